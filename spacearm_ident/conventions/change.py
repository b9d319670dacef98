"""`Change`: one ordinary mistake of convention as a change of a `Setup`, and every one that is looked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from .setup import Setup


class Kind(StrEnum):
    """What may be wrong; the stable name in JSON."""

    EFFORT_SIGN = "effort_sign"
    POSITION_SIGN = "position_sign"
    AXIS_REVERSED = "axis_reversed"
    DEGREES = "degrees"
    MOTOR_SIDE = "motor_side"
    POSITIONS_EXCHANGED = "positions_exchanged"
    EFFORTS_EXCHANGED = "efforts_exchanged"
    JOINTS_EXCHANGED = "joints_exchanged"
    EFFORT_GAIN = "effort_gain"
    EFFORT_UNIT = "effort_unit"
    EFFORT_RATED = "effort_rated"
    GRAVITY = "gravity"
    ENCODER_ZERO = "encoder_zero"
    DELAY = "delay"
    TIME_REVERSED = "time_reversed"
    PAYLOAD = "payload"
    FLOATING_BASE = "floating_base"


TORQUE_SCALES = (Kind.EFFORT_GAIN, Kind.EFFORT_UNIT, Kind.EFFORT_RATED)
"""Mistakes that multiply torques by positive factors."""
PHYSICAL = (Kind.PAYLOAD, Kind.FLOATING_BASE)
"""What is no mistake and changes the torque of many joints as a gain would; looked for only as its rival."""
RIGHT_OR_WRONG = frozenset(Kind) - {*TORQUE_SCALES, *PHYSICAL, Kind.GRAVITY, Kind.ENCODER_ZERO, Kind.DELAY}
"""Kinds without a size: signs, units of angle, order, the direction of time."""
FREE_GAIN_SD = 1.0
"""Standard deviation of the logarithm of a gain that is wrong: a factor of 1/e to e."""
FREE_UNIT_SD = 3.4
"""The same of a torque in another unit: a factor of 30 either way."""
UNIT_FACTOR = 4.0
"""Gain from which a torque is in another unit: no published motor constant or CAD mass is off by so much."""
GAIN_KNOWN = 0.5
"""Standard error of the logarithm of a gain below which the data determine it, a factor of 1.6 either way: the error of
one that is not determined is `FREE_UNIT_SD`, and `UNIT_FACTOR` is nearly three such errors off."""
PRIOR = 0.02
"""Probability of each kind of mistake before any data, shared by the joints it may be at."""


@dataclass(frozen=True)
class Change:
    """A hypothesis.

    Attributes:
        kind: What is wrong.
        joints: Numbers of the joints it is at, in the arm's order.
        value: Gravity (3,), m/s^2; delay, s; zero, rad; order of an exchange (n,); factors (n,) of a torque unit
            that the arm's files give, or give up to a factor that all joints share; joint turns a motor turn of each of
            `joints`; standard deviation of a payload's mass, kg; inertia and mass of a free base, kg m^2, kg; else
            empty.
        log_prior: Logarithm of its probability before the data.
    """

    kind: Kind
    joints: tuple[int, ...]
    value: tuple[float, ...] = ()
    log_prior: float = float(np.log(PRIOR))

    def on(self, setup: Setup) -> Setup:
        """The setup in which this mistake is undone as well."""
        joints = list(self.joints)
        if self.kind is Kind.GRAVITY:
            return replace(setup, gravity=np.array(self.value))
        if self.kind is Kind.PAYLOAD:
            return replace(setup, payload_kg=self.value[0])
        if self.kind is Kind.FLOATING_BASE:
            return replace(setup, free_base=(self.value[0], self.value[1]))
        if self.kind is Kind.TIME_REVERSED:
            return replace(setup, time_sign=-setup.time_sign)
        if self.kind is Kind.EFFORT_UNIT and self.value:
            return replace(setup, effort_sign=setup.effort_sign * np.array(self.value))
        if self.kind is Kind.EFFORT_RATED:
            return replace(setup, effort_sign=setup.effort_sign * np.array(self.value), common_gain_sd=FREE_UNIT_SD)
        if self.kind is Kind.EFFORT_GAIN and len(joints) > 1:
            return replace(setup, common_gain_sd=FREE_GAIN_SD)
        if self.kind in _ORDERS:
            order = np.array(self.value, dtype=int)
            orders: dict[str, Any] = {name: getattr(setup, name)[order] for name in _ORDERS[self.kind]}
            return replace(setup, **orders)
        edits: dict[str, Any] = {name: np.array(getattr(setup, name), dtype=float) for name in _ARRAYS[self.kind]}
        for name, array in edits.items():
            if self.kind is Kind.MOTOR_SIDE:
                array[joints] *= self.value
            elif name in ("position_scale", "effort_sign"):
                array[joints] *= np.pi / 180 if self.kind is Kind.DEGREES else -1.0
            elif name == "gain_sd":
                array[joints] = FREE_GAIN_SD if self.kind is Kind.EFFORT_GAIN else FREE_UNIT_SD
            else:
                array[joints] += self.value[0]
        if self.kind in (Kind.POSITION_SIGN, Kind.AXIS_REVERSED):
            edits["position_offset"] = np.array(setup.position_offset)
            edits["position_offset"][joints] *= -1.0
        return replace(setup, **edits)


_ORDERS = {
    Kind.POSITIONS_EXCHANGED: ("position_from", "position_scale"),
    Kind.EFFORTS_EXCHANGED: ("effort_from", "effort_sign", "gain_sd"),
    Kind.JOINTS_EXCHANGED: ("position_from", "position_scale", "effort_from", "effort_sign", "gain_sd"),
}
_ARRAYS = {
    Kind.EFFORT_SIGN: ("effort_sign",),
    Kind.POSITION_SIGN: ("position_scale",),
    Kind.AXIS_REVERSED: ("position_scale", "effort_sign"),
    Kind.DEGREES: ("position_scale",),
    Kind.MOTOR_SIDE: ("position_scale",),
    Kind.EFFORT_GAIN: ("gain_sd",),
    Kind.EFFORT_UNIT: ("gain_sd",),
    Kind.ENCODER_ZERO: ("position_offset",),
    Kind.DELAY: ("delay_s",),
}


def discrete_changes(arm: Arm) -> list[Change]:
    """Every change without a value to search for."""
    n = len(arm.joints)
    turning = [k for k, joint in enumerate(arm.joints) if joint.revolute]
    found: list[tuple[Kind, tuple[int, ...], tuple[float, ...]]] = [
        (kind, (k,), ()) for kind in (Kind.EFFORT_SIGN, Kind.POSITION_SIGN, Kind.AXIS_REVERSED) for k in range(n)
    ]
    found += [(Kind.DEGREES, (k,), ()) for k in turning]
    if len(turning) > 1:
        found.append((Kind.DEGREES, tuple(turning), ()))
    if geared := [k for k, joint in enumerate(arm.joints) if joint.gear_ratio not in (0.0, 1.0)]:
        ratios = tuple(1.0 / arm.joints[k].gear_ratio for k in geared)
        found.append((Kind.MOTOR_SIDE, tuple(geared), ratios))
    for kind in _ORDERS:
        found += [(kind, _moved(order), order) for order in _orders(arm)]
    found += [(Kind.GRAVITY, (), tuple(vector)) for vector in gravities(arm)]
    found += [(Kind.EFFORT_GAIN, (k,), ()) for k in range(n)]
    if n > 1:
        found += [(Kind.EFFORT_GAIN, tuple(range(n)), ())]
    found += [(Kind.EFFORT_UNIT, tuple(range(n)), factors) for factors in ((), *unit_factors(arm).values())]
    found += [(Kind.EFFORT_RATED, tuple(range(n)), shares) for shares in rated_shares(arm)]
    found += [(Kind.TIME_REVERSED, (), ())]
    number = {kind: sum(one[0] is kind for one in found) for kind in Kind}
    return [Change(kind, joints, value, float(np.log(PRIOR / number[kind]))) for kind, joints, value in found]


def unit_factors(arm: Arm) -> dict[str, tuple[float, ...]]:
    """Torque units that the arm's limits and drives tell: N·m a unit, joint by joint."""
    limits = np.array([joint.effort_limit for joint in arm.joints])
    constants = np.array([joint.torque_per_ampere for joint in arm.joints])
    units = {}
    if np.isfinite(limits).all():
        units["% of the torque limit"] = tuple(limits / 100)
        units["the torque limit"] = tuple(limits)
    if (constants != 1.0).any():
        units["A"] = tuple(constants)
        units["mA"] = tuple(constants / 1000)
    return units


