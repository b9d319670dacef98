"""`choose`: which of the candidates that no criterion rejects is accepted.

`is_outdone`: whether commoner effects explain as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

from .candidate import refit
from .current_model import CurrentModel
from .scored import RARER, TEMPER, TEMPER_SHARE, Scored, freedom, penalty

NAMED_SHARE, NAMED_PAIR = 0.8, 0.9
"""A named effect stands if it explains this share of what the best generic rival does, or two of them this share."""
ENDED_SHARE = 0.003
"""Of the score: so far apart two searches of the same optimum may end."""


def choose(ranked: Sequence[Scored], current: CurrentModel) -> Scored | None:
    """The winner of candidates that are not rejected, best first; None below the gate.

    The best named effect, unless a generic rival explains clearly more: than it, and than it with a second named
    one, for two effects at one joint look like one dependence that neither has.

    Args:
        ranked: Candidates that no criterion rejects, of one round, best first.
        current: What they are beside.
    """
    above = [s for s in ranked if s.score > current.gate and s.plausible]
    named = [s for s in above if s.named]
    generic = next((s for s in above if not s.named), None)
    if named:
        first = simplest(named)
        named = [first, *(s for s in named if s is not first)]
    if generic is None or not named:
        return named[0] if named else generic
    if generic.score <= named[0].score:
        return named[0]
    enough = NAMED_SHARE * (generic.gain + generic.held_out)
    if named[0].gain + named[0].held_out >= enough:
        return named[0]
    before = refit(current.accepted)
    held_out_before = current.squares_on_held_out(current.accepted, before.values)
    for one, other in combinations([s for s in named if s.candidate.effect.joints == generic.joints][:6], 2):
        both = [*current.accepted, one.candidate, other.candidate]
        together = refit(both)
        gain = together.gain - before.gain + held_out_before - current.squares_on_held_out(both, together.values)
        if gain > NAMED_PAIR * (generic.gain + generic.held_out):
            return one
    return generic


def simplest(ranked: Sequence[Scored]) -> Scored:
    """The best, or one with less freedom that is as good as far as scores can tell; of equal freedom, the least rare.

    Of touches, the one on the innermost link: any further joint would feel it (De Luca and Mattone 2005).
    """
    first = min(_near(ranked, TEMPER_SHARE), key=_plainness)
    if first.candidate.effect.exact:
        first = min(_near(ranked, 0.0), key=_plainness)
    if not first.candidate.effect.event:
        return first
    # Of one law: only where the search of their constants ended sets them apart.
    same = [s for s in _near(ranked, ENDED_SHARE) if s.candidate.effect.kind == first.candidate.effect.kind] or [first]
    return min(same, key=lambda s: s.candidate.stacked.stop)


def _near(ranked: Sequence[Scored], share: float) -> list[Scored]:
    """Those as good as the best, to a share of its score."""
    best = ranked[0].score
    return [s for s in ranked if best - s.score < TEMPER + share * best]


def _plainness(scored: Scored) -> tuple[int, int]:
    return freedom(scored.candidate.effect), scored.candidate.effect.rarity


def is_outdone(scored: Scored, ranked: Sequence[Scored], current: CurrentModel) -> bool:
    """Whether the commoner effects that an effect may be mistaken for, at all its joints together, explain as much.

    An effect of several joints is ranked beside effects of one, which explain less of the whole; and what changed a
    little at each joint passes for one cause where no joint by itself is above the gate. As much is as far as scores
    tell, what their freedom costs is in them, and base rates (`RARER`).

    Args:
        scored: The effect; `imitated_by` is the kind that is compared with it.
        ranked: Candidates of the same round, best first, rejected ones too.
        current: What they are beside.
    """
    effect = scored.candidate.effect
    if not effect.imitated_by:
        return False
    best: dict[tuple[str, ...], Scored] = {}
    for one in ranked:
        if one.candidate.effect.kind == effect.imitated_by and set(one.joints) <= set(effect.joints):
            best.setdefault(one.candidate.effect.joints, one)
    alone = [one.candidate for one in best.values() if one.plausible and one.score > 0.0]
    before, all_of_them = refit(current.accepted), [*current.accepted, *alone]
    after = refit(all_of_them)
    score = after.gain - before.gain - sum(penalty(one.effect, current.evidence.rows) for one in alone)
    score += current.squares_on_held_out(current.accepted, before.values)
    score -= current.squares_on_held_out(all_of_them, after.values)
    # The share is doubt of the score itself, whatever is commoner. Multiplied as well it would exceed the gate at large
    # scores, and what the commoner effects leave would be found beside them without a name.
    return bool(alone) and score > scored.score - math.log(RARER) * TEMPER - TEMPER_SHARE * scored.score
