"""Reading recordings: what is read, defects of the signals, real arms against an independent reader."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_bags import JOINTS, START, WHOLE, bag_bytes, issues, numbers, read_bytes, signals, state, states
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap_ros2.decoder import DecoderFactory

from spacearm_ident.conventions.finding import Level
from spacearm_ident.conventions.plain import read_off
from spacearm_ident.errors import UserError
from spacearm_ident.recording import Recording, cdr, describe, messages, read_recording, write_recording
from spacearm_ident.recording.bag import messages as bag_messages
from spacearm_ident.recording.contents import Bag
from spacearm_ident.recording.intake import increasing

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


@pytest.fixture
def bag(tmp_path):
    """Writes rows as a bag and reads it."""

    def write_and_read(rows, joints=None, **options) -> Recording:
        return read_bytes(tmp_path, bag_bytes(rows, **options), joints=joints)

    return write_and_read


def sample(row: int, stamp: int | None = None, **changed: object) -> bytes:
    """The message of one sample of `states`, with another stamp or other values."""
    position, velocity, effort = (array[row] for array in signals(row + 1))
    values = {"position": position, "velocity": velocity, "effort": effort} | changed
    return state(START + row * 10**6 if stamp is None else stamp, JOINTS, **values)


# --- what is read -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
@pytest.mark.parametrize("chunked", [True, False])
def test_any_compression_with_or_without_index(bag, compression, index, chunked):
    recording = bag(states(), compression=compression, index_types=index, use_chunking=chunked, use_statistics=chunked)
    assert numbers(recording) == list(range(100)) and recording.issues == ()
    assert recording.joints == JOINTS and recording.start_ns == START
    assert np.array_equal(recording.velocity, -recording.position)
    assert recording.segments == (slice(0, 100),)
    assert recording.rate_hz == pytest.approx(1000, rel=1e-9)


def test_time_keeps_the_nanoseconds(bag):
    stamps = START + np.cumsum(np.array([0, 333_333, 200_001, 4_000_007]))
    rows = list(zip(stamps.tolist(), cdr.encode_joint_states(stamps, JOINTS, *signals(4)), strict=True))
    recording = bag(rows)
    assert np.array_equal(np.rint(recording.time * 1e9).astype(int), stamps - START)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.permutations(range(3)), min_size=2, max_size=40))
def test_joint_order_is_by_name_in_every_message(tmp_path_factory, orders):
    rows = []
    position, velocity, effort = signals(len(orders))
    for row, order in enumerate(orders):
        values = [array[row, list(order)] for array in (position, velocity, effort)]
        stamp = START + row * 10**6
        rows.append((stamp, state(stamp, [JOINTS[i] for i in order], *values)))
    path = tmp_path_factory.mktemp("bag") / "bag.mcap"
    path.write_bytes(bag_bytes(rows))
    recording = read_recording(path)
    assert recording.joints == tuple(JOINTS[i] for i in orders[0]) and recording.issues == ()
    assert numbers(recording) == list(range(len(orders)))
    chosen = read_recording(path, joints=("wrist", "shoulder"))
    assert chosen.joints == ("wrist", "shoulder")
    assert np.array_equal(chosen.position, position[:, [2, 0]])


def test_all_topics_and_temperatures_by_joint(bag):
    stamps = START + 4 * 10**6 * np.arange(25)
    targets = np.arange(75.0).reshape(25, 3)
    commands = cdr.encode_joint_states(stamps, JOINTS[::-1], targets[:, ::-1])
    others = [(int(stamp), messages.COMMAND_TOPIC, row) for stamp, row in zip(stamps, commands, strict=True)]
    others.append((START, messages.DESCRIPTION_TOPIC, cdr.encode_string("<robot/>")))
    for row, value in enumerate((20.0, 21.5, np.nan)):
        stamp = START + row * 10**7
        payload = cdr.encode_temperature(stamp, "elbow", value)
        others.append((stamp, messages.TEMPERATURES_TOPIC, payload))
    others.append((START, "/camera", b"\x00\x01\x00\x00whatever"))
    recording = bag(states(), others=others)
    assert numbers(recording) == list(range(100))
    assert np.array_equal(recording.command.values, targets)
    assert np.allclose(recording.command.time, 0.004 * np.arange(25), atol=1e-12)
    assert recording.urdf == "<robot/>"
    assert recording.temperatures["elbow"].values.tolist() == [20.0, 21.5]
    assert recording.temperatures["elbow"].time.tolist() == [0.0, 0.01]
    assert issues(recording) == {"temperature": 1}
    assert any("set-points" in line for line in describe(recording))


def test_two_publishers_on_one_topic_the_arm_is_taken(bag):
    rows = []
    for stamp, payload in states(50):
        rows.append((stamp, payload))
        rows.append((stamp + 500_000, state(stamp + 500_000, ["finger"], [0.1], [0.0], [2.0])))
    recording = bag(rows)
    assert recording.joints == JOINTS and numbers(recording) == list(range(50))
    assert issues(recording) == {"missing_joint": 50}
    assert bag(rows, joints=["finger"]).joints == ("finger",)


@pytest.mark.parametrize(
    ("values", "kept", "range_"),
    [
        ([293.2, 294.0, 300.1], [], "from 293.2 to 300.1"),
        ([20.0, -273.15, 21.0], [20.0, 21.0], "from -273.15 to -273.15"),
        ([-100.0, 200.0, 85.0], [-100.0, 200.0, 85.0], None),
    ],
)
def test_temperatures_that_no_joint_has_are_left_out_with_the_unit(bag, values, kept, range_):
    rows = [
        (START + k * 10**7, messages.TEMPERATURES_TOPIC, cdr.encode_temperature(START + k * 10**7, "elbow", value))
        for k, value in enumerate(values)
    ]
    recording = bag(states(), others=rows)
    assert (recording.temperatures["elbow"].values.tolist() if kept else recording.temperatures) == (kept or {})
    said = [issue.message for issue in recording.issues if issue.kind == "temperature_unit"]
    assert len(said) == len(recording.issues) == (range_ is not None)
    assert all(range_ in text and "the unit is °C" in text and "kelvin" in text for text in said)


# --- defects of the signals ---------------------------------------------------------------------------------


def test_repeated_and_backward_stamps_are_dropped_not_sorted(bag):
    rows = states(100)
    log_times = [stamp for stamp, _ in rows]
    payloads = [payload for _, payload in rows]
    payloads[20] = sample(20, log_times[19])
    for late in (60, 61):
        payloads[late] = sample(late, log_times[late] - 10**8)
    recording = bag(list(zip(log_times, payloads, strict=True)))
    assert numbers(recording) == [row for row in range(100) if row not in (20, 60, 61)]
    assert issues(recording) == {"repeated_stamp": 1, "backward_stamp": 2}
    where = {issue.kind: issue.where_s for issue in recording.issues}
    assert where["repeated_stamp"] == pytest.approx(0.019)


def test_a_clock_set_back_is_a_border_between_segments(bag):
    rows = states(100)
    stamps = START + 10**6 * np.arange(100)
    stamps[60:] -= 20 * 10**6
    payloads = cdr.encode_joint_states(stamps, JOINTS, *signals(100))
    recording = bag([(log, payload) for (log, _), payload in zip(rows, payloads, strict=True)])
    assert issues(recording) == {"backward_stamp": 20} and len(recording.time) == 80
    [border] = [part.start for part in recording.segments if part.start]
    assert recording.position[border, 0] - recording.position[border - 1, 0] == 21
    assert np.allclose(np.diff(recording.time), 1e-3)  # the stamps alone do not tell


def test_one_stamp_far_ahead_costs_one_sample(bag):
    rows = states(100)
    rows[40] = (rows[40][0], sample(40, START + 10**12))
    recording = bag(rows)
    assert numbers(recording) == [row for row in range(100) if row != 40]
    assert issues(recording) == {"backward_stamp": 1}


@given(st.lists(st.integers(0, 12), max_size=40))
def test_increasing_keeps_a_longest_strictly_increasing_subsequence(values):
    stamps = np.array(values, dtype=np.int64)
    keep = increasing(stamps)
    assert (np.diff(stamps[keep]) > 0).all()
    best = [0] * len(values)
    for row, value in enumerate(values):
        best[row] = 1 + max((best[k] for k in range(row) if values[k] < value), default=0)
    assert keep.sum() == max(best, default=0)


@pytest.mark.parametrize("stamp", [0, START])
def test_log_time_when_the_stamps_carry_no_time(bag, stamp):
    recording = bag([(START + row * 2_000_000, sample(row, stamp)) for row in range(50)])
    assert issues(recording) == {"log_time_used": 50}
    assert numbers(recording) == list(range(50)) and recording.start_ns == START
    assert np.allclose(recording.time, 0.002 * np.arange(50), atol=1e-12)


@pytest.mark.parametrize("stamped", [True, False])
def test_times_of_recording_that_repeat_count_only_where_the_stamps_carry_no_time(bag, stamped):
    """A recorder under simulated time stamps by the last tick of /clock: two states share each time here."""
    recording = bag([(START + (k - k % 2) * 10**6, sample(k, None if stamped else 0)) for k in range(100)])
    if stamped:
        assert issues(recording) == {} and numbers(recording) == list(range(100))
        return
    assert issues(recording) == {"log_time_used": 100, "repeated_stamp": 50}
    assert numbers(recording) == list(range(0, 100, 2))
    (text,) = (issue.message for issue in recording.issues if issue.kind == "repeated_stamp")
    assert "time of recording" in text and "use_sim_time" in text
    said, found = read_off(recording).findings
    assert said.kind == "no_stamps"
    assert (found.kind, found.level) == ("clock_order", Level.UNFIT)
    assert "header stamps" in found.remedy and "use_sim_time" in found.remedy


def test_a_few_unset_stamps_are_not_1970(bag):
    rows = states(100)
    rows[0] = (rows[0][0], sample(0, 0))
    recording = bag(rows)
    assert issues(recording) == {"zero_stamp": 1} and numbers(recording) == list(range(1, 100))
    assert recording.start_ns == START + 10**6


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("signal", ["position", "effort"])
def test_samples_with_nan_in_position_or_effort_are_dropped(bag, value, signal):
    rows = states(100)
    rows[70] = (rows[70][0], sample(70, **{signal: [1.0, value, 1.0]}))
    recording = bag(rows)
    assert numbers(recording) == [row for row in range(100) if row != 70]
    [issue] = recording.issues
    assert (issue.kind, issue.count, issue.where_s) == ("nan", 1, pytest.approx(0.070))
    assert "elbow" in issue.message


@pytest.mark.parametrize(("lacking", "kept"), [(2, True), (30, False)])
def test_velocity_is_given_for_all_samples_or_not_at_all(bag, lacking, kept):
    rows = states(400)
    for row in range(100, 100 + lacking):
        rows[row] = (rows[row][0], sample(row, velocity=None if row % 2 else [np.nan, 1, 1]))
    recording = bag(rows)
    if kept:
        assert issues(recording) == {"nan": lacking} and len(recording.time) == 400 - lacking
        assert np.array_equal(recording.velocity, -recording.position)
    else:
        assert issues(recording) == {"velocity_unusable": lacking} and recording.velocity is None
        assert numbers(recording) == list(range(400))


def test_no_velocity_anywhere_is_no_defect(bag):
    recording = bag([(START + row * 10**6, sample(row, velocity=None)) for row in range(20)])
    assert recording.velocity is None and recording.issues == ()


def test_messages_lacking_a_joint_are_dropped(bag):
    rows = states(100)
    position, velocity, effort = signals(100)
    for row in (10, 11, 55):
        values = (array[row, :2] for array in (position, velocity, effort))
        rows[row] = (rows[row][0], state(rows[row][0], JOINTS[:2], *values))
    recording = bag(rows)
    assert numbers(recording) == [row for row in range(100) if row not in (10, 11, 55)]
    [issue] = recording.issues
    assert (issue.kind, issue.count, issue.where_s) == ("missing_joint", 3, pytest.approx(0.010))


def test_undecodable_messages_are_dropped(bag):
    rows = states(100)
    rows[33] = (rows[33][0], rows[33][1][:50])
    rows[34] = (rows[34][0], b"")
    recording = bag(rows)
    assert numbers(recording) == [row for row in range(100) if row not in (33, 34)]
    [issue] = recording.issues
    assert (issue.kind, issue.count) == ("undecodable_message", 2)
    assert issue.where_s == pytest.approx(0.032)  # the last place known


def test_gaps_split_into_segments_and_are_stated(bag):
    rows = states(300)
    recording = bag(rows[:100] + rows[106:200] + rows[250:])
    assert recording.segments == (slice(0, 100), slice(100, 194), slice(194, 244))
    [issue] = recording.issues
    assert (issue.kind, issue.count, issue.where_s) == ("gap", 2, pytest.approx(0.099))
    assert "5 ms" in issue.message


def test_uneven_sampling_is_no_gap(bag):
    random = np.random.default_rng(0)
    steps = np.where(random.random(500) < 0.3, 9_000_000, 1_000_000)
    stamps = START + np.cumsum(steps)
    rows = list(zip(stamps.tolist(), cdr.encode_joint_states(stamps, JOINTS, *signals(500)), strict=True))
    recording = bag(rows)
    assert recording.segments == (slice(0, 500),) and recording.issues == ()


def test_empty_effort_is_a_user_error(bag):
    with pytest.raises(UserError, match="no effort for shoulder, elbow, wrist"):
        bag([(START + row, sample(row, START + row, effort=None)) for row in range(20)])


def test_a_joint_that_never_has_an_effort_is_left_out_unless_chosen(bag):
    position, _, effort = signals(20)
    effort[:, 1] = np.nan
    rows = [(START + row * 10**6, sample(row, effort=effort[row])) for row in range(20)]
    recording = bag(rows)
    assert recording.joints == ("shoulder", "wrist") and len(recording.time) == 20
    assert issues(recording) == {"joint_without_effort": 1}
    assert recording.effortless == {"elbow": (position[:, 1].min(), position[:, 1].max())}
    with pytest.raises(UserError, match="no effort for elbow"):
        bag(rows, joints=JOINTS)


# --- against an independent reader, on real recordings ------------------------------------------------------

REAL = sorted(RECORDINGS.rglob("*.mcap")) or [
    pytest.param(None, marks=pytest.mark.skip(reason=f"no recordings in {RECORDINGS}"))
]


@pytest.mark.parametrize("path", REAL, ids=lambda path: path and str(path.relative_to(RECORDINGS)))
def test_real_recordings_are_read_whole(path):
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    [channel] = [c.id for c in summary.channels.values() if c.topic == messages.STATES_TOPIC]
    recording = read_recording(path)
    assert len(recording.time) == summary.statistics.channel_message_counts[channel]
    # The Panda's recorder left gaps of 9 ms; nothing else is wrong with any of them.
    assert {issue.kind for issue in recording.issues} <= ({"gap"} if "panda" in str(path) else set())
    assert recording.urdf.lstrip().startswith("<")
    assert len(recording.joints) in (6, 7) and np.isfinite(recording.effort).all()
    assert sum(part.stop - part.start for part in recording.segments) == len(recording.time)


def test_real_recording_agrees_with_mcap_ros2():
    path = RECORDINGS / "real" / "ur10e" / "commissioning_2.mcap"
    if not path.exists():
        pytest.skip(f"no recordings in {RECORDINGS}")
    recording = read_recording(path)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        rows = [row for *_, row in reader.iter_decoded_messages(topics=[messages.STATES_TOPIC])]
    stamps = np.array([row.header.stamp.sec * 10**9 + row.header.stamp.nanosec for row in rows])
    assert list(recording.joints) == list(rows[0].name)
    assert np.array_equal(recording.time, (stamps - stamps[0]) / 1e9)
    for name in ("position", "velocity", "effort"):
        assert np.array_equal(getattr(recording, name), [getattr(row, name) for row in rows])


def test_progress_rises_to_one_and_sources_are_hashed(tmp_path):
    import hashlib

    path = tmp_path / "bag.mcap"
    path.write_bytes(bag_bytes(states(10_000)))
    seen: list[float] = []
    recording = read_recording(path, progress=seen.append)
    assert seen == sorted(seen) and len(seen) > 2 and seen[-1] == 1.0
    [source] = recording.sources
    assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (source.path, source.bytes) == (str(path), path.stat().st_size)


def test_raw_messages_agree_with_the_mcap_library(tmp_path):
    path = tmp_path / "bag.mcap"
    path.write_bytes(WHOLE)
    bag = Bag()
    ours = [(m.channel.topic, m.log_time_ns, m.payload) for m in bag_messages(path, bag=bag)]
    theirs = [
        (channel.topic, message.log_time, message.data)
        for _, channel, message in make_reader(BytesIO(WHOLE)).iter_messages(log_time_order=False)
    ]
    assert ours == theirs
    assert bag.topics == {
        messages.STATES_TOPIC: messages.JOINT_STATE.name,
        messages.DESCRIPTION_TOPIC: messages.STRING.name,
    }


def test_what_was_read_can_be_written_and_read_again(tmp_path, bag):
    first = bag(states(50)[:20] + states(50)[40:])
    write_recording(tmp_path / "again.mcap", first)
    again = read_recording(tmp_path / "again.mcap")
    assert np.array_equal(again.time, first.time) and again.segments == first.segments
    assert replace(again.issues[0], message="") == replace(first.issues[0], message="")
