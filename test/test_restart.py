"""Driver, trajectory node and simulated arm as processes: which broken-off runs are begun again, and which are not."""

import re
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (pip install '.[ros]')")

from driven_arm import CONFIG, EMERGENCY, JOINTS, DrivenArm
from live_nodes import LIVE, output
from simulated_arm import paper_limits

from spacearm_ident.excitation.trajectory import Trajectory, random_feasible
from spacearm_ident.excitation.trajectory_file import save_trajectory

pytestmark = LIVE

HELD_UP_S = 0.6
"""Longer than the driver's delay (0.4 s in these tests), shorter than the drives' patience with its heartbeat."""


@pytest.fixture(scope="module")
def live(tmp_path_factory):

    folder = tmp_path_factory.mktemp("restart")
    files = {3: folder / "excitation.yaml", 2: folder / "other.yaml"}
    for periods, file in files.items():
        series = random_feasible(
            JOINTS,
            paper_limits(),
            seed=4,
            fundamental_hz=0.5,
            harmonics=2,
            periods=periods,
            usage=0.5,
            smallest_usage=0.49,
        )
        save_trajectory(Trajectory(JOINTS, (series,)), file)
    arm = DrivenArm(folder)
    arm.file, arm.other = files.values()
    try:
        arm.node = arm.processes.node(
            "trajectory",
            f"trajectory_file:={arm.file}",
            f"arm:={CONFIG / 'paper_arm.yaml'}",
            "feedback_timeout_s:=2.0",
            "restarts:=2",
        )
        arm.said = []
        arm.probe.hear_runs(arm.said)
        yield arm
    finally:
        arm.close()


@pytest.fixture
def arm(live):
    live.healthy()
    live.probe.wait_for(
        lambda: live.probe.values("trajectory").get("drives_enabled") == "true", "the node hears the driver"
    )
    live.said.clear()
    # A run that was stopped left the arm on its way: from there one must be planned within the limits.
    return live


def running(arm):
    """Start, and wait until the arm is in the periodic part, at full speed; returns the run's id."""
    arm.probe.wait_for(lambda: arm.at_rest(), "rest")
    arm.probe.must("/excitation/start")
    arm.wait_for(lambda: arm.said and arm.said[-1]["state"] == "running", "running")
    arm.probe.spin(0.7)
    return arm.said[-1]["run"]


def the_end(arm):
    """The state in which nothing more comes of a run."""
    arm.probe.wait_for(lambda: arm.said[-1]["state"] == "done", f"the end; last {arm.said[-1:]}", 90.0)
    return arm.said[-1]


def hold_up(arm):
    arm.driver.send_signal(signal.SIGSTOP)
    time.sleep(HELD_UP_S)
    arm.driver.send_signal(signal.SIGCONT)


def test_a_run_that_a_held_up_driver_broke_off_is_begun_again_and_completed(arm):
    first = running(arm)
    hold_up(arm)
    last = the_end(arm)
    assert last["complete"] is True and last["restarts"] == 1 and last["reason"] == ""
    assert last["begun_as"] == first != last["run"]
    states = [state["state"] for state in arm.said]
    assert "recovering" in states and states.index("recovering") < len(states) - states[::-1].index("running")
    broken = next(state for state in arm.said if state["state"] == "recovering")
    assert broken["run"] == first and broken["complete"] is False
    assert "the drives are no longer enabled (set-points missing: the cycle was held up" in broken["reason"]
    recovered = r"arm stopped: (set-points missing: .*)\n(?s:.*)arm recovered, enabled now; it was stopped by: \1\n"
    assert re.search(recovered, output(arm.driver)), "the stop is not the last that is known of the driver"
    assert "done" not in states[:-1], "whoever waits for the end must not see one before"
    arm.probe.wait_for(
        lambda: "begun again 1 of 2 times" in arm.probe.statuses["trajectory"].message, "it on /diagnostics"
    )


