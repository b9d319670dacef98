"""The trajectory node against a live graph: what it streams, when it refuses, how it stops."""

import itertools
import math
import re
import signal
import threading
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from live_nodes import LIVE, Probe, end, output, wait_for
from simulated_arm import CONFIG, paper_limits

from spacearm_ident.driver.set_points import PAUSE
from spacearm_ident.excitation.trajectory import Rest, Trajectory, random_feasible
from spacearm_ident.excitation.trajectory_file import save_trajectory
from spacearm_ident.nodes.joint_stream import JointStateWriter
from spacearm_ident.nodes.runtime import STREAM
from spacearm_ident.nodes.twin import SILENCE_S
from spacearm_ident.recording import cdr

pytestmark = LIVE

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = paper_limits()
HOME = np.array([0.1, -0.1, 0.05, 0.2, -0.2, 0.1])


class Arm:
    """Drives that follow every set-point at once, and the driver's word on them, in a thread of their own."""

    def __init__(self, probe: Probe, joints=JOINTS, others=()):
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState

        self.position, self.velocity = HOME.copy(), np.zeros(6)
        self.joints, self.enabled, self.silent, self.offset = joints, True, False, 0.0
        # Joints of somebody else in the same messages; the arm's are the other way round then.
        self.others = tuple(others)
        self.commands: list[tuple[int, np.ndarray, np.ndarray]] = []
        self.states: list[dict] = []
        node = probe.node
        self._command_node = rclpy.create_node("arm", context=node.context)
        self._command = self._command_node.create_subscription(JointState, "/joint_command", print, STREAM, raw=True)
        self._states = node.create_publisher(JointState, "/joint_states", STREAM)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        probe.hear_runs(self.states)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _take(self):
        with self._command.handle:
            while (taken := self._command.handle.take_message(self._command.msg_type, True)) is not None:
                self._follow(taken[0])

    def _follow(self, payload):
        (block,), _ = cdr.decode_joint_states([payload])
        assert block.names == JOINTS
        self.commands.append((int(block.stamp_ns[0]), block.position[0], block.velocity[0]))
        self.position = block.position[0]

    def _work(self):
        for k in itertools.count():
            if self._ending.wait(0.01):
                return
            self._take()
            if not self.silent:
                self._states.publish(self._message())
            if k % 10 == 0:
                self._say()

    def _message(self):
        names, position, velocity = self.joints, self.position[None] + self.offset, self.velocity[None]
        if self.others:
            more = np.full((1, len(self.others)), 0.5)
            names = (*self.others, *reversed(names))
            position, velocity = (np.concatenate([more, v[:, ::-1]], axis=1) for v in (position, velocity))
        return cdr.encode_joint_states([time.time_ns()], names, position, velocity)[0]

    def _say(self):
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        if self.enabled is not None:
            value = KeyValue(key="operation_enabled", value=str(self.enabled).lower())
            self._diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name="canopen_driver", values=[value])]))

    def stamps(self) -> np.ndarray:
        return np.array([stamp for stamp, _, _ in self.commands])

    def q(self) -> np.ndarray:
        return np.array([q for _, q, _ in self.commands])

    def seen(self) -> list[str]:
        """The states, each as often as it came anew."""
        names = [state["state"] for state in self.states]
        return [name for k, name in enumerate(names) if k == 0 or names[k - 1] != name]

    def close(self):
        self._ending.set()
        self._thread.join()
        self._command_node.destroy_node()


@pytest.fixture
def arm(probe):
    arm = Arm(probe)
    yield arm
    arm.close()


@pytest.fixture(scope="module")
def series():
    return random_feasible(JOINTS, LIMITS, seed=3, fundamental_hz=0.5, periods=3, usage=0.8, start=HOME)


@pytest.fixture
def file(series, tmp_path):
    path = tmp_path / "excitation.yaml"
    save_trajectory(Trajectory(JOINTS, (series,)), path)
    return path


def node(processes, file, *arguments):
    return processes.node(
        "trajectory",
        f"trajectory_file:={file}",
        f"arm:={CONFIG / 'paper_arm.yaml'}",
        "rate_hz:=500",
        "feedback_timeout_s:=1",
        *arguments,
    )


def start(probe, arm):
    """Start as soon as the node has heard of arm and drives."""
    probe.wait_for(lambda: probe.values("trajectory").get("drives_enabled") == "true", "the node hears the driver")
    probe.wait_for(lambda: float(probe.values("trajectory")["feedback_age_s"]) < 0.2, "the node hears the arm")
    success, reply = probe.call("/excitation/start")
    assert success, reply


