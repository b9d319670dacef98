"""What changed from one run of an arm to the next, by more than its runs did before.

A standard error is of noise. Two healthy runs differ by more (friction wanders from day to day), or by less, where what
a model leaves out is alike in both and was counted as noise. The yardstick is therefore how far consecutive runs of the
arm differed before, as soon as there are enough differences; until then it is the standard error of the difference.
What the temperature explains is taken out of a difference first, where the quantity clearly follows it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..arrays import FloatArray
from ..estimate.identified import Estimate
from .course import LEVEL
from .trends import TEMPERATURE, Run, trends

FEWEST_DIFFERENCES: Final = 5
"""Earlier differences from which they are the yardstick. Student's quantile at `LEVEL` is then 5.4 of their root mean
squares; with three it would be 9.9, and a change by the tenfold passed over."""
OUTLYING: Final = 3.0
"""Robust standard deviations beyond which an earlier difference was a change itself and is no measure of the ordinary:
of normal ones 0.3 % are."""
NORMAL_MEDIAN: Final = float(norm.ppf(0.75))
"""Median of the size of a standard normal variable."""
FREEDOM: Final = 2.0 / 3.0
"""Degrees of freedom of a consecutive difference: neighbours share a run, their correlation is -1/2, and the variance
of a mean of their squares is larger by 1 + 2 (1/2)^2 = 3/2."""


@dataclass(frozen=True)
class Change:
    """A quantity in a run and the one before it.

    Attributes:
        name: As in `quantities`.
        joint: It belongs to.
        unit: Of value and error.
        value: Difference beyond what the temperature explains, in the quantity's unit.
        error: What it is measured by: the ordinary difference of this arm, or the standard error.
        ordinary: Whether by the former.
        p_value: Of a difference as large among those.
    """

    name: str
    joint: str
    unit: str
    value: float
    error: float
    ordinary: bool
    p_value: float

    @property
    def errors(self) -> float:
        """The difference over its error."""
        return self.value / self.error

    @property
    def moved(self) -> bool:
        """Whether it is more than ordinary."""
        return self.p_value < LEVEL


def changes(runs: Sequence[Run]) -> list[list[Change]]:
    """Of each run of an arm what changed since the run before it; nothing of the first.

    Args:
        runs: Of one arm, in the order of the comparison.
    """
    follows = {
        trend.name: trend.slope
        for trend in trends(runs)
        if trend.over == TEMPERATURE and trend.slope is not None and trend.slope.clear
    }
    before: dict[str, list[tuple[float, float]]] = {}
    found: list[list[Change]] = [[] for _ in runs[:1]]
    for last, run in itertools.pairwise(runs):
        here = []
        for name, item in run.estimates.items():
            if name not in last.estimates:
                continue
            value = item.value - last.estimates[name].value
            error = math.hypot(item.standard_error, last.estimates[name].standard_error)
            warmer = run.temperature(item.joint) - last.temperature(item.joint)
            if name in follows and math.isfinite(warmer):
                value -= follows[name].value * warmer
                error = math.hypot(error, follows[name].error * warmer)
            earlier = before.setdefault(name, [])
            here.append(_judged(item, name, value, error, np.array(earlier)))
            earlier.append((value, error))
        found.append(here)
    return found


def _judged(item: Estimate, name: str, value: float, error: float, earlier: FloatArray) -> Change:
    """Args: earlier: (k, 2) differences before this one, oldest first, and their standard errors."""
    if len(earlier) < FEWEST_DIFFERENCES:
        return Change(name, item.joint, item.unit, value, error, False, float(2.0 * norm.sf(abs(value) / error)))
    absolute, count = _ordinary(earlier[:, 0])
    relative, other = _ordinary(earlier[:, 0] / earlier[:, 1])
    # A run known worse than the others differs by more: both yardsticks have to be exceeded.
    usual = max(absolute, relative * error)
    if usual == 0.0:
        return Change(name, item.joint, item.unit, value, error, False, float(2.0 * norm.sf(abs(value) / error)))
    freedom = FREEDOM * min(count, other)
    return Change(name, item.joint, item.unit, value, usual, True, float(2.0 * student.sf(abs(value) / usual, freedom)))


def _ordinary(differences: FloatArray) -> tuple[float, int]:
    """Root mean square of those that are not outlying, and their number."""
    size = np.abs(differences)
    kept = size[size <= OUTLYING * np.median(size) / NORMAL_MEDIAN]
    return math.sqrt(float(np.mean(kept**2))), len(kept)
