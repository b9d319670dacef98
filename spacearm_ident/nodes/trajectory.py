"""`trajectory`: streams an excitation on `/joint_command`, from where the arm is and back there.

`/excitation/start` reads the file named by the parameter `trajectory_file` (which may be changed between
runs), checks everything there is to check, and streams approach, excitation and return; or refuses with the
reason. `/excitation/stop` brings the arm to rest along its path, within the limits, from any moment; so does
the node itself when feedback ceases or is not a number, when the drives are no longer enabled, and when it is
interrupted.

`/excitation/state` (std_msgs/msg/String, latched) is a JSON object, published at every change:

    state: idle, approach, running, returning, stopping or done
    run: id of the run, or null before the first
    period, periods: the period running, from 1 (0 outside), and how many there are
    t0_ns, t1_ns: header stamps, ns since 1970, between which the periodic part lies; planned at first, and cut
        to where braking began when the run was stopped (t0_ns = t1_ns: there is none)
    complete: whether the periodic part ran to its end; null until that is known
    reason: why it was stopped early; empty otherwise
"""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ..canbus.realtime import prepare_process
from ..config import config_path
from ..dynamics.arm import load_arm
from ..errors import UserError
from ..excitation.run import Run, check_limits, limits_of, plan_run
from ..excitation.trajectory import FloatArray, MotionLimits
from ..excitation.trajectory_file import load_trajectory
from ..recording import cdr
from .runtime import LATCHED, STREAM, Level, LiveNode, Newest, Status, local_name, run
from .set_point_stream import SetPointStream

_WATCH_S = 0.05
_STATUS_AGE_S = 3.0
_AT_REST = 0.05
"""An arm that stands may seem to move with this share of its velocity limit."""
_LONGEST_STOP_S = 15.0
_DRIVER = "canopen_driver"


