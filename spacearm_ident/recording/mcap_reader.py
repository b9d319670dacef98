"""Read an MCAP file for salvage: every sound record, and an account of every defect.

The `mcap` library reads sound files; this module reads what a power cut or a bad disk left. It walks the
records from the front (MCAP specification 0, "Records") without needing an index; a summary section, where
it is intact, only contributes channel definitions (the chunk that held them may be lost) and the number of
messages there should be. A chunk is taken whole when its CRC agrees and left out whole when it does not. In
a chunk cut off by the end of the file the messages that are complete are taken. Where record framing is
broken, reading resumes at the next place that starts a chain of plausible records.

Memory is bounded by `MAX_CHUNK_BYTES` a chunk, whatever sizes the file announces, and time by the size of the file:
its chunks may hold `MAX_EXPANSION` times its bytes and no more.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import mcap.records
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK_BYTES = 256 * 2**20
"""Largest uncompressed chunk read; rosbag2 writes less than 1 MiB, other tools 4 MiB."""

MAX_EXPANSION = 256
"""Most bytes all chunks together may hold, as a multiple of the file's (beyond one full chunk)."""

MAX_DEFECTS = 1000
"""Defects kept one by one; what comes after only counts."""

Progress = Callable[[float], None]
"""Told the fraction done, 0 to 1."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
# Shortest body of each record type: what tells a record from zeros and noise when framing is lost.
_MIN_BODY: dict[int, int] = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
_ENDS = (Opcode.DATA_END, Opcode.FOOTER)
_RECORD_START = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\x00{4})")
_PARSE_ERRORS = (McapError, ValueError, struct.error)


@dataclass(frozen=True)
class Channel:
    """A topic as a bag declares it."""

    topic: str
    type_name: str
    schema_encoding: str
    schema: bytes
    message_encoding: str
    metadata: dict[str, str]


class Message(NamedTuple):
    """One raw message; times are nanoseconds of the recording computer's clock."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    payload: bytes


@dataclass(frozen=True)
class Defect:
    """Damage found in a file.

    Attributes:
        kind: As in `Issue`.
        text: What was found and what was done about it, with the place in the file.
        log_time_ns: Log time of the last sound message before it, None if there was none.
        count: How many places, or messages.
    """

    kind: str
    text: str
    log_time_ns: int | None = None
    count: int = 1


class _DamagedError(Exception):
    """A chunk that cannot be trusted; the text says why."""


def _decompress(compression: str, data: bytes, size: int) -> bytes:
    """At most `size` bytes of a chunk's records; less when `data` ends early."""
    try:
        if compression == "zstd":
            reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
            return bytes(reader.read(size))
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
        if compression == "":
            return data[:size]
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise _DamagedError(f"cannot be decompressed ({error})") from error
    raise _DamagedError(f"uses the unknown compression {compression!r}")


