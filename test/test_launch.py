"""The launch file, against stand-ins of the `launch` modules: what it starts, with which arguments."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from spacearm_ident.nodes.main import NODES

ROOT = Path(__file__).parent.parent


class Made:
    """Stands for every action and substitution: remembers how it was made."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs


STAND_INS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument",),
    "launch.conditions": ("IfCondition",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


@pytest.fixture
def entities(monkeypatch):
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        for made in classes:
            setattr(module, made, type(made, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("spacearm_launch", ROOT / "launch" / "spacearm.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description().args[0]


def of_kind(entities, kind):
    return [entity for entity in entities if type(entity).__name__ == kind]


def used(value):
    """Names of all launch configurations in a value, however deep."""
    if type(value).__name__ == "LaunchConfiguration":
        return {value.args[0]}
    if isinstance(value, Made):
        return used([value.args, value.kwargs])
    if isinstance(value, dict):
        return used(list(value.values()))
    return set().union(*map(used, value)) if isinstance(value, list | tuple) else set()


def test_every_argument_is_described_and_used(entities):
    arguments = of_kind(entities, "DeclareLaunchArgument")
    assert {argument.args[0] for argument in arguments} == {
        "namespace",
        "arm",
        "can",
        "params",
        "sim",
        "record",
        "trajectory",
    }
    assert all(argument.kwargs["description"] for argument in arguments)
    assert used(of_kind(entities, "Node")) == {argument.args[0] for argument in arguments}


def source_of(node: str) -> str:
    """The modules that a node's parameters may be declared in."""
    return "".join(path.read_text() for path in (ROOT / "spacearm_ident" / "nodes").glob(f"{node}*.py"))


def test_every_node_is_started_by_its_name_with_its_parameters(entities):
    nodes = of_kind(entities, "Node")
    assert {node.kwargs["executable"] for node in nodes} == set(NODES)
    for node in nodes:
        assert node.kwargs["name"] == node.kwargs["executable"] and node.kwargs["package"] == "spacearm_ident"
        assert used(node.kwargs["namespace"]) == {"namespace"}
        source = source_of(node.kwargs["executable"])
        assert used(node.kwargs["parameters"][0]) == {"params"}
        for name in node.kwargs["parameters"][1]:
            assert re.search(rf'(parameter|_file)\((node, )?\s*"{name}"', source)


def test_only_the_simulated_arm_depends_on_sim(entities):
    conditional = [node for node in of_kind(entities, "Node") if node.kwargs["condition"] is not None]
    assert [node.kwargs["executable"] for node in conditional] == ["simulated_arm"]
    assert used(conditional[0].kwargs["condition"]) == {"sim"}


def test_the_parameter_file_names_only_parameters_that_exist():
    given = yaml.safe_load((ROOT / "config" / "spacearm.yaml").read_text())
    assert set(given) == set(NODES)
    for node, parameters in given.items():
        source = source_of(node)
        for name in parameters["ros__parameters"]:
            assert f'"{name}"' in source, f"{node} has no parameter {name}"
