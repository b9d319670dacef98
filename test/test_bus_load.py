"""Bus load against frames built bit by bit, and against the figures the design was decided on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spacearm_ident.canbus.bus_load import (
    FD_SIZES,
    BitRate,
    BusLoad,
    CyclicFrame,
    Traffic,
    alternatives,
    bus_load,
    check,
    frame_seconds,
)
from spacearm_ident.errors import UserError


def _crc15(bits):
    crc = 0
    for bit in bits:
        invert = bit ^ (crc >> 14)
        crc = (crc << 1) & 0x7FFF
        if invert:
            crc ^= 0x4599
    return [crc >> (14 - i) & 1 for i in range(15)]


def bits_on_the_wire(can_id, data):
    """A classical frame as the transmitter builds it: fields, CRC, stuffing, tail, interframe space."""
    bits = [0] + [can_id >> (10 - i) & 1 for i in range(11)] + [0, 0, 0]
    bits += [len(data) >> (3 - i) & 1 for i in range(4)]
    bits += [byte >> (7 - i) & 1 for byte in data for i in range(8)]
    bits += _crc15(bits)
    sent, run, last = 0, 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        sent += 1
        if run == 5:
            sent, run, last = sent + 1, 1, 1 - bit
    return sent + 1 + 2 + 7 + 3


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_the_worst_case(can_id, data):
    _, worst = frame_seconds(len(data), BitRate(1.0), fd=False)
    assert bits_on_the_wire(can_id, data) <= worst
    assert bits_on_the_wire(can_id, data) >= 47 + 8 * len(data)


def test_the_mean_is_near_that_of_pdo_like_frames():
    rng = np.random.default_rng(1)
    counts = rng.integers(-(2**20), 2**20, 400)
    torque = rng.normal(0, 150, 400).astype(int)
    lengths = [
        bits_on_the_wire(0x180 + n % 6 + 1, int(c).to_bytes(4, "little", signed=True)
                         + int(t).to_bytes(2, "little", signed=True) + b"\x37\x12")
        for n, (c, t) in enumerate(zip(counts, torque))
    ]  # fmt: skip
    mean, worst = frame_seconds(8, BitRate(1.0), fd=False)
    assert abs(np.mean(lengths) - mean) < 0.04 * mean
    assert max(lengths) < worst


@pytest.mark.parametrize(
    "axes, traffic, expected",
    [
        (6, Traffic(), (137, 155)),
        (6, Traffic(feedback_bytes=6, set_point_bytes=4, set_point_rate=250), (78, 89)),
        (6, Traffic(rate=500), (69, 78)),
        (3, Traffic(), (71, 81)),
        (2, Traffic(), (49, 56)),
    ],
)
def test_the_figures_of_the_design(axes, traffic, expected):
    load = bus_load(traffic.frames(axes))
    assert (100 * load.mean, 100 * load.worst) == pytest.approx(expected, abs=0.65)


def test_can_fd():
    assert 100 * bus_load(Traffic().frames(6), BitRate(1e6, 5e6)).worst == pytest.approx(71, abs=0.5)


@given(st.sampled_from(FD_SIZES))
def test_fd_at_the_nominal_rate_counts_every_bit_once(size):
    mean, worst = frame_seconds(size, BitRate(1.0, 1.0), fd=True)
    fixed = 22 + 8 * size + 4 + (23 if size <= 16 else 28) + 13
    assert worst == fixed + (21 + 8 * size) // 4
    assert fixed < mean < worst


def test_load_is_linear_in_the_frames():
    frames = [CyclicFrame(8, 100), CyclicFrame(2, 300)]
    both, first, second = bus_load(frames), bus_load(frames[:1]), bus_load(frames[1:])
    assert both.mean == pytest.approx(first.mean + second.mean)
    assert both.worst == pytest.approx(first.worst + second.worst)
    assert bus_load([CyclicFrame(8, 1000)], BitRate(1e6)).worst == pytest.approx(0.135)


def test_heartbeats_count():
    quiet, beating = (bus_load(Traffic(heartbeat_rate=rate).frames(3)) for rate in (0.0, 10.0))
    assert beating.worst - quiet.worst == pytest.approx(4 * 10 * 65e-6)


def test_six_axes_on_one_bus_are_refused_with_what_would_fit():
    with pytest.raises(UserError) as refusal:
        check([6], Traffic())
    text = str(refusal.value)
    assert "\n" not in text
    assert "137 % (worst case 156 %)" in text
    for name, load in alternatives(6, Traffic(), BitRate()):
        assert f"{name}: {load}" in text
        assert load.worst < 1.0
    for expected in ("2 buses of 3 axes", "3 buses of 2 axes", "CAN FD", "250 Hz", "500 Hz"):
        assert expected in text


def test_what_does_not_fit_is_not_offered():
    with pytest.raises(UserError) as refusal:
        check([6], Traffic(rate=2000))
    assert "2 buses" not in str(refusal.value) and "3 buses of 2 axes" not in str(refusal.value)
    with pytest.raises(UserError, match="lower rate"):
        check([6], Traffic(rate=8000))


def test_the_default_fits():
    loads = check([3, 3], Traffic())
    assert [str(load) for load in loads] == ["71 % (worst case 80 %)"] * 2
    assert loads[0] == BusLoad(pytest.approx(0.7117, abs=1e-4), pytest.approx(0.805))


@pytest.mark.parametrize("size, fd", [(9, False), (-1, False), (9, True), (65, True)])
def test_frames_that_do_not_exist(size, fd):
    with pytest.raises(ValueError, match="hold"):
        frame_seconds(size, BitRate(1e6, 5e6), fd)
