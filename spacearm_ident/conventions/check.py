"""`check_conventions`: whether recordings keep the conventions that an identification takes for granted.

Cheap and certain things first (clock, rest, dead torque, recorded velocity, the bag's own description, joints that are
fixed in the arm), then every ordinary mistake as a hypothesis: how much better does the arm of the URDF explain the
torque if it was made?
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import expit

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.base_link import frame_fault, without_still_base
from ..errors import UnfitDataError
from ..forks import each
from ..recording.recording import Recording
from ..signals.bandwidth import BOUNDS_HZ
from ..signals.motion import STUCK_RAD
from ..signals.prepare import prepare, require_joints, reversal_cutoff_hz
from .change import PHYSICAL, PRIOR, TORQUE_SCALES, UNIT_FACTOR, Change, Kind
from .description import compare_description
from .evidence import MASS_SD, Evidence, log_mass, mass_likelihood
from .finding import INFERRED, Alternative, ConventionReport, Finding, Level, Untested, merged
from .fixed_joints import moving_though_fixed
from .jumps import impossible_steps, moved_zeros
from .physical import payload
from .plain import CLOCK_JITTER, Plain, read_off, two_sources, without_motion
from .plausible import EFFORT_SLACK
from .rows import rows_of
from .scorer import Scored, Scorer, carried, loaded_joints
from .search import SUSPECTED, Step, search
from .setup import Setup
from .values import (
    LATE_S,
    LEAST_TILT_RAD,
    SHORTEST_DELAY_S,
    ZERO_LARGE,
    ZERO_SMALL,
    ZERO_UNKNOWN,
    delay_past_reversals,
    direction_error,
    zero_error,
)
from .words import corrections, is_unit, joint_names, rated_factors, remedy, statement

SURE_PROBABILITY = 0.99
"""What a change at the limit of certainty is called; log odds are scaled to it."""
SUSPECTED_PROBABILITY = 0.8
"""Probability below which a suspicion names nothing."""
VELOCITY_BONUS = 5.0
"""Log-likelihood of a position mistake that explains a recorded velocity as well, a joint."""
OTHER_SCALES = (0.5, 0.5**0.5, 2.0**0.5, 2.0)
"""Factors on one joint's position about degrees, beside which degrees must stand; a wrong gear ratio taken for degrees
(a factor of 57) is off by more than a quarter at one joint or another, as the ratios of an arm differ by more."""
POSITION_UNIT = "position_unit"
"""Kind of a finding that positions are in no unit of angle."""
BASE_FRAME = "base_frame"
"""Kind of a finding that the frame of a moving base's sensor is not fixed to the base link."""

Progress = Callable[[float, str], None]


def check_conventions(
    recordings: Sequence[Recording], arm: Arm, *, gravity_known: bool = True, progress: Progress | None = None
) -> ConventionReport:
    """Check recordings against the conventions, each by itself.

    Args:
        recordings: At least one, of the arm's joints.
        arm: The arm; its CAD inertials are the prior, its corrections are taken to have been applied.
        gravity_known: Whether the arm's gravity is to be believed; else it is estimated, and that it is another one is
            no mistake.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A recording lacks a joint of the arm.
    """
    if progress is not None:
        progress(0.0, "checking conventions")
    found = merged(each(partial(_check, arm=arm), recordings))
    if gravity_known:
        return found
    return replace(found, findings=tuple(one for one in found.findings if one.kind != Kind.GRAVITY))


def recording_name(recording: Recording) -> str:
    """What a finding calls a recording."""
    return Path(recording.sources[0].path).name if recording.sources else "recording"


