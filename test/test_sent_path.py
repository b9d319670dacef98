"""A run as one message, its stop as another, and the eye on the arm: computed, without a graph."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_arm import paper_limits

pytest.importorskip("rclpy", reason="needs ROS 2 (pip install '.[ros]')")

from spacearm_ident.excitation.joint_trajectory import SETTLE_S
from spacearm_ident.excitation.run import plan_run
from spacearm_ident.excitation.trajectory import Trajectory, random_feasible
from spacearm_ident.nodes.trajectory import LONGEST_LAG_S
from spacearm_ident.nodes.trajectory_path import REPLACE_S, PathWatch, SentPath

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = paper_limits()
HOME = np.array([0.1, -0.1, 0.05, 0.2, -0.2, 0.1])
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def run():
    series = random_feasible(JOINTS, LIMITS, seed=3, fundamental_hz=0.5, periods=2, usage=0.8, start=HOME)
    return plan_run(Trajectory(JOINTS, (series,)), LIMITS, HOME)


class Clock:
    """A graph's clock that stands until it is told to go on."""

    def __init__(self):
        self.ns = START_NS

    def __call__(self):
        return self.ns

    def at(self, sent, time_s):
        """Let it be so many seconds after the start of the run."""
        self.ns = sent.start_ns + round(1e9 * time_s)


def begun(run, **options):
    clock, messages = Clock(), []
    return SentPath(run, LIMITS, messages.append, clock, **options), clock, messages


def points(message):
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    arrays = (np.array([getattr(p, name) for p in message.points]) for name in ("positions", "velocities"))
    return times, *arrays


def test_the_whole_run_is_one_message_in_the_controllers_order(run):
    order = tuple(reversed(JOINTS))
    sent, clock, (message,) = begun(run, order=order, rate_hz=100.0)
    assert tuple(message.joint_names) == order and sent.start_ns == START_NS + round(1e9 * SETTLE_S)
    # Zero: to begin when it arrives, whatever the controller's clock says.
    assert message.header.stamp.sec == message.header.stamp.nanosec == 0
    times, q, qd = points(message)
    wanted = run.trajectory.evaluate(times - SETTLE_S)
    np.testing.assert_allclose(q, wanted.q[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(qd, wanted.qd[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(q[[0, -1]], [HOME[::-1]] * 2, atol=1e-9)
    clock.at(sent, run.periodic[0] + 0.1)
    assert sent.moving and sent.phase == ("running", 1)
    clock.at(sent, run.duration_s + 0.01)
    assert not sent.moving and sent.phase.state == "done"


@pytest.mark.parametrize("time_s", [-0.3, 0.05, 1.5, 3.0, 4.4])
def test_a_stop_leads_along_the_path_to_rest_within_the_limits(run, time_s):
    sent, clock, messages = begun(run)
    clock.at(sent, time_s)
    sent.stop("enough")
    sent.stop("again")
    assert sent.reason == "enough" and len(messages) == 2
    times, q, qd = points(messages[1])
    assert times[0] == pytest.approx(REPLACE_S)
    # It takes over where the run will be when it is there.
    np.testing.assert_allclose(q[0], run.trajectory.evaluate(max(0.0, time_s + REPLACE_S)).q[0], atol=1e-9)
    assert np.allclose(qd[-1], 0.0, atol=1e-9)
    if len(times) > 2:
        velocity = np.diff(q, axis=0) / np.diff(times)[:, None]
        assert np.all(np.abs(velocity) <= LIMITS.velocity * 1.001)
        acceleration = np.diff(velocity, axis=0) / np.diff(times)[1:, None]
        assert np.all(np.abs(acceleration) <= LIMITS.acceleration * 1.05)
    assert sent.moving or time_s < 0
    clock.at(sent, time_s + times[-1] + 0.01)
    assert not sent.moving


def watch(run, tolerance=0.1):
    return PathWatch(JOINTS, run.set_points(1000.0), 1000.0, tolerance, LONGEST_LAG_S)


def test_an_arm_on_its_path_is_followed_with_its_lag(run):
    eye = watch(run)
    for time_s in np.arange(0.0, run.duration_s, 0.05):
        lag = 0.12 * min(1.0, time_s)
        position = run.trajectory.evaluate(time_s - lag).q[0]
        assert eye.judge(position, time_s) == ""
    for time_s in (1.2, 2.0, 3.1):
        eye.judge(run.trajectory.evaluate(time_s - 0.12).q[0], time_s)
        assert eye.lag_s == pytest.approx(0.12, abs=0.01)


def test_an_arm_that_stays_behind_or_leaves_the_path_is_told(run):
    eye, said = watch(run), ""
    for time_s in np.arange(0.0, run.duration_s, 0.05):
        said = eye.judge(run.trajectory.evaluate(0.5 * time_s).q[0], time_s)
        if said:
            break
    assert "behind the run" in said or "does not follow" in said
    off = run.trajectory.evaluate(2.0).q[0] + np.array([0, 0, 0.4, 0, 0, 0])
    assert "does not follow: joint_3 is " in watch(run).judge(off, 2.0)


def test_an_arm_that_rests_where_the_path_rests_has_no_lag(run):
    eye = watch(run)
    assert eye.judge(HOME, 0.0) == "" and eye.lag_s == 0.0
    assert eye.judge(HOME, -0.4) == "" and eye.lag_s == 0.0


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_of_an_arm_whose_other_joints_follow_the_joint_that_does_not_is_named(run, joint, lag):
    eye, named = watch(run, 0.02), []
    for time_s in np.arange(0.6, run.duration_s, 0.05):
        position = run.trajectory.evaluate(time_s - lag).q[0]
        there, position[joint] = position[joint], run.trajectory.evaluate(time_s - lag - 0.4).q[0, joint]
        said = eye.judge(position, time_s)
        if "does not follow" in said:
            words = said.split()
            named.append(words[5])
            # Where it should have been, but for a set-point.
            assert float(words[7]) == pytest.approx(abs(there - position[joint]), abs=0.01)
    assert len(named) > 5 and set(named) == {f"joint_{joint + 1}"}


def test_of_two_joints_the_one_that_left_the_path_is_named_not_the_one_that_is_on_time(run):
    motion = run.set_points(1000.0)
    eye = PathWatch(JOINTS[:2], type(motion)(*(values[:, :2] for values in motion)), 1000.0, 0.1, LONGEST_LAG_S)
    off = run.trajectory.evaluate(2.0).q[0, :2] + np.array([0.0, 0.4])
    assert eye.judge(off, 2.0).startswith("the arm does not follow: joint_2 is 0.4")
