"""From a drive's integers to SI on the output side of each joint, with nothing guessed.

Drives disagree on what 0x6077 "torque actual value" is per mille of: rated torque (0x6076, CiA 402) or rated
current (0x6075), as an RMS or as a peak value. A wrong choice is a wrong torque scale, which identification
turns into wrong masses. So source, rated value, peak factor and sign are stated for every joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError


@dataclass(frozen=True)
class JointScale:
    """Units of one joint's drive: what its position and torque values stand for.

    Attributes:
        counts_per_turn: Encoder counts of 0x6064 and 0x607A in one turn of the motor.
        gear_ratio: Motor turns in one turn of the joint.
        torque_constant: N·m of motor torque per A, for currents as `peak_factor` leaves them.
        rated: What 1000 per mille stands for: N·m on the motor side (0x6076), or A (0x6075).
        torque_source: Whether `rated` is a torque or a current.
        peak_factor: Multiplies the reported value to reach the kind of ampere the torque constant is for:
            1, √2 (reported RMS, constant for peak) or 1/√2.
        direction: +1, or −1 where the motor turns against the joint's positive sense.
        torque_sign: +1 where positive torque drives towards positive counts, else −1.
        zero_counts: 0x6064 where the joint angle is zero.
    """

    counts_per_turn: float
    gear_ratio: float
    torque_constant: float
    rated: float
    torque_source: Literal["rated_torque", "rated_current"] = "rated_current"
    peak_factor: float = 1.0
    direction: int = 1
    torque_sign: int = 1
    zero_counts: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be a drive.

        Raises:
            UserError: A value is not positive, a sign is not ±1, or the torque source is unknown.
        """
        for name in ("counts_per_turn", "gear_ratio", "torque_constant", "rated", "peak_factor"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise UserError(f"{name} of a joint is {value}: give a positive number")
        for name in ("direction", "torque_sign"):
            if getattr(self, name) not in (1, -1):
                raise UserError(f"{name} of a joint is {getattr(self, name)}: give 1 or -1")
        if self.torque_source not in ("rated_torque", "rated_current"):
            raise UserError(
                f"torque_source of a joint is '{self.torque_source}': give 'rated_torque' or 'rated_current'"
            )

    @property
    def rad_per_count(self) -> float:
        """Joint angle of one encoder count, with its sign."""
        return self.direction * 2.0 * np.pi / (self.counts_per_turn * self.gear_ratio)

    @property
    def amps_per_unit(self) -> float:
        """Motor current of one unit (per mille) of the torque value, with its sign in the joint's sense."""
        per_unit = 1e-3 * self.rated * self.peak_factor
        if self.torque_source == "rated_torque":
            per_unit /= self.torque_constant
        return self.direction * self.torque_sign * per_unit

    @property
    def torque_per_unit(self) -> float:
        """Output-side torque, N·m, of one unit: current × torque constant × gear ratio."""
        return self.amps_per_unit * self.torque_constant * self.gear_ratio


class Scaling:
    """The scales of n joints as arrays, for a whole cycle at once.

    Attributes:
        zero_counts: (n,) counts at joint angle zero.
        rad_per_count: (n,).
        torque_per_unit: (n,) N·m on the output side.
        amps_per_unit: (n,) A.
    """

    def __init__(self, joints: Sequence[JointScale]) -> None:
        self.zero_counts = np.array([joint.zero_counts for joint in joints], dtype=float)
        self.rad_per_count = np.array([joint.rad_per_count for joint in joints])
        self.torque_per_unit = np.array([joint.torque_per_unit for joint in joints])
        self.amps_per_unit = np.array([joint.amps_per_unit for joint in joints])

    def to_position(self, counts: NDArray[np.int32], out: FloatArray) -> None:
        """Joint angles of encoder counts, rad, into `out`; both (n,).

        Args:
            counts: Encoder counts.
            out: Filled; rad.
        """
        np.subtract(counts, self.zero_counts, out=out)
        np.multiply(out, self.rad_per_count, out=out)

    def to_counts(self, position: FloatArray, out: FloatArray) -> None:
        """Nearest whole encoder counts of joint angles (rad), as floats into `out`; both (n,).

        Args:
            position: Joint angles, rad.
            out: Filled; counts.
        """
        np.divide(position, self.rad_per_count, out=out)
        np.add(out, self.zero_counts, out=out)
        np.rint(out, out=out)
