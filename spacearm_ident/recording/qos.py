"""A publisher's quality of service as rosbag2 keeps it in a bag (metadata version 9, ROS 2 Jazzy).

The words are those of `offered_qos_profiles`, in a channel's metadata and in `metadata.yaml`. ROS is not needed: a node
fills a `Qos` from what its graph says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

FOREVER_NS = 2**63 - 1
"""A duration without end, ns: the largest that ROS 2 can say."""


@dataclass(frozen=True)
class Qos:
    """One publisher's offer; by default that of a reliable publisher of ROS 2.

    Attributes:
        history: `keep_last`, `keep_all`, `system_default` or `unknown` (discovery does not tell it).
        depth: Messages kept; 0 where it is unknown.
        reliability: `reliable`, `best_effort`, `system_default` or `unknown`.
        durability: `volatile`, `transient_local`, `system_default` or `unknown`.
        liveliness: `automatic`, `manual_by_topic`, `system_default` or `unknown`.
        deadline_ns: Longest interval between two messages.
        lifespan_ns: How long a message is worth delivering.
        lease_ns: How long the publisher counts as alive without a sign of life.
        avoid_ros_names: Whether the topic has its DDS name, without the prefix of ROS.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    liveliness: str = "automatic"
    deadline_ns: int = FOREVER_NS
    lifespan_ns: int = FOREVER_NS
    lease_ns: int = FOREVER_NS
    avoid_ros_names: bool = False

    def as_dict(self) -> dict[str, Any]:
        """The profile in rosbag2's words and order."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _duration(self.deadline_ns),
            "lifespan": _duration(self.lifespan_ns),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _duration(self.lease_ns),
            "avoid_ros_namespace_conventions": self.avoid_ros_names,
        }


STREAMED = Qos()
"""A topic of which late subscribers get nothing that was sent before."""
LATCHED = Qos(depth=1, durability="transient_local")
"""A topic of which late subscribers get the last message."""


def offered(profiles: Sequence[Qos]) -> str:
    """What a channel's metadata keeps as `offered_qos_profiles`: a YAML list, one profile a publisher."""
    return str(yaml.safe_dump([profile.as_dict() for profile in profiles], sort_keys=False))


def _duration(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, 10**9)
    return {"sec": seconds, "nsec": rest}
