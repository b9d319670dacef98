"""Write bags as rosbag2 Jazzy does: MCAP with CRCs and index, profile `ros2`, CDR payloads.

`RecordingWriter` takes raw CDR bytes on any topic and knows nothing of what they mean; `write_recording`
turns a `Recording` into such bytes. A path ending in `.mcap` is one file, which appears under its name only
when it is complete; any other path is a rosbag2 folder, whose `metadata.yaml` is written last (a folder
without one was not closed, and still reads).
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import yaml
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from spacearm_ident.arrays import FloatArray, IntArray
from spacearm_ident.documents import parse_yaml
from spacearm_ident.errors import UserError
from spacearm_ident.recording import bag, cdr, messages
from spacearm_ident.recording.mcap_reader import Channel, McapFile
from spacearm_ident.recording.messages import MessageType
from spacearm_ident.recording.qos import LATCHED, STREAMED, Qos, offered
from spacearm_ident.recording.recording import BaseSensor, Recording, Series

_NOTHING = 2**63 - 1


class RecordingWriter:
    """Context manager that writes raw messages into one MCAP file or one rosbag2 folder.

    Leaving it by an exception removes the unfinished single file, and leaves a folder without `metadata.yaml`, or none
    where no message is in it.

    Args:
        path: `NAME.mcap` for one file (an existing one is replaced), otherwise a new folder.
        remedy: What a user can do where the place cannot be written, for the error message.

    Attributes:
        kept: Messages in the file, known once the writer was left: after a failed write fewer than were written.

    Raises:
        UserError: The folder exists, or not even the file's header can be written; nothing is left then.
    """

    def __init__(self, path: str | Path, *, remedy: str = "name another place") -> None:
        self.path = Path(path)
        self.kept = 0
        self._remedy = remedy
        self._single = self.path.suffix == ".mcap"
        self._file = self.path if self._single else self.path / f"{self.path.name}_0.mcap"
        self._open = self.path.with_name(f".{self.path.name}.part") if self._single else self._file
        if not self._single and self.path.exists():
            raise UserError(f"{path}: exists already; remove it or name another")
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._topics: dict[int, dict[str, Any]] = {}
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = _NOTHING, 0
        self._synced = 0  # bytes
        with ExitStack() as undo, self._disk():
            undo.callback(self._remove)
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._open.open("wb")
            undo.callback(self._close_stream)
            self._mcap = Writer(self._stream, compression=CompressionType.ZSTD)
            self._mcap.start(profile="ros2", library="spacearm_ident")
            # A full disk lets files be made: only what was synced shows that there is room.
            self.flush()
            undo.pop_all()

    def add_topic(
        self, topic: str, kind: MessageType, publishers: Sequence[Qos] = (STREAMED,), *, described: bool = True
    ) -> int:
        """Declare a topic of CDR messages; returns the number to `write` with.

        Args:
            topic: Full topic name.
            kind: Its message type, with the definition text.
            publishers: What each of its publishers offers.
            described: Whether `kind.text` is the type's definition; otherwise the bag names the type only.
        """
        metadata = {"offered_qos_profiles": offered(publishers), "topic_type_hash": kind.type_hash}
        encoding, text = ("ros2msg", kind.text.encode()) if described else ("", b"")
        return self.add_channel(Channel(topic, kind.name, encoding, text, "cdr", metadata))

    def add_channel(self, channel: Channel) -> int:
        """Declare a channel just as another bag has it; returns the number to `write` with."""
        key = (channel.type_name, channel.schema_encoding, channel.schema)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(*key) if channel.type_name else 0
        number = self._mcap.register_channel(
            channel.topic, channel.message_encoding, self._schemas[key], channel.metadata
        )
        self._counts[number] = 0
        self._topics[number] = {
            "name": channel.topic,
            "type": channel.type_name,
            "serialization_format": channel.message_encoding,
            "offered_qos_profiles": _loaded(channel.metadata.get("offered_qos_profiles", "")),
            "type_description_hash": channel.metadata.get("topic_type_hash", ""),
        }
        return number

    def write(self, channel: int, log_time_ns: int, payload: bytes, publish_time_ns: int | None = None) -> None:
        """Append one message.

        Args:
            channel: Number from `add_topic` or `add_channel`.
            log_time_ns: When it was received, nanoseconds since 1970.
            payload: Serialised message (CDR with its encapsulation header).
            publish_time_ns: When it was sent; `log_time_ns` if not known.
        """
        sent = log_time_ns if publish_time_ns is None else publish_time_ns
        with self._disk():
            self._mcap.add_message(channel, log_time_ns, payload, sent, self._counts[channel])
        self._counts[channel] += 1
        self._first_ns = min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)

    def note(self, name: str, entries: dict[str, str]) -> None:
        """Add an MCAP metadata record."""
        with self._disk():
            self._mcap.add_metadata(name, entries)

    def flush(self) -> None:
        """Put what was written so far on the disk, where it survives a power cut; waits for the disk."""
        with self._disk():
            self._mcap.flush()
            self._sync()

    def close(self) -> None:
        """Finish the file: index, end mark, name or `metadata.yaml`."""
        with self._disk():
            self._mcap.finish()
            self._stream.flush()
            self._sync()
            self._stream.close()
            if self._single:
                self._open.replace(self._file)
            else:
                part = self.path / "metadata.yaml.part"
                part.write_text(yaml.safe_dump(self._metadata(), sort_keys=False), encoding="utf-8")
                part.replace(self.path / "metadata.yaml")

    def _sync(self) -> None:
        os.fsync(self._stream.fileno())
        self._synced, self.kept = self._stream.tell(), self._written

    @property
    def _written(self) -> int:
        return sum(self._counts.values())

    def _metadata(self) -> dict[str, Any]:
        count = self._written
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first_ns if count else 0},
            "duration": {"nanoseconds": self._last_ns - self._first_ns if count else 0},
            "message_count": count,
        }
        topics = [
            {"topic_metadata": topic, "message_count": self._counts[number]} for number, topic in self._topics.items()
        ]
        return {
            "rosbag2_bagfile_information": {
                "version": 9,
                "storage_identifier": "mcap",
                **span,
                "topics_with_message_count": topics,
                "compression_format": "",
                "compression_mode": "",
                "relative_file_paths": [self._file.name],
                "files": [{"path": self._file.name, **span}],
                "custom_data": None,
                "ros_distro": "jazzy",
            }
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            try:
                self.close()
            except BaseException:
                self._discard()
                raise
        else:
            self._discard()

    def _discard(self) -> None:
        self._close_stream()
        with suppress(OSError):
            self.kept += self._complete_after_sync()
        if self._single or not self.kept:
            self._remove()

    def _complete_after_sync(self) -> int:
        """Messages that a reader finds in what a failed write left behind the last sync."""
        with self._open.open("rb") as stream:
            stream.seek(self._synced)
            rest = McapFile(MCAP0_MAGIC + stream.read(), lambda _: False)
        deque(rest.messages(), maxlen=0)
        return rest.seen

    def _close_stream(self) -> None:
        with suppress(OSError):
            self._stream.close()

    def _remove(self) -> None:
        with suppress(OSError):
            self._open.unlink(missing_ok=True)
            if not self._single:
                self.path.rmdir()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turns what the disk says into a line for the user."""
        try:
            yield
        except OSError as error:
            raise UserError(f"{self.path}: cannot be written ({error.strerror}); {self._remedy}") from error


