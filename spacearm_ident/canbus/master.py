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
import numpy as np
from canopen.emcy import EmcyError
from canopen.sdo.exceptions import SdoError

from spacearm_ident.arrays import FloatArray
from spacearm_ident.canbus.arm_bus import STANDSTILL, ArmBus, Axis, optional_writes, position_limits, required_writes
from spacearm_ident.canbus.cia402 import Command, State, state_of
from spacearm_ident.canbus.cycle import HEARTBEAT, Cycle, is_spoilt_sdo
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.canbus.events import EventKind
from spacearm_ident.canbus.pdo import SYNC, SdoWrite
from spacearm_ident.canbus.scaling import Scaling
from spacearm_ident.canbus.sdo import NO_OBJECT, NO_SUB_INDEX, SdoTransferError, read, read_if_there, write
from spacearm_ident.errors import UserError

CIA_402: Final = 402
#: NMT "reset communication": PDOs, SYNC and heartbeats are again as at power-on, boot-up message. The application is
#: left as it is: "reset node" (0x81) would make a drive with an incremental encoder lose its position.
RESET_COMMUNICATION: Final = 0x82
START: Final = 0x01
PRE_OPERATIONAL: Final = 0x80
#: Deviation of a drive's rated value from the configured one that is worth a warning.
RATED_TOLERANCE: Final = 0.01
#: Factor by which drives that count in micro-units (0x6076 of an EPOS4: µN·m) exceed CiA 402's thousandths.
MICRO: Final = 1000.0
#: How long a drive that is found under power may take to come to rest and leave it, s.
POWER_OFF: Final = 3.0
#: How long a drive may take to display a commanded mode of operation, s: it changes within a few of the drive's own
#: cycles, of some milliseconds at most.
MODE_CHANGE: Final = 0.2
#: Names of modes of operation (CiA 402, 0x6060).
MODES: Final = {
    0: "none",
    1: "profile position",
    2: "velocity",
    3: "profile velocity",
    4: "profile torque",
    6: "homing",
    7: "interpolated position",
    8: "cyclic synchronous position",
    9: "cyclic synchronous velocity",
    10: "cyclic synchronous torque",
}
#: Interval over which a joint is looked at for standstill, s.
REST_INTERVAL: Final = 0.05
#: EMCY of a drive that has missed its master's heartbeat (CiA 301, table 26).
HEARTBEAT_ERROR: Final = 0x8130


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
        widened: What of an axis' own position limits is replaced by wider ones, since `boot`.
        errors: What an axis that `boot` found in fault says of it.
        doing: What `boot` does now, for a person.
        emergencies: Last EMCY of an axis since then that reports an error, until it reports that none is left.
        counts: (n,) 0x6064 of each drive as `boot` found it, before position limits were written.
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
        self.widened: dict[int, str] = {}
        self.errors: dict[int, str] = {}
        self.doing = ""
        self.emergencies: dict[int, str] = {}
        self.counts = np.zeros(len(arm.axes), dtype=np.int64)
        self._booted: set[tuple[int, int]] = set()
        self._others: set[int] = set()
        self._refused: set[tuple[int, int]] = set()
        self._ours = False
        self._statuswords: list[int] | None = None
        self._cycle: Cycle | None = None
        path = str(eds_path(eds))
        self.nodes = [self.networks[axis.bus].add_node(axis.node_id, path) for axis in arm.axes]
        for node in self.nodes:
            node.sdo.RESPONSE_TIMEOUT = arm.sdo_timeout
        for number, node in enumerate(self.nodes):
            node.emcy.add_callback(self._emergency_reporter(number))

    def __enter__(self) -> DriveMaster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def positions(self) -> FloatArray:
        """(n,) rad where `boot` found the joints."""
        out = np.empty(len(self.counts))
        Scaling(self.arm.scales).to_position(self.counts.astype(np.int32), out)
        return out

    def boot(self, timeout: float = 5.0, listen: float | None = None) -> None:
        """Reset the communication of every drive, identify, configure and start them; none is under power then.

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
                self._identify(axis, node)
            for axis, node in zip(self.arm.axes, self.nodes):
                self._stop(axis, node)
            for number in range(len(self.nodes)):
                self._take_power_off(number)
            for number in range(len(self.nodes)):
                self._configure(number)
            for axis in self.arm.axes:
                self._nmt(axis, START)
            # Where they come only on change, the cycle begins with what they are now.
            self._statuswords = [self._statusword(axis, node) for axis, node in zip(self.arm.axes, self.nodes)]
            faulty = [number for number, word in enumerate(self._statuswords) if state_of(word) is State.FAULT]
            self.errors = {number: self.error(number) for number in faulty}

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
            SdoTransferError: The drive does not answer, or not now.
        """
        index = self._asked[number]
        if index is None:
            return None
        try:
            return 0.1 * read(self.nodes[number], index, signed=True)
        except SdoTransferError as failure:
            if failure.code not in (NO_OBJECT, NO_SUB_INDEX):
                raise
            self._asked[number] = None
            self.warnings.append(
                f"node {self.arm.axes[number].node_id} has no object 0x{index:04X}: no temperature is published; "
                "correct temperature_object in the CAN YAML, or leave it out"
            )
            return None

    def error_code(self, number: int) -> int | None:
        """Error code (0x603F) of an axis; None where the drive has no such object. Beside a running cycle.

        Args:
            number: Of the axis.

        Raises:
            SdoTransferError: The drive does not answer.
        """
        return read_if_there(self.nodes[number], 0x603F)

    def error(self, number: int) -> str:
        """What an axis in fault says of it, for a person: error code, and the EMCY that was heard.

        Args:
            number: Of the axis.
        """
        node_id = self.arm.axes[number].node_id
        try:
            code = self.error_code(number)
        except SdoTransferError:
            code = None
        said = "gives no error code (0x603F)"
        if code is not None:
            kind = EmcyError(code, 0, b"", 0.0).get_desc()
            said = f"has error code 0x{code:04X} (0x603F{kind and f': {kind}'})"
        heard = f", EMCY: {self.emergencies[number]}" if number in self.emergencies else ""
        return f"node {node_id} {said}{heard}"

    def prepare(self, number: int) -> None:
        """Set a drive up for being enabled, and make sure that it will hold its joint; beside a running cycle.

        The position limits 0x607D are written so that they contain where the joint stands, for a drive that keeps its
        target within them would move as it is enabled; the mode of operation is written and read back.

        Args:
            number: Of the axis.

        Raises:
            UserError: The drive does not answer, refuses one of them, or is in another mode.
        """
        axis, node = self.arm.axes[number], self.nodes[number]
        self.counts[number] = self._position(number)
        try:
            if (number, 0x607D) not in self._refused:
                for item in position_limits(axis, int(self.counts[number])):
                    write(node, item)
            write(node, SdoWrite(0x6060, 0, self.arm.mode, 1))
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} cannot be configured: {failure}") from failure
        self.check_mode(number)

    def check_mode(self, number: int) -> None:
        """Make sure that a drive is in the mode of operation that it was told; beside a running cycle.

        Args:
            number: Of the axis.

        Raises:
            UserError: It is in another one (0x6061) for `MODE_CHANGE`, or does not say.
        """
        axis, node = self.arm.axes[number], self.nodes[number]
        deadline = time.monotonic() + MODE_CHANGE
        try:
            while (mode := read(node, 0x6061, signed=True)) != self.arm.mode:
                if time.monotonic() > deadline:
                    raise UserError(
                        f"node {axis.node_id} is in mode of operation {mode}{_mode_name(mode)} (0x6061), wanted is "
                        f"{self.arm.mode}{_mode_name(self.arm.mode)}: see in the drive's own tool what holds it there; "
                        "'mode' under 'cycle' in the CAN YAML may be 8 or 7"
                    )
                time.sleep(0.01)
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} does not say its mode: {failure}") from failure

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
            self._nmt(axis, RESET_COMMUNICATION)
        while not wanted <= self._booted:
            if time.monotonic() > deadline:
                missing = ", ".join(f"{node} on {self.buses[bus]}" for bus, node in sorted(wanted - self._booted))
                raise UserError(f"no boot-up message of node {missing}: check power, wiring, bit rate and node ids")
            time.sleep(0.002)

    def _identify(self, axis: Axis, node: canopen.RemoteNode) -> None:
        try:
            kind = read(node, 0x1000) & 0xFFFF
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} cannot be configured: {failure}") from failure
        if kind != CIA_402:
            raise UserError(f"node {axis.node_id} is a CiA {kind} device, not a CiA 402 drive: check its id")

    def _stop(self, axis: Axis, node: canopen.RemoteNode) -> None:
        """Stop a drive that another master has left in operation."""
        if state_of(self._statusword(axis, node)) is State.OPERATION_ENABLED:
            self._command(axis, node, Command.QUICK_STOP)

    def _take_power_off(self, number: int) -> None:
        """Wait until a drive is at rest, then out of power: nothing is configured under power."""
        axis, node = self.arm.axes[number], self.nodes[number]
        deadline = time.monotonic() + POWER_OFF
        while (state := state_of(self._statusword(axis, node))) is not None and state.powered:
            if time.monotonic() > deadline:
                raise UserError(
                    f"node {axis.node_id} was found in {state.label} and stays under power: end the program that has "
                    "enabled it, or take its power off"
                )
            before = self._position(number)
            time.sleep(REST_INTERVAL)
            moved = abs((self._position(number) - before) * axis.scale.rad_per_count)
            if state is not State.FAULT_REACTION_ACTIVE and moved < STANDSTILL * REST_INTERVAL:
                self._command(axis, node, Command.DISABLE_VOLTAGE)

    def _command(self, axis: Axis, node: canopen.RemoteNode, command: Command) -> None:
        try:
            write(node, SdoWrite(0x6040, 0, command.value, 2))
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} cannot be stopped: {failure}") from failure

    def _position(self, number: int) -> int:
        try:
            return read(self.nodes[number], 0x6064, signed=True)
        except SdoTransferError as failure:
            raise UserError(f"node {self.arm.axes[number].node_id} does not say where it is: {failure}") from failure

    def _configure(self, number: int) -> None:
        axis, node = self.arm.axes[number], self.nodes[number]
        self.doing = f"configuring node {axis.node_id}"
        try:
            for item in required_writes(axis, self.arm):
                write(node, item)
            self.counts[number] = self._position(number)
            self._note_own_limits(number)
            self._note_polarity(number)
            for item in optional_writes(axis, self.arm, int(self.counts[number])):
                try:
                    write(node, item)
                except SdoTransferError as failure:
                    if failure.code is None:
                        raise
                    self._refused.add((number, item.index))
                    self.warnings.append(f"node {axis.node_id}: {failure}; the driver goes on without")
            self._compare_rated(axis, node)
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} cannot be configured: {failure}") from failure

    def _note_own_limits(self, number: int) -> None:
        """Say where a drive's own position limits are narrower than those it will be given."""
        axis, node = self.arm.axes[number], self.nodes[number]
        own = [read_if_there(node, 0x607D, sub, signed=True) for sub in (1, 2)]
        low, high = (item.value for item in position_limits(axis, int(self.counts[number])))
        # Equal ends, as zero and zero, mean that there is no limit.
        if own[0] is None or own[1] is None or own[0] >= own[1] or (own[0] <= low and own[1] >= high):
            return
        self.widened[number] = (
            f"node {axis.node_id}: its own position limits (0x607D) were {_range(axis, own[0], own[1])}; the driver "
            f"sets {_range(axis, low, high)}, which is wider: take the drive's into the arm YAML (or the joint's "
            "position_lower_rad and position_upper_rad in the CAN YAML) if they are meant"
        )

    def _note_polarity(self, number: int) -> None:
        """Say where a drive inverts its positions or velocities by itself."""
        node_id = self.arm.axes[number].node_id
        polarity = read_if_there(self.nodes[number], 0x607E)
        if polarity:
            self.warnings.append(
                f"node {node_id} has polarity 0x{polarity & 0xFF:02X} (0x607E): it inverts by itself, so direction and "
                "torque_sign are right only if they were found with it; set it to 0, or check both"
            )

    def _statusword(self, axis: Axis, node: canopen.RemoteNode) -> int:
        try:
            return read(node, 0x6041) & 0xFFFF
        except SdoTransferError as failure:
            raise UserError(f"node {axis.node_id} does not report its state: {failure}") from failure

    def _compare_rated(self, axis: Axis, node: canopen.RemoteNode) -> None:
        index, unit = (0x6076, "N·m") if axis.scale.torque_source == "rated_torque" else (0x6075, "A")
        raw = read_if_there(node, index)
        if raw is None:
            return
        rated = 1e-3 * raw
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
            over = entry.code & 0xFF00 == 0
            text = f"node {node_id} reports {entry} (error register 0x{entry.register:02X})"
            if over:
                self.emergencies.pop(number, None)
            else:
                self.emergencies[number] = text
            if self._cycle is None:
                return
            if over:
                self._cycle.report(EventKind.EMERGENCY_OVER, number, f"node {node_id} reports no error left")
            else:
                kind = EventKind.MASTER_MISSED if entry.code == HEARTBEAT_ERROR else EventKind.EMERGENCY
                self._cycle.report(kind, number, text)

        return report


def _mode_name(mode: int) -> str:
    return f", {MODES[mode]}" if mode in MODES else ""


def _range(axis: Axis, low: int, high: int) -> str:
    """A range of counts for a person, in rad and counts."""
    ends = sorted((count - axis.scale.zero_counts) * axis.scale.rad_per_count for count in (low, high))
    return f"{ends[0]:.4g} to {ends[1]:.4g} rad ({low} to {high} counts)"
