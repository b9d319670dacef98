"""How a simulated drive turns set-points into a demand: interpolation between them, ramps to a stop.

A set-point that is missing in an even stream is extrapolated, as drives do that are told to (some call it
"extrapolation cycles"): otherwise each one would be a jerk. Positions are encoder counts as floats, times seconds.
"""

from __future__ import annotations

from typing import Final

from spacearm_ident.canbus.arm_bus import EXTRAPOLATION

#: Interpolation periods in which the drive then goes back to the last set-point.
RETURN: Final = 100


class Motion:
    """The demand of one drive.

    Attributes:
        demand: Where the drive wants its motor to be now, counts.
        velocity: How fast the demand moves, counts/s.
    """

    def __init__(self, extrapolation: float = EXTRAPOLATION) -> None:
        """Stand at zero; a stream of set-points that breaks off is extrapolated for so many seconds."""
        self._extrapolation = extrapolation
        self.demand = 0.0
        self.velocity = 0.0
        self._goal = 0.0
        self._remaining = 0.0
        self._deceleration: float | None = None
        # Seconds: the interpolation period, since the last set-point, how long to go on without one.
        self._period = 0.0
        self._age = float("inf")
        self._beyond = 0.0

    @property
    def stopped(self) -> bool:
        """Whether a ramp to a stop has ended."""
        return self._deceleration is not None and self.velocity == 0.0

    def hold(self, position: float) -> None:
        """Stand at `position` from now on."""
        self.demand = self._goal = position
        self.velocity = 0.0
        self._remaining = self._beyond = 0.0
        self._age = float("inf")
        self._deceleration = None

    def follow(self, target: float, period: float, stale: float = 0.0) -> None:
        """Move evenly to `target` within `period`, the interpolation time 0x60C2.

        Args:
            target: Where to be.
            period: In how many seconds.
            stale: How many seconds ago that should have begun; made up with the velocity.
        """
        self._goal = target + self.velocity * stale
        self._remaining = self._period = period
        self._deceleration = None
        most = self._extrapolation
        # A lone set-point is a place to go to, not a motion to continue.
        self._beyond = most if self._age <= most else 0.0
        self._age = 0.0

    def stop(self, deceleration: float) -> None:
        """Ramp the demand down to a stop; set-points no longer count."""
        self._deceleration = deceleration

    def advance(self, dt: float) -> None:
        """Let `dt` pass."""
        if self._deceleration is not None:
            speed = max(0.0, abs(self.velocity) - self._deceleration * dt)
            self.velocity = speed if self.velocity > 0 else -speed
            self.demand += self.velocity * dt
            return
        before = self.demand
        self._age += dt
        if self._remaining > dt * 1.001:
            self.demand += (self._goal - self.demand) * dt / self._remaining
            self._remaining -= dt
        elif self._remaining > 0.0:
            self.demand = self._goal
            self._remaining = 0.0
        elif self._beyond > 0.0:
            self.demand += self.velocity * dt
            self._beyond -= dt
            if self._beyond <= 0.0:
                self._remaining = RETURN * self._period
        self.velocity = (self.demand - before) / dt
