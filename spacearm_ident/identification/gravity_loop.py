"""The arm weighed under a gravity that is not known: fit, move gravity to where it fits best, fit again.

The fit gives the weights and the constants under which `gravity.estimate_gravity` searches; the next fit takes the
gravity found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..environment.gravity import (
    estimate_gravity,
    gravity_columns,
    gravity_result,
    is_zero,
    tangents,
    weight_columns,
)
from ..estimate.environment import GravityEstimate
from ..signals.motion import Motion
from .fit import Fit, covariance_of, fit_model, freedom

ROUNDS, STAYS, NEAR = 5, 1e-3, 0.2
"""m/s^2: gravity that moves by less has been found; constants found under one that is farther off are not kept."""


@dataclass(frozen=True)
class GravityLoop:
    """How gravity is estimated with a model.

    Attributes:
        choice: One of `gravity.GRAVITY_CHOICES`; empty: it is not.
        stated: (3,) before any data, m/s^2.
        motions: What is fitted.
    """

    choice: str
    stated: FloatArray
    motions: list[Motion]

    def settle(self, fit: Fit) -> Fit:
        """The fit under the gravity that fits best; the fit itself where gravity is not to be estimated."""
        if not self.choice:
            return fit
        columns = gravity_columns(fit.regression)
        for _ in range(ROUNDS):
            found = estimate_gravity(fit.regression, fit.prior, fit.solution, columns, self.choice, self.stated)
            moved = float(np.linalg.norm(found - fit.regression.model.arm.gravity))
            fit = self._under(fit, found, anew=moved > NEAR)
            if moved < STAYS:
                break
        return fit

    def conclude(self, fit: Fit) -> tuple[Fit, GravityEstimate | None]:
        """What was found, with its errors; gravity that does not differ from zero is zero."""
        if not self.choice:
            return fit, None
        found = self._found(fit)
        if not is_zero(found):
            return fit, found
        fit = self._under(fit, np.zeros(3), anew=False)
        return fit, replace(self._found(fit), p_zero=found.p_zero)

    def further(self, fit: Fit) -> list[FloatArray]:
        """Per joint, (M, d) torque of the ways in which gravity may change; empty where it is not estimated."""
        if not self.choice:
            return []
        ways = tangents(fit.regression.model.arm.gravity, self.choice)
        columns = gravity_columns(fit.regression)
        return [block @ ways for block in weight_columns(columns, fit.regression.model, fit.solution.parameters)]

    def _under(self, fit: Fit, gravity: FloatArray, anew: bool) -> Fit:
        return fit_model(fit.regression.model.with_gravity(gravity), self.motions, None if anew else fit)

    def _found(self, fit: Fit) -> GravityEstimate:
        gravity = fit.regression.model.arm.gravity
        ways = tangents(gravity, self.choice)
        count = ways.shape[1]
        spread = ways @ covariance_of(fit, self.further(fit))[-count:, -count:] @ ways.T
        return gravity_result(gravity, self.stated, spread, self.choice, max(sum(freedom(fit).values()), 1.0))
