"""Whose topics of a bag are read: those of one arm.

A bag keeps the names that topics had on the graph, so an arm in the namespace `/arm_1` is `/arm_1/joint_states` there.
Its joint states, set-points and temperatures are those of its own namespace; what several arms may share (the
description, a sensor on the base) is that of its namespace or of the nearest around it. Where it has no joint states,
or none with effort, the states that ros2_control publishes in other types stand in: see `other_states`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

from spacearm_ident.errors import UserError
from spacearm_ident.recording import messages
from spacearm_ident.recording.bag import read_bag
from spacearm_ident.recording.contents import Bag, Stream
from spacearm_ident.recording.intake import Finding, listing
from spacearm_ident.recording.mcap_reader import Progress
from spacearm_ident.recording.other_states import choose_other_states, is_other_states

_SHARED = frozenset({messages.DESCRIPTION_TOPIC, messages.BASE_IMU_TOPIC, messages.BASE_ODOMETRY_TOPIC})


def read_arm(path: str, namespace: str | None, progress: Progress | None) -> tuple[Bag, list[Finding]]:
    """One arm's topics of a bag, under the names they have without a namespace.

    Args:
        path: MCAP file or rosbag2 folder.
        namespace: The arm's, such as `arm_1` or `/cell/arm_1`; `/` is none. Or the full name of a topic of joint
            states that is called otherwise. None: the arm without a namespace, or the only one there is.
        progress: Told the fraction done.

    Returns:
        The bag, and findings: joint states of other arms left out without having been asked to; another topic taken
        for the joint states.

    Raises:
        UserError: The bag cannot be read, or holds several arms in namespaces and none was asked for; or the states
            that stand in for its joint states have no effort, or are several alike.
    """
    asked = None if namespace is None else _prefix(namespace)
    bag = read_bag(path, partial(_type_wanted, asked), progress)
    arms = _arms(bag.streams)
    if asked in bag.streams:
        return replace(bag, streams=_streams(bag, str(asked).rpartition("/")[0], str(asked))), []
    place = _choose(path, arms) if asked is None else asked
    others = [arm for arm in arms if arm != place]
    findings = []
    if others and place in arms:
        count = sum(len(bag.streams[arm + messages.STATES_TOPIC].payloads) for arm in others)
        text = f"{_named(others)} left out: choose another arm by its namespace (--namespace)"
        findings.append(Finding("other_arm", text, count))
    streams = _streams(bag, place)
    kinds = {topic: kind for topic, kind in bag.topics.items() if is_other_states(kind) and _is_within(topic, place)}
    own = streams.get(messages.STATES_TOPIC)
    if other := choose_other_states(path, kinds, own, progress) if kinds else None:
        stream, finding = other
        topic = stream.channel.topic
        # A controller's topic is in the namespace of its name.
        home = topic.rsplit("/", 2 if stream.channel.type_name == messages.CONTROLLER_STATE else 1)[0]
        streams = _streams(bag, home) | streams | {messages.STATES_TOPIC: stream}
        if stream.channel.type_name == messages.CONTROLLER_STATE:
            streams.setdefault(messages.COMMAND_TOPIC, stream)  # it has the set-points as well
        findings += [finding] if topic != asked else []
    elif asked is not None and asked not in arms:
        there = [topic for topic, kind in bag.topics.items() if kind == messages.JOINT_STATE.name]
        raise UserError(f"{path}: no {asked}{messages.STATES_TOPIC}; it holds {_named(_arms(there)) or 'no arm'}")
    return replace(bag, streams=streams), findings


def _is_within(topic: str, place: str) -> bool:
    return topic == place or topic.startswith(f"{place}/")


def _streams(bag: Bag, namespace: str, states: str | None = None) -> dict[str, Stream]:
    """The streams of a namespace by their local names; joint states from the topic `states` where there is one."""
    streams = {}
    for local in messages.TOPIC_TYPES:
        if stream := next((bag.streams[name] for name in _names(local, namespace) if name in bag.streams), None):
            streams[local] = stream
    return streams if states is None else streams | {messages.STATES_TOPIC: bag.streams[states]}


def _arms(topics: Iterable[str]) -> list[str]:
    """Namespaces that have joint states."""
    return sorted(
        topic.removesuffix(messages.STATES_TOPIC) for topic in topics if _local(topic) == messages.STATES_TOPIC
    )


def _choose(path: str, arms: list[str]) -> str:
    """The namespace to read where none was asked for."""
    if not arms or "" in arms:
        return ""
    if len(arms) > 1:
        example = arms[0].removeprefix("/")
        raise UserError(f"{path}: several arms ({_named(arms)}); choose one, such as --namespace {example}")
    return arms[0]


def _named(arms: Sequence[str]) -> str:
    return listing([place + messages.STATES_TOPIC for place in arms])


def _type_wanted(asked: str | None, topic: str) -> str | None:
    """The message type of a topic that may be the arm's, None of any other."""
    if asked is not None and topic == asked:
        return messages.JOINT_STATE.name
    local = _local(topic)
    kind = messages.TOPIC_TYPES.get(local)
    if kind is None or (asked is not None and topic not in _names(local, asked)):
        return None
    return kind.name


def _local(topic: str) -> str:
    """A topic's name without its namespace."""
    return topic[topic.rfind("/") :] if topic.startswith("/") else topic


def _names(local: str, namespace: str) -> list[str]:
    """Full names that a topic of an arm may have, its own namespace first."""
    places = [namespace]
    while local in _SHARED and places[-1]:
        places.append(places[-1].rpartition("/")[0])
    return [place + local for place in places]


def _prefix(namespace: str) -> str:
    """A namespace as it stands before a topic: empty, or with a slash in front and none behind."""
    bare = namespace.strip("/")
    return f"/{bare}" if bare else ""
