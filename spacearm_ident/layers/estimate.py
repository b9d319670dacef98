"""`Estimate`: unknowns of a `Linear` problem with errors that hold where the residual is model error.

The posterior covariance takes residuals for noise of a known correlation. The jackknife over blocks of time (Efron and
Stein 1981) asks instead how much the estimate moves when a block is left out. What the model leaves out is a function
of the state besides, and the same in every block: the third asks the same of a joint's rows at neighbouring velocities,
and at neighbouring positions, corrected for what each group decides alone (cluster-robust, CR2: Bell and McCaffrey
2002). The largest of all is the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..arrays import FloatArray
from .linear import Linear, Prior, Solution

LEVEL = 0.05
"""Probability outside an interval."""
LEAST_LEFT = 1e-3
"""Share of a direction that must be left where a group's rows are taken away; of what they alone decide, rounding."""


@dataclass(frozen=True)
class Estimate:
    """Values and errors of P unknowns.

    Attributes:
        values: (P,).
        covariance: (P, P), posterior.
        jackknife: (P, P), over blocks of time.
        blocks: Number of blocks left out in turn.
        by_state: (k, P, P), over groups of rows by velocity, and by position.
        groups: Number of groups of a joint.
    """

    values: FloatArray
    covariance: FloatArray
    jackknife: FloatArray
    blocks: int
    by_state: FloatArray
    groups: int

    def of(self, combination: FloatArray) -> float:
        """Value of a combination (P,)."""
        return float(combination @ self.values)

    def error(self, combination: FloatArray) -> float:
        """Half the width of its 95 % interval over 1.96: a standard error with the few blocks and groups in it."""
        return self.bound(combination) / float(norm.ppf(1 - LEVEL / 2))

    def bound(self, combination: FloatArray, level: float = LEVEL) -> float:
        """What a combination's estimate is off by at most, but with a probability of `level`.

        Student's, with the few blocks and groups that errors are from: far out in the tails they say much less than at
        95 %.
        """
        found = [float(norm.ppf(1 - level / 2)) * _size(self.covariance, combination)]
        if self.blocks >= 3:
            found.append(float(student.ppf(1 - level / 2, self.blocks - 1)) * _size(self.jackknife, combination))
        of_groups = float(student.ppf(1 - level / 2, self.groups - 1)) if len(self.by_state) else 0.0
        return max([*found, *(of_groups * _size(one, combination) for one in self.by_state)])

    def interval(self, combination: FloatArray) -> tuple[float, float]:
        """95 % interval of a combination."""
        half = self.bound(combination)
        return self.of(combination) - half, self.of(combination) + half


def _size(covariance: FloatArray, combination: FloatArray) -> float:
    return float(np.sqrt(max(float(combination @ covariance @ combination), 0.0)))


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
    count, groups = linear.count, 0
    by_state = np.zeros((0, count, count))
    if linear.by_state is not None:
        groups = linear.by_state.shape[2]
        by_state = np.stack([_between(one, prior.free, whole, variance) for one in linear.by_state])
    return Estimate(whole.values, whole.covariance, jackknife, len(blocks), by_state, groups)


def _between(gram: FloatArray, free: np.ndarray, whole: Solution, variance: FloatArray) -> FloatArray:
    """(P, P) covariance of a solution from how the groups of rows (n, G, P + 1, P + 1) of each joint pull at it."""
    own = np.flatnonzero(free)
    sizes, axes = np.linalg.eigh(whole.covariance[np.ix_(own, own)])
    root = axes * np.sqrt(np.maximum(sizes, 0.0))
    vector = np.append(whole.values, -1.0)
    between = np.zeros((len(own), len(own)))
    for joint, groups in enumerate(gram):
        for one in groups:
            pull = root.T @ (one[own] @ vector) / variance[joint]
            # Which share of each direction this group alone decides: its residual there is smaller for that.
            shares, along = np.linalg.eigh(root.T @ one[np.ix_(own, own)] @ root / variance[joint])
            moved = root @ (along @ (along.T @ pull / np.sqrt(np.maximum(1.0 - shares, LEAST_LEFT))))
            between += np.outer(moved, moved)
    found = np.zeros_like(whole.covariance)
    found[np.ix_(own, own)] = between
    return found
