"""What is said to be done next: a motion that these findings ask for, within what was recorded, or a remedy."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, run
from made_finding import made_finding

from spacearm_ident.cli.mismatch import summary
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.effects.drive import TorqueConstant
from spacearm_ident.excitation.composite import EXPERIMENT_OF
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.mismatch.document import to_document
from spacearm_ident.mismatch.finding import MISMATCH, Alternative, Explanation, Quantity, joined, unfit
from spacearm_ident.mismatch.judgement import doubted
from spacearm_ident.mismatch.next_step import next_experiment, outside_held_out, sure_of_remedy
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording.recording import Source
from spacearm_ident.report.mismatch_folder import write_mismatch
from spacearm_ident.report.mismatch_html import mismatch_html
from spacearm_ident.sessions.next_run import described, next_run

JOINTS = ARM.joint_names
NOISE = np.array([0.1, 0.05])


def finding(effect="payload", joint="elbow", *, close=(), **changes):
    """A finding, and which effects explain as much."""
    named = EFFECTS.get(effect)
    near = tuple(Alternative(name, (joint,), 1.0, "explains as much") for name in close)
    known = {"experiment": named.experiment, "remedy": named.remedy} if named else {}
    return made_finding(effect, joint, **{"alternatives": near, **known, **changes})


def explanation(*findings, **changes):
    level = np.array([0.7, 0.7])
    words, effect, joints = next_experiment(findings, in_air=True)
    made = Explanation(
        verdict=MISMATCH,
        joints=JOINTS,
        noise_floor_Nm=NOISE,
        detectable_Nm=NOISE,
        before_Nm=level,
        after_Nm=NOISE,
        findings=findings,
        next_experiment=words,
        next_effect=effect,
        next_joints=joints,
        judged_on="held-out recordings",
    )
    return replace(made, **changes)


def page(of):
    return mismatch_html(of, ARM, {"command": "", "fitted_on": [], "reference": [], "validated_on": []})


SMALL = replace(HEALTHY, position=0.3 * HEALTHY.position)
"""A recording of a motion that stays well within the arm's limits."""


# --- the motion ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", ["ripple", "friction_drift", "stribeck", "presliding_hysteresis", "filter_lag"])
def test_next_run_keeps_to_the_positions_and_speeds_that_were_recorded(effect):
    doubt = replace(unfit(JOINTS, ()), next_experiment="words", next_effect=effect, next_joints=("elbow",))
    planned = next_run(doubt, ARM, SMALL)
    motion = planned.evaluate(np.arange(0.0, planned.duration_s, 0.01))
    assert np.ptp(motion.q[:, 1]) > 1e-3
    assert np.all(motion.q.min(axis=0) >= SMALL.position.min(axis=0) - 1e-9)
    assert np.all(motion.q.max(axis=0) <= SMALL.position.max(axis=0) + 1e-9)
    fastest = np.abs(np.gradient(SMALL.position, SMALL.time, axis=0)).max(axis=0)
    assert np.all(np.abs(motion.qd).max(axis=0) <= fastest)
    told = described(doubt, planned, ARM, SMALL)
    assert not told.next_cautions and "elbow from" in told.next_motion and "recordings show" in told.next_motion


def test_next_run_uses_what_the_reference_reaches_beyond_the_field():
    doubt = replace(unfit(JOINTS, ()), next_experiment="words", next_effect="ripple", next_joints=("elbow",))
    runs = [next_run(doubt, ARM, SMALL, *others) for others in ((), (HEALTHY,))]
    spans = [np.ptp(one.evaluate(np.arange(0.0, one.duration_s, 0.01)).q[:, 1]) for one in runs]
    assert 1.5 * spans[0] < spans[1] <= np.ptp(HEALTHY.position[:, 1])


def test_a_reading_that_failed_for_a_sample_widens_no_range():
    position = SMALL.position.copy()
    position[1000, 1] += 1.0
    doubt = replace(unfit(JOINTS, ()), next_experiment="words", next_effect="ripple", next_joints=("elbow",))
    sound, spiked = (next_run(doubt, ARM, one).evaluate([20.0]).q for one in (SMALL, replace(SMALL, position=position)))
    np.testing.assert_allclose(spiked, sound, atol=1e-4)


