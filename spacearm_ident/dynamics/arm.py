"""`Arm`: what is known of the arm before any data: kinematics, CAD inertials, limits, drives, gravity.

Kinematics and CAD inertials come from a URDF through Pinocchio, which merges fixed joints; an arm YAML adds
what a URDF cannot say. A joint's twist axis and placement are all the batched regressor needs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..documents import entries, parse_yaml, read_text
from ..errors import UserError
from ..recording.corrections import Corrections, read_corrections
from .urdf_chain import locked, mimicking, with_limits

ARM_SCHEMA = "spacearm_ident/arm/1"
EARTH = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Units:
    """Units of a joint's coordinate, its derivatives, and what drives it."""

    position: str
    velocity: str
    acceleration: str
    jerk: str
    effort: str


TURNING = Units("rad", "rad/s", "rad/s²", "rad/s³", "N m")
SLIDING = Units("m", "m/s", "m/s²", "m/s³", "N")


@dataclass(frozen=True)
class Joint:
    """One actuated joint and the link it moves.

    Attributes:
        name: As in the URDF and the recordings.
        parent: Index of the joint that carries it, -1 for the base.
        revolute: Whether it turns; a prismatic joint slides.
        axis: (3,) unit axis in the joint frame.
        rotation: (3, 3) joint frame to parent joint frame, at zero position.
        translation: (3,) origin in the parent joint frame, m.
        inertial: (10,) CAD parameters m, m·c, I about the joint frame, in Pinocchio's order.
        lower, upper: Position limits, rad or m (infinite where none).
        velocity_limit, effort_limit: From the URDF, or the arm YAML (infinite where none).
        acceleration_limit: From the arm YAML (infinite where none).
        gear_ratio: Motor turns a joint turn.
        torque_constant: N·m/A at the motor.
        effort_scale: N·m on the output side for each unit of what the arm's driver publishes as effort.
        start: Where it rests before and after an excitation, rad or m; NaN: not stated.
    """

    name: str
    parent: int
    revolute: bool
    axis: FloatArray
    rotation: FloatArray
    translation: FloatArray
    inertial: FloatArray
    lower: float = -np.inf
    upper: float = np.inf
    velocity_limit: float = np.inf
    effort_limit: float = np.inf
    acceleration_limit: float = np.inf
    gear_ratio: float = 1.0
    torque_constant: float = 1.0
    effort_scale: float = 1.0
    start: float = np.nan

    @property
    def units(self) -> Units:
        """What its position, velocity, acceleration and effort are in."""
        return TURNING if self.revolute else SLIDING

    @property
    def torque_per_ampere(self) -> float:
        """N·m on the output side for each ampere of the motor's current."""
        return self.gear_ratio * self.torque_constant


@dataclass(frozen=True)
class Coupling:
    """A motor that several joints drive: its angle is `sum(ratio[joint] * q[joint])`."""

    name: str
    ratios: Mapping[str, float]


@dataclass(frozen=True)
class Arm:
    """An open chain (or tree) of n revolute and prismatic joints on a fixed base.

    Attributes:
        gravity_stated: Whether its file says what gravity is, which is the standard one otherwise.
        effort_declared: Whether somebody has said what unit its driver publishes effort in.
        corrections: Of its recordings, whose conventions may be others; nothing of the arm itself.
        package_path: Folders in which the description's meshes are looked for, the description's own first.
        locked: Joints of the description that a recording lacks, and that are fixed for it.
        empty: What its file names and leaves empty, as `JOINT: KEY`; a driver needs it, an identification does not.
        described: Its description before joints that mimic others were locked; empty: as `urdf`.
    """

    name: str
    joints: tuple[Joint, ...]
    urdf: str
    gravity: FloatArray = field(default_factory=lambda: np.array(EARTH))
    gravity_stated: bool = False
    couplings: tuple[Coupling, ...] = ()
    effort_declared: bool = False
    corrections: Corrections = field(default_factory=Corrections)
    package_path: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    empty: tuple[str, ...] = ()
    described: str = ""

    @property
    def effort_scale(self) -> FloatArray:
        """(n,) N·m for each unit of published effort."""
        return np.array([joint.effort_scale for joint in self.joints])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the order of every array."""
        return tuple(joint.name for joint in self.joints)

    @property
    def start(self) -> FloatArray | None:
        """(n,) posture of rest that its file states, zero for joints it leaves out; None: it states none."""
        stated = np.array([joint.start for joint in self.joints])
        return None if np.isnan(stated).all() else np.nan_to_num(stated)

    @property
    def effort_unit(self) -> str:
        """What a table over all joints is in: `N m`, `N`, or both with the joints that slide."""
        sliding = [joint.name for joint in self.joints if not joint.revolute]
        if not sliding:
            return TURNING.effort
        return SLIDING.effort if len(sliding) == len(self.joints) else f"{TURNING.effort} (N: {', '.join(sliding)})"

    @property
    def mass(self) -> float:
        """Kg, of all links as the description has them; 0 where it has none."""
        return float(sum(joint.inertial[0] for joint in self.joints))

    @property
    def size(self) -> float:
        """Mass times the squared length of its longest chain, kg m^2: of that order is what its first joint swings."""
        lengths = [float(np.linalg.norm(joint.translation)) for joint in self.joints]
        # What the first joint stands on does not swing.
        reach = max(sum(lengths[k] for k in self.supports(link)[:-1]) for link in range(len(self.joints)))
        return self.mass * reach**2

    def with_gravity(self, gravity: FloatArray) -> Arm:
        """The same arm under another gravity vector (3,), m/s^2, base frame."""
        return replace(self, gravity=np.asarray(gravity, dtype=float))

    def supports(self, link: int) -> tuple[int, ...]:
        """The joints that carry link `link`, itself first, the base's last."""
        chain = [link]
        while self.joints[chain[-1]].parent >= 0:
            chain.append(self.joints[chain[-1]].parent)
        return tuple(chain)


