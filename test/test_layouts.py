"""The layouts of Foxglove and PlotJuggler, against messages made by the nodes' own code: nothing in them is empty."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState

from spacearm_ident.canbus.bus_load import BusLoad
from spacearm_ident.canbus.cia402 import State
from spacearm_ident.commissioning.layouts import FOXGLOVE, PLOTJUGGLER, foxglove_layout, plotjuggler_layout
from spacearm_ident.driver.status import DriverStatus, Phase
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.nodes.canopen_driver import _values
from spacearm_ident.nodes.identifier_messages import parameter_statuses, parameters_message, torque_message
from spacearm_ident.nodes.joint_stream import JointStateWriter
from spacearm_ident.nodes.residual_stream import ResidualStream

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "config"


def status(name: str, values: dict[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, hardware_id="paper_arm", values=pairs)


@pytest.fixture(scope="module")
def graph() -> dict[str, object]:
    """A message of every topic, made as the nodes make them."""
    model = load_model(CONFIG / "paper_arm_model.yaml")
    joints = model.model.arm.joint_names
    stream, writer = ResidualStream(model, 50.0), JointStateWriter(joints, "position", "effort")
    angle = np.sin(np.linspace(0.0, 9.0, 600))[:, None] * np.linspace(0.1, 0.2, len(joints))
    rows = stream.add([writer.payload(k * 5_000_000, q, 10 * q) for k, q in enumerate(angle)])
    driver = DriverStatus(
        phase=Phase.ENABLED,
        fault=None,
        resumable=False,
        connection="connected",
        states=dict.fromkeys(joints, State.OPERATION_ENABLED),
        **dict.fromkeys(("cycles", "missed", "incomplete", "late_frames", "malformed", "samples", "set_points"), 1),
        lateness_s=(1e-6, 2e-6, 3e-6),
        buffered_s=0.1,
        stalls=1,
        lag_s=0.0,
        temperature_failures=0,
        reconnections=0,
        loads=(BusLoad(0.7, 0.8),),
        warnings=(),
    )
    statuses = [status("canopen_driver", _values(driver)), status("identifier: residual", stream.figures())]
    return {
        "/joint_states": JointState(name=joints, position=angle[0], effort=angle[0]),
        "/identifier/residuals": torque_message(joints, 7_000_000_001, rows[0].residual),
        "/identifier/predicted": torque_message(joints, 7_000_000_001, rows[0].predicted),
        "/identifier/parameters": parameters_message(Time(), parameter_statuses("paper_arm", model, None)),
        "/diagnostics": DiagnosticArray(status=statuses),
    }


def foxglove_value(graph: dict[str, object], path: str) -> object:
    """What a message path of Foxglove gives: fields, an index, a slice with a filter."""
    topic, rest = re.fullmatch(r"(/[\w/]+)(.*)", path).groups()
    value = graph[topic]
    for name, index, key, text in re.findall(r'\.(\w+)(?:\[(\d+)\]|\[:\]\{(\w+)==("[^"]*")\})?', rest):
        value = getattr(value, name)
        if index:
            value = value[int(index)]
        elif key:
            found = [item for item in value if getattr(item, key) == json.loads(text)]
            assert len(found) == 1, f"{path}: {len(found)} with {key} {text}"
            value = found[0]
    return value


def plotjuggler_series(graph: dict[str, object]) -> set[str]:
    """The series PlotJuggler's ROS parser makes of the messages: joints by name, diagnostics where a number."""
    names = set()
    for topic, message in graph.items():
        if isinstance(message, JointState):
            names |= {f"{topic}/{joint}/effort" for joint, _ in zip(message.name, message.effort)}
            continue
        for item in message.status:
            prefix = "/".join(filter(None, (topic, item.hardware_id, item.name)))
            for pair in item.values:
                try:
                    float(pair.value)
                except ValueError:
                    continue
                names.add(f"{prefix}/{pair.key}")
    return names


def panels(layout: object) -> list[str]:
    if isinstance(layout, str):
        return [layout]
    return [*panels(layout["first"]), *panels(layout["second"])]


def test_foxglove_shows_only_what_is_there(graph):
    layout = json.loads((CONFIG / FOXGLOVE).read_text())
    known = layout["configById"]
    paths = [path["value"] for name, panel in known.items() if name.startswith("Plot") for path in panel["paths"]]
    assert len(paths) > 6 * 3 + 6 * 3
    for path in paths:
        assert np.isfinite(float(foxglove_value(graph, path))), path
    assert foxglove_value(graph, known["RawMessages!0"]["topicPath"]).name == "canopen_driver"
    assert known["DiagnosticSummary!0"]["topicToRender"] in graph
    shown = panels(layout["layout"]) + [p for tab in known["Tab!0"]["tabs"] for p in panels(tab["layout"])]
    assert sorted(shown) == sorted(known), "every panel is somewhere, and every place has its panel"


def test_plotjuggler_shows_only_what_is_there(graph):
    curves = [curve.get("name") for curve in ET.parse(CONFIG / PLOTJUGGLER).iter("curve")]
    assert len(curves) == len(set(curves)) > 6 * 3 + 6 * 3
    assert set(curves) <= plotjuggler_series(graph), set(curves) - plotjuggler_series(graph)
    for splitter in ET.parse(CONFIG / PLOTJUGGLER).iter("DockSplitter"):
        assert int(splitter.get("count")) == len(splitter) == len(splitter.get("sizes").split(";"))


def test_every_topic_is_published_by_a_node(graph):
    sources = "".join(path.read_text() for path in (ROOT / "spacearm_ident" / "nodes").glob("*.py"))
    for topic in graph:
        assert re.search(rf'create_publisher\(\w+, "/?{topic[1:]}"', sources), topic


def test_the_files_are_those_of_the_arm(graph):
    arm = load_model(CONFIG / "paper_arm_model.yaml").model.arm
    assert (CONFIG / FOXGLOVE).read_text() == foxglove_layout(arm.joint_names)
    assert (CONFIG / PLOTJUGGLER).read_text() == plotjuggler_layout(arm.name, arm.joint_names)


@pytest.mark.parametrize("joints", [("only",), ("a", "b&<c>"), tuple(f"j{k}" for k in range(9))])
def test_any_arm_has_its_layout(joints):
    layout = json.loads(foxglove_layout(joints))
    torque = layout["configById"]["Tab!0"]["tabs"][0]["layout"]
    assert len(panels(torque)) == len(joints)
    names = {
        curve.get("name") for curve in ET.fromstring(plotjuggler_layout("arm", joints).split("\n", 1)[1]).iter("curve")
    }
    assert {f"/joint_states/{joint}/effort" for joint in joints} <= names
