"""Whether the arm may be moved: what its driver, its controller or anybody else says of it.

The parameter `enabled_from` names one source or several; all of them must agree.

- `driver`: this package's CANopen driver; `operation_enabled` of its status on `/diagnostics`.
- `controller`: a controller of ros2_control, by controller_manager's status on `/diagnostics`
  (`trajectory_controller`): only `active` will do.
- `topic`: a std_msgs/msg/Bool, latched or not, such as `robot_program_running` of Universal Robots' driver. A value
  holds as long as its publisher is there.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Bool

from ..errors import UserError
from .offers import common_offer
from .runtime import LiveNode, local_name
from .trajectory_choices import BY_CONTROLLER, BY_DRIVER, BY_TOPIC, ENABLED_FROM
from .trajectory_controller import DIAGNOSTICS, STATUS_AGE_S, ControllerSource

DRIVER: Final = "canopen_driver"


class DriverSource:
    """This package's driver.

    Args:
        node: Whose namespace counts.
    """

    def __init__(self, node: LiveNode) -> None:
        self._node = node
        self._said: dict[str, tuple[bool, str, float]] = {}

    def hear(self, status: DiagnosticStatus, values: Mapping[str, str]) -> None:
        """Take in a status of `/diagnostics`."""
        if DRIVER in (local_name(status.name, self._node.get_namespace()) or "") and "operation_enabled" in values:
            said = (values["operation_enabled"] == "true", values.get("fault", ""), time.monotonic())
            self._said[status.name] = said

    @property
    def enabled(self) -> bool | None:
        """Whether the drives are enabled."""
        now = time.monotonic()
        fresh = [enabled for enabled, _, at in self._said.values() if now - at < STATUS_AGE_S]
        return all(fresh) if fresh else None

    @property
    def refusal(self) -> str:
        """They are not, or that is not known."""
        call = f"call {self._node.resolve_service_name('driver/enable')} first"
        if self.enabled is None:
            return (
                f"the drives are not known to be enabled; {call} (no operation_enabled of {DRIVER} on /diagnostics; "
                "enabled_from names others to ask)"
            )
        return f"the drives are not enabled; {call}"

    @property
    def loss(self) -> str:
        """They were, and are no longer."""
        faults = [fault for _, fault, _ in self._said.values() if fault]
        return "the drives are no longer enabled" + (f" ({faults[0]})" if faults else "")


class TopicSource:
    """A std_msgs/msg/Bool.

    Args:
        node: Who subscribes.
        topic: Its name.
    """

    def __init__(self, node: LiveNode, topic: str) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        self._value: bool | None = None
        self._subscribed = False

    def look(self) -> None:
        """Subscribe once there is a publisher, with the QoS it offers; forget the last value once there is none."""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        if not publishers:
            self._value = None
        elif not self._subscribed:
            self._subscribed = True
            qos = common_offer([info.qos_profile for info in publishers], depth=1)
            self._node.create_subscription(Bool, self._topic, self._hear, qos)

    def _hear(self, message: Bool) -> None:
        self._value = message.data

    @property
    def enabled(self) -> bool | None:
        """What it says."""
        return self._value

    @property
    def refusal(self) -> str:
        """It says no, or nothing."""
        said = "nothing" if self._value is None else "false"
        return f"{self._topic} says {said}: the run may begin when it says true"

    @property
    def loss(self) -> str:
        """It says no."""
        return f"{self._topic} says false"


Source = DriverSource | ControllerSource | TopicSource
"""One that knows whether the arm may be moved (`enabled`; None where it has said nothing lately). `refusal`: why a run
cannot begin, and what to do, asked where `enabled` is not true; `loss`: why a run was stopped, where it is false."""


class Interlock:
    """All sources of a trajectory node; declares their parameters.

    Args:
        node: The trajectory node.

    Raises:
        UserError: A parameter is missing or not understood.
    """

    def __init__(self, node: LiveNode) -> None:
        named = node.parameter(
            "enabled_from",
            [BY_DRIVER],
            "who says that the arm may be moved: driver, controller, topic; all given must",
            choices=ENABLED_FROM,
        )
        controller = node.parameter("controller", "", "enabled_from controller: name of the ros2_control controller")
        manager = node.parameter(
            "controller_manager",
            "controller_manager",
            "enabled_from controller: node name of its controller_manager; with a namespace that node alone",
        )
        topic = node.parameter("enabled_topic", "", "enabled_from topic: a std_msgs/msg/Bool that must be true")
        required = node.parameter("require_enabled", True, "false: enabled_from is shown, and binds nothing")
        if BY_CONTROLLER in named and not controller:
            raise UserError("parameter controller is empty: name the controller that enabled_from asks for")
        if BY_TOPIC in named and not topic:
            raise UserError("parameter enabled_topic is empty: name the topic that enabled_from asks for")
        self._required = required
        self._topics = [TopicSource(node, topic)] if BY_TOPIC in named else []
        self._speaking: list[DriverSource | ControllerSource] = []
        if BY_DRIVER in named:
            self._speaking.append(DriverSource(node))
        if BY_CONTROLLER in named:
            self._speaking.append(ControllerSource(node, controller, manager))
        self._sources: list[Source] = [*self._speaking, *self._topics]
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._hear, 100)

    @property
    def of_driver(self) -> bool:
        """Whether this package's driver is among the sources."""
        return any(isinstance(source, DriverSource) for source in self._speaking)

    @property
    def enabled(self) -> bool | None:
        """False where any source says no; else None where any says nothing; else true."""
        words = [source.enabled for source in self._sources]
        return False if False in words else None if None in words else True

    def require(self) -> None:
        """Refuse a run unless all sources agree.

        Raises:
            UserError: The first that does not, and what to do.
        """
        for source in self._sources if self._required else ():
            if source.enabled is not True:
                raise UserError(source.refusal)

    def loss(self) -> str:
        """Why a run must be stopped now; empty where it need not be."""
        for source in self._sources if self._required else ():
            if source.enabled is False:
                return source.loss
        return ""

    def look(self) -> None:
        """Find who publishes; call it now and then."""
        for source in self._topics:
            source.look()

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            for source in self._speaking:
                source.hear(status, values)
