"""The result folder: every file says the same numbers, and the page stands alone."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from made_result import (
    FILES,
    STRUCTURE,
    Page,
    arm,
    fit,
    identification,
    identified_model,
    page_of,
    parsed,
    recording,
    trace,
    validation,
)

from spacearm_ident.dynamics.arm import Coupling
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import (
    Choice,
    Determination,
    Fit,
    Identified,
    JointValidation,
    LackOfFit,
    Validation,
)
from spacearm_ident.report import folder
from spacearm_ident.report.folder import rewrite_report, write_result
from spacearm_ident.report.opening import opening
from spacearm_ident.results.provenance import provenance
from spacearm_ident.results.store import Result, load_result, save_result
from spacearm_ident.results.tables import PAPER_SYMBOLS
from spacearm_ident.results.urdf import identified_urdf

Subject = tuple[Identified, Validation]


@pytest.fixture(scope="module")
def subject() -> Subject:
    known = provenance([recording("a.mcap"), recording("b.mcap")], [recording("v.mcap")], "spacearm identify a.mcap")
    model = replace(identified_model(arm()), provenance=known)
    return identification(model), validation(model.model.arm.joint_names)


@pytest.fixture(scope="module")
def written(subject: Subject, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("report") / "new" / "result"
    assert write_result(*subject, directory) == directory / "report.html"
    return directory


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of the folder, to which the page is one file among others."""
    monkeypatch.setattr(folder, "report_html", lambda result: result.validation.what)


# --- the folder -----------------------------------------------------------------------------------------------


def test_folder_holds_every_file_of_the_contract_and_nothing_else(written: Path) -> None:
    assert {path.name for path in written.iterdir()} == FILES


def test_model_loads_back_to_the_same_numbers(written: Path, subject: Subject) -> None:
    model, loaded = subject[0].model, load_model(written / "model.yaml")
    assert np.array_equal(loaded.parameters, model.parameters)
    assert np.array_equal(loaded.constants, model.constants)
    assert loaded.provenance == model.provenance


def test_parameter_table_says_what_the_model_says(written: Path, subject: Subject) -> None:
    identified = subject[0]
    rows = rows_of(written / "parameters.csv")
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
    rows = [row for row in rows_of(tmp_path / "parameters.csv") if row["name"] == "k_v3"]
    assert [row["joint"] for row in rows] == ["turn", "slide"]
    assert all(float(row["value"]) == 0.0 and row["identifiable"] == "no" for row in rows)


def test_base_parameter_table(written: Path, subject: Subject) -> None:
    identified = subject[0]
    rows = rows_of(written / "base_parameters.csv")
    assert [row["name"] for row in rows] == list(identified.base.names)
    assert [float(row["value"]) for row in rows] == list(identified.base_values)
    assert rows[0]["standard_error"] == "", "no error is known, which is not an error of zero"
    assert [float(row["standard_error"]) for row in rows[1:]] == [error for error in identified.base_errors[1:]]


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is not JSON")


@pytest.mark.usefixtures("no_figures")
def test_validation_has_the_shape_of_the_contract(tmp_path: Path, subject: Subject) -> None:
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
def test_a_second_result_replaces_the_first_and_leaves_foreign_files(tmp_path: Path, subject: Subject) -> None:
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
    subject: Subject,
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
    renames: int, tmp_path: Path, subject: Subject, monkeypatch: pytest.MonkeyPatch
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
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, subject: Subject) -> None:
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


def test_everything_about_a_result_comes_back(tmp_path: Path, subject: Subject) -> None:
    identified, figures = subject
    figures = replace(figures, traces=(trace(2), trace(2, 50, "other", seed=4)), held_out=False)
    identified = replace(identified, joints_at_rest=("slide",), consistency_shift=math.inf)
    save_result(Result(identified, figures, "2025-01-31T12:05:00+00:00"), tmp_path)
    loaded = load_result(tmp_path)
    np.testing.assert_equal(asdict(loaded.validation), asdict(figures))
    np.testing.assert_equal(*(asdict(replace(one, model=None)) for one in (loaded.identified, identified)))
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
    words = Page((written / "report.html").read_text(encoding="utf-8")).text
    for expected in ("Good fit.", "5.0 %", "0.9987", "6.25", "validation.mcap", "five times the 1.5 Hz", "ab" * 32):
        assert expected in words
    assert words.index("Good fit.") < words.index("Torque over time") < words.index("How it was obtained")


