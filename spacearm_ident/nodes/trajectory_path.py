"""A run as one message: the whole path to a JointTrajectoryController, which interpolates and keeps the time itself.

`points_of` samples a motion for it; `SentPath` sends a run, knows by the clock where the run should be, and stops it
by sending the way along its own path to rest. A message replaces what the controller has; its times count from when
it is received, so that the clocks of two machines need not agree.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..arrays import FloatArray
from ..excitation.joint_trajectory import PATH_RATE_HZ, SETTLE_S
from ..excitation.run import Brake, Phase, Run
from ..excitation.trajectory import Motion, MotionLimits

REPLACE_S = 0.2
"""Time between a stop's message and the point of the path it takes over at: a controller that leads from the measured
state bridges a tracking error e in it with an acceleration of 5.8 e/T², 1.4 rad/s² for 0.01 rad."""
FOLLOWED_S = 0.5
"""An arm is at rest so long after its path is: the delay of the message and of the controller."""
_BRAKE_STEP_S = 1e-3
"""Braking is computed in steps of this length (`run.Brake`), and sent at the rate of the path."""


def path_message(joints: Sequence[str], order: Sequence[str], times: FloatArray, motion: Motion) -> JointTrajectory:
    """A motion for a controller, to begin when it arrives.

    Args:
        joints: Order of the motion's columns.
        order: Order in the message, the same names.
        times: (T,) s from the start.
        motion: (T, n) each.
    """
    columns = [list(joints).index(name) for name in order]
    message = JointTrajectory(joint_names=list(order))
    rows = zip(times.tolist(), *(values[:, columns].tolist() for values in motion), strict=True)
    for time_s, q, qd, qdd in rows:
        nanoseconds = round(1e9 * time_s)
        since = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        message.points.append(
            JointTrajectoryPoint(positions=q, velocities=qd, accelerations=qdd, time_from_start=since)
        )
    return message


class SentPath:
    """One run given to a controller.

    Attributes:
        reason: Why it was stopped early; empty otherwise.
        warning: None: it has no thread that could be late.
        start_ns: When the run begins, ns of the graph's clock.
        lag_s: How far the arm is behind that, s; whoever sees the arm sets it.
        late: Set-points sent late: none.
        late_s: 0.
    """

    warning: str | None = None
    late = 0
    late_s = 0.0

    def __init__(
        self,
        run: Run,
        limits: MotionLimits,
        publish: Callable[[JointTrajectory], None],
        now_ns: Callable[[], int],
        *,
        order: Sequence[str] = (),
        rate_hz: float = PATH_RATE_HZ,
    ) -> None:
        """Send the whole path.

        Args:
            run: What to do.
            limits: Limits braking must keep.
            publish: Sends a message.
            now_ns: The graph's clock.
            order: The controller's joints; as in the run unless given.
            rate_hz: Points a second.
        """
        self.reason = ""
        self.lag_s = 0.0
        self._run, self._limits, self._publish, self._now_ns = run, limits, publish, now_ns
        self._order = tuple(order) or run.trajectory.joints
        self._rate_hz = rate_hz
        self.stopped_s: float | None = None
        self._rest_s = run.duration_s
        times = np.arange(math.ceil(run.duration_s * rate_hz) + 1) / rate_hz
        self.start_ns = now_ns() + round(1e9 * SETTLE_S)
        self._send(SETTLE_S + times, run.trajectory.evaluate(times))
        self.set_points = len(times)

    @property
    def time_s(self) -> float:
        """Time along the run, s from its start; negative before."""
        return 1e-9 * (self._now_ns() - self.start_ns)

    @property
    def moving(self) -> bool:
        """Whether the run, or its braking, goes on."""
        return self.time_s - self.lag_s < self._rest_s

    @property
    def phase(self) -> Phase:
        """Where the run should be."""
        if not self.moving:
            return Phase("done", 0)
        if self.stopped_s is not None:
            return Phase("stopping", 0)
        return self._run.phase(max(0.0, self.time_s))

    def stop(self, reason: str) -> None:
        """Send the way to rest along the path, within the limits. Only the first reason counts."""
        if self.stopped_s is not None or not self.moving:
            return
        self.reason = reason
        at_s = max(0.0, self.time_s - self.lag_s + REPLACE_S)
        self.stopped_s = min(at_s, self._run.duration_s)
        brake = Brake(self._run.trajectory, self._limits, self.stopped_s)
        states = [self._run.trajectory.evaluate(self.stopped_s).at(0)]
        every = max(1, round(1.0 / (self._rate_hz * _BRAKE_STEP_S)))
        while not brake.at_rest:
            for _ in range(every):
                state = brake.step(_BRAKE_STEP_S)
            states.append(state)
        times: FloatArray = every * _BRAKE_STEP_S * np.arange(len(states), dtype=float)
        self._rest_s = self.time_s - self.lag_s + REPLACE_S + float(times[-1])
        self._send(REPLACE_S + times, Motion(*(np.stack(values) for values in zip(*states, strict=True))))

    def wait(self, timeout_s: float) -> None:
        """Wait until the arm should be at rest; a process that ended before would take an undelivered stop with it."""
        # By this machine's clock: nobody may be there who moves that of the graph on.
        left_s = self._rest_s - (self.time_s - self.lag_s)
        if left_s > 0.0:
            time.sleep(min(left_s + FOLLOWED_S, timeout_s))

    def _send(self, times: FloatArray, motion: Motion) -> None:
        self._publish(path_message(self._run.trajectory.joints, self._order, times, motion))


class PathWatch:
    """Whether the arm follows: how far it is from the run, and how far behind it.

    Args:
        joints: Of the run.
        motion: Set-points of the run at `rate_hz`.
        rate_hz: Their rate.
        tolerance: Largest distance of a joint from the path, rad.
        longest_lag_s: Largest time it may be behind.
    """

    LEAD_S = 0.1
    """The arm may seem ahead of a clock that is read later."""
    ALIKE = 1e-6
    """Distances from the path, rad, that differ by less are the same place of it, a period apart: rounding."""

    def __init__(
        self, joints: Sequence[str], motion: Motion, rate_hz: float, tolerance: float, longest_lag_s: float
    ) -> None:
        self._joints, self._q, self._rate_hz = tuple(joints), motion.q, rate_hz
        self._tolerance, self._longest_lag_s = tolerance, longest_lag_s
        self.lag_s = 0.0

    def judge(self, position: FloatArray, time_s: float) -> str:
        """What is wrong with the arm at `position` (n,) rad, `time_s` from the start of the run; empty: nothing."""
        last = len(self._q) - 1
        first_s, last_s = time_s - 2.0 * self._longest_lag_s, time_s + self.LEAD_S
        first, end = (int(np.clip(t * self._rate_hz, 0, last)) for t in (first_s, last_s))
        apart = np.abs(self._q[first : end + 1] - position)
        # The latest of the nearest: where the path rests nothing lags, and a period before it was there as well.
        distance = apart.max(axis=1)
        nearest = int(np.flatnonzero(distance <= distance.min() + self.ALIKE)[-1])
        if distance[nearest] > self._tolerance:
            joint, far = self._astray(apart)
            return (
                f"the arm does not follow: {self._joints[joint]} is {far:.3f} rad from the path, "
                f"{self._tolerance:g} rad are allowed; see what the controller says"
            )
        self.lag_s = max(0.0, time_s - (first + nearest) / self._rate_hz) if time_s * self._rate_hz < last else 0.0
        if self.lag_s > self._longest_lag_s:
            return (
                f"the arm lags {self.lag_s:.2f} s behind the run, {self._longest_lag_s:g} s are allowed: "
                "is the robot's speed scaled down?"
            )
        return ""

    def _astray(self, apart: FloatArray) -> tuple[int, float]:
        """The joint without which the others follow best, and how far it is from the path where they are.

        Where all joints together are nearest the path, those that follow are as far from it as the one that does not:
        a lag that is shared among them makes up for half of its distance.

        Args:
            apart: (T, n) distance of each joint from each place of the path, rad.

        Returns:
            Index of the joint, and its distance, rad.
        """
        # Two places a set-point apart cannot be told apart by it; of what fits alike, the least lag is likeliest.
        alike = float(np.abs(np.diff(apart, axis=0)).max(initial=self.ALIKE))
        places = []
        for joint in range(apart.shape[1]):
            others = np.delete(apart, joint, axis=1).max(axis=1, initial=0.0)
            place = int(np.flatnonzero(others <= others.min() + self.ALIKE)[-1])
            places.append((float(others[place]), place))
        least = min(rest for rest, _ in places)
        place = max(place for rest, place in places if rest <= least + alike)
        joint = int(apart[place].argmax())
        return joint, float(apart[place, joint])
