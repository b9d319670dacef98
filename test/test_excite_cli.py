"""`spacearm excite` as a user meets it: the file it writes, what reads it, and one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import small_arm
import yaml

from spacearm_ident.cli.excite import METHODS
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.excitation.genetic import evolve
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.run import check_limits, limits_of, plan_run
from spacearm_ident.excitation.segments import Chirp
from spacearm_ident.excitation.trajectory import FourierTrajectory
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.recording import read_recording

QUICK = ("--harmonics", "2", "--fundamental", "0.5", "--periods", "1", "--quiet")
START = ("--start", "0.1", "-0.2")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(small_arm.URDF)
    description = {
        "schema": "spacearm_ident/arm/1",
        "urdf": "arm.urdf",
        "joints": {name: {"acceleration_limit_rad_s2": 6.0, "velocity_limit_rad_s": 2.0} for name in small_arm.JOINTS},
    }
    (folder / "arm.yaml").write_text(yaml.safe_dump(description))
    known = nominal_model(arm_from_urdf(small_arm.URDF))
    values = {"f_c": 3.0, "f_b": 4.0, "k_v1": 2.0, "J_m": 0.4}
    parameters = np.array([values.get(p.symbol, p.prior) for p in known.model.parameters])
    constants = np.array([0.2 if c.symbol == "v_b" else 0.0 for c in known.model.constants])
    save_model(replace(known, parameters=parameters, constants=constants), folder / "model.yaml")
    return folder


def excite(capsys, *words, expect=0):
    code = main(["excite", *(str(word) for word in words)])
    out, err = capsys.readouterr()
    assert code == expect, err
    return out, err


def test_the_file_loads_in_the_trajectory_node_and_in_the_simulated_arm(arm, tmp_path, capsys):
    path = tmp_path / "traj.yaml"
    words = ("--arm", arm / "arm.yaml", "--model", arm / "model.yaml", "--out", path, *START, *QUICK)
    out, err = excite(capsys, *words)
    assert err == ""
    assert "<- optimised" in out and "all limits of 2 joints kept" in out and "v_b[elbow]" in out
    run = load_trajectory(path)
    np.testing.assert_allclose(run.evaluate(0.0).q[0], [0.1, -0.2])
    # What the node does before it moves anything.
    limits = limits_of(arm_from_urdf(small_arm.URDF), run.joints)
    plan = plan_run(run, limits, np.array([0.05, -0.1]))
    check_limits(run.joints, plan.set_points(250.0), limits, 250.0)
    assert plan.periods == 1
    bag = tmp_path / "run.mcap"
    assert (
        main(["simulate", "--model", str(arm / "model.yaml"), "--trajectory", str(path), "--out", str(bag), "--quiet"])
        == 0
    )
    recording = read_recording(bag)
    assert recording.time[-1] == pytest.approx(run.duration_s, abs=0.01)
    assert np.abs(recording.position - run.evaluate(recording.time).q).max() < 0.05


def test_json_tells_criteria_margins_and_errors(arm, tmp_path, capsys):
    path = tmp_path / "traj.yaml"
    words = (
        "--arm",
        arm / "arm.yaml",
        "--model",
        arm / "model.yaml",
        "--criterion",
        "d-optimal",
        "--jerk",
        "60",
        "--slow",
        "1",
    )
    out, _ = excite(capsys, *words, "--structural-frequency", "3", "--out", path, *START, *QUICK, "--json")
    told = json.loads(out)
    assert set(told["criteria"]) == {"condition", "scaled-condition", "d-optimal", "prediction"}
    kinds = {margin["kind"] for margin in told["margins"]}
    assert kinds == {"position", "velocity", "acceleration", "jerk", "torque", "frequency", "clearance"}
    assert all(margin["used"] <= 1 + 1e-6 for margin in told["margins"])
    assert set(told["constants_relative_error"]) == {"v_b[shoulder]", "v_b[elbow]"}
    assert told["duration_s"] == pytest.approx(load_trajectory(path).duration_s)
    assert sum(isinstance(segment, FourierTrajectory) for segment in load_trajectory(path).segments) == 2


def test_seeds_repeat_and_differ(arm, tmp_path, capsys):
    series = []
    for name, words in (("a", ("--seed", 1)), ("b", ("--seed", 1)), ("c", ("--seed", 2))):
        excite(capsys, "--arm", arm / "arm.yaml", "--out", tmp_path / name, *START, *QUICK, *words)
        series.append(yaml.safe_load((tmp_path / name).read_text()))
    assert series[0] == series[1] != series[2]


def test_terms_that_the_optimiser_does_without_are_named(arm, tmp_path, capsys):
    """A term of a kind that `smooth_columns` does not know, and a column of a kind that it does."""
    known = load_model(arm / "model.yaml")
    further = {"stribeck_friction": {"load": True}, "torque_ripple": {"at": [{"joint": "elbow"}]}}
    wider = known.carried_to(TorqueModel(known.model.arm, {**known.model.structure, **further}))
    save_model(wider, tmp_path / "wider.yaml")
    quick = [word for word in QUICK if word != "--quiet"]
    for model, named in ((arm / "model.yaml", False), (tmp_path / "wider.yaml", True)):
        words = ("--arm", arm / "arm.yaml", "--model", model, "--out", tmp_path / "t.yaml", *START, *quick)
        _, err = excite(capsys, *words)
        assert ("optimised without these terms" in err) == named
        assert ("friction that grows with the load, torque ripple over the joint's position" in err) == named


def test_the_genetic_algorithm_can_be_asked_for(arm, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(METHODS, "genetic", partial(evolve, population=8, generations=3))
    words = ("--arm", arm / "arm.yaml", "--optimiser", "genetic", "--criterion", "condition")
    out, _ = excite(capsys, *words, "--out", tmp_path / "t.yaml", *START, *QUICK)
    assert "all limits of 2 joints kept" in out
    load_trajectory(tmp_path / "t.yaml")


def test_auto_tells_what_each_number_of_harmonics_gave(arm, tmp_path, capsys):
    words = (
        "--arm",
        arm / "arm.yaml",
        "--fundamental",
        "0.4",
        "--periods",
        "1",
        "--structural-frequency",
        "1.7",
        *START,
    )
    out, err = excite(capsys, *words, "--out", tmp_path / "t.yaml")
    assert "\nprediction by number of harmonics 3: " in out and "4: " in out
    assert "pairs, from capsules" in out + err and "torque from CAD inertials alone" in out + err


def test_a_composite_run_is_written_and_its_spectrum_told(arm, tmp_path, capsys):
    path = tmp_path / "chirp.yaml"
    out, _ = excite(
        capsys, "--arm", arm / "arm.yaml", "--for", "elasticity", "--joints", "elbow", "--out", path, *START, "--quiet"
    )
    assert "0.5-2, 2-5, 5-10 and 10-20 Hz" in out
    assert sum(isinstance(segment, Chirp) for segment in load_trajectory(path).segments) == 4
    out, _ = excite(capsys, "--arm", arm / "arm.yaml", "--for", "stribeck", "--out", path, *START, "--quiet", "--json")
    assert json.loads(out)["purpose"] == "stribeck"


def test_in_orbit_there_is_no_floor(arm, tmp_path, capsys):
    hanging = ("--arm", arm / "arm.yaml", "--for", "presliding", "--out", tmp_path / "t.yaml", "--start", "2.9", "0.0")
    _, err = excite(capsys, *hanging, expect=2)
    assert "clearance of" in err and "ground" in err
    excite(capsys, *hanging, "--gravity", 0, 0, 0)
    excite(capsys, *hanging, "--ground", "none")
    excite(capsys, *hanging, "--ground", "-3")


ERRORS = {
    "no arm": ((), "no arm: give --arm"),
    "two starts for a wrong number": (("--arm", "{arm}", "--start", "1", "2", "3"), "--start has 3 numbers"),
    "jerk of zero": (("--arm", "{arm}", "--jerk", "0"), "--jerk must be above zero"),
    "harmonics in words": (("--arm", "{arm}", "--harmonics", "many"), "--harmonics 'many' is neither"),
    "too high": (("--arm", "{arm}", "--harmonics", "9", "--structural-frequency", "0.5"), "--harmonics 5 at most"),
    "ground in words": (("--arm", "{arm}", "--ground", "grass"), "--ground 'grass' is neither"),
    "no such joint": (("--arm", "{arm}", "--for", "ripple", "--joints", "knee"), "joint 'knee' is not the arm's"),
    "joints without for": (("--arm", "{arm}", "--joints", "elbow"), "--joints goes with --for"),
    "outside": (("--arm", "{arm}", "--start", "4", "0"), "position of shoulder: 4 rad"),
    "negative frequency": (("--arm", "{arm}", "--fundamental", "-1"), "--fundamental -1 must be above zero"),
    "no period": (("--arm", "{arm}", "--periods", "0"), "--periods must be at least 1"),
    "nowhere to write": (("--arm", "{arm}", *QUICK, "--out", "{arm}/x.yaml"), "cannot be written"),
}


@pytest.mark.parametrize(("words", "message"), ERRORS.values(), ids=ERRORS.keys())
def test_errors_are_one_line_that_says_what_to_do(words, message, arm, tmp_path, capsys):
    given = [word.replace("{arm}", str(arm / "arm.yaml")) for word in words]
    out = [] if "--out" in words else ["--out", tmp_path / "t.yaml"]
    _, err = excite(capsys, *given, *out, "--quiet", expect=2)
    assert message in err and err.count("\n") == 1 and err.startswith("spacearm: ")
    assert not (tmp_path / "t.yaml").exists()


def test_a_model_of_another_arm_is_refused(arm, tmp_path, capsys):
    other = tmp_path / "other.urdf"
    other.write_text(small_arm.URDF.replace('"elbow"', '"knee"'))
    words = ("--arm", other, "--model", arm / "model.yaml", "--out", tmp_path / "t.yaml")
    _, err = excite(capsys, *words, expect=2)
    assert "is of an arm with the joints shoulder, elbow" in err
