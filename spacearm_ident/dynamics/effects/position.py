"""What depends on where a joint stands: torque ripple, the harness, an eccentric encoder, one whose zero has moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Constant, Parameter, Values
from .effect import Effect, Options, Shown, each, known_joint, nothing, own
from .linearised import by_position


@dataclass(frozen=True)
class TorqueRipple(Effect):
    """A torque that comes back so many times a turn: cogging, tooth mesh, a wave generator."""

    kind: ClassVar[str] = "torque_ripple"
    follows: ClassVar[str] = "position"
    words: ClassVar[str] = "torque ripple over the joint's position"
    equation: ClassVar[str] = "a sin(N q) + b cos(N q)"
    source: ClassVar[str] = "cogging and gear mesh; Olsen and Petersen 2001"
    experiment: ClassVar[str] = "slow constant speed over its range in both directions (--for ripple)"
    remedy: ClassVar[str] = "use the model that has it as feed-forward; if it is new, look at the motor and the gear"

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        # Fewer cycles are a smooth function of position: harness, gravity.
        cycles = Constant("cycles", joint, "1/rev", tuple(float(n) for n in range(3, 241)))
        number = "" if place.get("number", 1) == 1 else f"_{place['number']}"
        symbols = (f"sin{number}", f"cos{number}")
        cycles = replace(cycles, symbol=f"cycles{number}")
        return cls(tuple(Parameter(symbol, joint, "N m") for symbol in symbols), (cycles,), place=place)

    def again(self, arm: Arm) -> Effect:
        """With another number of cycles."""
        return TorqueRipple.at(arm, {**self.place, "number": int(self.place.get("number", 1)) + 1})

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Sine and cosine."""
        row = motion.joints.index(self.place["joint"])
        angle = constants[0] * motion.position[:, row]
        return own(row, np.sin(angle), np.cos(angle))

    def shown(self, values: FloatArray) -> Shown:
        """Amplitude, cycles and phase."""
        return {
            "amplitude": (float(np.hypot(*values[:2])), "N m"),
            "cycles": (float(values[2]), "1/rev"),
            "phase": (float(np.arctan2(values[1], values[0])), "rad"),
        }

    def where(self, values: FloatArray) -> str:
        """With its number of cycles."""
        return f"{values[2]:.4g} cycles a joint revolution, {np.hypot(*values[:2]):.2g} N m in amplitude"


SIDES = ("above", "below")
"""Of the position from which a one-sided spring pulls."""
ANGLES = 12
"""Positions at which a one-sided spring may begin; the search goes on between them."""
PASSED = (2.0, 98.0)
"""Percentiles of the recorded positions between which it may: what a joint hardly reaches, or hardly leaves, a few rows
would decide. Generic rivals follow a position between the same (`mismatch.rivals.INNER`)."""
AT_END = 0.01
"""Share of the range from where it may begin: nearer to an end it begins beyond, and its stiffness is another."""


@dataclass(frozen=True)
class HarnessSpring(Effect):
    """Cables that pull a joint towards where they are slack; with a `side`, on one side of a position alone.

    The stiffness is not negative: a spring pulls back, in whichever direction it was bent, and never pushes on.
    """

    kind: ClassVar[str] = "harness_spring"
    follows: ClassVar[str] = "position"
    words: ClassVar[str] = "a spring, as of a cable harness, pulls the joint"
    beyond: ClassVar[str] = "a spring pulls the joint back beyond a position, as a taut cable or a soft stop does"
    """Words of the one-sided form."""
    equation: ClassVar[str] = "k (q - q_0); one-sided: k (q - q_1) where q > q_1, or where q < q_1, else 0"
    source: ClassVar[str] = (
        "cable harnesses of space manipulators; one-sided: the spring of a unilateral contact, Hunt and Crossley 1975"
    )
    experiment: ClassVar[str] = (
        "slow constant speed over its range, then once more with the next joints folded (--for ripple)"
    )
    remedy: ClassVar[str] = "look at cables, hoses and stops of the joint; if they stay so, use the model that has it"
    forms: ClassVar[tuple[Options, ...]] = ({}, *({"side": side} for side in SIDES))

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint; on the `side` `above` or `below` of a position within `range`, where it is one-sided."""
        joint = known_joint(arm, place)
        rate = Parameter("stiffness", joint, "N m/rad", dimension=(1, 0, 0), lower=0.0)
        if "side" not in place:
            return cls((rate, Parameter("preload", joint, "N m")), place=place)
        side = place["side"]
        if side not in SIDES:
            raise ValueError(f"side is {' or '.join(SIDES)}")
        low, high = place.get("range", (-np.pi, np.pi))
        begins = Constant(side, joint, "rad", tuple(np.linspace(low, high, ANGLES).tolist()), position=True)
        return cls((replace(rate, symbol=f"stiffness_{side}"),), (begins,), place=place)

    @property
    def one_sided(self) -> bool:
        """Whether it pulls on one side of a position alone."""
        return "side" in self.place

    @property
    def rarity(self) -> int:
        """Over the whole range, if that explains as much."""
        return int(self.one_sided)

    def over(self, arm: Arm, motions: Sequence[Motion]) -> Effect:
        """One-sided from a position that these motions pass."""
        if not self.one_sided:
            return self
        passed = np.concatenate([motion.position[:, motion.joints.index(self.place["joint"])] for motion in motions])
        return self.at(arm, {**self.place, "range": np.percentile(passed, PASSED).tolist()})

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Position, and one for where it is slack; one-sided: how far beyond."""
        row = motion.joints.index(self.place["joint"])
        position = motion.position[:, row]
        if self.one_sided:
            far = position - constants[0]
            return own(row, np.maximum(far, 0.0) if self.place["side"] == "above" else np.minimum(far, 0.0))
        return own(row, position, np.ones(len(position)))

    def against(self, values: FloatArray) -> str:
        """Where it begins must have been passed: at an end of the range it may as well begin further out."""
        if not self.one_sided:
            return ""
        low, high = self.constants[0].bounds
        near = AT_END * (high - low)
        return "" if low + near < values[1] < high - near else "beginning is at an end of where the joint has been"

    def where(self, values: FloatArray) -> str:
        """One-sided: from which position on."""
        if not self.one_sided:
            return self.words
        return f"{self.beyond}: {self.place['side']} {values[1]:.3g} {self.constants[0].unit}"


