"""PDO payloads byte by byte, and scaling against hand calculation."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spacearm_ident.canbus.pdo import (
    CURRENT,
    FEEDBACK,
    POSITION,
    SET_POINT,
    TARGET,
    TORQUE,
    Feedback,
    Layout,
    SdoWrite,
    SetPoints,
    pdo_off,
    pdo_writes,
)
from spacearm_ident.canbus.scaling import JointScale
from spacearm_ident.errors import UserError

JOINT = JointScale(counts_per_turn=4096, gear_ratio=100.0, torque_constant=0.1, rated=5.0)
FLIPPED = replace(JOINT, direction=-1, zero_counts=1000)


def test_default_layouts():
    assert (FEEDBACK.size, SET_POINT.size) == (8, 6)
    assert [field.mapping for field in FEEDBACK.fields] == [0x60640020, 0x60770010, 0x60410010]
    assert [field.mapping for field in SET_POINT.fields] == [0x607A0020, 0x60400010]


@given(
    st.lists(
        st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**15), 2**15 - 1), st.integers(0, 0xFFFF)),
        min_size=1,
        max_size=6,
    )
)
def test_feedback_is_what_struct_unpacks(values):
    feedback = Feedback([JOINT] * len(values))
    for drive, value in enumerate(values):
        assert feedback.put(drive, bytearray(struct.pack("<ihH", *value)))
    feedback.decode()
    assert list(zip(feedback.counts, feedback.units, feedback.statusword)) == values
    assert feedback.position == pytest.approx([v[0] * 2 * math.pi / 409600 for v in values])
    # 5 A at 1000 per mille, 0.1 N m/A, ratio 100: 50 N m at the output.
    assert feedback.torque == pytest.approx([v[1] * 0.05 for v in values])
    assert feedback.current == pytest.approx([v[1] * 0.005 for v in values])


def test_a_payload_of_wrong_length_is_refused_and_changes_nothing():
    feedback = Feedback([JOINT])
    assert feedback.put(0, struct.pack("<ihH", 7, 8, 9))
    assert not feedback.put(0, b"\x01" * 7) and not feedback.put(0, b"") and not feedback.put(0, bytes(64))
    assert (feedback.counts[0], feedback.units[0], feedback.statusword[0]) == (7, 8, 9)


@given(st.lists(st.floats(-1000, 1000), min_size=1, max_size=6))
def test_set_points_reach_the_nearest_count(angles):
    points = SetPoints([JOINT] * len(angles))
    points.controlword[:] = 0x000F
    points.encode(np.array(angles))
    for angle, payload in zip(angles, points.payloads):
        target, controlword = struct.unpack("<iH", payload)
        assert abs(target * JOINT.rad_per_count - angle) <= 0.5000001 * JOINT.rad_per_count
        assert controlword == 0x000F


@given(st.integers(-(2**31), 2**31 - 1), st.sampled_from([JOINT, FLIPPED]))
def test_there_and_back_is_exact(counts, joint):
    feedback, points = Feedback([joint]), SetPoints([joint])
    feedback.put(0, struct.pack("<ihH", counts, 0, 0))
    feedback.decode()
    points.encode(feedback.position)
    assert struct.unpack("<iH", points.payloads[0])[0] == counts


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
def test_an_impossible_set_point_is_refused_and_the_last_one_stays(bad):
    points = SetPoints([JOINT, JOINT])
    points.encode(np.array([1.0, 2.0]))
    before = [bytes(payload) for payload in points.payloads]
    with pytest.raises(ValueError, match="not finite or beyond"):
        points.encode(np.array([0.5, bad]))
    assert [bytes(payload) for payload in points.payloads] == before


def test_hold_is_count_for_count():
    feedback, points = Feedback([FLIPPED] * 2), SetPoints([FLIPPED] * 2)
    for drive in range(2):
        feedback.put(drive, struct.pack("<ihH", 123456, 0, 0))
    points.hold(feedback, np.array([True, False]))
    assert [struct.unpack("<iH", payload)[0] for payload in points.payloads] == [123456, 0]
    feedback.decode()
    assert points.position()[0] == feedback.position[0]


def test_signs():
    feedback = Feedback([FLIPPED, replace(FLIPPED, torque_sign=-1)])
    for drive in range(2):
        feedback.put(drive, struct.pack("<ihH", 1000 + 409600, 100, 0))
    feedback.decode()
    assert feedback.position == pytest.approx([-2 * math.pi] * 2)
    assert feedback.torque == pytest.approx([-5.0, 5.0])


def test_rated_torque_and_rated_current_agree_where_the_drive_means_the_same():
    by_torque = replace(JOINT, torque_source="rated_torque", rated=0.5)
    assert by_torque.torque_per_unit == pytest.approx(JOINT.torque_per_unit)
    assert by_torque.amps_per_unit == pytest.approx(JOINT.amps_per_unit)
    peak = replace(JOINT, peak_factor=math.sqrt(2))
    assert peak.torque_per_unit == pytest.approx(math.sqrt(2) * JOINT.torque_per_unit)


@pytest.mark.parametrize(
    "change",
    [{"gear_ratio": 0}, {"rated": -1}, {"torque_constant": math.nan}, {"direction": 0}, {"torque_sign": 2},
     {"torque_source": "guess"}],
)  # fmt: skip
def test_nonsense_scales_are_refused(change):
    with pytest.raises(UserError, match=next(iter(change))):
        replace(JOINT, **change)


def test_a_slim_layout_without_status_and_with_current():
    layout = Layout((POSITION, CURRENT))
    feedback = Feedback([JOINT], layout)
    assert layout.size == 6 and feedback.put(0, struct.pack("<ih", -5, 7))
    feedback.decode()
    assert feedback.statusword[0] == 0 and feedback.units[0] == 7
    points = SetPoints([JOINT], Layout((TARGET,)))
    points.encode(np.array([0.0]))
    assert bytes(points.payloads[0]) == bytes(4)
    assert layout.fields[1].mapping == 0x60780010 and TORQUE.mapping == 0x60770010


def test_the_writes_follow_the_order_of_cia_301():
    assert pdo_writes(5, FEEDBACK, transmit=True) == [
        SdoWrite(0x1800, 1, 0x80000185, 4),
        SdoWrite(0x1800, 2, 1, 1),
        SdoWrite(0x1A00, 0, 0, 1),
        SdoWrite(0x1A00, 1, 0x60640020, 4),
        SdoWrite(0x1A00, 2, 0x60770010, 4),
        SdoWrite(0x1A00, 3, 0x60410010, 4),
        SdoWrite(0x1A00, 0, 3, 1),
        SdoWrite(0x1800, 1, 0x185, 4),
    ]
    receive = pdo_writes(5, SET_POINT, transmit=False, number=2, transmission_type=255)
    assert receive[0] == SdoWrite(0x1401, 1, 0x80000305, 4)
    assert SdoWrite(0x1401, 2, 255, 1) in receive
    assert receive[-1] == SdoWrite(0x1401, 1, 0x305, 4)
    assert pdo_off(5, transmit=True, number=4) == SdoWrite(0x1803, 1, 0x80000485, 4)


def test_bytes_of_a_write():
    assert SdoWrite(0x60C2, 2, -3, 1).data == b"\xfd"
    assert SdoWrite(0x1800, 1, 0x80000185, 4).data == b"\x85\x01\x00\x80"
