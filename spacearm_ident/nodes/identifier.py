"""The identifier: buffers the arm's joint states, identifies when a run ends, then watches the residual.

`/excitation/state` (JSON of the trajectory node) says when a run begins and ends. The first run that ends well is
the excitation: the arm is identified from it, its parameters are published (latched) and the residual is live from
then on. Every later run, with other coefficients, validates that model and completes the result folder, where the
runs lie as bags, too. `/identifier/identify` starts over from all that is buffered, as `spacearm identify` would
from a bag of it: the last third is held out. With `mismatch_reference` every run is compared with the healthy arm as
well, as `spacearm mismatch` would; with `simulation`, with that simulation, layer by layer. The verdict is on
`/diagnostics`. All of it runs in a process of its own (`worker`).

With a model, the friction levels are followed on line (`tracking`) and published beside the identified ones; a jump is
a warning on `/diagnostics`, and with `mismatch_on_change` the stretch behind it is explained like a run. A run of an
arm that has changed is identified, but does not take the place of the model in use.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from ..dynamics.arm import arm_from_urdf, load_arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.model_file import load_model, save_model
from ..errors import UserError
from ..estimate.identified import Identified
from ..mismatch.finding import NO_MISMATCH, Explanation
from ..recording import cdr
from ..recording.intake import listing
from ..recording.messages import DESCRIPTION_TOPIC, STATES_TOPIC, TEMPERATURES_TOPIC
from .identifier_messages import (
    doubts_and_notes,
    layer_figures,
    mismatch_figures,
    parameter_statuses,
    parameters_message,
    torque_message,
    tracked_statuses,
    validation_figures,
)
from .identifier_settings import declare
from .jobs import WRITING, Compared, Done, IdentifyJob, Job, MismatchJob
from .joint_samples import EffortWatch
from .live_tracking import LiveTracking, sentence
from .message_buffer import Capture, MessageBuffer
from .offers import RawStream
from .publishers import PublisherWatch
from .residual_stream import ResidualStream
from .runtime import LATCHED, STREAM, Level, LiveNode, Status, relative, run
from .twin import TwinWatch
from .worker import Failed, Step, Worker

RATE_HZ = 1000.0
"""Rate up to which joint states are kept for `buffer_s`: of faster ones, as many messages, which bounds the memory."""
WATCH_S = 0.05
LOOK_S = 0.25
"""How often publishers are looked for: as often as the recorder does."""
STREAM_S = 0.2
"""Residual and tracking are computed in pieces of this length: shorter ones cost more."""
UNDER_WAY = frozenset({"approach", "running", "returning", "stopping"})
SHORTEST_S = 2.0
LONGEST_PENDING = 4
STARTING = "starting"
MISMATCH_FOLDER, CHANGE_FOLDER = "mismatch", "change"
"""Within the result folder."""
MODEL_FILE, KEPT_MODEL_FILE = "model.yaml", "model_before_change.yaml"
"""Within the result folder: what a result has, and the model in use where a result has taken the place of its file."""
LATEST_STATES = 100
"""So many of the messages since the last look are searched for an effort: of one in ten, ten have it."""
LATEST_TEMPERATURES = 100
"""So many messages before a model came hold a temperature of every joint."""


NOT_WRITTEN = "its recording was not written to the end: identify the recorder's bag, where there is one"


@dataclass(frozen=True)
class RunMark:
    """A run by its id and the times of arrival between which its data lie."""

    name: str
    start_ns: int
    stop_ns: int = 0


class Identifier(LiveNode):
    """Buffers, identifies, publishes parameters and residuals."""

    def __init__(self) -> None:
        super().__init__("identifier")
        self._settings = declare(self)
        self._new_job = partial(IdentifyJob, directory=self._settings.directory, options=self._settings.how)
        limit, span_ns = max(1, int(self._settings.buffer_s * RATE_HZ)), int(self._settings.buffer_s * 1e9)
        self._states = MessageBuffer(STATES_TOPIC, limit, span_ns)
        self._temperatures = MessageBuffer(TEMPERATURES_TOPIC, limit // 10, span_ns)
        self._description: Capture | None = None
        self._joints = () if self._settings.how.arm is None else load_arm(self._settings.how.arm).joint_names
        self._described: tuple[str, ...] = ()
        self._efforts = EffortWatch()
        self._looked, self._looked_at = 0, ""
        self._under_way: RunMark | None = None
        self._pending: deque[RunMark] = deque(maxlen=LONGEST_PENDING)
        self._worker: Worker | None = None
        self._job: Job | None = None
        self._step = Step(0.0, "")
        self._known: Identified | None = None
        self._fitted: tuple[Path, ...] = ()
        self._last = Status(Level.OK, "nothing identified yet", part="identification")
        self._to_explain: MismatchJob | None = None
        self._verdict = Status(Level.OK, "nothing compared yet", part="mismatch")
        self._model_file = self._settings.model
        self._model: IdentifiedModel | None = None
        self._statuses: list[DiagnosticStatus] = []
        self._stream: ResidualStream | None = None
        self._tracking: LiveTracking | None = None
        self._seen = self._seen_warm = 0
        self._parameters_out = self.create_publisher(DiagnosticArray, "identifier/parameters", LATCHED)
        self._residuals = self.create_publisher(JointState, "identifier/residuals", STREAM)
        self._predicted = self.create_publisher(JointState, "identifier/predicted", STREAM)
        self._twin = TwinWatch(self)
        self._subscribe()
        self.offer("identifier/identify", self._identify_buffer)
        self.every(WATCH_S, self._watch)
        self.every(LOOK_S, self._look)
        self.every(STREAM_S, self._go_on)
        if self._model_file:
            self._use(load_model(self._model_file), None)
        if self._settings.replay:
            self._start(self._new_job((self._settings.replay.bag,), self._settings.replay.validated))

    def _subscribe(self) -> None:
        # In no executor: a wake-up a message would cost three times what taking them by the fifty does.
        unspun = self.unspun_node()
        self._states_topic = self.resolve_topic_name(relative(STATES_TOPIC))
        self._several = PublisherWatch(self, self._states_topic)
        self._arriving = [
            (RawStream(unspun, kind, self.resolve_topic_name(relative(buffer.topic))), buffer)
            for kind, buffer in ((JointState, self._states), (Temperature, self._temperatures))
        ]
        self.create_subscription(String, relative(DESCRIPTION_TOPIC), self._on_description, LATCHED, raw=True)
        self.create_subscription(String, "excitation/state", self._on_excitation, LATCHED)

    def _take(self) -> None:
        """Joint states and temperatures that have arrived, with the time at which each did."""
        for stream, buffer in self._arriving:
            for payload, arrived_ns, number in stream.take():
                buffer.append(arrived_ns, payload)
                if buffer is self._states:
                    self._several.hear(payload, number)

    def _look(self) -> None:
        """Take the streams as they are published."""
        for stream, _ in self._arriving:
            if sentence := stream.look():
                self.get_logger().info(sentence)
        if self._several.look(self._joints):
            if self._several.sentence:
                self.get_logger().warning(self._several.sentence)
            self.publish_diagnostics()
        self._look_for_effort()

    def _look_for_effort(self) -> None:
        """Say as a run begins, or as a joint moves, not after it, that there is no effort to identify from."""
        stored, run = self._states.stored, self._under_way
        payloads = self._states.since(max(self._looked, stored - LATEST_STATES))
        if not payloads:
            return
        efforts, before = self._efforts, (self._efforts.absent, self._efforts.moving)
        begins = run is not None and run.name != self._looked_at
        if begins:
            efforts.forget()
        self._looked = stored
        efforts.look(payloads, self._joints or self._described)
        if run is not None and begins:
            self._looked_at = run.name
            if efforts.absent:
                self.get_logger().warning(f"run {run.name}: {self._no_effort}")
        if set(efforts.moving) - set(before[1]):
            self.get_logger().warning(self._effort_missing)
        if before != (efforts.absent, efforts.moving):
            self.publish_diagnostics()

    @property
    def _no_effort(self) -> str:
        return (
            f"{self._states_topic} carries no effort of {listing(self._efforts.absent)}: nothing can be "
            "identified from a run; have the driver publish effort (N m, or A with constants in the arm YAML)"
        )

    @property
    def _effort_missing(self) -> str:
        return (
            f"{self._states_topic} carries no effort of {listing(self._efforts.moving)}, which moves: a model of the "
            "other joints would be wrong; have the driver publish its effort, or hold it still"
        )

    def _on_description(self, payload: bytes) -> None:
        self._description = Capture.of_one(DESCRIPTION_TOPIC, time.time_ns(), payload)
        self._described = ()
        with suppress(cdr.CdrError, UserError):  # an identification says what is wrong with it
            self._described = arm_from_urdf(cdr.decode_string(payload)).joint_names

    def _on_excitation(self, message: String) -> None:
        """Mark where a run begins and ends; one that was stopped early is not used."""
        try:
            said = json.loads(message.data)
            state, name, complete = said["state"], str(said["run"]), said["complete"] is True
        except (ValueError, TypeError, KeyError, AttributeError):
            self.get_logger().warning(f"/excitation/state is not understood: {message.data[:80]!r}")
            return
        known = self._under_way
        if state in UNDER_WAY:
            if known is None or known.name != name:
                self._under_way = RunMark(name, time.time_ns())
            return
        self._under_way = None
        if known is None or state != "done" or known.name != name or not self._settings.auto:
            return
        if not complete:
            self.get_logger().info(f"run {name} was stopped early: not identified")
            return
        self._pending.append(RunMark(name, known.start_ns, time.time_ns()))

    def _watch(self) -> None:
        """Twenty times a second: what has arrived, news of the worker, the next run."""
        self._take()
        self._hear()
        if self._worker is not None:
            return
        if self._pending:
            self._start_run(self._pending.popleft())
        elif self._to_explain is not None:
            job, self._to_explain = self._to_explain, None
            self._start(job)
        elif self._tracking is not None and (stretch := self._tracking.to_explain()) is not None:
            self._explain_change(*stretch)

    def _start_run(self, mark: RunMark) -> None:
        """Identify from a finished run, or validate on it."""
        captures = self._captures(mark.start_ns, mark.stop_ns)
        if self._known is None:
            bag = self._settings.directory / "excitation.mcap"
            self._start(self._new_job((bag,), (bag,), captures=captures, bag=bag))
        else:
            bag = self._settings.directory / "validation.mcap"
            self._start(self._new_job(self._fitted, (bag,), captures=captures, bag=bag, known=self._known))

    def _identify_buffer(self) -> str:
        """The service."""
        self._take()
        if self._worker is not None:
            what = "an identification" if isinstance(self._job, IdentifyJob) else "an explanation"
            raise UserError(f"{what} is under way ({self._step.share:.0%}: {self._step.what}): wait for it to end")
        first, last = self._states.span_ns()
        span = (last - first) / 1e9
        if not len(self._states):
            raise UserError("no joint states have come: start the driver, or whatever publishes /joint_states")
        if self._settings.how.arm is None and self._description is None:
            raise UserError("no /robot_description has come: publish it, or give the parameter arm")
        count = len(self._states)
        if count < SHORTEST_S * 10:
            raise UserError(f"only {count} joint states are buffered: move the arm first")
        bag = self._settings.directory / "buffer.mcap"
        self._pending.clear()
        self._start(self._new_job((bag,), (), captures=self._captures(first, last), bag=bag))
        return f"identifying from {count} joint states that came within {span:.1f} s; the result goes to " + str(
            self._settings.directory
        )

    def _captures(self, start_ns: int, stop_ns: int) -> tuple[Capture, ...]:
        captures = [buffer.between(start_ns, stop_ns) for buffer in (self._states, self._temperatures)]
        if self._description is not None:
            captures.append(self._description)
        return tuple(capture for capture in captures if len(capture.times_ns))

    def _explain_change(self, start_ns: int, stop_ns: int) -> None:
        """Explain what came between two times of arrival, behind a change."""
        captures = self._captures(start_ns, stop_ns)
        if not any(capture.topic == STATES_TOPIC for capture in captures):
            self._leave_unexplained("the joint states behind it are no longer buffered: enlarge the parameter buffer_s")
            return
        bag, healthy = self._settings.directory / "change.mcap", self._settings.reference
        model = self._model_file
        assert model is not None
        how, folder = self._settings.how, self._settings.directory / CHANGE_FOLDER
        # The model in use knows its arm and gravity.
        place = (None, None) if healthy is None else (how.arm, how.gravity)
        self._start(MismatchJob((bag,), (), (healthy or model,), folder, *place, captures, bag))

    def _leave_unexplained(self, reason: str) -> None:
        """Say why a change will not be explained."""
        if not reason:
            return
        sentence = f"a change found by the tracking is not explained: {reason}"
        self._verdict = Status(Level.WARN, sentence, part="mismatch")
        self.get_logger().warning(sentence)

    def _start(self, job: Job) -> None:
        self._step = Step(0.0, STARTING)
        self._job = replace(job, captures=())
        self._worker = Worker(job)
        self.get_logger().info(f"{job.name}, as {job.command}")
        self.publish_diagnostics()

    def _hear(self) -> None:
        """What the worker says."""
        for event in self._worker.poll() if self._worker is not None else ():
            if isinstance(event, Step):
                self._step = event
                continue
            job, self._job, self._worker = self._job, None, None
            assert job is not None
            if isinstance(event, Failed):
                self._fail(job, event)
            elif isinstance(event, Compared) and isinstance(job, MismatchJob):
                self._report(job, event)
            elif isinstance(event, Done) and isinstance(job, IdentifyJob):
                self._finish(job, event)
            self.publish_diagnostics()
            replay = self._settings.replay
            if replay is not None and replay.exit_after and replay.bag in job.bags and not self._to_explain:
                self.exit_code = event.code if isinstance(event, Failed) else 0

    def _fail(self, job: Job, event: Failed) -> None:
        status = Status(Level.ERROR, event.reason, {"bags": _files(job.bags)}, job.name)
        if isinstance(job, IdentifyJob):
            self._last = status
        else:
            self._verdict = status
        self.get_logger().error(event.reason)

    def _finish(self, job: IdentifyJob, done: Done) -> None:
        """Publish a result and go on with its model."""
        session = done.session
        doubts, notes = doubts_and_notes(session)
        for line in doubts:
            self.get_logger().warning(line)
        for line in (*notes, *done.findings):
            self.get_logger().info(line)
        if job.known is None:
            # Runs of a fit with a hold-out are not validated further: the fit has not seen all of its bag.
            self._known, self._fitted = (session.identified, job.fitted) if job.holds_nothing_out else (None, ())
            self._adopt(job, session.identified)
        figures = {"report": session.page, "bags": _files(job.bags), **validation_figures(session.validation)}
        figures["model_in_use"] = self._model_file
        message = f"identified and validated {session.validation.what}"
        said = "; ".join([message, *doubts[:1]])
        self._last = Status(Level.WARN if doubts else Level.OK, said, figures, "identification")
        self.get_logger().info(f"{message}; report: {session.page}")
        if (against := self._settings.reference or self._settings.simulation) is not None:
            self._to_explain = MismatchJob(
                job.fitted,
                () if job.holds_nothing_out else job.validated,
                (against,),
                self._settings.directory / MISMATCH_FOLDER,
                self._settings.how.arm,
                self._settings.how.gravity,
                simulated=self._settings.reference is None,
            )

    def _report(self, job: MismatchJob, compared: Compared) -> None:
        """Publish a verdict."""
        outcome = compared.outcome
        said = mismatch_figures(outcome) if isinstance(outcome, Explanation) else layer_figures(outcome)
        against = "simulation" if job.simulated else "reference"
        figures = {"report": compared.page, "bags": _files(job.bags), against: _files(job.against)}
        level = Level.OK if said["verdict"] == NO_MISMATCH else Level.WARN
        self._verdict = Status(level, outcome.headline, {**figures, **said}, job.name)
        self.get_logger().info(f"{outcome.headline}; report: {compared.page}")

    def _adopt(self, job: IdentifyJob, identified: Identified) -> None:
        """Go on with the model that a job identified, unless a run did and a change was found since the present one.

        A model of the changed arm would make of the change what is healthy. Who asks for it by the service gets it.
        """
        new, old = job.directory / MODEL_FILE, self._model_file
        change = self._tracking.last_change if self._tracking is not None else None
        if old is None or change is None or not job.holds_nothing_out:
            self._model_file = new
            self._use(identified.model, identified)
            if old is not None:
                instead = "" if new.resolve() == old.resolve() else f", no longer those of {old}"
                self.get_logger().info(f"residual and tracking are those of the model now in {new}{instead}")
            return
        if new.resolve() == old.resolve():
            # The result has taken its place in the folder; a change is explained against it.
            assert self._model is not None
            self._model_file = old = job.directory / KEPT_MODEL_FILE
            save_model(self._model, old)
        self.get_logger().warning(
            f"the arm has changed since its model was made ({sentence(change)}): residual and tracking stay those of "
            f"{old}; {new} is the arm of this run. {self.resolve_service_name('identifier/identify')} identifies the "
            "arm as it is now, and goes on with that"
        )

    def _use(self, model: IdentifiedModel, identified: Identified | None) -> None:
        """Publish a model's parameters; from now on the residual is its, and what is followed begins at it."""
        self.hardware_id = model.model.arm.name
        self._statuses = parameter_statuses(self.hardware_id, model, identified)
        self._publish_parameters()
        self._stream = ResidualStream(model, self._settings.row_rate_hz)
        self._seen, self._seen_warm = self._states.stored, self._temperatures.stored - LATEST_TEMPERATURES
        self._model, before = model, self._tracking
        self._end_tracking("the model in use was replaced before there were enough joint states behind the change")
        choice, window_s = self._settings.tracking, self._settings.change_window_s
        self._tracking = None if choice is None else LiveTracking(model, choice, window_s, before)

    def _end_tracking(self, reason: str) -> None:
        if self._tracking is not None:
            self._tracking.stop(reason)
            self._leave_unexplained(self._tracking.given_up())

    def _publish_parameters(self, tracked: Sequence[DiagnosticStatus] = ()) -> None:
        now = self.get_clock().now().to_msg()
        self._parameters_out.publish(parameters_message(now, [*self._statuses, *tracked]))

    def _go_on(self) -> None:
        """Residual and tracking of what has arrived since."""
        if self._stream is None:
            return
        payloads = self._states.since(self._seen)
        self._seen = self._states.stored
        joints = self._stream.joints
        for row in self._stream.add(payloads):
            self._residuals.publish(torque_message(joints, row.stamp_ns, row.residual))
            self._predicted.publish(torque_message(joints, row.stamp_ns, row.predicted))
        if self._tracking is not None:
            self._track(self._tracking, payloads)

    def _track(self, tracking: LiveTracking, payloads: Sequence[bytes]) -> None:
        """Hand over what has arrived, say what was found in what had."""
        temperatures = self._temperatures.since(self._seen_warm)
        self._seen_warm = self._temperatures.stored
        tracking.feed(payloads, temperatures, self._states.span_ns()[1])
        found = tracking.poll()
        self._leave_unexplained(tracking.given_up())
        for change in found:
            self.get_logger().warning(sentence(change))
        if (state := tracking.due()) is not None:
            self._publish_parameters(tracked_statuses(self.hardware_id, state))
        if found:
            self.publish_diagnostics()

    def diagnose(self) -> Sequence[Status]:
        """The buffer, the last identification, the verdict, the residual, the tracking."""
        statuses = [self._buffer_status(), self._last]
        compares = self._settings.reference is not None or self._settings.simulation is not None
        if compares or self._settings.change_window_s is not None:
            statuses.append(self._verdict)
        if self._stream is not None:
            figures = self._stream.figures()
            message = "live" if figures else "waiting for joint states"
            statuses.append(Status(Level.OK, message, figures, "residual"))
        if self._tracking is not None:
            statuses.append(self._tracking.status())
        return statuses

    def _buffer_status(self) -> Status:
        buffer = self._states
        first, last = buffer.span_ns()
        level, message = Level.OK, "waiting for a run"
        if self._worker is not None:
            message = f"{self._job.name if self._job else ''}, {self._step.share:.0%}: {self._step.what}"
        elif self._under_way is not None:
            message = f"run {self._under_way.name} is under way"
        elif not buffer.stored:
            message = "no joint states have come yet"
        if self._efforts.absent:
            level, message = Level.WARN, f"{message}; {self._no_effort}"
        if self._efforts.moving:
            level, message = Level.WARN, f"{message}; {self._effort_missing}"
        if self._several.sentence:
            level, message = Level.WARN, f"{message}; {self._several.sentence}"
        if self._under_way is not None and buffer.dropped and first > self._under_way.start_ns:
            level = Level.WARN
            message += "; it is longer than the buffer, its beginning is lost: enlarge the parameter buffer_s"
        values = {
            "buffered_messages": len(buffer),
            "buffered_s": (last - first) / 1e9,
            "buffer_MB": buffer.bytes / 1e6,
            "received": buffer.stored,
            "dropped": buffer.dropped,
            "identifying": self._worker is not None,
            "progress": self._step.share if self._worker is not None else 0.0,
            "runs_waiting": len(self._pending),
        }
        return Status(level, message, values)

    def readiness(self) -> str | None:
        """Where results go."""
        return f"results go to {self._settings.directory.absolute()}"

    def close(self) -> None:
        """End the tracking, and the worker; what that was writing is discarded, and what was not done is said."""
        self._end_tracking("the node was ended before there were enough joint states behind the change")
        self._hear()
        if self._worker is not None:
            self._worker.stop()
            assert self._job is not None
            self._leave_undone(self._job)
        if self._to_explain is not None:
            self.log(Level.WARN, f"{self._to_explain.name} not begun: the node is ended; {_off_line(self._to_explain)}")
        for mark in self._pending:
            self.log(Level.WARN, f"run {mark.name} is not identified: the node is ended; {NOT_WRITTEN}")

    def _leave_undone(self, job: Job) -> None:
        """Say that a job was cut off, and what there is to do it off line from."""
        whole = job.bag is None or self._step.what not in (STARTING, WRITING)
        self.log(
            Level.WARN,
            f"{job.name} cut off at {self._step.share:.0%} ({self._step.what}), without a result: the node is ended; "
            + (_off_line(job) if whole else NOT_WRITTEN),
        )


def _off_line(job: Job) -> str:
    """How to do a job whose bags are whole without the node."""
    return f"its recordings are whole, off line it is {job.command}"


def _files(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths))


def main(arguments: Sequence[str]) -> int:
    """Run the node; returns its exit code."""
    return run(Identifier, arguments)
