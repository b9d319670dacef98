"""A particle swarm over the truly nonlinear constants only, everything linear solved exactly inside its objective.

This is variable projection (Golub and Pereyra 1973) under a swarm in place of the separable solver's grid: a
particle's place is the logarithm of every constant of all joints at once, its cost the weighted squares that the
exact parameters leave, shared inertials and prior included. Levenberg-Marquardt then refines as it does there.

What is ours, there being no paper for it: 30 particles and 30 iterations (each place costs a whole linear solution);
the axis of a constant that may be absent reaches below its range by a quarter of it, and all of that stands for
"absent", which saves `gate` weighted squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..regression.prior import Prior
from ..regression.regression import Regression
from . import pso
from .separable import solve_linear

SWARM = pso.SwarmSettings(particles=30, iterations=30)
ABSENT_SHARE = 0.25


def search(
    regression: Regression, prior: Prior, gate: float, rng: np.random.Generator, settings: pso.SwarmSettings = SWARM
) -> FloatArray:
    """(c,) constants at the best place that a swarm finds.

    Args:
        regression: Weighted rows; with a background where terms depend on the rest of the model.
        prior: Beliefs that keep the problem regular.
        gate: Weighted squares that a constant which may be absent must gain to be there.
        rng: Source of all chance.
        settings: How the swarm moves.
    """
    axes = [_Axis.of(number, grid) for number, grid in enumerate(regression.grids) if (grid > 0).any()]
    if not axes:
        return np.zeros(len(regression.grids))

    def constants_at(place: FloatArray) -> FloatArray:
        constants = np.zeros(len(regression.grids))
        for axis, coordinate in zip(axes, place):
            constants[axis.number] = axis.value(coordinate)
        return constants

    def cost(place: FloatArray) -> float:
        constants = constants_at(place)
        parameters, squares = solve_linear(regression, prior, constants)
        if not _plausible(regression, parameters, constants):
            return float("inf")
        present = sum(axis.optional and bool(constants[axis.number] > 0) for axis in axes)
        return squares + gate * present

    lower, upper = np.array([axis.ends for axis in axes]).T
    # One particle starts where all that may be absent is: a plausible place is known from the beginning.
    simplest = np.array([lower[k] if axis.optional else (lower[k] + upper[k]) / 2 for k, axis in enumerate(axes)])
    found = pso.minimise(
        lambda places: np.array([cost(place) for place in places]), lower, upper, rng, settings, simplest[None]
    )
    return constants_at(found.best)


def _plausible(regression: Regression, parameters: FloatArray, constants: FloatArray) -> bool:
    """Whether every term could have these values."""
    return all(
        term.plausible(
            parameters[first : first + len(term.parameters)],
            constants[first_constant : first_constant + len(term.constants)],
        )
        for term, first, first_constant in regression.model.numbered()
        if term.constants
    )


@dataclass(frozen=True)
class _Axis:
    """One coordinate of the swarm: a constant's logarithm, and room below for its absence."""

    number: int
    lowest: float
    highest: float
    optional: bool

    @classmethod
    def of(cls, number: int, grid: FloatArray) -> _Axis:
        positive = grid[grid > 0]
        return cls(number, float(np.log(positive[0])), float(np.log(positive[-1])), bool(grid[0] == 0))

    @property
    def ends(self) -> tuple[float, float]:
        below = ABSENT_SHARE * max(self.highest - self.lowest, 1.0) if self.optional else 0.0
        return self.lowest - below, self.highest

    def value(self, coordinate: float) -> float:
        """The constant at a coordinate; 0: absent."""
        return 0.0 if self.optional and coordinate < self.lowest else float(np.exp(coordinate))
