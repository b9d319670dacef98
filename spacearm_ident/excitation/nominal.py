"""A model of an arm before any data, for its first excitation: CAD inertials, no friction known."""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel, TorqueModel, structure_of


def nominal_model(arm: Arm, friction: str = "paper") -> IdentifiedModel:
    """Parameters at their priors, constants absent: its torque is that of the CAD links alone.

    Args:
        arm: Arm whose links have CAD inertials.
        friction: One of `FRICTION_LAWS`: which terms the model has, at their priors.

    Raises:
        UserError: No friction law of that name.
    """
    model = TorqueModel(arm, structure_of(arm, friction))
    parameters = np.array([parameter.prior for parameter in model.parameters])
    return IdentifiedModel(model, parameters, np.array([constant.grid[0] for constant in model.constants]))
