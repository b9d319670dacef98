"""Rows, noise and joint refit of the mismatch engine, against closed forms and brute force."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, LAWS, ripple, run
from planted_arm import two_link_run
from scipy.signal import lfilter

from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.mismatch.candidate import refit
from spacearm_ident.mismatch.evidence import NEARER
from spacearm_ident.mismatch.judgement import BEYOND_A_DAY
from spacearm_ident.mismatch.preparation import banded, prepare_evidence
from spacearm_ident.mismatch.residuals import Residuals
from spacearm_ident.mismatch.rivals import Rival, rivals
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.mismatch.scene import (
    FEWEST_ROWS,
    LARGEST_ROOT,
    NEAR,
    SLOW,
    Scene,
    Whitener,
    coarse,
    fit_whitener,
    inflated,
    one_way,
    stable,
    stretch,
    travel,
)
from spacearm_ident.mismatch.scored import BEST, PARTS, penalty, throughout
from spacearm_ident.mismatch.stacked import NUISANCE, base_columns, nuisance_scale, stacked_effect
from spacearm_ident.recording.recording import Recording
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.signals.prepare import prepare

# --- rows -----------------------------------------------------------------------------------------------------------


def test_after_its_whitener_coloured_noise_is_white_with_variance_one():
    rng = np.random.default_rng(0)
    noise = [0.3 * lfilter([1.0], [1.0, -1.2, 0.5], rng.standard_normal(4000)) for _ in range(2)]
    whitener = fit_whitener(noise, [np.ones(4000, bool)] * 2, 4, 1e-6)
    np.testing.assert_allclose(whitener.coefficients, [1.2, -0.5, 0.0, 0.0], atol=0.06)
    assert whitener.sigma_Nm == pytest.approx(0.3, rel=0.04)
    white = whitener.matrix(np.arange(4000)) @ noise[0]
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.08)
    lags = [np.mean(white[lag:] * white[:-lag]) for lag in range(1, 8)]
    assert np.abs(lags).max() < 4 / np.sqrt(len(white))


def test_outliers_do_not_define_the_noise_and_few_rows_make_it_plain_or_unknown():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(4000)
    noise[1000:1010] += 500.0
    assert fit_whitener([noise], [np.ones(4000, bool)], 2, 1e-6).sigma_Nm == pytest.approx(1.0, rel=0.1)
    apart = np.tile([True, True, False], 40)
    few = fit_whitener([noise[:120]], [apart], 6, 1e-6)
    assert few.order <= 1 and few.sigma_Nm == pytest.approx(np.sqrt(np.mean(noise[:120][apart] ** 2)), rel=0.15)
    assert fit_whitener([np.zeros(FEWEST_ROWS)], [np.ones(FEWEST_ROWS, bool)], 0, 0.25).sigma_Nm == 0.25
    nothing = fit_whitener([noise[: FEWEST_ROWS - 1]], [np.ones(FEWEST_ROWS - 1, bool)], 6, 1e-6)
    assert nothing.order == 0 and nothing.sigma_Nm == np.inf


def test_a_stretch_is_counted_from_where_the_last_one_was_broken():
    moving = np.array([0, 1, 1, 0, 0, 1, 1, 1], bool)
    np.testing.assert_array_equal(stretch(moving), [-1, 0, 1, -1, -1, 0, 1, 2])
    np.testing.assert_array_equal(stretch(np.zeros(3, bool)), [-1, -1, -1])


def test_the_first_rows_of_a_stretch_are_white_too():
    """Of noise that remembers, 3000 stretches of five rows, with none known before them."""
    rng = np.random.default_rng(4)
    noise = lfilter([1.0], [1.0, -1.6, 0.8], rng.standard_normal(3000 * 60)).reshape(3000, 60)[:, -5:]
    whitener = Whitener(np.array([1.6, -0.8]), 1.0)
    white = (whitener.matrix(np.tile(np.arange(5), 3000)) @ noise.ravel()).reshape(3000, 5)
    np.testing.assert_allclose(np.cov(white.T), np.eye(5), atol=5 / np.sqrt(3000))
    np.testing.assert_allclose(whitener.predictors[0][1] ** 2, np.mean(noise**2), rtol=0.05)


@pytest.mark.parametrize("coefficients", [(1.0,), (1.2, 0.0), (2.0, -1.0), (0.3, 0.2, 0.9)])
def test_noise_without_end_is_taken_for_noise_that_forgets(coefficients):
    tamed = stable(np.array(coefficients))
    assert np.abs(np.roots([1.0, *-tamed])).max() == pytest.approx(LARGEST_ROOT)
    assert np.isfinite(Whitener(tamed, 1.0).predictors[0][1])
    np.testing.assert_array_equal(stable(0.5 * tamed), 0.5 * tamed)


def test_slow_rows_and_rows_after_a_reversal_count_for_less():
    inflation = np.ones((len(SLOW) + 1, len(NEAR) + 1))
    inflation[0], inflation[1], inflation[:, 0] = 16.0, 4.0, 100.0
    whitener = Whitener(np.zeros(0), 1.0, inflation)
    speed, gone = np.array([0.001, -0.004, 0.01, 1.0, 0.001]), np.array([1.0, 1.0, 1.0, 1e-4, 1e-4])
    np.testing.assert_allclose(whitener.weight(speed, gone), [0.25, 0.5, 1.0, 0.1, 0.1])


def test_beside_an_effect_rows_near_a_reversal_count_for_what_is_left_there():
    """That does not become less with what is left elsewhere: such rows would decide over any further effect."""

    def disturbed(planted):
        since = np.cumsum(np.abs(planted.qd[:, 1])) / 250.0
        turned = np.concatenate([[True], np.diff(np.sign(planted.qd[:, 1])) != 0.0])
        near = since - np.maximum.accumulate(np.where(turned, since, 0.0)) < 0.5 * NEAR[-1]
        jolts = np.where(near, 3.0 * np.random.default_rng(5).standard_normal(len(near)), 0.0)
        return 3.0 * ripple(planted) + np.outer(jolts, [0.0, 1.0])

    before = prepare_evidence(ARM, RunSet([run(2, disturbed)], validation=[run(3, disturbed)]))
    effect = EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"})
    after = before.beside([before.evidence.candidate(effect, (20.0,))])
    assert after is not None
    row = ARM.joint_names.index("elbow")
    assert after.noise_floor_Nm[row] < 0.3 * before.noise_floor_Nm[row]
    field = after.evidence.field
    left = after.evidence.residual_beside([after.evidence.candidate(effect, (20.0,))])
    own = field.joint == row
    near, far = (
        np.sqrt(np.mean(left[own & rows] ** 2)) for rows in (field.gone < NEAR[-1], field.gone > 10 * NEAR[-1])
    )
    assert near < 4.0 * far
    held = after.held_out.scene.whiteners[row].inflation
    np.testing.assert_array_equal(held, after.plain[row].inflation)
    assert held[-1, 0] > 3.0 * before.plain[row].inflation[-1, 0]


def test_creeping_far_from_a_reversal_counts_for_less_where_the_reference_shows_it():
    """However much rows count for that are as slow beside a reversal; and slower still is no better known."""
    base = prepare_evidence(ARM, RunSet([run(2)], [HEALTHY])).base
    (motion,), _ = prepare([HEALTHY], ARM.joint_names, 40.0, average=False)
    scene = Scene(base, [coarse(motion, 20.0)], [Whitener(np.zeros(0), 1.0)] * 2)
    creeping = (np.abs(scene.speed) < SLOW[-1]) & (scene.gone > NEAR[-1])
    assert 5 < creeping[scene.joint == 1].sum() < 0.2 * (scene.joint == 1).sum()
    noise = np.random.default_rng(3).standard_normal(len(scene))
    found = inflated(scene.whiteners, scene, np.where(creeping, 10.0, 1.0) * noise)[1]
    assert found.inflation[len(SLOW) - 1, -1] > 30.0
    assert np.all(found.inflation[: len(SLOW), :] >= found.inflation[len(SLOW) - 1, -1])
    assert np.all(found.inflation[-1] < 3.0)


def test_the_reference_shows_what_rows_after_a_reversal_are_worth():
    """Noise ten times as large where a joint has gone little: found, told from slow rows, and weighed."""
    base = prepare_evidence(ARM, RunSet([run(2)], [HEALTHY])).base
    (motion,), _ = prepare([HEALTHY], ARM.joint_names, 40.0, average=False)
    scene = Scene(base, [coarse(motion, 20.0)], [Whitener(np.zeros(0), 1.0)] * 2)
    rng = np.random.default_rng(3)
    near = scene.gone < NEAR[-1]
    assert 20 < near[scene.joint == 1].sum() < 0.5 * (scene.joint == 1).sum()
    found = inflated(scene.whiteners, scene, np.where(near, 10.0, 1.0) * rng.standard_normal(len(scene)))[1]
    assert 50.0 < found.inflation[-1, -2] <= found.inflation[-1, 0] < 400.0
    assert max(found.inflation[:, -1]) < 3.0


def test_of_rows_a_joint_never_had_the_others_tell():
    """The first joint never crept; the second did, ten times as loud. Where no joint is louder, none is."""
    speed = np.concatenate([np.full(1000, 0.5), np.full(50, 0.01)])
    residual = np.concatenate([np.random.default_rng(6).standard_normal(1000), np.full(50, 10.0)])
    joint = np.repeat([0, 1, 1], [500, 500, 50])
    scene = SimpleNamespace(joint=joint, speed=speed, gone=np.full(1050, 0.1), weight=np.ones(1050))
    never, did = inflated([Whitener(np.zeros(0), 1.0)] * 2, scene, residual)
    creeping = int(np.searchsorted(SLOW, 0.01))
    assert never.inflation[creeping, -1] == pytest.approx(100.0, rel=0.2)
    assert did.inflation[creeping, -1] == pytest.approx(100.0, rel=0.2)
    np.testing.assert_array_equal(never.inflation[-1, -1], 1.0)
    even = inflated([Whitener(np.zeros(0), 1.0)] * 2, scene, np.where(np.arange(1050) < 1000, residual, 1.0))[0]
    assert even.inflation[creeping, -1] < 1.5


def test_a_jolt_goes_through_the_same_low_pass_as_torque_and_as_acceleration():
    """Of a unit inertia that shakes at 12 Hz, but for what the low-pass of positions takes of that."""
    time = np.arange(8000) / 1000.0
    turns = 2 * np.pi * np.array([0.5, 12.0])[:, None] * time
    shaken = (np.array([0.5, 1e-3])[:, None] * np.sin(turns)).sum(axis=0)
    effort = -(np.array([0.5 * np.pi**2, 1e-3 * (24 * np.pi) ** 2])[:, None] * np.sin(turns)).sum(axis=0)
    recording = Recording(("only",), time, shaken[:, None], None, effort[:, None], (slice(0, len(time)),))
    (motion,) = banded([recording], ("only",), 20.0, 80.0)
    jolt = 1e-3 * (24 * np.pi) ** 2
    assert np.abs(motion.torque_rows).max() > 4.0 + 0.4 * jolt
    assert np.abs(motion.reduce(motion.acceleration) - motion.torque_rows).max() < 0.03 * jolt


def test_travel_starts_anew_at_every_reversal():
    (motion,), _ = prepare([HEALTHY], ARM.joint_names, 40.0, average=False)
    gone = travel(motion)[:, 0]
    sound = one_way(motion)[:, 0]
    turned = np.diff(np.sign(motion.velocity_rows[:, 0])) != 0
    assert (gone[sound] >= 0).all() and turned.sum() > 3
    # Between two reversals it is the distance from the first, to what passes while a row's window fills.
    first, second = np.flatnonzero(turned)[:2]
    position = motion.reduce(motion.position)[:, 0]
    middle = (first + second) // 2
    start = (
        position[first : second + 1].min() if position[middle] > position[first] else position[first : second + 1].max()
    )
    assert gone[middle] == pytest.approx(abs(position[middle] - start), abs=0.02)


def test_a_coarse_motion_is_the_mean_of_its_samples_at_their_middle():
    (motion,), _ = prepare([HEALTHY], ARM.joint_names, 40.0, average=False)
    fine = replace(motion, rate_hz=1000.0)
    slow = coarse(fine, 20.0)
    assert slow.rate_hz == 250.0
    assert slow.start_s == pytest.approx(fine.start_s + 1.5e-3)
    np.testing.assert_allclose(slow.velocity[7], fine.velocity[28:32].mean(axis=0))
    np.testing.assert_allclose(slow.torque[7], fine.torque[28:32].mean(axis=0))


# --- evidence against brute force -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def prepared():
    return prepare_evidence(ARM, RunSet([run(2, ripple)], [HEALTHY], [run(3, ripple)]))


def candidates_of(evidence):
    """Free and held parameters, one joint and both, constants and none."""
    effects = [
        (EFFECTS["torque_ripple"], {"joint": "elbow"}, [20.0]),
        (EFFECTS["friction_drift"], {"joint": "shoulder", "of": ["f_c", "k_v1"]}, []),
        (EFFECTS["joint_elasticity"], {"joint": "elbow"}, [3000.0, 0.05]),
        (EFFECTS["payload"], {"joint": "elbow"}, []),
    ]
    return [evidence.candidate(kind.at(ARM, place), constants) for kind, place, constants in effects]


class Brute:
    """Everything in one least-squares problem of all rows, base and effects side by side."""

    def __init__(self, evidence, shifts=None):
        """Take evidence, and (F, s) torque that the field alone may have, one standard deviation a column."""
        scenes = [evidence.field, evidence.reference]
        base = np.concatenate([base_columns(evidence.base, scene, ()) for scene in scenes])
        prior = make_prior(evidence.base.model, [motion for scene in scenes for motion in scene.motions])
        known, beside = prior.rows.shape[1], NUISANCE * len(ARM.joints)
        belief = np.zeros((len(prior.rows) + beside, base.shape[1]))
        belief[: len(prior.rows), :known] = NEARER * prior.rows
        belief[len(prior.rows) :, known:] = np.diag(1.0 / nuisance_scale(evidence.base))
        self.columns = np.concatenate([base, belief])
        near = NEARER * prior.rows @ evidence.base.parameters
        self.torque = np.concatenate([*(scene.torque() for scene in scenes), near, np.zeros(beside)])
        self.rows = len(evidence.field)
        if shifts is not None:
            count = shifts.shape[1]
            elsewhere = np.zeros((len(self.columns) - self.rows, count))
            self.columns = np.hstack([self.columns, np.concatenate([shifts, elsewhere])])
            of_their_own = np.hstack([np.zeros((count, self.columns.shape[1] - count)), np.eye(count)])
            self.columns = np.concatenate([self.columns, of_their_own])
            self.torque = np.concatenate([self.torque, np.zeros(count)])
        self.used = np.any(self.columns != 0, axis=0)

    def solve(self, candidates):
        """Chi-square, base's parameters, effects' values."""
        target, free = self.torque.copy(), [self.columns[:, self.used]]
        held = []
        for candidate in candidates:
            whole = np.zeros((len(target), len(candidate.effect.parameters)))
            whole[: self.rows][candidate.stacked.rows] = candidate.stacked.columns
            for k, parameter in enumerate(candidate.effect.parameters):
                held.append(parameter.held)
                if held[-1]:
                    target = target - whole[:, k] * parameter.prior
                else:
                    free.append(whole[:, [k]])
        columns = np.concatenate(free, axis=1)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        solution = np.linalg.lstsq(columns / size, target, rcond=1e-14)[0] / size
        residual = target - columns @ solution
        base = np.zeros(len(self.used))
        base[self.used] = solution[: self.used.sum()]
        values = np.array([p.prior for c in candidates for p in c.effect.parameters])
        values[~np.array(held, bool)] = solution[self.used.sum() :]
        return float(residual @ residual), residual[: self.rows], base, values


SETS = [(0,), (1,), (2,), (3,), (0, 1), (0, 2, 3), (0, 1, 2, 3)]


@pytest.mark.parametrize("chosen", SETS)
def test_a_gain_is_the_drop_of_the_sum_of_squares_of_everything_fitted_together(prepared, chosen):
    evidence = prepared.evidence
    candidates = [candidates_of(evidence)[k] for k in chosen]
    brute = Brute(evidence)
    without, *_ = brute.solve([])
    squares, residual, _, values = brute.solve(candidates)
    found = refit(candidates)
    assert found.gain == pytest.approx(without - squares, rel=1e-6, abs=1e-5 * without)
    np.testing.assert_allclose(found.values, values, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(evidence.residual_beside(candidates), residual, atol=1e-5 * np.abs(residual).max())
    assert np.all((found.visibility >= 0) & (found.visibility <= 1 + 1e-9))


@pytest.mark.parametrize("chosen", SETS)
def test_columns_in_half_the_memory_lose_nothing_that_is_decided_on(prepared, chosen):
    evidence = prepared.evidence
    exact = [candidates_of(evidence)[k] for k in chosen]
    rounded = [evidence.candidates(one.effect, [one.constants])[0] for one in exact]
    assert sum(one.stacked.kept.nbytes for one in exact) == 2 * sum(one.stacked.kept.nbytes for one in rounded)
    want = refit(exact)
    for some in (rounded, [*rounded[:1], *exact[1:]]):
        found = refit(some)
        assert found.gain == pytest.approx(want.gain, rel=1e-6)
        np.testing.assert_allclose(found.values, want.values, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("chosen", [(1,), (0, 1, 2, 3)])
def test_friction_of_another_day_is_least_squares_with_shifts_of_the_field_alone(prepared, chosen):
    """Coulomb friction off by 3 % and viscous by 6 % at each joint, 1.5 times that, beside everything else."""
    evidence, day = prepared.evidence, prepared.evidence.with_days(1.5)
    model, columns = evidence.base.model, base_columns(evidence.base, evidence.field, ())
    sizes = {"f_c": 0.03, "f_b": 0.03, "k_v1": 0.06, "k_v2": 0.06, "k_v3": 0.06}
    shifts = np.zeros((evidence.rows, 4))
    for number, parameter in enumerate(model.parameters):
        if parameter.symbol in sizes:
            column = 2 * (parameter.joint == "elbow") + parameter.symbol.startswith("k_v")
            value = evidence.base.parameters[number]
            shifts[:, column] += 1.5 * sizes[parameter.symbol] * value * columns[:, number]
    brute = Brute(evidence, shifts)
    candidates = [candidates_of(evidence)[k] for k in chosen]
    without, *_ = brute.solve([])
    squares, _, _, values = brute.solve(candidates)
    found = refit(day.again(candidates))
    assert found.gain == pytest.approx(without - squares, rel=1e-6, abs=1e-5 * without)
    np.testing.assert_allclose(found.values, values, rtol=1e-5, atol=1e-7)
    # What a day may bring is no longer the effect's, and the effect's size is less sure.
    same = refit(candidates)
    assert found.gain < same.gain
    assert (np.diag(found.covariance) >= np.diag(same.covariance) * (1.0 - 1e-9)).all()


@pytest.mark.parametrize("cubic, drift, changed", [(0.4, 0.0, False), (0.0, 0.3, True), (0.1, 0.3, True)])
def test_a_course_of_friction_that_only_the_field_s_speeds_show_is_no_change_of_it(cubic, drift, changed):
    """The reference is slow, its structure has no cubic term, and the arm always had one."""

    def at(seed, speed, change=0.0):
        laws = LAWS[0], replace(LAWS[1], k_v3=cubic)
        return run(seed, lambda planted: np.outer(change * planted.qd[:, 1], [0.0, 1.0]), speed=speed, laws=laws)

    def straight(fit):
        held = {"held": {"elbow": ["k_v2", "k_v3"]}}
        return {**fit.regression.model.structure, "viscous_friction": held}, ()

    runs = RunSet([at(2, 1.5, drift)], [at(1, 0.6), at(4, 0.6)], [at(3, 1.5, drift)])
    evidence = prepare_evidence(ARM, runs, straight).evidence
    candidate = evidence.candidate(EFFECTS["friction_drift"].at(ARM, {"joint": "elbow", "of": ["k_v1"]}), ())
    day = evidence.with_days(1.0)
    assert refit([candidate]).gain > 100.0
    assert (refit(day.again([candidate])).gain > BEYOND_A_DAY) == changed


def test_in_thin_air_the_field_has_no_friction_of_high_order(prepared):
    """The same least squares with those columns set to zero in the field's rows."""
    evidence = prepared.evidence
    brute, high = Brute(evidence), np.flatnonzero(evidence.base.model.of_high_order)
    brute.columns[: brute.rows, high] = 0.0
    want, _, base, _ = brute.solve([])
    found, squares = evidence.in_vacuum
    assert squares == pytest.approx(want, rel=1e-4)
    np.testing.assert_allclose(found, base[: len(found)], rtol=1e-4, atol=1e-4 * np.abs(base).max())
    assert np.abs(found[high]).min() > 0


