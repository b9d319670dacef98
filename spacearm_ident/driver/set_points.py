"""`SetPointStream`: set-points as they are streamed, played back evenly on the driver's clock.

Messages arrive with the jitter of two processes and a network; the arm must not feel it. The header stamp of
a set-point says when it is meant; it is played `delay` seconds after that, interpolated between neighbours.
So up to `delay` of jitter is absorbed, and velocity and acceleration are judged from the stamps, exactly.

The rules for whoever streams:

- stamps advance evenly with the motion (the planned times, not the times of publishing), and are of this
  machine's clock;
- the first set-point is near where the arm is (`START`); what remains is blended out over `BLEND` seconds;
- the motion starts and ends at rest. A stream that ends while the arm should move is a fault.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.canbus.arm_bus import STANDSTILL
from spacearm_ident.driver.safety import Fault, Limits, Rule, judge_step

#: Largest distance of the first set-point from where the arm is held, rad.
START: Final = 0.02
BLEND: Final = 0.5
#: Difference of a stamp from the clock beyond which one of them is wrong, s.
CLOCK: Final = 1.0
#: A pause of this many seconds at rest ends a stream; the next set-point begins another.
PAUSE: Final = 0.1
#: How long the last velocity is kept when the next set-point has not come, s.
BRIDGE: Final = 0.003
#: Set-points kept at most: the delay's worth, many times over.
MOST_WAITING: Final = 20000


class SetPointStream:
    """Set-points of one enabled period; `put` and `target` may be called from different threads.

    Attributes:
        limits: For every set-point.
        delay: Seconds from a set-point's stamp to its playing.
        accepted: Set-points taken in.
    """

    def __init__(self, limits: Limits, held: FloatArray, delay: float = 0.2) -> None:
        """Start at rest.

        Args:
            limits: For every set-point.
            held: (n,) rad, where the drives hold the arm.
            delay: Seconds from a set-point's stamp to its playing.
        """
        self.delay = delay
        self.accepted = 0
        self.limits = limits
        # To be played, offset blended in; as streamed; where the arm is held between streams.
        self._waiting: deque[tuple[int, FloatArray]] = deque()
        self._last: tuple[int, FloatArray] | None = None
        self._held = held.copy()
        self._velocity = np.zeros(len(held))
        self._step_s = 0.0
        self._moving = False
        self._origin_ns = 0
        self._offset = np.zeros(len(held))

    @property
    def fill_s(self) -> float:
        """Seconds of set-points that wait to be played."""
        waiting = tuple(self._waiting)
        return 1e-9 * (waiting[-1][0] - waiting[0][0]) if waiting else 0.0

    def put(self, stamp_ns: int, position: FloatArray, now_ns: int) -> Fault | None:
        """Take in a set-point, unless it is refused.

        Args:
            stamp_ns: When it is meant, nanoseconds since the epoch.
            position: (n,) rad.
            now_ns: The time now.

        Returns:
            Why it is refused; nothing has been taken in then.
        """
        if abs(stamp_ns - now_ns) > 1e9 * CLOCK:
            seconds = 1e-9 * (stamp_ns - now_ns)
            return Fault(Rule.SET_POINT, f"its stamp is {seconds:.3g} s from the clock: stamp set-points when due")
        last = self._last
        if last is not None and stamp_ns <= last[0]:
            if stamp_ns == last[0] and np.array_equal(position, last[1]):
                return None
            return Fault(Rule.SET_POINT, "set-points go back in time: let only one node stream them")
        if last is None or (stamp_ns - last[0] > 1e9 * PAUSE and not self._moving):
            fault = self._begin(stamp_ns, position)
        else:
            fault = self._proceed(stamp_ns, position, last)
        if fault is None and len(self._waiting) >= MOST_WAITING:
            fault = Fault(Rule.SET_POINT, "set-points come faster than time passes")
        if fault is None:
            self._last = (stamp_ns, position)
            self._held = self._blended(stamp_ns, position)
            self._waiting.append((stamp_ns, self._held))
            self.accepted += 1
        return fault

    def target(self, now_ns: int) -> FloatArray | None:
        """What the drives shall follow now, (n,) rad; None where nothing has been played yet."""
        play, waiting = now_ns - round(1e9 * self.delay), self._waiting
        if not waiting or play < waiting[0][0]:
            return None
        while len(waiting) > 1 and waiting[1][0] <= play:
            waiting.popleft()
        at, position = waiting[0]
        if len(waiting) > 1:
            after, following = waiting[1]
            return position + (play - at) / (after - at) * (following - position)
        if self._moving:
            return position + min(1e-9 * (play - at), BRIDGE) * self._velocity
        return position

    def course(self) -> tuple[FloatArray, FloatArray]:
        """Velocity and acceleration of the path where `target` was asked last, (n,) rad/s and rad/s²."""
        waiting = self._waiting
        still = np.zeros(len(self._held))
        if len(waiting) < 2:
            return still, still
        (first, q0), (second, q1) = waiting[0], waiting[1]
        velocity = 1e9 * (q1 - q0) / (second - first)
        if len(waiting) < 3:
            return velocity, still
        third, q2 = waiting[2]
        return velocity, 2e9 * (1e9 * (q2 - q1) / (third - second) - velocity) / (third - first)

    def rests(self, now_ns: int) -> bool:
        """Whether nothing moves from where `target` was asked last to what is meant for now."""
        play, waiting = now_ns - round(1e9 * self.delay), self._waiting
        for k in range(1, len(waiting)):
            if not np.array_equal(waiting[k][1], waiting[0][1]):
                return False
            if waiting[k][0] >= play:
                return True
        return not self._moving

    def starved(self, now_ns: int) -> Fault | None:
        """Whether the stream has ended while the arm should move."""
        last = self._last
        if last is None or not self._moving:
            return None
        missing = 1e-9 * (now_ns - last[0]) - self.delay
        if missing <= BRIDGE:
            return None
        speed = np.abs(self._velocity)
        joint = self.limits.joints[int(speed.argmax())]
        return Fault(
            Rule.STARVATION,
            f"no set-point for {1e3 * (missing + self.delay):.0f} ms while {joint} should move with "
            f"{speed.max():.3g} rad/s",
        )

    def _begin(self, stamp_ns: int, position: FloatArray) -> Fault | None:
        still = np.zeros(len(position))
        held = self._held
        fault = judge_step(self.limits, position, still, still)
        if fault is not None:
            return fault
        offset = held - position
        joint = int(np.abs(offset).argmax())
        if abs(offset[joint]) > START:
            return Fault(
                Rule.SET_POINT,
                f"{self.limits.joints[joint]} is held at {held[joint]:.4g} rad, the first set-point is "
                f"{position[joint]:.4g} rad: start within {START} rad",
            )
        self._offset, self._origin_ns = offset, stamp_ns
        self._velocity, self._step_s, self._moving = still, 0.0, False
        return None

    def _blended(self, stamp_ns: int, position: FloatArray) -> FloatArray:
        share = 1e-9 * (stamp_ns - self._origin_ns) / BLEND
        if share >= 1.0:
            return position
        return position + 0.5 * (1.0 + math.cos(math.pi * share)) * self._offset

    def _proceed(self, stamp_ns: int, position: FloatArray, last: tuple[int, FloatArray]) -> Fault | None:
        step = 1e-9 * (stamp_ns - last[0])
        velocity = (position - last[1]) / step
        # The change of velocity is from the middle of the interval before to the middle of this one.
        acceleration = (velocity - self._velocity) / (0.5 * (step + (self._step_s or step)))
        fault = judge_step(self.limits, position, velocity, acceleration)
        if fault is None:
            self._velocity, self._step_s = velocity, step
            self._moving = bool((np.abs(velocity) > STANDSTILL).any())
        return fault
