"""The master over the real bus: booting, the cycle, and everything that goes wrong in it."""

import math
import struct
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import can
import numpy as np
import pytest
from four_axes import ARM
from live_nodes import LIVE
from simulated_bus import SCALE, simulated_drives

from spacearm_ident.canbus.arm_bus import ArmBus, Axis
from spacearm_ident.canbus.cia402 import Goal, State
from spacearm_ident.canbus.events import EventKind
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.master import DriveMaster
from spacearm_ident.canbus.pdo import SLIM_FEEDBACK, SLIM_SET_POINT
from spacearm_ident.canbus.realtime import Pacer
from spacearm_ident.errors import UserError

FREEZE, EMERGENCY, CORRUPT = 1, 2, 3
pytestmark = [*LIVE, pytest.mark.usefixtures("own_buses")]


@pytest.fixture
def drives():
    with simulated_drives(("a", "b")) as process:
        yield process


class Running:
    """A booted master with a cycle that a test runs by condition."""

    def __init__(self, arm):
        self.arm = arm
        self.master = DriveMaster(arm, [LocalBus(name) for name in ("a", "b")[: arm.buses]])
        self.events = []

    def boot(self):
        self.master.boot()
        self.cycle = self.master.cycle()
        self.pacer = Pacer(self.arm.period)
        return self

    def run(self, cycles=1, target=None):
        for _ in range(cycles):
            self.pacer.wait()
            self.cycle.run(target)
            while self.cycle.events:
                self.events.append(self.cycle.events.popleft())

    def until(self, condition, target=None):
        for _ in range(round(5.0 / self.arm.period)):
            if condition():
                return
            self.run(1, target)
        raise AssertionError(f"waited in vain; states {self.cycle.states}, events {self.events}")

    def enable(self):
        self.cycle.goal = Goal.ENABLED
        self.until(lambda: self.cycle.enabled)

    def seen(self, kind, axis=None):
        return [event for event in self.events if event.kind is kind and axis in (None, event.axis)]

    def inject(self, axis, sub, value):
        """Write the drive's fault object as a third participant would, without waiting for the answer."""
        with LocalBus("ab"[self.arm.axes[axis].bus]) as other:
            node = self.arm.axes[axis].node_id
            size = 1 if sub == CORRUPT else 2
            data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, 0x2F00, sub, value)
            other.send(can.Message(arbitration_id=0x600 + node, data=data, is_extended_id=False))
            self.run(3)


@contextmanager
def running(arm=ARM):
    run = Running(arm)
    try:
        yield run.boot()
    finally:
        run.master.close()


@pytest.fixture
def run(drives):
    with running() as run:
        yield run


# The good days --------------------------------------------------------------------------------------


def test_enabling_does_not_move_and_set_points_do(run):
    assert run.master.warnings == []
    run.enable()
    run.run(10)
    assert np.all(run.cycle.feedback.position == 0.0)
    target = np.array([0.02, -0.03, 0.04, -0.05])
    run.until(lambda: np.abs(run.cycle.feedback.position - target).max() <= abs(SCALE.rad_per_count), target)
    assert run.events == []
    run.cycle.goal = Goal.DISABLED
    run.until(lambda: run.cycle.states == [State.SWITCH_ON_DISABLED] * 4)
    run.enable()
    run.run(10)
    assert np.abs(run.cycle.feedback.position - target).max() <= abs(SCALE.rad_per_count)


def test_every_feedback_is_counted_once(run):
    run.run(200)
    cycle = run.cycle
    assert cycle.cycles == 200
    missed = 200 - cycle.received
    assert missed.min() >= 0 and cycle.received.min() > 0
    assert missed.max() <= cycle.incomplete <= missed.sum()
    assert cycle.late <= missed.sum() and cycle.malformed == 0


def test_feedback_belongs_to_its_sync(run):
    run.enable()
    for k in range(100):
        run.run(1, np.full(4, 0.002 * math.sin(0.1 * k)))
        fresh = run.cycle.missing == 0
        delay = run.cycle.stamp - 1e-9 * run.cycle.sync_ns
        assert np.all(delay[fresh] >= -1e-6) and np.all(delay[fresh] <= ARM.answer_time)


def test_slim_frames_carry_the_same(drives):
    arm = replace(ARM, feedback=SLIM_FEEDBACK, set_point=SLIM_SET_POINT, set_point_divider=2)
    with running(arm) as run:
        run.enable()
        target = np.full(4, 0.01)
        run.until(lambda: np.abs(run.cycle.feedback.position - target).max() < 1e-6, target)
        run.cycle.quick_stop()
        run.until(lambda: run.cycle.states == [State.QUICK_STOP_ACTIVE] * 4)


def test_interpolated_position_mode(drives):
    with running(replace(ARM, mode=7)) as run:
        run.enable()
        target = np.full(4, 0.01)
        run.until(lambda: np.abs(run.cycle.feedback.position - target).max() < 1e-6, target)


