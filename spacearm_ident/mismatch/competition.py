"""The competition: which effects explain what the base model leaves over.

Every effect at every place is fitted together with the base (and with what was accepted before); constants are
searched over their grids, the best refined. An effect's score is its drop in chi-square on the field, plus its drop on
held-out recordings, less a penalty for its freedom. The best joins, earlier ones are tried again without,
and so on until nothing scores above the gate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.effect import Effect
from ..dynamics.model import in_own_units
from ..forks import each
from .candidate import Candidate, with_own
from .constants import Method, grid_points, polish, recorded_span, refine, search
from .evidence import Evidence
from .finding import Happened
from .happened import happened, without
from .held_out import HeldOut
from .joint_refit import Refit, inner_each, refit, refit_each
from .residuals import unwhitened
from .rivals import UNKNOWN, Rival, rivals
from .scene import Scene
from .scored import Scored, feels, is_dominated, is_not_excited, penalty, plausible, simplest, throughout
from .stacked import base_columns

GATE = 60.0
"""Score an effect must have. The largest on healthy arms is what sets it (bench/concealed.py)."""
REFINED, RIVALS = 12, 6
"""So many named effects, and generic rivals, that explain most of the field are refined and judged on held-out data; so
are as many of the others, with held-out data the best of them: a dozen forms of one law at another joint, where nothing
changed but the motion, may explain more of the field and foretell nothing."""
NAMED_SHARE, NAMED_PAIR = 0.8, 0.9
"""A named effect stands if it explains this share of what the best generic rival does, or two of them this share."""
SHARED = 0.3
"""An effect that explains this share as much in the reference, row for row, was there before; so was one that explains
this share of what it does in the field with the parameters that the reference shows, where that excites it less."""
MINOR_SHARE = 0.01
"""Beside a large effect at the same joints, less than this share of it is more likely the large one's own law being
a little different than a second physics: it is left unexplained, not named."""
MINOR_UNKNOWN = 0.05
"""The same for a dependence without a name, which has the freedom to follow any such difference."""
SEEN_AGAIN = 0.1
"""Share of its drop on the fitted rows that an effect must show, row for row, on held-out ones. A large named one need
not be excited there (`scored.is_not_excited`)."""
CLEARS_UP = 0.5
"""Share of its joints' residual in the field that an effect must explain if the held-out data do not excite it, or
excite it so little that a healthy arm may leave as much."""
NAMES_ENOUGH = 0.2
"""A named effect that explains less than this share of its joints' residual is a coincidence, not an explanation."""
POLISHED = 2.0
"""An event is searched finely from this share's inverse of the best score on; what is further behind waits for its
round. In 74 such searches of two blind trials the score grew by 6 % (median), 76 % at most."""
LASTS = 0.5
"""An effect must score this share of the gate without its best moments: what shows in one alone is an accident."""
MOVES = 0.1
"""What was accepted takes other constants if it scores this share of the gate more with them, 2.4 standard errors of
one: every effect's inner products with it are computed again then."""
RELINEARISED = 6
"""Times that what depends on its own parameters is fitted around them: each leaves mu / (1 - mu) of the error."""
MOST = 8
"""Effects in one arm; more is a wrong base model."""
MOST_ROUNDS = 16
"""Effects and single events in all: a robot that picks up parts does it again and again."""


@dataclass(frozen=True)
class Round:
    """One accepted effect, and who else was near."""

    winner: Scored
    others: tuple[Scored, ...]


@dataclass(frozen=True)
class Outcome:
    """What the competition ended with.

    Attributes:
        rounds: Accepted effects, in the order of their acceptance, with their competitors as they were then.
        accepted: The same effects beside the base as it ended.
        refit: All of them fitted together.
        common: Effects that the reference shows as well: what the base model always lacked.
        left: The best of anything beyond them.
        left_values: Its parameters and constants.
    """

    rounds: tuple[Round, ...]
    accepted: tuple[Candidate, ...]
    refit: Refit
    common: tuple[Scored, ...]
    left: Scored | None
    left_values: FloatArray


