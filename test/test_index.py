"""The index of several results and the comparison of two: the right numbers, whatever the names, in pages that stand
alone."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from made_result import Page, arm, identification, identified_model, validation

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Determination, Identified
from spacearm_ident.report import folder
from spacearm_ident.report.comparison import base_differences, comparison_html, differences, moved
from spacearm_ident.report.folder import write_result
from spacearm_ident.report.index import find_results, write_comparison, write_index
from spacearm_ident.results.quantities import quantities
from spacearm_ident.results.store import Result

MOVED = "m[slide]"
WRITTEN = "2025-01-31T12:05:00+00:00"


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """The runs' own pages are not looked at."""
    monkeypatch.setattr(folder, "report_html", lambda result: "a page")


def shifted(known: Identified, name: str, errors: float) -> Identified:
    """The same with one parameter moved by so many of its standard errors."""
    estimates = [
        replace(item, value=item.value + errors * item.standard_error)
        if f"{item.symbol}[{item.joint}]" == name
        else item
        for item in known.estimates
    ]
    assert any(one.value != other.value for one, other in zip(estimates, known.estimates))
    return replace(known, estimates=tuple(estimates))


def base_shifted(known: Identified, errors: float) -> Identified:
    """The same with one base parameter moved by so many of its standard errors."""
    values, number = known.base_values.copy(), known.base.names.index(MOVED)
    values[number] += errors * known.base_errors[number]
    return replace(known, base_values=values)


@pytest.fixture(scope="module")
def known() -> Identified:
    return identification(identified_model(arm()))


@pytest.fixture(scope="module")
def name(known) -> str:
    """A parameter with a standard error."""
    return next(f"{e.symbol}[{e.joint}]" for e in known.estimates if e.determination is Determination.DATA)


def runs(directory: Path, **results: Identified) -> Path:
    """Result folders, written a day apart in this order."""
    for day, (name, identified) in enumerate(results.items(), start=1):
        write_result(identified, validation(identified.model.model.arm.joint_names), directory / name)
        file = directory / name / "result.json"
        data = json.loads(file.read_text())
        file.write_text(json.dumps({**data, "written": f"2025-01-{day:02d}T12:00:00+00:00"}))
    return directory


def text_of(page: Path) -> str:
    return Page(page.read_text()).text


# --- differences ------------------------------------------------------------------------------------------------


def test_a_difference_is_counted_in_errors_of_the_difference(known, name):
    other = shifted(known, name, 6.0)
    found = {item.name: item for item in differences(known, other)}
    assert found[name].errors == pytest.approx(6.0 / math.sqrt(2.0))
    assert [item.name for item in moved(list(found.values()))] == [name]
    assert all(item.errors == 0.0 for key, item in found.items() if key != name and math.isfinite(item.errors))
    back = {item.name: item for item in differences(other, known)}
    assert back[name].errors == pytest.approx(-found[name].errors)


def test_what_rests_on_the_prior_has_no_errors_to_count_in(known):
    for item in differences(known, known):
        both = [one.determination for one in (item.first, item.second)]
        assert math.isfinite(item.errors) == (both == [Determination.DATA] * 2), item
        assert item.value == 0.0


def test_errors_of_the_difference_are_those_of_a_simulation(known, name):
    """Two independent normal draws of a parameter: the count is a standard normal."""
    rng = np.random.default_rng(1)
    counts = []
    for first, second in rng.standard_normal((300, 2)):
        found = differences(shifted(known, name, first), shifted(known, name, second))
        counts.append(next(item.errors for item in found if item.name == name))
    assert np.std(counts) == pytest.approx(1.0, abs=0.12) and abs(np.mean(counts)) < 0.2


def test_a_term_only_one_has_is_shown_and_not_counted(known):
    fewer = replace(known, estimates=tuple(e for e in known.estimates if e.symbol != "k_v3"))
    found = [item for item in differences(known, replace(fewer)) if item.name.startswith("k_v3")]
    assert len(found) == 2 and all(not item.moved for item in found)


def test_base_parameters_are_compared_where_they_are_the_same_combination(known):
    assert len(base_differences(known, known)) == len(known.base.names)
    names = ("another combination", *known.base.names[1:])
    other = replace(known, base=replace(known.base, names=names))
    assert len(base_differences(known, other)) == len(known.base.names) - 1


def test_arms_without_a_common_joint_cannot_be_compared(known):
    with pytest.raises(UserError, match="no joint in common"):
        differences(known, identification(identified_model(arm("here", "there"))))


# --- pages ------------------------------------------------------------------------------------------------------


