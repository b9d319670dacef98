"""Which findings are accepted: not names that leave too much, explain too little, or are dominated by another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from changed_arm import ARM, HEALTHY, ripple, run

from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.mismatch.candidate import Candidate, refit
from spacearm_ident.mismatch.choice import simplest
from spacearm_ident.mismatch.competition import GATE, Competition, Round
from spacearm_ident.mismatch.constants import polish, refine
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.finding import Alternative
from spacearm_ident.mismatch.judgement import clears_up, contradicted, doubted, of_one_law, shows
from spacearm_ident.mismatch.preparation import prepare_evidence
from spacearm_ident.mismatch.rejection import Case, is_dominated, is_momentary, is_rejected
from spacearm_ident.mismatch.rivals import UNKNOWN, Rival
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.mismatch.scored import Scored, is_not_excited
from spacearm_ident.mismatch.stacked import Stacked


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


@pytest.mark.parametrize(
    ("explained", "felt_Nm", "apart"),
    [
        (0.6, {"elbow": 0.5, "shoulder": 0.1}, False),
        (0.6, {"elbow": 0.5, "shoulder": 0.4}, True),
        (0.95, {"elbow": 0.5}, True),
    ],
    ids=["its rest", "another joint as well", "nothing is left"],
)
def test_effects_that_are_fitted_to_what_an_unknown_law_leaves_are_no_findings(rippled, explained, felt_Nm, apart):
    """Whose law is not known leaves a rest of any shape: contacts, friction for a while."""
    (finding,) = rippled.findings
    floor = {"elbow": 0.1, "shoulder": 0.1}
    unknown = replace(finding, effect=UNKNOWN, explained=explained, after_Nm={"elbow": 0.5}, beside_Nm={})
    contact = replace(finding, effect="external_contact", felt_Nm=felt_Nm)
    found = of_one_law([unknown, contact], floor)
    assert [one.effect for one in found] == [UNKNOWN, "external_contact"][: 1 + apart]
    assert ("external_contact" in [other.effect for other in found[0].alternatives]) != apart
    assert [one.effect for one in of_one_law([contact, unknown], floor)] == ["external_contact", UNKNOWN]


def test_a_joint_has_one_finding_without_a_name(rippled):
    (finding,) = rippled.findings
    first, second = (
        replace(finding, effect=UNKNOWN, where=where, before_Nm={"elbow": rms})
        for where, rms in (("a", 1.0), ("b", 0.4))
    )
    (found,) = of_one_law([first, second], {"elbow": 0.1})
    assert (found.where, found.before_Nm) == ("a; b", {"elbow": 1.0})


@pytest.mark.parametrize(("event", "after", "named"), [(False, 0.2, False), (False, 0.104, True), (True, 0.2, True)])
def test_a_law_that_leaves_more_at_a_joint_than_there_was_is_not_the_one(rippled, event, after, named):
    """However much of another joint it explains; an event need not be in the held-out data at all."""
    (finding,) = rippled.findings
    left = {"elbow": 0.1, "shoulder": after}
    before = {"elbow": 1.0, "shoulder": 0.05}
    finding = replace(finding, effect="payload", event=event, explained=0.95, before_Nm=before, beside_Nm={})
    judged = doubted(replace(finding, after_Nm=left), {"elbow": 0.1, "shoulder": 0.1})
    assert (judged.effect != UNKNOWN) == named
    assert named or "more than before at shoulder" in judged.where


@pytest.mark.parametrize("explained, company, good", [(0.3, False, False), (0.3, True, True), (0.5, False, True)])
def test_a_name_by_itself_must_explain_more_than_one_of_several(rippled, explained, company, good):
    (finding,) = rippled.findings
    other = replace(finding, effect="payload") if company else replace(finding, before_Nm={"shoulder": 1.0})
    finding = replace(finding, explained=explained, before_Nm={"elbow": 1.0}, after_Nm={"elbow": 0.8})
    assert shows(0, [finding, other], {"shoulder": 0.1, "elbow": 0.1}) == good


@pytest.mark.parametrize(
    "gain, not_excited, good", [(5000.0, True, True), (115.0, True, False), (5000.0, False, False)]
)
def test_what_held_out_data_do_not_show_must_be_clear_in_the_field_and_not_excited_there(
    rippled, gain, not_excited, good
):
    (finding,) = rippled.findings
    quiet = replace(finding, gain=gain, held_out_gain=0.05 * gain, explained=0.2, not_excited=not_excited)
    assert shows(0, [quiet], {"shoulder": 0.1, "elbow": 0.1}) == good


@pytest.mark.parametrize(
    ("active_gain", "drop", "foretold", "not_excited"),
    [(4.0, 20.0, 20.0, True), (4.0, -1.0, 1.0, True), (4.0, 100.0, 300.0, False), (4.0, 0.0, 100.0, False),
     (0.3, 20.0, 20.0, False)],
)  # fmt: skip
def test_only_what_its_law_leaves_unexcited_and_the_field_shows_plainly_is_not_excited(
    active_gain, drop, foretold, not_excited
):
    assert is_not_excited(1.0, active_gain, drop, foretold, 1000) == not_excited


def test_what_was_below_the_noise_needs_no_explanation(rippled):
    (finding,) = rippled.findings
    assert shows(0, [finding], {"shoulder": 0.1, "elbow": 0.1})
    assert not shows(0, [finding], {joint: 1.01 * rms for joint, rms in finding.before_Nm.items()})


@pytest.mark.parametrize("added, clear", [(0.8, True), (0.6, False)])
def test_a_finding_clears_up_a_joint_of_the_field_if_it_is_more_than_half_of_what_is_above_the_floor(
    rippled, added, clear
):
    finding = replace(rippled.findings[0], felt_Nm={"elbow": added, "shoulder": 9.0})
    assert clears_up(finding, {"elbow": 1.0}, {"elbow": 0.1, "shoulder": 0.1}) == clear


@pytest.mark.parametrize("changed, found", [(0.4, ["friction_drift"]), (0.1, [])])
def test_what_a_gentle_motion_shows_too_little_of_is_named_where_the_field_is_beyond_a_healthy_arm(
    monkeypatch, changed, found
):
    """The field says how large it is, and held-out data that it is there again."""
    for size in ("beyond_healthy", "exceeds_null"):
        monkeypatch.setattr(f"spacearm_ident.mismatch.explain.{size}", lambda *of: False)

    def drift(planted):
        return np.outer(changed * planted.qd[:, 1], [0.0, 1.0])

    explanation = explain(ARM, RunSet([run(2, drift)], [HEALTHY], [run(3, drift, speed=0.3)]))
    assert explanation.before_Nm[1] < explanation.detectable_Nm[1]
    assert [one.effect for one in explanation.findings] == found


def contender(kind, score, joint="elbow", **place):
    effect = EFFECTS[kind].at(ARM, place if "joints" in place else {"joint": joint, **place})
    return Scored(Candidate(effect, (), None, *np.zeros((3, 1))), 0.0, 0.0, score, plausible=True)


def test_what_another_explains_better_and_does_not_stand_is_no_finding():
    """An effect that fits by chance takes weaker ones at its joints along; those at other joints stay."""
    ripple, drift = contender("torque_ripple", 300.0), contender("friction_drift", 100.0)
    assert is_dominated(drift, [ripple], {"elbow"}) and not is_dominated(ripple, [drift], {"elbow"})
    assert not is_dominated(contender("friction_drift", 100.0, "shoulder"), [ripple], {"shoulder"})
    assert not is_dominated(drift, [replace(ripple, plausible=False)], {"elbow"})


def test_a_contact_acts_on_the_joints_that_feel_it():
    """A push on the last link, whose own joint it hardly turns, if at all; what is no event acts where it is."""
    prepared = prepare_evidence(ARM, RunSet([run(2)], [HEALTHY], [run(3)]))
    competition = Competition(prepared.evidence, prepared.held_out)

    def acts_on(kind, constants):
        candidate = prepared.evidence.candidate(EFFECTS[kind].at(ARM, {"joint": "elbow"}), constants)
        return competition.current.acts_on(candidate)

    assert acts_on("external_contact", (5.0, 3.0, 0.1, 0.0, 0.0, 0.0)) >= {"shoulder"}
    assert acts_on("torque_ripple", (20.0,)) == {"elbow"}


def test_constants_are_searched_again_beside_what_joins():
    """What was not known when an effect was accepted went into its constants."""

    def extra(planted):
        return ripple(planted) + np.array([4.0, 0.0])

    prepared = prepare_evidence(ARM, RunSet([run(2, extra)], [HEALTHY], [run(3, extra)]))
    competition = Competition(prepared.evidence, prepared.held_out)
    elbow = EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"})
    competition.current.accepted = [prepared.evidence.candidate(elbow, (19.4,))]
    outcome = competition.run(lambda share, what: None)
    assert {one.effect.kind for one in outcome.accepted} == {"torque_ripple", "current_offset"}
    assert outcome.accepted[0].constants == pytest.approx((20.0,), abs=0.05)


def test_of_two_that_score_alike_the_one_with_less_freedom_is_taken():
    less, more = contender("friction_drift", 5000.0), contender("torque_ripple", 5040.0)
    assert simplest([more, less]) is less
    assert simplest([replace(more, score=5200.0), less]).candidate is more.candidate


def test_an_exact_law_is_not_kept_where_another_explains_more():
    """A constant has no shape that could be a little different: 40 of 5000 are no accident."""
    offset = contender("current_offset", 5000.0)
    more = contender("asymmetric_friction", 5040.0, of=["level", "viscous"])
    assert simplest([more, offset]) is more
    assert simplest([replace(more, score=5005.0), offset]) is offset


def test_late_at_one_joint_is_its_filter_and_late_at_all_is_the_clock():
    everywhere = {"joints": ["shoulder", "elbow"]}
    delay, first = contender("time_delay", 5040.0), contender("filter_lag", 5000.0)
    second = contender("filter_lag", 5020.0, order=2)
    lag, clock = contender("filter_lag", 5040.0, **everywhere), contender("time_delay", 5000.0, **everywhere)
    for ranked, usual in (([delay, second, first], first), ([delay, second], second), ([lag, clock], clock)):
        assert simplest(ranked) is usual
        assert simplest([*ranked[:-1], replace(usual, score=4500.0)]) is not usual


def test_of_touches_that_explain_alike_the_one_fewer_joints_would_feel_is_taken():
    def touched(joint, rows, score):
        stacked = Stacked(slice(0, rows), np.zeros((rows, 3)))
        candidate = replace(contender("external_contact", score, joint).candidate, stacked=stacked)
        return Scored(candidate, score, 0.0, score, plausible=True)

    inner, outer = touched("shoulder", 100, 4980.0), touched("elbow", 200, 5000.0)
    assert simplest([outer, inner]) is inner
    assert simplest([replace(outer, score=5200.0), inner]).candidate is outer.candidate


def test_a_window_whose_beginning_is_early_and_whose_end_is_right_is_found():
    """Whoever moves the beginning alone moves the end along with it."""
    effect = EFFECTS["external_contact"].at(ARM, {"joint": "elbow"})

    def gain(constants):
        first, last = constants[0], constants[0] + constants[1]
        return -abs(first - 8.4) - abs(last - 10.5)

    begin = (9.0, 1.5, 0.1, 0.0, 0.0, 0.0)
    stuck, found = (method(effect, begin, gain, gain(begin)) for method in (refine, polish))
    assert gain(found) > 0.2 * gain(stuck)
    assert found[:2] == pytest.approx((8.4, 2.1), abs=0.1)


def test_constants_that_pull_at_each_other_are_searched_together():
    """A bent valley: one constant after the other, from the grid's best point, ends far from its bottom."""
    effect = EFFECTS["joint_elasticity"].at(ARM, {"joint": "elbow"})

    def gain(constants):
        stiffness, damping = constants[0] / 5000.0, constants[1] / 0.05
        return -1e3 * (stiffness - 1.0) ** 2 - 4e5 * (damping - stiffness) ** 2

    begin = (8000.0, 0.08)
    stuck, found = (method(effect, begin, gain, gain(begin)) for method in (refine, polish))
    assert gain(found) > 0.1 * gain(stuck) > gain(begin)
    assert found == pytest.approx((5000.0, 0.05), rel=0.1)


