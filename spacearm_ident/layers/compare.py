"""Compare a simulation with recordings of the arm, layer by layer.

1. What the simulation predicts of the held-out recordings, as it is.
2. Conventions and wiring: signs, order, units (`conventions.search`), then gains, zeros, delay and tilt
   (`conventions.py`).
3. The catalogue's search for physics beside the simulation's own terms, on corrected recordings.
4. Gains, zeros, delay and tilt again, beside the physics: what looked like a gain may have been an effect. Then one
   joint fit of wiring, parameters and physics. Layers are nested sets of its unknowns; each is judged on the
   held-out recordings. Items are read off the whole fit, with errors that hold where the residual is model error, and
   estimated again on the held-out recordings by themselves: that is whether they replicate.
5. What a flexible function of the same inputs could still remove.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.body import ExternalContact
from ..dynamics.effects.drive import CurrentOffset
from ..dynamics.effects.friction import LoadFriction
from ..errors import UnfitDataError
from ..identification.identify import Settings, identify
from ..mismatch.explain import held_out_ends
from ..mismatch.finding import DATA_UNFIT, Detectable, Explanation
from ..mismatch.happened import voided
from ..mismatch.integrity import faults
from ..mismatch.preparation import banded, cut_off_hz, position_cut_off_hz
from ..mismatch.rivals import UNKNOWN
from ..noise.slow import white_and_slow
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..simulations import Simulation
from ..simulations.simulation import ARMATURE, DAMPING, FRICTION
from .comparison import Comparison
from .conventions import Suspicion, Wired, find_wiring, without_columns
from .item import CONVENTIONS, PARAMETERS, PHYSICS, REST, Item, Layer
from .joint_fit import JointFit, in_newton_metres
from .linear import Linear
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
from .physics import (
    Added,
    added_terms,
    friction_by_load,
    late_by,
    missing_physics,
    optional_terms,
    with_friction_terms,
)
from .wiring import DELAY, GAIN, TILT, ZERO, Wiring, kind_and_joint

Progress = Callable[[float, str], None]
WORDS = {GAIN: "effort_gain", ZERO: "encoder_zero", DELAY: "delay", TILT: "base_tilt"}
UNITS = {GAIN: "1", ZERO: "rad", DELAY: "s", TILT: "rad"}
SHOWS = 0.02
"""Share by which a parameter's change, a gain, a zero, a tilt or a delay must lower the held-out variance that is left
at some joint to be named: one per cent of its RMS, as for a model that is no worse than another (`bench/real_arms.py`).
Errors shrink with the length of the recordings; half a sampling period and a simulator's integration step stay, and
both look like friction."""

LAW_SHOWS = 0.1
"""The same for friction by the load that is not as sure as other physics (`Wired.doubted`): 5 % of the RMS, by which
friction laws are off (`mismatch.intervals.LAW_ERROR`)."""
STANDS_OUT = 3.0
"""Times what is left at a joint, where that follows nothing known, from which a constant torque is not its mean."""
RELINEARISED = 2
"""Times that everything is fitted again around its values, where physics depends on them: friction by the load grows
with what the other terms and itself add up to, and the search fitted constants beside other values."""
SLOW = "slower than noise; follows nothing that was tried"
"""Where what is left of a joint has a slow part that is larger than the noise (`noise.slow`)."""
SIGNAL, LOWEST_HZ = 0.8, 5.0
"""The bandwidth is halved, to no less than this, where half of it holds less than so much of the accelerations' mean
square at the median joint. Noise of an encoder, differentiated twice, grows with the fifth power of the bandwidth:
nearly all of it is in the upper half. By its share of an acceleration an inertia comes out too small (errors in
variables): a fifth at most. Of five real arms one has 10 to 20 % in the lower half at 20 Hz, another 59 to 80, the
others 86 and more."""


def compare(
    simulation: Simulation,
    fitted: Sequence[Recording],
    held: Sequence[Recording],
    excluded: Sequence[str] = (),
    progress: Progress | None = None,
) -> Comparison:
    """Compare a simulation with an arm.

    Args:
        simulation: The simulation.
        fitted: Recordings of the arm to fit to; signs, order and units are right.
        held: Recordings to judge on, which no fit sees; empty: the last third of each of `fitted`.
        excluded: Effects that are not to be considered.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A recording lacks a joint of the simulation.
    """
    report = progress or (lambda share, what: None)
    arm = simulation.arm
    judged_on = "held-out recordings"
    if not held:
        fitted, held = held_out_ends(fitted)
        judged_on = "the last third of each recording, held out of the fit"
    if broken := faults([*fitted, *held], arm.joint_names):
        return _unfit(arm, tuple(broken))
    try:
        return _Pass(simulation, list(fitted), list(held), judged_on).run(excluded, report)
    except UnfitDataError as error:
        return _unfit(arm, (str(error),))
    except np.linalg.LinAlgError:
        return _unfit(arm, ("the data do not determine the simulation's terms: record a motion of all joints",))


def _unfit(arm: Arm, reasons: tuple[str, ...]) -> Comparison:
    nothing = np.full(len(arm.joints), np.nan)
    right = Wiring.right(len(arm.joints))
    return Comparison(
        arm.joint_names,
        (),
        nothing,
        nothing,
        nothing,
        nothing,
        nothing,
        nothing,
        None,
        right,
        (),
        None,
        reasons=reasons,
    )


def _acceleration(motions: Sequence[Motion]) -> FloatArray:
    """(n,) mean square of the accelerations in their bandwidth."""
    return np.asarray(np.mean(np.concatenate([m.reduce(m.acceleration) ** 2 for m in motions]), axis=0))


class _Pass:
    """One comparison: recordings, motions, and the problems built on them."""

    def __init__(self, simulation: Simulation, fitted: list[Recording], held: list[Recording], judged_on: str) -> None:
        self.simulation, self.fitted, self.held, self.judged_on = simulation, fitted, held, judged_on
        self.arm, self.joints = simulation.arm, simulation.arm.joint_names
        self.cutoff = cut_off_hz([*fitted, *held])
        wide = self._of_positions(self.cutoff)
        # Wiring is looked for in the full bandwidth: a delay is in its upper half.
        self.motions = self.wired_in = banded(fitted, self.joints, self.cutoff, wide)
        while self.cutoff > LOWEST_HZ:
            half = 0.5 * self.cutoff
            narrower = self._of_positions(half)
            slower = banded(fitted, self.joints, half, narrower)
            with np.errstate(invalid="ignore", divide="ignore"):
                share = _acceleration(slower) / _acceleration(self.motions)
            # A joint that stands still says nothing.
            if not np.nanmedian(share) <= SIGNAL:
                break
            self.cutoff, wide, self.motions = half, narrower, slower
        self.judged = banded(held, self.joints, self.cutoff, wide, first=len(fitted))

    def _of_positions(self, cutoff_hz: float) -> float:
        """Cut-off of positions beside one of torque, Hz."""
        return position_cut_off_hz([*self.fitted, *self.held], self.joints, cutoff_hz)

    def run(self, excluded: Sequence[str], report: Progress) -> Comparison:
        """All layers."""
        report(0.05, "conventions and wiring")
        wired = find_wiring(self.simulation.model, self.wired_in, self.simulation.own)
        report(0.2, "searching for missing physics")
        base, corrected = self.simulation.model.model, self._corrected(self.fitted, wired)
        explanation = missing_physics(
            self.arm,
            base.structure,
            corrected,
            self._corrected(self.held, wired),
            excluded,
            lambda share, what: report(0.2 + 0.6 * share, what),
        )
        if explanation.verdict == DATA_UNFIT:
            return _unfit(self.arm, explanation.reasons)
        report(0.8, "fitting all layers together")
        self.judged = voided(self.judged, explanation.happened)
        if late := late_by(explanation):
            wired = wired.delayed(late)
            corrected = self._corrected(self.fitted, wired)
        chosen = identify(corrected, self.arm, Settings(cutoff_hz=self.cutoff)).model
        extended = explanation.model or wired.model.carried_to(base)
        rubbing = [kind_and_joint(name)[1] for name in wired.laws]
        whole = with_friction_terms(extended, base.structure, chosen, explanation.findings, rubbing)
        wired = find_wiring(whole, self.wired_in, self.simulation.own, wired)
        if LoadFriction.kind in excluded:
            wired = replace(wired, laws={})
        elif wired.laws:
            whole = wired.model
        laws = wired.laws
        found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        for _ in range(RELINEARISED if found.depends_on_itself else 0):
            whole = found.fitted
            found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        idle = found.idle_wiring(SHOWS)
        if idle:
            other = without_columns(whole, self.wired_in, self.simulation.own, wired, idle)
            wired = replace(other, laws=laws, doubted=wired.doubted)
            found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        added = [*added_terms(whole, base, explanation.findings), *friction_by_load(whole, laws)]
        optional = optional_terms(whole, base)
        report(0.9, "what a flexible function could remove")
        why = "which is within its error of none or lowers no held-out variance"
        lost = tuple(f"{_wiring_words(name)}, {why}" for name in idle)
        return self._answer(found, added, optional, explanation, wired, lost)

    def _corrected(self, recordings: Sequence[Recording], wired: Wired) -> list[Recording]:
        """Recordings without what their wiring is off by."""
        corrections = wired.wiring.corrections(self.joints)
        return [wired.wiring.without_tilt(corrections.applied(one), wired.model) for one in recordings]

    def _answer(
        self,
        found: JointFit,
        added: list[Added],
        optional: list[Added],
        explanation: Explanation,
        wired: Wired,
        idle: tuple[str, ...],
    ) -> Comparison:
        gain = found.wiring.gain
        simulated = self._as_simulated()
        stages = [found.simulated(), found.fit(with_terms=())]
        gone = _not_there(found, added, optional, wired)
        found.leave_out(gone)
        added = [one for one in added if one not in gone]
        named = found.clear(optional, added, SHOWS)
        unclear = [one for one in optional if one not in named]
        rest = found.predicting(unclear)
        found.leave_out([one for one in unclear if one not in rest])
        whole = found.fit(with_terms=[*added, *named, *rest])
        after = gain * found.judge.rms(whole)
        traces = found.traces(whole)
        rows = [trace.measured - trace.mended for trace in traces]
        white, slow = white_and_slow(found.judge.motions, rows, [np.isfinite(residual) for residual in rows])
        noise = np.fmin(after, explanation.noise_floor_Nm * gain)
        noise = np.where(slow > white, np.fmin(noise, white), noise)
        torque = gain * found.judge.rms(np.zeros(found.judge.count))
        shares = _Shares(found, gain, simulated, after, noise, torque)
        left = _rest_items(explanation, after, noise, slow > white, shares)
        unknown = {joint for item in left for joint in item.joints}
        part = [one for one in named if unknown & set(one.joints) and self._is_the_mean(one, found, after)]
        named, rest = [one for one in named if one not in part], [*rest, *part]
        order = found.order([*added, *named])
        stages += [found.fit(with_terms=order[: k + 1]) for k in range(len(order))]
        if rest:
            stages.append(whole)
        rms = [simulated, *(gain * found.judge.rms(values) for values in stages)]
        ceiling = found.ceiling(stages[1]) * gain
        items, lost, seen, notes, kept = self._parameter_items(found, shares, wired.open_factors)
        layers = (
            Layer(CONVENTIONS, rms[0], rms[1], self._wiring_items(found, shares), _suspicions(wired.suspected)),
            Layer(PARAMETERS, rms[1], rms[2], items, (*self.simulation.notes, *notes)),
            Layer(PHYSICS, rms[2], after, self._physics_items(found, order, rms, shares), _unnamed(rest, gone)),
            Layer(REST, after, noise, left),
        )
        mended = found.mended(self.cutoff, kept, SHOWS)
        return Comparison(
            joints=self.joints,
            layers=layers,
            before_Nm=simulated,
            after_Nm=after,
            torque_Nm=torque,
            noise_Nm=noise,
            ceiling_Nm=ceiling,
            mended_Nm=gain * found.judge.rms(found.with_model(mended)),
            model=mended,
            wiring=found.wiring,
            suspected=wired.suspected,
            explanation=_standing(explanation, gone),
            traces=traces,
            unconfirmed=(*idle, *lost, *(f"{one.effect} at {', '.join(one.joints)}" for one in gone)),
            would_have_seen=seen,
            judged_on=self.judged_on,
            cutoff_hz=self.cutoff,
        )

    def _is_the_mean(self, one: Added, found: JointFit, left: FloatArray) -> bool:
        """Whether a constant torque may be the mean of what is left (n,), N m, and follows nothing known."""
        size = abs(found.estimate.of(found.vector(one)))
        return one.effect == CurrentOffset.kind and size < STANDS_OUT * left[self.joints.index(one.joints[0])]

    def _as_simulated(self) -> FloatArray:
        """(n,) RMS residual of the simulation as it is, on the held-out recordings."""
        right = Wiring.right(len(self.joints))
        plain = Linear(self.simulation.model, self.judged, in_newton_metres(self.arm), right)
        return plain.rms(plain.start())

    def _wiring_items(self, found: JointFit, shares: _Shares) -> tuple[Item, ...]:
        items, undone = [], found.wiring.by_column(self.joints)
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
                    (joint,) if joint in self.joints else self.joints,
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
        return _by_share(items)

    def _parameter_items(
        self, found: JointFit, shares: _Shares, open_factors: Mapping[str, str]
    ) -> tuple[
        tuple[Item, ...], tuple[str, ...], tuple[Detectable, ...], tuple[str, ...], list[tuple[FloatArray, float]]
    ]:
        """Of the parameters.

        Args:
            found: The joint fit.
            shares: What an item is worth.
            open_factors: As of `Wired`.

        Returns:
            What differs and is confirmed; names of what is not confirmed; what agrees; what may differ, in words; and
            combinations (P,) that keep a value.
        """
        known = determined(found.linear, found.estimate, found.prior, self.simulation)
        simple, others = few_causes(known, found.linear, found.estimate, self.simulation)
        changed, same = changes(known, found.estimate)
        either = self._by_a_factor(changed, open_factors)
        changed = tuple(one for one in changed if one not in either)
        open_joints = dict.fromkeys(one.joints[0] for one in either)
        by_gain = [joint for joint in open_joints if kind_and_joint(open_factors[joint])[0] == GAIN]
        rotor = self.simulation.word(ARMATURE)
        items = [
            one for one in _cause_items(simple, found, shares) if one.name != rotor or one.joints[0] not in by_gain
        ]
        # Also what is not of the same size in the held-out recordings: they are predicted worse without.
        differing = set[tuple[str, str]]()
        for change in changed:
            if not simple or not change.of_bodies:
                rise = shares.rise(shares.back(change.vector, change.was))
                if rise > SHOWS:
                    items.append(self._change_item(change, found, shares))
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
            for one in combinations(found.linear, self.simulation)
            if (one.name, one.where) not in differing
        ]
        return _by_share(items), lost, seen, notes, kept

    def _by_a_factor(self, changed: Sequence[Change], joints: Container[str]) -> list[Change]:
        """Changes of friction and of damping at those of some joints where both differ."""
        words = {self.simulation.word(symbol) for symbol in (FRICTION, DAMPING)}
        own = [one for one in changed if one.name in words and one.joints[0] in joints]
        both = {one.joints for one in own if {other.name for other in own if other.joints == one.joints} == words}
        return [one for one in own if one.joints in both]

    def _change_item(self, change: Change, found: JointFit, shares: _Shares) -> Item:
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
            combination_of(change, found.linear, self.simulation),
        )

    def _physics_items(
        self, found: JointFit, order: Sequence[Added], rms: Sequence[FloatArray], shares: _Shares
    ) -> tuple[Item, ...]:
        items = []
        for number, one in enumerate(order):
            drop = shares.of_variance(rms[2 + number] ** 2 - rms[3 + number] ** 2)
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


def _not_there(found: JointFit, added: Sequence[Added], optional: Sequence[Added], wired: Wired) -> list[Added]:
    """Effects that are of no size, not needed though nothing else is sure of them, or of another size in held-out data.

    Args:
        found: The joint fit.
        added: Effects that were found.
        optional: All other physics of the model.
        wired: Whose `laws` some of the effects are.
    """
    gone = [one for one in added if _of_no_size(one, found)]
    doubted = {int(law.columns[0]) for law in friction_by_load(found.linear.model, wired.doubted)}
    unsure = [one for one in added if one.finding is None and int(one.columns[0]) in doubted and one not in gone]
    gone += [one for one in unsure if not found.needs(one, [*added, *optional], LAW_SHOWS)]
    return gone + found.contradicted([one for one in added if one not in gone], [*optional, *gone], SHOWS)


def _of_no_size(one: Added, found: JointFit) -> bool:
    """Whether the 95 % interval of an effect's size, the first value of its card or the joint fit's, holds zero.

    A touch's force and its lever are one torque, which may be plain where neither of the two is.
    """
    if one.effect == ExternalContact.kind:
        return False
    if one.effect == LoadFriction.kind:
        low, high = found.estimate.interval(found.vector(one))
        return low <= 0.0 <= high
    size = None if one.finding is None else next(iter(one.finding.parameters.values()), None)
    return size is not None and size.low <= 0.0 <= size.high


def _cause_items(simple: Sequence[Explained], found: JointFit, shares: _Shares) -> list[Item]:
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


class _Shares:
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
        self._found, self._gain, self._after = found, gain, after
        self._unit = np.where(torque > 0.0, torque, np.nan) ** -2.0
        self._whole = float(np.nansum(np.maximum(simulated**2 - noise**2, 0.0) * self._unit))

    def of_variance(self, variance: FloatArray) -> float:
        """Of variances (n,), N^2 m^2; NaN where the simulation leaves no more than noise."""
        return float(np.nansum(variance * self._unit)) / self._whole if self._whole > 0.0 else float("nan")

    def without(self, vector: FloatArray, was: float) -> float:
        """With one combination as in the simulation."""
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


def _by_share(items: Sequence[Item]) -> tuple[Item, ...]:
    """Largest share first; those without one before all."""
    return tuple(sorted(items, key=lambda one: -np.nan_to_num(one.share, nan=np.inf)))


def _standing(explanation: Explanation, gone: Sequence[Added]) -> Explanation:
    """The search's answer without the findings that another recording does not show."""
    lost = [one.finding for one in gone]
    return replace(explanation, findings=tuple(one for one in explanation.findings if one not in lost))


