"""Columns and a solution's residual on all rows of a regression, uncompressed."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..regression.regression import Regression
from .separable import Solution


def residuals_of(regression: Regression, solution: Solution) -> list[FloatArray]:
    """Per joint, (M,) measured minus predicted torque on the regression's rows, N·m.

    Args:
        regression: With the motions.
        solution: Of its model.
    """
    columns, numbers = columns_at(regression, solution.constants)
    return [
        rows.torque - block @ solution.parameters[number]
        for rows, block, number in zip(regression.rows, columns, numbers)
    ]


def columns_at(regression: Regression, constants: FloatArray) -> tuple[list[FloatArray], list[list[int]]]:
    """Per joint, all unweighted columns (M, k) at some constants, and the parameters they belong to.

    Args:
        regression: With the motions.
        constants: (c,) in the model's order.
    """
    columns = [[rows.fixed] for rows in regression.rows]
    numbers = [list(rows.indices) for rows in regression.rows]
    for term, first, count in regression.shaped_terms():
        for joint, (indices, shaped) in regression.shaped(term, constants[first : first + count]).items():
            columns[joint].append(shaped)
            numbers[joint].extend(indices)
    return [np.concatenate(parts, axis=1) for parts in columns], numbers
