"""The plain model: what twenty lines of Pinocchio and numpy would fit, as a candidate for the prediction.

Rigid bodies, rotor inertia, Coulomb and viscous friction, a constant offset and the arm's couplings, by least squares
that weighs each joint by the RMS of its residual. No physical bounds, no bounded influence of outliers, no optional
term. Where an arm is not what the richer model assumes, this is what a user would have obtained without it, and no
prediction should be worse (`blend.py`). One thing of its prediction is not plain: Coulomb friction builds up over the
presliding distance of the richer model, because the sign of the velocity says nothing of standstill, which moving rows
do not judge (UR10e wrist 2, all samples: 12.9 % of the torque left with the sign, 6.9 % with the distance). It is
fitted with the sign, as a user's would be: on short recordings the distance of one joint changes another's parameters
(Rokae joint 5, recording B: 31 % of its torque left in recording A with the distances, 18 % with the sign).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.model import FRICTION_LAWS, Structure, TorqueModel
from ..regression.prior import Prior, make_prior
from ..regression.regression import Regression
from ..solvers.separable import Solution, solve_linear
from ..solvers.solution_columns import residuals_of
from .fit import Fit

WEIGHTINGS = 3
"""Solutions in turn, each under the weights that the residual of the one before shows; the change from the third to the
fourth is below 1 % of a standard error on the five real arms of docs/real_arms.md."""


def plain_structure(arm: Arm, presliding: Sequence[str] = ()) -> Structure:
    """Terms of the plain model of an arm.

    Args:
        arm: The arm.
        presliding: Names of the joints whose Coulomb friction builds up over a distance.
    """
    structure: Structure = {
        "rigid_body": {},
        "rotor_inertia": {},
        **FRICTION_LAWS["coulomb-viscous"],
        "stribeck_friction": {"stribeck": False, "presliding": list(presliding)},
        "torque_offset": {},
    }
    if arm.couplings:
        structure["coupled_motor"] = {}
    return structure


def plain_fit(fit: Fit, arm: Arm | None = None) -> tuple[Regression, Prior, Solution]:
    """The plain model fitted to the rows of another fit.

    Args:
        fit: Whose motions and columns are used.
        arm: The fit's arm with other couplings; None: the fit's.

    Returns:
        Weighted rows, the prior that keeps unexcited directions regular, and the solution; its constants (c,) are
        presliding distances for predictions, those of the fit are zero.
    """
    arm, fitted = arm or fit.regression.model.arm, fit.regression.model.constants
    distance = {
        constant.name: value
        for constant, value in zip(fitted, fit.solution.constants.tolist())
        if constant.symbol == "d_s" and value > 0.0
    }
    sliding = [joint for joint in arm.joint_names if f"d_s[{joint}]" in distance]
    model = TorqueModel(arm, plain_structure(arm, sliding))
    regression = Regression(model, fit.regression.motions, fit.regression)
    prior = make_prior(model, regression.motions, fit.prior.cad_scale)
    constants = np.array([distance.get(constant.name, 0.0) for constant in model.constants])
    solution = _solved(regression, prior)
    for _ in range(WEIGHTINGS):
        for rows, residual in zip(regression.rows, residuals_of(regression, solution)):
            if len(residual):
                size = float(np.sqrt(np.mean(residual**2))) or 1.0
                rows.set_weight(np.full(len(residual), 1.0 / size))
        solution = _solved(regression, prior)
    return regression, prior, replace(solution, constants=constants)


def _solved(regression: Regression, prior: Prior) -> Solution:
    """Least squares with the sign of the velocity."""
    constants = np.zeros(len(regression.model.constants))
    parameters, cost = solve_linear(regression, prior, constants)
    return Solution(parameters, constants, cost, 0, "linear")