@pytest.mark.parametrize("chosen", [(), (0,), (0, 1, 2, 3)])
def test_unseen_residuals_are_those_of_the_fitted_model_on_other_rows(prepared, chosen):
    evidence, held_out = prepared.evidence, prepared.held_out
    candidates = [candidates_of(evidence)[k] for k in chosen]
    _, _, base, values = Brute(evidence).solve(candidates)
    want = held_out.scene.torque() - base_columns(evidence.base, held_out.scene, ()) @ base
    first = 0
    for candidate in candidates:
        own = values[first : first + len(candidate.effect.parameters)]
        first += len(own)
        stacked = stacked_effect(held_out.scene, candidate.effect, candidate.constants)
        want[stacked.rows] -= stacked.columns @ own
    found = held_out.residual(candidates, refit(candidates).values)
    np.testing.assert_allclose(found, want, atol=1e-5 * np.abs(want).max())


def test_stacked_rows_are_reduced_filtered_and_weighted_columns(prepared):
    """An independent filter on each motion's rows, joint by joint."""
    scene = prepared.evidence.field
    effect = EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"})
    stacked = stacked_effect(scene, effect, [20.0])
    motion, whitener = scene.motions[0], scene.whiteners[1]
    reduced = motion.reduce(np.cos(20.0 * motion.position[:, 1]))
    white = lfilter([1.0, *-whitener.coefficients], [whitener.sigma_Nm], reduced)
    weighted = white * whitener.weight(motion.velocity_rows[:, 1], travel(motion)[:, 1])
    slot = scene.slot(1, 0)
    assert (stacked.rows.start, stacked.rows.stop) == (slot.start, slot.stop)
    before = stretch(scene.sound[0][:, 1])
    place = scene.place[slot]
    np.testing.assert_array_equal(place, np.flatnonzero(before >= 0))
    inside = before[place] >= whitener.order
    np.testing.assert_allclose(stacked.columns[inside, 1], weighted[place[inside]], atol=1e-9)
    assert inside.any() and not inside.all()


