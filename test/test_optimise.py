"""Optimised excitation: limits on an independent grid, determinism, and errors that really get smaller."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import small_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import THREE_LINKS, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.clearance import Clearance, Nearest
from spacearm_ident.excitation.constraints import Requirements, check, model_torque
from spacearm_ident.excitation.criteria import CRITERIA, D_OPTIMAL, PREDICTION, SCALED_CONDITION, Question
from spacearm_ident.excitation.descent import descend
from spacearm_ident.excitation.genetic import evolve
from spacearm_ident.excitation.optimise import _reachable, exact_value, optimise, optimise_harmonics
from spacearm_ident.excitation.problem import Problem
from spacearm_ident.excitation.segments import Motion, MotionLimits
from spacearm_ident.excitation.series_space import SeriesSpace
from spacearm_ident.excitation.trajectory import FourierTrajectory, draw_coefficients

ARM = arm_from_urdf(small_arm.URDF)
LIMITS = MotionLimits(
    np.array([-1.5, -2.0]), np.array([1.5, 2.5]), np.array([1.5, 2.0]), np.array([4.0, 6.0]), np.array([20.0, 30.0])
)
COULOMB, VISCOUS, ROTOR = small_arm.COULOMB, small_arm.VISCOUS, small_arm.ROTOR


def identified(arm=ARM):
    model = TorqueModel(arm, structure_of(arm, "coulomb-viscous"))
    known = {"f_c": COULOMB, "k_v1": VISCOUS, "J_m": ROTOR}
    names = arm.joint_names
    values = [known[p.symbol][names.index(p.joint) % 2] if p.symbol in known else p.prior for p in model.parameters]
    return IdentifiedModel(model, np.array(values), np.zeros(len(model.constants)))


def problem(criterion=D_OPTIMAL, **changes):
    model = identified()
    wanted = Requirements(LIMITS, np.array([20.0, 18.0]), model)
    return replace(Problem(Question.of(model), wanted, criterion, 0.2, 3, 2, np.array([0.1, 0.2])), **changes)


def drawn(wanted, seed):
    a, b, centre = draw_coefficients(np.random.default_rng(seed), wanted.needs.motion, 0.2, 3, (0.6, 0.9))
    return FourierTrajectory(wanted.joints, centre, a, b, 0.2, 2)


@given(st.integers(0, 10_000), st.integers(1, 6))
@settings(max_examples=25, deadline=None)
def test_a_point_that_uses_its_limits_up_exceeds_them_at_no_instant(seed, harmonics):
    space = SeriesSpace(ARM.joint_names, LIMITS, 0.15, harmonics)
    z = np.random.default_rng(seed).normal(size=space.shape)
    z /= space.usage(z)[:, None]
    series = space.series(z, 1)
    t = np.sort(np.random.default_rng(seed).uniform(0, series.period_s, 4000))
    motion = series.evaluate(t)
    assert LIMITS.usage(motion).max() <= 1 + 1e-9
    jerk = (series.evaluate(t + 1e-4).qdd - series.evaluate(t - 1e-4).qdd) / 2e-4
    assert np.all(np.abs(jerk) <= LIMITS.jerk * (1 + 1e-5))
    np.testing.assert_allclose(space.point(series), z, atol=1e-9)
    # Not shrunk by more than the few per mille that the guarantee costs, either.
    both = np.max([LIMITS.usage(motion), (np.abs(jerk) / LIMITS.jerk).max(axis=0)], axis=0)
    assert both.min() > 0.97


def test_descent_finds_the_nearest_point_of_a_polygon_and_stays_inside():
    """min |z − (3, 1)|² over |z1| <= 1, |z1 + z2| <= 1 is the corner (1, 0)."""
    goal, rows = np.array([[3.0, 1.0]]), [np.array([[1.0, 0.0], [1.0, 1.0]])]
    visited = []

    def function(z):
        visited.append(z.copy())
        return float(np.sum((z - goal) ** 2)), 2 * (z - goal)

    found = descend(function, np.zeros((1, 2)), rows, 60, 1e-9)
    np.testing.assert_allclose(found.point, [[1.0, 0.0]], atol=1e-5)
    assert all(np.abs(rows[0] @ z[0]).max() <= 1 + 1e-9 for z in visited)


def test_descent_backs_off_from_where_the_function_is_infinite():
    def function(z):
        x = float(z[0, 0])
        return (
            (np.inf, np.zeros_like(z))
            if x >= 0.5
            else (-x - 0.01 * np.log(0.5 - x), np.array([[-1 + 0.01 / (0.5 - x)]]))
        )

    found = descend(function, np.zeros((1, 1)), [np.array([[1.0]])], 60, 1e-10)
    assert found.point[0, 0] == pytest.approx(0.49, abs=1e-3)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_comes_out_better_than_the_best_of_many_random_motions(criterion):
    wanted = problem(criterion)
    found = optimise(wanted, seed=3)
    random = min(exact_value(wanted, drawn(wanted, seed)) for seed in range(40))
    assert exact_value(wanted, found.series) < random
    assert all(margin.kept for margin in found.margins)


def independent_torque(motion):
    """Pinocchio's Newton-Euler with friction and rotors written out."""
    model = pin.buildModelFromXML(small_arm.URDF)
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    return rigid + COULOMB * np.sign(motion.qd) + VISCOUS * motion.qd + ROTOR * motion.qdd


