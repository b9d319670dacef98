"""The offline command as a user meets it: exit codes, one-line errors, files, JSON."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import small_arm
from made_result import Page

from spacearm_ident.cli import common
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.recording import write_recording


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    run, other = small_arm.recording(seed=0), small_arm.recording(seed=1)
    nan = run.effort.copy()
    nan[100:105, 0] = np.nan
    made = {
        "run": run,
        "other": other,
        "still": small_arm.recording(still=(0, 1)),
        "one_still": small_arm.recording(still=(0,)),
        "no_torque": replace(run, effort=np.zeros_like(run.effort)),
        "no_urdf": replace(run, urdf=None),
        "short": replace(run.between(0, 1.5), segments=(slice(0, 300),)),
        "nan": replace(run, effort=nan),
        "stranger": replace(run, joints=("a", "b")),
    }
    paths = {name: folder / f"{name}.mcap" for name in made}
    for name, recording in made.items():
        write_recording(paths[name], recording)
    whole = paths["run"].read_bytes()
    paths["cut"] = folder / "cut.mcap"
    paths["cut"].write_bytes(whole[: int(0.7 * len(whole))])
    paths["text"] = folder / "text.mcap"
    paths["text"].write_text("this is not a bag")
    return paths


def run(*words: object, expect: int, capsys) -> tuple[str, str]:
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert code == expect, err
    return out, err


def test_identify_writes_everything_the_contract_names(bags, tmp_path, capsys):
    out, _ = run("identify", bags["run"], "--validate", bags["other"], "--out", tmp_path, expect=0, capsys=capsys)
    assert str(tmp_path / "report.html") in out
    validation = json.loads((tmp_path / "validation.json").read_text())
    assert validation["bags"] == [str(bags["other"])]
    for joint in small_arm.JOINTS:
        figures = validation["joints"][joint]
        assert {"rmse_Nm", "mae_Nm", "max_Nm", "r", "relative_rms"} <= set(figures["moving"]) & set(figures)
        assert figures["moving"]["relative_rms"] < 0.02
        assert figures["moving"]["r"] > 0.999
    rows = {(row["name"], row["joint"]): row for row in csv.DictReader((tmp_path / "parameters.csv").open())}
    for joint, truth in zip(small_arm.JOINTS, small_arm.COULOMB):
        row = rows["f_c", joint]
        assert row["identifiable"] == "yes"
        assert abs(float(row["value"]) - truth) < 4 * float(row["standard_error"])
    assert pin.buildModelFromUrdf(str(tmp_path / "identified.urdf")).nv == 2
    assert load_model(tmp_path / "model.yaml").provenance["fitted_on"][0]["path"] == str(bags["run"])


def test_json_goes_to_standard_output_alone(bags, tmp_path, capsys):
    out, _ = run("identify", bags["run"], "--out", tmp_path, "--json", expect=0, capsys=capsys)
    result = json.loads(out)
    assert result["held_out"] is True
    assert set(result["joints"]) == set(small_arm.JOINTS)


def test_several_bags_know_more_than_one(bags, tmp_path, capsys):
    def error(*fitted: str) -> float:
        words = ["identify", *(bags[name] for name in fitted), "--validate", bags["other"], "--out", tmp_path]
        run(*words, expect=0, capsys=capsys)
        rows = csv.DictReader((tmp_path / "parameters.csv").open())
        return next(float(r["standard_error"]) for r in rows if (r["name"], r["joint"]) == ("k_v1", "elbow"))

    assert error("run", "nan") < error("run")


def test_gravity_is_taken_from_the_command(bags, tmp_path, capsys):
    run("identify", bags["run"], "--gravity", 0, 0, -1.62, "--out", tmp_path, expect=0, capsys=capsys)
    model = load_model(tmp_path / "model.yaml")
    np.testing.assert_array_equal(model.model.arm.gravity, [0, 0, -1.62])


def test_damaged_bags_are_used_as_far_as_they_are_sound(bags, tmp_path, capsys):
    for name, said in (("cut", "cut"), ("nan", "NaN")):
        _, err = run("identify", bags[name], "--out", tmp_path / name, expect=0, capsys=capsys)
        assert said.lower() in err.lower()
        assert (tmp_path / name / "model.yaml").exists()


def test_a_joint_at_rest_is_a_stated_degradation(bags, tmp_path, capsys):
    out, _ = run("identify", bags["one_still"], "--out", tmp_path, expect=0, capsys=capsys)
    assert "shoulder does not move" in out
    (figures,) = [line for line in out.splitlines() if line.startswith("shoulder  ")]
    assert figures.split()[-1] == "-" and "nan" not in out
    rows = {(row["name"], row["joint"]): row for row in csv.DictReader((tmp_path / "parameters.csv").open())}
    assert rows["f_c", "shoulder"]["identifiable"] == "no"
    assert rows["f_c", "elbow"]["identifiable"] == "yes"


@pytest.mark.parametrize(
    ("bag", "code", "says"),
    [
        ("missing", 2, "no such"),
        ("text", 2, "not an MCAP"),
        ("no_urdf", 2, "--arm"),
        ("still", 1, "no joint moves"),
        ("no_torque", 1, "every torque is zero"),
        ("short", 1, "too short"),
    ],
)
def test_unusable_bags_are_refused_in_one_line(bags, tmp_path, capsys, bag, code, says):
    path = bags.get(bag, tmp_path / "missing.mcap")
    # --quiet: on a busy machine the progress lines, one each ten seconds, would stand before the error.
    out, err = run("identify", path, "--out", tmp_path / "out", "--quiet", expect=code, capsys=capsys)
    assert says.lower() in err.lower()
    assert err.startswith("spacearm: ") and err.count("\n") == 1
    assert out == ""
    assert not (tmp_path / "out").exists()


def test_an_arm_that_does_not_fit_is_named(bags, tmp_path, capsys):
    _, err = run("identify", bags["stranger"], "--out", tmp_path / "out", expect=2, capsys=capsys)
    assert "shoulder" in err and "--arm" in err
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot><link></robot>")
    words = (bags["run"], "--arm", broken, "--out", tmp_path / "out", "--quiet")
    _, err = run("identify", *words, expect=2, capsys=capsys)
    assert "URDF" in err and err.count("\n") == 1


def test_a_result_that_cannot_be_written_leaves_nothing_behind(bags, tmp_path, capsys):
    blocker = tmp_path / "file"
    blocker.write_text("in the way")
    _, err = run("identify", bags["run"], "--out", blocker / "out", expect=2, capsys=capsys)
    assert "--out" in err
    assert blocker.read_text() == "in the way"


def test_report_needs_a_result_folder(tmp_path, capsys):
    _, err = run("report", tmp_path, expect=2, capsys=capsys)
    assert str(tmp_path) in err


def test_simulate_records_what_identify_reads(tmp_path, capsys):
    config = Path(__file__).parent.parent / "config"
    trajectory = tmp_path / "rest.yaml"
    trajectory.write_text(
        "schema: spacearm_ident/trajectory/1\n"
        f"joints: [{', '.join(f'joint_{k}' for k in range(1, 7))}]\n"
        "segments:\n- {kind: rest, duration_s: 0.5, position: [0, 0, 0, 0, 0, 0]}\n"
    )
    words = ["simulate", "--model", config / "paper_arm_model.yaml", "--arm", config / "paper_arm.yaml"]
    out, _ = run(*words, "--trajectory", trajectory, "--out", tmp_path / "bag.mcap", "--json", expect=0, capsys=capsys)
    assert json.loads(out)["samples"] == 501
    _, err = run("identify", tmp_path / "bag.mcap", "--out", tmp_path / "out", expect=1, capsys=capsys)
    assert "too short" in err


@pytest.mark.parametrize("command", ["identify", "simulate", "report", "demo", "node", "excite", "mismatch"])
def test_every_level_has_help(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert command in capsys.readouterr().out


def test_usage_errors_exit_with_2():
    pytest.importorskip("clarabel", reason="the command needs clarabel: README.md, ROS 2 Jazzy")
    for words in ([], ["identify"], ["identify", "x.mcap"], ["nonsense"]):
        done = subprocess.run([sys.executable, "-m", "spacearm_ident.cli.main", *words], capture_output=True)
        assert done.returncode == 2


def test_a_step_that_reports_nothing_for_long_has_lines_of_progress_where_piped(monkeypatch, capsys):
    monkeypatch.setattr(common, "LINE_EVERY_S", 0.02)
    with common.progress(Namespace(quiet=False)) as report:
        report(0.2, "comparing effects")
        end = time.monotonic() + 30.0
        lines = ""
        while lines.count("comparing effects") < 2 and time.monotonic() < end:
            time.sleep(0.02)
            lines += capsys.readouterr().err
    assert lines.count(" 20%") >= 2
    time.sleep(0.1)
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == "", "none after the end"


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: nothing is shared")
@pytest.mark.parametrize("terminal", [True, False])
def test_progress_leaves_a_command_all_cores(terminal):
    """In a process of its own, as the command is: its only other thread is the one that shows progress."""
    program = (
        "import os, time\n"
        "from argparse import Namespace\n"
        "from spacearm_ident.cli import common\n"
        "from spacearm_ident.forks import each\n"
        "with common.progress(Namespace(quiet=False)) as report:\n"
        "    report(0.2, 'comparing effects')\n"
        "    processes = set(each(lambda _: (time.sleep(0.02), os.getpid())[1], range(20)))\n"
        "print(len(processes))\n"
    )
    environment = {**os.environ, "TERM": "xterm", **({"FORCE_COLOR": "1"} if terminal else {})}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    assert int(done.stdout) > 1
    assert ("comparing effects" in done.stderr) == terminal, "the bar is drawn, and a line comes later"


def test_the_command_says_the_verdict_first_and_describes_its_recordings_last(bags, tmp_path):
    """Both streams in one, as in a terminal; no library's warning among them."""
    words = ["identify", bags["run"], "--validate", bags["other"], "--out", tmp_path / "result"]
    command = [sys.executable, "-m", "spacearm_ident.cli.main", *map(str, words)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True)
    lines = [line for line in done.stdout.splitlines() if not line.lstrip()[:3].rstrip("%").isdigit()]
    assert lines[0].startswith("Good fit.") and lines[1].startswith("next: ") and lines[2].startswith("report: ")
    assert "Warning" not in done.stdout and "with velocity" in lines[-1]


