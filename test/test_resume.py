"""Which stops a program may undo: the driver's decision, as a table and as a latch."""

from __future__ import annotations

import pytest

from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.driver.resume import OF_A_STALL, Latch, Silence, resumable
from spacearm_ident.driver.safety import Fault, Rule
from spacearm_ident.errors import UserError


@pytest.mark.parametrize("rule", Rule)
def test_only_held_up_set_points_or_limits_broken_by_bridging_are_resumable(rule):
    fault = Fault(rule, "why")
    assert resumable(fault, bridging=False) is (rule is Rule.STARVATION)
    assert resumable(fault, bridging=True) is (rule is Rule.STARVATION or rule in OF_A_STALL)


def test_drives_buses_positions_refusals_and_halts_are_never_resumable():
    assert not OF_A_STALL & {Rule.DRIVE, Rule.BUS, Rule.POSITION, Rule.SET_POINT, Rule.HALT}


def test_the_first_fault_stays_and_decides():
    latch = Latch()
    latch.trip(Fault(Rule.TORQUE, "a touch"))
    latch.trip(Fault(Rule.STARVATION, "late"), may_resume=True)
    assert latch.fault == Fault(Rule.TORQUE, "a touch") and not latch.resumable
    with pytest.raises(UserError, match="a touch; no held-up cycle was the cause"):
        latch.require_resumable()


def test_a_halt_outranks_what_stopped_the_arm_before_until_somebody_recovers_it():
    latch = Latch()
    latch.trip(Fault(Rule.STARVATION, "late"), may_resume=True)
    assert latch.resumable and latch.require_resumable().message == "late"
    latch.halt("pressed")
    assert latch.fault is not None and latch.fault.message == "late"
    with pytest.raises(UserError, match="/driver/halt was called"):
        latch.require_resumable()
    latch.release()
    latch.clear()
    assert latch.fault is None
    latch.trip(Fault(Rule.STARVATION, "late again"), may_resume=True)
    assert latch.resumable


def test_a_halt_while_the_arm_recovers_stands_afterwards():
    latch = Latch()
    latch.trip(Fault(Rule.STARVATION, "late"), may_resume=True)
    latch.require_resumable()
    latch.halt("pressed meanwhile")
    latch.clear()
    assert latch.fault is not None and latch.fault.rule is Rule.HALT and not latch.resumable


def test_nothing_is_resumed_where_nothing_was_stopped():
    with pytest.raises(UserError, match="has not stopped the arm"):
        Latch().require_resumable()


MS = 1_000_000
START_NS = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("gap_ms", "after_ms", "kind", "explained"),
    [
        (300, 0, EventKind.MASTER_MISSED, True),
        (300, 900, EventKind.MASTER_MISSED, True),
        (300, 1100, EventKind.MASTER_MISSED, False),
        (150, 0, EventKind.MASTER_MISSED, False),
        (300, 0, EventKind.EMERGENCY, False),
        (300, 0, EventKind.LEFT_OPERATION, False),
        (300, 0, EventKind.HEARTBEAT_LOST, False),
    ],
    ids=[
        "at once",
        "soon",
        "too late for it",
        "too short a silence",
        "another error",
        "left operation",
        "drive silent",
    ],
)
def test_only_a_heartbeat_error_after_a_silence_of_this_driver_is_its_own(gap_ms, after_ms, kind, explained):
    silence = Silence(heartbeat=0.05, timeout=0.25)
    now = START_NS
    for _ in range(50):
        silence.cycle(now)
        now += MS
    now += gap_ms * MS
    silence.cycle(now)
    for _ in range(after_ms):
        now += MS
        silence.cycle(now)
    assert silence.explains(Event(kind, 0, "why", now)) is explained
