"""The separable solver finds planted constants, steps along true derivatives, and bounds outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_arm
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.identification.identify import identify
from spacearm_ident.regression.prior import Prior, make_prior
from spacearm_ident.regression.regression import NARROWEST_SHARE, Regression
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.separable import grid_search, solve, solve_linear, system

LAWS = (Friction(f_c=5.0, f_b=8.0, v_b=0.1), Friction(f_c=3.0, J_m=0.2))


def problem(planted: planted_arm.Planted, friction: str = "paper", noise: float = 0.0) -> tuple[Regression, Prior]:
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([planted.recording(noise=noise)], arm.joint_names)
    model = TorqueModel(arm, structure_of(arm, friction))
    regression = Regression(model, motions)
    for rows in regression.rows:
        rows.set_weight(np.full(len(rows.torque), 20.0))
    return regression, make_prior(model, motions)


def named(regression: Regression, values: np.ndarray) -> dict[str, float]:
    return {constant.name: value for constant, value in zip(regression.model.constants, values)}


@pytest.mark.parametrize("stribeck_velocity", [0.08, 0.12, 0.2])
def test_planted_constants_are_found_and_absent_ones_are_not(stribeck_velocity):
    planted = two_link_run((replace(LAWS[0], v_b=stribeck_velocity), LAWS[1]))
    regression, prior = problem(planted, noise=0.05)
    solution = solve(regression, prior, grid_search(regression))
    constants = named(regression, solution.constants)
    values = {p.name: value for p, value in zip(regression.model.parameters, solution.parameters)}
    assert constants["v_b[shoulder]"] == pytest.approx(stribeck_velocity, rel=0.03)
    assert values["f_b[shoulder]"] == pytest.approx(8.0, rel=0.03)
    assert values["f_c[shoulder]"] == pytest.approx(5.0, rel=0.01)
    assert constants["v_b[elbow]"] == constants["d_s[elbow]"] == 0.0
    assert values["f_c[elbow]"] == pytest.approx(3.0, rel=0.01)


def test_a_planted_presliding_distance_is_found():
    planted = two_link_run((replace(LAWS[0], f_b=None, v_b=0.0, d_s=1e-3), LAWS[1]))
    regression, prior = problem(planted, noise=0.05)
    assert named(regression, solve(regression, prior, grid_search(regression)).constants)[
        "d_s[shoulder]"
    ] == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize("start", [0.07, 0.1, 0.2])
def test_every_start_ends_in_the_same_minimum(start):
    regression, prior = problem(two_link_run(LAWS), noise=0.05)
    best = solve(regression, prior, grid_search(regression))
    constants = np.where(best.constants > 0, start, 0.0)
    assert (constants > 0).sum() == 1
    again = solve(regression, prior, constants)
    np.testing.assert_allclose(again.constants, best.constants, rtol=5e-3)
    assert again.cost <= best.cost * (1 + 1e-4)


def test_the_grid_is_searched_without_what_it_cannot_see():
    regression, _ = problem(two_link_run(LAWS))
    slowest = min(motion.resolved_speed[0] for motion in regression.motions)
    assert regression.grids[0][1] == pytest.approx(NARROWEST_SHARE * slowest)
    assert 0.05 < named(regression, grid_search(regression))["v_b[shoulder]"] < 0.2


def test_the_linear_solution_is_the_least_of_the_uncompressed_squares():
    """Against a dense least-squares problem built from full-rate torque of unit parameters."""
    regression, prior = problem(two_link_run(LAWS), noise=0.05)
    constants = np.array([0.1, 1e-3, 0.0, 0.0])
    parameters, cost = solve_linear(regression, prior, constants)
    columns = np.column_stack([rows_of(regression, unit, constants) for unit in np.eye(len(parameters))])
    torque = np.concatenate([rows.torque * rows.weight for rows in regression.rows])
    free = prior.free
    dense = np.linalg.lstsq(
        np.concatenate([columns[:, free], prior.rows[:, free]]), np.concatenate([torque, prior.target]), rcond=None
    )[0]
    np.testing.assert_allclose(parameters[free], dense, rtol=1e-6, atol=1e-8)
    residual = np.concatenate([columns[:, free] @ dense - torque, prior.rows[:, free] @ dense - prior.target])
    assert cost == pytest.approx(float(residual @ residual), rel=1e-9)


def test_the_jacobian_is_the_derivative_of_the_predicted_torque():
    regression, prior = problem(two_link_run(LAWS), noise=0.05)
    constants = np.array([0.1, 2e-3, 0.08, 1e-3])
    rng = np.random.default_rng(0)
    parameters = rng.uniform(0.5, 2.0, len(prior.held)) * (prior.scale > 0)
    matrix, _ = system(regression, prior, constants, parameters, np.arange(4))
    matrix = matrix[: len(matrix) - len(prior.rows)]
    numeric = []
    for k in range(4):
        up, down = constants.copy(), constants.copy()
        up[k] *= np.exp(1e-3)
        down[k] *= np.exp(-1e-3)
        numeric.append((rows_of(regression, parameters, up) - rows_of(regression, parameters, down)) / 2e-3)
    unit = np.eye(len(parameters))[prior.free]
    full = np.column_stack([*(rows_of(regression, one, constants) for one in unit), *numeric])
    mine = matrix[:, [*prior.free, *range(len(parameters), len(parameters) + 4)]]
    scale = np.linalg.norm(full, axis=0) + 1e-12
    # Compression is an orthogonal map: it keeps every inner product of columns.
    np.testing.assert_allclose(
        (mine.T @ mine) / np.outer(scale, scale), full.T @ full / np.outer(scale, scale), atol=2e-3
    )


def rows_of(regression: Regression, parameters: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """Weighted rows of the model's torque, all joints one after the other, by the full-rate prediction."""
    parts = []
    for joint in range(len(regression.rows)):
        for motion in regression.motions:
            torque = motion.reduce(regression.model.torque(motion, parameters, constants))
            parts.append(torque[motion.moving[:, joint], joint])
    return np.concatenate(parts) * np.concatenate([rows.weight for rows in regression.rows])


def test_outliers_are_bounded():
    """Bursts of 40 N·m, 2 % of the run: the fit stays near the one without them, plain least squares does not."""
    planted = two_link_run(LAWS, seconds=40.0)
    clean = planted.recording(noise=0.1)
    effort = clean.effort.copy()
    for start in np.random.default_rng(1).integers(500, len(effort) - 500, 8):
        effort[start : start + 50] += 40.0
    arm = arm_from_urdf(planted.urdf)
    spoilt = replace(clean, effort=effort)
    reference, robust = (
        {e.name: e.value for e in identify([run], arm).estimates if e.identifiable} for run in (clean, spoilt)
    )
    motions, _ = prepare([spoilt], arm.joint_names)
    model = TorqueModel(arm, structure_of(arm))
    regression, prior = Regression(model, motions), make_prior(TorqueModel(arm, structure_of(arm)), motions)
    plain = {p.name: v for p, v in zip(model.parameters, solve(regression, prior, grid_search(regression)).parameters)}
    names = [name for name in ("f_c[shoulder]", "k_v1[shoulder]", "f_c[elbow]", "k_v1[elbow]") if name in robust]
    assert len(names) == 4
    off = {kind: sum(abs(fit[n] - reference[n]) for n in names) for kind, fit in (("robust", robust), ("plain", plain))}
    assert off["robust"] < 0.3 * off["plain"]
    assert all(abs(robust[name] - planted.values[name]) < 0.1 * planted.values[name] for name in names)
