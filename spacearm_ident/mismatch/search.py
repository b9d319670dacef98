"""`Search`: which effects compete, and the best that each can do beside the current model.

Every effect of the catalogue at every place it could act, and the generic rivals. All are compared at the points of
their constants' grids by their gain on the field; what explains most there, and what does with held-out data, is
refined between the points and scored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.effect import Effect
from ..dynamics.model import in_own_units
from ..forks import each
from .candidate import Candidate, Refit, inner_each, refit, refit_each
from .constants import Method, grid_points, polish, refine, search
from .current_model import CurrentModel
from .evidence import Evidence
from .rivals import UNKNOWN, Rival, rivals
from .scored import Scored, penalty

REFINED, RIVALS = 12, 6
"""So many named effects, and generic rivals, that explain most of the field are refined and judged on held-out data; so
are as many of the others, with held-out data the best of them: a dozen forms of one law at another joint, where nothing
changed but the motion, may explain more of the field and foretell nothing."""
POLISHED = 2.0
"""An event is searched finely from this share's inverse of the best score on; what is further behind waits for its
round. In 74 such searches of two blind trials the score grew by 6 % (median), 76 % at most."""


class Search:
    """A pool of effects, without some kinds; their grids, computed once, are known by the identity of the effect."""

    def __init__(self, current: CurrentModel, excluded: Sequence[str]) -> None:
        self._current = current
        self._pool = list(_competitors(current.evidence, excluded))
        self._grids: dict[int, list[Candidate]] = {}
        self._inner: dict[tuple[int, int], tuple[Candidate, Sequence[Candidate], FloatArray]] = {}

    def ranked(self) -> list[Scored]:
        """The best of every effect at every place, best first."""
        current = self._current
        beside = refit(current.accepted)
        held_out_before = current.on_held_out(current.accepted, beside.values)
        rough = self._rough(beside)
        named = [one for one in rough if one[1].effect.kind != UNKNOWN]
        generic = [one for one in rough if one[1].effect.kind == UNKNOWN]
        shortlist = [
            candidate
            for one, count in ((named, REFINED), (generic, RIVALS))
            for candidate in self._shortlisted(one, count, beside, held_out_before)
        ]
        shortlist += _imitators(shortlist, named)
        refined = self._all_searched(refine, shortlist, beside)
        scored = [current.scored(candidate, beside, held_out_before) for candidate in refined]
        largest = max((s.score for s in scored), default=0.0)
        # Which link was touched, only windows that fit well tell.
        touches = [s.named and s.candidate.effect.event and POLISHED * s.score > largest for s in scored]
        polished = iter(self._all_searched(polish, [s.candidate for s, touch in zip(scored, touches) if touch], beside))
        scored = [current.scored(next(polished), beside, held_out_before) if t else s for s, t in zip(scored, touches)]
        return sorted(scored, key=lambda s: -s.score)

    def polished(self, scored: Scored) -> Scored:
        """The winner with its constants searched together; a touch's once more, for a simplex may end where none is."""
        current = self._current
        beside = refit(current.accepted)
        (candidate,) = self._all_searched(polish, [scored.candidate], beside)
        if candidate is scored.candidate:
            return scored
        return current.scored(candidate, beside, current.on_held_out(current.accepted, beside.values))

    def again(self, number: int) -> Candidate | None:
        """An accepted effect with its constants searched again beside the others; None where none are better."""
        current = self._current
        one, others = current.accepted[number], current.all_but(number)
        beside = refit(others)

        def gain(trial: Candidate) -> float:
            return current.gain(trial, beside, others)

        grid = self._grids.get(id(one.effect))
        best = one
        if grid:
            far, place, _ = self._best_of(grid, beside, others)
            best = grid[place] if far > gain(one) else one
        moved = search(refine, best, current.evidence, gain)
        return None if moved is one else moved

    def drop(self, effect: Effect) -> None:
        """An effect competes no more, nor do other forms of it."""
        self._pool = [other for other in self._pool if not effect.replaces(other)]

    def accept(self, effect: Effect) -> None:
        """What is accepted competes no more; a further one of its kind may."""
        self.drop(effect)
        arm = self._current.evidence.base.model.arm
        if again := effect.again(arm):
            again = in_own_units(again, arm)
            self._pool.append(again)
            if again == effect:
                self._grids[id(again)] = [replace(one, effect=again) for one in self._grids[id(effect)]]

    def renew(self) -> None:
        """Go on with the same rows beside another base."""
        self._grids = {key: self._current.evidence.again(grid) for key, grid in self._grids.items()}
        self._inner.clear()

    def reweigh(self, before: Evidence) -> None:
        """Go on with the same rows under other weights than they had before."""
        self._inner.clear()
        # One after the other: all of them twice would be most of the memory that a search takes.
        for key, grid in self._grids.items():
            self._grids[key] = self._current.evidence.reweighted(grid, before) if grid else []

    def end(self) -> None:
        """Forget the columns that only a further search would ask for."""
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

    def _shortlisted(
        self, rough: Sequence[tuple[float, Candidate]], count: int, beside: Refit, held_out_before: FloatArray
    ) -> list[Candidate]:
        """So many that explain most of the field, and as many of the others, the best on held-out rows as well."""
        current = self._current
        first = [candidate for _, candidate in rough[:count]]
        if current.held_out is None:
            return first
        # Nothing stands that does not explain as much as the gate of the field itself.
        others = [candidate for gain, candidate in rough[count:] if POLISHED * gain > current.gate]
        scores = each(lambda one: current.scored(one, beside, held_out_before).score, others)
        best = sorted(range(len(others)), key=lambda k: -scores[k])[:count]
        return [*first, *(others[k] for k in best if POLISHED * scores[k] > current.gate)]

    def _rough(self, beside: Refit) -> list[tuple[float, Candidate]]:
        """Every effect at every place at the best point of its grid, with its drop less its penalty, best first."""
        self._compute_grids()
        accepted = self._current.accepted
        # Where none of its places was passed there is none to try.
        grids = [grid for effect in self._pool if (grid := self._grids[id(effect)])]
        found, scored = each(lambda grid: self._best_of(grid, beside, accepted), grids), []
        for grid, (gain, number, inner) in zip(grids, found):
            for one, own in zip(accepted, inner):
                # Kept with what they are of, so that no other can be at its address.
                self._inner[id(one), id(grid)] = one, grid, own
            scored.append((gain - penalty(grid[0].effect, self._current.evidence.rows), grid[number]))
        return sorted(scored, key=lambda one: -one[0])

    def _all_searched(self, method: Method, candidates: Sequence[Candidate], beside: Refit) -> list[Candidate]:
        """Candidates with better constants, if the method finds any, each beside what is accepted."""
        evidence, accepted = self._current.evidence, self._current.accepted

        def better(candidate: Candidate) -> Candidate | None:
            found = search(method, candidate, evidence, lambda trial: self._current.gain(trial, beside, accepted))
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
        for background in self._current.evidence.field.backgrounds:
            background.grids.clear()
        return made

    def _at_every_point(self, effect: Effect) -> list[Candidate]:
        """An effect at every point of its constants' grids."""
        evidence = self._current.evidence
        return evidence.candidates(effect, grid_points(effect, evidence.field.motions))

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
            if np.isfinite(gains[k]) and self._current.is_plausible(grid[k], values[k]):
                return float(gains[k] - beside.gain), k, inner
        return -np.inf, len(grid) - 1, inner


