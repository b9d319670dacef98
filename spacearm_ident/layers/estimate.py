"""`Estimate`: unknowns of a `Linear` problem with errors that hold where the residual is model error.

The posterior covariance takes residuals for noise of a known correlation. The jackknife over blocks of time (Efron and
Stein 1981) asks instead how much the estimate moves when a block is left out. The larger of the two is the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..dynamics.arm import FloatArray
from .linear import Linear, Prior

LEVEL = 0.05
"""Probability outside an interval."""


@dataclass(frozen=True)
class Estimate:
    """Values and errors of P unknowns.

    Attributes:
        values: (P,).
        covariance: (P, P), posterior.
        jackknife: (P, P).
        blocks: Number of blocks left out in turn.
    """

    values: FloatArray
    covariance: FloatArray
    jackknife: FloatArray
    blocks: int

    def of(self, combination: FloatArray) -> float:
        """Value of a combination (P,)."""
        return float(combination @ self.values)

    def error(self, combination: FloatArray) -> float:
        """Half the width of its 95 % interval over 1.96: a standard error with the jackknife's few blocks in it."""
        posterior = float(np.sqrt(max(float(combination @ self.covariance @ combination), 0.0)))
        if self.blocks < 3:
            return posterior
        moved = float(np.sqrt(max(float(combination @ self.jackknife @ combination), 0.0)))
        few = student.ppf(1 - LEVEL / 2, self.blocks - 1) / norm.ppf(1 - LEVEL / 2)
        return max(posterior, moved * float(few))

    def interval(self, combination: FloatArray) -> tuple[float, float]:
        """95 % interval of a combination."""
        half = float(norm.ppf(1 - LEVEL / 2)) * self.error(combination)
        return self.of(combination) - half, self.of(combination) + half


def estimate(linear: Linear, prior: Prior, variance: FloatArray) -> Estimate:
    """Estimate by least squares with a prior.

    Args:
        linear: The problem.
        prior: Of every unknown.
        variance: (n,) factor on each joint's variance.
    """
    whole, blocks = linear.solve(prior, variance), np.arange(linear.blocks)
    left_out = np.stack([linear.solve(prior, variance, np.delete(blocks, one)).values for one in blocks])
    off = left_out - left_out.mean(axis=0)
    jackknife = (len(blocks) - 1) / len(blocks) * off.T @ off
    return Estimate(whole.values, whole.covariance, jackknife, len(blocks))
