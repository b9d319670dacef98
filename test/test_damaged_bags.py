"""Bags that were cut, damaged, split or are none: what is whole is read, the rest is said in one line."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_bags import WHOLE, bag_bytes, issues, numbers, read_bytes, states
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from spacearm_ident.errors import UserError
from spacearm_ident.recording import messages, read_recording
from spacearm_ident.recording.mcap_reader import MAX_CHUNK_BYTES

# --- defects of the file ------------------------------------------------------------------------------------


CHUNKS = [
    (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length)
    for index in make_reader(BytesIO(WHOLE)).get_summary().chunk_indexes
]
# The first flush closes a chunk of the description and 24 samples, each later one holds 25.
COUNTS = np.cumsum([24] + [25] * 15 + [1])


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def test_the_bag_to_be_damaged_is_as_assumed():
    assert len(CHUNKS) == len(COUNTS) and COUNTS[-1] == 400


@settings(max_examples=120, deadline=None)
@given(cut=st.integers(0, len(WHOLE) - 1))
def test_a_cut_never_crashes_and_loses_no_chunk_before_it(scratch, cut):
    whole_chunks = sum(stop <= cut for _, stop in CHUNKS)
    sound = int(COUNTS[whole_chunks - 1]) if whole_chunks else 0
    try:
        recording = read_bytes(scratch, WHOLE[:cut])
    except UserError:
        assert sound < 2
        return
    read = numbers(recording)
    assert read == list(range(len(read))) and len(read) >= sound
    assert "cut_off" in issues(recording) or cut > CHUNKS[-1][1]


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"compression": CompressionType.NONE}])
def test_every_complete_message_before_a_cut_is_read(tmp_path, options):
    whole = bag_bytes(states(100), **options)
    payloads = [payload for _, payload in states(100)]
    for cut in (whole.index(payloads[60]), whole.index(payloads[60]) + len(payloads[60])):
        complete = 60 if cut == whole.index(payloads[60]) else 61
        recording = read_bytes(tmp_path, whole[:cut])
        assert numbers(recording) == list(range(complete))
        assert issues(recording)["cut_off"] == 1


def test_power_loss_that_leaves_zeros_at_the_end(tmp_path):
    recording = read_bytes(tmp_path, WHOLE[: CHUNKS[9][1]] + bytes(20_000))
    assert numbers(recording) == list(range(COUNTS[9])) and "cut_off" in issues(recording)


@settings(max_examples=150, deadline=None)
@given(flips=st.lists(st.integers(0, 8 * len(WHOLE) - 1), min_size=1, max_size=3))
def test_bit_flips_never_crash_and_never_let_a_false_sample_through(scratch, flips):
    damaged = bytearray(WHOLE)
    for flip in flips:
        damaged[flip // 8] ^= 1 << flip % 8
    hit = {
        number for number, (start, stop) in enumerate(CHUNKS) if any(start - 9 <= flip // 8 < stop for flip in flips)
    }
    try:
        recording = read_bytes(scratch, damaged)
    except UserError as error:
        magic = any(flip // 8 < 8 for flip in flips)
        declarations = 0 in hit and any(flip // 8 >= CHUNKS[-1][1] for flip in flips)
        assert magic or declarations, error  # the topics are declared in the first chunk and the summary
        return
    read = set(numbers(recording))  # each one as it was written, whatever was hit
    edges = [0, *COUNTS.tolist()]
    for number in set(range(len(CHUNKS))) - hit:
        assert set(range(edges[number], edges[number + 1])) <= read


@pytest.mark.parametrize("number", [0, 7])
def test_a_chunk_that_fails_its_crc_is_left_out_and_the_rest_read(tmp_path, number):
    start, stop = CHUNKS[number]
    damaged = bytearray(WHOLE)
    damaged[(start + stop) // 2] ^= 0xFF
    recording = read_bytes(tmp_path, damaged)
    edges = [0, *COUNTS.tolist()]
    lost = range(edges[number], edges[number + 1])
    assert numbers(recording) == [row for row in range(400) if row not in lost]
    found = issues(recording)
    assert found["corrupt_chunk"] == 1
    assert found["lost_messages"] == len(lost) + (number == 0)
    [issue] = [issue for issue in recording.issues if issue.kind == "corrupt_chunk"]
    assert str(start) in issue.message
    if number:
        assert issue.where_s == pytest.approx((lost[0] - 1) * 1e-3)
        assert len(recording.segments) == 2


def test_absurd_record_length_of_a_chunk_costs_nothing_as_long_as_its_data_length_stands(tmp_path):
    damaged = bytearray(WHOLE)
    struct.pack_into("<Q", damaged, CHUNKS[5][0] + 1, 2**62)
    recording = read_bytes(tmp_path, damaged)
    assert numbers(recording) == list(range(400)) and recording.issues == ()


def test_reading_resumes_behind_absurd_lengths(tmp_path):
    start, _ = CHUNKS[5]
    damaged = bytearray(WHOLE)
    struct.pack_into("<Q", damaged, start + 1, 2**62)
    name = damaged.index(b"zstd", start)
    struct.pack_into("<Q", damaged, name + 4, 2**61)
    recording = read_bytes(tmp_path, damaged)
    assert numbers(recording) == [row for row in range(400) if not COUNTS[4] <= row < COUNTS[5]]
    [issue] = [issue for issue in recording.issues if issue.kind == "corrupt_record"]
    assert f"byte {start}" in issue.message and issue.where_s == pytest.approx((COUNTS[4] - 1) * 1e-3)


def test_an_unchunked_file_resumes_behind_a_broken_record(tmp_path):
    whole = bytearray(bag_bytes(states(100), use_chunking=False))
    record = whole.index(states(100)[50][1]) - 31
    assert whole[record] == 5
    struct.pack_into("<Q", whole, record + 1, 1000)
    recording = read_bytes(tmp_path, whole)
    assert numbers(recording) == [row for row in range(100) if row != 50]
    assert issues(recording) == {"corrupt_record": 1, "lost_messages": 1}


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_decompression_bomb_is_refused(tmp_path, compression):
    import lz4.frame
    import zstandard

    zeros = bytes(MAX_CHUNK_BYTES + 1)
    name, packed = (
        (b"zstd", zstandard.compress(zeros))
        if compression == CompressionType.ZSTD
        else (b"lz4", lz4.frame.compress(zeros))
    )
    sound = bag_bytes(states(50), finish=False)
    for announced in (len(zeros), 1000, 2**63):
        body = struct.pack("<QQQI", 0, 0, announced, 1) + struct.pack("<I", len(name)) + name
        body += struct.pack("<Q", len(packed)) + packed
        recording = read_bytes(tmp_path, sound + b"\x06" + struct.pack("<Q", len(body)) + body)
        assert numbers(recording) == list(range(50)) and issues(recording)["corrupt_chunk"] == 1


# --- folders ------------------------------------------------------------------------------------------------


def split_bag(folder: Path, parts: int = 11, listed=None) -> None:
    folder.mkdir()
    rows = states(110)
    names = [f"run_{number}.mcap" for number in range(parts)]
    for number, name in enumerate(names):
        (folder / name).write_bytes(bag_bytes(rows[number * 10 : (number + 1) * 10]))
    information = {"version": 9, "relative_file_paths": listed or names}
    (folder / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": information}))


def test_split_bag_in_order_of_metadata_or_of_natural_names(tmp_path):
    split_bag(tmp_path / "run")
    recording = read_recording(tmp_path / "run")
    assert numbers(recording) == list(range(110)) and recording.issues == ()
    assert len(recording.sources) == 11
    (tmp_path / "run" / "metadata.yaml").unlink()
    recording = read_recording(tmp_path / "run")
    assert numbers(recording) == list(range(110)) and issues(recording) == {"no_metadata": 1}


def test_missing_unlisted_and_empty_files_of_a_split_bag(tmp_path):
    names = ["run_0.mcap", "run_1.mcap", "run_2.mcap", "gone.mcap"]
    split_bag(tmp_path / "run", listed=names)
    (tmp_path / "run" / "run_2.mcap").write_bytes(b"")
    recording = read_recording(tmp_path / "run")
    assert numbers(recording) == list(range(20))
    assert issues(recording) == {"missing_file": 1, "unlisted_file": 8, "unreadable_file": 1}


def test_metadata_cannot_point_outside_the_folder(tmp_path):
    (tmp_path / "secret.mcap").write_bytes(bag_bytes(states(10)))
    split_bag(tmp_path / "run", listed=["../secret.mcap", "run_0.mcap"])
    assert len(read_recording(tmp_path / "run").time) == 10
    assert "missing_file" in issues(read_recording(tmp_path / "run"))


# --- what is no recording -----------------------------------------------------------------------------------


def user_errors():
    yield "missing", None, "no such file"
    yield "empty", b"", "empty"
    yield "text", b"hello, this is not a bag", "not an MCAP"
    yield "sqlite", b"SQLite format 3\0" + bytes(100), "not a readable rosbag2 file"
    yield "ros1", b"#ROSBAG V2.0\n" + bytes(100), "not a readable ROS 1 bag"
    yield "compressed", b"\x28\xb5\x2f\xfd" + bytes(100), "zstd -d"
    yield "only magic", WHOLE[:8], "no /joint_states"
    yield "other topics", bag_bytes([(1, b"\0\1\0\0\0")], topic="/camera"), r"/camera \(pkg/msg/Odd\)"
    yield "one sample", bag_bytes(states(1)), "fewer than two"


@pytest.mark.parametrize(("content", "says"), [pytest.param(*rest, id=name) for name, *rest in user_errors()])
def test_what_is_no_recording_is_one_line_that_says_so(tmp_path, content, says):
    path = tmp_path / "bag.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=says) as error:
        read_recording(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_folder_without_mcap_and_unknown_joint(tmp_path):
    with pytest.raises(UserError, match=r"no \.mcap file"):
        read_recording(tmp_path)
    with pytest.raises(UserError, match="no joint hip; the recording has elbow, shoulder, wrist"):
        read_bytes(tmp_path, bag_bytes(states(10)), joints=["hip"])
    (tmp_path / "metadata.yaml").write_text(
        json.dumps({"rosbag2_bagfile_information": {"relative_file_paths": ["a.mcap"], "compression_format": "lz4"}})
    )
    with pytest.raises(UserError, match=r"compressed by 'lz4', not zstd; convert it with `ros2 bag convert`"):
        read_recording(tmp_path)


def test_topic_of_another_type_is_not_taken_for_joint_states(tmp_path):
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema("other/msg/Thing", "ros2msg", b"int8 x\n")
    channel = writer.register_channel(messages.STATES_TOPIC, "cdr", schema)
    for log, payload in states(10):
        writer.add_message(channel, log, payload, log)
    writer.finish()
    with pytest.raises(UserError, match="other/msg/Thing"):
        read_bytes(tmp_path, stream.getvalue())
