"""What the simulated drives need of the physics behind them."""

from __future__ import annotations

from typing import Protocol

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
