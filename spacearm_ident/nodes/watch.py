"""`spacearm watch`: listens to the live graph and keeps a screen of it; publishes nothing, calls nothing.

Joint states are not heard one by one: twenty times a second the newest is taken, and its number in the publisher's
stream says how many there were.
"""

from __future__ import annotations

import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.live import Live
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from ..errors import UnfitDataError
from ..recording import cdr
from ..recording.messages import STATES_TOPIC, TEMPERATURES_TOPIC
from .ending import heed_signals
from .main import NODES
from .offers import raw_subscription, taken
from .runtime import LATCHED, local_name, relative
from .watch_screen import screen
from .watch_state import View, WatchState

SPIN_S = 0.05
ALL_NODES_S = 1.2
"""After the last new node has spoken: each speaks every second."""


class Listener:
    """A hidden node that feeds a `WatchState` with what the nodes of one namespace say.

    Attributes:
        elsewhere: Namespaces in which other nodes of this package were heard.
    """

    def __init__(self, namespace: str = "") -> None:
        self.state = WatchState()
        self.elsewhere: set[str] = set()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = self._hidden_node("_spacearm_watch", namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._statuses, 100)
        self._node.create_subscription(DiagnosticArray, "identifier/parameters", self._parameters, LATCHED)
        self._node.create_subscription(String, "excitation/state", self._run, LATCHED)
        self._node.create_subscription(Temperature, relative(TEMPERATURES_TOPIC), self._temperature, 10)
        # In no executor: taken when a screen is due, for a wake-up a message would cost more than all the rest.
        self._unspun = self._hidden_node("_spacearm_watch_joints", namespace)
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._joints = raw_subscription(self._unspun, JointState, relative(STATES_TOPIC), newest)

    def _hidden_node(self, name: str, namespace: str) -> Node:
        return rclpy.create_node(
            name, namespace=namespace, context=self._context, enable_rosout=False, start_parameter_services=False
        )

    def __enter__(self) -> Listener:
        """The listener."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._unspun.destroy_node()
        self._context.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Listen for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, SPIN_S))
            self._take_joints()

    def view(self, most_parameters: int) -> View:
        """What is so now."""
        return self.state.view(time.monotonic(), most_parameters)

    def _take_joints(self) -> None:
        # The queue holds one message: the newest.
        for payload, info in taken(self._joints):
            for block in cdr.decode_joint_states([payload])[0]:
                position, effort = (() if part is None else part[0].tolist() for part in (block.position, block.effort))
                number = info["publication_sequence_number"]
                self.state.hear_joints(block.names, position, effort, number, time.monotonic())

    def _statuses(self, message: DiagnosticArray) -> None:
        for item in message.status:
            name = local_name(item.name, self._node.get_namespace())
            if name is None:
                place, _, other = item.name.rpartition("/")
                if other in NODES:
                    self.elsewhere.add(f"/{place}")
                continue
            values = {pair.key: pair.value for pair in item.values}
            self.state.hear_status(name, item.level[0], item.message, item.hardware_id, values, time.monotonic())

    def _parameters(self, message: DiagnosticArray) -> None:
        self.state.hear_parameters(
            (item.name, {pair.key: pair.value for pair in item.values}) for item in message.status
        )

    def _run(self, message: String) -> None:
        self.state.hear_run(message.data)

    def _temperature(self, message: Temperature) -> None:
        self.state.hear_temperature(message.header.frame_id, message.temperature)


def look_once(wait_s: float, most_parameters: int, namespace: str = "") -> View:
    """One view of a namespace, after every node has had a second to publish.

    Args:
        wait_s: Longest wait for the first node, s.
        most_parameters: Most parameters to include in the view.
        namespace: ROS namespace without leading slash; empty: the root.

    Raises:
        UnfitDataError: No node speaks within `wait_s`.
    """
    with Listener(namespace) as listener:
        end = time.monotonic() + wait_s
        while not listener.state.nodes_heard:
            if time.monotonic() > end and listener.elsewhere:
                heard = ", ".join(sorted(listener.elsewhere))
                raise UnfitDataError(f"no node was found in /{namespace}, but in {heard}: say --namespace")
            if time.monotonic() > end:
                raise UnfitDataError(
                    f"no node of spacearm_ident was found within {wait_s:g} s: start them (docs/live.md), or set "
                    "ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as theirs are"
                )
            listener.spin(SPIN_S)
        known = 0
        while listener.state.nodes_heard > known and time.monotonic() < end + ALL_NODES_S:
            known = listener.state.nodes_heard
            listener.spin(ALL_NODES_S)
        return listener.view(most_parameters)


def watch(console: Console, rate_hz: float, most_parameters: int, namespace: str = "") -> None:
    """Keep a screen of a namespace up to date until SIGINT or SIGTERM; the terminal is then restored.

    Args:
        console: Terminal to draw on.
        rate_hz: Screens a second, Hz.
        most_parameters: Most parameters to show.
        namespace: ROS namespace without leading slash; empty: the root.
    """
    # An exception out of a signal handler, in the middle of a C++ call, becomes another one there.
    stop = heed_signals()
    with Listener(namespace) as listener, Live(console=console, screen=True, auto_refresh=False) as live:
        while not stop.is_set():
            listener.spin(1.0 / rate_hz)
            live.update(screen(listener.view(most_parameters)), refresh=True)
