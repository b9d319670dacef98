"""What the arm carries, stands on or touches: payload, tilt, a floating base, a contact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import EARTH, Arm
from ..background import Background
from ..frames import frames_of
from ..free_base import BELOW_M, DEEPEST_M, INERTIA_RATIOS, MASS_RATIOS, FreeBase
from ..regressor import INERTIAL_SYMBOLS, cross, rigid_body_blocks
from ..term import Columns, Constant, Parameter, Values
from .effect import Effect, Options, Shown, each, known_joint, nothing, share_of
from .linearised import COARSE_HZ, interpolate, rigid_torque
from .window import STARTS_S, LastingEvent, long_window, shares_within

MASS = INERTIAL_SYMBOLS[:4]
HEAVIEST_KG, LONGEST_M = 50.0, 2.0
"""Of a payload; one as heavy as the arm where that is more: rated payloads are 0.1 to 0.3 of an arm's mass."""


@dataclass(frozen=True)
class Payload(Effect):
    """A body fixed to a link, the last one as a rule: mass and first moment, and inertia in the fuller form."""

    kind: ClassVar[str] = "payload"
    shown_over = ("position",)
    bodily: ClassVar[bool] = True
    words: ClassVar[str] = "an unknown payload"
    equation: ClassVar[str] = "Y_k [m, m c]"
    source: ClassVar[str] = "Khalil, Gautier and Lemoine 2007"
    experiment: ClassVar[str] = "the same motion with the gripper turned by a right angle"
    remedy: ClassVar[str] = (
        "take it off if it should not be there; else enter its mass and centre as the payload of controller and model"
    )
    weighs: ClassVar[bool] = True
    often: ClassVar[float] = 0.8

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """On the last link, as a point or with inertia of its own, all the time or for a while; on any other.

        A gripper may hold the same body elsewhere in another recording (`regripped`): the mass stays.
        """
        last = {"joint": arm.joint_names[-1], "last": True}
        yield last
        # An object away from the joint's origin has inertia there even as a point.
        yield {**last, "inertia": True, "for_a_while": True}
        yield {**last, "inertia": True}
        yield {**last, "inertia": True, "regripped": True}
        for joint in reversed(arm.joint_names[:-1]):
            yield {"joint": joint}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """On the link of one joint."""
        if place.get("for_a_while"):
            cls = HeldObject
        joint = known_joint(arm, place)
        units = {"m": "kg", "mcx": "kg m", "mcy": "kg m", "mcz": "kg m"}
        scales = {"m": 2.0, "mcx": 0.5, "mcy": 0.5, "mcz": 0.5}
        most = {"m": max(HEAVIEST_KG, arm.mass)}
        parameters = [
            Parameter(f"d{s}", joint, units[s], scale=scales[s], lower=-most.get(s, np.inf), upper=most.get(s, np.inf))
            for s in MASS
        ]
        if place.get("inertia"):
            # All six: without gravity the products of inertia of a body beside the axis pass for its first moment.
            parameters += [
                Parameter(f"d{symbol}", joint, "kg m^2", scale=0.2) for symbol in INERTIAL_SYMBOLS[len(MASS) :]
            ]
        return cls(tuple(parameters), long_window(joint) if place.get("for_a_while") else (), place=place)

    @property
    def per_recording(self) -> tuple[int, ...]:
        """Where it is held."""
        return tuple(range(1, len(self.parameters))) if self.place.get("regripped") else ()

    def excludes(self, other: Effect) -> bool:
        """A load on another link: an arm carries one, and two imitate whatever moves mass between links.

        Hysteresis of a wrist was 27 kg more on one link and as much less on the next.
        """
        return isinstance(other, Payload) and other.place["joint"] != self.place["joint"]

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """A mass within reach of its link; a negative one only where a tool was taken off, at the last link."""
        mass, moment = float(parameters[0]), float(np.linalg.norm(parameters[1:4]))
        if mass < 0 and not self.place.get("last"):
            return False
        return moment < LONGEST_M * abs(mass)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The regressor's columns of that link."""
        rows = range(len(motion.joints))
        if background is None or background.arm is None:
            return nothing(motion, rows, len(self.parameters))
        arm, link = background.arm, motion.joints.index(self.place["joint"])
        blocks = background.keep(
            "blocks", lambda: rigid_body_blocks(arm, motion.position, motion.velocity, motion.acceleration, motion.base)
        )
        count = len(self.parameters)
        return each({row: blocks[row, link][:count].T for row in rows if (row, link) in blocks})

    def shown(self, values: FloatArray) -> Shown:
        """Mass, and where it is."""
        known = {"mass": (float(values[0]), "kg")}
        for symbol, moment in zip(("x", "y", "z"), values[1:4]):
            known[f"moment_{symbol}"] = (float(moment), "kg m")
        return known

    def where(self, values: FloatArray) -> str:
        """On which link."""
        held = ", at another position in the held-out recordings" if self.per_recording else ""
        return f"{values[0]:.3g} kg on the link of {self.place['joint']}{held}"


