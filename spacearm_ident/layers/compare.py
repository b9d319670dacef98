"""Compare a simulation with recordings of the arm, layer by layer.

1. What the simulation predicts of the held-out recordings, as it is.
2. Conventions and wiring: signs, order, units (`conventions.search`), then gains, zeros and delay (`conventions.py`).
3. The catalogue's search for physics beside the simulation's own terms, on corrected recordings.
4. Gains, zeros and delay again, beside the physics: what looked like a gain may have been an effect. Then one joint
   fit of wiring, parameters and physics. Layers are nested sets of its unknowns; each is judged on the
   held-out recordings. Items are read off the whole fit, with errors that hold where the residual is model error, and
   estimated again on the held-out recordings by themselves: that is whether they replicate.
5. What a flexible function of the same inputs could still remove.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..errors import UnfitDataError
from ..identification.consistency import make_consistent
from ..identification.held_out import folds_of, predicts_better
from ..identification.identify import Settings, identify
from ..identification.prior import make_prior
from ..mismatch.finding import DATA_UNFIT, Explanation
from ..mismatch.integrity import faults
from ..mismatch.noise import Noise, weighted
from ..mismatch.preparation import CUTOFF_HZ, WIDER, banded
from ..mismatch.rivals import UNKNOWN
from ..mismatch.scene import Whitener, one_way
from ..recording.recording import Recording
from ..simulations import Simulation
from .ceiling import black_box, inputs_of
from .conventions import Suspicion, Wired, find_wiring
from .estimate import Estimate, estimate
from .item import CONVENTIONS, PARAMETERS, PHYSICS, REST, Item, Layer
from .linear import DELAY, GAIN, ZERO, Linear, Prior, weak_prior
from .parameters import LEVEL, Change, Explained, changes, combination_of, few_causes
from .physics import Added, added_terms, missing_physics, optional_terms, with_friction_terms
from .wiring import Wiring

Progress = Callable[[float, str], None]
HOLD_OUT = 0.35
"""Share of every recording that is held out where no recording is given to judge on."""
AGREE = 2.58
"""Standard errors of the difference (99 %) within which two estimates of the same thing agree."""
WORDS = {GAIN: "effort_gain", ZERO: "encoder_zero", DELAY: "delay"}
UNITS = {GAIN: "1", ZERO: "rad", DELAY: "s"}


@dataclass(frozen=True)
class Trace:
    """Torque of one held-out motion, for figures: rows of the bandwidth looked at, N m, NaN where no row counts.

    Attributes:
        time: (M,) s.
        measured, simulated, mended: (M, n).
    """

    time: FloatArray
    measured: FloatArray
    simulated: FloatArray
    mended: FloatArray


@dataclass(frozen=True)
class Detectable:
    """The smallest change of something that would have been named."""

    name: str
    joints: tuple[str, ...]
    size: float
    unit: str


@dataclass(frozen=True)
class Comparison:
    """The whole answer.

    Attributes:
        joints: Names.
        layers: The four, in order.
        before_Nm, after_Nm: (n,) residual RMS on held-out recordings of the simulation as it is, and with all layers.
        torque_Nm: (n,) RMS of the measured torque there.
        noise_Nm: (n,) noise floor: what is left that nothing tried explains, at most.
        ceiling_Nm: (n,) what a flexible function of the same inputs leaves beside the simulation's own terms, refitted.
        model: The mended simulation with the physics it lacked.
        wiring: What recordings are off by.
        suspected: What else may be off.
        explanation: The search for physics, with its cards.
        traces: For figures.
        unconfirmed: Names of what was found and the held-out recordings by themselves do not show; not among items.
        would_have_seen: Of what was looked at and not named, the smallest size that would have been.
        judged_on: In words, what the residuals are on.
        cutoff_hz: Bandwidth that was looked at.
        reasons: Why the data are unfit; empty where they are not.
    """

    joints: tuple[str, ...]
    layers: tuple[Layer, ...]
    before_Nm: FloatArray
    after_Nm: FloatArray
    torque_Nm: FloatArray
    noise_Nm: FloatArray
    ceiling_Nm: FloatArray
    model: IdentifiedModel | None
    wiring: Wiring
    suspected: tuple[Suspicion, ...]
    explanation: Explanation | None
    traces: tuple[Trace, ...] = ()
    unconfirmed: tuple[str, ...] = ()
    would_have_seen: tuple[Detectable, ...] = ()
    judged_on: str = ""
    cutoff_hz: float = float("nan")
    reasons: tuple[str, ...] = field(default=())

    @property
    def fit(self) -> bool:
        """Whether the data can carry the question."""
        return not self.reasons

    @property
    def headline(self) -> str:
        """The answer in one line."""
        if not self.fit:
            return f"data unfit: {'; '.join(self.reasons)}"
        counted = [f"{len(layer.items)} of {layer.name}" for layer in self.layers[:3] if layer.items]
        with np.errstate(invalid="ignore", divide="ignore"):
            before, after = (float(np.nanmedian(rms / self.torque_Nm)) for rms in (self.before_Nm, self.after_Nm))
        what = ", ".join(counted) or "nothing beyond its error"
        return f"simulation against arm: {what}; residual {before:.0%} -> {after:.1%} of the torque (median joint)"


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
    fitted, held, judged_on = _split(fitted, held)
    if broken := faults([*fitted, *held], arm.joint_names):
        return _unfit(arm, tuple(broken))
    try:
        return _Pass(simulation, fitted, held, judged_on).run(excluded, report)
    except UnfitDataError as error:
        return _unfit(arm, (str(error),))
    except np.linalg.LinAlgError:
        return _unfit(arm, ("the data do not determine the simulation's terms: record a motion of all joints",))


def _split(fitted: Sequence[Recording], held: Sequence[Recording]) -> tuple[list[Recording], list[Recording], str]:
    if held:
        return list(fitted), list(held), "held-out recordings"
    first, last = [], []
    for recording in fitted:
        cut = recording.time[-1] - HOLD_OUT * (recording.time[-1] - recording.time[0])
        first.append(recording.between(-np.inf, cut))
        last.append(recording.between(cut, np.inf))
    return first, last, "the last third of each recording, held out of the fit"


def _unfit(arm: Arm, reasons: tuple[str, ...]) -> Comparison:
    nothing = np.full(len(arm.joints), np.nan)
    right = Wiring.right(len(arm.joints))
    return Comparison(
        arm.joint_names, (), nothing, nothing, nothing, nothing, nothing, None, right, (), None, reasons=reasons
    )


class _Pass:
    """One comparison: recordings, motions, and the problems built on them."""

    def __init__(self, simulation: Simulation, fitted: list[Recording], held: list[Recording], judged_on: str) -> None:
        self.simulation, self.fitted, self.held, self.judged_on = simulation, fitted, held, judged_on
        self.arm, self.joints = simulation.arm, simulation.arm.joint_names
        rate = min(recording.rate_hz for recording in [*fitted, *held])
        self.cutoff = min(CUTOFF_HZ, 0.2 * rate)
        wide = min(WIDER * self.cutoff, 0.35 * rate)
        self.motions = banded(fitted, self.joints, self.cutoff, wide)
        self.judged = banded(held, self.joints, self.cutoff, wide)

    def run(self, excluded: Sequence[str], report: Progress) -> Comparison:
        """All layers."""
        report(0.05, "conventions and wiring")
        wired = find_wiring(self.simulation.model, self.motions)
        report(0.2, "searching for missing physics")
        corrections = wired.wiring.corrections(self.joints)
        explanation = missing_physics(
            self.arm,
            self.simulation.model.model.structure,
            [corrections.applied(recording) for recording in self.fitted],
            [corrections.applied(recording) for recording in self.held],
            excluded,
            lambda share, what: report(0.2 + 0.6 * share, what),
        )
        if explanation.verdict == DATA_UNFIT:
            return _unfit(self.arm, explanation.reasons)
        report(0.8, "fitting all layers together")
        base = self.simulation.model.model
        corrected = [corrections.applied(recording) for recording in self.fitted]
        chosen = identify(corrected, self.arm, Settings(cutoff_hz=self.cutoff)).model
        extended = explanation.model or wired.model
        whole = with_friction_terms(extended, base.structure, chosen, explanation.findings)
        wired = find_wiring(whole, self.motions, wired)
        found = _Joint(self, whole, wired)
        added = added_terms(whole, base, explanation.findings)
        optional = optional_terms(whole, base)
        report(0.9, "what a flexible function could remove")
        return self._answer(found, added, optional, explanation, wired.suspected)

    def _answer(
        self,
        found: _Joint,
        added: list[Added],
        optional: list[Added],
        explanation: Explanation,
        suspected: tuple[Suspicion, ...],
    ) -> Comparison:
        gain = found.wiring.gain
        simulated = self._as_simulated()
        stages = [found.simulated(), found.fit(with_terms=())]
        gone = [one for one in added if found.replicates(found.vector(one), 0.0) is False]
        found.leave_out(gone)
        added = [one for one in added if one not in gone]
        named = found.clear(optional)
        rest = [one for one in optional if one not in named]
        if rest and not found.predicted_better_with(rest):
            found.leave_out(rest)
            rest = []
        order = found.order([*added, *named])
        stages += [found.fit(with_terms=order[: k + 1]) for k in range(len(order))]
        if rest:
            stages.append(found.fit(with_terms=[*order, *rest]))
        rms = [simulated, *(gain * found.judge.rms(values) for values in stages)]
        after = rms[-1]
        noise = np.fmin(after, explanation.noise_floor_Nm * gain)
        above = np.maximum(simulated**2 - noise**2, 1e-12)
        ceiling = found.ceiling(stages[1]) * gain
        shares = _Shares(found, above, gain, after)
        items, lost, seen = self._parameter_items(found, shares)
        layers = (
            Layer(CONVENTIONS, rms[0], rms[1], self._wiring_items(found, shares), _suspicions(suspected)),
            Layer(PARAMETERS, rms[1], rms[2], items, self.simulation.notes),
            Layer(PHYSICS, rms[2], after, self._physics_items(found, order, rms, above), _unnamed(rest, gone)),
            Layer(REST, after, noise, _rest_items(explanation, after, noise, above)),
        )
        traces = found.traces(stages[-1])
        torque = gain * found.judge.rms(np.zeros(found.judge.count))
        return Comparison(
            joints=self.joints,
            layers=layers,
            before_Nm=simulated,
            after_Nm=after,
            torque_Nm=torque,
            noise_Nm=noise,
            ceiling_Nm=ceiling,
            model=found.mended(),
            wiring=found.wiring,
            suspected=suspected,
            explanation=_standing(explanation, gone),
            traces=traces,
            unconfirmed=(*lost, *(f"{one.effect} at {', '.join(one.joints)}" for one in gone)),
            would_have_seen=seen,
            judged_on=self.judged_on,
            cutoff_hz=self.cutoff,
        )

    def _as_simulated(self) -> FloatArray:
        """(n,) RMS residual of the simulation as it is, on the held-out recordings."""
        unit = [Whitener(np.zeros(0), 1.0)] * len(self.joints)
        plain = Linear(self.simulation.model, self.judged, unit, Wiring.right(len(self.joints)))
        return plain.rms(plain.start())

    def _wiring_items(self, found: _Joint, shares: _Shares) -> tuple[Item, ...]:
        items = []
        for name in found.names:
            kind, joint = name.split("[")[0], name[:-1].partition("[")[2]
            vector = np.zeros(found.linear.count)
            vector[found.linear.names.index(name)] = 1.0
            low, high = found.estimate.interval(vector)
            now = found.wiring_value(name)
            value, low, high = (now + off for off in (found.estimate.of(vector), low, high))
            was = 0.0
            if kind == GAIN:
                value, low, high, was = float(np.exp(value)), float(np.exp(low)), float(np.exp(high)), 1.0
            items.append(
                Item(
                    WORDS[kind],
                    (joint,) if joint else self.joints,
                    joint or "all joints",
                    was,
                    value,
                    low,
                    high,
                    UNITS[kind],
                    shares.without(vector, -now),
                    found.replicates(vector, -now),
                )
            )
        return tuple(sorted(items, key=lambda one: -one.share))

    def _parameter_items(
        self, found: _Joint, shares: _Shares
    ) -> tuple[tuple[Item, ...], tuple[str, ...], tuple[Detectable, ...]]:
        """What differs and is confirmed, names of what is not confirmed, and what agrees."""
        simple = few_causes(found.linear, found.estimate, found.prior, self.simulation)
        changed, same = changes(found.linear, found.estimate, found.prior, self.simulation)
        items = [] if simple is None else _cause_items(simple, found, shares)
        for change in changed:
            if simple is not None and change.unit in ("kg", "kg m", "kg m^2"):
                continue
            items.append(self._change_item(change, found, shares))
        lost = tuple(f"{item.name} of {item.where}" for item in items if item.replicated is False)
        items = [item for item in items if item.replicated is not False]
        seen = tuple(Detectable(one.name, one.joints, size, one.unit) for one, size in same)
        return tuple(sorted(items, key=lambda one: -np.nan_to_num(one.share, nan=np.inf))), lost, seen

    def _change_item(self, change: Change, found: _Joint, shares: _Shares) -> Item:
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
        self, found: _Joint, order: Sequence[Added], rms: Sequence[FloatArray], above: FloatArray
    ) -> tuple[Item, ...]:
        items = []
        for number, one in enumerate(order):
            drop = float(np.mean((rms[2 + number] ** 2 - rms[3 + number] ** 2) / above))
            vector = found.vector(one)
            card = {} if one.finding is None else one.finding.parameters
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
                )
            )
        return tuple(items)


def _cause_items(simple: Explained, found: _Joint, shares: _Shares) -> list[Item]:
    """Causes as items; a centre of mass has one for each axis."""
    simulation, items = found.run.simulation, []
    names = list(found.linear.names)
    model = TorqueModel(found.run.arm, {"rigid_body": {}, "rotor_inertia": {}})
    places = [names.index(parameter.name) for parameter in model.parameters]
    half = float(norm.ppf(0.975))
    for cause, values, errors in zip(simple.causes, simple.values, simple.errors):
        joint = found.run.joints.index(cause.joint)
        inertial, body = cause.inertial, cause.body
        without = found.estimate.values.copy()
        without[places] -= cause.directions @ values
        share = shares.of(without)
        for axis, (change, error) in enumerate(zip(values, errors)):
            if cause.name == "mass":
                was, name, where, key = float(inertial[0]), "mass", f"mass of {body}", f"{body}.mass"
            elif cause.name == "armature":
                numbers = found.simulated()
                was = float(numbers[places[10 * len(found.run.joints) + joint]])
                name, where, key = simulation.word("J_m"), cause.joint, f"{cause.joint}.armature"
            else:
                was = float(inertial[1 + axis] / inertial[0])
                name, where, key = f"centre_of_mass_{'xyz'[axis]}", f"centre of mass of {body} along {'xyz'[axis]}", ""
            low, high = was + change - half * error, was + change + half * error
            items.append(
                Item(
                    name,
                    (cause.joint,),
                    where,
                    was,
                    was + float(change),
                    float(low),
                    float(high),
                    cause.unit,
                    share,
                    None,
                    {key: 1.0} if key else {},
                )
            )
    return items


class _Joint:
    """The last joint fit: wiring, parameters and physics, and nested fits of less."""

    def __init__(self, run: _Pass, model: IdentifiedModel, wired: Wired) -> None:
        wiring = wired.wiring
        self.wiring, self.names, self.run = wiring, wired.found, run
        self._errors = dict(zip(wired.found, wired.errors))
        undone = wiring.undone(run.motions)
        noise = weighted(model, undone)
        unit = [Whitener(np.zeros(0), 1.0)] * len(run.joints)
        self.linear = Linear(model, run.motions, noise.whiteners, wiring)
        self.judge = Linear(model, run.judged, unit, wiring)
        self.again = Linear(model, run.judged, noise.whiteners, wiring)
        self.base = run.simulation.model.model
        self._known = {p.name for p, own in zip(self.base.parameters, _has_values(self.base)) if own}
        self._gone: set[int] = set()
        self._variance(noise)
        self._settle()

    def _variance(self, noise: Noise) -> None:
        """What each joint's residual says of its variance, beside what its rows count for."""
        self.prior = self._prior(None)
        first = self.linear.solve(self.prior, np.ones(len(self.run.joints)))
        rows = self.linear.rows.sum(axis=1)
        share = np.array([(f / w.sigma_Nm) ** 2 for f, w in zip(noise.floor_Nm, noise.whiteners)])
        counts = np.where(np.isfinite(share), rows * share, 0.0)
        left = self.linear.squares(first.values).sum(axis=1)
        self.variance: FloatArray = np.where(counts > 0, left / np.maximum(counts, 1e-9), 1.0).clip(1e-3, 10.0)

    def _settle(self) -> None:
        """Solve for everything, here and in the held-out recordings by themselves."""
        self.prior = self._prior(None)
        self.estimate = estimate(self.linear, self.prior, self.variance)
        try:
            self._there: Estimate | None = estimate(self.again, self._prior(None, self.again), self.variance)
        except np.linalg.LinAlgError:
            self._there = None

    def _prior(self, terms: Sequence[np.ndarray] | None, linear: Linear | None = None) -> Prior:
        """Everything free that is in the layers so far; `terms` of None: all physics."""
        linear = linear or self.linear
        prior = weak_prior(linear)
        free, mean = prior.free.copy(), prior.mean.copy()
        precision = prior.precision.copy()
        kept = set() if terms is None else {int(k) for columns in terms for k in columns}
        names = {name: number for number, name in enumerate(linear.names)}
        for number, parameter in enumerate(linear.model.model.parameters):
            left_in = (terms is None or number in kept) and number not in self._gone
            if parameter.name in self._known or left_in:
                continue
            if parameter.symbol == "f_b" and free[number]:
                _tie(precision, number, names[f"f_c[{parameter.joint}]"])
            else:
                free[number], mean[number] = False, 0.0
        for number, name in enumerate(linear.names):
            if name in self.names:
                free[number], mean[number] = True, 0.0
                # The weak prior of an identification would let a gain be a heavier link.
                precision[number, number] = 1.0 / self._errors[name] ** 2
        return Prior(mean, precision, free)

    def leave_out(self, terms: Sequence[Added]) -> None:
        """Take physics out of the model for good."""
        if terms:
            self._gone |= {int(number) for one in terms for number in one.columns}
            self._settle()

    def predicted_better_with(self, terms: Sequence[Added]) -> bool:
        """Whether held-out parts of the fitted recordings are predicted better with some physics, beyond chance."""
        numbers = [int(number) for one in terms for number in one.columns]
        others = [np.array([k]) for k in range(len(self.linear.model.parameters)) if k not in numbers]
        squares = []
        for prior in (self._prior(others), self._prior(None)):
            left = np.zeros((self.linear.blocks, len(self.run.joints)))
            for fold in folds_of(self.linear.recording):
                rest = np.setdiff1d(np.arange(self.linear.blocks), fold)
                values = self.linear.solve(prior, self.variance, rest).values
                left[fold] = self.linear.squares(values)[:, fold].T
            squares.append(left)
        return predicts_better(*squares)

    def clear(self, terms: Sequence[Added]) -> list[Added]:
        """Friction terms whose values exceed their errors and are the same in the held-out recordings.

        The others stay in the model, where they predict better, and are not named.
        """
        bound = float(norm.ppf(1 - LEVEL / 2 / max(len(terms), 1)))
        vectors = [self.vector(one) for one in terms]
        return [
            one
            for one, vector in zip(terms, vectors)
            if abs(self.estimate.of(vector)) > bound * self.estimate.error(vector)
            and self.replicates(vector, 0.0) is not False
        ]

    def vector(self, one: Added) -> FloatArray:
        """(P,) which unknown says how large an effect is: its largest parameter; what a static level is above."""
        vector = np.zeros(self.linear.count)
        largest = int(one.columns[int(np.argmax(np.abs(self.estimate.values[one.columns])))])
        vector[largest] = 1.0
        parameter = self.linear.model.model.parameters[largest]
        if parameter.symbol == "f_b":
            vector[self.linear.names.index(f"f_c[{parameter.joint}]")] = -1.0
        return vector

    def unit(self, one: Added) -> str:
        """Of what `vector` says."""
        return self.linear.model.model.parameters[int(one.columns[0])].unit

    def wiring_value(self, name: str) -> float:
        """What is undone of a column: the logarithm of a gain, a zero, a delay."""
        kind, joint = name.split("[")[0], name[:-1].partition("[")[2]
        if kind == DELAY:
            return self.wiring.delay_s
        row = self.run.joints.index(joint)
        return float(np.log(self.wiring.gain[row])) if kind == GAIN else float(self.wiring.zero_rad[row])

    def simulated(self) -> FloatArray:
        """(P,) the simulation's own values, wiring undone."""
        values = np.zeros(self.linear.count)
        was = {p.name: float(v) for p, v in zip(self.base.parameters, self.run.simulation.model.parameters)}
        for number, name in enumerate(self.linear.names):
            values[number] = was.get(name, 0.0)
        return values

    def fit(self, with_terms: Sequence[Added]) -> FloatArray:
        """(P,) wiring and parameters fitted, with some of the physics."""
        prior = self._prior([one.columns for one in with_terms])
        return self.linear.solve(prior, self.variance).values

    def order(self, added: Sequence[Added]) -> list[Added]:
        """Physics in the order of what each removes beside those before."""
        left, ordered = list(added), list[Added]()
        while left:
            squares = [
                np.sum(np.log(np.maximum(self.linear.squares(self.fit([*ordered, one])).sum(axis=1), 1e-12)))
                for one in left
            ]
            ordered.append(left.pop(int(np.argmin(squares))))
        return ordered

    def replicates(self, vector: FloatArray, was: float) -> bool | None:
        """Whether the held-out recordings by themselves say the same; None: they cannot say."""
        if self._there is None:
            return None
        here, there = self.estimate.of(vector), self._there.of(vector)
        error = float(np.hypot(self.estimate.error(vector), self._there.error(vector)))
        if self._there.error(vector) > abs(here - was):
            return None
        return bool(abs(here - there) < AGREE * error and (here - was) * (there - was) > 0)

    def ceiling(self, values: FloatArray) -> FloatArray:
        """(n,) RMS that a flexible function leaves beside the simulation's terms with values (P,), held out."""
        here, there = (self._residuals(linear, values) for linear in (self.linear, self.judge))
        counts = [[one_way(motion) for motion in linear.motions] for linear in (self.linear, self.judge)]
        inputs = [inputs_of(linear.motions, kept) for linear, kept in zip((self.linear, self.judge), counts)]
        left = there - black_box(inputs[0], here, inputs[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt((left**2 * inputs[1].counts).sum(axis=0) / inputs[1].counts.sum(axis=0)))

    def _residuals(self, linear: Linear, values: FloatArray) -> FloatArray:
        """(M, n) measured minus what the simulation's own terms predict, all motions one after the other, N m."""
        known = dict(zip(linear.names, values.tolist()))
        simulated = self.run.simulation.model
        own = np.array([known.get(parameter.name, 0.0) for parameter in self.base.parameters])
        model = replace(simulated, parameters=own)
        return np.concatenate([motion.torque_rows - motion.reduce(model.torque(motion)) for motion in linear.motions])

    def traces(self, values: FloatArray) -> tuple[Trace, ...]:
        """Held-out torque for figures."""
        count = len(self.judge.model.model.parameters)
        mended = replace(self.judge.model, parameters=values[:count])
        gain, made = self.wiring.gain, []
        for recorded, undone in zip(self.run.judged, self.judge.motions):
            hidden = np.where(one_way(undone), 1.0, np.nan)
            made.append(
                Trace(
                    undone.start_s
                    + undone.reduce(np.arange(float(len(undone.position)))[:, None])[:, 0] / undone.rate_hz,
                    undone.torque_rows * gain * hidden,
                    recorded.reduce(self.run.simulation.model.torque(recorded)) * hidden,
                    undone.reduce(mended.torque(undone)) * gain * hidden,
                )
            )
        return tuple(made)

    def mended(self) -> IdentifiedModel:
        """The model with all layers, its bodies such as can be."""
        model = self.linear.model
        prior = make_prior(model.model, self.linear.motions)
        count = len(model.parameters)
        free = np.flatnonzero(self.prior.free[:count])
        precision = np.linalg.pinv(self.estimate.covariance[np.ix_(free, free)], hermitian=True)
        triangle = np.zeros((len(free), count))
        triangle[:, free] = np.linalg.cholesky(precision + 1e-9 * np.diag(np.diag(precision))).T
        scale = np.where(self.prior.free[:count], prior.scale, 0.0)
        values = make_consistent(model.model, triangle, self.estimate.values[:count], scale)
        return replace(model, parameters=values, cutoff_hz=self.run.cutoff)


def _tie(precision: FloatArray, one: int, other: int) -> None:
    """Make two unknowns equal: their difference has no room."""
    stiff = 1e6 * max(precision[one, one], precision[other, other], 1.0)
    precision[np.ix_([one, other], [one, other])] += stiff * np.array([[1.0, -1.0], [-1.0, 1.0]])


def _has_values(model: TorqueModel) -> list[bool]:
    """(p,) which parameters of a simulation are its own; a static level without Stribeck velocity is none."""
    stribeck = model.structure.get("stribeck_friction", {}).get("stribeck", True)
    return [p.symbol != "f_b" or bool(stribeck) for p in model.parameters]


class _Shares:
    """What an item is worth: the held-out variance that is back when it alone is as the simulation has it."""

    def __init__(self, found: _Joint, above: FloatArray, gain: FloatArray, after: FloatArray) -> None:
        self._found, self._above, self._gain, self._after = found, above, gain, after

    def without(self, vector: FloatArray, was: float) -> float:
        """Share of the simulation's variance above the noise, mean over the joints; the leading unknown is moved."""
        values = self._found.estimate.values.copy()
        lead = int(np.argmax(vector == 1.0))
        values[lead] += was - self._found.estimate.of(vector)
        return self.of(values)

    def of(self, values: FloatArray) -> float:
        """The same of other values (P,)."""
        rms = self._gain * self._found.judge.rms(values)
        return float(np.nanmean((rms**2 - self._after**2) / self._above))


def _standing(explanation: Explanation, gone: Sequence[Added]) -> Explanation:
    """The search's answer without the findings that another recording does not show."""
    lost = [one.finding for one in gone]
    return replace(explanation, findings=tuple(one for one in explanation.findings if one not in lost))


def _suspicions(suspected: Sequence[Suspicion]) -> tuple[str, ...]:
    """What may be off and was not undone, in words."""
    return tuple(
        f"suspected, {one.probability:.0%}: "
        + ", ".join(f"{_wiring_words(name)} {value:.3g}" for name, value in zip(one.names, one.values))
        + "; links of other mass say nearly the same, so nothing was corrected for it"
        for one in suspected
    )


def _wiring_words(name: str) -> str:
    kind, joint = name.split("[")[0], name[:-1].partition("[")[2]
    return {GAIN: f"torque gain of {joint}", ZERO: f"encoder zero of {joint} (rad)", DELAY: "delay of torque (s)"}[kind]


def _unnamed(small: Sequence[Added], gone: Sequence[Added]) -> tuple[str, ...]:
    """What is in the model and too small to be named, and what was found and not found again."""
    notes = []
    if small:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in small)
        notes.append(f"in the model, for held-out parts are predicted better with it, but within its error: {words}")
    if gone:
        words = "; ".join(f"{one.effect} at {', '.join(one.joints)}" for one in gone)
        notes.append(f"found, but another recording does not show it, and left out: {words}")
    return tuple(notes)


