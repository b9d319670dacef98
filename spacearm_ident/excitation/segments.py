"""Segments: the pieces a run is made of, each an analytic motion on its own clock.

A segment is anything with a duration that can be evaluated (`Segment`). Besides rest, the fifth-order move and
the Fourier series (`trajectory.FourierTrajectory`), there are constant speed and a sine of rising frequency; with
moves between them these make sweeps, reversals, steps and chirps (`composite`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError

_LONGEST_MOVE_S = 120.0
_MOVE_POINTS = 401
"""Between these a fifth-order polynomial's extremes exceed the sampled ones by less than 1e-4."""
_SIFTED = 20
"""Every so many of these points alone rule out most durations that are too short."""


class Motion(NamedTuple):
    """Position, velocity, acceleration, (T, n) each; rad, rad/s, rad/s²."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray

    def at(self, row: int) -> Motion:
        """The state at one instant, three (n,) arrays."""
        return Motion(self.q[row], self.qd[row], self.qdd[row])


class Segment(Protocol):
    """A piece of a run: analytic motion on [0, `duration_s`]."""

    @property
    def duration_s(self) -> float:
        """How long the segment lasts, s."""

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at the times `t` (T,), seconds from the start of the segment."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What the arm may do: positions in [lower, upper], |velocity|, |acceleration|, |jerk|, (n,) each, SI."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray | None = None

    def usage(self, motion: Motion) -> FloatArray:
        """Largest share of each joint's limits a motion (..., T, n) uses, (..., n); above 1 it breaks one.

        Position counts as the distance from the middle of the range over half the range.
        """
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        shares = (
            np.abs(motion.q - middle) / half,
            np.abs(motion.qd) / self.velocity,
            np.abs(motion.qdd) / self.acceleration,
        )
        return np.asarray(np.max([share.max(axis=-2) for share in shares], axis=0))


@dataclass(frozen=True, eq=False)
class Rest:
    """Standing still at `position` (n,)."""

    position: FloatArray
    duration_s: float

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at `t` (T,): constant position."""
        q = np.tile(self.position, (np.atleast_1d(t).size, 1))
        return Motion(q, np.zeros_like(q), np.zeros_like(q))


@dataclass(frozen=True, eq=False)
class Quintic:
    """The fifth-order polynomial from one state (q, qd, qdd; (n,) each) to another in `duration_s`."""

    start: Motion
    end: Motion
    duration_s: float

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at `t` (T,), s."""
        T = self.duration_s
        return _quintic(self._coefficients(), T, (np.atleast_1d(np.asarray(t, dtype=float)) / T)[:, None])

    def jerk(self, t: ArrayLike) -> FloatArray:
        """(T, n) rad/s³ at `t` (T,), s."""
        s = (np.atleast_1d(np.asarray(t, dtype=float)) / self.duration_s)[:, None]
        *_, c3, c4, c5 = self._coefficients()
        return (6 * c3 + s * (24 * c4 + s * 60 * c5)) / self.duration_s**3

    def _coefficients(self) -> tuple[FloatArray, ...]:
        return _quintic_coefficients(self.start, self.end, self.duration_s)

    def keeps(self, limits: MotionLimits) -> bool:
        """Whether the move stays within the limits."""
        t = np.linspace(0.0, self.duration_s, _MOVE_POINTS)
        if limits.jerk is not None and np.any(np.abs(self.jerk(t)) > limits.jerk):
            return False
        return bool(limits.usage(self.evaluate(t)).max() <= 1.0)

    @classmethod
    def within(cls, limits: MotionLimits, start: Motion, end: Motion, shortest_s: float = 1.0) -> Quintic:
        """The quickest such move, in steps of some 10 % from `shortest_s`, that keeps the limits.

        Args:
            limits: (n,) each.
            start: State at the beginning, (n,) each.
            end: State at the end, (n,) each.
            shortest_s: Shortest duration tried, s.

        Raises:
            UserError: No duration up to two minutes does.
        """
        durations = _durations(shortest_s)
        for duration in durations[_sifted(limits, start, end, durations)].tolist():
            move = cls(start, end, duration)
            if move.keeps(limits):
                return move
        raise UserError(
            "no smooth move joins the start posture and the trajectory within the limits; "
            "choose a start posture inside the position limits, or a trajectory that begins farther from them"
        )


@lru_cache
def _durations(shortest_s: float) -> FloatArray:
    """Durations tried, s: whole tenths, so that what follows starts on a sample at any usual rate."""
    durations = [shortest_s]
    while (longer := math.ceil(11.0 * durations[-1]) / 10.0) < _LONGEST_MOVE_S:
        durations.append(longer)
    return np.array(durations)


def _sifted(limits: MotionLimits, start: Motion, end: Motion, durations: FloatArray) -> NDArray[np.bool_]:
    """(D,) which durations of the move break no limit at a few of its points; the others cannot keep them."""
    T = durations[:, None, None]
    s = np.linspace(0.0, 1.0, _MOVE_POINTS)[::_SIFTED, None]
    moves = _quintic(_quintic_coefficients(start, end, T), T, s)
    return np.asarray(limits.usage(moves).max(axis=-1) <= 1.0)


def _quintic_coefficients(start: Motion, end: Motion, T: float | FloatArray) -> tuple[FloatArray, ...]:
    """Of the position's polynomial in s = t/T: the first three are the start state, the rest close on the end state."""
    c0, c1, c2 = start.q, T * start.qd, T**2 * start.qdd / 2
    dq = end.q - (c0 + c1 + c2)
    dv = T * end.qd - (c1 + 2 * c2)
    da = T**2 * end.qdd - 2 * c2
    return c0, c1, c2, 10 * dq - 4 * dv + da / 2, -15 * dq + 7 * dv - da, 6 * dq - 3 * dv + da / 2