def test_a_sweep_approaches_its_ends_no_faster_than_it_sweeps():
    """What is suspected there may be a stop."""
    doubt = replace(unfit(JOINTS, ()), next_experiment="words", next_effect="ripple", next_joints=("elbow",))
    planned = next_run(doubt, ARM, SMALL)
    speed = np.abs(planned.evaluate(np.arange(0.0, planned.duration_s, 0.01)).qd[:, 1])
    assert speed.max() < 1.05 * np.ptp(SMALL.position[:, 1]) / 12.0


def test_a_range_that_is_too_small_is_left_with_words_on_console_page_and_in_the_file(tmp_path):
    middle = SMALL.position[0, 1]
    held = replace(SMALL, position=np.column_stack([SMALL.position[:, 0], middle + 0.01 * SMALL.position[:, 1]]))
    doubt = explanation(finding("unknown"))
    planned = next_run(doubt, ARM, held)
    told = described(doubt, planned, ARM, held)
    (farther, *faster) = told.next_cautions
    assert "leaves the recorded range: elbow from" in farther and "make sure it is free" in farther
    assert all(line.startswith("faster than recorded: elbow") for line in faster)
    folder = write_mismatch(told, ARM, RunSet([held]), planned, tmp_path / "why").parent
    head = [line for line in (folder / "next_experiment.yaml").read_text().splitlines() if line.startswith("# ")]
    for text in ("\n".join(head), (folder / "report.html").read_text(), summary(told, folder / "report.html", "N m")):
        assert farther in text
    assert "next_experiment.yaml" in (folder / "report.html").read_text()
    assert to_document(told)["next_experiment_cautions"] == [*told.next_cautions]
    assert load_trajectory(folder / "next_experiment.yaml").joints == JOINTS


def test_a_file_is_written_where_it_is_the_experiment_that_the_words_name_and_nowhere_else():
    for kind, effect in EFFECTS.items():
        named = re.findall(r"--for (\w*)", effect.experiment)
        assert named == [EXPERIMENT_OF[one] for one in (kind,) if one in EXPERIMENT_OF], f"no purpose: {named}"
    same = explanation(finding("torque_constant", close=["payload"]))
    assert same.next_experiment.startswith("the same motion")
    assert next_run(same, ARM, HEALTHY) is None
    assert "next_experiment.yaml" not in summary(same, Path("page"), "N m") + page(same)


# --- what is asked ------------------------------------------------------------------------------------------------


def test_nobody_on_the_ground_is_asked_to_exclude_vacuum():
    drift = finding("friction_drift", close=["vacuum_friction"])
    assert next_experiment([drift], in_air=True)[0] is None
    assert "from vacuum_friction" in next_experiment([drift], in_air=False)[0]
    both = finding("friction_drift", close=["vacuum_friction", "position_friction"])
    assert "from position_friction" in next_experiment([both], in_air=True)[0]


def test_what_follows_another_joint_is_settled_by_a_motion_of_both():
    words, effect, joints = next_experiment([finding("unknown", driver="shoulder")], in_air=True)
    assert "alone" not in words and "elbow" in words and "shoulder" in words
    assert joints == ("elbow", "shoulder") and effect not in EXPERIMENT_OF.values()


def test_what_happened_once_is_not_looked_for_over_the_range():
    words, effect, _ = next_experiment([finding("unknown", windows=((0, 6.5, 7.3),))], in_air=True)
    assert words.startswith("the same motion") and not effect


@pytest.mark.parametrize(("explained", "left", "weakly"), [(0.53, 0.2, True), (0.97, 0.2, False), (0.53, 0.05, False)])
def test_a_dependence_that_leaves_most_is_said_to_be_weak(explained, left, weakly):
    one = finding("unknown", where="follows the position of shoulder", explained=explained, after_Nm={"elbow": left})
    assert doubted(one, {"elbow": 0.05}).where.startswith("weakly: ") is weakly


