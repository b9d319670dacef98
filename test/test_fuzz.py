"""Hostile input to everything that reads: it ends in data or in one `UserError` of one line, in bounded memory.

The cases are the same in every run (see conftest); `HYPOTHESIS_PROFILE=search` draws others.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzzing import EXAMPLES, ends_well, in_child
from hypothesis import given
from hypothesis import strategies as st
from made_bags import JOINTS
from small_arm import URDF

from spacearm_ident import documents
from spacearm_ident.config import config_path
from spacearm_ident.documents import parse_yaml, read_text
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import LONGEST, UserError
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.recording import read_recording
from spacearm_ident.simulation.concealed import load_concealed

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
