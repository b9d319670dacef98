"""Every solver goes from a bag to a result folder; the separable ones agree, and chance repeats itself."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import small_arm
from domains import domain
from planted_arm import Friction, two_link_run

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Determination, Identified
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.nodes.jobs import IdentifyJob
from spacearm_ident.recording import write_recording
from spacearm_ident.regression import balanced
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.results.covariance_file import covariance_dict
from spacearm_ident.sessions.bags import Options
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers import separable
from spacearm_ident.solvers.choice import SOLVERS
from spacearm_ident.solvers.separable import AT_ENDS, CONVERGED, STUCK, grid_search, solve, solve_linear

ARM = arm_from_urdf(small_arm.URDF)
PLANTED = two_link_run((Friction(f_c=5.0, f_b=8.0, v_b=0.1), Friction(f_c=3.0, J_m=0.2)))


def planted_problem() -> Regression:
    arm = arm_from_urdf(PLANTED.urdf)
    motions, _ = prepare([PLANTED.recording(noise=0.05)], arm.joint_names)
    regression = Regression(TorqueModel(arm, structure_of(arm)), motions)
    for rows in regression.rows:
        rows.set_weight(np.full(len(rows.torque), 20.0))
    return regression


def test_converged_is_said_only_where_an_undamped_step_is_small(monkeypatch):
    regression = planted_problem()
    prior = make_prior(regression.model, regression.motions)
    best = solve(regression, prior, grid_search(regression))
    assert best.status == CONVERGED == solve(regression, prior, best.constants).status
    away = np.where(best.constants > 0, 1.3 * best.constants, 0.0)
    costs = itertools.count()

    def ever_worse(*problem):
        return solve_linear(*problem)[0], float(next(costs))

    monkeypatch.setattr(separable, "solve_linear", ever_worse)
    found = solve(regression, prior, away)
    assert found.status == STUCK
    np.testing.assert_array_equal(found.constants, away)


def test_constants_at_the_ends_of_their_ranges_stay_and_are_not_called_converged():
    regression = planted_problem()
    prior = make_prior(regression.model, regression.motions)
    ends = np.array([grid[-1] for grid in regression.grids])
    found = solve(regression, prior, ends)
    assert found.status == AT_ENDS and found.iterations == 0
    np.testing.assert_array_equal(found.constants, ends)


@pytest.fixture(scope="module")
def results() -> dict[str, Identified]:
    recording = small_arm.recording()
    return {
        solver: identify([recording], ARM, Settings(5.0, structure_of(ARM, "coulomb-viscous"), solver, 4))
        for solver in SOLVERS
    }


def value(result: Identified, name: str) -> float:
    return next(estimate.value for estimate in result.estimates if estimate.name == name)


@pytest.mark.parametrize("solver", SOLVERS)
def test_each_solver_identifies_a_small_arm(results, solver):
    result = results[solver]
    assert result.solver.startswith(solver)
    assert ("seed 4" in result.solver) == solver.startswith("pso")
    for name, truth in (("f_c[shoulder]", 3.0), ("k_v1[shoulder]", 2.0), ("f_c[elbow]", 1.5), ("k_v1[elbow]", 0.8)):
        assert value(result, name) == pytest.approx(truth, rel=0.1), name
    # A spring that is held at zero has no error; everything else has.
    assert np.isfinite(result.base_errors).all() and (result.base_errors > 0).sum() >= len(result.base_errors) - 2
    assert any(estimate.determination is Determination.DATA for estimate in result.estimates)
    assert any(estimate.determination is Determination.COMBINED for estimate in result.estimates)


def test_pso_lm_takes_the_paper_s_unknowns_and_tells_both_stages(results):
    result = results["pso-lm"]
    assert any(estimate.name == "k_1[elbow]" and estimate.value != 0.0 for estimate in result.estimates)
    assert any("PSO F" in note and "LM ->" in note for note in result.notes)
    assert any("times what exact parameters leave" in note for note in result.notes)


def test_the_same_seed_gives_the_same_result_and_another_another(results):
    recording, structure = small_arm.recording(), structure_of(ARM, "coulomb-viscous")
    again, other = (identify([recording], ARM, Settings(5.0, structure, "pso-lm", seed)) for seed in (4, 5))
    assert np.array_equal(results["pso-lm"].model.parameters, again.model.parameters)
    assert not np.array_equal(again.model.parameters, other.model.parameters)


def test_an_unknown_solver_is_refused_with_those_there_are():
    with pytest.raises(UserError, match=r"no solver 'magic': choose one of separable, pso-lm, idim-iv, cloe"):
        Options(solver="magic").settings(ARM)
    with pytest.raises(UserError, match="no solver 'magic'"):
        identify([small_arm.recording(duration_s=4.0)], ARM, Settings(solver="magic"))


def test_a_negative_seed_is_refused():
    with pytest.raises(UserError, match="seed -1: a seed is a whole number from 0 on"):
        Options(solver="pso-lm", seed=-1).settings(ARM)


def test_the_command_passes_solver_and_seed_on(tmp_path, capsys):
    bag = tmp_path / "run.mcap"
    write_recording(bag, small_arm.recording())
    words = ["identify", bag, "--out", tmp_path / "out", "--friction", "coulomb-viscous", "--bandwidth", 5]
    assert main([str(word) for word in [*words, "--solver", "pso-lm", "--seed", 7]]) == 0
    assert "solver pso-lm (seed 7)" in capsys.readouterr().out
    assert "pso-lm (seed 7)" in (tmp_path / "out" / "report.html").read_text()
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in [*words, "--solver", "magic"]])
    assert ended.value.code == 2 and "magic" in capsys.readouterr().err


def test_the_job_of_the_node_says_which_command_does_the_same(tmp_path):
    job = IdentifyJob((tmp_path / "a.mcap",), (), tmp_path, Options(solver="pso-lm", seed=3))
    assert "--solver pso-lm --seed 3" in job.command
    assert "--solver" not in IdentifyJob((tmp_path / "a.mcap",), (), tmp_path).command


def test_the_covariance_of_what_is_determined_is_exported(results):
    result = results["separable"]
    exported = json.loads(json.dumps(covariance_dict(result)))
    names = [item["name"] for item in exported["unknowns"]]
    spread, mean = np.array(exported["covariance"]), np.array(exported["mean"])
    assert spread.shape == (len(names),) * 2 and np.array_equal(spread, spread.T)
    assert np.linalg.eigvalsh(spread / np.outer(*[np.sqrt(np.diag(spread))] * 2))[0] > -1e-9
    known = [k for k, error in enumerate(result.base_errors) if error > 0]
    assert names == [result.base.names[k] for k in known]
    assert np.sqrt(np.diag(spread)) == pytest.approx(result.base_errors[known])
    assert mean == pytest.approx(result.base_values[known])
    # The map, applied to the parameters of model.yaml by name, gives the model's base values.
    values = {item.name: value for item, value in zip(result.model.model.parameters, result.model.parameters)}
    for name, value in zip(names, exported["model"]):
        assert sum(factor * values[part] for part, factor in exported["map"][name].items()) == pytest.approx(value)


@pytest.mark.parametrize(("parameter", "words"), [("solver:=magic", "solver: no 'magic'"), ("seed:=-1", "seed")])
def test_a_node_with_a_parameter_that_cannot_be_says_so_and_ends(tmp_path, monkeypatch, parameter, words):
    pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")
    live_nodes = pytest.importorskip("live_nodes")
    monkeypatch.setenv("ROS_DOMAIN_ID", domain("clean"))
    processes = live_nodes.Processes(tmp_path)
    try:
        node = processes.node("identifier", parameter, f"result_directory:={tmp_path / 'result'}")
        assert node.wait(120.0) == 2, live_nodes.output(node)
        assert words in live_nodes.output(node) and "Traceback" not in live_nodes.output(node)
    finally:
        processes.end()


@pytest.mark.parametrize("decades", [0, 9])
def test_normal_equations_in_many_units_are_solved_as_those_in_one(decades):
    """Two unknowns of six are alike, which no unit changes: only their sum is known, and shared between them."""
    columns = np.random.default_rng(3).normal(size=(40, 5))
    columns = np.column_stack([columns, columns[:, 4]])
    gram, slope = columns.T @ columns, columns.T @ (columns @ np.arange(1.0, 7.0))
    units = 10.0 ** np.linspace(-decades, decades, 6)
    inverse = balanced.pseudo_inverse(gram * np.outer(units, units))
    np.testing.assert_allclose(inverse * np.outer(units, units), np.linalg.pinv(gram, hermitian=True), rtol=1e-6)
    found = balanced.solve(gram * np.outer(units, units), units * slope) * units
    np.testing.assert_allclose(found, [1.0, 2.0, 3.0, 4.0, 5.5, 5.5], rtol=1e-8)