def check_smooth(arm):
    """All set-points keep the limits, as the drives see them: differences over stamps."""
    stamps = arm.stamps()
    q, t = arm.q()[: len(stamps)], (stamps - stamps[0]) * 1e-9
    assert np.all(q <= LIMITS.upper) and np.all(q >= LIMITS.lower)
    step = np.diff(t)[:, None]
    assert np.all(step > 0)
    velocity = np.diff(q, axis=0) / step
    assert np.all(np.abs(velocity) <= LIMITS.velocity * 1.001)
    acceleration = np.diff(velocity, axis=0) / ((step[1:] + step[:-1]) / 2)
    assert np.all(np.abs(acceleration) <= LIMITS.acceleration * 1.05)


def done(arm):
    return arm.states and arm.states[-1]["state"] == "done"


def test_a_run_from_where_the_arm_is_and_back(processes, probe, arm, file, series):
    process = node(processes, file)
    start(probe, arm)
    success, reply = probe.call("/excitation/start")
    assert not success and reply.startswith("already ")
    probe.wait_for(lambda: done(arm), "the run ends")
    assert arm.seen()[-4:] == ["approach", "running", "returning", "done"]
    assert [s["period"] for s in arm.states if s["state"] == "running"] == [1, 2, 3]
    last = arm.states[-1]
    assert last["complete"] is True and last["reason"] == ""
    probe.wait_for(lambda: f"run {last['run']} is over: its periods are complete" in output(process), "the log")
    assert f"run {last['run']} begins: " in output(process) and f"3 periods, of {file}" in output(process)
    assert "is being stopped" not in output(process)
    check_smooth(arm)
    stamps = arm.stamps()
    q = arm.q()[: len(stamps)]
    assert np.allclose(q[0], HOME, atol=1e-9) and np.allclose(q[-1], HOME, atol=1e-9)
    assert last["t1_ns"] - last["t0_ns"] == pytest.approx(series.duration_s * 1e9, abs=2)
    # Between the stamps announced, the set-points are the excitation itself, at the joints' own phase.
    inside = (stamps >= last["t0_ns"]) & (stamps < last["t1_ns"])
    phase = (stamps[inside] - last["t0_ns"]) * 1e-9
    assert np.allclose(q[inside], series.evaluate(phase).q, atol=1e-6)
    velocity = np.array([qd for _, _, qd in arm.commands[: len(stamps)]])
    assert np.allclose(velocity[inside], series.evaluate(phase).qd, atol=1e-6)
    probe.spin(2.5)  # the hold, and diagnostics after it
    stamps = arm.stamps()
    # Late or not, every slot has its set-point.
    slots = round(np.ptp(stamps) * 500e-9) + 1
    assert slots == len(stamps) == int(probe.values("trajectory")["set_points"])


def test_a_run_asked_for_the_moment_another_is_done_is_a_stream_of_its_own(processes, probe, arm, file):
    """The driver must not take the way from where the arm was sent to where it is measured for a motion."""
    node(processes, file)
    start(probe, arm)
    probe.wait_for(lambda: done(arm), "the run ends")
    first = arm.states[-1]["run"]
    start(probe, arm)
    probe.wait_for(lambda: arm.states[-1]["state"] == "running" and arm.states[-1]["run"] != first, "another runs")
    assert np.diff(arm.stamps()).max() > 1e9 * PAUSE


@pytest.mark.parametrize("moment", ["approach", "running", "returning"])
def test_stopped_smoothly(processes, probe, arm, file, moment):
    process = node(processes, file)
    start(probe, arm)
    probe.wait_for(lambda: arm.seen()[-1:] == [moment], moment)
    probe.spin(0.4)
    assert probe.call("/excitation/stop")[0]
    probe.wait_for(lambda: done(arm), "it comes to rest")
    assert arm.seen()[-2:] == ["stopping", "done"]
    probe.spin(1.5)  # the hold
    check_smooth(arm)
    q, last = arm.q(), arm.states[-1]
    assert np.array_equal(q[-1], q[-200]), "it holds the last set-point"
    assert last["reason"] == "stopped by /excitation/stop"
    assert re.search(rf"\[WARN\].*run {last['run']} is being stopped: stopped by /excitation/stop", output(process))
    assert last["complete"] is (moment == "returning")
    assert last["t0_ns"] <= last["t1_ns"] <= arm.stamps()[-1]
    assert (last["t0_ns"] == last["t1_ns"]) is (moment == "approach")
    assert probe.call("/excitation/stop") == (False, "nothing is running")
    start(probe, arm)  # from where it stands now


