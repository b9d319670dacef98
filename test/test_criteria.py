"""Criteria: closed forms, derivatives against differences, and the information against a second writing of it."""

from __future__ import annotations

import numpy as np
import pytest
import small_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import Link, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.regressor import rigid_body_blocks
from spacearm_ident.excitation.constraints import Requirements, model_torque
from spacearm_ident.excitation.criteria import (
    CONDITION,
    CRITERIA,
    D_OPTIMAL,
    PREDICTION,
    SCALED_CONDITION,
    Information,
    Question,
    condition_number,
    scaled_condition_number,
    smooth_criterion,
)
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.problem import Problem
from spacearm_ident.excitation.regressor_gradient import DifferentiableRegressor
from spacearm_ident.excitation.smooth_columns import SmoothColumns
from spacearm_ident.excitation.trajectory import Motion, MotionLimits

TREE = (
    Link("a", axis=(0, 0, 1), xyz=(0, 0, 0.3), rpy=(0.2, 0.3, 0.1)),
    Link("b", kind="prismatic", parent="a", axis=(0, 0.6, 0.8), xyz=(0.1, 0.2, 0.3), rpy=(0.2, 0.1, -0.4)),
    Link("c", parent="b", axis=(0.6, 0, 0.8), xyz=(0.1, 0.2, 0.3), rpy=(1, 0.1, -0.4)),
    Link("d", parent="b", axis=(1, 0, 0), xyz=(0, 0.2, 0.3), rpy=(1, 0.1, -0.4)),
    Link("e", kind="prismatic", parent="c", axis=(1, 0, 0), xyz=(0, 0.2, 0.3)),
)
LIMITS = MotionLimits(np.full(2, -2.5), np.full(2, 2.5), np.full(2, 2.0), np.full(2, 6.0))


def states(arm, samples=6, seed=0):
    return Motion(*np.random.default_rng(seed).normal(size=(3, samples, len(arm.joints))))


def planted(friction="paper", v_b=0.4):
    arm = arm_from_urdf(small_arm.URDF)
    model = TorqueModel(arm, structure_of(arm, friction))
    known = {"f_c": 3.0, "f_b": 5.0, "k_v1": 2.0, "k_v2": 0.3, "k_v3": -0.1, "J_m": 0.4}
    parameters = np.array([known.get(p.symbol, p.prior) for p in model.parameters])
    constants = np.array([v_b if c.symbol == "v_b" else 0.0 for c in model.constants])
    return IdentifiedModel(model, parameters, constants)


def test_the_differentiable_regressor_is_the_regressor():
    arm = arm_from_urdf(urdf_of(TREE))
    motion = states(arm)
    expected = rigid_body_blocks(arm, *motion)
    found = DifferentiableRegressor(arm, motion)
    assert {*zip(found.rows.tolist(), found.links.tolist())} == {*expected}
    for row, link, columns in zip(found.rows, found.links, found.columns().swapaxes(0, 1)):
        np.testing.assert_allclose(columns, expected[row, link], atol=1e-12)


def test_its_way_back_is_what_differences_give_on_a_branching_arm_with_sliding_joints():
    arm = arm_from_urdf(urdf_of(TREE))
    motion = states(arm)
    rng = np.random.default_rng(1)
    adjoint = rng.normal(size=DifferentiableRegressor(arm, motion).columns().shape)

    def contracted(*state):
        return (DifferentiableRegressor(arm, Motion(*state)).columns() * adjoint).sum(axis=(0, 1))

    back = DifferentiableRegressor(arm, motion).back(adjoint)
    for which in range(3):
        for joint in range(len(arm.joints)):
            step = np.zeros_like(motion.q)
            step[:, joint] = 1e-6
            up, down = ([x + s * step * (k == which) for k, x in enumerate(motion)] for s in (1, -1))
            difference = (contracted(*up) - contracted(*down)) / 2e-6
            np.testing.assert_allclose(back[which][:, joint], difference, atol=1e-6)


