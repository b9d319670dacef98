"""Friction that is not as the model has it: its level, or what it depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..friction import bristle_state
from ..term import Columns, Constant, Parameter, Values
from .effect import Effect, Options, direction, each, known_joint, known_joints, nothing, own, share_of
from .warmth import above_reference, excess_of
from .window import LastingEvent, long_window

BETWEEN = 1.05
"""A constant nearer to the end of its grid than this ratio is at its end."""
SPOT_GRID = tuple(float(q) for q in np.linspace(-3.2, 3.2, 33))
WIDTH_GRID = (0.1, 0.2, 0.4, 0.8)
"""rad: a dent in a race or a seal that pinches, to a part of the range that is worn."""
SHORT_RAD, MOST_OF_IT = 1e-3, 0.5
"""Distance d_s, rad, below which any bearing shows the friction transition at a reversal; and the share of f_c that a
finding below it must have. In blind trials f of true findings was at least 1.15 f_c, of false ones 0.07 to 0.16 f_c."""
MOST_OF_INPUT, MOST_OF_OUTPUT = 0.4, 0.6
"""Largest friction by the load on either side of a gear: what gives 1 on its output takes 1.67, or 1.6, on its input; a
strain-wave gear in the cold, or a worm, has less than two thirds of efficiency."""
BELL = 4.0
"""Widths from its centre beyond which a spot is not felt."""


@dataclass(frozen=True)
class _Friction(Effect):
    friction: ClassVar[bool] = True

    def row(self, motion: Motion) -> int:
        """Its joint's row."""
        return motion.joints.index(self.place["joint"])


@dataclass(frozen=True)
class FrictionDrift(_Friction):
    """The level of Coulomb or viscous friction is another than it was, or creeps while the arm moves."""

    kind: ClassVar[str] = "friction_drift"
    follows: ClassVar[str] = "velocity"
    words: ClassVar[str] = "friction level changed"
    equation: ClassVar[str] = "(df_c + creep t) sgn(qd) + dk_v1 qd, t since the recording began"
    source: ClassVar[str] = "paper eq. 2; wear and lubrication"
    experiment: ClassVar[str] = (
        "constant speeds there and back after a rest, with the joint temperatures recorded (--for temperature)"
    )
    remedy: ClassVar[str] = (
        "look at what changed there (lubricant, preload, brake, temperature); if the arm stays so, identify it again"
    )
    forms: ClassVar[tuple[Options, ...]] = (
        *({"of": of} for of in (["f_c"], ["k_v1"], ["f_c", "k_v1"], ["creep"])),
        {"of": ["f_c"], "for_a_while": True},
    )

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint: `of` names the levels that changed, or that the Coulomb level creeps; `for_a_while`, when."""
        if place.get("for_a_while"):
            cls = PassingFriction
        joint = known_joint(arm, place)
        known = {
            "f_c": Parameter("df_c", joint, "N m"),
            "k_v1": Parameter("dk_v1", joint, "N m s/rad", dimension=(0, 1, 0)),
            "creep": Parameter("creep", joint, "N m/s", scale=1.0),
        }
        window = long_window(joint) if place.get("for_a_while") else ()
        return cls(tuple(known[symbol] for symbol in place.get("of", ["f_c"])), window, place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Direction, velocity, and direction times time."""
        row = self.row(motion)
        sign, time = direction(motion, row), motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
        signals = {"f_c": sign, "k_v1": motion.velocity[:, row], "creep": sign * time}
        return own(row, *(signals[of] for of in self.place.get("of", ["f_c"])))

    def against(self, values: FloatArray) -> str:
        """A level rises or falls; where one part rises and the other falls it is the curve over speed that changed.

        Wear, preload and lubricant move both parts the same way, or one of them.
        """
        both = self.place.get("of") == ["f_c", "k_v1"]
        return "dry and viscous parts go opposite ways" if both and values[0] * values[1] < 0.0 else ""

    def where(self, values: FloatArray) -> str:
        """Whether it creeps."""
        return "friction creeps in time" if "creep" in self.place.get("of", ()) else self.words


