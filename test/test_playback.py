"""A cycle that is held up: the arm goes on along its path, without a jump and within its limits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_arm import CONFIG, paper_arm, paper_limits

from spacearm_ident.canbus import realtime
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.driver.playback import (
    AFTERMATH,
    BRIDGED_ACCELERATION,
    BRIDGED_VELOCITY,
    CATCH_UP,
    EASED_ACCELERATION,
    FADE,
    FADE_SHARE,
    Playback,
    acceleration_for_stalls,
)
from spacearm_ident.driver.safety import TOLERANCE, Limits, Margins, MotionMonitor, Rule
from spacearm_ident.driver.set_points import SetPointStream
from spacearm_ident.excitation.trajectory import random_feasible
from spacearm_ident.simulation.drives.motion import Motion
from spacearm_ident.simulation.live_arm import LiveArm

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
DELAY = 0.2
VELOCITY, ACCELERATION = np.array([1.0, 1.5, 2.0]), np.array([2.0, 3.0, 5.0])
LIMITS = Limits(
    ("a", "b", "c"),
    lower=np.full(3, -0.1),
    upper=np.array([1.1, np.inf, np.inf]),
    velocity=VELOCITY,
    acceleration=ACCELERATION,
    torque=np.full(3, np.inf),
    tracking=np.full(3, 0.05),
)
#: Joint a meets both of its limits, b its acceleration limit, c its velocity limit.
PACE = np.array([2.0, 3.1, 1.3])
REACH = np.array([0.5, 3.0 / 3.1**2, 2.0 / 1.3])
stalls_ms = st.integers(6, 100)


def swinging(t: float) -> np.ndarray:
    """From rest, back and forth for ever."""
    return REACH * (1.0 - np.cos(PACE * max(0.0, t)))


def played(extrapolation, stalls: dict[int, int], cycles: int, motion=swinging, jitter=lambda k: 0, limits=LIMITS):
    """Play `motion` at 1 kHz, the cycle held up at some of the milliseconds for some; (ms, target, lag in s, rate)."""
    stream, playback = SetPointStream(limits, np.zeros(3), DELAY), Playback(1e-3, extrapolation)
    heard, awake = [], 0
    for k in range(cycles):
        now = START_NS + k * MS
        assert stream.put(now, motion(1e-3 * k), now) is None
        awake = max(awake, k + stalls.get(k, 0))
        if k >= awake:
            target = playback.target(stream, now + jitter(k))
            assert playback.starved(stream, now) is None
            if target is not None:
                heard.append((k, target, 1e-9 * playback.lag_ns, playback.rate))
    ms, targets, lags, rates = (np.array(column) for column in zip(*heard))
    return ms, targets, lags, rates, playback


def rates_of(targets):
    """First and second differences at 1 kHz."""
    velocity = 1e3 * np.diff(targets, axis=0)
    return velocity, 1e3 * np.diff(velocity, axis=0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.06]))
def test_without_a_stall_it_is_the_stream_to_the_bit(seed, extrapolation):
    jitter = np.random.default_rng(seed).integers(-MS // 10, MS // 10, 700).tolist()
    ms, targets, lags, _, playback = played(extrapolation, {}, 700, jitter=lambda k: jitter[k])
    alone = SetPointStream(LIMITS, np.zeros(3), DELAY)
    for k in range(700):
        alone.put(START_NS + k * MS, swinging(1e-3 * k), START_NS + k * MS)
    for k, target in zip(ms.tolist(), targets):
        assert np.array_equal(target, alone.target(START_NS + k * MS + jitter[k]))
    assert not lags.any() and playback.stalls == 0


@settings(max_examples=12, deadline=None)
@given(st.integers(250, 2500), stalls_ms)
def test_drives_that_stand_are_led_on_along_the_path_within_the_limits(at, stall):
    ms, targets, lags, rates, playback = played(0.0, {at: stall}, at + stall + 1500)
    assert playback.stalls == 1
    after = ms > at
    # Never ahead of the clock, never back, never faster than set-points may be; on the path wherever it is.
    s = 1e-3 * ms - DELAY - lags
    assert np.all(lags >= 0) and np.all(np.diff(s) >= -1e-12) and np.all(rates <= 1 + CATCH_UP)
    np.testing.assert_allclose(targets, [swinging(t) for t in s], atol=2e-6)
    before, first = targets[~after][-1], targets[after][0]
    assert np.array_equal(before, first)
    resumed = np.concatenate([[before], targets[after]])
    velocity, acceleration = rates_of(resumed)
    assert np.all(np.abs(velocity) <= (1 + TOLERANCE) * VELOCITY)
    assert np.all(np.abs(acceleration) <= 1.03 * ACCELERATION)
    # It goes on: within a second and a half it is at the clock's pace again.
    assert rates[-1] >= 1.0 and lags[-1] < lags.max()


def test_the_lag_is_made_up_and_then_it_is_the_stream_to_the_bit():
    ms, targets, lags, _, _ = played(0.0, {230: 6}, 11_000)
    assert 0.006 <= lags.max() < 0.1
    done = lags == 0
    assert done[-1] and np.array_equal(done[ms > 230], np.maximum.accumulate(done[ms > 230]))
    alone = played(0.0, {}, 11_000)
    kept = dict(zip(alone[0].tolist(), alone[1]))
    for k, target in zip(ms[done].tolist(), targets[done]):
        assert np.array_equal(target, kept[k])
    velocity, acceleration = rates_of(targets[ms > 230])
    assert np.all(np.abs(velocity) <= (1 + TOLERANCE) * VELOCITY)
    assert np.all(np.abs(acceleration) <= 1.03 * ACCELERATION)


@settings(max_examples=20, deadline=None)
@given(st.integers(250, 2500), st.integers(6, 59))
def test_drives_that_went_on_are_faded_onto_the_path_at_the_clock(at, stall):
    ms, targets, lags, _, playback = played(0.06, {at: stall}, at + stall + 700)
    assert playback.stalls == 1 and not lags.any()
    after = np.flatnonzero(ms > at)
    i = after[0]
    gone = targets[i - 1] + (targets[i - 1] - targets[i - 2]) * (ms[i] - ms[i - 1])
    np.testing.assert_allclose(targets[i], gone, atol=1e-12)
    T = 1e-3 * (stall + 1)
    fade = max(FADE, FADE_SHARE * T)
    faded = ms > ms[i] + 1e3 * fade
    np.testing.assert_allclose(targets[faded], [swinging(1e-3 * k - DELAY) for k in ms[faded]], atol=2e-6)
    # The fading itself: a cubic from an error of a T²/2 and a T; the velocity they went on with is half a cycle older.
    _, acceleration = rates_of(targets[i:])
    most = 1 + 4 * (T + 1e-3) / fade + 3 * (T / fade) ** 2
    assert np.all(np.abs(acceleration) <= 1.02 * most * ACCELERATION)


def test_what_a_plan_must_leave_for_bridging_is_the_extremes_of_the_cubic():
    extrapolation = 0.06
    assert pytest.approx(1.75) == BRIDGED_ACCELERATION and pytest.approx(0.583, abs=1e-3) == EASED_ACCELERATION
    share = np.linspace(0.0, 1.0, 20001)
    r, T = 1.0 / FADE_SHARE, extrapolation
    # The cubic of a drive left behind by a T²/2 and a T, with a = 1.
    beside, velocity, fade = -(T**2) / 2, -T, T / r
    left = (1 - share) ** 2 * ((1 + 2 * share) * beside + share * fade * velocity)
    speed = np.gradient(left, share * fade)
    bent = np.gradient(speed, share * fade)[5:-5]
    assert speed.max() == pytest.approx(BRIDGED_VELOCITY * T, rel=1e-3)
    assert 1 + bent.max() == pytest.approx(BRIDGED_ACCELERATION, rel=1e-3)
    assert 1 + bent.min() == pytest.approx(EASED_ACCELERATION, rel=1e-3)


def test_what_is_faded_stays_within_the_position_limits():
    """The swing comes back to where it began, which is its limit here, while drives that went on are beside it."""
    tight = replace(LIMITS, lower=np.zeros(3))
    _, targets, *_ = played(0.06, {200 + round(1e3 * math.pi) - 250: 50}, 200 + 3400, limits=tight)
    assert np.all(targets >= 0.0)
    _, loose, *_ = played(0.06, {200 + round(1e3 * math.pi) - 250: 50}, 200 + 3400)
    assert loose[:, 0].min() < -1e-4


def test_at_rest_nothing_is_held_up_and_nothing_lags():
    def once(t):
        return swinging(min(t, math.pi)) * np.array([1.0, 0.0, 0.0])

    # In motion with drives that stand, then over the end, at rest again: no lag is left.
    _, targets, lags, rates, playback = played(0.0, {3000: 20, 4500: 90}, 5000, motion=once)
    assert playback.stalls == 1 and lags.max() > 0.02
    assert lags[-1] == 0 and rates[-1] == 1
    np.testing.assert_allclose(targets[-1], once(10.0), atol=1e-12)


def test_bridging_is_said_from_the_stall_until_the_arm_has_settled_and_at_no_other_time():
    for extrapolation in (0.0, 0.06):
        stream, playback = SetPointStream(LIMITS, np.zeros(3), DELAY), Playback(1e-3, extrapolation)
        said = []
        for k in range(2500):
            now = START_NS + k * MS
            stream.put(now, swinging(1e-3 * k), now)
            if not 1000 < k < 1040:
                playback.target(stream, now)
                said.append((k, playback.bridging(now)))
        during = [k for k, bridging in said if bridging]
        assert during[0] == 1040 and during == [k for k, _ in said if 1040 <= k <= during[-1]]
        assert 1040 + 1e3 * (FADE if extrapolation else 0.0) + 1e3 * AFTERMATH <= during[-1] + 1 < 2400


def test_acceleration_is_capped_only_where_bridging_would_break_the_velocity_limit():
    velocity, acceleration = np.array([1.2, 2.0]), np.array([3.0, 50.0])
    capped = acceleration_for_stalls(velocity, acceleration, 0.06, Margins().velocity)
    assert capped[0] == 3.0 and 14.0 < capped[1] < 16.0
    most = velocity + BRIDGED_VELOCITY * capped * 0.06
    assert np.all(most <= Margins().velocity * velocity * (1 + 1e-12))
    assert np.array_equal(acceleration_for_stalls(velocity, acceleration, 0.0, 1.2), acceleration)


@pytest.mark.parametrize("extrapolation", [0.0, 0.06])
def test_a_stall_longer_than_the_delay_stops_the_arm(extrapolation):
    stream, playback = SetPointStream(LIMITS, np.zeros(3), DELAY), Playback(1e-3, extrapolation)
    for k in range(1300):
        stream.put(START_NS + k * MS, swinging(1e-3 * k), START_NS + k * MS)
    for k in range(200, 900):
        playback.target(stream, START_NS + k * MS)
    assert playback.starved(stream, START_NS + 900 * MS) is None
    playback.target(stream, START_NS + 1100 * MS)
    fault = playback.starved(stream, START_NS + 1100 * MS)
    assert fault.rule is Rule.STARVATION and "held up for 201 ms" in fault.message
    playback.begin()
    assert playback.starved(stream, START_NS + 1100 * MS) is None


def test_set_points_that_end_in_motion_are_missed_later_by_the_lag():
    stream, playback = SetPointStream(LIMITS, np.zeros(3), DELAY), Playback(1e-3, 0.0)
    last = 1000
    for k in range(last + 1):
        stream.put(START_NS + k * MS, swinging(1e-3 * k), START_NS + k * MS)
    starved = []
    for k in [*range(200, 900), *range(950, 1600)]:
        playback.target(stream, START_NS + k * MS)
        starved.append((k, playback.lag_ns, playback.starved(stream, START_NS + k * MS)))
    k, lag_ns, fault = next(entry for entry in starved if entry[2])
    assert fault.rule is Rule.STARVATION and "no set-point" in fault.message
    assert lag_ns > 50 * MS
    assert k == pytest.approx(last + 1e3 * DELAY + 1e-6 * lag_ns, abs=5)


# With drives and the arm behind them ------------------------------------------------------------------


def stopped_by(extrapolation, stall, at, pace, bridged):
    """The monitor's fault where the paper's arm follows an excitation and its driver is held up, or None.

    Args:
        extrapolation: Of the drives, s.
        stall: How long the driver is held up, ms.
        at: From when on, ms; the drives are given what is meant for `DELAY` before.
        pace: Of the excitation; 1: at 60 % of the arm's limits.
        bridged: Whether by `Playback`; else the set-points jump to the clock.
    """
    config = load_arm_can(CONFIG / "paper_arm_can.yaml")
    fourier = random_feasible(
        paper_arm().joints, paper_limits(), seed=4, fundamental_hz=0.5, harmonics=2, usage=0.6, smallest_usage=0.59
    )
    points = fourier.run(paper_limits()).evaluate(1e-3 * pace * np.arange(at + stall + 250)).q
    arm, yes = LiveArm(paper_arm(), config.arm, position=points[0]), np.ones(6, dtype=bool)
    drives = [Motion(extrapolation) for _ in points[0]]
    for drive, angle in zip(drives, points[0].tolist()):
        drive.hold(angle)
    monitor, stream = MotionMonitor(config.limits), SetPointStream(config.limits, points[0], DELAY)
    playback, target, last = Playback(1e-3, extrapolation), None, -1
    for k, point in enumerate(points):
        now = START_NS + k * MS
        assert stream.put(now, point, now) is None
        if not at <= k < at + stall:
            if target is not None:
                # What was sent after the last SYNC takes effect with this one; see `drives_motion`.
                for drive, angle in zip(drives, target.tolist()):
                    drive.follow(angle, 1e-3, 1e-3 * (k - last - 1))
            target, last = playback.target(stream, now) if bridged else stream.target(now), k
            monitor.observe(1e-3 * k, arm.position, arm.torque, yes)
            fault = monitor.judge(arm.position if target is None else target)
            if fault is not None:
                return fault
        for drive in drives:
            drive.advance(1e-3)
        arm.step(np.array([drive.demand for drive in drives]), yes, ~yes, 1e-3)
    assert playback.stalls == int(bridged)
    return None


@pytest.mark.parametrize(
    "extrapolation, stall, at, pace",
    [(0.06, 50, 1500, 1.0), (0.0, 15, 2800, 0.5), (0.0, 100, 2800, 0.5)],
    ids=["went on", "stood", "stood long"],
)
def test_the_arm_goes_on_after_a_stall_that_would_stop_it(extrapolation, stall, at, pace):
    assert stopped_by(extrapolation, stall, at, pace, bridged=True) is None
    assert stopped_by(extrapolation, stall, at, pace, bridged=False) is not None


def test_a_thread_kept_asleep_through_several_slots_begins_the_last(monkeypatch):
    """Its targets are for the slot that begins then: one for the slot it should have begun would be a step back."""
    now, asleep = [10 * MS], [0]

    def sleep(seconds):
        now[0] += round(1e9 * seconds) + asleep[0]

    monkeypatch.setattr(realtime.time, "monotonic_ns", lambda: now[0])
    monkeypatch.setattr(realtime.time, "sleep", sleep)
    pacer = realtime.Pacer(1e-3)
    assert [pacer.wait() for _ in range(3)] == [0.0] * 3
    asleep[0] = 15 * MS + 300_000
    assert pacer.wait() == pytest.approx(0.3e-3) and pacer.missed == 15
    assert pacer.lateness(1.0) == pytest.approx(4.999e-3, abs=1e-5)
    asleep[0] = 0
    assert pacer.wait() == 0.0 and pacer.missed == 15
    assert now[0] == (10 + 15 + 4) * MS
