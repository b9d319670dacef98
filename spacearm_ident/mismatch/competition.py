"""The competition: which effects explain what the base model leaves over.

Every effect at every place is fitted together with the base (and with what was accepted before); constants are
searched over their grids, the best refined (`search`). An effect's score is its drop in chi-square on the field, plus
its drop on held-out recordings, less a penalty for its freedom (`current_model`). Of those that no criterion rejects
(`rejection`) the best joins (`choice`), earlier ones are tried again without, and so on until nothing scores above the
gate. Those rounds are here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..forks import each
from .already_there import was_there_before, with_shared
from .candidate import Candidate, Refit, refit, with_own
from .choice import choose, is_outdone, simplest
from .current_model import CurrentModel
from .evidence import Evidence
from .finding import Happened
from .happened import happened, without
from .held_out import HeldOut
from .rejection import is_dominated, is_rejected
from .scored import Scored, penalty
from .search import Search

GATE = 60.0
"""Score an effect must have. The largest on healthy arms is what sets it (bench/concealed.py)."""
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

    def without(self, dropped: Sequence[int]) -> Outcome:
        """The outcome less some of its effects, refitted.

        Args:
            dropped: Their numbers.
        """
        kept = [k for k in range(len(self.accepted)) if k not in dropped]
        accepted = tuple(self.accepted[k] for k in kept)
        return replace(self, rounds=tuple(self.rounds[k] for k in kept), accepted=accepted, refit=refit(accepted))


class Competition:
    """The rounds.

    Attributes:
        current: The base with what is accepted so far.
        search: What competes with it.
        common: Effects that the reference shows as well, part of the base.
        happened: Events found in held-out recordings.
    """

    def __init__(
        self, evidence: Evidence, held_out: HeldOut | None, excluded: Sequence[str] = (), gate: float = GATE
    ) -> None:
        self.current = CurrentModel(evidence, gate)
        scenes = [evidence.field, *([held_out.scene] if held_out else [])]
        evidence.fit_reversals(scenes)
        if evidence.reference is not None:
            thin, _ = evidence.in_vacuum
            for scene in scenes:
                scene.set_high_orders(thin)
        self.search = Search(self.current, excluded)
        self._rounds: list[Round] = []
        self.common: list[Scored] = []
        self.happened: list[Happened] = []
        self._judge_on(held_out)

    def run(self, progress: Callable[[float, str], None]) -> Outcome:
        """Until nothing more scores; from what is accepted already, where it ran before."""
        current, rounds = self.current, self._rounds
        left = None
        left_values = np.zeros(0)
        dropped = 0
        while _causes(rounds) + len(self.common) + dropped < MOST and len(rounds) < MOST_ROUNDS:
            progress(len(rounds) / MOST, f"comparing effects, round {len(rounds) + 1}")
            ranked = self.search.ranked()
            outdone = [is_outdone(scored, ranked, current) for scored in ranked]
            standing = [scored for scored, bad in zip(ranked, outdone) if not bad]
            rejects = [is_rejected(scored, current) for scored in standing]
            rejected = [scored for scored, bad in zip(standing, rejects) if bad]
            sound = [scored for scored, bad in zip(standing, rejects) if not bad]
            sound = [s for s in sound if not is_dominated(s, rejected, current.acts_on(s.candidate))]
            winner = choose(sound, current)
            if winner is None:
                left = ranked[0] if ranked else None
                left_values = current.values_of(left.candidate) if left else left_values
                break
            if was_there_before(winner, current):
                if not self._take_into_base(winner):
                    dropped += 1
                    self.search.drop(winner.candidate.effect)
                continue
            chosen, winner = winner, self.search.polished(winner)
            current.accepted.append(winner.candidate)
            self._search_again()
            self._relinearise()
            self.search.accept(winner.candidate.effect)
            if winner.candidate.effect.event:
                self._leave_out_events()
            # One of several joints has a large score because it has several: it is no rival of what outdoes it.
            rivals = [s for s, bad in zip(ranked, outdone) if not (bad and len(s.joints) > 1)]
            rounds.append(Round(winner, tuple(s for s in rivals if s is not chosen)))
            rounds = self._without_the_idle(rounds)
            if self._is_excluded(winner.candidate.effect):
                current.accepted.pop()
                rounds.pop()
                dropped += 1
        self._rounds = rounds = self.with_possible_values(rounds)
        accepted = tuple(current.accepted)
        return Outcome(tuple(rounds), accepted, refit(accepted), tuple(self.common), left, left_values)

    def reweigh(self, evidence: Evidence, held_out: HeldOut | None) -> None:
        """Go on with the same rows under other weights of the joints."""
        before, self.current.evidence = self.current.evidence, evidence
        self._judge_on(held_out)
        self.current.accepted = [evidence.reweighted([one], before)[0] for one in self.current.accepted]
        self.search.reweigh(before)

    def with_possible_values(self, rounds: Sequence[Round]) -> list[Round]:
        """Rounds whose winners have values that their physics has beside all others too, not only when they were taken.

        In the place of one that has not comes the simplest other of its joints that has; where there is none it goes.

        Args:
            rounds: Of what is accepted, in its order; that follows what is returned.
        """
        current, kept = self.current, list(rounds)
        for number in reversed(range(len(kept))):
            if self._is_possible(number):
                continue
            effect = current.accepted[number].effect
            others = current.all_but(number)
            beside = refit(others)
            held_out_before = current.on_held_out(others, beside.values)
            alike = [one.candidate for one in kept[number].others if one.named and one.joints == effect.joints]
            accepted, current.accepted = current.accepted, others
            again = [current.scored(one, beside, held_out_before) for one in current.evidence.again(alike)]
            current.accepted = accepted
            sound = sorted((s for s in again if s.plausible and s.score > current.gate), key=lambda s: -s.score)
            if sound:
                winner = simplest(sound)
                current.accepted[number] = winner.candidate
                kept[number] = Round(winner, tuple(s for s in sound if s is not winner))
            else:
                del current.accepted[number], kept[number]
        return kept

    def _is_possible(self, number: int) -> bool:
        """Whether one accepted effect has values that its physics has, fitted with all others."""
        accepted = self.current.accepted
        candidate, own = [*with_own(accepted, refit(accepted).values)][number]
        return self.current.is_plausible(candidate, own)

    def _search_again(self) -> None:
        """Constants of what was accepted before, beside what has joined: what was not known then is in them.

        A ripple found beside an unknown push was 2 % off, and a second one beside it made up for that.
        """
        current = self.current
        numbers = [k for k, one in enumerate(current.accepted[:-1]) if one.effect.constants and not one.effect.event]
        for number, moved in zip(numbers, each(self.search.again, numbers)):
            # Beside what the others have become as well.
            others = current.all_but(number)
            beside, one = refit(others), current.accepted[number]
            if moved and current.gain(moved, beside, others) - current.gain(one, beside, others) > MOVES * current.gate:
                current.accepted[number] = replace(moved, effect=one.effect)

    def _relinearise(self) -> None:
        """Accepted effects whose columns depend on their own parameters, around the values that they now have."""
        current = self.current
        for _ in range(RELINEARISED):
            own = with_own(current.accepted, refit(current.accepted).values)
            moved = [(one, one.effect.around(tuple(values.tolist()))) for one, values in own]
            if all(effect is one.effect for one, effect in moved):
                return
            current.accepted = [
                one if effect is one.effect else current.evidence.candidate(effect, one.constants)
                for one, effect in moved
            ]

    def _leave_out_events(self) -> None:
        """Judge nothing on held-out rows during an event like one that was found."""
        if self._with_events is not None:
            accepted = self.current.accepted
            self.happened = happened(self._with_events, accepted, refit(accepted).values, self.current.gate)
            self._judge_on(self._with_events)

    def _judge_on(self, held_out: HeldOut | None) -> None:
        """Judge on held-out recordings, less the events in them."""
        self._with_events = held_out
        self.current.held_out = held_out and without(held_out, self.happened)

    def _take_into_base(self, winner: Scored) -> bool:
        """Refit everything with an effect that reference and field share; False, and nothing changed, if it is none."""
        evidence = with_shared(winner, self.current)
        if evidence is None:
            return False
        self.common.append(winner)
        self.current.evidence = evidence
        if self._with_events is not None:
            self._judge_on(HeldOut(evidence, self._with_events.scene))
        self.current.accepted = evidence.again(self.current.accepted)
        self.search.renew()
        return True

    def _without_the_idle(self, rounds: list[Round]) -> list[Round]:
        """Drop what later effects have made idle."""
        current = self.current
        whole = refit(current.accepted).gain
        for k in range(len(rounds) - 1):
            others = current.all_but(k)
            lost = whole - refit(others).gain
            if lost - penalty(current.accepted[k].effect, current.evidence.rows) < 0.5 * current.gate:
                current.accepted = others
                return self._without_the_idle([r for number, r in enumerate(rounds) if number != k])
        return rounds

    def _is_excluded(self, last: Effect) -> bool:
        """Whether the effect that joined last has left in place one that an arm cannot have beside it."""
        return any(last.excludes(other.effect) for other in self.current.accepted[:-1])


def _causes(rounds: Sequence[Round]) -> int:
    """How many effects there are; the same event in several recordings counts once."""
    effects = [one.winner.candidate.effect for one in rounds]
    return len({effect.kind if effect.event and effect.one_cause else id(effect) for effect in effects})