def _loaded(qos: str) -> list[dict[str, Any]]:
    """A channel's QoS as a list; what cannot be understood is an unknown QoS."""
    try:
        loaded = parse_yaml(qos, "the QoS")
    except UserError:
        return []
    return loaded if isinstance(loaded, list) else []


Row = tuple[int, int, bytes]  # log time, channel, payload


def write_recording(path: str | Path, recording: Recording, origin: Sequence[str] = ()) -> None:
    """Write a `Recording` as a bag; read back, its arrays are the same numbers.

    Args:
        path: `NAME.mcap` for one file (replaced if there), otherwise a new rosbag2 folder.
        recording: What to write. Log times equal the header stamps.
        origin: How it was made, a line each: kept in the file as MCAP metadata `origin`.

    Raises:
        UserError: The place cannot be written, or the folder exists.
    """
    with RecordingWriter(path) as writer:
        rows: list[Row] = []
        if origin:
            writer.note("origin", {str(number): line for number, line in enumerate(origin)})
        if recording.urdf is not None:
            channel = writer.add_topic(messages.DESCRIPTION_TOPIC, messages.STRING, [LATCHED])
            rows.append((recording.start_ns, channel, cdr.encode_string(recording.urdf)))
        channel = writer.add_topic(messages.STATES_TOPIC, messages.JOINT_STATE)
        stamps = _stamps_ns(recording, recording.time)
        payloads = cdr.encode_joint_states(
            stamps, recording.joints, recording.position, recording.velocity, recording.effort
        )
        rows += zip(stamps.tolist(), [channel] * len(payloads), payloads, strict=True)
        if recording.command is not None:
            channel = writer.add_topic(messages.COMMAND_TOPIC, messages.JOINT_STATE)
            stamps = _stamps_ns(recording, recording.command.time)
            payloads = cdr.encode_joint_states(stamps, recording.joints, recording.command.values)
            rows += zip(stamps.tolist(), [channel] * len(payloads), payloads, strict=True)
        if recording.temperatures:
            channel = writer.add_topic(messages.TEMPERATURES_TOPIC, messages.TEMPERATURE)
            for joint, series in recording.temperatures.items():
                rows += _temperature_rows(recording, channel, joint, series)
        if recording.base is not None:
            kind = messages.TOPIC_TYPES[recording.base.topic]
            rows += _base_rows(recording, writer.add_topic(recording.base.topic, kind), recording.base)
        rows.sort(key=lambda row: row[0])
        for log_time, channel, payload in rows:
            writer.write(channel, log_time, payload)


