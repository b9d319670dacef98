"""All nodes of spacearm_ident: driver, trajectory, recorder, identifier, and the simulated arm unless `sim:=false`.

It says when all nodes are ready and what to call next. When one of them fails it ends, with exit code 1 and the reason.
"""

import signal
from collections.abc import Iterator
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.conditions import evaluate_condition_expression
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events.process import ProcessExited, ProcessIO
from launch.substitutions import PathJoinSubstitution, TextSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import Action, Event, EventHandler, LaunchContext, LaunchDescription

PACKAGE = "spacearm_ident"
STATE_PUBLISHER = "robot_state_publisher"
READY = "]: ready: "
"""Between a node's name and what it is ready for, in the line that it logs once."""
WHETHER = ["true", "false", "True", "False", "1", "0"]
"""What an argument that is either may be."""
ORDERLY_S = "30"
"""Seconds a node has to end after SIGINT before it is sent SIGTERM, and after that before it is killed: the trajectory
node may take 15 s to bring the arm to rest, and a recording must be finished. launch's own 5 s would cut both short."""


def generate_launch_description() -> LaunchDescription:
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), "config"])

    def argument(name: str, default: object, description: str, **more: list[str]) -> DeclareLaunchArgument:
        return DeclareLaunchArgument(name, default_value=default, description=description, **more)

    return LaunchDescription(
        [
            argument("arm", PathJoinSubstitution([config, "paper_arm.yaml"]), "arm YAML: limits, gears, URDF"),
            argument("can", PathJoinSubstitution([config, "paper_arm_can.yaml"]), "CAN YAML: buses and drives"),
            argument("namespace", "", "namespace of all nodes, such as arm_1 where there are two; empty: none"),
            argument("params", PathJoinSubstitution([config, "spacearm.yaml"]), "ROS parameters of all nodes"),
            argument(
                "sim", "true", "whether to start the simulated arm; false: the drives are on the buses", choices=WHETHER
            ),
            argument("record", "true", "whether to record from the start; false: on /recorder/start", choices=WHETHER),
            argument("trajectory", "", "excitation file for /excitation/start"),
            argument("recordings", "", "folder for the bags; empty: as in params (the recorder's directory)"),
            argument("results", "", "folder for the results; empty: as in params (the identifier's result_directory)"),
            argument(
                STATE_PUBLISHER,
                "false",
                "whether to start robot_state_publisher (a package of its own) for TF; in a namespace the frames are "
                "called arm_1/LINK",
                choices=WHETHER,
            ),
            OpaqueFunction(function=start),
        ]
    )


def start(context: LaunchContext) -> list[Action]:
    """The nodes, and what watches over their start and end."""

    def given(name: str) -> str:
        return context.launch_configurations[name]

    def file(name: str) -> str:
        # launch passes over a parameter file that is not there with a warning, and the nodes would have their defaults.
        path = Path(given(name)).expanduser().absolute()
        if not path.is_file():
            raise RuntimeError(f"{name}:={given(name)}: no such file")
        return str(path)

    def whether(name: str) -> bool:
        return evaluate_condition_expression(context, [TextSubstitution(text=given(name))])

    def node(name: str, **parameters: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=namespace,
            output="screen",
            # What is empty is left to the parameter file.
            parameters=[params, {key: value for key, value in parameters.items() if value != ""}],
            sigterm_timeout=ORDERLY_S,
            sigkill_timeout=ORDERLY_S,
        )

    def place(name: str) -> str | ParameterValue:
        return text(str(Path(given(name)).expanduser().absolute())) if given(name) else ""

    params, arm, can, namespace = file("params"), file("arm"), file("can"), given("namespace").strip("/")
    nodes = [
        node("canopen_driver", can_config=text(can)),
        node("trajectory", arm=text(arm), trajectory_file=place("trajectory")),
        node("recorder", start_immediately=whether("record"), directory=place("recordings")),
        node("identifier", arm=text(arm), result_directory=place("results")),
    ]
    if whether("sim"):
        nodes.insert(0, node("simulated_arm", can_config=text(can)))
    others = [state_publisher(arm, namespace)] if whether(STATE_PUBLISHER) else []
    return [*Watch(nodes, namespace).handlers(), *others, *nodes]


def text(value: str) -> ParameterValue:
    """A parameter that stays a string, however it looks."""
    return ParameterValue(value, value_type=str)


