"""How parameters go with the date and the temperature of the recordings, over many results of one arm.

A line through n estimates with standard errors s_i is fitted by weighted least squares. Estimates that scatter more
about it than their errors allow (what a model leaves out differs from run to run) widen the error of its slope by the
Birge ratio, sqrt(chi^2 / (n - 2)) (R. T. Birge, Phys. Rev. 40, 207, 1932); its p value is Student's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

import numpy as np
from scipy.stats import t as student

from ..arrays import FloatArray
from ..estimate.identified import Estimate
from .provenance import Moment
from .store import Result
from .tables import by_joint

LEVEL: Final = 0.01
"""A slope is called one where chance gives as steep a one in so small a share of cases."""
FEWEST: Final = 4
"""Runs from which a slope can be told from scatter that is itself unknown."""
DATE, TEMPERATURE = "date", "temperature"
DAY_S, YEAR_DAYS = 86400.0, 365.25
LONG_DAYS: Final = 90.0
"""Span, days, from which slopes are stated per year."""

Arm = tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """One result, and when it was recorded."""

    moment: Moment
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Slope:
    """A line through estimates: change per unit of what it goes over, standard error, and p of there being none."""

    value: float
    error: float
    p_value: float
    at_zero: float

    @property
    def clear(self) -> bool:
        """Whether it is more than chance."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class Trend:
    """One parameter over the runs of one arm, where the data determined it.

    Attributes:
        over: `DATE` or `TEMPERATURE`.
        x: (n,) seconds of the epoch, or mean temperature of its joint in degrees Celsius.
        estimates: n of one parameter.
        slope: Per second or kelvin; None where there are fewer than `FEWEST`.
    """

    over: str
    x: FloatArray
    estimates: tuple[Estimate, ...]
    slope: Slope | None

    @property
    def name(self) -> str:
        """As `f_c[joint_1]`."""
        return self.estimates[0].name

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
    """Those results that know when they were recorded."""
    found: dict[Arm, list[Run]] = {}
    for result in results:
        when = result.moment
        if when is not None:
            known = tuple(item for items in by_joint(result.identified).values() for item in items)
            found.setdefault(arm_of(result), []).append(Run(when, known))
    return found


def trends(runs: Sequence[Run], over: str) -> list[Trend]:
    """Every parameter that the data determined in two runs or more that differ in date (or temperature).

    Args:
        runs: Of one arm.
        over: `DATE`, or `TEMPERATURE`: the mean of the joint that the parameter belongs to.

    Returns:
        Points sorted by date or temperature; a slope only from `FEWEST` runs on.
    """
    points: dict[str, list[tuple[float, Estimate]]] = {}
    for run in runs:
        date = run.moment.date.timestamp() if run.moment.date else math.nan
        for item in run.estimates:
            at = date if over == DATE else run.moment.temperature.get(item.joint, math.nan)
            if item.identifiable and math.isfinite(at) and 0.0 < item.standard_error < math.inf:
                points.setdefault(item.name, []).append((at, item))
    found = []
    for pairs in points.values():
        pairs.sort(key=lambda pair: pair[0])
        x = np.array([pair[0] for pair in pairs])
        if len(pairs) > 1 and np.ptp(x) > 0.0:
            items = tuple(pair[1] for pair in pairs)
            found.append(Trend(over, x, items, _slope_of(x, items)))
    return found


def _slope_of(x: FloatArray, items: Sequence[Estimate]) -> Slope | None:
    values = np.array([item.value for item in items])
    return line(x, values, np.array([item.standard_error for item in items])) if len(items) >= FEWEST else None


def line(x: FloatArray, values: FloatArray, errors: FloatArray) -> Slope:
    """The weighted line through three points or more; its error is at least what theirs make it.

    Args:
        x: (n,) places, not all the same.
        values: (n,) estimates.
        errors: (n,) their standard errors, above zero.
    """
    weights = errors**-2 / np.sum(errors**-2)
    middle, level = float(weights @ x), float(weights @ values)
    spread = float(weights @ (x - middle) ** 2)
    slope = float(weights @ ((x - middle) * (values - level))) / spread
    residual = (values - level - slope * (x - middle)) / errors
    freedom = len(x) - 2
    birge = max(1.0, math.sqrt(float(residual @ residual) / freedom))
    error = birge / math.sqrt(float(np.sum(errors**-2)) * spread)
    return Slope(slope, error, float(2.0 * student.sf(abs(slope) / error, freedom)), level - slope * middle)


def trend_dict(arm: Arm, trend: Trend) -> dict[str, Any]:
    """A slope for a program, in the unit a person would have it in.

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
        "runs": len(trend.x),
        "slope": trend.slope.value * size,
        "standard_error": trend.slope.error * size,
        "unit": f"{trend.estimates[0].unit} / {per}",
        "p_value": trend.slope.p_value,
    }


def date_text(when: datetime) -> str:
    """`2025-01-31 12:05`."""
    return when.isoformat(sep=" ")[:16]
