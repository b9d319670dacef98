"""Identifiers among the joint states that others publish: two arms on one graph, slow ones, more or fewer joints."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")
pytest.importorskip("clarabel", reason="needs clarabel in the processes that identify (README.md, ROS 2 Jazzy)")

from domains import domain
from live_nodes import LIVE, Probe, Processes, output
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.nodes.runtime import LATCHED
from spacearm_ident.recording import Recording, cdr

pytestmark = LIVE

QUICK = ("friction:=coulomb-viscous", "bandwidth_hz:=5.0")
PER_SECOND = 2000.0
PATIENCE_S = 180.0
"""An identification on a busy machine."""


class Graph(Probe):
    """Publishes joint states and descriptions, and sees what identifiers say."""

    patience_s = PATIENCE_S

    def __init__(self, processes: Processes, folder: Path) -> None:
        super().__init__()
        self.processes, self.folder = processes, folder
        self._states: dict[str, object] = {}
        self._descriptions: list[object] = []

    def identifier(self, *parameters: str, namespace: str = "") -> str:
        """Start one; the name that its diagnostics have."""
        name = f"{namespace}/identifier".lstrip("/")
        place = ["-r", f"__ns:={namespace}"] if namespace else []
        node = self.processes.node("identifier", *parameters, *QUICK, words=place)
        self.wait_for(lambda: name in self.statuses or node.poll() is not None, "the node")
        assert node.poll() is None, output(node)
        return name

    def describe(self, urdf: str, namespace: str = "") -> None:
        publisher = self.node.create_publisher(String, f"{namespace}/robot_description", LATCHED)
        publisher.publish(String(data=urdf))
        self._descriptions.append(publisher)

    def play(self, *streams: tuple[str, list[bytes]]) -> None:
        """Messages of several topics, in turn."""
        for topic, _ in streams:
            if topic not in self._states:
                self._states[topic] = self.node.create_publisher(JointState, topic, QoSProfile(depth=1000))
                self.wait_for(lambda topic=topic: self._states[topic].get_subscription_count(), topic)
        start, sent = time.monotonic(), 0
        for number in range(max(len(messages) for _, messages in streams)):
            for topic, messages in streams:
                if number < len(messages):
                    self._states[topic].publish(messages[number])
                    sent += 1
            if (wait := start + sent / PER_SECOND - time.monotonic()) > 0:
                time.sleep(wait)
        time.sleep(0.5)

    def outcome(self, name: str) -> str:
        """What became of an identification."""
        part = f"{name}: identification"

        def said() -> str:
            message = self.statuses[part].message if part in self.statuses else ""
            return "" if message == "nothing identified yet" else message

        return self.wait_for(said, part)

    def identified(self, name: str) -> None:
        self.must(f"/{name}/identify")
        assert "identified and validated" in self.outcome(name)


@pytest.fixture
def graph(tmp_path, monkeypatch) -> Iterator[Graph]:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain("clean"))
    folder = tmp_path / "processes"
    folder.mkdir()
    processes = Processes(folder)
    made = Graph(processes, folder)
    yield made
    made.close()
    processes.end()


def stronger(run: Recording, factor: float) -> Recording:
    """The same motion of an arm whose torque is `factor` times as large."""
    assert run.effort is not None
    return replace(run, effort=factor * run.effort)


def messages(
    run: Recording, prefix: str = "", extra: tuple[str, ...] = (), without: tuple[str, ...] = ()
) -> list[bytes]:
    """Joint states with prefixed names, with joints that stand still in front, without some."""
    assert run.effort is not None
    kept = [k for k, name in enumerate(run.joints) if name not in without]
    stamps = run.start_ns + np.round(run.time * 1e9).astype(np.int64)
    still = np.zeros((len(stamps), len(extra)))
    names = [*extra, *(prefix + run.joints[k] for k in kept)]
    position, effort = (np.column_stack([still, values[:, kept]]) for values in (run.position, run.effort))
    return cdr.encode_joint_states(stamps, names, position, effort=effort)


def coulomb(folder: Path) -> dict[str, float]:
    """Joint -> identified Coulomb friction, N·m."""
    known = load_model(folder / "model.yaml")
    pairs = zip(known.model.parameters, known.parameters)
    return {item.joint: float(value) for item, value in pairs if item.symbol == "f_c"}


def urdf_of(prefix: str) -> str:
    text = small_arm.URDF
    for joint in small_arm.JOINTS:
        text = text.replace(f'joint name="{joint}"', f'joint name="{prefix}{joint}"')
    return text


def test_two_arms_in_two_namespaces_do_not_mix(graph, tmp_path):
    """Started in one folder with default parameters, as by hand."""
    run = small_arm.recording(16.0)
    arms = {"/left": run, "/right": stronger(run, 2.0)}
    names = {place: graph.identifier(namespace=place) for place in arms}
    for place in arms:
        graph.describe(small_arm.URDF, place)
    graph.play(*((f"{place}/joint_states", messages(one)) for place, one in arms.items()))
    for name in names.values():
        graph.must(f"/{name}/identify")
    for name in names.values():
        assert "identified and validated" in graph.outcome(name)
    results = {place: graph.folder / "identified" / place.strip("/") for place in arms}
    for place, factor in (("/left", 1.0), ("/right", 2.0)):
        found = coulomb(results[place])
        assert found == {j: pytest.approx(factor * f, rel=0.1) for j, f in zip(small_arm.JOINTS, small_arm.COULOMB)}


def test_joint_states_at_20_hz_are_refused_with_what_to_do_and_100_hz_are_not(graph, tmp_path):
    run = small_arm.recording(40.0)
    slow = graph.identifier(f"result_directory:={tmp_path / 'slow'}")
    graph.describe(small_arm.URDF)
    graph.play(("/joint_states", messages(run)[::10]))
    granted, answer = graph.call(f"/{slow}/identify")
    assert "record joint states at 100 Hz or more" in (graph.outcome(slow) if granted else answer)
    assert not (tmp_path / "slow" / "model.yaml").exists()
    fast = graph.identifier(f"result_directory:={tmp_path / 'fast'}", namespace="/fast")
    graph.describe(small_arm.URDF, "/fast")
    graph.play(("/fast/joint_states", messages(run)[::2]))
    graph.identified(fast)


@pytest.mark.parametrize("extra, without", [(("head", "finger"), ()), ((), ("elbow",))], ids=["more", "fewer"])
def test_an_arm_is_identified_from_joint_states_of_more_or_fewer_joints(graph, tmp_path, extra, without):
    run = small_arm.recording(16.0, still=(1,) if without else ())
    name = graph.identifier(f"result_directory:={tmp_path / 'out'}")
    graph.describe(small_arm.URDF)
    graph.play(("/joint_states", messages(run, extra=extra, without=without)))
    graph.identified(name)
    found = coulomb(tmp_path / "out")
    known = dict(zip(small_arm.JOINTS, small_arm.COULOMB))
    assert found == {joint: pytest.approx(known[joint], rel=0.2) for joint in small_arm.JOINTS if joint not in without}


def test_of_two_arms_on_one_topic_the_identifier_takes_that_of_its_description(graph, tmp_path):
    run = small_arm.recording(16.0)
    arm = tmp_path / "right.urdf"
    arm.write_text(urdf_of("right_"))
    name = graph.identifier(f"result_directory:={tmp_path / 'out'}", f"arm:={arm}")
    both = [messages(run, "left_"), messages(stronger(run, 2.0), "right_")]
    graph.play(*(("/joint_states", part) for part in both))
    graph.identified(name)
    found = coulomb(tmp_path / "out")
    known = zip(small_arm.JOINTS, small_arm.COULOMB)
    assert found == {f"right_{joint}": pytest.approx(2.0 * value, rel=0.1) for joint, value in known}
    # The residual of the model in use follows the same arm, though the other publishes between its messages.
    got: list[JointState] = []
    graph.node.create_subscription(JointState, "/identifier/residuals", got.append, QoSProfile(depth=1000))
    graph.play(*(("/joint_states", part) for part in both))
    graph.wait_for(lambda: got, "residuals")
    assert set(got[-1].name) == {"right_shoulder", "right_elbow"}
