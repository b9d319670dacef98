"""Constant speed, chirps, and the composite runs made of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import small_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.clearance import Clearance
from spacearm_ident.excitation.composite import (
    EXPERIMENT_OF,
    PURPOSES,
    SLOW_RAD_S,
    compose,
    experiment_for,
    with_slow_segment,
)
from spacearm_ident.excitation.constraints import Requirements, allowed_torque, check, limits_for_excitation
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.run import check_limits, plan_run
from spacearm_ident.excitation.segments import Chirp, Cruise, Motion, MotionLimits, Quintic, Rest, still
from spacearm_ident.excitation.trajectory import Trajectory, random_feasible
from spacearm_ident.excitation.trajectory_file import (
    load_trajectory,
    save_trajectory,
    trajectory_from_dict,
    trajectory_to_dict,
)

JOINTS = ("shoulder", "elbow")
ARM = arm_from_urdf(small_arm.URDF)
START = np.array([0.2, -0.3])
LIMITS, _ = limits_for_excitation(ARM, START, np.array([40.0, 40.0]))
CLEARANCE = Clearance(ARM, 0.0, np.full(2, -3.0), np.full(2, 3.0))
NEEDS = Requirements(LIMITS, allowed_torque(ARM), nominal_model(ARM), clearance=CLEARANCE)


@given(st.floats(0.5, 3.0), st.floats(0.1, 2.0), st.floats(2.5, 6.0))
@settings(max_examples=25, deadline=None)
def test_chirp_derivatives_are_those_of_its_position_and_it_begins_and_ends_at_rest(duration, low, high):
    chirp = Chirp(np.array([0.3, -1.0]), np.array([0.1, 0.0]), low, high, 2 * duration)
    t, h = np.linspace(0.01, 2 * duration - 0.01, 60), 1e-5
    before, here, after = (chirp.evaluate(t + shift) for shift in (-h, 0.0, h))
    scale = 0.1 * (2 * np.pi * high) ** 2
    np.testing.assert_allclose((after.q - before.q) / (2 * h), here.qd, atol=1e-4 * scale)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), here.qdd, atol=1e-3 * scale)
    for end in (0.0, 2 * duration):
        np.testing.assert_allclose(chirp.evaluate(end).at(0), [[0.3, -1.0], [0, 0], [0, 0]], atol=1e-12)


def test_a_chirp_has_its_power_between_its_two_frequencies():
    chirp = Chirp(np.zeros(1), np.ones(1), 2.0, 8.0, 20.0)
    t = np.arange(0.0, 20.0, 0.005)
    power = np.abs(np.fft.rfft(chirp.evaluate(t).q[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(t), 0.005)
    inside = (frequency > 1.8) & (frequency < 8.2)
    assert power[inside].sum() > 0.99 * power.sum()
    middle = power[(frequency > 3.0) & (frequency < 7.0)]
    assert middle.max() < 4 * np.median(middle)


def test_cruise_is_constant_speed():
    motion = Cruise(np.array([0.5, 0.0]), np.array([0.1, -0.2]), 3.0).evaluate([0.0, 2.0])
    np.testing.assert_allclose(motion.q, [[0.5, 0.0], [0.7, -0.4]])
    np.testing.assert_allclose(motion.qd, [[0.1, -0.2]] * 2)
    assert not motion.qdd.any()


def test_quintic_jerk_is_the_derivative_of_its_acceleration_and_a_move_waits_for_its_limit():
    rest, there = (Motion(np.array([q]), np.zeros(1), np.zeros(1)) for q in (0.0, 1.0))
    move = Quintic(rest, there, 2.0)
    t = np.linspace(0.1, 1.9, 20)
    difference = (move.evaluate(t + 1e-5).qdd - move.evaluate(t - 1e-5).qdd) / 2e-5
    np.testing.assert_allclose(move.jerk(t), difference, atol=1e-5)
    free = MotionLimits(*np.array([[-2.0], [2.0], [9.0], [99.0]]))
    # From rest to rest over d in T the jerk peaks at 60 d / T^3.
    gentle = replace(free, jerk=np.array([7.5]))
    assert Quintic.within(gentle, rest, there).duration_s == pytest.approx(2.0, rel=0.15)
    assert Quintic.within(gentle, rest, there).duration_s >= 2.0
    assert Quintic.within(free, rest, there).duration_s == 1.0


def test_the_quickest_move_is_the_first_duration_that_keeps_the_limits_from_moving_starts_too():
    rng = np.random.default_rng(0)
    limits = MotionLimits(np.full(3, -2.0), np.full(3, 2.0), np.array([0.4, 1.0, 2.0]), np.array([0.8, 2.0, 6.0]))
    tried = [1.0]
    while tried[-1] < 100.0:
        tried.append(math.ceil(11.0 * tried[-1]) / 10.0)
    found = []
    for _ in range(40):
        begin = Motion(rng.uniform(-1.5, 1.5, 3), rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.5, 0.5, 3))
        end = still(rng.uniform(-1.5, 1.5, 3))
        kept = [duration for duration in tried if Quintic(begin, end, duration).keeps(limits)]
        if not kept:
            with pytest.raises(UserError, match="no smooth move"):
                Quintic.within(limits, begin, end)
            continue
        found.append(kept[0])
        assert Quintic.within(limits, begin, end).duration_s == kept[0]
    assert len(found) > 20 and len({*found}) > 5


@pytest.mark.parametrize("purpose", PURPOSES)
def test_every_composite_run_keeps_all_limits_begins_and_ends_at_rest_and_goes_through_a_file(purpose, tmp_path):
    run = compose(purpose, NEEDS, START)
    times = np.arange(0.0, run.duration_s, 0.0031)
    motion = run.evaluate(times)
    slack = 1 + 1e-6
    assert np.all(motion.q <= LIMITS.upper) and np.all(motion.q >= LIMITS.lower)
    assert np.all(np.abs(motion.qd) <= LIMITS.velocity * slack)
    assert np.all(np.abs(motion.qdd) <= LIMITS.acceleration * slack)
    assert all(margin.kept for margin in check(run, NEEDS))
    for end in (0.0, run.duration_s):
        np.testing.assert_allclose(run.evaluate(end).at(0), [START, [0, 0], [0, 0]], atol=1e-9)
    # Acceleration is continuous too: nothing jerks.
    for border in run.starts_s()[1:]:
        below, above = run.evaluate([border - 1e-9, border + 1e-9]).qdd
        np.testing.assert_allclose(below, above, atol=1e-5)
    save_trajectory(run, tmp_path / "run.yaml")
    again = load_trajectory(tmp_path / "run.yaml").evaluate(times)
    np.testing.assert_allclose(again, motion, atol=1e-9)
    plan = plan_run(load_trajectory(tmp_path / "run.yaml"), LIMITS, START)
    check_limits(JOINTS, plan.set_points(250.0), LIMITS, 250.0)


def cruises(run):
    return [segment for segment in run.segments if isinstance(segment, Cruise)]


def test_ripple_sweeps_each_joint_alone_in_both_directions_at_two_speeds():
    run = compose("ripple", NEEDS, START)
    for joint in range(2):
        own = [s for s in cruises(run) if s.velocity[joint]]
        assert all(not np.delete(s.velocity, joint).any() for s in own)
        speeds = sorted(s.velocity[joint] for s in own)
        assert len(speeds) == 4 and speeds[0] == pytest.approx(-speeds[3]) and speeds[3] == pytest.approx(2 * speeds[2])
        assert max(abs(s.velocity[joint]) * s.duration_s for s in own) > 1.0


def test_stribeck_and_presliding_stay_slow_where_they_measure():
    run = compose("stribeck", NEEDS, START)
    speeds = {round(float(np.abs(s.velocity).max()), 4) for s in cruises(run)}
    assert min(speeds) == pytest.approx(5e-4) and max(speeds) == pytest.approx(0.1)
    slow = run.segments[2]
    assert np.abs(slow.evaluate(np.linspace(0, 10, 999)).qd).max() == pytest.approx(SLOW_RAD_S, rel=1e-3)
    run = compose("presliding", NEEDS, START)
    series = [s for s in run.segments if hasattr(s, "periods")]
    swings = [np.ptp(s.evaluate(np.linspace(0, s.duration_s, 999)).q[:, 0]) / 2 for s in series]
    np.testing.assert_allclose(swings, [1e-3, 3e-3, 1e-2, 3e-2], rtol=1e-3)
    assert all(np.abs(s.evaluate(np.linspace(0, 9, 999)).qd).max() <= SLOW_RAD_S * 1.001 for s in series)


def test_temperature_comes_back_to_the_same_speeds_again_and_again():
    speeds = [
        round(float(np.abs(s.velocity / LIMITS.velocity).max()), 3)
        for s in cruises(compose("temperature", NEEDS, START))
    ]
    assert speeds[:6] == [0.05, 0.05, 0.2, 0.2, 0.6, 0.6] and speeds == speeds[:6] * 3


def test_elasticity_chirps_one_joint_at_a_time_in_rising_bands():
    run = compose("elasticity", NEEDS, START, ["elbow"])
    chirps = [s for s in run.segments if isinstance(s, Chirp)]
    assert all(s.amplitude[0] == 0.0 < s.amplitude[1] for s in chirps)
    assert [s.start_hz for s in chirps[1:]] == [s.end_hz for s in chirps[:-1]]
    peaks = [np.abs(s.evaluate(np.linspace(0, s.duration_s, 9999)).qdd[:, 1]).max() for s in chirps]
    assert max(peaks) < LIMITS.acceleration[1]


def test_effects_have_experiments_and_only_the_joints_named_move():
    assert set(EXPERIMENT_OF) <= set(EFFECTS) and set(EXPERIMENT_OF.values()) <= set(PURPOSES)
    for effect in ("torque_ripple", "stribeck"):
        run = experiment_for(effect, ARM, LIMITS, needs=NEEDS, start=START, joints=["elbow"])
        moved = np.ptp(run.evaluate(np.arange(0.0, run.duration_s, 0.01)).q, axis=0)
        assert moved[0] < 1e-12 < 0.05 < moved[1]
    general = [experiment_for("payload", ARM, LIMITS, start=START, seed=seed) for seed in (1, 1, 2)]
    t = np.linspace(0.0, 20.0, 50)
    assert np.array_equal(general[0].evaluate(t).q, general[1].evaluate(t).q)
    assert not np.allclose(general[0].evaluate(t).q, general[2].evaluate(t).q)


def test_sweeps_stop_short_of_what_they_would_hit():
    """Over a floor under the arm, the shoulder's free range ends where the stretched arm reaches it."""
    low = replace(NEEDS, clearance=Clearance(ARM, 0.0, np.full(2, -3.0), np.full(2, 3.0)))
    wide = compose("ripple", replace(NEEDS, clearance=None), START, ["shoulder"])
    narrow = compose("ripple", low, START, ["shoulder"])
    spans = [np.ptp(run.evaluate(np.arange(0.0, run.duration_s, 0.01)).q[:, 0]) for run in (narrow, wide)]
    assert spans[0] < spans[1] - 0.3