def _imitators(shortlist: Sequence[Candidate], named: Sequence[tuple[float, Candidate]]) -> list[Candidate]:
    """Of what imitates an effect of several joints on the shortlist, the best at each that is not there.

    The choice compares them all together with it; one alone may explain little of the whole.

    Args:
        shortlist: Candidates.
        named: Drop in chi-square less penalty, and candidate, of the named effects; the best first.
    """
    imitated = [one.effect for one in shortlist if one.effect.imitated_by]
    wanted = {(effect.imitated_by, (joint,)) for effect in imitated for joint in effect.joints}
    best: dict[object, Candidate] = {}
    for gain, candidate in named:
        where = candidate.effect.kind, candidate.effect.joints
        if where in wanted and np.isfinite(gain):
            best.setdefault(where, candidate)
    there = {id(one) for one in shortlist}
    return [candidate for candidate in best.values() if id(candidate) not in there]


def _competitors(evidence: Evidence, excluded: Sequence[str]) -> Iterator[Effect]:
    """Every effect that is not excluded and could show, at every place, and the generic rivals."""
    arm, field, reference = evidence.base.model.arm, evidence.field, evidence.reference
    warm, compared = field.warm_joints, reference is not None
    for kind, effect in EFFECTS.items():
        if kind in excluded:
            continue
        for place in effect.variants(arm):
            one = effect.at(arm, place).over(arm, field.motions)
            term = in_own_units(one if reference is None else one.since(reference.motions), arm)
            told = not term.needs_temperature or {one.joint for one in term.parameters} <= warm
            if told and (compared or not term.needs_reference):
                yield from _in_each_recording(term, evidence)
    for place in rivals(field.motions):
        yield from _in_each_recording(Rival.at(arm, place), evidence)


def _in_each_recording(effect: Effect, evidence: Evidence) -> Iterator[Effect]:
    """An event for each recording of the field, for it need not happen in another, or not then."""
    if not effect.event:
        yield effect
        return
    for recording in sorted({motion.source for motion in evidence.field.motions}):
        yield replace(effect, place={**effect.place, "recording": recording})
