"""`Simulation`: what a simulation says of an arm, as a torque model with values and the simulation's own words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm, without_joints
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..dynamics.regressor import INERTIAL_SYMBOLS

ARMATURE, DAMPING, FRICTION, STIFFNESS = "J_m", "k_v1", "f_c", "k_1"
"""Symbols of the torque model for what a simulator's joint holds beside its body."""
LEAST_OWN = 1e-6
"""N m, N m s/rad, kg m^2: an identification of a simulator's bag leaves a thousandth of it where there is none."""
WORDS: Mapping[str, Mapping[str, str]] = {
    "mjcf": {ARMATURE: "armature", DAMPING: "damping", FRICTION: "frictionloss", STIFFNESS: "stiffness"},
    "urdf": {ARMATURE: "rotor inertia", DAMPING: "damping", FRICTION: "friction", STIFFNESS: "stiffness"},
    "sdf": {ARMATURE: "rotor inertia", DAMPING: "damping", FRICTION: "friction", STIFFNESS: "spring_stiffness"},
    "model": {ARMATURE: "J_m", DAMPING: "k_v1", FRICTION: "f_c", STIFFNESS: "k_1"},
    "bag": {ARMATURE: "rotor inertia", DAMPING: "damping", FRICTION: "friction", STIFFNESS: "stiffness"},
}
"""Format -> what it calls each of them; for formats without a rotor inertia, the usual term."""


@dataclass(frozen=True)
class JointDynamics:
    """What a simulator's joint holds beside its body, SI units of the output side.

    Attributes:
        armature: Inertia added to the joint, kg m^2 (kg where it slides).
        damping: N m s/rad (N s/m).
        friction: Coulomb friction, N m (N).
        stiffness: N m/rad (N/m) about `rest`.
        rest: Position at which the spring is free, rad (m).
    """

    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


@dataclass(frozen=True)
class Part:
    """A body as the simulation's file has it; several may be fixed to each other behind one joint.

    Attributes:
        name: In the file.
        joint: That moves it.
        inertial: (10,) m, m c, I about the frame of the joint, in its axes.
    """

    name: str
    joint: str
    inertial: FloatArray


@dataclass(frozen=True)
class Simulation:
    """A simulation of an arm.

    Attributes:
        model: Its torque model with its values.
        format: Key of `WORDS`.
        source: The file, as a person would name it.
        bodies: Joint -> name of the body it moves, in the simulation's words.
        notes: What of the file is not in the model, a sentence each.
        parts: Bodies of the file, where the reader knows them apart.
    """

    model: IdentifiedModel
    format: str
    source: str
    bodies: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()

    @property
    def all_parts(self) -> tuple[Part, ...]:
        """The file's bodies with mass; where they are not known apart, everything behind a joint is one.

        Of a simulator's bag they are what its torque shows, not what a description beside it says.
        """
        known = {part.joint for part in self.parts}
        whole = (
            Part(self.body(joint), joint, np.array([self.model.value(symbol, joint) for symbol in INERTIAL_SYMBOLS]))
            for joint in self.arm.joint_names
            if joint not in known
        )
        return tuple(part for part in (*self.parts, *whole) if part.inertial[0] > 0.0)

    @property
    def arm(self) -> Arm:
        """The arm that is simulated."""
        return self.model.model.arm

    @property
    def values(self) -> dict[str, float]:
        """Parameter by name, such as `m[joint_1]` -> value."""
        return {p.name: float(v) for p, v in zip(self.model.model.parameters, self.model.parameters)}

    @property
    def own(self) -> dict[str, float]:
        """Friction, damping and rotor inertias that the joints have, by name; not what is rounding of zero."""
        symbols = (FRICTION, DAMPING, ARMATURE)
        found = zip(self.model.model.parameters, self.model.parameters)
        return {p.name: float(v) for p, v in found if p.symbol in symbols and v > LEAST_OWN}

    def word(self, symbol: str) -> str:
        """What the simulation's format calls a parameter of a joint; other symbols stay."""
        return WORDS[self.format].get(symbol, symbol)

    def body(self, joint: str) -> str:
        """Name of the body that a joint moves."""
        return self.bodies.get(joint, joint)


