"""Nodes in namespaces: every name follows, nothing crosses from one arm to another, and none changes without one."""

from __future__ import annotations

import ast
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import small_arm
import yaml

from spacearm_ident.cli import node as node_command
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model_file import save_model
from spacearm_ident.nodes import main as entry
from spacearm_ident.nodes.main import NODES
from spacearm_ident.nodes.params_file import holding_in_namespace, name_in_full
from spacearm_ident.recording import cdr, read_recording
from spacearm_ident.recording.bag import messages
from spacearm_ident.recording.contents import Bag

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "spacearm_ident" / "nodes").glob("*.py"))
NAMING = {
    "create_publisher": 1,
    "create_subscription": 1,
    "resolve_topic_name": 0,
    "offer": 0,
    "offer_switch": 0,
}
"""Calls that name a topic or service, and which of their arguments does."""
CLIENTS = {"chain.py"}
"""Not nodes of an arm: the demo's own, which talks to nodes it has started without a namespace."""


def names(path: Path) -> list[str]:
    """Topics and services as a module names them, where it does so in so many words."""
    found = []
    for call in ast.walk(ast.parse(path.read_text())):
        if isinstance(call, ast.Call):
            called = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if called in NAMING and len(call.args) > NAMING[called]:
                item = call.args[NAMING[called]]
                found += [item.value] if isinstance(item, ast.Constant) else [ast.unparse(item)]
    return found


def test_no_name_but_that_of_the_diagnostics_is_absolute():
    found = {name for path in SOURCES if path.name not in CLIENTS for name in names(path)}
    assert {"joint_states", "joint_command", "driver/enable", "excitation/state", "identifier/residuals"} <= found
    assert {name for name in found if name.startswith("/")} == {"/diagnostics"}
    assert not {name for name in found if name.endswith("_TOPIC")}, "a recording's topic is absolute"


@pytest.mark.parametrize("node", NODES)
def test_ros_arguments_reach_every_node_from_both_entrances(node, monkeypatch):
    words = ["--ros-args", "-r", "__ns:=/arm_1", "--params-file", "a.yaml", "-p", "x:=1.5", "--log-level", "warn"]
    got = []
    take = lambda name, arguments: got.append((name, list(arguments))) or 0  # noqa: E731
    monkeypatch.setattr(node_command, "start", take)
    monkeypatch.setattr(entry, "start", take)
    assert main(["node", node, *words]) == 0
    monkeypatch.setattr(sys, "argv", [node, *words])
    script = re.search(r'f"\{node\} = ([\w.]+):\{node\}"', (ROOT / "setup.py").read_text())
    assert script and script[1] == entry.__name__
    assert getattr(entry, node)() == 0
    assert got == [(node, words)] * 2


# --- parameter files ----------------------------------------------------------------------------------------------


FILE = """# recorder: of all arms
recorder: {ros__parameters: {prefix: on, buffer_mb: 1e1}}
"trajectory" :
  ros__parameters:
    recorder: nested
/**:
  ros__parameters: {use_sim_time: false}
/arm_1/identifier:
  ros__parameters: {seed: 1}
identifier:
  ros__parameters: {seed: 2}
other: {ros__parameters: {}}
"""


def test_plain_names_are_completed_and_nothing_else_is_touched():
    text = name_in_full(FILE, "/arm_1")
    assert list(yaml.safe_load(text)) == [
        "/arm_1/recorder",
        "/arm_1/trajectory",
        "/**",
        "/arm_1/identifier",
        "identifier",
        "other",
    ]
    assert text.replace("/arm_1/recorder:", "recorder:").replace("/arm_1/trajectory :", '"trajectory" :') == FILE


def test_arguments_are_changed_in_a_namespace_only(tmp_path):
    file = tmp_path / "nodes.yaml"
    file.write_text(FILE)
    words = ["--ros-args", "-p", "a:=b", "--params-file", str(file), "--params-file", "nowhere.yaml"]
    for more in ([], ["-r", "__node:=other"], ["-r", "joint_states:=/x__ns:=y"], ["-r", "__ns:=/"]):
        with holding_in_namespace([*words, *more]) as same:
            assert same == [*words, *more]
    for rule in ("__ns:=/cell/arm_1", "__ns:=cell/arm_1/", "recorder:__ns:=/cell/arm_1"):
        with holding_in_namespace([*words, "-r", rule]) as changed:
            other = Path(changed.pop(4))
            assert changed == [*words[:4], *words[5:], "-r", rule]
            assert other.name == "nodes.yaml" and other.read_text() == name_in_full(FILE, "/cell/arm_1")
        assert not other.exists()


# --- on a graph ---------------------------------------------------------------------------------------------------


def local(*cases):
    from spacearm_ident.nodes.runtime import local_name

    return [local_name(*case) for case in cases]


def test_a_status_belongs_to_one_namespace():
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
    assert local(("recorder: a/b", "/"), ("arm_1/recorder: topics", "/arm_1"), ("a/b/recorder", "/a/b")) == [
        "recorder: a/b",
        "recorder: topics",
        "recorder",
    ]
    assert (
        local(("recorder", "/arm_1"), ("arm_1/recorder", "/"), ("arm_1/recorder", "/arm"), ("a/b/c", "/b"))
        == [None] * 4
    )


