"""What a healthy arm's recordings differ by: fits that leave parts out, the noise model, and the size of a finding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, ripple, run
from scipy.linalg import lstsq
from scipy.stats import t as student

from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.mismatch.candidate import refit
from spacearm_ident.mismatch.constants import grid_points
from spacearm_ident.mismatch.evidence import NEARER, Evidence
from spacearm_ident.mismatch.healthy import GROWS, UNNAMED, Healthy, healthy_levels
from spacearm_ident.mismatch.judgement import beyond_healthy
from spacearm_ident.mismatch.left_out import LEVEL, LeftOut, largest_rms
from spacearm_ident.mismatch.noise import coloured, weighted
from spacearm_ident.mismatch.null import exceeds_null
from spacearm_ident.mismatch.preparation import prepare_evidence
from spacearm_ident.mismatch.residuals import Residuals
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.mismatch.scene import Scene
from spacearm_ident.mismatch.stacked import base_columns, nuisance_scale
from spacearm_ident.recording import Recording, read_recording
from spacearm_ident.recording.recording import Series
from spacearm_ident.regression.held_out import t_of_all
from spacearm_ident.regression.prior import make_prior

REAL = Path(__file__).parents[2] / "shared" / "recordings" / "real"


@pytest.fixture(scope="module")
def prepared():
    return prepare_evidence(ARM, RunSet([run(2)], [HEALTHY], [run(3)]))


@pytest.fixture(scope="module")
def healthy(prepared):
    return prepared.evidence.healthy


def test_base_parameters_without_rows_equal_a_fit_to_the_others_and_errors_those_of_least_squares(healthy):
    scene = healthy.field
    prior = make_prior(healthy.base.model, scene.motions)
    beside = nuisance_scale(healthy.base)
    columns = base_columns(healthy.base, scene, ())
    belief = np.zeros((len(prior.rows) + len(beside), columns.shape[1]))
    belief[: len(prior.rows), : prior.rows.shape[1]] = NEARER * prior.rows
    belief[len(prior.rows) :, prior.rows.shape[1] :] = np.diag(1.0 / beside)
    whole = np.concatenate([columns, belief])
    used = np.any(whole != 0.0, axis=0)
    scatter = columns[:, used] @ np.linalg.pinv(whole[:, used])
    np.testing.assert_allclose(healthy.error_of(columns)[::50], np.linalg.norm(scatter[::50], axis=1), rtol=1e-4)
    left = np.arange(len(scene)) % 7 < 2
    whole = np.concatenate([columns[~left], belief])
    torque = np.concatenate(
        [scene.torque()[~left], NEARER * prior.rows @ healthy.base.parameters, np.zeros(len(beside))]
    )
    used = np.any(whole != 0.0, axis=0)
    brute = lstsq(whole[:, used], torque)[0]
    found = healthy.base_parameters_without(left)
    predicted = columns[left]
    np.testing.assert_allclose(predicted @ found, predicted[:, used] @ brute, atol=1e-5)
    assert np.abs(predicted @ found - predicted @ healthy.base_parameters([], np.zeros(0))).max() > 1e-4


def test_left_out_squares_exceed_those_of_the_whole_fit_and_the_error_grows_where_parts_disagree(prepared, healthy):
    residuals = Residuals(healthy, healthy.field, prepared.plain)
    left_out = LeftOut(healthy, residuals)
    own = residuals.rms(residuals.of(healthy.base_parameters([], np.zeros(0)), [], np.zeros(0)))
    assert (left_out.rms_Nm > own).all() and (left_out.rms_Nm < 1.5 * own).all()
    assert (left_out.largest_Nm > own).all() and left_out.times > 2.3
    judged = Residuals(prepared.evidence, prepared.held_out.scene, prepared.plain)
    assert (left_out.error_Nm(judged) > 0.0).all() and (left_out.error_Nm(judged) < own).all()
    middle = np.mean(left_out.fits, axis=0)
    left_out.fits = [middle + 3.0 * (fit - middle) for fit in left_out.fits]
    wider = left_out.error_Nm(judged)
    left_out.fits = [middle + (fit - middle) / 3.0 for fit in left_out.fits]
    np.testing.assert_allclose(left_out.error_Nm(judged), wider / 3.0)


def test_a_healthy_arm_may_leave_more_of_a_motion_that_is_faster_than_the_references(prepared):
    def acceleration(recording):
        velocity = np.gradient(recording.position, recording.time, axis=0)
        return np.std(np.gradient(velocity, recording.time, axis=0), axis=0)

    known, left = replace(prepared, weighted=True, days=0.0), []
    for speed in (0.5, 2.0):
        judged = run(3, speed=speed)
        faster = prepare_evidence(ARM, RunSet([run(2)], [HEALTHY], [judged])).held_out.scene
        residuals = Residuals(prepared.evidence, faster, prepared.plain)
        (healthy,) = healthy_levels(prepared.evidence, known, [residuals])
        error = np.maximum(healthy.left_out.error_Nm(residuals), residuals.error_Nm(prepared.evidence.healthy))
        left.append(np.sqrt(healthy.largest_Nm**2 - (healthy.left_out.times * error) ** 2))
    ratio = acceleration(judged) / acceleration(HEALTHY)
    assert (ratio > 1.3).all()
    np.testing.assert_allclose(left[1] / left[0], ratio**GROWS, rtol=0.05)


def test_the_largest_healthy_residual_is_exceeded_by_a_further_part_as_often_as_stated():
    """Log-normal mean squares of five parts at six joints, a thousand arms: the part after them."""
    rng = np.random.default_rng(0)
    beyond = 0
    for _ in range(1000):
        mean_square = np.exp(0.7 * rng.standard_normal((6, 6)) + rng.standard_normal(6))
        beyond += int(np.sum(np.sqrt(mean_square[5]) > largest_rms(4.0 * mean_square[:5], np.full((5, 6), 4.0))))
    assert beyond / 6000 == pytest.approx(LEVEL, abs=0.005)
    spread = np.log(9.0 / 4.0) / np.sqrt(2.0)
    above = student.ppf(1.0 - LEVEL, 1) * spread * np.sqrt(1.5)
    two = largest_rms(np.array([[4.0, 0.0], [9.0, 0.0]]), np.array([[1.0, 0.0], [1.0, 0.0]]))
    np.testing.assert_allclose(two, [np.sqrt(6.0) * np.exp(0.5 * above), np.nan])


def test_weighted_noise_counts_correlated_rows_for_less_and_coloured_noise_whitens_them(healthy):
    motions = [*healthy.field.motions]
    rng = np.random.default_rng(1)
    walk = np.zeros((len(motions[0].torque), 2))
    for k in range(1, len(walk)):
        walk[k] = 0.995 * walk[k - 1] + 0.05 * rng.standard_normal(2)
    slow = [replace(motions[0], torque=motions[0].torque + walk), *motions[1:]]
    base = healthy.base
    for make, sizes in ((weighted, (1.5, np.inf)), (coloured, (0.0, 0.5))):
        noise = make(base, slow)
        ratio = np.array([own.sigma_Nm for own in noise.whiteners]) / noise.floor_Nm
        assert (ratio > sizes[0]).all() and (ratio < sizes[1]).all()
        left = Evidence(base, Scene(base, slow, noise.whiteners), None).residual
        if make is coloured:
            assert np.mean(left**2) == pytest.approx(1.0, abs=0.2)
    assert all(own.order == 0 for own in weighted(base, slow).whiteners)


def test_an_arm_whose_residual_is_noise_keeps_the_coloured_noise(prepared):
    assert all(own.order > 0 for own in prepared.evidence.field.whiteners)


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/recordings is not here")
@pytest.mark.parametrize(
    ("arm", "reference", "field"),
    [("airbot", "run_3", "run_1"), ("panda", "run_2", "run_1"), ("rokae", "run_2", "run_1")],
)
def test_a_real_arm_gets_weights_and_leaves_no_more_of_another_run_than_a_healthy_arm_does(arm, reference, field):
    known, runs = (
        load_arm(REAL / arm / "arm.urdf"),
        [read_recording(REAL / arm / f"{n}.mcap") for n in (reference, field)],
    )
    prepared = prepare_evidence(known, RunSet(runs[1:], runs[:1], runs[1:]))
    assert all(own.order == 0 for own in prepared.evidence.field.whiteners)
    residuals = Residuals(prepared.evidence, prepared.held_out.scene, prepared.plain)
    (healthy,) = healthy_levels(prepared.evidence, prepared, [residuals])
    left = residuals.of(healthy.parameters, [], np.zeros(0))
    assert not healthy.beyond(residuals.rms_throughout(left), residuals.rms(left)).any()


def _detectable_Nm(with_temperatures: bool) -> np.ndarray:
    """What a healthy arm leaves of another run at most, with or without the joints' temperatures."""

    def recorded(recording: Recording) -> Recording:
        warm = Series(recording.time, np.full(len(recording.time), 25.0))
        return replace(recording, temperatures=dict.fromkeys(recording.joints, warm) if with_temperatures else {})

    prepared = prepare_evidence(ARM, RunSet([recorded(run(2))], [recorded(HEALTHY)], [recorded(run(3))]))
    residuals = Residuals(prepared.evidence, prepared.held_out.scene, prepared.plain)
    (healthy,) = healthy_levels(prepared.evidence, prepared, [residuals])
    return healthy.detectable_Nm


