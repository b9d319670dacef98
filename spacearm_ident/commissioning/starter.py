"""The files of a new arm: arm, CAN and node YAML, commented, and live views, from a URDF and the drives' data sheet.

Where the URDF says something it is taken and marked `URDF`. What can be guessed cautiously is marked `ASSUMED`. What
cannot be guessed (gear ratios, torque constants, what a drive's per mille stand for) is left empty and marked
`FILL IN`: what needs an empty value refuses it by its name, and `spacearm check` lists them all. Nothing of that is
asked where the arm's own driver publishes torque: then there is no CAN file, and no drive's constants.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import yaml

from ..canbus.bus_load import BusLoad, Traffic, bus_load
from ..documents import parse_xml
from ..driver.arm_can import CAN_SCHEMA
from ..dynamics.arm import ARM_SCHEMA, Arm, Joint
from ..dynamics.demand import torque_asked
from ..errors import UserError
from .layouts import FOXGLOVE, PLOTJUGGLER, foxglove_layout, plotjuggler_layout

ARM_FILE: Final = "arm.yaml"
CAN_FILE: Final = "arm_can.yaml"
NODES_FILE: Final = "arm_nodes.yaml"
CAUTIOUS_VELOCITY: Final = {True: 0.5, False: 0.05}
"""Velocity limit where the URDF has none, by whether the joint turns: rad/s or m/s."""
CAUTIOUS_TRAVEL: Final = {True: math.pi, False: 0.25}
"""Position limit to either side where the URDF has none: half a turn, for the cables' sake; a quarter of a metre."""
TORQUE_RESERVE: Final = 2.0
"""Torque limit where the URDF has none, over what the CAD links ask (`dynamics.demand`), for friction and rotors."""
PLACEHOLDER_RATIO: Final = 1.0
"""Reduction of a URDF's transmission that is not taken for the gear ratio: most URDFs state 1, because
ros_control required a transmission."""
UP_TO_SPEED_S: Final = 0.5
"""Acceleration limit: the velocity limit in so long, as `spacearm excite` assumes."""
COMFORTABLE: Final = 0.85
"""Worst-case load a bus is filled to."""
MOST_BUSES: Final = 4
HEARTBEAT_HZ: Final = 20.0
_CHANNELS: Final = {"socketcan": "can", "local": "arm"}

_HEAD = "# URDF: taken from there. ASSUMED: cautious default, to be reviewed. FILL IN: needed, and has no default."


SIMULATED_EDS = "spacearm_drive.eds"
"""Data sheet of the simulated drive."""


@dataclass(frozen=True)
class DataSheet:
    """What the makers of gears, motors and drives say; each a number for all joints, one a joint, or none.

    Attributes:
        gear_ratio: Motor turns a joint turn.
        torque_constant: N·m/A at the motor.
        rated_current: A: what 1000 per mille of 0x6077 stand for.
        rated_torque: N·m of the motor: the same of drives that count in rated torque.
        counts_per_turn: Encoder counts a motor turn.
    """

    gear_ratio: Sequence[float] = field(default=())
    torque_constant: Sequence[float] = field(default=())
    rated_current: Sequence[float] = field(default=())
    counts_per_turn: Sequence[float] = field(default=())
    rated_torque: Sequence[float] = field(default=())

    def of(self, key: str, joint: int, joints: int) -> float | None:
        """The value for a joint; None where it is not known.

        Args:
            key: Name of an attribute, such as `gear_ratio`; its unit is that of the result.
            joint: Index of the joint, from 0.
            joints: Number of joints of the arm.

        Raises:
            UserError: Neither one value nor one a joint, or a value that is not above zero.
        """
        values: Sequence[float] = getattr(self, key)
        option = f"--{key.replace('_', '-')}"
        if not values:
            return None
        if len(values) not in (1, joints):
            raise UserError(f"{option} has {len(values)} numbers: give one, or one for each of the {joints} joints")
        value = values[joint % len(values)]
        if not (math.isfinite(value) and value > 0):
            raise UserError(f"{option} {value:g} must be above zero")
        return value


@dataclass(frozen=True)
class Entry:
    """One `key: value  # comment` of a joint; without a value it is to be filled in."""

    key: str
    value: float | int | None
    comment: str

    def __str__(self) -> str:
        if self.value is None:
            return f"    {self.key}:  # FILL IN: {self.comment}"
        return f"    {self.key}: {self.value:.10g}  # {self.comment}"


