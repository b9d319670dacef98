"""What was read from a bag, whatever its format: messages by topic, and what was found wrong."""

from __future__ import annotations

from dataclasses import dataclass, field

from spacearm_ident.recording.mcap_reader import Channel, Defect
from spacearm_ident.recording.recording import Source


@dataclass
class Stream:
    """Messages of one topic, in recorded order: receive times in nanoseconds and CDR payloads."""

    channel: Channel
    log_times_ns: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)


@dataclass
class Bag:
    """What was read from a bag.

    Attributes:
        streams: Wanted messages by topic.
        topics: Every topic declared, with its type.
        defects: What was found wrong.
        sources: The files.
    """

    streams: dict[str, Stream] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)
    defects: list[Defect] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
