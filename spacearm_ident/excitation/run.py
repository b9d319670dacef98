"""A run on the arm: approach, excitation, return; and how it stops at any moment. No ROS, no clock.

`plan_run` joins an excitation to where the arm is; `Run.check` refuses what would leave a limit; `Brake`
brings the arm to rest from any moment of a run without leaving its path.

Braking is a time scaling q(s(t)) with s' = v falling from 1 to 0. Then q' = q_s v and q'' = q_ss v² + q_s u,
u = s'': positions and velocities are those of the path, or less, and the acceleration limit a bounds u from
below by −(a + sign(q_s) q_ss v²)/|q_s| (Bobrow, Dubowsky and Gibson 1985, eq. 9). u = 0 always keeps it, since
|q_ss| v² ≤ a v²: so taking, at each step, the hardest braking allowed never ends in a place without a way out,
and needs no look-ahead. u changes smoothly (`_JERK`), but gives way at once where the limit comes near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..errors import UserError
from .segments import still
from .trajectory import FourierTrajectory, Motion, MotionLimits, Quintic, Trajectory

State = Literal["approach", "running", "returning", "stopping", "done"]

LONGEST_RUN_S = 3600.0
_BLOCK_S = 30.0
_ROUNDING = 1e-9
_UNBOUNDED = 1e4
"""Stands for "no limit" in rad (rad/s, rad/s²): finite, so that the middle of a range exists."""
_MARGIN = 0.98
"""Share of the acceleration limit braking uses: the path bends within a step."""
_JERK = 20.0
"""Fastest growth of braking, 1/s³: from full speed to rest takes 0.45 s where no limit is in the way."""


class Phase(NamedTuple):
    """Where a run is: its state, and while running the period (1 … `Run.periods`; 0 otherwise)."""

    state: State
    period: int


@dataclass(frozen=True, eq=False)
class Run:
    """A whole run, from rest where the arm was, back to rest there.

    Attributes:
        trajectory: All of it.
        periodic: Start and end of the periodic part, s from the start of the run. Of an excitation without
            Fourier segments, the excitation's.
        periods: Periods in the periodic part (1 where there are no Fourier segments).
    """

    trajectory: Trajectory
    periodic: tuple[float, float]
    periods: int

    @property
    def duration_s(self) -> float:
        """Length of the whole run, s."""
        return self.trajectory.duration_s

    def phase(self, time_s: float) -> Phase:
        """Where the run is at `time_s` from its start."""
        start, end = self.periodic
        if time_s < start:
            return Phase("approach", 0)
        if time_s < end:
            share = (time_s - start) / (end - start)
            return Phase("running", min(int(share * self.periods), self.periods - 1) + 1)
        return Phase("returning" if time_s < self.duration_s else "done", 0)

    def set_points(self, rate_hz: float) -> Motion:
        """The run at `rate_hz`, from its start to its end inclusive, (T, n) each."""
        times = np.arange(int(np.floor(self.duration_s * rate_hz)) + 2) / rate_hz
        blocks = np.array_split(times, max(1, round(self.duration_s / _BLOCK_S)))
        parts = [self.trajectory.evaluate(block) for block in blocks]
        return Motion(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def limits_of(arm: Arm, joints: Sequence[str]) -> MotionLimits:
    """An arm's motion limits, in the order of `joints`.

    Args:
        arm: States limits by joint.
        joints: Names of some or all of its joints, in the order of a trajectory.

    Returns:
        Limits clipped to ±1e4 in SI units, so that they are finite where the arm states none; jerk is not limited.

    Raises:
        UserError: A joint is not the arm's.
    """
    by_name = {joint.name: joint for joint in arm.joints}
    unknown = [name for name in joints if name not in by_name]
    if unknown:
        raise UserError(f"joint {unknown[0]!r} is not in the arm description; its joints are {', '.join(by_name)}")
    chosen = [by_name[name] for name in joints]
    rows = np.array([(j.lower, j.upper, j.velocity_limit, j.acceleration_limit) for j in chosen])
    lower, upper, velocity, acceleration = np.clip(rows, -_UNBOUNDED, _UNBOUNDED).T
    return MotionLimits(lower, upper, velocity, acceleration)


def plan_run(excitation: Trajectory, limits: MotionLimits, start: FloatArray) -> Run:
    """Approach from rest at `start`, the excitation, and return there.

    Approach and return are quintics within the limits. An excitation that is one Fourier series alone, so
    begins in motion, is entered and left as `FourierTrajectory.run` does.

    Args:
        excitation: Motion of n joints.
        limits: (n,) each, in the order of `excitation.joints`.
        start: (n,) posture of rest before and after, rad.

    Raises:
        UserError: `start` is outside the position limits, or cannot be joined to the excitation within them, or the
            run would take longer than `LONGEST_RUN_S`.
    """
    names = excitation.joints
    outside = np.flatnonzero((start < limits.lower) | (start > limits.upper))
    if outside.size:
        i = int(outside[0])
        raise UserError(
            f"{names[i]} is at {start[i]:.4f} rad, outside its limits "
            f"[{limits.lower[i]:.4f}, {limits.upper[i]:.4f}]; move it inside by hand or with the vendor's tool"
        )
    match excitation.segments:
        case (FourierTrajectory() as series,):
            whole = series.run(limits, start, rest_s=0.0)
        case segments:
            first = segments[0].evaluate(0.0).at(0)
            last = segments[-1].evaluate(segments[-1].duration_s).at(0)
            home = still(start)
            approach = Quintic.within(limits, home, first)
            whole = Trajectory(names, (approach, *segments, Quintic.within(limits, last, home)))
    if whole.duration_s > LONGEST_RUN_S:
        raise UserError(f"the run would take {whole.duration_s:.0f} s, over an hour; use fewer periods")
    return Run(whole, *_periodic_part(whole))


def _periodic_part(whole: Trajectory) -> tuple[tuple[float, float], int]:
    starts = whole.starts_s()
    series = [(k, s) for k, s in enumerate(whole.segments) if isinstance(s, FourierTrajectory)]
    if not series:
        return (float(starts[1]), float(starts[-1])), 1
    end = float(starts[series[-1][0]]) + series[-1][1].duration_s
    return (float(starts[series[0][0]]), end), sum(s.periods for _, s in series)


def check_limits(joints: Sequence[str], motion: Motion, limits: MotionLimits, rate_hz: float) -> None:
    """Refuse set-points that are not finite or leave a limit, with joint, place and figures.

    Args:
        joints: Names of the n joints.
        motion: (T, n) each, from the start of the run.
        limits: (n,) each; the jerk is not checked.
        rate_hz: Rate of the set-points, Hz.

    Raises:
        UserError: They do.
    """
    for values, low, high, unit in (
        (motion.q, limits.lower, limits.upper, "rad"),
        (motion.qd, -limits.velocity, limits.velocity, "rad/s"),
        (motion.qdd, -limits.acceleration, limits.acceleration, "rad/s²"),
    ):
        slack = _ROUNDING * np.maximum(np.abs(low), np.abs(high))
        kept = (values >= low - slack) & (values <= high + slack)  # false for NaN
        if not kept.all():
            row, joint = (int(k) for k in np.unravel_index(int(np.argmin(kept)), kept.shape))
            raise UserError(
                f"the run leaves the limits: {joints[joint]} at {values[row, joint]:.4g} {unit}, {row / rate_hz:.2f} s "
                f"after the start, where [{low[joint]:.4g}, {high[joint]:.4g}] is allowed; "
                "use a trajectory optimised for this arm"
            )


class Brake:
    """Brings a run to rest along its own path.

    Attributes:
        path_s: Place on the path, s of the undisturbed run.
        speed: v, share of the undisturbed speed: 1 at first, 0 at rest.
    """

    def __init__(self, trajectory: Trajectory, limits: MotionLimits, at_s: float) -> None:
        """Begin to brake `at_s` after the start of `trajectory`, which keeps `limits`."""
        self.path_s = at_s
        self.speed = 1.0
        self._u = 0.0
        self._trajectory = trajectory
        self._acceleration = limits.acceleration

    @property
    def at_rest(self) -> bool:
        """Whether the arm has come to rest."""
        return self.speed <= 0.0

    def step(self, dt: float) -> Motion:
        """The next set-point, `dt` seconds after the last; three (n,) arrays."""
        if not self.at_rest:
            self.path_s += self.speed * dt + self._u * dt**2 / 2
            self.speed = max(0.0, self.speed + self._u * dt)
        path = self._trajectory.evaluate(self.path_s).at(0)
        if self.at_rest:
            return Motion(path.q, np.zeros_like(path.q), np.zeros_like(path.q))
        # Softly into the braking, softly out of it (√(2 J v) is what a constant jerk J can still undo).
        wanted = max(self._u - _JERK * dt, -np.sqrt(2.0 * _JERK * self.speed))
        self._u = min(0.0, max(wanted, self._hardest(path)))
        v = self.speed
        return Motion(path.q, path.qd * v, path.qdd * v**2 + path.qd * self._u)

    def _hardest(self, path: Motion) -> float:
        """The lower bound of u that every joint's acceleration limit leaves."""
        moving = np.abs(path.qd) > 1e-9
        bent = np.sign(path.qd) * path.qdd * self.speed**2
        bounds = -(_MARGIN * self._acceleration + bent)[moving] / np.abs(path.qd[moving])
        return float(bounds.max(initial=-np.inf))
