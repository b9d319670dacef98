"""Encoders that lost their zero while recorded: a position that jumps, or is another one after a gap.

A step that the joint's speed cannot have covered is read off. In a gap that is long enough the arm may have been moved,
as it ordinarily is; whether the zero after it is that before it is then asked of the torque, as `values.zeros` asks for
a zero that is wrong throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from ..arrays import BoolArray, FloatArray
from ..dynamics.arm import Arm
from ..recording.intake import gap_threshold_s
from ..recording.recording import Recording
from .change import Kind
from .evidence import OWN
from .finding import Finding, Level
from .scorer import Scored, Scorer
from .setup import Setup
from .values import ZERO_LARGE, ZERO_SMALL, ZERO_UNKNOWN, zero_error, zero_prior, zero_step

POSITION_JUMP = "position_jump"
"""Kind of the finding that a joint's positions have two zeros."""
FASTEST_PERCENTILE = 99.9
"""Of the steps from sample to sample, the one that is taken for the joint's largest recorded speed: a jump is not."""
UNLIMITED_FACTOR = 10.0
"""Times that speed which a joint without a speed limit may have within a run. The largest step of 33 sound recordings,
17 of them of real arms, is 2.5 times it; of drives with a cycle that is held up, 3.5 times (1 December 2026)."""
SIDE_S = 0.05
"""Time on either side of a gap over which the speed there is taken, s."""
MOST_GAPS = 4
"""Gaps asked of the torque, those with the largest steps: each costs some twenty evaluations."""
NEWTON_STEPS, NEAR_RAD = 4, 0.01
"""Most steps to a zero, and the step, rad, from which it is near enough."""


@dataclass(frozen=True)
class Gap:
    """A border between two segments.

    Attributes:
        time_s: Last sample before it, s from the recording's start.
        length_s: To the first sample after it, s.
        beyond: (n,) change of the position less what the speeds on either side make of it, rad (m); 0 where the
            position is nearly the same: a zero that moved by just what the joint did is no likely one.
    """

    time_s: float
    length_s: float
    beyond: FloatArray


def impossible_steps(recording: Recording, arm: Arm) -> list[Finding]:
    """Steps of single joints, between two samples or over a gap, that their speed cannot have covered.

    Args:
        recording: Its columns in the arm's order.
        arm: For speed limits; a joint without one is judged within uninterrupted runs alone.
    """
    span, step = np.diff(recording.time), np.abs(np.diff(recording.position, axis=0))
    borders = np.array([part.stop - 1 for part in recording.segments[:-1]], dtype=int)
    # At a seam, where the clock was set, nobody knows how long it was.
    threshold = gap_threshold_s(recording.time)
    seams = borders[span[borders] <= threshold]
    within = np.ones(len(span), dtype=bool)
    within[borders] = False
    if not within.any():
        return []
    recorded = np.percentile(step[within], FASTEST_PERCENTILE, axis=0) / float(np.median(span))
    limit = np.array([joint.velocity_limit for joint in arm.joints])
    known = np.isfinite(limit) & (limit > 0)
    fastest = np.where(known, np.maximum(limit, recorded), UNLIMITED_FACTOR * recorded)
    # An interval may be wrong by as much as is no gap yet: messages are lost, and stamped together.
    most = np.maximum(fastest * (span + min(threshold, float(span.max())))[:, None], ZERO_SMALL)
    beyond = step > most
    beyond[seams] = False
    beyond[np.ix_(borders, ~known)] = False
    # What all joints do at once is the clock's doing.
    moves = np.ptp(recording.position, axis=0) > ZERO_SMALL
    together = within & (beyond.sum(axis=1) > max(1.0, 0.5 * float(moves.sum())))
    beyond[together] = False
    found = []
    for k in np.flatnonzero(beyond.any(axis=0)):
        places = np.flatnonzero(beyond[:, k])
        place = places[np.argmax(step[places, k])]
        found.append(_read_off(recording, int(k), int(place), len(places), float(fastest[k]), bool(known[k])))
    return found


