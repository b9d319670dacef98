"""What a model is worth: by its residual, and by whether an arm could be what it says."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import small_arm
from made_result import arm, fit, identification, identified_model, validation
from planted_arm import Friction, two_link_run

from spacearm_ident.blas_threads import VARIABLES
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.friction_curve import friction_curve, friction_error, viscosity
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Identified, JointValidation, Validation
from spacearm_ident.identification.verdict import HELD, IMPOSSIBLE, Level, judge_result
from spacearm_ident.recording import Recording, write_recording
from spacearm_ident.results.tables import validation_dict
from spacearm_ident.sessions.bags import Options
from spacearm_ident.sessions.identification import Session, identify_session


@pytest.fixture(scope="module")
def made() -> tuple[Identified, Validation]:
    model = identified_model(arm())
    return identification(model), validation(model.model.arm.joint_names)


def with_moving(figures: Validation, turn: float, slide: float) -> Validation:
    joints = {name: JointValidation(fit(0.9), fit(share), fit()) for name, share in (("turn", turn), ("slide", slide))}
    return replace(figures, joints=joints)


@pytest.mark.parametrize(
    ("worst", "level"),
    [(0.1, "good"), (0.11, "fair"), (0.25, "fair"), (0.26, "poor"), (1.0, "poor"), (1.01, "suspect")],
)
def test_verdict_is_that_of_the_worst_moving_joint(made, worst: float, level: str) -> None:
    verdict = judge_result(made[0], with_moving(made[1], 0.01, worst))
    assert verdict.level == level and verdict.headline.lower().startswith(level)
    assert {name: str(one.level) for name, one in verdict.joints.items()} == {"turn": "good", "slide": level}
    assert verdict.usable == (level in ("good", "fair"))
    assert bool(verdict.reasons) == (level in ("poor", "suspect"))
    assert all(reason.startswith("slide: ") for reason in verdict.reasons)


def test_verdict_on_the_data_of_the_fit_says_so(made) -> None:
    identified, figures = made
    own, other = (judge_result(identified, replace(figures, held_out=held)).headline for held in (False, True))
    assert "on the data of the fit itself" in own and "on the data of the fit itself" not in other


def test_verdict_is_unknown_only_where_no_joint_could_be_validated(made) -> None:
    nothing = judge_result(made[0], with_moving(made[1], math.nan, math.nan))
    assert nothing.level is Level.UNKNOWN and len(nothing.reasons) == 2
    assert judge_result(made[0], with_moving(made[1], math.nan, 0.2)).level is Level.FAIR
    missing = judge_result(made[0], replace(made[1], joints={}))
    assert missing.level is Level.UNKNOWN and "not in the validation data" in missing.reasons[0]


def test_a_joint_at_rest_is_a_reason_and_no_fault(made) -> None:
    verdict = judge_result(replace(made[0], joints_at_rest=("slide",)), with_moving(made[1], 0.01, math.nan))
    assert verdict.level is Level.GOOD and verdict.joints["slide"].level is Level.UNKNOWN
    assert any("slide: it does not move" in reason for reason in verdict.reasons)


def where_slide_ranges_over(figures: Validation, size: float) -> Validation:
    """The made validation with the slide's positions between 0 and `size`."""
    (trace,) = figures.traces
    position = trace.position.copy()
    position[:, 1] = np.linspace(0.0, size, len(position))
    return replace(figures, traces=(replace(trace, position=position),))


@pytest.mark.parametrize(("size", "level"), [(1.0, Level.POOR), (0.01, Level.UNKNOWN)])
def test_a_joint_that_moves_in_no_row_is_poor_if_its_position_moves(made, size: float, level: Level) -> None:
    figures = where_slide_ranges_over(with_moving(made[1], 0.01, 0.01), size)
    figures.joints["slide"] = JointValidation(fit(0.5), fit(math.nan, 0), fit())
    verdict = judge_result(made[0], figures)
    assert verdict.joints["slide"].level is level and verdict.usable == (level is Level.UNKNOWN)
    (reason,) = verdict.joints["slide"].reasons
    assert ("does not move" in reason) == (level is Level.UNKNOWN)


@pytest.mark.parametrize(("size", "level"), [(1.0, Level.SUSPECT), (0.01, Level.GOOD)])
def test_a_residual_above_the_torque_is_suspect_though_few_rows_count_as_moving(made, size: float, level) -> None:
    figures = where_slide_ranges_over(with_moving(made[1], 0.01, 0.01), size)
    figures.joints["slide"] = JointValidation(fit(4.77), fit(1e-10, 2), fit())
    verdict = judge_result(made[0], figures)
    assert verdict.level is level
    assert any("slide: the residual is 477 %" in reason for reason in verdict.reasons) == (level is Level.SUSPECT)


