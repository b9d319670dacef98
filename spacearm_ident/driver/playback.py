"""`Playback`: the set-points of a stream onto the drives, evenly even where the cycle was held up.

A kernel that promises nothing, or a hypervisor, holds the cycle up for 5 to 50 ms now and then. The drives go on
with their last velocity meanwhile for as long as they extrapolate (`ArmBus.extrapolation`), then stand. Playing what
the clock says from then on would make them jump; instead they are taken up where they are, and led on along the
same path q(s):

- As far as they went on, so does s. They have left the path by what it bent meanwhile: that is faded out (`FADE`).
- For as long as they stood, s lags behind the clock. It sets off from rest at a rate that keeps to the acceleration
  limits, |q'' ṡ² + q' s̈| (Bobrow, Dubowsky and Gibson 1985, "Time-optimal control of robotic manipulators along
  specified paths"), and makes the lag up at a rate that set-points may exceed the limits by.

So what is played is never ahead of the clock, and without a stall it is the stream, to the bit.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.driver.safety import TOLERANCE, Fault, Rule
from spacearm_ident.driver.set_points import SetPointStream

#: Cycles from one target to the next beyond which it is a stall. The arm hardly feels fewer: to set off from rest
#: would be the harder jerk (seen on the simulated arm, its drives standing at once).
STALL: Final = 6.5
#: What drives that extrapolated for T seconds are beside the path is faded out in F seconds, this long or so many T:
#: longer, and the arm gets further off, shorter, and it accelerates more (by 4 T/F + 3 T²/F² of what the path does).
FADE: Final = 0.15
FADE_SHARE: Final = 6.0
#: Most acceleration that bridging a stall asks for, as a multiple of the path's. A drive that goes on with its last
#: velocity for T seconds is a T²/2 and a T beside a path of acceleration a; the cubic that fades this out within
#: F >= FADE_SHARE T begins with 4 a T/F + 3 a T²/F². A path led on from rest keeps to the limits of the path itself.
BRIDGED_ACCELERATION: Final = 1.0 + 4.0 / FADE_SHARE + 3.0 / FADE_SHARE**2
#: Least acceleration then, same unit: the cubic ends with 2 a T/F + 3 a T²/F² the other way.
EASED_ACCELERATION: Final = 1.0 - 2.0 / FADE_SHARE - 3.0 / FADE_SHARE**2
#: Most velocity by which bridging exceeds the path's, as a multiple of a T. With r = T/F = 1/FADE_SHARE the cubic's
#: velocity is a T (1-s)((3+3r) s - 1) at the share s of the fade, largest at s = (4+3r)/(6+6r), where it is the value
#: here: 0.446. A catching up at `CATCH_UP` adds less than the tolerance of set-points.
_PEAK_AT: Final = (4.0 + 3.0 / FADE_SHARE) / (6.0 + 6.0 / FADE_SHARE)
BRIDGED_VELOCITY: Final = (1.0 - _PEAK_AT) * ((3.0 + 3.0 / FADE_SHARE) * _PEAK_AT - 1.0)
#: How long after bridging what the arm does is still its consequence, s: the monitor looks back over 20 ms, and a
#: joint of 5 Hz, damped a little, has come to rest after one swing.
AFTERMATH: Final = 0.2
#: Share by which the playing is faster than the clock while it lags; its square is within `TOLERANCE`.
CATCH_UP: Final = 0.4 * TOLERANCE
#: How fast the rate of playing may rise, 1/s, and how fast the catching up ends.
RISE: Final = 10.0
EASE: Final = 0.05
#: A machine that has held up the cycle so often that the playing lags by more is not fit for it, s.
LONGEST_LAG: Final = 1.0


class Playback:
    """The place in a stream that is played in each cycle; used by the cyclic thread alone.

    Attributes:
        stalls: Stalls bridged in motion, since the start.
        lag_ns: How far the playing lags behind the clock, ns.
        rate: Of the playing, path seconds a second; 1 unless it sets off or catches up.
    """

    def __init__(self, period: float, extrapolation: float) -> None:
        """Nothing is played yet.

        Args:
            period: Of the cycle, s.
            extrapolation: How long the drives go on by themselves without set-points, s.
        """
        self._stall_ns = round(1e9 * STALL * period)
        self._extrapolation_ns = round(1e9 * extrapolation)
        self.stalls = 0
        self.begin()

    def begin(self) -> None:
        """The arm is held; another stream is about to be played."""
        self.lag_ns, self.rate = 0, 1.0
        self._too_late: Fault | None = None
        # Until when what the arm does is a consequence of a stall.
        self._bridged_ns = 0
        # Time and target of the last two cycles.
        self._last: tuple[int, FloatArray] | None = None
        self._before: tuple[int, FloatArray] | None = None
        # Beside the path: since when, for how long, by how many rad, rad/s.
        self._beside: tuple[int, float, FloatArray, FloatArray] | None = None

    def bridging(self, now_ns: int) -> bool:
        """Whether what the arm does now, ns since the epoch, is the consequence of a stall in motion."""
        return now_ns < self._bridged_ns or self._beside is not None or self.rate < 1.0

    def target(self, stream: SetPointStream, now_ns: int) -> FloatArray | None:
        """What the drives shall follow now, (n,) rad; None where nothing has been played yet. Once a cycle.

        Args:
            stream: Set-points that have arrived.
            now_ns: The driver's clock, ns.
        """
        if self._last is not None:
            step_ns = now_ns - self._last[0]
            if step_ns > self._stall_ns:
                self._bridge(stream, now_ns, *self._last)
            elif self.lag_ns:
                self._make_up(stream, now_ns, step_ns)
        played = stream.target(now_ns - self.lag_ns)
        if played is None:
            return None
        if self._beside is not None:
            played = self._faded(stream, played, now_ns)
        self._before, self._last = self._last, (now_ns, played)
        return played

    def starved(self, stream: SetPointStream, now_ns: int) -> Fault | None:
        """Whether the stream has ended while the arm should move, or the cycle was held up for too long.

        Args:
            stream: Set-points that have arrived.
            now_ns: The driver's clock, ns.
        """
        return self._too_late or stream.starved(now_ns - self.lag_ns)

    def _bridge(self, stream: SetPointStream, now_ns: int, last_ns: int, last: FloatArray) -> None:
        """Take the drives up where they are now, having had no set-point since `last`."""
        step_ns = now_ns - last_ns
        if stream.rests(now_ns):
            self._settle()
            return
        self.stalls += 1
        self._bridged_ns = now_ns + round(1e9 * AFTERMATH)
        velocity = np.zeros_like(last)
        if self._before is not None:
            velocity = 1e9 * (last - self._before[1]) / (last_ns - self._before[0])
        gone_ns = min(step_ns, self._extrapolation_ns)
        there = last + 1e-9 * gone_ns * velocity
        self.lag_ns = max(0, self.lag_ns + step_ns - round(self.rate * gone_ns))
        if step_ns > gone_ns:
            self.rate, velocity = 0.0, np.zeros_like(last)
        elif self.lag_ns == 0:
            self.rate = 1.0
        if step_ns > 1e9 * stream.delay or self.lag_ns > 1e9 * LONGEST_LAG:
            self._too_late = Fault(
                Rule.STARVATION,
                f"the cycle was held up for {1e-6 * step_ns:.0f} ms while the arm should move, and set-points are "
                f"{1e-6 * self.lag_ns:.0f} ms late: end what else runs on this machine",
            )
        path = stream.target(now_ns - self.lag_ns)
        if path is not None and gone_ns:
            self._beside = (
                now_ns,
                max(FADE, FADE_SHARE * 1e-9 * gone_ns),
                there - path,
                velocity - self.rate * stream.course()[0],
            )

    def _make_up(self, stream: SetPointStream, now_ns: int, step_ns: int) -> None:
        """Let the playing go on by a cycle, and a little more."""
        if stream.rests(now_ns):
            self._settle()
            return
        velocity, acceleration = stream.course()
        # Between set-points the path is straight: it bends by q'' ṡ at some cycles, at others not.
        bend = self.rate * np.maximum(np.sign(velocity) * acceleration, 0.0)
        room = (stream.limits.acceleration - bend) / np.maximum(np.abs(velocity), 1e-9)
        rise = min(max(float(room.min()), 0.0), RISE)
        most = 1.0 + min(CATCH_UP, math.sqrt(2e-9 * EASE * self.lag_ns))
        if self.rate < 1.0:
            self._bridged_ns = now_ns + round(1e9 * AFTERMATH)
        self.rate = min(most, self.rate + 1e-9 * rise * step_ns)
        self.lag_ns = max(0, self.lag_ns - round((self.rate - 1.0) * step_ns))
        if self.lag_ns == 0:
            self.rate = 1.0

    def _settle(self) -> None:
        """Nothing moves between what is played and the clock: they are one."""
        self.lag_ns, self.rate = 0, 1.0

    def _faded(self, stream: SetPointStream, played: FloatArray, now_ns: int) -> FloatArray:
        """`played`, and what is left of being beside it: the cubic that begins with its position and velocity."""
        assert self._beside is not None
        since_ns, duration, beside, velocity = self._beside
        share = 1e-9 * (now_ns - since_ns) / duration
        if share >= 1.0:
            self._beside = None
            self._bridged_ns = now_ns + round(1e9 * AFTERMATH)
            return played
        left = (1.0 - share) ** 2 * ((1.0 + 2.0 * share) * beside + share * duration * velocity)
        faded: FloatArray = np.clip(played + left, stream.limits.lower, stream.limits.upper)
        return faded


def acceleration_for_stalls(
    velocity: FloatArray, acceleration: FloatArray, extrapolation: float, margin: float
) -> FloatArray:
    """(n,) acceleration a plan may use so that bridging any stall keeps to the monitor's velocity limit.

    Velocity is at most that of the path and `BRIDGED_VELOCITY` a T beyond it, T = `extrapolation`; a path of full speed
    keeps `margin` times the limit v as long as a <= (margin - 1) v / (`BRIDGED_VELOCITY` T).

    Args:
        velocity: (n,) limit, rad/s.
        acceleration: (n,) limit, rad/s².
        extrapolation: How long the drives go on by themselves, s.
        margin: What the monitor allows, as a multiple of the velocity limit (`safety.Margins`).
    """
    if not extrapolation > 0.0:
        return acceleration
    return np.minimum(acceleration, (margin - 1.0) * velocity / (BRIDGED_VELOCITY * extrapolation))