def starter_files(
    arm: Arm,
    urdf: str,
    eds: str | None,
    sheet: DataSheet,
    directory: Path,
    interface: str = "socketcan",
    *,
    canopen: bool = True,
    start: Sequence[float] | None = None,
    package_path: Sequence[str] = (),
) -> Mapping[str, str]:
    """Names and texts of the files.

    Args:
        arm: As the URDF describes it.
        urdf: Name of the URDF, in `directory`.
        eds: Name of the drives' data sheet, in `directory`; None: the simulated drive's stands in.
        sheet: What is known of gears, motors and drives.
        directory: Where the files will be; the nodes' parameters name it.
        interface: python-can's, or `local` for the simulated arm.
        canopen: Whether this package's driver is to drive the arm: its constants and a CAN file are asked for.
        start: (n,) posture of rest, rad or m; None: none is known.
        package_path: Folders in which the URDF's meshes are.

    Raises:
        UserError: The numbers of the sheet do not fit the arm.
    """
    files = {ARM_FILE: _arm_yaml(arm, urdf, sheet, canopen, start, package_path)}
    if canopen:
        files[CAN_FILE] = _can_yaml(arm, eds, sheet, interface)
    return files | {
        NODES_FILE: _nodes_yaml(directory, canopen),
        FOXGLOVE: foxglove_layout(arm.joint_names),
        PLOTJUGGLER: plotjuggler_layout(arm.name, arm.joint_names),
    }


def completed(arm: Arm) -> Arm:
    """The arm with a limit for everything that its description does not limit; `_joint_entries` marks those."""
    joints = []
    for joint in arm.joints:
        velocity = joint.velocity_limit
        velocity = velocity if math.isfinite(velocity) else CAUTIOUS_VELOCITY[joint.revolute]
        travel = CAUTIOUS_TRAVEL[joint.revolute]
        lower, upper = (joint.lower, joint.upper) if _has_travel(joint) else (-travel, travel)
        acceleration = min(joint.acceleration_limit, velocity / UP_TO_SPEED_S)
        joints.append(
            replace(joint, lower=lower, upper=upper, velocity_limit=velocity, acceleration_limit=acceleration)
        )
    arm = replace(arm, joints=tuple(joints))
    asked = TORQUE_RESERVE * torque_asked(arm)
    limits = [
        joint.effort_limit if math.isfinite(joint.effort_limit) or not most > 0 else float(f"{most:.2g}")
        for joint, most in zip(arm.joints, asked)
    ]
    return replace(arm, joints=tuple(replace(joint, effort_limit=limit) for joint, limit in zip(arm.joints, limits)))


def _has_travel(joint: Joint) -> bool:
    """Whether its position limits leave it room: many URDFs give only `effort` and `velocity`, which leaves 0 to 0."""
    return math.isfinite(joint.upper - joint.lower) and joint.upper > joint.lower


def gear_ratios(urdf: str) -> dict[str, float]:
    """Joint -> reduction, where the URDF has `<transmission>` elements that say one other than the placeholder."""
    found = {}
    for transmission in parse_xml(urdf, "the URDF").iter("transmission"):
        texts = [item.text for item in transmission.iter("mechanicalReduction") if item.text]
        joints = [item.get("name") for item in transmission.iter("joint")]
        try:
            ratio = abs(float(texts[0])) if len(texts) == 1 and len(joints) == 1 else 0.0
        except ValueError:
            continue
        if ratio not in (0.0, PLACEHOLDER_RATIO) and joints[0]:
            found[joints[0]] = ratio
    return found


def _arm_yaml(
    arm: Arm, urdf: str, sheet: DataSheet, canopen: bool, start: Sequence[float] | None, package_path: Sequence[str]
) -> str:
    full = completed(arm)
    reductions = gear_ratios(arm.urdf)
    lines = [
        f"# Data of {arm.name} before it is identified; everything on the output side of the gears, SI.",
        _HEAD,
        f"schema: {ARM_SCHEMA}",
        f"urdf: {_quoted(urdf)}  # kinematics, and CAD inertials as prior",
    ]
    if package_path:
        lines.append(f"package_path: [{', '.join(map(_quoted, package_path))}]  # where its meshes are")
    lines += [
        "gravity_m_s2: [0, 0, -9.81]  # ASSUMED: in the base frame; [0, 0, 0] in orbit",
        "joints:  # prismatic joints have m and N in place of rad and N m, under the same keys",
    ]
    for number, (joint, whole) in enumerate(zip(arm.joints, full.joints)):
        lines.append(f"  {_quoted(joint.name)}:" + ("" if joint.revolute else "  # prismatic"))
        if canopen:
            lines += map(str, _drive_entries(joint, number, len(arm.joints), sheet, reductions.get(joint.name)))
        lines += map(str, _limit_entries(joint, whole))
        if start is not None:
            lines.append(str(Entry("start_position_rad", start[number], "ASSUMED: rests here before and after a run")))
    lines += [
        "# A wrist whose last motor turns with two joints: [{name: motor_6, ratios: {joint_5: 1.0, joint_6: 1.0}}]",
        "couplings: []",
    ]
    return "\n".join(lines) + "\n"


