"""How a simulated drive turns set-points into a demand: interpolation between them, ramps to a stop.

Positions are encoder counts as floats, times seconds.
"""

from __future__ import annotations


class Motion:
    """The demand of one drive.

    Attributes:
        demand: Where the drive wants its motor to be now, counts.
        velocity: How fast the demand moves, counts/s.
    """

    def __init__(self) -> None:
        self.demand = 0.0
        self.velocity = 0.0
        self._goal = 0.0
        self._remaining = 0.0
        self._deceleration: float | None = None

    @property
    def stopped(self) -> bool:
        """Whether a ramp to a stop has ended."""
        return self._deceleration is not None and self.velocity == 0.0

    def hold(self, position: float) -> None:
        """Stand at `position` from now on."""
        self.demand = self._goal = position
        self.velocity = 0.0
        self._remaining = 0.0
        self._deceleration = None

    def follow(self, target: float, period: float) -> None:
        """Move evenly to `target` within `period`, the interpolation time 0x60C2."""
        self._goal = target
        self._remaining = period
        self._deceleration = None

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
        if self._remaining > dt * 1.001:
            self.demand += (self._goal - self.demand) * dt / self._remaining
            self._remaining -= dt
        else:
            # Nothing is extrapolated: without a new set-point the drive stands at the last one.
            self.demand = self._goal
            self._remaining = 0.0
        self.velocity = (self.demand - before) / dt
