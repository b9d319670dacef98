"""`ArmCan`: an arm and its drives, read from an arm YAML and a CAN YAML (`spacearm_ident/can/1`).

The arm YAML says what the joints are (gear ratio, torque constant, limits), the CAN YAML how their drives are
wired and how they count. Limits given here override those of the arm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import can
import numpy as np

from spacearm_ident.canbus.arm_bus import EXTRAPOLATION, SDO_TIMEOUT, ArmBus, Axis
from spacearm_ident.canbus.bus_load import BitRate
from spacearm_ident.canbus.open_bus import open_bus
from spacearm_ident.canbus.pdo import FEEDBACK, SET_POINT, SLIM_FEEDBACK, SLIM_SET_POINT
from spacearm_ident.canbus.scaling import JointScale
from spacearm_ident.documents import read_yaml
from spacearm_ident.driver.safety import Limits
from spacearm_ident.dynamics.arm import Arm, Joint, load_arm
from spacearm_ident.errors import UserError

CAN_SCHEMA: Final = "spacearm_ident/can/1"
#: Tracking error allowed where none is given: what the joint covers in this time at its velocity limit, s.
TRACKING_TIME: Final = 0.05
#: The drive's own following-error window, as a multiple of the driver's, so that the driver's comes first.
DRIVE_WINDOW: Final = 2.0
#: Deceleration of the drives' quick stop, as a multiple of the acceleration limit.
QUICK_STOP: Final = 3.0
_TOP: Final = {"schema", "arm", "eds", "bitrate", "data_bitrate", "buses", "cycle", "joints"}
_CYCLE: Final = {"period_s", "set_point_divider", "slim", "mode", "heartbeat_s", "heartbeat_timeout_s"}
_LIMITS: Final = {
    "position_lower_rad": "lower",
    "position_upper_rad": "upper",
    "velocity_limit_rad_s": "velocity_limit",
    "acceleration_limit_rad_s2": "acceleration_limit",
    "torque_limit_Nm": "effort_limit",
}
_SCALE: Final = {"counts_per_turn", "peak_factor", "direction", "torque_sign", "zero_counts"}
_RATED: Final = {"rated_current_A": "rated_current", "rated_torque_Nm": "rated_torque"}
_JOINT: Final = {
    *("bus", "node", "tracking_error_rad", "temperature_object", "quick_stop_unit"),
    *(*_SCALE, *_RATED, *_LIMITS),
}


@dataclass(frozen=True)
class BusAddress:
    """Where a bus is: python-can's interface, and the channel there."""

    interface: str
    channel: str


@dataclass(frozen=True)
class ArmCan:
    """An arm and its drives.

    Attributes:
        arm: What is known of the arm, its limits as in force here.
        buses: Addresses of its buses.
        bus: What the master is told.
        limits: What the safety policy checks.
        eds: Data sheet of the drives.
    """

    arm: Arm
    buses: tuple[BusAddress, ...]
    bus: ArmBus
    limits: Limits
    eds: str = "spacearm_drive.eds"

    def open_one(self, address: BusAddress) -> can.BusABC:
        """Open one of the buses at the arm's bit rates.

        Args:
            address: One of `buses`.

        Raises:
            UserError: It cannot be opened.
        """
        rate = self.bus.bit_rate
        options: dict[str, Any] = {"bitrate": round(rate.nominal), "fd": rate.data is not None}
        if rate.data is not None:
            options["data_bitrate"] = round(rate.data)
        return open_bus(address.interface, address.channel, **options)

    def open(self) -> list[can.BusABC]:
        """Open all buses.

        Raises:
            UserError: One cannot be opened.
        """
        opened: list[can.BusABC] = []
        try:
            for address in self.buses:
                opened.append(self.open_one(address))
        except UserError:
            for bus in opened:
                bus.shutdown()
            raise
        return opened


def load_arm_can(path: Path) -> ArmCan:
    """Read a CAN YAML and the arm YAML it names.

    Raises:
        UserError: A file is missing or not understood; the message says which key. Also where a bus would be
            overloaded.
    """
    data = read_yaml(path, "the CAN configuration")
    if not isinstance(data, dict) or data.get("schema") != CAN_SCHEMA:
        raise UserError(f"{path} is no CAN configuration of an arm: it should begin with 'schema: {CAN_SCHEMA}'")
    _known(data, _TOP, str(path))
    if "arm" not in data:
        raise UserError(f"{path}: the key 'arm' is missing: name the arm YAML")
    arm = load_arm(path.parent / str(data["arm"]))
    if arm.empty:
        raise UserError(
            f"{path.parent / str(data['arm'])}: {arm.empty[0]} is still empty: fill it in (spacearm check lists all "
            "that is missing)"
        )
    if np.any(arm.effort_scale != 1.0):
        raise UserError(f"{path}: {data['arm']} declares a unit of effort, but this driver publishes N·m: remove it")
    try:
        return _build(data, arm, path)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise UserError(f"{path}: {type(error).__name__} {error}: a key is missing or of the wrong kind") from error


