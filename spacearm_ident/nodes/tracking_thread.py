"""`TrackingThread`: a `TrackingStream` at work beside its node, which only hands blocks over and asks for news.

A thread, not a process: it takes a tenth of a core, and the messages are in this process already. It may fall behind
for `LONGEST_WAITING` blocks; what comes on top is left out and counted, which the stream takes for a gap.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..tracking.tracker import Change, TrackingState
from .tracking_stream import TrackingStream

LONGEST_WAITING = 64
_ENDING_S = 5.0


@dataclass(frozen=True)
class _Block:
    """Joint states and temperatures since the last one, and when the last joint state came."""

    payloads: Sequence[bytes]
    temperatures: Sequence[bytes]
    arrived_ns: int


@dataclass(frozen=True)
class Followed:
    """What a block has brought.

    Attributes:
        newest_s, arrived_ns: Stamp of the last joint state (s since 1970) and when it came.
        changes: Found in it.
        state: After it.
        figures: For `/diagnostics`.
    """

    newest_s: float
    arrived_ns: int
    changes: tuple[Change, ...]
    state: TrackingState
    figures: Mapping[str, object]


@dataclass(frozen=True)
class Broken:
    """Tracking has ended, and why."""

    reason: str


class TrackingThread:
    """A stream at work, from the constructor to `stop` or `Broken`.

    Attributes:
        blocks_left_out: Because it had fallen behind.
    """

    def __init__(self, stream: TrackingStream) -> None:
        self.blocks_left_out = 0
        self._stream = stream
        self._blocks: queue.Queue[_Block | None] = queue.Queue(LONGEST_WAITING)
        self._news: queue.SimpleQueue[Followed | Broken] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name="tracking", daemon=True)
        self._thread.start()

    def feed(self, payloads: Sequence[bytes], temperatures: Sequence[bytes], arrived_ns: int) -> None:
        """Hand messages over in the order of arrival; never waits, and counts blocks that are left out.

        Args:
            payloads: Joint states since the last call, CDR.
            temperatures: Temperatures since the last call, CDR.
            arrived_ns: When the last joint state arrived, ns.
        """
        try:
            self._blocks.put_nowait(_Block(payloads, temperatures, arrived_ns))
        except queue.Full:
            self.blocks_left_out += 1

    def poll(self) -> list[Followed | Broken]:
        """What it has to say since the last time."""
        news = []
        while not self._news.empty():
            news.append(self._news.get())
        return news

    def stop(self) -> None:
        """End it; returns when the block it is at, if any, is done. Nothing is heard of it afterwards."""
        self._stopping.set()
        with contextlib.suppress(queue.Full):  # Full: it is awake, and sees the flag.
            self._blocks.put_nowait(None)
        self._thread.join(_ENDING_S)

    def _work(self) -> None:
        start = time.thread_time()
        try:
            while (block := self._blocks.get()) is not None and not self._stopping.is_set():
                changes = self._stream.add(block.payloads, block.temperatures)
                figures = self._stream.figures()
                if figures:
                    spent = time.thread_time() - start
                    figures |= {"data_s": self._stream.data_s, "core_share": spent / self._stream.data_s}
                    state = self._stream.state()
                    self._news.put(Followed(self._stream.newest_s, block.arrived_ns, tuple(changes), state, figures))
        except Exception as error:
            traceback.print_exc()
            self._news.put(Broken(f"the tracking broke: {type(error).__name__}: {error}"))
