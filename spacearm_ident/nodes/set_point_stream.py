"""Set-points on absolute deadlines: one thread that publishes a run, can be told to stop, and ends at rest.

Everything that can be computed before is: a slot copies one row into a message whose layout never changes
(2.5 % of a core at 1 kHz; a typed message 4 %). Set-points whose slot is over are sent late, all at once, and
counted: each carries the stamp of its slot, and the driver plays it a while after that.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray

from ..arrays import FloatArray
from ..canbus.realtime import Pacer, prepare_thread
from ..driver.set_points import PAUSE
from ..excitation.run import Brake, Phase, Run
from ..excitation.trajectory import Motion, MotionLimits
from .joint_stream import JointStateWriter

HOLD_S = 1.0
"""How long the last set-point is repeated at the end: whoever follows sees the arm come to rest."""
SILENCE_S = 2.0 * PAUSE
"""Nothing is sent for so long after the last set-point. The driver takes set-points that follow sooner than `PAUSE` for
the same motion, and where the arm is measured for another jump of it; twice that, for a thread that is late."""

_POLL_S = 1e-3
"""How often a graph's clock that is not this machine's is looked at."""


Encoder = Callable[[int, FloatArray, FloatArray], bytes]
"""A set-point as a serialised message (CDR), from its stamp (ns since 1970), positions and velocities, (n,), SI."""


class ClockPacer:
    """Slots by the clock of the graph (`use_sim_time`), which may stand still, or run at another pace.

    Attributes:
        slots: Slots that began.
        missed: Slots that had passed before they could begin.
    """

    def __init__(self, period: float, now_ns: Callable[[], int]) -> None:
        """Slots of `period` seconds, from the first `wait` on, by a clock in ns."""
        self._period_ns, self._now_ns = round(1e9 * period), now_ns
        self._begin_ns = 0
        self.slots = self.missed = 0

    def wait(self) -> float:
        """Sleep until the next slot begins; skip, and count, slots that are over."""
        self._begin_ns = self._begin_ns or self._now_ns()
        due_ns = self._begin_ns + (self.slots + self.missed) * self._period_ns
        while (now := self._now_ns()) < due_ns:
            time.sleep(_POLL_S)
        over, late_ns = divmod(now - due_ns, self._period_ns)
        self.missed += over
        self.slots += 1
        return late_ns * 1e-9

    def lateness(self, quantile: float) -> float:
        """0, because it cannot be measured: the steps of a simulated clock are coarser than a slot."""
        return 0.0


class PositionsMessage:
    """A `std_msgs/msg/Float64MultiArray` with positions in the order of a controller's joints, patched in place.

    Args:
        joints: Order of the positions given.
        order: Order in the message, the same names.
    """

    def __init__(self, joints: Sequence[str], order: Sequence[str]) -> None:
        marks = np.arange(1.0, len(order) + 1)
        encoded = serialize_message(Float64MultiArray(data=marks.tolist()))
        self._buffer = bytearray(encoded)
        self._data = np.frombuffer(self._buffer, "<f8", len(order), encoded.index(marks.tobytes()))
        self._columns = [list(joints).index(name) for name in order]

    def encode(self, stamp_ns: int, q: FloatArray, qd: FloatArray) -> bytes:
        """The message with these positions (n,); it carries neither stamp nor velocities."""
        self._data[:] = q[self._columns]
        return bytes(self._buffer)


class SetPointStream:
    """One run being streamed.

    Attributes:
        reason: Why it was stopped early; empty otherwise.
        warning: What keeps the thread from being on time, or None.
        start_ns: Stamp of the first set-point, ns since 1970.
        lag_s: How far the arm is behind, s; whoever sees the arm sets it.
        stopped_s: When braking began, s from the start; None if it did not.
    """

    lag_s = 0.0

    def __init__(
        self,
        run: Run,
        motion: Motion,
        limits: MotionLimits,
        rate_hz: float,
        publish: Callable[[bytes], None],
        priority: int = 0,
        *,
        encode: Encoder | None = None,
        now_ns: Callable[[], int] | None = None,
    ) -> None:
        """Begin to stream.

        Args:
            run: What to do.
            motion: Its set-points at `rate_hz`, checked against the limits.
            limits: Limits braking must keep.
            rate_hz: Set-points a second.
            publish: Given each message (CDR), in the stream's thread.
            priority: Of `SCHED_FIFO`; 0 for none.
            encode: How a set-point is written; as a `sensor_msgs/msg/JointState` unless given.
            now_ns: Clock of the graph, where it is not this machine's.
        """
        self.reason = ""
        self.warning: str | None = None
        self._run, self._motion, self._limits = run, motion, limits
        self._encode: Encoder = encode or JointStateWriter(run.trajectory.joints, "position", "velocity").payload
        self._publish, self._priority = publish, priority
        self._period_s = 1.0 / rate_hz
        self._now_ns = now_ns or time.time_ns
        self._pacer = Pacer(self._period_s) if now_ns is None else ClockPacer(self._period_s, now_ns)
        self._stop = threading.Event()
        self._slot = 0
        self.stopped_s: float | None = None
        self._at_rest = False
        self.start_ns = 0
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._work, name="set-points")
        self._thread.start()
        self._begun.wait()

    @property
    def moving(self) -> bool:
        """Whether the run goes on; afterwards the last set-point is repeated for `HOLD_S`."""
        return self._thread.is_alive() and not self._at_rest

    @property
    def set_points(self) -> int:
        """Set-points published."""
        return self._pacer.slots + self._pacer.missed

    @property
    def time_s(self) -> float:
        """Time along the run, s from its start, of the last set-point sent."""
        return self._slot * self._period_s

    @property
    def late(self) -> int:
        """Set-points sent late, with the one after them."""
        return self._pacer.missed

    @property
    def late_s(self) -> float:
        """Lateness that 99 % of the set-points stayed below, s."""
        return self._pacer.lateness(0.99)

    @property
    def phase(self) -> Phase:
        """Where the stream is.

        `done` from when the arm is at rest; where it was stopped, not before the silence after the last set-point:
        drives that are enabled again must not meet it.
        """
        if not self._thread.is_alive():
            return Phase("done", 0)
        if self._stop.is_set():
            return Phase("stopping", 0)
        if self._at_rest:
            return Phase("done", 0)
        return self._run.phase(self._slot * self._period_s)

    def stop(self, reason: str) -> None:
        """Brake to rest from here on, hold, end; returns at once. Only the first reason counts."""
        if not self._stop.is_set():
            self.reason = reason
            self._stop.set()

    def wait(self, timeout_s: float) -> None:
        """Wait for the last set-point, and for the silence after which another stream may begin."""
        self._thread.join(timeout_s)

    def _work(self) -> None:
        self.warning = prepare_thread(self._priority)
        self.start_ns = self._now_ns()
        self._begun.set()
        try:
            self._stream()
        except Exception as error:  # the driver misses the set-points and stops the arm; here it must be told
            self.reason = f"the stream broke off: {error!r}"
            raise

    def _stream(self) -> None:
        last = self._follow()
        if self._stop.is_set():
            last = self._brake()
        self._at_rest = True
        until = self._slot + round(HOLD_S / self._period_s)
        while self._slot < until:
            for slot in self._next_slots():
                self._send(slot, last.q, last.qd)
        time.sleep(SILENCE_S)

    def _follow(self) -> Motion:
        """Publish the run until its end or a stop; returns the state at the end."""
        q, qd, end = self._motion.q, self._motion.qd, len(self._motion.q) - 1
        while self._slot < end and not self._stop.is_set():
            for slot in self._next_slots():
                row = min(slot, end)
                self._send(slot, q[row], qd[row])
        return self._motion.at(end)

    def _brake(self) -> Motion:
        self.stopped_s = self._slot * self._period_s
        brake = Brake(self._run.trajectory, self._limits, self.stopped_s)
        state = self._motion.at(min(self._slot, len(self._motion.q) - 1))
        while not brake.at_rest:
            for slot in self._next_slots():
                state = brake.step(self._period_s)
                self._send(slot, state.q, state.qd)
        return state

    def _next_slots(self) -> range:
        """Wait for the next slot; returns it, and before it those that were missed.

        They are still sent: the driver plays set-points a while after their stamps.
        """
        before = self._slot
        self._pacer.wait()
        self._slot = self._pacer.slots + self._pacer.missed - 1
        return range(before + 1, self._slot + 1) if self._slot else range(1)

    def _send(self, slot: int, q: FloatArray, qd: FloatArray) -> None:
        stamp_ns = self.start_ns + round(slot * self._period_s * 1e9)
        self._publish(self._encode(stamp_ns, q, qd))
