"""The mismatch engine from end to end: planted physics found again, and data that cannot carry the question."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, LAWS, NOISE, explained, loaded_run, ripple, run
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.mismatch.document import EXTENDED_MODEL, to_document
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.finding import DATA_UNFIT, MISMATCH, NO_MISMATCH
from spacearm_ident.mismatch.integrity import faults
from spacearm_ident.mismatch.intervals import Intervals
from spacearm_ident.mismatch.rivals import UNKNOWN
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.mismatch.scene import one_way
from spacearm_ident.recording.recording import Series
from spacearm_ident.signals.prepare import prepare

SLOW_ONES = ("joint_elasticity", "backlash", "link_flexibility", "base_flexibility", "floating_base")
"""Left out where they are not the point, to be quick."""


def more_friction(planted):
    return np.outer(0.9 * np.sign(planted.qd[:, 0]), [1.0, 0.0])


def late(planted):
    """All recorded torque is 12 ms old."""
    return np.stack([np.roll(column, 3) - column for column in planted.torque.T], axis=1)


def early(planted):
    """All recorded motion is 12 ms old."""
    return np.stack([np.roll(column, -3) - column for column in planted.torque.T], axis=1)


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
    for reference, field, held_out in (
        ([HEALTHY], [broken], []),
        ([broken], [HEALTHY], []),
        ([], [HEALTHY], [broken]),
    ):
        answer = explain(ARM, RunSet(field, reference, held_out))
        assert answer.verdict == DATA_UNFIT and answer.findings == () and answer.model is None
        assert any(re.search(reason, text) for text in answer.reasons)
    document = to_document(answer)
    json.dumps(document, allow_nan=False)
    assert document["noise_floor_Nm"] == {"shoulder": None, "elbow": None}


def at_rest(recording, joint):
    """One joint that stands, held by a brake."""
    position, effort = recording.position.copy(), recording.effort.copy()
    position[:, joint] = position[0, joint]
    effort[:, joint] = 0.02 * np.random.default_rng(joint).standard_normal(len(position))
    return replace(recording, position=position, effort=effort)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("moves_in_field", [False, True])
def test_a_joint_that_rests_in_the_reference_is_not_compared_and_said(joint, moves_in_field):
    field = run(2) if moves_in_field else at_rest(run(2), joint)
    answer = explain(ARM, RunSet([field], [at_rest(HEALTHY, joint)]), SLOW_ONES)
    said = re.search(f"not compared.*{ARM.joint_names[joint]}", " ".join(answer.reasons))
    assert answer.verdict == DATA_UNFIT or said
    document = to_document(answer)
    json.dumps(document, allow_nan=False)
    assert document["noise_floor_Nm"][ARM.joint_names[joint]] is None


@pytest.mark.parametrize("seconds", [2.5, 3.5, 5.0])
def test_short_recordings_get_an_answer(seconds):
    """A verdict or the reason why there is none: never an error from inside."""
    short = [run(seed, seconds=seconds) for seed in (1, 2)]
    for reference, field in (
        ([short[0]], [short[1]]),
        ([HEALTHY], [short[1]]),
        ([short[0]], [run(2)]),
        ([], [short[0]]),
    ):
        answer = explain(ARM, RunSet(field, reference), SLOW_ONES)
        assert answer.reasons or answer.verdict != DATA_UNFIT


def test_a_base_model_that_cannot_be_solved_for_is_unfit_data(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError("3-th leading minor of the array is not positive definite")

    monkeypatch.setattr("spacearm_ident.mismatch.explain.prepare_evidence", fails)
    answer = explain(ARM, RunSet([run(2)], [HEALTHY]))
    assert answer.verdict == DATA_UNFIT and "record a longer run" in answer.reasons[0]


def test_sound_data_have_no_faults():
    assert faults([HEALTHY, run(2, ripple)], ARM.joint_names) == []


def test_a_recording_of_another_arm_is_refused():
    with pytest.raises(UserError, match="shoulder"):
        explain(ARM, RunSet([run(2)], [replace(HEALTHY, joints=("a", "b"))]))


# --- end to end -----------------------------------------------------------------------------------------------------


def test_a_healthy_arm_has_no_mismatch():
    answer = explained(None)
    assert answer.verdict == NO_MISMATCH and answer.findings == () and answer.model is None
    np.testing.assert_allclose(answer.after_Nm, answer.noise_floor_Nm, rtol=0.35)
    assert to_document(answer)["model"] is None and to_document(answer)["next_experiment"] is None


def loaded_by_its_input(planted, mu=0.25):
    """Friction by the torque on the gear's input, of which it is part."""
    load = planted.torque[:, 0] - LAWS[0].J_m * planted.qdd[:, 0]
    sign = np.sign(planted.qd[:, 0])
    return np.outer(mu * np.abs(load) / (1.0 - mu * np.sign(load) * sign) * sign, [1.0, 0.0])


