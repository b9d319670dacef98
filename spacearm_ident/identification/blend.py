"""Which models predict torque best together, joint by joint: consistent, unbounded and plain.

Where a model leaves something out, least squares puts it into parameters that can imitate it: a spring takes inertia
away, and a rotor inertia comes out below zero. Physical consistency forbids that, and torque is then predicted worse
than by least squares without bounds. And where joints share inertials, a term that helps one joint may cost another
more than a plain model would (`plain.py`). Held-out blocks decide: the prediction is a convex combination of the three
(stacked regressions, Breiman 1996, Machine Learning 24, 49). Of all combinations that predict held-out blocks within
one standard error of the best, the one nearest to the plain model is taken (one-standard-error rule, Breiman et al.
1984, section 3.4.3): a more complex prediction must earn its place. Where the consistent parameters have earned it,
and predict a joint better than the plain model beyond chance, the plain model has no part in that joint's torque, and
the combination nearest to them is taken. Bodies, simulations and the URDF keep the consistent parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel, Plain, Unbounded
from ..regression.held_out import BEYOND, FEWEST_BLOCKS, LEVEL, bound, t_of_drop, time_blocks
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..solvers.solution_columns import columns_at
from .block_grams import BlockGrams
from .fit import Fit
from .own_recordings import PartLeftOut
from .plain import plain_fit

CONSISTENT, UNBOUNDED, PLAIN = range(3)
"""Numbers of the three candidates in every array of this module."""
STEPS = 10
"""Shares are multiples of one in so many: a tenth of the difference of two models is below what blocks can resolve."""
MIXTURES = np.array([(STEPS - k - m, k, m) for k in range(STEPS + 1) for m in range(STEPS + 1 - k)]) / STEPS
"""(66, 3) shares of the candidates that are compared; each sums to one."""


def blended(
    model: IdentifiedModel, fit: Fit, parts: Sequence[PartLeftOut], allow_plain: bool = True
) -> IdentifiedModel:
    """The model with what predicts held-out data best blended into its torque.

    Args:
        model: Physically consistent parameters of `fit`, and nothing blended.
        fit: Least squares without bounds, which gave parameters that are not physically consistent.
        parts: Fits of it that leave out a part each (`own_recordings.py`).
        allow_plain: Whether the plain model is a candidate; not where the user asked for a structure. The combination
            nearest to the consistent parameters is then taken.

    Returns:
        `model` itself where nothing else is part of the prediction, or too little was recorded to decide.
    """
    if not parts:
        return model
    plain, prior, solution = plain_fit(fit)
    products = _products(fit, parts, plain, prior, solution.constants)
    shares = np.stack([_share(products[:, joint], allow_plain) for joint in range(products.shape[1])])
    if shares[:, UNBOUNDED].any():
        model = replace(model, unbounded=Unbounded(fit.solution.parameters, shares[:, UNBOUNDED]))
    if shares[:, PLAIN].any():
        model = replace(model, plain=Plain(plain.model, solution.parameters, solution.constants, shares[:, PLAIN]))
    return model


def blend_notes(model: IdentifiedModel) -> tuple[str, ...]:
    """What is blended into the prediction and why, for the user; empty where nothing is."""
    parts = {
        "least squares without the bounds of physical consistency": model.unbounded,
        "a model with Coulomb and viscous friction alone": model.plain,
    }
    names = model.model.arm.joint_names
    described = [
        f"{words} ({', '.join(f'{name} {share:.0%}' for name, share in zip(names, part.share) if share > 0.0)})"
        for words, part in parts.items()
        if part is not None
    ]
    if not described:
        return ()
    return (
        f"predicted torque is weighted with {' and '.join(described)}, which predict held-out data as well or better; "
        "masses, inertias, the URDF and simulations use the physically consistent parameters alone",
    )


def _products(
    fit: Fit, parts: Sequence[PartLeftOut], plain: Regression, plain_prior: Prior, constants: FloatArray
) -> FloatArray:
    """Squares and products of the candidates' residuals in held-out blocks.

    Args:
        fit: Least squares without bounds.
        parts: Fits of it that leave out a part each.
        plain: Weighted rows of the plain model on the same motions.
        plain_prior: Its prior.
        constants: (c,) its constants in a prediction; zero in its fit.

    Returns:
        (blocks, n, 3, 3) sums over a block's rows, N²·m²; each candidate fitted to the other folds.
    """
    plain_grams = BlockGrams(plain, np.zeros_like(constants))
    columns, numbers = columns_at(fit.regression, fit.solution.constants)
    plain_columns, plain_numbers = columns_at(plain, constants)
    block_of, recording = time_blocks(fit.regression.motions)
    blocks = [rows.group(block_of) for rows in fit.regression.rows]
    products = np.zeros((len(recording), len(blocks), 3, 3))
    for part in parts:
        fold = part.fold
        _, simple = plain_grams.solve(plain_grams.rest(fold), plain_prior)
        for joint, (rows, block) in enumerate(zip(fit.regression.rows, blocks)):
            inside = np.isin(block, fold)
            own = columns[joint][inside] @ np.column_stack([part.possible, part.free])[numbers[joint]]
            other = plain_columns[joint][inside] @ simple[plain_numbers[joint]]
            left = rows.torque[inside, None] - np.column_stack([own, other])
            for number in fold:
                own_rows = left[block[inside] == number]
                products[number, joint] = own_rows.T @ own_rows
    return products


def _share(products: FloatArray, allow_plain: bool) -> FloatArray:
    """Shares of the candidates in one joint's prediction.

    Args:
        products: (blocks, 3, 3) of `_products`.
        allow_plain: Whether the plain model is a candidate.

    Returns:
        (3,) shares nearest to the simplest candidate among those within one standard error of the best; the consistent
        parameters alone where too few blocks hold motion of the joint.
    """
    alone = np.einsum("bkk->kb", products)
    if (alone.min(axis=0) > 0.0).sum() < FEWEST_BLOCKS:
        return np.asarray(np.eye(3)[CONSISTENT])
    surpassed = t_of_drop(alone[PLAIN], alone[CONSISTENT]) > bound(LEVEL, len(products))
    with_plain = allow_plain and not surpassed
    mixtures = MIXTURES if with_plain else MIXTURES[MIXTURES[:, PLAIN] == 0.0]
    simplest = PLAIN if with_plain else CONSISTENT
    squares = np.einsum("bij,wi,wj->bw", products, mixtures, mixtures)
    best = int(squares.sum(axis=0).argmin())
    drops = np.array([t_of_drop(left, squares[:, best]) for left in squares.T])
    distance = np.linalg.norm(mixtures - np.eye(3)[simplest], axis=1)
    return np.asarray(mixtures[np.where(drops <= BEYOND, distance, np.inf).argmin()])
