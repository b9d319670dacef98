"""Results that can be trusted later: whole or not there, one to a folder, traced, and repeated to the last digit."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml
from mcap.reader import make_reader
from test_excite_cli import QUICK
from test_excite_cli import arm as arm

from spacearm_ident.cli.main import main
from spacearm_ident.documents import file_sha256
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.recording import read_recording, write_recording
from spacearm_ident.report import folder
from spacearm_ident.report.folder import replacing, rewrite_report
from spacearm_ident.results.store import load_result

SAME = ("model.yaml", "parameters.csv", "base_parameters.csv", "validation.json", "covariance.json", "identified.urdf")


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    made = tmp_path_factory.mktemp("runs")
    for seed in range(2):
        write_recording(made / f"run {seed}.mcap", small_arm.recording(8.0, seed=seed))
    return sorted(made.iterdir())


@pytest.fixture(scope="module")
def written(runs, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("result") / "out"
    words = ["identify", str(runs[0]), "--validate", str(runs[1]), "--gravity", "0", "0", "-9.8", "--out", str(out)]
    assert main([*words, "--quiet"]) == 0
    return out


def content(directory: Path, names=SAME) -> dict[str, bytes]:
    return {name: (directory / name).read_bytes() for name in names}


def test_the_model_tells_where_it_comes_from(written, runs):
    known = load_model(written / "model.yaml").provenance
    assert [(source["path"], source["sha256"]) for source in known["fitted_on"]] == [
        (str(runs[0]), file_sha256(runs[0]))
    ]
    assert known["validated_on"][0]["sha256"] == file_sha256(runs[1])
    assert shlex.split(known["command"])[:3] == ["spacearm", "identify", str(runs[0])]
    assert {"spacearm_ident", "python", "numpy", "scipy"} <= set(known["versions"])


def test_the_recorded_command_gives_the_same_numbers_to_the_last_digit(written, tmp_path):
    """In a process of its own, and into the same folder: what is there is the same again, byte for byte."""
    before = content(written)
    arrays = dict(np.load(written / "result.npz"))
    command = shlex.split(load_model(written / "model.yaml").provenance["command"])
    subprocess.run([sys.executable, "-m", "spacearm_ident.cli.main", *command[1:]], check=True, cwd=tmp_path)
    assert content(written) == before
    again = np.load(written / "result.npz")
    assert set(arrays) == set(again) and all(np.array_equal(arrays[name], again[name]) for name in arrays)


# --- one result to a folder -----------------------------------------------------------------------------------


@pytest.fixture
def result(written, tmp_path) -> Path:
    """A copy of the result, with a file of the user's beside it."""
    out = tmp_path / "result"
    out.mkdir()
    for path in written.iterdir():
        (out / path.name).write_bytes(path.read_bytes())
    (out / "notes.txt").write_text("mine")
    return out


def test_a_result_of_another_command_replaces_the_whole_result(result):
    with replacing(result, "mismatch.json") as staging:
        for name in ("mismatch.json", "report.html"):
            (staging / name).write_text("{}")
    assert {path.name for path in result.iterdir()} == {"mismatch.json", "report.html", "notes.txt"}
    with pytest.raises(UserError, match="not a result folder"):
        rewrite_report(result)


def test_what_a_result_is_made_from_is_not_replaced_by_it(result, runs, capsys):
    before = content(result)
    model = str(result / "model.yaml")
    for words in (
        ["mismatch", str(runs[0]), "--reference", model, "--out", str(result)],
        ["calibrate-temperature", str(runs[0]), "--model", model, "--out", str(result)],
    ):
        assert main(words) == 2
        assert "would be replaced: choose another --out" in capsys.readouterr().err
    assert content(result) == before


def test_two_writers_into_one_folder_take_turns(tmp_path):
    inside, go_on, order = threading.Event(), threading.Event(), []

    def first():
        with replacing(tmp_path, "result.json") as staging:
            inside.set()
            assert go_on.wait(20)
            for name in ("result.json", "model.yaml", "parameters.csv"):
                (staging / name).write_text("first")
            order.append("first")

    def second():
        with replacing(tmp_path, "result.json") as staging:
            order.append("second")
            for name in ("result.json", "model.yaml"):
                (staging / name).write_text("second")

    threads = [threading.Thread(target=first), threading.Thread(target=second)]
    threads[0].start()
    assert inside.wait(20)
    threads[1].start()
    threads[1].join(0.3)
    go_on.set()
    for thread in threads:
        thread.join(20)
    assert order == ["first", "second"]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "result.json": "second",
        "model.yaml": "second",
    }


