"""Which conventions explain a recording best: every `Change` against none, then what is left, until nothing gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..forks import each
from .change import PHYSICAL, TORQUE_SCALES, Change, Kind, discrete_changes
from .evidence import CAD_SCALES, GAIN_SD
from .physical import physical
from .scorer import SCREEN_ITERATIONS, Scored, Scorer, loaded_joints
from .setup import Setup
from .values import delays, refined_gravity, tilted, tilts, zeros

SUSPECTED = 0.5
"""Share of those log odds from which a change is mentioned."""
LEAST_MOTION_RAD = 0.05
"""Motion, rad, of which degrees can be told: of 3 degrees gravity's torque changes by a twentieth, less than CAD is off
by, and nobody records so little. Numbers that are in degrees range over tens."""
SHORT_LIST, LONG_LIST = 6, 24
"""Changes that get a second look at least, and at most: all that the first look cannot surely tell from the best."""
MOST_CHANGES = 4
"""Mistakes looked for at once."""


@dataclass(frozen=True)
class Step:
    """One round of the search.

    Attributes:
        before: What it started from.
        after: The best that was found.
        rivals: Other single changes that came close, the best first.
        screened: The rest, after a first look only.
    """

    before: Scored
    after: Scored
    rivals: tuple[Scored, ...]
    screened: tuple[Scored, ...] = ()

    @property
    def gain(self) -> float:
        """Log odds of the change against none; of a factor on the torque against what looks like one as well."""
        against = [self.before.score]
        if self.after.changes and self.after.changes[-1].kind in TORQUE_SCALES:
            against += [one.score for one in self.rivals if one.changes[-1].kind in PHYSICAL]
        return self.after.score - max(against)


def search(scorer: Scorer) -> list[Step]:
    """Rounds of `compete` until nothing is sure of a gain; the last one is the round that gained nothing."""
    steps = [compete(scorer, scorer.score((), Setup.as_recorded(scorer.arm)))]
    while steps[-1].gain > scorer.sure and len(steps) <= MOST_CHANGES:
        last = steps[-1]
        again = (*last.rivals, *last.screened) if last.after.changes[-1].kind is Kind.DELAY else None
        steps.append(compete(scorer, scorer.score(last.after.changes, last.after.setup), again))
    return steps


def compete(scorer: Scorer, start: Scored, again: Sequence[Scored] | None = None) -> Step:
    """The best single change of a setup, and those that came close.

    Args:
        scorer: Scores.
        start: The setup.
        again: Changes that were tried beside a delay that `start` has now: only the best of them are tried.
    """
    if again is None:
        scale = (min(start.evidence.scale, CAD_SCALES[-2]),)
        tried = []
        few = scorer.screen()
        for change in discrete_changes(scorer.arm):
            if is_testable(scorer, start, change):
                tried.append(few.score((*start.changes, change), change.on(start.setup), scale, SCREEN_ITERATIONS))
        tried += zeros(few, start)
        tried += delays(scorer, start)
        tried += tilts(scorer, start)
    else:
        changes = [one.changes[-1] for one in again if one.changes[-1].kind is not Kind.DELAY]
        tried = [replace(start, changes=(*start.changes, one), setup=one.on(start.setup)) for one in changes]
    close = SHORT_LIST
    if again is None:
        tried.sort(key=lambda one: -one.score)
        close = int(np.clip(sum(one.score > tried[0].score - scorer.sure for one in tried), SHORT_LIST, LONG_LIST))
    chosen = [one for k, one in enumerate(tried) if k < close or one.changes[-1].kind in _SECOND_LOOK]
    short = each(lambda one: judged(scorer, start, one), chosen)
    short = [one for one in short if _is_off(start, one)]
    short = _apart(sorted(short, key=lambda one: -one.score))
    best = short[0] if short and short[0].score > start.score else start
    if best.changes and best.changes[-1].kind in TORQUE_SCALES and best is not start:
        causes, together = physical(scorer, start)
        if together > best.score:
            # Each by itself may explain less than a factor does; the other comes in the next round.
            short = [one for one in short if one.changes[-1].kind not in TORQUE_SCALES]
            best = max(causes, key=lambda one: one.score)
            short = [*causes, *short]
        else:
            short = sorted([*causes, *short], key=lambda one: -one.score)
            best = short[0]
    # Beside a delay the others were not scored again.
    rest = [one for one in tried if all(one is not other for other in chosen)] if again is None else []
    return Step(start, best, tuple(one for one in short if one is not best), tuple(rest))


_SECOND_LOOK = (*TORQUE_SCALES, Kind.GRAVITY)
"""What masses add up to, and the direction of gravity, are looked at there only."""


def judged(scorer: Scorer, start: Scored, one: Scored) -> Scored:
    """A change, scored on all rows and CAD scales.

    One that takes torque to another motion on the rows in which all its joints move: elsewhere it would explain other
    data than `start`, and of such hypotheses the likelihoods do not compare.

    Args:
        scorer: Scores, on all rows.
        start: The setup without the change.
        one: The setup with the change, which is the last of its `changes`.
    """
    change = one.changes[-1]
    if change.kind not in (Kind.POSITIONS_EXCHANGED, Kind.EFFORTS_EXCHANGED):
        return refined_gravity(scorer, scorer.score(one.changes, one.setup))
    both = scorer.where_all_move(start.setup.position_from[list(change.joints)])
    whole = both.score(one.changes, one.setup)
    return replace(whole, score=start.score + whole.score - both.score(start.changes, start.setup).score)


def _is_off(start: Scored, one: Scored) -> bool:
    """Whether a gain that was set free, or gravity, went further than they ordinarily are off."""
    change = one.changes[-1]
    if change.kind is Kind.EFFORT_GAIN:
        return bool(abs(np.log(one.evidence.gains[change.joints[0]])) > 2.0 * GAIN_SD)
    if change.kind is Kind.GRAVITY:
        return tilted(start.setup.gravity, np.array(change.value))
    return True


def _apart(found: Sequence[Scored]) -> list[Scored]:
    """The same, the best first, without directions of gravity that the search led to a better one's."""
    kept: list[Scored] = []
    for one in found:
        last = one.changes[-1]
        known = [np.array(other.changes[-1].value) for other in kept if other.changes[-1].kind is Kind.GRAVITY]
        if last.kind is not Kind.GRAVITY or all(tilted(other, np.array(last.value)) for other in known):
            kept.append(one)
    return kept


