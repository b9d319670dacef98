"""The arm weighed under a gravity that is not known: fit, move gravity to where it fits best, fit again.

The fit gives the weights and the constants under which `gravity.estimate_gravity` searches; the next fit takes the
gravity found. Structure and solver are the caller's: `GravityLoop` is told how to fit a model again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import TorqueModel
from ..estimate.environment import GravityEstimate
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..solvers.separable import Solution
from .gravity import (
    estimate_gravity,
    gravity_columns,
    gravity_result,
    is_zero,
    tangents,
    weight_columns,
)

ROUNDS, STAYS, NEAR = 5, 1e-3, 0.2
"""m/s^2: gravity that moves by less has been found; constants found under one that is farther off are not kept."""


class Fitted(Protocol):
    """What a fit holds."""

    regression: Regression
    prior: Prior
    solution: Solution


F = TypeVar("F", bound=Fitted)


@dataclass(frozen=True)
class GravityLoop(Generic[F]):
    """How gravity is estimated with a model.

    Attributes:
        choice: One of `gravity.GRAVITY_CHOICES`; empty: it is not.
        stated: (3,) before any data, m/s^2.
        refit: Fits a model again, its constants refined from those of a fit, or searched anew.
        covariance: Of a fit's unknowns and of further ones, given by their columns (M, d) a joint, numbered last.
        freedom: Effective rows of a fit beyond its unknowns.
    """

    choice: str
    stated: FloatArray
    refit: Callable[[TorqueModel, F | None], F]
    covariance: Callable[[F, Sequence[FloatArray]], FloatArray]
    freedom: Callable[[F], float]

    def settle(self, fit: F) -> F:
        """The fit under the gravity that fits best; the fit itself where gravity is not to be estimated."""
        if not self.choice:
            return fit
        columns = gravity_columns(fit.regression)
        for _ in range(ROUNDS):
            found = estimate_gravity(fit.regression, fit.prior, fit.solution, columns, self.choice, self.stated)
            moved = float(np.linalg.norm(found - fit.regression.model.arm.gravity))
            fit = self._under(fit, found, moved > NEAR)
            if moved < STAYS:
                break
        return fit

    def conclude(self, fit: F) -> tuple[F, GravityEstimate | None]:
        """What was found, with its errors; gravity that does not differ from zero is zero."""
        if not self.choice:
            return fit, None
        found = self._found(fit)
        if not is_zero(found):
            return fit, found
        fit = self._under(fit, np.zeros(3), anew=False)
        return fit, replace(self._found(fit), p_zero=found.p_zero)

    def further(self, fit: F) -> list[FloatArray]:
        """Per joint, (M, d) torque of the ways in which gravity may change; empty where it is not estimated."""
        if not self.choice:
            return []
        ways = tangents(fit.regression.model.arm.gravity, self.choice)
        columns = gravity_columns(fit.regression)
        return [block @ ways for block in weight_columns(columns, fit.regression.model, fit.solution.parameters)]

    def _under(self, fit: F, gravity: FloatArray, anew: bool) -> F:
        model = fit.regression.model
        there = model.with_gravity(gravity)
        return self.refit(there, None if anew else fit)

    def _found(self, fit: F) -> GravityEstimate:
        gravity = fit.regression.model.arm.gravity
        ways = tangents(gravity, self.choice)
        count = ways.shape[1]
        spread = ways @ self.covariance(fit, self.further(fit))[-count:, -count:] @ ways.T
        return gravity_result(gravity, self.stated, spread, self.choice, self.freedom(fit))