def _read_off(recording: Recording, joint: int, place: int, count: int, fastest: float, known: bool) -> Finding:
    """The largest of a joint's steps, in words."""
    name, at = recording.joints[joint], float(recording.time[place])
    size = float(recording.position[place + 1, joint] - recording.position[place, joint])
    length = float(recording.time[place + 1]) - at
    speed = f"at most {fastest:.3g} a second {'by its limit' if known else 'where recorded otherwise'}"
    more = f", the largest of {count} such steps" if count > 1 else ""
    turns = size / (2.0 * np.pi)
    if round(turns) and abs(turns - round(turns)) < ZERO_SMALL:
        remedy = "publish positions that go on beyond a turn, and record again"
    else:
        remedy = _AGAIN
    return Finding(
        POSITION_JUMP,
        Level.UNFIT,
        (name,),
        f"the position of {name} jumps by {size:+.3f} rad within {length:.3g} s at {at:.3f} s{more}; "
        f"it moves by {speed}",
        remedy,
        values={"jump_rad": round(size, 6), "at_s": round(at, 4), "within_s": round(length, 6), "count": count},
    )


_AGAIN = (
    "an encoder may have lost its zero (a power-off, a drive that restarted): home the joint and record again, or cut "
    "the log there and use one of the pieces"
)
"""Remedy where positions have two zeros."""


def doubtful_gaps(recording: Recording) -> list[Gap]:
    """Gaps and seams over which a joint's position changed otherwise than by its speed on either side.

    Args:
        recording: Its columns in the arm's order.
    """
    gaps = []
    size = max(2, round(SIDE_S * recording.rate_hz))
    for before, after in zip(recording.segments, recording.segments[1:]):
        if min(before.stop - before.start, after.stop - after.start) < 2:
            continue
        speeds = []
        for rows in (slice(max(before.start, before.stop - size), before.stop), slice(after.start, after.start + size)):
            part, time = recording.position[rows], recording.time[rows]
            speeds.append((part[-1] - part[0]) / (time[-1] - time[0]))
        length = float(recording.time[after.start] - recording.time[before.stop - 1])
        step = recording.position[after.start] - recording.position[before.stop - 1]
        beyond = np.where(np.abs(step) > ZERO_SMALL, step - 0.5 * length * (speeds[0] + speeds[1]), 0.0)
        gap = Gap(float(recording.time[before.stop - 1]), length, beyond)
        if np.abs(gap.beyond).max() > ZERO_SMALL:
            gaps.append(gap)
    return gaps


def moved_zeros(scorer: Scorer, final: Scored, recording: Recording) -> tuple[list[Finding], list[str]]:
    """Joints whose zero is another one after a gap, by gravity and inertia; and what the data cannot tell of that.

    Args:
        scorer: Scores the recording.
        final: The best setup with one zero a joint.
        recording: Its columns in the arm's order.
    """
    findings: list[Finding] = []
    unknown: list[str] = []
    gaps = sorted(doubtful_gaps(recording), key=lambda gap: -float(np.abs(gap.beyond).max()))
    for gap in gaps[:MOST_GAPS]:
        found, open_ones = _over(scorer, final, gap, len(gaps))
        findings += found
        if open_ones:
            unknown.append(_whether(open_ones, f"the gap at {gap.time_s:.3f} s"))
    if len(gaps) > MOST_GAPS:
        unknown.append(f"whether encoder zeros are the same across the other {len(gaps) - MOST_GAPS} gaps")
    return findings, unknown


def _whether(joints: Sequence[str], where: str) -> str:
    return f"whether the encoder zero of {', '.join(joints)} is the same before and after {where}"