def test_a_healthy_arm_leaves_white_noise_of_variance_one(prepared):
    healthy = prepare_evidence(ARM, RunSet([run(2)], [HEALTHY], [run(3)]))
    residual = healthy.evidence.residual
    assert np.mean(residual**2) == pytest.approx(1.0, abs=0.35)
    assert np.mean(prepared.evidence.residual**2) > 10.0


def dip(planted):
    """Less friction below some 0.08 rad/s, which no term of the base model is."""
    return np.outer(-np.sign(planted.qd[:, 0]) * np.exp(-((planted.qd[:, 0] / 0.08) ** 2)), [2.0, 0.0])


def test_how_friction_runs_through_a_reversal_is_told_to_the_field_by_the_reference():
    evidence = prepare_evidence(ARM, RunSet([run(2)], [run(1, dip)], [run(3)])).evidence
    (motion,), (background,) = evidence.field.motions, evidence.field.backgrounds
    np.testing.assert_array_equal(background.whole, background.torque)
    evidence.fit_reversals([evidence.field])
    planted = two_link_run(LAWS, seconds=16.0, rate_hz=250.0, seed=2, speed=1.0)
    true, speed = planted.torque + dip(planted), np.abs(planted.qd[:, 0])
    cut = (len(true) - len(motion.velocity)) // 2
    true, speed = true[cut:-cut, 0], speed[cut:-cut]
    for rows in ((speed > 0.03) & (speed < 0.06), speed > 0.4):
        assert rows.sum() > 50
        plain, told = (np.std((torque[:, 0] - true)[rows]) for torque in (background.torque, background.whole))
        assert told < 0.03 < plain


