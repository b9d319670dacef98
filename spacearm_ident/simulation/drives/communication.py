"""The CANopen half of a simulated drive (CiA 301): NMT, SYNC, PDOs, SDO, heartbeats, EMCY.

The power half is `drives.SimulatedDrive`, which fills in what is abstract here.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import IntEnum
from typing import Final

import can

from spacearm_ident.simulation.drives.dictionary import DriveDictionary, key
from spacearm_ident.simulation.drives.faults import FaultInjection
from spacearm_ident.simulation.drives.pdo import PDOS, Pdo

NMT_ID: Final = 0x000
SDO_REQUEST: Final = 0x600
HEARTBEAT: Final = 0x700
EMERGENCY: Final = 0x080
_ERROR_REGISTER: Final = key(0x1001)
_HEARTBEAT_PERIOD: Final = key(0x1017)
_EMCY: Final = struct.Struct("<HB5x")
#: EMCY for an RPDO that is shorter than its mapping (CiA 301, table 26).
PDO_TOO_SHORT: Final = 0x8210
HEARTBEAT_ERROR: Final = 0x8130

Route = Callable[[can.Message], None]


class NmtState(IntEnum):
    """NMT states as the heartbeat carries them."""

    BOOT = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


_NMT_COMMANDS: Final = {
    0x01: NmtState.OPERATIONAL,
    0x02: NmtState.STOPPED,
    0x80: NmtState.PRE_OPERATIONAL,
}


class Communication(ABC):
    """A CANopen slave.

    Attributes:
        node_id: Its node.
        nmt: Its NMT state.
        values: Its object dictionary, `key(index, sub)` to integer.
        faults: What a test has told it to do wrong.
        stale: How long the set-points that take effect now have waited for a SYNC that was missing, s.
        routes_changed: Set whenever `routes` has new entries; whoever dispatches frames clears it.
    """

    def __init__(self, node_id: int, send: Callable[[int, bytes], None]) -> None:
        self.node_id = node_id
        self._put = send
        self.nmt = NmtState.BOOT
        self.stale = 0.0
        self.routes_changed = True
        self.dictionary = DriveDictionary(node_id, self)
        self.values = self.dictionary.values
        self.faults = FaultInjection(self.dictionary)
        self.receive = [self._pdo(number, transmit=False) for number in range(PDOS)]
        self.transmit = [self._pdo(number, transmit=True) for number in range(PDOS)]
        self.dictionary.after_write[key(0x1016, 1)] = self._on_new_master
        self._received: dict[int, bytes | bytearray] = {}
        self._next_heartbeat = 0.0
        self._master_deadline: float | None = None
        self._now = 0.0
        self._last_status = -1

    # What the power half adds ---------------------------------------------------------------------------

    @abstractmethod
    def process_received(self, mapped: tuple[int, ...]) -> None:
        """Act on objects that an RPDO has just changed."""

    @abstractmethod
    def connection_lost(self, code: int) -> None:
        """The master has gone (EMCY `code`), or has taken the drive out of operation (0)."""

    @abstractmethod
    def fault(self, code: int, register: int = 0x01) -> None:
        """Detect a fault.

        Args:
            code: Emergency error code (CiA 402, 0x603F).
            register: Bits of the error register (CiA 301, 0x1001).
        """

    # Frames ---------------------------------------------------------------------------------------------

    def send_message(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus, unless a test has silenced the drive."""
        if not self.faults.silent:
            self._put(can_id, data)

    def routes(self) -> dict[int, Route]:
        """What to do with a frame of which identifier; SYNC comes through `on_sync` and `after_sync`."""
        routes: dict[int, Route] = {
            NMT_ID: self._on_nmt,
            SDO_REQUEST + self.node_id: self._on_sdo,
        }
        for number, pdo in enumerate(self.receive):
            if pdo.can_id is not None:
                routes[pdo.can_id] = self._receiver(number)
        if master := self.values[key(0x1016, 1)] >> 16 & 0x7F:
            routes[HEARTBEAT + master] = self._on_master_heartbeat
        return routes

    def on_sync(self) -> None:
        """Send the synchronous TPDOs."""
        if self.nmt is not NmtState.OPERATIONAL or self.faults.silent:
            return
        for pdo in self.transmit:
            if pdo.can_id is not None and pdo.synchronous and pdo.due():
                self._send_pdo(pdo)

    def after_sync(self, stale: float = 0.0) -> None:
        """Let the set-points received since the last SYNC take effect, `stale` seconds late."""
        if not self._received or self.faults.silent:
            return
        received, self._received = self._received, {}
        self.stale = stale
        for number, payload in received.items():
            self._take(self.receive[number], payload)
        self.stale = 0.0

    def status_changed(self) -> None:
        """Send the event-driven TPDOs that carry the statusword."""
        place = key(0x6041)
        if self.values[place] == self._last_status:
            return
        self._last_status = self.values[place]
        for pdo in self.transmit:
            if self.nmt is NmtState.OPERATIONAL and not pdo.synchronous and place in pdo.mapped:
                self._send_pdo(pdo)

    def _send_pdo(self, pdo: Pdo) -> None:
        payload: bytes | None = pdo.pack()
        if payload is not None and self.faults.corrupting:
            payload = self.faults.corrupt(payload)
        if pdo.can_id is not None and payload is not None:
            self.send_message(pdo.can_id, payload)

    def _receiver(self, number: int) -> Route:
        pdo = self.receive[number]

        def take(message: can.Message) -> None:
            if self.nmt is not NmtState.OPERATIONAL or self.faults.silent:
                return
            if len(message.data) < pdo.size:
                self.emergency(PDO_TOO_SHORT, 0x11)
            elif pdo.synchronous:
                self._received[number] = message.data
            else:
                self._take(pdo, message.data)

        return take

    def _take(self, pdo: Pdo, payload: bytes | bytearray) -> None:
        pdo.unpack(payload)
        self.process_received(pdo.mapped)

    def _on_sdo(self, message: can.Message) -> None:
        if self.nmt is not NmtState.STOPPED and not self.faults.silent:
            self.dictionary.on_sdo(message.data)
            if code := self.faults.take():
                self.fault(code)

    def _pdo(self, number: int, *, transmit: bool) -> Pdo:
        def changed() -> None:
            self.routes_changed = True

        return Pdo(self.dictionary, number, transmit=transmit, changed=changed)

    # NMT and heartbeats -----------------------------------------------------------------------------------

    def reset(self, communication_only: bool = False) -> None:
        """Put the objects at their defaults (or only those of the communication), boot up."""
        self.dictionary.restore(last=0x1FFF if communication_only else 0xFFFF)
        for pdo in (*self.receive, *self.transmit):
            pdo.configure()
        self._received.clear()
        self._master_deadline = None
        self.routes_changed = True
        self.nmt = NmtState.BOOT
        self.send_message(HEARTBEAT + self.node_id, bytes([self.nmt]))
        self.nmt = NmtState.PRE_OPERATIONAL

    def keep_time(self, now: float) -> None:
        """Send the heartbeat when it is due, notice when the master's is overdue; `now` in seconds."""
        self._now = now
        self.faults.keep_time(now)
        period = 1e-3 * self.values[_HEARTBEAT_PERIOD]
        if period and now >= self._next_heartbeat:
            behind = now > self._next_heartbeat + period
            self._next_heartbeat = (now if behind else self._next_heartbeat) + period
            self.send_message(HEARTBEAT + self.node_id, bytes([self.nmt]))
        if self._master_deadline is not None and now > self._master_deadline and not self.faults.silent:
            self._master_deadline = None
            self.connection_lost(HEARTBEAT_ERROR)

    def emergency(self, code: int, register: int) -> None:
        """Send an EMCY and set bits of the error register.

        Args:
            code: Emergency error code (CiA 301).
            register: Bits of the error register (0x1001) to set.
        """
        self.values[_ERROR_REGISTER] |= register
        if self.nmt is not NmtState.STOPPED:
            self.send_message(EMERGENCY + self.node_id, _EMCY.pack(code, self.values[_ERROR_REGISTER]))

    def clear_emergency(self) -> None:
        """Report that no error is left."""
        self.values[_ERROR_REGISTER] = 0
        self.emergency(0, 0)

    def _on_nmt(self, message: can.Message) -> None:
        if len(message.data) < 2 or message.data[1] not in (0, self.node_id) or self.faults.silent:
            return
        command = message.data[0]
        if command in (0x81, 0x82):
            self.reset(communication_only=command == 0x82)
            return
        new = _NMT_COMMANDS.get(command)
        if new is None or new is self.nmt:
            return
        leaving, self.nmt = self.nmt is NmtState.OPERATIONAL, new
        self._received.clear()
        if leaving:
            self.connection_lost(0)
        self._last_status = -1
        self.status_changed()

    def _on_new_master(self, _: int) -> None:
        self.routes_changed = True
        self._master_deadline = None

    def _on_master_heartbeat(self, message: can.Message) -> None:
        # Monitoring begins with the first heartbeat (CiA 301, 7.2.8.3.2.2); zero switches it off.
        allowed = 1e-3 * (self.values[key(0x1016, 1)] & 0xFFFF)
        self._master_deadline = self._now + allowed if allowed else None