def _check(recording: Recording, arm: Arm) -> ConventionReport:
    require_joints(recording, arm.joint_names)
    # As in an identification: a sensor at rest makes no moving base.
    sensed = recording.base is not None
    recording = without_still_base(recording)
    ordered = recording.in_order(arm.joint_names)
    if mixed := two_sources(recording):
        # Motion, clock and velocity are those of two courses: what else is found of them follows from that.
        return _report(recording, [*mixed, *compare_description(recording, arm)], Untested.TWO_SOURCES)
    plain = read_off(ordered)
    unmodelled = moving_though_fixed(recording, arm)
    findings = [*_base_frame(recording, arm), *compare_description(recording, arm), *unmodelled, *plain.findings]
    undecided: list[str] | Untested = []
    if jumps := impossible_steps(ordered, arm):
        # What else is found of them follows from that.
        findings, undecided = [*jumps, *findings], Untested.TWO_ZEROS
    elif recording.base is not None:
        undecided = Untested.MOVING_BASE
    elif any(one.level is Level.UNFIT for one in unmodelled):
        undecided = Untested.UNMODELLED_JOINTS
    elif len(plain.still) < len(arm.joints) and len(plain.dead) < len(arm.joints):
        try:
            inferred, undecided = _infer(ordered, arm, plain, base_held=sensed)
            if any(one.kind == CLOCK_JITTER for one in inferred):
                # What is inferred of motion that the clock has spoilt is none of the arm's.
                findings, undecided = _spoilt_by_the_clock(findings, inferred), Untested.CLOCK
            else:
                findings = _explained(findings, inferred) + inferred
        except UnfitDataError as error:
            findings = _without_rows(findings, str(error))
    return _report(recording, findings, undecided)


def _report(recording: Recording, findings: Sequence[Finding], undecided: list[str] | Untested) -> ConventionReport:
    """What was found in one recording, and what its data leave open."""
    name = recording_name(recording)
    found = tuple(replace(finding, recordings=(name,)) for finding in findings)
    if isinstance(undecided, Untested):
        return merged([ConventionReport(found, (f"{INFERRED} ({undecided})",), (name,), (name,))])
    return merged([ConventionReport(found, tuple(undecided), (name,))])


def _base_frame(recording: Recording, arm: Arm) -> list[Finding]:
    """That nobody knows where on the base the sensor of its motion sits; with it an identification ends."""
    fault = None if recording.base is None else frame_fault(recording.base, arm)
    return [] if fault is None else [Finding(BASE_FRAME, Level.UNFIT, (), *fault)]


def _spoilt_by_the_clock(plain: Sequence[Finding], inferred: Sequence[Finding]) -> list[Finding]:
    """What is read off, and that the clock makes the data unfit: as read off where that was, with its correction."""
    if any(one.kind == CLOCK_JITTER for one in plain):
        return [replace(one, level=Level.UNFIT) if one.kind == CLOCK_JITTER else one for one in plain]
    return [*plain, *(one for one in inferred if one.kind == CLOCK_JITTER)]


def _without_rows(findings: Sequence[Finding], reason: str) -> list[Finding]:
    """What is said where no rows remain: stamps that tear the recording apart are the cause, else it is too short."""
    if any(one.kind.startswith("clock") for one in findings):
        return [replace(one, level=Level.UNFIT) if one.kind.startswith("clock") else one for one in findings]
    remedy = "record an excitation run of ten seconds or more"
    return [*findings, Finding("too_little_motion", Level.UNFIT, (), reason, remedy)]


def _explained(findings: Sequence[Finding], inferred: Sequence[Finding]) -> list[Finding]:
    """Findings without the notes on a recorded velocity that a wrong convention of the position explains."""
    kinds = (Kind.DEGREES, Kind.MOTOR_SIDE, Kind.POSITION_SIGN, Kind.POSITIONS_EXCHANGED, Kind.TIME_REVERSED)
    causes = [one for one in inferred if one.kind in kinds and one.level is Level.UNFIT]
    joints = {joint for one in causes for joint in one.joints}
    every = any(one.kind == Kind.TIME_REVERSED for one in causes)
    return [one for one in findings if one.kind != "velocity" or not (every or set(one.joints) <= joints)]


