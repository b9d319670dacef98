"""The safety policy: what makes the driver stop the arm. Pure: arrays in, a `Fault` or None out.

Two judges. `MotionMonitor` looks at what the arm does, every cycle; `judge_step` at what it is asked to do,
every set-point (see `set_points`). `fault_of` says which of the master's events are faults. A fault stops all
axes and is latched by the driver; the arm never leaves it without a person asking.

The arm's limits bind set-points strictly. What the arm does may exceed them by `Margins`, for measured
velocities are noisy, a joint that breaks away from static friction jerks, and a position may overshoot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, NamedTuple

import numpy as np

from spacearm_ident.arrays import BoolArray, FloatArray
from spacearm_ident.canbus.arm_bus import STANDSTILL
from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.dynamics.arm import Arm

#: Share by which set-points may exceed the limits: rounding of differences.
TOLERANCE: Final = 0.02
_POSITION_ROUNDING: Final = 1e-6


class Rule(Enum):
    """What was broken; the value is for people."""

    POSITION = "position limit"
    VELOCITY = "velocity limit"
    ACCELERATION = "acceleration limit"
    TORQUE = "torque limit"
    TRACKING = "tracking error"
    SET_POINT = "set-point refused"
    STARVATION = "set-points missing"
    DRIVE = "drive"
    BUS = "bus"
    HALT = "halt"


class Fault(NamedTuple):
    """Why the arm was stopped: the rule, and one line for a person."""

    rule: Rule
    message: str

    def __str__(self) -> str:
        return f"{self.rule.value}: {self.message}"


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of n joints, (n,) each, output side, SI; infinite where there is none.

    Attributes:
        joints: Names.
        lower: Smallest position, rad.
        upper: Largest position, rad.
        velocity: rad/s.
        acceleration: rad/s².
        torque: N·m.
        tracking: Largest distance of target and actual position, rad.
    """

    joints: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    tracking: FloatArray

    @classmethod
    def of_arm(cls, arm: Arm, tracking: FloatArray) -> Limits:
        """The limits an arm description states, with `tracking` (n,) rad."""

        def column(name: str) -> FloatArray:
            return np.array([getattr(joint, name) for joint in arm.joints], dtype=float)

        return cls(
            arm.joint_names,
            column("lower"),
            column("upper"),
            column("velocity_limit"),
            column("acceleration_limit"),
            column("effort_limit"),
            np.asarray(tracking, dtype=float),
        )

    def around(self, position: FloatArray) -> Limits:
        """Limits for an arm that starts at `position` (n,): outside of its limits it may move inwards only."""
        return replace(self, lower=np.minimum(self.lower, position), upper=np.maximum(self.upper, position))


def stands_outside(limits: Limits, position: FloatArray) -> str:
    """Which joint is outside of its position limits by more than an overshoot, for a person; empty if none is.

    Args:
        limits: Of the arm; by `tracking` a joint may exceed them, as in motion.
        position: (n,) rad.
    """
    outside = np.maximum(limits.lower - position, position - limits.upper) - limits.tracking
    joint = int(np.argmax(outside))
    if not outside[joint] > 0:
        return ""
    return (
        f"{limits.joints[joint]} stands at {position[joint]:.4g} rad, its limits are {limits.lower[joint]:.4g} to "
        f"{limits.upper[joint]:.4g}: if it does not, correct zero_counts (or direction, counts_per_turn) in the CAN "
        "YAML; if it does, move it back with the drive's own tool"
    )


@dataclass(frozen=True)
class Margins:
    """How far measured motion may exceed the limits, as multiples of them."""

    velocity: float = 1.2
    acceleration: float = 10.0
    torque: float = 1.0


