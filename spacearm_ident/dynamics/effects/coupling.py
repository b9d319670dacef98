"""What one joint's motor feels of another joint's motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Parameter, Values
from .effect import Effect, Options, each, nothing
from .linearised import rigid_torque

RIGHT_ANGLE = 1e-3
"""Cosine below which two axes are at right angles: 1.57 in place of half of pi leaves 8e-4 of it."""
DRY = 0.3
"""Gears rub dry by as much, at least, as their viscous friction is at this speed, rad/s."""


@dataclass(frozen=True)
class RotorCoupling(Effect):
    """A rotor turns with its gear ratio about an axis that other joints carry around.

    That axis is the joint's own. Where the joint's neighbour is at right angles to it always, the two alone couple if
    bevel gears turn the motor's: J is then of what turns about the neighbour's axis.
    """

    kind: ClassVar[str] = "rotor_coupling"
    shown_over = ("acceleration",)
    words: ClassVar[str] = "the spinning rotor couples joints"
    equation: ClassVar[str] = "J (z_i . z_j) qdd_j at joint i, and i, j exchanged; J qdd_j by bevel gears"
    source: ClassVar[str] = "Murphy, Wen and Saridis 1991"
    experiment: ClassVar[str] = "quick moves of each of the two joints alone, with the other held (--for elasticity)"
    remedy: ClassVar[str] = "use the model that has it: it is a property of the drives' arrangement"

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """The rotor of every joint that another carries."""
        for number, joint in enumerate(arm.joints):
            if joint.parent >= 0:
                yield {"joint": joint.name}
                yield {"joint": joint.name, "with": arm.joint_names[arm.supports(number)[1]]}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """The rotor of one joint, with all that carry it or one of them."""
        joint = place["joint"]
        if joint not in arm.joint_names or place.get("with", joint) not in arm.joint_names:
            raise ValueError(f"the arm has not both joints {joint!r} and {place.get('with')!r}")
        if arm.joints[arm.joint_names.index(joint)].parent < 0:
            raise ValueError(f"no joint carries {joint!r}")
        return cls((Parameter("J", joint, "kg m^2", scale=0.5),), place=place)

    @property
    def joints(self) -> tuple[str, ...]:
        """Its rotor's joint, and the other where it is one."""
        other = self.place.get("with")
        return (self.place["joint"],) if other is None else (other, self.place["joint"])

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Accelerations of the others, by how far the axes point the same way."""
        number = motion.joints.index(self.place["joint"])
        if background is None or background.arm is None:
            return nothing(motion, range(number + 1), 1)
        arm = background.arm
        carriers = arm.supports(number)[1:]
        if "with" in self.place:
            carriers = (motion.joints.index(self.place["with"]),)
        aligned = background.keep(("aligned", number), lambda: _alignment(arm, motion, number))
        if "with" in self.place and carriers == (arm.joints[number].parent,) and not aligned[:, carriers].any():
            aligned = np.ones_like(aligned)
        columns = {row: (aligned[:, row] * motion.acceleration[:, number])[:, None] for row in carriers}
        mine = sum(aligned[:, row] * motion.acceleration[:, row] for row in carriers)
        return each({**columns, number: np.asarray(mine)[:, None]})


def _alignment(arm: Arm, motion: Motion, joint: int) -> FloatArray:
    """(N, n) cosine between the axis of a joint and every joint's; zero where they are at right angles always."""
    # A body with inertia about the joint's axis alone, spun about it: each joint feels its share.
    axis = arm.joints[joint].axis
    body = np.zeros((len(arm.joints), 10))
    x, y, z = axis
    body[joint, 4:] = x * x, x * y, y * y, x * z, y * z, z * z
    unit = np.zeros_like(motion.position)
    unit[:, joint] = 1.0
    cosines = rigid_torque(arm.with_gravity(np.zeros(3)), body, motion.position, None, unit)
    return np.where(np.abs(cosines).max(axis=0) < RIGHT_ANGLE, 0.0, cosines)


@dataclass(frozen=True)
class WristCoupling(Effect):
    """A gear train through a neighbour: a motor turns with the sum of two joints' motions, and rubs with it.

    Where the reference has the motor's inertia and friction turn with the joint alone, they are taken away there
    (`moved`): what is added is what they are of both motions, less what they are of the joint's own.
    """

    kind: ClassVar[str] = "wrist_coupling"
    shown_over = ("velocity",)
    words: ClassVar[str] = "a joint feels its neighbour's motion through the gears"
    equation: ClassVar[str] = (
        "[f sgn + k] (q_d,other) at the joint; or the same of the sum of both, at both, "
        "less that of its own at the joint"
    )
    source: ClassVar[str] = "Stäubli TX wrist; Gautier and Briot 2014"
    experiment: ClassVar[str] = "each joint of the wrist alone at constant speed, the others still (--for ripple)"
    remedy: ClassVar[str] = (
        "check the wrist's coupling ratio in the conversion of motor to joint positions; else use the model that has it"
    )

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """Neighbours either way, and a motor between both."""
        for first, second in pairwise(arm.joint_names):
            yield {"joint": first, "with": second}
            yield {"joint": second, "with": first}
            for ratio in (1.0, -1.0):
                yield {"joint": second, "with": first, "ratio": ratio}
                yield {"joint": second, "with": first, "ratio": ratio, "moved": True}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint, with another."""
        if place["joint"] not in arm.joint_names or place["with"] not in arm.joint_names:
            raise ValueError(f"the arm has not both joints {place['joint']!r} and {place['with']!r}")
        units = {"J": "kg m^2", "k": "N m s/rad", "f": "N m"}
        parameters = tuple(Parameter(s, place["joint"], unit, scale=10.0) for s, unit in units.items())
        return cls(parameters, place=place)

    def plausible(self, values: FloatArray, constants: Values) -> bool:
        """Gears rub dry: what grows with speed alone, or drives what it should brake, is no gear (a gyroscope, say)."""
        _, viscous, dry = values
        if "ratio" in self.place and dry <= 0.0:
            return False
        return bool(abs(dry) >= DRY * abs(viscous) and (viscous * dry >= 0.0 or abs(viscous) < abs(dry)))

    @property
    def needs_reference(self) -> bool:
        """What is taken away at the joint is free where the field's own fit is the base."""
        return bool(self.place.get("moved"))

    @property
    def joints(self) -> tuple[str, ...]:
        """The joint that feels it, then the other."""
        return (self.place["joint"], self.place["with"])

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Acceleration, velocity and direction of the other joint; with `ratio`, of other + ratio × own joint."""
        row, other = (motion.joints.index(self.place[key]) for key in ("joint", "with"))
        ratio = self.place.get("ratio")
        mine = 0.0 if ratio is None else float(ratio)
        speed = motion.velocity[:, other] + mine * motion.velocity[:, row]
        accelerated = motion.acceleration[:, other] + mine * motion.acceleration[:, row]
        columns = _turned(accelerated, speed, motion.speed_noise[other])
        if ratio is None:
            return each({row: columns})
        own = mine * columns
        if self.place.get("moved"):
            own = own - _turned(motion.acceleration[:, row], motion.velocity[:, row], motion.speed_noise[row])
        return each({other: columns, row: own})


def _turned(acceleration: FloatArray, speed: FloatArray, noise: float) -> FloatArray:
    """(N, 3) what a motor's inertia, viscous and Coulomb friction give as it turns."""
    return np.stack([acceleration, speed, np.sign(speed) * (np.abs(speed) > noise)], axis=1)