def break_feedback(arm):
    arm.silent = True


def break_numbers(arm):
    arm.offset = np.nan


def disable(arm):
    arm.enabled = False


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (break_feedback, "feedback on /joint_states ceased"),
        (break_numbers, "feedback on /joint_states is not a number"),
        (disable, "the drives are no longer enabled"),
    ],
)
def test_an_unsafe_state_stops_the_run_and_says_why(processes, probe, arm, file, fault, reason):
    process = node(processes, file)
    start(probe, arm)
    probe.wait_for(lambda: arm.seen()[-1:] == ["running"], "running")
    fault(arm)
    probe.wait_for(lambda: done(arm), "it comes to rest")
    last = arm.states[-1]
    assert last["reason"].startswith(reason)
    assert last["complete"] is False and last["restarts"] == 0
    check_smooth(arm)
    probe.wait_for(lambda: reason in probe.statuses["trajectory"].message, "the reason on /diagnostics")
    probe.wait_for(lambda: f"run {last['run']} is over: stopped early" in output(process), "its end in the log")
    said = re.findall(rf"\[ERROR\].*run {last['run']} is being stopped: {reason}", output(process))
    assert len(said) == 1, output(process)


@pytest.mark.parametrize("fault_first", [True, False])
def test_a_fault_and_a_stop_asked_for_in_one_life_of_the_node_both_brake(processes, probe, arm, file, fault_first):
    process = node(processes, file)
    for fault in (fault_first, not fault_first):
        arm.enabled = True
        arm.commands.clear()
        arm.velocity = np.zeros(6)
        probe.wait_for(lambda: not arm.states or done(arm) or arm.states[-1]["state"] == "idle", "no run")
        start(probe, arm)
        probe.wait_for(lambda: arm.seen()[-1:] == ["running"], "running")
        if fault:
            disable(arm)
        else:
            assert probe.call("/excitation/stop") == (True, "stopping within the limits")
        probe.wait_for(lambda: done(arm) or process.poll() is not None, "it comes to rest")
        assert process.poll() is None, output(process)
        check_smooth(arm)
        level = "ERROR" if fault else "WARN"
        said = rf"\[{level}\].*run {arm.states[-1]['run']} is being stopped"
        probe.wait_for(lambda s=said: re.search(s, output(process)), "the reason in the log")


