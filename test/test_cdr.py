"""CDR against three independent implementations: rosbags, mcap_ros2 and (where installed) ROS 2 itself."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore

from spacearm_ident.recording import cdr, messages

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
NAMES = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=9)
NUMBERS = st.floats(allow_nan=True, width=64)
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def ros_joint_state(stamp_ns, frame_id, names, arrays, *, little_endian=True) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)
    values = [np.array(array, dtype=np.float64) for array in arrays]
    message = TYPES["sensor_msgs/msg/JointState"](header, list(names), *values)
    return bytes(STORE.serialize_cdr(message, "sensor_msgs/msg/JointState", little_endian=little_endian))


@st.composite
def joint_states(draw):
    names = draw(st.lists(NAMES, max_size=5, unique=True))
    row = st.lists(NUMBERS, min_size=len(names), max_size=len(names))
    arrays = [draw(row) if draw(st.booleans()) else [] for _ in range(3)]
    return draw(STAMPS), draw(NAMES), tuple(names), arrays


def rows_of(blocks) -> dict[int, tuple]:
    """What was decoded, by row, in comparable form."""
    result = {}
    for block in blocks:
        arrays = (block.position, block.velocity, block.effort)
        for index, row in enumerate(block.rows.tolist()):
            values = tuple(b"" if array is None else array[index].tobytes() for array in arrays)
            result[row] = (int(block.stamp_ns[index]), block.names, values)
    return result


def expected(message) -> tuple:
    stamp_ns, _, names, arrays = message
    return stamp_ns, names, tuple(np.array(array, dtype=np.float64).tobytes() for array in arrays)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(joint_states(), st.booleans()), max_size=25))
def test_any_mixture_of_layouts_decodes_as_rosbags_encoded_it(cases):
    payloads = [ros_joint_state(*message, little_endian=little) for message, little in cases]
    blocks, bad = cdr.decode_joint_states(payloads)
    assert bad == []
    assert rows_of(blocks) == {row: expected(message) for row, (message, _) in enumerate(cases)}


@settings(max_examples=60, deadline=None)
@given(joint_states())
def test_encoding_is_byte_for_byte_that_of_rosbags(message):
    stamp_ns, frame_id, names, arrays = message
    columns = [np.array([array]) if array else None for array in arrays]
    [payload] = cdr.encode_joint_states([stamp_ns], names, *columns, frame_id=frame_id)
    assert payload == ros_joint_state(*message)


def test_mcap_ros2_reads_what_we_encode_with_our_definition_texts():
    position = np.arange(12.0).reshape(2, 6)
    names = [f"joint_{i}" for i in range(6)]
    payloads = cdr.encode_joint_states([1, 2_000_000_003], names, position, None, -position)
    kind = messages.JOINT_STATE
    decode = generate_dynamic(kind.name, kind.text)[kind.name]
    second = decode(payloads[1])
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (2, 3)
    assert list(second.name) == names
    assert list(second.velocity) == []
    assert list(second.position) == position[1].tolist()
    assert list(second.effort) == (-position[1]).tolist()
    warm = generate_dynamic(messages.TEMPERATURE.name, messages.TEMPERATURE.text)[messages.TEMPERATURE.name]
    temperature = warm(cdr.encode_temperature(5, "elbow", 21.5, 0.25))
    assert (temperature.header.frame_id, temperature.temperature, temperature.variance) == (
        "elbow",
        21.5,
        0.25,
    )


def test_ros_itself_understands_our_bytes_and_we_its():
    serialization = pytest.importorskip("rclpy.serialization", reason="no ROS 2 on this machine")
    joint_state = pytest.importorskip("sensor_msgs.msg").JointState
    message = joint_state(name=["a", "bcd"], position=[1.0, 2.0], effort=[-3.0, 0.5])
    message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id = 7, 8, "base"
    blocks, bad = cdr.decode_joint_states([serialization.serialize_message(message)])
    assert bad == [] and len(blocks) == 1 and blocks[0].velocity is None
    assert blocks[0].effort.tolist() == [[-3.0, 0.5]] and blocks[0].stamp_ns.tolist() == [7_000_000_008]
    effort = np.array([[-3.0, 0.5]])
    [payload] = cdr.encode_joint_states(
        [7_000_000_008], ["a", "bcd"], np.array([[1.0, 2.0]]), None, effort, frame_id="base"
    )
    assert serialization.deserialize_message(payload, joint_state) == message


@pytest.mark.parametrize("kind", [messages.STRING, messages.JOINT_STATE, messages.TEMPERATURE])
def test_type_hashes_are_those_of_the_definitions(kind):
    assert STORE.hash_rihs01(kind.name) == kind.type_hash


def test_a_constant_layout_is_one_block_even_with_garbage_in_the_padding_and_changing_frame_ids():
    names = ["a", "bcd"]
    frames = ["abc", "xyz"]
    payloads = []
    for row in range(200):
        stamp, values = [row], np.full((1, 2), float(row))
        [payload] = cdr.encode_joint_states(stamp, names, values, values, values, frame_id=frames[row % 2])
        changed = bytearray(payload)
        gap = payload.index(b"a\0") + 2  # behind "a\0" up to the next multiple of 4
        changed[gap : gap + 2] = bytes([row, 255 - row])
        payloads.append(bytes(changed))
    blocks, bad = cdr.decode_joint_states(payloads)
    assert bad == [] and len(blocks) == 1
    assert blocks[0].effort[:, 1].tolist() == list(range(200))


def test_array_of_another_length_than_the_names_counts_as_absent():
    blocks, bad = cdr.decode_joint_states([ros_joint_state(1, "", ["a", "b"], ([1, 2], [1], [3, 4]))])
    assert bad == [] and blocks[0].velocity is None
    assert blocks[0].effort.tolist() == [[3.0, 4.0]]


@pytest.mark.parametrize("place", ["frame", "names", "name", "position", "velocity", "effort"])
def test_absurd_lengths_are_refused_without_allocating(place):
    good = ros_joint_state(1, "f", ["abc"], ([1], [2], [3]))
    # 4 header, 8 stamp, 4+2 frame +2 pad, 4 names, 4+4 name, then three times 4 (+4 pad) + 8
    offset = {"frame": 12, "names": 20, "name": 24, "position": 32, "velocity": 44, "effort": 60}[place]
    assert struct.unpack_from("<I", good, offset)[0] in (1, 2, 4)
    hostile = bytearray(good)
    struct.pack_into("<I", hostile, offset, 0xFFFFFFF0)
    tracemalloc.start()
    blocks, bad = cdr.decode_joint_states([good, bytes(hostile), good])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert bad == [1] and sorted(np.concatenate([block.rows for block in blocks])) == [0, 2]
    assert peak < 1_000_000


@settings(max_examples=150, deadline=None)
@given(
    st.lists(joint_states(), min_size=1, max_size=4),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255), st.booleans()), max_size=8),
)
def test_damaged_payloads_never_raise_and_every_row_is_accounted_for(cases, damage):
    payloads = [bytearray(ros_joint_state(*message)) for message in cases]
    for place, value, cut in damage:
        payload = payloads[place % len(payloads)]
        if payload and cut:
            del payload[place % len(payload) :]
        elif payload:
            payload[place % len(payload)] = value
    blocks, bad = cdr.decode_joint_states([bytes(payload) for payload in payloads])
    rows = sorted([*bad, *(row for block in blocks for row in block.rows.tolist())])
    assert rows == list(range(len(payloads)))


@settings(max_examples=40, deadline=None)
@given(STAMPS, NAMES, st.floats(allow_nan=False))
def test_temperature_and_string_against_rosbags(stamp_ns, text, value):
    payload = cdr.encode_temperature(stamp_ns, text, value)
    message = STORE.deserialize_cdr(payload, "sensor_msgs/msg/Temperature")
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp_ns
    assert (message.header.frame_id, message.temperature) == (text, value)
    for little in (True, False):
        wire = bytes(STORE.serialize_cdr(message, "sensor_msgs/msg/Temperature", little_endian=little))
        assert cdr.decode_temperature(wire) == (stamp_ns, text, value)
    string = STORE.types["std_msgs/msg/String"](data=text)
    wire = bytes(STORE.serialize_cdr(string, "std_msgs/msg/String"))
    assert cdr.decode_string(wire) == text
    assert STORE.deserialize_cdr(cdr.encode_string(text), "std_msgs/msg/String").data == text


def test_cut_temperature_and_string_are_errors_at_every_length():
    for payload, decode in (
        (cdr.encode_temperature(1, "j", 20.0)[:-8], cdr.decode_temperature),
        (cdr.encode_string("urdf"), cdr.decode_string),
    ):
        decode(payload)
        for size in range(len(payload)):
            with pytest.raises(cdr.CdrError):
                decode(payload[:size])