@pytest.mark.parametrize(("felt", "named"), [(0.1, True), (1.0, False)])
def test_what_is_left_counts_where_the_effect_is_felt(rippled, felt, named):
    """A joint that hardly feels a payload has a residual of its own."""
    (finding,) = rippled.findings
    near = Alternative("payload", ("elbow",), 0.6, "")
    left = {"shoulder": 0.2, "elbow": 0.1}
    finding = replace(
        finding,
        explained=0.7,
        before_Nm={"shoulder": 0.25, "elbow": 0.3},
        after_Nm=left,
        beside_Nm={},
        felt_Nm={"shoulder": felt, "elbow": 1.0},
        alternatives=(near,),
    )
    assert (doubted(finding, {"shoulder": 0.1, "elbow": 0.1}) == finding) == named


def test_what_rings_at_its_own_resonance_is_not_held_against_a_compliance(rippled):
    (finding,) = rippled.findings
    near = Alternative("payload", ("elbow",), 0.6, "")
    finding = replace(finding, explained=0.7, after_Nm={"elbow": 0.3}, beside_Nm={"elbow": 0.1}, alternatives=(near,))
    assert doubted(finding, {"elbow": 0.1}) == finding


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


def test_a_level_of_friction_whose_parts_go_opposite_ways_is_another_curve_over_the_speed(rippled):
    drift = EFFECTS["friction_drift"].at(ARM, {"joint": "elbow", "of": ["f_c", "k_v1"]})
    (finding,) = rippled.findings
    for values, named in (([0.5, 0.2], True), ([-0.5, -0.2], True), ([-0.5, 0.7], False)):
        found = replace(finding, effect=drift.kind, against=drift.against(np.array(values)))
        judged = contradicted(found, drift, [drift])
        assert (judged == found) == named
    assert judged.effect == UNKNOWN and "whose dry and viscous parts go opposite ways" in judged.where
    assert judged.alternatives[0].effect == "friction_drift"


