"""States of an arm in the types of ros2_control, for bags without usable `/joint_states`.

A joint_state_broadcaster publishes `DynamicJointState`, a joint_trajectory_controller its own state. Either is read
only where there are no joint states, or none of them has an effort while the other has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from spacearm_ident.errors import UserError
from spacearm_ident.recording import cdr, messages
from spacearm_ident.recording.bag import read_bag
from spacearm_ident.recording.contents import Stream
from spacearm_ident.recording.intake import Finding, listing
from spacearm_ident.recording.mcap_reader import Progress

_DECODED_TOGETHER = 4096  # messages decoded in one go: joint states with effort show it in the first


def is_other_states(kind: str) -> bool:
    """Whether a message type holds states of joints that can stand in for joint states."""
    return kind in (messages.DYNAMIC_JOINT_STATE, messages.CONTROLLER_STATE)


def choose_other_states(
    path: str, kinds: Mapping[str, str], own: Stream | None, progress: Progress | None = None
) -> tuple[Stream, Finding] | None:
    """The states that stand in for an arm's joint states: those of most joints with position and effort.

    Args:
        path: The bag.
        kinds: Topic -> type, of the arm's states in other types; one at least.
        own: The arm's joint states; None: it has none.
        progress: Told the fraction done.

    Returns:
        The messages of the topic, and a finding that says which and why; None where the joint states serve as well.

    Raises:
        UserError: There are no joint states, and the others have no effort; or several are alike.
    """
    if own is not None and any(_with_effort(own)):
        return None
    streams = read_bag(path, kinds.get, progress).streams
    worth = {topic: len(set().union(*_with_effort(stream))) for topic, stream in streams.items()}
    most = max(worth.values(), default=0)
    if most == 0 and own is not None:
        return None
    if most == 0:
        there = listing([f"{topic} ({kind})" for topic, kind in kinds.items()])
        raise UserError(
            f"{path}: no {messages.STATES_TOPIC}, and {there} {'holds no effort' if streams else 'cannot be decoded'}; "
            f"record {messages.STATES_TOPIC} with effort (an effort state interface of every joint)"
        )
    best = [topic for topic in streams if worth[topic] == most]
    # A broadcaster's states are of the hardware; a controller passes on what it reads of them.
    best = [topic for topic in best if kinds[topic] == messages.DYNAMIC_JOINT_STATE] or best
    if len(best) > 1:
        several = f"several topics of states ({listing(best)})"
        raise UserError(f"{path}: {several}; choose one, such as --namespace {best[0]}")
    count = len(streams[best[0]].payloads)
    lacking = "no" if own is None else "no effort in"
    text = f"{lacking} {messages.STATES_TOPIC}: {best[0]} ({kinds[best[0]]}) is read in its place"
    return streams[best[0]], Finding("other_states", text, count)


def _with_effort(stream: Stream) -> Iterator[set[str]]:
    """The joints with a position and an effort other than zero, of one run of messages after another; none empty."""
    for start in range(0, len(stream.payloads), _DECODED_TOGETHER):
        payloads = stream.payloads[start : start + _DECODED_TOGETHER]
        for block in cdr.decode_joint_states(payloads, stream.channel.type_name)[0]:
            if block.position is not None and block.effort is not None:
                there = np.isfinite(block.position) & np.isfinite(block.effort) & (block.effort != 0.0)
                if there.any():
                    yield {name for name, has in zip(block.names, there.any(axis=0), strict=True) if has}
