"""The result folder: every file says the same numbers, the URDF is the same arm, the page stands alone."""

from __future__ import annotations

import csv
import json
import math
import shutil
import xml.etree.ElementTree as ET
from dataclasses import fields, is_dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.dynamics.arm import Arm, Coupling, arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.identification.identified import (
    Choice,
    Determination,
    Estimate,
    Fit,
    Identified,
    JointValidation,
    LackOfFit,
    Trace,
    Validation,
)
from spacearm_ident.recording.bandwidth import Bandwidth
from spacearm_ident.recording.motion import Motion
from spacearm_ident.recording.recording import Recording, Source
from spacearm_ident.report import folder
from spacearm_ident.report.figures import joint_signals
from spacearm_ident.report.folder import rewrite_report, write_result
from spacearm_ident.report.friction_curve import friction_curve
from spacearm_ident.report.html import report_html
from spacearm_ident.report.markup import element, measured, number
from spacearm_ident.report.plotting import decimated
from spacearm_ident.report.provenance import provenance
from spacearm_ident.report.store import Result, load_result, save_result
from spacearm_ident.report.tables import PAPER_SYMBOLS
from spacearm_ident.report.urdf import identified_urdf
from spacearm_ident.report.verdict import judge_result

FILES = {
    *("model.yaml", "parameters.csv", "base_parameters.csv", "identified.urdf"),
    *("validation.json", "covariance.json", "report.html", "result.json", "result.npz"),
}
STRUCTURE = {
    "rigid_body": {},
    "rotor_inertia": {},
    "joint_spring": {},
    "stribeck_friction": {},
    "viscous_friction": {"quadratic": "even"},
}

INERTIAL = """<inertial><origin xyz="{0} 0.02 0.1" rpy="0.1 0.2 0.3"/><mass value="{1}"/>
    <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.015"/></inertial>"""
# A stand fixed to the base, a turning and a sliding joint, and two links merged into the last by fixed joints.
URDF = f"""<?xml version="1.0" encoding="utf-8"?>
<!-- a small arm -->
<robot name="small">
  <link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 0.3" rpy="0 0 0.4"/></joint>
  <link name="base">{INERTIAL.format(0.0, 9.0)}</link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0.1 0.2" rpy="1.2 0 0.3"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2.5" effort="80" velocity="1.5"/>
    <dynamics damping="99" friction="98"/>
  </joint>
  <link name="upper">{INERTIAL.format(0.05, 4.0)}
    <visual><geometry><mesh filename="package://small/upper.stl"/></geometry></visual>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0" rpy="0 0.5 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="0.3" effort="60" velocity="0.5"/>
  </joint>
  <link name="lower">{INERTIAL.format(0.1, 2.0)}
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/>
    <origin xyz="0.2 0 0" rpy="0 1 0"/></joint>
  <link name="tool">{INERTIAL.format(-0.03, 1.0)}</link>
  <joint name="mount" type="fixed"><parent link="tool"/><child link="camera"/>
    <origin xyz="0 0 0.05" rpy="0 0 0"/></joint>
  <link name="camera">{INERTIAL.format(0.0, 0.3)}<sensor:kind value="rgb"/></link>
</robot>
"""


def arm(*names: str) -> Arm:
    """The small arm, its two joints renamed."""
    text = URDF
    for old, new in zip(("turn", "slide"), names):
        text = text.replace(f'"{old}"', f'"{new}"')
    return arm_from_urdf(text)


def inertials(seed: int, count: int) -> np.ndarray:
    """Parameters of random bodies that can exist."""
    pin.seed(seed)
    return np.array([pin.Inertia.Random().toDynamicParameters() for _ in range(count)])


VALUES = {
    **{"J_m": 2.0, "k_1": 0.0, "f_c": 4.0, "f_b": 6.0, "k_v1": 8.0, "k_v2": -0.5, "k_v3": 0.25},
    **{"v_b": 0.02, "d_s": 1e-3, "mu": 0.06, "offset": -0.3},
}


