"""The identifier's buffer against a plain list, and its memory bound."""

from __future__ import annotations

import pytest
import small_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.nodes.message_buffer import BLOCK_MESSAGES, LARGEST_BYTES, Capture, MessageBuffer, write_captures
from spacearm_ident.recording import cdr, read_recording, write_recording
from spacearm_ident.recording.bag import read_bag
from spacearm_ident.recording.messages import DESCRIPTION_TOPIC, STATES_TOPIC, TOPIC_TYPES

MESSAGES = st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=40)), max_size=60)


@settings(max_examples=60, deadline=None)
@given(messages=MESSAGES, window=st.tuples(st.integers(-1, 100), st.integers(-1, 100)), number=st.integers(0, 70))
def test_it_holds_what_a_list_would(messages, window, number):
    buffer, times, now = MessageBuffer(STATES_TOPIC, 1000), [], 0
    for step, payload in messages:
        now += step
        times.append(now)
        buffer.append(now, payload)
    payloads = [payload for _, payload in messages]
    kept = list(zip(times, payloads))[-len(buffer) :] if len(buffer) else []
    assert len(buffer) + buffer.dropped == len(messages) == buffer.stored
    assert buffer.since(number) == payloads[max(number, len(payloads) - len(buffer)) :]
    start, stop = min(window), max(window)
    assert list(buffer.between(start, stop).messages()) == [(t, p) for t, p in kept if start <= t <= stop]
    if kept:
        assert buffer.span_ns() == (kept[0][0], kept[-1][0])


def test_memory_is_bounded_and_the_oldest_go_first():
    limit = 3 * BLOCK_MESSAGES
    buffer = MessageBuffer(STATES_TOPIC, limit)
    largest = 0
    for number in range(10 * BLOCK_MESSAGES):
        buffer.append(number, number.to_bytes(4, "little") * 5)
        largest = max(largest, buffer.bytes)
    assert limit <= len(buffer) <= limit + BLOCK_MESSAGES
    assert buffer.dropped == buffer.stored - len(buffer)
    assert buffer.bytes == largest <= (limit + BLOCK_MESSAGES) * (20 + 16)
    held = buffer.since(0)
    first = buffer.dropped
    assert held[0] == first.to_bytes(4, "little") * 5 and held[-1][:4] == (buffer.stored - 1).to_bytes(4, "little")
    assert len(buffer.between(0, 10**9).times_ns) == len(buffer)


@pytest.mark.parametrize("rate_hz", [50, 200, 1000])
def test_messages_are_kept_for_the_time_asked_for_at_any_rate(rate_hz):
    step_ns, span_s = 10**9 // rate_hz, 100
    buffer = MessageBuffer(STATES_TOPIC, 1000 * span_s, span_s * 10**9)
    for number in range(3 * span_s * rate_hz + 4 * BLOCK_MESSAGES):
        buffer.append(number * step_ns, b"x")
    first, last = buffer.span_ns()
    assert span_s <= (last - first) / 1e9 + 1.0 / rate_hz <= span_s + 2 * BLOCK_MESSAGES / rate_hz
    assert buffer.dropped == buffer.stored - len(buffer)


def test_a_faster_stream_than_the_limit_is_for_costs_no_more_memory():
    buffer = MessageBuffer(STATES_TOPIC, 2 * BLOCK_MESSAGES, 10**9 * 3600)
    for number in range(10 * BLOCK_MESSAGES):
        buffer.append(number, b"x")
    assert 2 * BLOCK_MESSAGES <= len(buffer) <= 3 * BLOCK_MESSAGES


def test_larger_messages_cost_messages_and_not_memory():
    buffer = MessageBuffer(STATES_TOPIC, 2 * BLOCK_MESSAGES)
    for number in range(6 * BLOCK_MESSAGES):
        buffer.append(number, b"small" if number < 100 else b"x" * 50)
    assert buffer.bytes <= 3 * BLOCK_MESSAGES * (5 + 16)
    assert set(buffer.since(0)) == {b"x" * 50} and len(buffer) > 100


def test_a_monstrous_message_is_lost_and_nothing_else():
    buffer = MessageBuffer(STATES_TOPIC, 100)
    buffer.append(0, b"fine")
    buffer.append(1, bytes(LARGEST_BYTES + 1))
    buffer.append(2, b"fine too")
    assert buffer.since(0) == [b"fine", b"fine too"] and buffer.dropped == 1


def test_a_capture_is_read_back_as_the_recording_it_was(tmp_path):
    run = small_arm.recording(4.0)
    write_recording(tmp_path / "run.mcap", run)
    streams = read_bag(tmp_path / "run.mcap", {topic: kind.name for topic, kind in TOPIC_TYPES.items()}.get).streams
    buffer = MessageBuffer(STATES_TOPIC, 10_000)
    for payload, time_ns in zip(streams[STATES_TOPIC].payloads, streams[STATES_TOPIC].log_times_ns):
        buffer.append(time_ns, payload)
    description = Capture.of_one(DESCRIPTION_TOPIC, 1, cdr.encode_string(small_arm.URDF))
    write_captures(tmp_path / "captured.mcap", [buffer.between(0, 2**62), description])
    whole, captured = (read_recording(tmp_path / name) for name in ("run.mcap", "captured.mcap"))
    assert captured.urdf == small_arm.URDF and captured.issues == whole.issues
    for name in ("time", "position", "velocity", "effort"):
        assert (getattr(captured, name) == getattr(whole, name)).all()
    cut = buffer.between(run.start_ns + 10**9, run.start_ns + 2 * 10**9)
    assert len(cut.times_ns) == pytest.approx(200, abs=1)


def test_a_clock_that_goes_back_loses_no_message():
    buffer = MessageBuffer(STATES_TOPIC, 100)
    for time_ns in (10, 20, 5, 21, 30):
        buffer.append(time_ns, bytes([time_ns]))
    assert [payload[0] for _, payload in buffer.between(20, 21).messages()] == [20, 5, 21]
