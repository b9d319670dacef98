"""Write a bag while it is being lived: a bounded buffer, and a thread that puts it on the disk.

Whoever delivers messages never waits: not for compression, not for the disk. What the buffer cannot hold is
dropped and counted. Every `FLUSH_S` the chunk is closed and synced, so that a process killed or a machine
without power loses less than a second (`read_recording` reads what is left).
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from .messages import MessageType
from .qos import STREAMED, Qos
from .writer import RecordingWriter

FLUSH_S = 0.4
_TAKE_S = 0.05


@dataclass(frozen=True)
class Topic:
    """A topic as it is to stand in the bag.

    Attributes:
        name: Full topic name.
        kind: Its message type; the text may be empty.
        publishers: What each of its publishers offers.
        described: Whether `kind.text` is the type's definition; otherwise the bag names the type only.
    """

    name: str
    kind: MessageType
    publishers: tuple[Qos, ...] = (STREAMED,)
    described: bool = True


class BackgroundWriter:
    """A bag being written by a thread of its own.

    Attributes:
        path: The bag.
        failure: Why writing ended early (disk full, ...), or None. What came before is in the bag.
        messages: Messages written; after a failure, those that are in the bag.
        dropped: Messages dropped because the buffer was full, or after the failure.
    """

    def __init__(self, path: str | Path, *, buffer_bytes: int = 64 * 2**20, remedy: str = "name another place") -> None:
        """Create the bag and start.

        Args:
            path: As for `RecordingWriter`.
            buffer_bytes: Payload bytes that may wait for the disk.
            remedy: As for `RecordingWriter`.

        Raises:
            UserError: The place cannot be written.
        """
        self.path = Path(path)
        self.failure: str | None = None
        self.messages = 0
        self.dropped = 0
        self._accepted = 0
        self._room = buffer_bytes
        self._queue: deque[tuple[Topic, int, bytes, int]] = deque()
        # Two counters with one writer each, instead of one under a lock.
        self._put_bytes = 0
        self._taken_bytes = 0
        self._channels: dict[Topic, int] = {}
        self._ending = threading.Event()
        self._writer = RecordingWriter(path, remedy=remedy)
        self._thread = threading.Thread(target=self._work, name="bag writer")
        self._thread.start()

    @property
    def fill(self) -> float:
        """Share of the buffer in use."""
        return (self._put_bytes - self._taken_bytes) / self._room

    @property
    def offered(self) -> int:
        """Messages that were `put`, dropped ones among them."""
        return self._accepted + self.dropped

    def put(self, topic: Topic, log_time_ns: int, payload: bytes, publish_time_ns: int) -> bool:
        """Queue one message for writing, without waiting; call it from one thread at a time.

        Args:
            topic: Topic of the message.
            log_time_ns: When it was received, ns since the epoch.
            payload: The message, CDR.
            publish_time_ns: When it was published, ns since the epoch.

        Returns:
            False where it was dropped.
        """
        if self.failure is not None or self._put_bytes - self._taken_bytes + len(payload) > self._room:
            self.dropped += 1
            return False
        self._accepted += 1
        self._put_bytes += len(payload)
        self._queue.append((topic, log_time_ns, payload, publish_time_ns))
        return True

    def close(self) -> None:
        """Write what is waiting and finish the bag; waits for the disk. Look at `failure` then."""
        self._ending.set()
        self._thread.join()

    def _work(self) -> None:
        try:
            with self._writer:
                flushed = time.monotonic()
                while not self._ending.wait(_TAKE_S):
                    self._drain()
                    if time.monotonic() - flushed >= FLUSH_S:
                        flushed = time.monotonic()
                        self._writer.flush()
                self._drain()
        except UserError as error:
            self.messages = self._writer.kept
            self.failure = str(error)

    def _drain(self) -> None:
        # Only what is there now: a sender faster than the disk must not keep the thread from syncing.
        for _ in range(len(self._queue)):
            topic, log_time_ns, payload, publish_time_ns = self._queue.popleft()
            if topic not in self._channels:
                self._channels[topic] = self._declare(topic)
            self._writer.write(self._channels[topic], log_time_ns, payload, publish_time_ns)
            self.messages += 1
            self._taken_bytes += len(payload)

    def _declare(self, topic: Topic) -> int:
        return self._writer.add_topic(topic.name, topic.kind, topic.publishers, described=topic.described)
