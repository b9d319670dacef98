"""`FreeBase`: how a base moves that nothing holds, from the motion of the joints: momentum stays zero.

The base is six more joints (Umetani and Yoshida 1989): its velocity is what makes the momentum of the whole zero, its
acceleration what makes the wrench on it zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..signals.base_motion import BaseMotion
from .arm import Arm, Joint
from .regressor import rigid_body_torque

BELOW_M, DEEPEST_M = 0.3, 1.5
"""How far below the arm's foot the middle of what carries it may be."""
INERTIA_RATIOS = tuple(float(ratio) for ratio in 0.1 * 2.3 ** np.arange(9))
"""Inertia of a base about its centre of mass over the arm's mass, m²: what is looked through."""
MASS_RATIOS = (2.0, 4.5, 10.0, 22.0, 50.0, 110.0, 240.0, 500.0)
"""Mass of a base over the arm's."""


class FreeBase:
    """The arm on six virtual joints, in zero gravity: its inertia matrix and the torque on a held base.

    Attributes:
        fixed: (N, n) torque of the links on a base that is held, N·m.
    """

    def __init__(
        self, arm: Arm, inertials: FloatArray, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> None:
        """Compute what does not depend on the base.

        Args:
            arm: Arm of n joints.
            inertials: (n, 10) of its links, SI.
            position: (N, n) rad or m.
            velocity: (N, n) rad/s or m/s.
            acceleration: (N, n) rad/s² or m/s².
        """
        axes, zero = np.eye(3), np.zeros(10)
        virtual = [Joint(f"base_{k}", k - 1, k >= 3, axes[k % 3], np.eye(3), np.zeros(3), zero) for k in range(6)]
        moved = [replace(joint, parent=joint.parent + 6) for joint in arm.joints]
        self._arm = replace(arm, joints=(*virtual, *moved), couplings=(), gravity=np.zeros(3))
        self._inertials = np.concatenate([np.zeros((6, 10)), inertials])
        self._q, self._qd, self._qdd = (
            np.hstack([np.zeros((len(signal), 6)), signal]) for signal in (position, velocity, acceleration)
        )
        # (N, 6, 6 + n) rows of the base in the inertia matrix: symmetric, so columns will do.
        self._rows = np.stack([self._column(k) for k in range(6)], axis=1)
        self.fixed = rigid_body_torque(self._arm, self._inertials, self._q, self._qd, self._qdd)[:, 6:]

    def _column(self, axis: int) -> FloatArray:
        unit, still = np.zeros_like(self._q), np.zeros_like(self._q)
        unit[:, axis] = 1.0
        return rigid_body_torque(self._arm, self._inertials, self._q, still, unit)

    def _solved(self, turn: float, mass: float, below: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Velocity (N, 6) and acceleration (N, 6) of the virtual joints, and the arm's torque (N, n) were they held."""
        rocked = turn + mass * below**2
        inertials = self._inertials.copy()
        inertials[5] = mass, 0.0, 0.0, -mass * below, rocked, 0.0, rocked, 0.0, 0.0, turn
        own = np.diag([mass, mass, mass, rocked, rocked, turn])
        own[[0, 4], [4, 0]] = -mass * below
        own[[1, 3], [3, 1]] = mass * below
        inertia = self._rows[:, :, :6] + own
        momentum = np.einsum("nij,nj->ni", self._rows[:, :, 6:], self._qd[:, 6:])
        velocity = self._qd.copy()
        velocity[:, :6] = -np.linalg.solve(inertia, momentum[..., None])[..., 0]
        torque = rigid_body_torque(self._arm, inertials, self._q, velocity, self._qdd)
        acceleration = -np.linalg.solve(inertia, torque[:, :6, None])[..., 0]
        return velocity[:, :6], np.asarray(acceleration), torque[:, 6:]

    def change(self, turn: float, mass: float, below: float = BELOW_M) -> FloatArray:
        """(N, n) torque of the free arm less that of the fixed one, N·m.

        Args:
            turn: Inertia of the base about its centre of mass, kg·m², the same about every axis.
            mass: Its mass, kg.
            below: How far its centre of mass is below the arm's foot, m.
        """
        _, acceleration, torque = self._solved(turn, mass, below)
        return np.asarray(torque + np.einsum("nij,ni->nj", self._rows[:, :, 6:], acceleration) - self.fixed)

    def motion(self, turn: float, mass: float, below: float = BELOW_M) -> BaseMotion:
        """Motion of the base link in its own axes, (N, 3) each.

        Args:
            turn: Inertia of the base about its centre of mass, kg·m², the same about every axis.
            mass: Its mass, kg.
            below: How far its centre of mass is below the arm's foot, m.
        """
        velocity, acceleration, _ = self._solved(turn, mass, below)
        rate, rate_dot = velocity[:, 3:], acceleration[:, 3:].copy()
        # The axes of y and z are carried by the joints before them.
        about_x, about_y, about_z = rate[:, :, None].transpose(1, 0, 2) * np.eye(3)[:, None, :]
        rate_dot += np.cross(about_x, about_y) + np.cross(about_x + about_y, about_z)
        return BaseMotion(rate, rate_dot, acceleration[:, :3])