def test_sdo_works_beside_the_cycle(run):
    found = []
    asker = threading.Thread(target=lambda: found.extend(run.master.temperature(k) for k in range(4)))
    asker.start()
    run.until(lambda: not asker.is_alive())
    assert found == pytest.approx([20.0, 21.0, 22.0, 23.0])
    assert run.cycle.malformed == 0


def test_after_closing_another_master_can_take_over(drives):
    with running() as run:
        run.enable()
    with running() as run:
        run.run(20)
        assert run.cycle.states == [State.SWITCH_ON_DISABLED] * 4
        assert run.events == []
        run.enable()


# Stopping -------------------------------------------------------------------------------------------


def test_a_quick_stop_takes_effect_with_the_next_sync(run):
    run.enable()
    for k in range(30):
        run.run(1, np.full(4, 0.001 * k))
    assert np.all(run.cycle.feedback.position > 0.0)
    run.cycle.quick_stop()
    # The SYNC of the next cycle puts it in force, the one after reports it.
    run.run(2)
    fresh = run.cycle.missing == 0
    states = [state for state, good in zip(run.cycle.states, fresh) if good]
    assert states and set(states) == {State.QUICK_STOP_ACTIVE}
    assert run.events == []
    run.until(lambda: run.cycle.states == [State.QUICK_STOP_ACTIVE] * 4)
    run.run(40)
    still = run.cycle.feedback.position.copy()
    run.run(20, np.full(4, 1.0))
    assert np.all(run.cycle.feedback.position == still)
    run.enable()
    run.run(10)
    assert np.all(run.cycle.feedback.position == still)


def test_the_drives_stop_when_the_cycle_does(run):
    run.enable()
    for k in range(10):
        run.run(1, np.full(4, 0.001 * k))
    time.sleep(0.3)
    run.run(5)
    assert run.cycle.states == [State.QUICK_STOP_ACTIVE] * 4
    assert {event.axis for event in run.seen(EventKind.LEFT_OPERATION)} == {0, 1, 2, 3}
    assert {event.axis for event in run.seen(EventKind.MASTER_MISSED)} == {0, 1, 2, 3}
    run.run(20)
    assert run.cycle.states == [State.QUICK_STOP_ACTIVE] * 4, "nothing may be enabled again by itself"


