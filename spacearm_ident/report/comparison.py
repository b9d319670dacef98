"""Two results side by side: every parameter, its difference in standard errors, and how well each predicts.

A difference is divided by the standard error of a difference of two independent estimates, sqrt(s_a^2 + s_b^2). That
is noise alone: what differs between two days (temperature, payload) is what one wants to see, and what the model
leaves out moves estimates too. Values that rest on the prior are compared, but have no errors to count in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from ..errors import UserError
from ..estimate.identified import Estimate, Identified
from ..identification.verdict import judge_result
from ..results.store import Result
from ..results.tables import base, by_joint
from .html import page
from .markup import NOTHING, Markup, breakable, element, join, listed, measured, number, percent, unit_text
from .parameter_tables import MARK

FAR: Final = 3.0
"""Standard errors beyond which a parameter is said to have moved."""
BY_CHANCE: Final = 0.0027
"""Share of normal differences beyond `FAR`."""
WIDEST: Final = 10.0
"""Standard errors at which a bar is full."""
MOST_NAMED: Final = 8


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
    title = f"{names[0]} and {names[1]}"
    dates = " and ".join(result.written[:16].replace("T", " ") for result in results)
    body = join(
        element("h1", title),
        element("p", f"{first.model.model.arm.name} · written {dates} UTC", class_="quiet"),
        _headline(found, combined),
        element("h2", "How well each predicts"),
        _figures(names, results),
        element("h2", "Parameters"),
        element(
            "p",
            "Difference: the second less the first. Errors: the difference in its standard error, noise alone; what "
            "has none rests on the prior in one of the two, and may be any of many values that predict the same.",
            class_="quiet",
        ),
        _table(names, found),
        element(
            "details",
            element("summary", f"{len(combined)} base parameters that are the same combination in both"),
            _table(names, combined) if combined else None,
        ),
    )
    return page(title, body)


def _headline(found: Sequence[Difference], combined: Sequence[Difference]) -> Markup:
    compared = sum(math.isfinite(item.errors) for item in found)
    far = moved(found)
    if not compared:
        headline, level = "Nothing can be compared: no parameter has a standard error in both", "unknown"
    elif far:
        headline, level = f"{len(far)} of {compared} parameters moved by more than {FAR:g} standard errors", "fair"
    else:
        headline, level = f"None of {compared} parameters moved by more than {FAR:g} standard errors", "good"
    chance = f"By chance alone {number(BY_CHANCE * compared, 1)} would, were noise all there is."
    names = [f"{item.name} ({number(item.errors, 2)})" for item in far]
    bases = sum(math.isfinite(item.errors) for item in combined)
    return element(
        "section",
        element("h2", headline),
        element("p", f"Farthest: {listed(names, MOST_NAMED)} standard errors.") if far else None,
        element("p", f"Of {bases} base parameters {len(moved(combined))} moved.") if bases else None,
        element("p", chance) if compared else None,
        class_=f"verdict {level}",
    )


def _figures(names: tuple[str, str], results: tuple[Result, Result]) -> Markup:
    validations = [result.validation.joints for result in results]
    rows = []
    for joint in dict.fromkeys([*validations[0], *validations[1]]):
        both = [validation.get(joint) for validation in validations]
        cells = [
            *(NOTHING if one is None else number(one.everything.rmse) for one in both),
            *(_correlation(one.everything.correlation) if one else NOTHING for one in both),
            *(NOTHING if one is None else percent(one.moving.relative_rms) for one in both),
        ]
        rows.append(element("tr", element("th", breakable(joint), class_="text"), *(element("td", c) for c in cells)))
    verdicts = [judge_result(result.identified, result.validation) for result in results]
    heads = ("RMSE, N·m", "R", "residual / torque, moving")
    header = join(
        element("tr", element("th", "joint", class_="text", rowspan=2), *(element("th", h, colspan=2) for h in heads)),
        element("tr", *(element("th", name) for _ in heads for name in names)),
    )
    return join(
        *(element("p", element("strong", name), f": {verdict.headline}.") for name, verdict in zip(names, verdicts)),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )


def _correlation(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else NOTHING


def _table(names: tuple[str, str], found: Sequence[Difference]) -> Markup:
    header = element(
        "tr",
        element("th", "", class_="text"),
        *(element("th", name) for name in names),
        element("th", "difference"),
        element("th", "errors"),
        element("th", "unit", class_="text"),
    )
    groups: dict[str, list[Difference]] = {}
    for item in found:
        groups.setdefault(item.joint, []).append(item)
    bodies = [
        element(
            "tbody",
            element("tr", element("th", joint, class_="text wrap", colspan=6)),
            *(_row(item) for item in items if not _both_absent(item)),
        )
        for joint, items in groups.items()
    ]
    return element("div", element("table", element("thead", header), *bodies), class_="wide")


def _both_absent(item: Difference) -> bool:
    """A parameter that neither model has: zero in both, by the paper's list of 18."""
    return all(one is None or (one.value == 0.0 and not one.unit) for one in (item.first, item.second))


def _row(item: Difference) -> Markup:
    part = min(1.0, abs(item.errors) / WIDEST) if math.isfinite(item.errors) else 0.0
    symbol = item.name.removesuffix(f"[{item.joint}]")
    unit = next((one.unit for one in (item.first, item.second) if one is not None and one.unit), "")
    return element(
        "tr",
        element("td", symbol, class_="text wrap"),
        _cell(item.first),
        _cell(item.second),
        element("td", number(item.value)),
        element("td", number(item.errors, 2), class_="share", style=f"--part: {100 * part:.0f}%"),
        element("td", unit_text(unit), class_="text"),
        class_="moved" if item.moved else None,
    )


def _cell(item: Estimate | None) -> Markup:
    if item is None:
        return element("td", NOTHING)
    role, symbol = MARK[item.determination]
    mark = element("span", symbol, class_=f"mark {role}", title=item.determination.value)
    return element("td", measured(item.value, item.standard_error), mark, title=item.note or None)
