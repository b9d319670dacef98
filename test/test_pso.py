"""The swarm finds known minima, stays in its box, asks for whole swarms, and repeats itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.errors import UserError
from spacearm_ident.solvers.pso import SwarmSettings, minimise


def box(dimension: int, size: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    return np.full(dimension, -size), np.full(dimension, size)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_skewed_quadratic_is_minimised():
    target = np.array([1.0, -2.0, 0.5, 3.0])
    matrix = np.array([[9.0, 2, 0, 0], [2, 4, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0.1]])
    result = minimise(lambda x: np.einsum("ni,ij,nj->n", x - target, matrix, x - target), *box(4), rng())
    assert result.best == pytest.approx(target, abs=1e-6)
    assert result.cost == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_rastrigin_s_many_minima_do_not_hold_it(seed):
    def rastrigin(x: np.ndarray) -> np.ndarray:
        return 10 * x.shape[1] + (x**2 - 10 * np.cos(2 * np.pi * x)).sum(axis=1)

    assert minimise(rastrigin, *box(3, 5.12), rng(seed)).cost < 1e-6


def test_a_minimum_outside_the_box_is_met_at_its_wall():
    lower, upper = np.array([-1.0, 0.0]), np.array([1.0, 2.0])
    result = minimise(lambda x: (x[:, 0] - 5) ** 2 + (x[:, 1] - 1) ** 2, lower, upper, rng())
    assert result.best == pytest.approx([1.0, 1.0], abs=1e-6)
    assert result.best[0] == 1.0


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 5), st.integers(1, 20), st.integers(0, 8), st.integers(0, 1000))
def test_every_place_is_in_the_box_and_the_best_never_worsens(dimension, particles, iterations, seed):
    seen = []

    def wild(x: np.ndarray) -> np.ndarray:
        assert x.shape == (particles, dimension)
        seen.append(x.copy())
        return np.sin(37 * x).sum(axis=1)

    lower, upper = box(dimension, 2.0)
    result = minimise(wild, lower, upper, rng(seed), SwarmSettings(particles, iterations))
    assert len(seen) == iterations + 1
    assert result.evaluations == particles * (iterations + 1)
    places = np.concatenate(seen)
    assert (places >= lower).all() and (places <= upper).all()
    assert (np.diff(result.history) <= 0).all() and len(result.history) == iterations + 1
    assert result.cost == pytest.approx(np.sin(37 * places).sum(axis=1).min())


def test_one_step_is_the_paper_s_rule():
    places = []

    def record(x: np.ndarray) -> np.ndarray:
        places.append(x.copy())
        return np.sum(x**2, axis=1)

    minimise(record, *box(2, 100.0), rng(3), SwarmSettings(4, 2, 1.5, 1.5, 0.9, 0.4))
    draw = rng(3)
    first = draw.uniform(-100.0, 100.0, (4, 2))
    assert np.array_equal(places[0], first)
    leader = first[np.argmin(np.sum(first**2, axis=1))]
    draw.random((4, 2))  # r1: every particle is where its own best is
    velocity = 1.5 * draw.random((4, 2)) * (leader - first)
    second = first + velocity
    assert places[1] == pytest.approx(second)
    own = np.where((np.sum(second**2, axis=1) < np.sum(first**2, axis=1))[:, None], second, first)
    leader = own[np.argmin(np.sum(own**2, axis=1))]
    r1, r2 = draw.random((4, 2)), draw.random((4, 2))
    third = second + 0.4 * velocity + 1.5 * r1 * (own - second) + 1.5 * r2 * (leader - second)
    assert places[2] == pytest.approx(third)


def test_the_same_seed_repeats_itself_and_another_does_not():
    def bumpy(x: np.ndarray) -> np.ndarray:
        return np.cos(9 * x).sum(axis=1) + 0.1 * (x**2).sum(axis=1)

    few = SwarmSettings(10, 5)
    runs = [minimise(bumpy, *box(3), rng(seed), few) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0].best, runs[1].best) and np.array_equal(runs[0].history, runs[1].history)
    assert not np.array_equal(runs[0].best, runs[2].best)


def test_a_seed_is_never_lost():
    needle = np.array([[1.2345, -0.5]])

    def haystack(x: np.ndarray) -> np.ndarray:
        return np.where(np.abs(x - needle).max(axis=1) < 1e-9, -1.0, 1.0)

    result = minimise(haystack, *box(2), rng(), SwarmSettings(20, 10), seeds=needle)
    assert result.cost == -1.0 and np.array_equal(result.best, needle[0])


def test_places_without_a_cost_are_passed_over():
    result = minimise(lambda x: np.where(x[:, 0] < 1, np.nan, x[:, 0]), *box(1), rng())
    assert result.best == pytest.approx([1.0], abs=1e-9)
    with pytest.raises(UserError, match="finite cost"):
        minimise(lambda x: np.full(len(x), np.inf), *box(1), rng(), SwarmSettings(3, 2))


@pytest.mark.parametrize(("lower", "upper"), [([1.0], [0.0]), ([-np.inf], [0.0]), ([0.0], [np.nan])])
def test_a_box_that_is_none_is_refused(lower, upper):
    with pytest.raises(UserError, match="finite box"):
        minimise(lambda x: x[:, 0], np.array(lower), np.array(upper), rng())