@dataclass(frozen=True)
class PassingFriction(LastingEvent, FrictionDrift):
    """A joint drags for a while, as one whose brake does not open or whose gear jams; or it runs more easily."""

    follows: ClassVar[str] = ""
    words: ClassVar[str] = "friction was another for a while"
    equation: ClassVar[str] = "df_c sgn(qd) between t_0 and t_1"
    source: ClassVar[str] = "De Luca and Mattone 2003: what is wrong with one joint, and when"
    experiment: ClassVar[str] = (
        "the same motion again with the state of the joint's brake recorded (a gear that jams at a place does it again)"
    )

    def is_within(self, parameters: FloatArray, coulomb: Mapping[str, float]) -> bool:
        """Whether there is no less than none: nothing pushes a joint along."""
        return bool(parameters[0] >= -coulomb.get(self.place["joint"], 0.0))

    def where(self, values: FloatArray) -> str:
        """Its window, and how much more or less there was."""
        start, length = values[len(self.parameters) :]
        more = "more" if values[0] > 0.0 else "less"
        return f"from {start:.1f} s for {length:.1f} s, {abs(values[0]):.3g} N m {more} dry friction"


@dataclass(frozen=True)
class TemperatureFriction(_Friction):
    """Friction follows the joint's temperature."""

    kind: ClassVar[str] = "temperature_friction"
    shown_over = ("friction_time",)
    one_cause: ClassVar[bool] = True
    words: ClassVar[str] = "friction follows temperature"
    equation: ClassVar[str] = "[alpha_c sgn(qd) + alpha_v qd] (T - T_0)"
    source: ClassVar[str] = "paper §2.2.2"
    experiment: ClassVar[str] = "constant-velocity runs over a temperature sweep (spacearm excite --for temperature)"
    remedy: ClassVar[str] = "record the temperatures and identify with them (--temperature), or warm the arm up first"
    forms: ClassVar[tuple[Options, ...]] = ({"of": ["f_c"]}, {"of": ["k_v1"]}, {"of": ["f_c", "k_v1"]})
    needs_temperature = True

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint: `of` names what follows the temperature; `rising` lets friction grow with it."""
        joint = known_joint(arm, place)
        # Lubricants thin out: friction falls, unless a bearing's preload grows. Whoever asks for it is told which.
        highest = np.inf if place.get("rising") else 0.0
        known = {
            "f_c": Parameter("alpha_c", joint, "N m/K", scale=1.0, upper=highest),
            "k_v1": Parameter("alpha_v", joint, "N m s/(rad K)", scale=1.0, upper=highest),
        }
        return cls(tuple(known[symbol] for symbol in place.get("of", ["f_c"])), place=place)

    def since(self, reference: Sequence[Motion]) -> Effect:
        """The friction of the base is that at the reference's temperature."""
        return above_reference(self, reference)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Direction and velocity times the excess temperature; nothing where no temperature was recorded."""
        row = self.row(motion)
        excess = excess_of(self, motion, row)
        signals = {"f_c": direction(motion, row) * excess, "k_v1": motion.velocity[:, row] * excess}
        return own(row, *(signals[of] for of in self.place.get("of", ["f_c"])))


@dataclass(frozen=True)
class LoadFriction(_Friction):
    """Friction that grows with the load on the gear: on its output, or (`side: motor`) on its input, with friction."""

    kind: ClassVar[str] = "load_friction"
    shown_over = ("friction_position", "position")
    imitated_by: ClassVar[str] = FrictionDrift.kind
    words: ClassVar[str] = "friction grows with the load on the gear"
    equation: ClassVar[str] = "mu |tau_load| sgn(qd); by the input: tau_load = load + all friction, this one included"
    source: ClassVar[str] = "Hamon, Gautier and Garrec 2010"
    experiment: ClassVar[str] = (
        "with a known load at the flange, slow constant speed in both directions: up and down (--for ripple)"
    )
    remedy: ClassVar[str] = "look at the gear and its lubricant; if the arm stays so, use the model that has it"
    forms: ClassVar[tuple[Options, ...]] = ({}, {"side": "motor"})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        symbol = "mu_in" if place.get("side") == "motor" else "mu"
        largest = MOST_OF_INPUT if symbol == "mu_in" else MOST_OF_OUTPUT
        return cls((Parameter(symbol, known_joint(arm, place), "1", scale=0.1, lower=0.0, upper=largest),), place=place)

    def around(self, parameters: Values) -> Effect:
        """On the input it is part of the load."""
        return replace(self, point=tuple(parameters)) if self.place.get("side") == "motor" else self

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """|load| times direction.

        On the input it is part of the load: |tau| = |rest| + mu |tau| where it acts against the load's motion, and with
        the other sign where the load drives. The rest is divided by 1 -+ mu, at the value that the model has.
        """
        row = self.row(motion)
        if background is None:
            return nothing(motion, [row], 1)
        load, sign = background.load[:, row], direction(motion, row)
        if self.place.get("side") == "motor":
            rotor = background.values.get(f"J_m[{motion.joints[row]}]", 0.0)
            load = background.torque[:, row] - rotor * motion.acceleration[:, row]
            load = load / (1.0 - self._own(background)[0] * np.sign(load) * sign)
        return own(row, np.abs(load) * sign)


@dataclass(frozen=True)
class GearEfficiency(_Friction):
    """A gear that loses a share of what it transmits, another driving than driven."""

    kind: ClassVar[str] = "gear_efficiency"
    shown_over = ("friction_position", "position")
    imitated_by: ClassVar[str] = FrictionDrift.kind
    words: ClassVar[str] = "the gear loses a share of the power it transmits"
    equation: ClassVar[str] = "tau_load (1/eta - 1) driving, tau_load (eta - 1) driven"
    source: ClassVar[str] = "Chevallereau and Khalil 1987"
    experiment: ClassVar[str] = (
        "with a known load at the flange, slow constant speed in both directions: up and down (--for ripple)"
    )
    remedy: ClassVar[str] = "look at the gear and its lubricant; if the arm stays so, use the model that has it"

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        share = share_of(joint)
        # Strain-wave gears at low load or in the cold have less than one half.
        grid = (0.35, 0.43, 0.51, 0.6, 0.7, 0.76, 0.82, 0.86, 0.9, 0.93, 0.955, 0.975, 0.988, 0.995, 0.999)
        return cls((share,), (Constant("eta", joint, "1", grid),), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The loss; it always opposes the motion."""
        row = self.row(motion)
        if background is None:
            return nothing(motion, [row], 1)
        load, moving = background.load[:, row], direction(motion, row)
        eta = constants[0]
        loss = np.where(load * moving > 0, 1.0 / eta - 1.0, 1.0 - eta)
        return own(row, np.abs(load) * moving * loss)


