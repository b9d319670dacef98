"""The simulated drives' inner loops: position over velocity over current, fed back from a motor encoder.

Proportional over proportional, as servo drives run with their integrators off: with an integrator and this
much static friction an arm hunts at rest. Gravity leaves a position error of a few mrad; it is in what is
recorded too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray


@dataclass(frozen=True, eq=False)
class DriveData:
    """Electrical data of n drives, (n,) each.

    Attributes:
        gear_ratio: Motor turns per output turn.
        torque_constant: N·m/A on the motor side.
        torque_limit: N·m on the output side.
        winding_resistance: Ω.
    """

    gear_ratio: FloatArray
    torque_constant: FloatArray
    torque_limit: FloatArray
    winding_resistance: FloatArray

    @classmethod
    def plain(
        cls,
        n: int,
        *,
        gear_ratio: ArrayLike = 100.0,
        torque_constant: ArrayLike = 0.15,
        torque_limit: ArrayLike = np.inf,
        winding_resistance: ArrayLike = 0.6,
    ) -> DriveData:
        """Data of n drives, each quantity from one number for all drives or (n,) numbers.

        Args:
            n: Number of drives.
            gear_ratio: Motor turns per output turn.
            torque_constant: N·m/A on the motor side.
            torque_limit: N·m on the output side.
            winding_resistance: Ω.
        """
        given = (gear_ratio, torque_constant, torque_limit, winding_resistance)
        return cls(*(np.broadcast_to(np.asarray(value, dtype=float), (n,)).copy() for value in given))

    @property
    def torque_per_ampere(self) -> FloatArray:
        """(n,) N·m on the output side per ampere."""
        return self.torque_constant * self.gear_ratio

    @property
    def copper_loss(self) -> FloatArray:
        """(n,) W lost in the windings per squared output torque, W/(N·m)²."""
        return self.winding_resistance / self.torque_per_ampere**2


@dataclass(frozen=True)
class ServoTuning:
    """How the loops of every drive are tuned.

    Attributes:
        rate_hz: Rate of the inner loops.
        velocity_bandwidth_hz: Cross-over of the velocity loop.
        position_bandwidth_hz: Cross-over of the position loop, a quarter of the above or less.
        velocity_filter_hz: Corner of the low-pass on the encoder difference.
        encoder_counts: Motor encoder counts per motor turn.
    """

    rate_hz: float = 4000.0
    velocity_bandwidth_hz: float = 40.0
    position_bandwidth_hz: float = 8.0
    velocity_filter_hz: float = 400.0
    encoder_counts: int = 2**20


class Servo:
    """The cascaded loops of n drives: motor torque (output side) from set-point and true position."""

    def __init__(self, inertia: FloatArray, drives: DriveData, tuning: ServoTuning, position: FloatArray) -> None:
        """Tune the loops and start at rest at `position`.

        Args:
            inertia: (n,) kg·m² the loops are tuned for (diagonal of the joint-space inertia).
            drives: Electrical data.
            tuning: Bandwidths and encoder.
            position: (n,) rad.
        """
        self.dt = 1.0 / tuning.rate_hz
        self._velocity_gain = inertia * 2 * np.pi * tuning.velocity_bandwidth_hz
        self._position_gain = 2 * np.pi * tuning.position_bandwidth_hz
        self._count = 2 * np.pi / (tuning.encoder_counts * drives.gear_ratio)
        self._filter_share = -np.expm1(-2 * np.pi * tuning.velocity_filter_hz * self.dt)
        self._limit, self._limit_below = drives.torque_limit, -drives.torque_limit
        self._last = np.rint(position / self._count) * self._count
        self._velocity = np.zeros_like(inertia)

    def torque(self, position: FloatArray, command: FloatArray, command_velocity: FloatArray) -> FloatArray:
        """One cycle: (n,) N·m to hold until the next, inside the torque limits.

        Args:
            position: (n,) rad, true; the encoder of the drive quantises it.
            command: (n,) rad, interpolated set-point.
            command_velocity: (n,) rad/s, its rate.
        """
        measured = np.rint(position / self._count) * self._count
        self._velocity = self._velocity + self._filter_share * ((measured - self._last) / self.dt - self._velocity)
        self._last = measured
        wanted = command_velocity + self._position_gain * (command - measured)
        torque = self._velocity_gain * (wanted - self._velocity)
        return np.minimum(np.maximum(torque, self._limit_below), self._limit)