class Competition:
    """Candidates, and what was accepted so far."""

    def __init__(
        self, evidence: Evidence, held_out: HeldOut | None, excluded: Sequence[str] = (), gate: float = GATE
    ) -> None:
        self.evidence = evidence
        self.gate = gate
        self.accepted: list[Candidate] = []
        base = evidence.base
        self._coulomb = {p.joint: float(v) for p, v in zip(base.model.parameters, base.parameters) if p.symbol == "f_c"}
        scenes = [evidence.field, *([held_out.scene] if held_out else [])]
        evidence.fit_reversals(scenes)
        if evidence.reference is not None:
            thin, _ = evidence.in_vacuum
            for scene in scenes:
                scene.set_high_orders(thin)
        self._pool = list(self._candidates(excluded))
        self._grids: dict[int, list[Candidate]] = {}
        self._inner: dict[tuple[int, int], tuple[Candidate, Sequence[Candidate], FloatArray]] = {}
        self._rounds: list[Round] = []
        self.common: list[Scored] = []
        self.happened: list[Happened] = []
        self._judge_on(held_out)

    def _candidates(self, excluded: Sequence[str]) -> Iterator[Effect]:
        arm = self.evidence.base.model.arm
        warm, compared = self.evidence.field.temperatures_known, self.evidence.reference is not None
        for kind, effect in EFFECTS.items():
            if kind in excluded:
                continue
            for place in effect.variants(arm):
                term = in_own_units(effect.at(arm, place).over(arm, self.evidence.field.motions), arm)
                if (warm or not term.needs_temperature) and (compared or not term.needs_reference):
                    yield from self._in_each_recording(term)
        for place in rivals(self.evidence.field.motions):
            yield from self._in_each_recording(Rival.at(arm, place))

    def _in_each_recording(self, effect: Effect) -> Iterator[Effect]:
        """An event for each recording of the field, for it need not happen in another, or not then."""
        if not effect.event:
            yield effect
            return
        for recording in sorted({motion.source for motion in self.evidence.field.motions}):
            yield replace(effect, place={**effect.place, "recording": recording})

    def run(self, progress: Callable[[float, str], None]) -> Outcome:
        """Until nothing more scores; from what is accepted already, where it ran before."""
        rounds = self._rounds
        left = None
        left_values = np.zeros(0)
        dropped = 0
        while self._causes(rounds) + len(self.common) + dropped < MOST and len(rounds) < MOST_ROUNDS:
            progress(len(rounds) / MOST, f"comparing effects, round {len(rounds) + 1}")
            ranked = self._ranked()
            stands = [self._stands(scored) for scored in ranked]
            refused = [scored for scored, good in zip(ranked, stands) if not good]
            sound = [scored for scored, good in zip(ranked, stands) if good]
            winner = self._choose([s for s in sound if not is_dominated(s, refused, self._acts_on(s))])
            if winner is None:
                left = ranked[0] if ranked else None
                left_values = self._values_of(left) if left else left_values
                break
            if self._was_there_before(winner):
                if not self._take_into_base(winner):
                    dropped += 1
                    self._drop(winner.candidate.effect)
                continue
            winner = self._polished(winner)
            self.accepted.append(winner.candidate)
            self._search_again()
            self._relinearise()
            self._renew_pool(winner.candidate.effect)
            if winner.candidate.effect.event:
                self._leave_out_events()
            rounds.append(Round(winner, tuple(s for s in ranked if s is not winner)))
            rounds = self._without_the_idle(rounds)
            if self._is_excluded(winner.candidate.effect):
                self.accepted.pop()
                rounds.pop()
                dropped += 1
        self._rounds = rounds = self._with_possible_values(rounds)
        return Outcome(
            tuple(rounds),
            tuple(self.accepted),
            refit(self.accepted),
            tuple(self.common),
            left,
            left_values,
        )

    def _search_again(self) -> None:
        """Constants of what was accepted before, beside what has joined: what was not known then is in them.

        A ripple found beside an unknown push was 2 % off, and a second one beside it made up for that.
        """
        numbers = [k for k, one in enumerate(self.accepted[:-1]) if one.effect.constants and not one.effect.event]
        for number, moved in zip(numbers, each(self._searched, numbers)):
            # Beside what the others have become as well.
            others = self._all_but(number)
            beside, one = refit(others), self.accepted[number]
            if moved and self._gain(moved, beside, others) - self._gain(one, beside, others) > MOVES * self.gate:
                self.accepted[number] = replace(moved, effect=one.effect)

    def _searched(self, number: int) -> Candidate | None:
        """An accepted effect with its constants searched again beside the others; None where none are better."""
        one, others = self.accepted[number], self._all_but(number)
        beside = refit(others)

        def gain(trial: Candidate) -> float:
            return self._gain(trial, beside, others)

        grid = self._grids.get(id(one.effect))
        best = one
        if grid:
            far, place, _ = self._best_of(grid, beside, others)
            best = grid[place] if far > gain(one) else one
        moved = search(refine, best, self.evidence, gain)
        return None if moved is one else moved

    def _all_but(self, number: int) -> list[Candidate]:
        """What is accepted but for one."""
        return [candidate for k, candidate in enumerate(self.accepted) if k != number]

    def _relinearise(self) -> None:
        """Accepted effects whose columns depend on their own parameters, around the values that they now have."""
        for _ in range(RELINEARISED):
            own = with_own(self.accepted, refit(self.accepted).values)
            moved = [(one, one.effect.around(tuple(values.tolist()))) for one, values in own]
            if all(effect is one.effect for one, effect in moved):
                return
            self.accepted = [
                one if effect is one.effect else self.evidence.candidate(effect, one.constants) for one, effect in moved
            ]

    def _with_possible_values(self, rounds: Sequence[Round]) -> list[Round]:
        """Rounds whose winners have values that their physics has beside all others too, not only when they were taken.

        In the place of one that has not comes the simplest other of its joints that has; where there is none it goes.
        """
        kept = list(rounds)
        for number in reversed(range(len(kept))):
            if self._is_possible(number):
                continue
            effect = self.accepted[number].effect
            others = self._all_but(number)
            beside = refit(others)
            held_out_before = self._on_held_out(others, beside.values)
            accepted, self.accepted = self.accepted, others
            again = [
                self._scored(self._renewed(one.candidate), beside, held_out_before)
                for one in kept[number].others
                if one.named and one.joints == effect.joints
            ]
            self.accepted = accepted
            sound = sorted((s for s in again if s.plausible and s.score > self.gate), key=lambda s: -s.score)
            if sound:
                winner = simplest(sound)
                self.accepted[number] = winner.candidate
                kept[number] = Round(winner, tuple(s for s in sound if s is not winner))
            else:
                del self.accepted[number], kept[number]
        return kept

    def _is_possible(self, number: int) -> bool:
        """Whether one accepted effect has values that its physics has, fitted with all others."""
        candidate, own = [*with_own(self.accepted, refit(self.accepted).values)][number]
        return self._is_plausible(candidate, own)

    def _leave_out_events(self) -> None:
        """Judge nothing on held-out rows during an event like one that was found."""
        if self._with_events is not None:
            values = refit(self.accepted).values
            self.happened = happened(self._with_events, self.accepted, values, self.gate)
            self._judge_on(self._with_events)

    def _judge_on(self, held_out: HeldOut | None) -> None:
        """Judge on held-out recordings, less the events in them."""
        self._with_events = held_out
        self.held_out = held_out and without(held_out, self.happened)

    def _causes(self, rounds: Sequence[Round]) -> int:
        """How many effects there are; the same event in several recordings counts once."""
        effects = [one.winner.candidate.effect for one in rounds]
        return len({effect.kind if effect.event and effect.one_cause else id(effect) for effect in effects})

    def reweigh(self, evidence: Evidence, held_out: HeldOut | None) -> None:
        """Go on with the same rows under other weights of the joints."""
        before, self.evidence = self.evidence, evidence
        self._judge_on(held_out)
        self.accepted = [evidence.reweighted([candidate], before)[0] for candidate in self.accepted]
        self._inner.clear()
        # One after the other: all of them twice would be most of the memory that a search takes.
        for key, grid in self._grids.items():
            self._grids[key] = evidence.reweighted(grid, before) if grid else []

    def end(self) -> None:
        """Search no more: forget the columns that only a further search would ask for."""
        asked = {id(effect) for effect in self._named_lasting()}
        self._grids = {key: grid for key, grid in self._grids.items() if key in asked}
        self._inner.clear()

    def tried(self) -> Iterator[list[Candidate]]:
        """Named lasting effects that are not accepted, each at the points of its constants' grids."""
        for effect in self._named_lasting():
            yield self._grids.get(id(effect)) or self._at_every_point(effect)

    def _named_lasting(self) -> Iterator[Effect]:
        """What is in the pool but unknown causes and events in time."""
        return (effect for effect in self._pool if effect.kind != UNKNOWN and not effect.event)

    def _choose(self, ranked: Sequence[Scored]) -> Scored | None:
        """The winner; None below the gate.

        The best named effect, unless a generic rival explains clearly more: than it, and than it with a second named
        one, for two effects at one joint look like one dependence that neither has.
        """
        above = [s for s in ranked if s.score > self.gate and s.plausible]
        named = [s for s in above if s.named]
        generic = next((s for s in above if not s.named), None)
        if named:
            first = self._joint_by_joint(simplest(named), named)
            named = [first, *(s for s in named if s is not first)]
        if generic is None or not named:
            return named[0] if named else generic
        if generic.score <= named[0].score:
            return named[0]
        enough = NAMED_SHARE * (generic.gain + generic.held_out)
        if named[0].gain + named[0].held_out >= enough:
            return named[0]
        before = refit(self.accepted)
        held_out_before = _squares(self._on_held_out(self.accepted, before.values))
        for one, other in combinations([s for s in named if s.candidate.effect.joints == generic.joints][:6], 2):
            both = [*self.accepted, one.candidate, other.candidate]
            together = refit(both)
            gain = together.gain - before.gain + held_out_before - _squares(self._on_held_out(both, together.values))
            if gain > NAMED_PAIR * (generic.gain + generic.held_out):
                return one
        return generic

    def _joint_by_joint(self, first: Scored, named: Sequence[Scored]) -> Scored:
        """The first, or what explains as much of its joints one by one: the best of these then.

        An effect of several joints is ranked beside effects of one, which explain less of the whole.
        """
        effect = first.candidate.effect
        if not effect.imitated_by or len(effect.joints) < 2:
            return first
        best: dict[tuple[str, ...], Scored] = {}
        for one in named:
            if one.candidate.effect.kind == effect.imitated_by and set(one.joints) <= set(effect.joints):
                best.setdefault(one.candidate.effect.joints, one)
        alone = [one.candidate for one in best.values()]
        before, all_of_them = refit(self.accepted), [*self.accepted, *alone]
        after = refit(all_of_them)
        score = after.gain - before.gain - sum(penalty(one.effect, self.evidence.rows) for one in alone)
        if self.held_out is not None:
            score += _squares(self._on_held_out(self.accepted, before.values))
            score -= _squares(self._on_held_out(all_of_them, after.values))
        return max(best.values(), key=lambda one: one.score) if best and score > first.score else first

    def _values_of(self, scored: Scored) -> FloatArray:
        """Parameters and constants of a candidate beside what is accepted."""
        count = len(scored.candidate.effect.parameters)
        values = refit([*self.accepted, scored.candidate]).values[-count:]
        return np.concatenate([values, scored.candidate.constants])

    def _acts_on(self, scored: Scored) -> Set[str]:
        """Names of the joints where an effect acts; of an event, of those that feel it."""
        if not scored.candidate.effect.event:
            return set(scored.joints)
        felt = feels(self._energy([scored.candidate], self._values_of(scored)))
        return {name for name, feeling in zip(self.evidence.base.model.arm.joint_names, felt) if feeling}

    def _stands(self, scored: Scored) -> bool:
        """Whether an effect is in the field by itself, explains enough, acts on held-out rows and is not negligible."""
        if scored.gain < self.gate:
            return False
        if scored.score > self.gate and not (self._lasts(scored) and self._is_at_each(scored)):
            return False
        values = self._values_of(scored)
        mine = self._energy([scored.candidate], values)
        felt = feels(mine)
        share = scored.gain / max(float(self._excess(scored.candidate.effect)[felt].sum()), 1e-9)
        if scored.named and share < NAMES_ENOUGH:
            return False
        lasting = not scored.candidate.effect.event
        if not lasting and not scored.named and self._is_within_another(scored.candidate):
            return False
        if self.held_out is not None and lasting:
            again = scored.held_out / len(self.held_out.scene) / (scored.gain / self.evidence.rows)
            not_excited = scored.named and share > CLEARS_UP and scored.not_excited
            if again < SEEN_AGAIN and not not_excited:
                return False
        if not self.accepted:
            return True
        # An event is small beside what goes on while it lasts: there the larger effect's law is most in doubt. What
        # lasts is seen without any event, too.
        beside = [*with_own(self.accepted, refit(self.accepted).values)]
        beside = [one for one in beside if not (lasting and one[0].effect.event)]
        own = np.concatenate([np.zeros(0), *(values for _, values in beside)])
        large = self._energy([candidate for candidate, _ in beside], own, None if lasting else scored)
        minor = MINOR_SHARE if scored.named and lasting else MINOR_UNKNOWN
        # Joint by joint: what shows at all of them may be small beside another cause at one.
        return float(np.median(mine[felt] - minor * large[felt])) > 0.0

    def _is_within_another(self, event: Candidate) -> bool:
        """Whether most of an event is during an accepted one: that its law is not quite right is no second event."""
        begin, end = event.effect.window(event.constants)
        for other in self.accepted:
            if other.effect.event and other.effect.place.get("recording") == event.effect.place.get("recording"):
                first, last = other.effect.window(other.constants)
                if min(end, last) - max(begin, first) > 0.5 * (end - begin):
                    return True
        return False

    def _lasts(self, scored: Scored) -> bool:
        """Whether an effect has a score without the best moments of field and held-out rows, too; an event need not."""
        effect = scored.candidate.effect
        if effect.event:
            return True
        drop = sum(throughout(scene, before, after) for scene, before, after in self._left(scored))
        return drop - penalty(effect, self.evidence.rows) > LASTS * self.gate

    def _is_at_each(self, scored: Scored) -> bool:
        """Whether what is alike at several joints makes none so much worse that what undoes it would be a finding.

        A loose bolt at one joint is late torque there; one clock stamps them all.
        """
        if "joints" not in scored.candidate.effect.place:
            return True
        drops = [scene.by_joint(before**2 - after**2) for scene, before, after in self._left(scored)]
        return float(np.min(np.sum(drops, axis=0))) > -self.gate

    def _left(self, scored: Scored) -> Iterator[tuple[Scene, FloatArray, FloatArray]]:
        """Field and held-out rows: whitened residual beside what is accepted, and with one more."""
        both = [*self.accepted, scored.candidate]
        field = self.evidence.residual_beside
        yield self.evidence.field, field(self.accepted), field(both)
        if self.held_out is not None:
            before, after = (self._on_held_out(one, refit(one).values) for one in (self.accepted, both))
            yield self.held_out.scene, before, after

    def _excess(self, effect: Effect) -> FloatArray:
        """(n,) chi-square of each joint's field rows above what noise would leave, beside what is accepted.

        For an event, of the recording in which it is.
        """
        field = self.evidence.field
        above = self.evidence.residual_beside(self.accepted) ** 2 - 1.0
        here = np.array([not effect.elsewhere(motion) for motion in field.motions])
        return np.maximum(field.by_joint(np.where(here[field.owner], above, 0.0)), 0.0)

    def _energy(self, candidates: Sequence[Candidate], values: FloatArray, event: Scored | None = None) -> FloatArray:
        """(n,) sum of squares by joint of what effects add to the torque, in all rows or in those of an event."""
        torque = self.evidence.added(candidates, values)
        if event is not None:
            during = np.zeros(len(torque), dtype=bool)
            during[event.candidate.stacked.rows] = np.any(event.candidate.stacked.columns != 0.0, axis=1)
            torque = np.where(during, torque, 0.0)
        return self.evidence.field.by_joint(torque**2)

    def _renew_pool(self, effect: Effect) -> None:
        """What is accepted competes no more; a further one of its kind may."""
        self._drop(effect)
        arm = self.evidence.base.model.arm
        if again := effect.again(arm):
            again = in_own_units(again, arm)
            self._pool.append(again)
            if again == effect:
                self._grids[id(again)] = [replace(one, effect=again) for one in self._grids[id(effect)]]

    def _drop(self, effect: Effect) -> None:
        """An effect competes no more, nor do other forms of it."""
        self._pool = [other for other in self._pool if not effect.replaces(other)]

    def without(self, outcome: Outcome, dropped: Sequence[int]) -> Outcome:
        """An outcome less some of its effects, refitted."""
        kept = [k for k in range(len(outcome.accepted)) if k not in dropped]
        accepted = tuple(outcome.accepted[k] for k in kept)
        return replace(
            outcome,
            rounds=tuple(outcome.rounds[k] for k in kept),
            accepted=accepted,
            refit=refit(accepted),
        )

    def _was_there_before(self, winner: Scored) -> bool:
        """Whether the reference shows the same, so that it is no change but what the base model always lacked."""
        reference = self.evidence.reference
        if reference is None:
            return False
        effect, healthy = winner.candidate.effect, self.evidence.healthy
        alone = refit([healthy.candidate(effect, winner.candidate.constants)])
        gain = alone.gain - penalty(effect, len(reference))
        if gain <= 0.5 * self.gate:
            return False
        alike = gain / len(reference) > SHARED * winner.gain / self.evidence.rows
        return alike or self._gain_at(winner, alone.values) > SHARED * winner.gain

    def _gain_at(self, winner: Scored, values: FloatArray) -> float:
        """Drop in chi-square of an effect with given parameters (k,), beside what is accepted and the base refitted."""
        fitted = refit([*self.accepted, winner.candidate])
        off = values - fitted.values[-len(values) :]
        own = fitted.covariance[-len(values) :, -len(values) :]
        return winner.gain - float(off @ np.linalg.pinv(own, hermitian=True) @ off)

    def _with_shared(self, winner: Scored) -> Evidence:
        old = self.evidence
        shared = [*old.common, (winner.candidate.effect, winner.candidate.constants)]
        return Evidence(old.base, old.field, old.reference, shared)

    def _take_into_base(self, winner: Scored) -> bool:
        """Refit everything with an effect that reference and field share.

        Returns:
            False, and nothing changed, where the reference's torque at its joints is then fitted worse, every row
            counted alike: the effect has followed what is not its own.
        """
        old, new = self.evidence, self._with_shared(winner)
        acts = [name in self._acts_on(winner) for name in old.base.model.arm.joint_names]
        if _left_of_reference(new)[acts].sum() > _left_of_reference(old)[acts].sum():
            return False
        self.common.append(winner)
        self.evidence = new
        if self._with_events is not None:
            self._judge_on(HeldOut(self.evidence, self._with_events.scene))
        renew = self._renewed
        self.accepted = [renew(candidate) for candidate in self.accepted]
        self._grids = {key: [renew(c) for c in grid] for key, grid in self._grids.items()}
        self._inner.clear()
        return True

    def _renewed(self, candidate: Candidate) -> Candidate:
        return self.evidence.candidate(candidate.effect, candidate.constants, candidate.stacked)

    def _ranked(self) -> list[Scored]:
        """The best of every effect at every place, best first."""
        beside = refit(self.accepted)
        held_out_before = self._on_held_out(self.accepted, beside.values)
        rough = self._rough(beside)
        named = [one for one in rough if one[1].effect.kind != UNKNOWN]
        generic = [one for one in rough if one[1].effect.kind == UNKNOWN]
        shortlist = [
            candidate
            for one, count in ((named, REFINED), (generic, RIVALS))
            for candidate in self._shortlisted(one, count, beside, held_out_before)
        ]
        refined = self._all_searched(refine, shortlist, beside)
        scored = [self._scored(candidate, beside, held_out_before) for candidate in refined]
        largest = max((s.score for s in scored), default=0.0)
        # Which link was touched, only windows that fit well tell.
        touches = [s.named and s.candidate.effect.event and POLISHED * s.score > largest for s in scored]
        polished = iter(self._all_searched(polish, [s.candidate for s, touch in zip(scored, touches) if touch], beside))
        scored = [self._scored(next(polished), beside, held_out_before) if t else s for s, t in zip(scored, touches)]
        return sorted(scored, key=lambda s: -s.score)

    def _shortlisted(
        self, rough: Sequence[tuple[float, Candidate]], count: int, beside: Refit, held_out_before: FloatArray
    ) -> list[Candidate]:
        """So many that explain most of the field, and as many of the others, the best on held-out rows as well."""
        first = [candidate for _, candidate in rough[:count]]
        if self.held_out is None:
            return first
        # Nothing stands that does not explain as much as the gate of the field itself.
        others = [candidate for gain, candidate in rough[count:] if POLISHED * gain > self.gate]
        scores = each(lambda one: self._scored(one, beside, held_out_before).score, others)
        best = sorted(range(len(others)), key=lambda k: -scores[k])[:count]
        return [*first, *(others[k] for k in best if POLISHED * scores[k] > self.gate)]

    def _rough(self, beside: Refit) -> list[tuple[float, Candidate]]:
        """Every effect at every place at the best point of its grid, with its drop less its penalty, best first."""
        self._compute_grids()
        # Where none of its places was passed there is none to try.
        grids = [grid for effect in self._pool if (grid := self._grids[id(effect)])]
        found, scored = each(lambda grid: self._best_of(grid, beside, self.accepted), grids), []
        for grid, (gain, number, inner) in zip(grids, found):
            for one, own in zip(self.accepted, inner):
                # Kept with what they are of, so that no other can be at its address.
                self._inner[id(one), id(grid)] = one, grid, own
            scored.append((gain - penalty(grid[0].effect, self.evidence.rows), grid[number]))
        return sorted(scored, key=lambda one: -one[0])

    def _all_searched(self, method: Method, candidates: Sequence[Candidate], beside: Refit) -> list[Candidate]:
        """Candidates with better constants, if the method finds any, each beside what is accepted."""

        def better(candidate: Candidate) -> Candidate | None:
            found = search(method, candidate, self.evidence, lambda trial: self._gain(trial, beside, self.accepted))
            return None if found is candidate else found

        # The longest first: what is begun last the other processes wait for.
        order = sorted(candidates, key=lambda one: -one.stacked.kept.size * len(one.constants))
        found = dict(zip(map(id, order), each(better, order)))
        # What another process computed is of a copy of the effect.
        return [one if (other := found[id(one)]) is None else replace(other, effect=one.effect) for one in candidates]

    def _compute_grids(self) -> None:
        """Everything in the pool at every point of its constants' grids, computed once."""
        # What effects of a kind have in common is kept with the motions: one process computes it for all of them.
        alike: dict[object, list[Effect]] = {}
        for effect in self._pool:
            if id(effect) not in self._grids:
                alike.setdefault(id(effect) if effect.kind == UNKNOWN else effect.kind, []).append(effect)
        made = each(self._at_all_points, [*alike.values()])
        for effects, grids in zip(alike.values(), made):
            for effect, grid in zip(effects, grids):
                self._grids[id(effect)] = [replace(candidate, effect=effect) for candidate in grid]

    def _at_all_points(self, effects: Sequence[Effect]) -> list[list[Candidate]]:
        """Effects of one kind at every point of their constants' grids."""
        made = [self._at_every_point(effect) for effect in effects]
        for background in self.evidence.field.backgrounds:
            background.grids.clear()
        return made

    def _at_every_point(self, effect: Effect) -> list[Candidate]:
        """An effect at every point of its constants' grids."""
        return self.evidence.candidates(effect, grid_points(effect, self.evidence.field.motions))

    def _best_of(
        self, grid: Sequence[Candidate], beside: Refit, others: Sequence[Candidate]
    ) -> tuple[float, int, list[FloatArray]]:
        """The largest gain of an effect at the points of its grid, −∞ where no value is plausible, and at which it is.

        Inner products of every other with all of the points besides; computed once.
        """
        known = (self._inner.get((id(one), id(grid))) for one in others)
        inner = [inner_each(one, grid) if own is None else own[2] for one, own in zip(others, known)]
        values, gains = refit_each(others, grid, beside, inner)
        for k in np.argsort(-gains).tolist():
            if np.isfinite(gains[k]) and self._is_plausible(grid[k], values[k]):
                return float(gains[k] - beside.gain), k, inner
        return -np.inf, len(grid) - 1, inner

    def _gain(self, candidate: Candidate, beside: Refit, others: Sequence[Candidate]) -> float:
        """Drop in chi-square of a candidate beside others, which are fitted already."""
        together = refit([*others, candidate], beside)
        values = together.values[len(beside.values) :]
        gain = together.gain - beside.gain
        return gain if np.isfinite(gain) and self._is_plausible(candidate, values) else -np.inf

    def _polished(self, scored: Scored) -> Scored:
        """The winner with its constants searched together; a touch's once more, for a simplex may end where none is."""
        beside = refit(self.accepted)
        (candidate,) = self._all_searched(polish, [scored.candidate], beside)
        if candidate is scored.candidate:
            return scored
        return self._scored(candidate, beside, self._on_held_out(self.accepted, beside.values))

    def _scored(self, candidate: Candidate, beside: Refit, held_out_before: FloatArray) -> Scored:
        together = refit([*self.accepted, candidate], beside)
        gain = together.gain - beside.gain
        held_out_after = self._on_held_out([*self.accepted, candidate], together.values)
        # What happened in the field says nothing of other recordings, whatever the base becomes beside it. Of what has
        # no name nobody knows whether it did: it must not make them worse.
        happened_here = candidate.effect.event and candidate.effect.kind != UNKNOWN
        held_out = 0.0 if happened_here else _squares(held_out_before) - _squares(held_out_after)
        values = together.values[len(beside.values) :]
        score = gain + held_out - penalty(candidate.effect, self.evidence.rows)
        foretold, count = _squares(held_out_before - held_out_after), len(held_out_after)
        not_excited = is_not_excited(
            gain / self.evidence.rows, gain / self._rows_of(candidate, values), held_out, foretold, count
        )
        return Scored(candidate, gain, held_out, score, self._is_plausible(candidate, values), not_excited)

    def _is_plausible(self, candidate: Candidate, values: FloatArray) -> bool:
        """Whether its physics has such values, and an event ends or begins within the recordings that it is in."""
        effect = candidate.effect
        if effect.event:
            begin, end = effect.window(candidate.constants)
            first, last = recorded_span(effect, self.evidence.field.motions)
            if min(end, last) - max(begin, first) > effect.often * (last - first):
                return False
        return plausible(candidate, values, self._coulomb)

    def _rows_of(self, candidate: Candidate, values: FloatArray) -> int:
        """How many rows of the field feel an effect, at the joints that feel it most."""
        joint = self.evidence.field.joint[candidate.stacked.rows]
        acts = np.any(candidate.stacked.columns != 0.0, axis=1)
        return max(int(np.sum(acts & feels(self._energy([candidate], values))[joint])), 1)

    def _on_held_out(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(V,) whitened residual of the held-out rows with these effects; empty where there are none."""
        return np.zeros(0) if self.held_out is None else self.held_out.residual(candidates, values)

    def _without_the_idle(self, rounds: list[Round]) -> list[Round]:
        """Drop what later effects have made idle."""
        whole = refit(self.accepted).gain
        for k in range(len(rounds) - 1):
            others = self._all_but(k)
            lost = whole - refit(others).gain
            if lost - penalty(self.accepted[k].effect, self.evidence.rows) < 0.5 * self.gate:
                self.accepted = others
                return self._without_the_idle([r for number, r in enumerate(rounds) if number != k])
        return rounds

    def _is_excluded(self, last: Effect) -> bool:
        """Whether the effect that joined last has left in place one that an arm cannot have beside it."""
        return any(last.excludes(other.effect) for other in self.accepted[:-1])


def _left_of_reference(evidence: Evidence) -> FloatArray:
    """(n,) sum of squares that the base, with what it shares, leaves of the reference by joint, N²·m²."""
    assert evidence.reference is not None
    scene = unwhitened(evidence.base, evidence.reference)
    fitted = evidence.healthy.base_parameters([], np.zeros(0))
    return scene.by_joint((scene.torque() - base_columns(evidence.base, scene, evidence.common) @ fitted) ** 2)


def _squares(residual: FloatArray) -> float:
    return float(residual @ residual)