@dataclass(frozen=True)
class PreslidingHysteresis(_Friction):
    """After a reversal friction builds up over a distance, not at once."""

    kind: ClassVar[str] = "presliding_hysteresis"
    shown_over = ("velocity",)
    words: ClassVar[str] = "friction builds up over a distance after each reversal"
    equation: ClassVar[str] = "f (z - sgn(qd)), dz/ds = (sgn(qd) - z)/d_s"
    source: ClassVar[str] = "Dahl 1968; Canudas de Wit et al. 1995"
    experiment: ClassVar[str] = "slow reversals at several amplitudes (spacearm excite --for presliding)"
    remedy: ClassVar[str] = (
        "use the model that has it where the joint reverses slowly, or leave reversals out of what is fitted"
    )

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        grid = tuple(float(d) for d in np.geomspace(1e-4, 0.04, 13))
        return cls((Parameter("f", joint, "N m", lower=0.0),), (Constant("d_s", joint, "rad", grid),), place=place)

    def within_healthy_range(self, parameters: FloatArray, constants: Values, coulomb: Mapping[str, float]) -> bool:
        """Whether it is presliding as every bearing has it: less than half of the friction, within less than 1 mrad."""
        least = MOST_OF_IT * coulomb.get(self.place["joint"], 0.0)
        return bool(constants[0] < SHORT_RAD and parameters[0] < least)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """What is missing of full friction while the bristles bend."""
        row = self.row(motion)
        moving = direction(motion, row)
        travel = np.abs(motion.velocity[:, row]) / motion.rate_hz
        state = bristle_state(moving[:, None], travel, constants[0], motion.cyclic)[:, 0]
        return own(row, state - moving)


