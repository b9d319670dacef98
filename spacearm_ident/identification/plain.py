"""The plain model: what twenty lines of Pinocchio and numpy would fit, as a candidate for the prediction.

Rigid bodies, rotor inertia, Coulomb and viscous friction, a constant offset and the arm's couplings, by least squares
that weighs each joint by the RMS of its residual. No physical bounds, no bounded influence of outliers, no optional
term. Where an arm is not what the richer model assumes, this is what a user would have obtained without it, and no
prediction should be worse (`blend.py`).
"""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.model import FRICTION_LAWS, Structure, TorqueModel
from .fit import Fit
from .prior import Prior, make_prior
from .regression import Regression
from .separable import Solution, without_constants
from .solution_columns import residuals_of

WEIGHTINGS = 3
"""Solutions in turn, each under the weights that the residual of the one before shows; the change from the third to the
fourth is below 1 % of a standard error on the five real arms of docs/real_arms.md."""


def plain_structure(arm: Arm) -> Structure:
    """Terms of the plain model of an arm."""
    structure: Structure = {
        "rigid_body": {},
        "rotor_inertia": {},
        **FRICTION_LAWS["coulomb-viscous"],
        "torque_offset": {},
    }
    if arm.couplings:
        structure["coupled_motor"] = {}
    return structure


def plain_fit(fit: Fit) -> tuple[Regression, Prior, Solution]:
    """The plain model fitted to the rows of another fit.

    Args:
        fit: Whose arm, motions and columns are used.

    Returns:
        Weighted rows, the prior that keeps unexcited directions regular, and the solution.
    """
    arm = fit.regression.model.arm
    model = TorqueModel(arm, plain_structure(arm))
    regression = Regression(model, fit.regression.motions, fit.regression)
    prior = make_prior(model, regression.motions)
    solution = without_constants(regression, prior)
    for _ in range(WEIGHTINGS):
        for rows, residual in zip(regression.rows, residuals_of(regression, solution)):
            if len(residual):
                size = float(np.sqrt(np.mean(residual**2))) or 1.0
                rows.set_weight(np.full(len(residual), 1.0 / size))
        solution = without_constants(regression, prior)
    return regression, prior, solution
