"""`DriveMaster`: everything with the drives that is not cyclic: find, configure, start, ask, leave.

SDO, EMCY, NMT and the EDS are the `canopen` library's, on networks that are not connected: no thread of the
library reads the buses. While no cycle runs, a pump of our own does; while one runs, `Cycle` hands on what is
not its own, and the methods here may be used from another thread beside it.

    with DriveMaster(arm, buses) as master:
        master.boot()
        cycle = master.cycle()
        cycle.goal = Goal.ENABLED
        while …: cycle.run()
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import can
import canopen
from canopen.emcy import EmcyError
from canopen.sdo.exceptions import SdoCommunicationError, SdoError

from spacearm_ident.canbus.arm_bus import ArmBus, Axis, optional_writes, required_writes
from spacearm_ident.canbus.cycle import HEARTBEAT, Cycle, is_spoilt_sdo
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.canbus.events import EventKind
from spacearm_ident.canbus.pdo import SYNC, SdoWrite
from spacearm_ident.errors import UserError

CIA_402: Final = 402
RESET_NODE: Final = 0x81
START: Final = 0x01
PRE_OPERATIONAL: Final = 0x80
#: Deviation of a drive's rated value from the configured one that is worth a warning.
RATED_TOLERANCE: Final = 0.01
#: Factor by which drives that count in micro-units (0x6076 of an EPOS4: µN·m) exceed CiA 402's thousandths.
MICRO: Final = 1000.0
#: SDO abort codes of an object and of a sub-index that do not exist (CiA 301, table 22).
NO_SUCH_OBJECT: Final = (0x06020000, 0x06090011)
#: EMCY of a drive that has missed its master's heartbeat (CiA 301, table 26).
HEARTBEAT_ERROR: Final = 0x8130
#: Longest object that is read, bytes; a drive that goes on sending segments is cut off (CiA 301, table 22).
LONGEST_OBJECT: Final = 8
TOO_LONG: Final = 0x06070012


class OtherMasterError(UserError):
    """Somebody else is master of these drives; waiting does not help."""


class DriveMaster:
    """The master of all drives of an arm.

    Attributes:
        arm: What it was told about them.
        buses: Open buses, as numbered by the axes.
        networks: Of the same, as `canopen` has them.
        warnings: What a user should know after `boot`: settings a drive refused, rated values that differ;
            `temperature` adds to them.
        notes: What is worth knowing, and no reason for concern.
    """

    def __init__(self, arm: ArmBus, buses: Sequence[can.BusABC], eds: str = "spacearm_drive.eds") -> None:
        """Take over open buses; `close` shuts them down.

        Args:
            arm: The axes.
            buses: As numbered by the axes.
            eds: Data sheet of the drives.

        Raises:
            UserError: There are fewer buses than the axes name, a bus would be overloaded, or no such EDS.
        """
        if len(buses) != arm.buses:
            raise UserError(f"the axes are on {arm.buses} buses, {len(buses)} were given: name each bus once")
        self.loads = arm.loads()
        self.arm = arm
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self._asked = [axis.temperature_object for axis in arm.axes]
        self.buses = list(buses)
        self.networks = [canopen.Network(bus) for bus in buses]
        self._booted: set[tuple[int, int]] = set()
        self._others: set[int] = set()
        self._ours = False
        self._statuswords: list[int] | None = None
        self._cycle: Cycle | None = None
        path = str(eds_path(eds))
        self.nodes = [self.networks[axis.bus].add_node(axis.node_id, path) for axis in arm.axes]
        for number, node in enumerate(self.nodes):
            node.emcy.add_callback(self._emergency_reporter(number))

    def __enter__(self) -> DriveMaster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def boot(self, timeout: float = 5.0, listen: float | None = None) -> None:
        """Reset, identify, configure and start every drive.

        Args:
            timeout: How long a drive may take to boot, s.
            listen: How long to listen for another master before anything is sent, s; None: for three
                heartbeats, so one that is alive is heard.

        Raises:
            OtherMasterError: Another master is on a bus. Nothing has been sent.
            UserError: A drive is missing, is no CiA 402 drive, or refuses what
                the cycle needs.
        """
        self.warnings.clear()
        self.notes.clear()
        with self._pumping():
            self._refuse_second_master(3.0 * self.arm.heartbeat if listen is None else listen)
            self._ours = True
            self._reset_drives(timeout)
            for axis, node in zip(self.arm.axes, self.nodes):
                self._configure(axis, node)
            for axis in self.arm.axes:
                self._nmt(axis, START)
            # Where they come only on change, the cycle begins with what they are now.
            self._statuswords = [self._statusword(axis, node) for axis, node in zip(self.arm.axes, self.nodes)]

    def cycle(self) -> Cycle:
        """The cyclic exchange with the configured drives; from its first `run` on it reads the buses."""
        self._cycle = Cycle(self.arm, self.buses, self.networks, self._statuswords)
        return self._cycle

    def temperature(self, number: int) -> float | None:
        """Winding temperature of an axis, °C; asks by SDO, so call it beside a running cycle, not in it.

        None where the configuration names no object for it, or the drive has said that it has none: then it is asked no
        more.

        Args:
            number: Of the axis.

        Raises:
            SdoError: The drive does not answer, or not now.
        """
        index = self._asked[number]
        if index is None:
            return None
        try:
            raw = _upload(self.nodes[number], index)
        except canopen.SdoAbortedError as error:
            if error.code not in NO_SUCH_OBJECT:
                raise
            self._asked[number] = None
            self.warnings.append(
                f"node {self.arm.axes[number].node_id} has no object 0x{index:04X}: no temperature is published; "
                "correct temperature_object in the CAN YAML, or leave it out"
            )
            return None
        return 0.1 * int.from_bytes(raw, "little", signed=True)

    def close(self) -> None:
        """Take the drives out of operation and leave the buses. Never raises; the cycle must have ended."""
        with suppress(can.CanError, SdoError, UserError), self._pumping():
            # Drives of another master are left alone.
            for axis, node in zip(self.arm.axes, self.nodes) if self._ours else ():
                with suppress(SdoError):
                    node.sdo.download(0x1016, 1, bytes(4))
                self._nmt(axis, PRE_OPERATIONAL)
        for bus in self.buses:
            bus.shutdown()

    # Booting ----------------------------------------------------------------------------------------------

    def _refuse_second_master(self, listen: float) -> None:
        time.sleep(listen)
        if self._others:
            found = ", ".join(f"{self.buses[bus]}" for bus in sorted(self._others))
            raise OtherMasterError(f"another master is active on {found}: stop it first (one driver a bus)")

    def _reset_drives(self, timeout: float) -> None:
        wanted = {(axis.bus, axis.node_id) for axis in self.arm.axes}
        self._booted.clear()
        deadline = time.monotonic() + timeout
        for axis in self.arm.axes:
            self._nmt(axis, RESET_NODE)
        while not wanted <= self._booted:
            if time.monotonic() > deadline:
                missing = ", ".join(f"{node} on {self.buses[bus]}" for bus, node in sorted(wanted - self._booted))
                raise UserError(f"no boot-up message of node {missing}: check power, wiring, bit rate and node ids")
            time.sleep(0.002)

    def _configure(self, axis: Axis, node: canopen.RemoteNode) -> None:
        try:
            kind = int.from_bytes(_upload(node, 0x1000), "little") & 0xFFFF
            if kind != CIA_402:
                raise UserError(f"node {axis.node_id} is a CiA {kind} device, not a CiA 402 drive: check its id")
            for write in required_writes(axis, self.arm):
                self._write(node, write)
            for write in optional_writes(axis, self.arm):
                try:
                    self._write(node, write)
                except canopen.SdoAbortedError as error:
                    self.warnings.append(f"node {axis.node_id} refuses 0x{write.index:04X}:{write.sub} ({error})")
            self._compare_rated(axis, node)
        except SdoError as error:
            raise UserError(f"node {axis.node_id} cannot be configured: {error}") from error

    def _statusword(self, axis: Axis, node: canopen.RemoteNode) -> int:
        try:
            return int.from_bytes(_upload(node, 0x6041), "little") & 0xFFFF
        except SdoError as error:
            raise UserError(f"node {axis.node_id} does not report its state: {error}") from error

    def _write(self, node: canopen.RemoteNode, write: SdoWrite) -> None:
        try:
            node.sdo.download(write.index, write.sub, write.data)
        except canopen.SdoAbortedError as error:
            # The library's text does not say which object.
            error.args = (f"0x{write.index:04X}:{write.sub} = {write.value}", *error.args)
            raise

    def _compare_rated(self, axis: Axis, node: canopen.RemoteNode) -> None:
        index, unit = (0x6076, "N·m") if axis.scale.torque_source == "rated_torque" else (0x6075, "A")
        try:
            rated = 1e-3 * int.from_bytes(_upload(node, index), "little")
        except canopen.SdoAbortedError:
            return
        if abs(rated / MICRO - axis.scale.rated) <= RATED_TOLERANCE * axis.scale.rated:
            self.notes.append(
                f"node {axis.node_id} states 0x{index:04X} in µ{unit}, not in m{unit} as CiA 402 has it: "
                f"{rated / MICRO:g} {unit}, as configured"
            )
        elif abs(rated - axis.scale.rated) > RATED_TOLERANCE * axis.scale.rated:
            self.warnings.append(
                f"node {axis.node_id} states a rated value of {rated:g} {unit} (0x{index:04X}), configured "
                f"are {axis.scale.rated:g} {unit}: torques are scaled with the configured one"
            )

    def _nmt(self, axis: Axis, command: int) -> None:
        try:
            self.networks[axis.bus].send_message(0, bytes([command, axis.node_id]))
        except can.CanError as error:
            raise UserError(f"cannot send on {self.buses[axis.bus]}: {error}") from error

    # Reading while no cycle runs --------------------------------------------------------------------------

    @contextmanager
    def _pumping(self) -> Iterator[None]:
        """Read all buses in a thread each, for as long as the block lasts."""
        stop = threading.Event()
        threads = [
            threading.Thread(target=self._pump, args=(bus, stop), name=f"can-pump-{bus}", daemon=True)
            for bus in range(len(self.buses))
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            stop.set()
            for thread in threads:
                thread.join()

    def _pump(self, bus: int, stop: threading.Event) -> None:
        network = self.networks[bus]
        while not stop.is_set():
            try:
                message = self.buses[bus].recv(0.02)
            except can.CanError:
                # Whoever sends next is told.
                stop.wait(0.02)
                continue
            if message is None or message.is_error_frame or message.is_remote_frame or is_spoilt_sdo(message):
                continue
            can_id = message.arbitration_id
            if can_id in (SYNC, HEARTBEAT + self.arm.master_id):
                self._others.add(bus)
            elif can_id & ~0x7F == HEARTBEAT and bytes(message.data) == b"\0":
                self._booted.add((bus, can_id & 0x7F))
            with suppress(Exception):
                # The library's callbacks trust every frame; a spoilt one must not end the pump.
                network.notify(can_id, message.data, message.timestamp)

    def _emergency_reporter(self, number: int) -> Callable[[EmcyError], None]:
        node_id = self.arm.axes[number].node_id

        def report(entry: EmcyError) -> None:
            # The library keeps every EMCY for ever.
            self.nodes[number].emcy.reset()
            if self._cycle is None:
                return
            if entry.code & 0xFF00 == 0:
                self._cycle.report(EventKind.EMERGENCY_OVER, number, f"node {node_id} reports no error left")
            else:
                text = f"node {node_id} reports {entry} (error register 0x{entry.register:02X})"
                kind = EventKind.MASTER_MISSED if entry.code == HEARTBEAT_ERROR else EventKind.EMERGENCY
                self._cycle.report(kind, number, text)

        return report


def _upload(node: canopen.RemoteNode, index: int) -> bytes:
    """An integer object, as `SdoClient.upload` reads it, but never more than `LONGEST_OBJECT` bytes of one.

    Raises:
        SdoError: The drive does not answer, has no such object, or does not stop answering.
    """
    data = b""
    with node.sdo.open(index, 0, "rb", buffering=0) as stream:
        while part := stream.read(7):
            data += part
            if len(data) > LONGEST_OBJECT:
                node.sdo.abort(TOO_LONG)
                raise SdoCommunicationError(f"0x{index:04X} is longer than {LONGEST_OBJECT} bytes")
    variable = node.object_dictionary.get_variable(index, 0)
    return data if variable is None else data[: len(variable) // 8]