def _infer(
    recording: Recording, arm: Arm, plain: Plain, *, base_held: bool = False, unit_known: bool = False
) -> tuple[list[Finding], list[str] | Untested]:
    """What the arm's dynamics say, and what they cannot.

    Where positions are in another unit, all but that is said of them in rad: bandwidth, standstill, and the distance
    over which friction builds up follow from the unit (`unit_known`: it was mended).
    """
    motions, bandwidth = prepare([recording], arm.joint_names)
    widest = bandwidth.cutoff_hz
    # In a slow motion the direction of a joint would be lost in its encoder's noise, and the joint seem to rest.
    cutoff = reversal_cutoff_hz([recording], arm.joint_names, min(BOUNDS_HZ[0], widest), widest)
    if cutoff < widest:
        motions, _ = prepare([recording], arm.joint_names, cutoff)
    rows = rows_of(motions)
    stuck = [joint.revolute for joint in arm.joints] & (np.ptp(recording.position, axis=0) < STUCK_RAD)
    rows.moving[:, stuck] = False
    rows.moving[:, sorted(plain.dead | plain.still)] = False
    dead = plain.dead | plain.still
    scorer = Scorer(arm, rows, _velocity_bonus(plain.velocity_slopes), dead, base_held=base_held)
    steps = search(scorer)
    final = steps[-1].before
    if (odd := _no_unit(scorer, final)) is not None:
        return [odd], Untested.POSITION_UNIT
    moved, unknown = moved_zeros(scorer, final, recording)
    if any(one.level is Level.UNFIT for one in moved):
        return moved, Untested.TWO_ZEROS
    findings = [finding for step in steps if (finding := _finding(scorer, step, final)) is not None]
    scaled = [one for one in findings if one.kind in (Kind.DEGREES, Kind.MOTOR_SIDE) and one.level is Level.UNFIT]
    if scaled and not unit_known:
        in_rad = reduce(lambda before, one: one.corrections.applied(before), scaled, recording)
        rest, undecided = _infer(in_rad, arm, read_off(in_rad), base_held=base_held, unit_known=True)
        return scaled + rest, undecided
    units = [one for one in findings if one.kind in (Kind.EFFORT_UNIT, Kind.EFFORT_GAIN)]
    if all(one.level is Level.NOTE for one in units):
        far = _far_from_cad(scorer, final)
        if any(one.level is Level.UNFIT for one in far):
            # Both say that the torque is too small, or too large: a fact takes the place of what is suspected.
            findings = [one for one in findings if one not in units] + far
        elif not units:
            findings += far or _beyond_the_limit(scorer, final)
    findings += without_motion(recording, [arm.joint_names[k] for k in sorted(scorer.idle)], plain.clock_error_s)
    return findings + moved, _undecided(scorer, steps[-1], plain) + unknown


def _no_unit(scorer: Scorer, final: Scored) -> Finding | None:
    """Positions that are too large for rad and that degrees do not explain either; None where degrees do.

    Degrees are by far nearer than rad to motor-side positions at any gear ratio of tens or hundreds. Where they are
    what was recorded, no other factor explains the torque better.
    """
    joints = sorted({joint for one in final.changes if one.kind is Kind.DEGREES for joint in one.joints})
    best, worst = 0.0, -1
    for k in joints:
        for factor in OTHER_SCALES:
            scale = np.array(final.setup.position_scale)
            scale[k] *= factor
            gain = scorer.score(final.changes, replace(final.setup, position_scale=scale)).score - final.score
            best, worst = (gain, k) if gain > best else (best, worst)
    if best <= scorer.sure:
        return None
    names = tuple(scorer.arm.joint_names[k] for k in joints)
    return Finding(
        kind=POSITION_UNIT,
        level=Level.UNFIT,
        joints=names,
        statement=(
            f"the positions of {', '.join(names)} are too large for rad, and degrees do not explain the torque: at "
            f"{scorer.arm.joint_names[worst]} another factor does better. Are they of the motors, larger by the gear "
            "ratio?"
        ),
        remedy=(
            "find out what is recorded; gear_ratio of each joint in the arm YAML lets this check test positions of the "
            "motors, and corrections with position_scale mend them"
        ),
        log_odds=best,
        probability=float(expit(best / _temperature(scorer))),
    )


def _far_from_cad(scorer: Scorer, final: Scored) -> list[Finding]:
    """A unit of torque that masses have taken up.

    Masses that are all off by one factor explain the torque as well as a unit does, and a wide prior of CAD inertials
    lets them: no hypothesis gains then. But neither CAD masses nor a gain are off by `UNIT_FACTOR`.
    """
    size = carried(scorer, final)
    if not np.isfinite(size) or abs(np.log(size)) < np.log(UNIT_FACTOR):
        return []
    # The masses of an arm are off together: what the factor costs, it costs once.
    log_odds = float(np.log(PRIOR) - log_mass(np.array(size)))
    if held := None if final.setup.payload_kg else payload(scorer, final):
        # Off by one factor the masses would not count as off; with the body they do not, either.
        factor = final.score - mass_likelihood(scorer.design(final.setup), final.evidence) + float(np.log(PRIOR))
        log_odds = min(log_odds, factor - held.score)
        if log_odds <= 0.0:
            body = _finding(scorer, Step(final, held, ()), held)
            return [] if body is None else [body]
    everywhere = Change(Kind.EFFORT_GAIN, tuple(range(len(scorer.arm.joints))))
    error = np.full_like(final.evidence.gains, MASS_SD)
    evidence = replace(final.evidence, gains=np.full_like(error, size), gain_errors=error)
    return [
        Finding(
            kind=str(Kind.EFFORT_UNIT),
            level=Level.UNFIT if log_odds > scorer.sure else Level.NOTE,
            joints=joint_names(scorer.arm, everywhere),
            statement=f"{statement(scorer.arm, everywhere, evidence)}, or the URDF's masses are not the arm's",
            remedy=remedy(scorer.arm, everywhere, evidence),
            corrections=corrections(scorer.arm, everywhere, evidence),
            probability=float(expit(log_odds / _temperature(scorer))),
            log_odds=log_odds,
        )
    ]


