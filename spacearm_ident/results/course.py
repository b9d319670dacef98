"""How one quantity of one arm went with the date and the temperature of its runs: a line, one step, or neither.

Estimates y of n runs with standard errors s_i are explained by a level, a line over the joint's temperature where it
was recorded, and, in turn, a line over the date and a step between two runs. What they leave is the quantity's healthy
wander beside independent scatter, sigma^2 [(1 - w) s_i^2 delta_ij + w s^2 exp(-|t_i - t_j| / tau)] with the median s of
the s_i: a first-order autoregression of runs at uneven dates, whose size does not depend on how well a run measured it.
Sigma is at least 1 (R. T. Birge, Phys. Rev. 40, 207, 1932). The share w
and a correlation time tau cannot be told from so few runs, and a slope's error depends on both. The p value of a slope
or a step is therefore the largest over all noise that the data do not refute, plus the probability that the true one
is among the refuted: R. L. Berger and D. D. Boos, JASA 89, 1012 (1994). Within one noise it is Student's.

A step is sought between all pairs of runs in turn, and its p value is multiplied by their number (Bonferroni). Where
both line and step are clear, the lower Bayesian information criterion decides: a step has one parameter more, its date.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from ..arrays import FloatArray

LEVEL: Final = 0.01
"""A slope or a step is called one where chance gives as large a one in so small a share of cases."""
REFUTED: Final = LEVEL / 10.0
"""Probability with which the noise that the data refute holds the true one; the rest of `LEVEL` is the slope's."""
FEWEST: Final = 4
"""Runs from which a slope can be told from scatter that is itself unknown: two degrees of freedom."""
FEWEST_SIDE: Final = 2
"""Runs on either side of a step: one alone is no other level."""
SHARES: Final = (0.25, 0.5, 0.75, 0.99)
"""Shares w of the variance that wanders, in quarters; independent scatter alone is tried too. Not quite 1: two runs of
one moment would be one estimate."""
TIMES: Final = 12
"""Correlation times tried, in equal ratios (1.3 for 26 runs): from half the median gap of the runs, where neighbours
are independent (correlation exp(-2) = 0.14), to half their span, where the first and the last run are. A wander of
longer memory goes one way through the whole record, which is what a trend is."""
SINGULAR: Final = 1e-9
"""Share of a column's squares left beside the other columns, below which it cannot be told from them; also the least
sum of squares of residuals in units of their standard errors, whose logarithm is taken: rounding (1e-16) is below."""


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
class Step:
    """A change of level between two runs.

    Attributes:
        after: Number of the first run at the new level; the change is between it and the run before.
        value: New level less old level.
        error: Standard error, for this date.
        p_value: Of there being none, the search for the date included.
    """

    after: int
    value: float
    error: float
    p_value: float

    @property
    def clear(self) -> bool:
        """Whether it is more than chance."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class Course:
    """What one quantity did; None where there are too few runs.

    Attributes:
        line: Over the date, at equal temperature.
        warm: Over the temperature, at equal date, beside whichever of line and step is the better one.
        step: The best of all dates, at equal temperature.
        stepped: Whether it is rather a step than a line: the clear one, of two clear ones the one of lower BIC.
    """

    line: Slope | None = None
    warm: Slope | None = None
    step: Step | None = None
    stepped: bool = False


@dataclass(frozen=True)
class _Fits:
    """Generalised least squares of m designs that differ in one column, each under k noises.

    Attributes:
        values: (k, m) coefficients of that column.
        variances: (k, m) of them, over sigma squared; infinite where the other columns are as good as it.
        squares: (k, m) sums of the whitened residual's squares.
        likelihood: (k, m) logarithms, sigma profiled out.
        restricted: (k, m) the same of the contrasts alone (REML), which do not take the fitted columns for noise.
        freedom: Degrees of freedom of the residual.
    """

    values: FloatArray
    variances: FloatArray
    squares: FloatArray
    likelihood: FloatArray
    restricted: FloatArray
    freedom: int

    def judged(self, design: int) -> tuple[float, float, float]:
        """Coefficient, standard error and largest p value over the noises that the data do not refute."""
        noise = self.restricted[:, design]
        possible = noise >= noise.max() - chi2.isf(REFUTED, 2) / 2.0
        scale = np.maximum(1.0, self.squares[:, design] / self.freedom)
        error = np.sqrt(scale * self.variances[:, design])
        p_values = 2.0 * student.sf(np.abs(self.values[:, design]) / error, self.freedom)
        worst = int(np.argmax(np.where(possible, p_values, -1.0)))
        return float(self.values[worst, design]), float(error[worst]), float(p_values[worst])


def course(dates: FloatArray, values: FloatArray, errors: FloatArray, temperatures: FloatArray | None = None) -> Course:
    """What a quantity did over the date and the temperature.

    Args:
        dates: (n,) s, increasing, not all the same.
        values: (n,) estimates.
        errors: (n,) their standard errors, above zero.
        temperatures: (n,) °C; None: not known.
    """
    count = len(dates)
    warm = None if temperatures is None or float(np.ptp(temperatures)) == 0.0 else _scaled(temperatures)
    if count < FEWEST + (warm is not None):
        return Course()
    noise, data = _whiteners(dates, errors), (values, errors)
    time, heat = _scaled(dates)[:, None], [] if warm is None else [warm]
    lines = _fits(noise, values, heat, time)
    line = _slope(lines.judged(0), dates, *data)
    firsts = np.arange(FEWEST_SIDE, count - FEWEST_SIDE + 1)
    jumps = (np.arange(count)[:, None] >= firsts).astype(float)
    steps = _fits(noise, values, heat, jumps)
    best = int(np.argmax(steps.likelihood.max(axis=0)))
    value, error, p_value = steps.judged(best)
    step = Step(int(firsts[best]), value, error, min(1.0, len(firsts) * p_value + REFUTED))
    gain = 2.0 * float(steps.likelihood[:, best].max() - lines.likelihood.max()) - math.log(count)
    stepped = step.clear and (gain > 0.0 or not line.clear)
    if warm is None or temperatures is None:
        return Course(line, None, step, stepped)
    beside = jumps[:, best] if stepped else time[:, 0]
    return Course(
        line, _slope(_fits(noise, values, [beside], warm[:, None]).judged(0), temperatures, *data), step, stepped
    )


def _slope(judged: tuple[float, float, float], x: FloatArray, values: FloatArray, errors: FloatArray) -> Slope:
    """A slope per unit of x, judged over x at unit spread; its line goes through the weighted mean of the points."""
    spread, weights = float(np.std(x)), errors**-2 / np.sum(errors**-2)
    value, error, p_value = judged[0] / spread, judged[1] / spread, min(1.0, judged[2] + REFUTED)
    return Slope(value, error, p_value, float(weights @ values - value * (weights @ x)))


def _scaled(x: FloatArray) -> FloatArray:
    """The same with zero mean and unit spread."""
    return np.asarray((x - np.mean(x)) / np.std(x))


def _whiteners(dates: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, n, n) inverse Cholesky factors of each covariance over sigma², and (k,) logarithms of determinants."""
    gaps = np.diff(dates)
    times = np.geomspace(float(np.median(gaps[gaps > 0.0])) / 2.0, float(np.ptp(dates)) / 2.0, TIMES)
    alone, like = (
        np.diag(errors**2),
        np.median(errors**2) * np.exp(-np.abs(np.subtract.outer(dates, dates)) / times[:, None, None]),
    )
    mixed = [(1.0 - share) * alone + share * like for share in SHARES]
    factors = np.linalg.cholesky(np.concatenate([alone[None], *mixed]))
    return np.linalg.inv(factors), 2.0 * np.log(np.einsum("kii->ki", factors)).sum(axis=1)


