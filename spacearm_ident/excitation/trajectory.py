"""Trajectories: a run is a list of segments (rest, quintic, Fourier series) that join without a jump.

A segment is anything with a duration that can be evaluated analytically (`segments.Segment`); a new kind is one
class and one entry in `trajectory_file`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from spacearm_ident.errors import UserError

from ..arrays import FloatArray
from .segments import Motion, MotionLimits, Quintic, Rest, Segment, still

__all__ = [
    "FloatArray",
    "FourierTrajectory",
    "Motion",
    "MotionLimits",
    "Quintic",
    "Rest",
    "Segment",
    "Trajectory",
    "draw_coefficients",
    "random_feasible",
]

_GRID_S = 0.002
"""Step of the grid on which limits are verified: at 5 Hz, far above any excitation here, it misses 5e-4."""
_JOIN_TOLERANCE = 1e-6
_PHASES = 40
_BRAKES_S = (2.0, 1.5, 1.1, 0.8, 0.6, 0.4, 0.3)
_PAUSE_S = 0.2


@dataclass(frozen=True, eq=False)
class FourierTrajectory:
    """The periodic excitation of the paper (eq. 9-11), `periods` times over.

    q_i(t) = q0_i + Σ_k [a_ik/ω_k · sin ω_k t − b_ik/ω_k · cos ω_k t],  ω_k = 2π k f0,  k = 1…N_h

    Attributes:
        joints: Names of the n joints.
        q0: (n,) rad, the mean position.
        a: (n, N_h) rad/s.
        b: (n, N_h) rad/s.
        fundamental_hz: f0, Hz.
        periods: How many periods the run holds.
    """

    joints: tuple[str, ...]
    q0: FloatArray
    a: FloatArray
    b: FloatArray
    fundamental_hz: float
    periods: int

    def __post_init__(self) -> None:
        n = len(self.joints)
        if self.q0.shape != (n,) or self.a.ndim != 2 or len(self.a) != n or self.a.shape != self.b.shape:
            raise ValueError(f"q0 {self.q0.shape}, a {self.a.shape}, b {self.b.shape} do not fit {n} joints")
        if not self.fundamental_hz > 0 or self.periods < 1:
            raise ValueError("fundamental_hz and periods must be positive")

    @property
    def period_s(self) -> float:
        """Length of one period, s."""
        return 1.0 / self.fundamental_hz

    @property
    def duration_s(self) -> float:
        """Length of all periods, s."""
        return self.periods * self.period_s

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at the times `t` (T,), s; periodic, so defined for every t."""
        omega = 2 * np.pi * self.fundamental_hz * np.arange(1, self.a.shape[1] + 1)
        phase = np.outer(np.atleast_1d(np.asarray(t, dtype=float)), omega)
        sin, cos = np.sin(phase), np.cos(phase)
        return Motion(
            self.q0 + sin @ (self.a / omega).T - cos @ (self.b / omega).T,
            cos @ self.a.T + sin @ self.b.T,
            cos @ (self.b * omega).T - sin @ (self.a * omega).T,
        )

    def shifted(self, time_s: float) -> FourierTrajectory:
        """The same periodic motion, begun `time_s` later in its period."""
        angle = 2 * np.pi * self.fundamental_hz * time_s * np.arange(1, self.a.shape[1] + 1)
        sin, cos = np.sin(angle), np.cos(angle)
        return replace(self, a=self.a * cos + self.b * sin, b=self.b * cos - self.a * sin)

    def begun_where_joinable(self, limits: MotionLimits, start: ArrayLike | None = None) -> FourierTrajectory:
        """The same motion, begun at the phase that makes its `run` from `start` the quickest.

        Raises:
            UserError: Begun nowhere in its period can it be joined within the limits.
        """
        return self.runs_by_phase(limits, start)[0][0]

    def runs_by_phase(
        self, limits: MotionLimits, start: ArrayLike | None = None, rest_s: float = 1.0
    ) -> list[tuple[FourierTrajectory, Trajectory]]:
        """The same motion begun at phases all over its period, each with its `run`, the quickest first.

        Args:
            limits: As for `run`.
            start: As for `run`.
            rest_s: As for `run`.

        Raises:
            UserError: Begun nowhere in its period can it be joined within the limits.
        """
        runs, refusal = [], UserError()
        for time_s in np.linspace(0.0, self.period_s, _PHASES, endpoint=False):
            begun = self.shifted(float(time_s))
            try:
                runs.append((begun, begun.run(limits, start, rest_s)))
            except UserError as error:
                refusal = error
        if not runs:
            raise refusal
        return sorted(runs, key=lambda pair: pair[1].duration_s)

    def run(self, limits: MotionLimits, start: ArrayLike | None = None, rest_s: float = 1.0) -> Trajectory:
        """The whole run: rest at `start` (n,), approach, all periods, return, rest.

        Approach and return are quick, with velocity and acceleration zero where they meet rest. A
        motion that is fast beside a limit when its period begins is refused: see `begun_where_joinable`.

        Args:
            limits: Limits the approach and the return must keep.
            start: Posture to leave from and come back to, rad; all zeros unless given.
            rest_s: Rest before and after, s; 0 for none.

        Raises:
            UserError: The approach cannot keep the limits.
        """
        home = np.zeros(len(self.joints)) if start is None else np.asarray(start, dtype=float)
        first = self.evaluate(0.0).at(0)
        rest = [Rest(home, rest_s)] if rest_s > 0 else []
        away = _departure(limits, home, Motion(first.q, -first.qd, first.qdd))
        approach = [_backwards(segment) for segment in reversed(away)]
        segments = [*rest, *approach, self, *_departure(limits, home, first), *rest]
        return Trajectory(self.joints, tuple(segments))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A whole run: segments one after the other, in position and velocity without a jump.

    Raises:
        UserError: Two neighbours do not join, or there are no segments.
    """

    joints: tuple[str, ...]
    segments: tuple[Segment, ...]

    def __post_init__(self) -> None:
        if not self.segments:
            raise UserError("a trajectory needs at least one segment")
        for number, (left, right) in enumerate(pairwise(self.segments), start=1):
            end, begin = left.evaluate(left.duration_s).at(0), right.evaluate(0.0).at(0)
            jump = max(np.abs(end.q - begin.q).max(), np.abs(end.qd - begin.qd).max())
            if jump > _JOIN_TOLERANCE:
                raise UserError(
                    f"segment {number + 1} starts {jump:.3g} rad or rad/s away from where segment {number} "
                    "ends; put a quintic segment between them"
                )

    @property
    def duration_s(self) -> float:
        """Length of the whole run, s."""
        return sum(segment.duration_s for segment in self.segments)

    def starts_s(self) -> FloatArray:
        """Time at which each segment starts, s."""
        return np.concatenate([[0.0], np.cumsum([s.duration_s for s in self.segments])[:-1]])

    def evaluate(self, t: ArrayLike) -> Motion:
        """Motion at the times `t` (T,), s; before the start and after the end, the posture there, held."""
        times = np.atleast_1d(np.asarray(t, dtype=float))
        inside = np.clip(times, 0.0, self.duration_s)
        starts = self.starts_s()
        which = np.clip(np.searchsorted(starts, inside, side="right") - 1, 0, len(starts) - 1)
        out = Motion(*(np.empty((times.size, len(self.joints))) for _ in range(3)))
        for index in np.unique(which):
            rows = which == index
            piece = self.segments[index].evaluate(inside[rows] - starts[index])
            for target, values in zip(out, piece, strict=True):
                target[rows] = values
        outside = times != inside
        out.qd[outside] = 0.0
        out.qdd[outside] = 0.0
        return out


def _departure(limits: MotionLimits, home: FloatArray, state: Motion) -> list[Rest | Quintic]:
    """From a moving state (three (n,)) to rest at `home`, in one move or, where that breaks a limit, in two.

    One polynomial of the long duration a far joint needs would swing the fast ones out of their range. So the
    second form brakes first, as gently as the limits allow, and goes home from that stop.

    Raises:
        UserError: Neither keeps the limits.
    """
    end = still(home)
    try:
        return [Quintic.within(limits, state, end)]
    except UserError as error:
        for brake_s in _BRAKES_S:
            # Where braking at a falling speed without turning round comes to a stop.
            stop = state.q + state.qd * brake_s / 2 + state.qdd * brake_s**2 / 12
            brake = Quintic(state, still(stop), brake_s)
            if brake.keeps(limits):
                return [brake, Rest(stop, _PAUSE_S), Quintic.within(limits, still(stop), end)]
        raise error


def _backwards(segment: Rest | Quintic) -> Rest | Quintic:
    """The same motion in reversed time."""
    if isinstance(segment, Rest):
        return segment
    start, end = (Motion(s.q, -s.qd, s.qdd) for s in (segment.end, segment.start))
    return Quintic(start, end, segment.duration_s)


def random_feasible(
    joints: Iterable[str],
    limits: MotionLimits,
    *,
    seed: int,
    fundamental_hz: float = 0.1,
    harmonics: int = 5,
    periods: int = 5,
    usage: float = 0.9,
    smallest_usage: float = 0.6,
    start: ArrayLike | None = None,
) -> FourierTrajectory:
    """A seeded random Fourier trajectory that keeps the limits, verified on a fine grid, and can be joined.

    Each joint is scaled on its own until position, velocity or acceleration uses a share of its limit, drawn
    between `smallest_usage` and `usage`; its centre is drawn from where the scaled motion fits.

    Args:
        joints: Names of the n joints.
        limits: Limits to keep.
        seed: Same seed, same trajectory.
        fundamental_hz: f0, Hz.
        harmonics: N_h.
        periods: Number of periods.
        usage: Largest share of a limit a joint may use, at most 1.
        smallest_usage: Smallest share drawn.
        start: Posture (n,) its `run` shall be able to leave from, rad; all zeros unless given.

    Raises:
        UserError: It cannot be joined to `start` within the limits.
    """
    names = tuple(joints)
    rng = np.random.default_rng(seed)
    a, b, centre = draw_coefficients(rng, limits, fundamental_hz, harmonics, (smallest_usage, usage))
    series = FourierTrajectory(names, centre, a, b, fundamental_hz, periods)
    return series.begun_where_joinable(limits, start)


def draw_coefficients(
    rng: np.random.Generator,
    limits: MotionLimits,
    fundamental_hz: float,
    harmonics: int,
    usage: tuple[float, float],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients a, b (n, N_h), rad/s, and centre (n,), rad, of one random series within the limits (jerk apart).

    Args:
        rng: Source of the random numbers.
        limits: (n,) each; position limits must be finite.
        fundamental_hz: f0, Hz.
        harmonics: N_h.
        usage: Smallest and largest share of a limit that a joint may use, at most 1.
    """
    n = len(limits.lower)
    # Coefficients are velocities (eq. 10), so every harmonic gets the same share of speed.
    a, b = rng.standard_normal((2, n, harmonics))
    unit = FourierTrajectory(("",) * n, np.zeros(n), a, b, fundamental_hz, 1)
    motion = unit.evaluate(_grid(unit.period_s))
    highest, lowest = motion.q.max(axis=0), motion.q.min(axis=0)
    worst = np.max(
        [
            (highest - lowest) / (limits.upper - limits.lower),
            np.abs(motion.qd).max(axis=0) / limits.velocity,
            np.abs(motion.qdd).max(axis=0) / limits.acceleration,
        ],
        axis=0,
    )
    scale = rng.uniform(*usage, n) / worst
    # The share narrows the position range about its middle too: the margin holds for all three limits.
    middle, half = (limits.upper + limits.lower) / 2, usage[1] * (limits.upper - limits.lower) / 2
    room_low, room_high = middle - half - scale * lowest, middle + half - scale * highest
    centre = room_low + rng.uniform(0.0, 1.0, n) * (room_high - room_low)
    return scale[:, None] * a, scale[:, None] * b, centre


def _grid(duration_s: float) -> FloatArray:
    return np.linspace(0.0, duration_s, max(200, round(duration_s / _GRID_S)) + 1)