def test_the_index_has_every_run_in_order_with_what_moved(tmp_path, known, capsys):
    runs(tmp_path, first=known, second=base_shifted(known, 9.0), third=base_shifted(known, 9.5))
    assert main(["report", str(tmp_path)]) == 0
    page = tmp_path / "index.html"
    assert capsys.readouterr().out == f"{page}\n"
    parsed = Page(page.read_text())
    assert parsed.references == [f"./{run}/report.html" for run in ("first", "second", "third")]
    assert all((tmp_path / target).is_file() for target in parsed.references)
    text = text_of(page)
    compared = len(quantities([known])[0])
    first, second, third = (text.index(f" {run} ") for run in ("first", "second", "third"))
    assert first < second < third
    assert f"1 of {compared} : {MOVED} (6.4*)" in text[second:third]
    assert f"0 of {compared}" in text[third:]
    assert "2025-01-01 12:00" in text[first:second] and "small" in text[first:second] and "0.9987" in text


def test_runs_of_another_arm_are_not_compared_with_this_one(tmp_path, known):
    other = identification(identified_model(arm("here", "there")))
    text = text_of(write_index(runs(tmp_path, a=known, b=other, c=known)))
    assert len(re.findall(r"\d+ of \d+", text)) == 1, "c with a, and b with nothing"


def test_what_cannot_be_read_has_a_row_that_says_why(tmp_path, known):
    runs(tmp_path, good=known, bad=known)
    (tmp_path / "bad" / "result.npz").write_bytes(b"")
    (tmp_path / "good" / ".writing-x").mkdir()
    (tmp_path / "good" / ".writing-x" / "result.json").write_text("{}")
    entries = find_results(tmp_path)
    assert [(entry.name, entry.result is not None) for entry in entries] == [("good", True), ("bad", False)]
    assert "is not the file this result was written with" in text_of(write_index(tmp_path))


def test_mismatches_are_listed_with_their_findings(tmp_path, known):
    runs(tmp_path, run=known)
    (tmp_path / "run" / "mismatch").mkdir()
    finding = {"effect": "torque_ripple", "joints": ["<b>turn</b>"]}
    document = {"verdict": "no_mismatch", "findings": [finding]}
    (tmp_path / "run" / "mismatch" / "mismatch.json").write_text(json.dumps(document))
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "mismatch.json").write_text("[]")
    text = text_of(write_index(tmp_path))
    assert "run/mismatch no mismatch torque_ripple at <b>turn</b>" in text
    assert "cannot be read" in text


def test_names_cannot_break_out_of_the_page(tmp_path, known):
    odd = 'a"><script>alert(1)</script> & javascript:x#?'
    run = tmp_path / "runs" / odd.replace("/", "⁄")
    write_result(known, validation(known.model.model.arm.joint_names), run)
    write_result(known, validation(known.model.model.arm.joint_names), tmp_path / "runs" / "b")
    index = Page(write_index(tmp_path / "runs").read_text())
    both = write_comparison(tmp_path / "runs", Path(run.name), Path("b"))
    for parsed in (index, Page(both.read_text())):
        assert "script" not in parsed.tags
        assert any(odd.split("/")[0] in word for word in parsed.words)
    assert unquote(index.references[0]) in (f"./{run.name}/report.html", "./b/report.html")
    assert all((tmp_path / "runs" / unquote(target)).is_file() for target in index.references)
    assert all(target.startswith("./") for target in index.references)
    assert both.parent == tmp_path / "runs" and both.name.isascii() and " " not in both.name


def test_the_comparison_shows_both_and_marks_what_moved(tmp_path, known, name, capsys):
    runs(tmp_path, old=known, new=shifted(known, name, -8.0))
    assert main(["report", str(tmp_path), "--compare", "old", "new"]) == 0
    page = tmp_path / "comparison_old_new.html"
    assert capsys.readouterr().out == f"{page}\n"
    text = text_of(page)
    assert "1 of " in text and f"Farthest: {name} (−5.7) standard errors." in text
    assert page.read_text().count('<tr class="moved">') == 1
    assert Page(page.read_text()).references == []
    assert main(["report", str(tmp_path), "--compare", str(tmp_path / "old"), "nowhere"]) == 2
    assert "nowhere is not a result folder" in capsys.readouterr().err


def test_pages_load_nothing_and_follow_the_readers_colours(tmp_path, known):
    names = known.model.model.arm.joint_names
    result = Result(known, validation(names), WRITTEN)
    for text in (comparison_html(("a", "b"), (result, result)), write_index(runs(tmp_path, a=known)).read_text()):
        assert "default-src 'none'" in text and "prefers-color-scheme: dark" in text and "@media print" in text
        assert not {"script", "link", "img", "iframe"} & set(Page(text).tags)


