"""Where the joints' frames are: forward kinematics for many postures at once."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .arm import Arm
from .regressor import joint_placement

Frames = list[tuple[FloatArray, FloatArray]]
"""The base's and every joint's rotation (3, 3, T) and origin (3, T) in the base frame."""


def frames_of(arm: Arm, postures: FloatArray) -> Frames:
    """Base and joint frames of an arm at postures (T, n), rad or m.

    Args:
        arm: Joints with their placements.
        postures: (T, n) joint positions, in the arm's order.

    Returns:
        n + 1 frames: number 0 is the base's, k + 1 that of joint k.
    """
    samples = len(postures)
    frames = [(np.tile(np.eye(3)[..., None], samples), np.zeros((3, samples)))]
    for joint, q in zip(arm.joints, postures.T):
        turn, origin = frames[joint.parent + 1]
        own, moved = joint_placement(joint, q)
        frames.append((np.einsum("ijt,jkt->ikt", turn, own), origin + (turn * moved).sum(axis=1)))
    return frames
