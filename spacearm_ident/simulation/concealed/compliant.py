"""A mechanism with more in it than rigid links on a fixed base.

`Structure` collects what effects add: motors behind springs, hinges inside links, a base that moves, rotors that
spin, forces. `CompliantMechanism` is the arm with all of it. Motor and link are two inertias (M. W. Spong, ASME J.
DSMC 109 (1987) 310: the motor turns about its own axis only, so only its reflected inertia counts); hinges, base and
rotors are further bodies of the kinematic tree. A rotor turns with its joint times the gear ratio: velocities of the
tree are T·(free velocities) with a constant T, so inertia TᵀMT and bias Tᵀb are exact, gyroscopic torques included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.mechanism import rigid_body_model
from spacearm_ident.simulation.parameters import PlantParameters

Spring = Callable[[float, float], float]
"""Torque N·m on the link from twist (motor before link) rad and its rate rad/s."""
LEAST_ROTOR = 0.004
"""Least motor inertia behind a spring, as a share of the joint's: below, no servo holds it."""


@dataclass(frozen=True)
class Hinge:
    """A passive joint inside a link: `place` of the way to the next joint, about `axis` in the link's frame."""

    axis: FloatArray
    place: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Base:
    """A body under the arm that can move; stiffness N/m and N·m/rad, zero: it floats.

    `inertia`: kg·m² about its centre, which is at `centre` m in the base frame.
    """

    mass: float
    inertia: float
    centre: FloatArray
    stiffness: FloatArray = field(default_factory=lambda: np.zeros(6))
    damping: FloatArray = field(default_factory=lambda: np.zeros(6))


@dataclass(frozen=True)
class Force:
    """`value(t)` N (3,), world axes, on the frame of joint number `joint`, at `point` m in that frame."""

    joint: int
    point: FloatArray
    value: Callable[[float], FloatArray | None]


@dataclass
class Structure:
    """What is to be added to an arm, by joint number."""

    joints: tuple[str, ...]
    springs: dict[int, Spring] = field(default_factory=dict)
    hinges: dict[int, Hinge] = field(default_factory=dict)
    rotors: dict[int, tuple[float, float]] = field(default_factory=dict)
    base: Base | None = None
    forces: list[Force] = field(default_factory=list)
    wheels: dict[int, FloatArray] = field(default_factory=dict)

    def add_spring(self, joint: int, spring: Spring) -> None:
        """A spring between motor and link.

        Raises:
            UserError: There is one already.
        """
        if joint in self.springs:
            raise UserError(f"{self.joints[joint]}: conceal one spring or gap between motor and link, not two")
        self.springs[joint] = spring

    def __bool__(self) -> bool:
        return bool(self.springs or self.hinges or self.rotors or self.base or self.forces or self.wheels)