def test_freedom_costs():
    drift, both = ({"joint": "elbow", "of": of} for of in (["f_c"], ["f_c", "k_v1"]))
    one, two = (penalty(EFFECTS["friction_drift"].at(ARM, place), 1000) for place in (drift, both))
    assert two == pytest.approx(2 * one) == pytest.approx(2 * np.log(1000))
    searched = penalty(EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"}), 1000)
    assert searched > 3 * np.log(1000)
    rocking = EFFECTS["base_flexibility"].at(ARM, {"axis": [1, 0, 0]})
    assert penalty(rocking, 1000) == pytest.approx(2 * np.log(1000) + 2 * np.log(len(rocking.constants[0].grid)))


def test_rivals_cover_every_joint_and_are_finite(prepared):
    motions = prepared.evidence.field.motions
    places = list(rivals(motions))
    assert {place["joint"] for place in places} == set(ARM.joint_names)
    for place in places:
        rival = Rival.at(ARM, place)
        constants = [constant.grid[len(constant.grid) // 2] for constant in rival.constants]
        for row, (_, columns) in rival.columns(motions[0], constants, None).items():
            assert ARM.joint_names[row] == place["joint"] and np.isfinite(columns).all()


def test_a_band_is_taken_out_of_a_residual_and_the_rest_stays(prepared):
    evidence = prepared.evidence
    residuals = Residuals(evidence, evidence.field, prepared.plain)
    scene = residuals.scene
    (motion,) = scene.motions
    time = motion.time[scene.place]
    swing, rest = np.sin(2 * np.pi * 8.0 * time), np.sin(2 * np.pi * 2.0 * time)
    left = residuals.without_band(swing + rest, [(6.5, 9.5)])
    assert np.std(left - rest) < 0.25 * np.std(swing)
    np.testing.assert_array_equal(residuals.without_band(swing, [None]), swing)


def test_what_is_loud_in_a_moment_alone_is_not_loud_throughout(prepared):
    residuals = Residuals(prepared.evidence, prepared.evidence.field, prepared.plain)
    scene = residuals.scene
    part, elbow = scene.part(PARTS), scene.joint == 1
    even = np.where(elbow, 2.0, 1.0)
    np.testing.assert_allclose(residuals.rms_throughout(even), [1.0, 2.0])
    moment = even + 100.0 * (elbow & (part >= PARTS - BEST))
    np.testing.assert_allclose(residuals.rms_throughout(moment), [1.0, 2.0])
    assert residuals.rms(moment)[1] > 20.0
    longer = even + 100.0 * (elbow & (part >= PARTS - BEST - 1))
    assert residuals.rms_throughout(longer)[1] > 20.0


def test_a_drop_is_counted_without_its_best_parts(prepared):
    scene = prepared.evidence.field
    part = scene.part(PARTS)
    assert np.all(np.diff(part[scene.joint == 0]) >= 0) and set(part) == set(range(PARTS))
    counts, none = np.bincount(part), np.zeros(len(scene))
    even = throughout(scene, np.ones(len(scene)), none)
    assert even == len(scene) - np.sort(counts)[-BEST:].sum()
    assert throughout(scene, np.where(part < BEST, 5.0, 0.0), none) == 0.0
    assert throughout(scene, none, np.where(part == 3, 1.0, 0.0)) == -counts[3]
