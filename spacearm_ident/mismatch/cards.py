"""A card for every accepted effect: what it is, how large, how sure, and what it does on held-out data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from .candidate import refit, with_own
from .competition import Outcome
from .constants import recorded_span
from .evidence import Evidence
from .finding import Alternative, Finding, Quantity
from .intervals import Intervals, step_of
from .residuals import Residuals, unwhitened
from .rivals import UNKNOWN
from .scored import Scored, exponent, feels
from .stacked import stacked_effect

NEAR_RESONANCE = 1.2
"""A link with little damping answers the noise of an encoder, and any error of its inertia, this near its resonance."""
NEAR = 0.25
"""Explanations with less than this share of the winner's score are not worth a line."""
MOST = 4


class Cards:
    """Turns an outcome into findings."""

    def __init__(
        self, evidence: Evidence, residuals: Residuals, outcome: Outcome, floor: FloatArray, on_a_day: Evidence
    ) -> None:
        """Take what was fitted, and `on_a_day`, the same rows with friction of another day, for the intervals."""
        self.evidence = evidence
        self.residuals = residuals
        self.outcome = outcome
        self.floor = floor
        self.accepted = list(outcome.accepted)
        self._own = [own for _, own in with_own(self.accepted, outcome.refit.values)]
        self._field = unwhitened(evidence.base, evidence.field)
        self._intervals = Intervals(on_a_day, on_a_day.again(self.accepted), outcome.refit.values)

    def finding(self, number: int) -> Finding:
        """The card of one accepted effect."""
        winner = self.outcome.rounds[number].winner
        effect = self.accepted[number].effect
        values = self._values(number)
        quantities = self._quantities(number, values)
        rivals = self._rivals(number)
        felt = self._felt_in_field(number)
        # Of what has no name nobody knows whether it is an event: it is judged as what lasts.
        event = effect.event and effect.kind != UNKNOWN
        before, after, beside, explained = self._on_held_out(number, felt)
        if effect.event:
            own_before, beside, explained = self._while_it_lasts(number)
            before, after = (own_before, beside) if event else (before, after)
        joints = effect.joints or tuple(before)
        return Finding(
            effect=effect.kind,
            joints=joints,
            where=effect.where(values),
            equation=effect.equation,
            source=effect.source,
            parameters=quantities,
            confidence=_confidence(winner, rivals),
            alternatives=(*_same_torque(winner), *(_alternative(winner, other) for other in rivals[:MOST])),
            gain=winner.gain,
            held_out_gain=winner.held_out,
            not_excited=winner.not_excited,
            visibility=self._visibility(number),
            before_Nm=before,
            after_Nm=after,
            explained=explained,
            beside_Nm=beside,
            against=effect.against(values) or _weightless(effect, quantities),
            felt_Nm=felt,
            event=event,
            experiment=effect.experiment,
            remedy=effect.remedy,
            windows=self._windows(effect, values),
            driver=str(effect.place.get("with", "")) if effect.kind == UNKNOWN else "",
        )

    def _windows(self, effect: Effect, values: FloatArray) -> tuple[tuple[int, float, float], ...]:
        """Of an event, the number of its recording, and begin and end in it, s."""
        if not effect.event:
            return ()
        constants = tuple(float(value) for value in values[len(effect.parameters) :])
        return ((int(effect.place.get("recording", 0)), *effect.window(constants)),)

    def _rivals(self, number: int) -> list[Scored]:
        """Plausible competitors worth a line, the best of each kind and place.

        What acts at none of the joints that feel the winner is no other explanation: it is accepted beside it, or it
        does not stand.
        """
        winner, felt = self.outcome.rounds[number].winner, self._felt_at(number)
        seen = {(winner.candidate.effect.kind, winner.joints)}
        kept = []
        for other in self.outcome.rounds[number].others:
            stacked, key = other.candidate.stacked, (other.candidate.effect.kind, other.joints)
            acts = self.evidence.field.joint[stacked.rows][np.any(stacked.kept != 0.0, axis=1)]
            near = other.plausible and other.score > NEAR * winner.score
            if near and key not in seen and np.isin(felt, acts).any():
                seen.add(key)
                kept.append(other)
        return kept

    def _values(self, number: int) -> FloatArray:
        """Parameters, then constants of one effect."""
        candidate = self.accepted[number]
        constants = candidate.effect.clipped(candidate.constants, self._span(candidate.effect))
        return np.concatenate([self._own[number], constants])

    def _span(self, effect: Effect) -> tuple[float, float]:
        """Start and end, s, of what was fitted of the recordings that an effect may act in."""
        return recorded_span(effect, self.evidence.field.motions)

    def _visibility(self, number: int) -> float:
        gram, columns, values = self.accepted[number].gram, self.accepted[number].stacked.columns, self._own[number]
        whole = float(np.sum((columns @ values) ** 2))
        return float(values @ gram @ values) / whole if whole > 0 else float("nan")

    def _on_held_out(
        self, number: int, felt: Mapping[str, float]
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float], float]:
        """RMS by joint without, with, and with it less its swings; share of the variance above the noise it removes.

        Where it is `felt` more, N m, a joint's variance counts for more: something else may be left where it is not.
        """
        values = self.outcome.refit.values
        others = [c for k, c in enumerate(self.accepted) if k != number]
        kept = np.concatenate([np.zeros(0), *(own for k, own in enumerate(self._own) if k != number)])
        whole = self.evidence.base_parameters(self.accepted, values)
        with_it = self.residuals.of(whole, self.accepted, values)
        if self.evidence.reference is None:
            # Nothing pins the base down but the field itself: without the effect it would have fitted otherwise.
            alone = refit(others).values
            without = self.residuals.of(self.evidence.base_parameters(others, alone), others, alone)
        else:
            without = self.residuals.of(whole, others, kept)
        names = self.evidence.base.model.arm.joint_names
        rms_without, rms_with = self.residuals.rms(without), self.residuals.rms(with_it)
        rms_beside = self.residuals.rms(self.residuals.without_band(with_it, self._swings(number)))
        rows = self._felt_at(number)
        removed = above = 0.0
        for row in rows:
            count = float(np.sum(self.residuals.scene.joint == row))
            if count:
                weight = count * felt.get(names[row], 0.0) ** 2 / self.floor[row] ** 4
                removed += weight * (rms_without[row] ** 2 - rms_with[row] ** 2)
                above += weight * max(rms_without[row] ** 2 - self.floor[row] ** 2, 0.0)
        explained = float(np.clip(removed / above, 0.0, 1.0)) if above > 0 else float("nan")
        return (
            {names[row]: float(rms_without[row]) for row in rows},
            {names[row]: float(rms_with[row]) for row in rows},
            {names[row]: float(rms_beside[row]) for row in rows},
            explained,
        )

    def _while_it_lasts(self, number: int) -> tuple[dict[str, float], dict[str, float], float]:
        """Of an event in the field: RMS by joint without and with it, N m, and the share of variance it removes.

        No other recording need have it.
        """
        own, others = self.accepted[number], [c for k, c in enumerate(self.accepted) if k != number]
        rows = own.stacked.rows
        left, without = (self.evidence.residual_beside(some)[rows] for some in (self.accepted, others))
        above = float(np.sum(without**2 - 1.0))
        explained = float(np.clip(np.sum(without**2 - left**2) / above, 0.0, 1.0)) if above > 0 else float("nan")
        names, joint = self.evidence.base.model.arm.joint_names, self.evidence.field.joint[rows]
        here = [k for k in self._felt_at(number) if np.any(joint == k)]

        def rms(whitened: FloatArray) -> dict[str, float]:
            return {names[k]: float(self.floor[k] * np.sqrt(np.mean(whitened[joint == k] ** 2))) for k in here}

        return rms(without), rms(left), explained

    def _swings(self, number: int) -> list[tuple[float, float] | None]:
        """By held-out motion, the band in which an effect rings, if it does."""
        scene, candidate = self.residuals.scene, self.accepted[number]
        bands: list[tuple[float, float] | None] = []
        for motion, background in zip(scene.motions, scene.backgrounds):
            band = candidate.effect.resonance(motion, candidate.constants, background)
            bands.append(band and (band[0] / NEAR_RESONANCE, band[1] * NEAR_RESONANCE))
        return bands

    def _felt_at(self, number: int) -> list[int]:
        """The rows in which an effect moves torque, the strongest first."""
        energy = self.evidence.field.by_joint(self.evidence.added([self.accepted[number]], self._own[number]) ** 2)
        felt = feels(energy)
        return [int(j) for j in np.argsort(-energy) if felt[j]]

    def _felt_in_field(self, number: int) -> dict[str, float]:
        """By joint, RMS of what one effect adds to the torque where it acts in the field, N·m."""
        candidate = self.accepted[number]
        stacked = stacked_effect(self._field, candidate.effect, candidate.constants)
        torque, joint = stacked.columns @ self._own[number], self._field.joint[stacked.rows]
        names = self.evidence.base.model.arm.joint_names
        acts = {row: torque[(joint == row) & (torque != 0.0)] for row in self._felt_at(number)}
        return {names[row]: float(np.sqrt(np.mean(own**2))) for row, own in acts.items() if len(own)}

    def _quantities(self, number: int, values: FloatArray) -> dict[str, Quantity]:
        """What the effect shows of its values, with intervals from their covariance."""
        effect = self.accepted[number].effect
        if effect.kind == UNKNOWN:
            return {}
        shown, possible = effect.shown(values), self._possible(effect, values)
        quantities = {}
        for name, (value, unit) in shown.items():
            slope = np.zeros(len(values))
            for k in range(len(values)):
                step = step_of(values[k])
                moved = values.copy()
                moved[k] += step
                slope[k] = (effect.shown(moved)[name][0] - value) / step
            half = self._intervals.half_width(number, slope)
            low, high = possible.get(name, (-np.inf, np.inf))
            quantities[name] = Quantity(value, unit, max(value - half, low), min(value + half, high))
        return quantities

    def _possible(self, effect: Effect, values: FloatArray) -> dict[str, tuple[float, float]]:
        """Between which values some of what is shown lies in any case, at its values (k + c,).

        Lengths of vectors, and constants of an event: its edges in a standstill no torque tells, nor any after the end.
        """
        lengths = dict.fromkeys(effect.sizes, (0.0, np.inf))
        if not effect.event:
            return lengths
        begin, end = self._span(effect)
        start, _ = effect.window(values[len(effect.parameters) :].tolist())
        known = {constant.symbol: constant.reach or (0.0, end - start) for constant in effect.constants}
        return lengths | known | {constant.symbol: (begin, end) for constant in effect.constants if constant.begins}


