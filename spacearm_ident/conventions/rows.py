"""`Rows`: a few hundred filtered samples of position, its derivatives, friction direction and torque.

A change of convention (sign, unit, zero, exchange of joints) is linear in position and torque, so it commutes with
low-pass, differentiation and decimation: everything is filtered once, and every hypothesis is applied to rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ..arrays import FloatArray
from ..dynamics.friction import bristle_state
from ..errors import UnfitDataError
from ..signals.motion import Motion

MOST_ROWS = 500
"""Rows that a hypothesis is judged on; neighbours at four rows a period of the cut-off tell little beyond these."""
PRESLIDING_RAD = 0.005
"""Travel over which friction builds up after a reversal: 2 to 10 mrad is usual for harmonic drives. Two columns, of 3
and 15 mrad, name no more of the mistakes that the conventions' bench draws, and call a zero of a sound xMate off."""
LONGEST_DELAY_S = 0.3
"""Delays looked for, either way; rows nearer to the end of a run have no torque so much earlier or later."""


@dataclass(frozen=True)
class Rows:
    """Filtered samples; columns are the recording's joints in the arm's order, before any correction.

    Attributes:
        position, velocity, acceleration: (M, n) rad, rad/s, rad/s^2.
        direction: (M, n) low-passed sign of the velocity: column of Coulomb friction.
        unbuilt: (M, n) low-passed share of Coulomb friction that has not built up since a reversal, signed alike.
        moving: (M, n) whether a row is free of the joint's standstill.
        time: (M,) seconds from the start of the recording.
        curves: The torque of each uninterrupted run of rows as a function of time.
        run: (M,) which of `curves` a row is of.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    direction: FloatArray
    unbuilt: FloatArray
    moving: np.ndarray
    time: FloatArray
    curves: tuple[CubicSpline, ...]
    run: np.ndarray

    def thinned(self, step: int) -> Rows:
        """Every `step`-th row."""
        pick = slice(None, None, step)
        names = ("position", "velocity", "acceleration", "direction", "unbuilt", "moving", "time", "run")
        return replace(self, **{name: getattr(self, name)[pick] for name in names})

    def torque(self, delay_s: FloatArray) -> FloatArray:
        """(M, n) N·m: the torque `delay_s` (n,) later than each row, at most `LONGEST_DELAY_S` either way."""
        torque = np.empty_like(self.position)
        for number, curve in enumerate(self.curves):
            rows = self.run == number
            for delay in np.unique(delay_s):
                columns = delay_s == delay
                torque[np.ix_(rows, columns)] = curve(self.time[rows] + delay)[:, columns]
        return torque


def rows_of(motions: Sequence[Motion], most: int = MOST_ROWS) -> Rows:
    """Rows of motions, thinned evenly: of those in which some joint moves, or of all where none does.

    A row without motion says nothing of any joint. Thinned by the clock, ten minutes with one run of seventeen seconds
    would keep five rows of it, too few for every joint.

    Args:
        motions: Filtered alike.
        most: About so many rows remain at most.

    Raises:
        UnfitDataError: No run is longer than twice `LONGEST_DELAY_S` and a second.
    """
    long = [motion for motion in motions if len(motion.time) and np.ptp(motion.time) > 2 * LONGEST_DELAY_S + 1.0]
    if not long:
        raise UnfitDataError("no uninterrupted stretch of motion is longer than two seconds: record a longer run")
    inside = [
        (motion.time - motion.time[0] >= LONGEST_DELAY_S) & (motion.time[-1] - motion.time >= LONGEST_DELAY_S)
        for motion in long
    ]
    telling = [rows & motion.moving.any(axis=1) for rows, motion in zip(inside, long)]
    if not any(rows.any() for rows in telling):
        telling = inside
    step = max(1, int(np.ceil(sum(int(rows.sum()) for rows in telling) / most)))
    parts = []
    for number, motion in enumerate(long):
        pick = np.flatnonzero(telling[number])[::step]
        signals = (
            motion.reduce(motion.position),
            motion.velocity_rows,
            motion.reduce(motion.acceleration),
            motion.reduce(np.sign(motion.velocity)),
            motion.reduce(_unbuilt(motion)),
            motion.moving,
            motion.time,
        )
        parts.append((*(signal[pick] for signal in signals), np.full(len(pick), number)))
    curves = tuple(CubicSpline(motion.time, motion.torque_rows) for motion in long)
    position, velocity, acceleration, direction, unbuilt, moving, time, run = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    return Rows(position, velocity, acceleration, direction, unbuilt, moving, time, curves, run)


def _unbuilt(motion: Motion) -> FloatArray:
    """(N, n) share of Coulomb friction that has not built up since a reversal, signed as the velocity."""
    sign, travel = np.sign(motion.velocity), np.abs(motion.velocity) / motion.rate_hz
    built = [bristle_state(own[:, None], way, PRESLIDING_RAD)[:, 0] for own, way in zip(sign.T, travel.T)]
    return np.asarray(sign - np.stack(built, axis=1))
