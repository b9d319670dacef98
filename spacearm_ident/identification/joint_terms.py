"""`JointTerms`: which optional terms one joint's friction and offset have, and the laws one step away.

The plain law (Coulomb and viscous friction, rotor inertia, offset) is where every selection begins, so that its result
is a plain model wherever nothing else predicts better. Rotor inertia, Coulomb and viscous friction are never optional.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..dynamics.friction import StribeckFriction, ViscousFriction
from ..dynamics.model import Structure
from ..dynamics.rigid_body import JointSpring

FLAGS = ("offset", "stribeck", "presliding", "load", "cubic", "spring")
"""Terms that are there or not; quadratic friction has a form."""


@dataclass(frozen=True)
class JointTerms:
    """Optional terms of one joint.

    Attributes:
        offset: A constant torque.
        stribeck: Static friction f_b over a Stribeck velocity v_b.
        presliding: Friction builds up over a distance d_s.
        load: Coulomb friction grows with the torque of the links, mu.
        quadratic: `even` (qd^2), `odd` (qd |qd|), or empty.
        cubic: qd^3.
        spring: k_1 q, as of a cable harness.
    """

    offset: bool = True
    stribeck: bool = False
    presliding: bool = False
    load: bool = False
    quadratic: str = ""
    cubic: bool = False
    spring: bool = False

    def neighbours(self, seen: frozenset[str]) -> Iterator[JointTerms]:
        """Laws that differ in one term, or have several of a curve more: often only together do they help.

        Args:
            seen: Names of the terms that these data can show at all; others are not offered.
        """
        for name in FLAGS:
            there = getattr(self, name)
            if there or name in seen:
                changes: dict[str, Any] = {name: not there}
                yield replace(self, **changes)
        # In this order in every process: a set of words has another each time.
        for form in (one for one in ("", "even", "odd") if one != self.quadratic):
            if not form or form in seen:
                yield replace(self, quadratic=form)
                if form and not self.quadratic and not self.cubic and "cubic" in seen:
                    yield replace(self, quadratic=form, cubic=True)
                    if not self.stribeck and "stribeck" in seen:
                        yield replace(self, stribeck=True, quadratic=form, cubic=True)

    def simpler(self) -> Iterator[JointTerms]:
        """Laws that lack one of its terms."""
        for name in sorted(self.terms):
            changes: dict[str, Any] = {"quadratic": ""} if name == self.quadratic else {name: False}
            yield replace(self, **changes)

    @property
    def terms(self) -> frozenset[str]:
        """Names of its terms, values of `OptionalTerm`."""
        flags = {name for name in FLAGS if getattr(self, name)}
        return frozenset(flags | ({self.quadratic} if self.quadratic else set()))

    @property
    def tag(self) -> str:
        """Which shape its Coulomb column has: by Stribeck velocity and presliding distance."""
        return ("v" if self.stribeck else "0") + ("d" if self.presliding else "0")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its columns in a `Trials`."""
        names = [f"f_c {self.tag}"]
        names += [f"f_b {self.tag}"] if self.stribeck else []
        names += [f"mu {self.tag}"] if self.load else []
        names += ["offset"] if self.offset else []
        names += ["k_1"] if self.spring else []
        names += [{"even": "k_v2", "odd": ViscousFriction.ODD}[self.quadratic]] if self.quadratic else []
        return (*names, "k_v3") if self.cubic else tuple(names)


def structure_with(
    structure: Structure, joints: Sequence[str], laws: Sequence[JointTerms], fastest: Sequence[float]
) -> Structure:
    """A structure in which every joint has its law; what the laws do not decide stays.

    Args:
        structure: With Stribeck and viscous friction.
        joints: Names of the n joints.
        laws: n laws.
        fastest: (n,) largest speed in the data, rad/s: beyond it quadratic and cubic friction grow linearly.
    """

    def having(name: str) -> list[str]:
        return [joint for joint, law in zip(joints, laws) if getattr(law, name)]

    held: dict[str, list[str]] = {}
    for joint, law in zip(joints, laws):
        absent = [*([] if law.quadratic else ["k_v2"]), *([] if law.cubic else ["k_v3"])]
        if absent:
            held[joint] = absent
    viscous: dict[str, Any] = {
        "quadratic": {joint: law.quadratic or "even" for joint, law in zip(joints, laws)},
        "held": held,
        "fastest": {joint: float(speed) for joint, speed in zip(joints, fastest) if speed > 0},
    }
    stribeck: Mapping[str, Any] = structure.get(StribeckFriction.kind, {})
    chosen: Structure = {
        **structure,
        StribeckFriction.kind: {
            **stribeck,
            **{name: having(name) for name in ("stribeck", "presliding", "load")},
        },
        ViscousFriction.kind: viscous,
    }
    if having("spring"):
        chosen[JointSpring.kind] = {"free": having("spring")}
    if having("offset"):
        chosen["torque_offset"] = {"joints": having("offset")}
    return chosen
