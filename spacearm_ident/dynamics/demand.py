"""What torque an arm's CAD links ask of its joints: gravity in any posture, and their inertia.

The scale for everything that a description lacks: a torque limit, the friction of a simulated arm.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from .arm import Arm
from .urdf_chain import bounded

POSTURES = 300
"""Random postures in which torque is looked at."""
USUAL_ACCELERATION = 4.0
"""rad/s² or m/s²: of an industrial arm's joint, where no limit is stated."""


def drawn_postures(arm: Arm, count: int = POSTURES, seed: int = 0) -> FloatArray:
    """(count, n) rad or m, uniform between the limits, at most half a turn (or π m) from zero.

    Args:
        arm: Arm of n joints, with its position limits.
        count: Number of postures.
        seed: Seed of the random generator.
    """
    lower = np.array([max(joint.lower, -np.pi) for joint in arm.joints])
    upper = np.array([min(joint.upper, np.pi) for joint in arm.joints])
    return np.random.default_rng(seed).uniform(lower, np.maximum(upper, lower), (count, len(arm.joints)))


def gravity_torques(arm: Arm, postures: FloatArray) -> FloatArray:
    """(T, n) N m or N that hold the CAD links in postures (T, n).

    Args:
        arm: Links of the URDF and the gravity vector.
        postures: (T, n) rad or m.
    """
    model = pin.buildModelFromXML(bounded(arm.urdf))
    model.gravity.linear = arm.gravity
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, posture).copy() for posture in postures])


def joint_inertias(arm: Arm, postures: FloatArray) -> FloatArray:
    """(T, n) kg m² or kg that each joint moves in postures (T, n), the others at rest: the diagonal of M(q).

    Args:
        arm: Links of the URDF.
        postures: (T, n) rad or m.
    """
    model = pin.buildModelFromXML(bounded(arm.urdf))
    data = model.createData()
    return np.array([np.diag(pin.crba(model, data, posture)) for posture in postures])


def torque_asked(arm: Arm) -> FloatArray:
    """(n,) N m or N: the most that gravity asks in `drawn_postures`, and the largest inertia at its acceleration."""
    postures = drawn_postures(arm)
    limit = np.array([joint.acceleration_limit for joint in arm.joints])
    acceleration = np.minimum(limit, USUAL_ACCELERATION)
    inertia = joint_inertias(arm, postures).max(axis=0)
    return np.asarray(np.abs(gravity_torques(arm, postures)).max(axis=0) + inertia * acceleration)
