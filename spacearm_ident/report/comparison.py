"""Two results side by side: every parameter, its difference in standard errors, and how well each predicts.

A difference is divided by the standard error of a difference of two independent estimates, sqrt(s_a^2 + s_b^2). That
is noise alone: what differs between two days (temperature, payload) is what one wants to see, and what the model
leaves out moves estimates too. Values that rest on the prior are compared, but have no errors to count in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from ..errors import UserError
from ..estimate.identified import Estimate, Identified, JointValidation
from ..identification.verdict import judge_result
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
    """

    name: str
    joint: str
    first: Estimate | None
    second: Estimate | None

    @property
    def value(self) -> float:
        """Second minus first; NaN where one is missing."""
        if self.first is None or self.second is None:
            return math.nan
        return self.second.value - self.first.value

    @property
    def errors(self) -> float:
        """The same in standard errors of the difference; NaN where a result does not know its own."""
        if self.first is None or self.second is None:
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
        """Of a result that has it; empty where none does."""
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

    Raises:
        UserError: They have no joint in common.
    """
    mine, other = by_joint(first), by_joint(second)
    if not set(mine) & set(other):
        raise UserError(
            f"the arms have no joint in common ({', '.join(mine)}; {', '.join(other)}): compare runs of one"
        )
    return [
        difference
        for joint in dict.fromkeys([*mine, *other])
        for difference in _pairs(mine.get(joint, []), other.get(joint, []))
    ]


def base_differences(first: Identified, second: Identified) -> list[Difference]:
    """Base parameters that are the same combination in both: what the data alone determine."""
    theirs = {item.symbol: item for item in base(second)}
    return [
        Difference(item.symbol, item.joint, item, theirs[item.symbol]) for item in base(first) if item.symbol in theirs
    ]


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
        verdicts=[judge_result(result.identified, result.validation) for result in results],
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
