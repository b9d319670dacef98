"""What a test can make a simulated drive do wrong, through the manufacturer object 0x2F00.

By SDO, any participant of the bus can freeze a drive, make it report a fault, spoil its feedback or take its
power, without a channel beside the bus.
"""

from __future__ import annotations

import random
from typing import Final

from spacearm_ident.simulation.drives.dictionary import DriveDictionary, key

FREEZE: Final = key(0x2F00, 1)
EMERGENCY: Final = key(0x2F00, 2)
CORRUPT: Final = key(0x2F00, 3)
LOSE_POWER: Final = key(0x2F00, 4)
FOR_GOOD: Final = 0xFFFF

SHORT, RANDOM, MISSING, JUMP = 1, 2, 3, 4
JUMP_COUNTS: Final = 1_000_000
"""How far a jumping encoder is off; the first object of the TPDO is taken for a position of 32 bits."""


class FaultInjection:
    """The injected faults of one drive.

    Attributes:
        silent: It neither hears nor speaks (frozen, or without power).
        powerless: It has lost its power: the motor has no current.
        corrupting: Its TPDOs are spoilt.
    """

    def __init__(self, dictionary: DriveDictionary) -> None:
        self._values = dictionary.values
        self._random = random.Random(1)
        self._frozen_until: float | None = None
        self._now = 0.0
        self.silent = False
        self.powerless = False
        self.corrupting = False

    def take(self) -> int:
        """Carry out what has been written, after the answer to the write; an EMCY code to report, else 0."""
        values = self._values
        self.corrupting = values[CORRUPT] in (SHORT, RANDOM, MISSING, JUMP)
        if milliseconds := values[FREEZE]:
            values[FREEZE] = 0
            self.silent = True
            self._frozen_until = None if milliseconds == FOR_GOOD else self._now + 1e-3 * milliseconds
        if values[LOSE_POWER]:
            self.silent = self.powerless = True
        code, values[EMERGENCY] = values[EMERGENCY], 0
        return code

    def keep_time(self, now: float) -> None:
        """Thaw when the time has come; `now` in seconds."""
        self._now = now
        if self._frozen_until is not None and now >= self._frozen_until:
            self._frozen_until = None
            self.silent = self.powerless

    def corrupt(self, payload: bytes) -> bytes | None:
        """The payload as the spoilt drive sends it; None: not at all."""
        mode = self._values[CORRUPT]
        if mode == SHORT:
            return payload[:-1]
        if mode == RANDOM:
            return self._random.randbytes(len(payload))
        if mode == JUMP and len(payload) >= 4:
            position = int.from_bytes(payload[:4], "little") + JUMP_COUNTS & 0xFFFFFFFF
            return position.to_bytes(4, "little") + payload[4:]
        return None