def _suspicions(suspected: Sequence[Suspicion]) -> tuple[str, ...]:
    """What may be off and was not undone, in words."""
    return tuple(
        f"suspected, {one.probability:.0%}: "
        + ", ".join(f"{_wiring_words(name)} {value:.3g}" for name, value in zip(one.names, one.values))
        + "; statistically indistinguishable from links of another mass, and therefore not corrected"
        for one in suspected
    )


def _either(joint: str, gain: bool) -> str:
    """That a joint's friction and damping differ, or another thing does."""
    own = "friction, damping and rotor inertia" if gain else "friction and damping"
    what = "its torque gain" if gain else "friction that grows with its load"
    return f"torque does not tell whether {own} of {joint} differ by one factor, or it is {what}"


def _wiring_words(name: str) -> str:
    kind, joint = kind_and_joint(name)
    return {
        GAIN: f"torque gain of {joint}",
        ZERO: f"encoder zero of {joint} (rad)",
        DELAY: "delay of torque (s)",
        TILT: f"tilt of the base about its {joint} axis (rad)",
    }[kind]


def _unnamed(small: Sequence[Added], gone: Sequence[Added]) -> tuple[str, ...]:
    """What is in the model and too small to be named, and what was found and not found again."""
    notes = []
    if small:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in small)
        notes.append(f"in the model since it predicts held-out data better, but not clear enough to be named: {words}")
    if gone:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in gone)
        notes.append(f"found in the fit, but not replicated or of a size that may be zero, and left out: {words}")
    return tuple(notes)


def _rest_items(
    explanation: Explanation, after: FloatArray, noise: FloatArray, slow: np.ndarray, shares: _Shares
) -> tuple[Item, ...]:
    """What is left, and what it depends on as far as the search can say; `slow` (n,): more than the noise is slow."""
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
    return _by_share(items)


def _left_at(
    rows: Sequence[int],
    joints: tuple[str, ...],
    where: str,
    after: FloatArray,
    noise: FloatArray,
    shares: _Shares,
) -> Item:
    largest = float(np.max(after[rows]))
    share = shares.of_variance(np.where(np.isin(np.arange(len(joints)), rows), after**2 - noise**2, 0.0))
    nothing = float("nan")
    return Item(UNKNOWN, tuple(joints[k] for k in rows), where, nothing, largest, nothing, nothing, "N m RMS", share)
