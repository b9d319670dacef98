"""Two results side by side: every parameter, its difference in standard errors, and how well each predicts.

A difference is divided by the standard error of a difference of two independent estimates, sqrt(s_a^2 + s_b^2). That
is noise alone: what differs between two days (temperature, payload) is what one wants to see, and what the model
leaves out moves estimates too. Values that rest on the prior are compared, but have no errors to count in.

A joint's friction may have other terms in two results, and f_c beside a Stribeck term is another quantity than f_c
beside a cubic one. There its parameters are shown and not counted. Its torque at speeds that both have seen is compared
always: f_c and k_v1 go together in the fit, and each alone may be known far worse than their sum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from ..dynamics.friction_curve import fastest_seen, friction_terms
from ..errors import UserError
from ..estimate.identified import Estimate, Identified, JointValidation
from ..identification.verdict import judge_result
from ..results.quantities import SPEED_SHARES, friction_at
from ..results.store import Result
from ..results.tables import base, by_joint
from .pages import render
from .text import number

FAR: Final = 3.0
"""Standard errors beyond which a parameter is said to have moved."""
BY_CHANCE: Final = 0.0027
"""Share of normal differences beyond `FAR`."""
WIDEST: Final = 10.0
"""Standard errors at which a bar is full."""


@dataclass(frozen=True)
class Difference:
    """One parameter in two results; None where a result does not have it.

    Attributes:
        name: As `f_c[joint_1]`, or the expression of a base parameter.
        joint: To which it belongs.
        first: In the one result.
        second: In the other.
        alike: Whether it is the same quantity in both.
    """

    name: str
    joint: str
    first: Estimate | None
    second: Estimate | None
    alike: bool = True

    @property
    def value(self) -> float:
        """Second minus first; NaN where one is missing."""
        if self.first is None or self.second is None:
            return math.nan
        return self.second.value - self.first.value

    @property
    def errors(self) -> float:
        """The same in standard errors of the difference; NaN where a result does not know its own, or not alike."""
        if self.first is None or self.second is None or not self.alike:
            return math.nan
        error = math.hypot(self.first.standard_error, self.second.standard_error)
        known = min(self.first.standard_error, self.second.standard_error) > 0.0
        return self.value / error if known and math.isfinite(error) else math.nan

    @property
    def bar(self) -> float:
        """How much of a cell the bar of its errors fills, 0 to 1."""
        return min(1.0, abs(self.errors) / WIDEST) if math.isfinite(self.errors) else 0.0

    @property
    def symbol(self) -> str:
        """Its name without the joint."""
        return self.name.removesuffix(f"[{self.joint}]")

    @property
    def unit(self) -> str:
        """The unit of its value, from the first result that has one; empty where neither has."""
        return next((one.unit for one in (self.first, self.second) if one is not None and one.unit), "")

    @property
    def absent(self) -> bool:
        """Whether neither model has it: zero in both, by the paper's list of 18."""
        return all(one is None or (one.value == 0.0 and not one.unit) for one in (self.first, self.second))

    @property
    def moved(self) -> bool:
        """Whether it is farther than `FAR` standard errors."""
        return abs(self.errors) > FAR


def differences(first: Identified, second: Identified) -> list[Difference]:
    """Every parameter of two results, by joint; those of the first in its order, then what only the second has.

    Args:
        first: The earlier result, or the one compared with.
        second: The other; a difference is its value minus the first's.

    Raises:
        UserError: They have no joint in common.
    """
    mine, other = by_joint(first), by_joint(second)
    if not set(mine) & set(other):
        raise UserError(
            f"the arms have no joint in common ({', '.join(mine)}; {', '.join(other)}): compare runs of one"
        )
    laws = _other_laws(first, second)
    found = []
    for joint in dict.fromkeys([*mine, *other]):
        pairs = _pairs(mine.get(joint, []), other.get(joint, []))
        found += [replace(pair, alike=pair.symbol not in laws.get(joint, ())) for pair in pairs]
        found += _levels(first, second, joint)
    return found


def base_differences(first: Identified, second: Identified) -> list[Difference]:
    """Base parameters that are the same combination in both: what the data alone determine.

    Args:
        first: Gives the order.
        second: Its base parameters are matched by their expression.
    """
    theirs, laws = {item.symbol: item for item in base(second)}, _other_laws(first, second)
    other = {f"{symbol}[{joint}]" for joint, symbols in laws.items() for symbol in symbols}
    return [
        Difference(item.symbol, item.joint, item, theirs[item.symbol], alike=item.symbol not in other)
        for item in base(first)
        if item.symbol in theirs
    ]


