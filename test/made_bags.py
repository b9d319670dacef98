"""Bags of samples that tell each from every other, made in memory."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from spacearm_ident.recording import Recording, cdr, messages, read_recording

START = 1_700_000_000_123_456_789
JOINTS = ("shoulder", "elbow", "wrist")


def signals(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, effort that tell every sample and joint from every other."""
    base = np.arange(count)[:, None] + np.array([0.0, 0.25, 0.5])
    return base, -base, base + 1000.0


def states(count: int = 100, *, step_ns: int = 1_000_000, joints=JOINTS) -> list[tuple[int, bytes]]:
    """Stamps and payloads of a sound /joint_states."""
    stamps = START + step_ns * np.arange(count)
    return list(zip(stamps.tolist(), cdr.encode_joint_states(stamps, joints, *signals(count)), strict=True))


def state(stamp: int, names, position, velocity, effort) -> bytes:
    columns = [None if values is None else np.array([values], float) for values in (position, velocity, effort)]
    return cdr.encode_joint_states([stamp], names, *columns)[0]


def bag_bytes(rows, *, topic=messages.STATES_TOPIC, others=(), finish=True, flush_every=0, **options) -> bytes:
    """An MCAP file of (log time, payload) rows on `topic` and (log time, topic, payload) rows besides."""
    stream = BytesIO()
    writer = Writer(stream, **options)
    writer.start(profile="ros2")
    channels = {}
    everything = [*((log, topic, payload) for log, payload in rows), *others]
    if others:
        everything.sort(key=lambda row: row[0])
    for number, (log, name, payload) in enumerate(everything):
        if name not in channels:
            kind = messages.TOPIC_TYPES.get(
                "/" + name.rpartition("/")[2], messages.MessageType("pkg/msg/Odd", "int8 x\n")
            )
            schema = writer.register_schema(kind.name, "ros2msg", kind.text.encode())
            channels[name] = writer.register_channel(name, "cdr", schema)
        writer.add_message(channels[name], log, payload, log)
        if flush_every and number % flush_every == flush_every - 1:
            writer.flush()
    if finish:
        writer.finish()
    else:
        writer.flush()
    return stream.getvalue()


def read_bytes(folder: Path, data: bytes, **options) -> Recording:
    """A bag of these bytes, written into a folder and read."""
    path = folder / "bag.mcap"
    path.write_bytes(data)
    return read_recording(path, **options)


def assert_same(got: Recording, run: Recording) -> None:
    """The same joints and numbers; times to the nanosecond of a stamp."""
    assert got.joints == run.joints and len(got.time) == len(run.time)
    for signal in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(got, signal), getattr(run, signal))
    assert np.abs(got.time - run.time).max() < 2e-9


def issues(recording: Recording) -> dict[str, int]:
    return {issue.kind: issue.count for issue in recording.issues}


def numbers(recording: Recording) -> list[int]:
    """Which of the samples of `states` the recording holds; checks that each is whole."""
    index = np.floor(recording.position[:, 0]).astype(int)
    position, _, effort = signals(int(index.max()) + 1)
    columns = [JOINTS.index(joint) for joint in recording.joints]
    assert np.array_equal(recording.position, position[index][:, columns])
    assert np.array_equal(recording.effort, effort[index][:, columns])
    assert (np.diff(recording.time) > 0).all()
    return index.tolist()


WHOLE = bag_bytes(
    states(400), flush_every=25, others=[(START, messages.DESCRIPTION_TOPIC, cdr.encode_string("<robot/>"))]
)