def test_another_days_friction_is_ordinary_only_where_temperatures_were_not_recorded():
    with_them, without = _detectable_Nm(True), _detectable_Nm(False)
    assert (with_them <= without * 1.001).all() and (with_them < 0.9 * without).any()


def test_all_joints_together_decide_which_model_predicts_better():
    rng = np.random.default_rng(2)
    before = rng.uniform(1.0, 1.5, (12, 6))
    assert t_of_all(before, 0.8 * before * rng.uniform(0.9, 1.1, (12, 6))) > 5.0
    assert abs(t_of_all(before, before * rng.uniform(0.9, 1.1, (12, 6)))) < 3.0
    resting = np.concatenate([before, np.zeros((12, 1))], axis=1)
    assert np.isfinite(t_of_all(resting, resting))


def test_a_residual_is_a_mismatch_if_it_lasts_or_is_far_beyond_a_healthy_arms():
    healthy = Healthy(np.zeros(0), np.array([0.1, 0.1, 0.1, np.nan]), np.array([0.1, 0.5, 0.1, np.nan]))
    np.testing.assert_allclose(healthy.detectable_Nm[:2], [0.1 * np.sqrt(UNNAMED), 0.5])
    lasting, whole = np.array([0.2, 0.2, 0.12, 1.0]), np.array([0.2, 0.3, 0.2, 1.0])
    np.testing.assert_array_equal(healthy.beyond(lasting, whole), [True, False, False, False])
    np.testing.assert_array_equal(healthy.beyond(lasting, np.full(4, 30.0)), [True, True, True, False])


