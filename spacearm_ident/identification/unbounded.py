"""`unbounded`: how much of least squares without bounds predicts torque best, joint by joint.

Where a model leaves something out, least squares puts it into parameters that can imitate it: a spring takes inertia
away, and a rotor inertia comes out below zero. Physical consistency forbids that, and torque is then predicted worse
than by least squares without bounds. Whether it is, held-out blocks say: the prediction is that of the consistent
parameters, and as large a share of the way to the unbounded ones as leaves the least there (stacked regressions,
Breiman 1996, Machine Learning 24, 49). Bodies, simulations and the URDF keep the consistent parameters.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve, cholesky

from ..dynamics.arm import FloatArray
from ..dynamics.model import IdentifiedModel, Unbounded
from .consistency import make_consistent
from .fit import Fit
from .held_out import FEWEST_BLOCKS, folds_of, t_of_drop, time_blocks
from .prior import Prior
from .solution_columns import all_columns

BEYOND = 1.0
"""Standard errors by which held-out squares must drop: within one, the simpler of two models is kept (Breiman et al.
1984, "Classification and regression trees", section 3.4.3), and the simpler is the one that an arm could have."""


def unbounded(fit: Fit) -> Unbounded | None:
    """The unbounded parameters and their shares in the prediction.

    Args:
        fit: Least squares without bounds, which gave parameters that are not physically consistent.

    Returns:
        None where the consistent parameters predict as well at every joint, or too little was recorded to tell.
    """
    grams = _Grams(fit)
    folds = folds_of(grams.recording)
    if len(folds) < 2 or len(grams.recording) < FEWEST_BLOCKS:
        return None
    share = _shares(*grams.held_out(fit, folds))
    return Unbounded(fit.solution.parameters, share) if share.any() else None


def _shares(bounded: FloatArray, between: FloatArray, free: FloatArray) -> FloatArray:
    """(n,) shares that leave the least, from the squares (blocks, n) left at 0, 1/2 and 1; 0 where the drop is chance.

    The squares are quadratic in the share.
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


class _Grams:
    """Per joint and block of time, the Gram matrix of the weighted columns and the torque."""

    def __init__(self, fit: Fit) -> None:
        regression = fit.regression
        block_of, self.recording = time_blocks(regression)
        self._parts: list[tuple[list[int], FloatArray]] = []
        for rows, columns, numbers in zip(regression.rows, *all_columns(regression, fit.solution)):
            stacked = np.column_stack([columns, rows.torque]) * rows.weight[:, None]
            block = np.concatenate([block_of[k][rows.place[rows.owner == k]] for k in range(len(block_of))])
            own = [stacked[block == number] for number in range(len(self.recording))]
            self._parts.append((numbers, np.stack([part.T @ part for part in own])))

    def held_out(self, fit: Fit, folds: list[np.ndarray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(blocks, n) squares left in every block by fits to the other folds: bounded, half way, and unbounded."""
        bounded, between, free = np.zeros((3, len(self.recording), len(self._parts)))
        for fold in folds:
            rest = np.setdiff1d(np.arange(len(self.recording)), fold)
            matrix, parameters = self._solve(rest, fit.prior)
            possible = make_consistent(fit.regression.model, matrix, parameters, fit.prior.scale)
            bounded[fold], free[fold] = self._squares(fold, possible), self._squares(fold, parameters)
            between[fold] = self._squares(fold, 0.5 * (possible + parameters))
        return bounded, between, free

    def _solve(self, blocks: np.ndarray, prior: Prior) -> tuple[FloatArray, FloatArray]:
        """The compressed rows (p, p) of some blocks and the prior, and the parameters (p,) they ask for."""
        normal, side = prior.rows.T @ prior.rows, prior.rows.T @ prior.target
        for numbers, grams in self._parts:
            gram = grams[blocks].sum(axis=0)
            normal[np.ix_(numbers, numbers)] += gram[:-1, :-1]
            side[numbers] += gram[:-1, -1]
        parameters, free = prior.held.copy(), prior.free
        # In units of the prior's scales, in which the prior makes the matrix at least the unit matrix.
        unit = prior.scale[free]
        root = cholesky(normal[np.ix_(free, free)] * np.outer(unit, unit))
        known = (side - prior.fixed_part(normal))[free]
        parameters[free] = cho_solve((root, False), known * unit) * unit
        matrix = np.zeros(normal.shape)
        matrix[np.ix_(free, free)] = root / unit
        return matrix, parameters

    def _squares(self, blocks: np.ndarray, parameters: FloatArray) -> FloatArray:
        """(len(blocks), n) weighted squares that parameters leave."""
        left = [
            np.einsum("i,bij,j->b", vector, grams[blocks], vector)
            for numbers, grams in self._parts
            for vector in (np.append(parameters[numbers], -1.0),)
        ]
        return np.asarray(np.maximum(np.column_stack(left), 0.0))
