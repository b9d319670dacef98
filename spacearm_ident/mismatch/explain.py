"""Explain a mismatch: recordings in, verdict, findings and the extended model out.

The stages: can the data carry the question (`integrity`); base model, noise and whitened rows (`preparation`); which
effects explain what is left (`competition`); and a card for each, judged on a recording that no fit has seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.effect import Effect
from ..dynamics.effects.friction import FrictionDrift
from ..errors import UnfitDataError
from ..memory import give_back
from ..recording.recording import Recording
from ..signals.moving_span import cut_by_motion
from .base_structure import choose_base
from .candidate import refit, with_own
from .cards import Cards
from .competition import GATE, Competition, Outcome
from .evidence import Evidence
from .extend import extended_model
from .finding import MISMATCH, NO_MISMATCH, Explanation, Finding, Happened, Unexplained, joined, unfit
from .healthy import Healthy, healthy_levels
from .integrity import faults
from .judgement import BEYOND_A_DAY, WEAKLY, beyond_healthy, clears_up, contradicted, doubted, harms, of_one_law, shows
from .next_step import next_experiment, outside_held_out, sure_of_remedy
from .null import exceeds_null
from .power import would_have_seen
from .preparation import ChooseStructure, Prepared, prepare_evidence
from .reliability import calibrated
from .residuals import Residuals
from .rivals import UNKNOWN
from .run_set import RunSet
from .scored import Scored

Progress = Callable[[float, str], None]
IsFinding = Callable[[Effect], bool]
AGAIN = 2
"""Times that the search goes on with a smaller noise, where only what it leaves says how large that is."""
HOLD_OUT = 0.35
"""Share of every recording that is held out where no recording is given to judge on."""
LEVEL_UNKNOWN = (
    "the model file does not keep what the model leaves of its own recordings: what the model lacks may be a finding; "
    "give recordings of the healthy arm as reference, or identify it again"
)
UNDETERMINED = (
    "the data do not determine the base model (its normal equations are singular): record a longer run, or a motion of "
    "all joints"
)


def explain(
    arm: Arm,
    runs: RunSet,
    excluded: Sequence[str] = (),
    gate: float = GATE,
    progress: Progress | None = None,
    choose: ChooseStructure = choose_base,
    is_finding: IsFinding = lambda effect: True,
) -> Explanation:
    """Say what physics a recording shows that the reference does not.

    Args:
        arm: What is known before.
        runs: What is compared with what.
        excluded: Effects that are not to be considered (for blind trials of what is not in the catalogue).
        gate: Score below which nothing is found.
        progress: Called with a share done in 0..1 and what is being done.
        choose: Chooses the structure of the base from a fit of the paper's.
        is_finding: Whether an effect is one where it is accepted; others are fitted beside the findings, and are in no
            model.

    Raises:
        UserError: A recording lacks a joint of the arm.
    """
    report = progress or (lambda share, what: None)
    names = arm.joint_names
    broken = faults(runs.every, names)
    if broken:
        return unfit(names, tuple(broken))
    judged_on = "held-out recordings"
    if not runs.validation:
        fitted, ends = held_out_ends(runs.field)
        runs = replace(runs, field=fitted, validation=ends)
        judged_on = "the last third of the field recordings, held out of the fit"
    report(0.0, "fitting the base model")
    try:
        prepared = prepare_evidence(arm, runs, choose)
    except UnfitDataError as error:
        return unfit(names, (str(error),))
    except np.linalg.LinAlgError:
        return unfit(names, (UNDETERMINED,))
    competition = Competition(prepared.evidence, prepared.held_out, excluded, gate)
    outcome = competition.run(lambda share, what: report(0.15 + 0.6 * share, what))
    for _ in range(AGAIN if prepared.evidence.reference is None else 0):
        quieter = prepared.beside(outcome.accepted)
        if quieter is None:
            break
        prepared = quieter
        competition.reweigh(prepared.evidence, prepared.held_out)
        outcome = competition.run(lambda share, what: report(0.75 + 0.15 * share, what))
    competition.search.end()
    report(0.92, "writing the result")
    answer = _answer(prepared, competition, outcome, is_finding)
    report(1.0, "done")
    findings = outside_held_out(answer.findings, runs.field, judged_on)
    return replace(answer, judged_on=judged_on, findings=findings)


def held_out_ends(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Recordings without the last third of their motion (`HOLD_OUT`), and those thirds."""
    parts = [cut_by_motion(recording, HOLD_OUT) for recording in recordings]
    return [first for first, _ in parts], [last for _, last in parts]


