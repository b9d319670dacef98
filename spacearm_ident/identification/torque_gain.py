"""What a torque gain that is off does to each parameter: the part of its error that no residual shows.

Recorded torque is motor current times a torque constant and a gear ratio, or a sensor's reading. If joint j's is off by
a share g_j, motions are explained as well as ever, by parameters that are wrong by

    dx = sum over j of g_j s_j,    s_j = H^-1 A_j' W_j tau_j,

with A_j, W_j, tau_j the columns, weights and torque of the joint's rows, and H the information of all of them and the
prior. Gains that are all off alike scale every parameter: the s_j add up to x. A link's inertials weigh on all joints
below it, so their error is less than g where gains are independent. It is a component of its own beside the standard
error, which is for the torque as recorded: parameters of one arm compare by that alone, while masses to be put on a
scale, or into the controller of another arm, need both. A known mass determines the gains (`weighed.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..arrays import FloatArray
from ..estimate.identified import GAIN_DEVIATION, Determination, Estimate
from ..solvers.solution_columns import columns_at
from .fit import Fit


def gain_shifts(fit: Fit, matrix: FloatArray) -> FloatArray:
    """How each parameter follows the gain of each joint's recorded torque.

    Args:
        fit: A solution under its weights.
        matrix: (r, p) compressed rows, data and prior, at its constants.

    Returns:
        (n, p) change of the parameters per relative gain of each joint; zero for those that are held.
    """
    regression, free = fit.regression, fit.prior.free
    scale = 1.0 / np.linalg.norm(matrix[:, free], axis=0)
    scaled = matrix[:, free] * scale
    factor = cho_factor(scaled.T @ scaled)
    shifts = np.zeros((len(regression.rows), matrix.shape[1]))
    columns_of = columns_at(regression, fit.solution.constants)
    for joint, (rows, columns, numbers) in enumerate(zip(regression.rows, *columns_of)):
        side = np.zeros(matrix.shape[1])
        np.add.at(side, numbers, columns.T @ (rows.weight**2 * rows.torque))
        shifts[joint, free] = cho_solve(factor, side[free] * scale) * scale
    return shifts


def assumed_covariance(joints: int) -> FloatArray:
    """(n, n) covariance of the gains where no known mass was weighed: `GAIN_DEVIATION` each, independent."""
    return np.asarray(np.diag(np.full(joints, GAIN_DEVIATION**2)))


def with_gain(estimates: Sequence[Estimate], shifts: FloatArray, covariance: FloatArray) -> tuple[Estimate, ...]:
    """Estimates with what the gains' uncertainty adds to their error.

    Args:
        estimates: Parameters, then constants, in the model's order. Constants do not scale with torque.
        shifts: (n, p), as `gain_shifts` returns.
        covariance: (n, n) of the relative gains.
    """
    errors = np.zeros(len(estimates))
    errors[: shifts.shape[1]] = np.sqrt(np.maximum(np.einsum("ip,ij,jp->p", shifts, covariance, shifts), 0.0))
    silent = (Determination.FIXED, Determination.PRIOR)
    return tuple(
        item if item.determination in silent else replace(item, gain_error=float(error))
        for item, error in zip(estimates, errors)
    )