def arm_from_urdf(urdf: str, gravity: FloatArray | None = None) -> Arm:
    """Read an arm from the text of a URDF; joints that mimic others are locked: they are payload.

    A limit that the text leaves out is one of zero, which many descriptions write: no limit is stated.

    Args:
        urdf: The text.
        gravity: (3,) m/s² in the base frame; None: the standard one, downwards.

    Raises:
        UserError: Not a URDF (`check_urdf`), no actuated joint, a joint that is neither revolute nor prismatic, or one
            without axis.
    """
    described = ""
    if fixed := mimicking(urdf):
        described, urdf = urdf, locked(urdf, fixed)
    urdf = with_limits(urdf)
    model = _pinocchio_model(urdf)
    joints = []
    for index in range(1, model.njoints):
        kind = model.joints[index]
        name = model.names[index]
        if kind.nv != 1:
            raise UserError(
                f"joint {name!r} is of type {kind.shortname()}: make it revolute, continuous, prismatic or fixed"
            )
        twist = _twist(kind)
        if not np.any(twist):
            raise UserError(f"joint {name!r} has the axis 0 0 0: give it a direction")
        placement = model.jointPlacements[index]
        bounded = kind.nq == 1
        joints.append(
            Joint(
                name=name,
                parent=model.parents[index] - 1,
                revolute=bool(np.any(twist[3:])),
                axis=twist[3:] if np.any(twist[3:]) else twist[:3],
                rotation=placement.rotation.copy(),
                translation=placement.translation.copy(),
                inertial=np.array(model.inertias[index].toDynamicParameters()),
                lower=float(model.lowerPositionLimit[kind.idx_q]) if bounded else -np.inf,
                upper=float(model.upperPositionLimit[kind.idx_q]) if bounded else np.inf,
                velocity_limit=float(model.velocityLimit[kind.idx_v]) or np.inf,
                effort_limit=float(model.effortLimit[kind.idx_v]) or np.inf,
            )
        )
    if not joints:
        raise UserError("the URDF has no actuated joint: check that its joints are not all fixed")
    vector = np.array(EARTH) if gravity is None else np.asarray(gravity, dtype=float)
    return Arm(model.name, tuple(joints), urdf, vector, described=described)


def without_joints(arm: Arm, names: Collection[str], at: Mapping[str, float] | None = None) -> Arm:
    """The arm with some of its joints fixed: where measured, at its posture of rest where its file has one, near zero.

    Args:
        arm: With at least one joint more.
        names: Joints to fix.
        at: Positions of those that were measured, rad (m for prismatic joints).

    Raises:
        UserError: A coupled motor turns with one of them, or they are all it has.
    """
    for coupling in arm.couplings:
        if tied := sorted(set(coupling.ratios) & set(names)):
            raise UserError(f"joint {tied[0]!r} is not in the recordings, but motor {coupling.name} turns with it")
    if set(names) >= set(arm.joint_names):
        raise UserError(f"none of the arm's joints is in the recordings: it has {', '.join(arm.joint_names)}")
    stated = {joint.name: joint.start for joint in arm.joints if joint.name in names and np.isfinite(joint.start)}
    urdf = arm.described or arm.urdf
    smaller = arm_from_urdf(locked(urdf, {*names, *mimicking(urdf, names)}, {**stated, **(at or {})}))
    known = {joint.name: joint for joint in arm.joints}
    joints = tuple(
        replace(
            known[new.name],
            parent=new.parent,
            rotation=new.rotation,
            translation=new.translation,
            inertial=new.inertial,
        )
        for new in smaller.joints
    )
    fixed = tuple(joint for joint in arm.joint_names if joint in names)
    described = smaller.described
    return replace(arm, joints=joints, urdf=smaller.urdf, locked=(*arm.locked, *fixed), described=described)


