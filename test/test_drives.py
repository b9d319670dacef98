"""The simulated drives under a master that is not ours: the plain `canopen` library, over the real bus."""

import struct
import time

import canopen
import numpy as np
import pytest
from canopen.profiles.p402 import BaseNode402
from drive_client import Stream, command, enable, reset, state, until
from simulated_bus import SCALE, simulated_drives

from spacearm_ident.canbus.cia402 import State, state_of
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.canbus.local_bus import LocalBus

EDS = str(eds_path())
TURN = SCALE.counts_per_turn * SCALE.gear_ratio
pytestmark = [pytest.mark.live, pytest.mark.alone]


@pytest.fixture
def master(own_buses):
    """A `canopen.Network` with two drives, freshly reset."""
    with simulated_drives():
        network = canopen.Network(LocalBus("t"))
        network.NOTIFIER_CYCLE = 0.01
        network.connect()
        for node_id in (1, 2):
            network.add_node(node_id, EDS)
        reset(network, network.nmt, (1, 2))
        try:
            yield network
        finally:
            network.disconnect()


@pytest.fixture
def drive(master):
    return master[1]


# CiA 301 ---------------------------------------------------------------------------------------------


def test_boot_up_and_nmt(master, drive):
    drive.sdo[0x1017].raw = 10
    for wanted in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        drive.nmt.state = wanted
        until(lambda: drive.nmt.wait_for_heartbeat(1) == wanted)  # noqa: B023
    reset(master, drive.nmt, [1], "RESET COMMUNICATION")
    assert drive.sdo[0x1017].raw == 0
    assert sorted(master.scanner.nodes) == [1, 2]


def test_a_stopped_node_answers_nothing_but_nmt(drive):
    drive.sdo.RESPONSE_TIMEOUT = 0.05
    drive.nmt.state = "STOPPED"
    with pytest.raises(canopen.SdoCommunicationError):
        _ = drive.sdo[0x1000].raw
    drive.nmt.state = "PRE-OPERATIONAL"
    assert drive.sdo[0x1000].raw == 0x00020192


def test_sdo(drive):
    assert drive.sdo[0x1008].raw == "spacearm simulated drive"
    assert drive.sdo[0x1018][4].raw == 1
    assert (drive.sdo[0x6075].raw, drive.sdo[0x6076].raw) == (5000, 500)
    assert drive.sdo[0x2000].raw == 200
    drive.sdo[0x607D][1].raw = -123456
    assert drive.sdo[0x607D][1].raw == -123456


@pytest.mark.parametrize(
    "index, sub, data, code",
    [
        (0x6041, 0, b"\0\0", 0x06010002),
        (0x5555, 0, b"\0", 0x06020000),
        (0x607D, 9, b"\0\0\0\0", 0x06090011),
        (0x6085, 0, b"\0\0", 0x06070010),
        (0x605A, 0, b"\x63\0", 0x06090030),
        (0x1A00, 0, b"\x01", 0x08000022),
        (0x1A00, 1, b"\0\0\0\0", 0x08000022),
    ],
)
def test_refused_writes_have_the_standards_abort_codes(drive, index, sub, data, code):
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        drive.sdo.download(index, sub, data)
    assert refusal.value.code == code


@pytest.mark.parametrize(
    "words, code",
    [
        ([0x60850020], 0x06040041),
        ([0x60640010], 0x06040041),
        ([0x55550020], 0x06040041),
        ([0x60640020, 0x606C0020, 0x60410010], 0x06040042),
    ],
)
def test_impossible_mappings_are_refused(drive, words, code):
    drive.sdo[0x1800][1].raw = 0x80000181
    drive.sdo[0x1A00][0].raw = 0
    for sub, word in enumerate(words, start=1):
        drive.sdo[0x1A00][sub].raw = word
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        drive.sdo[0x1A00][0].raw = len(words)
    assert refusal.value.code == code