def test_a_joint_whose_speed_is_lost_in_the_fit_is_poor_and_not_said_to_be_at_rest(made) -> None:
    lost = replace(made[0], joints_at_rest=("slide",), joints_unresolved=("slide",))
    verdict = judge_result(lost, with_moving(made[1], 0.01, math.nan))
    assert verdict.level is Level.POOR and not verdict.usable
    assert "does not move" not in str(verdict.reasons) and "it moves in the data of the fit" in str(verdict.reasons)


@pytest.mark.parametrize(
    ("shift", "level", "told"), [(HELD, "good", 0), (HELD + 1, "good", 1), (IMPOSSIBLE + 1, "suspect", 1)]
)
def test_bodies_that_only_a_bound_holds_are_suspect_beyond_their_error(made, shift, level, told) -> None:
    verdict = judge_result(replace(made[0], consistency_shift=shift), with_moving(made[1], 0.01, 0.01))
    assert verdict.level == level and len(verdict.reasons) == told


def with_values(made: tuple[Identified, Validation], error: float = 1e-3, **values: float) -> Identified:
    """The made result with some parameters of its first joint changed, and one error of all friction parameters."""
    identified = made[0]
    parameters = identified.model.parameters.copy()
    names = [parameter.name for parameter in identified.model.model.parameters]
    for symbol, value in values.items():
        parameters[names.index(f"{symbol}[turn]")] = value
    covariance = np.eye(len(identified.covariance)) * error**2
    return replace(identified, model=replace(identified.model, parameters=parameters), covariance=covariance)


def test_friction_that_drives_is_suspect_whatever_the_fit(made) -> None:
    figures = with_moving(made[1], 0.01, 0.01)
    assert judge_result(with_values(made), figures).level is Level.GOOD
    verdict = judge_result(with_values(made, f_c=-3.0, f_b=-3.0, k_v1=0.5, k_v2=0.0, k_v3=0.0), figures)
    assert verdict.level is Level.SUSPECT and verdict.joints["slide"].level is Level.GOOD
    assert "friction drives" in " ".join(verdict.joints["turn"].reasons)


def test_negative_viscosity_counts_beyond_its_error_alone(made) -> None:
    figures = with_moving(made[1], 0.01, 0.01)
    values = {"f_c": 9.0, "f_b": 9.0, "k_v1": -0.5, "k_v2": 0.0, "k_v3": 0.0}
    verdict = judge_result(with_values(made, 0.01, **values), figures)
    assert verdict.level is Level.SUSPECT and "viscous friction is negative" in verdict.reasons[0]
    assert judge_result(with_values(made, 1.0, **values), figures).level is Level.GOOD


def test_negative_viscosity_counts_at_every_speed_not_at_the_largest_alone(made) -> None:
    """k_v3 makes up for k_v1 at the largest speed: what resists there drives near standstill."""
    figures = with_moving(made[1], 0.01, 0.01)
    top = max(float(np.abs(trace.velocity[trace.moving[:, 0], 0]).max()) for trace in figures.traces)
    values = {"f_c": 9.0, "f_b": 9.0, "k_v1": -0.5, "k_v2": 0.0, "k_v3": 2.0 / top**2}
    verdict = judge_result(with_values(made, 0.01, **values), figures)
    assert verdict.level is Level.SUSPECT and "viscous friction is negative: -0.5" in verdict.reasons[0]
    assert "--friction paper" in verdict.reasons[0]
    assert judge_result(with_values(made, 1.0, **values), figures).level is Level.GOOD


def test_errors_of_friction_are_those_of_its_parameters(made) -> None:
    identified = with_values(made, 0.01)
    _, [slope_error] = viscosity(identified.model, 0, np.array([0.5]), identified.covariance)
    # k_v1 and 0.25 k_v3, each with an error of 0.01; k_v2 is even and cancels.
    assert slope_error == pytest.approx(0.01 * math.hypot(1.0, 0.25))
    velocity, _ = friction_curve(identified.model, 0, 0.5, np.zeros(2))
    errors = friction_error(identified.model, 0, 0.5, np.zeros(2), identified.covariance)
    fast = np.exp(-((velocity[-1] / identified.model.value("v_b", "turn")) ** 2))
    powers = [1.0 - fast, fast, *(velocity[-1] ** order for order in (1, 2, 3))]
    assert errors[-1] == pytest.approx(0.01 * np.linalg.norm(powers))


# --- arms ---------------------------------------------------------------------------------------------------------


def session(fitted: Recording, judged: Recording, directory: Path) -> Session:
    small = arm_from_urdf(fitted.urdf)
    settings = Options(friction="coulomb-viscous", cutoff_hz=5.0).settings(small)
    return identify_session([fitted], [judged], small, settings, directory)


