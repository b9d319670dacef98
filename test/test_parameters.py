"""Every parameter of every node is described, ranged where it is a number, and marked where it is read only once."""

import importlib
import math

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from rcl_interfaces.msg import ParameterType
from rclpy.signals import SignalHandlerOptions

from spacearm_ident.commissioning.params_check import EVERY_NODE, declared_parameters
from spacearm_ident.errors import UserError
from spacearm_ident.nodes.main import NODES
from spacearm_ident.nodes.runtime import LiveNode

CLASSES = {
    "canopen_driver": "CanopenDriver",
    "trajectory": "TrajectoryNode",
    "identifier": "Identifier",
    "recorder": "Recorder",
    "simulated_arm": "SimulatedArm",
}
REFUSED = {"canopen_driver": "can_config", "simulated_arm": "can_config", "trajectory": "arm"}
"""A file that is not there ends the start behind the last declaration, before a bus or the process is touched."""
CHANGEABLE = {"trajectory_file"}
"""Read anew at every start of a run."""
OF_RCLPY = EVERY_NODE | {"start_type_description_service"}


@pytest.fixture(params=NODES)
def node(request, monkeypatch, tmp_path):
    """A node of that name, in this process, as far as it declares its parameters."""
    made = []
    begin = LiveNode.__init__

    def remembered(self, *arguments, **options):
        begin(self, *arguments, **options)
        made.append(self)

    monkeypatch.setattr(LiveNode, "__init__", remembered)
    file = [f"{REFUSED[request.param]}:={tmp_path / 'nowhere.yaml'}"] if request.param in REFUSED else []
    words = [word for value in file for word in ("--ros-args", "-p", value)]
    kind = getattr(importlib.import_module(f"spacearm_ident.nodes.{request.param}"), CLASSES[request.param])
    rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    try:
        if file:
            with pytest.raises(UserError, match="nowhere"):
                kind()
        else:
            kind()
        yield made[0]
    finally:
        for one in made:
            if not file:
                one.close()
            one.destroy_node()
        rclpy.try_shutdown()


def test_every_parameter_is_described_ranged_and_marked(node):
    declared = {name for name in node.list_parameters([], 0).names if name not in OF_RCLPY}
    assert declared == declared_parameters(node.get_name()).keys()
    for descriptor in node.describe_parameters(sorted(declared)):
        name = descriptor.name
        assert len(descriptor.description) > 8, name
        assert descriptor.read_only is (name not in CHANGEABLE), name
        match node.get_parameter(name).get_parameter_value().type:
            case ParameterType.PARAMETER_INTEGER:
                (bounds,) = descriptor.integer_range
            case ParameterType.PARAMETER_DOUBLE:
                (bounds,) = descriptor.floating_point_range
            case _:  # ROS has ranges for single numbers only
                continue
        assert math.isfinite(bounds.from_value) and math.isfinite(bounds.to_value), name
        assert bounds.from_value <= node.get_parameter(name).value <= bounds.to_value, name


def test_types_and_ranges_read_from_the_source_are_those_the_node_declares(node):
    types = {
        ParameterType.PARAMETER_BOOL: (bool, False),
        ParameterType.PARAMETER_INTEGER: (int, False),
        ParameterType.PARAMETER_DOUBLE: (float, False),
        ParameterType.PARAMETER_STRING: (str, False),
        ParameterType.PARAMETER_STRING_ARRAY: (str, True),
        ParameterType.PARAMETER_DOUBLE_ARRAY: (float, True),
    }
    known = {name: one for name, one in declared_parameters(node.get_name()).items() if one.kind is not None}
    assert len(known) > 3
    for descriptor in node.describe_parameters(sorted(known)):
        one = known[descriptor.name]
        value = node.get_parameter(descriptor.name)
        assert types[value.get_parameter_value().type] == (one.kind, one.several), descriptor.name
        for bounds in (*descriptor.integer_range, *descriptor.floating_point_range):
            # A limit that the source names by a constant is not known, and then not checked.
            assert one.low in (bounds.from_value, -math.inf), descriptor.name
            assert one.high in (bounds.to_value, math.inf), descriptor.name
        assert descriptor.additional_constraints == ("" if one.choices is None else str(one.choices)), descriptor.name
        assert not one.refusal(value.value if not one.several else list(value.value)), descriptor.name


def test_what_is_marked_read_only_cannot_be_changed(node):
    for name in sorted(declared_parameters(node.get_name())):
        parameter = node.get_parameter(name)
        (result,) = node.set_parameters([parameter])
        assert result.successful is (name in CHANGEABLE), name


def test_a_file_parameter_is_found_from_the_home_folder_and_refused_where_it_is_read_at_once(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "arm.yaml").touch()
    given = {"there": "~/arm.yaml", "later": "~/no.yaml", "missing": "~/no.yaml"}
    words = [word for name, file in given.items() for word in ("-p", f"{name}:={file}")]
    rclpy.init(args=["--ros-args", *words], signal_handler_options=SignalHandlerOptions.NO)
    node = LiveNode("sample")
    try:
        assert node.file_parameter("there", "a file") == tmp_path / "arm.yaml"
        assert node.file_parameter("empty", "a file") is None
        assert node.file_parameter("later", "a file", read_only=False) == tmp_path / "no.yaml"
        with pytest.raises(UserError, match=r"parameter missing: .*no.yaml: no such file"):
            node.file_parameter("missing", "a file")
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
