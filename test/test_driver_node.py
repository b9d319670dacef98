"""Driver and simulated arm as processes, over the local bus and real DDS: the good day, and every bad one."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (pip install '.[ros]')")

from driven_arm import CORRUPT, EMERGENCY, FREEZE, JOINTS, BusWatch, DrivenArm, generous_config, smooth
from live_nodes import LIVE, PATIENCE_S, output

from spacearm_ident.config import config_path
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.driver.arm_driver import ArmDriver

pytestmark = LIVE

STOPPED = {"quick stop active", "fault", "switch on disabled"}


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    arm = DrivenArm(tmp_path_factory.mktemp("driver"))
    try:
        yield arm
    finally:
        arm.close()


@pytest.fixture
def arm(live):
    live.healthy()
    live.home()
    return live


def stopped_by(arm, words):
    """The arm is stopped with this reason, stays so, and says so to who wants to go on."""
    arm.wait_for(lambda: arm.fault, "a fault")
    assert words in arm.fault
    assert not arm.enabled and arm.probe.level("canopen_driver") == 2
    assert arm.probe.statuses["canopen_driver"].message == arm.fault
    arm.wait_for(lambda: set(arm.drive_states().values()) <= STOPPED, "all drives stopped")
    accepted, message = arm.call("/driver/enable", True)
    assert not accepted and "recover" in message


def recovers(arm):
    """Recovering moves nothing, and the arm can be enabled again."""
    before = arm.position()
    arm.probe.must("/driver/recover")
    arm.wait_for(lambda: not arm.fault and set(arm.drive_states().values()) == {"switch on disabled"}, "recovery")
    assert np.abs(arm.position() - before).max() < 0.01
    arm.healthy()


def moving(arm, upset, after_s=0.9):
    """Stream a motion, upset it on the way, go on streaming until the driver has stopped the arm."""
    begin = time.monotonic()

    def until():
        nonlocal upset
        if upset is not None and time.monotonic() - begin > after_s:
            upset, act = None, upset
            act()
        return bool(arm.fault)

    arm.stream(6.0, lambda t: smooth(t, period=6.0), until=until)


# The good day ---------------------------------------------------------------------------------------


def test_the_arm_follows_a_streamed_motion_and_reports_sensible_torques(arm):
    arm.payloads.clear()
    arm.currents.clear()
    start = arm.position()
    first = arm.stream(2.0)
    arm.wait_for(lambda: arm.states(arm.payloads[-1:])[0][0] > first + 2_600_000_000, "the end of the motion")
    stamps, position, effort = arm.states()
    assert np.all(np.diff(stamps) > 0)
    due = np.array([smooth(1e-9 * (stamp - first) - 0.4) if 0.4 <= 1e-9 * (stamp - first) <= 2.4 else 0.0
                    for stamp in stamps.tolist()])  # fmt: skip
    error = position - start - due[:, None]
    assert np.sqrt(np.mean(error**2)) < 0.005
    assert np.ptp(position, axis=0).min() > 0.05
    limit = np.array([joint.effort_limit for joint in load_arm_can(config_path("paper_arm_can.yaml")).arm.joints])
    assert np.all(np.abs(effort) <= 1.25 * limit)
    # Moving forth and back, friction turns round: at least the Coulomb level of the model on either side.
    forth, back = np.gradient(due) > 2e-5, np.gradient(due) < -2e-5
    assert np.all(effort[forth].mean(axis=0) - effort[back].mean(axis=0) > 2 * 3.0)


def test_currents_are_torques_without_torque_constant_and_gear(arm):
    arm.wait_for(lambda: len(arm.currents) > 50, "currents")
    currents = dict(zip(*[arm.states(arm.currents)[k].tolist() for k in (0, 2)]))
    stamps, _, effort = arm.states()
    joints = load_arm_can(arm.can_config).arm.joints
    constant = np.array([joint.torque_constant * joint.gear_ratio for joint in joints])
    common = [k for k, stamp in enumerate(stamps.tolist()) if stamp in currents]
    assert common
    for k in common:
        np.testing.assert_allclose(effort[k], constant * currents[stamps[k]], rtol=1e-12)


def test_description_temperatures_and_loads_are_on_the_graph(arm):
    from sensor_msgs.msg import Temperature
    from std_msgs.msg import String

    from spacearm_ident.nodes.runtime import LATCHED

    urdf, warm = [], {}
    node = arm.probe.node
    node.create_subscription(String, "/robot_description", lambda m: urdf.append(m.data), LATCHED)
    node.create_subscription(
        Temperature, "/joint_temperatures", lambda m: warm.setdefault(m.header.frame_id, m.temperature), 10
    )
    arm.wait_for(lambda: urdf and set(warm) == set(JOINTS), "description and temperatures")
    assert "<robot" in urdf[0] and all(19.0 < value < 60.0 for value in warm.values())
    assert "worst case 41 %" in arm.values["bus_0_load"] and "41 %" in arm.values["bus_1_load"]
    for name in ("missed_cycles", "incomplete_cycles", "late_frames", "samples"):
        assert int(arm.values[name]) >= 0


def test_the_sender_of_the_middleware_never_keeps_a_core_from_who_it_waits_for(arm):
    """Fast DDS's sender asks in a loop for what another thread holds (ros2/rmw_fastrtps issue 666)."""
    for process in (arm.driver, arm.arm):
        tasks = list(Path(f"/proc/{process.pid}/task").iterdir())
        priority = {task: os.sched_getparam(int(task.name)).sched_priority for task in tasks}
        middleware = {task for task in tasks if (task / "comm").read_text().startswith("dds.")}
        senders = {task for task in middleware if (task / "comm").read_text().startswith("dds.asyn")}
        if not senders or not any(priority.values()):
            pytest.skip("another middleware than Fast DDS, or no real-time priority here")
        others = middleware - senders
        assert max(priority[task] for task in senders) < min(priority[task] for task in others)


