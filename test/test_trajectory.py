"""Trajectories: derivatives, ends, limits, and what their files accept."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import (
    FourierTrajectory,
    Motion,
    MotionLimits,
    Quintic,
    Rest,
    Trajectory,
    random_feasible,
)
from spacearm_ident.excitation.trajectory_file import (
    load_trajectory,
    save_trajectory,
    trajectory_from_dict,
    trajectory_to_dict,
)

JOINTS = ("shoulder", "elbow")
LIMITS = MotionLimits(np.array([-2.0, -0.3]), np.array([2.0, 1.5]), np.array([1.0, 2.0]), np.array([3.0, 2.0]))

coefficients = arrays(float, (2, 3), elements=st.floats(-2, 2))
states = arrays(float, (3, 2), elements=st.floats(-2, 2))


def assert_derivatives_match(trajectory, t):
    """Central differences, whose error is of third derivatives times h²."""
    h = 1e-4
    before, here, after = (trajectory.evaluate(t + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), here.qd, atol=1e-4)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), here.qdd, atol=1e-4)


@given(coefficients, coefficients, st.floats(0.05, 0.3))
def test_fourier_derivatives_are_those_of_its_position(a, b, fundamental):
    series = FourierTrajectory(JOINTS, np.array([0.3, -1.0]), a, b, fundamental, 2)
    assert_derivatives_match(series, np.linspace(0.0, 7.0, 40))


@given(states, states, st.floats(1.0, 8.0))
def test_quintic_derivatives_are_those_of_its_position_and_it_meets_both_states(start, end, duration):
    move = Quintic(Motion(*start), Motion(*end), duration)
    assert_derivatives_match(move, np.linspace(0.01, duration - 0.01, 40))
    np.testing.assert_allclose(move.evaluate(0.0).at(0), start, atol=1e-9)
    np.testing.assert_allclose(move.evaluate(duration).at(0), end, atol=1e-9)


def test_fourier_is_the_formula_of_the_paper():
    """Eq. 9 with one harmonic a/ω sin ωt − b/ω cos ωt at a quarter period: q0 + a/ω, −b... of eq. 10."""
    series = FourierTrajectory(("j",), np.array([0.5]), np.array([[2.0]]), np.array([[3.0]]), 0.25, 1)
    omega = 0.5 * np.pi
    motion = series.evaluate([0.0, 1.0])
    np.testing.assert_allclose(motion.q[:, 0], [0.5 - 3 / omega, 0.5 + 2 / omega])
    np.testing.assert_allclose(motion.qd[:, 0], [2.0, 3.0])
    np.testing.assert_allclose(motion.qdd[:, 0], [3.0 * omega, -2.0 * omega])


@given(st.integers(0, 10_000), st.sampled_from([0.05, 0.1, 0.2]))
@settings(max_examples=25, deadline=None)
def test_random_trajectories_and_their_whole_run_keep_the_limits_and_begin_and_end_still(seed, hz):
    series = random_feasible(JOINTS, LIMITS, seed=seed, fundamental_hz=hz, periods=2, start=[0.1, 0.2])
    run = series.run(LIMITS, start=[0.1, 0.2], rest_s=0.5)
    motion = run.evaluate(np.arange(0.0, run.duration_s, 0.0037))
    slack = 1 + 1e-4
    assert np.all(motion.q >= LIMITS.lower * slack) and np.all(motion.q <= LIMITS.upper * slack)
    assert np.all(np.abs(motion.qd) <= LIMITS.velocity * slack)
    assert np.all(np.abs(motion.qdd) <= LIMITS.acceleration * slack)
    for t in (0.0, 0.25, run.duration_s - 0.25, run.duration_s):
        state = run.evaluate(t).at(0)
        np.testing.assert_allclose(state, [[0.1, 0.2], [0, 0], [0, 0]], atol=1e-12)
    # Acceleration is continuous at every border, not only position and velocity.
    for border in run.starts_s()[1:]:
        below, above = run.evaluate([border - 1e-9, border + 1e-9]).qdd
        np.testing.assert_allclose(below, above, atol=1e-6)
    assert LIMITS.usage(series.evaluate(np.linspace(0, 20, 5001))).min() > 0.3


def test_random_trajectories_repeat_with_their_seed_and_differ_without():
    one, same, other = (random_feasible(JOINTS, LIMITS, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.a, same.a)
    assert np.abs(one.a - other.a).max() > 0.01


@given(coefficients, coefficients, st.floats(-3, 12))
def test_a_shifted_series_is_the_same_motion_later(a, b, shift):
    series = FourierTrajectory(JOINTS, np.array([0.3, -1.0]), a, b, 0.2, 2)
    t = np.linspace(0.0, 6.0, 30)
    for have, want in zip(series.shifted(shift).evaluate(t), series.evaluate(t + shift), strict=True):
        np.testing.assert_allclose(have, want, atol=1e-9)


FAR = MotionLimits(*np.array([[-5.0, -1.0], [5.0, 1.0], [0.3, 3.0], [1.0, 9.0]]))
FAST = np.array([[0.0], [1.8]])


def test_a_fast_joint_keeps_its_range_while_a_far_one_takes_long_to_arrive(tmp_path):
    """No single fifth-order move of the twelve seconds joint 1 needs keeps joint 2 within ±1 rad."""
    series = FourierTrajectory(JOINTS, np.array([2.0, 0.0]), FAST, 0 * FAST, 1 / np.pi, 2)
    run = series.run(FAR)
    motion = run.evaluate(np.arange(0.0, run.duration_s, 0.01))
    assert FAR.usage(motion).max() <= 1.0 + 1e-4
    assert len(run.segments) == 9
    save_trajectory(run, tmp_path / "run.yaml")
    again = load_trajectory(tmp_path / "run.yaml").evaluate(np.linspace(0.0, run.duration_s, 200))
    np.testing.assert_allclose(again.q, run.evaluate(np.linspace(0.0, run.duration_s, 200)).q, atol=1e-12)


def test_a_series_can_be_begun_where_its_run_is_quickest():
    series = FourierTrajectory(JOINTS, np.array([0.4, 0.0]), FAST, 0 * FAST, 1 / np.pi, 2)
    begun = series.begun_where_joinable(FAR)
    quickest = begun.run(FAR).duration_s
    others = [series.shifted(s).run(FAR).duration_s for s in np.linspace(0.0, series.period_s, 8)[:-1]]
    assert quickest <= min(others) and quickest < max(others) - 0.5
    swing = begun.evaluate(np.linspace(0.0, 4.0, 1000)).q[:, 1]
    assert np.ptp(swing) == pytest.approx(1.8, abs=0.01)


def test_every_period_repeats_the_first():
    series = random_feasible(JOINTS, LIMITS, seed=5, periods=3)
    run = series.run(LIMITS)
    start = run.starts_s()[2]
    t = np.linspace(0.0, 9.9, 50)
    first, third = run.evaluate(start + t), run.evaluate(start + 2 * series.period_s + t)
    np.testing.assert_allclose(first.q, third.q, atol=1e-12)


def test_outside_its_time_a_run_holds_its_ends():
    moving = random_feasible(JOINTS, LIMITS, seed=1)
    run = Trajectory(JOINTS, (moving,))
    outside = run.evaluate([-3.0, run.duration_s + 3.0])
    np.testing.assert_allclose(outside.q, moving.evaluate([0.0, moving.duration_s]).q, atol=1e-12)
    assert not outside.qd.any() and not outside.qdd.any()


def test_a_start_posture_outside_the_limits_is_refused():
    with pytest.raises(UserError, match="start posture"):
        random_feasible(JOINTS, LIMITS, seed=1).run(LIMITS, start=[5.0, 0.0])
    with pytest.raises(UserError, match="start posture"):
        random_feasible(JOINTS, LIMITS, seed=1, start=[5.0, 0.0])


def test_neighbours_that_do_not_join_are_refused():
    with pytest.raises(UserError, match=r"segment 2 starts 1 rad.*quintic"):
        Trajectory(JOINTS, (Rest(np.zeros(2), 1.0), Rest(np.ones(2), 1.0)))


@given(st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_files_load_back_to_the_same_motion(tmp_path_factory, seed):
    path = tmp_path_factory.mktemp("trajectory") / "run.yaml"
    run = random_feasible(JOINTS, LIMITS, seed=seed, fundamental_hz=0.13).run(LIMITS, rest_s=0.7)
    save_trajectory(run, path)
    again = load_trajectory(path)
    assert again.joints == JOINTS
    t = np.linspace(-1.0, run.duration_s + 1.0, 500)
    for have, want in zip(again.evaluate(t), run.evaluate(t), strict=True):
        # The return leaves from the state at the end of the last period, equal to the first but for rounding.
        np.testing.assert_allclose(have, want, rtol=0, atol=1e-12)


def changed(change):
    document = trajectory_to_dict(random_feasible(JOINTS, LIMITS, seed=2).run(LIMITS))
    change(document)
    return document


BAD = {
    "no mapping": (lambda d: d.clear(), "schema, joints, segments missing"),
    "other schema": (lambda d: d.update(schema="spacearm_ident/trajectory/9"), "this program reads"),
    "unknown key": (lambda d: d.update(speed=3), "unknown key speed"),
    "joint twice": (lambda d: d.update(joints=["a", "a"]), "twice"),
    "joints no list": (lambda d: d.update(joints="a"), "list of joint names"),
    "no segments": (lambda d: d.update(segments=[]), "at least one segment"),
    "unknown kind": (lambda d: d["segments"][0].update(kind="wobble"), "segment 1: kind 'wobble' is unknown"),
    "kind a list": (lambda d: d["segments"][0].update(kind=[1]), "segment 1: kind"),
    "segment no mapping": (lambda d: d["segments"].__setitem__(0, 7), "segment 1: kind None"),
    "unknown segment key": (lambda d: d["segments"][2].update(q1=[0, 0]), "segment 3: unknown key q1"),
    "missing segment key": (lambda d: d["segments"][2].pop("b"), "segment 3: b missing"),
    "negative duration": (lambda d: d["segments"][1].update(duration_s=-1), "duration_s must be above zero"),
    "not a number": (lambda d: d["segments"][2].update(q0=["x", 1]), "q0 must be finite numbers, 2"),
    "nan": (lambda d: d["segments"][2].update(q0=[float("nan"), 1]), "finite"),
    "ragged": (lambda d: d["segments"][2].update(a=[[1, 2], [1]]), "a must be finite numbers, 2 × any"),
    "b unlike a": (lambda d: d["segments"][2].update(b=[[1.0], [1.0]]), "b must be finite numbers, 2 × 5"),
    "half a period": (lambda d: d["segments"][2].update(periods=2.5), "whole number"),
    "quintic at the end": (lambda d: d["segments"].pop(), "segment 4: a quintic joins"),
    "jump": (lambda d: d["segments"].pop(1), "segment 2 starts .* put a quintic"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD.keys())
def test_bad_documents_are_refused_with_their_place(change, message):
    with pytest.raises(UserError, match=message):
        trajectory_from_dict(changed(change))


def test_bad_files_are_refused_with_their_name(tmp_path):
    with pytest.raises(UserError, match=r"cannot read the trajectory .*nowhere.yaml"):
        load_trajectory(tmp_path / "nowhere.yaml")
    (tmp_path / "broken.yaml").write_text("segments: [")
    with pytest.raises(UserError, match=r"broken.yaml is not valid YAML"):
        load_trajectory(tmp_path / "broken.yaml")
    (tmp_path / "list.yaml").write_text(yaml.safe_dump([1, 2]))
    with pytest.raises(UserError, match=r"list.yaml: the file must be a mapping"):
        load_trajectory(tmp_path / "list.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"joints: [\xe9\xff]")
    with pytest.raises(UserError, match=r"cannot read the trajectory .*latin.yaml"):
        load_trajectory(tmp_path / "latin.yaml")