BROKEN = """
import sys
from rclpy.impl.rcutils_logger import RcutilsLogger
from spacearm_ident.nodes import trajectory

def fail(*_, **__):
    raise RuntimeError("what is said is broken")

broken, log = sys.argv.pop(1), trajectory.TrajectoryNode._log

def fail_in_a_stop(self, before, now):
    if now["reason"] and broken == "logger":
        RcutilsLogger.log = fail
    elif now["reason"]:
        fail()
    log(self, before, now)

trajectory.TrajectoryNode._log = fail_in_a_stop
sys.exit(trajectory.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(("broken", "code"), [("logger", None), ("message", 1)])
def test_a_stop_brakes_the_arm_to_rest_where_what_is_said_of_it_fails(processes, probe, arm, file, broken, code):
    given = (f"trajectory_file:={file}", f"arm:={CONFIG / 'paper_arm.yaml'}", "rate_hz:=500", "feedback_timeout_s:=1")
    process = processes.python("-c", BROKEN, broken, "--ros-args", *(word for value in given for word in ("-p", value)))
    start(probe, arm)
    probe.wait_for(lambda: arm.seen()[-1:] == ["running"], "running")
    probe.spin(0.3)
    disable(arm)
    over = (lambda: done(arm)) if code is None else (lambda: process.poll() is not None)
    probe.wait_for(over, "it comes to rest")
    probe.spin(0.3)
    assert process.poll() == code, output(process)
    check_smooth(arm)
    assert np.array_equal(arm.q()[-1], arm.q()[-200]), "it holds the last set-point"
    if code is None:
        assert "is being stopped" in output(process), "where there is no logger, on stderr"


def test_interrupted_it_stops_the_arm_before_itself(processes, probe, arm, file):
    process = node(processes, file)
    start(probe, arm)
    probe.wait_for(lambda: arm.seen()[-1:] == ["running"], "running")
    process.send_signal(signal.SIGINT)
    probe.wait_for(lambda: process.poll() is not None, "it ends")
    assert process.returncode == 0 and "Traceback" not in output(process)
    probe.spin(0.3)
    check_smooth(arm)
    assert np.array_equal(arm.q()[-1], arm.q()[-200])
    assert arm.states[-1]["reason"] == "the trajectory node was ended"


def test_joints_of_a_gripper_and_messages_of_others_are_no_hindrance(processes, probe, file):
    """Another order, more joints, and a gripper's own messages on the same topic between the arm's."""
    from sensor_msgs.msg import JointState

    arm = Arm(probe, others=("finger", "thumb"))
    other = probe.node.create_publisher(JointState, "/joint_states", STREAM)
    message = JointState(name=["finger"], position=[0.02])
    probe.node.create_timer(0.01, lambda: other.publish(message))
    try:
        node(processes, file)
        start(probe, arm)
        probe.wait_for(lambda: done(arm), "the run ends")
        assert arm.states[-1]["complete"] is True and arm.states[-1]["reason"] == ""
        assert np.allclose(arm.q()[0], HOME, atol=1e-9), "it begins where the arm is, not where another joint is"
    finally:
        arm.close()


class SimulatedClock:
    """`/clock`, at another pace than this machine's, from another epoch."""

    PACE, EPOCH_S = 2.0, 1000.0

    def __init__(self, probe):
        from rosgraph_msgs.msg import Clock

        self._publisher = probe.node.create_publisher(Clock, "/clock", 10)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, args=(Clock,))
        self._thread.start()

    def _work(self, kind):
        begin = time.monotonic()
        while not self._ending.wait(0.005):
            now_ns = round(1e9 * (self.EPOCH_S + self.PACE * (time.monotonic() - begin)))
            message = kind()
            message.clock.sec, message.clock.nanosec = divmod(now_ns, 10**9)
            self._publisher.publish(message)

    def close(self):
        self._ending.set()
        self._thread.join()


def test_under_simulated_time_stamps_and_pace_are_the_graphs(processes, probe, arm, file):
    clock = SimulatedClock(probe)
    try:
        node(processes, file, "use_sim_time:=true")
        start(probe, arm)
        probe.wait_for(lambda: arm.seen()[-1:] == ["running"], "running")
        first = len(arm.commands)
        probe.wait_for(lambda: arm.seen()[-1:] == ["returning"], "the periods end")
        stamps = arm.stamps()
        assert stamps[0] > 1e9 * clock.EPOCH_S and stamps[-1] < 1e9 * (clock.EPOCH_S + 1000.0)
        # Three periods of 2 s of the graph's time; a machine that holds the clock up makes them longer here, not there.
        assert 1e-9 * (stamps[-1] - stamps[first]) == pytest.approx(6.0, abs=1.0)
        last = arm.states[-1]
        assert last["t1_ns"] - last["t0_ns"] == pytest.approx(6e9, abs=2)
        probe.wait_for(lambda: done(arm), "the run ends")
        assert arm.states[-1]["complete"] is True
        check_smooth(arm)
    finally:
        clock.close()


def refusal(probe) -> str:
    success, reply = probe.call("/excitation/start")
    assert not success
    return reply


