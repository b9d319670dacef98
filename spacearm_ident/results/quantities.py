"""What can be compared between results of one arm: friction torque at speeds, base parameters, other constants.

A parameter that rests on the prior is no such quantity, nor is f_c where one result has a Stribeck term beside it and
another a quadratic one. Base parameters are what the data determine by themselves, and friction torque at a speed means
the same under every law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from ..dynamics.friction_curve import fastest_seen, friction_levels
from ..estimate.identified import Determination, Estimate, Identified
from .tables import base

SPEED_SHARES: Final = (0.25, 0.5, 1.0)
"""Shares of the largest speed that the results compared have seen, at which friction torque is compared."""
SEEN_BY: Final = 0.75
"""Share of the results of an arm that have seen the largest speed compared; the others are compared below theirs."""


def quantities(results: Sequence[Identified]) -> list[dict[str, Estimate]]:
    """Comparable quantities of results of one arm.

    Args:
        results: Of arms with the same joints.

    Returns:
        For each result name -> quantity, all with a standard error above zero: friction torque of every joint at shares
        of a speed that most have seen, base parameters without friction, and constants of other terms that the data
        determined. Friction of a joint whose speed no result states is there by its own base parameters.
    """
    joints = results[0].model.model.arm.joint_names
    tops = {joint: _top([fastest_seen(one.model, joint) for one in results]) for joint in joints}
    return [_of_one(one, tops) for one in results]


def _top(seen: Sequence[float | None]) -> float | None:
    """Largest speed that `SEEN_BY` of those that know it have seen, rad/s or m/s.

    Rounded down to two digits: repetitions of one motion, whose largest speeds differ by noise, have all seen it then.
    """
    known = sorted(speed for speed in seen if speed is not None)
    if not known:
        return None
    speed = known[int((1.0 - SEEN_BY) * (len(known) - 1))]
    unit: float = 10.0 ** (math.floor(math.log10(speed)) - 1)
    return math.floor(speed / unit) * unit


def _of_one(result: Identified, tops: dict[str, float | None]) -> dict[str, Estimate]:
    found: dict[str, Estimate] = {}
    for joint, top in tops.items():
        seen = fastest_seen(result.model, joint)
        if top is not None and seen is not None and joint not in result.joints_at_rest:
            speeds = [share * top for share in SPEED_SHARES if share * top <= seen]
            found.update((item.name, item) for item in friction_at(result, joint, speeds))
    terms = result.model.model.terms
    friction = {item.name for term in terms if term.friction for item in term.parameters if tops.get(item.joint)}
    known_by_speed = {item.name for term in terms if term.friction for item in term.constants if tops.get(item.joint)}
    arm = len(base(result)) - len(result.base.names)
    leaders = [None] * arm + [result.model.model.parameters[k].name for k in result.base.independent]
    for item, leader in zip(base(result), leaders):
        if leader not in friction:
            found[item.symbol] = item
    constants = {item.name for item in result.model.model.constants} - known_by_speed
    found.update((item.name, item) for item in result.estimates if item.identifiable and item.name in constants)
    return {name: item for name, item in found.items() if 0.0 < item.standard_error < math.inf}


def friction_at(result: Identified, joint: str, speeds: Sequence[float]) -> list[Estimate]:
    """Friction torque of a joint at speeds, and by how much it rises from the first of them to the last.

    Dry friction is most of the first, viscous friction most of the rise: a change of one does not hide in the other.

    Args:
        result: Whose friction.
        joint: Name of the joint.
        speeds: (K,) rad/s or m/s, above zero, increasing.

    Returns:
        K levels with their standard errors, and the rise where there are two speeds or more.
    """
    if not speeds:
        return []
    arm = result.model.model.arm
    number = arm.joint_names.index(joint)
    revolute = arm.joints[number].revolute
    per, unit = ("rad/s", "N m") if revolute else ("m/s", "N")
    levels, covariance = friction_levels(result.model, number, np.array(speeds), result.covariance)
    named = [(f"friction at {_digits(speed)} {per}", np.eye(len(speeds))[place]) for place, speed in enumerate(speeds)]
    if len(speeds) > 1:
        rise = np.eye(len(speeds))[-1] - np.eye(len(speeds))[0]
        named.append((f"friction rise {_digits(speeds[0])} to {_digits(speeds[-1])} {per}", rise))
    return [
        Estimate(
            symbol,
            joint,
            unit,
            float(row @ levels),
            math.sqrt(max(0.0, float(row @ covariance @ row))),
            Determination.DATA,
        )
        for symbol, row in named
    ]


def _digits(speed: float) -> str:
    """Two significant digits: `0.50`."""
    return f"{speed:#.2g}".rstrip(".")
