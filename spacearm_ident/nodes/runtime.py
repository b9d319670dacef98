"""What every node needs: a life from start to clean end, parameters, services, `/diagnostics`, QoS.

A node is a subclass of `LiveNode` in the module of its name, which ends with

    def main(arguments: Sequence[str]) -> int:
        return run(Recorder, arguments)

Its `__init__` declares parameters (`parameter`), services (`offer`, `offer_switch`), publishers and
subscriptions; it overrides `diagnose` (called once a second, and by `publish_diagnostics` at once), `readiness` (asked
until it says what the node is ready for, which is logged once) and `close` (called once, while it can still publish:
bring the arm to rest, end threads, close files). Bad input is a `UserError`: in `__init__` the process says it in one
line and exits with 2; in a service it is the reply.
Callbacks run in the main thread, one after another; a node that has a deadline keeps its own thread.

Topics and services are named relatively (`joint_states`, `driver/enable`), so that they follow the node's namespace;
only `/diagnostics` is one for the whole graph, as in all of ROS 2, and says in each status whose it is (`local_name`).
"""

from __future__ import annotations

import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from ..canbus.realtime import give_way, prepare_thread
from ..documents import try_folder
from ..errors import UserError
from .choices import Choices
from .ending import heed_signals, ignore_signals
from .params_file import holding_in_namespace

try:
    from rclpy.experimental import EventsExecutor as LiveExecutor
except ImportError:  # rclpy before 7.1.4: the same life, at three times the processor time
    LiveExecutor = SingleThreadedExecutor

STREAM: Final = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=5000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Streams at 1 kHz, both ends: five seconds of messages ride out a stalled subscriber without loss."""

LATCHED: Final = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The last message, for who comes late too."""

READY: Final = "ready"
"""First word of what a node logs once it can do what it is there for; the launch file looks for it."""

_SENDER: Final = "dds.asyn"
"""Fast DDS's thread that sends what could not be sent at once. Until another thread has let go of a writer it asks
again and again (ros2/rmw_fastrtps issue 666): of the same real-time priority and on the same core it would do so for
ever, and the cycle would wait for that writer."""
_SPIN_S = 0.1
_DIAGNOSTICS_S = 1.0

Value = TypeVar("Value", bool, int, float, str, list[str], list[float])