def test_of_unfit_data_the_command_says_that_alone_and_nothing_for_the_model(tmp_path, capsys):
    for seed in (0, 1):
        run_ = small_arm.recording(seed=seed)
        degrees = replace(run_, position=np.degrees(run_.position), velocity=np.degrees(run_.velocity))
        write_recording(tmp_path / f"{seed}.mcap", degrees)
    words = ["identify", tmp_path / "0.mcap", "--validate", tmp_path / "1.mcap", "--out", tmp_path / "out", "--quiet"]
    words += ["--friction", "coulomb-viscous"]
    out, _ = run(*words, expect=1, capsys=capsys)
    lines = out.splitlines()
    assert lines[0].startswith("data unfit: ") and lines[1].startswith("next: apply the remedies below (->)")
    assert lines[2] == f"report: {tmp_path / 'out' / 'report.html'}"
    assert any("->" in line for line in lines[3:]) and "do not use the model" in out
    told = json.loads(run(*words, "--json", expect=1, capsys=capsys)[0])
    assert told["verdict"] == "unfit" and told["headline"] == lines[0] and "do not use the model" in told["reasons"][-1]
    assert not told["conventions"]["fit"] and "spacearm export" not in out
    kept = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert (kept["verdict"], kept["headline"], kept["reasons"]) == ("unfit", lines[0], told["reasons"])
    for _ in ("as written", "as written again from the folder alone"):
        words_of_page = Page((tmp_path / "out" / "report.html").read_text()).text
        assert lines[0] in words_of_page and "do not use the model" in words_of_page and "Good fit" not in words_of_page
        assert main(["report", str(tmp_path / "out"), "--quiet"]) == 0


@pytest.mark.parametrize(
    "values, places",
    [((2.3, 0.031), 3), ((0.02, 0.0004, float("nan"), 0.0), 5), ((8123.0, 0.0004), 3), ((41.0, 0.0004), 5), ((), 3)],
)
def test_small_torques_of_a_table_keep_two_digits_where_there_is_room(values, places):
    assert common.decimals(values) == places