def test_page_has_units_of_each_kind_of_joint_and_tables_that_scroll_in_their_own_frames(written: Path) -> None:
    text = (written / "report.html").read_text(encoding="utf-8")
    words = Page(text).text
    assert "N·m (N for slide)" in words and "N in place of N·m: slide" in words
    assert text.count("<table") == text.count('<div class="wide"><table') > 3


def test_text_from_outside_cannot_become_markup(tmp_path: Path) -> None:
    evil = "<b>x</b>\"'><script>alert(1)</script>&$\\frac$"
    escaped = "&lt;b&gt;&amp;&quot;x&lt;/b&gt;"
    small = arm(escaped, "<slide>".replace("<", "&lt;"))
    assert small.joint_names[0] == '<b>&"x</b>'
    model = replace(identified_model(small), provenance={"command": evil, "fitted_on": [{"path": evil}], evil: evil})
    identified = identification(model, notes=(evil,), solver=evil, choices=(Choice(evil, 1.0, True),))
    source = [trace(2, source=evil), trace(2, source="other")]
    figures = validation(small.joint_names, what=evil, traces=tuple(source))
    write_result(identified, figures, tmp_path)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"b", "script"} & set(page.tags)
    words = "".join(page.words)
    assert words.count("<script>alert(1)</script>") >= 6
    assert words.count('<b>&"x</b>') > 20
    root = parsed((tmp_path / "identified.urdf").read_text(encoding="utf-8"))
    assert {'<b>&"x</b>', "<slide>"} <= {joint.get("name") for joint in root.iter("joint")}


def test_page_of_a_long_recording_is_no_larger(subject: Subject) -> None:
    identified, figures = subject
    small, large = (
        len(page_of(identified, replace(figures, traces=(trace(2, rows),))).encode()) for rows in (3000, 60_000)
    )
    assert large < 1.5 * small < 1_000_000


def test_page_without_signals_or_figures(subject: Subject) -> None:
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
    words = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "3 wrist" in words
    rows = rows_of(tmp_path / "parameters.csv")
    assert [row["name"] for row in rows if row["joint"] == "wrist"] == ["J_m", "k_v1", "f_c"]


# --- its first lines ------------------------------------------------------------------------------------------


def test_page_opens_with_the_verdict_and_its_reasons(subject: Subject) -> None:
    identified = replace(subject[0], joints_at_rest=("slide",), consistency_shift=70.0)
    first = opening(identified, subject[1])
    assert first.verdict.level == "suspect"
    words = Page(page_of(identified, subject[1])).text
    assert first.verdict.headline in words
    assert first.verdict.reasons and all(reason in words for reason in first.verdict.reasons)


def test_page_warns_of_what_weakens_its_figures(subject: Subject) -> None:
    identified, figures = subject
    assert opening(identified, figures).warnings == ()
    lacking = {"turn": replace(figures.joints["turn"], lack_of_fit=LackOfFit(6.0, 1e-9, 0.1))}
    warnings = " ".join(opening(identified, replace(figures, joints=lacking, held_out=False)).warnings)
    assert "fitted to" in warnings and "residual of turn repeats" in warnings


def test_the_page_offers_every_export_with_a_command_that_runs_and_what_it_does_not_hold(subject):
    """The command line of each, word by word, against the parser; the words against what `export` says."""
    from spacearm_ident.cli.main import parser
    from spacearm_ident.export.law import nearest
    from spacearm_ident.export.motion import motions_of
    from spacearm_ident.export.write import FORMATS
    from spacearm_ident.results.formats import MJCF, SDF

    identified, figures = subject
    text = page_of(identified, replace(figures, held_out=True))
    section = text[text.index("For simulators and controllers") :]
    commands = re.findall(r"spacearm (export [^<]*)</code>", section)
    parsed_lines = [parser(("export",)).parse_args(command.split()) for command in commands]
    assert [line.to for line in parsed_lines] == list(FORMATS)
    for form in (MJCF, SDF):
        lost = nearest(identified.model, form, motions_of(identified.model, None)).lost
        row = section[section.index(f"--to {form.name}") :]
        assert ", ".join(lost) in row[: row.index("</tr>")].replace("&#x27;", "'")
    assert "--to thresholds" not in page_of(identified, replace(figures, held_out=False))