def test_a_page_in_a_result_folder_leaves_the_result_there(tmp_path, known):
    runs(tmp_path, a=known, b=known)
    for name in ("mismatch.json", "model.yaml", "report.html"):
        (tmp_path / name).write_text("{}")
    before = {path.name for path in tmp_path.iterdir()}
    pages = {write_index(tmp_path).name, write_comparison(tmp_path, Path("a"), Path("b")).name}
    assert {path.name for path in tmp_path.iterdir()} == before | pages


def test_the_same_result_twice_has_not_moved(known):
    result = Result(known, validation(known.model.model.arm.joint_names), WRITTEN)
    assert "None of " in comparison_html(("a", "b"), (result, result))


def test_a_folder_without_results_is_said(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "no result in" in capsys.readouterr().err
    assert not (tmp_path / "index.html").exists()
    assert main(["report", str(tmp_path / "nowhere")]) == 2
    assert "is not a result folder" in capsys.readouterr().err


def with_stribeck_velocity(known: Identified, joint: str, value: float) -> Identified:
    """The same with another v_b at a joint; all of it is determined by the data to 1 %."""
    model = known.model
    fastest = {name: 2.0 for name in model.model.arm.joint_names}
    structure = {**model.model.structure, "viscous_friction": {"fastest": fastest}}
    constants = model.constants.copy()
    constants[[item.name for item in model.model.constants].index(f"v_b[{joint}]")] = value
    estimates = tuple(
        replace(item, standard_error=0.01 * abs(item.value) + 1e-4, determination=Determination.DATA)
        for item in known.estimates
    )
    model = replace(model, model=TorqueModel(model.model.arm, structure), constants=constants)
    return replace(known, model=model, estimates=estimates)


def test_parameters_of_other_friction_laws_are_not_counted_and_friction_torque_is(known):
    joint = known.model.model.arm.joint_names[0]
    plain, stribeck = (with_stribeck_velocity(known, joint, value) for value in (0.0, 0.1))
    far = shifted(stribeck, f"f_c[{joint}]", 30.0)
    assert [item.name for item in moved(differences(stribeck, far))] == [f"f_c[{joint}]"], "of one law: counted"
    found = differences(plain, far)
    friction = [item for item in found if item.joint == joint and item.symbol in ("f_c", "f_b", "v_b", "k_v1", "k_v3")]
    assert len(friction) == 5 and all(math.isnan(item.errors) for item in friction)
    levels = [item for item in found if item.joint == joint and item.symbol.startswith("friction at")]
    assert [item.symbol for item in levels] == [f"friction at {speed} rad/s" for speed in ("0.50", "1.0", "2.0")]
    assert all(abs(item.errors) < 0.1 for item in levels), "v_b is far below these speeds: the torque is the same"
    assert not moved(found)
    assert any(item.joint != joint and item.symbol == "f_c" and math.isfinite(item.errors) for item in found)
    assert all(math.isnan(item.errors) for item in base_differences(plain, far) if item.name == f"f_c[{joint}]")


def test_friction_torque_is_compared_where_the_law_is_the_same_too(known):
    """f_c up and k_v1 down in one law: each alone may be lost in its error, their sum at a speed is not."""
    joint = known.model.model.arm.joint_names[0]
    first = with_stribeck_velocity(known, joint, 0.1)
    parameters = first.model.parameters.copy()
    parameters[[item.name for item in first.model.model.parameters].index(f"f_c[{joint}]")] += 1.0
    second = replace(first, model=replace(first.model, parameters=parameters))
    levels = [item for item in differences(first, second) if item.joint == joint and "friction at" in item.symbol]
    assert [item.value for item in levels] == pytest.approx([1.0, 1.0, 1.0], abs=1e-6)
    (rise,) = [item for item in differences(first, second) if item.joint == joint and "friction rise" in item.symbol]
    assert rise.value == pytest.approx(0.0, abs=1e-6)


def test_quantities_do_not_depend_on_the_law_of_friction(known):
    joint = known.model.model.arm.joint_names[0]
    both = quantities([with_stribeck_velocity(known, joint, value) for value in (0.0, 0.1)])
    assert set(both[0]) == set(both[1])
    assert not any(name.startswith(("f_c", "k_v1", "v_b")) for name in both[0])
    assert f"friction at 0.50 rad/s[{joint}]" in both[0]
