"""What happens between the joint's torque and the number that is recorded for it: motor, current sensor, clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Constant, Parameter, Values
from .effect import Effect, Options, Shown, each, known_joint, known_joints, nothing, own, share_of
from .friction import FrictionDrift
from .warmth import above_reference, excess_of

MOST_PER_K = 0.004
"""Most that a torque constant changes with the temperature of its winding, 1/K: remanence falls by 0.0009 to 0.0013 of
itself (NdFeB) or by 0.002 (ferrite), and twice that covers a joint's temperature that follows its winding's by half.
What changes more is friction, which may halve in 50 K."""


@dataclass(frozen=True)
class TorqueConstant(Effect):
    """A torque constant that is not what the drive file says: all of a joint's torque is off by a factor."""

    kind: ClassVar[str] = "torque_constant"
    shown_over = ("position",)
    words: ClassVar[str] = "the torque constant is off"
    equation: ClassVar[str] = "e tau (with temperature: e tau (T - T_0))"
    source: ClassVar[str] = "demagnetisation, calibration; Gautier and Briot 2014"
    experiment: ClassVar[str] = "the same motion with a known mass at the flange"
    remedy: ClassVar[str] = (
        "correct the joint's torque constant by it, or calibrate the torque sensor against a known mass"
    )
    follows: ClassVar[str] = "torque"
    # Torque that is mostly friction has a factor where friction has changed, and friction changes by itself.
    imitated_by: ClassVar[str] = FrictionDrift.kind
    forms: ClassVar[tuple[Options, ...]] = ({"of": "level"}, {"of": "temperature"})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        if place.get("of", "level") == "temperature":
            most = MOST_PER_K
            return cls((Parameter("error_per_K", joint, "1/K", scale=most, lower=-most, upper=most),), place=place)
        return cls((Parameter("error", joint, "1", scale=0.3, lower=-0.6, upper=0.6),), place=place)

    @property
    def needs_temperature(self) -> bool:
        """Only where it follows it."""
        return bool(self.place.get("of") == "temperature")

    def since(self, reference: Sequence[Motion]) -> Effect:
        """Where it follows the temperature, the base has the constant of the reference's."""
        return above_reference(self, reference) if self.needs_temperature else self

    def shown(self, values: FloatArray) -> Shown:
        """The factor between recorded and true torque."""
        name = self.parameters[0].symbol
        shown = {name: (float(values[0]), self.parameters[0].unit)}
        return shown if self.needs_temperature else {"scale": (1.0 + float(values[0]), "1"), **shown}

    def where(self, values: FloatArray) -> str:
        """What the factor means: recorded is current times the configured constant; the true one is smaller by it."""
        error = float(values[0])
        size, other = ("large", "lower") if error > 0.0 else ("small", "higher")
        if self.needs_temperature:
            return (
                f"the recorded torque is {abs(error):.2%} too {size} for every kelvin: the torque constant is {other}"
            )
        true = abs(1.0 / (1.0 + error) - 1.0)
        return (
            f"the recorded torque is {100 * abs(error):.0f} % too {size}: "
            f"the true torque constant is {100 * true:.0f} % {other} than configured"
        )

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The model's torque."""
        row = motion.joints.index(self.place["joint"])
        if background is None:
            return nothing(motion, [row], 1)
        torque = background.torque[:, row]
        if self.needs_temperature:
            torque = torque * excess_of(self, motion, row)
        return own(row, torque)