def _answer(prepared: Prepared, competition: Competition, outcome: Outcome, is_finding: IsFinding) -> Explanation:
    current, tried = competition.current, competition.search.tried()
    evidence, held_out = current.evidence, current.held_out
    assert held_out is not None
    joints = evidence.base.model.arm.joint_names
    residuals, in_field = (Residuals(evidence, scene, prepared.plain) for scene in (held_out.scene, evidence.field))
    give_back()  # From here on a few large arrays are asked for, which the many small ones of the search left no room.
    healthy, healthy_field = healthy_levels(evidence, prepared, (residuals, in_field))
    floor = healthy.floor_Nm
    before = residuals.of(healthy.parameters, [], np.zeros(0))
    rms_before = residuals.rms(before)
    known = np.isfinite(floor)
    if not np.isfinite(rms_before[known]).any():
        return unfit(joints, (*_not_compared(joints, known, rms_before), "record a longer run, or give --validate"))
    on_a_day = evidence.with_days(prepared.days) if prepared.days > 0.0 else evidence
    field_alone = _FieldAlone(in_field, healthy_field, joints)
    judge = _Judge(evidence, healthy, dict(zip(joints, rms_before.tolist())), on_a_day, field_alone)
    outcome, made = judge.standing(outcome, residuals, is_finding)
    accepted = outcome.accepted
    findings = _named(made, outcome, judge.floor)
    after = residuals.of(evidence.base_parameters(accepted, outcome.refit.values), accepted, outcome.refit.values)
    rms_after = residuals.rms(after)
    # What happened for a while says nothing of the data judged on, of which its like is left out.
    if all(finding.event for finding in findings):
        lasting = np.minimum(residuals.rms_throughout(before), residuals.rms_throughout(after))
        where = np.flatnonzero(healthy.beyond(lasting, np.minimum(rms_before, rms_after)))
        findings = (*findings, *_unnamed(joints, where, rms_before, rms_after, floor))
    if not findings and evidence.reference is not None:
        findings = field_alone.unnamed()
    if evidence.reference is not None:
        findings = calibrated(findings)
    in_air = bool(np.any(evidence.base.model.arm.gravity))
    findings = tuple(sure_of_remedy(finding, in_air) for finding in findings)
    words, next_effect, next_joints = next_experiment(findings, in_air)
    # Without a finding nothing was added to the reference's model, whatever a refit to the field would leave.
    added, rms_added = (after, rms_after) if findings else (before, rms_before)
    return Explanation(
        verdict=MISMATCH if findings else NO_MISMATCH,
        joints=joints,
        noise_floor_Nm=np.where(known, floor, np.nan),
        detectable_Nm=np.where(known, healthy.detectable_Nm, np.nan),
        before_Nm=rms_before,
        after_Nm=rms_added,
        findings=findings,
        happened=tuple(competition.happened),
        unexplained=_unexplained(joints, rms_after, healthy, outcome) if findings else (),
        next_experiment=words,
        next_effect=next_effect,
        next_joints=next_joints,
        already_there=tuple(_words(scored) for scored in outcome.common),
        reasons=(
            *_not_compared(joints, known, rms_before),
            *((LEVEL_UNKNOWN,) if prepared.modelled and prepared.own is None else ()),
            *_not_judged(competition.happened, len({motion.source for motion in evidence.field.motions})),
            *(() if findings else _moments(joints, rms_after, healthy)),
            *_in_common(findings, joints, _warmer(evidence)),
        ),
        model=extended_model(evidence, accepted, outcome.refit.values, is_finding) if accepted else None,
        traces=residuals.traces(before, added),
        cutoff_hz=prepared.cutoff_hz,
        would_have_seen=would_have_seen(evidence, on_a_day, tried, findings, healthy, current.gate),
    )


class _FieldAlone:
    """What the reference's model, which saw neither, leaves of the fitted recordings, whatever it does of the judged.

    A motion need not excite what has changed.
    """

    def __init__(self, field: Residuals, healthy: Healthy, joints: Sequence[str]) -> None:
        residual = field.of(healthy.parameters, [], np.zeros(0))
        self._rms, self._floor, self._joints = field.rms(residual), healthy.floor_Nm, joints
        self._where = np.flatnonzero(healthy.beyond(field.rms_throughout(residual), self._rms))

    def is_cleared_up_by(self, finding: Finding) -> bool:
        """Whether a finding is most of what is too much for a healthy arm."""
        left = {self._joints[k]: float(self._rms[k]) for k in self._where.tolist()}
        return clears_up(finding, left, dict(zip(self._joints, self._floor.tolist())))

    def unnamed(self) -> tuple[Finding, ...]:
        """The same as a finding, where there is none."""
        found = _unnamed(self._joints, self._where, self._rms, self._rms, self._floor)
        return tuple(replace(finding, where=f"{finding.where}; the held-out data do not show it") for finding in found)