def _rest_items(explanation: Explanation, after: FloatArray, noise: FloatArray, above: FloatArray) -> tuple[Item, ...]:
    """What is left, and what it depends on as far as the search can say."""
    items = []
    for finding in explanation.findings:
        if finding.effect == UNKNOWN:
            rows = [explanation.joints.index(joint) for joint in finding.joints]
            items.append(_left_at(rows, explanation.joints, finding.where, after, noise, above))
    named = {joint for item in items for joint in item.joints}
    for left in explanation.unexplained:
        if not set(left.joints) <= named:
            rows = [explanation.joints.index(joint) for joint in left.joints]
            items.append(_left_at(rows, explanation.joints, left.where, after, noise, above))
    return tuple(sorted(items, key=lambda one: -one.share))


def _left_at(
    rows: Sequence[int],
    joints: tuple[str, ...],
    where: str,
    after: FloatArray,
    noise: FloatArray,
    above: FloatArray,
) -> Item:
    largest = float(np.max(after[rows]))
    share = float(np.sum((after[rows] ** 2 - noise[rows] ** 2) / above[rows]) / len(joints))
    nothing = float("nan")
    return Item(UNKNOWN, tuple(joints[k] for k in rows), where, nothing, largest, nothing, nothing, "N m RMS", share)
