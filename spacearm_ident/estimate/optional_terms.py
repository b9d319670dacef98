"""`OptionalTerm`: the terms that the data decide on, joint by joint. A term's row here is all that is to say of it.

Searches, structures, reports and the base of a mismatch read these rows; the order is that of reports.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..dynamics.friction import LARGEST_LOAD_SHARE, StribeckFriction, ViscousFriction
from ..dynamics.rigid_body import JointSpring, TorqueOffset
from ..dynamics.term import Term

SPEED, POSITION = "speed", "position"


@dataclass(frozen=True)
class Row:
    """What there is to know of an optional term.

    Attributes:
        words: As a page calls it.
        term: Class of the model's term that has it.
        symbol: Parameter whose column it adds; empty where it only shapes the Coulomb column.
        option: Option of `term` that lists the joints which have it; empty for powers of speed, which a viscous term
            always has and holds at zero (`identification.joint_terms.structure_with`).
        shape: Letter of the constant of Stribeck friction by which it shapes the Coulomb column; empty where it does
            not.
        covers: `SPEED` or `POSITION`, of which the data must cover a share before it is offered; empty: neither.
        possible: Lowest and highest value of its column that are physical; None: any. f_b counts from f_c.
        in_base: Whether the base of a mismatch may have it beyond the paper's law. False only where an effect of the
            catalogue has the same torque, and is to be found as that.
    """

    words: str
    term: type[Term]
    symbol: str = ""
    option: str = ""
    shape: str = ""
    covers: str = ""
    possible: tuple[float, float] | None = None
    in_base: bool = True


_POSITIVE = (0.0, float("inf"))


class OptionalTerm(StrEnum):
    """A term that the data decide on, joint by joint; its value is its name in results."""

    OFFSET = "offset", Row("constant torque offset", TorqueOffset, "offset", "joints")
    STRIBECK = (
        "stribeck",
        Row("Stribeck friction (f_b, v_b)", StribeckFriction, "f_b", "stribeck", shape="v", possible=_POSITIVE),
    )
    PRESLIDING = "presliding", Row("presliding friction (d_s)", StribeckFriction, "", "presliding", shape="d")
    LOAD = (
        "load",
        Row("friction that grows with the load", StribeckFriction, "mu", "load", possible=(0.0, LARGEST_LOAD_SHARE)),
    )
    EVEN = "even", Row("quadratic friction k_v2 qd^2", ViscousFriction, "k_v2", covers=SPEED)
    ODD = "odd", Row("quadratic friction k_v2 qd |qd|", ViscousFriction, ViscousFriction.ODD, covers=SPEED)
    CUBIC = "cubic", Row("cubic friction k_v3 qd^3", ViscousFriction, "k_v3", covers=SPEED)
    # Not in the base of a mismatch: `harness_spring` is this torque, and would never be found beside it.
    SPRING = (
        "spring",
        Row("spring k_1 q", JointSpring, "k_1", "free", covers=POSITION, possible=_POSITIVE, in_base=False),
    )

    row: Row

    def __new__(cls, name: str, row: Row) -> OptionalTerm:
        """A member: its name, and what there is to know of it."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.row = row
        return member

    @property
    def beyond_law(self) -> bool:
        """Whether the paper's law lacks it: it is neither a constant of that law nor a power of speed."""
        return bool(self.row.option) and not self.row.shape
