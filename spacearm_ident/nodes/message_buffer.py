"""`MessageBuffer`: the last messages of a topic as raw bytes in bounded memory; `Capture`: a piece of it, for a bag.

A message costs one copy into a preallocated block. Nothing is decoded, so whatever was sent, broken or not, reaches
the checks of `recording.reader` as it would from a bag.
"""

from __future__ import annotations

import builtins
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..recording import RecordingWriter
from ..recording.messages import DESCRIPTION_TOPIC, TOPIC_TYPES
from ..recording.qos import LATCHED, STREAMED

BLOCK_MESSAGES = 2048
LARGEST_BYTES = 1 << 20
"""No message of the joint topics is larger; one that is, is counted as lost."""


class _Block:
    """Room for some messages: their bytes one after the other, where each ends, and when it came."""

    def __init__(self, room: int) -> None:
        self.data: NDArray[np.uint8] = np.empty(room, dtype=np.uint8)
        self.view = memoryview(self.data)  # type: ignore[arg-type]  # numpy's Buffer is Python 3.12's
        self.ends: NDArray[np.int64] = np.zeros(BLOCK_MESSAGES, dtype=np.int64)
        self.times_ns: NDArray[np.int64] = np.zeros(BLOCK_MESSAGES, dtype=np.int64)
        self.count = self.used = 0

    def messages(self, first: int) -> Iterator[bytes]:
        """Payloads from the `first` on."""
        starts = [0, *self.ends[: self.count].tolist()]
        for start, end in zip(starts[first : self.count], starts[first + 1 :]):
            yield bytes(self.view[start:end])


@dataclass(frozen=True)
class Capture:
    """Messages of one topic: `times_ns` (k,) of arrival, `sizes` (k,), and their bytes one after the other."""

    topic: str
    times_ns: NDArray[np.int64]
    sizes: NDArray[np.int64]
    data: NDArray[np.uint8]

    @classmethod
    def of_one(cls, topic: str, time_ns: int, payload: bytes) -> Capture:
        """A single message.

        Args:
            topic: Name of the topic.
            time_ns: Time of arrival, ns.
            payload: The message, serialised.
        """
        data = np.frombuffer(payload, dtype=np.uint8)
        return cls(topic, np.array([time_ns]), np.array([len(payload)]), data)

    def messages(self) -> Iterator[tuple[int, bytes]]:
        """Time of arrival and payload, one after the other."""
        start = 0
        for time_ns, size in zip(self.times_ns.tolist(), self.sizes.tolist()):
            yield time_ns, self.data[start : start + size].tobytes()
            start += size


class MessageBuffer:
    """The last messages of one topic.

    Args:
        topic: Its name.
        limit: How many messages are kept; less than two blocks of `BLOCK_MESSAGES` more, never fewer while messages
            are no larger than the first. The bytes are bounded by the blocks for that many of the first's size.
        span_ns: Time of arrival within which messages are kept, where they are no more than `limit`; up to two blocks
            of older ones stay beside them.

    Attributes:
        stored: Messages taken in so far; the number of the next one.
        dropped: Messages that had to go, oldest first, or were too large.
    """

    def __init__(self, topic: str, limit: int, span_ns: int = 2**63 - 1) -> None:
        self.topic = topic
        self._span_ns = span_ns
        self._most = -(-limit // BLOCK_MESSAGES) + 1
        self._room = self._newest_ns = 0
        self._blocks: deque[_Block] = deque()
        self.stored = self.dropped = 0

    def __len__(self) -> int:
        return sum(block.count for block in self._blocks)

    @property
    def bytes(self) -> int:
        """Memory of the blocks."""
        return len(self._blocks) * (self._room + 16 * BLOCK_MESSAGES)

    def append(self, time_ns: int, payload: builtins.bytes) -> None:
        """Keep a message that arrived at `time_ns`; a clock that went back stands still until it has caught up.

        Args:
            time_ns: When it arrived, ns of the ROS clock.
            payload: The message as serialised.
        """
        size = len(payload)
        block = self._blocks[-1] if self._blocks else None
        if block is None or block.count == BLOCK_MESSAGES or block.used + size > self._room:
            if size > LARGEST_BYTES:
                self.dropped += 1
                return
            block = self._next_block(size)
        end = block.used + size
        block.view[block.used : end] = payload
        block.ends[block.count] = block.used = end
        self._newest_ns = max(self._newest_ns, time_ns)
        block.times_ns[block.count] = self._newest_ns
        block.count += 1
        self.stored += 1

    def _next_block(self, size: int) -> _Block:
        """An empty block: the oldest where the others hold enough or are as many as may be, else a new one."""
        if self._room < size:  # The first message, or the first that a whole block could not hold.
            self._room = max(size * BLOCK_MESSAGES, self._room)
            self.dropped += len(self)
            self._blocks.clear()
        outlived = len(self._blocks) > 1 and self._newest_ns - int(self._blocks[1].times_ns[0]) >= self._span_ns
        if len(self._blocks) < self._most and not outlived:
            block = _Block(self._room)
        else:
            block = self._blocks.popleft()
            self.dropped += block.count
            block.count = block.used = 0
        self._blocks.append(block)
        return block

    def span_ns(self) -> tuple[int, int]:
        """Times of the oldest and the newest message; (0, 0) where there is none."""
        if not self._blocks:
            return 0, 0
        first, last = self._blocks[0], self._blocks[-1]
        return int(first.times_ns[0]), int(last.times_ns[last.count - 1])

    def since(self, number: int) -> list[builtins.bytes]:
        """Payloads from the `number`-th stored on (counted from 0), as far as they are still there."""
        skip = number - (self.stored - len(self))
        payloads: list[builtins.bytes] = []
        for block in self._blocks:
            if skip < block.count:
                payloads.extend(block.messages(max(0, skip)))
            skip -= block.count
        return payloads

    def between(self, start_ns: int, stop_ns: int) -> Capture:
        """The messages that arrived in [start_ns, stop_ns], copied.

        Args:
            start_ns: First arrival, ns.
            stop_ns: Last arrival, ns.
        """
        empty = np.zeros(0, dtype=np.int64)
        times, sizes, data = [empty], [empty], [np.zeros(0, dtype=np.uint8)]
        for block in self._blocks:
            arrived = block.times_ns[: block.count]
            first, last = np.searchsorted(arrived, (start_ns, stop_ns + 1)).tolist()
            if first == last:
                continue
            ends = np.concatenate([[0], block.ends[: block.count]])
            times.append(arrived[first:last].copy())
            sizes.append(np.diff(ends[first : last + 1]))
            data.append(block.data[ends[first] : ends[last]].copy())
        return Capture(self.topic, np.concatenate(times), np.concatenate(sizes), np.concatenate(data))


def write_captures(path: Path, captures: Sequence[Capture]) -> None:
    """Write captures of the joint topics as a bag.

    Args:
        path: The new bag.
        captures: One a topic.

    Raises:
        UserError: The place cannot be written.
    """
    with RecordingWriter(path) as writer:
        rows: list[tuple[int, int, builtins.bytes]] = []
        for capture in captures:
            qos = LATCHED if capture.topic == DESCRIPTION_TOPIC else STREAMED
            channel = writer.add_topic(capture.topic, TOPIC_TYPES[capture.topic], [qos])
            rows.extend((time_ns, channel, payload) for time_ns, payload in capture.messages())
        rows.sort(key=lambda row: row[0])
        for time_ns, channel, payload in rows:
            writer.write(channel, time_ns, payload)