def _build(data: Mapping[str, Any], arm: Arm, path: Path) -> ArmCan:
    given: Mapping[str, Any] = data["joints"]
    if set(given) != set(arm.joint_names):
        odd = sorted(set(given) ^ set(arm.joint_names), key=str)[0]
        raise UserError(f"{path}: joint {odd!r} is not in both the arm and the CAN configuration")
    for name, keys in given.items():
        _known(keys, _JOINT, f"{path}: {name}")
        if empty := [key for key, value in keys.items() if value is None]:
            raise UserError(f"{path}: {name}: {empty[0]} is still empty: fill it in (spacearm check lists all)")
    joints = tuple(_limited(joint, given[joint.name]) for joint in arm.joints)
    arm = replace(arm, joints=joints)
    axes = tuple(_axis(joint, given[joint.name], f"{path}: {joint.name}") for joint in joints)
    buses = tuple(BusAddress(str(bus["interface"]), str(bus["channel"])) for bus in data["buses"])
    if any(not 0 <= axis.bus < len(buses) for axis in axes):
        raise UserError(f"{path}: a joint is on a bus that is not listed under 'buses' (the first is bus 0)")
    fast = data.get("data_bitrate")
    rate = BitRate(float(data.get("bitrate", 1e6)), None if fast is None else float(fast))
    bus = _arm_bus(axes, data.get("cycle") or {}, rate, str(path))
    if bus.buses != len(buses):
        raise UserError(f"{path}: no joint is on bus {len(buses) - 1}: remove it from 'buses'")
    bus.loads()
    tracking = np.array([_tracking(joint, given[joint.name]) for joint in joints])
    limits = Limits.of_arm(arm, tracking)
    return ArmCan(arm, buses, bus, limits, _eds(path, str(data.get("eds", "spacearm_drive.eds"))))


def _arm_bus(axes: tuple[Axis, ...], cycle: Mapping[str, Any], rate: BitRate, where: str) -> ArmBus:
    _known(cycle, {*_CYCLE, "stale_feedback_s", "extrapolation_s", "sdo_timeout_s"}, f"{where}: cycle")
    period = float(cycle.get("period_s", 1e-3))
    slim = bool(cycle.get("slim", False))
    return ArmBus(
        axes,
        period=period,
        set_point_divider=int(cycle.get("set_point_divider", 1)),
        mode=int(cycle.get("mode", 8)),
        feedback=SLIM_FEEDBACK if slim else FEEDBACK,
        set_point=SLIM_SET_POINT if slim else SET_POINT,
        answer_time=0.9 * period,
        heartbeat=float(cycle.get("heartbeat_s", 0.05)),
        heartbeat_timeout=float(cycle.get("heartbeat_timeout_s", 0.25)),
        stale_cycles=max(2, round(float(cycle.get("stale_feedback_s", 0.05)) / period)),
        extrapolation=float(cycle.get("extrapolation_s", EXTRAPOLATION)),
        sdo_timeout=float(cycle.get("sdo_timeout_s", SDO_TIMEOUT)),
        bit_rate=rate,
    )


def _limited(joint: Joint, keys: Mapping[str, Any]) -> Joint:
    values: dict[str, Any] = {field: float(keys[key]) for key, field in _LIMITS.items() if key in keys}
    return replace(joint, **values)


def _axis(joint: Joint, keys: Mapping[str, Any], where: str) -> Axis:
    rated = [key for key in _RATED if key in keys]
    if len(rated) != 1:
        raise UserError(f"{where}: give either rated_current_A or rated_torque_Nm: what 1000 per mille stands for")
    scale = JointScale(
        counts_per_turn=float(keys["counts_per_turn"]),
        gear_ratio=joint.gear_ratio,
        torque_constant=joint.torque_constant,
        rated=float(keys[rated[0]]),
        torque_source="rated_torque" if _RATED[rated[0]] == "rated_torque" else "rated_current",
        peak_factor=float(keys.get("peak_factor", 1.0)),
        direction=int(keys.get("direction", 1)),
        torque_sign=int(keys.get("torque_sign", 1)),
        zero_counts=int(keys.get("zero_counts", 0)),
    )
    stop = QUICK_STOP * joint.acceleration_limit
    window = DRIVE_WINDOW * _tracking(joint, keys)
    warm = keys.get("temperature_object")
    if warm is not None and not 0x2000 <= int(warm) <= 0x5FFF:
        raise UserError(f"{where}: temperature_object is 0x{int(warm):X}: a maker's objects are 0x2000 to 0x5FFF")
    return Axis(
        int(keys["node"]),
        scale,
        bus=int(keys["bus"]),
        limits=(joint.lower, joint.upper),
        following_error=window,
        quick_stop_deceleration=stop if np.isfinite(stop) else 20.0,
        temperature_object=None if warm is None else int(warm),
        quick_stop_unit=str(keys.get("quick_stop_unit", "counts/s2")),
    )


def _tracking(joint: Joint, keys: Mapping[str, Any]) -> float:
    value = float(keys.get("tracking_error_rad", TRACKING_TIME * joint.velocity_limit))
    if not value > 0:
        raise UserError(f"tracking_error_rad of {joint.name} is {value}: give a positive number")
    return value


def _eds(path: Path, name: str) -> str:
    beside = path.parent / name
    return str(beside) if beside.is_file() else name


def _known(data: Mapping[str, Any], keys: set[str], where: str) -> None:
    unknown = set(data) - keys
    if unknown:
        raise UserError(f"{where}: unknown key {sorted(unknown, key=str)[0]!r}")
