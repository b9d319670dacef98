"""`JointTerms`: which optional terms one joint's friction and offset have, and the laws one step away.

The plain law (Coulomb and viscous friction, rotor inertia, offset) is where every selection begins, so that its result
is a plain model wherever nothing else predicts better. Rotor inertia, Coulomb and viscous friction are never optional.
What the terms are is said in `estimate.optional_terms` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..dynamics.friction import StribeckFriction, ViscousFriction
from ..dynamics.model import Structure
from ..estimate.optional_terms import OptionalTerm

QUADRATIC = (OptionalTerm.EVEN, OptionalTerm.ODD)
"""Forms of one term: a joint has one of them or none."""


@dataclass(frozen=True)
class JointTerms:
    """Optional terms of one joint."""

    terms: frozenset[OptionalTerm] = frozenset({OptionalTerm.OFFSET})

    def neighbours(self, seen: frozenset[OptionalTerm]) -> Iterator[JointTerms]:
        """Laws that differ in one term, or have several of a curve more: often only together do they help.

        Args:
            seen: Terms that these data can show at all; others are not offered.
        """
        for term in OptionalTerm:
            if term not in QUADRATIC and (term in self.terms or term in seen):
                yield JointTerms(self.terms ^ {term})
        others = self.terms.difference(QUADRATIC)
        if self.quadratic:
            yield JointTerms(others)
        for form in QUADRATIC:
            if form in seen and form is not self.quadratic:
                yield JointTerms(others | {form})
                curve = {form}
                for more in () if self.quadratic else (OptionalTerm.CUBIC, OptionalTerm.STRIBECK):
                    if more in others or more not in seen:
                        break
                    curve.add(more)
                    yield JointTerms(others | curve)

    def simpler(self) -> Iterator[JointTerms]:
        """Laws that lack one of its terms."""
        return (JointTerms(self.terms - {term}) for term in sorted(self.terms))

    @property
    def quadratic(self) -> OptionalTerm | None:
        """The form of its quadratic friction; None where it has none."""
        return next((form for form in QUADRATIC if form in self.terms), None)

    @property
    def tag(self) -> str:
        """Which shape its Coulomb column has: by Stribeck velocity and presliding distance."""
        return "".join(term.row.shape if term in self.terms else "0" for term in OptionalTerm if term.row.shape)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its columns in a `Trials`."""
        # In this order in every process, which a set has not: sums are rounded by it.
        own = sorted((term for term in OptionalTerm if term in self.terms and term.row.symbol), key=_rank)
        return (f"f_c {self.tag}", *(column(term, self.tag) for term in own))


def _rank(term: OptionalTerm) -> int:
    return {StribeckFriction.kind: 0, ViscousFriction.kind: 2}.get(term.row.term.kind, 1)


def column(term: OptionalTerm, tag: str) -> str:
    """Name of a term's column in a `Trials`; those of Stribeck friction have one for every shape.

    Args:
        term: With a symbol.
        tag: The shape of the law that has the term (`JointTerms.tag`).
    """
    return f"{term.row.symbol} {tag}" if term.row.term is StribeckFriction else term.row.symbol


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
    held: dict[str, list[str]] = {}
    for joint, law in zip(joints, laws):
        absent = [*([] if law.quadratic else ["k_v2"]), *([] if OptionalTerm.CUBIC in law.terms else ["k_v3"])]
        if absent:
            held[joint] = absent
    viscous: dict[str, Any] = {
        "quadratic": {joint: str(law.quadratic or OptionalTerm.EVEN) for joint, law in zip(joints, laws)},
        "held": held,
        "fastest": {joint: float(speed) for joint, speed in zip(joints, fastest) if speed > 0},
    }
    chosen: Structure = {**structure, ViscousFriction.kind: viscous}
    for term in OptionalTerm:
        kind, option = term.row.term.kind, term.row.option
        having = [joint for joint, law in zip(joints, laws) if term in law.terms]
        # Stribeck friction is at every joint, its options say who has more; other terms are where a joint has them.
        if option and (having or kind == StribeckFriction.kind):
            chosen[kind] = {**chosen.get(kind, {}), option: having}
    return chosen