def test_enabling_twice_and_disabling_is_no_fault(arm):
    assert arm.call("/driver/enable", True) == (True, "enabled already")
    assert arm.call("/driver/recover")[0]
    assert arm.call("/driver/enable", False)[0]
    arm.wait_for(lambda: set(arm.drive_states().values()) == {"switch on disabled"}, "disabled")
    assert not arm.fault and not arm.enabled


def test_whoever_is_answered_that_the_drives_are_enabled_may_rely_on_others_knowing_it(arm):
    """A run that is asked for next is refused by a trajectory node that has not heard of it."""
    for wanted in (False, True) * 5:
        arm.probe.must("/driver/enable", wanted)
        assert arm.probe.values("canopen_driver")["operation_enabled"] == str(wanted).lower()


def test_disabling_in_motion_stops_first(arm):
    moving_until = []
    arm.stream(6.0, lambda t: smooth(t, period=6.0), until=lambda: len(moving_until) > 60 or moving_until.append(0))
    done, message = arm.call("/driver/enable", False)
    assert done and arm.at_rest() and not arm.fault, message


def test_a_driver_that_is_held_up_for_a_moment_goes_on_along_the_path(arm):
    """As a kernel or a hypervisor does it, at speed and twice."""
    bridged, start, begin = int(arm.values["stalls_bridged"]), arm.position(), time.monotonic()
    moments = [1.4, 2.4]

    def until():
        if moments and time.monotonic() - begin > moments[0]:
            moments.pop(0)
            arm.driver.send_signal(signal.SIGSTOP)
            time.sleep(0.03)
            arm.driver.send_signal(signal.SIGCONT)
        return bool(arm.fault)

    first = arm.stream(3.0, lambda t: smooth(t, amplitude=0.4, period=3.0), until=until)
    arm.wait_for(lambda: arm.fault or arm.states(arm.payloads[-1:])[0][0] > first + 3_600_000_000, "the motion's end")
    assert not arm.fault and not moments
    arm.wait_for(lambda: int(arm.values["stalls_bridged"]) >= bridged + 2, "the stalls on /diagnostics")
    assert arm.enabled and float(arm.values["playback_lag_s"]) == 0.0
    assert np.abs(arm.position() - start).max() < 0.01


# Bad days -------------------------------------------------------------------------------------------


def test_halt_stops_a_motion_and_is_latched(arm):
    moving(arm, lambda: arm.call("/driver/halt"))
    stopped_by(arm, "halt")
    assert arm.at_rest()
    recovers(arm)


@pytest.mark.parametrize(
    "position, words",
    [
        ([0, np.nan, 0, 0, 0, 0], "joint_2 was asked to go to nan"),
        ([9, 0, 0, 0, 0, 0], "joint_1 was asked to go to 9.0"),
        ([0, 0, 0, 0, 0, 0.01], "joint_6 was asked to"),
    ],
    ids=["nan", "position", "jump"],
)
def test_bad_set_points_stop_the_arm(arm, position, words):
    arm.stream(6.0, lambda t: smooth(t, period=6.0), until=lambda: bool(arm.fault),
               also=lambda k, q: q + np.array(position) if k == 900 else q)  # fmt: skip
    stopped_by(arm, words)
    assert arm.at_rest()
    recovers(arm)


