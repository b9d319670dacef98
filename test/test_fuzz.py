"""Hostile input to everything that reads: it ends in data or in one `UserError` of one line, in bounded memory.

The cases are the same in every run (see conftest); `HYPOTHESIS_PROFILE=search` draws others.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import can
import canopen
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from simulated_bus import SCALE
from small_arm import URDF
from test_reader import JOINTS, START, bag_bytes, signals, states

from spacearm_ident import documents
from spacearm_ident.canbus import frames, master
from spacearm_ident.canbus.arm_bus import ArmBus, Axis
from spacearm_ident.canbus.cycle import Cycle
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.config import config_path
from spacearm_ident.documents import parse_yaml, read_text
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import LONGEST, UserError
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.recording import cdr, messages, read_recording
from spacearm_ident.report.markup import element
from spacearm_ident.simulation.concealed import load_concealed
from spacearm_ident.simulation.drives import DriveConfig, SimulatedDrive

FUZZ = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
SAME = os.environ.get("HYPOTHESIS_PROFILE", "same") == "same"
EXAMPLES = settings(FUZZ, max_examples=60 if SAME else 1500)
FEW = settings(FUZZ, max_examples=15 if SAME else 300)
"""For what reads a data sheet every time."""


def ends_well(read: Callable[[], object]) -> object | None:
    """What is read, or None where it is refused as it should be; anything else that is raised fails the test."""
    try:
        return read()
    except UserError as error:
        text = str(error)
        assert text and text.isprintable() and len(text) <= LONGEST + 10, text
        return None


def in_child(code: str, gigabytes: float = 1.5, seconds: float = 120.0) -> str:
    """Run code in a process that may hold only so much memory; its last line on stdout."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({int(gigabytes * 2**30)},) * 2)\n"
    run = subprocess.run(
        [sys.executable, "-c", limit + textwrap.dedent(code)], capture_output=True, text=True, timeout=seconds
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return run.stdout.strip().splitlines()[-1]


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
    path = tmp_path / "bag.mcap"
    path.write_bytes(damaged(BAGS[which], damage))
    recording = ends_well(lambda: read_recording(path))
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
    path = tmp_path / "bag.mcap"
    path.write_bytes(bag_bytes([*states(10), *rows]))
    recording = ends_well(lambda: read_recording(path))
    if recording is not None:
        assert (np.diff(recording.time) > 0).all() and np.isfinite(recording.position).all()


def test_log_times_at_both_ends_of_their_range_keep_time_increasing(tmp_path):
    logs = [1, 2, 2**62 - 1, 2**63 - 1, 2**63, 2**64 - 1]
    payloads = cdr.encode_joint_states([0] * len(logs), JOINTS, *signals(len(logs)))
    (tmp_path / "bag.mcap").write_bytes(bag_bytes(list(zip(logs, payloads, strict=True))))
    recording = read_recording(tmp_path / "bag.mcap")
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
    (tmp_path / "bag.mcap").write_bytes(bag_bytes(states(10), others=others))
    assert len(read_recording(tmp_path / "bag.mcap").temperatures) == 20_000


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


# --- YAML ---------------------------------------------------------------------------------------------------

BOMB = "\n".join(
    ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
)
MERGES = "\n".join(
    ["m0: &m0 {x: 1}"] + [f"m{k}: &m{k} {{<<: [{', '.join([f'*m{k - 1}'] * 8)}]}}" for k in range(1, 12)]
)
HOSTILE = {
    "alias bomb": BOMB,
    "merge bomb": MERGES,
    "itself": "a: &a [*a]",
    "deep": "[" * 200_000,
    "deep maps": "{a: " * 100_000,
    "deep block": "- " * 100_000,
    "code": "!!python/object/apply:os.system ['touch pwned']",
    "name": "!!python/name:os.system",
    "base 60": "x: " + ":".join(["59"] * 400_000),
    "digits": "x: " + "9" * 6000,
    "month 13": "x: 2001-13-45",
    "before time": "x: 0001-01-01T00:00:00+23:59",
    "empty int": "x: !!int ''",
    "empty float": "x: !!float ''",
    "no bool": "x: !!bool perhaps",
    "no time": "x: !!timestamp soon",
    "no binary": "x: !!binary \N{SNOWMAN}",
    "list as key": "? [a]\n: b",
    "two documents": "a: 1\n---\nb: 2",
    "control": "a: \x07",
    "values": "[" + "0," * 250_000 + "0]",
}
READERS: dict[str, Callable[[Path], object]] = {
    "arm": load_arm,
    "model": load_model,
    "trajectory": load_trajectory,
    "conceal": lambda path: load_concealed(path, JOINTS),
    "can": load_arm_can,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_yaml_is_refused_without_being_expanded(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.yaml").write_text(HOSTILE[name], encoding="utf-8")
    for read in [*READERS.values()][: None if name in ("alias bomb", "deep", "code") else 1]:
        with pytest.raises(UserError) as error:
            read(tmp_path / "in.yaml")
        assert str(error.value).isprintable() and len(str(error.value)) < 2 * LONGEST
    assert not (tmp_path / "pwned").exists()


def test_yaml_means_what_it_meant_before():
    text = config_path("paper_arm_can.yaml").read_text(encoding="utf-8")
    assert parse_yaml(text, "x") == yaml.safe_load(text)
    shared = "base: &b {x: 1, y: [2, 3]}\none: {<<: *b, z: 4}\ntwo: *b\nwhen: 2001-01-01\nno: null"
    assert parse_yaml(shared, "x") == yaml.safe_load(shared)


@EXAMPLES
@given(st.text(max_size=60) | st.text(alphabet="[]{}:,-&*!|>'\"#%@? \n\tab1.", max_size=80))
def test_any_text_is_yaml_or_refused(text):
    ends_well(lambda: parse_yaml(text, "in.yaml"))


ODD = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from([*JOINTS, "shoulder", "elbow", "payload", "../../../etc/passwd", "/dev/zero", "\x1b[2J"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6) | st.integers(), inner, max_size=3),
    max_leaves=8,
)


def places(value: object, path: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    """Every place in a document, by keys."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, item in items for place in places(item, (*path, key)))]


def with_value(document: object, place: tuple[object, ...], value: object) -> object:
    if not place:
        return value
    copy = dict(document) if isinstance(document, dict) else list(document)
    copy[place[0]] = with_value(document[place[0]], place[1:], value)
    return copy


def sample(name: str, folder: Path) -> object:
    """A sound document of each kind; the URDF beside it."""
    (folder / "arm.urdf").write_text(URDF)
    match name:
        case "arm":
            joints = {"elbow": {"gear_ratio": 100, "torque_limit_Nm": 5, "position_upper_rad": 1}}
            couplings = [{"name": "w", "ratios": {"shoulder": 1, "elbow": -1}}]
            return {
                "schema": "spacearm_ident/arm/1",
                "name": "x",
                "urdf": "arm.urdf",
                "gravity_m_s2": [0, 0, -9.8],
                "joints": joints,
                "couplings": couplings,
            }
        case "model":
            arm = arm_from_urdf(URDF)
            model = TorqueModel(arm, {**structure_of(arm), "payload": {}, "torque_ripple": {"joints": ["elbow"]}})
            values = np.ones(len(model.parameters)), np.ones(len(model.constants))
            save_model(IdentifiedModel(model, *values), folder / "model.yaml")
            return yaml.safe_load((folder / "model.yaml").read_text())
        case "trajectory":
            rest = {"kind": "rest", "duration_s": 1.0, "position": [0.0, 0.0]}
            fourier = {"kind": "fourier", "fundamental_hz": 0.1, "periods": 2, "q0": [0, 0]}
            fourier |= {"a": [[0.1], [0.2]], "b": [[0], [0]]}
            chirp = {"kind": "chirp", "duration_s": 2, "centre": [0, 0], "amplitude": [0.1, 0]}
            chirp |= {"start_hz": 0.5, "end_hz": 5}
            join = {"kind": "quintic", "duration_s": 1}
            cruise = {"kind": "cruise", "duration_s": 1, "position": [0, 0], "velocity": [0.1, 0]}
            segments = [rest, join, fourier, join, chirp, join, cruise, join, rest]
            return {"schema": "spacearm_ident/trajectory/1", "joints": ["shoulder", "elbow"], "segments": segments}
        case "conceal":
            effects = [
                {"effect": "torque_ripple", "joints": ["elbow"], "parameters": {"amplitude": 1.0, "cycles": 24}},
                {"effect": "stribeck", "joints": ["wrist"], "parameters": {"amplitude": [1.5]}},
            ]
            return {"schema": "spacearm_ident/conceal/1", "effects": effects}
    (folder / "arm.yaml").write_text("schema: spacearm_ident/arm/1\nurdf: arm.urdf\n")
    drive = {"bus": 0, "node": 1, "counts_per_turn": 65536, "rated_current_A": 5.0, "velocity_limit_rad_s": 1.0}
    return {
        "schema": "spacearm_ident/can/1",
        "arm": "arm.yaml",
        "bitrate": 1000000,
        "buses": [{"interface": "local", "channel": "a"}],
        "cycle": {"period_s": 0.002, "heartbeat_s": 0.05},
        "joints": {"shoulder": drive, "elbow": {**drive, "node": 2, "acceleration_limit_rad_s2": 2.0}},
    }


@pytest.mark.parametrize("name", READERS)
def test_the_sound_documents_are_read(name, tmp_path):
    (tmp_path / "in.yaml").write_text(yaml.safe_dump(sample(name, tmp_path)))
    assert READERS[name](tmp_path / "in.yaml") is not None


@pytest.mark.parametrize("name", READERS)
def test_a_document_with_anything_anywhere_is_read_or_refused(name, tmp_path):
    document = sample(name, tmp_path)
    everywhere = places(document)

    @EXAMPLES
    @given(st.data())
    def attack(data):
        place = data.draw(st.sampled_from(everywhere))
        bad = with_value(document, place, data.draw(ODD))
        (tmp_path / "in.yaml").write_text(yaml.safe_dump(bad), encoding="utf-8")
        ends_well(lambda: READERS[name](tmp_path / "in.yaml"))

    attack()


# --- paths --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["/dev/zero", "pipe", "large", "."])
def test_what_is_no_ordinary_file_is_neither_waited_for_nor_filled_into_memory(target, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(documents.MAX_BYTES + 1)
    path = tmp_path / target
    with pytest.raises(UserError, match="cannot read"):
        read_text(path, "the arm")
    for name in ("arm", "model"):
        document = sample(name, tmp_path)
        document.pop("urdf")
        document["urdf" if name == "arm" else "urdf_file"] = str(path)
        (tmp_path / "in.yaml").write_text(yaml.safe_dump(document))
        with pytest.raises(UserError, match=r"cannot read the URDF that .*in\.yaml names"):
            READERS[name](tmp_path / "in.yaml")
    if target != "large":
        with pytest.raises(UserError):
            read_recording(path)


def test_a_file_that_is_no_urdf_is_not_repeated_in_the_error(tmp_path):
    (tmp_path / "secret.txt").write_text("password: hunter2\n<robot hunter2")
    (tmp_path / "in.yaml").write_text("schema: spacearm_ident/arm/1\nurdf: secret.txt\n")
    with pytest.raises(UserError) as error:
        load_arm(tmp_path / "in.yaml")
    assert "hunter2" not in str(error.value)


# --- URDF ---------------------------------------------------------------------------------------------------

LAUGHS = "".join(f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 10))
CHAIN = "".join(
    f"<link name='l{k}'/><joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/></joint>"
    for k in range(20_000)
)
URDFS = {
    "laughs": f"<!DOCTYPE r [<!ENTITY a0 'ha'>{LAUGHS}]><robot name='&a9;'/>",
    "file": "<!DOCTYPE r [<!ENTITY f SYSTEM 'file:///etc/passwd'>]><robot name='x'>&f;</robot>",
    "chain": f"<robot name='x'>{CHAIN}<link name='l20000'/></robot>",
    "deep": "<robot name='x'>" + "<a>" * 100_000,
    "many": "<robot name='x'>" + "<link name='l'/>" * 150_000 + "</robot>",
    "not finite": URDF.replace('value="4"', 'value="nan"'),
    "far": URDF.replace("0 0.05 0.4", "0 1e999 0.4"),
    "two parents": URDF.replace("</robot>", "<joint name='k' type='fixed'><parent link='base'/>")
    + "<child link='fore'/></joint></robot>",
    "loop": URDF.replace('<parent link="base"/>', '<parent link="fore"/>'),
    "own child": URDF.replace('<parent link="upper"/>', '<parent link="fore"/>'),
    "no link": URDF.replace('<child link="fore"/>', '<child link="gone"/>'),
    "latin": '<?xml version="1.0" encoding="ISO-8859-1"?><robot name="x"><link name="\xe9"/></robot>',
}


@pytest.mark.parametrize("name", URDFS)
def test_a_hostile_urdf_is_refused_and_crashes_no_parser(name, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDFS[name], encoding="utf-8")
    code = f"""
        from pathlib import Path
        from spacearm_ident.dynamics.arm import load_arm
        from spacearm_ident.errors import UserError
        try:
            load_arm(Path({str(tmp_path / "arm.urdf")!r}))
        except UserError as error:
            print("refused:", error)
    """
    assert in_child(code).startswith("refused: ")


def test_any_change_of_a_urdf_is_read_or_refused():
    """In one child, for the parsers are C++: what kills it fails the test."""
    code = f"""
        import sys
        sys.path[:0] = {[*sys.path]!r}
        import test_fuzz
        test_fuzz.attack_urdf()
        print("survived")
    """
    assert in_child(code, gigabytes=3.0, seconds=600) == "survived"


WORDS = st.sampled_from(
    ["", "nan", "inf", "-1", "1e400", "0 0", "0 0 0 0", "a b c", "fixed", "floating", "planar", "base", "fore", "é&#0;"]
)


@EXAMPLES
@given(st.data())
def attack_urdf(data):
    text = URDF
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text) - 1))
        match data.draw(st.sampled_from(["word", "cut", "repeat", "text"])):
            case "word":
                quoted = [k for k, character in enumerate(text) if character == '"']
                if len(quoted) >= 2:
                    first = 2 * data.draw(st.integers(0, len(quoted) // 2 - 1))
                    text = text[: quoted[first] + 1] + data.draw(WORDS) + text[quoted[first + 1] :]
            case "cut":
                text = text[:start] + text[start + data.draw(st.integers(1, 60)) :] or "<"
            case "repeat":
                lines = text.splitlines()
                line = data.draw(st.integers(0, len(lines) - 1))
                text = "\n".join([*lines[: line + 1], *lines[line:]])
            case "text":
                text = text[:start] + data.draw(st.text(max_size=5)) + text[start:]
    ends_well(lambda: arm_from_urdf(text))


# --- the bus ------------------------------------------------------------------------------------------------

FRAMES = st.builds(
    lambda can_id, data, fd, remote, error: can.Message(
        arbitration_id=can_id,
        data=None if remote else data,
        is_extended_id=can_id > 0x7FF,
        is_fd=fd,
        is_remote_frame=remote and not fd,
        is_error_frame=error,
        dlc=len(data) if remote else None,
    ),
    st.sampled_from([0x000, 0x080, 0x081, 0x181, 0x182, 0x281, 0x301, 0x581, 0x601, 0x701, 0x77F, 0x7FF, 0x1FFFFFFF]),
    st.binary(max_size=8),
    st.just(False),
    st.booleans(),
    st.booleans(),
)


class Played:
    """A bus that delivers the given frames, oldest first, and keeps what is sent."""

    def __init__(self, messages):
        self.messages, self.sent = list(messages), []

    def recv(self, timeout=None):
        return self.messages.pop(0) if self.messages else None

    def send(self, message, timeout=None):
        self.sent.append(message)

    def shutdown(self):
        pass


@EXAMPLES
@given(received=st.lists(FRAMES, max_size=30), slim=st.booleans())
def test_no_frame_ends_the_cycle(received, slim):
    arm = ArmBus((Axis(1, SCALE), Axis(2, SCALE)), answer_time=0.0001)
    bus = Played(received)
    network = canopen.Network(bus)
    for axis in arm.axes:
        network.add_node(axis.node_id, DICTIONARY)
    cycle = Cycle(arm, [bus], [network])
    for _ in range(3):
        cycle.run()
    assert cycle.cycles == 3 and len(cycle.events) <= 40 and np.isfinite(cycle.feedback.position).all()


@EXAMPLES
@given(raw=st.binary(max_size=100) | st.binary(min_size=frames.CLASSIC.size, max_size=frames.CLASSIC.size))
def test_no_bytes_on_the_local_bus_raise_anything_but_what_its_reader_expects(raw):
    try:
        message, _ = frames.unpack(raw, "x")
    except struct.error:
        assert len(raw) not in (frames.CLASSIC.size, frames.FD.size)
    else:
        assert len(message.data) <= 64


EDS = str(eds_path())
DICTIONARY = canopen.import_od(EDS)


class Answering(Played):
    """A drive that answers every SDO request with the next of the given answers, for ever."""

    def __init__(self, network, answers):
        super().__init__([])
        self.network, self.answers, self.asked = network, answers, 0

    def send(self, message, timeout=None):
        if message.arbitration_id == 0x601:
            self.asked += 1
            assert self.asked < 3000, "the master asks for ever"
            self.network.notify(0x581, bytearray(self.answers[self.asked % len(self.answers)]), 0.0)


def configured(answers):
    """What the master makes of a drive with these answers, and how often it asked."""
    arm = ArmBus((Axis(1, SCALE),))
    idle = Played([])
    booted = master.DriveMaster(arm, [idle], EDS)
    network = booted._networks[0]
    bus = network.bus = Answering(network, answers)
    booted.nodes[0].sdo.RESPONSE_TIMEOUT = 0.001
    return ends_well(lambda: booted._configure(arm.axes[0], booted.nodes[0])), bus.asked


@FEW
@given(
    st.lists(
        st.builds(
            lambda command, index, sub, data: struct.pack("<BHB", command, index, sub) + data,
            st.integers(0, 255) | st.sampled_from([0x43, 0x4F, 0x60, 0x80, 0x41, 0x00, 0x10, 0x20, 0x30]),
            st.sampled_from([0x1000, 0x1400, 0x1800, 0x1A00, 0x6060]),
            st.integers(0, 4),
            st.binary(min_size=4, max_size=4),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_no_answers_of_a_drive_hang_or_crash_its_configuration(answers):
    configured(answers)


def test_a_drive_that_never_ends_an_object_is_cut_off():
    begin = struct.pack("<BHBI", 0x41, 0x1000, 0, 2**31)  # segmented, two gigabytes announced
    segments = [bytes([0x10 * (k % 2)]) + b"x" * 7 for k in range(2)]
    _, asked = configured([segments[1], begin, segments[0]])  # the first request gets the second
    assert asked < 10


class Endless(Answering):
    """Answers the first request with a segmented transfer, and every segment with another."""

    def send(self, message, timeout=None):
        if message.arbitration_id != 0x601:
            return
        self.asked += 1
        assert self.asked < 1000, "the master asks for ever"
        command = message.data[0]
        if command == 0x80:
            return
        answer = struct.pack("<BHBI", 0x41, 0x1000, 0, 2**31) if command == 0x40 else bytes([command & 0x10]) + b"x" * 7
        self.network.notify(0x581, bytearray(answer), 0.0)


def test_a_drive_that_sends_segments_for_ever_is_refused():
    arm = ArmBus((Axis(1, SCALE),))
    booted = master.DriveMaster(arm, [Played([])], EDS)
    bus = booted._networks[0].bus = Endless(booted._networks[0], [])
    with pytest.raises(UserError, match=r"node 1 cannot be configured: 0x1000 is longer than 8 bytes"):
        booted._configure(arm.axes[0], booted.nodes[0])
    assert bus.asked < 10


@FEW
@given(st.lists(st.binary(min_size=8, max_size=8) | st.binary(max_size=9), max_size=12), st.lists(FRAMES, max_size=10))
def test_no_request_crashes_a_simulated_drive(requests, others):
    drive = SimulatedDrive(DriveConfig(1, SCALE), lambda can_id, data: None)
    drive.reset()
    for message in [*others, *(can.Message(arbitration_id=0x601, data=data[:8]) for data in requests)]:
        for can_id, route in drive.routes().items():
            if can_id == message.arbitration_id and not message.is_remote_frame:
                route(message)
    drive.on_sync()
    drive.after_sync()
    drive.advance(0.001, 0.001)


# --- what is printed ----------------------------------------------------------------------------------------


class Tags(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)


PLAIN = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0\r"), max_size=40)


@EXAMPLES
@given(text=PLAIN, attribute=PLAIN)
def test_no_text_becomes_markup(text, attribute):
    page = Tags(element("p", text, element("b", text), title=attribute))
    assert page.tags == [("p", {"title": attribute}), ("b", {})]
    assert "".join(page.words) == text + text


def test_an_error_is_one_printable_line_of_bounded_length():
    text = str(UserError("joint '\x1b[2J\n\t' " + "x" * 100_000 + " mend it"))
    assert text.isprintable() and len(text) <= LONGEST + 10
    assert text.startswith("joint '") and text.endswith("mend it")