def use(arm, path):
    """Set the parameter that names the file of the next run."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = arm.probe.node.create_client(SetParameters, "/trajectory/set_parameters")
    arm.probe.wait_for(client.service_is_ready, "parameters")
    wanted = [Parameter("trajectory_file", value=str(path)).to_parameter_msg()]
    future = client.call_async(SetParameters.Request(parameters=wanted))
    arm.probe.wait_for(future.done, "the parameter is set")
    assert future.result().results[0].successful


def test_what_is_begun_again_is_the_trajectory_that_was_started_whatever_file_is_named_since(arm):
    first = running(arm)
    arm.file.rename(arm.file.with_suffix(".gone"))
    use(arm, "")
    use(arm, arm.other)
    try:
        hold_up(arm)
        last = the_end(arm)
        assert last["complete"] is True and last["restarts"] == 1 and last["begun_as"] == first != last["run"]
        assert last["periods"] == 3
        said = output(arm.node)
        for run in (first, last["run"]):
            assert re.search(rf"run {run} begins: .* 3 periods, of {arm.file}\n", said)
        for named in ("none", arm.other):
            assert f"trajectory_file: {named} is for the next /excitation/start; run {first}, also where it" in said
        arm.said.clear()
        second = running(arm)
        assert arm.said[-1]["periods"] == 2 and f"2 periods, of {arm.other}" in output(arm.node)
        assert arm.call("/excitation/stop")[0]
        assert the_end(arm)["run"] == second
        use(arm, arm.other)
        assert output(arm.node).count("is for the next /excitation/start") == 2, (
            "nothing goes on: nothing to tell apart"
        )
    finally:
        arm.file.with_suffix(".gone").rename(arm.file)
        use(arm, arm.file)


def test_after_as_many_restarts_as_allowed_it_gives_up_with_the_reason(arm):
    running(arm)
    for attempt in range(3):
        arm.wait_for(
            lambda n=attempt: arm.said[-1]["state"] == "running" and arm.said[-1]["restarts"] == n, f"run {attempt}"
        )
        arm.probe.spin(0.5)
        hold_up(arm)
    last = the_end(arm)
    assert last["complete"] is False and last["restarts"] == 2
    assert last["reason"].endswith("begun again 2 times, then given up") and "held up" in last["reason"]


def test_nothing_is_begun_again_after_a_halt(arm):
    running(arm)
    assert arm.call("/driver/halt")[0]
    last = the_end(arm)
    assert last["complete"] is False and last["restarts"] == 0
    assert "not begun again: not resumed: /driver/halt was called" in last["reason"]
    assert not arm.enabled and "halt" in arm.fault
    assert not arm.call("/driver/resume")[0]


def test_nothing_is_begun_again_after_a_halt_that_came_upon_a_held_up_cycle(arm):
    """A person who presses stop while the machine is about to begin again is heard."""
    running(arm)
    arm.driver.send_signal(signal.SIGSTOP)
    time.sleep(HELD_UP_S)
    arm.driver.send_signal(signal.SIGCONT)
    # Called once it is awake: the set-points of this while have filled its socket, and what is dropped there DDS sends
    # again seconds later. It has stopped for the stall by then; nobody asks it to resume before the arm is at rest.
    assert arm.call("/driver/halt")[0]
    last = the_end(arm)
    assert last["restarts"] == 0 and "/driver/halt was called" in last["reason"]
    assert not arm.enabled


def test_nothing_is_begun_again_after_an_emergency_of_a_drive(arm):
    running(arm)
    arm.inject(2, EMERGENCY, 0x3210)
    last = the_end(arm)
    assert last["complete"] is False and last["restarts"] == 0
    assert "no held-up cycle was the cause" in last["reason"] and not arm.enabled


def test_nothing_is_begun_again_after_the_drives_were_disabled(arm):
    running(arm)
    assert arm.call("/driver/enable", False)[0]
    last = the_end(arm)
    assert last["restarts"] == 0
    assert "not begun again: nothing to resume from" in last["reason"] and not arm.enabled


def test_a_stop_while_about_to_begin_again_is_heard(arm):
    running(arm)
    hold_up(arm)
    arm.wait_for(lambda: arm.said[-1]["state"] in ("stopping", "recovering"), "the stop")
    arm.call("/excitation/stop")
    before = len(arm.said)
    last = the_end(arm)
    assert last["complete"] is False
    assert not any(state["state"] == "approach" for state in arm.said[before:])
    position = arm.position()
    arm.probe.spin(1.0)
    assert np.abs(arm.position() - position).max() < 1e-3