def test_a_finding_must_be_larger_than_what_healthy_parts_differ_by(rippled):
    (finding,) = rippled.findings
    (joint,) = finding.before_Nm
    size = finding.before_Nm[joint]
    assert beyond_healthy(finding, {joint: size}, {joint: 0.9 * size})
    assert not beyond_healthy(finding, {joint: size}, {joint: 1.1 * size})
    assert not beyond_healthy(finding, {joint: 0.5 * size}, {joint: 0.9 * size})
    event = replace(finding, effect="external_contact", event=True, before_Nm={joint: 0.0})
    assert beyond_healthy(event, {joint: 0.0}, {joint: 0.9 * finding.felt_Nm[joint]})
    assert not beyond_healthy(event, {joint: 0.0}, {joint: 1.1 * finding.felt_Nm[joint]})


def test_an_effect_must_be_larger_in_the_field_than_it_seems_in_parts_of_the_reference():
    """Ripple in the field stands; as small as it seems to be in the reference, or in the reference too, it does not."""
    changed = prepare_evidence(ARM, RunSet([run(2, ripple)], [HEALTHY], [run(3, ripple)]))
    both = prepare_evidence(ARM, RunSet([run(2, ripple)], [run(4, ripple)], [run(3, ripple)]))

    def stands(prepared, share):
        evidence = prepared.evidence
        effect = EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"})
        found = max(
            (evidence.candidate(effect, point) for point in grid_points(effect, evidence.field.motions)),
            key=lambda candidate: refit([candidate]).gain,
        )
        left_out = LeftOut(evidence.healthy, Residuals(evidence.healthy, evidence.reference, prepared.plain))
        return exceeds_null(found, share * refit([found]).values, evidence, left_out)

    assert stands(changed, 1.0)
    assert not stands(changed, 0.01)
    assert not stands(both, 1.0)
