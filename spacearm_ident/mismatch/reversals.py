"""Friction transition at a velocity reversal: in time or over a distance, identified on the healthy arm's reversals.

At a reversal friction changes sign. A joint that sticks does so at rest, while the motor's torque changes; a joint with
presliding does so over a distance that the position shows, while the velocity is still within its noise. Switching
friction at the velocity-noise threshold delays it by tens of milliseconds, as much as the delays sought here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import direction
from ..dynamics.friction import bristle_state
from ..signals.motion import Motion
from .scene import since_reversal

POWERS = (1.0, 1.5, 2.0)
"""Of the time at standstill: a drive asks for more with the time since its set-point left or, where that turned round
just then, with its square."""
DISTANCES = tuple(float(distance) for distance in np.geomspace(2e-5, 4e-4, 12))
"""rad, of an exponential."""
TURNED_RAD = 1e-3
"""So far from where it turned round, if it does so over a distance, a joint's friction is the model's."""
AROUND_S = 0.1
"""Before and after a standstill, where ways to turn round are compared."""
PLAINLY = 0.5
"""A joint gives way where that leaves less than this share of the squares: where it does, it is a few percent."""
Way = Callable[[Motion, int, FloatArray], FloatArray]
"""Of a motion, a joint and its friction (N,) by the model, N·m: friction (N,) that turns round in this way."""


def in_time(power: float) -> Way:
    """Friction that goes from one side to the other, or back, with a power of the time at standstill."""

    def way(motion: Motion, row: int, friction: FloatArray) -> FloatArray:
        sign = direction(motion, row)
        moves, still = np.flatnonzero(sign), np.flatnonzero(sign == 0.0)
        if len(moves) == 0:
            return friction
        end = np.minimum(np.searchsorted(moves, still), len(moves) - 1)
        before, after = moves[np.maximum(end - 1, 0)], moves[end]
        gone = np.clip((still - before) / np.maximum(after - before, 1), 0.0, 1.0) ** power
        turned = friction.copy()
        turned[still] = friction[before] + gone * (friction[after] - friction[before])
        return turned

    return way


def over_distance(distance: float) -> Way:
    """Friction that goes over a distance, rad, small speeds believed: noise goes to and fro, and so does friction."""

    def way(motion: Motion, row: int, friction: FloatArray) -> FloatArray:
        velocity, sign = motion.velocity[:, row], direction(motion, row)
        known = (sign != 0.0) & (since_reversal(motion, row) > TURNED_RAD)
        if not known.any():
            return friction
        place = np.arange(len(sign))
        level = np.interp(place, place[known], (friction * sign)[known])
        travel = np.abs(velocity) / motion.rate_hz
        state = bristle_state(np.sign(velocity)[:, None], travel, distance, motion.cyclic)[:, 0]
        return np.where(known, friction, level * state)

    return way


IN_TIME = tuple(map(in_time, POWERS))
OVER_DISTANCE = tuple(map(over_distance, DISTANCES))


def learnt(motions: Sequence[Motion], parts: Sequence[tuple[FloatArray, FloatArray]]) -> list[Way]:
    """By joint, the way that leaves least of the torque that was measured around standstill.

    Args:
        motions: Of the healthy arm.
        parts: Load and friction (N, n) of each, by the model, N·m.
    """
    ways = []
    for row in range(len(motions[0].joints)):
        left = np.zeros(len(IN_TIME + OVER_DISTANCE))
        for motion, (load, friction) in zip(motions, parts):
            measured, near = motion.torque[:, row] - load[:, row], _around(motion, row)
            turned = (way(motion, row, friction[:, row]) for way in IN_TIME + OVER_DISTANCE)
            left += [np.sum((measured - one)[near] ** 2) for one in turned]
        held, given = left[: len(IN_TIME)], left[len(IN_TIME) :]
        gives_way = given.min() < PLAINLY * held.min()
        ways.append(OVER_DISTANCE[int(np.argmin(given))] if gives_way else IN_TIME[int(np.argmin(held))])
    return ways


def _around(motion: Motion, row: int) -> np.ndarray:
    """(N,) whether a sample is near a standstill."""
    wide = np.ones(2 * int(AROUND_S * motion.rate_hz) + 1)
    return np.asarray(np.convolve(direction(motion, row) == 0.0, wide, mode="same") > 0.5)
