"""Every message of every topic on the graph, or in a namespace, raw, as it comes.

Topics are looked for four times a second; hidden ones (a part of the name begins with `_`) are left out. The
subscriptions belong to a node that is in no executor: one thread takes what has arrived every 20 ms. That is
the cheapest way there is (no wake-up a message), and with these wheels' EventsExecutor, which fails on
callbacks that ask for the message info, the only cheap one that tells time stamps and sequence numbers.
Until a message is taken, DDS keeps it (1000 a topic: a second at 1 kHz).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from typing import Any, Final

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

from ..recording.background_writer import Topic
from ..recording.definitions import definition_text
from ..recording.messages import MessageType
from ..recording.qos import Qos
from .offers import common_offer, meets, raw_subscription, taken
from .runtime import STREAM

_TAKE_S: Final = 0.02
_LOOK_S: Final = 0.25
_DEPTH: Final = STREAM.depth

Sink = Callable[[Topic, int, bytes, int], bool]
"""Given topic, time of receipt, payload, time of sending (ns since 1970); False where it was dropped."""


@dataclass
class Count:
    """What became of a topic's messages.

    Attributes:
        received: Messages handed to the sink.
        dropped: Of these, those the sink had no room for.
        lost: Messages the publisher numbered that never came; known while a topic has one publisher.
    """

    received: int = 0
    dropped: int = 0
    lost: int = 0


@dataclass
class _Tap:
    """One subscription."""

    topic: Topic
    subscription: Any
    qos: QoSProfile
    single: bool
    count: Count = field(default_factory=Count)
    last_number: int | None = None


class GraphReader:
    """Feeds a sink until closed.

    Attributes:
        counts: By topic name, as on the graph.
        problems: Sentences on topics that cannot be recorded (well), each once.
        failure: Why reading ended before `close`, or None; never expected, never to be passed over.
    """

    def __init__(self, node: Node, sink: Sink, shared: Sequence[str] = ()) -> None:
        """Begin.

        Args:
            node: A node in no executor (`LiveNode.unspun_node`), used by nothing else while this reader is open.
            sink: Where messages go; called in the reader's thread.
            shared: Where the node is in a namespace: topics outside it that are read as well.
        """
        self.counts: dict[str, Count] = {}
        self.problems: list[str] = []
        self.failure: str | None = None
        self._node = node
        self._sink = sink
        self._shared = frozenset(shared)
        self._taps: dict[str, _Tap] = {}
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="graph reader")
        self._thread.start()

    def close(self) -> None:
        """Take what has arrived, then end all subscriptions."""
        self._ending.set()
        self._thread.join()
        for tap in self._taps.values():
            self._node.destroy_subscription(tap.subscription)

    def _work(self) -> None:
        try:
            self._read()
        except Exception as error:
            self.failure = f"reading the graph failed: {error!r}"
            raise

    def _read(self) -> None:
        looked = float("-inf")
        while not self._ending.wait(_TAKE_S):
            if time.monotonic() - looked >= _LOOK_S:
                looked = time.monotonic()
                self._look()
            for tap in self._taps.values():
                self._take(tap)
        for tap in self._taps.values():
            self._take(tap)

    def _look(self) -> None:
        for name, kinds in self._node.get_topic_names_and_types():
            if not topic_or_service_is_hidden(name) and self._recorded(name):
                publishers = self._node.get_publishers_info_by_topic(name)
                try:
                    if publishers:
                        self._attend(name, kinds, publishers)
                except RuntimeError as error:  # what rclpy raises for all that goes wrong in the layers below
                    self._complain(f"{name} is not recorded: {error}")

    def _attend(self, name: str, kinds: Sequence[str], publishers: Sequence[TopicEndpointInfo]) -> None:
        """Subscribe to a new topic; again, more modestly, where a new publisher offers less than the others."""
        wanted = common_offer([publisher.qos_profile for publisher in publishers], _DEPTH)
        tap = self._taps.get(name)
        if tap is not None:
            tap.single = len(publishers) == 1
            if meets(wanted, tap.qos):
                return
            self._node.destroy_subscription(tap.subscription)
        elif len(kinds) > 1:
            self._complain(
                f"{name} has several types ({', '.join(kinds)}); only {publishers[0].topic_type} is recorded"
            )
        kind = publishers[0].topic_type
        python_type = _python_type(kind)
        if python_type is None:
            self._complain(f"{name} is not recorded: its type {kind} is not installed here")
            return
        # A topic is declared once, with the offers that were known then, as rosbag2 does.
        topic = tap.topic if tap is not None else self._topic(name, publishers)
        subscription = raw_subscription(self._node, python_type, name, wanted)
        count = self.counts.setdefault(name, Count())
        self._taps[name] = _Tap(topic, subscription, wanted, len(publishers) == 1, count)

    def _topic(self, name: str, publishers: Sequence[TopicEndpointInfo]) -> Topic:
        kind = publishers[0].topic_type
        text = definition_text(kind)
        if text is None:
            self._complain(f"{name} is recorded without its message definition: no .msg file of {kind}")
        offers = tuple(_offer(publisher.qos_profile) for publisher in publishers)
        declared = MessageType(kind, text or "", str(publishers[0].topic_type_hash))
        return Topic(name, declared, offers, described=text is not None)

    def _recorded(self, name: str) -> bool:
        """Whether a topic of the graph is to be in the recording."""
        namespace = self._node.get_namespace().rstrip("/")
        return name.startswith(f"{namespace}/") or name in self._shared

    def _complain(self, sentence: str) -> None:
        if sentence not in self.problems:
            self.problems.append(sentence)

    def _take(self, tap: _Tap) -> None:
        # At most what fits the history: a topic that never pauses must not starve the others.
        for payload, info in islice(taken(tap.subscription), _DEPTH):
            self._number(tap, info["publication_sequence_number"])
            tap.count.received += 1
            log_time_ns = info["received_timestamp"] or time.time_ns()
            publish_time_ns = info["source_timestamp"] or log_time_ns
            if not self._sink(tap.topic, log_time_ns, payload, publish_time_ns):
                tap.count.dropped += 1

    @staticmethod
    def _number(tap: _Tap, number: int | None) -> None:
        """Count gaps in the numbers; a number that goes back is another publisher's first."""
        if tap.single and number is not None and tap.last_number is not None and number > tap.last_number:
            tap.count.lost += number - tap.last_number - 1
        # Of several publishers the numbers are mixed, and say nothing.
        tap.last_number = number if tap.single else None


def _offer(profile: QoSProfile) -> Qos:
    """A publisher's offer as discovery tells it, in the words of a bag."""
    return Qos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        liveliness=profile.liveliness.name.lower(),
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        lease_ns=profile.liveliness_lease_duration.nanoseconds,
        avoid_ros_names=profile.avoid_ros_namespace_conventions,
    )


def _python_type(name: str) -> Any | None:
    """The Python class of `package/msg/Name` (or `srv`, `action`), or None where it is not installed."""
    package, *folders, short = name.split("/")
    try:
        return getattr(import_module(".".join((package, *folders))), short)
    except (ImportError, AttributeError):
        return None
