"""The mismatch engine: its algebra against brute force, and planted physics found again from end to end."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run, urdf_of
from scipy.signal import lfilter

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.prior import make_prior
from spacearm_ident.mismatch.competition import Scored, penalty, shadow, simplest
from spacearm_ident.mismatch.constants import polish, refine
from spacearm_ident.mismatch.document import EXTENDED_MODEL, to_document
from spacearm_ident.mismatch.evidence import NUISANCE, Candidate, base_columns, stacked_effect
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.finding import DATA_UNFIT, MISMATCH, NO_MISMATCH, Alternative
from spacearm_ident.mismatch.integrity import faults
from spacearm_ident.mismatch.judgement import contradicted, doubted, shows
from spacearm_ident.mismatch.preparation import prepare_evidence
from spacearm_ident.mismatch.residuals import Residuals
from spacearm_ident.mismatch.rivals import UNKNOWN, Rival, rivals
from spacearm_ident.mismatch.scene import (
    LARGEST_ROOT,
    NEAR,
    Scene,
    Whitener,
    coarse,
    fit_whitener,
    louder,
    one_way,
    stable,
    stretch,
    travel,
)
from spacearm_ident.recording.signals import prepare

LAWS = (
    Friction(f_c=3.0, k_v1=2.0, k_v2=0.0, k_v3=0.0, J_m=0.4),
    Friction(f_c=1.5, k_v1=0.8, k_v2=0.0, k_v3=0.0, J_m=0.1),
)
ARM = arm_from_urdf(urdf_of(TWO_LINKS))
NOISE = (0.3, 0.15)


def run(seed, extra=None, seconds=16.0):
    """A recording of the planar arm with white torque noise; `extra` adds torque (N, 2) to what it needs."""
    planted = two_link_run(LAWS, seconds=seconds, rate_hz=250.0, seed=seed, speed=1.0)
    if extra is not None:
        planted = replace(planted, torque=planted.torque + extra(planted))
    return planted.recording(noise=NOISE, seed=seed + 100)


def ripple(planted):
    return np.outer(0.8 * np.sin(20.0 * planted.q[:, 1] + 0.4), [0.0, 1.0])


def more_friction(planted):
    return np.outer(0.9 * np.sign(planted.qd[:, 0]), [1.0, 0.0])


def late(planted):
    """All recorded torque is 12 ms old."""
    return np.stack([np.roll(column, 3) - column for column in planted.torque.T], axis=1)


HEALTHY = run(1)
SLOW_ONES = ("joint_elasticity", "backlash", "link_flexibility", "base_flexibility", "floating_base")
"""Left out where they are not the point, to be quick."""


def explained(extra, *excluded):
    return explain(ARM, [HEALTHY], [run(2, extra)], [run(3, extra)], excluded)


# --- rows -----------------------------------------------------------------------------------------------------------


def test_after_its_whitener_coloured_noise_is_white_with_variance_one():
    rng = np.random.default_rng(0)
    noise = [0.3 * lfilter([1.0], [1.0, -1.2, 0.5], rng.standard_normal(4000)) for _ in range(2)]
    whitener = fit_whitener(noise, [np.ones(4000, bool)] * 2, 4, 1e-6)
    np.testing.assert_allclose(whitener.coefficients, [1.2, -0.5, 0.0, 0.0], atol=0.06)
    assert whitener.sigma_Nm == pytest.approx(0.3, rel=0.04)
    white = whitener.apply(noise[0][:, None], np.arange(4000))[:, 0]
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.08)
    lags = [np.mean(white[lag:] * white[:-lag]) for lag in range(1, 8)]
    assert np.abs(lags).max() < 4 / np.sqrt(len(white))


def test_outliers_do_not_define_the_noise_and_few_rows_make_it_plain():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(4000)
    noise[1000:1010] += 500.0
    assert fit_whitener([noise], [np.ones(4000, bool)], 2, 1e-6).sigma_Nm == pytest.approx(1.0, rel=0.1)
    few = fit_whitener([noise[:7]], [np.ones(7, bool)], 6, 1e-6)
    assert few.order == 0 and few.sigma_Nm == pytest.approx(np.sqrt(np.mean(noise[:7] ** 2)))
    assert fit_whitener([np.zeros(7)], [np.zeros(7, bool)], 6, 0.25).sigma_Nm == 0.25


def test_a_stretch_is_counted_from_where_the_last_one_was_broken():
    moving = np.array([0, 1, 1, 0, 0, 1, 1, 1], bool)
    np.testing.assert_array_equal(stretch(moving), [-1, 0, 1, -1, -1, 0, 1, 2])
    np.testing.assert_array_equal(stretch(np.zeros(3, bool)), [-1, -1, -1])


def test_the_first_rows_of_a_stretch_are_white_too():
    """Of noise that remembers, 3000 stretches of five rows, with none known before them."""
    rng = np.random.default_rng(4)
    noise = lfilter([1.0], [1.0, -1.6, 0.8], rng.standard_normal(3000 * 60)).reshape(3000, 60)[:, -5:]
    whitener = Whitener(np.array([1.6, -0.8]), 1.0)
    white = whitener.apply(noise.reshape(-1, 1), np.tile(np.arange(5), 3000)).reshape(3000, 5)
    np.testing.assert_allclose(np.cov(white.T), np.eye(5), atol=5 / np.sqrt(3000))
    np.testing.assert_allclose(whitener.predictors[0][1] ** 2, np.mean(noise**2), rtol=0.05)


@pytest.mark.parametrize("coefficients", [(1.0,), (1.2, 0.0), (2.0, -1.0), (0.3, 0.2, 0.9)])
def test_noise_without_end_is_taken_for_noise_that_forgets(coefficients):
    tamed = stable(np.array(coefficients))
    assert np.abs(np.roots([1.0, *-tamed])).max() == pytest.approx(LARGEST_ROOT)
    assert np.isfinite(Whitener(tamed, 1.0).predictors[0][1])
    np.testing.assert_array_equal(stable(0.5 * tamed), 0.5 * tamed)


def test_slow_rows_and_rows_after_a_reversal_count_for_less():
    whitener = Whitener(np.zeros(0), 1.0, (16.0, 4.0, 1.0, 1.0, 1.0), (100.0, 1.0, 1.0, 1.0, 1.0))
    speed, gone = np.array([0.001, -0.004, 0.01, 1.0, 0.001]), np.array([1.0, 1.0, 1.0, 1e-4, 1e-4])
    np.testing.assert_allclose(whitener.weight(speed, gone), [0.25, 0.5, 1.0, 0.1, 0.025])


def test_the_reference_shows_what_rows_after_a_reversal_are_worth():
    """Noise ten times as large where a joint has gone little: found, told from slow rows, and weighed."""
    base = prepare_evidence(ARM, [HEALTHY], [run(2)], []).base
    (motion,), _ = prepare([HEALTHY], ARM.joint_names, 40.0, average=False)
    scene = Scene(base, [coarse(motion, 20.0)], [Whitener(np.zeros(0), 1.0)] * 2)
    rng = np.random.default_rng(3)
    near = scene.gone < NEAR[-1]
    assert 20 < near[scene.joint == 1].sum() < 0.5 * (scene.joint == 1).sum()
    found = louder(scene.whiteners[1], scene, np.where(near, 10.0, 1.0) * rng.standard_normal(len(scene)), 1)
    assert 50.0 < found.near[-1] <= found.near[0] < 400.0
    assert max(found.loud) < 3.0


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
    return prepare_evidence(ARM, [HEALTHY], [run(2, ripple)], [run(3, ripple)])


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

    def __init__(self, evidence):
        scenes = [evidence.field, evidence.reference]
        base = np.concatenate([base_columns(evidence.base, scene, ()) for scene in scenes])
        prior = make_prior(evidence.base.model, [motion for scene in scenes for motion in scene.motions])
        known, beside = prior.rows.shape[1], NUISANCE * len(ARM.joints)
        belief = np.zeros((len(prior.rows) + beside, base.shape[1]))
        belief[: len(prior.rows), :known] = prior.rows
        belief[len(prior.rows) :, known:] = 1e-3 * np.eye(beside)
        self.columns = np.concatenate([base, belief])
        self.torque = np.concatenate([*(scene.torque() for scene in scenes), prior.target, np.zeros(beside)])
        self.used = np.any(self.columns != 0, axis=0)
        self.rows = len(evidence.field)

    def solve(self, candidates):
        """Chi-square, base's parameters, effects' values."""
        target, free = self.torque.copy(), [self.columns[:, self.used]]
        held = []
        for candidate in candidates:
            whole = np.zeros((len(target), len(candidate.effect.parameters)))
            whole[: self.rows][candidate.stacked.rows] = candidate.stacked.columns
            for k, parameter in enumerate(candidate.effect.parameters):
                held.append(parameter.scale == 0.0)
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
    found = evidence.refit(candidates)
    assert found.gain == pytest.approx(without - squares, rel=1e-6, abs=1e-5 * without)
    np.testing.assert_allclose(found.values, values, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(evidence.residual_beside(candidates), residual, atol=1e-5 * np.abs(residual).max())
    assert np.all((found.visibility >= 0) & (found.visibility <= 1 + 1e-9))


def test_in_thin_air_the_field_has_no_friction_of_high_order(prepared):
    """The same least squares with those columns set to zero in the field's rows."""
    evidence = prepared.evidence
    brute, high = Brute(evidence), np.flatnonzero(evidence.base.model.of_high_order)
    brute.columns[: brute.rows, high] = 0.0
    want, _, base, _ = brute.solve([])
    found, squares = evidence.in_thin_air
    assert squares == pytest.approx(want, rel=1e-4)
    np.testing.assert_allclose(found, base[: len(found)], rtol=1e-4, atol=1e-4 * np.abs(base).max())
    assert np.abs(found[high]).min() > 0