def is_testable(scorer: Scorer, start: Scored, change: Change) -> bool:
    """Whether a change is one that this arm and these data can be asked about.

    A gain needs CAD inertials, and a single joint's a large gravity torque; a joint without torque says
    nothing about its sign, gain or place.

    Args:
        scorer: Scores, with the arm, its CAD inertials and the joints that move or show torque.
        start: The scored setup that the change would be made to.
        change: The hypothesis.
    """
    if change.kind in TORQUE_SCALES:
        if scorer.frame.rough:
            return False
        return len(change.joints) != 1 or change.joints[0] in loaded_joints(scorer, start)
    own, silent = set(change.joints), scorer.silent(start.setup)
    if change.kind is Kind.DEGREES:
        if any(one.kind is Kind.DEGREES and own & set(one.joints) for one in start.changes):
            return False
        # A position that is 57 times smaller takes the motion out of all torques; where CAD or a current is wrong that
        # explains more than the motion does.
        columns = start.setup.position_from[list(change.joints)]
        moved = np.radians(scorer.ranges.high[columns] - scorer.ranges.low[columns])
        return bool(moved.max() > LEAST_MOTION_RAD) and (len(own) > 1 or columns[0] not in scorer.idle)
    if change.kind is Kind.JOINTS_EXCHANGED:
        # Torque stays with its motion.
        return not own <= silent and not own & scorer.dead
    return not own & silent
