"""Subscriptions that ask for what a topic's publishers offer.

A subscription that asks for more (RELIABLE of a BEST_EFFORT publisher) gets nothing, and its node no word of that.
Drivers publish `/joint_states` either way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from .runtime import STREAM


def common_offer(offered: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """The most that all publishers offer.

    Args:
        offered: What each offers.
        depth: Messages kept until they are taken.
    """
    reliable = all(qos.reliability != ReliabilityPolicy.BEST_EFFORT for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def meets(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Whether a subscription's request is met.

    Args:
        offered: Quality of service of the publishers; reliability and durability are compared.
        requested: That of the subscription.
    """
    return not (
        (requested.reliability == ReliabilityPolicy.RELIABLE and offered.reliability == ReliabilityPolicy.BEST_EFFORT)
        or (
            requested.durability == DurabilityPolicy.TRANSIENT_LOCAL and offered.durability == DurabilityPolicy.VOLATILE
        )
    )


def raw_subscription(node: Node, kind: type, topic: str, qos: QoSProfile) -> Any:
    """A subscription to serialised messages, which `taken` reads.

    Args:
        node: A node in no executor (`LiveNode.unspun_node`).
        kind: Message type.
        topic: Name of the topic.
        qos: Quality of service asked for.
    """
    return node.create_subscription(kind, topic, lambda _: None, qos, raw=True)


def taken(subscription: Any) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
    """What has arrived since at a `raw_subscription`: each message and what the middleware tells of it."""
    handle = subscription.handle
    with handle:
        while (message := handle.take_message(subscription.msg_type, True)) is not None:
            yield message


class RawStream:
    """Serialised messages of a stream in the order of arrival: RELIABLE, unless a publisher offers less.

    RELIABLE, because samples that are lost on their way leave gaps in what is identified.

    Args:
        node: A node in no executor (`LiveNode.unspun_node`).
        kind: Message type.
        topic: Full name of the topic.
    """

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        self._node, self._kind, self._topic = node, kind, topic
        self._subscription = raw_subscription(node, kind, topic, STREAM)
        self._before: list[tuple[bytes, int, int | None]] = []
        self._reliable = True

    def look(self) -> str:
        """Ask for less where a publisher offers less; returns a sentence on that, once. Call it now and then."""
        publishers = self._node.get_publishers_info_by_topic(self._topic) if self._reliable else []
        less = [info for info in publishers if not meets(info.qos_profile, STREAM)]
        if not less:
            return ""
        self._before = list(self.take())
        self._node.destroy_subscription(self._subscription)
        qos = QoSProfile(depth=STREAM.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._subscription, self._reliable = raw_subscription(self._node, self._kind, self._topic, qos), False
        names = sorted({f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in less})
        return (
            f"{self._topic} is published BEST_EFFORT by {', '.join(names)}, and taken so: what is lost on its way is "
            "not sent again"
        )

    def take(self) -> Iterator[tuple[bytes, int, int | None]]:
        """What has arrived since: message, time of arrival, ns since 1970, and its number among its publisher's.

        The number is None where the middleware has none.
        """
        before, self._before = self._before, []
        yield from before
        for payload, info in taken(self._subscription):
            yield payload, info["received_timestamp"], info.get("publication_sequence_number")
