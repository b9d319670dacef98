"""`Setup`: one set of conventions under which a recording might have been made, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.free_base import FreeBase
from .evidence import GAIN_SD, ArmMotion
from .rows import Rows


@dataclass(frozen=True)
class Setup:
    """How the arm's joints follow from what was recorded; n joints in the arm's order.

    Attributes:
        position_from: (n,) recorded column that holds each joint's position.
        position_scale: (n,) factor on it: -1 where the axis is reversed, pi/180 where it is in degrees.
        position_offset: (n,) rad added to it.
        effort_from: (n,) recorded column that holds each joint's torque.
        effort_sign: (n,) factor on it.
        gain_sd: (n,) standard deviation of the logarithm of each gain.
        common_gain_sd: The same of a gain that all joints share; 0: none.
        delay_s: (n,) how much later than the motion the torque was stamped.
        gravity: (3,) m/s^2 in the base frame.
        time_sign: -1 where the clock ran backwards.
        payload_kg: Standard deviation of the mass of a body on the last link, kg; 0: no more than is usual.
        free_base: Inertia (kg m^2) and mass (kg) of a base that nothing holds; None: it is held.
    """

    position_from: np.ndarray
    position_scale: FloatArray
    position_offset: FloatArray
    effort_from: np.ndarray
    effort_sign: FloatArray
    gain_sd: FloatArray
    delay_s: FloatArray
    gravity: FloatArray
    common_gain_sd: float = 0.0
    time_sign: float = 1.0
    payload_kg: float = 0.0
    free_base: tuple[float, float] | None = None

    @classmethod
    def as_recorded(cls, arm: Arm) -> Setup:
        """Everything as the contract has it."""
        n = len(arm.joints)
        order, one, zero = np.arange(n), np.ones(n), np.zeros(n)
        return cls(order, one, zero, order, one, np.full(n, GAIN_SD), zero, arm.gravity)

    def same_motion(self, other: Setup) -> bool:
        """Whether both give the joints the same motion under the same gravity."""
        return (
            np.array_equal(self.position_from, other.position_from)
            and np.array_equal(self.position_scale, other.position_scale)
            and np.array_equal(self.position_offset, other.position_offset)
            and np.array_equal(self.gravity, other.gravity)
            and self.time_sign == other.time_sign
            and self.free_base == other.free_base
        )


def motion_of(rows: Rows, setup: Setup, arm: Arm) -> ArmMotion:
    """Motion of the arm's joints under a setup, and of a free base as the CAD inertials make it move.

    Args:
        rows: As recorded.
        setup: What is recorded how.
        arm: With CAD inertials.
    """
    source, scale, back = setup.position_from, setup.position_scale, setup.time_sign
    position = rows.position[:, source] * scale + setup.position_offset
    velocity, acceleration = back * rows.velocity[:, source] * scale, rows.acceleration[:, source] * scale
    base = None
    if setup.free_base is not None:
        inertials = np.array([joint.inertial for joint in arm.joints])
        base = FreeBase(arm, inertials, position, velocity, acceleration).motion(*setup.free_base)
    return ArmMotion(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        direction=back * rows.direction[:, source] * np.sign(scale),
        unbuilt=back * rows.unbuilt[:, source] * np.sign(scale),
        moving=rows.moving[:, source],
        gravity=setup.gravity,
        base=base,
    )


def torque_of(rows: Rows, setup: Setup) -> FloatArray:
    """(M, n) torque of the arm's joints under a setup, N·m; a delay belongs to the joint, wherever it is recorded.

    Args:
        rows: As recorded.
        setup: What is recorded how.
    """
    delay = np.empty(len(setup.effort_from))
    delay[setup.effort_from] = setup.delay_s
    return np.asarray(rows.torque(delay)[:, setup.effort_from] * setup.effort_sign)
