"""What the driver tells about itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from spacearm_ident.canbus.bus_load import BusLoad
from spacearm_ident.canbus.cia402 import State, notes_of
from spacearm_ident.driver.safety import Fault


class Phase(Enum):
    """What the driver does; the value is for people."""

    CONNECTING = "connecting"
    DISABLED = "disabled"
    ENABLING = "enabling"
    ENABLED = "enabled"
    FAULT = "stopped by a fault"


@dataclass(frozen=True)
class DriverStatus:
    """A snapshot.

    Attributes:
        phase: What it does.
        fault: Why the arm was stopped, until recovered.
        resumable: Whether a program may begin again after that.
        connection: How it stands with the drives.
        states: CiA 402 state of each joint's drive; None for a pattern CiA 402 does not know.
        cycles: Cycles since the last connection, as for the counts up to `malformed`.
        missed: Slots that passed before they could begin, since the start.
        incomplete: Cycles without the feedback of all joints; their samples are not published.
        late_frames: Feedback after its cycle.
        malformed: Frames that could not be read.
        lateness_s: How late cycles begin: median, 99 %, 99.9 %.
        samples: Samples published, since the start.
        set_points: Set-points received while enabled, since the start.
        buffered_s: Seconds of set-points waiting.
        stalls: Times the cycle was held up in motion and the drives were taken up where they were, since the start.
        lag_s: How far what is played lags behind the clock for that, s.
        reconnections: Times the drives were connected again after a pause before the first enable.
        temperature_failures: SDO reads that failed, since the start.
        loads: Of each bus.
        warnings: What a user should know.
    """

    phase: Phase
    fault: Fault | None
    resumable: bool
    connection: str
    states: Mapping[str, State | None]
    cycles: int
    missed: int
    incomplete: int
    late_frames: int
    malformed: int
    lateness_s: tuple[float, ...]
    samples: int
    set_points: int
    buffered_s: float
    stalls: int
    lag_s: float
    temperature_failures: int
    reconnections: int
    loads: tuple[BusLoad, ...]
    warnings: tuple[str, ...]


def silent_joint(joints: Sequence[str], missing: NDArray[np.int64], stale: int) -> str:
    """Which drive sends no usable feedback; empty if all do.

    Args:
        joints: Names (n).
        missing: (n,) cycles in a row without feedback.
        stale: From how many on that is none.
    """
    worst = int(missing.argmax())
    return "" if missing[worst] < stale else f"{joints[worst]} sends no usable feedback"


def stuck_joint(
    joints: Sequence[str], states: Sequence[State | None], wanted: State, words: Sequence[int] | None = None
) -> str:
    """The first joint whose drive is not in the wanted state, as a clause; empty if all are.

    Args:
        joints: Names of the n joints.
        states: CiA 402 state of each drive, in the same order; None: unknown.
        wanted: State that every drive should be in.
        words: Statusword of each drive, in the same order, for what else it says; None: not known.

    Raises:
        ValueError: `joints` and `states` differ in length.
    """
    for number, (joint, state) in enumerate(zip(joints, states, strict=True)):
        if state is not wanted:
            notes = notes_of(int(words[number])) if words is not None else ""
            return f"{joint} stays in {state.label if state else 'an unknown state'}{notes and f' ({notes})'}"
    return ""
