"""`CurrentModel`: the base with the effects accepted so far, and how a candidate does beside it.

What search, rejection and choice ask of it is here; what is accepted, and when, the rounds decide (`competition`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from .candidate import Candidate, Refit, refit
from .constants import recorded_span
from .evidence import Evidence
from .held_out import HeldOut
from .rivals import UNKNOWN
from .scene import Scene
from .scored import Scored, feels, is_not_excited, penalty, plausible


class CurrentModel:
    """The base and what is accepted beside it.

    Attributes:
        evidence: Base model, field and reference.
        held_out: Held-out recordings, less the events in them; None where there are none.
        gate: Score that an effect must have.
        accepted: Effects accepted so far.
    """

    def __init__(self, evidence: Evidence, gate: float) -> None:
        self.evidence = evidence
        self.held_out: HeldOut | None = None
        self.gate = gate
        self.accepted: list[Candidate] = []
        base = evidence.base
        self._coulomb = {p.joint: float(v) for p, v in zip(base.model.parameters, base.parameters) if p.symbol == "f_c"}

    def all_but(self, number: int) -> list[Candidate]:
        """What is accepted but for one."""
        return [candidate for k, candidate in enumerate(self.accepted) if k != number]

    def on_held_out(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(V,) whitened residual of the held-out rows with these effects; empty where there are none."""
        return np.zeros(0) if self.held_out is None else self.held_out.residual(candidates, values)

    def squares_on_held_out(self, candidates: Sequence[Candidate], values: FloatArray) -> float:
        """Chi-square of the held-out rows with these effects; zero where there are none."""
        return _squares(self.on_held_out(candidates, values))

    def residuals(self, candidate: Candidate) -> Iterator[tuple[Scene, FloatArray, FloatArray]]:
        """Field and held-out rows: whitened residual beside what is accepted, and with one more."""
        both = [*self.accepted, candidate]
        field = self.evidence.residual_beside
        yield self.evidence.field, field(self.accepted), field(both)
        if self.held_out is not None:
            before, after = (self.on_held_out(one, refit(one).values) for one in (self.accepted, both))
            yield self.held_out.scene, before, after

    def values_of(self, candidate: Candidate) -> FloatArray:
        """Parameters and constants of a candidate beside what is accepted."""
        count = len(candidate.effect.parameters)
        values = refit([*self.accepted, candidate]).values[-count:]
        return np.concatenate([values, candidate.constants])

    def acts_on(self, candidate: Candidate) -> Set[str]:
        """Names of the joints where an effect acts; of an event, of those that feel it."""
        if not candidate.effect.event:
            return set(candidate.effect.joints)
        felt = feels(self.energy([candidate], self.values_of(candidate)))
        return {name for name, feeling in zip(self.evidence.base.model.arm.joint_names, felt) if feeling}

    def energy(self, candidates: Sequence[Candidate], values: FloatArray, event: Candidate | None = None) -> FloatArray:
        """(n,) sum of squares by joint of what effects add to the torque, in all rows or in those of an event."""
        return self._by_joint(self.evidence.added(candidates, values), event)

    def energy_beside(self, candidate: Candidate, event: Candidate | None = None) -> FloatArray:
        """(n,) the same of what all effects add, more than those accepted did without a candidate.

        What has the freedom of an accepted effect takes over a part of its torque, which is nothing new.
        """
        every = [*self.accepted, candidate]
        whole = self.evidence.added(every, refit(every).values)
        return self._by_joint(whole - self.evidence.added(self.accepted, refit(self.accepted).values), event)

    def _by_joint(self, torque: FloatArray, event: Candidate | None) -> FloatArray:
        if event is not None:
            during = np.zeros(len(torque), dtype=bool)
            during[event.stacked.rows] = np.any(event.stacked.columns != 0.0, axis=1)
            torque = np.where(during, torque, 0.0)
        return self.evidence.field.by_joint(torque**2)

    def excess(self, effect: Effect) -> FloatArray:
        """(n,) chi-square of each joint's field rows above what noise would leave, beside what is accepted.

        For an event, of the recording in which it is.
        """
        field = self.evidence.field
        above = self.evidence.residual_beside(self.accepted) ** 2 - 1.0
        here = np.array([not effect.elsewhere(motion) for motion in field.motions])
        return np.maximum(field.by_joint(np.where(here[field.owner], above, 0.0)), 0.0)

    def gain(self, candidate: Candidate, beside: Refit, others: Sequence[Candidate]) -> float:
        """Drop in chi-square of a candidate beside others, fitted already; −∞ where its values are implausible."""
        together = refit([*others, candidate], beside)
        values = together.values[len(beside.values) :]
        gain = together.gain - beside.gain
        return gain if np.isfinite(gain) and self.is_plausible(candidate, values) else -np.inf

    def scored(self, candidate: Candidate, beside: Refit, held_out_before: FloatArray) -> Scored:
        """A candidate's score beside what is accepted, its fit and (V,) residual of held-out rows (`on_held_out`)."""
        together = refit([*self.accepted, candidate], beside)
        gain = together.gain - beside.gain
        held_out_after = self.on_held_out([*self.accepted, candidate], together.values)
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
        return Scored(candidate, gain, held_out, score, self.is_plausible(candidate, values), not_excited)

    def is_plausible(self, candidate: Candidate, values: FloatArray) -> bool:
        """Whether its physics has such values (k,), and an event ends or begins within the recordings that it is in."""
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
        return max(int(np.sum(acts & feels(self.energy([candidate], values))[joint])), 1)


def _squares(residual: FloatArray) -> float:
    return float(residual @ residual)