def identified_model(of: Arm, structure: dict = STRUCTURE, seed: int = 1) -> IdentifiedModel:
    """Values that differ from symbol to symbol and from joint to joint."""
    model = TorqueModel(of, structure)
    bodies = inertials(seed, len(of.joints))
    values, body = [], dict(zip(of.joint_names, bodies))
    places = {name: k for k, name in enumerate(model_joints(model))}
    for number_, parameter in enumerate(model.parameters):
        if number_ < 10 * len(of.joints):
            values.append(body[parameter.joint][number_ % 10])
        else:
            values.append(VALUES[parameter.symbol] * (1 + 0.1 * places[parameter.joint]))
    constants = [VALUES[constant.symbol] for constant in model.constants]
    return IdentifiedModel(model, np.array(values), np.array(constants), 7.5, {})


def model_joints(model: TorqueModel) -> list[str]:
    return list(dict.fromkeys(parameter.joint for parameter in model.parameters))


def identification(model: IdentifiedModel, **changes: object) -> Identified:
    """An `Identified` with every determination in it."""
    kinds = list(Determination)
    estimates = []
    items = [*zip(model.model.parameters, model.parameters), *zip(model.model.constants, model.constants)]
    for k, (item, value) in enumerate(items):
        kind = kinds[k % len(kinds)]
        error = 0.01 * abs(value) + 1e-4 if kind is Determination.DATA else math.nan
        note = "" if kind is Determination.DATA else f"because of {kind.name.lower()}"
        estimates.append(Estimate(item.symbol, item.joint, item.unit, float(value), error, kind, note))
    base = base_parameters(model.model)
    values = base.regrouping @ model.parameters
    count = len(items)
    joints = len(model.model.arm.joints)
    result = Identified(
        model=model,
        estimates=tuple(estimates),
        base=base,
        base_values=values,
        base_errors=(0.01 * np.abs(values) + 1e-3) * (np.arange(len(values)) > 0),
        covariance=np.diag(np.arange(count) * 1e-6),
        consistency_shift=0.4,
        residual_sigma_Nm=np.linspace(0.1, 0.2, joints),
        rows=np.arange(joints) + 500,
        bandwidth=Bandwidth(7.5, 9.0, 1.5, np.full(joints, 1e-5), "five times the 1.5 Hz"),
        choices=(Choice("torque offset", 0.8, False), Choice("load friction", 120.0, True)),
        solver="separable: converged after 3 steps",
        notes=("recording 1: 5 periods of 20 s averaged",),
    )
    return replace(result, **changes)


def fit(relative: float = 0.05, rows: int = 400) -> Fit:
    return Fit(rows, 1.5, 1.1, 6.25, 0.9987, relative)


def trace(joints: int, rows: int = 400, source: str = "validation.mcap", seed: int = 3) -> Trace:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 20.0, rows)
    velocity = np.sin(time[:, None] * np.arange(1, joints + 1) * 0.7)
    torque = 10 * np.sign(velocity) + 5 * velocity
    moving = np.abs(velocity) > 0.1
    residual = 0.3 * rng.normal(size=torque.shape)
    return Trace(source, time, np.cos(velocity), velocity, torque, torque - residual, moving)


def validation(names: tuple[str, ...], **changes: object) -> Validation:
    joints = {
        name: JointValidation(fit(0.05 + 0.02 * k), fit(0.03 + 0.02 * k, 300), fit(0.08), LackOfFit(1.1, 0.3, 0.2))
        for k, name in enumerate(names)
    }
    result = Validation(joints, (trace(len(names)),), "validation.mcap, another recording", True)
    return replace(result, **changes)


def recording(path: str) -> Recording:
    empty = np.zeros((2, 2))
    return Recording(("turn", "slide"), np.arange(2.0), empty, None, empty, (), sources=(Source(path, 12, "ab" * 32),))