def _over(scorer: Scorer, final: Scored, gap: Gap, gaps: int) -> tuple[list[Finding], list[str]]:
    """One gap: joints whose zero it moved, the surest first; and those of which these data cannot tell."""
    arm, after = scorer.arm, scorer.rows.time > gap.time_s
    open_ones, asked = [], []
    for joint, one in enumerate(arm.joints):
        column = final.setup.position_from[joint]
        if not one.revolute or abs(gap.beyond[column]) < ZERO_SMALL:
            continue
        sides = (int(scorer.rows.moving[rows, column].sum()) for rows in (after, ~after))
        if min(sides) > OWN and zero_error(scorer, final, joint, after) <= ZERO_UNKNOWN:
            asked.append(joint)
        elif zero_error(scorer, final, joint) <= ZERO_UNKNOWN:
            # Where all rows together tell no zero, that is said already.
            open_ones.append(one.name)
    findings: list[Finding] = []
    score = final.score
    while asked:
        ways = [(*_best_shift(scorer, final, joint, after, gap, gaps), joint) for joint in asked]
        value, zero, mended, joint = max(ways, key=lambda way: way[0])
        if value - score <= scorer.sure or abs(zero) < ZERO_SMALL:
            break
        findings.append(_inferred(scorer, joint, -zero, value - score, gap))
        scorer, score = mended, value
        asked.remove(joint)
    return findings, open_ones


def _best_shift(
    scorer: Scorer, final: Scored, joint: int, after: BoolArray, gap: Gap, gaps: int
) -> tuple[float, float, Scorer]:
    """Score, zero (rad) and scorer of a joint's best zero after a gap: from none, and as if it had stood still."""
    # A zero for the whole recording is what the search took for that of one of its parts.
    changes = tuple(one for one in final.changes if one.kind is not Kind.ENCODER_ZERO or one.joints != (joint,))
    setup = Setup.as_recorded(scorer.arm)
    for change in changes:
        setup = change.on(setup)
    column, scale = setup.position_from[joint], setup.position_scale[joint]
    tried = []
    start = scorer.score(changes, setup)
    firsts = (zero_step(scorer, start, joint, 0.0, after)[0], -float(gap.beyond[column] * scale))
    for first in firsts:
        zero = float(np.clip(first, -np.pi, np.pi))
        for _ in range(NEWTON_STEPS):
            mended = _shifted(scorer, after, int(column), zero / scale)
            here = mended.score(changes, setup)
            prior = zero_prior(zero, len(scorer.arm.joints)) - float(np.log(gaps))
            tried.append((here.score + prior, zero, mended))
            step = float(np.clip(zero_step(mended, here, joint, zero, after)[0], -0.4, 0.4))
            if abs(step) < NEAR_RAD:
                break
            zero = float(np.clip(zero + step, -np.pi, np.pi))
    return max(tried, key=lambda way: way[0])


def _shifted(scorer: Scorer, rows: BoolArray, column: int, by: float) -> Scorer:
    """The same, with a recorded column's positions shifted in some rows."""
    position = scorer.rows.position.copy()
    position[rows, column] += by
    other = copy(scorer)
    other.rows, other._designs = replace(scorer.rows, position=position), []
    return other


def _inferred(scorer: Scorer, joint: int, moved: float, log_odds: float, gap: Gap) -> Finding:
    name = scorer.arm.joint_names[joint]
    return Finding(
        POSITION_JUMP,
        Level.UNFIT if abs(moved) > ZERO_LARGE else Level.NOTE,
        (name,),
        f"the encoder zero of {name} is another one after the gap of {gap.length_s:.3g} s at {gap.time_s:.3f} s: its "
        f"positions are {moved:+.3f} rad ({np.rad2deg(moved):+.1f}°) off those before",
        _AGAIN,
        probability=float(expit(log_odds)),
        log_odds=log_odds,
        values={"jump_rad": round(moved, 4), "at_s": round(gap.time_s, 4), "within_s": round(gap.length_s, 6)},
    )
