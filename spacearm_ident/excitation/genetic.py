"""The paper's way: an improved genetic algorithm (section 3.2), selectable, to compare with.

The paper names it without a word on what is improved. Ours is real-coded, with what such improvements usually are
(Deb and Agrawal 1995; Michalewicz 1996): tournament selection, elitism, blend crossover (BLX-0.3, Eshelman and
Schaffer 1993) joint by joint, mutation that grows finer from generation to generation, and repair instead of
penalties: an offspring beyond a motion limit is scaled back onto it, one that breaks torque or clearance is drawn
towards rest in the start posture. Criterion, limits and final check are those of the default method.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .descent import Function
from .optimise import SHRINK, STAGES, Excitation, Progress, check_start, draw_feasible, finish, known_point
from .problem import Problem
from .trajectory import FourierTrajectory

POPULATION, GENERATIONS, ELITE, TOURNAMENT = 60, 100, 3, 3
BLEND, CROSSED, MUTATED = 0.3, 0.9, 0.15
"""BLX's reach beyond the parents; share of offspring that is crossed; share of coefficients that mutates."""
COARSE, FINE = 0.3, 0.01
"""Size of a mutation in the first and the last generation, in units of what alone uses up a limit."""


def evolve(
    problem: Problem,
    seed: int = 0,
    progress: Progress | None = None,
    known: FourierTrajectory | None = None,
    *,
    population: int = POPULATION,
    generations: int = GENERATIONS,
) -> Excitation:
    """The best of a population after some generations.

    Args:
        problem: What is wanted.
        seed: Same seed, same trajectory.
        progress: Called with the share done and what is going on.
        known: A good series of no more harmonics, added to the first population where it keeps all limits.
        population: Individuals of a generation; more than `ELITE`.
        generations: Number of generations after the first population.

    Raises:
        UserError: The limits leave no motion: which, by how much, and what to do.
    """
    report = progress or (lambda share, what: None)
    check_start(problem)
    rng = np.random.default_rng(seed)
    sharpness, softness, *_ = STAGES[-1]
    function = problem.function(sharpness, softness, slopes=False)
    report(0.0, "drawing a population")
    drawn = draw_feasible(problem, function, rng, population)
    drawn = sorted([*known_point(problem, function, known), *drawn], key=lambda pair: pair[0])[:population]
    values = np.array([value for value, _ in drawn])
    points = np.array([point for _, point in drawn])
    for generation in range(generations):
        report(0.05 + 0.85 * generation / generations, f"generation {generation + 1}: {values[0]:.3f}")
        size = COARSE * (FINE / COARSE) ** (generation / max(1, generations - 1))
        children = [_offspring(problem, function, points, size, rng) for _ in range(population - ELITE)]
        values = np.concatenate([values[:ELITE], [value for value, _ in children]])
        points = np.concatenate([points[:ELITE], [point for _, point in children]])
        order = np.argsort(values, kind="stable")
        values, points = values[order], points[order]
    report(0.95, "checking all limits")
    return finish(problem, points[0])


def _offspring(
    problem: Problem, function: Function, points: FloatArray, size: float, rng: np.random.Generator
) -> tuple[float, FloatArray]:
    # Points are sorted: the best of a tournament is the one of the smallest number.
    mother, father = (points[rng.integers(0, len(points), TOURNAMENT).min()] for _ in range(2))
    child = mother.copy()
    if rng.random() < CROSSED:
        child = mother + rng.uniform(-BLEND, 1.0 + BLEND, (len(mother), 1)) * (father - mother)
    struck = rng.random(child.shape) < MUTATED
    return _repaired(problem, function, child + struck * size * rng.standard_normal(child.shape))


def _repaired(problem: Problem, function: Function, point: FloatArray) -> tuple[float, FloatArray]:
    """The point brought back within the limits, and its value."""
    point = point / np.maximum(1.0, problem.space.usage(point))[:, None]
    for share in SHRINK:
        shrunk = problem.home + share * (point - problem.home)
        value, _ = function(shrunk)
        if np.isfinite(value):
            return value, shrunk
    return np.inf, point