def rated_shares(arm: Arm) -> list[tuple[float, ...]]:
    """(n,) the joints' torque limits over their geometric mean; none where a gain of all joints says the same.

    Drives report torque as a share of the rated torque (CiA 402, object 0x6077), which is not in a URDF; it goes up
    and down with the limit from joint to joint.
    """
    limits = np.array([joint.effort_limit for joint in arm.joints])
    if not np.isfinite(limits).all() or not limits.min() > 0.0 or limits.max() < UNIT_FACTOR * limits.min():
        return []
    return [tuple((limits / np.exp(np.mean(np.log(limits)))).tolist())]


def _moved(order: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(k for k, source in enumerate(order) if source != k)


def _orders(arm: Arm) -> list[tuple[int, ...]]:
    """Exchanges of two joints, all in reverse, and alphabetical order taken for the URDF's."""
    n = len(arm.joints)
    orders = []
    for i, j in combinations(range(n), 2):
        order = list(range(n))
        order[i], order[j] = j, i
        orders.append(tuple(order))
    alphabetical = sorted(range(n), key=lambda k: arm.joint_names[k])
    whole = (tuple(range(n))[::-1], tuple(alphabetical), tuple(int(k) for k in np.argsort(alphabetical)))
    return [*dict.fromkeys([*orders, *(order for order in whole if order != tuple(range(n)))])]


def gravities(arm: Arm) -> list[FloatArray]:
    """(3,) gravity along the axes of the base frame but the stated one, and none, m/s^2."""
    size = float(np.linalg.norm(arm.gravity)) or 9.81
    stated = arm.gravity / size
    axes = [sign * axis + 0.0 for axis in np.eye(3) for sign in (1.0, -1.0)]  # no -0, which a remedy would print
    others = [size * axis for axis in axes if axis @ stated < 0.99]
    return [*others, np.zeros(3)] if arm.gravity.any() else others