@dataclass(frozen=True)
class PositionFriction(_Friction):
    """Friction that is not the same all around: an eccentric or worn gear, a tight spot."""

    kind: ClassVar[str] = "position_friction"
    follows: ClassVar[str] = "friction_position"
    imitated_by: ClassVar[str] = FrictionDrift.kind
    words: ClassVar[str] = "friction depends on the joint's position"
    equation: ClassVar[str] = "[a sin(n q) + b cos(n q)] sgn(qd), or a exp(-((q - q_0)/w)^2) sgn(qd)"
    source: ClassVar[str] = "Simoni et al. 2017"
    experiment: ClassVar[str] = "slow constant speed over its range in both directions (--for ripple)"
    remedy: ClassVar[str] = (
        "look at the joint there (bearing, seal, cable); if the arm stays so, use the model that has it"
    )
    forms: ClassVar[tuple[Options, ...]] = (*({"cycles": cycles} for cycles in range(1, 7)), {"spot": True})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint, with `cycles` a turn, or at a `spot`."""
        joint = known_joint(arm, place)
        if place.get("spot"):
            centre = Constant("centre", joint, "rad", SPOT_GRID, position=True)
            width = Constant("width", joint, "rad", WIDTH_GRID)
            return cls((Parameter("spot", joint, "N m"),), (centre, width), place=place)
        symbols = (f"sin_{float(place['cycles']):g}", f"cos_{float(place['cycles']):g}")
        return cls(tuple(Parameter(symbol, joint, "N m") for symbol in symbols), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Sine and cosine, or a bell, times direction."""
        row = self.row(motion)
        position, moving = motion.position[:, row], direction(motion, row)
        if self.place.get("spot"):
            away = (position - constants[0]) / constants[1]
            return own(row, np.where(np.abs(away) < BELL, np.exp(-(away**2)), 0.0) * moving)
        angle = float(self.place["cycles"]) * position
        return own(row, np.sin(angle) * moving, np.cos(angle) * moving)

    def shown(self, values: FloatArray) -> dict[str, tuple[float, str]]:
        """Amplitude and phase, or how much, where and how wide."""
        if self.place.get("spot"):
            return dict(zip(("amplitude", "centre", "width"), zip(map(float, values), ("N m", "rad", "rad"))))
        return {
            "amplitude": (float(np.hypot(*values[:2])), "N m"),
            "phase": (float(np.arctan2(values[1], values[0])), "rad"),
        }

    def where(self, values: FloatArray) -> str:
        """With its number of cycles, or where."""
        if self.place.get("spot"):
            return f"{'tight' if values[0] > 0 else 'easy'} about {values[1]:.2g} rad, times the direction of motion"
        return f"{self.place['cycles']} cycles a joint revolution, times the direction of motion"


