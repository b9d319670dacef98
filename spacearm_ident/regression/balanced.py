"""Normal matrices whose unknowns have many units (kg, N·m, rad), in units in which their diagonal is one.

What is rounding beside the largest is decided there: in SI the friction of a large joint is beside the inertia of a
small one.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


def pseudo_inverse(matrix: FloatArray, rcond: float = 1e-15) -> FloatArray:
    """(k, k) inverse of a positive semidefinite matrix, of what is not rounding.

    Args:
        matrix: (k, k), symmetric.
        rcond: Share of the largest eigenvalue, in balanced units, below which one is rounding.
    """
    units = _units(matrix)
    return np.asarray(np.linalg.pinv(matrix * np.outer(units, units), rcond, hermitian=True) * np.outer(units, units))


def solve(matrix: FloatArray, slope: FloatArray) -> FloatArray:
    """(k,) the smallest solution of normal equations, in balanced units.

    Args:
        matrix: (k, k), symmetric, positive semidefinite.
        slope: (k,) right-hand side.
    """
    units = _units(matrix)
    return np.asarray(units * np.linalg.lstsq(matrix * np.outer(units, units), units * slope, rcond=None)[0])


def _units(matrix: FloatArray) -> FloatArray:
    """(k,) factors that scale the diagonal of a matrix to one; 1 where the diagonal is zero."""
    diagonal = np.diag(matrix)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))