class _Judge:
    """Whether findings stand: on the judged data, and against what the healthy arm shows."""

    def __init__(
        self,
        evidence: Evidence,
        healthy: Healthy,
        before: dict[str, float],
        on_a_day: Evidence,
        field_alone: _FieldAlone,
    ) -> None:
        self._on_a_day, self._field_alone = on_a_day, field_alone
        joints = evidence.base.model.arm.joint_names
        self._evidence, self._healthy, self._before = evidence, healthy, before
        self.floor = dict(zip(joints, healthy.floor_Nm.tolist()))
        self._largest = dict(zip(joints, healthy.largest_Nm.tolist()))

    def standing(
        self, outcome: Outcome, residuals: Residuals, is_finding: IsFinding
    ) -> tuple[Outcome, dict[int, Finding]]:
        """The outcome without what does not stand, and its findings, each by the number of its effect."""
        while True:
            cards = Cards(self._evidence, residuals, outcome, self._healthy.floor_Nm, self._on_a_day)
            made = {k: cards.finding(k) for k, one in enumerate(outcome.accepted) if is_finding(one.effect)}
            idle = [k for k in made if not self.stands(k, made, outcome)]
            if not idle:
                return outcome, made
            # What shows beside another may show no more without it.
            outcome = outcome.without(idle)

    def stands(self, number: int, findings: Mapping[int, Finding], outcome: Outcome) -> bool:
        """Whether one of the findings, each by the number of its effect in the outcome, does."""
        finding = findings[number]
        if harms(finding) or not shows(list(findings).index(number), list(findings.values()), self.floor):
            return False
        if self._is_of_the_day(number, outcome):
            return False
        return (
            beyond_healthy(finding, self._before, self._largest)
            or self._exceeds_null(number, outcome)
            or (self._evidence.reference is not None and self._field_alone.is_cleared_up_by(finding))
        )

    def _is_of_the_day(self, number: int, outcome: Outcome) -> bool:
        """Whether friction that ordinarily differs between days explains about as much as one of the effects."""
        if self._on_a_day is self._evidence:
            return False
        own = self._on_a_day.again(outcome.accepted)
        others = [one for k, one in enumerate(own) if k != number]
        return refit(own).gain - refit(others).gain < BEYOND_A_DAY

    def _exceeds_null(self, number: int, outcome: Outcome) -> bool:
        candidate, values = [*with_own(outcome.accepted, outcome.refit.values)][number]
        if self._healthy.left_out is None or candidate.effect.event:
            return False
        return exceeds_null(candidate, values, self._evidence, self._healthy.left_out)


def _named(made: Mapping[int, Finding], outcome: Outcome, floor: Mapping[str, float]) -> tuple[Finding, ...]:
    """Findings, by the number of their effect, under the names that the data allow; a cause is one finding."""
    effects = [candidate.effect for candidate in outcome.accepted]
    stated = [contradicted(finding, effects[k], effects) for k, finding in made.items()]
    return of_one_law([doubted(finding, floor) for finding in _by_cause(stated, list(floor))], floor)


def _by_cause(findings: Sequence[Finding], joints: Sequence[str]) -> tuple[Finding, ...]:
    """Largest first; what several joints show for one reason is one finding."""
    ordered = sorted(findings, key=lambda finding: -finding.gain - finding.held_out_gain)
    causes: dict[object, list[Finding]] = {}
    for number, finding in enumerate(ordered):
        one = finding.event or (finding.effect in EFFECTS and EFFECTS[finding.effect].one_cause)
        key: object = (finding.effect, finding.event) if one else number
        if finding.effect == UNKNOWN:
            key = (UNKNOWN, finding.joints)
        causes.setdefault(key, []).append(finding)
    return tuple(joined(group, joints) for group in causes.values())


def _not_compared(joints: Sequence[str], known: np.ndarray, before: FloatArray) -> tuple[str, ...]:
    """Why some joints are not compared: their noise is not known (n,), or they hardly move where it is judged."""
    reasons = (
        (~known, "in the reference"),
        (known & ~np.isfinite(before), "in the held-out recordings"),
    )
    return tuple(
        f"not compared, because moving for less than half a second {where}: "
        f"{', '.join(joint for joint, out in zip(joints, left_out) if out)}"
        for left_out, where in reasons
        if left_out.any()
    )