def _weightless(effect: Effect, quantities: Mapping[str, Quantity]) -> str:
    """What speaks against a body whose mass may be zero, as `Effect.against`; empty for any other effect.

    Its moments follow any torque of the position at its joint; of its mass the joints before that feel more.
    """
    mass = quantities.get("mass") if effect.weighs else None
    return "mass may be zero" if mass is not None and mass.low <= 0.0 <= mass.high else ""


def _confidence(winner: Scored, others: Sequence[Scored]) -> float:
    """Weight of the winner among the named explanations that were compared."""
    kind = winner.candidate.effect.kind
    named = [other for other in others if other.named and other.candidate.effect.kind != kind]
    weights = [1.0, *(np.exp(min(0.0, exponent(other, winner))) for other in named)]
    return float(np.clip(weights[0] / sum(weights), 0.01, 0.99))


def _same_torque(winner: Scored) -> list[Alternative]:
    """Effects that have the same torque as the winner in every motion."""
    effect = winner.candidate.effect
    why = f"the same torque wherever the joint moves: {effect.experiment}"
    return [Alternative(kind, effect.joints, 1.0, why) for kind in effect.same_torque]


def _alternative(winner: Scored, other: Scored) -> Alternative:
    share = (other.gain + other.held_out) / max(winner.gain + winner.held_out, 1e-9)
    effect = other.candidate.effect
    if other.score > winner.score:
        freer = "with a freedom that no physics has" if not other.named else "is no simpler"
        why = f"explains as much, but {freer}"
    elif share > 0.97:
        why = "explains as much: statistically indistinguishable on these data"
    else:
        why = f"explains {100 * share:.0f} % of what the finding does"
    return Alternative(effect.kind, effect.joints, float(other.score / winner.score), why)