def negated(run: Recording, joint: int) -> Recording:
    effort = run.effort.copy()
    effort[:, joint] *= -1.0
    return replace(run, effort=effort)


def test_a_sound_arm_is_good_and_one_with_a_wrong_sign_suspect(tmp_path) -> None:
    runs = [small_arm.recording(seed=seed) for seed in (0, 1)]
    sound = session(*runs, tmp_path / "sound")
    assert judge_result(sound.identified, sound.validation).level is Level.GOOD
    for joint, name in enumerate(small_arm.JOINTS):
        wrong = session(*(negated(run, joint) for run in runs), tmp_path / name)
        verdict = judge_result(wrong.identified, wrong.validation)
        assert verdict.level is Level.SUSPECT, verdict
        assert verdict.joints[name].level is Level.SUSPECT


def test_planted_negative_viscosity_is_found(tmp_path) -> None:
    laws = [Friction(k_v1=-3.0, k_v2=0.0, k_v3=0.0, f_c=9.0), Friction(k_v2=0.0, k_v3=0.0)]
    runs = [two_link_run(laws, seed=seed).recording(0.05, seed) for seed in (0, 1)]
    result = session(*runs, tmp_path)
    verdict = judge_result(result.identified, result.validation)
    assert verdict.joints["shoulder"].level is Level.SUSPECT and verdict.joints["elbow"].level is Level.GOOD
    assert "viscous friction is negative" in verdict.reasons[0]


# --- where it is told ---------------------------------------------------------------------------------------------


def test_validation_json_has_the_verdict_of_the_whole_and_of_every_joint(made) -> None:
    told = validation_dict(made[0], with_moving(made[1], 0.01, 0.5))
    assert told["verdict"] == "poor" and told["reasons"] and told["headline"].startswith("Poor")
    assert told["joints"]["turn"]["verdict"] == "good" and told["joints"]["turn"]["reasons"] == []
    assert told["joints"]["slide"]["verdict"] == "poor" and len(told["joints"]["slide"]["reasons"]) == 1
    json.dumps(told, allow_nan=False)


@pytest.mark.parametrize("wrong", [False, True])
def test_exit_code_and_first_line_say_what_the_model_is_worth(wrong: bool, tmp_path, capsys) -> None:
    falling = [Friction(k_v1=-3.0, k_v2=0.0, k_v3=0.0, f_c=9.0), Friction(k_v2=0.0, k_v3=0.0)]
    bags = []
    for seed in (0, 1):
        run = two_link_run(falling, seed=seed).recording(0.05, seed) if wrong else small_arm.recording(seed=seed)
        bags.append(tmp_path / f"{seed}.mcap")
        write_recording(bags[-1], run)
    words = ["identify", str(bags[0]), "--validate", str(bags[1]), "--bandwidth", "5", "--out", str(tmp_path / "out")]
    assert main([*words, "--friction", "coulomb-viscous"]) == (3 if wrong else 0)
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("Suspect model." if wrong else "Good fit.")
    assert main([*words, "--friction", "coulomb-viscous", "--json"]) == (3 if wrong else 0)
    told = json.loads(capsys.readouterr().out)
    written = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert told["verdict"] == written["verdict"] == ("suspect" if wrong else "good")
    assert told["joints"] == written["joints"] and first == f"{told['headline']}."
    assert told["headline"] in unescape((tmp_path / "out" / "report.html").read_text())


# --- BLAS threads -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("given", "expected"), [({}, "1"), ({"OMP_NUM_THREADS": "3"}, None)])
def test_the_command_line_has_one_blas_thread_unless_the_user_decided(given, expected) -> None:
    surroundings = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    code = (
        "import os, sys; from spacearm_ident.cli import main\n"
        "assert 'numpy' not in sys.modules, 'too late: BLAS has read its threads'\n"
        "try: main.main(['--version'])\n"
        "except SystemExit: print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    )
    done = subprocess.run([sys.executable, "-c", code], env={**surroundings, **given}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == str(expected)


def test_a_worker_of_the_identifier_has_one_blas_thread(monkeypatch) -> None:
    worker = pytest.importorskip("spacearm_ident.nodes.worker")
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    job = worker.Worker(ThreadsJob())
    job._thread.join(120)
    (failed,) = [event for event in job.poll() if isinstance(event, worker.Failed)]
    assert failed.reason == "1"
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


class ThreadsJob:
    """Answers with the number of threads that BLAS was told."""

    name = "threads"

    def perform(self, progress):
        raise UserError(os.environ.get("OPENBLAS_NUM_THREADS", "not told"))
