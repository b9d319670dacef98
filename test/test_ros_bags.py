"""Bags of other formats, or compressed, as `rosbags` writes them, hold what the plain MCAP bag holds."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import small_arm
import zstandard
from fuzzing import EXAMPLES, ends_well
from hypothesis import given
from made_bags import assert_same, issues
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from test_fuzz_bags import DAMAGE, damaged

from spacearm_ident.cli.check import is_bag
from spacearm_ident.errors import UserError
from spacearm_ident.recording import Recording, bag, cdr, messages, read_recording, recordings_in, zstd
from spacearm_ident.sessions.batch import find_bags

RUN = small_arm.recording(3.0)


def write_bag(
    run: Recording,
    folder: Path,
    mode: CompressionMode = CompressionMode.NONE,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
) -> None:
    """A rosbag2 folder, description and joint states."""
    store = get_typestore(Stores.ROS2_JAZZY)
    stamps = run.start_ns + np.rint(run.time * 1e9).astype(np.int64)
    payloads = cdr.encode_joint_states(stamps, run.joints, run.position, run.velocity, run.effort)
    writer = Writer2(folder, version=9, storage_plugin=storage)
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


STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
COMPRESSED = [CompressionMode.FILE, CompressionMode.MESSAGE]


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("mode", [CompressionMode.NONE, *COMPRESSED])
def test_bags_hold_the_same_samples_compressed_or_not(tmp_path, mode, storage):
    write_bag(RUN, tmp_path / "bag", mode, storage)
    assert recordings_in(tmp_path) == [tmp_path / "bag"]
    got = read_recording(tmp_path / "bag")
    assert_same(got, RUN)
    assert got.urdf == RUN.urdf and not got.issues


def test_a_single_db3_file_without_its_metadata_is_read(tmp_path):
    write_bag(RUN, tmp_path / "bag")
    (file,) = (tmp_path / "bag").glob("*.db3")
    odd = tmp_path / "50% of?it#.db3"  # what a URI would take for its own
    file.rename(odd)
    assert_same(read_recording(odd), RUN)


@pytest.mark.parametrize("mode", COMPRESSED)
def test_a_single_compressed_mcap_file_without_its_metadata_is_read_by_every_command(tmp_path, mode):
    write_bag(RUN, tmp_path / "bag", mode, StoragePlugin.MCAP)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    (file,) = (tmp_path / "bag").iterdir()
    assert file.name.endswith(".mcap.zstd" if mode is CompressionMode.FILE else ".mcap")
    fractions: list[float] = []
    got = read_recording(file, progress=fractions.append)
    assert_same(got, RUN)
    assert got.sources[0].bytes == file.stat().st_size and fractions == sorted(fractions) and fractions[-1] == 1.0
    assert issues(read_recording(tmp_path / "bag")) == {"no_metadata": 1}
    assert is_bag(file) and is_bag(tmp_path / "bag") and is_bag(tmp_path)
    assert find_bags([tmp_path]) == {f"bag/{file.name.partition('.')[0]}": file}


def test_a_compressed_mcap_file_beside_what_it_holds_is_read_once(tmp_path):
    """`zstd -d` keeps the compressed file."""
    write_bag(RUN, tmp_path / "bag", CompressionMode.FILE, StoragePlugin.MCAP)
    (file,) = (tmp_path / "bag").glob("*.zstd")
    file.with_suffix("").write_bytes(zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read())
    got = read_recording(tmp_path / "bag")
    assert_same(got, RUN)
    assert not got.issues and [Path(source.path) for source in got.sources] == [file.with_suffix("")]


def test_of_a_compressed_mcap_file_that_breaks_off_the_rest_is_read(tmp_path):
    write_bag(RUN, tmp_path / "bag", CompressionMode.FILE, StoragePlugin.MCAP)
    (file,) = (tmp_path / "bag").glob("*.zstd")
    plain = zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read()
    packer = zstandard.ZstdCompressor().compressobj()
    half = packer.compress(plain[: len(plain) // 2]) + packer.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    file.write_bytes(half)  # a frame without an end
    got = read_recording(file)
    count = len(got.time)
    assert 0 < count < len(RUN.time) and "cut_off" in issues(got)
    assert np.array_equal(got.effort, RUN.effort[:count])


@pytest.mark.parametrize("storage", STORAGES)
def test_a_damaged_compressed_message_is_left_out_and_counted(tmp_path, monkeypatch, storage):
    write_bag(RUN, tmp_path / "bag", CompressionMode.MESSAGE, storage)
    inflate, seen = bag.inflated_message, []

    def third_is_damaged(data: bytes) -> bytes:
        seen.append(data)
        return inflate(data[:20] + bytes(8) + data[28:] if len(seen) == 4 else data)  # the first is the description

    monkeypatch.setattr(bag, "inflated_message", third_is_damaged)
    got = read_recording(tmp_path / "bag")
    assert issues(got) == {"undecodable_message": 1}
    assert np.array_equal(got.effort, np.delete(RUN.effort, 2, axis=0))


def test_ros_1_bags_hold_the_same_samples(tmp_path):
    write_ros1(RUN, tmp_path / "run.bag")
    assert_same(read_recording(tmp_path / "run.bag"), RUN)


@pytest.mark.parametrize("kind", ["db3", "bag"])
@EXAMPLES
@given(damage=DAMAGE)
def test_a_damaged_sqlite3_or_ros_1_bag_is_read_or_refused(tmp_path_factory, kind, damage):
    path = _kept(tmp_path_factory, kind)
    target = path.with_name(f"hurt.{kind}")
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
            write_bag(short, folder / "bag")
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


@pytest.mark.parametrize("name", ["bag.db3.zstd", "bag.mcap.zstd"])
def test_a_compressed_bag_that_grows_beyond_reason_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.setattr(zstd, "MAX_INFLATED", 2)
    (tmp_path / name).write_bytes(zstandard.compress(bytes(50_000_000)))
    with pytest.raises(UserError, match="grows by more than 2 times"):
        read_recording(tmp_path / name)
