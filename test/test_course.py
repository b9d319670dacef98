"""How one quantity went over dates and temperatures, and what changed between two runs: planted courses come back."""

from __future__ import annotations

import numpy as np
import pytest

from spacearm_ident.estimate.identified import Determination, Estimate
from spacearm_ident.results.changes import FEWEST_DIFFERENCES, changes
from spacearm_ident.results.course import course
from spacearm_ident.results.trends import Run

RUNS = 24
DATES = np.arange(RUNS) * 14.0 * 86400.0
ERRORS = np.where(np.arange(RUNS) % 2, 0.02, 0.08)
"""Two programmes in turn, one of which shows the quantity better."""


def season(rng: np.random.Generator) -> np.ndarray:
    return 30.0 + 8.0 * np.sin(2.0 * np.pi * np.arange(RUNS) / 26.0 - 1.5) + 2.0 * rng.standard_normal(RUNS)


def wander(rng: np.random.Generator, correlation: float) -> np.ndarray:
    """Stationary first-order autoregression of unit innovations."""
    out = rng.standard_normal(RUNS) / np.sqrt(1.0 - correlation**2)
    for k in range(1, RUNS):
        out[k] = correlation * out[k - 1] + rng.standard_normal()
    return out


def test_a_line_over_the_date_is_found_beside_a_season():
    rng = np.random.default_rng(1)
    warm = season(rng)
    values = 5.0 + 1e-7 * DATES - 0.05 * (warm - 30.0) + ERRORS * rng.standard_normal(RUNS)
    found = course(DATES, values, ERRORS, warm)
    assert found.line.clear and abs(found.line.value - 1e-7) < 3 * found.line.error and not found.stepped
    assert found.warm.clear and abs(found.warm.value + 0.05) < 3 * found.warm.error


def test_a_season_is_no_trend_over_the_date():
    rng = np.random.default_rng(2)
    warm = season(rng)
    values = 5.0 - 0.05 * (warm - 30.0) + ERRORS * rng.standard_normal(RUNS)
    half = slice(0, 14)
    blind = course(DATES[half], values[half], ERRORS[half])
    assert blind.line.clear or blind.stepped, "from winter to summer, temperature not known"
    found = course(DATES[half], values[half], ERRORS[half], warm[half])
    assert not found.line.clear and not found.stepped and found.warm.clear


@pytest.mark.parametrize("after", [3, 13, 20])
def test_a_step_is_dated_and_sized(after):
    rng = np.random.default_rng(after)
    values = 5.0 + 0.4 * (np.arange(RUNS) >= after) + ERRORS * rng.standard_normal(RUNS)
    found = course(DATES, values, ERRORS, season(rng))
    assert found.stepped and found.step.after == after
    assert abs(found.step.value - 0.4) < 3 * found.step.error < 0.4


@pytest.mark.parametrize("correlation", [0.0, 0.8, 0.9])
def test_a_healthy_wander_is_called_line_or_step_as_rarely_as_said(correlation):
    """Of a memory up to half the record: a correlation of 0.9 is 9.5 runs of 24."""
    rng = np.random.default_rng(3)
    calls = []
    for _ in range(300):
        values = wander(rng, correlation) + ERRORS * rng.standard_normal(RUNS)
        found = course(DATES, values, ERRORS, season(rng))
        calls.append((found.line.clear, found.step.clear, found.warm.clear))
    assert np.all(np.mean(calls, axis=0) < 0.03), "1 in 100, and three standard deviations of 300 draws"


def test_too_few_runs_have_no_slope():
    assert course(DATES[:3], np.arange(3.0), ERRORS[:3]).line is None
    assert course(DATES[:4], np.arange(4.0), ERRORS[:4]).line is not None
    assert course(DATES[:4], np.arange(4.0), ERRORS[:4], np.array([20.0, 25.0, 21.0, 30.0])).line is None


def runs_of(values: np.ndarray, error: float) -> list[Run]:
    return [Run(None, {"q": Estimate("q", "j", "N m", float(v), error, Determination.DATA)}) for v in values]


def test_an_ordinary_wander_is_no_change_and_a_larger_one_is():
    rng = np.random.default_rng(4)
    values = rng.standard_normal(20)
    values[15:] += 12.0
    found = [one for (one,) in changes(runs_of(values, 0.01))[1:]]
    moved = [number for number, one in enumerate(found, start=1) if one.moved and one.ordinary]
    assert moved == [15], "each is a hundred standard errors from the one before it"
    assert [one.ordinary for one in found].index(True) == FEWEST_DIFFERENCES


def test_a_change_below_a_standard_error_that_is_too_wide_is_seen():
    values = 4.36 + 0.007 * np.random.default_rng(5).standard_normal(16)
    values[12:] += 0.24
    found = [one for (one,) in changes(runs_of(values, 0.06))[1:]]
    assert [number for number, one in enumerate(found, start=1) if one.moved] == [12]