@pytest.fixture(scope="module")
def subject() -> tuple[Identified, Validation]:
    known = provenance([recording("a.mcap"), recording("b.mcap")], [recording("v.mcap")], "spacearm identify a.mcap")
    model = replace(identified_model(arm()), provenance=known)
    return identification(model), validation(model.model.arm.joint_names)


@pytest.fixture(scope="module")
def written(subject: tuple[Identified, Validation], tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("report") / "new" / "result"
    assert write_result(*subject, directory) == directory / "report.html"
    return directory


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of the folder, to which the page is one file among others."""
    monkeypatch.setattr(folder, "report_html", lambda result: result.validation.what)


def page_of(identified: Identified, figures: Validation) -> str:
    return report_html(Result(identified, figures, "2025-01-31T12:05:00+00:00"))


class Page(HTMLParser):
    """Elements, references and text of a page; fails on an element that is closed wrongly or not at all."""

    VOID = frozenset({"meta", "br", "wbr", "col", "link", "img", "input", "hr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                self.references.append(value or "")
            assert not name.startswith("on"), f"<{tag}> would run a script: {name}"

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


# --- the folder -----------------------------------------------------------------------------------------------


def test_folder_holds_every_file_of_the_contract_and_nothing_else(written: Path) -> None:
    assert {path.name for path in written.iterdir()} == FILES


def test_model_loads_back_to_the_same_numbers(written: Path, subject: tuple[Identified, Validation]) -> None:
    model, loaded = subject[0].model, load_model(written / "model.yaml")
    assert np.array_equal(loaded.parameters, model.parameters)
    assert np.array_equal(loaded.constants, model.constants)
    assert loaded.provenance == model.provenance


def test_parameter_table_says_what_the_model_says(written: Path, subject: tuple[Identified, Validation]) -> None:
    identified = subject[0]
    with (written / "parameters.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for joint in identified.model.model.arm.joint_names:
        mine = [row for row in rows if row["joint"] == joint]
        assert tuple(row["name"] for row in mine[:18]) == PAPER_SYMBOLS
        assert [row["name"] for row in mine[18:]] == ["d_s"]
    known = {(estimate.symbol, estimate.joint): estimate for estimate in identified.estimates}
    assert len(rows) == len(known)
    for row in rows:
        estimate = known[row["name"], row["joint"]]
        assert float(row["value"]) == identified.model.value(row["name"], row["joint"])
        assert row["unit"] == estimate.unit
        assert row["identifiable"] == ("yes" if estimate.determination is Determination.DATA else "no")
        assert (row["determined_by"], row["note"]) == (estimate.determination.value, estimate.note)
        if math.isnan(estimate.standard_error):
            assert row["standard_error"] == row["ci95_low"] == row["ci95_high"] == ""
        else:
            half = (float(row["ci95_high"]) - float(row["ci95_low"])) / 2
            assert half == pytest.approx(1.96 * float(row["standard_error"]), rel=1e-4)


@pytest.mark.usefixtures("no_figures")
def test_parameters_the_model_leaves_out_are_listed_as_fixed(tmp_path: Path) -> None:
    vacuum = {**STRUCTURE, "viscous_friction": {"vacuum": True}}
    model = identified_model(arm(), vacuum)
    write_result(identification(model), validation(model.model.arm.joint_names), tmp_path)
    with (tmp_path / "parameters.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["name"] == "k_v3"]
    assert [row["joint"] for row in rows] == ["turn", "slide"]
    assert all(float(row["value"]) == 0.0 and row["identifiable"] == "no" for row in rows)


def test_base_parameter_table(written: Path, subject: tuple[Identified, Validation]) -> None:
    identified = subject[0]
    with (written / "base_parameters.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == list(identified.base.names)
    assert [float(row["value"]) for row in rows] == list(identified.base_values)
    assert rows[0]["standard_error"] == "", "no error is known, which is not an error of zero"
    assert [float(row["standard_error"]) for row in rows[1:]] == [error for error in identified.base_errors[1:]]


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is not JSON")


@pytest.mark.usefixtures("no_figures")
def test_validation_has_the_shape_of_the_contract(tmp_path: Path, subject: tuple[Identified, Validation]) -> None:
    identified, whole = subject
    nothing = Fit(0, math.nan, math.nan, math.nan, math.nan, math.nan)
    joints = {**whole.joints, "slide": JointValidation(fit(), nothing, fit(), None)}
    write_result(identified, replace(whole, joints=joints), tmp_path)
    data = json.loads((tmp_path / "validation.json").read_text(encoding="utf-8"), parse_constant=refuse)
    five = {"rmse_Nm": 1.5, "mae_Nm": 1.1, "max_Nm": 6.25, "r": 0.9987, "relative_rms": 0.05}
    assert set(data["joints"]) == {"turn", "slide"}
    for figures in data["joints"].values():
        assert {key: figures[key] for key in five} == five
        assert set(figures["moving"]) == set(figures["unfiltered"]) == set(five)
    assert data["joints"]["turn"]["moving"]["relative_rms"] == 0.03
    assert set(data["joints"]["slide"]["moving"].values()) == {None}
    assert data["joints"]["turn"]["lack_of_fit"] == {"f": 1.1, "p_value": 0.3, "noise_Nm": 0.2}
    assert data["joints"]["slide"]["lack_of_fit"] is None
    assert data["bags"] == ["v.mcap"]
    assert (data["held_out"], data["bandwidth_hz"]) == (True, 7.5)


@pytest.mark.usefixtures("no_figures")
def test_a_second_result_replaces_the_first_and_leaves_foreign_files(
    tmp_path: Path, subject: tuple[Identified, Validation]
) -> None:
    identified, figures = subject
    write_result(identified, figures, tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "run.mcap").write_bytes(b"data")
    other = identification(identified_model(arm(), seed=7))
    write_result(other, figures, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "notes.txt", "bags"}
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "bags" / "run.mcap").read_bytes() == b"data"
    assert np.array_equal(load_model(tmp_path / "model.yaml").parameters, other.model.parameters)
    assert identified_urdf(other.model) == (tmp_path / "identified.urdf").read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("failing", ["report_html", "identified_urdf", "save_result"])
def test_a_failure_leaves_the_old_result(
    failing: str,
    tmp_path: Path,
    written: Path,
    subject: tuple[Identified, Validation],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    directory = tmp_path / "result"
    shutil.copytree(written, directory)
    before = {path.name: path.read_bytes() for path in directory.iterdir()}

    def fail(*_: object) -> None:
        raise RuntimeError("crash")

    monkeypatch.setattr(folder, failing, fail)
    with pytest.raises(RuntimeError, match="crash"):
        write_result(identification(identified_model(arm(), seed=7)), subject[1], directory)
    assert {path.name: path.read_bytes() for path in directory.iterdir()} == before
    with pytest.raises(RuntimeError, match="crash"):
        write_result(*subject, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("renames", range(len(FILES)))
def test_power_loss_between_renames_does_not_pass_for_a_result(
    renames: int, tmp_path: Path, subject: tuple[Identified, Validation], monkeypatch: pytest.MonkeyPatch
) -> None:
    identified, figures = subject
    write_result(identified, figures, tmp_path)
    rename, done = folder.os.replace, []

    def lose_power(source: Path, target: Path) -> None:
        if len(done) == renames:
            raise KeyboardInterrupt
        rename(source, target)
        done.append(target)

    monkeypatch.setattr(folder.os, "replace", lose_power)
    with pytest.raises(KeyboardInterrupt):
        write_result(identification(identified_model(arm(), seed=7)), figures, tmp_path)
    assert len(done) == renames
    with pytest.raises(UserError, match="is not a result folder"):
        load_result(tmp_path)


@pytest.mark.usefixtures("no_figures")
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, subject: tuple[Identified, Validation]) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"^cannot write .*file: .*: choose another --out$"):
        write_result(*subject, tmp_path / "file")
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    with pytest.raises(UserError, match=r"report\.html is a folder"):
        write_result(*subject, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["report.html"]


# --- the report again -----------------------------------------------------------------------------------------


def test_report_is_made_again_from_the_folder_alone(written: Path, tmp_path: Path) -> None:
    for name in ("model.yaml", "result.json", "result.npz"):
        shutil.copy(written / name, tmp_path)
    assert rewrite_report(tmp_path) == tmp_path / "report.html"
    assert (tmp_path / "report.html").read_bytes() == (written / "report.html").read_bytes()


def same(left: object, right: object) -> bool:
    """Equality through dataclasses and arrays, NaN equal to NaN."""
    if is_dataclass(left):
        return type(left) is type(right) and all(
            same(getattr(left, field.name), getattr(right, field.name)) for field in fields(left)
        )
    if isinstance(left, (tuple, list)):
        return len(left) == len(right) and all(map(same, left, right))
    if isinstance(left, dict):
        return left.keys() == right.keys() and all(same(left[key], right[key]) for key in left)
    if isinstance(left, (np.ndarray, float)):
        return np.array_equal(left, right, equal_nan=True)
    return left == right


def test_everything_about_a_result_comes_back(tmp_path: Path, subject: tuple[Identified, Validation]) -> None:
    identified, figures = subject
    figures = replace(figures, traces=(trace(2), trace(2, 50, "other", seed=4)), held_out=False)
    identified = replace(identified, joints_at_rest=("slide",), consistency_shift=math.inf)
    save_result(Result(identified, figures, "2025-01-31T12:05:00+00:00"), tmp_path)
    loaded = load_result(tmp_path)
    assert same(loaded.validation, figures)
    for field in fields(Identified):
        if field.name != "model":
            assert same(getattr(loaded.identified, field.name), getattr(identified, field.name)), field.name
    assert loaded.written == "2025-01-31T12:05:00+00:00"


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda folder: (folder / "result.json").unlink(), "is not a result folder"),
        (lambda folder: shutil.rmtree(folder), "is not a result folder"),
        (lambda folder: truncate(folder / "result.json"), "is not JSON"),
        (lambda folder: (folder / "result.json").write_text("[]"), "not a result of this version"),
        (lambda folder: (folder / "result.json").write_text('{"schema": "spacearm_ident/result/1"}'), "incomplete"),
        (lambda folder: (folder / "result.npz").unlink(), "incomplete"),
        (lambda folder: truncate(folder / "result.npz"), "not the file this result was written with"),
        (lambda folder: (folder / "model.yaml").write_text("x: 1"), "not the file this result was written with"),
    ],
)
def test_what_is_not_a_whole_result_is_one_line(damage, says: str, written: Path, tmp_path: Path) -> None:
    directory = tmp_path / "result"
    shutil.copytree(written, directory)
    damage(directory)
    with pytest.raises(UserError, match=says) as caught:
        rewrite_report(directory)
    assert "\n" not in str(caught.value)


# --- the URDF -------------------------------------------------------------------------------------------------


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_urdf_predicts_the_rigid_torque_of_the_model(seed: int) -> None:
    model = identified_model(arm(), seed=seed)
    loaded = pin.buildModelFromXML(identified_urdf(model))
    assert tuple(loaded.names)[1:] == model.model.arm.joint_names
    data = loaded.createData()
    position, velocity, acceleration = np.random.default_rng(seed).uniform(-2, 2, (3, 20, 2))
    zero = np.zeros(2)
    motion = Motion(
        model.model.arm.joint_names, 1.0, 0.0, position, velocity, acceleration, np.zeros((20, 2)), zero, zero
    )
    expected = model.torque(motion, ("rigid_body",))
    torque = [pin.rnea(loaded, data, *state) for state in zip(position, velocity, acceleration)]
    np.testing.assert_allclose(torque, expected, atol=1e-9 * np.abs(expected).max())


def parsed(text: str) -> ET.Element:
    """A URDF's root; the prefix that the small arm does not declare is taken off."""
    return ET.fromstring(text.replace("sensor:kind", "kind"))


def without_what_was_identified(text: str) -> list[tuple[str, dict[str, str], str]]:
    """Every element but inertials of moved links and dynamics, in order."""
    root = parsed(text)
    for parent in root.iter():
        for child in list(parent):
            moved = child.tag == "inertial" and parent.get("name") != "base"
            if moved or child.tag == "dynamics":
                parent.remove(child)
    return [(node.tag, dict(node.attrib), (node.text or "").strip()) for node in root.iter()]


def test_urdf_keeps_everything_else() -> None:
    text = identified_urdf(identified_model(arm()))
    assert without_what_was_identified(text) == without_what_was_identified(URDF)
    assert "<!-- a small arm -->" in text
    assert "<sensor:kind" in text


def test_urdf_has_the_merged_body_on_the_moving_link_alone() -> None:
    model = identified_model(arm())
    root = parsed(identified_urdf(model))
    links = {link.get("name"): link for link in root.findall("link")}
    assert {name for name, link in links.items() if link.find("inertial") is not None} == {"base", "upper", "lower"}
    assert links["base"].find("inertial/mass").get("value") == "9.0"
    assert float(links["lower"].find("inertial/mass").get("value")) == model.value("m", "slide")


def test_urdf_friction_is_not_negative() -> None:
    model = identified_model(arm())
    names = [parameter.name for parameter in model.model.parameters]
    values = model.parameters.copy()
    values[names.index("k_v1[slide]")] = -3.0
    root = parsed(identified_urdf(replace(model, parameters=values)))
    found = {joint.get("name"): joint.findall("dynamics") for joint in root.findall("joint")}
    assert {name: len(dynamics) for name, dynamics in found.items()} == {
        **dict.fromkeys(("stand", "flange", "mount"), 0),
        **dict.fromkeys(("turn", "slide"), 1),
    }
    assert found["turn"][0].attrib == {"damping": "8.0", "friction": "4.0"}
    assert float(found["slide"][0].get("damping")) == 0.0
    assert float(found["slide"][0].get("friction")) == pytest.approx(4.4)


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        ('<!DOCTYPE robot [<!ENTITY a "b">]>' + URDF.split("?>")[1], "DOCTYPE"),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd">' + URDF.split("?>")[1], "DOCTYPE"),
        (URDF.replace("</robot>", ""), "not well-formed"),
    ],
)
def test_urdf_with_entities_or_broken_is_refused(urdf: str, says: str) -> None:
    model = identified_model(arm())
    model = replace(model, model=TorqueModel(replace(model.model.arm, urdf=urdf), STRUCTURE))
    with pytest.raises(UserError, match=says):
        identified_urdf(model)