class Level(IntEnum):
    """How well a part of the system is, in the words of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """One line of `/diagnostics`.

    Attributes:
        level: How well it is.
        message: One sentence for a person.
        values: Figures for programs; booleans become `true` and `false`, floats six digits.
        part: Which part of the node it is about; empty for the node as a whole.
    """

    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)
    part: str = ""


def relative(topic: str) -> str:
    """A recording's topic as a node names it: it follows the node's namespace."""
    return topic.removeprefix("/")


def local_name(status: str, namespace: str) -> str | None:
    """The name of a diagnostics status without its namespace, or None where it is from another one.

    Args:
        status: `recorder: topics`, or `arm_1/recorder: topics` of a node in the namespace `/arm_1`.
        namespace: That of who listens, as rclpy says it (`/` where there is none).
    """
    node, colon, part = status.partition(":")
    place, _, name = node.rpartition("/")
    return name + colon + part if place == namespace.strip("/") else None


def require_folder(parameter: str, directory: Path) -> Path:
    """The folder, if what a node will have to write can be written there: known before an arm is moved for it.

    Args:
        parameter: Name of the parameter that names it.
        directory: The folder; need not be there yet.

    Raises:
        UserError: It cannot.
    """
    try:
        try_folder(directory)
    except OSError as error:
        why = error.strerror or error
        raise UserError(
            f"parameter {parameter}: {directory} cannot be written ({why}); name a folder that can be"
        ) from error
    return directory


class LiveNode(Node):
    """A node with parameters, services and diagnostics in the manner of this package.

    Args:
        name: Node name; its diagnostics are called `name` and `name: part`, in a namespace `arm_1/name`.
        hardware_id: What the diagnostics are about, such as the arm's name.

    Attributes:
        exit_code: Set it and `run` ends with it, after `close`.
        stamps: Of the latest diagnostics published, s and ns: who hears others knows them from its own.
    """

    def __init__(self, name: str, hardware_id: str = "") -> None:
        super().__init__(name)
        self.hardware_id = hardware_id
        self.exit_code: int | None = None
        self._unspun: list[Node] = []
        self.stamps: deque[tuple[int, int]] = deque(maxlen=100)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.every(_DIAGNOSTICS_S, self.publish_diagnostics)

    @property
    def simulated_time(self) -> bool:
        """Whether the graph's clock is `/clock` (`use_sim_time`), and not this machine's."""
        return bool(self.get_parameter("use_sim_time").value)

    def refuse_simulated_time(self, why: str) -> None:
        """Say that `use_sim_time` is not heeded, where it is given."""
        if self.simulated_time:
            self.get_logger().warning(f"use_sim_time is not heeded: {why}")

    def every(self, period_s: float, action: Callable[[], None]) -> None:
        """Call `action` every so many seconds of this machine's time: a clock of the graph that stands stops no watch.

        Args:
            period_s: How often, s.
            action: What to do.
        """
        self.create_timer(period_s, action, clock=self._steady)

    def unspun_node(self) -> Node:
        """A hidden node without services, in no executor, whose subscriptions are read by `offers.taken`.

        Callbacks that ask for the message info fail in these wheels' EventsExecutor; `take_message` tells it.
        It is destroyed after `close`.
        """
        node = rclpy.create_node(
            f"_{self.get_name()}_{len(self._unspun)}",
            namespace=self.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._unspun.append(node)
        return node

    def destroy_node(self) -> None:
        """Destroy it and its `unspun_node`s."""
        for node in self._unspun:
            node.destroy_node()
        super().destroy_node()

    def diagnose(self) -> Sequence[Status]:
        """The node's present state; override it."""
        return (Status(Level.OK, "running"),)

    def readiness(self) -> str | None:
        """What it can do now, for the line it says once at its start; None while it cannot yet; override it."""
        return "running"

    def close(self) -> None:
        """End cleanly: called once, in the main thread, while the node can still publish; override it."""

    def log(self, level: Level, sentence: str) -> None:
        """Log at a level that is known only now. Never raises: what a node does must not hang on what it says of it.

        A call site of rclpy's logger has the severity of its first call for ever (it raises where it gets another one),
        so each severity has its own here.

        Args:
            level: OK is logged as INFO, STALE as ERROR.
            sentence: What to say.
        """
        try:
            if level is Level.OK:
                self.get_logger().info(sentence)
            elif level is Level.WARN:
                self.get_logger().warning(sentence)
            else:
                self.get_logger().error(sentence)
        except Exception as error:
            with suppress(OSError, ValueError):  # nor where nobody reads stderr any more
                print(f"{sentence!a} (not logged: {error!r})", file=sys.stderr)

    def publish_diagnostics(self) -> None:
        """Publish what `diagnose` says now; the timer does so every second, call it on a change of state."""
        message = DiagnosticArray(status=[self._message(status) for status in self.diagnose()])
        message.header.stamp = self.get_clock().now().to_msg()
        self.stamps.append((message.header.stamp.sec, message.header.stamp.nanosec))
        self._diagnostics.publish(message)

    def _message(self, status: Status) -> DiagnosticStatus:
        name = self.get_fully_qualified_name().lstrip("/")
        return DiagnosticStatus(
            level=bytes([status.level]),
            name=f"{name}: {status.part}" if status.part else name,
            message=status.message,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=_text(value)) for key, value in status.values.items()],
        )

    def parameter(
        self,
        name: str,
        default: Value,
        description: str,
        *,
        low: float | None = None,
        high: float | None = None,
        choices: Choices | None = None,
        read_only: bool = True,
    ) -> Value:
        """Declare a parameter and return its value, of the type of `default`.

        Args:
            name: Name of the parameter.
            default: Default value; not an empty list. A whole number given for a float is taken as one.
            description: For `ros2 param describe`: what it means, with its unit.
            low: Smallest value allowed, for numbers.
            high: Largest value allowed.
            choices: The words allowed, for texts; a name of NODE_choices, where `commissioning` looks it up.
            read_only: Whether it cannot be changed while the node runs.

        Raises:
            UserError: The value given is of another type, out of range or none of `choices`.
        """
        descriptor = ParameterDescriptor(description=description, read_only=read_only)
        descriptor.additional_constraints = "" if choices is None else str(choices)
        kind = type(default)
        # A float parameter given as `1000` is an integer to ROS, which refuses it; here it means 1000.0.
        descriptor.dynamic_typing = kind is float and read_only
        bounds = (-math.inf if low is None else low, math.inf if high is None else high)
        if kind is int and (low is not None or high is not None):
            lowest, highest = (max(min(b, 2.0**63 - 1024), -(2.0**63)) for b in bounds)
            descriptor.integer_range = [IntegerRange(from_value=int(lowest), to_value=int(highest))]
        elif kind is float and (low is not None or high is not None):
            descriptor.floating_point_range = [FloatingPointRange(from_value=bounds[0], to_value=bounds[1])]
        try:
            value = self.declare_parameter(name, default, descriptor).value
        except ParameterException as error:
            raise UserError(f"parameter {name}: {error}; it is: {description}") from error
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if kind is float and not (isinstance(value, float) and bounds[0] <= value <= bounds[1]):
            raise UserError(f"parameter {name}: {value!r} is not a number from {bounds[0]:g} to {bounds[1]:g}")
        if choices is not None and (why := choices.refusal(value)):
            raise UserError(f"parameter {name}: {why}")
        result: Value = list(value) if isinstance(default, list) else value
        return result

    def file_parameter(self, name: str, description: str, *, read_only: bool = True) -> Path | None:
        """Declare a parameter that names a file or folder to read; `spacearm check --params` looks for it.

        Args:
            name: Name of the parameter.
            description: As for `parameter`; with what an empty one means.
            read_only: As for `parameter`; one that can be changed is read later, so it need not exist yet.

        Returns:
            The path; None where none is given.

        Raises:
            UserError: The value given is no text, or a read-only one names nothing that exists.
        """
        given = self.parameter(name, "", description, read_only=read_only)
        path = Path(given).expanduser() if given else None
        if read_only and path is not None and not path.exists():
            raise UserError(f"parameter {name}: {path}: no such file or folder")
        return path

    def offer(self, name: str, action: Callable[[], str]) -> None:
        """A `std_srvs/srv/Trigger` service: `action` returns the reply, or raises `UserError` with the refusal."""
        self.create_service(Trigger, name, lambda _, response: self._answer(response, action))

    def offer_switch(self, name: str, action: Callable[[bool], str]) -> None:
        """A `std_srvs/srv/SetBool` service; `action` is told the value asked for, otherwise like `offer`."""

        def answer(request: Any, response: Any) -> Any:
            return self._answer(response, lambda: action(request.data))

        self.create_service(SetBool, name, answer)

    def _answer(self, response: Any, action: Callable[[], str]) -> Any:
        try:
            response.message, response.success = action(), True
        except UserError as error:
            response.message, response.success = str(error), False
            self.log(Level.WARN, str(error))
        return response


