"""Hostile recordings: they are read or refused, in bounded memory and time; see test_fuzz."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from fuzzing import EXAMPLES, ends_well, in_child
from hypothesis import given
from hypothesis import strategies as st
from made_bags import JOINTS, START, bag_bytes, read_bytes, signals, states
from mcap.writer import CompressionType

from spacearm_ident.recording import cdr, messages, read_recording

# --- recordings ---------------------------------------------------------------------------------------------

OTHERS = [
    (START, messages.DESCRIPTION_TOPIC, cdr.encode_string("<robot/>")),
    *((START + k, messages.TEMPERATURES_TOPIC, cdr.encode_temperature(START + k, "elbow", 20.0)) for k in range(3)),
    *((START + k, messages.COMMAND_TOPIC, row) for k, (_, row) in enumerate(states(5))),
]
BAGS = [
    bag_bytes(states(60), flush_every=20, others=OTHERS),
    bag_bytes(states(60), others=OTHERS, use_chunking=False),
    bag_bytes(states(60), others=OTHERS, enable_crcs=False, flush_every=20, compression=CompressionType.NONE),
]
DAMAGE = st.lists(
    st.one_of(
        st.tuples(st.just("flip"), st.floats(0, 1), st.integers(0, 7)),
        st.tuples(st.just("cut"), st.floats(0, 1), st.just(0)),
        st.tuples(st.just("length"), st.floats(0, 1), st.sampled_from([0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1])),
        st.tuples(st.just("noise"), st.floats(0, 1), st.integers(0, 2**32 - 1)),
        st.tuples(st.just("repeat"), st.floats(0, 1), st.integers(1, 400)),
    ),
    min_size=1,
    max_size=5,
)


def damaged(data: bytes, damage: list[tuple[str, float, int]]) -> bytes:
    out = bytearray(data)
    for kind, share, value in damage:
        place = int(share * max(0, len(out) - 1))
        match kind:
            case "flip" if out:
                out[place] ^= 1 << value
            case "cut":
                del out[place:]
            case "length" if len(out) >= 8:
                struct.pack_into("<Q", out, min(place, len(out) - 8), value)
            case "noise":
                out[place : place + 16] = np.random.default_rng(value).bytes(16)
            case "repeat":
                out[place:place] = out[place : place + value]
    return bytes(out)


@EXAMPLES
@given(which=st.integers(0, len(BAGS) - 1), damage=DAMAGE)
def test_a_damaged_recording_is_read_or_refused(tmp_path, which, damage):
    recording = ends_well(lambda: read_bytes(tmp_path, damaged(BAGS[which], damage)))
    if recording is not None:
        assert (np.diff(recording.time) > 0).all() and len(recording.time) >= 2
        for values in (recording.position, recording.effort):
            assert values.shape == (len(recording.time), len(recording.joints)) and np.isfinite(values).all()
        assert all(np.isfinite(series.values).all() for series in recording.temperatures.values())


@EXAMPLES
@given(payloads=st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(0, 59), DAMAGE), min_size=2, max_size=12))
def test_sound_files_with_damaged_messages(tmp_path, payloads):
    """What no checksum tells: the writer itself was mad, in the payloads and in the log times."""
    rows = [(log, damaged(states(60)[row][1], damage)) for log, row, damage in payloads]
    recording = ends_well(lambda: read_bytes(tmp_path, bag_bytes([*states(10), *rows])))
    if recording is not None:
        assert (np.diff(recording.time) > 0).all() and np.isfinite(recording.position).all()


def test_log_times_at_both_ends_of_their_range_keep_time_increasing(tmp_path):
    logs = [1, 2, 2**62 - 1, 2**63 - 1, 2**63, 2**64 - 1]
    payloads = cdr.encode_joint_states([0] * len(logs), JOINTS, *signals(len(logs)))
    recording = read_bytes(tmp_path, bag_bytes(list(zip(logs, payloads, strict=True))))
    assert (np.diff(recording.time) > 0).all() and len(recording.time) == 3


def test_one_message_of_many_joints_among_many_of_one_makes_no_table_of_both(tmp_path):
    many = [f"j{k}" for k in range(40_000)]
    values = np.zeros((2, len(many)))
    wide = cdr.encode_joint_states([START, START + 5], many, values, None, values)
    narrow = cdr.encode_joint_states(START + 10 * np.arange(30_000), ["a"], *np.zeros((3, 30_000, 1)))
    path = tmp_path / "bag.mcap"
    path.write_bytes(bag_bytes([*zip((START, START + 5), wide), *((START, row) for row in narrow)]))
    code = f"""
        from spacearm_ident.recording import read_recording
        recording = read_recording({str(path)!r})
        print(len(recording.joints), len(recording.time))
    """
    assert in_child(code) == "40000 2"


def test_temperatures_of_as_many_names_as_messages(tmp_path):
    others = [
        (START + k, messages.TEMPERATURES_TOPIC, cdr.encode_temperature(START + k, f"joint {k}", 20.0))
        for k in range(20_000)
    ]
    assert len(read_bytes(tmp_path, bag_bytes(states(10), others=others)).temperatures) == 20_000


def chunk(records: bytes) -> bytes:
    import zstandard

    packed = zstandard.compress(records)
    body = struct.pack("<QQQI", 0, 0, len(records), 0) + struct.pack("<I", 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    return b"\x06" + struct.pack("<Q", len(body)) + body


@pytest.mark.parametrize("record", [bytes(9), b"\x05" + struct.pack("<Q", 22) + bytes(22)], ids=["zeros", "homeless"])
def test_many_chunks_that_expand_a_thousandfold_take_no_time_beyond_the_file_s_size(tmp_path, record):
    """Some hundred kilobytes that hold 12 GB: without a limit minutes of nothing, and hours in a larger file."""
    bomb = chunk(record * (40_000_000 // len(record)))
    sound = bag_bytes(states(50), finish=False)
    path = tmp_path / "bag.mcap"
    path.write_bytes(sound + bomb * 300)
    code = f"""
        from spacearm_ident.recording import mcap_reader, read_recording
        mcap_reader.MAX_CHUNK_BYTES, mcap_reader.MAX_EXPANSION = 2**26, 2
        recording = read_recording({str(path)!r})
        print(len(recording.time), sorted({{issue.kind for issue in recording.issues}}))
    """
    told = in_child(code)
    assert told.startswith("50 ") and "corrupt_chunk" in told


@EXAMPLES
@given(text=st.text(max_size=200) | st.binary(max_size=200).map(lambda raw: raw.decode("latin-1")))
def test_the_metadata_of_a_folder_of_bags(tmp_path, text):
    (tmp_path / "run.mcap").write_bytes(BAGS[0])
    (tmp_path / "metadata.yaml").write_text(text, encoding="utf-8", errors="replace")
    ends_well(lambda: read_recording(tmp_path))
