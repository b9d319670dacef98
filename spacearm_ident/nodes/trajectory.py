"""`trajectory`: an excitation for the arm, from where it is and back there.

`/excitation/start` reads the file named by the parameter `trajectory_file` (which may be changed at any time,
for the next start), checks everything there is to check, and begins approach, excitation and return; or refuses
with the reason. `/excitation/stop` brings the arm to rest along its path, within the limits, from any moment; so does
the node itself when feedback ceases or is not a number, when the arm may no longer be moved
(`trajectory_interlock`) or does not follow, and when it is interrupted. How the run reaches the arm is the
parameter `output` (`trajectory_output`).

A run that the driver stopped because its machine was too busy is begun again, `restarts` times at most
(`trajectory_restart`): the trajectory that was started, whatever became of the parameter or of the file since.

`/excitation/state` (std_msgs/msg/String, latched) is a JSON object, published at every change:

    state: idle, approach, running, returning, stopping, recovering (about to begin again) or done
    run: id of the run, or null before the first; a run begun again has another
    begun_as: the id /excitation/start answered with, the same for all that it began again
    restarts: how often it was begun again
    period, periods: the period running, from 1 (0 outside), and how many there are
    t0_ns, t1_ns: header stamps, ns since 1970, between which the periodic part lies; planned at first, and cut
        to where braking began when the run was stopped (t0_ns = t1_ns: there is none)
    complete: whether the periodic part ran to its end; null until that is known
    reason: why it was stopped early; empty otherwise
"""

from __future__ import annotations

import gc
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_msgs.msg import String

from ..arrays import FloatArray
from ..canbus.realtime import prepare_process
from ..config import config_path
from ..dynamics.arm import load_arm
from ..dynamics.mimics import require_open_chain
from ..errors import UserError
from ..excitation.run import Run, check_limits, limits_of, plan_run
from ..excitation.trajectory_file import load_trajectory
from .main import RESTARTS
from .runtime import LATCHED, Level, LiveNode, Status, run
from .trajectory_choices import JOINT_COMMAND
from .trajectory_feedback import Feedback
from .trajectory_interlock import Interlock
from .trajectory_output import Output, Stream
from .trajectory_path import PathWatch
from .trajectory_restart import Restart, Started
from .twin import TwinWatch

_WATCH_S = 0.05
_AT_REST = 0.05
"""An arm that stands may seem to move with this share of its velocity limit."""
_LONGEST_STOP_S = 15.0
STOPPED, ENDED = "stopped by /excitation/stop", "the trajectory node was ended"
"""Reasons of stops that somebody asked for; any other is a fault."""
LONGEST_LAG_S = 1.0
"""A run the arm is further behind, s, is not at the pace it was planned with: the way of a message and a controller's
delay are a tenth of it, and on a machine with a load of 16 on two cores half of it was seen."""