def _drive_entries(joint: Joint, number: int, count: int, sheet: DataSheet, reduction: float | None) -> list[Entry]:
    gear = sheet.of("gear_ratio", number, count)
    return [
        Entry("gear_ratio", gear or reduction, "motor turns a joint turn" if gear or not reduction else "URDF"),
        Entry(
            "torque_constant_Nm_per_A", sheet.of("torque_constant", number, count), "at the motor, by its data sheet"
        ),
    ]


def _limit_entries(joint: Joint, whole: Joint) -> list[Entry]:
    """Limits of a joint, of which `whole` has those that its description lacks as well."""
    travel = "half a turn, for the cables' sake" if joint.revolute else "a short way"
    bounds = "URDF" if _has_travel(joint) else f"ASSUMED: no limit in the URDF; {travel}"
    if math.isfinite(joint.effort_limit):
        torque, source = whole.effort_limit, "URDF"
    elif math.isfinite(whole.effort_limit):
        torque, source = (
            whole.effort_limit,
            f"ASSUMED: {TORQUE_RESERVE:g} times the torque its CAD links need; URDF has none",
        )
    else:
        torque, source = None, "the most gear and motor bear"
    return [
        Entry("position_lower_rad", whole.lower, bounds),
        Entry("position_upper_rad", whole.upper, bounds),
        Entry(
            "velocity_limit_rad_s",
            whole.velocity_limit,
            "URDF" if math.isfinite(joint.velocity_limit) else "ASSUMED: the URDF has none",
        ),
        Entry(
            "acceleration_limit_rad_s2",
            whole.acceleration_limit,
            f"ASSUMED: up to speed in {UP_TO_SPEED_S:g} s",
        ),
        Entry("torque_limit_Nm", torque, source),
    ]


