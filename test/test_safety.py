"""The safety policy, rule by rule: what stops the arm, and what must not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.driver.safety import Fault, Limits, Margins, MotionMonitor, Rule, fault_of, judge_step
from spacearm_ident.driver.set_points import BLEND, BRIDGE, PAUSE, START, SetPointStream

N = 3
LIMITS = Limits(
    ("a", "b", "c"),
    lower=np.array([-1.0, -2.0, -np.inf]),
    upper=np.array([1.0, 2.0, np.inf]),
    velocity=np.array([1.0, 1.5, 2.0]),
    acceleration=np.array([2.0, 3.0, 4.0]),
    torque=np.array([100.0, 50.0, 10.0]),
    tracking=np.full(N, 0.05),
)
STILL = np.zeros(N)
MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
joints = st.integers(0, N - 1)


def one(joint: int, value: float) -> np.ndarray:
    array = np.zeros(N)
    array[joint] = value
    return array


# What is asked of the arm -----------------------------------------------------------------------------


@given(joints, st.sampled_from([np.nan, np.inf, -np.inf]))
def test_a_set_point_that_is_no_number_is_refused(joint, value):
    fault = judge_step(LIMITS, one(joint, value), STILL, STILL)
    assert fault.rule is Rule.SET_POINT and LIMITS.joints[joint] in fault.message


@given(joints, st.floats(-1.5, 1.5), st.sampled_from(["position", "velocity", "acceleration"]))
def test_set_points_are_refused_exactly_beyond_the_limits(joint, share, what):
    limit = {
        "position": LIMITS.upper[joint],
        "velocity": LIMITS.velocity[joint],
        "acceleration": LIMITS.acceleration[joint],
    }[what]
    if not np.isfinite(limit):
        limit = 1e6
    tolerance = 1e-5 if what == "position" else 0.02
    value = {name: STILL for name in ("position", "velocity", "acceleration")} | {what: one(joint, share * limit)}
    fault = judge_step(LIMITS, **value)
    unbounded = what == "position" and joint == 2
    if abs(share) > 1.0 + 1.1 * tolerance and not unbounded:
        assert fault.rule is Rule.SET_POINT and LIMITS.joints[joint] in fault.message
    elif abs(share) <= 1.0:
        assert fault is None


def test_an_arm_outside_of_its_limits_may_come_back_but_not_go_further():
    outside = np.array([1.2, 0.0, 0.0])
    limits = LIMITS.around(outside)
    assert judge_step(limits, outside, STILL, STILL) is None
    assert judge_step(limits, outside - one(0, 0.1), STILL, STILL) is None
    assert judge_step(limits, outside + one(0, 0.01), STILL, STILL) is not None
    assert judge_step(limits, -outside, STILL, STILL) is not None


# What the arm does ------------------------------------------------------------------------------------


def watched(motion, torque=STILL, fresh=None, cycles=60, target=None, margins=None):
    """The first fault of a motion `position(t)`, sampled at 1 kHz."""
    monitor = MotionMonitor(LIMITS, margins)
    for k in range(cycles):
        position = motion(1e-3 * k)
        seen = np.ones(N, dtype=bool) if fresh is None else fresh(k)
        monitor.observe(1e-3 * k, position, torque, seen)
        fault = monitor.judge(position if target is None else target)
        if fault is not None:
            return k, fault
    return None


@given(joints, st.floats(0.1, 2.0), st.sampled_from([-1, 1]))
def test_velocity_beyond_its_margin_stops_the_arm(joint, share, sign):
    speed = sign * share * Margins().velocity * LIMITS.velocity[joint]
    # The acceleration of the sudden start is another test's.
    found = watched(lambda t: one(joint, speed * t), margins=Margins(acceleration=np.inf))
    if share > 1.01:
        assert found is not None and found[1].rule is Rule.VELOCITY
    elif share < 0.99:
        assert found is None


@given(joints, st.floats(0.1, 2.0))
def test_acceleration_beyond_its_margin_stops_the_arm(joint, share):
    acceleration = share * Margins().acceleration * LIMITS.acceleration[joint]
    found = watched(lambda t: one(joint, 0.5 * acceleration * t * t), cycles=25, margins=Margins(velocity=np.inf))
    if share > 1.01:
        assert found is not None and found[1].rule is Rule.ACCELERATION
    elif share < 0.99:
        assert found is None


@given(joints, st.floats(-2.0, 2.0))
def test_torque_beyond_its_limit_stops_the_arm(joint, share):
    found = watched(lambda t: STILL, torque=one(joint, share * LIMITS.torque[joint]))
    if abs(share) > 1.001:
        assert found is not None and found[1].rule is Rule.TORQUE and found[0] <= 10
    elif abs(share) < 0.999:
        assert found is None


def test_a_millisecond_of_torque_does_not_stop_the_arm():
    monitor = MotionMonitor(LIMITS)
    for k in range(60):
        torque = one(1, 200.0 if k == 30 else 0.0)
        monitor.observe(1e-3 * k, STILL, torque, np.ones(N, dtype=bool))
        assert monitor.judge(STILL) is None


@given(joints, st.floats(-0.2, 0.2))
def test_tracking_error(joint, error):
    found = watched(lambda t: STILL, target=one(joint, error))
    assert (found is not None) == (abs(error) > 0.05)
    if found:
        assert found[1].rule is Rule.TRACKING and found[0] == 0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_position_beyond_its_limit(side):
    assert watched(lambda t: one(0, side * 1.04)) is None
    _, fault = watched(lambda t: one(0, side * 1.06))
    assert fault.rule is Rule.POSITION and "a is at" in fault.message


def test_a_position_that_jumps_is_caught_in_its_cycle():
    cycle, fault = watched(lambda t: one(0, 0.04 if t > 0.0495 else 0.0))
    assert cycle == 50 and fault.rule in (Rule.VELOCITY, Rule.ACCELERATION)


@given(st.floats(-0.9, 0.9), st.integers(12, 40), st.integers(1, 15))
def test_feedback_that_is_missing_for_a_while_is_no_motion(share, first, length):
    """The last position stands while it is missing; the return to the true one is not a velocity."""
    speed = share * LIMITS.velocity[0]

    def last_known(t):
        k = round(1e3 * t)
        return one(0, 1e-3 * speed * (first - 1 if first <= k < first + length else k))

    missing = watched(
        last_known,
        fresh=lambda k: np.array([not first <= k < first + length, True, True]),
        cycles=80,
        margins=Margins(acceleration=np.inf),
    )
    assert missing is None


def test_rest_is_seen_and_left():
    monitor = MotionMonitor(LIMITS)
    assert monitor.at_rest
    for k in range(30):
        monitor.observe(1e-3 * k, one(1, 1e-4 * k), STILL, np.ones(N, dtype=bool))
    assert not monitor.at_rest
    for k in range(30, 60):
        monitor.observe(1e-3 * k, one(1, 3e-3), STILL, np.ones(N, dtype=bool))
    assert monitor.at_rest


@pytest.mark.parametrize("kind", EventKind)
def test_every_event_but_good_news_is_a_fault(kind):
    fault = fault_of(Event(kind, 2, "what happened", 0))
    if kind is EventKind.EMERGENCY_OVER:
        assert fault is None
    else:
        assert "what happened" in str(fault)
        assert (fault.rule is Rule.BUS) == (kind in (EventKind.BUS_ERROR, EventKind.OTHER_MASTER))


# Set-points onto the clock ------------------------------------------------------------------------------


def streamed(position, milliseconds, held=STILL, delay=0.02, stream=None, first=0):
    """Stream `position(t)` at 1 kHz, every set-point at its time."""
    stream = stream or SetPointStream(LIMITS, held, delay)
    for k in range(first, first + milliseconds):
        now = START_NS + k * MS
        fault = stream.put(now, position(1e-3 * k), now)
        assert fault is None, fault
    return stream


def rising(t):
    return one(0, 0.05 * (1.0 - np.cos(2 * np.pi * t)))


@settings(max_examples=30)
@given(st.integers(1, 39 * MS))
def test_the_arm_follows_the_stamps_whenever_the_cycle_asks(ns):
    stream = streamed(rising, 60)
    played = stream.target(START_NS + 20 * MS + ns)
    np.testing.assert_allclose(played, rising(1e-9 * ns), atol=2e-6)


def test_jitter_of_arrival_is_not_felt():
    stream, arrived = SetPointStream(LIMITS, STILL, 0.02), 0
    for k in range(200):
        now = START_NS + k * MS
        # They come in lumps of 15.
        if k % 15 == 14:
            for m in range(arrived, k + 1):
                assert stream.put(START_NS + m * MS, rising(1e-3 * m), now) is None
            arrived = k + 1
        if k > 30:
            np.testing.assert_allclose(stream.target(now), rising(1e-3 * (k - 20)), atol=2e-6)
        assert stream.starved(now) is None


def test_nothing_moves_before_the_first_set_point_is_due():
    stream = SetPointStream(LIMITS, STILL, 0.02)
    assert stream.target(START_NS) is None
    stream.put(START_NS, STILL, START_NS)
    assert stream.target(START_NS + 19 * MS) is None
    assert stream.target(START_NS + 21 * MS) is not None


@given(st.floats(-START, START))
def test_a_first_set_point_beside_the_arm_is_blended(offset):
    held = one(0, offset)
    stream = streamed(lambda t: STILL, 700, held=held)
    played = np.array([stream.target(START_NS + (20 + k) * MS)[0] for k in range(699)])
    assert played[0] == pytest.approx(offset, abs=1e-9)
    assert played[round(1e3 * BLEND) :] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(np.diff(played)).max() * 1e3 < 0.07


def test_a_first_set_point_far_from_the_arm_is_refused():
    fault = SetPointStream(LIMITS, STILL).put(START_NS, one(1, 2 * START), START_NS)
    assert fault.rule is Rule.SET_POINT and "b is held at 0 rad" in fault.message


def test_a_stream_that_begins_in_motion_is_refused():
    stream = SetPointStream(LIMITS, STILL)
    assert stream.put(START_NS, one(0, 0.0), START_NS) is None
    fault = stream.put(START_NS + MS, one(0, 0.5e-3), START_NS + MS)
    assert fault.rule is Rule.SET_POINT and "accelerate" in fault.message


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.5])
def test_a_bad_set_point_in_the_stream_is_refused_and_not_played(value):
    stream = streamed(rising, 50)
    now = START_NS + 50 * MS
    assert stream.put(now, one(0, value), now).rule is Rule.SET_POINT
    assert stream.accepted == 50
    assert np.isfinite(stream.target(now + 20 * MS)).all()


@pytest.mark.parametrize("seconds", [-5.0, 5.0, -1.7e9])
def test_stamps_of_another_clock_are_refused(seconds):
    fault = SetPointStream(LIMITS, STILL).put(START_NS + round(1e9 * seconds), STILL, START_NS)
    assert fault.rule is Rule.SET_POINT and "clock" in fault.message


def test_two_nodes_streaming_at_once_are_noticed():
    stream = streamed(rising, 50)
    now = START_NS + 50 * MS
    assert stream.put(now - 2 * MS, rising(0.048), now) is not None
    # The very same message twice is harmless.
    assert stream.put(now - MS, rising(0.049), now) is None


def test_a_stream_that_ends_in_motion_is_starvation_and_one_that_ends_at_rest_is_not():
    stream = streamed(rising, 250)
    last = START_NS + 249 * MS
    assert stream.starved(last + 20 * MS) is None
    fault = stream.starved(last + 20 * MS + round(1.1e9 * BRIDGE))
    assert fault.rule is Rule.STARVATION and "a should move" in fault.message
    stream = streamed(rising, 1001)
    assert stream.starved(START_NS + 60_000 * MS) is None


def test_what_is_missing_is_bridged_for_a_moment_only():
    stream = streamed(rising, 250)
    edge = START_NS + (249 + 20) * MS
    slope = 2 * np.pi * 0.05 * np.sin(2 * np.pi * 0.2485)
    bridged = stream.target(edge + 2 * MS)[0] - stream.target(edge)[0]
    assert bridged == pytest.approx(2e-3 * slope, rel=0.01)
    assert stream.target(edge + 500 * MS)[0] == pytest.approx(stream.target(edge)[0] + BRIDGE * slope, rel=0.01)


def test_after_a_pause_at_rest_another_stream_may_begin():
    stream = streamed(rising, 1001)
    pause = round(1e3 * PAUSE) + 200
    now = START_NS + (1000 + pause) * MS
    assert stream.put(now, one(0, 0.01), now) is None
    # From where the arm is held, smoothly.
    assert stream.target(now + 20 * MS)[0] == pytest.approx(rising(1.0)[0], abs=1e-9)
    assert stream.put(now + 500 * MS, one(0, 0.3), now + 500 * MS) is not None


def test_a_flood_of_set_points_is_refused():
    stream, fault = SetPointStream(LIMITS, STILL), None
    for k in range(30_000):
        fault = fault or stream.put(START_NS + 1000 * k, STILL, START_NS + 1000 * k)
    assert isinstance(fault, Fault) and "faster than time" in fault.message