def test_urdf_of_a_link_without_mass_is_refused() -> None:
    model = identified_model(arm())
    values = model.parameters.copy()
    values[0] = 0.0
    with pytest.raises(UserError, match="'upper' was identified without a positive mass"):
        identified_urdf(replace(model, parameters=values))


# --- the page -------------------------------------------------------------------------------------------------


def test_page_needs_nothing_else(written: Path) -> None:
    text = (written / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert page.tags.count("svg") > 4
    assert page.references, "the point clouds are images"
    assert all(reference.startswith(("data:image/png;base64,", "#")) for reference in page.references)
    assert "://" not in text
    assert "@import" not in text
    assert "url(" not in text.replace("url(#", "")


def test_page_shows_the_figures_of_merit(written: Path) -> None:
    words = " ".join(Page((written / "report.html").read_text(encoding="utf-8")).words)
    for expected in ("Good fit.", "5.0 %", "0.9987", "6.25", "validation.mcap", "five times the 1.5 Hz", "ab" * 32):
        assert expected in words
    assert words.index("Good fit.") < words.index("Torque over time") < words.index("How it was obtained")


def test_text_from_outside_cannot_become_markup(tmp_path: Path) -> None:
    evil = "<b>x</b>\"'><script>alert(1)</script>&$\\frac$"
    escaped = "&lt;b&gt;x&lt;/b&gt;"
    small = arm(escaped, "<slide>".replace("<", "&lt;"))
    assert small.joint_names[0] == "<b>x</b>"
    model = replace(identified_model(small), provenance={"command": evil, "fitted_on": [{"path": evil}], evil: evil})
    identified = identification(model, notes=(evil,), solver=evil, choices=(Choice(evil, 1.0, True),))
    source = [trace(2, source=evil), trace(2, source="other")]
    figures = validation(small.joint_names, what=evil, traces=tuple(source))
    write_result(identified, figures, tmp_path)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"b", "script"} & set(page.tags)
    words = "".join(page.words)
    assert words.count("<script>alert(1)</script>") >= 6
    assert words.count("<b>x</b>") > 20
    root = parsed((tmp_path / "identified.urdf").read_text(encoding="utf-8"))
    assert {"<b>x</b>", "<slide>"} <= {joint.get("name") for joint in root.iter("joint")}


