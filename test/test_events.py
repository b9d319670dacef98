"""Something touches the arm in every recording at another time: it is named, and nothing is judged while it lasts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, NOISE, loaded_run, run
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.effects.body import ExternalContact
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.preparation import banded
from spacearm_ident.mismatch.rivals import Rival
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.mismatch.stacked import Stacked

FORCE_N = (12.0, -16.0)
"""In the plane of the arm, x and z; 0.4 m along the second link."""


def pushed(begin_s, length_s=3.0):
    """What a force that comes and goes as a raised cosine adds to the torque: -J^T F of the planar arm, on paper."""

    def extra(planted):
        first, both = planted.q[:, 0], planted.q.sum(axis=1)
        across, along = (np.array([0.5 * f(first) + 0.4 * f(both), 0.4 * f(both)]).T for f in (np.cos, np.sin))
        phase = np.clip((np.arange(len(first)) / planted.rate_hz - begin_s) / length_s, 0.0, 1.0)
        rises = 0.5 - 0.5 * np.cos(2.0 * np.pi * phase)
        return -(across * FORCE_N[0] - along * FORCE_N[1]) * rises[:, None]

    return extra


def test_a_push_at_another_time_in_every_recording_is_one_contact_with_its_force():
    field = [run(2, pushed(4.0)), run(4, pushed(9.0))]
    answer = explain(ARM, RunSet(field, validation=[run(3, pushed(6.0))]))
    assert [finding.effect for finding in answer.findings] == ["external_contact"]
    (contact,) = answer.findings
    force = next(quantity for name, quantity in contact.parameters.items() if name.startswith("force"))
    # At a shorter lever than where it was, as its interval says: a force and its lever are nearly one number.
    assert force.low < np.hypot(*FORCE_N) < force.high
    assert force.value == pytest.approx(np.hypot(*FORCE_N), rel=0.16)
    assert np.all(answer.after_Nm < 1.15 * np.array(NOISE))
    # The push of the held-out recording, 6 to 9 s: most of it, and little more.
    during = np.linspace(0.0, 16.0, 1601)
    void = np.any([(during >= one.begin_s) & (during < one.end_s) for one in answer.happened], axis=0)
    assert void[(during > 6.5) & (during < 8.5)].all()
    assert not void[(during < 5.0) | (during > 10.0)].any()
    assert {one.recording for one in answer.happened} == {2}
    assert any("held-out recording 1" in reason for reason in answer.reasons)


def test_a_push_in_the_field_alone_leaves_all_of_the_other_recording_judged():
    answer = explain(ARM, RunSet([run(2, pushed(5.0))], [HEALTHY], [run(3)]))
    assert [finding.effect for finding in answer.findings] == ["external_contact"]
    assert not answer.happened
    assert answer.findings[0].explained > 0.8
    ((number, begin, end),) = answer.findings[0].windows
    assert number == 0 and (begin, end) == pytest.approx((5.5, 7.5), abs=0.7)
    assert "not checked on unseen data" in answer.findings[0].unchecked and answer.unchecked


def test_pushes_for_most_of_a_held_out_recording_are_no_events_of_it():
    """It would leave nothing to judge on."""

    def all_the_time(planted):
        return sum(pushed(begin_s)(planted) for begin_s in (0.5, 3.5, 6.5, 9.5, 12.5))

    answer = explain(ARM, RunSet([run(2, pushed(4.0)), run(4, pushed(9.0))], validation=[run(3, all_the_time)]))
    assert not answer.happened
    assert "external_contact" in {finding.effect for finding in answer.findings}


def test_what_lasts_to_the_end_of_the_recording_is_said_to_end_there():
    """Of what comes after it no torque tells anything."""
    answer = explain(ARM, RunSet([run(2, pushed(13.0, 6.0))], [HEALTHY], [run(3)]))
    (contact,) = answer.findings
    start, length = (contact.parameters[name] for name in ("start", "length"))
    assert contact.effect == "external_contact" and 13.0 < start.value < 15.0
    assert start.value + length.value <= 16.0 and length.high <= 16.0 - start.value


@given(start=st.floats(-3.0, 15.0), length=st.floats(0.1, 6.0))
@settings(max_examples=20, deadline=None)
def test_an_event_has_no_torque_outside_the_samples_in_which_it_lasts(start, length):
    (motion,) = banded([HEALTHY], ARM.joint_names, 20.0, 70.0)
    known = nominal_model(ARM)
    background = known.model.background(motion, known.parameters, known.constants)
    for effect, rest in (
        (ExternalContact.at(ARM, {"joint": "elbow"}), (0.3, 0.1, 0.0, 0.0)),
        (Rival.at(ARM, {"joint": "elbow", "of": "time_window"}), ()),
    ):
        constants = (start, length, *rest)
        outside = np.ones(len(motion.position), dtype=bool)
        outside[effect.lasts(motion, constants)] = False
        for _, columns in effect.columns(motion, constants, background).values():
            assert not columns[outside].any()


def holding(seed, *windows):
    """A run in which the arm holds 0.7 kg, 0.3 m along its last link, from one time to another, s."""
    light, heavy = run(seed), loaded_run(seed, (0.05, 0.0, 0.3)).recording(noise=NOISE, seed=seed + 100)
    held = np.any([(light.time >= begin) & (light.time < end) for begin, end in windows], axis=0)
    return replace(light, effort=np.where(held[:, None], heavy.effort, light.effort))


def test_an_object_that_is_picked_up_and_put_down_twice_is_one_payload_with_its_mass_and_times(monkeypatch):
    # A contact explains nearly as much; what to do is said of what leaves no doubt.
    monkeypatch.setattr("spacearm_ident.mismatch.next_step.CLOSE", 1.0)
    windows = (2.0, 6.0), (9.0, 13.0)
    answer = explain(ARM, RunSet([holding(2, *windows)], [HEALTHY], [holding(3, (5.0, 11.0))]))
    (payload,) = answer.findings
    assert payload.effect == "payload" and payload.joints == ("elbow",)
    assert "while it is held" in payload.remedy
    numbers = sorted(("", "_2"), key=lambda number: payload.parameters[f"start{number}[elbow]"].value)
    for number, (begin, end) in zip(numbers, windows):
        start, length = (payload.parameters[f"{name}{number}[elbow]"] for name in ("start", "length"))
        assert start.value == pytest.approx(begin, abs=0.2)
        assert length.value == pytest.approx(end - begin, abs=0.3)
        assert start.low >= 0.0 and start.high <= 16.0
        mass = payload.parameters[f"mass{number}[elbow]"]
        assert mass.value == pytest.approx(0.7, rel=0.15)
        assert mass.low < 0.7 < mass.high
    # While something is held in the recording judged on, nothing is judged.
    assert {(one.kind, one.recording) for one in answer.happened} == {("payload", 1)}
    assert min(one.begin_s for one in answer.happened) == pytest.approx(5.0, abs=1.0)
    assert max(one.end_s for one in answer.happened) == pytest.approx(11.0, abs=1.0)
    assert np.all(answer.after_Nm < 1.15 * np.array(NOISE))


def test_what_an_event_does_not_describe_is_said_beside_it():
    """Pushes in the field, and in the other recording friction that is not theirs."""

    def rough(planted):
        return np.outer(3.0 * np.sign(planted.qd[:, 1]) * (np.sin(3.0 * planted.q[:, 0]) > 0.3), [0.0, 1.0])

    answer = explain(ARM, RunSet([run(2, pushed(5.0))], [HEALTHY], [run(3, rough)]))
    assert [finding.effect for finding in answer.findings] == ["external_contact", "unknown"]
    assert answer.findings[1].joints[0] == "elbow"


def test_two_pushes_of_one_link_are_both_found():
    answer = explain(ARM, RunSet([run(2, lambda p: pushed(2.0)(p) + pushed(10.0)(p))], [HEALTHY], [run(3)]))
    (contact,) = answer.findings
    starts = [quantity for name, quantity in contact.parameters.items() if name.startswith("start")]
    assert contact.effect == "external_contact"
    assert sorted(one.value for one in starts) == pytest.approx([2.5, 10.5], abs=0.7)


def dragging(joint, torque_Nm, *windows):
    """Dry friction (N·m) that one joint has more for a while, from one time to another, s."""

    def extra(planted):
        time = np.arange(len(planted.qd)) / planted.rate_hz
        on = np.any([(time >= begin) & (time < end) for begin, end in windows], axis=0)
        return np.outer(torque_Nm * np.sign(planted.qd[:, joint]) * on, np.eye(2)[joint])

    return extra


@pytest.mark.parametrize(("joint", "torque_Nm"), [(0, 3.0), (1, 1.5), (0, -2.0)])
def test_a_joint_that_drags_for_a_while_is_friction_of_that_joint_and_time(joint, torque_Nm):
    answer = explain(ARM, RunSet([run(2, dragging(joint, torque_Nm, (5.0, 10.0)))], [HEALTHY], [run(3)]))
    (drag,) = answer.findings
    assert drag.effect == "friction_drift" and drag.joints == (ARM.joint_names[joint],)
    assert drag.parameters["df_c"].low < torque_Nm < drag.parameters["df_c"].high
    assert drag.parameters["start"].value == pytest.approx(5.0, abs=0.3)
    assert drag.parameters["length"].value == pytest.approx(5.0, abs=0.5)
    assert np.all(answer.after_Nm < 1.15 * np.array(NOISE))


def test_a_joint_that_drags_twice_is_one_finding_and_nothing_is_judged_while_it_does_in_the_other_recording():
    field, judged = run(2, dragging(0, 3.0, (2.0, 5.0), (10.0, 14.0))), run(3, dragging(0, 3.0, (6.0, 9.0)))
    answer = explain(ARM, RunSet([field], [HEALTHY], [judged]))
    (drag,) = answer.findings
    assert drag.effect == "friction_drift" and drag.joints == ("shoulder",)
    assert {"start[shoulder]", "start_2[shoulder]"} <= set(drag.parameters)
    assert [(one.kind, one.recording) for one in answer.happened] == [("friction_drift", 1)]


def test_joints_that_drag_at_the_same_time_are_one_finding_that_no_temperature_explains(monkeypatch):
    monkeypatch.setattr("spacearm_ident.mismatch.next_step.CLOSE", 0.0)

    def both(planted):
        return sum(dragging(joint, torque_Nm, (5.0, 10.0))(planted) for joint, torque_Nm in ((0, 3.0), (1, 1.5)))

    answer = explain(ARM, RunSet([run(2, both)], [HEALTHY], [run(3)]))
    (drag,) = answer.findings
    assert drag.effect == "friction_drift" and drag.joints == ARM.joint_names
    assert not any("temperature" in reason for reason in answer.reasons)
    # Another motion would say nothing of what happened for a while.
    assert "the same motion again" in answer.next_experiment and not answer.next_effect


def test_no_joint_has_less_friction_than_none_for_a_while():
    passing = EFFECTS["friction_drift"].at(ARM, {"joint": "shoulder", "of": ["f_c"], "for_a_while": True})
    assert passing.is_within(np.array([-2.9]), {"shoulder": 3.0})
    assert not passing.is_within(np.array([-3.1]), {"shoulder": 3.0})


def late(recording, seconds=0.006):
    """The recording with torque that is stamped later than the motion."""
    then = recording.time - seconds
    effort = np.column_stack([np.interp(then, recording.time, one) for one in recording.effort.T])
    return replace(recording, effort=effort)


def test_a_push_does_not_hide_torque_that_is_late():
    field, judged = [late(run(2, pushed(4.0)))], [late(run(3))]
    answer = explain(ARM, RunSet(field, [HEALTHY], judged))
    named = {finding.effect: finding for finding in answer.findings}
    assert set(named) == {"external_contact", "time_delay"}
    assert named["time_delay"].parameters["delay"].value == pytest.approx(0.006, abs=0.001)


def test_what_is_no_finding_is_fitted_beside_those_that_are_and_is_in_no_model():
    field, judged = [late(run(2, pushed(4.0)))], [late(run(3))]
    answer = explain(ARM, RunSet(field, [HEALTHY], judged), is_finding=lambda effect: effect.kind != "time_delay")
    assert [finding.effect for finding in answer.findings] == ["external_contact"]
    assert "time_delay" not in answer.model.model.structure
    # What it explains is in no residual.
    assert np.all(answer.after_Nm < 1.1 * np.array(NOISE))


@given(
    st.lists(st.integers(0, 29), min_size=1, unique=True),
    st.lists(st.integers(0, 29), min_size=1, unique=True),
    st.tuples(st.integers(0, 29), st.integers(1, 30)),
    st.tuples(st.integers(0, 29), st.integers(1, 30)),
)
def test_inner_products_are_those_of_whole_columns(some, others, first, second):
    rng = np.random.default_rng(0)
    rows = [np.sort(some), np.sort(others), *(slice(a, min(a + n, 30)) for a, n in (first, second))]
    stacks = [Stacked(own, rng.normal(size=(len(np.arange(30)[own]), 2))) for own in rows]
    for one in stacks:
        for other in stacks:
            np.testing.assert_allclose(one.inner(other), one.whole(30).T @ other.whole(30), atol=1e-12)