def _pinocchio_model(urdf: str) -> pin.Model:
    try:
        return pin.buildModelFromXML(urdf)
    except Exception as error:
        detail = str(error).strip().splitlines() or ["it could not be parsed"]
        raise UserError(f"the URDF cannot be read: {detail[0]}") from error


def _twist(kind: Any) -> FloatArray:
    """(6,) motion axis, linear then angular, in the joint frame."""
    data = kind.createData()
    neutral = np.zeros(kind.nq)
    if kind.nq == 2:  # Pinocchio keeps an unbounded angle as its cosine and sine.
        neutral[0] = 1.0
    kind.calc(data, neutral)
    return np.array(data.S).reshape(6)


def load_arm(path: Path) -> Arm:
    """Read an arm from a URDF, or from an arm YAML that names one.

    Raises:
        UserError: The file is missing or not understood; the message says which key.
    """
    text = read_text(path, "the arm")
    if path.suffix not in (".yaml", ".yml"):
        return replace(arm_from_urdf(text), package_path=(str(path.parent),))
    data = parse_yaml(text, str(path))
    if not isinstance(data, dict) or data.get("schema") != ARM_SCHEMA:
        raise UserError(f"{path} is not an arm description: its first line should be 'schema: {ARM_SCHEMA}'")
    unknown = set(data) - ARM_KEYS
    if unknown:
        raise UserError(f"{path}: unknown key {sorted(unknown, key=str)[0]!r}")
    if "urdf" not in data:
        raise UserError(f"{path}: the key 'urdf' is missing: name the arm's URDF file")
    urdf = read_text(path.parent / str(data["urdf"]), f"the URDF that {path} names,")
    arm = arm_from_description(urdf, data, str(path))
    listed = data.get("package_path") or []
    if not isinstance(listed, list) or not all(isinstance(folder, str) for folder in listed):
        raise UserError(f"{path}: package_path is a list of folders, not {listed!r}")
    beside = (path.parent / str(data["urdf"])).parent
    return replace(arm, package_path=(str(beside), *(str(path.parent / folder) for folder in listed)))


def arm_from_description(urdf: str, data: Mapping[str, Any], where: str) -> Arm:
    """An arm from its URDF text and the keys of an arm YAML.

    Args:
        urdf: Text of the URDF.
        data: Content of the arm YAML. `gravity_m_s2`, `joints`, `couplings`, `corrections`, `name` and `effort` are
            read, each optional; other keys are ignored.
        where: Name of the description in error messages, such as its path.

    Raises:
        UserError: The URDF is none that `arm_from_urdf` can read, or a key is malformed, or names a joint that the
            URDF does not have.
    """
    arm = arm_from_urdf(urdf, _vector(data.get("gravity_m_s2", EARTH), f"{where}: gravity_m_s2"))
    given = entries(data.get("joints"), f"{where}: joints")
    unknown = set(given) - set(arm.joint_names)
    if unknown:
        raise UserError(f"{where}: joint {sorted(unknown, key=str)[0]!r} is not in the URDF")
    joints = tuple(_with_drive(joint, given.get(joint.name), where) for joint in arm.joints)
    listed = data.get("couplings") or []
    if not isinstance(listed, list):
        raise UserError(f"{where}: couplings is a list of 'name' and 'ratios', not {listed!r}")
    couplings = tuple(_coupling(item, arm.joint_names, where) for item in listed)
    corrections = read_corrections(data.get("corrections"), arm.joint_names, f"{where}: corrections")
    name = str(data.get("name", arm.name))
    empty = tuple(
        f"{joint}: {key}"
        for joint, keys in given.items()
        for key in DRIVE_KEYS
        if key in (keys or {}) and keys[key] is None
    )
    stated = "gravity_m_s2" in data
    arm = replace(arm, name=name, joints=joints, couplings=couplings, corrections=corrections, empty=empty)
    arm = replace(arm, gravity_stated=stated)
    return arm if data.get("effort") is None else _with_effort(arm, data["effort"], given, f"{where}: effort")