def _stamps_ns(recording: Recording, time: FloatArray) -> IntArray:
    """Header stamps, ns since 1970, of times in seconds from the recording's start."""
    return recording.start_ns + np.rint(np.asarray(time) * 1e9).astype(np.int64)


def _temperature_rows(recording: Recording, channel: int, joint: str, series: Series) -> Iterator[Row]:
    for stamp, value in zip(_stamps_ns(recording, series.time).tolist(), series.values.tolist(), strict=True):
        yield stamp, channel, cdr.encode_temperature(stamp, joint, value)


def _base_rows(recording: Recording, channel: int, base: BaseSensor) -> Iterator[Row]:
    """What an IMU or an odometry does not know here is marked unknown, or zero."""
    stamps = _stamps_ns(recording, base.time).tolist()
    if base.force is not None:
        unknown = (0.0,) * 9
        for stamp, rate, force in zip(stamps, base.rate.tolist(), base.force.tolist(), strict=True):
            numbers = (0.0, 0.0, 0.0, 1.0, -1.0, *unknown[1:], *rate, *unknown, *force, *unknown)
            yield stamp, channel, cdr.encode_stamped(stamp, (base.frame,), numbers)
        return
    assert base.velocity is not None and base.attitude is not None
    twists = np.concatenate([base.velocity, base.rate], axis=1).tolist()
    nothing = (0.0,) * 36
    for stamp, attitude, twist in zip(stamps, base.attitude.tolist(), twists, strict=True):
        numbers = (0.0, 0.0, 0.0, *attitude, *nothing, *twist, *nothing)
        yield stamp, channel, cdr.encode_stamped(stamp, ("odom", base.frame), numbers)


def copy_messages(
    source: str | Path, writer: RecordingWriter, wanted: Callable[[Channel], bool] = lambda _: True
) -> int:
    """Copy raw messages of a bag, of known types or not; returns how many.

    Args:
        source: MCAP file or rosbag2 folder.
        writer: Where to.
        wanted: Which channels.

    Raises:
        UserError: The source cannot be read.
    """
    numbers: dict[tuple[str, str, bytes], int] = {}
    count = 0
    for message in bag.messages(source, wanted):
        channel = message.channel
        key = (channel.topic, channel.type_name, channel.schema)
        if key not in numbers:
            numbers[key] = writer.add_channel(channel)
        writer.write(numbers[key], message.log_time_ns, message.payload, message.publish_time_ns)
        count += 1
    return count