def in_one_moment(planted):
    """Ripple for a second and a half."""
    time = np.linspace(0.0, 1.0, len(planted.torque))[:, None]
    return np.where((time > 0.5) & (time < 0.59), ripple(planted), 0.0)


def pushed_away(planted):
    """A constant torque and a spring that pushes away from where it is slack, which no cable does."""
    return np.outer(4.0 - 0.5 * planted.q[:, 1], [0.0, 1.0])


def test_an_effect_whose_values_are_impossible_in_the_end_gives_way_to_another_of_its_joint():
    prepared = prepare_evidence(ARM, RunSet([run(2, pushed_away)], [HEALTHY], [run(3, pushed_away)]))
    competition = Competition(prepared.evidence, prepared.held_out)
    spring, offset = (
        Scored(
            prepared.evidence.candidate(EFFECTS[kind].at(ARM, {"joint": "elbow"}), ()), 1e4, 1e4, 1e4, plausible=True
        )
        for kind in ("harness_spring", "current_offset")
    )
    competition.current.accepted = [spring.candidate]
    rounds = competition.with_possible_values([Round(spring, (offset,))])
    assert [one.winner.candidate.effect.kind for one in rounds] == ["current_offset"]
    assert [candidate.effect.kind for candidate in competition.current.accepted] == ["current_offset"]
    competition.current.accepted = [spring.candidate]
    assert competition.with_possible_values([Round(spring, ())]) == []


@pytest.mark.parametrize(("extra", "lasts"), [(ripple, True), (in_one_moment, False)])
def test_what_shows_in_one_moment_alone_is_no_lasting_effect(extra, lasts):
    prepared = prepare_evidence(ARM, RunSet([run(2, extra)], [HEALTHY], [run(3, extra)]))
    current = Competition(prepared.evidence, prepared.held_out).current
    scored = current.scored(
        prepared.evidence.candidate(EFFECTS["torque_ripple"].at(ARM, {"joint": "elbow"}), [20.0]),
        refit([]),
        current.on_held_out([], np.zeros(0)),
    )
    assert scored.score > GATE
    assert is_momentary(Case(scored, current)) != lasts
    assert is_rejected(scored, current) != lasts
    assert is_rejected(replace(scored, gain=0.9 * GATE), current)