def test_page_of_a_long_recording_is_no_larger(subject: tuple[Identified, Validation]) -> None:
    identified, figures = subject
    small, large = (
        len(page_of(identified, replace(figures, traces=(trace(2, rows),))).encode()) for rows in (3000, 60_000)
    )
    assert large < 1.5 * small < 1_000_000


def test_page_without_signals_or_figures(subject: tuple[Identified, Validation]) -> None:
    empty = trace(2, 0)
    for figures in (
        Validation({}, (), "nothing", False),
        validation(("turn", "slide"), traces=(empty,)),
        validation(("turn",), traces=(replace(trace(2), moving=np.zeros((400, 2), bool)),)),
    ):
        Page(page_of(subject[0], figures))


def test_page_of_an_arm_with_a_coupled_motor(tmp_path: Path) -> None:
    small = replace(arm(), couplings=(Coupling("wrist", {"turn": 1.0, "slide": 2.0}),))
    model = identified_model(small, {**STRUCTURE, "coupled_motor": {}})
    write_result(identification(model), validation(small.joint_names), tmp_path)
    words = " ".join(Page((tmp_path / "report.html").read_text(encoding="utf-8")).words)
    assert "3 wrist" in words
    with (tmp_path / "parameters.csv").open(encoding="utf-8", newline="") as file:
        assert [row["name"] for row in csv.DictReader(file) if row["joint"] == "wrist"] == ["J_m", "k_v1", "f_c"]