# --- killed while writing ---------------------------------------------------------------------------------------

STALLED = """
import sys, time
from spacearm_ident.report import folder
from spacearm_ident.cli.main import main
whole = folder.%s
def stall(*arguments):
    print("writing", flush=True)
    time.sleep(60)
    return whole(*arguments)
folder.%s = stall
main(sys.argv[1:])
"""


@pytest.mark.parametrize("moment", ["report_html", "_commit"])
def test_kill_9_while_writing_leaves_the_old_result_whole_and_nothing_for_ever(moment, result, runs):
    before = content(result, (*SAME, "report.html", "result.json", "result.npz"))
    words = ["identify", str(runs[1]), "--out", str(result), "--quiet"]
    process = subprocess.Popen([sys.executable, "-c", STALLED % (moment, moment), *words], stdout=subprocess.PIPE)
    assert process.stdout is not None and process.stdout.readline() == b"writing\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(20)
    process.stdout.close()
    assert content(result, before) == before
    load_result(result)
    assert any(path.name.startswith(folder._STAGING) for path in result.iterdir())
    rewrite_report(result)
    assert not any(path.name.startswith(folder._STAGING) for path in result.iterdir())


def test_a_trajectory_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    from spacearm_ident.excitation import trajectory_file
    from spacearm_ident.excitation.segments import Rest
    from spacearm_ident.excitation.trajectory import Trajectory

    path = tmp_path / "motion.yaml"
    trajectory = Trajectory(("a",), (Rest(np.zeros(1), 1.0),))
    trajectory_file.save_trajectory(trajectory, path, ["made by\nme"])
    before = path.read_bytes()
    assert before.startswith(b"# made by me\nschema: ")

    def lose_power(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", lose_power)
        with pytest.raises(KeyboardInterrupt):
            trajectory_file.save_trajectory(trajectory, path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


# --- the other commands -----------------------------------------------------------------------------------------


def test_an_excitation_and_a_simulated_bag_tell_how_they_were_made_and_repeat(arm, tmp_path):
    model, known = arm / "model.yaml", arm / "arm.yaml"
    motion, bags = tmp_path / "motion.yaml", [tmp_path / f"{k}.mcap" for k in range(2)]
    assert main(["excite", "--arm", str(known), "--model", str(model), *QUICK, "--out", str(motion)]) == 0
    lines = motion.read_text().splitlines()
    assert lines[0].startswith("# spacearm excite --arm")
    assert file_sha256(known) in lines[2] and file_sha256(model) in lines[3]
    assert load_trajectory(motion).duration_s > 0
    for bag in bags:
        assert main(["simulate", "--model", str(model), "--trajectory", str(motion), "--out", str(bag)]) == 0
    one, other = (read_recording(bag) for bag in bags)
    assert np.array_equal(one.effort, other.effort) and np.array_equal(one.position, other.position)
    with bags[0].open("rb") as file:
        (record,) = make_reader(file).iter_metadata()
    assert record.name == "origin" and record.metadata["0"].startswith("spacearm simulate")
    assert {file_sha256(model), file_sha256(motion)} <= {
        word for line in record.metadata.values() for word in line.split()
    }


def test_a_temperature_calibration_is_traced(tmp_path, capsys):
    from test_temperature import SWEEP, bag

    paths = []
    for warm in SWEEP:
        paths.append(tmp_path / f"{warm:g}.mcap")
        write_recording(paths[-1], bag(warm))
    out = tmp_path / "out"
    words = ["calibrate-temperature", *map(str, paths), "--out", str(out), "--quiet"]
    assert main(words) == 0
    first = (out / "temperature.json").read_bytes()
    known = json.loads(first)["provenance"]
    assert known["command"] == shlex.join(["spacearm", *words])
    assert [source["sha256"] for source in known["fitted_on"]] == [file_sha256(path) for path in paths]
    assert main(words) == 0
    assert (out / "temperature.json").read_bytes() == first


def test_a_model_file_is_yaml_that_names_its_schema(written):
    assert yaml.safe_load((written / "model.yaml").read_text())["schema"] == "spacearm_ident/model/1"
