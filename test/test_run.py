"""Runs keep the limits: as planned, and stopped at any moment."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_arm import CONFIG, paper_limits

from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.run import Brake, Run, check_limits, limits_of, plan_run
from spacearm_ident.excitation.trajectory import FourierTrajectory, MotionLimits, Rest, Trajectory, random_feasible

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = paper_limits()
DT = 1e-3


def excitation(seed: int = 0, periods: int = 2, usage: float = 0.9) -> FourierTrajectory:
    return random_feasible(JOINTS, LIMITS, seed=seed, fundamental_hz=0.2, periods=periods, usage=usage)


def run(seed: int = 0, usage: float = 0.9) -> Run:
    return plan_run(Trajectory(JOINTS, (excitation(seed, usage=usage),)), LIMITS, np.zeros(6))


def braked(whole: Run, limits: MotionLimits, at_s: float):
    """Positions, velocities and accelerations at DT, from a little before the stop to well at rest."""
    brake = Brake(whole.trajectory, limits, at_s)
    rows = [brake.step(DT) for _ in range(int(20 / DT)) if not brake.at_rest]
    assert brake.at_rest, "did not come to rest in 20 s"
    before = whole.trajectory.evaluate(at_s + DT * np.arange(-5, 1))
    still = brake.step(DT)
    q = np.vstack([before.q, [row.q for row in rows], [still.q] * 5])
    return q, np.array([row.qd for row in rows]), np.array([row.qdd for row in rows])


RUNS = {(seed, usage): run(seed, usage) for seed in range(3) for usage in (0.7, 0.9999)}


@settings(max_examples=60, deadline=None)
@given(key=st.sampled_from(sorted(RUNS)), share=st.floats(0.0, 1.0))
def test_stopped_at_any_moment_every_limit_is_kept(key, share):
    whole = RUNS[key]
    q, qd, qdd = braked(whole, LIMITS, share * whole.duration_s)
    assert np.all(q >= LIMITS.lower) and np.all(q <= LIMITS.upper)
    assert np.all(np.abs(qd) <= LIMITS.velocity)
    assert np.all(np.abs(qdd) <= LIMITS.acceleration)
    # What the drives see: differences of the set-points themselves.
    assert np.all(np.abs(np.diff(q, axis=0)) <= LIMITS.velocity * DT * (1 + 1e-9))
    assert np.all(np.abs(np.diff(q, 2, axis=0)) <= LIMITS.acceleration * DT**2 * 1.02)


@settings(max_examples=20, deadline=None)
@given(share=st.floats(0.05, 0.95))
def test_braking_is_no_slower_than_it_has_to_be(share):
    whole = RUNS[0, 0.7]
    at_s = share * whole.duration_s
    brake = Brake(whole.trajectory, LIMITS, at_s)
    steps = 0
    while not brake.at_rest:
        brake.step(DT)
        steps += 1
    # 0.45 s of softness, and what the slowest joint needs to shed its limit speed, with the path's own share.
    assert steps * DT < 0.5 + 4 * np.max(LIMITS.velocity / LIMITS.acceleration)
    assert at_s < brake.path_s < at_s + steps * DT


def test_the_reported_motion_is_the_derivative_of_the_positions():
    whole = RUNS[1, 0.7]
    q, qd, _ = braked(whole, LIMITS, 0.4 * whole.duration_s)
    centred = (q[7:-5] - q[5:-7]) / (2 * DT)
    assert np.allclose(centred, qd[: len(centred)], atol=2e-5)


def test_a_run_begins_and_ends_at_rest_where_the_arm_was_and_joins_the_excitation():
    series = excitation(seed=4)
    start = np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2])
    still = Rest(series.q0, 1.0)
    for segments in ((series,), (still,)):
        whole = plan_run(Trajectory(JOINTS, segments), LIMITS, start)
        ends = whole.trajectory.evaluate([0.0, whole.duration_s])
        assert np.allclose(ends.q, start, atol=1e-12)
        assert np.allclose(ends.qd, 0.0, atol=1e-9)
        begin, end = whole.periodic
        expected = segments[0].evaluate([0.0])
        assert np.allclose(whole.trajectory.evaluate([begin]).q, expected.q)
        assert end - begin == pytest.approx(segments[0].duration_s)
        motion = whole.set_points(1000.0)
        check_limits(JOINTS, motion, LIMITS, 1000.0)
        assert np.allclose(motion.q[-1], start)


def test_phases_count_the_periods():
    whole = run()
    begin, end = whole.periodic
    period = (end - begin) / 2
    assert whole.phase(0.0) == ("approach", 0)
    assert whole.phase(begin + 0.5 * period) == ("running", 1)
    assert whole.phase(begin + 1.5 * period) == ("running", 2)
    assert whole.phase(end + 1e-6) == ("returning", 0)
    assert whole.phase(whole.duration_s) == ("done", 0)


@pytest.mark.parametrize(
    ("which", "array", "unit"),
    [("upper", "q", "rad,"), ("velocity", "qd", "rad/s,"), ("acceleration", "qdd", "rad/s²,")],
)
def test_a_run_that_leaves_a_limit_is_refused_with_the_joint_and_the_figures(which, array, unit):
    motion = run().set_points(500.0)
    tight = {name: np.array(getattr(LIMITS, name)) for name in ("lower", "upper", "velocity", "acceleration")}
    tight[which][2] = np.max(getattr(motion, array)[:, 2]) - 1e-3
    with pytest.raises(UserError, match="joint_3") as refused:
        check_limits(JOINTS, motion, MotionLimits(**tight), 500.0)
    assert unit in str(refused.value)


def test_set_points_that_are_not_numbers_are_refused():
    motion = run().set_points(100.0)
    motion.q[20, 1] = np.nan
    with pytest.raises(UserError, match=r"joint_2 at nan rad, 0\.20 s"):
        check_limits(JOINTS, motion, LIMITS, 100.0)


def test_a_start_outside_the_limits_is_refused():
    start = np.zeros(6)
    start[3] = LIMITS.upper[3] + 0.1
    with pytest.raises(UserError, match="joint_4 is at"):
        plan_run(Trajectory(JOINTS, (excitation(),)), LIMITS, start)


def test_limits_come_from_the_arm_in_the_trajectorys_order():
    arm = load_arm(CONFIG / "paper_arm.yaml")
    limits = limits_of(arm, JOINTS[::-1])
    assert np.allclose(limits.velocity, LIMITS.velocity[::-1])
    assert np.allclose(limits.lower, LIMITS.lower[::-1])
    with pytest.raises(UserError, match="elbow"):
        limits_of(arm, ("elbow",))


def test_joints_without_limits_can_be_planned():
    urdf = """<robot name="r"><link name="a"/><link name="b"/>
    <joint name="turn" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""
    limits = limits_of(arm_from_urdf(urdf), ["turn"])
    series = FourierTrajectory(("turn",), np.zeros(1), np.array([[0.3]]), np.array([[0.1]]), 0.5, 1)
    whole = plan_run(Trajectory(("turn",), (series,)), limits, np.zeros(1))
    check_limits(("turn",), whole.set_points(100.0), limits, 100.0)
