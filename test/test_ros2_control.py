"""docs/ros2_control.md, carried out against stand-ins of ros2_control: start, run, record, identify; what stops it."""

from __future__ import annotations

import os
import re
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 (pip install '.[ros]')")

import mock_controllers
from diagnostic_msgs.msg import DiagnosticArray
from domains import domain
from live_nodes import LIVE, Probe, Processes, output
from rclpy.qos import DurabilityPolicy, QoSProfile

from spacearm_ident.canbus.realtime import come_first
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.recording import read_recording

pytestmark = LIVE

PAGE = Path(__file__).parent.parent / "docs" / "ros2_control.md"
PATIENT = ("feedback_timeout_s:=5.0", "path_lag_s:=10.0")
"""The machine may hold up the stand-ins, which then make up what they missed; most tests are not about that."""
SHORTER = ["--harmonics", "3", "--fundamental", "0.5", "--periods", "4", "--quiet"]
"""The page's excitation takes a minute."""
PATIENCE_S = 120.0


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text(), re.M | re.S)


def commands(program: str) -> list[list[str]]:
    lines = [line.removeprefix("$ ") for block in blocks("console") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith(f"{program} ")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the page has its reader write, and the excitation it makes of it."""
    os.environ["ROS_DOMAIN_ID"] = domain("clean")
    place = tmp_path_factory.mktemp("arm")
    (place / "arm.urdf").write_text(small_arm.URDF)
    arm, nodes = blocks("yaml")
    (place / "arm.yaml").write_text(arm)
    (place / "nodes.yaml").write_text(nodes)
    declared = yaml.safe_load(arm)["effort"]["constants"]
    assert [declared[joint] for joint in small_arm.JOINTS] == mock_controllers.NM_PER_A.tolist()
    here = Path.cwd()
    os.chdir(place)
    try:
        (excite,) = (words for words in commands("spacearm") if words[0] == "excite")
        assert main([*excite, *SHORTER]) == 0
    finally:
        os.chdir(here)
    return place


class Graph(Probe):
    """The mock, nodes of ours beside it, and what they say."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder, self.processes = folder, Processes(folder)
        self.said: list[dict] = []
        self.place = ""
        self.hear_runs(self.said)

    def enter(self, place: str) -> None:
        """Heed the nodes of a namespace from now on, where their diagnostics may be, too."""
        self.place = place
        self.hear_runs(self.said, place)
        self.node.create_subscription(DiagnosticArray, f"{place}/diagnostics", self._keep, 100)

    def name(self, node: str) -> str:
        """A node as its diagnostics name it."""
        return f"{self.place}/{node}".lstrip("/")

    def mock(self, *words: str):
        process = self.processes.python(str(Path(__file__).with_name("mock_controllers.py")), *words)
        come_first(process.pid)
        return process

    def ours(self, *names: str, extra: tuple[str, ...] = (), words: tuple[str, ...] = ()) -> list:
        """Start nodes as the page does; their processes."""
        started = []
        shown = {words[1]: words[2:] for words in commands("spacearm") if words[0] == "node"}
        for name in names:
            patient = PATIENT if name == "trajectory" else ()
            flag, *page = shown[name]
            assert flag == "--ros-args"
            node = self.processes.node(name, *patient, *extra, words=[*page, *words])
            full = self.name(name)
            self.wait_for(lambda n=full, p=node: n in self.statuses or p.poll() is not None, full, PATIENCE_S)
            assert node.poll() is None, output(node)
            started.append(node)
        return started

    def start(self) -> None:
        name = self.name("trajectory")
        self.wait_for(lambda: self.values(name).get("drives_enabled") == "true", "the controller is heard")
        self.must(f"{self.place}/excitation/start")

    def reach(self, *states: str) -> dict:
        over = (*states, "done")
        self.wait_for(lambda: self.said and self.said[-1]["state"] in over, f"{states}", PATIENCE_S)
        last = self.said[-1]
        assert last["state"] in states, last["reason"]
        return last


@pytest.fixture
def graph(folder, monkeypatch):
    monkeypatch.chdir(folder)
    made = Graph(folder)
    yield made
    made.close()
    made.processes.end()


def test_the_page_leads_from_start_to_an_identified_arm(graph, folder):
    graph.mock("arm_controller")
    graph.ours("trajectory", "identifier", "recorder")
    services = [words[2] for words in commands("ros2") if words[:2] == ["service", "call"]]
    assert services == ["/recorder/start", "/excitation/start", "/recorder/stop"]
    assert graph.call(services[0])[0]
    graph.start()
    last = graph.reach("done")
    assert last["complete"] is True and last["reason"] == "", last["reason"]
    # Now, or the third that is held out at the end is an arm at rest.
    assert graph.call(services[2])[0]
    said = lambda: getattr(graph.statuses.get("identifier: identification"), "message", "")  # noqa: E731
    graph.wait_for(lambda: said().startswith("identified"), "the identification", PATIENCE_S)
    (identify,) = (words for words in commands("spacearm") if words[0] == "identify")
    # The last: a repetition of this test finds those of the attempts before.
    bag = max(folder.glob("recordings/run_*"))
    assert main([str(bag) if "*" in word else word for word in identify]) == 0
    for result in ("identified", "offline"):
        model = load_model(folder / result / "model.yaml")
        values = {p.name: v for p, v in zip(model.model.parameters, model.parameters, strict=True)}
        for joint, coulomb, viscous in zip(small_arm.JOINTS, small_arm.COULOMB, small_arm.VISCOUS, strict=True):
            # N·m, though the driver published A. At 1 rad/s, where it does not matter which powers of speed are in.
            assert values[f"f_c[{joint}]"] == pytest.approx(coulomb, rel=0.1), result
            powers = sum(values.get(f"{symbol}[{joint}]", 0.0) for symbol in ("k_v1", "k_v2", "k_v3"))
            assert values[f"f_c[{joint}]"] + powers == pytest.approx(coulomb + viscous, rel=0.1), result
    # Between the stamps announced, the arm did the excitation.
    recording = read_recording(bag).in_order(small_arm.JOINTS)
    inside = (recording.time * 1e9 + recording.start_ns > last["t0_ns"]) & (
        recording.time * 1e9 + recording.start_ns < last["t1_ns"]
    )
    assert np.ptp(recording.position[inside], axis=0).min() > 0.3
    velocity = np.abs(recording.velocity[inside])
    assert velocity.max() <= 2.0 * 1.01


def test_a_controller_that_is_deactivated_stops_the_run_with_that_reason(graph):
    graph.mock("arm_controller")
    graph.ours("trajectory")
    graph.start()
    graph.reach("running")
    assert graph.call("/mock/switch", False)[0]
    last = graph.reach("done")
    assert last["complete"] is False and last["restarts"] == 0
    # Whichever is seen first: what controller_manager says once a second, or an arm that no longer follows.
    assert re.match("the controller arm_controller is no longer active|the arm does not follow", last["reason"])
    graph.wait_for(lambda: graph.values("trajectory").get("drives_enabled") == "false", "the controller's word")
    done, reply = graph.call("/excitation/start")
    assert not done and "the controller arm_controller is inactive; activate it" in reply


@pytest.mark.parametrize("told_by", ["name", "topic"])
def test_of_two_arms_on_one_graph_the_trajectory_node_obeys_its_own_controller(graph, told_by):
    remapped = ("-r", "/diagnostics:=/right/diagnostics") if told_by == "topic" else ()
    told = ("full_name",) if told_by == "name" else ()
    graph.mock("arm_controller", *told, "--ros-args", "-r", "__ns:=/left")
    graph.mock("arm_controller", *told, "--ros-args", "-r", "__ns:=/right", *remapped)
    assert graph.call("/left/mock/switch", False)[0]
    graph.enter("/right")
    graph.ours("trajectory", words=("-r", "__ns:=/right", *remapped))
    graph.start()
    graph.reach("running")
    assert graph.call("/left/mock/switch", True)[0]
    graph.spin(0.5)
    assert graph.call("/left/mock/switch", False)[0]
    graph.spin(1.5)
    assert graph.said[-1]["state"] == "running", graph.said[-1]["reason"]
    assert graph.call("/right/mock/switch", False)[0]
    assert re.match("the controller arm_controller is no longer active|the arm does not", graph.reach("done")["reason"])


def test_of_two_arms_whose_managers_cannot_be_told_apart_neither_is_moved(graph):
    for place in ("/left", "/right"):
        graph.mock("arm_controller", "--ros-args", "-r", f"__ns:={place}")
    graph.enter("/right")
    graph.ours("trajectory", words=("-r", "__ns:=/right"))
    both = "may be that of /left/controller_manager, /right/controller_manager"
    graph.wait_for(lambda: both in graph.call("/right/excitation/start")[1], "the refusal")
    assert {state["state"] for state in graph.said} <= {"idle"}


def test_a_stop_is_a_way_to_rest_along_the_path_within_the_limits(graph):
    from sensor_msgs.msg import JointState

    seen = []
    graph.node.create_subscription(JointState, "/joint_states", seen.append, QoSProfile(depth=1000))
    graph.mock("arm_controller")
    graph.ours("trajectory")
    graph.start()
    graph.reach("running")
    graph.spin(1.0)
    assert graph.call("/excitation/stop")[0]
    last = graph.reach("done")
    assert last["reason"] == "stopped by /excitation/stop" and last["complete"] is False
    graph.spin(0.5)
    stamp = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in seen])
    velocity = np.array([m.velocity for m in seen])[:, 1:]
    assert np.abs(velocity[-20:]).max() == 0.0
    assert np.abs(velocity).max() <= 2.0 * 1.01
    acceleration = np.diff(velocity, axis=0) / np.diff(stamp)[:, None]
    # Bridging from wherever the controller is to where the stop begins may ask for a little more.
    assert np.abs(acceleration).max() <= 6.0 * 1.1
    graph.must("/excitation/start")