def test_a_target_that_is_asked_for_is_that_of_the_sync_that_has_gone_out(run):
    run.enable()
    asked = []

    def target(sync_ns):
        asked.append((sync_ns, run.cycle.sync_ns, time.time_ns()))
        return np.full(4, 0.001 * len(asked))

    for _ in range(5):
        run.cycle.run(target)
    assert len(asked) == 5 and all(given == sync <= now for given, sync, now in asked)
    np.testing.assert_allclose(run.cycle.set_points.position(), 0.005, atol=1e-6)
    run.cycle.run(lambda _: None)
    np.testing.assert_allclose(run.cycle.set_points.position(), 0.005, atol=1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_an_impossible_target_is_refused_before_anything_is_sent(run, bad):
    run.enable()
    cycles = run.cycle.cycles
    with pytest.raises(ValueError, match="not finite"):
        run.cycle.run(np.array([0.0, bad, 0.0, 0.0]))
    assert run.cycle.cycles == cycles
    run.run(5)
    assert np.all(run.cycle.feedback.position == 0.0)


# Faults ---------------------------------------------------------------------------------------------


def test_an_emergency_and_the_explicit_way_out(run):
    run.enable()
    run.inject(2, EMERGENCY, 0x4310)
    run.until(lambda: run.seen(EventKind.EMERGENCY, 2) and run.seen(EventKind.LEFT_OPERATION, 2))
    assert "node 3" in run.seen(EventKind.EMERGENCY)[0].message
    assert "0x4310" in run.seen(EventKind.EMERGENCY)[0].message
    run.run(20)
    assert run.cycle.states[2] is State.FAULT, "a fault must not be left without request"
    assert run.cycle.goal is Goal.QUICK_STOP and run.cycle.states[0] is State.QUICK_STOP_ACTIVE
    run.cycle.goal = Goal.RESET
    run.until(lambda: run.cycle.states[2] is State.SWITCH_ON_DISABLED)
    run.until(lambda: run.seen(EventKind.EMERGENCY_OVER, 2))
    run.run(20)
    assert State.OPERATION_ENABLED not in run.cycle.states
    run.enable()


def test_a_frozen_drive_is_stale_then_lost_and_the_others_go_on(run):
    run.enable()
    run.inject(1, FREEZE, 0xFFFF)
    run.until(lambda: run.seen(EventKind.STALE_FEEDBACK, 1))
    run.until(lambda: run.seen(EventKind.HEARTBEAT_LOST, 1))
    before = run.cycle.received.copy()
    run.run(20)
    gained = run.cycle.received - before
    assert gained[1] == 0 and min(gained[0], gained[2], gained[3]) > 0
    assert len(run.seen(EventKind.STALE_FEEDBACK, 1)) == 1
    assert run.cycle.missing[1] >= 20 and math.isnan(run.cycle.answer_s)


def test_feedback_of_a_wrong_length_is_reported_once_and_not_used(run):
    run.enable()
    run.run(5, np.full(4, 0.01))
    run.inject(0, CORRUPT, 1)
    run.until(lambda: run.seen(EventKind.BAD_FRAME, 0))
    before = run.cycle.feedback.position[0]
    run.until(lambda: run.cycle.malformed >= 20 and run.seen(EventKind.STALE_FEEDBACK, 0), np.full(4, 0.02))
    assert run.cycle.feedback.position[0] == before
    assert len(run.seen(EventKind.BAD_FRAME, 0)) == 1


def test_nonsense_feedback_shows_in_the_state(run):
    run.enable()
    run.inject(0, CORRUPT, 2)
    run.until(lambda: run.seen(EventKind.LEFT_OPERATION, 0))


def test_drives_that_die_are_a_bus_error_and_nothing_hangs(run, drives):
    run.enable()
    drives.kill()
    drives.join()
    run.until(lambda: len(run.seen(EventKind.BUS_ERROR)) == 2)
    run.run(20)
    assert len(run.seen(EventKind.BUS_ERROR)) == 2, "one report a bus, not one a cycle"
    assert run.seen(EventKind.STALE_FEEDBACK)
    run.cycle.quick_stop()


def test_a_drive_that_restarts_is_reported(run):
    run.enable()
    with LocalBus("a") as other:
        other.send(can.Message(arbitration_id=0, data=b"\x81\x01", is_extended_id=False))
        run.until(lambda: run.seen(EventKind.RESTARTED, 0))
    run.until(lambda: run.seen(EventKind.STALE_FEEDBACK, 0))


def test_a_second_master_is_refused_and_a_stray_one_reported(run):
    stop = threading.Event()

    def keep_running():
        while not stop.is_set():
            run.run(1)

    thread = threading.Thread(target=keep_running)
    thread.start()
    second = DriveMaster(ARM, [LocalBus("a"), LocalBus("b")])
    try:
        with pytest.raises(UserError, match="another master is active on local bus 'a'"):
            second.boot()
    finally:
        stop.set()
        thread.join()
        for bus in second.buses:
            bus.shutdown()
    run.events.clear()
    with LocalBus("b") as other:
        other.send(can.Message(arbitration_id=0x80, data=b"", is_extended_id=False))
        run.until(lambda: run.seen(EventKind.OTHER_MASTER))


# Booting --------------------------------------------------------------------------------------------


def test_a_missing_drive_is_named(drives):
    arm = replace(ARM, axes=(*ARM.axes, Axis(9, SCALE, bus=1)))
    master = DriveMaster(arm, [LocalBus("a"), LocalBus("b")])
    with master, pytest.raises(UserError, match="no boot-up message of node 9 on local bus 'b': check power"):
        master.boot(timeout=0.3)


def test_an_empty_bus_is_said_at_once():
    master = DriveMaster(ARM, [LocalBus("a"), LocalBus("b")])
    with master, pytest.raises(UserError, match="cannot send on local bus 'a'"):
        master.boot(listen=0.0)


def test_rated_values_that_differ_are_a_warning(drives):
    scale = replace(SCALE, rated=7.0)
    with running(replace(ARM, axes=(replace(ARM.axes[0], scale=scale), *ARM.axes[1:]))) as run:
        assert len(run.master.warnings) == 1
        assert "node 1 states a rated value of 5 A" in run.master.warnings[0]


def test_a_rated_value_in_micro_units_is_told_and_no_warning(drives):
    scale = replace(SCALE, rated=0.005)
    with running(replace(ARM, axes=(replace(ARM.axes[0], scale=scale), *ARM.axes[1:]))) as run:
        assert run.master.warnings == []
        (note,) = run.master.notes
        assert "node 1 states 0x6075 in µA" in note and "0.005 A, as configured" in note


def test_a_temperature_is_asked_for_where_the_configuration_names_it_until_the_drive_has_none(drives):
    axes = (
        replace(ARM.axes[0], temperature_object=None),
        replace(ARM.axes[1], temperature_object=0x2345),
        *ARM.axes[2:],
    )
    with running(replace(ARM, axes=axes)) as run:
        found = []
        asker = threading.Thread(target=lambda: found.extend(run.master.temperature(k) for k in (0, 1, 1, 2)))
        asker.start()
        run.until(lambda: not asker.is_alive())
        assert found[:3] == [None, None, None] and found[3] == pytest.approx(22.0)
        (warning,) = run.master.warnings
        assert "node 2 has no object 0x2345" in warning and "temperature_object" in warning


def test_an_overloaded_bus_is_refused_before_anything_is_sent():
    arm = ArmBus(tuple(Axis(1 + k, SCALE) for k in range(6)))
    with LocalBus("a") as bus, pytest.raises(UserError, match="2 buses of 3 axes"):
        DriveMaster(arm, [bus])


def test_the_number_of_buses_must_fit():
    with LocalBus("a") as bus, pytest.raises(UserError, match="on 2 buses, 1 were given"):
        DriveMaster(ARM, [bus])