def test_friction_that_is_part_of_its_own_load_has_the_value_that_was_planted():
    (finding,) = explained(loaded_by_its_input, *SLOW_ONES).findings
    assert finding.effect == "load_friction" and finding.joints == ("shoulder",)
    assert finding.parameters["mu_in"].value == pytest.approx(0.25, rel=0.01)


def test_gear_that_takes_half_of_its_load_has_friction_by_the_load():
    def half_of_the_load(planted):
        return np.outer(0.5 * np.abs(planted.rigid[:, 1]) * np.sign(planted.qd[:, 1]), [0.0, 1.0])

    (finding,) = explained(half_of_the_load, *SLOW_ONES).findings
    assert finding.effect == "load_friction" and finding.joints == ("elbow",)
    assert finding.parameters["mu"].value == pytest.approx(0.5, rel=0.02)


def test_ripple_is_found_where_it_is_as_large_as_it_is(rippled):
    assert rippled.verdict == MISMATCH
    (finding,) = rippled.findings
    assert finding.effect == "torque_ripple" and finding.joints == ("elbow",)
    for name, truth in (("amplitude", 0.8), ("cycles", 20.0), ("phase", 0.4)):
        quantity = finding.parameters[name]
        reach = 1.5 * (quantity.high - quantity.low) / 2
        assert abs(quantity.value - truth) < reach, name
    assert finding.parameters["amplitude"].value == pytest.approx(0.8, rel=0.05)
    assert finding.confidence > 0.85 and finding.explained > 0.9
    assert finding.after_Nm["elbow"] < 0.3 * finding.before_Nm["elbow"]


@pytest.mark.parametrize(("share", "found"), [(0.06, False), (-0.3, True), (0.5, True)])
def test_friction_is_a_finding_when_it_is_more_than_another_day_brings(share: float, found: bool):
    """Viscous friction of both joints off by a standard deviation of that between days, by five and by eight."""

    def another_day(planted):
        return share * planted.qd * [law.k_v1 for law in LAWS]

    answer = explained(another_day, *SLOW_ONES)
    assert {finding.effect for finding in answer.findings} == ({"friction_drift"} if found else set())
    assert {joint for finding in answer.findings for joint in finding.joints} == set(ARM.joint_names if found else ())
    for finding in answer.findings:
        change = finding.parameters["dk_v1"]
        truth = share * LAWS[ARM.joint_names.index(finding.joints[0])].k_v1
        assert change.low < truth < change.high


