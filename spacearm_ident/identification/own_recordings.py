"""What a model leaves of its own recordings: fits that each leave out a part, and how well they predict it.

Kept in the model file. Whoever compares another recording with the model alone (`mismatch --reference model.yaml`)
learns from it how far a healthy arm may be from the model: what the model lacks is in what is left of the parts, and
what the recordings did not determine in how far the fits differ (jackknife, Efron and Stein 1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import OwnRecordings
from ..estimate.consistency import make_consistent
from ..regression.held_out import FEWEST_BLOCKS, folds_of
from .block_grams import BlockGrams
from .fit import Fit

LEAST_MOVED = 1e-12
"""Keeps the ratio of what moves a fit finite at a joint without rows."""


@dataclass(frozen=True)
class PartLeftOut:
    """A fit that leaves out the blocks of one fold.

    Attributes:
        fold: Numbers of these blocks (`held_out.time_blocks`).
        free: (p,) parameters by least squares without bounds.
        possible: (p,) physically consistent ones.
    """

    fold: np.ndarray
    free: FloatArray
    possible: FloatArray


def parts_left_out(fit: Fit, grams: BlockGrams) -> list[PartLeftOut]:
    """One part after the other left out; none where too little was recorded to be divided.

    Args:
        fit: Least squares without bounds.
        grams: Its regression by blocks, at its constants.
    """
    if len(grams.recording) < FEWEST_BLOCKS:
        return []
    made = []
    for fold in folds_of(grams.recording):
        matrix, free = grams.solve(grams.rest(fold), fit.prior)
        possible = make_consistent(fit.regression.model, matrix, free, fit.prior.scale)
        made.append(PartLeftOut(fold, free, possible))
    return made


def own_recordings(
    fit: Fit, grams: BlockGrams, parts: list[PartLeftOut], parameters: FloatArray, factor: FloatArray
) -> OwnRecordings | None:
    """What is kept of them in the model; None where there are none.

    Args:
        fit: Least squares without bounds.
        grams: Its regression by blocks, at its constants.
        parts: Fits that leave out a part each.
        parameters: (p,) of the model, fitted to all.
        factor: (p, v) how far they may be off in another recording: L of their covariance L L'.
    """
    if len(parts) < 2:
        return None
    motions = fit.regression.motions
    largest = np.array([rows.weight.max(initial=0.0) for rows in fit.regression.rows])
    worth = np.stack([grams.information(part.fold) for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        left, fitted = (
            np.nan_to_num(np.sqrt(np.stack(squares) / worth))
            for squares in (
                [grams.squares(part.fold, part.possible).sum(axis=0) for part in parts],
                [grams.squares(part.fold, parameters).sum(axis=0) for part in parts],
            )
        )
        rows = np.nan_to_num(worth / largest**2)
    moves, moved = np.sum([grams.slowness(part.fold, part.possible, factor) for part in parts], axis=0)
    rate_hz = np.mean([motion.row_rate_hz for motion in motions])
    white = 1.0 / (np.where(largest > 0.0, largest, np.inf) ** 2 * rate_hz)
    squares = sum((motion.moving * motion.reduce(motion.acceleration) ** 2).sum(axis=0) for motion in motions)
    moving = np.maximum(sum(motion.moving.sum(axis=0) for motion in motions), 1)
    return OwnRecordings(
        recordings=len({motion.source for motion in motions}),
        acceleration=np.sqrt(squares / moving),
        rows=rows,
        left_out_Nm=left,
        fitted_Nm=fitted,
        parameters=np.stack([part.possible for part in parts]),
        density=white * moves / np.maximum(moved, LEAST_MOVED),
    )
