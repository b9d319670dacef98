"""Bags that are not MCAP, as `rosbags` writes them, hold what the MCAP bag holds; damaged ones end in one line."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import small_arm
import zstandard
from fuzzing import EXAMPLES, ends_well
from hypothesis import given
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from test_fuzz_bags import DAMAGE, damaged

from spacearm_ident.errors import UserError
from spacearm_ident.recording import Recording, cdr, messages, read_recording, recordings_in, ros_bags

RUN = small_arm.recording(3.0)


def write_db3(run: Recording, folder: Path, mode: CompressionMode = CompressionMode.NONE) -> None:
    """A rosbag2 folder in sqlite3, description and joint states."""
    store = get_typestore(Stores.ROS2_JAZZY)
    stamps = run.start_ns + np.rint(run.time * 1e9).astype(np.int64)
    payloads = cdr.encode_joint_states(stamps, run.joints, run.position, run.velocity, run.effort)
    writer = Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        text = writer.add_connection(messages.DESCRIPTION_TOPIC, messages.STRING.name, typestore=store)
        states = writer.add_connection(messages.STATES_TOPIC, messages.JOINT_STATE.name, typestore=store)
        writer.write(text, int(stamps[0]), cdr.encode_string(run.urdf or ""))
        for stamp, payload in zip(stamps.tolist(), payloads, strict=True):
            writer.write(states, stamp, payload)


def write_ros1(run: Recording, path: Path) -> None:
    """A ROS 1 bag of joint states."""
    store = get_typestore(Stores.ROS1_NOETIC)
    state = store.types["sensor_msgs/msg/JointState"]
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    stamps = run.start_ns + np.rint(run.time * 1e9).astype(np.int64)
    with Writer1(path) as writer:
        connection = writer.add_connection(messages.STATES_TOPIC, "sensor_msgs/msg/JointState", typestore=store)
        for k, stamp in enumerate(stamps.tolist()):
            head = header(seq=k, stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            message = state(head, list(run.joints), run.position[k], run.velocity[k], run.effort[k])
            writer.write(connection, stamp, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))


def same(got: Recording, run: Recording) -> None:
    assert got.joints == run.joints and len(got.time) == len(run.time)
    for one, other in ((got.position, run.position), (got.velocity, run.velocity), (got.effort, run.effort)):
        assert np.array_equal(one, other)
    assert np.abs(got.time - run.time).max() < 2e-9


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_sqlite3_bags_hold_the_same_samples_compressed_or_not(tmp_path, mode):
    write_db3(RUN, tmp_path / "bag", mode)
    assert recordings_in(tmp_path) == [tmp_path / "bag"]
    got = read_recording(tmp_path / "bag")
    same(got, RUN)
    assert got.urdf == RUN.urdf and not got.issues


def test_a_single_db3_file_without_its_metadata_is_read(tmp_path):
    write_db3(RUN, tmp_path / "bag")
    (file,) = (tmp_path / "bag").glob("*.db3")
    odd = tmp_path / "50% of?it#.db3"  # what a URI would take for its own
    file.rename(odd)
    same(read_recording(odd), RUN)


def test_ros_1_bags_hold_the_same_samples(tmp_path):
    write_ros1(RUN, tmp_path / "run.bag")
    same(read_recording(tmp_path / "run.bag"), RUN)


@EXAMPLES
@given(damage=DAMAGE)
def test_a_damaged_sqlite3_bag_is_read_or_refused(tmp_path_factory, damage):
    path = _kept(tmp_path_factory, "db3")
    target = path.with_name("hurt.db3")
    target.write_bytes(damaged(path.read_bytes(), damage))
    recording = ends_well(lambda: read_recording(target))
    if recording is not None:
        assert (np.diff(recording.time) > 0).all() and np.isfinite(recording.effort).all()


@EXAMPLES
@given(damage=DAMAGE)
def test_a_damaged_ros_1_bag_is_read_or_refused(tmp_path_factory, damage):
    path = _kept(tmp_path_factory, "bag")
    target = path.with_name("hurt.bag")
    target.write_bytes(damaged(path.read_bytes(), damage))
    recording = ends_well(lambda: read_recording(target))
    if recording is not None:
        assert (np.diff(recording.time) > 0).all() and np.isfinite(recording.effort).all()


KEPT: dict[str, Path] = {}


def _kept(tmp_path_factory, kind: str) -> Path:
    """A sound bag of half a second, written once."""
    if kind not in KEPT:
        folder = tmp_path_factory.mktemp("kept")
        short = RUN.between(0.0, 0.5)
        if kind == "db3":
            write_db3(short, folder / "bag")
            KEPT[kind] = next((folder / "bag").glob("*.db3"))
        else:
            write_ros1(short, folder / "run.bag")
            KEPT[kind] = folder / "run.bag"
    return KEPT[kind]


def test_a_database_that_would_run_something_is_no_bag(tmp_path):
    with sqlite3.connect(tmp_path / "bag.db3") as database:
        database.execute("CREATE TABLE topics (id, name, type)")
        database.execute("CREATE VIEW messages AS SELECT 1 AS id, zeroblob(1000000000) AS data")
    with pytest.raises(UserError, match="not a bag"):
        read_recording(tmp_path / "bag.db3")


def test_a_compressed_bag_that_grows_beyond_reason_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(ros_bags, "MAX_INFLATED", 2)
    (tmp_path / "bag.db3.zstd").write_bytes(zstandard.compress(bytes(50_000_000)))
    with pytest.raises(UserError, match="grows by more than 2 times"):
        read_recording(tmp_path / "bag.db3.zstd")