def test_condition_numbers_of_columns_of_known_lengths_and_angle():
    assert condition_number(np.diag([16.0, 1.0])) == pytest.approx(4.0)
    assert scaled_condition_number(np.diag([16.0, 1.0])) == pytest.approx(1.0)
    # Two unit columns at 60 degrees: eigenvalues 1 +- 1/2, whatever their lengths.
    lengths = np.array([3.0, 0.01])
    gram = np.outer(lengths, lengths) * np.array([[1.0, 0.5], [0.5, 1.0]])
    assert scaled_condition_number(gram) == pytest.approx(np.sqrt(3.0))
    assert condition_number(np.ones((2, 2))) == np.inf
    assert scaled_condition_number(np.diag([1.0, 0.0])) == np.inf


@given(st.integers(0, 1000), st.sampled_from(CRITERIA), st.sampled_from([4.0, 30.0]))
@settings(max_examples=40, deadline=None)
def test_every_criterion_has_the_derivative_that_differences_give(seed, name, sharpness):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(40, 5)) * rng.uniform(0.2, 5.0, 5)
    information, test = columns.T @ columns, np.diag(rng.uniform(0.1, 2.0, 5))
    criterion = smooth_criterion(name, sharpness, test)
    _, slope = criterion(information)
    direction = rng.normal(size=(5, 5))
    direction += direction.T
    step = 1e-6 * information.max()
    difference = (
        (criterion(information + step * direction)[0] - criterion(information - step * direction)[0]) / 2 / step
    )
    assert np.sum(slope * direction) == pytest.approx(difference, rel=1e-4, abs=1e-9)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_smooth_condition_numbers_tend_to_the_true_ones_and_scaling_columns_moves_only_the_raw_one(seed):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(40, 5))
    information = columns.T @ columns
    scale = rng.uniform(0.1, 10.0, 5)
    scaled = information * np.outer(scale, scale)
    for name, exact in ((CONDITION, condition_number), (SCALED_CONDITION, scaled_condition_number)):
        value, _ = smooth_criterion(name, 500.0)(information)
        assert np.exp(value) == pytest.approx(exact(information), rel=0.01)
    assert scaled_condition_number(scaled) == pytest.approx(scaled_condition_number(information), rel=1e-6)
    volume = smooth_criterion(D_OPTIMAL, 1.0)
    change = volume(scaled)[0] - volume(information)[0]
    assert change == pytest.approx(-2 * np.log(scale).mean(), rel=1e-6)


def test_information_columns_are_what_the_torque_gains_by_each_base_parameter_and_by_log_v_b():
    identified = planted()
    question = Question.of(identified)
    arm = identified.model.arm
    motion = states(arm, samples=40)
    columns = []
    for number in question.leads:
        moved = identified.parameters.copy()
        moved[number] += 1.0
        there = IdentifiedModel(identified.model, moved, identified.constants)
        columns.append(model_torque(there, motion, 1.0) - model_torque(identified, motion, 1.0))
    for k, constant in enumerate(identified.model.constants):
        if constant.symbol == "v_b":
            torques = []
            for sign in (1, -1):
                moved = identified.constants.copy()
                moved[k] *= np.exp(sign * 1e-3)
                torques.append(
                    model_torque(IdentifiedModel(identified.model, identified.parameters, moved), motion, 1.0)
                )
            columns.append((torques[0] - torques[1]) / 2e-3)
    whole = np.array(columns)  # (b, T, n)
    expected = np.einsum("atj,btj->jab", whole, whole) / 40
    found = question.information(motion, 1.0)
    assert len(found.names) == len(columns) and "log v_b[elbow]" in found.names
    np.testing.assert_allclose(found.by_joint, expected, rtol=1e-3, atol=1e-3)


