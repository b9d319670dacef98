"""The launch file against stand-ins of the `launch` modules, where the real ones are absent: what it starts, and how.

With the real `ros2 launch`: test_ros2_launch.py.
"""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

from spacearm_ident.config import config_path
from spacearm_ident.nodes.main import NODES

ROOT = Path(__file__).parent.parent


class Made:
    """Stands for every action, event and substitution: remembers how it was made."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs


STAND_INS = {
    "ament_index_python": (),
    "ament_index_python.packages": ("PackageNotFoundError", "get_package_prefix"),
    "launch": ("Action", "Event", "EventHandler", "LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "EmitEvent", "LogInfo", "OpaqueFunction", "RegisterEventHandler"),
    "launch.conditions": ("evaluate_condition_expression",),
    "launch.event_handlers": ("OnProcessExit", "OnProcessIO"),
    "launch.events": (),
    "launch.events.process": ("ProcessExited", "ProcessIO"),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution", "TextSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}
DEFAULTS = {
    "arm": str(config_path("paper_arm.yaml")),
    "can": str(config_path("paper_arm_can.yaml")),
    "params": str(config_path("spacearm.yaml")),
    "namespace": "",
    "sim": "true",
    "record": "true",
    "trajectory": "",
    "recordings": "",
    "results": "",
    "robot_state_publisher": "false",
}


@pytest.fixture
def launch(monkeypatch):
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        for made in classes:
            setattr(module, made, type(made, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["ament_index_python.packages"].PackageNotFoundError = KeyError
    sys.modules["launch.conditions"].evaluate_condition_expression = lambda _, parts: parts[0].kwargs["text"] == "true"
    spec = importlib.util.spec_from_file_location("spacearm_launch", ROOT / "launch" / "spacearm.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def of_kind(entities, kind):
    return [entity for entity in entities if type(entity).__name__ == kind]


def nodes_of(launch, **given):
    """What is started with these arguments: name -> how the node was made."""
    started = launch.start(SimpleNamespace(launch_configurations=DEFAULTS | given))
    return {node.kwargs["executable"]: node.kwargs for node in of_kind(started, "Node")}


def plain(parameters):
    """Parameters by name, without the wrapping that keeps their type."""
    return {key: value.args[0] if isinstance(value, Made) else value for key, value in parameters.items()}


def test_every_argument_is_described_and_has_a_default(launch):
    arguments = of_kind(launch.generate_launch_description().args[0], "DeclareLaunchArgument")
    assert {argument.args[0] for argument in arguments} == set(DEFAULTS)
    assert all(argument.kwargs["description"] for argument in arguments)
    assert all("default_value" in argument.kwargs for argument in arguments)
    either = {argument.args[0] for argument in arguments if "true" in argument.kwargs.get("choices", ())}
    assert either == {name for name, default in DEFAULTS.items() if default in ("true", "false")}


def source_of(node: str) -> str:
    """The modules that a node's parameters may be declared in."""
    return "".join(path.read_text() for path in (ROOT / "spacearm_ident" / "nodes").glob(f"{node}*.py"))


def test_every_node_is_started_by_its_name_with_parameters_that_it_declares(launch):
    nodes = nodes_of(launch, namespace="arm_1", trajectory="run.yaml", recordings="bags", results="/out")
    assert set(nodes) == set(NODES)
    for name, made in nodes.items():
        assert made["name"] == name and made["package"] == "spacearm_ident" and made["namespace"] == "arm_1"
        assert made["parameters"][0] == DEFAULTS["params"]
        for parameter in made["parameters"][1]:
            assert re.search(rf'(parameter|_file)\((node, )?\s*"{parameter}"', source_of(name)), parameter
    own = {name: plain(made["parameters"][1]) for name, made in nodes.items()}
    assert own["recorder"] == {"start_immediately": True, "directory": str(Path("bags").absolute())}
    assert own["identifier"]["result_directory"] == "/out"
    assert own["trajectory"]["trajectory_file"] == str(Path("run.yaml").absolute())