def _can_yaml(arm: Arm, eds: str | None, sheet: DataSheet, interface: str) -> str:
    count = len(arm.joints)
    buses, load = buses_for(count)
    each = -(-count // buses)
    simulated = interface == "local" and eds in (None, SIMULATED_EDS)
    channel = _CHANNELS.get(interface, "")
    lines = [
        f"# How the drives of {arm.name} are wired and how they count.",
        _HEAD,
        f"schema: {CAN_SCHEMA}",
        f"arm: {ARM_FILE}  # gear ratios, torque constants, limits",
        f"eds: {_quoted(eds)}"
        if eds
        else "eds: spacearm_drive.eds  # ASSUMED: that of the simulated drive; put yours beside this file and name it",
        "bitrate: 1000000  # ASSUMED",
        "# data_bitrate: 5000000  # CAN FD with bit-rate switch, where the drives have it",
        f"buses:  # ASSUMED: {each} axes a bus at 1 kHz load it {load}; the simulated arm: interface: local",
        *(f"- {{interface: {_quoted(interface)}, channel: {_quoted(f'{channel}{bus}')}}}" for bus in range(buses)),
        "cycle:",
        "  period_s: 0.001",
        "  set_point_divider: 1  # set-points with every how many-th SYNC",
        "  slim: false  # status word and controlword in frames of their own, for a full bus",
        "  mode: 8  # cyclic synchronous position; 7: interpolated position",
        "  heartbeat_s: 0.05",
        "  heartbeat_timeout_s: 0.25",
        "  stale_feedback_s: 0.05",
        "  extrapolation_s: 0.06  # ASSUMED: how long the drives extrapolate without set-points; 0: they stop at once",
        "# Further keys of a joint: rated_torque_Nm instead of rated_current_A where 0x6077 is per mille of the rated",
        "# torque; peak_factor (1.414 where the drive reports RMS and the torque constant is for peak), direction and",
        "# torque_sign (1 or -1), zero_counts (0x6064 at joint angle zero), tracking_error_rad, any limit of the arm,",
        "# quick_stop_unit (of 0x6085: counts/s2, which is the default, rpm/s of the motor, or none: not written).",
        "# torque_sign is within the drive: -1 where positive torque drives towards falling counts, whatever direction",
        "# is; temperature_object: the maker's object with the winding temperature (signed, 0.1 °C), or none is read.",
        "joints:",
    ]
    for number, joint in enumerate(arm.joints):
        lines += [
            f"  {_quoted(joint.name)}:",
            str(Entry("bus", number // each, "ASSUMED: number in the list of buses")),
            str(Entry("node", number + 1, "ASSUMED: CANopen node id")),
            str(Entry("counts_per_turn", sheet.of("counts_per_turn", number, count), "encoder counts a motor turn")),
            str(_rated(sheet, number, count)),
            *(["    temperature_object: 0x2000  # of the simulated drive"] if simulated else []),
        ]
    return "\n".join(lines) + "\n"


def _rated(sheet: DataSheet, joint: int, joints: int) -> Entry:
    """What 1000 per mille of 0x6077 stand for: a torque where one is given, else a current."""
    torque = sheet.of("rated_torque", joint, joints)
    if torque is not None:
        return Entry("rated_torque_Nm", torque, "motor torque at 1000 per mille of 0x6077")
    return Entry("rated_current_A", sheet.of("rated_current", joint, joints), "current at 1000 per mille of 0x6077")


def buses_for(axes: int) -> tuple[int, BusLoad]:
    """How many classical 1 Mbit/s buses carry so many axes at 1 kHz comfortably, and the fullest one's load."""
    traffic = Traffic(heartbeat_rate=HEARTBEAT_HZ)
    load = bus_load(traffic.frames(axes))
    for buses in range(1, min(axes, MOST_BUSES) + 1):
        load = bus_load(traffic.frames(-(-axes // buses)))
        if load.worst <= COMFORTABLE:
            break
    return buses, load


def _nodes_yaml(directory: Path, canopen: bool) -> str:
    arm, can = (_quoted(str(directory / name)) for name in (ARM_FILE, CAN_FILE))
    driver = _node("canopen_driver", f"can_config: {can}", "connect_timeout_s: 30.0  # 0: wait for the drives for ever")
    simulated = _node(
        "simulated_arm",
        f"can_config: {can}",
        f"# model: {directory / 'identified' / 'model.yaml'}  # once there is one: what the simulated arm obeys",
    )
    head = [
        "# Parameters of all nodes for this arm; `ros2 param describe /NODE NAME` explains one. They are used with",
        "# `spacearm node NODE --ros-args --params-file THIS_FILE`. `ros2 launch spacearm_ident spacearm.launch.py`",
        "# wants this file as `params:=`, and beside it `arm:=`, `can:=` and, with drives on the buses, `sim:=false`.",
    ]
    if not canopen:
        head = [
            "# Parameters of the nodes beside the arm's own driver: spacearm node NODE --ros-args --params-file FILE.",
            "# How the trajectory node talks to a controller, and what else it can wait for: docs/ros2_control.md.",
        ]
    lines = [
        *head,
        *(driver if canopen else []),
        *_node("trajectory", f"arm: {arm}  # its limits are kept", *_release(canopen)),
        *_node("recorder", f"directory: {_quoted(str(directory / 'recordings'))}"),
        *_node("identifier", f"arm: {arm}", f"result_directory: {_quoted(str(directory / 'identified'))}"),
        *(simulated if canopen else []),
    ]
    return "\n".join(lines) + "\n"


def _release(canopen: bool) -> list[str]:
    """What releases a run: this package's driver, or the controller of the arm's own."""
    if canopen:
        return ["require_enabled: true"]
    return ["output: joint_trajectory", "enabled_from: [controller]", "controller: arm_controller  # ASSUMED"]


def _node(name: str, *parameters: str) -> list[str]:
    return [f"{name}:", "  ros__parameters:", *(f"    {parameter}" for parameter in parameters)]


def _quoted(text: str) -> str:
    """A string as YAML wants it, in a block or in braces: plain where that is unmistakable."""
    return str(yaml.safe_dump([text], default_flow_style=True, allow_unicode=True, width=math.inf)).strip()[1:-1]