@dataclass(frozen=True)
class HeldObject(LastingEvent, Payload):
    """An object that the last link picks up, carries and puts down again."""

    words: ClassVar[str] = "an object was picked up and put down again"
    equation: ClassVar[str] = "Y_k [m, m c] between t_0 and t_1"
    experiment: ClassVar[str] = "the same motion with an empty gripper"
    remedy: ClassVar[str] = (
        "enter its mass and centre as the payload while it is held, or leave that time out of what is fitted"
    )

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """A mass within reach of its link, and no negative one."""
        return float(parameters[0]) > 0.0 and super().plausible(parameters, constants)

    def shown(self, values: FloatArray) -> Shown:
        """Mass, where it is, and when."""
        count = len(self.parameters)
        window = {constant.symbol: (float(x), constant.unit) for constant, x in zip(self.constants, values[count:])}
        return {**super().shown(values[:count]), **window}

    def where(self, values: FloatArray) -> str:
        """Its window, and on which link."""
        start, length = values[len(self.parameters) :]
        return f"from {start:.1f} s for {length:.1f} s, {super().where(values)}"


def turned_gravity(gravity: FloatArray, tilt: Values) -> FloatArray:
    """(2, 3) change of gravity in the base frame per angle about x and y; with the angles it is the whole change.

    Rodrigues' formula for -t, since turning the base by t turns gravity, seen from the base, by -t.

    Args:
        gravity: (3,) of the level base, m/s^2.
        tilt: Rotation vector's x and y, rad.
    """
    axes, turn = np.eye(3)[:2], np.array([tilt[0], tilt[1], 0.0])
    angle = float(np.linalg.norm(turn))
    linear = np.sinc(angle / np.pi) * np.cross(gravity, axes)
    return np.asarray(linear + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * np.cross(axes, np.cross(turn, gravity)))