# --- the verdict ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("worst", "level"), [(0.1, "good"), (0.11, "fair"), (0.26, "poor"), (math.nan, "unknown")])
def test_verdict_goes_by_the_worst_moving_joint(
    worst: float, level: str, subject: tuple[Identified, Validation]
) -> None:
    better = 0.01 if math.isfinite(worst) else math.nan
    joints = {
        "turn": JointValidation(fit(0.9), fit(better), fit()),
        "slide": JointValidation(fit(0.9), fit(worst), fit()),
    }
    verdict = judge_result(subject[0], replace(subject[1], joints=joints))
    assert verdict.level == level


def test_verdict_warns_of_what_weakens_it(subject: tuple[Identified, Validation]) -> None:
    identified, figures = subject
    assert judge_result(identified, figures).warnings == ()
    lacking = {"turn": replace(figures.joints["turn"], lack_of_fit=LackOfFit(6.0, 1e-9, 0.1))}
    weak = replace(identified, joints_at_rest=("slide",), consistency_shift=7.0)
    warnings = " ".join(judge_result(weak, replace(figures, joints=lacking, held_out=False)).warnings)
    for expected in (
        "fitted to",
        "Not validated: slide",
        "Never moved: slide",
        "residual of turn repeats",
        "by 7.0 of its standard errors",
    ):
        assert expected in warnings