def _fits(
    noise: tuple[FloatArray, FloatArray],
    values: FloatArray,
    shared: list[FloatArray],
    last: FloatArray,
) -> _Fits:
    """Fit a constant, shared columns (n,) and one of the last columns (n, m), under each noise."""
    whiteners, determinants = noise
    count = len(values)
    white = whiteners @ np.column_stack([np.ones(count), *shared, values, last])
    first = 1 + len(shared)
    basis, triangle = np.linalg.qr(white[:, :, :first])
    # What the shared columns explain is taken out of the estimates and of every last column (Frisch and Waugh).
    left = white[:, :, first:] - basis @ (np.swapaxes(basis, 1, 2) @ white[:, :, first:])
    target, ends = left[:, :, 0], left[:, :, 1:]
    size = np.einsum("kij,kij->kj", ends, ends)
    told = size > SINGULAR * np.einsum("kij,kij->kj", white[:, :, first + 1 :], white[:, :, first + 1 :])
    inverse = np.where(told, 1.0 / np.where(told, size, 1.0), np.inf)
    value = np.where(told, np.einsum("kij,ki->kj", ends, target) / np.where(told, size, 1.0), 0.0)
    squares = np.einsum("ki,ki->k", target, target)[:, None] - value**2 * size
    squares = np.maximum(squares, SINGULAR)
    freedom = count - first - 1
    shared_size = 2.0 * np.log(np.abs(np.einsum("kii->ki", triangle))).sum(axis=1)[:, None]
    likelihood = -0.5 * determinants[:, None] - 0.5 * count * np.log(squares)
    fixed = determinants[:, None] + shared_size + np.log(np.where(told, size, 1.0))
    restricted = -0.5 * fixed - 0.5 * freedom * np.log(squares)
    return _Fits(value, inverse, squares, np.where(told, likelihood, -np.inf), restricted, freedom)