def test_every_effect_has_a_remedy_and_a_sure_finding_shows_it():
    for kind, effect in EFFECTS.items():
        assert effect.remedy, kind
    sure = sure_of_remedy(finding(), in_air=True)
    told = explanation(sure)
    assert f"next: {EFFECTS['payload'].remedy}" in summary(told, Path("page"), "N m")
    assert EFFECTS["payload"].remedy in page(told)
    assert to_document(told)["findings"][0]["remedy"] == EFFECTS["payload"].remedy
    assert not sure_of_remedy(finding(close=["base_tilt"]), in_air=True).remedy


# --- what was not checked -----------------------------------------------------------------------------------------


def test_an_event_is_said_to_be_outside_the_held_out_data_and_these_are_no_all_clear():
    field = replace(run(2), sources=(Source("bags/field.mcap", 1, ""),))
    contact = finding("external_contact", windows=((0, 10.0, 12.1),), event=True, explained=float("nan"))
    (told,) = outside_held_out([contact], [field], "the last third of the field recordings")
    words = (
        "it is in field.mcap from 10.0 to 12.1 s, outside what is held out (the last third of the field recordings): "
        "not checked on unseen data"
    )
    assert told.unchecked == words
    whole = explanation(told, before_Nm=NOISE)
    console, html = summary(whole, Path("page"), "N m"), page(whole)
    for text in (console, html):
        assert words in text and "nan %" not in text and "not testable" not in text
    assert "residual RMS" not in console and "Residual RMS over the noise floor" not in html
    assert to_document(whole)["findings"][0]["unchecked"] == words
    # Beside a finding that the held-out data do have, they say something.
    assert "residual RMS" in summary(explanation(finding(), told, before_Nm=NOISE), Path("page"), "N m")
    assert "residual RMS" in summary(explanation(told), Path("page"), "N m")


def test_a_window_beyond_what_is_fitted_is_not_said_to_be_outside_what_is_held_out():
    field = run(2)
    contact = finding("external_contact", windows=((0, 10.0, 40.0),), event=True)
    (told,) = outside_held_out([contact], [field], "the last third")
    assert f"from 10.0 to {field.time[-1]:.1f} s" in told.unchecked and "outside" not in told.unchecked
    assert "not checked" in told.unchecked


def test_findings_of_which_one_lasts_are_in_the_held_out_data():
    once, lasting = finding("unknown", windows=((0, 1.0, 2.0),)), finding("unknown")
    assert joined([once, once], JOINTS).windows == ((0, 1.0, 2.0),) * 2
    assert joined([once, lasting], JOINTS).windows == ()


def test_a_share_that_cannot_be_tested_is_no_number():
    text = summary(explanation(finding(explained=float("nan"))), Path("page"), "N m")
    assert "nan" not in text and "not testable" in text


# --- words --------------------------------------------------------------------------------------------------------


def test_confidence_of_unknown_is_not_that_of_a_name():
    nameless = explanation(finding("unknown"))
    assert "that no known effect is the cause" in summary(nameless, Path("page"), "N m")
    assert "that no known effect is the cause" in page(nameless) and "that the name is right" not in page(nameless)
    assert "that the name is right" in page(explanation(finding()))


def test_a_ratio_has_no_unit():
    ratio = explanation(finding(parameters={"scale": Quantity(1.133, "1", 1.112, 1.155)}))
    assert "    scale 1.133 [1.112, 1.155]\n" in summary(ratio, Path("page"), "N m")


@pytest.mark.parametrize(
    ("true", "words"),
    [
        (0.88, "the recorded torque is 14 % too large: the true torque constant is 12 % lower than configured"),
        (1.25, "the recorded torque is 20 % too small: the true torque constant is 25 % higher than configured"),
    ],
)
def test_a_torque_constant_says_which_way_it_is_off(true, words):
    """Recorded is the current, torque / true, times the configured constant, 1."""
    effect = TorqueConstant.at(ARM, {"joint": "elbow"})
    assert effect.where(np.array([1.0 / true - 1.0])) == words