def test_refusals_say_why(processes, probe, arm, file, series, tmp_path):
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    arm.silent, arm.enabled = True, None
    process = node(processes, file)
    client = probe.node.create_client(SetParameters, "/trajectory/set_parameters")
    probe.wait_for(client.service_is_ready, "parameters")

    def use(path):
        wanted = [Parameter("trajectory_file", value=str(path)).to_parameter_msg()]
        future = client.call_async(SetParameters.Request(parameters=wanted))
        probe.wait_for(future.done, "the parameter is set")

    assert "no feedback on /joint_states (there is none)" in refusal(probe)
    arm.silent = False
    probe.wait_for(lambda: "no feedback" not in refusal(probe), "feedback")
    assert "not known to be enabled; call /driver/enable first" in refusal(probe)
    arm.enabled = False
    probe.wait_for(lambda: "not known" not in refusal(probe), "the driver is heard")
    assert refusal(probe) == "the drives are not enabled; call /driver/enable first"
    arm.enabled = True
    probe.wait_for(lambda: probe.values("trajectory").get("drives_enabled") == "true", "enabled")

    use("")
    assert refusal(probe).startswith("no trajectory: set the parameter trajectory_file")
    use(tmp_path / "none.yaml")
    probe.wait_for(lambda: "trajectory_file: as it is now, a start would be refused: " in output(process), "the log")
    assert "none.yaml (No such file or directory)" in refusal(probe)
    (tmp_path / "bad.yaml").write_text("schema: else\n")
    use(tmp_path / "bad.yaml")
    assert "bad.yaml" in refusal(probe)
    far = HOME.copy()
    far[2] = LIMITS.upper[2] + 0.2
    save_trajectory(Trajectory(JOINTS, (Rest(HOME, 1.0), Rest(HOME, 1.0))), tmp_path / "fine.yaml")
    save_trajectory(Trajectory(JOINTS, (Rest(far, 1.0),)), tmp_path / "far.yaml")
    use(tmp_path / "far.yaml")
    assert "within the limits" in refusal(probe)
    save_trajectory(Trajectory(JOINTS[:5], (Rest(HOME[:5], 1.0),)), tmp_path / "five.yaml")
    use(tmp_path / "five.yaml")
    assert "but the arm has joint_1, " in refusal(probe)
    said = output(process).count("as it is now")
    use(tmp_path / "fine.yaml")
    # A start asked before the new state has arrived would be granted: give it its way there first.
    arm.velocity = np.full(6, 0.3)
    probe.spin(0.5)
    assert "joint_1 moves at 0.300 rad/s" in refusal(probe)
    assert output(process).count("as it is now") == said
    arm.velocity = np.full(6, np.nan)
    probe.spin(0.5)
    assert "not a number" in refusal(probe)
    arm.silent = True
    probe.spin(1.5)
    assert "no feedback on /joint_states (the last is " in refusal(probe)
    assert not arm.commands, "nothing was ever streamed"
    assert end(process) == 0


def test_a_bad_arm_file_is_one_line(processes, tmp_path):
    process = processes.node("trajectory", f"arm:={tmp_path / 'none.yaml'}")
    assert process.wait(20) == 2
    assert len(output(process).splitlines()) == 1 and "none.yaml" in output(process)


def test_the_patched_message_is_what_the_encoder_writes():
    writer = JointStateWriter(["a", "long_name", "c"], "position", "velocity")
    q, qd = np.array([0.1, -2.0, math.pi]), np.array([1e-9, 3.0, -0.5])
    for stamp in (0, 1_795_262_547_999_999_999):
        expected = cdr.encode_joint_states([stamp], ["a", "long_name", "c"], q[None], qd[None])[0]
        assert writer.payload(stamp, q, qd) == expected


def test_a_second_node_of_the_same_name_is_said_and_neither_moves_the_arm_until_one_is_gone(
    processes, probe, arm, file
):
    first, second = node(processes, file), node(processes, file)
    words = "another node /trajectory is on this graph: end one of them, or start it in a namespace"
    for process in (first, second):
        probe.wait_for(lambda p=process: words in output(p), "the warning")
    assert refusal(probe) == f"{words}; two would move one arm"
    assert end(second) == 0
    probe.spin(SILENCE_S + 0.5)
    start(probe, arm)
    assert output(first).count(words) == 1 + output(first).count("two would")


@pytest.mark.parametrize("kind", ["recorder", "identifier"])
def test_two_nodes_of_one_name_are_said_and_two_in_namespaces_are_not(processes, probe, tmp_path, kind):
    def begin(place):
        code = f"import sys; from spacearm_ident.nodes.main import start; sys.exit(start({kind!r}, sys.argv[1:]))"
        return processes.python("-c", code, "--ros-args", "-r", f"__ns:={place}")

    left, right = begin("/left"), begin("/right")
    for name in (f"left/{kind}", f"right/{kind}"):
        probe.wait_for(lambda n=name: n in probe.statuses, name)
    probe.spin(3.0)
    assert "another node" not in output(left) + output(right)
    twin = begin("/right")
    for process in (right, twin):
        probe.wait_for(lambda p=process: f"another node /right/{kind} is on this graph" in output(p), "the warning")
    assert "another node" not in output(left)


def test_a_file_that_is_not_there_is_said_when_the_node_is_ready(processes, tmp_path):
    process = node(processes, tmp_path / "nowhere.yaml")
    wait_for(lambda: "ready: " in output(process), "the node is up")
    said = output(process)
    assert "ready: no trajectory yet, /excitation/start would be refused: " in said and "No such file" in said