@pytest.mark.parametrize("chosen", [(), (0,), (0, 1, 2, 3)])
def test_unseen_residuals_are_those_of_the_fitted_model_on_other_rows(prepared, chosen):
    evidence, unseen = prepared.evidence, prepared.unseen
    candidates = [candidates_of(evidence)[k] for k in chosen]
    _, _, base, values = Brute(evidence).solve(candidates)
    want = unseen.scene.torque() - base_columns(evidence.base, unseen.scene, ()) @ base
    first = 0
    for candidate in candidates:
        own = values[first : first + len(candidate.effect.parameters)]
        first += len(own)
        stacked = stacked_effect(unseen.scene, candidate.effect, candidate.constants)
        want[stacked.rows] -= stacked.columns @ own
    found = unseen.residual(candidates, evidence.refit(candidates).values)
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
    healthy = prepare_evidence(ARM, [HEALTHY], [run(2)], [run(3)])
    residual = healthy.evidence.residual
    assert np.mean(residual**2) == pytest.approx(1.0, abs=0.35)
    assert np.mean(prepared.evidence.residual**2) > 10.0


def test_freedom_costs():
    drift, both = ({"joint": "elbow", "of": of} for of in (["f_c"], ["f_c", "k_v1"]))
    one, two = (penalty(EFFECTS["friction_drift"].at(ARM, place), 1000) for place in (drift, both))
    assert two == pytest.approx(2 * one) == pytest.approx(2 * np.log(1000))
    searched = penalty(EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"}), 1000)
    assert searched > 3 * np.log(1000)
    held = penalty(EFFECTS["base_flexibility"].at(ARM, {"axis": [1, 0, 0]}), 1000)
    assert held == pytest.approx(2 * np.log(1000) + 2 * np.log(20))


def test_rivals_cover_every_joint_and_are_finite(prepared):
    motions = prepared.evidence.field.motions
    places = list(rivals(motions))
    assert {place["joint"] for place in places} == set(ARM.joint_names)
    for place in places:
        rival = Rival.at(ARM, place)
        constants = [constant.grid[len(constant.grid) // 2] for constant in rival.constants]
        for row, (_, columns) in rival.columns(motions[0], constants, None).items():
            assert ARM.joint_names[row] == place["joint"] and np.isfinite(columns).all()


# --- data that cannot carry the question ----------------------------------------------------------------------------


def saturated():
    whole = run(2)
    level = 0.5 * np.abs(whole.effort[:, 0]).max()
    return replace(whole, effort=np.clip(whole.effort, -level, level))


def torn():
    whole = run(2)
    half = len(whole.time) // 2
    time = whole.time.copy()
    time[half:] += 10.0
    return replace(whole, time=time, segments=(slice(0, half), slice(half, len(time))))


def resting():
    whole = run(2)
    return replace(whole, position=np.tile(whole.position[:1], (len(whole.time), 1)))


def torqueless():
    whole = run(2)
    return replace(whole, effort=whole.effort * [1.0, 0.0])


UNFIT = [
    (saturated, "torque of shoulder stands at .* saturated"),
    (torn, "missing: its time stamps are broken or samples were lost"),
    (resting, "no joint moves"),
    (torqueless, "torque of elbow is zero throughout"),
    (lambda: run(2, seconds=1.5), "too short"),
]


@pytest.mark.parametrize(("made", "reason"), UNFIT)
def test_unfit_data_get_a_reason_and_no_finding(made, reason):
    broken = made()
    for reference, field, unseen in (
        ([HEALTHY], [broken], []),
        ([broken], [HEALTHY], []),
        ([], [HEALTHY], [broken]),
    ):
        answer = explain(ARM, reference, field, unseen)
        assert answer.verdict == DATA_UNFIT and answer.findings == () and answer.model is None
        assert any(re.search(reason, text) for text in answer.reasons)
    document = to_document(answer)
    json.dumps(document, allow_nan=False)
    assert document["noise_floor_Nm"] == {"shoulder": None, "elbow": None}


def test_sound_data_have_no_faults():
    assert faults([HEALTHY, run(2, ripple)], ARM.joint_names) == []


def test_a_recording_of_another_arm_is_refused():
    with pytest.raises(UserError, match="shoulder"):
        explain(ARM, [replace(HEALTHY, joints=("a", "b"))], [run(2)], [])


# --- end to end -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rippled():
    return explained(ripple)


def test_a_healthy_arm_has_no_mismatch():
    answer = explained(None)
    assert answer.verdict == NO_MISMATCH and answer.findings == () and answer.model is None
    np.testing.assert_allclose(answer.after_Nm, answer.noise_floor_Nm, rtol=0.35)
    assert to_document(answer)["model"] is None and to_document(answer)["next_experiment"] is None


def test_ripple_is_found_where_it_is_as_large_as_it_is(rippled):
    assert rippled.verdict == MISMATCH
    (finding,) = rippled.findings
    assert finding.effect == "torque_ripple" and finding.joints == ("elbow",)
    for name, truth in (("amplitude", 0.8), ("cycles", 20.0), ("phase", 0.4)):
        quantity = finding.parameters[name]
        reach = 1.5 * (quantity.high - quantity.low) / 2
        assert abs(quantity.value - truth) < reach, name
    assert finding.parameters["amplitude"].value == pytest.approx(0.8, rel=0.05)
    assert finding.confidence > 0.9 and finding.explained > 0.9
    assert finding.after_Nm["elbow"] < 0.3 * finding.before_Nm["elbow"]


def test_more_friction_is_friction_drift():
    answer = explained(more_friction, *SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    change = answer.findings[0].parameters["df_c"]
    assert change.value == pytest.approx(0.9, abs=0.1) and change.low > 0.5


def test_what_vanishes_in_vacuum_is_one_finding_and_the_extended_model_lacks_it(tmp_path):
    """With qd |qd|, of which a reference alone says little beside qd and qd^3."""

    def runs(scale, *seeds):
        laws = [replace(law, k_v2=2.0 * scale, k_v3=-0.7 * scale, odd=True) for law in LAWS]
        planted = [two_link_run(laws, seconds=16.0, rate_hz=250.0, seed=seed, speed=1.0) for seed in seeds]
        return [one.recording(noise=NOISE, seed=seed + 100) for one, seed in zip(planted, seeds)]

    field, unseen = runs(0.0, 2, 3)
    answer = explain(ARM, runs(1.0, 1), [field], [unseen], SLOW_ONES)
    (finding,) = answer.findings
    assert finding.effect == "vacuum_friction" and set(finding.joints) == set(ARM.joint_names)
    assert finding.parameters["share"].value == pytest.approx(1.0, abs=0.1)
    assert finding.explained > 0.9
    save_model(answer.model, tmp_path / EXTENDED_MODEL)
    (motion,), _ = prepare([unseen], ARM.joint_names, answer.cutoff_hz, average=False)
    left = motion.torque_rows - motion.reduce(load_model(tmp_path / EXTENDED_MODEL).torque(motion))
    for joint, sound in enumerate(one_way(motion).T):
        assert np.sqrt(np.mean(left[sound, joint] ** 2)) < NOISE[joint]


def test_torque_that_is_late_is_late_by_so_much():
    answer = explained(late, *SLOW_ONES)
    assert [f.effect for f in answer.findings] == ["time_delay"]
    assert answer.findings[0].parameters["delay"].value == pytest.approx(0.012, rel=0.1)


def carrying(seed, com):
    """A run with 0.7 kg on the last link, at `com` (m) in its axes."""
    elbow = TWO_LINKS[1]
    mass = elbow.mass + 0.7
    whole = (np.array(elbow.com) * elbow.mass + 0.7 * np.array(com)) / mass
    parts = [(elbow.mass, np.array(elbow.com) - whole), (0.7, np.array(com) - whole)]
    ixx, iyy, izz = (sum(m * (d @ d - d[k] ** 2) for m, d in parts) + elbow.inertia[j] for k, j in enumerate((0, 3, 5)))
    ixz = elbow.inertia[2] - sum(m * d[0] * d[2] for m, d in parts)
    heavier = replace(elbow, mass=mass, com=tuple(whole), inertia=tuple(map(float, (ixx, 0, ixz, iyy, 0, izz))))
    time = np.arange(0.0, 16.0, 1 / 250.0)
    motion = incommensurate(time, 2, seed, 1.0)
    planted = plant(TWO_LINKS, LAWS, motion, 250.0, true_links=(TWO_LINKS[0], heavier))
    return planted.recording(noise=NOISE, seed=seed + 100)


@pytest.mark.parametrize("there", [(0.05, 0.0, 0.3), (-0.25, 0.0, 0.1)], ids=["held alike", "held elsewhere"])
def test_a_payload_is_found_however_it_is_held_in_the_other_recording(there):
    here = (0.05, 0.0, 0.3)
    answer = explain(ARM, [HEALTHY], [carrying(2, here)], [carrying(3, there)], SLOW_ONES)
    (finding,) = answer.findings
    assert finding.effect == "payload" and finding.joints == ("elbow",)
    assert finding.parameters["mass"].value == pytest.approx(0.7, rel=0.1)
    for axis, place in zip("xz", (here[0], here[2])):
        assert finding.parameters[f"moment_{axis}"].value == pytest.approx(0.7 * place, abs=0.02)
    assert ("held elsewhere" in finding.where) == (there != here)
    assert finding.explained > 0.9


@pytest.mark.parametrize(
    ("explained", "left", "named"), [(0.7, 2.0, False), (0.7, 1.1, True), (0.95, 2.0, True), (float("nan"), 2.0, True)]
)
def test_a_law_that_leaves_much_of_what_there_was_is_not_the_one(rippled, explained, left, named):
    """Nearly all must be explained, or nothing but noise be left; else it is unknown, and what it is like is told."""
    (finding,) = rippled.findings
    rival = Alternative("payload", ("elbow",), 0.6, "")
    finding = replace(finding, explained=explained, after_Nm={"elbow": 0.1 * left}, beside_Nm={}, alternatives=(rival,))
    judged = doubted(finding, {"shoulder": 0.2, "elbow": 0.1})
    assert (judged == finding) == named
    if not named:
        assert (judged.effect, judged.joints, judged.parameters) == (UNKNOWN, ("elbow",), {})
        assert judged.alternatives[0].effect == "torque_ripple" and "2.0 times the noise" in judged.where


def test_a_law_that_leaves_much_keeps_its_name_where_nothing_else_comes_near(rippled):
    (finding,) = rippled.findings
    far = Alternative("payload", ("elbow",), 0.4, "")
    finding = replace(finding, explained=0.7, after_Nm={"elbow": 0.3}, beside_Nm={}, alternatives=(far,))
    assert doubted(finding, {"elbow": 0.1}) == finding
    assert doubted(replace(finding, explained=0.6), {"elbow": 0.1}).effect == UNKNOWN


@pytest.mark.parametrize("explained, company, good", [(0.3, False, False), (0.3, True, True), (0.5, False, True)])
def test_a_name_by_itself_must_explain_more_than_one_of_several(rippled, explained, company, good):
    (finding,) = rippled.findings
    other = replace(finding, effect="payload") if company else replace(finding, before_Nm={"shoulder": 1.0})
    finding = replace(finding, explained=explained, before_Nm={"elbow": 1.0}, after_Nm={"elbow": 0.8})
    assert shows(0, [finding, other], {"shoulder": 0.1, "elbow": 0.1}) == good


@pytest.mark.parametrize("gain, good", [(5000.0, True), (115.0, False)])
def test_what_the_unseen_data_do_not_show_must_be_sure_in_the_field(rippled, gain, good):
    (finding,) = rippled.findings
    asleep = replace(finding, gain=gain, unseen_gain=0.05 * gain, explained=0.2)
    assert shows(0, [asleep], {"shoulder": 0.1, "elbow": 0.1}) == good


def test_what_was_below_the_noise_needs_no_explanation(rippled):
    (finding,) = rippled.findings
    assert shows(0, [finding], {"shoulder": 0.1, "elbow": 0.1})
    assert not shows(0, [finding], {joint: 1.01 * rms for joint, rms in finding.before_Nm.items()})


def contender(kind, score, joint="elbow"):
    effect = EFFECTS[kind].at(ARM, {"joint": joint})
    return Scored(Candidate(effect, (), None, *np.zeros((3, 1))), 0.0, 0.0, score, plausible=True)


def test_what_another_explains_better_and_does_not_stand_is_no_finding():
    """An effect that fits by chance takes weaker ones at its joints along; those at other joints stay."""
    ripple, drift = contender("torque_ripple", 300.0), contender("friction_drift", 100.0)
    assert shadow(drift, [ripple]) and not shadow(ripple, [drift])
    assert not shadow(contender("friction_drift", 100.0, "shoulder"), [ripple])
    assert not shadow(drift, [replace(ripple, plausible=False)])


def test_of_two_that_score_alike_the_one_with_less_freedom_is_taken():
    less, more = contender("current_offset", 5000.0), contender("torque_ripple", 5040.0)
    assert simplest([more, less]) is less
    assert simplest([replace(more, score=5200.0), less]).candidate is more.candidate


def test_constants_that_pull_at_each_other_are_searched_together():
    """A bent valley: one constant after the other, from the grid's best point, ends far from its bottom."""
    effect = EFFECTS["joint_elasticity"].at(ARM, {"joint": "elbow"})

    def gain(constants):
        stiffness, damping = constants[0] / 5000.0, constants[1] / 0.05
        return -((stiffness - 1.0) ** 2) - 400.0 * (damping - stiffness) ** 2

    begin = (8000.0, 0.08)
    stuck, found = (method(effect, begin, gain, gain(begin)) for method in (refine, polish))
    assert gain(found) > 0.1 * gain(stuck) > gain(begin)
    assert found == pytest.approx((5000.0, 0.05), rel=0.1)


def test_what_rings_at_its_own_resonance_is_not_held_against_a_compliance(rippled):
    (finding,) = rippled.findings
    near = Alternative("payload", ("elbow",), 0.6, "")
    finding = replace(finding, explained=0.7, after_Nm={"elbow": 0.3}, beside_Nm={"elbow": 0.1}, alternatives=(near,))
    assert doubted(finding, {"elbow": 0.1}) == finding


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


def test_a_law_beside_which_a_free_function_of_the_same_quantity_stands_is_another(rippled):
    """The residual of a dead zone, say, looks like less friction first, and like any curve over the speed then."""
    (finding,) = rippled.findings
    ripple = EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"})
    curve = {"joint": "elbow", "count": 9, "low": -1.0, "high": 1.0}
    places = [{**curve, "of": "position"}, {**curve, "of": "velocity"}, {**curve, "of": "position", "with": "shoulder"}]
    own, other, neighbour = (Rival.at(ARM, place) for place in places)
    assert contradicted(finding, ripple, [ripple, other, neighbour]) == finding
    judged = contradicted(finding, ripple, [ripple, own])
    assert judged.effect == UNKNOWN and judged.where.startswith("most like torque_ripple")


def test_noise_that_has_grown_is_a_mismatch_without_a_name():
    """Nothing repeats in it, so nothing that could be fitted explains it; the arm is not healthy all the same."""

    def loud(planted):
        noise = np.random.default_rng(len(planted.torque) + int(1e6 * planted.q[-1, 0])).normal(
            size=len(planted.torque)
        )
        return np.outer(0.6 * noise, [0.0, 1.0])

    answer = explained(loud, *SLOW_ONES)
    assert answer.verdict == MISMATCH and answer.model is None
    (finding,) = answer.findings
    assert (finding.effect, finding.joints) == (UNKNOWN, ("elbow",))
    assert finding.explained == 0.0 and "times the noise" in finding.where
    assert to_document(answer)["findings"][0]["validation"]["explained_fraction"] == 0.0


def test_what_is_not_in_the_catalogue_is_called_unknown():
    answer = explained(ripple, "torque_ripple", *SLOW_ONES)
    assert {finding.effect for finding in answer.findings} <= {UNKNOWN}
    assert {joint for finding in answer.findings for joint in finding.joints} <= {"elbow"}
    assert answer.findings or answer.unexplained


def test_the_document_is_that_of_the_contract(rippled):
    document = json.loads(json.dumps(to_document(rippled), allow_nan=False))
    assert document["schema"] == "spacearm_ident/mismatch/1"
    assert document["verdict"] == "mismatch" and document["model"] == EXTENDED_MODEL == "extended_model.yaml"
    for key in ("noise_floor_Nm", "residual_before_Nm", "residual_after_Nm"):
        assert set(document[key]) == {"shoulder", "elbow"} and all(v > 0 for v in document[key].values())
    assert document["residual_before_Nm"]["elbow"] > 3 * document["residual_after_Nm"]["elbow"]
    assert isinstance(document["unexplained"], list) and "next_experiment" in document
    (finding,) = document["findings"]
    assert finding["effect"] == "torque_ripple" and finding["joints"] == ["elbow"] and finding["where"]
    for quantity in finding["parameters"].values():
        low, high = quantity["ci95"]
        assert low <= quantity["value"] <= high and quantity["unit"]
    assert 0 <= finding["confidence"] <= 1
    assert all({"effect", "score", "why_not"} <= set(one) for one in finding["alternatives"])
    assert set(finding["validation"]) == {"rms_before_Nm", "rms_after_Nm", "explained_fraction"}
    assert list(finding["validation"]["rms_before_Nm"]) == ["elbow"]
    assert 0.9 < finding["validation"]["explained_fraction"] <= 1


def test_the_extended_model_predicts_a_fresh_run_to_its_noise(rippled, tmp_path):
    save_model(rippled.model, tmp_path / EXTENDED_MODEL)
    model = load_model(tmp_path / EXTENDED_MODEL)
    (motion,), _ = prepare([run(7, ripple)], ARM.joint_names, 20.0, average=False)
    base = [kind for kind in model.model.structure if kind not in EFFECTS]

    def left(torque):
        residual = motion.reduce(motion.torque - torque)
        return np.sqrt(np.mean(residual[motion.moving[:, 1], 1] ** 2))

    assert left(model.torque(motion)) < 1.6 * rippled.noise_floor_Nm[1]
    assert left(model.torque(motion, base)) > 5 * rippled.noise_floor_Nm[1]


@pytest.fixture(scope="module")
def healthy_model():
    return identify([HEALTHY], ARM, Settings(cutoff_hz=20.0)).model


def test_a_model_as_reference_holds_the_field_to_its_values(healthy_model):
    """What the structure could take over is still a change from the model."""
    answer = explain(ARM, healthy_model, [run(2, more_friction)], [run(3, more_friction)], SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    assert answer.findings[0].parameters["df_c"].value == pytest.approx(0.9, abs=0.1)
    assert answer.before_Nm[0] > 5 * answer.noise_floor_Nm[0]
    assert explain(ARM, healthy_model, [run(2)], [run(3)], SLOW_ONES).verdict == NO_MISMATCH


def test_an_extended_model_is_extended_once_more(rippled, healthy_model):
    """Effects that the reference model has stay, before and beside further ones of the same kind."""
    first = rippled.model
    kinds = {kind: options for kind, options in first.model.structure.items() if kind in EFFECTS}
    both = {**first.model.structure, "current_offset": {"at": [{"joint": "elbow"}]}}
    known = replace(first, model=replace(first.model, structure=both), parameters=np.append(first.parameters, 0.0))

    def again(planted):
        return ripple(planted) + np.outer(1.5 * np.sin(31.0 * planted.q[:, 0]), [1.0, 0.0])

    excluded = [kind for kind in EFFECTS if kind not in ("torque_ripple", "friction_drift")]
    answer = explain(ARM, known, [run(2, again)], [run(3, again)], excluded)
    assert [(f.effect, f.joints) for f in answer.findings] == [("torque_ripple", ("shoulder",))]
    places = answer.model.model.structure["torque_ripple"]["at"]
    assert [place["joint"] for place in places] == ["elbow", "shoulder"]
    assert known.model.structure == both and kinds["torque_ripple"]["at"] == places[:1]
    assert answer.model.value("cycles", "elbow") == pytest.approx(20.0, abs=0.1)
    assert answer.model.value("cycles", "shoulder") == pytest.approx(31.0, abs=0.1)
    assert answer.model.value("sin", "shoulder") == pytest.approx(1.5, abs=0.1)
    assert abs(answer.model.value("offset", "elbow")) < 0.1


def test_without_a_reference_what_the_structure_leaves_over_is_explained():
    answer = explain(ARM, [], [run(2, ripple, 24.0)], [], SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("torque_ripple", ("elbow",))]
    assert "held out" in answer.judged_on
