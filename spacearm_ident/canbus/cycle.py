"""`Cycle`: one SYNC and its answers, for all drives on all buses; called a thousand times a second.

Only frames of the cycle are handled here; everything else (SDO answers, heartbeats, EMCY) goes on to the
`canopen` networks, so that no second thread reads the bus. What the safety policy must know is left in
`events`; the policy itself is the caller's. Nothing is logged, and nothing grows.

Who commands what: a goal (`cia402.Goal`) holds for all axes. An axis that is not in "operation enabled" gets
its actual position as target, so enabling never moves; from then on its target stays until the caller gives
another. `quick_stop` sends at once and also replaces the goal, so it takes effect with the next SYNC. An axis
that leaves "operation enabled" by itself stops all: the goal becomes the quick stop, until the caller sets
another. No axis is ever enabled again without that.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

import can
import canopen
import numpy as np

from spacearm_ident.arrays import BoolArray, FloatArray
from spacearm_ident.canbus.arm_bus import INTERPOLATED_MODE, ArmBus
from spacearm_ident.canbus.cia402 import Command, Goal, State, controlword_toward, notes_of, state_of
from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.canbus.frames import ERROR_BUS_OFF
from spacearm_ident.canbus.pdo import (
    CONTROLWORD,
    RPDO1,
    STATUSWORD,
    SYNC,
    TPDO1,
    Feedback,
    SetPoints,
)

HEARTBEAT: Final = 0x700
SDO_ANSWER: Final = 0x580
#: Frames taken in at once before a SYNC; a flood must not stop the cycle.
MOST_WAITING: Final = 200
#: Events kept for a caller that does not fetch them.
MOST_EVENTS: Final = 1000
#: Share of the period within which SYNC is out on all buses; else the answers are of no one moment and not used.
TORN: Final = 0.2
_RUN_INTERPOLATION: Final = 0x10


class Cycle:
    """The cyclic exchange with all drives.

    Attributes:
        buses: Open buses, as numbered by the axes.
        networks: Of the same, as `canopen` has them.
        feedback: Position (rad), torque (N·m, output side), current (A), statusword of each axis.
        sync_ns: When the SYNC of the last cycle was sent (its last, where it went out in pieces), nanoseconds since the
            epoch.
        stamp: (n,) time of each axis' last feedback frame, seconds since the epoch.
        received: (n,) feedback frames taken in so far.
        missing: (n,) cycles in a row without feedback.
        states: CiA 402 state of each axis; None for a pattern CiA 402 does not know.
        goal: Where all drives shall be; set it, the cycles lead there.
        cycles: Cycles run.
        incomplete: Cycles in which at least one feedback did not come in time, or SYNC went out in pieces (`TORN`).
        late: Feedback frames that belong to no cycle: they came after theirs, or it was torn.
        malformed: Frames of a wrong length or that the `canopen` library could not read.
        answer_s: From SYNC to the last feedback of the last cycle, s; NaN if incomplete.
        events: What happened, oldest first; the caller takes them out (`popleft`).
    """

    def __init__(
        self,
        arm: ArmBus,
        buses: Sequence[can.BusABC],
        networks: Sequence[canopen.Network],
        statuswords: Sequence[int] | None = None,
    ) -> None:
        """Prepare all frames; the drives must have been configured for `arm`.

        Args:
            arm: The axes.
            buses: As numbered by the axes.
            networks: The library's view of each bus, not connected.
            statuswords: Of each axis now, where the feedback does not carry them.
        """
        count = len(arm.axes)
        self.arm = arm
        self.buses = list(buses)
        self.networks = list(networks)
        self.feedback = Feedback(arm.scales, arm.feedback)
        self.set_points = SetPoints(arm.scales, arm.set_point)
        self.sync_ns = 0
        self.stamp = np.zeros(count)
        self.received = np.zeros(count, dtype=np.int64)
        self.missing = np.zeros(count, dtype=np.int64)
        self.states: list[State | None] = [None] * count
        self.goal = Goal.DISABLED
        self.cycles = self.incomplete = self.late = self.malformed = 0
        self.answer_s = np.nan
        self._torn = False
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._fresh = np.zeros(count, dtype=bool)
        self._not_enabled = np.ones(count, dtype=bool)
        self._goal_before: Goal | None = None
        self._states_changed = True
        self._words_before: list[int] = []
        self._bus_of = [axis.bus for axis in arm.axes]
        self._status = np.array(statuswords or [0] * count, dtype=np.uint16)
        self._own_status = STATUSWORD not in arm.feedback.fields
        self._own_control = CONTROLWORD not in arm.set_point.fields
        self._run_bit = _RUN_INTERPOLATION if arm.mode == INTERPOLATED_MODE else 0
        self._bus_failed = [False] * len(self.buses)
        self._heartbeat_ns = [0] * count
        self._heartbeat_lost = [False] * count
        self._next_heartbeat_ns = 0
        self._sync = _frame(SYNC, b"")
        self._beat = _frame(HEARTBEAT + arm.master_id, b"\x05")
        fd = arm.bit_rate.data is not None
        self._points = [_frame(RPDO1 + axis.node_id, bytes(arm.set_point.size), fd) for axis in arm.axes]
        self._controls = [_frame(RPDO1 + 0x100 + axis.node_id, bytes(2), fd) for axis in arm.axes]
        self._routes: list[dict[int, int]] = [{} for _ in buses]
        self._expected = [0] * len(self.buses)
        for number, axis in enumerate(arm.axes):
            self._routes[axis.bus][TPDO1 + axis.node_id] = number
            self._expected[axis.bus] += 1
        self._nodes = [{axis.node_id: k for k, axis in enumerate(arm.axes) if axis.bus == bus} for bus in
                       range(len(self.buses))]  # fmt: skip

    @property
    def enabled(self) -> bool:
        """Whether every axis is in "operation enabled"."""
        return all(state is State.OPERATION_ENABLED for state in self.states)

    @property
    def powered(self) -> BoolArray:
        """(n,) whether each axis was in "operation enabled" when it was heard last."""
        return ~self._not_enabled

    def run(self, target: FloatArray | Callable[[int], FloatArray | None] | None = None) -> Feedback:
        """Send SYNC and set-points, and wait for the feedback.

        Args:
            target: (n,) rad, for axes in "operation enabled"; None: as before. Or who knows it, asked with `sync_ns`
                once SYNC is out: a process that was held up before it must not send what was meant for then.

        Returns:
            `feedback`, the same object every time; `missing` says which axes are not from this cycle.

        Raises:
            ValueError: A target is not finite or out of the drive's range. It has not been sent.
        """
        if target is not None and not callable(target):
            self.set_points.encode(target)
        for bus in range(len(self.buses)):
            self._take_waiting(bus)
        self._fresh[:] = False
        begin = time.monotonic()
        self.sync_ns = time.time_ns()
        for bus in range(len(self.buses)):
            self._send(bus, self._sync)
        # Taken off the processor meanwhile: what the drives answer is not of the moment of `sync_ns`.
        self._torn = time.monotonic() - begin > TORN * self.arm.period
        if self._torn:
            self.sync_ns = time.time_ns()
        if callable(target) and (asked := target(self.sync_ns)) is not None:
            self.set_points.encode(asked)
        self.cycles += 1
        if self.cycles % self.arm.set_point_divider == 0:
            self._send_set_points()
        self._send_heartbeat()
        deadline = begin + self.arm.answer_time
        for bus in range(len(self.buses)):
            self._read_answers(bus, deadline)
        self.answer_s = time.monotonic() - begin
        self._evaluate()
        return self.feedback

    def quick_stop(self) -> None:
        """Stop all axes on their quick-stop ramps; sent at once, in force from the next SYNC on."""
        self.goal = Goal.QUICK_STOP
        self._send_set_points()

    def report(self, kind: EventKind, axis: int, message: str) -> None:
        """Append an event, stamped with the present time, to `events`.

        Args:
            kind: What happened.
            axis: Number of the axis; −1 where the event concerns a whole bus.
            message: One line for a person.
        """
        self.events.append(Event(kind, axis, message, time.time_ns()))

    # Sending --------------------------------------------------------------------------------------------

    def _send_set_points(self) -> None:
        points = self.set_points
        points.hold(self.feedback, self._not_enabled)
        changed = self._choose_words()
        for message, payload, bus in zip(self._points, points.payloads, self._bus_of):
            message.data[:] = payload
            self._send(bus, message)
        if self._own_control:
            for number in changed:
                self._controls[number].data[:] = int(points.controlword[number]).to_bytes(2, "little")
                self._send(self._bus_of[number], self._controls[number])

    def _choose_words(self) -> list[int]:
        """Set the controlwords for the goal; returns the axes whose word has changed."""
        goal, words = self.goal, self.set_points.controlword
        changed: list[int] = []
        # They depend on states and goal alone, but for the edges of a reset.
        if goal is self._goal_before and not self._states_changed and goal is not Goal.RESET:
            return changed
        self._goal_before, self._states_changed = goal, False
        for number, state in enumerate(self.states):
            before = int(words[number])
            word = controlword_toward(goal, state, before)
            if word == Command.ENABLE_OPERATION.value:
                word |= self._run_bit
            words[number] = word
            if word != before:
                changed.append(number)
        return changed

    def _send_heartbeat(self) -> None:
        if self.sync_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = self.sync_ns + round(1e9 * self.arm.heartbeat)
            for bus in range(len(self.buses)):
                self._send(bus, self._beat)

    def _send(self, bus: int, message: can.Message) -> None:
        try:
            self.buses[bus].send(message)
        except can.CanError as error:
            self._bus_error(bus, str(error))

    def _bus_error(self, bus: int, text: str) -> None:
        """Report the first of a row of errors; the row ends when feedback of the bus is complete again."""
        if not self._bus_failed[bus]:
            self._bus_failed[bus] = True
            self.report(EventKind.BUS_ERROR, -1, f"bus {bus}: {text}")

    # Receiving ------------------------------------------------------------------------------------------

    def _take_waiting(self, bus: int) -> None:
        """Take in what came since the last cycle; feedback among it is late."""
        for _ in range(MOST_WAITING):
            message = self._receive(bus, 0.0)
            if message is None:
                return
            if message.arbitration_id in self._routes[bus]:
                self.late += 1
            else:
                self.take_other(bus, message)

    def _read_answers(self, bus: int, deadline: float) -> None:
        routes, waiting = self._routes[bus], self._expected[bus]
        sync_s = self.sync_ns * 1e-9
        while waiting:
            message = self._receive(bus, max(0.0, deadline - time.monotonic()))
            if message is None:
                return
            axis = routes.get(message.arbitration_id, -1)
            if axis < 0 or message.is_error_frame:
                self.take_other(bus, message)
            elif self._torn or self._fresh[axis] or message.timestamp < sync_s:
                self.late += 1
            elif self.feedback.put(axis, message.data):
                self._fresh[axis] = True
                self.stamp[axis] = message.timestamp
                waiting -= 1
            else:
                self._bad_frame(axis, len(message.data))
                waiting -= 1
        self._bus_failed[bus] = False

    def _receive(self, bus: int, timeout: float) -> can.Message | None:
        try:
            return self.buses[bus].recv(timeout)
        except can.CanError as error:
            self._bus_error(bus, str(error))
            return None

    def _bad_frame(self, axis: int, length: int) -> None:
        self.malformed += 1
        # One report a row: the next comes after sound feedback.
        if self.missing[axis] == 0:
            self.report(
                EventKind.BAD_FRAME,
                axis,
                f"node {self.arm.axes[axis].node_id} sent {length} bytes of feedback instead of "
                f"{self.arm.feedback.size}",
            )

    def take_other(self, bus: int, message: can.Message) -> None:
        """Deal with a frame that is no feedback: errors, heartbeats, another master, the library's."""
        if message.is_error_frame:
            what = "bus off" if message.arbitration_id & ERROR_BUS_OFF else "error frame"
            self._bus_error(bus, f"{what} (0x{message.arbitration_id:03X}): check wiring, power and bit rate")
            return
        if message.is_remote_frame:
            return
        if is_spoilt_sdo(message):
            self.malformed += 1
            return
        can_id = message.arbitration_id
        if can_id in (SYNC, HEARTBEAT + self.arm.master_id):
            self.report(EventKind.OTHER_MASTER, -1, f"bus {bus}: another master is sending (0x{can_id:03X})")
            return
        axis = self._nodes[bus].get(can_id & 0x7F, -1)
        if axis >= 0 and can_id & ~0x7F == HEARTBEAT:
            self._take_heartbeat(axis, message)
        if axis >= 0 and self._own_status and can_id & ~0x7F == TPDO1 + 0x100 and len(message.data) == 2:
            self._status[axis] = int.from_bytes(message.data, "little")
            return
        try:
            self.networks[bus].notify(can_id, message.data, message.timestamp)
        except Exception:
            # The library's callbacks trust every frame; a spoilt one must not end the cycle.
            self.malformed += 1

    def _take_heartbeat(self, axis: int, message: can.Message) -> None:
        self._heartbeat_ns[axis] = time.time_ns()
        self._heartbeat_lost[axis] = False
        if len(message.data) == 1 and message.data[0] == 0:
            node = self.arm.axes[axis].node_id
            self.report(EventKind.RESTARTED, axis, f"node {node} has restarted: configure it again")

    # Judging --------------------------------------------------------------------------------------------

    def _evaluate(self) -> None:
        fresh = self._fresh
        self.received += fresh
        self.missing += 1
        self.missing[fresh] = 0
        if not fresh.all():
            self.incomplete += 1
            self.answer_s = np.nan
            self._report_stale()
        self.feedback.decode()
        if self._own_status:
            self.feedback.statusword[:] = self._status
        words = self.feedback.statusword.tolist()
        if words != self._words_before:
            self._words_before = words
            self._judge_states(words)
        self._watch_heartbeats()

    def _judge_states(self, words: list[int]) -> None:
        self._states_changed, stop = True, False
        for number, word in enumerate(words):
            state = self.states[number] = state_of(word)
            was_enabled = not self._not_enabled[number]
            enabled = state is State.OPERATION_ENABLED
            self._not_enabled[number] = not enabled
            if was_enabled and not enabled and self.goal is Goal.ENABLED:
                node = self.arm.axes[number].node_id
                label = state.label if state else f"an unknown state (0x{word:04X})"
                notes = notes_of(word)
                text = f"node {node} went to {label} by itself{notes and f' ({notes})'}"
                self.report(EventKind.LEFT_OPERATION, number, text)
                stop = True
        if stop:
            self.quick_stop()

    def _report_stale(self) -> None:
        for number in np.flatnonzero(self.missing == self.arm.stale_cycles):
            node = self.arm.axes[number].node_id
            text = f"node {node} has sent no feedback for {self.arm.stale_cycles} cycles"
            self.report(EventKind.STALE_FEEDBACK, int(number), text)

    def _watch_heartbeats(self) -> None:
        limit = self.sync_ns - round(1e9 * self.arm.heartbeat_timeout)
        for number, last in enumerate(self._heartbeat_ns):
            if last == 0:
                # Watching begins with the first cycle.
                self._heartbeat_ns[number] = self.sync_ns
            elif last < limit and not self._heartbeat_lost[number]:
                self._heartbeat_lost[number] = True
                node = self.arm.axes[number].node_id
                text = f"no heartbeat of node {node} for {self.arm.heartbeat_timeout:g} s"
                self.report(EventKind.HEARTBEAT_LOST, number, text)


def is_spoilt_sdo(message: can.Message) -> bool:
    """Whether it is an SDO answer of another length than 8 (CiA 301, 7.2.4.3), which the library would choke on."""
    return message.arbitration_id & ~0x7F == SDO_ANSWER and len(message.data) != 8


def _frame(can_id: int, data: bytes, fd: bool = False) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd)
