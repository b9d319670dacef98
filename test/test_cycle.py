"""The cycle of one drive, frame by frame, and the parts beneath it."""

import math
import struct
import time
from dataclasses import replace

import can
import canopen
import pytest
from four_axes import ARM
from simulated_bus import SCALE

from spacearm_ident.canbus.arm_bus import ArmBus, Axis, interpolation_time, optional_writes, required_writes
from spacearm_ident.canbus.cia402 import State, statusword_of
from spacearm_ident.canbus.cycle import TORN, Cycle
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.canbus.events import EventKind
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.pdo import SdoWrite
from spacearm_ident.canbus.realtime import Pacer
from spacearm_ident.errors import UserError

pytestmark = [pytest.mark.live, pytest.mark.alone, pytest.mark.usefixtures("own_buses")]


@pytest.fixture
def single():
    """A cycle with one axis, and the bare bus of its drive."""
    with LocalBus("one") as ours, LocalBus("one") as theirs:
        arm = ArmBus((Axis(1, SCALE),), answer_time=0.0005)
        yield Cycle(arm, [ours], [canopen.Network(ours)]), theirs


def feedback_frame(position, state=State.SWITCH_ON_DISABLED, **options):
    data = struct.pack("<ihH", position, 0, statusword_of(state))
    return can.Message(arbitration_id=0x181, data=data, is_extended_id=False, **options)


def test_late_feedback_is_counted_and_not_taken_for_new(single):
    cycle, drive = single
    cycle.run()
    assert (cycle.incomplete, cycle.late, cycle.missing[0]) == (1, 0, 1)
    drive.send(feedback_frame(7))
    cycle.run()
    assert (cycle.incomplete, cycle.late, cycle.missing[0]) == (2, 1, 2)
    assert cycle.feedback.counts[0] == 0 and cycle.received[0] == 0


class Withholding:
    """A bus that hides what has arrived until after the SYNC, as a busy sender's socket may."""

    def __init__(self, bus):
        self.bus, self.send = bus, bus.send

    def recv(self, timeout):
        return self.bus.recv(timeout) if timeout else None


def test_feedback_stamped_before_the_sync_is_late_though_it_arrives_after_it(single):
    cycle, drive = single
    cycle.buses[0] = Withholding(cycle.buses[0])
    drive.send(feedback_frame(7))
    cycle.run()
    assert (cycle.late, cycle.incomplete, cycle.received[0], cycle.feedback.counts[0]) == (1, 1, 0, 0)


class Answering:
    """A bus whose drive answers each SYNC at once; the sender may be taken off the processor before it goes on."""

    def __init__(self, bus, drive):
        self.bus, self.drive, self.recv = bus, drive, bus.recv
        self.held_up_s = 0.0

    def send(self, message):
        self.bus.send(message)
        if message.arbitration_id == 0x80:
            self.drive.send(feedback_frame(7))
            time.sleep(self.held_up_s)


def test_feedback_of_a_sync_that_went_out_in_pieces_is_not_used(single):
    """The other buses' drives answer for a moment that is not the sample's: a jerk that never was."""
    cycle, drive = single
    bus = cycle.buses[0] = Answering(cycle.buses[0], drive)
    bus.held_up_s = 2 * TORN * cycle.arm.period
    cycle.run()
    assert (cycle.late, cycle.incomplete, cycle.received[0], cycle.feedback.counts[0]) == (1, 1, 0, 0)
    bus.held_up_s = 0.0
    for _ in range(100):
        cycle.run()
        if cycle.received[0]:
            break
    assert cycle.feedback.counts[0] == 7 and cycle.missing[0] == 0


def test_a_flood_does_not_stop_the_cycle(single):
    cycle, drive = single
    for _ in range(500):
        drive.send(can.Message(arbitration_id=0x123, data=b"x", is_extended_id=False))
    cycle.run()
    assert cycle.cycles == 1 and cycle.incomplete == 1


def test_frames_the_library_cannot_read_are_counted(single):
    cycle, drive = single
    cycle.networks[0].add_node(1, str(eds_path()))
    drive.send(can.Message(arbitration_id=0x081, data=b"\x01", is_extended_id=False))
    drive.send(can.Message(arbitration_id=0x701, data=b"", is_extended_id=False))
    cycle.run()
    assert cycle.malformed == 2


def test_error_frames_are_bus_errors(single):
    cycle, drive = single
    for _ in range(3):
        drive.send(can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, data=bytes(8)))
    cycle.run()
    assert [event.kind for event in cycle.events] == [EventKind.BUS_ERROR]
    assert "bus off" in cycle.events[0].message


def test_writes_for_a_drive_that_turns_the_other_way():
    scale = replace(SCALE, direction=-1, zero_counts=500)
    axis = Axis(3, scale, limits=(-1.0, 2.0), following_error=0.1, quick_stop_deceleration=10.0)
    arm = replace(ARM, axes=(axis,))
    writes = {(w.index, w.sub): w.value for w in optional_writes(axis, arm)}
    per_rad = SCALE.counts_per_turn * SCALE.gear_ratio / (2 * math.pi)
    assert writes[0x607D, 1] == pytest.approx(500 - 2 * per_rad, abs=1)
    assert writes[0x607D, 2] == pytest.approx(500 + per_rad, abs=1)
    assert writes[0x6065, 0] == pytest.approx(0.1 * per_rad, abs=1)
    assert writes[0x6085, 0] == pytest.approx(10 * per_rad, abs=1)
    assert writes[0x1006, 0] == 4000
    needed = required_writes(axis, arm)
    assert SdoWrite(0x1016, 1, 127 << 16 | 150, 4) in needed and SdoWrite(0x60C2, 1, 4, 1) in needed


@pytest.mark.parametrize(
    "period, expected", [(0.001, (1, -3)), (0.004, (4, -3)), (0.0005, (5, -4)), (0.00125, (125, -5))]
)
def test_interpolation_time(period, expected):
    assert interpolation_time(period) == expected


def test_a_period_a_drive_cannot_be_told():
    with pytest.raises(UserError, match="whole milliseconds"):
        interpolation_time(0.001 / 3)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"axes": ()}, "at least one axis"),
        ({"axes": (Axis(1, SCALE), Axis(1, SCALE))}, "its own node"),
        ({"axes": (Axis(127, SCALE),)}, "cannot be a drive"),
        ({"mode": 9}, "mode of operation 9"),
        ({"answer_time": 1.0}, "answer_time"),
        ({"extrapolation": -0.1}, "extrapolation_s is -0.1"),
        ({"extrapolation": math.nan}, "extrapolation_s is nan"),
    ],
)
def test_impossible_arms(change, message):
    with pytest.raises(UserError, match=message):
        replace(ARM, **change)


def test_the_pacer_skips_what_is_over_and_counts_it():
    pacer = Pacer(0.01)
    pacer.wait()
    time.sleep(0.055)
    pacer.wait()
    assert pacer.slots == 2 and pacer.missed >= 4
    before = pacer.missed
    assert pacer.wait() >= 0.0
    assert pacer.slots == 3 and pacer.missed - before < 4
    assert 0.0 <= pacer.lateness(0.5) <= pacer.lateness(1.0)