@dataclass(frozen=True)
class AsymmetricFriction(_Friction):
    """More friction in one direction than in the other."""

    kind: ClassVar[str] = "asymmetric_friction"
    follows: ClassVar[str] = "velocity"
    words: ClassVar[str] = "more friction in one direction"
    equation: ClassVar[str] = "a + b |qd|"
    source: ClassVar[str] = "Armstrong-Hélouvry, Dupont and Canudas de Wit 1994"
    experiment: ClassVar[str] = "read the currents with the brakes on: an offset of the sensor stays, friction goes"
    remedy: ClassVar[str] = (
        "look at what drags in one direction (cable, seal, sensor offset); if the arm stays so, identify it again"
    )
    forms: ClassVar[tuple[Options, ...]] = ({"of": ["level", "viscous"]}, {"of": ["viscous"]})
    """A level alone is an offset as well."""

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        known = {
            "level": Parameter("a", joint, "N m"),
            "viscous": Parameter("b", joint, "N m s/rad", dimension=(0, 1, 0)),
        }
        return cls(tuple(known[of] for of in place.get("of", ["level"])), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """One, and speed."""
        row = self.row(motion)
        speed = np.abs(motion.velocity[:, row])
        signals = {"level": np.ones_like(speed), "viscous": speed}
        return own(row, *(signals[of] for of in self.place.get("of", ["level"])))


EXPONENTIAL = "exponential"
"""Law of a Stribeck curve that falls with speed, not with its square."""


@dataclass(frozen=True)
class Stribeck(_Friction):
    """Friction falls with speed from a level that the model does not have."""

    kind: ClassVar[str] = "stribeck"
    one_form: ClassVar[bool] = True
    follows: ClassVar[str] = "velocity"
    imitated_by: ClassVar[str] = FrictionDrift.kind
    words: ClassVar[str] = "friction is higher at low speeds"
    equation: ClassVar[str] = "f exp(-(qd/v)^2) sgn(qd), or f exp(-|qd/v|) sgn(qd)"
    source: ClassVar[str] = "paper eq. 2; Tustin 1947; Bo and Pavelescu 1982"
    experiment: ClassVar[str] = "constant speeds from a thousandth to a tenth of a radian a second (--for stribeck)"
    remedy: ClassVar[str] = "use the model that has it at low speeds; if it is new, look at the lubricant"
    forms: ClassVar[tuple[Options, ...]] = ({}, {"law": EXPONENTIAL})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        grid = tuple(float(v) for v in np.geomspace(0.008, 0.67, 12))
        return cls(
            (Parameter("f", joint, "N m", lower=0.0),), (Constant("v_b", joint, "rad/s", grid, True),), place=place
        )

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """Whether it ends at a speed that was looked at: one below all of them is how the joint turns round."""
        return constants[0] > BETWEEN * self.constants[0].grid[0]

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """A Gaussian, or an exponential, of speed times direction."""
        row = self.row(motion)
        ratio = np.abs(motion.velocity[:, row] / constants[0])
        share = np.exp(-ratio if self.place.get("law") == EXPONENTIAL else -(ratio**2))
        return own(row, share * direction(motion, row))


@dataclass(frozen=True)
class VacuumFriction(_Friction):
    """In vacuum the terms of higher order vanish, at every joint at once."""

    kind: ClassVar[str] = "vacuum_friction"
    shown_over = ("velocity",)
    one_cause: ClassVar[bool] = True
    words: ClassVar[str] = "the high-order terms of friction are gone"
    imitated_by: ClassVar[str] = FrictionDrift.kind
    in_vacuum: ClassVar[bool] = True
    equation: ClassVar[str] = "-share (k_v2 qd^2 + k_v3 qd^3)"
    source: ClassVar[str] = "paper §2.2.2"
    experiment: ClassVar[str] = "faster motion: the terms grow with the square and the cube of speed"
    remedy: ClassVar[str] = "use the model without these terms as long as the arm is in vacuum"
    of_all: ClassVar[bool] = True

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At some joints."""
        name = known_joints(arm, place)
        return cls((Parameter("share", name, "1", scale=1.0, lower=0.4, upper=1.6),), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """What the model's own terms of second and third order say, taken away."""
        rows = [motion.joints.index(joint) for joint in self.joints]
        if background is None:
            return nothing(motion, rows, 1)
        return each({row: -background.high_orders[:, [row]] for row in rows})
