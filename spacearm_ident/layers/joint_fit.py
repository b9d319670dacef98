"""`JointFit`: wiring, parameters and physics fitted together, and nested fits of less.

Everything is fitted once to the fitted recordings and, for what replicates, once to the held-out ones by themselves.
Any subset of the physics is then a small linear problem (`linear.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, cached_property

import numpy as np

from ..arrays import FloatArray
from ..conventions.evidence import inertial_belief
from ..dynamics.arm import Arm
from ..dynamics.effects.effect import Effect
from ..dynamics.effects.friction import LoadFriction
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..estimate.consistency import make_consistent
from ..mismatch.noise import in_full, weighted
from ..mismatch.scene import Whitener, one_way
from ..regression.balanced import solve
from ..regression.held_out import folds_of, predicts_better
from ..regression.held_out import gain as lowered_by
from ..regression.prior import make_prior
from ..signals.motion import Motion
from ..simulations import Simulation
from .ceiling import black_box, inputs_of
from .comparison import Trace
from .conventions import Wired
from .estimate import Estimate, estimate
from .hypotheses import SPREAD
from .linear import CONSTANT_SPREAD, Linear, Prior, weak_prior
from .parameters import DETERMINED, LEVEL
from .physics import Added
from .wiring import DELAY, Wiring, kind_and_joint

AGREE = 2.58
"""Standard errors of the difference (99 %) within which two estimates of the same thing agree."""
KEPT = ((30.0, 0.15), (3.0, 0.15), (1.0, 0.15), (1.0, 0.5), (1.0, 1.5), (0.0, 1.5))
"""How hard what does not differ is kept at the simulation's values: combinations, by so many inverse errors of their
own, and inertials, within so much of themselves (of `CAD_SCALES`). The first is taken than which none leaves much less
of held-out parts of the recordings: each of forty combinations may be within its error, and all together not, where a
residual is model error."""
NOT_NEGATIVE = frozenset({"J_m", "f_c", "k_v1"})
"""Symbols of what no joint has less than none of; k_v1 where it alone is the viscous friction."""
HIGHER_ORDERS = frozenset({"k_v2", "k_v2_odd", "k_v3"})
ROUNDING = 1e-12
"""Smallest variance of a combination beside the largest, in units of the prior's."""
LARGEST_STEP = 0.3
"""Largest step of a constant's logarithm at once: between two points of its grid."""
LEAST_FACTOR = 1e-3
"""Smallest factor on a joint's variance: a thirtieth of its residual's standard deviation."""


def in_newton_metres(arm: Arm) -> list[Whitener]:
    """What leaves rows in N m, each counting for one, joint by joint."""
    return [Whitener(np.zeros(0), 1.0)] * len(arm.joints)


