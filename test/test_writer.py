"""What is written reads back equal, here, with rosbags and with mcap; nothing half-written is left."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader as RosbagsReader

from spacearm_ident.errors import UserError
from spacearm_ident.recording import (
    BaseSensor,
    Recording,
    RecordingWriter,
    Series,
    bag,
    copy_messages,
    messages,
    read_recording,
    write_recording,
)
from spacearm_ident.recording.qos import LATCHED

START = 1_753_000_000_987_654_321
NUMBERS = st.floats(-1e6, 1e6)


@st.composite
def recordings(draw) -> Recording:
    joints = tuple(draw(st.lists(st.text("abcj_1é", min_size=1, max_size=6), min_size=1, max_size=4, unique=True)))

    def clock(least: int, most: int) -> np.ndarray:
        steps = draw(st.lists(st.integers(200_000, 11_000_000), min_size=least, max_size=most))
        return np.cumsum([0, *steps[1:]]) / 1e9 if steps else np.zeros(0)

    def matrix(rows: int) -> np.ndarray:
        row = st.lists(NUMBERS, min_size=len(joints), max_size=len(joints))
        return np.array(draw(st.lists(row, min_size=rows, max_size=rows))).reshape(rows, len(joints))

    time = clock(2, 12)
    command_time = clock(1, 5)
    warm_time = clock(1, 4)
    return Recording(
        joints=joints,
        time=time,
        position=matrix(len(time)),
        velocity=matrix(len(time)) if draw(st.booleans()) else None,
        effort=matrix(len(time)),
        segments=(slice(0, len(time)),),
        start_ns=START + draw(st.integers(0, 10**12)),
        command=Series(command_time + 0.5, matrix(len(command_time))) if draw(st.booleans()) else None,
        temperatures={joints[0]: Series(warm_time, 20.0 + warm_time)} if draw(st.booleans()) else {},
        base=draw(st.sampled_from([None, on_base(time, odometry=False), on_base(time, odometry=True)])),
        urdf=draw(st.one_of(st.none(), st.text("<robot/> äö\n", min_size=1))),
    )


def example(count: int = 500) -> Recording:
    time = np.arange(count) / 1000.0
    values = np.sin(time[:, None] * [1.0, 2.0, 3.0])
    return Recording(
        joints=("j1", "j2", "j3"),
        time=time,
        position=values,
        velocity=2 * values,
        effort=3 * values,
        segments=(slice(0, count),),
        start_ns=START,
        command=Series(time[::4], values[::4]),
        temperatures={"j2": Series(np.array([0.0, 0.25]), np.array([20.0, 20.5]))},
        base=on_base(time, odometry=False),
        urdf="<robot name='a'/>",
    )


def on_base(time: np.ndarray, *, odometry: bool) -> BaseSensor:
    """A sensor that turns slowly, 20 samples over the times."""
    clock = np.rint(np.linspace(time[0], time[-1], 20) * 1e9) / 1e9
    rate, linear = np.sin(np.outer(clock, [1.0, 2.0, 3.0])), np.cos(np.outer(clock, [3.0, 1.0, 2.0]))
    runs = (slice(0, 20),)
    if not odometry:
        return BaseSensor(messages.BASE_IMU_TOPIC, "base", clock, rate, runs, force=linear)
    half = 0.5 * clock
    attitude = np.stack([np.sin(half), 0 * half, 0 * half, np.cos(half)], axis=1)
    return BaseSensor(messages.BASE_ODOMETRY_TOPIC, "base", clock, rate, runs, velocity=linear, attitude=attitude)


def assert_equal(one: Recording, other: Recording) -> None:
    def same(a: Series | None, b: Series | None) -> bool:
        if a is None or b is None:
            return a is b
        return np.array_equal(a.values, b.values) and np.allclose(a.time, b.time, rtol=0, atol=2e-10)

    assert (one.joints, one.start_ns, one.urdf) == (other.joints, other.start_ns, other.urdf)
    for name in ("time", "position", "effort"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert np.array_equal(one.velocity, other.velocity) if one.velocity is not None else other.velocity is None
    assert same(one.command, other.command)
    assert (one.base is None) == (other.base is None)
    if one.base is not None and other.base is not None:
        assert (one.base.topic, one.base.frame, one.base.runs) == (other.base.topic, other.base.frame, other.base.runs)
        for name in ("rate", "force", "velocity", "attitude"):
            assert np.array_equal(getattr(one.base, name), getattr(other.base, name))
    assert one.temperatures.keys() == other.temperatures.keys()
    assert all(same(one.temperatures[name], other.temperatures[name]) for name in one.temperatures)


@settings(max_examples=50, deadline=None)
@given(recordings(), st.booleans())
def test_round_trip(recording, folder):
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / ("run" if folder else "run.mcap")
        write_recording(path, recording)
        assert_equal(read_recording(path, joints=recording.joints), recording)


def test_rosbags_reads_the_folder_with_types_hashes_and_qos(tmp_path):
    recording = example()
    write_recording(tmp_path / "run", recording)
    with RosbagsReader(tmp_path / "run") as reader:
        assert reader.message_count == 500 + 125 + 2 + 1 + 20
        assert reader.start_time == START and reader.end_time == START + 499_000_000 + 1
        assert reader.ros_distro == "jazzy"
        kinds = {c.topic: (c.msgtype, c.digest) for c in reader.connections}
        declared = {name: (kind.name, kind.type_hash) for name, kind in messages.TOPIC_TYPES.items()}
        assert kinds == {name: kind for name, kind in declared.items() if name != messages.BASE_ODOMETRY_TOPIC}
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability for c in reader.connections}
        assert durability[messages.DESCRIPTION_TOPIC] == QosDurability.TRANSIENT_LOCAL
        assert durability[messages.STATES_TOPIC] == QosDurability.VOLATILE
    # AnyReader takes the definitions from the file: the texts must be complete.
    with AnyReader([tmp_path / "run"]) as reader:
        rows = [
            reader.deserialize(payload, connection.msgtype)
            for connection, _, payload in reader.messages()
            if connection.topic == messages.STATES_TOPIC
        ]
    assert np.array_equal([row.effort for row in rows], recording.effort)
    assert [row.header.stamp.nanosec for row in rows[:2]] == [987_654_321, 988_654_321]


def test_the_single_file_is_indexed_in_time_order_and_decodes_with_mcap_ros2(tmp_path):
    write_recording(tmp_path / "run.mcap", example())
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert all(index.message_index_offsets for index in summary.chunk_indexes)
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        for channel in summary.channels.values():
            [profile] = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            latched = channel.topic == messages.DESCRIPTION_TOPIC
            assert profile["durability"] == ("transient_local" if latched else "volatile")
        decoded = list(reader.iter_decoded_messages(log_time_order=False))
    times = [message.log_time for _, _, message, _ in decoded]
    assert times == sorted(times) and len(times) == 648
    [urdf] = [m.data for _, channel, _, m in decoded if channel.topic == messages.DESCRIPTION_TOPIC]
    assert urdf == "<robot name='a'/>"


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "run.mcap"
    write_recording(path, example(10))
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match="power"), RecordingWriter(path) as writer:
        writer.add_topic("/x", messages.STRING)
        raise RuntimeError("power")
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.mcap"]


def test_places_that_cannot_be_written_are_user_errors(tmp_path):
    write_recording(tmp_path / "run", example(10))
    with pytest.raises(UserError, match="exists already"):
        write_recording(tmp_path / "run", example(10))
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        write_recording(tmp_path / "file" / "run.mcap", example(10))


def test_a_full_disk_is_a_user_error():
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / ".run.mcap.part").symlink_to("/dev/full")
        with pytest.raises(UserError, match="No space left"):
            write_recording(Path(scratch) / "run.mcap", example(100))
        assert list(Path(scratch).iterdir()) == []


@contextmanager
def files_of_at_most(size: int):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [0, 20])
def test_a_bag_that_cannot_even_be_begun_leaves_nothing(tmp_path, size):
    with files_of_at_most(size), pytest.raises(UserError, match=r"File too large\); make room"):
        RecordingWriter(tmp_path / "run", remedy="make room")
    assert list(tmp_path.iterdir()) == []


def test_a_bag_that_no_message_could_be_written_to_leaves_nothing(tmp_path):
    with files_of_at_most(100), pytest.raises(UserError), RecordingWriter(tmp_path / "run") as writer:
        channel = writer.add_topic("/x", messages.STRING)
        writer.write(channel, START, os.urandom(1000))
    assert writer.kept == 0 and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [300_000, 390_000, 400_000])
def test_messages_kept_are_those_that_are_read_back_after_the_disk_was_full(tmp_path, size):
    with files_of_at_most(size), pytest.raises(UserError), RecordingWriter(tmp_path / "run") as writer:
        channel = writer.add_topic("/x", messages.STRING)
        for number in range(100):
            writer.write(channel, START + number, os.urandom(10_000))
            if number == 19:
                writer.flush()
    # 20 messages were flushed; the chunk cut off holds blocks of 128 kB, each to be decompressed by itself.
    assert 20 < writer.kept < 100
    assert sum(1 for _ in bag.messages(tmp_path / "run")) == writer.kept


KILLED = """
import sys
from spacearm_ident.recording import RecordingWriter, cdr, messages
import numpy as np
with RecordingWriter(sys.argv[1]) as writer:
    channel = writer.add_topic(messages.STATES_TOPIC, messages.JOINT_STATE)
    for row in range(10**9):
        stamp = 10**18 + row * 10**6
        [payload] = cdr.encode_joint_states([stamp], ["a", "b"], *[np.full((1, 2), float(row))] * 3)
        writer.write(channel, stamp, payload)
        if row % 100 == 99:
            writer.flush()
            print(row + 1, flush=True)
