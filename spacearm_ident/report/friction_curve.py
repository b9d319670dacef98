"""Friction over velocity, as the identified model has it: each joint swept alone, steadily, in one pose."""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.model import IdentifiedModel
from ..recording.motion import Motion

SLOWEST = 1e-4
"""Smallest speed of the curve, as a share of its largest."""
STEADY_HZ = 1e-9
"""A sample rate so low that any presliding distance is long travelled between two samples: steady friction."""


def friction_curve(
    identified: IdentifiedModel, joint: int, top_speed: float, pose: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Steady friction torque of one joint.

    Args:
        identified: The model.
        joint: Its index.
        top_speed: Largest speed of the sweep, rad/s.
        pose: (n,) position it is taken in, rad: friction that grows with the load depends on it.

    Returns:
        (K,) velocities from -top_speed to top_speed without zero, and (K,) N·m.
    """
    speeds = np.unique(np.concatenate([np.geomspace(SLOWEST, 1.0, 120), np.linspace(0.01, 1.0, 80)])) * top_speed
    sweep = np.concatenate([-speeds[::-1], speeds])
    position = np.tile(pose, (len(sweep), 1))
    velocity = np.zeros_like(position)
    velocity[:, joint] = sweep
    zero = np.zeros(position.shape[1])
    still = np.zeros_like(position)
    joints = identified.model.arm.joint_names
    motion = Motion(joints, STEADY_HZ, 0.0, position, velocity, still, still, zero, zero)
    return sweep, identified.torque(motion, identified.model.friction_kinds)[:, joint]