class JointFit:
    """A joint fit, and nested fits of less.

    Attributes:
        simulation: What is compared.
        wiring: What is undone in all motions.
        names: Columns of the wiring that were found.
        linear: Fitted motions.
        variance: (n,) factor on each joint's variance.
        prior: Of everything.
        estimate: Of everything.
    """

    def __init__(
        self,
        simulation: Simulation,
        model: IdentifiedModel,
        wired: Wired,
        motions: Sequence[Motion],
        judged: Sequence[Motion],
    ) -> None:
        """Fit.

        Args:
            simulation: What is compared.
            model: Its terms, and all physics that was found, with values near the arm's.
            wired: Gains, zeros, delay and tilt that were found.
            motions: Recordings to fit to.
            judged: Held-out recordings.
        """
        wiring = wired.wiring
        self.simulation, self.wiring, self.names = simulation, wiring, wired.found
        self._errors, self._laws, self._judged = dict(wired.errors), wired.laws, judged
        noise = weighted(model, wiring.undone(motions, model))
        self._whiteners = noise.whiteners
        self.linear = Linear(model, motions, noise.whiteners, wiring, by_state=True)
        self._weak = weak_prior(self.linear)
        self.base = simulation.model.model
        self._known = {p.name for p, own in zip(self.base.parameters, _has_values(self.base)) if own}
        self._gone: set[int] = set()
        self._there = cache(self._fit_there)
        self.prior = self._prior(None)
        first = self.linear.solve(self.prior, np.ones(len(simulation.arm.joints)))
        self.variance = self.linear.variance(first.values, noise, LEAST_FACTOR)
        self._believe_the_data()
        self._settle()

    @cached_property
    def judge(self) -> Linear:
        """Held-out motions, every row counting for one N^2 m^2."""
        return Linear(self.linear.model, self._judged, in_newton_metres(self.simulation.arm), self.wiring)

    @cached_property
    def _again(self) -> tuple[Linear, Prior]:
        """Held-out motions in the weights of the fitted ones, and the weak prior of them."""
        linear = Linear(self.linear.model, self._judged, self._whiteners, self.wiring, by_state=True)
        return linear, weak_prior(linear)

    @property
    def fitted(self) -> IdentifiedModel:
        """The model with the values of this fit, about which the next is linear.

        Constants of friction are a Gauss-Newton step on: the search has those that fit beside its own friction loss and
        damping, of which a Stribeck velocity takes a part.
        """
        model = self.linear.model
        constants = model.constants.copy()
        for term, _, first in model.model.numbered():
            for number, constant in enumerate(term.constants if term.friction else (), start=first):
                if not constant.position:
                    step = float(self._open.values[self.linear.column_of_constant(number)])
                    constants[number] *= np.exp(np.clip(step, -LARGEST_STEP, LARGEST_STEP))
        return replace(model, parameters=self.estimate.values[: len(model.parameters)], constants=constants)

    @property
    def depends_on_itself(self) -> bool:
        """Whether the columns of some physics depend on what is fitted: its load, or a constant."""
        terms = self.linear.model.model.terms
        return any(isinstance(t, Effect) and t.friction and (t.constants or t.kind == LoadFriction.kind) for t in terms)

    def _believe_the_data(self) -> None:
        """Take the wiring that these motions determine from them alone.

        Where a simulation's inertials leave a gain no choice, as its search has it, one link that is much heavier
        moves it by several of its errors. Where the data leave it open, at an outer joint, that is all that is known.
        """
        narrow = self._errors
        wide = {name: SPREAD[kind_and_joint(name)[0]] for name in self.names}
        self._errors = {**narrow, **wide}
        spread = np.sqrt(np.diag(self.linear.solve(self._prior(None), self.variance).covariance))
        known = {name for name in wide if spread[self.linear.names.index(name)] < DETERMINED * wide[name]}
        self._errors = {**narrow, **{name: wide[name] for name in known}}

    def _settle(self) -> None:
        """Solve for everything."""
        self.prior = self._prior(None)
        # Values with the searched constants as they were found, errors with those open as well.
        self._open = estimate(self.linear, self._with_constants(self.prior), self.variance)
        self.estimate = replace(self._open, values=self._possible(self.linear, self.prior))
        self._there.cache_clear()

    def _fit_there(self) -> Estimate | None:
        """Everything by the held-out recordings alone; None where they do not determine it."""
        linear, weak = self._again
        prior = self._prior(None, weak)
        try:
            return replace(estimate(linear, prior, self.variance), values=self._possible(linear, prior))
        except np.linalg.LinAlgError:
            return None

    def _possible(self, linear: Linear, prior: Prior, blocks: np.ndarray | None = None) -> FloatArray:
        """(P,) the solution in which no rotor inertia, friction or damping is below zero (active set)."""
        values = linear.solve(prior, self.variance, blocks).values
        own = list(zip(linear.model.model.parameters, prior.free))
        curved = {parameter.joint for parameter, free in own if free and parameter.symbol in HIGHER_ORDERS}
        bounded = np.zeros(linear.count, dtype=bool)
        for number, (parameter, free) in enumerate(own):
            is_slope = parameter.symbol == "k_v1" and parameter.joint in curved
            bounded[number] = free and parameter.symbol in NOT_NEGATIVE and not is_slope
        while (low := bounded & prior.free & (values < 0.0)).any():
            prior = prior.held(low, 0.0)
            values = linear.solve(prior, self.variance, blocks).values
        return values

    def _with_constants(self, prior: Prior) -> Prior:
        """A prior in which the constants of what is in the model are free."""
        linear = self.linear
        free, precision = prior.free.copy(), prior.precision.copy()
        for term, parameter, first in linear.model.model.numbered():
            for number, constant in enumerate(term.constants, start=first):
                # A static level that is left out is tied to the Coulomb friction: no speed tells them apart.
                needs = [
                    self._is_in(k)
                    for k, own in enumerate(term.parameters, start=parameter)
                    if isinstance(term, Effect) or (own.joint == constant.joint and own.symbol == "f_b")
                ]
                if linear.model.constants[number] != 0.0 and (any(needs) or constant.symbol == "d_s"):
                    column = linear.column_of_constant(number)
                    free[column] = True
                    precision[column, column] = CONSTANT_SPREAD**-2
        return Prior(prior.mean, precision, free)

    def _prior(self, terms: Sequence[np.ndarray] | None, weak: Prior | None = None) -> Prior:
        """Everything free that is in the layers so far.

        Args:
            terms: Numbers of the parameters of each piece of physics; None: all physics.
            weak: Of the motions; None: of the fitted ones.
        """
        weak, linear = weak or self._weak, self.linear
        free, mean, precision = weak.free.copy(), weak.mean.copy(), weak.precision.copy()
        kept = set() if terms is None else {int(k) for columns in terms for k in columns}
        names = {name: number for number, name in enumerate(linear.names)}
        for number, parameter in enumerate(linear.model.model.parameters):
            if self._is_in(number) and (terms is None or number in kept or parameter.name in self._known):
                if number in self._of_events:
                    # It stays as the search has it: while it lasts hardly any row counts (`events.without_events`).
                    free[number], mean[number] = False, linear.model.parameters[number]
                continue
            if parameter.symbol == "f_b" and free[number]:
                _tie(precision, number, names[f"f_c[{parameter.joint}]"])
            else:
                free[number], mean[number] = False, 0.0
        for number, name in enumerate(linear.names):
            if name in self.names or name == DELAY:
                free[number], mean[number] = True, 0.0
                # Where the data leave it open, the weak prior of an identification would let a gain be a heavier link.
                precision[number, number] = 1.0 / self._errors[name] ** 2
            if free[number] and name in self._laws:
                # A joint's friction by a factor: which of the two it is the file says, not these data.
                precision[number, :] = precision[:, number] = 0.0
                mean[number], error = self._laws[name]
                precision[number, number] = error**-2
        return Prior(mean, precision, free)

    @cached_property
    def _of_events(self) -> list[int]:
        """Numbers of the parameters of events."""
        model = self.linear.model.model
        spans = [range(k, k + len(t.parameters)) for t, k, _ in model.numbered() if isinstance(t, Effect) and t.event]
        return [number for span in spans for number in span]

    def _is_in(self, number: int) -> bool:
        """Whether a parameter is of the simulation's own terms, or of physics that was not left out."""
        return self.linear.model.model.parameters[number].name in self._known or number not in self._gone

    def leave_out(self, terms: Sequence[Added]) -> None:
        """Take physics out of the model for good."""
        if terms:
            self._gone |= {int(number) for one in terms for number in one.columns}
            self._settle()

    def idle_wiring(self, least: float) -> tuple[str, ...]:
        """Columns of the wiring that are within their 95 % intervals of none, or lower no held-out variance.

        Nothing is fitted again without a column: what it is worth against a heavier link was decided by how far a
        simulation's inertials may be off (`conventions`), which this fit leaves free.

        Args:
            least: Share by which a column must lower the variance that is left at some joint; in all joints together,
                each counted by what is left there, it must lower it at all.
        """
        left = self.judge.rms(self.estimate.values) ** 2
        idle = []
        for name, undone in self.wiring.by_column(self.simulation.arm.joint_names).items():
            if name in self.names:
                values, column = self.estimate.values.copy(), np.zeros(self.linear.count)
                column[self.linear.names.index(name)] = 1.0
                values[self.linear.names.index(name)] = -undone
                low, high = self.estimate.interval(column)
                if low <= -undone <= high or not self._rises(values, left, least):
                    idle.append(name)
        return tuple(idle)

    def _rises(self, values: FloatArray, left: FloatArray, least: float) -> bool:
        """Whether values (P,) leave more held-out variance than `left` (n,): by a share at some joint, and in all."""
        with np.errstate(invalid="ignore", divide="ignore"):
            rise = self.judge.rms(values) ** 2 / left - 1.0
        return bool(np.nanmax(rise) > least and np.nanmean(rise) > 0.0)

    def contradicted(self, terms: Sequence[Added], others: Sequence[Added], least: float) -> list[Added]:
        """Physics that the held-out recordings by themselves have of another size, and do not need either.

        A recording in which the temperature hardly moves says little of what friction does with it, and is predicted
        worse without.

        Args:
            terms: Physics in question.
            others: All other physics.
            least: As for `idle_wiring`.
        """
        doubted = [one for one in terms if self.replicates(self.vector(one), 0.0) is False]
        return [one for one in doubted if not self.needs(one, [*terms, *others], least)]

    def needs(self, one: Added, terms: Sequence[Added], least: float) -> bool:
        """Whether held-out recordings are predicted worse without one of all physics, everything else fitted again.

        Args:
            one: In question.
            terms: All physics.
            least: As for `idle_wiring`.
        """
        left = self.judge.rms(self.estimate.values) ** 2
        return self._rises(self.fit([other for other in terms if other is not one]), left, least)

    def predicting(self, terms: Sequence[Added]) -> list[Added]:
        """Those of some friction terms with which held-out parts of the fitted recordings are predicted better.

        The terms of each joint stay or go together, judged beside those of the other joints.
        """
        with_all = self._held_out_squares(self._prior(None))
        kept = []
        for where in dict.fromkeys(one.joints for one in terms):
            own = [one for one in terms if one.joints == where]
            if predicts_better(self._held_out_squares(self._prior_without(own)), with_all):
                kept += own
        return kept

    def _prior_without(self, terms: Sequence[Added]) -> Prior:
        numbers = [int(number) for one in terms for number in one.columns]
        return self._prior([np.array([k]) for k in range(len(self.linear.model.parameters)) if k not in numbers])

    def _held_out_squares(self, prior: Prior) -> FloatArray:
        """(blocks, n) squares that fits with a prior leave in the parts that each does not see."""
        left = np.zeros((self.linear.blocks, len(self.simulation.arm.joints)))
        for fold in folds_of(self.linear.recording):
            rest = np.setdiff1d(np.arange(self.linear.blocks), fold)
            left[fold] = self.linear.squares(self._possible(self.linear, prior, rest))[:, fold].T
        return left

    def clear(self, terms: Sequence[Added], others: Sequence[Added], least: float) -> list[Added]:
        """Friction terms whose values exceed their errors, and that the held-out recordings have alike, and need.

        The others stay in the model, where they predict better, and are not named: a small constant torque is easily a
        centre of mass and a spring that are off a little.

        Args:
            terms: Terms in question.
            others: All other physics.
            least: As for `idle_wiring`; everything is fitted again without the term.
        """
        level = LEVEL / max(len(terms), 1)
        large = [one for one in terms if self._exceeds(self.vector(one), level)]
        alike = [one for one in large if self.replicates(self.vector(one), 0.0) is not False]
        return [one for one in alike if self.needs(one, [*terms, *others], least)]

    def _exceeds(self, vector: FloatArray, level: float) -> bool:
        """Whether the size of what `vector` says is none with no more than this probability."""
        return abs(self.estimate.of(vector)) > self.estimate.bound(vector, level)

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

    def simulated(self) -> FloatArray:
        """(P,) the simulation's own values, wiring undone."""
        was = self.simulation.values
        return np.array([was.get(name, 0.0) for name in self.linear.names])

    def fit(self, with_terms: Sequence[Added]) -> FloatArray:
        """(P,) wiring and parameters fitted, with some of the physics."""
        prior = self._prior([one.columns for one in with_terms])
        return self._possible(self.linear, prior)

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
        by_them = self._there()
        if by_them is None:
            return None
        here, there = self.estimate.of(vector), by_them.of(vector)
        error = float(np.hypot(self.estimate.error(vector), by_them.error(vector)))
        if by_them.error(vector) > abs(here - was) or set(np.flatnonzero(vector)) <= set(self._of_events):
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
        own = np.array([known.get(parameter.name, 0.0) for parameter in self.base.parameters])
        model = replace(self.simulation.model, parameters=own)
        return np.concatenate([motion.torque_rows - motion.reduce(model.torque(motion)) for motion in linear.motions])

    def in_full(self) -> list[np.ndarray]:
        """By held-out motion, (M, n) rows that count in full."""
        return [in_full(self._whiteners, motion) for motion in self.judge.motions]

    def traces(self, values: FloatArray) -> tuple[Trace, ...]:
        """Held-out torque for figures."""
        count = len(self.judge.model.model.parameters)
        mended = replace(self.judge.model, parameters=values[:count])
        gain, made = self.wiring.gain, []
        for recorded, undone in zip(self._judged, self.judge.motions):
            hidden = np.where(one_way(undone), 1.0, np.nan)
            tilt = undone.reduce(self.wiring.by_tilt(undone, self.judge.model))
            made.append(
                Trace(
                    undone.start_s
                    + undone.reduce(np.arange(float(len(undone.position)))[:, None])[:, 0] / undone.rate_hz,
                    (undone.torque_rows + tilt) * gain * hidden,
                    recorded.reduce(self.simulation.model.torque(recorded)) * hidden,
                    (undone.reduce(mended.torque(undone)) + tilt) * gain * hidden,
                )
            )
        return tuple(made)

    def mended(self, cutoff_hz: float, kept: Sequence[tuple[FloatArray, float]], least: float) -> IdentifiedModel:
        """The simulation with what is named of all layers, its bodies such as can be.

        Args:
            cutoff_hz: Bandwidth that it is of.
            kept: Combinations (P,) of bodies and rotors, and their values, that stay as near to the simulation as
                prediction allows (`KEPT`), for they do not differ. Fitted freely, they would take up what no term
                explains: a spring would make inertias smaller.
            least: Share of a joint's variance, summed over the joints, that must be lowered to be worth anything.
        """
        model, prior = self.linear.model, self._prior_that_predicts(kept, least)
        found = self.linear.solve(prior, self.variance)
        count = len(model.parameters)
        scale = np.where(prior.free[:count], make_prior(model.model, self.linear.motions).scale, 0.0)
        free = np.flatnonzero(scale > 0.0)
        unit = scale[free]
        size, axes = np.linalg.eigh(found.covariance[np.ix_(free, free)] / np.outer(unit, unit))
        # Nothing is known less well than before the data, nor better than rounding leaves it.
        size = np.clip(size, ROUNDING * float(size.max()), 1.0)
        matrix = np.zeros((len(free), count))
        matrix[:, free] = (axes / np.sqrt(size)).T / unit
        values = make_consistent(model.model, matrix, found.values[:count], scale)
        return replace(model, parameters=values, cutoff_hz=cutoff_hz)

    def _prior_that_predicts(self, kept: Sequence[tuple[FloatArray, float]], least: float) -> Prior:
        """That keeps as much as held-out parts of the recordings allow."""
        priors = [self._prior_that_keeps(kept, *how) for how in KEPT]
        left = [self._held_out_squares(prior) for prior in priors]
        lowered = [lowered_by(left[0], squares) for squares in left]
        return next(prior for prior, share in zip(priors, lowered) if max(lowered) - share <= least)

    def _prior_that_keeps(self, kept: Sequence[tuple[FloatArray, float]], by: float, within: float) -> Prior:
        """Of everything: what the simulation has near its own values, combinations (P,) at given values.

        Args:
            kept: Combinations and values.
            by: How hard each is kept, in inverse errors of its own.
            within: How near inertials stay, relatively.
        """
        prior, was = self._prior(None), self.simulation.values
        mean, precision, free = prior.mean.copy(), prior.precision.copy(), prior.free
        for number, parameter in enumerate(self.linear.model.model.parameters):
            if parameter.name in self._known and free[number]:
                mean[number] = was[parameter.name]
        for number, parameter in enumerate(self.linear.model.model.parameters):
            # A static level that was left out is the Coulomb friction: a tie is of values with the same mean.
            if parameter.symbol == "f_b" and free[number] and not self._is_in(number):
                mean[number] = mean[self.linear.names.index(f"f_c[{parameter.joint}]")]
        slope = precision @ mean
        for number, near in self._near_the_simulation(within).items():
            precision[number, number] += near**-2
            slope[number] += mean[number] * near**-2
        for vector, value in kept:
            weight = (by / self.estimate.error(vector)) ** 2
            precision += weight * np.outer(vector, vector)
            slope += weight * value * vector
        slope -= precision[:, ~free] @ mean[~free]
        mean[free] = solve(precision[np.ix_(free, free)], slope[free])
        return Prior(mean, precision, free)

    def beside(self, model: IdentifiedModel) -> FloatArray:
        """(P,) a model of the same terms, and the wiring that fits best beside its parameters.

        Bodies that are such as can be take another gain than those that are fitted freely.
        """
        parameters = np.arange(self.linear.count) < len(model.parameters)
        mean = self.prior.mean.copy()
        mean[parameters] = model.parameters
        prior = Prior(mean, self.prior.precision, self.prior.free & ~parameters)
        return self.linear.solve(prior, self.variance).values

    def wiring_of(self, values: FloatArray) -> Wiring:
        """What recordings are off by, with values (P,)."""
        joints = self.simulation.arm.joint_names
        step = dict(zip(self.linear.names, values.tolist()))
        return Wiring.of_columns(
            joints, {name: was + step[name] for name, was in self.wiring.by_column(joints).items()}
        )

    def _near_the_simulation(self, within: float) -> dict[int, float]:
        """Inertials and rotor inertias by number -> by how much they stay near the simulation's where torque is silent.

        Which body has a combination torque does not tell: none is to end up with next to nothing of it.
        """
        was = self.simulation.values
        size = np.sqrt(np.mean(np.concatenate([motion.torque_rows for motion in self.linear.motions]) ** 2, axis=0))
        near = dict(enumerate((within * inertial_belief(self.simulation.arm, size)[1]).tolist()))
        for number, name in enumerate(self.linear.names):
            if name.startswith("J_m[") and was.get(name, 0.0) > 0.0:
                near[number] = within * was[name]
        return near


def _tie(precision: FloatArray, one: int, other: int) -> None:
    """Make two unknowns equal: their difference has no room."""
    stiff = 1e6 * max(precision[one, one], precision[other, other], 1.0)
    precision[np.ix_([one, other], [one, other])] += stiff * np.array([[1.0, -1.0], [-1.0, 1.0]])


def _has_values(model: TorqueModel) -> list[bool]:
    """(p,) which parameters of a simulation are its own; a static level without Stribeck velocity is none."""
    stribeck = model.structure.get("stribeck_friction", {}).get("stribeck", True)
    return [p.symbol != "f_b" or bool(stribeck) for p in model.parameters]
