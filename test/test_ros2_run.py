"""`colcon build`, `ros2 run` and `ros2 pkg`, with the real tools: every node, however its arguments are given."""

import contextlib
import os
from pathlib import Path

import pytest
import yaml
from live_nodes import LIVE
from ros2_tools import NEEDED, ROOT

from spacearm_ident.nodes.main import NODES

pytestmark = [*LIVE, NEEDED]
GIVEN = {
    "simulated_arm": ("seed", 7),
    "canopen_driver": ("temperature_hz", 2.5),
    "trajectory": ("rate_hz", 500.5),
    "recorder": ("prefix", "typed"),
    "identifier": ("buffer_s", 42.5),
}
"""A parameter of each node, and a value that is not its default."""
FORMS = {
    "parameters": ((), "/"),
    "file in an empty namespace": (("-r", "__ns:=/", "--params-file", "FILE"), "/"),
    "file in a namespace": (("-r", "__ns:=/arm_1", "--params-file", "FILE"), "/arm_1/"),
}


def held(probe, node, name):
    """The value of a node's parameter."""
    from rcl_interfaces.srv import GetParameters
    from rclpy.parameter import parameter_value_to_python

    client = probe.node.create_client(GetParameters, f"{node}/get_parameters")
    probe.wait_for(client.service_is_ready, f"the parameters of {node}")
    future = client.call_async(GetParameters.Request(names=[name]))
    probe.wait_for(future.done, f"the value of {name}")
    return parameter_value_to_python(future.result().values[0])


def test_colcon_builds_the_package_in_an_empty_workspace(workspace):
    assert workspace.build.returncode == 0, workspace.build.stderr
    assert "1 package finished" in workspace.build.stdout
    listed = workspace.run("ros2", "pkg", "executables", "spacearm_ident").stdout.split()
    assert set(listed) - {"spacearm_ident"} == {*NODES, "spacearm"}
    share = Path(workspace.run("ros2", "pkg", "prefix", "--share", "spacearm_ident").stdout.strip())
    for folder in ("config", "launch"):
        installed, meant = ({path.name for path in (top / folder).iterdir() if path.is_file()} for top in (share, ROOT))
        assert installed == meant


def test_offline_command_answers_on_the_path_and_from_ros2_run(workspace, tmp_path):
    for words in (("spacearm",), ("ros2", "run", "spacearm_ident", "spacearm")):
        told = workspace.run(*words, "report", "--help", cwd=tmp_path)
        assert told.returncode == 0 and told.stdout.startswith("usage: spacearm report"), told.stderr
        assert workspace.run(*words, "report", "nowhere", cwd=tmp_path).returncode == 2


@pytest.mark.parametrize("form", FORMS)
def test_every_node_runs_with_the_parameters_given(workspace, graph, tmp_path, form):
    (words, place), probe = FORMS[form], graph[1]
    own = workspace.apart() | {"ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"]}  # the probe's
    file = tmp_path / "nodes.yaml"
    file.write_text(yaml.safe_dump({node: {"ros__parameters": dict([pair])} for node, pair in GIVEN.items()}))
    with contextlib.ExitStack() as stack:
        started = {}
        for node, (name, value) in GIVEN.items():
            ros = [word.replace("FILE", str(file)) for word in words] or ["-p", f"{name}:={value}"]
            command = ("ros2", "run", "spacearm_ident", node, "--ros-args", *ros)
            started[node] = stack.enter_context(workspace.started(*command, cwd=tmp_path, **own))
        for process in started.values():
            process.wait_until_said("]: ready: ")
        assert {node: held(probe, f"{place}{node}", GIVEN[node][0]) for node in NODES} == {
            node: value for node, (_, value) in GIVEN.items()
        }
        assert {node: process.interrupt() for node, process in started.items()} == dict.fromkeys(NODES, 0)
        assert not any(process.members() for process in started.values())
    assert not any("Traceback" in process.said for process in started.values())