def test_after_a_stop_on_the_way_the_arm_is_held_where_it_is_not_where_it_was_going(arm):
    moving(arm, lambda: arm.call("/driver/halt"), after_s=2.5)
    stopped_by(arm, "halt")
    with BusWatch() as watch:
        arm.probe.spin(0.05)
        recovers(arm)
        arm.probe.spin(0.3)
    for joint, scale in enumerate(load_arm_can(arm.can_config).bus.scales):
        positions = np.array([position for _, position in watch.feedback(joint)])
        enabled = [target for _, target, word in watch.set_points(joint) if word & 0x0F == 0x0F]
        assert enabled
        tolerance = 5e-4 * scale.counts_per_turn * scale.gear_ratio / (2 * np.pi)
        assert np.abs(np.array(enabled) - positions[-1]).max() < tolerance
        assert np.ptp(positions) < tolerance


def test_set_points_of_other_joints_stop_the_arm(arm):
    from sensor_msgs.msg import JointState

    stranger = arm.probe.node.create_publisher(JointState, "/joint_command", 10)
    arm.wait_for(lambda: stranger.get_subscription_count() > 0, "the driver's subscription")
    stranger.publish(JointState(name=["elbow"], position=[0.0]))
    stopped_by(arm, "must name each of the arm's joints")
    recovers(arm)


def test_a_stream_that_breaks_off_stops_the_arm(arm):
    arm.stream(1.5, lambda t: smooth(t, period=6.0))
    stopped_by(arm, "no set-point for")
    assert arm.at_rest()
    recovers(arm)


def test_an_emergency_of_one_drive_stops_all_within_a_cycle(arm):
    with BusWatch() as watch:
        moving(arm, lambda: arm.inject(4, EMERGENCY, 0x4310))
        stopped_by(arm, "node 5")
    emergency = watch.frames(1, 0x085)[0][0]
    # It may come just after the cycle has read its feedback: then the next cycle's frames stop the arm.
    assert all(watch.syncs_until_stop(joint, emergency) <= 1 for joint in range(6))
    arm.wait_for(lambda: arm.drive_states()["joint_5"] == "fault", "the drive's fault")
    assert [arm.drive_states()[name] for name in ("joint_1", "joint_4")] == ["quick stop active"] * 2
    assert arm.at_rest()
    recovers(arm)


def test_a_frozen_drive_stops_all_in_the_cycle_its_silence_is_too_long(arm):
    with BusWatch() as watch:
        moving(arm, lambda: arm.inject(1, FREEZE, 2500))
        stopped_by(arm, "node 2")
        silent_since = watch.feedback(1)[-1][0]
        stale = load_arm_can(arm.can_config).bus.stale_cycles
        arm.probe.spin(0.1)
    assert all(watch.syncs_until_stop(joint, silent_since) <= stale + 1 for joint in (0, 2, 3, 4, 5))
    others = [state for name, state in arm.drive_states().items() if name != "joint_2"]
    assert others == ["quick stop active"] * 5
    done, message = arm.call("/driver/recover")
    if not done:
        assert "not recovered" in message or "node 2" in message
    arm.wait_for(lambda: arm.call("/driver/recover")[0], "recovery once the drive has thawed")
    arm.healthy()


@pytest.mark.parametrize("how", [1, 2, 3], ids=["short", "random", "missing"])
def test_corrupt_feedback_stops_the_arm(arm, how):
    with BusWatch() as watch:
        moving(arm, lambda: arm.inject(3, CORRUPT, how))
        arm.wait_for(lambda: arm.fault, "a fault")
        arm.probe.spin(0.1)
    assert not arm.enabled and arm.probe.level("canopen_driver") == 2
    short = [at for at, data in watch.frames(1, 0x184) if len(data) != 8]
    if short:
        assert "bytes of feedback instead of 8" in arm.fault
        assert all(watch.syncs_until_stop(joint, short[0]) <= 1 for joint in range(6))
    arm.inject(3, CORRUPT, 0)
    arm.wait_for(lambda: arm.call("/driver/recover")[0], "recovery from sound feedback")
    arm.healthy()


def test_another_master_stops_the_arm(arm):
    arm.send_frame(0, 0x080, b"")
    stopped_by(arm, "another master")
    recovers(arm)


def test_a_second_driver_is_refused_and_the_first_does_not_notice(arm):
    cycles = int(arm.values["cycles"])
    second = arm.second_driver()
    assert second.wait(PATIENCE_S) == 2
    assert "another canopen_driver runs on local bus 'arm0': stop it first" in output(second)
    arm.wait_for(lambda: int(arm.values["cycles"]) > cycles + 500, "cycles going on")
    assert arm.enabled and not arm.fault


def test_a_second_arm_is_refused(arm):
    second = arm.processes.node("simulated_arm", f"can_config:={arm.can_config}")
    assert second.wait(PATIENCE_S) == 2
    assert "another simulated_arm runs on local bus 'arm0': stop it first" in output(second)
    assert arm.enabled and not arm.fault