def test_a_slow_segment_can_follow_any_run():
    run = random_feasible(JOINTS, LIMITS, seed=1, periods=1, start=START).run(LIMITS, START)
    longer = with_slow_segment(run, replace(NEEDS, torque_Nm=np.full(2, np.inf), clearance=None), 2)
    assert longer.duration_s > run.duration_s + 20.0
    tail = longer.evaluate(np.arange(run.duration_s + 6.0, run.duration_s + 20.0, 0.01)).qd
    assert np.abs(tail).max() <= SLOW_RAD_S * 1.001 and np.abs(tail).max() > 0.9 * SLOW_RAD_S


def test_wishes_that_cannot_be_met_are_refused_with_the_reason():
    with pytest.raises(UserError, match="no excitation for 'magic': there are ripple"):
        compose("magic", NEEDS, START)
    with pytest.raises(UserError, match="joint 'knee' is not the arm's"):
        compose("ripple", NEEDS, START, ["knee"])
    with pytest.raises(UserError, match=r"torque of shoulder: .* allowed is 0\.1 N·m"):
        compose("ripple", replace(NEEDS, torque_Nm=np.array([0.1, 0.1])), START)


BAD = {
    "cruise without velocity": (lambda d: d["segments"][2].pop("velocity"), "segment 3: velocity missing"),
    "cruise of three": (lambda d: d["segments"][2].update(velocity=[1, 2, 3]), "velocity must be finite numbers, 2"),
    "chirp backwards": (lambda d: d["segments"][4].update(duration_s=-4), "duration_s must be above zero"),
    "chirp of zero": (lambda d: d["segments"][4].update(start_hz=0), "start_hz must be above zero"),
    "chirp unknown key": (lambda d: d["segments"][4].update(speed=1), "segment 5: unknown key speed"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD.keys())
def test_bad_documents_are_refused_with_their_place(change, message):
    rest = Rest(np.zeros(2), 1.0)
    cruise = Cruise(np.array([0.5, 0.0]), np.array([0.1, 0.0]), 2.0)
    chirp = Chirp(np.zeros(2), np.array([0.01, 0.0]), 1.0, 5.0, 4.0)
    states = [
        rest.evaluate(0.0).at(0),
        cruise.evaluate(0.0).at(0),
        cruise.evaluate(2.0).at(0),
        chirp.evaluate(0.0).at(0),
    ]
    run = Trajectory(JOINTS, (rest, Quintic(*states[:2], 3.0), cruise, Quintic(*states[2:], 3.0), chirp))
    document = trajectory_to_dict(run)
    assert trajectory_from_dict(document).duration_s == pytest.approx(run.duration_s)
    change(document)
    with pytest.raises(UserError, match=message):
        trajectory_from_dict(document)
