"""Terms of the rigid arm: link inertials, rotor inertia, joint springs and torque offsets (paper §2.1, eq. 1 and 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..arrays import FloatArray
from ..signals.motion import Motion
from .arm import Arm
from .background import Background
from .regressor import INERTIAL_SYMBOLS, rigid_body_blocks, rigid_body_torque
from .term import Columns, Parameter, Term, Values, chosen_joints

INERTIAL_UNITS = ("kg", "kg m", "kg m", "kg m", *("kg m^2",) * 6)
SMALLEST_SHARE = 0.1
"""A CAD mass below this share of the mean link's is not believed to be known any better than that."""


@dataclass(frozen=True)
class RigidBody(Term):
    """Mass, first moments and inertia about the joint frame of every link; gravity and the base's motion included."""

    kind: ClassVar[str] = "rigid_body"
    words: ClassVar[str] = "rigid links"
    pointwise: ClassVar[bool] = True
    arm: Arm | None = None

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One term for the whole chain; its prior is CAD, as uncertain as it is large."""
        masses = np.array([joint.inertial[0] for joint in arm.joints])
        length = float(np.median([np.linalg.norm(joint.translation) for joint in arm.joints])) or 0.3
        least = SMALLEST_SHARE * (masses.mean() or 1.0)
        parameters = []
        for joint in arm.joints:
            mass = max(joint.inertial[0], least)
            moment = max(float(np.linalg.norm(joint.inertial[1:4])), mass * length)
            inertia = max(float(joint.inertial[4] + joint.inertial[6] + joint.inertial[9]) / 2, mass * length**2)
            scales = (mass, *(moment,) * 3, *(inertia,) * 6)
            for symbol, unit, prior, scale in zip(INERTIAL_SYMBOLS, INERTIAL_UNITS, joint.inertial, scales):
                parameters.append(Parameter(symbol, joint.name, unit, float(prior), scale))
        return (cls(tuple(parameters), arm=arm),)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The joint-torque regressor."""
        assert self.arm is not None
        blocks = rigid_body_blocks(self.arm, motion.position, motion.velocity, motion.acceleration, motion.base)
        rows: Columns = {}
        for row in range(len(self.arm.joints)):
            links = [link for (owner, link) in blocks if owner == row]
            indices = [10 * link + k for link in links for k in range(10)]
            rows[row] = indices, np.concatenate([blocks[row, link] for link in links]).T
        return rows

    def torque(
        self, motion: Motion, constants: Values, background: Background | None, parameters: FloatArray
    ) -> FloatArray:
        """The same torque without the columns, whose number grows with the square of the joints."""
        assert self.arm is not None
        state = motion.position, motion.velocity, motion.acceleration
        return rigid_body_torque(self.arm, parameters.reshape(-1, 10), *state, motion.base)


@dataclass(frozen=True)
class PerJoint(Term):
    """A term with one parameter a joint, whose column is that joint's own signal."""

    pointwise: ClassVar[bool] = True
    symbol: ClassVar[str]
    unit: ClassVar[str]
    dimension: ClassVar[tuple[int, int, int]]
    lower: ClassVar[float] = -np.inf

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One parameter a joint, or only for `options["joints"]`."""
        chosen = chosen_joints(arm, options.get("joints", True))
        parameters = tuple(
            Parameter(cls.symbol, name, cls.unit, dimension=cls.dimension, lower=cls.lower) for name in chosen
        )
        return (cls(parameters, options=dict(options)),)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Each joint's own signal in its own row."""
        return {
            (row := motion.joints.index(parameter.joint)): ([k], self.signal(motion, row)[:, None])
            for k, parameter in enumerate(self.parameters)
        }

    @staticmethod
    def signal(motion: Motion, row: int) -> FloatArray:
        """(N,) what the parameter multiplies.

        Args:
            motion: N samples.
            row: Number of the joint.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class RotorInertia(PerJoint):
    """J_m: inertia of rotor and gear, reflected to the output side."""

    kind: ClassVar[str] = "rotor_inertia"
    words: ClassVar[str] = "rotor inertia J_m"
    symbol: ClassVar[str] = "J_m"
    unit: ClassVar[str] = "kg m^2"
    dimension: ClassVar[tuple[int, int, int]] = (0, 0, 1)
    lower: ClassVar[float] = 0.0

    @staticmethod
    def signal(motion: Motion, row: int) -> FloatArray:
        """Joint acceleration."""
        return motion.acceleration[:, row]


@dataclass(frozen=True)
class JointSpring(PerJoint):
    """k_1: the paper's unexplained twelfth parameter, taken for the linear spring of a cable harness.

    Zero, and not estimated, but for the joints in `options["free"]` (true: all).
    """

    kind: ClassVar[str] = "joint_spring"
    words: ClassVar[str] = "joint spring k_1"
    symbol: ClassVar[str] = "k_1"
    unit: ClassVar[str] = "N m/rad"
    dimension: ClassVar[tuple[int, int, int]] = (1, 0, 0)

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """A spring at every joint, held at zero where it is not free."""
        free = chosen_joints(arm, options.get("free"))
        parameters = tuple(
            Parameter(cls.symbol, name, cls.unit, dimension=cls.dimension, held=name not in free)
            for name in arm.joint_names
        )
        return (cls(parameters, options=dict(options)),)

    @staticmethod
    def signal(motion: Motion, row: int) -> FloatArray:
        """Joint position."""
        return motion.position[:, row]


@dataclass(frozen=True)
class TorqueOffset(PerJoint):
    """A constant torque: current sensor offset, or what Coulomb friction differs by in its two directions."""

    kind: ClassVar[str] = "torque_offset"
    words: ClassVar[str] = "torque offset"
    symbol: ClassVar[str] = "offset"
    unit: ClassVar[str] = "N m"
    dimension: ClassVar[tuple[int, int, int]] = (0, 0, 0)

    @staticmethod
    def signal(motion: Motion, row: int) -> FloatArray:
        """(N,) ones: the torque does not depend on the motion."""
        return np.ones(len(motion.position))