class McapFile:
    """One pass over one MCAP file.

    Args:
        data: The whole file (bytes or a memory map), starting with the MCAP magic.
        wanted: Which channels' messages to yield; the others are counted only.

    Attributes:
        channels: Channels met so far, by id.
        defects: Damage met so far.
        seen: Messages met so far, of any channel.
    """

    def __init__(self, data: bytes | mmap.mmap, wanted: Callable[[Channel], bool] = lambda _: True) -> None:
        self.data = data
        self.channels: dict[int, Channel] = {}
        self.defects: list[Defect] = []
        self.position = 0
        self._wanted = wanted
        self._yielded: dict[int, Channel | None] = {}
        self._schemas: dict[int, mcap.records.Schema] = {}
        self._settled = False
        self._expected: int | None = None
        self.seen = 0
        self._homeless = 0
        self._last_log_time: int | None = None
        self._room = MAX_CHUNK_BYTES + MAX_EXPANSION * len(data)
        self._beyond: dict[str, int] = {}

    def messages(self) -> Iterator[Message]:
        """All sound messages of wanted channels, in file order."""
        self._read_summary()
        data, size = self.data, len(self.data)
        self.position = len(MCAP0_MAGIC)
        closed = False
        while self.position + _HEAD.size <= size and not closed:
            start = self.position
            opcode, length = _HEAD.unpack_from(data, start)
            stop = self._record_end(start, opcode, length)
            if stop is None:
                if opcode == Opcode.CHUNK and self._own_end(start) == start + _HEAD.size + length:
                    yield from self._chunk(start, data[start + _HEAD.size :], cut=True)
                    break
                if (resumed := self._next_record(start + 1, size)) is None:
                    break
                self._report("corrupt_record", f"{resumed - start} unreadable bytes at byte {start}, skipped")
                self.position = resumed
                continue
            self.position = stop
            if opcode == Opcode.CHUNK:
                yield from self._chunk(start, data[start + _HEAD.size : stop])
            elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                yield from self._records(data[start:stop], start)
            closed = opcode in _ENDS
        self._take_stock(closed)

    def _take_stock(self, closed: bool) -> None:
        if not closed:
            place = f"the file breaks off at byte {len(self.data)} without an end mark"
            self._report("cut_off", f"{place}; what is complete before it is used")
        for kind, count in self._beyond.items():
            self.defects.append(Defect(kind, f"{count} more of the kind", self._last_log_time, count))
        if self._homeless:
            text = f"{self._homeless} messages of undeclared channels left out"
            self._report("unknown_channel", text, self._homeless)
        if self._expected is not None and self.seen < self._expected:
            lost = self._expected - self.seen
            self._report("lost_messages", f"{lost} of {self._expected} messages of all topics are lost", lost)

    def _report(self, kind: str, text: str, count: int = 1) -> None:
        if len(self.defects) < MAX_DEFECTS:
            self.defects.append(Defect(kind, text, self._last_log_time, count))
        else:
            self._beyond[kind] = self._beyond.get(kind, 0) + count

    def _records(self, data: bytes, offset: int) -> Iterator[Message]:
        """Messages in `data`, a run of records; the tight loop of this module."""
        position, size = 0, len(data)
        read_head, read_message = _HEAD.unpack_from, _MESSAGE.unpack_from
        yielded = self._yielded
        while position + 9 <= size:
            opcode, length = read_head(data, position)
            body = position + 9
            position = body + length
            if position > size:
                self._report("corrupt_record", f"a record at byte {offset} overruns its chunk; rest left out")
                return
            if opcode == 5 and length >= 22:
                channel_id, _, log_time, publish_time = read_message(data, body)
                self.seen += 1
                if channel_id not in yielded:
                    self._homeless += 1
                elif (channel := yielded[channel_id]) is not None:
                    self._last_log_time = log_time
                    yield Message(channel, log_time, publish_time, data[body + 22 : position])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, data[body:position], offset)
            elif opcode == 0:
                self._report("corrupt_record", f"no record where one should be at byte {offset}; rest left out")
                return

    def _chunk(self, start: int, body: bytes, *, cut: bool = False) -> Iterator[Message]:
        """Messages of a chunk; of a cut chunk, those that are complete."""
        try:
            records = self._chunk_records(body, cut)
        except _DamagedError as error:
            kind = "cut_off" if cut else "corrupt_chunk"
            self._report(kind, f"the chunk at byte {start} {error}; its messages are left out")
            return
        if cut:
            records = records[: _complete(records)]
        yield from self._records(records, start)

    def _chunk_records(self, body: bytes, cut: bool) -> bytes:
        if len(body) < _MIN_BODY[Opcode.CHUNK] and not cut:
            raise _DamagedError("is too short")
        _, _, size, crc, name_size = _CHUNK.unpack_from(body)
        compression = body[_CHUNK.size : _CHUNK.size + min(name_size, 16)].decode("ascii", "replace")
        if size > MAX_CHUNK_BYTES:
            raise _DamagedError(f"announces {size} bytes, more than the {MAX_CHUNK_BYTES} allowed")
        self._room -= size
        if self._room < 0:
            raise _DamagedError(f"is beyond the {MAX_EXPANSION} times its size that this file may hold")
        start = _CHUNK.size + name_size + 8
        packed = int.from_bytes(body[start - 8 : start], "little")
        records = _decompress(compression, body[start : start + packed], size)
        if not cut and len(records) != size:
            raise _DamagedError(f"holds {len(records)} bytes instead of {size}")
        if not cut and crc and zlib.crc32(records) != crc:
            raise _DamagedError("fails its CRC")
        return records

    def _define(self, opcode: int, body: bytes, offset: int) -> None:
        """Take in a schema or channel record, unless the summary vouches for another of this number."""
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = mcap.records.Schema.read(stream)
                if not self._settled or schema.id not in self._schemas:
                    self._schemas[schema.id] = schema
                return
            record = mcap.records.Channel.read(stream)
        except _PARSE_ERRORS:
            self._report("corrupt_record", f"a topic declaration at byte {offset} is unreadable")
            return
        if self._settled and record.id in self.channels:
            return
        declared = self._schemas.get(record.schema_id)
        channel = Channel(
            record.topic,
            declared.name if declared else "",
            declared.encoding if declared else "",
            declared.data if declared else b"",
            record.message_encoding,
            record.metadata,
        )
        self.channels[record.id] = channel
        self._yielded[record.id] = channel if self._wanted(channel) else None

    def _read_summary(self) -> None:
        """Channels and message count from the summary section; final if its CRC vouches for them."""
        footer = len(self.data) - len(MCAP0_MAGIC) - _HEAD.size - 20
        if footer < len(MCAP0_MAGIC) or self.data[-8:] != MCAP0_MAGIC:
            return
        opcode, length, start, _, crc = struct.unpack_from("<BQQQI", self.data, footer)
        if (opcode, length) != (Opcode.FOOTER, 20) or not len(MCAP0_MAGIC) <= start <= footer:
            return
        section = self.data[start : footer + _HEAD.size + 16]
        sound = crc != 0 and zlib.crc32(section) == crc
        position = 0
        while position + _HEAD.size <= footer - start:
            opcode, length = _HEAD.unpack_from(section, position)
            body = section[position + _HEAD.size : position + _HEAD.size + length]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, body, start)
            elif opcode == Opcode.STATISTICS and len(body) >= 8 and (sound or crc == 0):
                self._expected = int.from_bytes(body[:8], "little")
            position += _HEAD.size + length
        self._settled = sound

    # Framing: where one record ends and the next begins, when lengths cannot be trusted.

    def _record_end(self, start: int, opcode: int, length: int) -> int | None:
        """End of the record at `start`; None where its head cannot be right or it runs past the file."""
        stop = start + _HEAD.size + length
        if opcode == 0 or (opcode in _ENDS and length != _MIN_BODY[opcode]):
            return None
        if self._plausible(stop, 1):
            return stop
        if opcode == Opcode.CHUNK:  # its length stands in it a second time
            own = self._own_end(start)
            if own is not None and own != stop and self._plausible(own, 3):
                return own
        if stop > len(self.data) or self._next_record(start + 1, stop) is not None:
            return None
        return stop

    def _own_end(self, start: int) -> int | None:
        """Where the chunk at `start` ends by the length of its data."""
        body = start + _HEAD.size
        head = self.data[body : body + _CHUNK.size + 16]
        if len(head) < _CHUNK.size:
            return None
        data = _CHUNK.size + int(_CHUNK.unpack_from(head)[4]) + 8
        return body + data + int.from_bytes(head[data - 8 : data], "little") if data <= len(head) else None

    def _next_record(self, start: int, stop: int) -> int | None:
        """The next byte in `start`..`stop` from which three plausible records follow each other."""
        for match in _RECORD_START.finditer(self.data, start, min(stop + _HEAD.size, len(self.data))):
            if match.start() < stop and self._plausible(match.start(), 3):
                return match.start()
        return None

    def _plausible(self, position: int, records: int) -> bool:
        """Whether as many records, or the end of the file, can stand at `position`."""
        size = len(self.data)
        for _ in range(records):
            if position in (size, size - len(MCAP0_MAGIC)):
                return True
            if position + _HEAD.size > size:
                return False
            opcode, length = _HEAD.unpack_from(self.data, position)
            if length < _MIN_BODY.get(opcode, 2**64) or position + _HEAD.size + length > size:
                return False
            position += _HEAD.size + length
        return True


def _complete(records: bytes) -> int:
    """How many bytes of a run of records belong to complete ones."""
    position = 0
    while position + _HEAD.size <= len(records):
        stop = position + _HEAD.size + _HEAD.unpack_from(records, position)[1]
        if stop > len(records):
            break
        position = stop
    return position
