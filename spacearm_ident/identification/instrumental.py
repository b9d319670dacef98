"""Instrumental variables: is least squares biased because the regressor itself is measured with noise?

Least squares takes the columns A for exact. They are made from measured positions, and noise in them pulls estimates
towards zero (errors in variables). With instruments Z, columns of the same motion whose noise is independent,

    x = (Z' W A)^-1 Z' W tau

is consistent all the same (IDIM-IV: Janot, Vandanjon and Gautier 2014, "A generic instrumental variable approach for
industrial robot identification"). They simulate the closed loop for Z, with the controller known. A recording does not
hold the controller, so here Z is a second measurement: the positions are split into even and odd samples, each half
interpolated over the other and put through the whole filter chain, and either is the instrument of the other (split
samples: Angrist and Krueger 1995). That is sound where position noise is white from sample to sample.

The structure, constants and weights are those of the least-squares solution on the same rows; what differs is only
whether noise in the columns counts. Differences beyond the standard errors are a sign of biased data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from ..arrays import FloatArray
from ..errors import UnfitDataError
from ..recording.recording import Recording
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..solvers.separable import Solution
from ..solvers.solution_columns import columns_at


def halves(recording: Recording) -> tuple[Recording, Recording]:
    """The recording with its odd, and with its even positions interpolated from the others.

    Raises:
        UnfitDataError: A segment has fewer than eight samples.
    """
    made = []
    for first in (0, 1):
        position = recording.position.copy()
        for segment in recording.segments:
            time = recording.time[segment]
            if len(time) < 8:
                raise UnfitDataError("a stretch of under eight samples cannot be split: use the solver separable")
            known, guessed = slice(first, None, 2), slice(1 - first, None, 2)
            within = position[segment]
            within[guessed] = make_interp_spline(time[known], within[known], k=3)(time[guessed])
        made.append(replace(recording, position=position, velocity=None))
    return made[0], made[1]


def split_motions(
    recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float
) -> tuple[list[Motion], list[Motion], list[Motion]]:
    """Motions of the recordings, and of either half of their samples, on the same rows; periods are not averaged.

    Args:
        recordings: One or more runs of the same arm.
        joints: The arm's joints, in its order.
        cutoff_hz: Low-pass cut-off, Hz.

    Returns:
        The motions of all samples, of every second sample from the first, and of every second from the second.

    Raises:
        UserError: As `prepare`.
        UnfitDataError: As `prepare`, or a segment has fewer than eight samples.
    """
    split = [halves(recording) for recording in recordings]
    plain, _ = prepare(recordings, joints, cutoff_hz, average=False)
    first, second = (
        prepare([pair[which] for pair in split], joints, cutoff_hz, average=False)[0] for which in range(2)
    )
    return plain, with_speeds_of(plain, first), with_speeds_of(plain, second)


def with_speeds_of(known: Sequence[Motion], motions: Sequence[Motion]) -> list[Motion]:
    """Motions, told at which speeds those that are known stand still.

    Args:
        known: Of the same recordings.
        motions: Made of their positions in another way.
    """
    return [
        replace(motion, speed_noise=own.speed_noise, resolved_speed=own.resolved_speed)
        for motion, own in zip(motions, known)
    ]


def instrumental(
    regression: Regression, first: Regression, second: Regression, prior: Prior, solution: Solution
) -> FloatArray:
    """(p,) parameters by instrumental variables, each half the instrument of the other.

    Args:
        regression: Weighted rows of the whole.
        first: The same rows from one half of the samples.
        second: From the other.
        prior: Beliefs.
        solution: Least squares on `regression`; its constants shape the columns.
    """
    width = len(regression.model.parameters)
    normal, side = prior.rows.T @ prior.rows, prior.rows.T @ prior.target
    for other in (first, second):
        other.update_background(solution.parameters, solution.constants)
    parts = [columns_at(other, solution.constants) for other in (first, second)]
    for joint, rows in enumerate(regression.rows):
        places = [_keys(other, joint) for other in (regression, first, second)]
        shared = np.intersect1d(np.intersect1d(places[0], places[1]), places[2])
        here, one, two = (np.searchsorted(place, shared) for place in places)
        information = rows.weight[here, None] ** 2
        numbers = parts[0][1][joint]
        columns, instruments = parts[0][0][joint][one], parts[1][0][joint][two]
        cross = instruments.T @ (information * columns)
        block = np.zeros((width, width))
        np.add.at(block, np.ix_(numbers, numbers), (cross + cross.T) / 2)
        normal += block
        np.add.at(side, numbers, ((columns + instruments) / 2).T @ (information[:, 0] * rows.torque[here]))
    free = prior.free
    held = np.setdiff1d(np.arange(width), free)
    side = side - normal[:, held] @ prior.held[held]
    scale = np.sqrt(np.abs(np.diag(normal))[free])
    parameters = prior.held.copy()
    parameters[free] = np.linalg.solve(normal[np.ix_(free, free)] / np.outer(scale, scale), side[free] / scale) / scale
    return parameters


def _keys(regression: Regression, joint: int) -> np.ndarray:
    """(M,) increasing numbers that name a joint's rows by motion and place."""
    rows = regression.rows[joint]
    return np.asarray(rows.owner.astype(np.int64) * 2**32 + rows.place)
