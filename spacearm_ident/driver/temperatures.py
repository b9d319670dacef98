"""Winding temperatures, asked for by SDO beside the cycle, one drive after the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

#: Called with joint number, °C and time (ns since the epoch).
OnTemperature = Callable[[int, float, int], None]


class TemperatureReader:
    """Asks until it is told to end.

    Args:
        joints: How many there are.
        rate_hz: Readings a joint and second.
        read: The temperature of a joint's drive, °C; None where it cannot be asked now. May raise anything.
        take: Takes what was read.

    Attributes:
        failures: Readings that failed: a slow answer, or none where a drive has no such object.
    """

    def __init__(self, joints: int, rate_hz: float, read: Callable[[int], float | None], take: OnTemperature) -> None:
        self.failures = 0
        self._joints, self._rate_hz, self._read, self._take = joints, rate_hz, read, take

    def work(self, ending: threading.Event) -> None:
        """Ask until `ending` is set."""
        number = 0
        while not ending.wait(1.0 / (self._rate_hz * self._joints)):
            number = (number + 1) % self._joints
            try:
                value = self._read(number)
                if value is not None:
                    self._take(number, value, time.time_ns())
            except Exception:
                self.failures += 1