def _beyond_the_limit(scorer: Scorer, final: Scored) -> list[Finding]:
    """A note on torques that no motor of the URDF gives.

    Inertials that are placeholders tell no unit; a limit does where it is exceeded, and is wrong at times itself.
    """
    ratios, names = scorer.ranges.effort_ratio(final.setup), scorer.arm.joint_names
    beyond = [k for k in range(len(names)) if ratios[k] > EFFORT_SLACK]
    if not beyond:
        return []
    listed = ", ".join(f"{names[k]} {ratios[k]:.2g}" for k in beyond)
    return [
        Finding(
            kind=str(Kind.EFFORT_UNIT),
            level=Level.NOTE,
            joints=tuple(names[k] for k in beyond),
            statement=f"suspected: effort is not in N·m, or the URDF's limits are wrong; effort over limit is {listed}",
            remedy="find the unit of the effort (A, mA, per cent of the limit); effort_scale in the arm YAML mends it",
            values={"over_limit": [round(float(ratios[k]), 3) for k in beyond]},
        )
    ]


def _velocity_bonus(slopes: FloatArray) -> Callable[[Setup], float]:
    """Log-likelihood of recorded velocities: a position scale that makes them its derivative is worth something."""
    odd = np.isfinite(slopes) & (np.abs(slopes - 1.0) > 0.1)

    def bonus(setup: Setup) -> float:
        scale = setup.time_sign * setup.position_scale
        explained = odd & (np.abs(slopes / scale - 1.0) < 0.1) & (setup.position_from == np.arange(len(slopes)))
        return VELOCITY_BONUS * float(explained.sum())

    return bonus


def _finding(scorer: Scorer, step: Step, final: Scored) -> Finding | None:
    """A round's change in words; None where there is none, or it is too small to matter."""
    if step.gain < SUSPECTED * scorer.sure or not step.after.changes:
        return None
    change, arm = step.after.changes[-1], scorer.arm
    if change.kind is Kind.DELAY:
        step = Step(*delay_past_reversals(scorer, step.before, change.joints), ())
        change = step.after.changes[-1]
        if abs(change.value[0]) < SHORTEST_DELAY_S:
            return None
    evidence = final.evidence if change in final.changes else step.after.evidence
    sure = step.gain > scorer.sure
    level = Level.UNFIT if sure else Level.NOTE
    if change.kind is Kind.DELAY:
        # At one joint a wide hysteresis of friction lags behind the velocity like a late torque, past a reversal too.
        shared = len(change.joints) == len(arm.joints) > 1
        level = level if shared and abs(change.value[0]) > LATE_S else Level.NOTE
    elif change.kind is Kind.ENCODER_ZERO:
        if abs(change.value[0]) < ZERO_SMALL:
            return None
        level = level if abs(change.value[0]) > ZERO_LARGE else Level.NOTE
    elif change.kind in PHYSICAL or (change.kind in TORQUE_SCALES and not is_unit(change, evidence)):
        level = Level.NOTE
    alternatives, probability = _alternatives(scorer, step)
    if not sure and probability < SUSPECTED_PROBABILITY:
        return None
    kind, joints, value = change.kind, joint_names(arm, change), change.value
    if kind is Kind.EFFORT_RATED:
        kind, value = Kind.EFFORT_UNIT, rated_factors(change, evidence)
    if kind is Kind.EFFORT_GAIN and len(change.joints) > 1:
        if is_unit(change, evidence):
            kind = Kind.EFFORT_UNIT
        else:
            joints = tuple(arm.joint_names[k] for k in loaded_joints(scorer, final))
    values: dict[str, Any] = {"value": [float(v) for v in value]} if value else {}
    said = statement(arm, change, evidence)
    if kind is Kind.GRAVITY and any(value):
        error = direction_error(scorer, final if change in final.changes else step.after)
        values["direction_error_rad"] = round(error, 4)
        said += f", give or take {np.degrees(error):.0f}°" if error > LEAST_TILT_RAD else ""
    if change.kind in PHYSICAL:
        values = _physical_values(change, evidence)
    mended = remedy(arm, change, evidence)
    if change.kind in TORQUE_SCALES and not scorer.base_held and not step.before.setup.gravity.any():
        mended += "; in zero gravity a base that floats lowers the torque as well: /base_imu tells"
    suspected = "" if sure else "suspected: "
    return Finding(
        kind=str(kind),
        level=level,
        joints=joints,
        statement=suspected + said,
        remedy=mended,
        corrections=corrections(arm, change, evidence),
        probability=probability,
        log_odds=step.gain,
        values=values,
        alternatives=alternatives,
    )