def simulation_of(
    arm: Arm,
    joints: Mapping[str, JointDynamics],
    format_: str,
    source: str,
    bodies: Mapping[str, str] | None = None,
    notes: Sequence[str] = (),
    parts: Sequence[Part] = (),
) -> Simulation:
    """A simulation from an arm and the dynamics of its joints.

    Springs are those about zero; one about another position adds a constant torque, which goes to the offset.

    Args:
        arm: The arm, with the inertials of its links.
        joints: Joint -> friction, damping, armature and spring; a joint that is not named has none.
        format_: Key of `WORDS`.
        source: The file, as a person would name it.
        bodies: Joint -> name of the body it moves, in the simulation's words; None: the joints' names.
        notes: What of the file is not in the model, a sentence each.
        parts: Bodies of the file, where the reader knows them apart.
    """
    values = {name: joints.get(name, JointDynamics()) for name in arm.joint_names}
    structure = simulated_structure([name for name, one in values.items() if one.stiffness])
    shifted = [name for name, one in values.items() if one.stiffness * one.rest]
    if shifted:
        structure["torque_offset"] = {"joints": shifted}
    model = TorqueModel(arm, structure)
    parameters = np.array([_value(arm, values, parameter.symbol, parameter.joint) for parameter in model.parameters])
    constants = np.zeros(len(model.constants))
    identified = IdentifiedModel(model, parameters, constants)
    return Simulation(identified, format_, source, dict(bodies or {}), tuple(notes), tuple(parts))


def simulated_structure(sprung: Sequence[str] = ()) -> Structure:
    """Terms that a rigid-body simulator has: bodies, armature, Coulomb friction, damping; springs where there are."""
    return {
        "rigid_body": {},
        "rotor_inertia": {},
        "joint_spring": {"free": list(sprung)} if sprung else {},
        "stribeck_friction": {"stribeck": False, "presliding": False},
        "viscous_friction": {"vacuum": True},
    }


def _value(arm: Arm, values: Mapping[str, JointDynamics], symbol: str, joint: str) -> float:
    one = values[joint]
    if symbol in INERTIAL_SYMBOLS:
        return float(arm.joints[arm.joint_names.index(joint)].inertial[INERTIAL_SYMBOLS.index(symbol)])
    own = {
        ARMATURE: one.armature,
        DAMPING: one.damping,
        FRICTION: one.friction,
        "f_b": one.friction,
        STIFFNESS: one.stiffness,
        "offset": -one.stiffness * one.rest,
    }
    return own[symbol]


def without(simulation: Simulation, names: Sequence[str]) -> Simulation:
    """The simulation with some joints fixed: at the posture of rest where its arm file has one, else near zero.

    Args:
        simulation: With at least one joint more.
        names: Joints to fix, such as those that the recordings lack; empty: the simulation is returned as it is.

    Returns:
        Bodies are those of the arm's description, and parts are not told apart. Of the joints' terms, armature,
        damping, Coulomb friction and spring stay; a note names the others.

    Raises:
        UserError: A coupled motor turns with one of them, or they are all it has.
    """
    if not names:
        return simulation
    arm = without_joints(simulation.arm, names)
    values = simulation.values
    joints = {
        joint: JointDynamics(
            armature=values.get(f"{ARMATURE}[{joint}]", 0.0),
            damping=values.get(f"{DAMPING}[{joint}]", 0.0),
            friction=values.get(f"{FRICTION}[{joint}]", 0.0),
            stiffness=(stiffness := values.get(f"{STIFFNESS}[{joint}]", 0.0)),
            rest=-values.get(f"offset[{joint}]", 0.0) / stiffness if stiffness else 0.0,
        )
        for joint in arm.joint_names
    }
    notes = [*simulation.notes, f"not in the recordings, and taken as fixed: {', '.join(names)}"]
    fixed = simulation_of(arm, joints, simulation.format, simulation.source, simulation.bodies)
    kept = {*(p.name for p in fixed.model.model.parameters)}
    lost = [
        p.name
        for p, value in zip(simulation.model.model.parameters, simulation.model.parameters)
        if p.joint in joints and p.name not in kept and abs(value) > LEAST_OWN
    ]
    if lost:
        notes.append(f"left out of the model with the joints taken as fixed: {', '.join(lost)}")
    return replace(fixed, notes=tuple(notes))
