"""What the simulated drives need of the physics behind them, and a stand-in without any."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...arrays import BoolArray, FloatArray


class Mechanics(Protocol):
    """Motors, position loops and arm of n joints; output side, SI units.

    Attributes:
        position: (n,) rad.
        velocity: (n,) rad/s.
        torque: (n,) N·m that the drives believe to produce: measured current × nominal torque constant ×
            gear ratio, noise included. Where the true constant differs, only the physics knows.
        temperature: (n,) °C of the windings.
    """

    position: FloatArray
    velocity: FloatArray
    torque: FloatArray
    temperature: FloatArray

    def step(self, target: FloatArray, enabled: BoolArray, brake: BoolArray, dt: float) -> None:
        """Let `dt` seconds pass.

        Args:
            target: (n,) rad, what the position loops shall follow.
            enabled: (n,) whether the loop is closed; without it the motor has no current.
            brake: (n,) whether the holding brake is closed.
            dt: Seconds.
        """


class FirstOrderArm:
    """Joints that follow their target with a time constant and report a torque that tells tests apart.

    The torque is `stiffness × (target − position)`; temperatures rise by 1 °C a joint from 20 °C.
    """

    def __init__(self, joints: int, time_constant: float = 0.005, stiffness: float = 1000.0) -> None:
        self.position = np.zeros(joints)
        self.velocity = np.zeros(joints)
        self.torque = np.zeros(joints)
        self.temperature = 20.0 + np.arange(joints)
        self._time_constant = time_constant
        self._stiffness = stiffness

    def step(self, target: FloatArray, enabled: BoolArray, brake: BoolArray, dt: float) -> None:
        """Let `dt` seconds pass; joints that are not enabled stand still."""
        error = np.where(enabled & ~brake, target - self.position, 0.0)
        move = error * -np.expm1(-dt / self._time_constant)
        self.position = self.position + move
        self.velocity = move / dt
        self.torque = self._stiffness * (error - move)