def _other_laws(first: Identified, second: Identified) -> dict[str, frozenset[str]]:
    """Joint whose friction has other terms in the second result than in the first -> symbols of its friction."""
    models = first.model, second.model
    found = {}
    for joint in models[0].model.arm.joint_names:
        if joint in models[1].model.arm.joint_names and len({friction_terms(model, joint) for model in models}) > 1:
            terms = [term for model in models for term in model.model.terms if term.friction]
            own = [item for term in terms for item in term.parameters if item.joint == joint]
            searched = [item for term in terms for item in term.constants if item.joint == joint]
            found[joint] = frozenset([item.symbol for item in own] + [item.symbol for item in searched])
    return found


def _levels(first: Identified, second: Identified, joint: str) -> list[Difference]:
    """Friction torque of a joint at speeds that both results have seen; none where one of them does not say which."""
    seen = [fastest_seen(one.model, joint) for one in (first, second) if joint in one.model.model.arm.joint_names]
    known = [speed for speed in seen if speed is not None]
    if len(known) < 2 or joint in (*first.joints_at_rest, *second.joints_at_rest):
        return []
    speeds = [share * min(known) for share in SPEED_SHARES]
    pairs = zip(friction_at(first, joint, speeds), friction_at(second, joint, speeds))
    return [Difference(mine.name, joint, mine, theirs) for mine, theirs in pairs]


def _pairs(mine: Sequence[Estimate], theirs: Sequence[Estimate]) -> list[Difference]:
    first = {item.symbol: item for item in mine}
    second = {item.symbol: item for item in theirs}
    joint = next(item.joint for item in (*mine, *theirs))
    return [
        Difference(f"{symbol}[{joint}]", joint, first.get(symbol), second.get(symbol))
        for symbol in dict.fromkeys([*first, *second])
    ]


def moved(found: Sequence[Difference]) -> list[Difference]:
    """Those that moved, farthest first."""
    return sorted((item for item in found if item.moved), key=lambda item: -abs(item.errors))


def comparison_html(names: tuple[str, str], results: tuple[Result, Result]) -> str:
    """A page that compares two results.

    Args:
        names: What to call them.
        results: Both.

    Raises:
        UserError: They have no joint in common.
    """
    first, second = (result.identified for result in results)
    found, combined = differences(first, second), base_differences(first, second)
    far, compared = moved(found), _compared(found)
    if not compared:
        headline, level = "Nothing can be compared: no parameter has a standard error in both", "unknown"
    elif far:
        headline, level = f"{len(far)} of {compared} parameters moved by more than {FAR:g} standard errors", "fair"
    else:
        headline, level = f"None of {compared} parameters moved by more than {FAR:g} standard errors", "good"
    return render(
        "comparison.html",
        names=names,
        results=results,
        arm=first.model.model.arm,
        level=level,
        headline=headline,
        far=named(far),
        compared=compared,
        by_chance=BY_CHANCE * compared,
        compared_base=_compared(combined),
        moved_base=len(moved(combined)),
        verdicts=[judge_result(result.identified, result.validation, result.unfit) for result in results],
        joints=_side_by_side(*(result.validation.joints for result in results)),
        parameters=_by_joint(found),
        combined=combined,
        base_parameters=_by_joint(combined),
    )


def named(found: Sequence[Difference]) -> list[str]:
    """Names, each with its difference in standard errors: `f_c[elbow] (6.4)`."""
    return [f"{item.name} ({number(item.errors, 2)})" for item in found]


def _compared(found: Sequence[Difference]) -> int:
    """How many have a standard error in both."""
    return sum(math.isfinite(item.errors) for item in found)


def _side_by_side(
    first: Mapping[str, JointValidation], second: Mapping[str, JointValidation]
) -> dict[str, tuple[JointValidation | None, JointValidation | None]]:
    """Joint -> its figures in both; None where one did not validate it."""
    return {joint: (first.get(joint), second.get(joint)) for joint in dict.fromkeys([*first, *second])}


def _by_joint(found: Sequence[Difference]) -> dict[str, list[Difference]]:
    groups: dict[str, list[Difference]] = {}
    for item in found:
        groups.setdefault(item.joint, []).append(item)
    return groups