FARTHEST_OFF = 0.1
"""Share by which the slope of a reading may err: that of an encoder off its centre by e does by e / R, 1 mm of 10."""


@dataclass(frozen=True)
class EncoderEccentricity(Effect):
    """An encoder off its centre reads a position that is wrong by a sine of itself."""

    kind: ClassVar[str] = "encoder_eccentricity"
    shown_over = ("position",)
    words: ClassVar[str] = "the encoder is off its centre: its reading errs once a turn"
    equation: ClassVar[str] = "q_read = q + a sin(n q) + b cos(n q), through inertia, gravity and viscosity"
    source: ClassVar[str] = "encoder data sheets"
    experiment: ClassVar[str] = (
        "constant speed over its range: eccentricity shows in velocity, ripple in torque (--for ripple)"
    )
    remedy: ClassVar[str] = "centre the encoder, or correct its reading by this curve"
    turns: ClassVar[bool] = True
    forms: ClassVar[tuple[Options, ...]] = tuple({"cycles": cycles} for cycles in range(1, 9))
    """Up to eight times a turn: an encoder off its centre once, a bent disc twice, a resolver by its poles."""

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        bound = FARTHEST_OFF / float(place.get("cycles", 1))
        symbols = ("sin", "cos")
        parameters = tuple(Parameter(symbol, joint, "rad", scale=1e-3, lower=-bound, upper=bound) for symbol in symbols)
        return cls(parameters, place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Torque of the motion that was read, less that of the motion that was."""
        row = motion.joints.index(self.place["joint"])
        if background is None or background.arm is None:
            return nothing(motion, range(len(motion.joints)), 2)
        sensitivity = by_position(motion, background, row)
        order = float(self.place.get("cycles", 1))
        angle = order * motion.position[:, row]
        joint = motion.joints[row]
        rotor, viscous = (background.values.get(f"{symbol}[{joint}]", 0.0) for symbol in ("J_m", "k_v1"))
        parts = []
        for error in (np.sin(angle), np.cos(angle)):
            rate = np.gradient(error) * motion.rate_hz
            change = sensitivity.torque(error)
            change[:, row] += rotor * np.gradient(rate) * motion.rate_hz + viscous * rate
            parts.append(-change)
        both = np.stack(parts, axis=2)
        return each({k: both[:, k] for k in range(len(motion.joints))})

    def shown(self, values: FloatArray) -> Shown:
        """Amplitude and phase."""
        return {
            "amplitude": (float(np.hypot(*values[:2])), "rad"),
            "phase": (float(np.arctan2(values[1], values[0])), "rad"),
        }


FARTHEST_ZERO = 0.3
"""rad: by which a zero may have moved; farther, torque is not linear in it, and `check` finds it by itself."""


@dataclass(frozen=True)
class EncoderZero(Effect):
    """The zero of an encoder is elsewhere than it was: it slipped, or was set anew."""

    kind: ClassVar[str] = "encoder_zero"
    shown_over = ("position",)
    words: ClassVar[str] = "the encoder's zero has moved"
    equation: ClassVar[str] = "q_read = q + e, through inertia and gravity"
    source: ClassVar[str] = "the model's gradient by position"
    experiment: ClassVar[str] = "move the joint to its reference mark and read the encoder"
    remedy: ClassVar[str] = (
        "set the encoder's zero again at the joint's reference mark, or correct it (position_offset_rad)"
    )
    turns: ClassVar[bool] = True
    needs_reference = True
    """A zero that is wrong from the start is one of the model's own first moments."""

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        zero = Parameter("zero", joint, "rad", scale=0.02, lower=-FARTHEST_ZERO, upper=FARTHEST_ZERO)
        return cls((zero,), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Torque of the motion that was read, less that of the motion that was."""
        rows = range(len(motion.joints))
        if background is None or background.arm is None:
            return nothing(motion, rows, 1)
        sensitivity = by_position(motion, background, motion.joints.index(self.place["joint"]))
        change = -sensitivity.torque(np.ones(len(motion.position)))
        return each({k: change[:, [k]] for k in rows})
