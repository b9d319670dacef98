"""The likeliest Stribeck velocity of a joint whose model has no Stribeck term."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.friction import STRIBECK_GRID, StribeckFriction
from .regression import Regression

FINER = 9
"""Values of v_b tried about the best of its grid, whose steps are 75 %: they are 15 % apart."""
SEEN_SHARE = 1e-8
"""Squares that columns add to others, as a share of their own, below which it is rounding."""


@dataclass(frozen=True)
class Absent:
    """A joint's Stribeck term that is not there: its number in the model, the joint's row, and d_s and what follows."""

    term: int
    joint: int
    rest: tuple[float, ...]

    def column(self, regression: Regression, width: float) -> FloatArray:
        """(M,) unweighted column of f_b - f_c at a v_b, rad/s."""
        return regression.shaped(self.term, (width, *self.rest))[self.joint][1][:, 1]


def absent_terms(regression: Regression, constants: FloatArray) -> list[Absent]:
    """The Stribeck terms without a Stribeck velocity, of joints that have rows.

    Args:
        regression: Rows.
        constants: (c,) of the model.
    """
    found = []
    for number, first, count in regression.shaped_terms():
        term = regression.term(number)
        if isinstance(term, StribeckFriction) and constants[first] <= 0.0:
            joint = regression.model.arm.joint_names.index(term.parameters[0].joint)
            rest = tuple(float(value) for value in constants[first + 1 : first + count])
            found += [Absent(number, joint, rest)] if len(regression.rows[joint].torque) else []
    return found


def likeliest_width(regression: Regression, absent: Absent, beside: FloatArray, torque: FloatArray) -> float:
    """The v_b, rad/s, at which a fall of friction with speed takes most squares from a joint's rows; 0: none takes any.

    Args:
        regression: Weighted rows.
        absent: The term.
        beside: (M, k) weighted columns that are fitted with it.
        torque: (M,) weighted torque, or what `beside` leaves of it.
    """
    weight = regression.rows[absent.joint].weight
    left, size, _ = np.linalg.svd(beside, full_matrices=False)
    basis = left[:, size > SEEN_SHARE * size.max(initial=0.0)]
    constant = regression.term(absent.term).constants[0]
    grid = regression.visible(replace(constant, grid=STRIBECK_GRID))
    grid = grid[grid > 0.0]

    def drop(width: float) -> float:
        own = absent.column(regression, width) * weight
        outside = own - basis @ (basis.T @ own)
        squares, along = float(outside @ outside), float(torque @ outside)
        falls = along > 0.0 and squares > SEEN_SHARE * float(own @ own)
        return along**2 / squares if falls else 0.0

    if not len(grid):
        return 0.0
    best = int(np.argmax([drop(width) for width in grid]))
    finer = np.geomspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], FINER)
    width = max(finer.tolist(), key=drop)
    return float(width) if drop(width) > 0.0 else 0.0