def own_names(probe, place: str) -> set[str]:
    """Topics and services of the graph outside a namespace that a node within it has."""
    node, found = probe.node, set()
    for name, namespace in node.get_node_names_and_namespaces():
        if namespace == place:
            for ask in (node.get_publisher_names_and_types_by_node, node.get_subscriber_names_and_types_by_node):
                found |= {topic for topic, _ in ask(name, namespace)}
            found |= {service for service, _ in node.get_service_names_and_types_by_node(name, namespace)}
    return found


def model_file(folder: Path, level: float) -> Path:
    """The small arm, its shoulder with this Coulomb friction."""
    model = small_arm.identified()
    number = [item.name for item in model.model.parameters].index("f_c[shoulder]")
    values = model.parameters.copy()
    values[number] = level
    file = folder / f"model_{level:g}.yaml"
    save_model(replace(model, parameters=values), file)
    return file


@pytest.mark.flaky(reruns=2)  # It must keep time, as what `live_nodes.LIVE` marks.
def test_two_arms_on_one_graph_do_not_meet(graph, tmp_path, capsys):
    """An identifier in each namespace, obeying a parameter file that knows of none, and the recorder of the first."""
    pytest.importorskip("clarabel", reason="needs clarabel in the processes that identify (README.md, ROS 2 Jazzy)")
    from diagnostic_msgs.msg import DiagnosticArray
    from live_nodes import output
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    from spacearm_ident.nodes.runtime import LATCHED, STREAM

    processes, probe = graph
    command = ("-m", "spacearm_ident.cli.main", "node")
    started, told = {}, {}
    for arm, level in (("arm_1", 3.5), ("arm_2", 4.5)):
        file = tmp_path / f"{arm}.yaml"
        own = {"identifier": {"model": str(model_file(tmp_path, level)), "result_directory": str(tmp_path / arm)}}
        own["recorder"] = {"directory": str(tmp_path / f"bags_{arm}")}
        file.write_text(yaml.safe_dump({node: {"ros__parameters": values} for node, values in own.items()}))
        words = ("--ros-args", "-r", f"__ns:=/{arm}", "--params-file", str(file))
        nodes = ("identifier", "recorder") if arm == "arm_1" else ("identifier",)
        started |= {f"{arm}/{node}": processes.python(*command, node, *words) for node in nodes}
        told[arm] = []
        probe.node.create_subscription(DiagnosticArray, f"/{arm}/identifier/parameters", told[arm].append, LATCHED)
    probe.wait_for(lambda: started.keys() <= probe.statuses.keys() and all(told.values()), "both arms")
    for arm, level in (("arm_1", 3.5), ("arm_2", 4.5)):
        values = {item.name: {pair.key: pair.value for pair in item.values} for item in told[arm][-1].status}
        assert float(values["f_c[shoulder]"]["value"]) == level
        outside = {name for name in own_names(probe, f"/{arm}") if not name.startswith(f"/{arm}/")}
        assert outside <= {"/diagnostics", "/rosout", "/parameter_events"}

    accepted, reply = probe.call("/arm_1/recorder/start")
    assert accepted and str(tmp_path / "bags_arm_1") in reply
    run = small_arm.recording(3.0)
    probe.node.create_publisher(String, "/arm_1/robot_description", LATCHED).publish(String(data=small_arm.URDF))
    payloads = cdr.encode_joint_states(
        [run.start_ns + round(1e9 * t) for t in run.time], run.joints, run.position, None, run.effort
    )
    publishers = {arm: probe.node.create_publisher(JointState, f"/{arm}/joint_states", STREAM) for arm in told}
    probe.wait_for(
        lambda: [publishers[arm].get_subscription_count() for arm in ("arm_1", "arm_2")] == [2, 1], "the listeners"
    )
    for number, payload in enumerate(payloads):
        publishers["arm_1"].publish(payload)
        if number >= len(payloads) - 7:
            publishers["arm_2"].publish(payloads[-1])
        probe.spin(0.001)
    probe.wait_for(lambda: probe.values("arm_1/identifier").get("received") == str(len(payloads)), "all of the first")
    probe.wait_for(lambda: probe.values("arm_2/identifier").get("received") == "7", "those of the second, and no other")
    granted, answer = probe.call("/arm_2/identifier/identify")
    assert not granted and "no /robot_description has come" in answer

    probe.must("/arm_1/recorder/stop")
    recording = read_recording(next((tmp_path / "bags_arm_1").iterdir()))
    assert len(recording.time) == len(payloads) and recording.urdf == small_arm.URDF and not recording.issues
    topics: dict[str, str] = {}
    bag = Bag(topics=topics)
    assert list(messages(next((tmp_path / "bags_arm_1").iterdir()), bag=bag))
    assert {"/arm_1/joint_states", "/arm_1/robot_description", "/diagnostics"} <= topics.keys()
    assert all(topic.startswith("/arm_1/") for topic in topics.keys() - {"/diagnostics"})
    assert not (tmp_path / "bags_arm_2").exists()

    assert main(["watch", "--json", "--wait", "30", "--namespace", "/arm_2"]) == 0
    assert {row["name"].partition(":")[0] for row in json.loads(capsys.readouterr().out)["nodes"]} == {"identifier"}
    assert main(["watch", "--once", "--wait", "2.5"]) == 1
    assert "but in /arm_1, /arm_2: say --namespace" in capsys.readouterr().err
    assert not any("Traceback" in output(process) for process in started.values())


def test_a_namespace_that_is_none_is_refused(capsys):
    assert main(["watch", "--once", "--namespace", "arm 1"]) == 2
    assert "not a ROS namespace such as arm_1" in capsys.readouterr().err
