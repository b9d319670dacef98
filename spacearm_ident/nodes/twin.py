"""A second node of the same name on one graph: both answer the same services, and one caller does not know which."""

from __future__ import annotations

import math
import time
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray

from .runtime import LiveNode

SILENCE_S: Final = 3.0
"""One that has published no status for so long, s, three in a row, is gone."""


class TwinWatch:
    """Whether another node of this node's name lives on its graph.

    Neither the graph nor `/diagnostics` tells alone: the graph lists a killed node until its lease has run out (20 s
    with Fast DDS), and a bag that is played has the statuses of the day it was recorded on.

    Args:
        node: Whose name it is; says once in its log that there is another.
    """

    def __init__(self, node: LiveNode) -> None:
        self._node, self._heard_s = node, -math.inf
        self._name = node.get_fully_qualified_name().lstrip("/")
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)

    @property
    def sentence(self) -> str:
        """That there is another, and what to do; empty where there is none."""
        if time.monotonic() - self._heard_s > SILENCE_S:
            return ""
        return f"another node /{self._name} is on this graph: end one of them, or start it in a namespace"

    def _hear(self, message: DiagnosticArray) -> None:
        names = {status.name.partition(":")[0] for status in message.status}
        if self._name not in names or (message.header.stamp.sec, message.header.stamp.nanosec) in self._node.stamps:
            return
        own = (self._node.get_name(), self._node.get_namespace())
        if self._node.get_node_names_and_namespaces().count(own) > 1:
            fresh, self._heard_s = not self.sentence, time.monotonic()
            if fresh:
                self._node.get_logger().warning(self.sentence)