class CompliantMechanism:
    """A mechanism, as `mechanism.RigidMechanism`, of an arm with a `Structure`.

    Velocity coordinates: base (6, if it moves), then joints and hinges from base to tip, then sprung motors.
    """

    def __init__(self, parameters: PlantParameters, structure: Structure) -> None:
        """Build it.

        Raises:
            UserError: A motor has too little inertia to stand behind a spring.
        """
        self._rigid = rigid_body_model(parameters)
        self._rigid_data = self._rigid.createData()
        self._structure = structure
        self._sprung = np.array(sorted(structure.springs), dtype=np.intp)
        self._motor_inertia = parameters.rotor_inertia[self._sprung]
        own = np.diag(pin.crba(self._rigid, self._rigid_data, pin.neutral(self._rigid)))[self._sprung]
        for joint, rotor, whole in zip(self._sprung, self._motor_inertia, own, strict=True):
            if rotor < LEAST_ROTOR * whole:
                raise UserError(
                    f"{parameters.joints[joint]} has a rotor inertia of {rotor:g} kg m2: a motor behind a spring "
                    f"needs at least {LEAST_ROTOR * whole:.2g}; choose another joint or a model with J_m"
                )
        self._build(parameters, structure)
        self.time = 0.0

    def _build(self, parameters: PlantParameters, structure: Structure) -> None:
        rigid, tree = self._rigid, pin.Model()
        axes = joint_axes(rigid)
        parent, rest = 0, pin.SE3.Identity()
        if structure.base is not None:
            base = structure.base
            parent = tree.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
            body = pin.Inertia(base.mass, base.centre, base.inertia * np.eye(3))
            tree.appendBodyToJoint(parent, body, pin.SE3.Identity())
        numbers: list[int] = []
        hinges: list[tuple[int, Hinge]] = []
        rotors: list[tuple[int, int, float]] = []
        for k in range(len(parameters.joints)):
            place = rest * rigid.jointPlacements[k + 1]
            if k in structure.rotors:
                ratio, inertia = structure.rotors[k]
                turned = tree.addJoint(parent, pin.JointModelRevoluteUnaligned(axes[k]), place, f"rotor_{k}")
                spin = inertia * np.outer(axes[k], axes[k])
                tree.appendBodyToJoint(turned, pin.Inertia(0.0, np.zeros(3), spin), pin.SE3.Identity())
                rotors.append((turned, k, ratio))
            parent = tree.addJoint(parent, rigid.joints[k + 1], place, parameters.joints[k])
            tree.appendBodyToJoint(parent, rigid.inertias[k + 1], pin.SE3.Identity())
            numbers.append(parent)
            rest = pin.SE3.Identity()
            if k in structure.hinges:
                hinge = structure.hinges[k]
                along = hinge.place * rigid.jointPlacements[k + 2].translation
                parent = tree.addJoint(
                    parent, pin.JointModelRevoluteUnaligned(hinge.axis), pin.SE3(np.eye(3), along), f"hinge_{k}"
                )
                rest = pin.SE3(np.eye(3), -along)
                hinges.append((parent, hinge))
        armature = np.zeros(tree.nv)
        for k, number in enumerate(numbers):
            spun = sum(ratio**2 * structure.rotors[j][1] for _, j, ratio in rotors if j == k)
            reflected = 0.0 if k in structure.springs else float(parameters.rotor_inertia[k])
            armature[tree.joints[number].idx_v] = reflected - spun
        tree.armature = armature
        tree.gravity.linear = parameters.gravity
        self._tree, self._data, self._numbers = tree, tree.createData(), numbers
        self._index(tree, numbers, hinges, rotors)

    def _index(
        self, tree: pin.Model, numbers: list[int], hinges: list[tuple[int, Hinge]], rotors: list[tuple[int, int, float]]
    ) -> None:
        """Where things are: in the tree's velocity, in the free velocity, in the configuration."""
        spun = {tree.joints[number].idx_v for number, *_ in rotors}
        free = [column for column in range(tree.nv) if column not in spun]
        self._T = np.zeros((tree.nv, len(free)))
        self._T[free, np.arange(len(free))] = 1.0
        at = {column: i for i, column in enumerate(free)}
        links = np.array([at[tree.joints[number].idx_v] for number in numbers], dtype=np.intp)
        for number, joint, ratio in rotors:
            self._T[tree.joints[number].idx_v, links[joint]] = ratio
        self._has_rotors = bool(rotors)
        self._links, self._m = links, len(free)
        self._in_q = np.array([tree.joints[number].idx_q for number in numbers], dtype=np.intp)
        self._hinge_v = np.array([at[tree.joints[number].idx_v] for number, _ in hinges], dtype=np.intp)
        self._hinge_q = np.array([tree.joints[number].idx_q for number, _ in hinges], dtype=np.intp)
        self._hinge_stiffness = np.array([hinge.stiffness for _, hinge in hinges])
        self._hinge_damping = np.array([hinge.damping for _, hinge in hinges])
        self.size = self._m + len(self._sprung)
        self.drives: NDArray[np.intp] | None = links.copy()
        self.drives[self._sprung] = self._m + np.arange(len(self._sprung))
        self._drive_q = self._in_q.copy()
        self._drive_q[self._sprung] = tree.nq + np.arange(len(self._sprung))
        self._rest = pin.neutral(tree)
        # Rotors turn round and round, and look the same at any angle: theirs stays at zero.
        self._turns = np.array([column not in spun for column in range(tree.nv)])

    def start(self, position: FloatArray) -> FloatArray:
        """See `RigidMechanism`; springs unloaded."""
        tree = self._rest.copy()
        tree[self._in_q] = position
        return np.concatenate([tree, position[self._sprung]])

    def position(self, configuration: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        return configuration[self._drive_q]

    def moved(self, configuration: FloatArray, velocity: FloatArray, h: float) -> FloatArray:
        """See `RigidMechanism`."""
        nq, m = self._tree.nq, self._m
        step = h * velocity
        if self._structure.base is None and not self._has_rotors:
            return configuration + step
        tree = pin.integrate(self._tree, configuration[:nq], (self._T @ step[:m]) * self._turns)
        return np.concatenate([tree, configuration[nq:] + step[m:]])

    def acceleration(self, configuration: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        m, q, v = self._m, configuration[: self._tree.nq], velocity[: self._m]
        driving = torque + self._passive(configuration, velocity)
        if self._has_rotors:
            moving = np.linalg.solve(self._tree_inertia(q), driving[:m] - self._tree_bias(q, v))
        else:
            moving = pin.aba(self._tree, self._data, q, v, driving[:m])
        return np.concatenate([moving, driving[m:] / self._motor_inertia])

    def bias(self, configuration: FloatArray, velocity: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        out = -self._passive(configuration, velocity)
        out[: self._m] += self._tree_bias(configuration[: self._tree.nq], velocity[: self._m])
        return out

    def inertia(self, configuration: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        out = np.zeros((self.size, self.size))
        out[: self._m, : self._m] = self._tree_inertia(configuration[: self._tree.nq])
        out.flat[self._m * (self.size + 1) :: self.size + 1] = self._motor_inertia
        return out

    def joint_inertia(self, configuration: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        return np.array(pin.crba(self._rigid, self._rigid_data, self.position(configuration)))

    def load(self, configuration: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """See `RigidMechanism`."""
        q, m = configuration[: self._tree.nq], self._m
        a, v = self._T @ acceleration[:m], self._T @ velocity[:m]
        whole = self._T.T @ (pin.rnea(self._tree, self._data, q, v, a) - self._tree.armature * a)
        return np.asarray((whole - self._passive(configuration, velocity, springs=False)[:m])[self._links])

    def base(self, configuration: FloatArray, velocity: FloatArray) -> FloatArray | None:
        """See `RigidMechanism`."""
        if self._structure.base is None:
            return None
        return np.concatenate([configuration[:7], velocity[:6]])

    def energy(self, configuration: FloatArray, velocity: FloatArray) -> float:
        """Kinetic and potential energy of the bodies, hinges and base springs, J; not of the springs at motors."""
        q, base = configuration[: self._tree.nq], self._structure.base
        kinetic = 0.5 * velocity @ self.inertia(configuration) @ velocity
        stored = 0.5 * self._hinge_stiffness @ configuration[self._hinge_q] ** 2 if len(self._hinge_q) else 0.0
        if base is not None:
            stored += 0.5 * base.stiffness @ self._base_offset(q) ** 2
        return float(kinetic + pin.computePotentialEnergy(self._tree, self._data, q) + stored)

    def _tree_inertia(self, q: FloatArray) -> FloatArray:
        full = np.array(pin.crba(self._tree, self._data, q))
        return np.asarray(self._T.T @ full @ self._T) if self._has_rotors else full

    def _tree_bias(self, q: FloatArray, v: FloatArray) -> FloatArray:
        if self._has_rotors:
            return np.asarray(self._T.T @ pin.nonLinearEffects(self._tree, self._data, q, self._T @ v))
        found: FloatArray = pin.nonLinearEffects(self._tree, self._data, q, v)
        return found

    def _passive(self, configuration: FloatArray, velocity: FloatArray, *, springs: bool = True) -> FloatArray:
        """Forces of springs, dampers, wheels and the outside, (m,)."""
        force, structure = np.zeros(self.size), self._structure
        if springs:
            for i, joint in enumerate(self._sprung):
                link, motor = self._links[joint], self._m + i
                twist = configuration[self._tree.nq + i] - configuration[self._in_q[joint]]
                torque = structure.springs[int(joint)](twist, velocity[motor] - velocity[link])
                force[link] += torque
                force[motor] -= torque
        if len(self._hinge_v):
            force[self._hinge_v] -= (
                self._hinge_stiffness * configuration[self._hinge_q] + self._hinge_damping * velocity[self._hinge_v]
            )
        if structure.base is not None and structure.base.stiffness.any():
            base = structure.base
            offset = self._base_offset(configuration[: self._tree.nq])
            force[:6] -= base.stiffness * offset + base.damping * velocity[:6]
        if structure.forces or structure.wheels:
            force[: self._m] += self._outside(configuration[: self._tree.nq], velocity[: self._m])
        return force

    def _base_offset(self, q: FloatArray) -> FloatArray:
        """How far the base is from where it was, m and rad, small."""
        pose = pin.log6(pin.XYZQUATToSE3(q[:7]))
        return np.concatenate([pose.linear, pose.angular])

    def _outside(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Forces on links and the gyroscopic torque of wheels in them, on the free coordinates."""
        total = np.zeros(self._tree.nv)
        now = [(force, force.value(self.time)) for force in self._structure.forces]
        pulls = [(force, value) for force, value in now if value is not None]
        if not pulls and not self._structure.wheels:
            return self._T.T @ total
        pin.computeJointJacobians(self._tree, self._data, q)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for force, value in pulls:
            number = self._numbers[force.joint]
            jacobian = _jacobian(self._tree, self._data, number, world)
            arm = self._data.oMi[number].rotation @ force.point
            total += jacobian.T @ np.concatenate([value, np.cross(arm, value)])
        for joint, momentum in self._structure.wheels.items():
            number = self._numbers[joint]
            turning = _jacobian(self._tree, self._data, number, world)[3:]
            spin = self._data.oMi[number].rotation @ momentum
            total -= turning.T @ np.cross(turning @ (self._T @ v), spin)
        return self._T.T @ total


def joint_axes(model: pin.Model) -> FloatArray:
    """Axes of the joints in their own frames, (n, 3)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    local = [_jacobian(model, data, k, pin.ReferenceFrame.LOCAL)[:, k - 1] for k in range(1, model.njoints)]
    return np.array([column[3:] if column[3:].any() else column[:3] for column in local])


def _jacobian(model: pin.Model, data: pin.Data, joint: int, frame: pin.ReferenceFrame) -> FloatArray:
    """(6, nv), for a single joint too."""
    return np.asarray(pin.getJointJacobian(model, data, joint, frame)).reshape(6, model.nv)