@dataclass(frozen=True)
class BaseTilt(Effect):
    """Gravity does not come from where the model has it."""

    kind: ClassVar[str] = "base_tilt"
    shown_over = ("position",)
    bodily: ClassVar[bool] = True
    words: ClassVar[str] = "the base is tilted"
    equation: ClassVar[str] = "G(q; tilt x g)"
    source: ClassVar[str] = "gravity as a prior, paper §2.2.2"
    sizes: ClassVar[tuple[str, ...]] = ("tilt",)
    experiment: ClassVar[str] = "a level on the base; or the same motion with joint 1 turned by a right angle"
    remedy: ClassVar[str] = "level the base, or enter the direction of gravity (--gravity)"

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """One, where there is gravity."""
        if np.any(arm.gravity):
            yield {}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """Of the base."""
        return cls(
            tuple(Parameter(s, "base", "rad", scale=0.1, lower=-0.4, upper=0.4) for s in ("tilt_x", "tilt_y")),
            place=place,
        )

    def around(self, parameters: Values) -> Effect:
        """By how much gravity turns depends on how far it has turned."""
        return replace(self, point=tuple(parameters))

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Static torque under the change of gravity, which is turned about x and y."""
        rows = range(len(motion.joints))
        if background is None or background.arm is None or background.inertials is None:
            return nothing(motion, rows, 2)
        arm, inertials, point = background.arm, background.inertials, self._own(background)

        def compute() -> FloatArray:
            fields = turned_gravity(arm.gravity, point)
            return np.stack([rigid_torque(arm.with_gravity(g), inertials, motion.position) for g in fields], axis=2)

        # Around each point of a search the columns are wanted once; those of the model again and again.
        columns = compute() if self.point else background.keep("tilt", compute)
        return each({row: columns[:, row] for row in rows})

    def shown(self, values: FloatArray) -> Shown:
        """Both angles and their size."""
        return {
            "tilt": (float(np.hypot(*values[:2])), "rad"),
            "tilt_x": (float(values[0]), "rad"),
            "tilt_y": (float(values[1]), "rad"),
        }


@dataclass(frozen=True)
class FloatingBase(Effect):
    """The base is free and moves as the arm does: momentum stays zero.

    Where the base's motion was recorded the rigid body's columns have it already, and there is nothing left to explain.
    """

    kind: ClassVar[str] = "floating_base"
    bodily: ClassVar[bool] = True
    words: ClassVar[str] = "the base floats and reacts"
    equation: ClassVar[str] = "-M_mb M_bb^-1 (M_bm qdd + c_b)"
    source: ClassVar[str] = "Umetani and Yoshida 1989"
    experiment: ClassVar[str] = (
        "record /base_imu; move one joint alone, then the next (spacearm excite --for elasticity)"
    )
    remedy: ClassVar[str] = (
        "record /base_imu, so that the base's motion is known rather than inferred; plan with the model that has it"
    )

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """One."""
        yield {}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """Of the base."""
        share = share_of("base")
        total = max(arm.mass, 1.0)
        # Not its radius of gyration: mass and radius are searched one after the other, and the data know their inertia
        # first. A mass that is changed at a fixed radius hardly leaves its grid point.
        inertia = tuple(total * ratio for ratio in INERTIA_RATIOS)
        mass = tuple(total * ratio for ratio in MASS_RATIOS)
        constants = (
            Constant("inertia", "base", "kg m^2", inertia),
            Constant("mass", "base", "kg", mass),
            Constant("below", "base", "m", (BELOW_M,), reach=(0.0, DEEPEST_M)),
        )
        return cls((share,), constants, place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """What the rows of all joints differ by."""
        rows = range(len(motion.joints))
        if background is None or background.arm is None or background.inertials is None or motion.base is not None:
            return nothing(motion, rows, 1)
        arm, inertials = background.arm, background.inertials
        # On a coarse grid.
        step = max(1, int(motion.rate_hz / COARSE_HZ))

        def compute() -> FreeBase:
            return FreeBase(
                arm, inertials, motion.position[::step], motion.velocity[::step], motion.acceleration[::step]
            )

        change = background.keep("free", compute).change(*constants)
        torque = interpolate(change, np.arange(len(motion.position)) / step)
        return each({row: torque[:, [row]] for row in rows})

    def shown(self, values: FloatArray) -> Shown:
        """Mass, inertia about its centre, the radius of gyration that they make, and how far below the foot that is."""
        turn, mass, below = map(float, values[1:4])
        radius = float(np.sqrt(turn / mass))
        return {"mass": (mass, "kg"), "inertia": (turn, "kg m^2"), "radius": (radius, "m"), "below": (below, "m")}


OUTER_LINKS = 4
"""Those that reach where something may be in the way."""
LARGEST_FORCE = 300.0
"""N: of a person, a cable, a fixture touched in passing (the field's examples: 3 to 40); of an arm that weighs more,
its weight."""
RISE_S, RISE_REACH = 0.1, (0.01, 2.5)
"""How long a touch takes to come, and to go; at most half of how long it lasts."""
POINT_REACH = (-0.3, 0.3)
"""m from the link's joint, along each axis of its frame."""


@dataclass(frozen=True)
class ExternalContact(Effect):
    """Something pushed a link for a while, at one point of it, in one direction of the base frame."""

    kind: ClassVar[str] = "external_contact"
    shown_over = ()
    bodily: ClassVar[bool] = True
    one_cause: ClassVar[bool] = True
    words: ClassVar[str] = "something touched the arm for a while"
    equation: ClassVar[str] = "J(q, p)^T F between t_0 and t_1, with soft edges"
    source: ClassVar[str] = "De Luca and Mattone 2005"
    sizes: ClassVar[tuple[str, ...]] = ("force",)
    experiment: ClassVar[str] = "the same motion again: a contact does not come back at the same place by itself"
    remedy: ClassVar[str] = "find out what touched the arm then, and leave that time out of what is fitted"

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """On one of the outer links."""
        for joint in arm.joints[-OUTER_LINKS:]:
            if joint.parent >= 0:
                yield {"joint": joint.name}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """On a link; its window and its point are searched."""
        joint = known_joint(arm, place)
        most = max(LARGEST_FORCE, arm.mass * float(np.linalg.norm(EARTH)))
        parameters = tuple(
            Parameter(f"force_{axis}", joint, "N", scale=50.0, lower=-most, upper=most) for axis in "xyz"
        )
        start = Constant("start", joint, "s", STARTS_S, begins=True)
        length = Constant("length", joint, "s", (0.75, 1.5, 3.0, 6.0, 12.0))
        rise = Constant("rise", joint, "s", (RISE_S,), reach=RISE_REACH)
        point = (Constant(f"point_{axis}", joint, "m", (0.0,), reach=POINT_REACH) for axis in "xyz")
        return cls(parameters, (start, length, rise, *point), place=place)

    def again(self, arm: Arm) -> Effect:
        """Another touch of the same link."""
        return replace(self)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Torque that holds against a force on the link along each base axis, within the window."""
        number = motion.joints.index(self.place["joint"])
        rows = range(number + 1)
        if background is None or background.arm is None or self.elsewhere(motion):
            return nothing(motion, rows, 3)
        arm, count = background.arm, len(motion.joints)

        def compute() -> FloatArray:
            # What holds against a force along each base axis at the link's joint, and more at a metre along its axes.
            frames, row = frames_of(arm, motion.position), number
            turn, at = frames[number + 1]
            held = np.zeros((4, 3, len(motion.position), count))
            while row >= 0:
                joint, (own, origin) = arm.joints[row], frames[row + 1]
                axis = np.einsum("ijt,j->it", own, joint.axis)
                if joint.revolute:
                    levers = [at - origin, *np.swapaxes(turn, 0, 1)]
                    held[..., row] = [cross(axis, lever) for lever in levers]
                else:
                    held[0, ..., row] = axis
                row = joint.parent
            return held

        start, length, rise, *point = constants
        at, pushed = shares_within(motion, start, length, rise)
        jacobian = np.tensordot([1.0, *point], background.keep(("push", number), compute)[:, :, at], 1)
        torque = np.zeros((count, len(motion.position), 3))
        torque[:, at] = -np.transpose(jacobian, (2, 1, 0)) * pushed[:, None]
        return each({row: torque[row] for row in rows})

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """Whether it is a touch: a direction that hardly shows may be fitted with any force."""
        return float(np.linalg.norm(parameters)) < self.parameters[0].upper

    def shown(self, values: FloatArray) -> Shown:
        """Force, window and point."""
        values = values.copy()
        values[5] = min(values[5], 0.5 * values[4])
        return {
            "force": (float(np.linalg.norm(values[:3])), "N"),
            **{f"force_{axis}": (float(f), "N") for axis, f in zip("xyz", values)},
            **{constant.symbol: (float(x), constant.unit) for constant, x in zip(self.constants, values[3:])},
        }

    def where(self, values: FloatArray) -> str:
        """Its window."""
        window = f"from {values[3]:.1f} s for {values[4]:.1f} s"
        return f"{window}, {np.linalg.norm(values[:3]):.1f} N on the link of {self.place['joint']}"