def run(make: Callable[[], LiveNode], arguments: Sequence[str], *, priority: int = 0) -> int:
    """A node's whole life in this process; returns its exit code.

    It ends on SIGINT or SIGTERM (0), when the node sets `exit_code`, or with 2 where the node cannot be made
    (`UserError`: one line on stderr). However often and whenever the signals come, `close` runs once, to its end.

    Args:
        make: The node's class, or a function that makes one.
        arguments: Command line without the program, such as `--ros-args --params-file FILE`.
        priority: Real-time priority, where permitted, of all threads but those that ask for another one: a thread
            that is not scheduled while it holds Python's lock, or one of the middleware's, would hold up a cycle.
    """
    stop = heed_signals()
    if priority:
        prepare_thread(priority)
    try:
        return _live(make, arguments, stop, priority)
    finally:
        # The middleware's threads and libraries take a while to go: a signal then must not change the exit code.
        ignore_signals()


def _live(make: Callable[[], LiveNode], arguments: Sequence[str], stop: threading.Event, priority: int) -> int:
    if stop.is_set():
        return 0
    try:
        with holding_in_namespace(arguments) as words:
            rclpy.init(args=[sys.argv[0], *words], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises bare RuntimeErrors and its own, for the same mistake
        print(f"the --ros-args cannot be used: {_first_line(error)}", file=sys.stderr)
        return 2
    try:
        node = make()
        if priority:
            give_way(_SENDER, priority - 1)
        try:
            _spin(node, stop)
        finally:
            node.close()
            node.destroy_node()
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return node.exit_code or 0


def _spin(node: LiveNode, stop: threading.Event) -> None:
    # EventsExecutor costs a third of the others; its spin() is a busy loop, spin_once() is not.
    executor = LiveExecutor()
    executor.add_node(node)
    ready: str | None = None
    try:
        while not stop.is_set() and node.exit_code is None:
            if ready is None and (ready := node.readiness()) is not None:
                node.get_logger().info(f"{READY}: {ready}")
            executor.spin_once(timeout_sec=_SPIN_S)
    finally:
        executor.remove_node(node)
        executor.shutdown()


def _text(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case float():
            return f"{value:.6g}"
    return str(value)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