ARM_KEYS = frozenset(
    {"schema", "name", "urdf", "package_path", "gravity_m_s2", "joints", "couplings", "effort", "corrections"}
)
"""What an arm YAML may hold."""
DRIVE_KEYS = ("gear_ratio", "torque_constant_Nm_per_A")
"""What of a joint may be left empty: only a driver's scaling and effort in amperes need it."""
JOINT_KEYS = {
    "gear_ratio": "gear_ratio",
    "torque_constant_Nm_per_A": "torque_constant",
    "position_lower_rad": "lower",
    "position_upper_rad": "upper",
    "velocity_limit_rad_s": "velocity_limit",
    "acceleration_limit_rad_s2": "acceleration_limit",
    "torque_limit_Nm": "effort_limit",
    "start_position_rad": "start",
}
"""What an arm YAML may say of a joint, and the attribute of `Joint` that holds it."""


def _with_drive(joint: Joint, given: Any, where: str) -> Joint:
    data = entries(given, f"{where}: {joint.name}")
    unknown = set(data) - set(JOINT_KEYS)
    if unknown:
        raise UserError(f"{where}: {joint.name} has an unknown key {sorted(unknown, key=str)[0]!r}")
    values: dict[str, Any] = {
        JOINT_KEYS[key]: _number(value, f"{where}: {joint.name}: {key}")
        for key, value in data.items()
        if value is not None or key not in DRIVE_KEYS
    }
    return replace(joint, **values)


EFFORT_UNITS = ("N m", "A", "percent")
"""What a driver may publish as effort; `A` of the motor, `percent` of the rated torque."""


def _with_effort(arm: Arm, data: Any, joints: Mapping[str, Any], where: str) -> Arm:
    """Read `{unit: A, constants: {JOINT: N·m/A, ...}}`; in A, gear ratio × torque constant of a joint stands in.

    Args:
        arm: The arm.
        data: What is given.
        joints: The joints' own keys.
        where: For errors.
    """
    data = entries(data, where)
    unit = data.get("unit")
    if set(data) - {"unit", "constants"} or unit not in EFFORT_UNITS:
        raise UserError(f"{where} needs 'unit', one of {', '.join(EFFORT_UNITS)}, and 'constants', not {dict(data)!r}")
    constants = entries(data.get("constants"), f"{where}: constants")
    unknown = set(constants) - set(arm.joint_names)
    if unknown:
        raise UserError(f"{where}: constants: joint {sorted(unknown, key=str)[0]!r} is not in the URDF")
    if unit == "N m":
        if constants:
            raise UserError(f"{where}: N m needs no constants: leave them out, or correct the unit")
        return replace(arm, effort_declared=True)
    scaled = []
    for joint in arm.joints:
        per_cent = 0.01 if unit == "percent" else 1.0
        own = entries(joints.get(joint.name), where)
        if joint.name in constants:
            constant = _number(constants[joint.name], f"{where}: constants: {joint.name}")
        elif unit == "A" and all(own.get(key) is not None for key in DRIVE_KEYS):
            constant = joint.torque_per_ampere
        else:
            what = "N·m on the output side for each A" if unit == "A" else "N·m on the output side at 100 %"
            raise UserError(f"{where}: constants has no {joint.name}: give {what}")
        if not np.isfinite(constant) or constant == 0.0:
            raise UserError(f"{where}: constants: {joint.name}: {constant:g} turns nothing into torque")
        scaled.append(replace(joint, effort_scale=per_cent * constant))
    return replace(arm, joints=tuple(scaled), effort_declared=True)


def _coupling(data: Any, joints: tuple[str, ...], where: str) -> Coupling:
    """Read `{name: NAME, ratios: {JOINT: RATIO, ...}}`."""
    ratios = data.get("ratios") if isinstance(data, dict) else None
    if not isinstance(ratios, dict) or len(ratios) < 2 or not set(ratios) <= set(joints):
        raise UserError(
            f"{where}: a coupling needs 'name' and 'ratios' of at least two of the arm's joints, not {data!r}"
        )
    name = str(data.get("name", "+".join(ratios)))
    return Coupling(name, {key: _number(value, f"{where}: ratio of {key}") for key, value in ratios.items()})


def _number(value: Any, where: str) -> float:
    if value is None:
        raise UserError(f"{where} is still empty: fill it in (spacearm check lists all that is missing)")
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if np.isnan(number):
        raise UserError(f"{where} needs a number, not {value!r}")
    return number


def _vector(value: Any, where: str) -> FloatArray:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise UserError(f"{where} needs three numbers, m/s^2 in the base frame, not {value!r}")
    return vector