def _not_judged(events: Sequence[Happened], fitted: int) -> tuple[str, ...]:
    """What of the recordings judged on is not."""
    return tuple(f"not judged: {event.words} of held-out recording {event.recording - fitted + 1}" for event in events)


def _moments(joints: Sequence[str], after: FloatArray, healthy: Healthy) -> tuple[str, ...]:
    """What is above a healthy arm's residual for a moment only, where nothing was found."""
    return tuple(
        f"{joint} leaves {rms:.3g} N m RMS where a healthy arm leaves {least:.3g} at most, but not throughout: see when"
        for joint, rms, least in zip(joints, after, healthy.unexplained_Nm)
        if np.isfinite(rms) and rms > least
    )


def _warmer(evidence: Evidence) -> FloatArray | None:
    """(n,) by how much the joints are warmer in the field than in the reference, K; None where not all is recorded."""
    if evidence.reference is None or not (evidence.field.temperatures_known and evidence.reference.temperatures_known):
        return None
    means = [
        np.mean(np.concatenate([motion.temperature for motion in scene.motions]), axis=0)
        for scene in (evidence.field, evidence.reference)
    ]
    return np.asarray(means[0] - means[1])


def _in_common(findings: Sequence[Finding], joints: Sequence[str], warmer: FloatArray | None) -> tuple[str, ...]:
    """What lasting changes of friction at most joints have in common, where all are of one sign.

    Args:
        findings: All of them.
        joints: Names of the arm's n joints.
        warmer: (n,) K, as `_warmer` has it.
    """
    drifts = [finding for finding in findings if finding.effect == FrictionDrift.kind and not finding.event]
    rises = {value.value > 0.0 for finding in drifts for value in finding.parameters.values()}
    where = {joint for finding in drifts for joint in finding.joints}
    if len(where) < 2 or 2 * len(where) <= len(joints) or len(rises) != 1:
        return ()
    level = "higher" if rises == {True} else "lower"
    alike = (
        f"friction is {level} at {len(where)} of {len(joints)} joints: one cause of all, such as their temperature, "
    )
    if warmer is None:
        return (alike + "is more likely than one at each; record the joints' temperatures",)
    apart = [kelvin for joint, kelvin in zip(joints, warmer) if joint in where]
    return (
        alike + f"is more likely than one at each; they were {min(apart):+.1f} to {max(apart):+.1f} K from the "
        "reference's temperature",
    )


def _words(scored: Scored) -> str:
    effect = scored.candidate.effect
    return f"{effect.words} ({effect.kind}) at {', '.join(effect.joints) or 'the base'}"


def _unnamed(
    joints: Sequence[str], where: np.ndarray, before: FloatArray, after: FloatArray, floor: FloatArray
) -> tuple[Finding, ...]:
    """Where nothing was found, and more is left than a healthy arm leaves all the same: something, without a name.

    By the reference's model, and by that refitted with the field: the latter alone may fail on a motion of its own.
    """
    if not len(where):
        return ()
    where = where[np.argsort(-after[where] / floor[where])]
    return (
        Finding(
            effect=UNKNOWN,
            joints=tuple(joints[k] for k in where),
            where=f"{after[where[0]] / floor[where[0]]:.1f} times the noise; no effect of the catalogue explains it",
            equation="",
            source="",
            parameters={},
            confidence=1.0,
            alternatives=(),
            gain=0.0,
            held_out_gain=0.0,
            visibility=1.0,
            before_Nm={joints[k]: float(before[k]) for k in where},
            after_Nm={joints[k]: float(after[k]) for k in where},
            explained=0.0,
        ),
    )


def _unexplained(
    joints: Sequence[str], after: FloatArray, healthy: Healthy, outcome: Outcome
) -> tuple[Unexplained, ...]:
    """Joints whose residual is above the noise with everything that was found."""
    left = outcome.left.candidate.effect if outcome.left is not None else None
    found = []
    for joint, rms, noise, least in zip(joints, after, healthy.floor_Nm, healthy.unexplained_Nm):
        if np.isfinite(rms) and rms > least:
            where = "no effect of the catalogue explains it"
            if left is not None and left.kind == UNKNOWN and joint in left.joints:
                where = f"{WEAKLY}{left.where(outcome.left_values)}"
            found.append(Unexplained((joint,), where, float(1.0 - noise**2 / rms**2)))
    return tuple(found)