def test_the_mapping_the_master_wrote_governs_the_frames(master, drive):
    stream = Stream(master, drive)
    position, torque, status = stream.last()
    assert (position, torque) == (0, 0) and state_of(status) is State.SWITCH_ON_DISABLED
    drive.nmt.state = "PRE-OPERATIONAL"
    tpdo = drive.tpdo[1]
    tpdo.clear()
    for index in (0x6041, 0x2000, 0x6061):
        tpdo.add_variable(index)
    tpdo.save()
    drive.nmt.state = "OPERATIONAL"
    until(lambda: len(stream.frames[-1][1]) == 5)
    status, temperature, mode = struct.unpack("<Hhb", stream.frames[-1][1])
    assert (state_of(status), temperature, mode) == (State.SWITCH_ON_DISABLED, 200, 8)


def test_feedback_comes_once_a_sync_or_every_third(master, drive):
    stream = Stream(master, drive)
    master.sync.stop()
    for divider in (1, 3):
        drive.sdo[0x1800][2].raw = divider
        before = len(stream.frames)
        for _ in range(9):
            # Apart, for a drive does not answer a SYNC that has waited for most of a cycle.
            time.sleep(0.02)
            master.send_message(0x80, b"")
        until(lambda: len(stream.frames) == before + 9 // divider)  # noqa: B023
        drive.sdo.upload(0x1000, 0)
        assert len(stream.frames) == before + 9 // divider


def test_an_event_driven_pdo_comes_when_the_status_changes(master, drive):
    drive.sdo[0x1800][1].raw = 0x80000181
    drive.sdo[0x1800][2].raw = 255
    drive.sdo[0x1800][1].raw = 0x181
    seen = []
    master.subscribe(0x181, lambda _, data, __: seen.append(state_of(struct.unpack_from("<H", data)[0])))
    drive.nmt.state = "OPERATIONAL"
    enable(drive)
    until(lambda: len(seen) >= 4)
    assert seen == [
        State.SWITCH_ON_DISABLED,
        State.READY_TO_SWITCH_ON,
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
    ]


def test_a_short_set_point_frame_is_an_emergency_and_is_not_used(master, drive):
    stream = Stream(master, drive)
    enable(drive)
    master.send_message(0x201, b"\x10\x00\x00")
    until(lambda: [entry.code for entry in drive.emcy.log] == [0x8210])
    assert stream.last()[0] == 0


# CiA 402 ---------------------------------------------------------------------------------------------


def test_the_librarys_own_402_profile_can_drive_it(master):
    node = BaseNode402(2, EDS)
    master[2] = node
    node.nmt.state = "PRE-OPERATIONAL"
    # To the library a synchronous RPDO is one it repeats by itself; 255 makes it send at once.
    for pdo, kind, indices in (
        (node.tpdo[1], 1, (0x6041, 0x6061, 0x6064)),
        (node.rpdo[1], 255, (0x6040, 0x6060, 0x607A)),
    ):
        pdo.read()
        pdo.clear()
        for index in indices:
            pdo.add_variable(index)
        pdo.trans_type, pdo.enabled = kind, True
        pdo.save()
    node.setup_402_state_machine()
    node.rpdo[1]["Modes of operation"].raw = 8
    master.sync.start(0.005)
    node.nmt.state = "OPERATIONAL"
    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    node.state = "OPERATION ENABLED"
    assert node.state == "OPERATION ENABLED"
    node.rpdo[1]["Target position"].raw = 5000
    node.rpdo[1].transmit()
    until(lambda: abs(node.tpdo[1]["Position actual value"].raw - 5000) <= 1)
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


def test_enabling_does_not_move_and_set_points_do(master, drive):
    stream = Stream(master, drive)
    drive.sdo[0x607A].raw = 70000
    enable(drive)
    assert stream.last()[0] == 0
    stream.send(20000)
    until(lambda: abs(stream.last()[0] - 20000) <= 1)
    _, _, status = stream.last()
    assert status & 0x1000 and state_of(status) is State.OPERATION_ENABLED
    assert master[2].sdo[0x6064].raw == 0


def test_set_points_are_interpolated_over_the_stated_period(master, drive):
    stream = Stream(master, drive, period=0.002)
    drive.sdo[0x60C2][1].raw = 200
    enable(drive)
    stream.send(100_000)
    until(lambda: abs(stream.last()[0] - 100_000) <= 1)
    points = np.array([(stamp, struct.unpack_from("<i", data)[0]) for stamp, data in stream.frames])
    moving = points[(points[:, 1] > 30_000) & (points[:, 1] < 90_000)]
    slope = np.polyfit(moving[:, 0], moving[:, 1], 1)[0]
    assert slope == pytest.approx(100_000 / 0.2, rel=0.1)


def test_interpolated_position_needs_its_bit(master, drive):
    drive.sdo[0x6060].raw = 7
    enable(drive)
    drive.sdo[0x60C1][1].raw = 1000
    time.sleep(0.03)
    assert drive.sdo[0x6064].raw == 0 and not drive.sdo[0x6041].raw & 0x1000
    command(drive, 0x1F)
    drive.sdo[0x60C1][1].raw = 1000
    until(lambda: drive.sdo[0x6064].raw == 1000)
    assert drive.sdo[0x6041].raw & 0x1000


def test_targets_stay_within_the_software_limits(drive):
    drive.sdo[0x607D][1].raw, drive.sdo[0x607D][2].raw = -500, 700
    enable(drive)
    drive.sdo[0x607A].raw = 10_000
    until(lambda: drive.sdo[0x6064].raw == 700)
    drive.sdo[0x607A].raw = -10_000
    until(lambda: drive.sdo[0x6064].raw == -500)


@pytest.mark.parametrize(
    "option, final",
    [(0, State.SWITCH_ON_DISABLED), (2, State.SWITCH_ON_DISABLED), (6, State.QUICK_STOP_ACTIVE)],
)
def test_quick_stop_ramps_down_and_ends_as_the_option_says(master, drive, option, final):
    stream = Stream(master, drive, period=0.005)
    drive.sdo[0x605A].raw = option
    drive.sdo[0x6085].raw = 1_000_000
    drive.sdo[0x60C2][1].raw = 250
    enable(drive)
    stream.send(50_000)
    until(lambda: stream.last()[0] > 10_000)
    command(drive, 0x02)
    until(lambda: drive.sdo[0x606C].raw == 0 and state(drive) is final)
    stopped = drive.sdo[0x6064].raw
    # 200 000 counts/s take 20 000 counts to stop at 1 000 000 counts/s².
    assert stopped < 50_000
    if option:
        position = next(p for p in (struct.unpack("<ihH", f)[0] for _, f in stream.frames) if p > 10_000)
        assert stopped - position > 15_000
    stream.send(200_000, 0x02)
    time.sleep(0.03)
    assert drive.sdo[0x6064].raw == stopped


def test_a_lost_heartbeat_of_the_master_stops_the_drive(master, drive):
    stream = Stream(master, drive)
    drive.sdo[0x1016][1].raw = 127 << 16 | 60
    enable(drive)
    time.sleep(0.1)
    assert state(drive) is State.OPERATION_ENABLED, "monitoring must begin with the first heartbeat"
    beat = master.send_periodic(0x700 + 127, b"\x05", 0.01)
    time.sleep(0.15)
    assert state(drive) is State.OPERATION_ENABLED
    beat.stop()
    until(lambda: state(drive) is State.QUICK_STOP_ACTIVE)
    assert [entry.code for entry in drive.emcy.log] == [0x8130]
    # The master wakes up and goes on as before: nothing may move.
    for target in range(0, 50_000, 10_000):
        stream.send(target)
    time.sleep(0.03)
    assert stream.last()[0] == 0 and state(drive) is State.QUICK_STOP_ACTIVE
    command(drive, 0x00)
    enable(drive)


def test_out_of_a_quick_stop_nothing_moves_before_a_new_set_point(master, drive):
    stream = Stream(master, drive)
    drive.sdo[0x60C2][1].raw = 250
    enable(drive)
    stream.send(50_000)
    until(lambda: stream.last()[0] > 10_000)
    command(drive, 0x02)
    until(lambda: drive.sdo[0x606C].raw == 0)
    stopped = drive.sdo[0x6064].raw
    command(drive, 0x0F)
    assert state(drive) is State.OPERATION_ENABLED
    time.sleep(0.03)
    assert drive.sdo[0x6064].raw == stopped == drive.sdo[0x6062].raw
    drive.sdo[0x607A].raw = stopped + 100
    until(lambda: drive.sdo[0x6064].raw == stopped + 100)


@pytest.mark.parametrize(
    "option, final", [(0, State.OPERATION_ENABLED), (1, State.FAULT), (2, State.SWITCH_ON_DISABLED)]
)
def test_abort_connection_options(master, drive, option, final):
    drive.sdo[0x6007].raw = option
    drive.sdo[0x1016][1].raw = 127 << 16 | 20
    enable(drive)
    master.send_message(0x700 + 127, b"\x05")
    until(lambda: drive.emcy.log and state(drive) is final)


def test_leaving_operational_stops_an_enabled_drive(master, drive):
    Stream(master, drive)
    enable(drive)
    drive.nmt.state = "PRE-OPERATIONAL"
    until(lambda: state(drive) is State.QUICK_STOP_ACTIVE)


def test_a_reset_takes_the_power_off(master, drive):
    enable(drive)
    reset(master, drive.nmt, [1])
    assert state(drive) is State.SWITCH_ON_DISABLED


def test_a_fault_is_reported_and_left_only_by_an_explicit_reset(drive):
    enable(drive)
    drive.sdo[0x2F00][2].raw = 0x4310
    until(lambda: drive.emcy.active)
    assert drive.emcy.active[0].code == 0x4310
    until(lambda: state(drive) is State.FAULT)
    assert drive.sdo[0x603F].raw == 0x4310 and drive.sdo[0x1001].raw & 1
    command(drive, 0x00, 0x06, 0x07, 0x0F)
    assert state(drive) is State.FAULT
    command(drive, 0x80)
    assert state(drive) is State.SWITCH_ON_DISABLED
    until(lambda: not drive.emcy.active)
    assert (drive.sdo[0x603F].raw, drive.sdo[0x1001].raw) == (0, 0)


def test_a_following_error_is_a_fault(drive):
    drive.sdo[0x6065].raw = 5000
    drive.sdo[0x6066].raw = 5
    enable(drive)
    drive.sdo[0x607A].raw = 4000
    until(lambda: drive.sdo[0x6064].raw == 4000)
    assert state(drive) is State.OPERATION_ENABLED
    drive.sdo[0x607A].raw = 500_000
    until(lambda: state(drive) is State.FAULT)
    assert drive.emcy.log[-1].code == 0x8611


# Injected faults -------------------------------------------------------------------------------------


def test_a_frozen_drive_is_silent_until_it_thaws(master, drive):
    stream = Stream(master, drive)
    drive.sdo[0x2F00][1].raw = 100
    count = len(stream.frames)
    time.sleep(0.05)
    assert len(stream.frames) <= count + 1
    until(lambda: len(stream.frames) > count + 5)


@pytest.mark.parametrize("mode, sizes", [(1, {7}), (2, {8}), (3, set()), (4, {8})])
def test_corrupted_feedback(master, drive, mode, sizes):
    stream = Stream(master, drive)
    clean = stream.frames[0][1] if stream.frames else struct.pack("<ihH", *stream.last())
    drive.sdo[0x2F00][3].raw = mode
    stream.frames.clear()
    time.sleep(0.05)
    spoilt = list(stream.frames)[1:]
    assert {len(data) for _, data in spoilt} == sizes
    assert all(data != clean for _, data in spoilt)


def test_a_drive_that_lost_its_power_never_answers_again(master, drive):
    enable(drive)
    drive.sdo[0x2F00][4].raw = 1
    drive.sdo.RESPONSE_TIMEOUT = 0.05
    drive.nmt.state = "RESET"
    with pytest.raises(canopen.SdoCommunicationError):
        _ = drive.sdo[0x1000].raw
    assert master[2].sdo[0x1000].raw == 0x00020192
