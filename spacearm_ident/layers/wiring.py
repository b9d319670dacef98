"""`Wiring`: gains, zeros and a delay of a recording, and the motion and torque without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..dynamics.arm import FloatArray
from ..recording.corrections import Corrections, JointCorrection
from ..recording.motion import Motion


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
