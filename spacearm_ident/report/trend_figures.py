"""Trends of parameters on a page: friction levels first, everything else behind a fold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ..results.trends import DATE, LEVEL, TEMPERATURE, Arm, Run, Trend, trends
from .figures import short
from .html import captioned
from .markup import MINUS, Markup, element, join, listed, measured, number, unit_text
from .plotting import COLOUR, grid, to_svg

FRICTION = ("f_c", "f_b", "k_v1", "v_b")
WORDS = {DATE: "the date of recording", TEMPERATURE: "the joint's mean temperature"}
MOST_NAMED = 12
LONGEST_TITLE = 37
"""Characters, unit and all, that fit over a panel and its tick labels."""
TITLE_AT = -0.27
"""Where it begins, in widths of the panel: over the tick labels."""
WIDEST_BAR = 3.0
"""An interval wider than so many times the spread of its panel runs out of the picture."""


def arm_section(arm: Arm, runs: Sequence[Run]) -> Markup | None:
    """What is to be seen of one arm; None where nothing can be compared."""
    over = {what: trends(runs, what) for what in (DATE, TEMPERATURE)}
    if not any(over.values()):
        return None
    return join(
        element("h2", f"Trends of {arm[0]}"),
        element(
            "p",
            f"{len(runs)} runs that say when they were recorded. Dots: estimates with their 95 % intervals, where the "
            "data determined them. Date and temperature may go together: look at both.",
            class_="quiet",
        ),
        *(_over(found, what) for what, found in over.items() if found),
    )


def _over(found: Sequence[Trend], what: str) -> Markup:
    friction = [one for symbol in FRICTION for one in found if one.estimates[0].symbol == symbol]
    others = [one for one in found if one.estimates[0].symbol not in FRICTION]
    return join(
        element("h3", f"Over {WORDS[what]}"),
        element("p", _clear(found)),
        captioned(_figure(friction, what), "Friction levels.") if friction else None,
        element("details", element("summary", f"{len(others)} other parameters"), _figure(others, what))
        if others
        else None,
    )


def _clear(found: Sequence[Trend]) -> str:
    """The parameters that change by more than chance."""
    tested = [trend for trend in found if trend.slope is not None]
    if not tested:
        return "Too few runs to separate a trend from scatter."
    clear = sorted(
        (one for one in tested if one.slope and one.slope.clear), key=lambda one: one.slope.p_value if one.slope else 1
    )
    chance = f"by chance {number(LEVEL * len(tested), 1)} of {len(tested)} would (p < {LEVEL:g})"
    if not clear:
        return f"No parameter follows it clearly; {chance}."
    return f"Clear trends: {listed([slope_text(one) for one in clear], MOST_NAMED)}; {chance}."


def slope_text(trend: Trend) -> str:
    """`f_c[elbow] 0.500 ± 0.020 N·m/day`."""
    assert trend.slope is not None
    per, size = trend.per
    unit = unit_text(trend.estimates[0].unit) or "1"
    return f"{trend.name} {measured(trend.slope.value * size, trend.slope.error * size)} {unit}/{per}"


def _figure(found: Sequence[Trend], what: str) -> Markup:
    with grid(len(found), 4, 1.5, left_in=0.56, below_in=0.36) as (figure, panels):
        for axes, trend in zip(panels, found):
            _draw(axes, trend)
        return to_svg(figure, f"Parameters over {WORDS[what]}, one panel each")


def _draw(axes: Axes, trend: Trend) -> None:
    dated = trend.over == DATE
    x = date2num(np.round(trend.x * 1e3).astype("datetime64[ms]")) if dated else trend.x
    values = np.array([item.value for item in trend.estimates])
    low, high = np.array([item.interval for item in trend.estimates]).T
    axes.vlines(x, low, high, color=COLOUR["data"], linewidth=1.1)
    axes.plot(x, values, "o", color=COLOUR["data"], markersize=3.6, markeredgewidth=0)
    if trend.slope is not None and trend.slope.clear:
        ends = np.array([trend.x[0], trend.x[-1]])
        axes.plot(x[[0, -1]], trend.slope.at_zero + trend.slope.value * ends, color=COLOUR["residual"], linewidth=1.1)
    spread = float(np.ptp(values)) or abs(float(values[0])) or 1.0
    reach = WIDEST_BAR * spread
    bottom, top = max(low.min(), values.min() - reach), min(high.max(), values.max() + reach)
    axes.set_ylim(bottom - 0.08 * (top - bottom or spread), top + 0.08 * (top - bottom or spread))
    item = trend.estimates[0]
    unit = unit_text(item.unit)
    behind = f", {unit}" if unit else ""
    axes.set_title(short(item.name, LONGEST_TITLE - len(behind)) + behind, fontsize=7.5, x=TITLE_AT, pad=6)
    axes.margins(x=0.08)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}".replace("-", MINUS)))
    if dated:
        locator = AutoDateLocator(minticks=2, maxticks=4)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        axes.xaxis.get_offset_text().set_fontsize(6.5)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.set_xlabel("°C", labelpad=0)
    axes.tick_params(labelsize=7)