class TrajectoryNode(LiveNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__("trajectory")
        self.file_parameter("trajectory_file", "excitation file to stream; read at every start", read_only=False)
        self._timeout_s = self.parameter(
            "feedback_timeout_s", 0.2, "stop when /joint_states is older than this, s", low=0.01, high=10.0
        )
        self._restarts = self.parameter(
            "restarts", RESTARTS, "how often a run is begun again that a busy machine broke off", low=0, high=100
        )
        self._tolerance = self.parameter(
            "path_tolerance",
            0.1,
            "stop where a joint is so far from the path, rad",
            low=1e-3,
            high=3.2,
        )
        self._longest_lag_s = self.parameter(
            "path_lag_s", LONGEST_LAG_S, "stop where the arm is so far behind the run, s", low=0.05, high=60.0
        )
        self._output = Output(self)
        self._interlock = Interlock(self)
        arm = self.file_parameter("arm", "URDF or arm YAML with the limits to keep; empty: config/paper_arm.yaml")
        self._arm = require_open_chain(load_arm(arm or config_path("paper_arm.yaml")))
        self.hardware_id = self._arm.name
        self._stream: Stream | None = None
        self._path: PathWatch | None = None
        self._slow: FloatArray = np.zeros(0)
        self._started: Started | None = None
        self._run: Run | None = None
        self._run_id: str | None = None
        self._begun_as: str | None = None
        self._again = 0
        self._restart: Restart | None = None
        self._may_restart = False
        self._in_the_end = ""
        self._said: dict[str, object] = {}
        self._state = self.create_publisher(String, "excitation/state", LATCHED)
        self._feedback = Feedback(self)
        self._twin = TwinWatch(self)
        self.offer("excitation/start", self.start)
        self.offer("excitation/stop", self.stop)
        self.add_on_set_parameters_callback(self._on_parameters)
        self.every(_WATCH_S, self._watch)
        self._announce()
        prepare_process()

    def start(self) -> str:
        """Begin a run; returns the reply.

        Raises:
            UserError: It cannot begin, with the reason.
        """
        if twin := self._twin.sentence:
            raise UserError(f"{twin}; two would move one arm")
        if self._restart is not None:
            raise UserError("about to begin the last run again; stop that first, or wait until it is done")
        if self._stream is not None:
            if self._stream.moving:
                raise UserError(f"already {self._stream.phase.state}; stop first, or wait until the run is done")
            self._stream.wait(_LONGEST_STOP_S)
        reply = self._begin(Started.read(self.get_parameter("trajectory_file").value))
        self._begun_as, self._again = self._run_id, 0
        self._announce()
        return reply

    def _begin(self, started: Started) -> str:
        """Plan and begin a run, from where the arm stands.

        Raises:
            UserError: It cannot begin, with the reason.
        """
        gc.collect()  # prepare_process left that to us
        excitation = started.excitation
        limits = limits_of(self._arm, excitation.joints)
        self._output.require(excitation.joints, self._arm.joint_names)
        self._feedback.follow(excitation.joints)
        self._slow = _AT_REST * limits.velocity
        position = self._feedback.standing(self._timeout_s, self._slow)
        self._interlock.require()
        plan = plan_run(excitation, limits, position)
        rate_hz = self._output.rate_hz
        motion = plan.set_points(rate_hz)
        check_limits(excitation.joints, motion, limits, rate_hz)
        self._started, self._run, self._run_id = started, plan, f"{datetime.now():%Y%m%d-%H%M%S-%f}"
        self._may_restart, self._in_the_end, self._path = False, "", None
        if self._output.kind != JOINT_COMMAND:  # our driver watches the tracking error itself, every cycle
            self._path = PathWatch(excitation.joints, motion, rate_hz, self._tolerance, self._longest_lag_s)
        self._stream = self._output.start(plan, motion, limits)
        return f"run {self._run_id}: {plan.duration_s:.1f} s, {plan.periods} periods"

    def stop(self) -> str:
        """Stop the run smoothly; returns the reply.

        Raises:
            UserError: None is running.
        """
        if self._restart is not None:
            self._give_up(STOPPED)
            return "not beginning again"
        if self._stream is None or not self._stream.moving:
            raise UserError("nothing is running")
        self._may_restart = False
        self._stream.stop(STOPPED)
        self._announce()
        return "stopping within the limits"

    def readiness(self) -> str | None:
        """What the next run would be."""
        file, start = self.get_parameter("trajectory_file").value, self.resolve_service_name("excitation/start")
        if not file:
            return f"no trajectory yet: set the parameter trajectory_file, then call {start}"
        path = Path(file).expanduser().absolute()
        if wrong := _unfit(path):
            return f"no trajectory yet, {start} would be refused: {wrong}"
        return f"{start} runs {path}"

    def _on_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Grant a change of the trajectory file, and say what is wrong with it: it is read at the next start."""
        start = self.resolve_service_name("excitation/start")
        for file in (str(each.value) for each in parameters if each.name == "trajectory_file"):
            if self._started is not None and self._describe()["state"] != "done":
                stays = f"run {self._run_id}, also where it is begun again, stays that of {self._started.file}"
                self.log(Level.OK, f"trajectory_file: {file or 'none'} is for the next {start}; {stays}")
            if file and (wrong := _unfit(Path(file).expanduser())):
                self.log(Level.WARN, f"trajectory_file: as it is now, a start would be refused: {wrong}")
        return SetParametersResult(successful=True)

    def close(self) -> None:
        """Bring the arm to rest."""
        stream, moving = self._stream, self._stream is not None and self._stream.moving
        if stream is not None and moving:
            stream.stop(ENDED)
        try:
            if self._restart is not None:
                self._give_up(ENDED)
            self._announce()
        finally:
            # Whatever became of the words: set-points that brake the arm still have to be published.
            if stream is not None:
                stream.wait(_LONGEST_STOP_S)
        if moving:
            self._confirm_rest()
        self._announce()

    def _confirm_rest(self) -> None:
        """Log an error if the arm is not at rest after the node's last stop, since this node no longer monitors it."""
        try:
            self._feedback.standing(self._timeout_s, self._slow)
        except UserError as error:
            sentence = f"run {self._run_id}: the arm is not known to have stopped"
            if self._feedback.published:
                self.log(Level.ERROR, f"{sentence}: {error}")
            else:
                # All nodes were ended together: the driver's own end brings the arm to rest.
                self.log(Level.WARN, f"{sentence} by this node: who published /joint_states has ended as well")

    def _watch(self) -> None:
        """Stop a run that is no longer safe, begin one again that may; tell of the progress."""
        self._interlock.look()
        stream = self._stream
        if stream is not None and self._restart is None:
            if stream.moving and stream.stopped_s is None and not stream.reason:
                self._check(stream)
            elif self._may_restart and stream.phase.state == "done":
                self._consider()
        if self._restart is not None:
            self._go_on(self._restart)
        self._announce()

    def _check(self, stream: Stream) -> None:
        """Stop a run that is no longer safe."""
        age = self._feedback.age_s
        position = self._feedback.position()
        if position is None or age > self._timeout_s:
            self._may_restart = self._interlock.of_driver
            stream.stop(f"feedback on /joint_states ceased {age:.2f} s ago")
        elif not np.isfinite(position).all():
            stream.stop("feedback on /joint_states is not a number")
        elif loss := self._interlock.loss():
            self._may_restart = self._interlock.of_driver
            stream.stop(loss)
        elif self._path is not None:
            # Where the arm was when that was heard, beside where it should have been then.
            wrong = self._path.judge(position, stream.time_s - age)
            stream.lag_s = self._path.lag_s
            if wrong:
                stream.stop(wrong)

    def _consider(self) -> None:
        """With the arm at rest after a stop, ask the driver if the run may begin again, at most `restarts` times."""
        assert self._stream is not None
        self._may_restart = False
        if self._whole or self._started is None:
            return
        if self._again >= self._restarts:
            self._in_the_end = f"begun again {self._again} times, then given up" if self._restarts else ""
            return
        self.log(
            Level.WARN,
            f"run {self._run_id} was stopped: {self._stream.reason}; the driver is asked whether to "
            f"begin again, {self._again + 1} of {self._restarts} times",
        )
        self._restart = Restart(self, partial(self._begin, self._started))

    def _go_on(self, restart: Restart) -> None:
        try:
            if restart.step():
                self._again += 1
                self._restart = None
                restart.close()
        except UserError as error:
            self._give_up(f"not begun again: {error}")

    def _give_up(self, reason: str) -> None:
        """Begin nothing again, and say why."""
        assert self._restart is not None
        self._restart.close()
        self._restart, self._in_the_end = None, reason
        self.log(Level.ERROR, f"run {self._run_id}: {self._reason}")
        self._announce()

    @property
    def _whole(self) -> bool:
        """Whether the periodic part of the last run has not been cut short so far."""
        cut = self._stream.stopped_s if self._stream is not None else None
        return cut is None or (self._run is not None and cut >= self._run.periodic[1])

    @property
    def _reason(self) -> str:
        """Why the last run was stopped early, and what came of it."""
        reason = self._stream.reason if self._stream is not None else ""
        return "; ".join(filter(None, (reason, self._in_the_end)))

    def _announce(self) -> None:
        """Publish the state where it has changed."""
        now = self._describe()
        if now != self._said:
            changed = now["state"] != self._said.get("state")
            self._log(self._said, now)
            self._said = now
            self._state.publish(String(data=json.dumps(now)))
            if changed:
                self.publish_diagnostics()

    def _log(self, before: Mapping[str, object], now: Mapping[str, object]) -> None:
        """Say in the log that a run begins, is being stopped and why, or is over."""
        name = f"run {now['run']}"
        fresh = now["run"] != before.get("run")
        if fresh and self._run is not None and self._started is not None:
            of = f"{self._run.periods} periods, of {self._started.file}"
            self.log(Level.OK, f"{name} begins: {self._run.duration_s:.1f} s, {of}")
        if now["reason"] and (fresh or not before["reason"]):
            level = Level.WARN if now["reason"] in (STOPPED, ENDED) else Level.ERROR
            self.log(level, f"{name} is being stopped: {now['reason']}")
        if now["state"] == "done" and (fresh or before["state"] != "done"):
            self.log(Level.OK, f"{name} is over: {'its periods are complete' if now['complete'] else 'stopped early'}")

    def _describe(self) -> dict[str, object]:
        stream, plan = self._stream, self._run
        if stream is None or plan is None:
            empty: dict[str, object] = {"state": "idle", "run": None, "period": 0, "periods": 0}
            empty |= {"begun_as": None, "restarts": 0}
            return empty | {"t0_ns": None, "t1_ns": None, "complete": None, "reason": ""}
        state, period = stream.phase
        begin, end = plan.periodic
        cut = stream.stopped_s
        whole = self._whole
        if cut is not None:
            begin, end = min(begin, cut), min(end, cut)
        over = state in ("returning", "done") or not whole
        # Whoever waits for the end of a run must not take this for it.
        to_come = self._restart is not None or (self._may_restart and not whole and self._again < self._restarts)
        return {
            "state": "recovering" if state == "done" and to_come else state,
            "run": self._run_id,
            "begun_as": self._begun_as,
            "restarts": self._again,
            "period": period,
            "periods": plan.periods,
            "t0_ns": stream.start_ns + round(begin * 1e9),
            "t1_ns": stream.start_ns + round(end * 1e9),
            "complete": whole if over else None,
            "reason": self._reason,
        }

    def diagnose(self) -> Sequence[Status]:
        """The run's state and how well its set-points keep time."""
        described = self._describe()
        enabled = self._interlock.enabled
        values: dict[str, object] = {
            **described,
            "trajectory_file": self.get_parameter("trajectory_file").value,
            "output": self._output.kind,
            "rate_hz": self._output.rate_hz,
            "feedback_age_s": self._feedback.age_s,
            "drives_enabled": "unknown" if enabled is None else enabled,
        }
        stream = self._stream
        if stream is None:
            return (Status(Level.OK, "idle", values),)
        values |= {"set_points": stream.set_points, "late": stream.late, "late_p99_s": stream.late_s}
        values |= {"lag_s": stream.lag_s}
        state, period, periods = described["state"], described["period"], described["periods"]
        message = f"running period {period} of {periods}" if state == "running" else str(state)
        if self._again:
            message += f"; begun again {self._again} of {self._restarts} times"
        if described["reason"]:
            return (Status(Level.WARN, f"{message}: {described['reason']}", values),)
        if stream.late:
            return (Status(Level.WARN, f"{message}; {stream.late} set-points sent late", values),)
        return (Status(Level.OK, message + (f"; {stream.warning}" if stream.warning else ""), values),)


def _unfit(path: Path) -> str:
    """Why a trajectory file cannot be run as it is now; empty where it can."""
    try:
        load_trajectory(path)
    except UserError as error:
        return str(error)
    return ""


def main(arguments: Sequence[str]) -> int:
    """Run the node until it is stopped."""
    return run(TrajectoryNode, arguments)