def test_what_is_not_given_is_left_to_the_parameter_file(launch):
    nodes = nodes_of(launch)
    assert plain(nodes["recorder"]["parameters"][1]) == {"start_immediately": True}
    assert "result_directory" not in nodes["identifier"]["parameters"][1]
    assert "trajectory_file" not in nodes["trajectory"]["parameters"][1]


def test_only_the_simulated_arm_depends_on_sim(launch):
    assert set(NODES) - set(nodes_of(launch, sim="false")) == {"simulated_arm"}


def test_state_publisher_has_the_description_and_frames_of_its_namespace(launch):
    made = nodes_of(launch, robot_state_publisher="true", namespace="/arm_1/")["robot_state_publisher"]
    (parameters,) = made["parameters"]
    assert plain(parameters)["robot_description"].startswith("<?xml") and parameters["frame_prefix"] == "arm_1/"
    made = nodes_of(launch, robot_state_publisher="true")["robot_state_publisher"]
    assert "frame_prefix" not in made["parameters"][0]


def test_file_that_is_not_there_is_refused_by_the_name_of_its_argument(launch):
    for name in ("arm", "can", "params"):
        with pytest.raises(RuntimeError, match=f"{name}:=nowhere.yaml: no such file"):
            nodes_of(launch, **{name: "nowhere.yaml"})


def test_launch_says_ready_with_the_last_node_and_passes_on_why_one_failed(launch):
    first_word = pytest.importorskip("spacearm_ident.nodes.runtime", reason="ROS 2 (rclpy) is not installed").READY
    nodes = [Made() for _ in NODES]
    for node, name in zip(nodes, NODES):
        node.node_executable = name
    watch = launch.Watch(nodes, "arm_1")
    said = []
    for node in nodes:
        text = f"[INFO] [1.0] [arm_1.{node.node_executable}]: {first_word}: place of {node.node_executable}\n".encode()
        said.append(watch._listen(SimpleNamespace(action=node, text=text, process_name="x")))
    assert said[:-1] == [[]] * 4
    message = said[-1][0].kwargs["msg"]
    assert "place of recorder" in message and "service call /arm_1/driver/enable" in message
    watch._listen(SimpleNamespace(action=nodes[0], text=b"first\nno such file\n\n", process_name="x"))
    running, ending = SimpleNamespace(is_shutdown=False), SimpleNamespace(is_shutdown=True)
    assert watch._ended(SimpleNamespace(returncode=0, process_name="x", action=nodes[0]), running) == []
    assert watch._ended(SimpleNamespace(returncode=-2, process_name="z", action="another package's"), ending) == []
    (emitted,) = watch._ended(SimpleNamespace(returncode=2, process_name="x", action=nodes[0]), running)
    assert emitted.kwargs["event"].reason == "x ended with exit code 2: no such file"
    assert launch.how_it_ended(1, None) == "ended with exit code 1: it said nothing"
    # One reason is enough: the others end for it.
    assert watch._ended(SimpleNamespace(returncode=2, process_name="y", action=nodes[1]), ending) == []


def test_last_words_of_a_killed_process_are_not_given_as_the_reason(launch):
    node = Made()
    watch = launch.Watch([node], "")
    watch._listen(SimpleNamespace(action=node, text=b"arm stopped: drive 1\n", process_name="driver-2"))
    ended = SimpleNamespace(returncode=-9, process_name="driver-2", action=node)
    (emitted,) = watch._ended(ended, SimpleNamespace(is_shutdown=False))
    said = "driver-2 ended with exit code -9: killed by SIGKILL; before that, it said last: arm stopped: drive 1"
    assert emitted.kwargs["event"].reason == said
    assert launch.how_it_ended(-11, None) == "ended with exit code -11: killed by SIGSEGV"


def test_the_parameter_file_names_only_parameters_that_exist():
    given = yaml.safe_load((ROOT / "config" / "spacearm.yaml").read_text())
    assert set(given) == set(NODES)
    for node, parameters in given.items():
        source = source_of(node)
        for name in parameters["ros__parameters"]:
            assert f'"{name}"' in source, f"{node} has no parameter {name}"