def _physical_values(change: Change, evidence: Evidence) -> dict[str, Any]:
    """Numbers of a payload or a free base, by name."""
    if change.kind is Kind.FLOATING_BASE:
        return {"inertia_kg_m2": round(change.value[0], 3), "mass_kg": round(change.value[1], 3)}
    mass = 0.0 if evidence.body is None else float(evidence.body[0])
    return {"mass_kg": round(mass, 3), "mass_error_kg": round(evidence.body_kg_error, 3)}


def _temperature(scorer: Scorer) -> float:
    """What log odds are divided by: the limit of certainty is `SURE_PROBABILITY` then."""
    return float(scorer.sure / np.log(SURE_PROBABILITY / (1.0 - SURE_PROBABILITY)))


def _alternatives(scorer: Scorer, step: Step) -> tuple[tuple[Alternative, ...], float]:
    """Other changes as probable as the one taken, within the limits of certainty, and the probability of that one."""
    arm, taken = scorer.arm, step.after.changes[-1]
    rivals = [one for one in step.rivals if len(one.changes) == len(step.after.changes)]
    scores = np.array([step.after.score, step.before.score, *(one.score for one in rivals)])
    weights = np.exp((scores - scores.max()) / _temperature(scorer))
    weights /= weights.sum()
    close = [
        Alternative(str(one.changes[-1].kind), joint_names(arm, one.changes[-1]), float(weight))
        for one, weight in zip(rivals, weights[2:])
        if weight > 0.05 and (one.changes[-1].kind, one.changes[-1].joints) != (taken.kind, taken.joints)
    ]
    return tuple(close), float(weights[0])


def _undecided(scorer: Scorer, last: Step, plain: Plain) -> list[str]:
    """What these data leave open."""
    arm, start = scorer.arm, last.before
    words = []
    for one in (*last.rivals, *last.screened):
        change = one.changes[-1]
        zero_or_gain = (Kind.ENCODER_ZERO, Kind.DELAY, *TORQUE_SCALES, *PHYSICAL)
        if change.kind not in zero_or_gain and one.score - start.score > -scorer.sure and change.joints:
            words.append(f"{str(change.kind).replace('_', ' ')} of {', '.join(joint_names(arm, change))}")
    if start.setup.gravity.any() and direction_error(scorer, start) > LEAST_TILT_RAD:
        told = [name for k, name in enumerate(arm.joint_names) if direction_error(scorer, start, [k]) <= LEAST_TILT_RAD]
        beside = f" (a constant torque at {', '.join(told)} looks the same)" if told else ""
        words.append(f"direction of gravity{beside}")
    open_zeros = [
        name
        for k, name in enumerate(arm.joint_names)
        if arm.joints[k].revolute and zero_error(scorer, start, k) > ZERO_UNKNOWN
    ]
    if open_zeros:
        words.append(f"encoder zero of {', '.join(open_zeros)}")
    if scorer.frame.rough:
        words.append("gains, units and total mass (the URDF's inertials are absent or placeholders)")
    else:
        loaded = loaded_joints(scorer, start)
        light = [name for k, name in enumerate(arm.joint_names) if k not in loaded]
        if light:
            words.append(f"torque gain of {', '.join(light)} (little gravity)")
    return words