def test_a_killed_arm_stops_everything_and_a_new_one_is_taken_over(arm):
    moving(arm, arm.arm.kill)
    arm.wait_for(lambda: arm.fault, "a fault")
    assert not arm.enabled and arm.driver.poll() is None
    done, message = arm.call("/driver/recover")
    assert not done and "not" in message
    assert not arm.call("/driver/enable", True)[0]
    arm.start_arm(arm.states(arm.payloads[-1:])[1][0])
    arm.wait_for(lambda: arm.call("/driver/recover")[0], "recovery with the new arm")
    arm.healthy()


def test_sigterm_stops_the_arm_before_the_process(arm):
    arm.payloads.clear()
    moving_until = []
    arm.stream(6.0, lambda t: smooth(t, period=6.0), until=lambda: len(moving_until) > 60 or moving_until.append(0))
    arm.driver.send_signal(signal.SIGTERM)
    arm.driver.send_signal(signal.SIGINT)
    assert arm.driver.wait(PATIENCE_S) == 0
    arm.probe.spin(0.3)
    stamps, position, _ = arm.states()
    late = stamps > stamps[-1] - 20_000_000
    assert np.abs(np.ptp(position[late], axis=0)).max() < 1e-3
    states = lambda: [value for key, value in arm.probe.values("simulated_arm").items() if key.startswith("node_")]  # noqa: E731
    arm.wait_for(lambda: states() == ["switch on disabled"] * 6, "the drives out of operation")
    assert "Traceback" not in output(arm.driver)
    arm.start_driver()
    arm.healthy()


def test_without_the_driver_the_drives_stop_the_arm_by_themselves(arm):
    arm.stream(1.2, lambda t: smooth(t, period=6.0), until=lambda: False)
    arm.driver.kill()
    arm.driver.wait()
    stopped = lambda: {value for key, value in arm.probe.values("simulated_arm").items() if key.startswith("node_")}  # noqa: E731
    arm.wait_for(lambda: stopped() == {"quick stop active"}, "quick stop of all drives")
    arm.probe.statuses.clear()
    arm.start_driver()
    arm.healthy()


@pytest.mark.parametrize("held", ["driver", "arm"])
def test_pause_before_the_first_enable_is_a_warning_that_clears_by_itself(live, held):
    live.wait_for(lambda: live.values, "the driver is up")
    live.driver.send_signal(signal.SIGTERM)
    assert live.driver.wait(PATIENCE_S) == 0
    live.start_driver()
    # Of its log: the last words of the driver before may still be on their way.
    live.wait_for(lambda: "]: ready: " in output(live.driver), "a connection")
    process = getattr(live, held)
    process.send_signal(signal.SIGSTOP)
    time.sleep(2.0)  # longer than either side's limits in `generous_config`
    process.send_signal(signal.SIGCONT)
    live.wait_for(lambda: "connecting to the drives again, for node" in output(live.driver), "the pause noticed")
    # Asked for meanwhile, it waits for the drives.
    live.probe.must("/driver/enable", True)
    live.probe.statuses.clear()
    live.wait_for(lambda: live.values.get("connection") == "connected", "a connection again")
    assert live.values["reconnections"] != "0"
    assert not live.fault and live.probe.level("canopen_driver") < 2


def test_no_arm_no_driver(tmp_path, live):
    lonely = tmp_path / "can.yaml"
    lonely.write_text(live.can_config.read_text().replace("arm0", "nobody").replace("arm1", "there"))
    driver = live.processes.node("canopen_driver", f"can_config:={lonely}", "connect_timeout_s:=1.0")
    assert driver.wait(PATIENCE_S) == 2
    assert "no one else is on it" in output(driver) and "Traceback" not in output(driver)


def test_during_every_attempt_but_the_first_the_driver_says_why_the_one_before_failed(tmp_path):
    lonely = generous_config(tmp_path)
    lonely.write_text(lonely.read_text().replace("arm0", "nobody2").replace("arm1", "there2"))
    driver = ArmDriver(load_arm_can(lonely), on_sample=lambda *_: None, priority=0)
    driver.start()
    try:
        said = set()
        end = time.monotonic() + PATIENCE_S
        while not any("the last attempt" in text for text in said) and time.monotonic() < end:
            said.add(driver.connection)
            time.sleep(0.0005)
    finally:
        driver.close()
    said -= {"not started", "connecting to the drives"}
    assert len(said) == 2 and all("no one else is on it" in text for text in said), said


def test_an_overloaded_bus_is_refused_with_what_would_fit(tmp_path, live):
    full = generous_config(tmp_path, period_s=0.001)
    text = full.read_text().replace("bus: 1", "bus: 0").replace("- channel: arm1\n  interface: local\n", "")
    full.write_text(text)
    driver = live.processes.node("canopen_driver", f"can_config:={full}")
    assert driver.wait(PATIENCE_S) == 2
    assert "137 %" in output(driver).replace("138 %", "137 %") and "2 buses of 3 axes" in output(driver)
