"""Many bags: each as `spacearm identify` would, none in another's way, nothing done twice, trends that are there."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pool_tasks
import pytest
import small_arm
from made_result import Page
from test_index import text_of

from spacearm_ident.cli.main import main
from spacearm_ident.recording import Series, write_recording
from spacearm_ident.recording.recording import Issue
from spacearm_ident.report.summary import write_summary
from spacearm_ident.report.text import percent
from spacearm_ident.results.provenance import moment
from spacearm_ident.results.recorded_runs import recorded_runs
from spacearm_ident.results.store import load_result
from spacearm_ident.sessions.bags import Options
from spacearm_ident.sessions.batch import Task, find_bags, perform, up_to_date
from spacearm_ident.sessions.side_by_side import Lost, on_cluster, on_cores

QUICK = ("--friction", "coulomb-viscous", "--bandwidth", "5")
DAY_NS = 86_400 * 10**9
START_NS = 1_735_689_600 * 10**9  # 2025-01-01
GAIN = 0.5
"""Coulomb friction that the elbow gains a day."""


def dated(day: int, warm: float = 20.0) -> small_arm.Recording:
    """A run of some day, at some temperature, with more friction at the elbow every day."""
    run = small_arm.with_step(small_arm.recording(8.0, 100.0, seed=day), 0.0, GAIN * day)
    every_second = np.arange(0.0, 8.0)
    series = {"elbow": Series(every_second, np.full(len(every_second), warm))}
    return replace(run, start_ns=START_NS + day * DAY_NS, temperatures=series)


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> Path:
    """A folder of two good bags, one in a folder below, one that is unfit and one that is no bag."""
    folder = tmp_path_factory.mktemp("fleet")
    write_recording(folder / "a.mcap", dated(1, warm=25.0))
    (folder / "deeper").mkdir()
    write_recording(folder / "deeper" / "b", dated(0))
    write_recording(folder / "still.mcap", small_arm.recording(8.0, 100.0, still=(0, 1)))
    (folder / "text.mcap").write_text("this is not a bag")
    (folder / "notes.txt").write_text("nor is this")
    return folder


def batch(*words: object, jobs: int = 1) -> int:
    return main(["batch", *map(str, words), *QUICK, "--quiet", "--jobs", str(jobs)])


@pytest.fixture(scope="module")
def done(bags, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("results") / "new" / "out"
    assert batch(bags, "--out", out, jobs=2) == 1
    return out


def inodes(out: Path, *names: str) -> list[int]:
    return [(out / name / "model.yaml").stat().st_ino for name in names]


def rows_of(out: Path) -> dict[str, dict]:
    return {row["run"]: row for row in json.loads((out / "summary.json").read_text())["runs"]}


# --- what comes out ---------------------------------------------------------------------------------------------


def test_every_bag_is_a_row_whatever_became_of_it(done):
    rows = rows_of(done)
    assert {name: row["status"] for name, row in rows.items()} == {
        "a": "identified",
        "deeper/b": "identified",
        "still": "unfit",
        "text": "failed",
    }
    assert "moves" in rows["still"]["reason"] and "not an MCAP file" in rows["text"]["reason"]
    assert all("\n" not in row["reason"] for row in rows.values())
    assert not (done / "still").exists() and not (done / "text").exists()


def test_every_row_has_the_same_keys_and_none_where_there_is_nothing(done):
    rows = rows_of(done)
    assert len({tuple(row) for row in rows.values()}) == 1
    for name in ("still", "text"):
        nothing = {key for key, value in rows[name].items() if value is None}
        assert nothing >= {"recorded", "written", "arm", "r", "relative_rms", "changed", "temperature_C", "parameters"}
    assert rows["still"]["verdict"] == "unfit" and rows["text"]["verdict"] is None


def test_the_summary_says_what_changed_and_the_residual_of_every_joint_as_the_page_does(done):
    rows, text = rows_of(done), " ".join(text_of(done / "index.html").split())
    assert rows["deeper/b"]["changed"] is None, "the first of its arm"
    changed = rows["a"]["changed"]
    assert changed["since"] == "deeper/b"
    said = {item["name"]: item for item in changed["parameters"]}
    (gained,) = (item for name, item in said.items() if re.match(r"f_c\[elbow\]|friction at \S+ rad/s\[elbow\]", name))
    assert gained["joint"] == "elbow" and gained["difference"] == pytest.approx(GAIN, abs=0.1)
    assert gained["unit"] == "N m" and gained["difference"] > 3.0 * gained["error"] and not gained["ordinary"]
    assert f"{len(said)} of {changed['compared']}" in text
    shares = rows["a"]["relative_rms_by_joint"]
    known = load_result(done / "a").validation.joints
    assert shares == {name: joint.moving.relative_rms for name, joint in known.items()}
    assert max(shares.values()) == rows["a"]["relative_rms"] and min(shares.values()) < max(shares.values())
    table = {one["run"]: one for one in csv.DictReader((done / "summary.csv").open())}
    assert {name: float(table["a"][f"relative_rms[{name}]"]) for name in shares} == shares
    of_joints = text[text.index("of every joint of small_arm") :]
    assert all(" ".join(percent(share).split()) in of_joints for share in shares.values())


def test_a_result_is_that_of_the_command_to_the_last_digit(bags, done, tmp_path):
    words = ["identify", str(bags / "a.mcap"), *QUICK, "--out", str(tmp_path / "a"), "--quiet"]
    assert main(words) == 0
    for name in ("parameters.csv", "base_parameters.csv", "identified.urdf", "covariance.json"):
        assert (done / "a" / name).read_bytes() == (tmp_path / "a" / name).read_bytes(), name
    mine, other = (dict(np.load(place / "a" / "result.npz")) for place in (done, tmp_path))
    assert set(mine) == set(other) and all(np.array_equal(mine[name], other[name]) for name in mine)
    assert load_result(done / "a").validation.held_out


def test_the_tables_have_the_numbers_of_the_results(done):
    result = load_result(done / "a")
    item = next(one for one in result.identified.estimates if one.name == "f_c[elbow]")
    row = rows_of(done)["a"]
    assert row["parameters"]["f_c[elbow]"]["value"] == item.value
    assert row["parameters"]["f_c[elbow]"]["standard_error"] == item.standard_error
    assert row["recorded"] == datetime(2025, 1, 2, tzinfo=UTC).isoformat()
    assert row["temperature_C"] == {"elbow": 25.0} and row["arm"] == "small_arm"
    table = {one["run"]: one for one in csv.DictReader((done / "summary.csv").open())}
    assert float(table["a"]["f_c[elbow]"]) == item.value
    assert float(table["a"]["standard error f_c[elbow]"]) == item.standard_error
    assert float(table["a"]["temperature_C[elbow]"]) == 25.0
    assert table["still"]["f_c[elbow]"] == "" and table["still"]["status"] == "unfit"
    lowest = min(joint.everything.correlation for joint in result.validation.joints.values())
    assert float(table["a"]["r"]) == lowest == row["r"]


def test_the_index_is_in_order_of_recording_and_says_what_failed(done):
    text = text_of(done / "index.html")
    links = [link for link in Page((done / "index.html").read_text()).references if not link.startswith("#")]
    assert links == ["./deeper/b/report.html", "./a/report.html"], "none where there is no report"
    assert text.index("2025-01-01 00:00") < text.index("2025-01-02 00:00") < text.index("not an MCAP file")
    assert rows_of(done)["still"]["reason"] in text
    before = (done / "index.html").read_bytes()
    assert main(["report", str(done), "--quiet"]) == 0
    assert (done / "index.html").read_bytes() == before, "spacearm report makes the same page"


def test_a_run_whose_stamps_give_no_date_has_none_in_the_tables(tmp_path):
    (tmp_path / "fleet").mkdir()
    write_recording(tmp_path / "fleet" / "a.mcap", replace(dated(0), start_ns=0))
    assert batch(tmp_path / "fleet", "--out", tmp_path / "out") == 0
    assert rows_of(tmp_path / "out")["a"]["recorded"] is None
    (table,) = csv.DictReader((tmp_path / "out" / "summary.csv").open())
    assert table["recorded"] == ""


# --- what counts once, and what has no place in time ------------------------------------------------------------


@pytest.fixture(scope="module")
def odd_days(tmp_path_factory) -> Path:
    """Four days of one arm, a copy of the second, a clock of 1970 (41 days on) and one of 2035; identified."""
    folder, out = tmp_path_factory.mktemp("odd"), tmp_path_factory.mktemp("of_odd") / "out"
    for day in range(4):
        write_recording(folder / f"{day}.mcap", dated(day, warm=20.0 + day))
    shutil.copy(folder / "1.mcap", folder / "1_copy.mcap")
    write_recording(folder / "past.mcap", replace(dated(5, warm=25.0), start_ns=41 * DAY_NS))
    write_recording(folder / "future.mcap", replace(dated(6, warm=26.0), start_ns=START_NS + 4000 * DAY_NS))
    assert batch(folder, "--out", out) == 0
    return out


def test_the_same_data_are_said_to_be_and_counted_once(odd_days, tmp_path, capsys):
    rows = rows_of(odd_days)
    assert rows["1_copy"]["copy_of"] == "1" and rows["1_copy"]["status"] == "identified"
    assert all(row["copy_of"] is None for name, row in rows.items() if name != "1_copy")
    assert rows["1_copy"]["changed"] is None and rows["2"]["changed"]["since"] == "1"
    assert "the same data as 1: counted once" in text_of(odd_days / "index.html")
    again = Path(shutil.copytree(odd_days, tmp_path / "out"))
    assert batch(*(row["bag"] for row in rows.values()), "--out", again) == 0
    out = capsys.readouterr().out
    assert "the same data as 1: counted once" in out and "its clock says 1970" in out


def test_a_clock_that_gives_no_date_has_no_place_in_time(odd_days):
    rows = rows_of(odd_days)
    assert "1970" in rows["past"]["wrong_clock"] and "2035-12-15" in rows["future"]["wrong_clock"]
    assert rows["past"]["recorded"] is None and rows["future"]["recorded"] is None
    assert [rows[name]["wrong_clock"] for name in "0123"] == [None] * 4
    assert rows["past"]["changed"] is None and rows["future"]["changed"] is None
    assert [rows[name]["changed"]["since"] for name in "123"] == ["0", "1", "2"]
    trends = json.loads((odd_days / "summary.json").read_text())["trends"]
    runs = {over: {one["runs"] for one in trends if one["over"] == over} for over in ("date", "temperature")}
    assert runs["date"] == {4} and runs["temperature"] <= {4}, "slopes rest on what has a place in time"
    text = text_of(odd_days / "index.html")
    assert rows["past"]["wrong_clock"] in text and rows["future"]["wrong_clock"] in text


@pytest.mark.parametrize("ahead_h, right", [(13, True), (15, False)])
def test_a_clock_in_local_time_is_not_taken_for_one_in_the_future(ahead_h, right):
    start = datetime(2025, 1, 1, ahead_h, tzinfo=UTC)
    known = {"recorded": [{"start": start.isoformat(), "duration_s": 1.0}]}
    found = moment(known, "2025-01-01T00:00:00+00:00")
    assert found is not None and (found.date == start) is right and bool(found.wrong_clock) is not right


# --- arms of one type --------------------------------------------------------------------------------------------


def test_arms_of_one_type_are_told_apart_by_their_folders_where_that_is_asked_for(tmp_path, capsys):
    fleet, out = tmp_path / "fleet", tmp_path / "out"
    for arm, level in (("arm1", 0.0), ("arm2", 3.0)):
        (fleet / arm / "2025").mkdir(parents=True)
        for day in range(4):
            run = small_arm.with_step(dated(day), 0.0, level - GAIN * day * (arm == "arm2"))
            write_recording(fleet / arm / "2025" / f"{day}.mcap", run)
    assert batch(fleet, "--out", out) == 0
    document = json.loads((out / "summary.json").read_text())
    assert {row["arm"] for row in document["runs"]} == {"small_arm"}
    assert {trend["runs"] for trend in document["trends"]} == {8}
    assert batch(fleet, "--out", out, "--arm-by-folder") == 0
    document = json.loads((out / "summary.json").read_text())
    assert all(row["skipped"] for row in document["runs"]), "nothing is identified again for it"
    for row in document["runs"]:
        arm = row["run"].split("/")[0]
        assert row["arm"] == f"{arm} (small_arm)"
        assert row["changed"] is None or row["changed"]["since"].startswith(f"{arm}/")
    slopes = {trend["arm"]: trend for trend in document["trends"] if trend["parameter"] == "f_c[elbow]"}
    assert {arm: trend["runs"] for arm, trend in slopes.items()} == {"arm1 (small_arm)": 4, "arm2 (small_arm)": 4}
    assert slopes["arm1 (small_arm)"]["slope"] == pytest.approx(GAIN, abs=0.1)
    assert slopes["arm2 (small_arm)"]["slope"] == pytest.approx(0.0, abs=0.1)
    before = (out / "index.html").read_bytes()
    assert "Trends of arm2 (small_arm)" in text_of(out / "index.html")
    assert main(["report", str(out), "--quiet"]) == 0
    assert (out / "index.html").read_bytes() == before, "spacearm report knows"
    assert batch(fleet / "arm1" / "2025", "--out", tmp_path / "new", "--arm-by-folder") == 2
    assert "name the one above" in capsys.readouterr().err and not (tmp_path / "new").exists()


# --- again ------------------------------------------------------------------------------------------------------


@pytest.fixture
def finished(done, tmp_path) -> Path:
    """A copy, to go on with."""
    return Path(shutil.copytree(done, tmp_path / "out"))


def test_what_is_there_is_not_done_again_until_it_is_asked_for(bags, finished, capsys):
    before = inodes(finished, "a", "deeper/b")
    assert batch(bags, "--out", finished, "--json") == 1
    shown = json.loads(capsys.readouterr().out)
    assert inodes(finished, "a", "deeper/b") == before
    assert shown == json.loads((finished / "summary.json").read_text())
    assert [row["skipped"] for row in shown["runs"] if row["status"] == "identified"] == [True, True]
    assert batch(bags / "a.mcap", "--out", finished, "--again") == 0
    after = inodes(finished, "a", "deeper/b")
    assert after[0] != before[0] and after[1] == before[1]


def test_a_result_is_up_to_date_for_the_same_bag_options_and_versions_only(bags, done, tmp_path, monkeypatch):
    quick = Options(friction="coulomb-viscous", cutoff_hz=5.0)
    task = Task("a", bags / "a.mcap", done / "a", quick)
    assert up_to_date(task)
    moved = Path(shutil.copy(bags / "a.mcap", tmp_path / "moved.mcap"))
    assert up_to_date(replace(task, bag=moved)), "its content counts, not its place"
    moved.write_bytes(moved.read_bytes() + b"x")
    assert not up_to_date(replace(task, bag=moved))
    for changed in (Options(), replace(quick, cutoff_hz=6.0), replace(quick, gravity=(0.0, 0.0, -9.8))):
        assert not up_to_date(replace(task, options=changed))
    monkeypatch.setattr("spacearm_ident.sessions.batch.versions", lambda: {"spacearm_ident": "9"})
    assert not up_to_date(task)


def test_files_of_the_options_count_by_their_content(tmp_path):
    urdf, arm = tmp_path / "arm.urdf", tmp_path / "arm.yaml"
    urdf.write_text(small_arm.URDF)
    arm.write_text("schema: spacearm_ident/arm/1\nurdf: arm.urdf\n")
    known = Options(arm=arm).fingerprint()
    elsewhere = Path(shutil.copytree(tmp_path, tmp_path / "copy")) / "arm.yaml"
    assert Options(arm=elsewhere).fingerprint() == known
    urdf.write_text(small_arm.URDF.replace("0.4", "0.5"))
    assert Options(arm=arm).fingerprint() != known, "the URDF that the YAML names"
    assert Options().fingerprint() == {}


def test_a_bag_that_has_become_unfit_does_not_pass_for_its_old_result(finished, tmp_path):
    bag = tmp_path / "a.mcap"
    write_recording(bag, small_arm.recording(8.0, 100.0, still=(0, 1)))
    assert batch(bag, "--out", finished) == 1
    assert rows_of(finished)["a"]["status"] == "unfit" and rows_of(finished)["a"]["parameters"] is None
    text = text_of(finished / "index.html")
    assert rows_of(finished)["a"]["reason"] in text and "deeper/b" in text


# --- data that break a convention -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def with_degrees(tmp_path_factory) -> Path:
    """Five days of one arm, that of the third in degrees; identified."""
    folder, out = tmp_path_factory.mktemp("week"), tmp_path_factory.mktemp("of") / "out"
    for day in range(5):
        run = dated(day)
        if day == 2:
            run = replace(run, position=np.degrees(run.position), velocity=np.degrees(run.velocity))
        write_recording(folder / f"{day}.mcap", run)
    assert batch(folder, "--out", out) == 1, "identify says 1 of that bag"
    return out


def test_data_that_break_a_convention_are_unfit_with_the_reason(with_degrees, tmp_path, capsys):
    rows = rows_of(with_degrees)
    assert [rows[str(day)]["status"] for day in range(5)] == ["identified"] * 2 + ["unfit"] + ["identified"] * 2
    bad = rows["2"]
    assert bad["verdict"] == "unfit" and bad["reason"].startswith("data unfit: ") and "->" in bad["reason"]
    assert bad["recorded"] == "2025-01-03T00:00:00+00:00", "the facts are there, the figures are not"
    assert bad["parameters"] is None and bad["relative_rms"] is None and bad["r"] is None
    again = Path(shutil.copytree(with_degrees, tmp_path / "out"))
    assert batch(*(row["bag"] for row in rows.values()), "--out", again) == 1, "nor is it good the second time"
    out = capsys.readouterr().out
    assert "4 of 5 bags identified" in out and f"unfit: {bad['reason']}" in out
    assert rows_of(again)["2"]["skipped"] and rows_of(again)["2"]["reason"] == bad["reason"]


def test_runs_of_unfit_data_are_in_no_trend_and_no_comparison(with_degrees):
    document = json.loads((with_degrees / "summary.json").read_text())
    assert {one["runs"] for one in document["trends"]} == {4}
    before = (with_degrees / "index.html").read_bytes()
    text = text_of(with_degrees / "index.html")
    assert rows_of(with_degrees)["2"]["reason"] in text and "Trends of small_arm 4 runs" in " ".join(text.split())
    page = Page(before.decode())
    assert "./2/report.html" in page.references, "its own page says more"
    assert main(["report", str(with_degrees), "--quiet"]) == 0
    assert (with_degrees / "index.html").read_bytes() == before


def test_a_result_of_before_that_only_has_its_conventions_is_unfit_as_well(with_degrees, tmp_path):
    folder = Path(shutil.copytree(with_degrees / "2", tmp_path / "2"))
    data = json.loads((folder / "result.json").read_text())
    said = data.pop("unfit")
    (folder / "result.json").write_text(json.dumps(data))
    assert load_result(folder).unfit[0] == said[0] == load_result(with_degrees / "2").unfit[0]


# --- recordings with issues, and logs ---------------------------------------------------------------------------


def test_what_is_wrong_with_a_recording_that_can_be_used_is_in_its_row(tmp_path, capsys):
    fleet, out = tmp_path / "fleet", tmp_path / "out"
    fleet.mkdir()
    run = replace(dated(0), effort=np.where(np.arange(800)[:, None] == 400, np.nan, dated(0).effort))
    write_recording(fleet / "nan.mcap", run)
    write_recording(fleet / "whole.mcap", dated(1))
    write_recording(fleet / "cut.mcap", dated(2))
    whole = (fleet / "cut.mcap").read_bytes()
    (fleet / "cut.mcap").write_bytes(whole[: int(0.9 * len(whole))])
    assert batch(fleet, "--out", out) == 0
    shown, rows, page = capsys.readouterr().out, rows_of(out), text_of(out / "index.html")
    assert rows["whole"]["issues"] == []
    table = {one["run"]: one["issues"] for one in csv.DictReader((out / "summary.csv").open())}
    for name, word in (("nan", "NaN"), ("cut", "breaks off")):
        (issue,) = rows[name]["issues"]
        assert word in issue and issue in shown and issue in page and issue == table[name]


def test_how_a_recording_was_read_is_no_issue_of_it(tmp_path):
    with_issues = replace(dated(0), issues=(Issue("log", "columns read as time s"), Issue("gap", "1 gap", where_s=2.0)))
    (found,) = recorded_runs([with_issues], [], small_arm.identified().model.arm)
    assert found.defects == ("1 gap (from 2.000 s)",) and found.read_as == ("columns read as time s",)


def test_a_folder_of_logs_without_a_mapping_is_told_what_it_lacks(tmp_path, capsys):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t,q1\n0,0\n")
    assert batch(tmp_path, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "2 logs without a mapping" in said and f"spacearm import {tmp_path / 'a.csv'}" in said
    assert "mapping.yaml" in said and "docs/logs.md" in said and len(said.splitlines()) == 1


# --- usage ------------------------------------------------------------------------------------------------------


def test_usage_errors_are_said_before_anything_is_done(bags, tmp_path, capsys):
    out = tmp_path / "out"
    (tmp_path / "empty").mkdir()
    for words, said in (
        ([tmp_path / "nowhere"], "no such file or folder"),
        ([tmp_path / "empty"], "no bag in it"),
        ([bags, "--arm", tmp_path / "none.urdf"], "none.urdf"),
        ([bags, "--structure", tmp_path / "none.yaml"], "none.yaml"),
        ([bags, "--jobs", 0], "at least one"),
    ):
        assert main(["batch", *map(str, words), "--out", str(out)]) == 2
        assert said in capsys.readouterr().err
    assert not out.exists()


def test_bags_are_found_in_folders_and_named_apart(tmp_path):
    for name in ("x/run.mcap", "y/run.mcap", "x/split/run_0.mcap", "x/split/run_1.mcap", "y/.hidden/no.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "x" / "split" / "metadata.yaml").touch()
    assert set(find_bags([tmp_path])) == {"x/run", "y/run", "x/split"}
    apart = find_bags([tmp_path / "x", tmp_path / "y" / "run.mcap", tmp_path / "x" / "run.mcap"])
    assert {name: bag.relative_to(tmp_path).as_posix() for name, bag in apart.items()} == {
        "x/run.mcap": "x/run.mcap",
        "y/run.mcap": "y/run.mcap",
        "split": "x/split",
    }


# --- side by side -----------------------------------------------------------------------------------------------


def test_a_task_that_kills_its_process_does_not_take_the_others_along():
    tasks = ["one", "kill", "two", "three"]
    outcomes = dict(on_cores(pool_tasks.perform, tasks, 2))
    assert isinstance(outcomes.pop("kill"), Lost)
    assert outcomes == {"one": "ONE", "two": "TWO", "three": "THREE"}


def test_a_process_killed_from_outside_costs_nothing(tmp_path):
    marker = tmp_path / "killed"
    assert dict(on_cores(pool_tasks.dies_once, [str(marker)], 1)) == {str(marker): "alive"}


def test_processes_have_one_blas_thread_and_leave_ours_alone(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert dict(on_cores(pool_tasks.variable, ["OMP_NUM_THREADS"], 1)) == {"OMP_NUM_THREADS": "1"}
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ


def test_without_dask_a_scheduler_is_refused_in_one_line(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert batch(bags / "a.mcap", "--out", tmp_path, "--scheduler", "tcp://127.0.0.1:1") == 2
    assert "pip install 'spacearm_ident[dask]'" in capsys.readouterr().err


def test_a_cluster_does_the_same(bags, done, tmp_path, monkeypatch, capsys):
    distributed = pytest.importorskip("distributed", reason="needs dask.distributed (pip install distributed)")
    with distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None) as cluster:
        assert dict(on_cluster(pool_tasks.perform, ["one"], cluster.scheduler_address)) == {"one": "ONE"}
        words = (bags / "a.mcap", bags / "text.mcap", "--out", tmp_path, "--scheduler", cluster.scheduler_address)
        assert batch(*words) == 1
    assert (tmp_path / "a" / "parameters.csv").read_bytes() == (done / "a" / "parameters.csv").read_bytes()
    assert rows_of(tmp_path)["text"]["reason"] == rows_of(done)["text"]["reason"]
    monkeypatch.setattr("spacearm_ident.sessions.side_by_side.CONNECT_S", 0.5)
    assert batch(*words) == 2
    assert "no Dask scheduler at" in capsys.readouterr().err


# --- trends -----------------------------------------------------------------------------------------------------


def test_friction_that_was_planted_over_dates_is_found_and_no_other(tmp_path, monkeypatch):
    monkeypatch.setattr("spacearm_ident.report.folder.report_html", lambda result: "a page")
    rows = []
    for day in range(6):
        bag = tmp_path / f"{day}.mcap"
        write_recording(bag, dated(day, warm=20.0 + 5.0 * (day % 2)))
        rows.append(perform(Task(str(day), bag, tmp_path / "out" / str(day), Options(friction="coulomb-viscous"))))
    document = write_summary(tmp_path / "out", rows)
    over = {(one["over"], one["parameter"]): one for one in document["trends"]}
    gain = over["date", "f_c[elbow]"]
    assert abs(gain["slope"] - GAIN) < 4 * gain["standard_error"] < 0.2 * GAIN
    assert gain["unit"] == "N m / day" and gain["p_value"] < 0.01 and not gain["is_step"]
    others = [one for one in document["trends"] if one["over"] == "date" and one is not gain]
    assert others and not any(one["p_value"] < 0.01 or one["is_step"] for one in others)
    assert not any(one["p_value"] < 0.01 for one in document["trends"] if one["over"] == "temperature")
    assert not any(key[0] == "temperature" and key[1].endswith("[shoulder]") for key in over), "none was recorded"
    text = text_of(tmp_path / "out" / "index.html")
    start = text.index("Over the date of recording")
    assert "f_c[elbow]" in text[start : text.index("Over the joint's mean temperature")]
    assert "Trends of small_arm" in text and "Friction levels" in text
