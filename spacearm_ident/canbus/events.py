"""Events that the cyclic master reports to the safety logic."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class EventKind(Enum):
    """What happened."""

    HEARTBEAT_LOST = "heartbeat lost"
    EMERGENCY = "emergency"
    EMERGENCY_OVER = "emergency over"
    MASTER_MISSED = "a drive has missed the master's heartbeat"
    BUS_ERROR = "bus error"
    STALE_FEEDBACK = "stale feedback"
    BAD_FRAME = "bad frame"
    OTHER_MASTER = "another master"
    LEFT_OPERATION = "left operation"
    RESTARTED = "restarted"


class Event(NamedTuple):
    """Something the caller must know.

    Attributes:
        kind: What happened.
        axis: Number of the axis, −1 where it is a whole bus.
        message: One line for a person.
        stamp_ns: When, nanoseconds since the epoch.
    """

    kind: EventKind
    axis: int
    message: str
    stamp_ns: int