"""


def test_a_killed_recorder_loses_nothing_it_flushed(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "run")],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).resolve().parents[1],
    ) as process:
        flushed = [int(process.stdout.readline()) for _ in range(3)][-1]
        os.kill(process.pid, signal.SIGKILL)
    recording = read_recording(tmp_path / "run")
    assert len(recording.time) >= flushed == 300
    assert recording.position[:, 0].tolist() == list(range(len(recording.time)))
    assert {"no_metadata", "cut_off"} <= {issue.kind for issue in recording.issues}


def test_copying_keeps_topics_it_does_not_know(tmp_path):
    camera = messages.MessageType("vendor_msgs/msg/Blob", "uint8[] data\n")
    with RecordingWriter(tmp_path / "one.mcap") as writer:
        numbers = [
            writer.add_topic("/blob", camera),
            writer.add_topic("/other", messages.STRING, [LATCHED]),
        ]
        written = [(numbers[row % 2], START + row, os.urandom(row), START - row) for row in range(60)]
        for channel, log_time, payload, publish_time in written:
            writer.write(channel, log_time, payload, publish_time)
    with RecordingWriter(tmp_path / "copy") as writer:
        assert copy_messages(tmp_path / "one.mcap", writer) == 60
    with RecordingWriter(tmp_path / "blobs.mcap") as writer:
        assert copy_messages(tmp_path / "copy", writer, lambda channel: channel.topic == "/blob") == 30

    def content(path: Path) -> list[tuple]:
        with path.open("rb") as file:
            return [
                (c.topic, c.metadata, s.name, s.data, m.log_time, m.publish_time, m.data)
                for s, c, m in make_reader(file).iter_messages()
            ]

    original = content(tmp_path / "one.mcap")
    assert content(tmp_path / "copy" / "copy_0.mcap") == original and len(original) == 60
    assert content(tmp_path / "blobs.mcap") == [row for row in original if row[0] == "/blob"]
