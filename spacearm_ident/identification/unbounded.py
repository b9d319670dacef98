"""`unbounded`: how much of least squares without bounds predicts torque best, joint by joint.

Where a model leaves something out, least squares puts it into parameters that can imitate it: a spring takes inertia
away, and a rotor inertia comes out below zero. Physical consistency forbids that, and torque is then predicted worse
than by least squares without bounds. Whether it is, held-out blocks say: the prediction is that of the consistent
parameters, and as large a share of the way to the unbounded ones as leaves the least there (stacked regressions,
Breiman 1996, Machine Learning 24, 49). Bodies, simulations and the URDF keep the consistent parameters.
"""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.model import IdentifiedModel, Unbounded
from .block_grams import BlockGrams
from .consistency import make_consistent
from .fit import Fit
from .held_out import BEYOND, FEWEST_BLOCKS, folds_of, t_of_drop


def unbounded(fit: Fit) -> Unbounded | None:
    """The unbounded parameters and their shares in the prediction.

    Args:
        fit: Least squares without bounds, which gave parameters that are not physically consistent.

    Returns:
        None where the consistent parameters predict as well at every joint, or too little was recorded to tell.
    """
    grams = BlockGrams(fit.regression, fit.solution.constants)
    if len(grams.recording) < FEWEST_BLOCKS:
        return None
    share = _shares(*_held_out(fit, grams))
    return Unbounded(fit.solution.parameters, share) if share.any() else None


def _shares(bounded: FloatArray, between: FloatArray, free: FloatArray) -> FloatArray:
    """(n,) shares that leave the least, from the squares (blocks, n) left at 0, 1/2 and 1; 0 where the drop is chance.

    The squares are quadratic in the share. The simpler of the two models is the one that an arm could have.
    """
    slope, bend = 4.0 * between - 3.0 * bounded - free, 2.0 * (bounded + free) - 4.0 * between
    total = np.maximum(bend.sum(axis=0), 1e-300)
    share = np.clip(-slope.sum(axis=0) / (2.0 * total), 0.0, 1.0)
    left = bounded + slope * share + bend * share**2
    clear = [t_of_drop(before, after) > BEYOND for before, after in zip(bounded.T, left.T)]
    return np.where(clear, share, 0.0)


def blend_notes(model: IdentifiedModel) -> tuple[str, ...]:
    """What a user should know of the shares of the unbounded parameters, in words."""
    if model.unbounded is None:
        return ()
    shares = zip(model.model.arm.joint_names, model.unbounded.share.tolist())
    told = ", ".join(f"{joint} {share:.0%}" for joint, share in shares if share > 0.0)
    return (
        f"predicted torque goes part of the way to least squares without physical bounds ({told}), which predicts "
        "held-out data better: something acts there that the model leaves out; bodies, simulations and the URDF keep "
        "the physically consistent parameters",
    )


def _held_out(fit: Fit, grams: BlockGrams) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(blocks, n) squares left in every block by fits to the other folds: bounded, half way, and unbounded."""
    model, prior = fit.regression.model, fit.prior
    bounded, between, free = np.zeros((3, len(grams.recording), len(model.arm.joints)))
    for fold in folds_of(grams.recording):
        matrix, parameters = grams.solve(grams.rest(fold), prior)
        possible = make_consistent(model, matrix, parameters, prior.scale)
        bounded[fold], free[fold] = grams.squares(fold, possible), grams.squares(fold, parameters)
        between[fold] = grams.squares(fold, 0.5 * (possible + parameters))
    return bounded, between, free