def test_prediction_sd_is_the_textbook_one():
    """One joint, one column of ones: N samples of noise s give the level, and any torque, to s / sqrt(N)."""
    one = Information(("f_c[j]",), np.ones((1, 1, 1)), (0,), np.array([0.3]))
    np.testing.assert_allclose(one.prediction_sd([one], 400), [0.3 / 20])
    # A column twice as strong on the test doubles it.
    strong = Information(("f_c[j]",), 4 * np.ones((1, 1, 1)), (0,), np.array([0.3]))
    np.testing.assert_allclose(one.prediction_sd([strong], 400), [0.6 / 20])


def test_louder_joints_count_less_in_d_optimal_and_nothing_changes_in_condition_numbers():
    motion = states(arm_from_urdf(small_arm.URDF), samples=50)
    quiet = Question.of(planted(), np.array([0.1, 0.1])).information(motion, 1.0)
    loud = Question.of(planted(), np.array([0.1, 1.0])).information(motion, 1.0)
    assert quiet.values()[CONDITION] == pytest.approx(loud.values()[CONDITION])
    assert quiet.values()[D_OPTIMAL] < loud.values()[D_OPTIMAL]


def test_noise_defaults_to_a_share_of_the_torque_limits():
    noise = Question.of(planted()).noise_Nm
    assert noise[0] / noise[1] == pytest.approx(2.0)


@pytest.mark.parametrize("v_b", [0.4, 0.0])
def test_smooth_columns_are_the_exact_ones_where_the_direction_turns_sharply(v_b):
    identified = planted(v_b=v_b)
    question = Question.of(identified)
    motion = states(identified.model.arm, samples=50)
    smooth = SmoothColumns(question, np.full(2, 1e-9))
    at = smooth.at(motion)
    exact = question.information(motion, 1.0)
    order = [question.leads.index(number) for number in smooth.leads]
    np.testing.assert_allclose(
        at.information(np.ones(2)), exact.by_joint.sum(axis=0)[np.ix_(order, order)], atol=1e-6, rtol=1e-6
    )
    np.testing.assert_allclose(at.torque, model_torque(identified, motion, 1.0), atol=1e-6)


def test_a_peak_too_narrow_for_full_speed_is_left_out_of_the_condition_numbers_but_not_of_the_errors():
    found = Question.of(planted(v_b=1e-3)).information(states(arm_from_urdf(small_arm.URDF), samples=500), 1.0)
    conditioned = [found.names[k] for k in found.conditioned]
    assert "f_c[elbow]" in conditioned and "f_b[elbow]" not in conditioned
    assert "v_b[elbow]" in found.relative_errors(1.0)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_objective_has_the_derivative_that_differences_give_barriers_included(criterion):
    identified = planted()
    needs = Requirements(LIMITS, np.array([60.0, 30.0]), identified)
    problem = Problem(Question.of(identified), needs, criterion, 0.2, 3, 1, np.zeros(2))
    function = problem.function(8.0, 0.1)
    rng = np.random.default_rng(2)
    z = 0.3 * rng.normal(size=problem.space.shape)
    value, gradient = function(z)
    assert np.isfinite(value)
    for _ in range(3):
        direction = rng.normal(size=z.shape)
        difference = (function(z + 1e-5 * direction)[0] - function(z - 1e-5 * direction)[0]) / 2e-5
        assert np.sum(gradient * direction) == pytest.approx(difference, rel=1e-3, abs=1e-5)


def test_prediction_needs_its_test_motions():
    with pytest.raises(ValueError, match="test motions"):
        smooth_criterion(PREDICTION, 1.0)


def test_a_nominal_model_knows_the_links_and_no_friction():
    arm = arm_from_urdf(small_arm.URDF)
    torque = model_torque(nominal_model(arm), Motion(np.zeros((1, 2)), np.ones((1, 2)), np.zeros((1, 2))), 1.0)
    still = model_torque(nominal_model(arm), Motion(*np.zeros((3, 1, 2))), 1.0)
    # At rest upright only the offset centres of mass weigh: 9.81 (4 x 0.02 + 2 x 0.01) about the shoulder.
    assert abs(still[0, 0]) == pytest.approx(9.81 * 0.1, rel=1e-6)
    assert np.all(np.isfinite(torque))
