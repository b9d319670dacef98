"""Whether several nodes publish the joint states of the same joints, by turns: which of them is the arm's nobody knows.

Several publishers alone are sound: a gripper's driver has joints of its own, and the graph lists a killed node until
its lease has run out (20 s with Fast DDS). The messages tell: each publisher numbers its own, so that where two take
turns the number falls back again and again, between messages that name the same joint.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

from rclpy.node import Node

from ..recording import cdr

MOST = 100
"""Falls between two looks that are looked into."""
FEWEST = 3
"""Falls within `WITHIN_S` from which a joint has two publishers: a driver that was started again makes one."""
WITHIN_S = 10.0
"""s; a second publisher is noticed from 0.3 Hz on."""


class PublisherWatch:
    """Who publishes the states of the arm's joints.

    Args:
        node: To ask for the graph.
        topic: Full name of the topic.

    Attributes:
        sentence: That several nodes publish the same joints, and what to do; empty where only one does.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._before: tuple[bytes, int] | None = None
        self._falls: deque[tuple[bytes, bytes]] = deque(maxlen=MOST)
        self._shared: deque[tuple[float, str]] = deque(maxlen=FEWEST)
        self.sentence = ""

    def hear(self, payload: bytes, number: int | None) -> None:
        """Take a message and its number among its publisher's; None: the middleware does not say."""
        if number is None:
            return
        if self._before is not None and number <= self._before[1]:
            self._falls.append((self._before[0], payload))
        self._before = payload, number

    def look(self, joints: Sequence[str] = ()) -> bool:
        """Look at what was heard since; returns whether `sentence` has changed.

        Args:
            joints: Those that count; all in the messages unless given.
        """
        now, before = time.monotonic(), self.sentence
        self._shared.extend((now, name) for pair in self._falls if (name := _common(pair, joints)))
        self._falls.clear()
        several = len(self._shared) == FEWEST and now - self._shared[0][0] < WITHIN_S
        publishers = self._node.get_publishers_info_by_topic(self._topic) if several else []
        self.sentence = ""
        if len(publishers) > 1:
            names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers)
            self.sentence = (
                f"{self._topic} is published by {', '.join(names)}, and {self._shared[0][1]} is in the messages of "
                "several of them: nothing can be identified from their mixture; end the others, or remap their topic"
            )
        return before != self.sentence


def _common(pair: tuple[bytes, bytes], joints: Sequence[str]) -> str:
    """A joint that two serialised joint states name, one of `joints` where given; empty where there is none."""
    first, second = ([name for block in cdr.decode_joint_states([one])[0] for name in block.names] for one in pair)
    return next((name for name in first if name in second and (not joints or name in joints)), "")