@dataclass(frozen=True)
class MotorSaturation(Effect):
    """Torque grows less than current where the iron saturates: the recorded torque is too large at high load."""

    kind: ClassVar[str] = "motor_saturation"
    shown_over = ("position",)
    one_form: ClassVar[bool] = True
    words: ClassVar[str] = "the motor saturates: more current than torque at high load"
    equation: ClassVar[str] = "s tau^3 (deep in saturation: + s_5 tau^5)"
    source: ClassVar[str] = "first terms of the odd series of a saturating torque-current curve"
    experiment: ClassVar[str] = "high torque at low speed and low torque at high speed"
    remedy: ClassVar[str] = (
        "keep the joint's torque below where the current bends, or convert current to torque by that curve"
    )
    follows: ClassVar[str] = "torque"
    forms: ClassVar[tuple[Options, ...]] = ({}, {"terms": 2})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        first = Parameter("s", joint, "1/(N m)^2", scale=1e-3, lower=0.0)
        second = Parameter("s_5", joint, "1/(N m)^4", scale=1e-5, lower=0.0)
        return cls((first, second)[: place.get("terms", 1)], place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The cube of the model's torque, and its fifth power."""
        row, count = motion.joints.index(self.place["joint"]), len(self.parameters)
        if background is None:
            return nothing(motion, [row], count)
        torque = background.torque[:, row]
        return own(row, *(torque**power for power in (3, 5)[:count]))


@dataclass(frozen=True)
class CurrentOffset(Effect):
    """The current sensor's zero is off."""

    kind: ClassVar[str] = "current_offset"
    shown_over = ("velocity",)
    exact: ClassVar[bool] = True
    words: ClassVar[str] = "constant offset of the current sensor"
    equation: ClassVar[str] = "offset"
    source: ClassVar[str] = "current sensor data sheets"
    same_torque: ClassVar[tuple[str, ...]] = ("asymmetric_friction",)
    experiment: ClassVar[str] = "read the currents with the brakes on: an offset of the sensor stays, friction goes"
    remedy: ClassVar[str] = "set the current sensor's zero again, or take the offset off the recorded torque"

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        return cls((Parameter("offset", known_joint(arm, place), "N m"),), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """One."""
        return own(motion.joints.index(self.place["joint"]), np.ones(len(motion.position)))


@dataclass(frozen=True)
class _Late(Effect):
    """The recorded torque is later than the motion it belongs to."""

    of_all: ClassVar[bool] = True
    shown_over = ()

    def late(self, torque: np.ndarray, samples: float) -> np.ndarray:
        """The torque (N, k) after a lag of so many samples."""
        raise NotImplementedError

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """What the late torque differs by."""
        rows = [motion.joints.index(joint) for joint in self.joints]
        if background is None:
            return nothing(motion, rows, 1)
        torque = background.whole[:, rows]
        change = self.late(torque, constants[0] * motion.rate_hz) - torque
        return each({row: change[:, [k]] for k, row in enumerate(rows)})


@dataclass(frozen=True)
class TimeDelay(_Late):
    """The recorded torque is late by a fixed time; or, `early`, the motion is."""

    kind: ClassVar[str] = "time_delay"
    one_cause: ClassVar[bool] = True
    words: ClassVar[str] = "the recorded torque is late, or early, by a fixed time"
    equation: ClassVar[str] = "tau(t - d) - tau(t), d < 0 where the motion is late"
    source: ClassVar[str] = "fieldbus and filter delays; MuJoCo and PACE identification reports"
    experiment: ClassVar[str] = (
        "a chirp to the drive's bandwidth (--for elasticity): delay turns phase in proportion to it"
    )
    remedy: ClassVar[str] = (
        "shift the recorded torque by it (effort_delay_s in an arm YAML), or correct the time stamps"
    )

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """Late torque, or late positions: those come from one clock, for all joints alike."""
        yield from super().variants(arm)
        yield {"joints": list(arm.joint_names), "early": True}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At some joints alike."""
        name = known_joints(arm, place)
        if not isinstance(place.get("early", False), bool):
            raise ValueError("early is true or false")
        # Torque that was logged over a network may be a quarter of a second late.
        short = (5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 12e-3, 16e-3, 24e-3, 36e-3, 54e-3)
        grid = (*short, 81e-3, 0.12, 0.18, 0.25)
        share = share_of(name)
        return cls((share,), (Constant("delay", name, "s", grid),), place=place)

    @property
    def rarity(self) -> int:
        """One clock stamps all joints; what is late at one alone is more likely its drive's filter."""
        return 2 if "joint" in self.place else 0

    @property
    def early(self) -> bool:
        """Whether the torque is ahead of its motion."""
        return bool(self.place.get("early", False))

    def where(self, values: FloatArray) -> str:
        """Which of the two is late."""
        return f"the recorded {'motion' if self.early else 'torque'} is late by a fixed time"

    def shown(self, values: FloatArray) -> Shown:
        """The delay of the torque: below zero where the motion is late."""
        return {"delay": (-float(values[1]) if self.early else float(values[1]), "s")}

    def late(self, torque: np.ndarray, samples: float) -> np.ndarray:
        """Shifted, interpolated between samples."""
        place = np.arange(len(torque))
        wanted = place + samples if self.early else place - samples
        return np.column_stack([np.interp(wanted, place, column) for column in torque.T])


@dataclass(frozen=True)
class FilterLag(_Late):
    """The recorded torque went through a low-pass of first order, or through a Butterworth of second."""

    kind: ClassVar[str] = "filter_lag"
    one_form: ClassVar[bool] = True
    one_cause: ClassVar[bool] = True
    words: ClassVar[str] = "the recorded torque went through a low-pass"
    equation: ClassVar[str] = "tau filtered by 1/(1 + T s), or by 1/(1 + T s + (T s)^2/2), minus tau"
    source: ClassVar[str] = "current filters of drives"
    experiment: ClassVar[str] = (
        "a chirp to the drive's bandwidth (--for elasticity): a filter also takes amplitude away"
    )
    remedy: ClassVar[str] = "switch the drive's filter off, or let position and torque go through the same one"
    forms: ClassVar[tuple[Options, ...]] = ({}, {"order": 2})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At some joints alike."""
        name = known_joints(arm, place)
        if place.get("order", 1) not in (1, 2):
            raise ValueError("order is 1 or 2")
        grid = (5e-4, 1e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 12e-3, 16e-3, 24e-3, 40e-3, 60e-3, 90e-3, 140e-3)
        share = share_of(name)
        return cls((share,), (Constant("lag", name, "s", grid),), place=place)

    @property
    def rarity(self) -> int:
        """A drive's filter is its own, and most are of first order."""
        return int("joint" not in self.place) + int(self._second)

    @property
    def _second(self) -> bool:
        return bool(self.place.get("order") == 2)

    def where(self, values: FloatArray) -> str:
        """Of which order."""
        return f"{self.words} of {'second' if self._second else 'first'} order"

    def shown(self, values: FloatArray) -> Shown:
        """What it is late by at low frequencies, and its corner frequency."""
        lag = float(values[1])
        corner = (np.sqrt(2.0) if self._second else 1.0) / (2 * np.pi * lag)
        return {"lag": (lag, "s"), "corner": (float(corner), "Hz")}

    def late(self, torque: np.ndarray, samples: float) -> np.ndarray:
        """Filtered, in the steady state at the start."""
        # Tustin's rule: at low frequencies late by the lag itself, not by half a sample more or less.
        passed, kept = bilinear([1.0], [*([0.5 * samples**2] if self._second else []), samples, 1.0])
        start = lfilter_zi(passed, kept)[:, None] * torque[:1]
        return np.asarray(lfilter(passed, kept, torque, axis=0, zi=start)[0])
