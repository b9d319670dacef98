"""Compare a simulation with recordings of the arm, layer by layer.

1. What the simulation predicts of the held-out recordings, as it is.
2. Conventions and wiring: signs, order, units (`conventions.search`), then gains, zeros, delay and tilt
   (`conventions.py`).
3. The catalogue's search for physics beside the simulation's own terms, on corrected recordings. Torque that is late
   at all joints is fitted there as well: beside a touch or backlash it need not have been found before.
4. Gains, zeros, delay and tilt again, beside the physics: what looked like a gain may have been an effect. Then one
   joint fit of wiring, parameters and physics. Layers are nested sets of its unknowns; each is judged on the
   held-out recordings. Items are read off the whole fit, with errors that hold where the residual is model error, and
   estimated again on the held-out recordings by themselves: that is whether they replicate.
5. What a flexible function of the same inputs could still remove.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.effects.body import ExternalContact
from ..dynamics.effects.drive import CurrentOffset
from ..dynamics.effects.friction import LoadFriction
from ..dynamics.model import IdentifiedModel
from ..errors import UnfitDataError
from ..identification.identify import Settings, identify
from ..mismatch.explain import held_out_ends
from ..mismatch.finding import DATA_UNFIT, Explanation
from ..mismatch.happened import voided
from ..mismatch.integrity import faults
from ..mismatch.preparation import banded, cut_off_hz, position_cut_off_hz
from ..noise.slow import white_and_slow
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..simulations import Simulation
from .comparison import Comparison, Trace
from .conventions import Wired, find_wiring, without_columns
from .events import with_events_earlier, without_events
from .item import CONVENTIONS, PARAMETERS, PHYSICS, REST, Layer
from .itemise import (
    SHOWS,
    Shares,
    not_named,
    parameter_items,
    physics_items,
    rest_items,
    suspicions,
    wiring_items,
    wiring_words,
)
from .joint_fit import JointFit, in_newton_metres
from .linear import Linear
from .physics import Added, added_terms, friction_by_load, missing_physics, optional_terms, with_friction_terms
from .wiring import Wiring, kind_and_joint

Progress = Callable[[float, str], None]
LAW_SHOWS = 0.1
"""As `SHOWS`, for friction by the load that is not as sure as other physics (`Wired.doubted`): 5 % of the RMS, by which
friction laws are off (`mismatch.intervals.LAW_ERROR`)."""
STANDS_OUT = 3.0
"""Times what is left at a joint, where that follows nothing known, from which a constant torque is not its mean."""
RELINEARISED = 2
"""Times that everything is fitted again around its values, where physics depends on them: friction by the load grows
with what the other terms and itself add up to, and the search fitted constants beside other values."""
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
        chosen = identify(corrected, self.arm, Settings(cutoff_hz=self.cutoff)).model
        extended = explanation.model or wired.model.carried_to(base)
        rubbing = [kind_and_joint(name)[1] for name in wired.laws]
        whole = with_friction_terms(extended, base.structure, chosen, explanation.findings, rubbing)
        self.motions, self.wired_in = (without_events(motions, whole) for motions in (self.motions, self.wired_in))
        before, wired = wired, find_wiring(whole, self.wired_in, self.simulation.own, wired)
        if LoadFriction.kind in excluded:
            wired = replace(wired, laws={})
        whole = wired.model if wired.laws else _moved(whole, before, wired)
        laws = wired.laws
        found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        for _ in range(RELINEARISED if found.depends_on_itself else 0):
            whole = found.fitted
            found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        idle = found.idle_wiring(SHOWS)
        if idle:
            other = without_columns(whole, self.wired_in, self.simulation.own, wired, idle)
            whole, wired = _moved(whole, wired, other), replace(other, laws=laws, doubted=wired.doubted)
            found = JointFit(self.simulation, whole, wired, self.motions, self.judged)
        added = [*added_terms(whole, base, explanation.findings), *friction_by_load(whole, laws)]
        optional = optional_terms(whole, base)
        report(0.9, "what a flexible function could remove")
        why = "which is within its error of none or lowers no held-out variance"
        lost = tuple(f"{wiring_words(name)}, {why}" for name in idle)
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
        named, rest = _of_optional(found, added, optional)
        whole = found.fit(with_terms=[*added, *named, *rest])
        after, traces = gain * found.judge.rms(whole), found.traces(whole)
        noise, is_slow = _noise(found, traces, np.fmin(after, explanation.noise_floor_Nm * gain))
        torque = gain * found.judge.rms(np.zeros(found.judge.count))
        shares = Shares(found, gain, simulated, after, noise, torque)
        left = rest_items(explanation, after, noise, is_slow, shares)
        unknown = {joint for item in left for joint in item.joints}
        part = [one for one in named if unknown & set(one.joints) and self._is_the_mean(one, found, after)]
        named, rest = [one for one in named if one not in part], [*rest, *part]
        order = found.order([*added, *named])
        stages += [found.fit(with_terms=order[: k + 1]) for k in range(len(order))]
        if rest:
            stages.append(whole)
        rms = [simulated, *(gain * found.judge.rms(values) for values in stages)]
        ceiling = found.ceiling(stages[1]) * gain
        of_parameters = parameter_items(found, shares, wired.open_factors)
        layers = (
            Layer(CONVENTIONS, rms[0], rms[1], wiring_items(found, shares), suspicions(wired.suspected)),
            Layer(PARAMETERS, rms[1], rms[2], of_parameters.items, (*self.simulation.notes, *of_parameters.notes)),
            Layer(PHYSICS, rms[2], after, physics_items(found, order, rms[2:], shares), not_named(rest, gone)),
            Layer(REST, after, noise, left),
        )
        mended = found.mended(self.cutoff, of_parameters.kept, SHOWS)
        as_mended = found.beside(mended)
        return Comparison(
            joints=self.joints,
            layers=layers,
            before_Nm=simulated,
            after_Nm=after,
            torque_Nm=torque,
            noise_Nm=noise,
            ceiling_Nm=ceiling,
            mended_Nm=gain * found.judge.rms(as_mended),
            model=mended,
            wiring=found.wiring_of(as_mended),
            suspected=wired.suspected,
            explanation=_standing(explanation, gone),
            traces=traces,
            unconfirmed=(*idle, *of_parameters.lost, *(f"{one.effect} at {', '.join(one.joints)}" for one in gone)),
            would_have_seen=of_parameters.seen,
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


def _moved(model: IdentifiedModel, before: Wired, after: Wired) -> IdentifiedModel:
    """A model with its events when they are beside another delay."""
    return with_events_earlier(model, after.wiring.delay_s - before.wiring.delay_s)


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


def _of_optional(found: JointFit, added: Sequence[Added], optional: Sequence[Added]) -> tuple[list[Added], list[Added]]:
    """Friction terms that are clear enough to be named, and those that only predict better; others leave the fit."""
    named = found.clear(optional, added, SHOWS)
    unclear = [one for one in optional if one not in named]
    predicting = found.predicting(unclear)
    found.leave_out([one for one in unclear if one not in predicting])
    return named, predicting


def _noise(found: JointFit, traces: Sequence[Trace], most: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """(n,) RMS of the noise in what is left, N m, no more than `most`, and (n,) whether more than that is slow."""
    rows = [trace.measured - trace.mended for trace in traces]
    white, slow = white_and_slow(found.judge.motions, rows, found.in_full())
    return np.where(slow > white, np.fmin(most, white), most), slow > white


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


def _standing(explanation: Explanation, gone: Sequence[Added]) -> Explanation:
    """The search's answer without the findings that another recording does not show."""
    lost = [one.finding for one in gone]
    return replace(explanation, findings=tuple(one for one in explanation.findings if one not in lost))