def test_all_limits_hold_on_an_independent_grid_and_bind():
    found = optimise(problem(), seed=0)
    run = found.run
    times = np.arange(0.0, run.duration_s, 0.0017)
    motion = run.evaluate(times)
    assert LIMITS.usage(motion).max() <= 1 + 1e-4
    jerk = np.diff(motion.qdd, axis=0) / 0.0017
    assert np.all(np.abs(jerk) <= LIMITS.jerk * 1.001)
    torque = np.abs(independent_torque(motion)).max(axis=0)
    assert np.all(torque <= np.array([20.0, 18.0]) * (1 + 1e-3))
    assert torque[0] > 0.8 * 20.0
    for end in (0.0, run.duration_s):
        np.testing.assert_allclose(run.evaluate(end).at(0), [[0.1, 0.2], [0, 0], [0, 0]], atol=1e-9)


def test_the_same_seed_gives_the_same_trajectory_and_another_seed_another():
    one, same, other = (optimise(problem(), seed=seed).series for seed in (5, 5, 6))
    assert np.array_equal(one.a, same.a) and np.array_equal(one.q0, same.q0)
    t = np.linspace(0.0, 5.0, 100)
    assert np.abs(one.evaluate(t).q - other.evaluate(t).q).max() > 0.1


def estimates_spread(wanted, series, trials=60):
    """Root mean square error of predicted torque over noisy least-squares fits, by linear algebra of its own."""
    model, leads = wanted.question.identified, list(wanted.question.leads)
    noise = wanted.question.noise_Nm

    def columns(motion):
        out = []
        for number in leads:
            unit = np.zeros(len(model.parameters))
            unit[number] = 1.0
            out.append(model_torque(IdentifiedModel(model.model, unit, model.constants), motion, 100.0))
        return np.array(out).transpose(1, 2, 0)

    weights = np.tile(1 / noise, 500)[:, None]
    fit = columns(series.evaluate(np.arange(500) / 100.0)).reshape(-1, len(leads)) * weights
    solver = np.linalg.pinv(fit)
    rng = np.random.default_rng(0)
    errors = solver @ rng.normal(size=(len(fit), trials))
    tests = [columns(drawn(wanted, 900 + k).evaluate(np.arange(100) / 20.0)) for k in range(4)]
    return np.sqrt(np.mean([np.mean((test @ errors / noise[:, None]) ** 2) for test in tests]))


