"""When an event may begin, how long it may last, and how much of it there is at each sample."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Constant, Values
from .effect import Effect, nothing

STARTS_S = tuple(float(t) for t in np.arange(0.0, 600.0, 0.5))
"""When an event may begin; those of them within the recording are looked at."""
LONG_STARTS_S, LENGTHS_S = STARTS_S[::2], (1.5, 3.0, 6.0, 12.0, 24.0)
"""When an object may be picked up or a joint begin to drag, and how long that may last: coarser, for that is longer
than a touch, and every column of every window is kept (objects in ten minutes of six joints at 25 rows a second: 0.12
GB)."""


def shares_within(motion: Motion, start: float, length: float, rise: float) -> tuple[slice, FloatArray]:
    """Which samples an event lasts, and how much of it there is at each: it comes and goes as half a cosine does.

    Args:
        motion: N samples.
        start: Of the event, s.
        length: Of the event, s.
        rise: How long it takes to come, and to go, s; at most half of how long it lasts. Zero: at once.

    Returns:
        The slice of r samples, and (r,) shares of 0..1.
    """
    time = motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
    first, last = np.searchsorted(time, [start, start + length])
    at = slice(int(first), int(last))
    if not rise:
        return at, np.ones(at.stop - at.start)
    come = np.minimum(time[at] - start, start + length - time[at]) / min(rise, 0.5 * length)
    return at, 0.5 - 0.5 * np.cos(np.pi * np.clip(come, 0.0, 1.0))


def long_window(joint: str) -> tuple[Constant, ...]:
    """Constants of what lasts longer than a touch at a joint: when it begins, and how long it lasts."""
    return Constant("start", joint, "s", LONG_STARTS_S, begins=True), Constant("length", joint, "s", LENGTHS_S)


@dataclass(frozen=True)
class LastingEvent(Effect):
    """An event that acts within a window as the next base class, an effect, does throughout."""

    one_cause: ClassVar[bool] = True

    def again(self, arm: Arm) -> Effect:
        """The next event of its kind."""
        return replace(self)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Those of the next base class, zero outside the window and in other recordings.

        Args:
            motion: N samples.
            constants: Start and length, s, as of `long_window`.
            background: As for the next base class.
        """
        always = super().columns(motion, constants, background)  # type: ignore[safe-super]  # of an effect, never Effect
        if self.elsewhere(motion):
            return nothing(motion, list(always), len(self.parameters))
        start, length = constants
        at, shares = shares_within(motion, start, length, rise=0.0)
        passing: Columns = {}
        for row, (indices, columns) in always.items():
            passing[row] = indices, np.zeros_like(columns)
            passing[row][1][at] = shares[:, None] * columns[at]
        return passing
