"""`Wiring`: gains, zeros and a delay of a recording, and the motion and torque without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..dynamics.arm import FloatArray
from ..recording.corrections import Corrections, JointCorrection
from ..recording.motion import Motion

GAIN, ZERO, DELAY = "gain", "zero", "delay"
"""Kinds of what may be off; a column is called `gain[JOINT]`, `zero[JOINT]` or `delay`."""


def column_names(joints: Sequence[str]) -> tuple[str, ...]:
    """Names of all columns: gains, zeros, one delay."""
    return (*(f"{GAIN}[{joint}]" for joint in joints), *(f"{ZERO}[{joint}]" for joint in joints), DELAY)


def kind_and_joint(column: str) -> tuple[str, str]:
    """What a column is of, and the joint; none for the delay."""
    kind, _, joint = column.rstrip("]").partition("[")
    return kind, joint


@dataclass(frozen=True)
class Wiring:
    """How a recording differs from what the arm did.

    Attributes:
        gain: (n,) recorded torque over the true one.
        zero_rad: (n,) true position less the recorded one.
        delay_s: How much later than the motion the torque was stamped.
    """

    gain: FloatArray
    zero_rad: FloatArray
    delay_s: float = 0.0

    @classmethod
    def right(cls, joints: int) -> Wiring:
        """Nothing is off."""
        return cls(np.ones(joints), np.zeros(joints))

    @classmethod
    def of_columns(cls, joints: Sequence[str], values: Mapping[str, float]) -> Wiring:
        """From `by_column`."""
        gains, zeros = (np.array([values[f"{kind}[{joint}]"] for joint in joints]) for kind in (GAIN, ZERO))
        return cls(np.exp(gains), zeros, values[DELAY])

    def by_column(self, joints: Sequence[str]) -> dict[str, float]:
        """Column -> the logarithm of a gain, a zero (rad), the delay (s)."""
        return dict(
            zip(column_names(joints), (*np.log(self.gain).tolist(), *self.zero_rad.tolist(), float(self.delay_s)))
        )

    def undone(self, motions: Sequence[Motion]) -> list[Motion]:
        """Motions as they would have been recorded rightly; torque is interpolated at the later times."""
        return [self._undone(motion) for motion in motions]

    def _undone(self, motion: Motion) -> Motion:
        torque = motion.torque
        if self.delay_s:
            time = np.arange(len(torque)) / motion.rate_hz
            torque = np.column_stack([np.interp(time + self.delay_s, time, one) for one in torque.T])
        return replace(motion, position=motion.position + self.zero_rad, torque=torque / self.gain)

    def corrections(self, joints: Sequence[str]) -> Corrections:
        """The same as corrections of a recording."""
        return Corrections(
            {
                name: JointCorrection(
                    position_offset_rad=float(self.zero_rad[k]),
                    effort_scale=float(1.0 / self.gain[k]),
                    effort_delay_s=self.delay_s,
                )
                for k, name in enumerate(joints)
            }
        )