def state_publisher(arm: str, namespace: str) -> Node:
    """robot_state_publisher with the arm's URDF.

    Args:
        arm: Arm YAML or URDF.
        namespace: Of all nodes; empty for none.

    Raises:
        RuntimeError: The package is not installed.
    """
    try:
        get_package_prefix(STATE_PUBLISHER)
    except PackageNotFoundError as error:
        raise RuntimeError(
            f"{STATE_PUBLISHER} is not installed: apt install ros-jazzy-robot-state-publisher, or launch without "
            f"{STATE_PUBLISHER}:=true"
        ) from error
    from spacearm_ident.dynamics.arm import load_arm

    parameters = {"robot_description": text(load_arm(Path(arm)).urdf)}
    if namespace:
        # /tf is one for the whole graph.
        parameters["frame_prefix"] = f"{namespace}/"
    return Node(
        package=STATE_PUBLISHER,
        executable=STATE_PUBLISHER,
        name=STATE_PUBLISHER,
        namespace=namespace,
        output="screen",
        parameters=[parameters],
        # The driver publishes the description already.
        remappings=[("robot_description", f"{STATE_PUBLISHER}/robot_description")],
    )


class NodeFailed(Event):
    """A node has ended with an error."""

    name = f"{PACKAGE}.NodeFailed"

    def __init__(self, reason: str) -> None:
        self.reason = reason


class Watch:
    """Says when all nodes are ready; ends the launch when one fails.

    `ros2 launch` returns something other than 0 only where handling an event raised an exception (or an action could
    not be executed), which shuts everything else down as Ctrl-C would. It is raised in the handling of an event of its
    own, so that the handlers of the node's exit, which print its last words, all come to their turn.
    """

    def __init__(self, nodes: list[Node], namespace: str) -> None:
        """Watch over `nodes`, which are in `namespace` (empty for none)."""
        self._place = f"/{namespace}" if namespace else ""
        self._nodes, self._waiting = frozenset(nodes), set(nodes)
        self._places: dict[str, str] = {}
        self._last_words: dict[str, str] = {}
        self._failed = False

    def handlers(self) -> Iterator[RegisterEventHandler]:
        """What to put into the launch description before the nodes."""
        yield RegisterEventHandler(OnProcessIO(on_stdout=self._listen, on_stderr=self._listen))
        yield RegisterEventHandler(OnProcessExit(on_exit=self._ended))
        yield RegisterEventHandler(EventHandler(matcher=lambda event: isinstance(event, NodeFailed), entities=[FAIL]))

    def _listen(self, event: ProcessIO) -> list[Action]:
        lines = event.text.decode(errors="replace").splitlines()
        for line in lines:
            if READY in line and event.action in self._waiting:
                self._waiting.remove(event.action)
                self._places[event.action.node_executable] = line.partition(READY)[2].strip()
                if not self._waiting:
                    return [LogInfo(msg=self._all_ready())]
            if line.strip():
                self._last_words[event.process_name] = line.strip()
        return []

    def _all_ready(self) -> str:
        return (
            f"all nodes are ready; recorder: {self._places['recorder']}; identifier: {self._places['identifier']}; "
            f"trajectory: {self._places['trajectory']}. "
            f"Next: ros2 service call {self._place}/driver/enable std_srvs/srv/SetBool '{{data: true}}'"
        )

    def _ended(self, event: ProcessExited, context: LaunchContext) -> list[Action]:
        # Nodes of other packages may take a second SIGINT for their death.
        ending = context.is_shutdown and event.action not in self._nodes
        if event.returncode == 0 or self._failed or ending:
            return []
        self._failed = True
        words = self._last_words.get(event.process_name)
        return [EmitEvent(event=NodeFailed(f"{event.process_name} {how_it_ended(event.returncode, words)}"))]


def how_it_ended(code: int, words: str | None) -> str:
    """How a process ended that did not end well, and its last words.

    They are the reason where it ended by itself. What a signal killed had no time to say why, and said them before, of
    something else.

    Args:
        code: Exit code; that of a signal is below 0.
        words: What it said last, if anything.
    """
    if code >= 0:
        return f"ended with exit code {code}: {words or 'it said nothing'}"
    number = -code
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    killed = f"ended with exit code {code}: killed by {name}"
    return f"{killed}; before that, it said last: {words}" if words else killed


def fail(context: LaunchContext) -> None:
    """Have the launch end with an error."""
    raise RuntimeError(context.locals.event.reason)


FAIL = OpaqueFunction(function=fail)
