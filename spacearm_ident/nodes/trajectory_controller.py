"""Whether a controller of ros2_control is active, as the controller_manager of this arm says, and of no other.

controller_manager publishes the state of each of its controllers once a second on `/diagnostics`, in the status
`controller_manager: Controllers Activity` under the controller's name (since a later release of Jazzy `NAME.state`).
The namespace of the node is not in that name unless its parameter `diagnostic_updater.use_fqn` is true, so that the
managers of two arms on one graph say the same. A message does not tell who sent it. But the name of the status is that
of the node, and discovery knows which nodes publish on the topic: a status without a namespace counts where the
manager of this arm is the only node that may have sent it.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

STATUS_AGE_S: Final = 3.0
"""A status older than this says nothing: diagnostics come every second."""
DIAGNOSTICS: Final = "/diagnostics"
ACTIVITY: Final = "Controllers Activity"
"""Name of controller_manager's status of its controllers, behind the node's name."""
UNKNOWN: Final = "_NODE_NAME_UNKNOWN_"
"""What rmw says of a publisher before it has heard whose it is."""


class Heard:
    """The states that a status of one name has told lately, oldest first."""

    def __init__(self) -> None:
        self._states: deque[tuple[float, str]] = deque()

    def add(self, state: str) -> None:
        """Note what it says now."""
        self._states.append((time.monotonic(), state))

    @property
    def states(self) -> list[str]:
        """Those not older than `STATUS_AGE_S`."""
        oldest = time.monotonic() - STATUS_AGE_S
        while self._states and self._states[0][0] < oldest:
            self._states.popleft()
        return [state for _, state in self._states]


class ControllerSource:
    """A controller of ros2_control.

    Args:
        node: The trajectory node. A manager in its namespace is its arm's, else the nearest in a namespace around it.
        controller: The controller's name.
        manager: Name of controller_manager's node; with its namespace (`/right/controller_manager`) that node alone.
    """

    def __init__(self, node: Node, controller: str, manager: str) -> None:
        self._node, self._controller = node, controller
        self._topic = node.resolve_topic_name(DIAGNOSTICS)
        self._name = manager.rpartition("/")[2]
        self._candidates = _candidates(node.get_namespace(), manager)
        self._heard: defaultdict[str, Heard] = defaultdict(Heard)

    def hear(self, status: DiagnosticStatus, values: Mapping[str, str]) -> None:
        """Take in a status of `/diagnostics`."""
        sender, _, part = status.name.partition(": ")
        if part == ACTIVITY and sender.rpartition("/")[2] == self._name:
            full = f"/{sender.strip('/')}" if "/" in sender else sender
            name = self._controller
            self._heard[full].add(values.get(f"{name}.state", values.get(name, "not loaded")))

    @property
    def enabled(self) -> bool | None:
        """Whether it is active.

        False as well where that is said and it is in doubt of which arm: a run is stopped rather than led on without
        its controller. None where nothing is known, or what is known does not suffice to begin a run.
        """
        states, doubt = self._said()
        if states and states[-1] != "active":
            return False
        return None if doubt or not states else True

    @property
    def refusal(self) -> str:
        """It is not, or that is not known."""
        states, doubt = self._said()
        if doubt:
            return f"the controller {self._controller} is not known to be active: {doubt}"
        if not states:
            return (
                f"the controller {self._controller} is not known to be active: no status '{self._name}: {ACTIVITY}' "
                f"came on {self._topic}; start controller_manager, or name its node in the parameter controller_manager"
            )
        return (
            f"the controller {self._controller} is {states[-1]}; activate it "
            f"(ros2 control switch_controllers --activate {self._controller})"
        )

    @property
    def loss(self) -> str:
        """It was, and is no longer."""
        states, doubt = self._said()
        said = f"the controller {self._controller} is no longer active ({states[-1] if states else 'unknown'})"
        return f"{said}; {doubt}" if doubt else said

    def _said(self) -> tuple[list[str], str]:
        """The states told lately that may be this arm's, oldest first, and why it is in doubt that they are."""
        publishers = {_full_name(info) for info in self._node.get_publishers_info_by_topic(self._topic)}
        publishers.discard(self._node.get_fully_qualified_name())
        named = {name for name in publishers if name.rpartition("/")[2] in (self._name, UNKNOWN)}
        # A node whose statuses have its namespace in their names is not the sender of others.
        silent = {name for name in named if not self._heard[name].states}
        for candidate in self._candidates:
            if states := self._heard[candidate].states:
                return states, self._contradiction(states)
            if candidate in silent:
                break
        if not (states := self._heard[self._name].states):
            return [], ""
        if named and not named.intersection(self._candidates):
            return [], (
                f"'{self._name}: {ACTIVITY}' on {self._topic} is that of {', '.join(sorted(named))}, and this node is "
                f"{self._node.get_fully_qualified_name()}: start both in one namespace, or, where it is this arm's, "
                "give its full name as the parameter controller_manager"
            )
        # Without any such node the status came by way of another, such as a bridge between two graphs.
        places = {candidate.rpartition("/")[0] for candidate in self._candidates}
        strange = len(silent) > 1 if named else any(name.rpartition("/")[0] not in places for name in publishers)
        if strange:
            senders = ", ".join(sorted(silent or publishers))
            return states, (
                f"'{self._name}: {ACTIVITY}' on {self._topic} may be that of {senders}; "
                "set diagnostic_updater.use_fqn of each controller_manager to true, or start each, and the trajectory "
                f"node of its arm, with -r {DIAGNOSTICS}:=NAMESPACE{DIAGNOSTICS}"
            )
        return states, self._contradiction(states)

    def _contradiction(self, states: Sequence[str]) -> str:
        """Why states that go to and fro are not one manager's; empty where they do not."""
        if sum(one != other for one, other in pairwise(states)) < 2:
            return ""
        return (
            f"{self._topic} says {' and '.join(sorted(set(states)))} by turns; are there two nodes {self._name} of one "
            "namespace? Start each arm's nodes in a namespace of its own"
        )


def _candidates(namespace: str, manager: str) -> tuple[str, ...]:
    """Full names that a manager of this arm may have, the nearest first."""
    if manager.startswith("/"):
        return (manager,)
    parts = [part for part in namespace.split("/") if part]
    return tuple("/" + "/".join((*parts[:depth], manager)) for depth in range(len(parts), -1, -1))


def _full_name(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"
