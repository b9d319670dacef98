"""Trends of quantities on a page: friction torque first, everything else behind a fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ..results.course import LEVEL, Slope, Step
from ..results.trends import DATE, TEMPERATURE, Arm, Run, Trend, trends
from .figures import short
from .plotting import COLOUR, grid, to_svg
from .text import MINUS, listed, measured, number, unit_text

FRICTION = ("friction ", "f_c", "f_b", "k_v1", "v_b")
"""How names of friction torque, and of its parameters where no speed is known, begin."""
WORDS = {DATE: "the date of recording", TEMPERATURE: "the joint's mean temperature"}
MOST_NAMED = 12
LONGEST_NAME = 60
"""Characters of a quantity's name in a sentence."""
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
    known = trends(runs)
    found = {what: [trend for trend in known if trend.over == what] for what in (DATE, TEMPERATURE)}
    over = tuple(_over(those, what) for what, those in found.items() if those)
    return ArmTrends(arm[0], sum(run.moment is not None for run in runs), over) if over else None


def _over(found: Sequence[Trend], what: str) -> Over:
    friction = [one for symbol in FRICTION for one in found if one.name.startswith(symbol)]
    others = [one for one in found if not one.name.startswith(FRICTION)]
    return Over(WORDS[what], _clear(found), _figure(friction, what), _figure(others, what), len(others))


def _clear(found: Sequence[Trend]) -> str:
    """The quantities that change by more than chance: steps with their dates, then lines."""
    tested = [trend for trend in found if trend.slope is not None]
    if not tested:
        return "Too few runs to separate a trend from scatter."
    steps = sorted((one for one in tested if one.step and one.stepped), key=lambda one: -_far(one.step))
    lines = sorted((one for one in tested if one.line), key=lambda one: -_far(one.line))
    both = 2 if any(trend.step for trend in tested) else 1
    chance = f"by chance {number(LEVEL * both * len(tested), 1)} of {len(tested)} would (p < {LEVEL:g}"
    chance += " for a line, and for a step)" if both > 1 else ")"
    said = [f"Steps: {listed([step_text(one) for one in steps], MOST_NAMED)}"] if steps else []
    said += [f"Clear trends: {listed([slope_text(one) for one in lines], MOST_NAMED)}"] if lines else []
    return f"{'. '.join(said)}; {chance}." if said else f"No quantity follows it clearly; {chance}."


def _far(one: Slope | Step | None) -> float:
    return abs(one.value) / one.error if one else 0.0


def slope_text(trend: Trend) -> str:
    """`f_c[elbow] 0.500 ± 0.020 N·m/day`."""
    assert trend.slope is not None
    per, size = trend.per
    unit = unit_text(trend.estimates[0].unit) or "1"
    name = short(trend.name, LONGEST_NAME)
    return f"{name} {measured(trend.slope.value * size, trend.slope.error * size)} {unit}/{per}"


def step_text(trend: Trend) -> str:
    """`f_c[elbow] −1.35 ± 0.26 N·m between 2025-05-12 and 2025-05-26`; with the hour where both are of one day."""
    assert trend.step is not None
    before, after = (datetime.fromtimestamp(at, UTC) for at in trend.between)
    digits = 10 if before.date() != after.date() else 16
    first, second = (at.isoformat(sep=" ")[:digits] for at in (before, after))
    unit = unit_text(trend.estimates[0].unit) or "1"
    size = measured(trend.step.value, trend.step.error)
    return f"{short(trend.name, LONGEST_NAME)} {size} {unit} between {first} and {second}"


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
    if trend.line is not None:
        ends = np.array([trend.x[0], trend.x[-1]])
        axes.plot(x[[0, -1]], trend.line.at_zero + trend.line.value * ends, color=COLOUR["residual"], linewidth=1.1)
    if trend.stepped:
        middle = np.mean(date2num(np.round(np.array(trend.between) * 1e3).astype("datetime64[ms]")))
        axes.axvline(float(middle), color=COLOUR["residual"], linewidth=1.1)
    spread = float(np.ptp(values)) or abs(float(values[0])) or 1.0
    reach = WIDEST_BAR * spread
    bottom, top = max(low.min(), values.min() - reach), min(high.max(), values.max() + reach)
    axes.set_ylim(bottom - 0.08 * (top - bottom or spread), top + 0.08 * (top - bottom or spread))
    item = trend.estimates[0]
    unit = unit_text(item.unit)
    behind = f", {unit}" if unit else ""
    axes.set_title(short(trend.name, LONGEST_TITLE - len(behind)) + behind, fontsize=7.5, x=TITLE_AT, pad=6)
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
