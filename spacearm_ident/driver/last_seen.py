"""`LastSeen`: where each joint was when its drive was heard last, so that a drive that comes back elsewhere is noticed.

A drive with an incremental encoder counts from zero after it has lost its power. Its positions are then wrong by a
constant, and limits, clearances and an identification with them; nothing else on the bus shows it. What a joint may
have moved while its drive was not heard is bounded:

- a drive that hears but is not heard follows the targets it is sent: its joint is among them;
- one that does not hear goes on with its last velocity for its extrapolation time at most, then brakes;
- one that has lost its power is stopped by its brake, with the deceleration of the arm's acceleration limit at least
  (the quick-stop ramp is several times that);
- a joint without power sinks until its brake holds (`SAG`).

How long the drive was away does not matter: an absolute encoder comes back where it was, and an arm with closed brakes
does not move. A joint that a person has moved meanwhile cannot be told from one that has lost its position; starting
the driver anew says that somebody has compared them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from spacearm_ident.arrays import BoolArray, FloatArray
from spacearm_ident.driver.safety import Limits

#: How far a joint may sink until its brake holds, rad: a brake closes within 0.06 s, and gravity alone turns a link of
#: a metre with no more than about 10 rad/s²: ½ · 10 · 0.06². Also the distance within which a set-point may begin.
SAG: Final = 0.02


class LastSeen:
    """What was seen last of n joints.

    Attributes:
        position: (n,) rad where each joint was seen last; NaN where it never was.
    """

    def __init__(
        self, limits: Limits, deceleration: Sequence[float] | FloatArray, extrapolation: float, period: float
    ) -> None:
        """Nothing has been seen.

        Args:
            limits: Names and largest velocities of the joints.
            deceleration: (n,) rad/s² with which a joint is stopped at least.
            extrapolation: How long a drive goes on with its last velocity, s.
            period: Of the cycle, s.
        """
        n = len(limits.joints)
        self._joints, self._fastest = limits.joints, limits.velocity
        self._deceleration = np.asarray(deceleration, dtype=float)
        self._extrapolation, self._period = extrapolation, period
        self.position = np.full(n, np.nan)
        # What a joint was asked for since then, and its largest speed.
        self._low, self._high = self.position.copy(), self.position.copy()
        self._speed = np.zeros(n)
        self._target = self.position.copy()
        self._distrusted = np.zeros(n, dtype=bool)

    def observe(
        self, position: FloatArray, speed: FloatArray, fresh: BoolArray, target: FloatArray, powered: BoolArray
    ) -> None:
        """Take in a cycle.

        Args:
            position: (n,) rad.
            speed: (n,) rad/s measured; NaN where it is not known.
            fresh: (n,) whether the position is of this cycle.
            target: (n,) rad that was sent.
            powered: (n,) whether the joint was in operation when it was heard last, and may follow that.
        """
        seen = fresh & ~self._distrusted
        for kept in (self.position, self._low, self._high):
            np.copyto(kept, position, where=seen)
        np.copyto(self._speed, np.abs(speed), where=seen & ~np.isnan(speed))
        if not seen.all():
            away = powered & ~seen
            np.minimum(self._low, target, out=self._low, where=away)
            np.maximum(self._high, target, out=self._high, where=away)
            asked = np.abs(target - self._target) / self._period
            np.fmax(self._speed, np.minimum(asked, self._fastest), out=self._speed, where=away)
        self._target = target.copy()

    def distrust(self, joint: int) -> None:
        """Take in nothing more of a joint until `compare`: its drive has restarted, or was silent for too long."""
        self._distrusted[joint] = True

    def compare(self, position: FloatArray) -> str:
        """Whether the joints are where they can be; those that are are trusted again.

        Args:
            position: (n,) rad that the drives report now that they are connected again.

        Returns:
            Which joint is elsewhere and what to do, for a person; empty if none is.
        """
        travel = SAG + self._speed * self._extrapolation + self._speed**2 / (2.0 * self._deceleration)
        # Joints that were never seen (NaN) are not beyond anything.
        beyond = np.maximum(self._low - travel - position, position - self._high - travel)
        elsewhere = beyond > 0
        self._distrusted = elsewhere
        self._speed[~elsewhere] = 0.0
        for kept in (self.position, self._low, self._high, self._target):
            np.copyto(kept, position, where=~elsewhere)
        if not elsewhere.any():
            return ""
        joint = int(np.argmax(np.where(elsewhere, beyond, -np.inf)))
        # As the distance from where it was seen, of the two sides the one that it is on.
        reach = abs(position[joint] - self.position[joint]) - beyond[joint]
        return (
            f"{self._joints[joint]} is at {position[joint]:.4g} rad by its drive, but was at "
            f"{self.position[joint]:.4g} rad when the drive was heard last, and can have moved by {reach:.2g} rad: "
            "the drive has lost its position, or somebody has moved the joint. Home it or correct zero_counts, compare "
            "the posture with /joint_states, then start the driver anew"
        )
