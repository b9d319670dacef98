"""The report's tables of parameters: an overview of symbols by joints, the whole list, and the base parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..estimate.identified import GAIN_DEVIATION, Determination, Estimate, Identified
from ..results.tables import base, by_joint, shown_value
from .markup import Markup, breakable, element, join, measured, number, unit_text

MARK = {
    Determination.DATA: ("data", "●"),
    Determination.COMBINED: ("combined", "○"),
    Determination.BOUND: ("bound", "▲"),
    Determination.PRIOR: ("prior", "□"),
    Determination.FIXED: ("fixed", "×"),
}
"""What a value rests on -> class of the style sheet and the symbol, those of the figure."""
ROOMY_COLUMNS = 6
BAR_HALF = 56.0
"""Half the width of an interval's drawing, in its own units."""


def determination_key() -> Markup:
    """What the symbols mean."""
    return element("div", *(element("span", _mark(kind), " ", kind.value) for kind in Determination), class_="key")


def _mark(kind: Determination) -> Markup:
    role, symbol = MARK[kind]
    return element("span", symbol, class_=f"mark {role}", title=kind.value)


def matrix(identified: Identified) -> Markup:
    """A row a symbol, a column a joint."""
    listing = by_joint(identified)
    symbols = list(dict.fromkeys(item.symbol for items in listing.values() for item in items))
    cells = {(item.symbol, joint): item for joint, items in listing.items() for item in items}
    header = [element("th", breakable(joint)) for joint in listing]
    rows = []
    for symbol in symbols:
        mine = [cells.get((symbol, joint)) for joint in listing]
        unit = next((item.unit for item in mine if item and item.unit), "")
        label = element("th", symbol, " ", element("span", unit_text(unit), class_="quiet"), class_="text")
        rows.append(element("tr", label, *(_cell(item, unit) for item in mine)))
    table = element(
        "table",
        element("thead", element("tr", element("th"), *header)),
        element("tbody", *rows),
        class_="matrix" if len(listing) <= ROOMY_COLUMNS else "matrix dense",
    )
    return element("div", table, class_="wide")


def _cell(item: Estimate | None, unit: str) -> Markup:
    """A value of a row in `unit`; a prismatic joint's own unit stands behind its value."""
    if item is None:
        return element("td")
    other = item.value != 0.0 and item.unit not in ("", unit)
    rested = item.determination in (Determination.PRIOR, Determination.FIXED)
    return element(
        "td",
        measured(shown_value(item), item.standard_error),
        element("span", f" {unit_text(item.unit)}", class_="quiet") if other else None,
        _mark(item.determination),
        class_="rested" if rested else None,
        title=item.note or None,
    )


def whole_list(identified: Identified) -> Markup:
    """A row a parameter, grouped by joint, with its interval drawn about zero."""
    gain = f"with torque gain ± {GAIN_DEVIATION:.0%}"
    heads = ("", "value", "standard error", "95 % interval", "", gain, "unit", "rests on")
    header = element(
        "tr", *(element("th", head, class_="text" if k > 5 or not k else None) for k, head in enumerate(heads))
    )
    groups = [
        element(
            "tbody",
            element("tr", element("th", joint, class_="text wrap", colspan=8)),
            *(_list_row(item) for item in items),
        )
        for joint, items in by_joint(identified).items()
    ]
    return element("div", element("table", element("thead", header), *groups, class_="list"), class_="wide")


def _list_row(item: Estimate) -> Markup:
    low, high = item.interval_with_gain
    because = f"{item.determination.value}: {item.note}" if item.note else item.determination.value
    return element(
        "tr",
        element("td", item.symbol, class_="text"),
        *_numbers(item),
        element("td", f"{number(low, 4)} … {number(high, 4)}" if math.isfinite(low) else ""),
        element("td", unit_text(item.unit), class_="text"),
        element("td", _mark(item.determination), because, class_="text wrap note"),
    )


def _numbers(item: Estimate) -> Sequence[Markup]:
    low, high = item.interval
    known = math.isfinite(low)
    return (
        element("td", number(shown_value(item), 5)),
        element("td", number(item.standard_error, 2)),
        element("td", f"{number(low, 4)} … {number(high, 4)}" if known else ""),
        element("td", _drawn(item) if known else None),
    )


def _drawn(item: Estimate) -> Markup:
    """The interval and the value on an axis that reaches as far either side of zero."""
    low, high = item.interval
    reach = max(abs(low), abs(high)) or 1.0
    ends = [60 + BAR_HALF * end / reach for end in (low, high, item.value)]
    role = MARK[item.determination][0]
    return element(
        "svg",
        element("line", x1=60, x2=60, y1=1, y2=11, stroke="var(--muted)", stroke_width=0.7),
        element("line", x1=f"{ends[0]:.1f}", x2=f"{ends[1]:.1f}", y1=6, y2=6, stroke=f"var(--{role})", stroke_width=2),
        element("circle", cx=f"{ends[2]:.1f}", cy=6, r=2.6, fill=f"var(--{role})"),
        viewBox="0 0 120 12",
        class_="interval",
        aria_hidden="true",
    )


def base_table(identified: Identified) -> Markup:
    """A row a base parameter, as the data give it, before physical consistency is imposed."""
    heads = ("base parameter", "value", "standard error", "95 % interval", "")
    header = element("tr", *(element("th", head, class_="text" if not k else None) for k, head in enumerate(heads)))
    rows = [
        element("tr", element("td", element("code", item.symbol), class_="text wrap"), *_numbers(item))
        for item in base(identified)
    ]
    return join(
        element("p", "As the data give them, before physical consistency is imposed.", class_="quiet"),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )
