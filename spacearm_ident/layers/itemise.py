"""From a joint fit to the items of its layers: what differs, was and is, with an interval and a share, in words."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..arrays import FloatArray
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.friction import LoadFriction
from ..mismatch.finding import Detectable, Explanation
from ..mismatch.rivals import UNKNOWN
from ..simulations.simulation import ARMATURE, DAMPING, FRICTION
from .conventions import Suspicion
from .item import Item
from .joint_fit import JointFit
from .parameters import (
    DIGITS,
    LEVEL,
    Change,
    Explained,
    changes,
    combination_of,
    combinations,
    determined,
    few_causes,
    places_of,
)
from .physics import Added
from .wiring import DELAY, GAIN, TILT, ZERO, kind_and_joint

WORDS = {GAIN: "effort_gain", ZERO: "encoder_zero", DELAY: "delay", TILT: "base_tilt"}
UNITS = {GAIN: "1", ZERO: "rad", DELAY: "s", TILT: "rad"}
SHOWS = 0.02
"""Share by which a parameter's change, a gain, a zero, a tilt or a delay must lower the held-out variance that is left
at some joint to be named: one per cent of its RMS, as for a model that is no worse than another (`bench/real_arms.py`).
Errors shrink with the length of the recordings; half a sampling period and a simulator's integration step stay, and
both look like friction."""
SLOW = "slower than noise; follows nothing that was tried"
"""Where what is left of a joint has a slow part that is larger than the noise (`noise.slow`)."""


class Shares:
    """What an item is worth: the held-out variance that is back when it alone is as the simulation has it.

    As a share of the simulation's variance above the noise, each joint's in units of its torque's: at a joint that the
    simulation predicts there is nothing to be a share of.
    """

    def __init__(
        self,
        found: JointFit,
        gain: FloatArray,
        simulated: FloatArray,
        after: FloatArray,
        noise: FloatArray,
        torque: FloatArray,
    ) -> None:
        """Take a joint fit, recorded over true torque (n,), and RMS (n,), N m.

        Args:
            found: The joint fit.
            gain: Recorded torque over the true one.
            simulated: What the simulation leaves of the held-out recordings.
            after: What the joint fit leaves.
            noise: What noise leaves.
            torque: The torque itself.
        """
        self._found, self._gain, self._after = found, gain, after
        self._unit = np.where(torque > 0.0, torque, np.nan) ** -2.0
        self._whole = float(np.nansum(np.maximum(simulated**2 - noise**2, 0.0) * self._unit))

    def of_variance(self, variance: FloatArray) -> float:
        """Of variances (n,), N^2 m^2; NaN where the simulation leaves no more than noise."""
        return float(np.nansum(variance * self._unit)) / self._whole if self._whole > 0.0 else float("nan")

    def without(self, vector: FloatArray, was: float) -> float:
        """With one combination (P,) as in the simulation."""
        return self.of(self.back(vector, was))

    def back(self, vector: FloatArray, was: float) -> FloatArray:
        """(P,) the estimates with one combination as in the simulation; its leading unknown is moved."""
        values = self._found.estimate.values.copy()
        lead = int(np.argmax(vector == 1.0))
        values[lead] += was - self._found.estimate.of(vector)
        return values

    def rise(self, values: FloatArray) -> float:
        """Largest share by which the variance that is left at a joint rises with other values (P,)."""
        rms = self._gain * self._found.judge.rms(values)
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(np.nanmax((rms / self._after) ** 2 - 1.0))

    def of(self, values: FloatArray) -> float:
        """The same of other values (P,)."""
        rms = self._gain * self._found.judge.rms(values)
        return self.of_variance(rms**2 - self._after**2)


def wiring_items(found: JointFit, shares: Shares) -> tuple[Item, ...]:
    """Of gains, zeros, the delay and the tilt.

    Args:
        found: The joint fit.
        shares: What an item is worth.
    """
    joints = found.simulation.arm.joint_names
    items, undone = [], found.wiring.by_column(joints)
    for name in found.names:
        kind, joint = kind_and_joint(name)
        vector = np.zeros(found.linear.count)
        vector[found.linear.names.index(name)] = 1.0
        low, high = found.estimate.interval(vector)
        now = undone[name]
        value, low, high = (now + off for off in (found.estimate.of(vector), low, high))
        was = 0.0
        if kind == GAIN:
            value, low, high, was = float(np.exp(value)), float(np.exp(low)), float(np.exp(high)), 1.0
        items.append(
            Item(
                WORDS[kind],
                (joint,) if joint in joints else joints,
                f"base, about its {joint} axis" if kind == TILT else joint or "all joints",
                was,
                value,
                low,
                high,
                UNITS[kind],
                shares.without(vector, -now),
                found.replicates(vector, -now),
            )
        )
    return by_share(items)


@dataclass(frozen=True)
class ParameterItems:
    """Differences between the parameters of simulation and arm, from the joint fit.

    Attributes:
        items: Confirmed differences.
        lost: Names of differences that held-out data do not confirm.
        seen: For parameters that agree, the smallest difference that would have been detected.
        notes: Sentences on what may differ.
        kept: Combinations (P,) of parameters whose value stays, each with that value.
    """

    items: tuple[Item, ...]
    lost: tuple[str, ...]
    seen: tuple[Detectable, ...]
    notes: tuple[str, ...]
    kept: list[tuple[FloatArray, float]]


def parameter_items(found: JointFit, shares: Shares, open_factors: Mapping[str, str]) -> ParameterItems:
    """Of bodies, rotors and friction.

    Args:
        found: The joint fit.
        shares: What an item is worth.
        open_factors: As of `Wired`.
    """
    simulation = found.simulation
    known = determined(found.linear, found.estimate, found.prior, simulation)
    simple, others = few_causes(known, found.linear, found.estimate, simulation)
    changed, same = changes(known, found.estimate)
    either = _by_a_factor(changed, open_factors, {simulation.word(symbol) for symbol in (FRICTION, DAMPING)})
    changed = tuple(one for one in changed if one not in either)
    open_joints = dict.fromkeys(one.joints[0] for one in either)
    by_gain = [joint for joint in open_joints if kind_and_joint(open_factors[joint])[0] == GAIN]
    rotor = simulation.word(ARMATURE)
    items = [one for one in _cause_items(simple, found, shares) if one.name != rotor or one.joints[0] not in by_gain]
    # Also what is not of the same size in the held-out recordings: they are predicted worse without.
    differing = set[tuple[str, str]]()
    for change in changed:
        if not simple or not change.of_bodies:
            rise = shares.rise(shares.back(change.vector, change.was))
            if rise > SHOWS:
                items.append(_change_item(change, found, shares))
                differing.add((change.name, change.where))
            else:
                size = abs(found.estimate.of(change.vector) - change.was)
                same = (*same, (change, size * float(np.sqrt(SHOWS / max(rise, 1e-6)))))
    lost = tuple(f"{item.name} of {item.where}" for item in items if item.replicated is False)
    items = [item for item in items if item.replicated is not False]
    seen = tuple(Detectable(one.name, one.joints, size, one.unit) for one, size in same)
    notes = (f"torque does not tell which of these differs, too: {'; '.join(others)}",) if others else ()
    notes = (*notes, *(_either(joint, gain=joint in by_gain) for joint in open_joints))
    if simple and others:
        # It is fitted whatever differs, for there is more than can be said in few words.
        differing |= {(one.name, one.where) for one in changed if one.of_bodies}
    bodies = _with_causes(() if others else simple, found)
    kept = [
        (one.vector, float(one.vector @ bodies))
        for one in combinations(found.linear, simulation)
        if (one.name, one.where) not in differing
    ]
    return ParameterItems(by_share(items), lost, seen, notes, kept)


def physics_items(
    found: JointFit, order: Sequence[Added], rms: Sequence[FloatArray], shares: Shares
) -> tuple[Item, ...]:
    """Of physics that the simulation does not have.

    Args:
        found: The joint fit.
        order: Physics in the order in which it is added.
        rms: (n,) what is left of the held-out recordings, N m: before physics, then after each.
        shares: What an item is worth.
    """
    items = []
    for number, one in enumerate(order):
        drop = shares.of_variance(rms[number] ** 2 - rms[number + 1] ** 2)
        vector = found.vector(one)
        # Friction by the load is known best where the load is.
        card = {} if one.finding is None or one.effect == LoadFriction.kind else one.finding.parameters
        name, quantity = next(iter(card.items()), ("", None))
        value, low, high, unit = (
            (quantity.value, quantity.low, quantity.high, quantity.unit)
            if quantity is not None
            else (found.estimate.of(vector), *found.estimate.interval(vector), found.unit(one))
        )
        where = one.where if not name else f"{one.where} ({name})"
        items.append(
            Item(
                one.effect,
                one.joints,
                where,
                float("nan"),
                value,
                low,
                high,
                unit,
                drop,
                found.replicates(vector, 0.0),
                equivalents=EFFECTS[one.effect].same_torque if one.effect in EFFECTS else (),
            )
        )
    return tuple(items)


def rest_items(
    explanation: Explanation, after: FloatArray, noise: FloatArray, slow: np.ndarray, shares: Shares
) -> tuple[Item, ...]:
    """What is left, and what it depends on as far as the search can say.

    Args:
        explanation: The search's answer.
        after: (n,) RMS that the joint fit leaves, N m.
        noise: (n,) RMS that noise leaves, N m.
        slow: (n,) whether more than the noise is slow.
        shares: What an item is worth.
    """
    items = []
    for finding in explanation.findings:
        if finding.effect == UNKNOWN:
            rows = [explanation.joints.index(joint) for joint in finding.joints]
            items.append(_left_at(rows, explanation.joints, finding.where, after, noise, shares))
    named = {joint for item in items for joint in item.joints}
    for left in explanation.unexplained:
        if not set(left.joints) <= named:
            rows = [explanation.joints.index(joint) for joint in left.joints]
            items.append(_left_at(rows, explanation.joints, left.where, after, noise, shares))
    named = {joint for item in items for joint in item.joints}
    for row, joint in enumerate(explanation.joints):
        if slow[row] and joint not in named:
            items.append(_left_at([row], explanation.joints, SLOW, after, noise, shares))
    return by_share(items)


def by_share(items: Sequence[Item]) -> tuple[Item, ...]:
    """Largest share first; those without one before all."""
    return tuple(sorted(items, key=lambda one: -np.nan_to_num(one.share, nan=np.inf)))


def suspicions(suspected: Sequence[Suspicion]) -> tuple[str, ...]:
    """What may be off and was not undone, in words."""
    return tuple(
        f"suspected, {one.probability:.0%}: "
        + ", ".join(f"{wiring_words(name)} {value:.3g}" for name, value in zip(one.names, one.values))
        + "; statistically indistinguishable from links of another mass, and therefore not corrected"
        for one in suspected
    )


def wiring_words(name: str) -> str:
    """A column of the wiring, such as `gain[joint_2]`, in words."""
    kind, joint = kind_and_joint(name)
    return {
        GAIN: f"torque gain of {joint}",
        ZERO: f"encoder zero of {joint} (rad)",
        DELAY: "delay of torque (s)",
        TILT: f"tilt of the base about its {joint} axis (rad)",
    }[kind]


def not_named(small: Sequence[Added], gone: Sequence[Added]) -> tuple[str, ...]:
    """Physics that is no item, in words.

    Args:
        small: What is in the model and too small to be named.
        gone: What was found and not found again.
    """
    notes = []
    if small:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in small)
        notes.append(f"in the model since it predicts held-out data better, but not clear enough to be named: {words}")
    if gone:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in gone)
        notes.append(f"found in the fit, but not replicated or of a size that may be zero, and left out: {words}")
    return tuple(notes)


def _by_a_factor(changed: Sequence[Change], joints: Container[str], words: set[str]) -> list[Change]:
    """Changes of friction and of damping, so called in `words`, at those of some joints where both differ."""
    own = [one for one in changed if one.name in words and one.joints[0] in joints]
    both = {one.joints for one in own if {other.name for other in own if other.joints == one.joints} == words}
    return [one for one in own if one.joints in both]


def _either(joint: str, gain: bool) -> str:
    """That a joint's friction and damping differ, or another thing does."""
    own = "friction, damping and rotor inertia" if gain else "friction and damping"
    what = "its torque gain" if gain else "friction that grows with its load"
    return f"torque does not tell whether {own} of {joint} differ by one factor, or it is {what}"


def _change_item(change: Change, found: JointFit, shares: Shares) -> Item:
    low, high = found.estimate.interval(change.vector)
    return Item(
        change.name,
        change.joints,
        change.where,
        change.was,
        found.estimate.of(change.vector),
        low,
        high,
        change.unit,
        shares.without(change.vector, change.was),
        found.replicates(change.vector, change.was),
        combination_of(change, found.linear, found.simulation),
    )


def _cause_items(simple: Sequence[Explained], found: JointFit, shares: Shares) -> list[Item]:
    """Causes as items."""
    places, items = places_of(found.linear), []
    half = float(norm.ppf(1 - LEVEL / 2))
    for one in simple:
        reported, without = one.reported, found.estimate.values.copy()
        without[places] -= one.cause.directions @ one.values
        least = max(half * reported.error, DIGITS * abs(reported.was))
        if abs(reported.now - reported.was) > least and shares.rise(without) > SHOWS:
            items.append(
                Item(
                    reported.name,
                    (one.cause.joint,),
                    reported.where,
                    reported.was,
                    reported.now,
                    reported.now - half * reported.error,
                    reported.now + half * reported.error,
                    reported.unit,
                    shares.of(without),
                    None,
                    {reported.key: 1.0} if reported.key else {},
                )
            )
    return items


def _with_causes(simple: Sequence[Explained], found: JointFit) -> FloatArray:
    """(P,) bodies and rotors as in the simulation, but for these causes; the rest is zero."""
    values, was = np.zeros(found.linear.count), found.simulation.values
    places = places_of(found.linear)
    values[places] = [was.get(found.linear.names[place], 0.0) for place in places]
    for cause, change in {one.cause.claim: (one.cause, one.values) for one in simple}.values():
        values[places] += cause.directions @ change
    return values


def _left_at(
    rows: Sequence[int],
    joints: tuple[str, ...],
    where: str,
    after: FloatArray,
    noise: FloatArray,
    shares: Shares,
) -> Item:
    largest = float(np.max(after[rows]))
    share = shares.of_variance(np.where(np.isin(np.arange(len(joints)), rows), after**2 - noise**2, 0.0))
    nothing = float("nan")
    return Item(UNKNOWN, tuple(joints[k] for k in rows), where, nothing, largest, nothing, nothing, "N m RMS", share)