# --- figures and numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.0, 1e-3])
def test_friction_curve_is_the_papers_law_whatever_the_presliding_distance(distance: float) -> None:
    model = identified_model(arm())
    constants = np.array([distance if constant.symbol == "d_s" else 0.02 for constant in model.model.constants])
    v, torque = friction_curve(replace(model, constants=constants), 0, 1.5, np.zeros(2))
    assert v[0] == -1.5 and v[-1] == 1.5 and np.all(np.diff(v) > 0) and not np.any(v == 0)
    expected = (4 + (6 - 4) * np.exp(-((v / 0.02) ** 2))) * np.sign(v) + 8 * v - 0.5 * v**2 + 0.25 * v**3
    np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_recordings_are_joined_on_one_axis() -> None:
    traces = [trace(2, 100, "a"), trace(2, 0, "b"), trace(2, 50, "c", seed=5)]
    signals = joint_signals(traces, 1, False)
    assert np.all(np.diff(signals.time) > 0)
    assert (signals.starts, signals.sources) == ((0, 100), ("a", "c"))
    np.testing.assert_array_equal(signals.residual[100:], (traces[2].measured - traces[2].predicted)[:, 1])
    np.testing.assert_allclose(np.ptp(signals.time[100:]), 20.0)
    assert joint_signals([trace(2, 0)], 0, True) is None


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9000), st.integers(0, 99), st.integers(1, 3))
def test_thinning_for_a_figure_keeps_every_extreme(count: int, seed: int, signals: int) -> None:
    given_ = np.random.default_rng(seed).normal(size=(signals, count))
    kept = decimated(*given_, most=500)
    assert len(kept) <= 500
    assert kept[0] == 0 and kept[-1] == count - 1
    assert np.all(np.diff(kept) > 0)
    for signal in given_:
        assert {int(signal.argmin()), int(signal.argmax())} <= set(kept.tolist())


SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text: str) -> float:
    """A printed number as a float."""
    mantissa, _, exponent = text.replace("−", "-").partition("×10")
    return float(mantissa) * 10.0 ** int(exponent.translate(SUPERSCRIPTS) or 0)


@given(st.floats(-1e12, 1e12).filter(lambda value: abs(value) > 1e-12), st.integers(1, 5))
def test_printed_numbers_are_right_to_their_digits(value: float, digits: int) -> None:
    assert read(number(value, digits)) == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - digits))


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e5))
def test_values_are_printed_to_the_digits_of_their_error(value: float, error: float) -> None:
    printed, uncertainty = (read(part) for part in measured(value, error).split(" ± "))
    assert uncertainty == pytest.approx(error, rel=0.15)
    assert abs(printed - value) <= max(0.16 * error, 5.1e-3 * abs(value) * (error > 10 or error < 1e-6))


def test_numbers_as_a_person_writes_them() -> None:
    assert (number(14.879, 3), number(-0.05), number(9.9996), number(0.0)) == ("14.9", "−0.0500", "10.0", "0")
    assert (number(math.nan), number(6.02e23), number(1e-7, 2)) == ("–", "6.02×10²³", "1.0×10⁻⁷")
    assert measured(14.8791, 0.0213) == "14.879 ± 0.021"
    assert measured(14.8791, 0.52) == "14.9 ± 0.5"
    assert measured(-0.0001, 0.5) == "0.0 ± 0.5"
    assert measured(14.8791, math.nan) == "14.88"


def test_elements_escape_text_and_attributes() -> None:
    built = element("td", "<i>&", element("b", 1), None, class_="a", title='"<', aria_hidden="true", rowspan=None)
    assert built == '<td class="a" title="&quot;&lt;" aria-hidden="true">&lt;i&gt;&amp;<b>1</b></td>'