def _quintic(coefficients: tuple[FloatArray, ...], T: float | FloatArray, s: FloatArray) -> Motion:
    """The motion at s = t/T; all broadcast against each other, the joints last."""
    c0, c1, c2, c3, c4, c5 = coefficients
    return Motion(
        c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5)))),
        (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / T,
        (2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / T**2,
    )


@dataclass(frozen=True, eq=False)
class Cruise:
    """Constant speed: from `position` (n,) rad with `velocity` (n,) rad/s."""

    position: FloatArray
    velocity: FloatArray
    duration_s: float

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at `t` (T,), s."""
        times = np.atleast_1d(np.asarray(t, dtype=float))[:, None]
        q = self.position + times * self.velocity
        return Motion(q, np.tile(self.velocity, (len(times), 1)), np.zeros_like(q))


@dataclass(frozen=True, eq=False)
class Chirp:
    """A sine whose frequency rises from `start_hz` to `end_hz` in proportion to time, faded in and out.

    q = centre + w(t) amplitude sin(2π (start_hz t + (end_hz − start_hz) t² / 2 T)). The fade w rises as a quintic
    over `FADE` of the duration T and falls likewise: position, velocity and acceleration are zero at both ends. The
    spectrum is flat between the two frequencies, and falls off outside.
    """

    centre: FloatArray
    amplitude: FloatArray
    start_hz: float
    end_hz: float
    duration_s: float

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at `t` (T,), s."""
        times = np.clip(np.atleast_1d(np.asarray(t, dtype=float)), 0.0, self.duration_s)[:, None]
        rate = (self.end_hz - self.start_hz) / self.duration_s
        phase = 2 * np.pi * (self.start_hz * times + rate * times**2 / 2)
        omega = 2 * np.pi * (self.start_hz + rate * times)
        sin, cos = np.sin(phase), np.cos(phase)
        s, s1, s2 = sin, omega * cos, 2 * np.pi * rate * cos - omega**2 * sin
        w, w1, w2 = self._fade(times)
        unit = (w * s, w1 * s + w * s1, w2 * s + 2 * w1 * s1 + w * s2)
        q, qd, qdd = (part * self.amplitude for part in unit)
        return Motion(self.centre + q, qd, qdd)

    def _fade(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The fade w and its two derivatives."""
        length = FADE * self.duration_s
        rising = times < self.duration_s / 2
        u = np.minimum(1.0, np.where(rising, times, self.duration_s - times) / length)
        sign = np.where(rising, 1.0, -1.0)
        first, second = 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
        return u**3 * (10 + u * (6 * u - 15)), sign * first / length, second / length**2


FADE = 0.1
"""Share of a chirp's duration over which it fades in, and out."""


def still(position: FloatArray) -> Motion:
    """The state at rest at `position` (n,)."""
    return Motion(position, np.zeros_like(position), np.zeros_like(position))