def test_an_interrupted_node_stays_until_the_arm_is_at_rest(graph):
    from sensor_msgs.msg import JointState

    seen = []
    graph.node.create_subscription(JointState, "/joint_states", seen.append, QoSProfile(depth=1000))
    graph.mock("arm_controller")
    (node,) = graph.ours("trajectory")
    graph.start()
    graph.reach("running")
    graph.spin(1.0)
    node.send_signal(signal.SIGINT)
    graph.wait_for(lambda: node.poll() is not None, "its end")
    moving = np.abs(np.array(seen[-1].velocity)).max()
    assert node.returncode == 0 and moving == 0.0
    assert graph.said[-1]["reason"] == "the trajectory node was ended"
    assert "not known to have stopped" not in output(node)


def test_an_interrupted_node_whose_stop_nobody_took_says_so(graph):
    mock = graph.mock("arm_controller")
    (node,) = graph.ours("trajectory", extra=("feedback_timeout_s:=0.5",))
    graph.start()
    graph.reach("running")
    mock.send_signal(signal.SIGSTOP)
    node.send_signal(signal.SIGINT)
    assert node.wait(30) == 0
    assert "[ERROR]" in output(node) and "the arm is not known to have stopped: no feedback" in output(node)


def test_a_robot_whose_speed_is_scaled_down_is_no_run_of_this_excitation(graph):
    graph.mock("arm_controller", "slow")
    graph.ours("trajectory", extra=("path_lag_s:=1.0",))
    graph.start()
    last = graph.reach("done")
    assert last["complete"] is False
    assert "behind the run" in last["reason"] or "does not follow" in last["reason"]