def judge_step(limits: Limits, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> Fault | None:
    """Whether a set-point is within the limits.

    Args:
        limits: In force.
        position: (n,) rad asked for; NaN and infinities are refused.
        velocity: (n,) rad/s from the set-point before to this one.
        acceleration: (n,) rad/s², the change of that velocity.
    """
    if not np.isfinite(position).all():
        joint = int(np.argmin(np.isfinite(position)))
        return Fault(Rule.SET_POINT, f"{limits.joints[joint]} was asked to go to {position[joint]}")
    below, above = limits.lower - _POSITION_ROUNDING, limits.upper + _POSITION_ROUNDING
    if (position < below).any() or (position > above).any():
        joint = int(np.argmax(np.maximum(below - position, position - above)))
        return Fault(
            Rule.SET_POINT,
            f"{limits.joints[joint]} was asked to go to {position[joint]:.4g} rad, outside of "
            f"{limits.lower[joint]:.4g} to {limits.upper[joint]:.4g}",
        )
    for what, value, limit, unit in (
        ("move", velocity, limits.velocity, "rad/s"),
        ("accelerate", acceleration, limits.acceleration, "rad/s²"),
    ):
        joint = _worst(value, (1.0 + TOLERANCE) * limit)
        if joint >= 0:
            return Fault(
                Rule.SET_POINT,
                f"{limits.joints[joint]} was asked to {what} with {value[joint]:.4g} {unit}, the limit is "
                f"{limit[joint]:.4g}",
            )
    return None


class MotionMonitor:
    """Judges what the arm does, from the feedback of every cycle.

    Velocity and torque are means over `window` cycles, acceleration the change of velocity over twice as many:
    a single set-point that is late makes a drive jerk for a millisecond, which is no danger. A joint whose
    feedback is missing at either end of a window is not judged by it.
    """

    def __init__(self, limits: Limits, margins: Margins | None = None, window: int = 10) -> None:
        n = len(limits.joints)
        self.limits = limits
        self._margins = Margins() if margins is None else margins
        self._window = window
        self._length = 2 * window + 1
        self._time = np.full(self._length, np.nan)
        self._position = np.zeros((self._length, n))
        self._fresh = np.zeros((self._length, n), dtype=bool)
        self._torque = np.zeros((window, n))
        self._now = self._torque_now = 0
        self._nothing = np.zeros(n)
        self._velocity = self._acceleration = self._nothing

    def observe(self, time_s: float, position: FloatArray, torque: FloatArray, fresh: BoolArray) -> None:
        """Take in a cycle's feedback.

        Args:
            time_s: Of its SYNC, s.
            position: (n,) rad.
            torque: (n,) N·m.
            fresh: (n,) whether it is of this cycle.
        """
        now = self._now = (self._now + 1) % self._length
        self._time[now] = time_s
        self._position[now] = position
        self._fresh[now] = fresh
        self._torque_now = (self._torque_now + 1) % self._window
        self._torque[self._torque_now] = torque
        middle, oldest = (now - self._window) % self._length, (now + 1) % self._length
        known = self._fresh[now] & self._fresh[middle]
        self._velocity = self._slope(now, middle) * known
        before = self._slope(middle, oldest) * (known & self._fresh[oldest])
        span = 0.5 * (time_s - self._time[oldest])
        change = (self._velocity - before) * (known & self._fresh[oldest])
        self._acceleration = change / span if np.isfinite(span) and span > 0 else self._nothing

    @property
    def speed(self) -> FloatArray:
        """(n,) rad/s of every joint; NaN where its feedback is missing at an end of the window."""
        known = self._fresh[self._now] & self._fresh[(self._now - self._window) % self._length]
        return np.where(known, self._velocity, np.nan)

    @property
    def at_rest(self) -> bool:
        """Whether no joint that sends feedback moves."""
        return bool((np.abs(self._velocity) < STANDSTILL).all())

    def judge(self, target: FloatArray) -> Fault | None:
        """Whether what was observed last is within the limits; `target` (n,) rad is what the joints shall follow."""
        limits, margins = self.limits, self._margins
        fresh, position = self._fresh[self._now], self._position[self._now]
        for rule, value, limit, unit in (
            (Rule.TORQUE, self._torque.mean(axis=0), margins.torque * limits.torque, "N·m"),
            (Rule.TRACKING, target - position, limits.tracking, "rad"),
            (Rule.VELOCITY, self._velocity, margins.velocity * limits.velocity, "rad/s"),
            (Rule.ACCELERATION, self._acceleration, margins.acceleration * limits.acceleration, "rad/s²"),
        ):
            joint = _worst(value * fresh, limit)
            if joint >= 0:
                return Fault(
                    rule, f"{limits.joints[joint]} has {value[joint]:.4g} {unit}, allowed are {limit[joint]:.4g}"
                )
        outside = np.maximum(limits.lower - position, position - limits.upper) - limits.tracking
        joint = int(np.argmax(np.where(fresh, outside, -np.inf)))
        if fresh[joint] and outside[joint] > 0:
            return Fault(
                Rule.POSITION,
                f"{limits.joints[joint]} is at {position[joint]:.4g} rad, allowed are "
                f"{limits.lower[joint]:.4g} to {limits.upper[joint]:.4g}",
            )
        return None

    def _slope(self, last: int, first: int) -> FloatArray:
        span = self._time[last] - self._time[first]
        if not (np.isfinite(span) and span > 0):
            return self._nothing
        slope: FloatArray = (self._position[last] - self._position[first]) / span
        return slope


def fault_of(event: Event) -> Fault | None:
    """The fault an event of the master is, if it is one."""
    if event.kind is EventKind.EMERGENCY_OVER:
        return None
    of_bus = event.kind in (EventKind.BUS_ERROR, EventKind.OTHER_MASTER)
    return Fault(Rule.BUS if of_bus else Rule.DRIVE, event.message)


def _worst(value: FloatArray, limit: FloatArray) -> int:
    """The joint that exceeds its limit most, or is NaN; −1 if none does."""
    size = np.abs(value)
    # NaN fails the comparison.
    if (size <= limit).all():
        return -1
    return int(np.argmax(np.where(np.isnan(size), np.inf, size / limit)))