class TrajectoryNode(LiveNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__("trajectory")
        self.parameter("trajectory_file", "", "excitation file to stream; read at every start", read_only=False)
        arm = self.parameter("arm", "", "URDF or arm YAML with the limits to keep; empty: config/paper_arm.yaml")
        self._rate_hz = self.parameter("rate_hz", 1000.0, "set-points a second, Hz", low=10.0, high=5000.0)
        self._require_enabled = self.parameter(
            "require_enabled", True, "refuse to start unless the driver's diagnostics say that the drives are enabled"
        )
        self._timeout_s = self.parameter(
            "feedback_timeout_s", 0.2, "stop when /joint_states is older than this, s", low=0.01, high=10.0
        )
        self._priority = self.parameter("realtime_priority", 60, "SCHED_FIFO; 0 for none", low=0, high=99)
        self._arm = load_arm(Path(arm).expanduser() if arm else config_path("paper_arm.yaml"))
        self.hardware_id = self._arm.name
        self._enabled: dict[str, tuple[bool, float]] = {}
        self._stream: SetPointStream | None = None
        self._run: Run | None = None
        self._run_id: str | None = None
        self._said: dict[str, object] = {}
        self._command = self.create_publisher(JointState, "joint_command", STREAM)
        self._state = self.create_publisher(String, "excitation/state", LATCHED)
        self._feedback = Newest(self, JointState, "joint_states")
        self.create_subscription(DiagnosticArray, "/diagnostics", self._keep_status, 100)
        self.offer("excitation/start", self.start)
        self.offer("excitation/stop", self.stop)
        self.create_timer(_WATCH_S, self._watch)
        self._announce()
        prepare_process()

    def _keep_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if _DRIVER in (local_name(status.name, self.get_namespace()) or ""):
                for pair in status.values:
                    if pair.key == "operation_enabled":
                        self._enabled[status.name] = (pair.value == "true", time.monotonic())

    def start(self) -> str:
        """Begin a run; returns the reply.

        Raises:
            UserError: It cannot begin, with the reason.
        """
        if self._stream is not None:
            if self._stream.moving:
                raise UserError(f"already {self._stream.phase.state}; stop first, or wait until the run is done")
            self._stream.wait(_LONGEST_STOP_S)
        gc.collect()  # prepare_process left that to us
        file = self.get_parameter("trajectory_file").value
        if not file:
            raise UserError("no trajectory: set the parameter trajectory_file to an excitation file, then start")
        excitation = load_trajectory(Path(file).expanduser())
        limits = limits_of(self._arm, excitation.joints)
        position = self._standing_at(excitation.joints, limits)
        if self._require_enabled and self._drives_enabled() is not True:
            unknown = self._drives_enabled() is None
            raise UserError(
                f"the drives are {'not known to be' if unknown else 'not'} enabled; "
                f"call {self.resolve_service_name('driver/enable')} first"
                + (f" (no operation_enabled of {_DRIVER} on /diagnostics)" if unknown else "")
            )
        plan = plan_run(excitation, limits, position)
        motion = plan.set_points(self._rate_hz)
        check_limits(excitation.joints, motion, limits, self._rate_hz)
        self._run, self._run_id = plan, f"{datetime.now():%Y%m%d-%H%M%S-%f}"
        self._stream = SetPointStream(plan, motion, limits, self._rate_hz, self._command.publish, self._priority)
        self._announce()
        return f"run {self._run_id}: {plan.duration_s:.1f} s, {plan.periods} periods"

    def stop(self) -> str:
        """Stop the run smoothly; returns the reply.

        Raises:
            UserError: None is running.
        """
        if self._stream is None or not self._stream.moving:
            raise UserError("nothing is running")
        self._stream.stop("stopped by /excitation/stop")
        self._announce()
        return "stopping within the limits"

    def close(self) -> None:
        """Bring the arm to rest."""
        if self._stream is not None:
            if self._stream.moving:
                self._stream.stop("the trajectory node was ended")
                self._announce()
            self._stream.wait(_LONGEST_STOP_S)
            self._announce()

    def _standing_at(self, joints: Sequence[str], limits: MotionLimits) -> FloatArray:
        """Where the arm stands, in the order of `joints`.

        Raises:
            UserError: That is not known, or it does not stand.
        """
        payload, age = self._feedback.take()
        if payload is None or age > self._timeout_s:
            since = "there is none" if math.isinf(age) else f"the last is {age:.1f} s old"
            raise UserError(f"no feedback on /joint_states ({since}); start the driver")
        blocks, _ = cdr.decode_joint_states([payload])
        if not blocks or blocks[0].position is None:
            raise UserError("/joint_states carries no positions; check the driver")
        block = blocks[0]
        if set(block.names) != set(joints):
            raise UserError(f"the trajectory moves {', '.join(joints)}, but /joint_states has {', '.join(block.names)}")
        order = [block.names.index(name) for name in joints]
        position = blocks[0].position[0, order]
        velocity = np.zeros(len(order)) if block.velocity is None else block.velocity[0, order]
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise UserError("/joint_states is not a number; check the driver")
        fast = np.flatnonzero(np.abs(velocity) > _AT_REST * limits.velocity)
        if fast.size:
            raise UserError(f"{joints[fast[0]]} moves at {velocity[fast[0]]:.3f} rad/s; wait until the arm stands")
        return position

    def _drives_enabled(self) -> bool | None:
        """What the driver says; None if it has said nothing lately."""
        now = time.monotonic()
        fresh = [enabled for enabled, at in self._enabled.values() if now - at < _STATUS_AGE_S]
        return all(fresh) if fresh else None

    def _watch(self) -> None:
        """Stop a run that is no longer safe; tell of its progress."""
        if self._stream is not None and self._stream.moving:
            payload, age = self._feedback.take()
            if payload is None or age > self._timeout_s:
                self._stream.stop(f"feedback on /joint_states ceased {age:.2f} s ago")
            elif not _finite(payload):
                self._stream.stop("feedback on /joint_states is not a number")
            elif self._require_enabled and self._drives_enabled() is False:
                self._stream.stop("the drives are no longer enabled")
        self._announce()

    def _announce(self) -> None:
        """Publish the state where it has changed."""
        now = self._describe()
        if now != self._said:
            changed = now["state"] != self._said.get("state")
            self._said = now
            self._state.publish(String(data=json.dumps(now)))
            if changed:
                self.publish_diagnostics()

    def _describe(self) -> dict[str, object]:
        stream, plan = self._stream, self._run
        if stream is None or plan is None:
            empty: dict[str, object] = {"state": "idle", "run": None, "period": 0, "periods": 0}
            return empty | {"t0_ns": None, "t1_ns": None, "complete": None, "reason": ""}
        state, period = stream.phase
        begin, end = plan.periodic
        cut = stream.stopped_s
        whole = cut is None or cut >= end
        if cut is not None:
            begin, end = min(begin, cut), min(end, cut)
        over = state in ("returning", "done") or not whole
        return {
            "state": state,
            "run": self._run_id,
            "period": period,
            "periods": plan.periods,
            "t0_ns": stream.start_ns + round(begin * 1e9),
            "t1_ns": stream.start_ns + round(end * 1e9),
            "complete": whole if over else None,
            "reason": stream.reason,
        }

    def diagnose(self) -> Sequence[Status]:
        """The run's state and how well its set-points keep time."""
        described = self._describe()
        enabled = self._drives_enabled()
        values: dict[str, object] = {
            **described,
            "trajectory_file": self.get_parameter("trajectory_file").value,
            "rate_hz": self._rate_hz,
            "feedback_age_s": self._feedback.take()[1],
            "drives_enabled": "unknown" if enabled is None else enabled,
        }
        stream = self._stream
        if stream is None:
            return (Status(Level.OK, "idle", values),)
        values |= {"set_points": stream.set_points, "late": stream.late, "late_p99_s": stream.late_s}
        state, period, periods = described["state"], described["period"], described["periods"]
        message = f"running period {period} of {periods}" if state == "running" else str(state)
        if stream.reason:
            return (Status(Level.WARN, f"{message}: {stream.reason}", values),)
        if stream.late:
            return (Status(Level.WARN, f"{message}; {stream.late} set-points sent late", values),)
        return (Status(Level.OK, message + (f"; {stream.warning}" if stream.warning else ""), values),)


def _finite(payload: bytes) -> bool:
    """Whether all positions of a joint state are numbers."""
    blocks, _ = cdr.decode_joint_states([payload])
    return bool(blocks) and blocks[0].position is not None and bool(np.isfinite(blocks[0].position).all())


def main(arguments: Sequence[str]) -> int:
    """Run the node until it is stopped."""
    return run(TrajectoryNode, arguments)
