"""`recorder`: everything on the graph, into a rosbag2 folder (MCAP) that survives a killed process.

In a namespace it records the topics of that namespace alone, and `shared_topics`, which are the whole graph's. Names
are those of the graph, as rosbag2 keeps them: `/arm_1/joint_states`.

Services: `/recorder/start` and `/recorder/stop` (std_srvs/srv/Trigger); both replies name the folder. What
goes wrong while recording (disk full) is an ERROR in the log and on `/diagnostics`, and in the reply to stop; the node
stays alive, and can start anew.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from ..errors import UserError
from ..recording.background_writer import BackgroundWriter, Topic
from .graph_reader import GraphReader, Sink
from .runtime import Level, LiveNode, Status, require_folder, run
from .twin import TwinWatch

LOOK_S = 0.25
"""How often it is looked whether the recording goes on."""


class Recorder(LiveNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__("recorder")
        given = self.parameter("directory", ".", "folder the bags are put into; made if missing")
        self._directory = require_folder("directory", Path(given).expanduser())
        # Two recorders that are started in one folder name their bags by their arms.
        usual = "_".join([*filter(None, self.get_namespace().split("/")), "run"])
        self._prefix = self.parameter("prefix", usual, "first part of a bag's name; date and time follow")
        self._buffer_bytes = 2**20 * self.parameter(
            "buffer_mb", 64, "messages that may wait for the disk, MiB; more are dropped and counted", low=1, high=4096
        )
        self._shared = self.parameter(
            "shared_topics", ["/diagnostics"], "in a namespace: topics outside it that are recorded as well"
        )
        immediately = self.parameter("start_immediately", False, "record from the start, without being asked")
        if not self._prefix or "/" in self._prefix:
            raise UserError(f"parameter prefix: {self._prefix!r} is not the beginning of a file name")
        self._subscriber = self.unspun_node()
        self._writer: BackgroundWriter | None = None
        self._reader: GraphReader | None = None
        self._started = 0.0
        self._told_failure = False
        self._twin = TwinWatch(self)
        self._refusal = ""
        self.offer("recorder/start", self.start)
        self.offer("recorder/stop", self.stop)
        self.every(LOOK_S, self._watch)
        if immediately:
            self.start()

    def start(self) -> str:
        """Begin a new bag; returns the reply.

        Raises:
            UserError: One is being written already, or the place cannot be written.
        """
        if self._writer is not None and self._writer.failure is None:
            raise UserError(f"already recording to {self._writer.path}; stop first")
        self._watch()
        self._end()
        # `directory` cannot be changed while the node runs.
        remedy = (
            f"make room or permit writing there, then call {self.resolve_service_name('recorder/start')}; or start the "
            "recorder with another directory"
        )
        try:
            writer = BackgroundWriter(self._new_folder(), buffer_bytes=self._buffer_bytes, remedy=remedy)
        except UserError as error:
            self._refusal = str(error)
            self.publish_diagnostics()
            raise
        self._refusal, self._told_failure = "", False
        self._writer, self._reader = writer, GraphReader(self._subscriber, self._sink(writer), self._shared)
        self._started = time.monotonic()
        self.publish_diagnostics()
        return f"recording to {writer.path}"

    def _sink(self, writer: BackgroundWriter) -> Sink:
        """Where messages go: with the times they came at, or under `use_sim_time` that of the graph's clock then."""
        if not self.simulated_time:
            return writer.put
        clock = self.get_clock()

        def put(topic: Topic, _: int, payload: bytes, __: int) -> bool:
            now_ns = clock.now().nanoseconds
            return writer.put(topic, now_ns, payload, now_ns)

        return put

    def stop(self) -> str:
        """Finish the bag; returns the reply.

        Raises:
            UserError: None is being written, or writing it failed.
        """
        if self._writer is None or self._reader is None:
            raise UserError(self._refusal or "not recording; start first")
        level, sentence = self._finish(self._writer, self._reader)
        self.publish_diagnostics()
        if level is Level.ERROR:
            if not self._told_failure:
                self.log(level, sentence)
            raise UserError(sentence)
        return sentence

    def _finish(self, writer: BackgroundWriter, reader: GraphReader) -> tuple[Level, str]:
        """Finish the bag; how well it is, and what is in it."""
        seconds = time.monotonic() - self._started
        self._end()
        if (failure := _failure(writer, reader)) is not None:
            return Level.ERROR, failure
        lost = sum(count.lost for count in reader.counts.values())
        figures = f"{writer.messages} messages in {seconds:.1f} s, {lost} lost, {writer.dropped} dropped"
        return Level.WARN if lost or writer.dropped else Level.OK, f"wrote {writer.path}: {figures}"

    def _watch(self) -> None:
        """Say once that a recording has ended early."""
        if self._writer is None or self._reader is None or self._told_failure:
            return
        if (failure := _failure(self._writer, self._reader)) is not None:
            self._told_failure = True
            self.log(Level.ERROR, f"recording ended early: {failure}")
            self.publish_diagnostics()

    def readiness(self) -> str | None:
        """Where it records to."""
        if self._writer is not None:
            return f"recording to {self._writer.path}"
        start, place = self.resolve_service_name("recorder/start"), self._directory.absolute()
        return f"not recording; {start} begins a bag in {place}"

    def close(self) -> None:
        """Finish the bag."""
        if self._writer is not None and self._reader is not None:
            self.log(*self._finish(self._writer, self._reader))

    def _end(self) -> None:
        if self._reader is not None:
            self._reader.close()
        if self._writer is not None:
            self._writer.close()
        self._reader = self._writer = None

    def _new_folder(self) -> Path:
        name = f"{self._prefix}_{datetime.now():%Y_%m_%d-%H_%M_%S}"
        folder, number = self._directory / name, 2
        while folder.exists():
            folder, number = self._directory / f"{name}_{number}", number + 1
        return folder.absolute()

    def diagnose(self) -> Sequence[Status]:
        """State, buffer and losses; and each topic's counts."""
        writer, reader = self._writer, self._reader
        if writer is None or reader is None:
            if self._refusal:
                return (Status(Level.ERROR, self._refusal, {"recording": False}),)
            return (Status(Level.OK, "not recording", {"recording": False}),)
        counts = reader.counts.copy()
        lost = sum(count.lost for count in counts.values())
        failure = writer.failure or reader.failure
        values = {
            "recording": failure is None,
            "folder": writer.path,
            "messages": writer.messages,
            "buffer_fill": writer.fill,
            "dropped": writer.dropped,
            "lost": lost,
        }
        topics = {
            name: f"{count.received} received, {count.lost} lost, {count.dropped} dropped"
            for name, count in sorted(counts.items())
        }
        if failure is not None:
            level, message = Level.ERROR, f"recording ended early: {failure}"
        elif writer.dropped or lost:
            level, message = Level.WARN, f"recording; {lost} messages lost on the way, {writer.dropped} dropped here"
        elif reader.problems:
            level, message = Level.WARN, "recording; " + "; ".join(reader.problems)
        else:
            level, message = Level.OK, "recording"
        return (Status(level, message, values), Status(Level.OK, f"{len(topics)} topics", topics, part="topics"))


def _failure(writer: BackgroundWriter, reader: GraphReader) -> str | None:
    """Why a recording ended before it was asked to, what to do, and how much is in the bag; None where it did not."""
    if (failure := writer.failure or reader.failure) is None:
        return None
    held = f"{writer.messages} of the {writer.offered} messages that came are in it"
    if not writer.path.exists():
        held = f"none of the {writer.offered} messages that came could be written, and no bag is left"
    return f"{writer.path} is incomplete: {failure.removeprefix(f'{writer.path}: ')} ({held})"


def main(arguments: Sequence[str]) -> int:
    """Run the node until it is stopped."""
    return run(Recorder, arguments)