def test_what_is_fitted_to_noisy_torques_predicts_better_after_the_optimised_run():
    wanted = problem(PREDICTION)
    best = estimates_spread(wanted, optimise(wanted, seed=0).series)
    random = [estimates_spread(wanted, drawn(wanted, seed)) for seed in range(8)]
    assert best < 0.85 * np.median(random) and best < min(random)


def test_the_number_of_harmonics_is_where_a_further_one_gains_little():
    found = optimise_harmonics(problem(SCALED_CONDITION), seed=0)
    numbers, values = zip(*found.tried, strict=True)
    assert numbers[0] == 3 and list(numbers) == list(range(3, 3 + len(numbers)))
    chosen = found.problem.harmonics
    best = values[numbers.index(chosen)]
    assert best == min(values[: numbers.index(chosen) + 1])
    # What comes after gains little; one more than the first of these was tried only where that had gained nothing.
    after = values[numbers.index(chosen) + 1 :]
    assert all(value > 0.97 * best for value in after)
    assert len(after) == 1 or numbers[-1] == 10 or (len(after) == 2 and after[0] > 0.998 * best)
    # A structure that swings at 0.5 Hz leaves two harmonics of 0.2 Hz.
    soft = replace(problem().needs, structural_hz=0.5)
    assert optimise_harmonics(problem(needs=soft), seed=0).problem.harmonics == 2


def test_the_genetic_algorithm_gets_better_with_its_generations_and_repeats_with_its_seed():
    wanted = problem(SCALED_CONDITION)
    early, late, again = (evolve(wanted, 1, population=16, generations=n) for n in (1, 25, 25))
    assert exact_value(wanted, late.series) < exact_value(wanted, early.series) - 0.05
    assert np.array_equal(late.series.a, again.series.a)
    assert all(margin.kept for margin in late.margins)


def test_an_optimised_arm_keeps_off_the_ground_and_its_clearance_costs_information():
    arm = arm_from_urdf(urdf_of(THREE_LINKS))
    model = identified(arm)
    limits = MotionLimits(np.full(3, -2.8), np.full(3, 2.8), np.full(3, 2.0), np.full(3, 6.0))
    clearance = Clearance(arm, 0.2, limits.lower, limits.upper, 0.05)
    free = Requirements(limits, np.full(3, np.inf), model)
    wanted = Problem(Question.of(model), free, D_OPTIMAL, 0.2, 3, 1, np.array([0.0, 0.3, 0.3]))
    bounded = optimise(replace(wanted, needs=replace(free, clearance=clearance)), seed=0)
    unbounded = optimise(wanted, seed=0)
    postures = bounded.run.evaluate(np.arange(0.0, bounded.run.duration_s, 0.013)).q
    assert clearance.nearest(postures).distance_m >= 0.05 - 1e-3
    assert clearance.nearest(unbounded.series.evaluate(np.linspace(0, 5, 300)).q).distance_m < 0.0
    assert exact_value(wanted, unbounded.series) < exact_value(wanted, bounded.series)


def test_limits_that_leave_no_motion_are_refused_with_which_and_by_how_much():
    weak = replace(problem().needs, torque_Nm=np.array([2.0, 18.0]))
    with pytest.raises(
        UserError, match=r"already at rest in the start posture, torque of shoulder: .* allowed is 2 N·m"
    ):
        optimise(problem(needs=weak))
    with pytest.raises(UserError, match=r"in the start posture, position of elbow: 2\.9 rad"):
        optimise(problem(start=np.array([0.0, 2.9])))
    soft = replace(problem().needs, structural_hz=0.5)
    with pytest.raises(
        UserError, match=r"3 harmonics of 0\.2 Hz reach 0\.6 Hz, 0\.1 Hz above .* --harmonics 2 at most"
    ):
        optimise(problem(needs=soft))
    with pytest.raises(UserError, match="no criterion 'e-optimal': choose one of condition"):
        optimise(problem("e-optimal"))