def test_more_friction_is_friction_drift():
    answer = explained(more_friction, *SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    change = answer.findings[0].parameters["df_c"]
    assert change.value == pytest.approx(0.9, abs=0.1) and change.low > 0.5
    # Over less than one radian a cycle of friction over position is as good, and what changes less often.
    assert any(other.effect == "position_friction" for other in answer.findings[0].alternatives)
    assert answer.findings[0].confidence > 0.8


def test_what_a_level_leaves_of_its_law_does_not_make_it_unknown():
    """A free function of speed takes the level over, and is none the larger for that.

    Coulomb friction that grows with its Stribeck part, of an arm with little noise.
    """

    def quiet(seed, grown=0.0):
        planted = two_link_run(LAWS, seconds=16.0, rate_hz=250.0, seed=seed, speed=1.0)
        speed = planted.qd[:, 0]
        more = grown * np.sign(speed) * (1.0 + 0.15 * np.exp(-np.abs(speed) / 0.08))
        changed = replace(planted, torque=planted.torque + np.outer(more, [1.0, 0.0]))
        return changed.recording(noise=[noise / 10.0 for noise in NOISE], seed=seed + 100)

    answer = explain(ARM, RunSet([quiet(2, 1.5)], [quiet(1)], [quiet(3, 1.5)]), SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    assert answer.findings[0].parameters["df_c"].value == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize(
    ("size", "share", "phase", "name"), [(0.35, 0.9, 0.8, "friction_drift"), (0.5, np.inf, 1.6, "position_friction")]
)
def test_friction_that_grew_is_its_level_where_that_explains_nearly_as_much(size, share, phase, name):
    """By a size and so much of it over position, which is more than the level where it turns its sign."""
    level, swing = (0.0, size) if np.isinf(share) else (size, size * share)

    def changed(planted):
        grown = level + swing * np.cos(planted.q[:, 0] - phase)
        return np.outer(grown * np.sign(planted.qd[:, 0]), [1.0, 0.0])

    answer = explained(changed, *SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [(name, ("shoulder",))]


@pytest.mark.parametrize(("elbow", "said"), [(1.2, "higher at 2 of 2 joints"), (0.8, "")])
def test_friction_that_rises_at_most_joints_is_said_to_have_one_cause(elbow, said):
    def changed(planted):
        direction = np.sign(planted.qd)
        return direction * [0.5 * LAWS[0].f_c, (elbow - 1.0) * 2.0 * LAWS[1].f_c]

    answer = explained(changed, *SLOW_ONES)
    assert {finding.joints for finding in answer.findings} == {("shoulder",), ("elbow",)}
    alike = [reason for reason in answer.reasons if "one cause of all" in reason]
    assert len(alike) == bool(said) and all(said in reason for reason in alike)
    assert all("record the joints' temperatures" in reason for reason in alike)


def test_friction_that_rises_at_most_joints_is_said_beside_the_temperatures_that_are_known():
    def cold(planted):
        return np.sign(planted.qd) * [0.5 * LAWS[0].f_c, 0.4 * LAWS[1].f_c]

    def at(celsius, recording):
        time = recording.time[::100]
        warmth = zip(recording.joints, celsius)
        return replace(recording, temperatures={name: Series(time, np.full(len(time), c)) for name, c in warmth})

    field = [at((0.0, 4.5), run(seed, cold)) for seed in (2, 3)]
    runs = RunSet(field[:1], [at((20.0, 20.0), HEALTHY)], field[1:])
    answer = explain(ARM, runs, (*SLOW_ONES, "temperature_friction"))
    (alike,) = [reason for reason in answer.reasons if "one cause of all" in reason]
    assert "-20.0 to -15.5 K from the reference's temperature" in alike and "record" not in alike


def test_a_coarse_encoder_hides_no_more_than_its_noise_does():
    """A step of 1 mrad, differentiated in the widest band, is noise of 0.4 rad/s: most rows would seem at rest."""

    def coarse(recording):
        return replace(recording, position=np.round(recording.position / 1e-3) * 1e-3)

    field, judged = (coarse(run(seed, more_friction)) for seed in (2, 3))
    answer = explain(ARM, RunSet([field], [coarse(HEALTHY)], [judged]), SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    assert not answer.reasons


def tight(planted):
    """A stretch of 0.8 rad where the elbow rubs, most in its middle at 0.3 rad."""
    away = planted.q[:, 1] - 0.3
    rub = np.where(np.abs(away) < 0.4, 0.7 * (1.0 + np.cos(np.pi * away / 0.4)) / 2.0, 0.0)
    return np.outer(rub * np.sign(planted.qd[:, 1]), [0.0, 1.0])


def test_a_stretch_where_a_joint_is_tight_is_found_where_it_is():
    (finding,) = explained(tight, *SLOW_ONES).findings
    assert (finding.effect, finding.joints) == ("position_friction", ("elbow",))
    assert finding.parameters["centre"].value == pytest.approx(0.3, abs=0.05)
    assert finding.parameters["amplitude"].value == pytest.approx(0.7, rel=0.15)
    assert "tight" in finding.where and finding.explained > 0.9


def pulled(planted, side, begins=0.2, stiffness=5.0):
    """Torque of a cable that is taut, or of a soft stop that is touched, on one side of a position of the elbow."""
    far = planted.q[:, 1] - begins
    return np.outer(stiffness * (np.maximum(far, 0.0) if side == "above" else np.minimum(far, 0.0)), [0.0, 1.0])


@pytest.mark.parametrize(("side", "begins"), [("above", 0.2), ("below", -0.15)])
def test_a_spring_that_pulls_beyond_an_angle_is_named_with_its_stiffness_and_where_it_begins(side, begins):
    answer = explained(lambda planted: pulled(planted, side, begins), *SLOW_ONES)
    (finding,) = answer.findings
    assert (finding.effect, finding.joints) == ("harness_spring", ("elbow",))
    assert f"{side} {finding.parameters[side].value:.3g} rad" in finding.where and "soft stop" in finding.where
    for name, truth, unit in ((f"stiffness_{side}", 5.0, "N m/rad"), (side, begins, "rad")):
        quantity = finding.parameters[name]
        assert quantity.low < truth < quantity.high and quantity.unit == unit, name
    assert finding.explained > 0.9
    motion = prepare([run(4)], ARM.joint_names)[0][0]
    term = answer.model.torque(motion, ["harness_spring"])
    far = motion.position[:, 1] - begins
    want = 5.0 * (np.maximum(far, 0.0) if side == "above" else np.minimum(far, 0.0))
    np.testing.assert_allclose(term, np.outer(want, [0.0, 1.0]), atol=0.25)


def test_a_spring_over_the_whole_range_has_no_side():
    (finding,) = explained(lambda planted: np.outer(5.0 * (planted.q[:, 1] - 0.1), [0.0, 1.0]), *SLOW_ONES).findings
    assert (finding.effect, finding.joints) == ("harness_spring", ("elbow",))
    assert set(finding.parameters) == {"stiffness", "preload"}
    assert finding.parameters["stiffness"].low < 5.0 < finding.parameters["stiffness"].high


@pytest.mark.parametrize("stiffness", [30.0, 300.0])
def test_a_stop_that_is_hardly_reached_gets_no_stiffness(stiffness):
    """It begins in the outermost per cent of the field's positions: a soft one is not seen, of a hard one no more."""
    edge = np.percentile(run(2).position[:, 1], 99.0)
    findings = explained(lambda planted: pulled(planted, "above", edge, stiffness), *SLOW_ONES).findings
    assert [(finding.effect, finding.joints, finding.parameters) for finding in findings] == (
        [(UNKNOWN, ("elbow",), {})] if stiffness > 100.0 else []
    )
    assert all("most like harness_spring" in finding.where for finding in findings)


def test_a_spring_at_a_joint_that_slides_is_in_newtons_and_metres():
    links = (TWO_LINKS[0], replace(TWO_LINKS[1], kind="prismatic"))

    def slid(seed, *extra):
        time = np.arange(0.0, 16.0, 1 / 250.0)
        planted = plant(links, LAWS, incommensurate(time, 2, seed, 1.0), 250.0)
        added = sum((one(planted) for one in extra), np.zeros_like(planted.torque))
        return replace(planted, torque=planted.torque + added).recording(noise=NOISE, seed=seed + 100)

    def cable(planted):
        return pulled(planted, "above")

    arm = arm_from_urdf(urdf_of(links))
    (finding,) = explain(arm, RunSet([slid(2, cable)], [slid(1)], [slid(3, cable)]), SLOW_ONES).findings
    assert (finding.effect, finding.joints) == ("harness_spring", ("elbow",))
    assert {name: value.unit for name, value in finding.parameters.items()} == {"stiffness_above": "N/m", "above": "m"}
    assert re.search(r"above 0\.\d+ m$", finding.where)


def test_what_vanishes_in_vacuum_is_one_finding_and_the_extended_model_lacks_it(tmp_path):
    """With qd |qd|, of which a reference alone says little beside qd and qd^3."""

    def runs(scale, *seeds):
        laws = [replace(law, k_v2=2.0 * scale, k_v3=-0.7 * scale, odd=True) for law in LAWS]
        planted = [two_link_run(laws, seconds=16.0, rate_hz=250.0, seed=seed, speed=1.0) for seed in seeds]
        return [one.recording(noise=NOISE, seed=seed + 100) for one, seed in zip(planted, seeds)]

    field, held_out = runs(0.0, 2, 3)
    answer = explain(ARM, RunSet([field], runs(1.0, 1), [held_out]), SLOW_ONES)
    (finding,) = answer.findings
    assert finding.effect == "vacuum_friction" and set(finding.joints) == set(ARM.joint_names)
    assert finding.parameters["share"].value == pytest.approx(1.0, abs=0.1)
    assert finding.explained > 0.9
    save_model(answer.model, tmp_path / EXTENDED_MODEL)
    (motion,), _ = prepare([held_out], ARM.joint_names, answer.cutoff_hz, average=False)
    left = motion.torque_rows - motion.reduce(load_model(tmp_path / EXTENDED_MODEL).torque(motion))
    for joint, sound in enumerate(one_way(motion).T):
        assert np.sqrt(np.mean(left[sound, joint] ** 2)) < NOISE[joint]


def samples_late(count):
    """All recorded torque is so many times 4 ms old."""
    return lambda planted: np.roll(planted.torque, count, axis=0) - planted.torque


@pytest.mark.parametrize(
    ("shifted", "delay", "words"),
    [
        (late, 0.012, "torque is late"),
        (early, -0.012, "motion is"),
        (samples_late(10), 0.04, "torque is late"),
        (samples_late(50), 0.2, "torque is late"),
    ],
)
def test_torque_that_is_late_or_early_is_so_by_so_much(shifted, delay, words):
    answer = explained(shifted, *SLOW_ONES)
    assert [f.effect for f in answer.findings] == ["time_delay"]
    assert answer.findings[0].parameters["delay"].value == pytest.approx(delay, rel=0.1)
    assert words in answer.findings[0].where


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_what_is_late_at_one_joint_is_no_clock_that_stamps_all(noise):
    """Late motion of the elbow alone is in no catalogue; the shoulder, if noisy, contradicts one delay of all."""

    def recording(seed, changed):
        planted = two_link_run(LAWS, seconds=16.0, rate_hz=250.0, seed=seed, speed=1.0)
        if changed:
            planted = replace(planted, torque=planted.torque + early(planted) * [0.0, 1.0])
        return planted.recording(noise=(noise, NOISE[1]), seed=seed + 100)

    healthy, field, held_out = recording(1, False), recording(2, True), recording(3, True)
    answer = explain(ARM, RunSet([field], [healthy], [held_out]), SLOW_ONES)
    assert [(finding.effect, finding.joints) for finding in answer.findings] == [(UNKNOWN, ("elbow",))]


def carrying(seed, com, extra=lambda planted: 0.0):
    """A run with 0.7 kg on the last link, at `com` (m) in its axes, and further torque (N, 2)."""
    planted = loaded_run(seed, com)
    planted = replace(planted, torque=planted.torque + extra(planted))
    return planted.recording(noise=NOISE, seed=seed + 100)


@pytest.mark.parametrize("there", [(0.05, 0.0, 0.3), (-0.25, 0.0, 0.1)], ids=["held alike", "held elsewhere"])
def test_a_payload_is_found_however_it_is_held_in_the_other_recording(there):
    here = (0.05, 0.0, 0.3)
    answer = explain(ARM, RunSet([carrying(2, here)], [HEALTHY], [carrying(3, there)]), SLOW_ONES)
    (finding,) = answer.findings
    assert finding.effect == "payload" and finding.joints == ("elbow",)
    assert finding.parameters["mass"].value == pytest.approx(0.7, rel=0.1)
    for axis, place in zip("xz", (here[0], here[2])):
        assert finding.parameters[f"moment_{axis}"].value == pytest.approx(0.7 * place, abs=0.02)
    assert ("at another position" in finding.where) == (there != here)
    assert finding.explained > 0.9
    # The arm is planar: no motion turns the moment that is along its axes.
    assert not finding.parameters["moment_y"].known
    assert set(to_document(answer)["findings"][0]["parameters"]) == {"mass", "moment_x", "moment_z"}


@pytest.mark.parametrize("times", [0.01, 300.0])
def test_an_arm_of_any_mass_gets_the_same_answer(times):
    """Masses, inertias and torques alike: nothing but the unit of torque has changed."""
    links = [replace(link, mass=times * link.mass, inertia=[times * x for x in link.inertia]) for link in TWO_LINKS]
    here = (0.05, 0.0, 0.3)
    runs = ([replace(one, effort=times * one.effort)] for one in (carrying(2, here), HEALTHY, carrying(3, here)))
    (finding,) = explain(arm_from_urdf(urdf_of(links)), RunSet(*runs), SLOW_ONES).findings
    assert finding.effect == "payload" and finding.joints == ("elbow",)
    assert finding.parameters["mass"].value == pytest.approx(0.7 * times, rel=0.1)


def test_an_encoder_far_off_its_centre_is_no_load():
    def off_centre(seed):
        whole, err = run(seed), np.zeros_like(HEALTHY.position)
        err[:, 1] = 0.05 * np.sin(whole.position[:, 1] + 0.4)
        return replace(whole, position=whole.position + err, velocity=None)

    (finding,) = explain(ARM, RunSet([off_centre(2)], [HEALTHY], [off_centre(3)]), SLOW_ONES).findings
    assert finding.effect == "encoder_eccentricity" and finding.joints == ("elbow",)
    assert finding.parameters["amplitude"].value == pytest.approx(0.05, rel=0.1)


def test_an_encoder_whose_zero_has_moved_is_named_with_how_far():
    """The recording is right but for the reading of one joint."""

    def slipped(seed):
        recording = run(seed)
        return replace(recording, position=recording.position + np.array([0.0, 0.03]))

    answer = explain(ARM, RunSet([slipped(2)], [HEALTHY], [slipped(3)]), SLOW_ONES)
    (finding,) = answer.findings
    assert finding.effect == "encoder_zero" and finding.joints == ("elbow",)
    zero = finding.parameters["zero"]
    assert zero.value == pytest.approx(0.03, rel=0.1) and zero.low < 0.03 < zero.high


def test_a_body_whose_mass_may_be_zero_is_no_payload(monkeypatch):
    here = (0.05, 0.0, 0.3)
    monkeypatch.setattr(Intervals, "half_width", lambda self, number, slope: 1.0)
    (finding,) = explain(ARM, RunSet([carrying(2, here)], [HEALTHY], [carrying(3, here)]), SLOW_ONES).findings
    assert finding.effect == UNKNOWN and "payload" in finding.where and "whose mass may be zero" in finding.where


@pytest.mark.parametrize("healthy, field, speed, change", [(0.6, 0.6, 0.7, None), (0.3, 0.8, 0.5, 0.5)])
def test_what_the_reference_shows_over_a_smaller_range_was_there_and_what_was_added_is_found(
    healthy, field, speed, change
):
    """Friction that depends on the position: over a small range the base takes most of it for a constant."""

    def at(seed, speed, amplitude):
        def friction(planted):
            size = amplitude * np.cos(2.0 * planted.q[:, 1] + 0.3)
            return np.outer(size * np.sign(planted.qd[:, 1]), [0.0, 1.0])

        return run(seed, friction, speed=speed)

    reference = [at(seed, speed, healthy) for seed in (1, 4)]
    found = explain(ARM, RunSet([at(2, 1.2, field)], reference, [at(3, 1.2, field)]))
    assert any("position_friction" in words and "elbow" in words for words in found.already_there)
    amplitudes = [one.parameters["amplitude"].value for one in found.findings if one.effect == "position_friction"]
    assert len(found.findings) == len(amplitudes)
    assert amplitudes == ([] if change is None else [pytest.approx(change, rel=0.1)])


@pytest.mark.parametrize("run_in, found, told", [(0.0, False, 2), (0.15, True, 2), (0.15, True, 1)])
def test_a_law_that_the_reference_hardly_shows_was_there_if_it_has_the_same_values_there(run_in, found, told):
    """Joints warm up by 1 K in the reference and are 30 K warmer in the field; friction may run in (N·m) meanwhile.

    So many of them, the elbow among them, have a temperature.
    """

    def warm(seed, begin, end, seconds=16.0, run_in=0.0):
        time = run(seed, seconds=seconds).time
        share = time / time[-1]
        warmth = begin + (end - begin) * share
        change = -0.04 * (warmth - 20.0) + run_in * share
        recording = run(seed, lambda planted: np.outer(change * np.sign(planted.qd[:, 1]), [0.0, 1.0]), seconds)
        return replace(recording, temperatures={name: Series(time, warmth) for name in recording.joints[-told:]})

    reference = warm(1, 20.0, 21.0, 48.0, run_in)
    answer = explain(ARM, RunSet([warm(2, 44.0, 56.0)], [reference], [warm(3, 47.0, 53.0)]), SLOW_ONES)
    assert any("temperature" in words for words in answer.already_there) != found
    assert [(one.effect, one.joints) for one in answer.findings] == [("temperature_friction", ("elbow",))] * found
    for one in answer.findings:
        assert one.parameters["alpha_c"].low < -0.04 < one.parameters["alpha_c"].high


@pytest.mark.parametrize(
    ("degrees", "slope", "step", "found", "size"),
    [
        ((51.0, 59.0), -0.04, 0.0, "temperature_friction", "alpha_c"),
        ((37.2, 37.2), 0.0, -0.7, "friction_drift", "df_c"),
    ],
    ids=["warmer", "as warm"],
)
def test_friction_follows_the_temperature_from_that_of_the_reference(degrees, slope, step, found, size):
    """The base has the friction at the reference's 37 degrees, not at 20; what changed at 37 did not follow them."""

    def at(seed, degrees, slope=0.0, step=0.0):
        time = run(seed).time
        warmth = np.linspace(*degrees, len(time))
        change = slope * (warmth - 37.0) + step
        recording = run(seed, lambda planted: np.outer(change * np.sign(planted.qd[:, 1]), [0.0, 1.0]))
        return replace(recording, temperatures={name: Series(time, warmth) for name in recording.joints})

    field, judged = (at(seed, degrees, slope, step) for seed in (2, 3))
    (finding,) = explain(ARM, RunSet([field], [at(1, (37.0, 37.0))], [judged]), SLOW_ONES).findings
    assert (finding.effect, finding.joints) == (found, ("elbow",))
    assert finding.parameters[size].low < slope + step < finding.parameters[size].high


def test_two_effects_that_an_arm_cannot_both_have_are_not_both_found(monkeypatch):
    here = (0.05, 0.0, 0.3)
    runs = RunSet([carrying(2, here, ripple)], [HEALTHY], [carrying(3, here, ripple)])
    both = {finding.effect for finding in explain(ARM, runs, SLOW_ONES).findings}
    assert both == {"payload", "torque_ripple"}
    for name in both:
        monkeypatch.setattr(EFFECTS[name], "excludes", lambda self, other: self.kind != other.kind)
    assert not both <= {finding.effect for finding in explain(ARM, runs, SLOW_ONES).findings}


THINNING = Friction(k_v2=-0.6, k_v3=0.0, odd=True)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        (
            replace(THINNING, k_v1=THINNING.k_v1 + 0.6),
            {("friction_drift", ("shoulder",)), ("friction_drift", ("elbow",))},
        ),
        (replace(THINNING, k_v2=0.0), {("vacuum_friction", ("shoulder", "elbow"))}),
    ],
    ids=["colder", "vacuum"],
)
def test_friction_that_grew_at_every_joint_has_lost_its_high_orders_only_where_it_has(changed, found):
    """One share of what the high orders did passes for more viscous friction at each joint, with fewer parameters."""

    def moved(seed, law):
        motion = incommensurate(np.arange(0.0, 20.0, 1 / 250.0), 2, seed, speed=2.0)
        return plant(TWO_LINKS, [law, law], motion, 250.0).recording(0.05, seed)

    runs = RunSet([moved(2, changed)], [moved(0, THINNING), moved(1, THINNING)], [moved(3, changed)])
    findings = explain(ARM, runs, SLOW_ONES).findings
    assert {(one.effect, one.joints) for one in findings} == found
    assert all(one.confidence > 0.85 for one in findings)


def test_loads_on_two_links_exclude_each_other():
    last, again, inner = (
        EFFECTS["payload"].at(ARM, place)
        for place in ({"joint": "elbow", "last": True}, {"joint": "elbow", "inertia": True}, {"joint": "shoulder"})
    )
    assert inner.excludes(last) and last.excludes(inner) and not again.excludes(last)


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


def test_what_the_held_out_recording_does_not_show_is_a_mismatch_all_the_same():
    def loud(planted):
        return np.outer(np.random.default_rng(5).normal(size=len(planted.torque)), [0.0, 1.0])

    answer = explain(ARM, RunSet([run(2, loud)], [HEALTHY], [run(3)]), SLOW_ONES)
    (finding,) = answer.findings
    assert (answer.verdict, finding.effect, finding.joints) == (MISMATCH, UNKNOWN, ("elbow",))
    assert "held-out" in finding.where


def test_what_is_not_in_the_catalogue_is_called_unknown():
    answer = explained(ripple, "torque_ripple", *SLOW_ONES)
    assert {finding.effect for finding in answer.findings} <= {UNKNOWN}
    assert {joint for finding in answer.findings for joint in finding.joints} <= {"elbow"}
    assert answer.findings or answer.unexplained


def test_friction_that_another_joint_changes_says_which():
    """As of a cable that the other joint bends: the next experiment needs both joints."""

    def friction(planted):
        more = np.tanh((planted.q[:, 0] - np.median(planted.q[:, 0])) / 0.2)
        return np.outer(0.8 * more * np.sign(planted.qd[:, 1]), [0.0, 1.0])

    (finding,) = explained(friction).findings
    assert (finding.effect, finding.joints, finding.driver) == (UNKNOWN, ("elbow",), "shoulder")
    assert finding.where == "follows the position of shoulder times direction of motion"
    assert finding.explained > 0.9


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
    answer = explain(ARM, RunSet([run(2, more_friction)], healthy_model, [run(3, more_friction)]), SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("friction_drift", ("shoulder",))]
    assert answer.findings[0].parameters["df_c"].value == pytest.approx(0.9, abs=0.1)
    assert answer.before_Nm[0] > 5 * answer.noise_floor_Nm[0]
    assert not answer.reasons
    assert explain(ARM, RunSet([run(2)], healthy_model, [run(3)]), SLOW_ONES).verdict == NO_MISMATCH


def test_a_healthy_arm_is_quiet_beside_a_model_whose_file_is_older_and_the_answer_says_so(healthy_model):
    quiet = explain(ARM, RunSet([run(2)], replace(healthy_model, own=None), [run(3)]), SLOW_ONES)
    assert quiet.verdict == NO_MISMATCH
    assert any("does not keep what the model leaves of its own recordings" in reason for reason in quiet.reasons)


def test_an_extended_model_is_extended_once_more(rippled, healthy_model):
    """Effects that the reference model has stay, before and beside further ones of the same kind."""
    first = rippled.model
    kinds = {kind: options for kind, options in first.model.structure.items() if kind in EFFECTS}
    both = {**first.model.structure, "current_offset": {"at": [{"joint": "elbow"}]}}
    known = replace(first, model=replace(first.model, structure=both), parameters=np.append(first.parameters, 0.0))

    def again(planted):
        return ripple(planted) + np.outer(1.5 * np.sin(31.0 * planted.q[:, 0]), [1.0, 0.0])

    excluded = [kind for kind in EFFECTS if kind not in ("torque_ripple", "friction_drift")]
    answer = explain(ARM, RunSet([run(2, again)], known, [run(3, again)]), excluded)
    assert [(f.effect, f.joints) for f in answer.findings] == [("torque_ripple", ("shoulder",))]
    places = answer.model.model.structure["torque_ripple"]["at"]
    assert [place["joint"] for place in places] == ["elbow", "shoulder"]
    assert known.model.structure == both and kinds["torque_ripple"]["at"] == places[:1]
    assert answer.model.value("cycles", "elbow") == pytest.approx(20.0, abs=0.1)
    assert answer.model.value("cycles", "shoulder") == pytest.approx(31.0, abs=0.1)
    assert answer.model.value("sin", "shoulder") == pytest.approx(1.5, abs=0.1)
    assert abs(answer.model.value("offset", "elbow")) < 0.1


def test_without_a_reference_what_the_structure_leaves_over_is_explained():
    answer = explain(ARM, RunSet([run(2, ripple, 24.0)]), SLOW_ONES)
    assert [(f.effect, f.joints) for f in answer.findings] == [("torque_ripple", ("elbow",))]
    assert "held out" in answer.judged_on


# --- power ----------------------------------------------------------------------------------------------------------


def sized(document, name, joint):
    return next(one for one in document["would_have_seen"] if one["name"] == name and one["joints"] == [joint])


def test_the_size_that_would_have_been_seen_is_found_when_planted_and_a_tenth_of_it_is_not():
    quiet = to_document(explain(ARM, RunSet([run(2)], [HEALTHY], [run(3)]), SLOW_ONES))
    assert quiet["verdict"] == NO_MISMATCH
    size = sized(quiet, "friction_drift", "shoulder")
    assert size["quantity"] == "df_c" and size["unit"] == "N m" and size["size"] > 0.0
    for factor, found in ((2.0, True), (0.1, False)):

        def more(planted, level=factor * size["size"]):
            return np.outer(level * np.sign(planted.qd[:, 0]), [1.0, 0.0])

        answer = explain(ARM, RunSet([run(2, more)], [HEALTHY], [run(3, more)]), SLOW_ONES)
        assert ("friction_drift" in {finding.effect for finding in answer.findings}) == found
        seen = {(one.name, joint) for one in answer.would_have_seen for joint in one.joints}
        assert (("friction_drift", "shoulder") in seen) != found, "what was found has no smallest size"


def noisier(factor):
    """What is said of the healthy arm with white noise so many times as large in its torque, and the field's torque."""

    def made(seed):
        recording = run(seed)
        noise = factor * np.array(NOISE) * np.random.default_rng(seed + 4).standard_normal(recording.effort.shape)
        return replace(recording, effort=recording.effort + noise)

    field = made(2)
    return to_document(explain(ARM, RunSet([field], [made(1)], [made(3)]), SLOW_ONES)), field.effort


def test_more_noise_in_the_arm_needs_a_larger_effect_to_be_seen():
    # Less than four times: what friction ordinarily differs by on another day stands beside the noise.
    small, large = (sized(noisier(factor)[0], "torque_constant", "shoulder")["size"] for factor in (0.0, 4.0))
    assert large > 1.5 * small


def test_no_size_is_more_torque_than_the_joint_ever_needed():
    """Beside so much noise Stribeck friction of the elbow would be seen from 92 N·m on; it needs 11."""
    document, torque = noisier(15.0)
    largest = dict(zip(HEALTHY.joints, np.abs(torque).max(axis=0)))
    sizes = [one for one in document["would_have_seen"] if one["unit"] == "N m"]
    assert sizes and all(one["size"] < largest[joint] for one in sizes for joint in one["joints"])
    assert sized(document, "stribeck", "elbow")["size"] is None
