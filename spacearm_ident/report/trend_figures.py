"""Trends of parameters on a page: friction levels first, everything else behind a fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ..results.trends import DATE, LEVEL, TEMPERATURE, Arm, Run, Trend, trends
from .figures import short
from .plotting import COLOUR, grid, to_svg
from .text import MINUS, listed, measured, number, unit_text

FRICTION = ("f_c", "f_b", "k_v1", "v_b")
WORDS = {DATE: "the date of recording", TEMPERATURE: "the joint's mean temperature"}
MOST_NAMED = 12
LONGEST_TITLE = 37
"""Characters, unit and all, that fit over a panel and its tick labels."""
TITLE_AT = -0.27
"""Where it begins, in widths of the panel: over the tick labels."""
WIDEST_BAR = 3.0
"""An interval wider than so many times the spread of its panel runs out of the picture."""


@dataclass(frozen=True)
class Over:
    """Trends over one quantity.

    Attributes:
        words: The quantity.
        clear: A sentence on the parameters that change by more than chance.
        friction: Drawing of the friction levels; None where there is none.
        others: Drawing of all other parameters; None where there is none.
        count: Number of the others.
    """

    words: str
    clear: str
    friction: Markup | None
    others: Markup | None
    count: int


@dataclass(frozen=True)
class ArmTrends:
    """What is to be seen of one arm: its name, how many runs have a date, and the trends."""

    name: str
    runs: int
    over: tuple[Over, ...]


def trends_of(arm: Arm, runs: Sequence[Run]) -> ArmTrends | None:
    """Trends of one arm over date and temperature; None where nothing can be compared.

    Args:
        arm: Name and joints, as `arm_of` gives them.
        runs: Of this arm, with the date and temperatures of their recordings.
    """
    found = {what: trends(runs, what) for what in (DATE, TEMPERATURE)}
    over = tuple(_over(those, what) for what, those in found.items() if those)
    return ArmTrends(arm[0], len(runs), over) if over else None


def _over(found: Sequence[Trend], what: str) -> Over:
    friction = [one for symbol in FRICTION for one in found if one.estimates[0].symbol == symbol]
    others = [one for one in found if one.estimates[0].symbol not in FRICTION]
    return Over(WORDS[what], _clear(found), _figure(friction, what), _figure(others, what), len(others))


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


def _figure(found: Sequence[Trend], what: str) -> Markup | None:
    """A panel for each trend; None without trends."""
    if not found:
        return None
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