def test_no_motion_at_the_limit_itself_is_refused_with_the_limit_and_the_options():
    """A distance that no motion changes, at the limit but for rounding: rest passes the check, the barrier does not."""
    pair = ("upper", "lower")
    at_limit = SimpleNamespace(
        needed_m=0.02,
        nearest=lambda postures: Nearest(0.02 * (1 - 1e-9), 0, pair),
        barrier=lambda postures, reach_m, slopes=True: (np.inf, np.zeros_like(postures)),
    )
    needs = replace(problem().needs, clearance=at_limit)
    with pytest.raises(UserError, match=r"clearance of upper and lower: 0\.02 m .* 0\.02 m; .*--start.*--clearance"):
        optimise(problem(needs=needs))


def test_friction_the_joint_cannot_overcome_is_named_though_rest_is_possible():
    """At rest friction counts for nothing; any motion meets all of it at once."""
    stuck = replace(problem().needs, torque_Nm=np.array([20.0, 1.4]))
    with pytest.raises(UserError, match=r"torque of elbow: .* allowed is 1\.4 N·m"):
        optimise(problem(needs=stuck, start=np.zeros(2)))


def test_margins_reported_are_those_of_the_whole_run():
    found = optimise(problem(), seed=0)
    again = check(found.run, found.problem.needs)
    assert [(m.kind, m.where, m.value) for m in found.margins] == [(m.kind, m.where, m.value) for m in again]
    assert {m.kind for m in found.margins} == {"position", "velocity", "acceleration", "jerk", "torque"}


def test_with_room_for_stalls_torque_holds_with_more_acceleration_and_the_derivatives_are_exact():
    tight = replace(problem().needs, torque_Nm=np.array([16.0, 7.0]), accelerations=(1.0, 1.75, 0.58))
    wanted = problem(needs=tight)
    function = wanted.function(6.0, 0.1)
    point = 0.3 * wanted.space.point(drawn(wanted, 1)) + 0.7 * wanted.home
    value, slope = function(point)
    assert np.isfinite(value)
    rng = np.random.default_rng(0)
    for _ in range(4):
        direction = rng.normal(size=point.shape)
        step = 1e-6
        change = (function(point + step * direction)[0] - function(point - step * direction)[0]) / (2 * step)
        assert np.sum(slope * direction) == pytest.approx(change, rel=1e-4, abs=1e-6)
    found = optimise(wanted, seed=3)
    motion = found.series.evaluate(np.arange(0.0, found.series.period_s, 0.002))
    for factor in (1.0, 1.75, 0.58):
        torque = model_torque(tight.identified, Motion(motion.q, motion.qd, factor * motion.qdd), 500.0)
        assert np.all(np.abs(torque) <= tight.torque_Nm * (1 + 1e-6))
    # It is what binds: without, the same limits allow a motion that breaks them after a stall.
    free = optimise(problem(needs=replace(tight, accelerations=(1.0,))), seed=3)
    motion = free.series.evaluate(np.arange(0.0, free.series.period_s, 0.002))
    torque = model_torque(tight.identified, Motion(motion.q, motion.qd, 1.75 * motion.qdd), 500.0)
    assert np.any(np.abs(torque) > 1.02 * tight.torque_Nm)


def test_starts_with_an_obstacle_between_them_and_rest_come_last():
    """A wall at half the way of the best two; with them a UR5 is led round the floor, and cannot be joined to rest."""
    rest = SimpleNamespace(home=np.zeros(2))
    walled = lambda point: (np.inf if 0.4 < point[0] < 0.6 else float(np.sum(point)), np.zeros(2))  # noqa: E731
    drawn = [
        (0.0, np.array([1.0, 0.0])),
        (1.0, np.array([1.0, 1.0])),
        (2.0, np.array([0.0, 2.0])),
        (3.0, np.array([0.1, 3.0])),
    ]
    assert [value for value, _ in _reachable(rest, walled, drawn, 2)] == [2.0, 3.0]
    assert [value for value, _ in _reachable(rest, walled, drawn, 3)] == [2.0, 3.0, 0.0]
