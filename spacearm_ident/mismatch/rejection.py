"""`is_rejected`: whether a candidate is no finding, however it scores: one criterion after the other (`CRITERIA`).

`is_dominated`: whether one that stands by itself is rejected with another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from .candidate import refit, with_own
from .current_model import CurrentModel
from .scored import Scored, feels, penalty, throughout

NAMES_ENOUGH = 0.2
"""A named effect that explains less than this share of its joints' residual is a coincidence, not an explanation."""
LASTS = 0.5
"""An effect must score this share of the gate without its best moments: what shows in one alone is an accident."""
SEEN_AGAIN = 0.1
"""Share of its drop on the fitted rows that an effect must show, row for row, on held-out ones. A large named one need
not be excited there (`scored.is_not_excited`)."""
CLEARS_UP = 0.5
"""Share of its joints' residual in the field that an effect must explain if the held-out data do not excite it, or
excite it so little that a healthy arm may leave as much."""
MINOR_SHARE = 0.01
"""Beside a large effect at the same joints, less than this share of it is more likely the large one's own law being
a little different than a second physics: it is left unexplained, not named."""
MINOR_UNKNOWN = 0.05
"""The same for a dependence without a name, which has the freedom to follow any such difference."""
DOMINATES = 1.15
"""Ratio of scores from which a rejected effect dominates those that share a joint with it: they are rejected too."""


@dataclass(frozen=True)
class Case:
    """A candidate, and the model beside which it is judged."""

    scored: Scored
    current: CurrentModel

    @property
    def lasting(self) -> bool:
        """Whether it is no event in time."""
        return not self.scored.candidate.effect.event

    @cached_property
    def energy(self) -> FloatArray:
        """(n,) sum of squares by joint of what it adds to the torque of the field."""
        candidate = self.scored.candidate
        return self.current.energy([candidate], self.current.values_of(candidate))

    @cached_property
    def felt(self) -> np.ndarray:
        """(n,) whether a joint feels it."""
        return feels(self.energy)

    @cached_property
    def share(self) -> float:
        """Share that it explains of what is above the noise in the field, at the joints that feel it."""
        excess = self.current.excess(self.scored.candidate.effect)
        return self.scored.gain / max(float(excess[self.felt].sum()), 1e-9)


def is_rejected(scored: Scored, current: CurrentModel) -> bool:
    """Whether any criterion rejects a candidate.

    Args:
        scored: The candidate, scored beside the current model.
        current: That model.
    """
    case = Case(scored, current)
    return any(rejects(case) for rejects in CRITERIA)


def is_not_in_the_field(case: Case) -> bool:
    """Whether an effect does not gain the gate on the fitted rows alone."""
    return case.scored.gain < case.current.gate


def is_momentary(case: Case) -> bool:
    """Whether an effect scores too little without the best moments of field and held-out rows; an event may."""
    candidate, current = case.scored.candidate, case.current
    if not (case.lasting and case.scored.score > current.gate):
        return False
    drop = sum(throughout(scene, before, after) for scene, before, after in current.residuals(candidate))
    return not drop - penalty(candidate.effect, current.evidence.rows) > LASTS * current.gate


def worsens_a_joint(case: Case) -> bool:
    """Whether what is alike at several joints makes one so much worse that what undoes it would be a finding.

    A loose bolt at one joint is late torque there; one clock stamps them all.
    """
    candidate, current = case.scored.candidate, case.current
    if not ("joints" in candidate.effect.place and case.scored.score > current.gate):
        return False
    drops = [scene.by_joint(before**2 - after**2) for scene, before, after in current.residuals(candidate)]
    return not float(np.min(np.sum(drops, axis=0))) > -current.gate


def is_a_coincidence(case: Case) -> bool:
    """Whether a named effect explains too little of what is above the noise at its joints."""
    return case.scored.named and case.share < NAMES_ENOUGH


def is_within_another(case: Case) -> bool:
    """Whether most of an event without a name is during an accepted one, whose law is not quite right."""
    event = case.scored.candidate
    if case.lasting or case.scored.named:
        return False
    begin, end = event.effect.window(event.constants)
    for other in case.current.accepted:
        if other.effect.event and other.effect.place.get("recording") == event.effect.place.get("recording"):
            first, last = other.effect.window(other.constants)
            if min(end, last) - max(begin, first) > 0.5 * (end - begin):
                return True
    return False


def is_not_seen_again(case: Case) -> bool:
    """Whether held-out rows show too little of what lasts, though its law says that they excite it."""
    scored, held_out = case.scored, case.current.held_out
    if held_out is None or not case.lasting:
        return False
    again = scored.held_out / len(held_out.scene) / (scored.gain / case.current.evidence.rows)
    not_excited = scored.named and case.share > CLEARS_UP and scored.not_excited
    return again < SEEN_AGAIN and not not_excited


def is_negligible(case: Case) -> bool:
    """Whether an effect is small beside what is accepted at the joints that feel it.

    An event is small beside what goes on while it lasts: there the larger effect's law is most in doubt. What lasts is
    seen without any event, too.
    """
    current, lasting = case.current, case.lasting
    if not current.accepted:
        return False
    beside = [*with_own(current.accepted, refit(current.accepted).values)]
    beside = [one for one in beside if not (lasting and one[0].effect.event)]
    own = np.concatenate([np.zeros(0), *(values for _, values in beside)])
    event = None if lasting else case.scored.candidate
    large = current.energy([candidate for candidate, _ in beside], own, event)
    minor = MINOR_SHARE if case.scored.named and lasting else MINOR_UNKNOWN
    small = case.energy
    if not case.scored.named:
        # An effect may take the place of an accepted one, which is idle then; a free function that could adds only
        # what it explains more.
        small = np.minimum(small, current.energy_beside(case.scored.candidate, event))
    # Joint by joint: what shows at all of them may be small beside another cause at one. What no joint feels has no
    # median (NaN), and is negligible.
    return not float(np.median(small[case.felt] - minor * large[case.felt])) > 0.0


CRITERIA: tuple[Callable[[Case], bool], ...] = (
    is_not_in_the_field,
    is_momentary,
    worsens_a_joint,
    is_a_coincidence,
    is_within_another,
    is_not_seen_again,
    is_negligible,
)
"""In the order in which they are tried."""


def is_dominated(scored: Scored, rejected: Sequence[Scored], joints: Set[str]) -> bool:
    """Whether a named effect is dominated by a rejected one that shares a joint with it.

    Args:
        scored: The effect in question.
        rejected: Candidates of the same round that were rejected.
        joints: Names of the joints at which `scored` acts.
    """

    def better(other: Scored) -> bool:
        return other.named and other.plausible and other.score > DOMINATES * scored.score

    return scored.named and any(better(other) and joints & set(other.joints) for other in rejected)
