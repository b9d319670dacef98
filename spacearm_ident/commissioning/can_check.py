"""Whether a CAN configuration fits the arm, the drives' data sheet and the buses of this machine."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import can
import canopen
from canopen.objectdictionary import ODVariable

from ..canbus.arm_bus import ArmBus, optional_writes, required_writes
from ..canbus.cycle import HEARTBEAT
from ..canbus.eds import eds_path
from ..canbus.pdo import SYNC, Field, SdoWrite
from ..driver.arm_can import ArmCan, load_arm_can
from ..dynamics.arm import Arm, load_arm
from ..errors import UserError
from .result import CheckResult, fail, ok, warn
from .yaml_file import empty_keys, read_yaml, to_fill_in

FULL: Final = 0.9
"""Worst-case load above which a bus has no room for a repeated frame or a diagnosis."""
CIA_402: Final = 402
SUPPORTED_MODES: Final = 0x6502
"""Supported drive modes: bit n - 1 is mode n (CiA 402-2)."""
LISTEN_S: Final = 0.25
LARGEST_OVERLOAD: Final = 10.0
"""Times its rated torque that a drive may be asked for before a unit is suspected."""


def check_can(path: Path, arm_file: Path | None = None) -> list[CheckResult]:
    """All checks of a CAN configuration; `arm_file` is the arm it should be of.

    Args:
        path: The CAN file, YAML.
        arm_file: Arm file that the user checks beside it; a CAN file of another arm is warned of. None: not compared.

    Returns:
        One result only where the file has empty keys or cannot be loaded, else those of all checks.
    """
    try:
        data = read_yaml(path)
        if empty := empty_keys(data):
            return [to_fill_in("CAN file", path, data, empty)]
        config = load_arm_can(path)
    except UserError as error:
        return [fail("CAN file", str(error), "correct it; config/paper_arm_can.yaml is an example")]
    named = path.parent / str(data["arm"])
    return [
        ok("CAN file", f"{len(config.bus.axes)} drives on {len(config.buses)} buses, {1 / config.bus.period:g} Hz"),
        *_of_the_arm(config.arm, named, arm_file),
        *_rated(config),
        *check_eds(config.bus, config.eds, path),
        *_loads(config.bus),
        *(result for number, _ in enumerate(config.buses) for result in _reach(config, number)),
    ]


def _of_the_arm(arm: Arm, named: Path, arm_file: Path | None) -> Iterator[CheckResult]:
    if arm_file is not None and arm_file.resolve() != named.resolve():
        yield warn("CAN and arm", f"the CAN file is of {named}, not of {arm_file}", "check that both are the same arm")
    wider = [
        ours.name
        for ours, theirs in zip(arm.joints, load_arm(named).joints)
        if ours.lower < theirs.lower
        or ours.upper > theirs.upper
        or ours.velocity_limit > theirs.velocity_limit
        or ours.acceleration_limit > theirs.acceleration_limit
        or ours.effort_limit > theirs.effort_limit
    ]
    if wider:
        yield warn(
            "CAN and arm",
            f"limits of {', '.join(wider)} are wider in the CAN file, and those the driver keeps",
            "leave them to the arm YAML",
        )


def _rated(config: ArmCan) -> Iterator[CheckResult]:
    """The torque limit in terms of what the drive can report and is rated for."""
    shares = {}
    for joint, axis in zip(config.arm.joints, config.bus.axes):
        scale = axis.scale
        motor = scale.rated * (1.0 if scale.torque_source == "rated_torque" else scale.torque_constant)
        shares[joint.name] = joint.effort_limit / (motor * scale.peak_factor * scale.gear_ratio)
    odd = {name: share for name, share in shares.items() if not 1 / LARGEST_OVERLOAD < share < LARGEST_OVERLOAD}
    if odd:
        text = ", ".join(f"{name} {share:.3g}" for name, share in odd.items())
        yield warn(
            "torque scale",
            f"the torque limit is this many times the rated torque: {text}",
            "check rated_current_A (A, not mA), torque_constant_Nm_per_A, gear_ratio and torque_limit_Nm",
        )
    else:
        text = f"{min(shares.values()):.2g} to {max(shares.values()):.2g}"
        yield ok("torque scale", f"torque limits are {text} times the rated torques")


def check_eds(bus: ArmBus, eds: str, path: Path) -> Iterator[CheckResult]:
    """Whether the drive of a data sheet has what the cycle needs: CiA 402 objects, PDO mapping, watchdogs.

    Args:
        bus: What the drives will be told.
        eds: The data sheet, as `eds_path` finds it.
        path: Of the CAN file, beside which the data sheet should be.
    """
    try:
        file = eds_path(eds)
        dictionary = canopen.import_od(str(file), node_id=bus.axes[0].node_id)
    except UserError as error:
        yield fail("EDS", str(error), "put the drives' EDS beside the CAN file and name it there as 'eds'")
        return
    except Exception as error:  # the library trusts its input: whatever a broken file leads to
        yield fail("EDS", f"{eds} cannot be read ({type(error).__name__}: {error})", "ask the maker for a sound one")
        return
    if file.parent.resolve() != path.parent.resolve():
        yield warn("EDS", f"{file} is not beside the CAN file: is it that of your drives?", "put yours there as 'eds'")
    kind = _find(dictionary, 0x1000, 0)
    number = int(kind.default or 0) & 0xFFFF if kind is not None else 0
    if number and number != CIA_402:
        yield fail("EDS", f"{file.name} is of a CiA {number} device", "the drives must be CiA 402")
    axis = bus.axes[0]
    lacking = [
        *_lacking(dictionary, required_writes(axis, bus)),
        *_unmappable(dictionary, (*bus.feedback.fields, *bus.set_point.fields)),
    ]
    modes = _find(dictionary, SUPPORTED_MODES, 0)
    supported = None if modes is None or modes.default is None else int(modes.default)
    if lacking:
        yield fail(
            "EDS",
            f"{file.name} does not allow {', '.join(lacking)}",
            "the cycle needs them: another firmware, `slim` or `mode` in the CAN file, or another drive",
        )
    elif supported and not supported >> (bus.mode - 1) & 1:
        yield warn(
            "EDS",
            f"{file.name} does not list mode {bus.mode} as supported (0x6502 is 0x{supported:X} by default)",
            "see in the drive's manual whether it has the mode; 'mode' in the CAN file may be 8 or 7",
        )
    else:
        yield ok("EDS", f"{file.name}: PDO mapping, SYNC, heartbeats, mode {bus.mode} and interpolation time are there")
    polarity = _find(dictionary, 0x607E, 0)
    if polarity is not None and polarity.default:
        yield warn(
            "EDS",
            f"{file.name} sets polarity 0x607E to 0x{int(polarity.default):02X}: the drive inverts by itself",
            "set it to 0, or find direction and torque_sign with it",
        )
    if without := _lacking(dictionary, optional_writes(axis, bus)):
        yield warn(
            "EDS",
            f"{file.name} does not allow {', '.join(without)}",
            "the drive itself will not watch that: see the limits and windows in its own set-up",
        )


def _find(dictionary: canopen.ObjectDictionary, index: int, sub: int) -> ODVariable | None:
    try:
        entry: Any = dictionary[index]
        return entry if isinstance(entry, ODVariable) else entry[sub]
    except KeyError:
        return None


def _lacking(dictionary: canopen.ObjectDictionary, writes: Sequence[SdoWrite]) -> list[str]:
    """Objects that cannot be written as they would be."""
    found = []
    for write in writes:
        variable, name = _find(dictionary, write.index, write.sub), f"0x{write.index:04X}:{write.sub}"
        if variable is None:
            found.append(f"{name} (missing)")
        elif not variable.writable:
            found.append(f"{name} ({variable.access_type})")
        elif len(variable) != 8 * write.size:
            found.append(f"{name} ({len(variable)} bits, not {8 * write.size})")
    return list(dict.fromkeys(found))


def _unmappable(dictionary: canopen.ObjectDictionary, fields: Sequence[Field]) -> list[str]:
    """Objects that cannot be in a PDO as they would have to be."""
    found = []
    for field in fields:
        variable, name = _find(dictionary, field.index, field.sub), f"0x{field.index:04X}:{field.sub} in a PDO"
        if variable is None:
            found.append(f"{name} (missing)")
        elif not variable.pdo_mappable:
            found.append(f"{name} (PDOMapping=0)")
        elif len(variable) != field.bits:
            found.append(f"{name} ({len(variable)} bits, not {field.bits})")
    return found


def _loads(bus: ArmBus) -> Iterator[CheckResult]:
    for number, load in enumerate(bus.loads()):
        if load.worst > FULL:
            yield warn(f"bus {number} load", str(load), "use more buses, a longer period, or slim: true")
        else:
            yield ok(f"bus {number} load", str(load))


def _reach(config: ArmCan, number: int) -> Iterator[CheckResult]:
    """Open a bus and listen; nothing is sent."""
    address, subject = config.buses[number], f"bus {number}"
    where = f"{address.interface} '{address.channel}'"
    try:
        bus = config.open_one(address)
    except UserError as error:
        message, _, hint = str(error).rpartition(": ")
        yield fail(subject, message or str(error), hint)
        return
    with bus:
        nodes, master, errors = _listen(bus, config.bus.master_id)
    if errors:
        yield warn(subject, f"{where} carries error frames", "check bit rate, termination and wiring")
    elif master:
        yield warn(subject, f"{where}: another master is active", "one driver a bus: stop it before you start another")
    elif nodes:
        yield ok(subject, f"{where}: found nodes {', '.join(map(str, sorted(nodes)))}")
    else:
        yield ok(subject, f"{where} opens; it is silent, as it is before a driver configures the drives")


def _listen(bus: can.BusABC, master_id: int) -> tuple[set[int], bool, bool]:
    """Nodes whose heartbeat was heard, whether a master was, whether there were error frames."""
    nodes: set[int] = set()
    master = errors = False
    end = time.monotonic() + LISTEN_S
    while (left := end - time.monotonic()) > 0:
        message = bus.recv(left)
        if message is None:
            continue
        if message.is_error_frame:
            errors = True
            continue
        can_id = message.arbitration_id
        master |= can_id in (SYNC, HEARTBEAT + master_id)
        if can_id & ~0x7F == HEARTBEAT and can_id & 0x7F != master_id:
            nodes.add(can_id & 0x7F)
    return nodes, master, errors
