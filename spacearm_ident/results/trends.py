"""How quantities go with the date and the temperature of the recordings, over many results of one arm.

Both are fitted together where temperatures were recorded, so that a season is not taken for ageing, and a step is tried
in place of the line over the date; `course.py` has the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from ..arrays import FloatArray
from ..estimate.identified import Estimate
from .course import LEVEL, Course, Slope, Step, course
from .provenance import Moment
from .quantities import quantities
from .store import Result

__all__ = ["LEVEL", "Run", "Slope", "Step", "Trend", "arm_of", "runs_by_arm", "trend_dict", "trends"]
DATE, TEMPERATURE = "date", "temperature"
DAY_S, YEAR_DAYS = 86400.0, 365.25
LONG_DAYS: Final = 90.0
"""Span, days, from which slopes are stated per year."""

Arm = tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """One result: when it was recorded (None: it does not say), and its quantities by name."""

    moment: Moment | None
    estimates: dict[str, Estimate]

    @property
    def date(self) -> float:
        """Seconds of the epoch; NaN where it gives none."""
        return self.moment.date.timestamp() if self.moment and self.moment.date else math.nan

    def temperature(self, joint: str) -> float:
        """Mean of a joint, °C; NaN where it was not recorded."""
        return self.moment.temperature.get(joint, math.nan) if self.moment else math.nan


@dataclass(frozen=True)
class Trend:
    """One quantity over the runs of one arm, where the data determined it.

    Attributes:
        name: As `f_c[joint_1]`, or the expression of a base parameter.
        over: `DATE` or `TEMPERATURE`.
        x: (n,) seconds of the epoch, or mean temperature of its joint in degrees Celsius, increasing.
        estimates: n of one quantity.
        slope: Per second (at equal temperature) or kelvin (at equal date); None where there are too few runs.
        step: Over the date, the most likely one; None where there are too few runs.
        between: Dates of the runs before and after it, seconds of the epoch.
        stepped: Whether it is rather a step than a line.
        tested: Runs that slope and step rest on.
    """

    name: str
    over: str
    x: FloatArray
    estimates: tuple[Estimate, ...]
    slope: Slope | None = None
    step: Step | None = None
    between: tuple[float, float] = (math.nan, math.nan)
    stepped: bool = False
    tested: int = 0

    @property
    def line(self) -> Slope | None:
        """The slope where it is more than chance and no step."""
        return self.slope if self.slope is not None and self.slope.clear and not self.stepped else None

    @property
    def per(self) -> tuple[str, float]:
        """The unit a person would have the slope in, and how much of x that is."""
        if self.over == TEMPERATURE:
            return "K", 1.0
        days = float(np.ptp(self.x)) / DAY_S
        return ("day", DAY_S) if days < LONG_DAYS else ("year", YEAR_DAYS * DAY_S)


def arm_of(result: Result) -> Arm:
    """What tells one arm from another: its name, with the individual of that type where it is known, and joints."""
    arm = result.identified.model.model.arm
    name = f"{result.individual} ({arm.name})" if result.individual else arm.name
    return (name, *arm.joint_names)


def runs_by_arm(results: Iterable[Result]) -> dict[Arm, list[Run]]:
    """All results by arm, in their order, with the quantities that can be compared between those of one arm."""
    found: dict[Arm, list[Result]] = {}
    for result in results:
        found.setdefault(arm_of(result), []).append(result)
    return {
        arm: [
            Run(result.moment, known)
            for result, known in zip(those, quantities([result.identified for result in those]))
        ]
        for arm, those in found.items()
    }


def trends(runs: Sequence[Run]) -> list[Trend]:
    """Every quantity that the data determined in two runs or more that differ in date (or temperature).

    Date and temperature are fitted together over the runs that have both where these are most of the dated ones, else
    the date alone; a temperature without dates has no order, and no slope.

    Args:
        runs: Of one arm.

    Returns:
        Those over the date, then those over the temperature of the joint that the quantity belongs to; points sorted.
    """
    by_date, by_temperature = [], []
    for name in dict.fromkeys(name for run in runs for name in run.estimates):
        points = [
            (run.date, run.temperature(run.estimates[name].joint), run.estimates[name])
            for run in runs
            if name in run.estimates
        ]
        dated = sorted((point for point in points if math.isfinite(point[0])), key=lambda point: point[0])
        both = [point for point in dated if math.isfinite(point[1])]
        tested = both if 2 * len(both) > len(dated) else dated
        found = _course(tested, tested is both)
        if _differ([point[0] for point in dated]):
            x, items = np.array([point[0] for point in dated]), tuple(point[2] for point in dated)
            after = found.step.after if found.step else 0
            between = (tested[after - 1][0], tested[after][0]) if after else (math.nan, math.nan)
            by_date.append(Trend(name, DATE, x, items, found.line, found.step, between, found.stepped, len(tested)))
        warm = sorted((point for point in points if math.isfinite(point[1])), key=lambda point: point[1])
        if _differ([point[1] for point in warm]):
            x, items = np.array([point[1] for point in warm]), tuple(point[2] for point in warm)
            by_temperature.append(Trend(name, TEMPERATURE, x, items, found.warm, tested=len(tested)))
    return by_date + by_temperature


def _differ(x: Sequence[float]) -> bool:
    return len(x) > 1 and float(np.ptp(x)) > 0.0


def _course(points: Sequence[tuple[float, float, Estimate]], with_temperature: bool) -> Course:
    dates, temperatures = (np.array([point[k] for point in points], dtype=float) for k in (0, 1))
    if not _differ(dates.tolist()):
        return Course()
    values = np.array([point[2].value for point in points])
    errors = np.array([point[2].standard_error for point in points])
    return course(dates, values, errors, temperatures if with_temperature else None)


def trend_dict(arm: Arm, trend: Trend) -> dict[str, Any]:
    """A slope for a program, in the unit a person would have it in; over the date, with the step tried in its place.

    Args:
        arm: Name and joints, as `arm_of` gives them.
        trend: One with a slope.
    """
    assert trend.slope is not None
    per, size = trend.per
    return {
        "arm": arm[0],
        "parameter": trend.name,
        "over": trend.over,
        "runs": trend.tested,
        "slope": trend.slope.value * size,
        "standard_error": trend.slope.error * size,
        "unit": f"{trend.estimates[0].unit} / {per}",
        "p_value": trend.slope.p_value,
        **({} if trend.step is None else {"is_step": trend.stepped, "step": _step_dict(trend, trend.step)}),
    }


def _step_dict(trend: Trend, step: Step) -> dict[str, Any]:
    before, after = (datetime.fromtimestamp(at, UTC).isoformat(timespec="seconds") for at in trend.between)
    return {
        "last_before": before,
        "first_after": after,
        "size": step.value,
        "standard_error": step.error,
        "unit": trend.estimates[0].unit,
        "p_value": step.p_value,
    }


def date_text(when: datetime) -> str:
    """`2025-01-31 12:05`."""
    return when.isoformat(sep=" ")[:16]
