"""The width of the prior of the inertials that the URDF gives: the data choose it.

Seconds of data leave directions of the inertials open, and there the prior decides which torque other motions are
predicted to take. One as wide as the inertials themselves leaves those directions to the noise; where CAD is right, it
is worth more. The width s is the one that makes the data most likely (empirical Bayes: MacKay 1992, Neural Computation
4, 415), which for a linear model with Gaussian errors is

    2 log p(tau | s) = constant - |M x - v|^2 - log det(M' M) - log det(Sigma_s),

with M, v the rows of data and prior, x their least-squares solution and Sigma_s the prior covariance. Rows weigh what
they tell (`noise/weights.py`), so that slow model error is not taken for evidence. Long recordings determine the
inertials by themselves, and s moves nothing.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..regression.prior import WIDENING, Prior, make_prior
from ..regression.regression import Regression
from ..solvers.separable import system

CAD_SCALES = (1.0, 0.5, 0.25, 0.1)
"""Factors on the prior's width to choose from. The narrowest, times `regression/prior.WIDENING`, is 20 % of a link's
mass: cables, grease and screws are not in CAD. Recordings of a UR10e, a Panda, an AIRBOT and a TX40 choose it, or the
next wider one."""


def with_cad_scale(regression: Regression, prior: Prior, constants: FloatArray) -> Prior:
    """The prior whose inertials are as wide as makes the data most likely.

    Args:
        regression: Weighted rows.
        prior: As wide as it may be.
        constants: (c,) of the model.

    Returns:
        The prior with one of `CAD_SCALES`; the widest of those that are equally likely.
    """
    matrix, vector = system(regression, prior, constants)
    data = len(matrix) - len(prior.rows)
    matrix, vector = matrix[:data], vector[:data]
    candidates = [make_prior(regression.model, regression.motions, scale) for scale in CAD_SCALES]
    return max(candidates, key=lambda one: log_evidence(matrix, vector, one))


def prior_note(prior: Prior) -> tuple[str, ...]:
    """What the prior's width means for the user; empty where it is the widest."""
    if prior.cad_scale == max(CAD_SCALES):
        return ()
    known, last = f"{WIDENING * prior.cad_scale:.0%}", f"{WIDENING:.0%}"
    return (
        f"before the data, the URDF's inertials count as known to {known} of a link (the last: {last}), the width "
        "under which these data are most likely",
    )


def log_evidence(matrix: FloatArray, vector: FloatArray, prior: Prior) -> float:
    """Logarithm of the marginal likelihood of data, up to a constant that no prior changes.

    Args:
        matrix: (r, p) columns of the data's rows, in units of their noise; compressed or not.
        vector: (r,) torque in the same units.
        prior: Of the parameters.
    """
    free = prior.free
    rows = np.vstack([matrix, prior.rows])[:, free] * prior.scale[free]
    side = np.concatenate([vector - prior.fixed_part(matrix), prior.target - prior.fixed_part(prior.rows)])
    whole: FloatArray = np.column_stack([rows, side])
    sizes = np.abs(np.diag(np.linalg.qr(whole, mode="r")))
    return float(-0.5 * sizes[-1] ** 2 - np.log(sizes[:-1]).sum())
