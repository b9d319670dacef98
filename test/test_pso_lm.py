"""The published algorithm: its objective is exact, its mu obeys the paper's rule, its rounds hand over the best."""

from __future__ import annotations

import numpy as np
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.errors import UserError
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.pso import SwarmSettings
from spacearm_ident.solvers.pso_lm import (
    CONVERGED,
    EXHAUSTED,
    HANDED_BACK,
    LmSettings,
    PsoLmSettings,
    as_published,
    box_of,
    gap,
    linearised,
    minimise,
    refine,
    solve,
)
from spacearm_ident.solvers.swarm_cost import SwarmCost, Unknowns

FEW = PsoLmSettings(SwarmSettings(20, 10), LmSettings(10), 1)


def rosenbrock(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = point
    return np.array([10 * (y - x**2), 1 - x]), np.array([[-20 * x, 10.0], [-1.0, 0.0]])


def test_lm_walks_down_rosenbrock_s_valley():
    refined = refine(rosenbrock, np.array([-1.2, 1.0]))
    assert refined.point == pytest.approx([1.0, 1.0], abs=1e-5)
    assert (np.diff(refined.costs) <= 0).all()


def test_mu_halves_on_success_and_doubles_on_failure():
    refined = refine(rosenbrock, np.array([-1.2, 1.0]), LmSettings(first_damping=0.01))
    assert refined.dampings[0] == 0.01
    ratio = refined.dampings[1:] / refined.dampings[:-1]
    success = np.diff(refined.costs) < 0
    assert success.any() and not success.all()
    assert np.array_equal(ratio, np.where(success, 0.5, 2.0))


def test_the_first_step_is_the_paper_s():
    point = np.array([-1.2, 1.0])
    residual, jacobian = rosenbrock(point)
    step = np.linalg.solve(jacobian.T @ jacobian + 5.0 * np.eye(2), jacobian.T @ residual)
    refined = refine(rosenbrock, point, LmSettings(iterations=1, first_damping=5.0))
    assert refined.point == pytest.approx(point - step)
    assert refined.status == EXHAUSTED


def stubborn(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A slope that is promised and never there."""
    return np.array([1.0 + abs(float(point[0]))]), np.array([[-1.0]])


def test_mu_above_the_limit_hands_back():
    refined = refine(stubborn, np.zeros(1), LmSettings(first_damping=1.0, hand_back=1e3))
    # 1, 2, 4, ... 1024: the tenth failure exceeds 1e3.
    assert refined.status == HANDED_BACK and len(refined.costs) == 11 and refined.dampings[-1] == 1024.0


def test_lm_that_has_nothing_to_gain_is_done():
    refined = refine(lambda x: (np.array([x[0], 1.0]), np.array([[1.0], [0.0]])), np.array([3.0]))
    assert refined.status == CONVERGED and refined.point == pytest.approx([0.0], abs=1e-6)


def test_steps_end_at_walls():
    refined = refine(rosenbrock, np.array([-1.2, 1.0]), lower=np.array([-2.0, -2.0]), upper=np.array([0.5, 2.0]))
    # Along the wall the other coordinate still finds its best place.
    assert refined.point == pytest.approx([0.5, 0.25], abs=1e-4)


def test_every_round_starts_from_the_best_so_far_and_the_best_is_kept():
    seen: list[np.ndarray] = []

    def cost(swarm: np.ndarray) -> np.ndarray:
        seen.append(swarm.copy())
        return 0.5 * (1 + np.abs(swarm[:, 0])) ** 2

    result = minimise(
        cost,
        stubborn,
        np.array([2.0]),
        np.array([3.0]),
        np.random.default_rng(0),
        PsoLmSettings(SwarmSettings(5, 4), LmSettings(20), rounds=3),
    )
    assert [part.refined.status for part in result.rounds] == [HANDED_BACK] * 3
    assert "handed back" in result.rounds[0].words and "PSO F" in result.rounds[0].words
    for number in (1, 2):
        best = min(result.rounds[:number], key=lambda part: part.refined.cost)
        assert best.refined.point[0] in seen[5 * number][:, 0]
    assert result.cost == min(part.refined.cost for part in result.rounds)


def test_a_best_place_outside_the_box_is_not_lost():
    swarms: list[np.ndarray] = []

    def cost(swarm: np.ndarray) -> np.ndarray:
        swarms.append(swarm.copy())
        return 0.5 * ((swarm[:, 0] + 7) ** 2 + 1)

    def linearise(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([point[0] + 7, 1.0]), np.array([[1.0], [0.0]])

    # With a limit of zero every step hands back, even the one that leaves the box for the minimum.
    settings = PsoLmSettings(SwarmSettings(4, 2), LmSettings(5, first_damping=1e-12, hand_back=0.0), rounds=2)
    result = minimise(cost, linearise, np.array([2.0]), np.array([3.0]), np.random.default_rng(1), settings)
    first = result.rounds[0].refined.point
    assert first == pytest.approx([-7.0]) and swarms[3][0] == first
    assert result.rounds[1].swarm.cost == pytest.approx(0.5)


@pytest.fixture(scope="module")
def problem():
    planted = two_link_run((Friction(f_c=5.0, f_b=8.0, v_b=0.1), Friction(f_c=3.0, J_m=0.2)))
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([planted.recording(noise=0.05)], arm.joint_names)
    model = TorqueModel(arm, as_published(structure_of(arm)))
    regression = Regression(model, motions)
    prior = make_prior(model, motions)
    unknowns = Unknowns.of(regression, prior)
    return regression, prior, unknowns, box_of(model, regression, prior, unknowns)


def test_the_paper_s_unknowns_are_18_a_joint(problem):
    regression, _, unknowns, (lower, upper) = problem
    assert len(lower) == len(upper) == 18 * len(regression.rows)
    names = {constant.symbol for constant in regression.model.constants}
    assert len(unknowns.searched) == 2 and names >= {"v_b"}


def test_the_swarm_s_cost_is_the_sum_of_squares_over_the_rows(problem):
    regression, _, unknowns, (lower, upper) = problem
    swarm = np.random.default_rng(0).uniform(lower, upper, (12, len(lower)))
    swarm[0, -2:], swarm[1, -2:] = lower[-2:], upper[-2:]
    costs = SwarmCost(regression, unknowns, lower, upper)(swarm)
    for place, cost in zip(swarm, costs):
        parameters, constants = unknowns.split(place)
        total = 0.0
        for motion in regression.motions:
            torque = motion.reduce(motion.torque - regression.model.torque(motion, parameters, constants))
            total += float(np.sum(torque[motion.moving] ** 2))
        assert cost == pytest.approx(total / 2, rel=1e-10)


def test_small_costs_are_as_exact(problem):
    """Near the minimum, where squares of hundreds of N·m cancel."""
    regression, prior, unknowns, (lower, upper) = problem
    solution, found = solve(regression, prior, 1, FEW)
    parameters, constants = solution.parameters, solution.constants
    total = sum(
        float(
            np.sum(
                motion.reduce(motion.torque - regression.model.torque(motion, parameters, constants))[motion.moving]
                ** 2
            )
        )
        for motion in regression.motions
    )
    cost = SwarmCost(regression, unknowns, lower, upper)(found.point[None])[0]
    assert cost == pytest.approx(total / 2, rel=1e-7)
    assert solution.cost == pytest.approx(total, rel=1e-7)


def test_the_jacobian_is_the_cost_s_slope(problem):
    regression, _, unknowns, (lower, upper) = problem
    cost, linearise = SwarmCost(regression, unknowns, lower, upper), linearised(regression, unknowns)
    place = np.random.default_rng(5).uniform(lower, upper)
    residual, jacobian = linearise(place)
    step = 1e-6 * np.diag(upper - lower)
    slope = (cost(place + step) - cost(place - step)) / 2e-6
    gradient = (jacobian.T @ residual) * (upper - lower)
    assert gradient == pytest.approx(slope, abs=1e-5 * np.abs(gradient).max())


def test_both_stages_lower_the_cost_and_the_gap_says_what_is_left(problem):
    regression, prior, _, _ = problem
    solution, found = solve(regression, prior, 0)
    part = found.rounds[0]
    assert part.swarm.cost < 0.1 * part.swarm.history[0]
    assert part.refined.cost < part.swarm.cost
    assert gap(regression, prior, solution) >= 1.0 - 1e-6


def test_a_model_of_another_form_is_refused(problem):
    regression, _, _, _ = problem
    model = TorqueModel(regression.model.arm, structure_of(regression.model.arm))  # with presliding distances
    other = Regression(model, regression.motions)
    with pytest.raises(UserError, match=r"one nonlinear constant a joint, and shoulder has more"):
        solve(other, make_prior(model, regression.motions), 0, FEW)