def test_positions_are_streamed_to_a_forward_controller_in_its_order(graph):
    graph.mock("forward")
    order = "[" + ", ".join(reversed(small_arm.JOINTS)) + "]"
    graph.ours(
        "trajectory",
        extra=(
            "output:=forward_positions",
            "output_topic:=forward/commands",
            f"output_joints:={order}",
            "rate_hz:=250.0",
            "controller:=forward",
        ),
    )
    graph.start()
    last = graph.reach("done")
    assert last["complete"] is True and last["reason"] == "", last["reason"]
    assert "late" in graph.values("trajectory")


def test_a_run_is_refused_where_nobody_could_take_it(graph):
    graph.mock("arm_controller")
    graph.ours("trajectory", extra=("output_topic:=elsewhere/joint_trajectory",))
    graph.wait_for(lambda: graph.values("trajectory").get("drives_enabled") == "true", "the controller is heard")
    done, reply = graph.call("/excitation/start")
    assert not done and "nobody listens on /elsewhere/joint_trajectory" in reply


def test_a_topic_that_says_no_stops_a_run(graph):
    from std_msgs.msg import Bool

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    running = graph.node.create_publisher(Bool, "/robot_program_running", latched)
    graph.mock("arm_controller")
    graph.ours("trajectory", extra=("enabled_from:=[controller, topic]", "enabled_topic:=/robot_program_running"))
    assert not graph.call("/excitation/start")[0]
    running.publish(Bool(data=True))
    graph.start()
    graph.reach("running")
    running.publish(Bool(data=False))
    last = graph.reach("done")
    assert last["reason"] == "/robot_program_running says false"


def test_the_message_file_fills_the_message_as_the_tool_fills_it(folder):
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    document = yaml.safe_load((folder / "message.yaml").read_text())
    # As rosidl_runtime_py does: every element of a list must be of the field's type, so 0 is no double.
    message = JointTrajectory(joint_names=document["joint_names"])
    for entry in document["points"]:
        point = JointTrajectoryPoint()
        for name in ("positions", "velocities", "accelerations"):
            assert all(type(value) is float for value in entry[name])
            setattr(point, name, entry[name])
        point.time_from_start.sec = entry["time_from_start"]["sec"]
        point.time_from_start.nanosec = entry["time_from_start"]["nanosec"]
        message.points.append(point)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
    assert times[0] == 0.5 and np.allclose(np.diff(times), 0.02)
    assert np.allclose(message.points[0].positions, [0.1, -0.2]) and not any(message.points[-1].velocities)
    q = np.array([p.positions for p in message.points])
    qd = np.array([p.velocities for p in message.points])
    assert np.allclose(np.gradient(q, 0.02, axis=0)[1:-1], qd[1:-1], atol=0.02)
