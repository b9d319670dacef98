"""Hypotheses about what recordings are off by: their priors, and the linear problem in which they are compared.

Each is a column that is free, with a prior of its own, or absent. Hypotheses are compared by marginal likelihood,
summed over how far the simulation's inertials may be off (`CAD_SCALES`), so that a gain is not found where a heavier
link says the same. At a joint with little load a gain is the same as all of its friction and rotor inertia by that
factor: there it counts how many of them a gain leaves exactly as the file has them (`UNCHANGED`). A stamp is good to
half a sampling period, and a torque to two digits: so much delay and gain is always estimated, and is no finding.
What is a function of a joint's state is the same wherever the joint comes by again: where a residual is mostly that,
its rows count for less (Kish's design effect, `STATE_GROUPS` clusters). What is decided with them: `conventions`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np
from scipy.special import logsumexp

from ..arrays import FloatArray
from ..conventions.evidence import CAD_SCALES, inertial_belief
from ..dynamics.effects.friction import LoadFriction
from ..dynamics.effects.position import HarnessSpring
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..forks import each
from ..mismatch.noise import Noise, model_error_share, weighted
from ..signals.motion import Motion
from .events import with_events_earlier
from .linear import STATE_GROUPS, Linear, Prior, Solution, weak_prior
from .parameters import DIGITS, OFF, ROTOR_SHARE
from .wiring import AXES, DELAY, GAIN, TILT, ZERO, Wiring, kind_and_joint

GAIN_SD, ZERO_SD, DELAY_SD, TILT_SD = 0.5, 0.05, 0.02, 0.05
"""Standard deviations of what is off where something is: of a gain's logarithm (a torque constant of a neighbouring
size of motor), of a zero, rad (three degrees), of a delay, s (a few cycles of a slow bus), of a tilt, rad (three
degrees)."""
SPREAD = {GAIN: GAIN_SD, ZERO: ZERO_SD, DELAY: DELAY_SD, TILT: TILT_SD}
STAMP_PERIODS = 1 / 6
"""Standard deviation of a right stamp, sampling periods: effort is what held before the sample or what will hold after
it, half a period early or late, at three standard deviations."""
SPRING, LOADED, DRIVEN = "stiffness", "mu", "mu_in"
RIVALS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    SPRING: (HarnessSpring.kind, {}),
    LOADED: (LoadFriction.kind, {}),
    DRIVEN: (LoadFriction.kind, {"side": "motor"}),
}
"""Physics that is easily taken for a gain, a zero or a tilt: parameter -> effect, and options of its place. A cable at
a vertical first joint is no tilted base, and friction that grows with the load no torque constant. A spring is left to
the search for physics; friction by the load is not, for at a joint with little load it is its friction by a factor, and
only the values in the file distinguish the two (`conventions.Wired.laws`)."""
SCALING = frozenset({GAIN, LOADED, DRIVEN})
"""What may leave friction and rotor inertia as the file has them where all of a joint's torque is more or less."""
UNCHANGED = 1.0 - OFF
"""Prior probability that a joint's own parameter is what the file has."""
KEPT_SD = DIGITS
"""Relative standard deviation of one that is, and of a torque that is right; of a parameter that is not it is
`ROTOR_SHARE`."""
ODDS = {GAIN: 0.1, ZERO: 0.05, DELAY: 0.05, TILT: 0.05**0.5, SPRING: 0.05, LOADED: 0.05, DRIVEN: 0.02}
"""Prior probability of each at one joint (the delay: at all; a tilt: about one of two axes), and of a rival. Of the
five real arms in hand torque from current is 8 to 43 % off at single joints of two; a zero that is off shows as soon as
an arm is used; late torque is common."""
LARGEST = {GAIN: 1.6, ZERO: 0.35, DELAY: 0.1, TILT: 0.35}
"""Largest size of each that is considered: a factor of five, twenty degrees, a tenth of a second, twenty degrees.
Beyond, the torque is in another unit or the joint has another zero, and the linear problem around the simulation does
not hold."""
LEAST_FACTOR = 1e-4
"""Smallest factor on a joint's variance: a hundredth of its residual's standard deviation."""
MODEL_ERROR = 0.5
"""Share of a joint's residual variance that is a function of its state from which it is model error more than noise."""
LEAST_STEP = -0.8
"""Smallest relative change of a gain at once: what is a larger one is `LARGEST`'s."""


def with_rivals(model: IdentifiedModel) -> IdentifiedModel:
    """With `RIVALS` at every joint, hypotheses beside gains, zeros and tilt; a spring comes with a constant torque."""
    return model.carried_to(with_rival_terms(model.model, _rivals_of(model.model)))


def _rivals_of(model: TorqueModel) -> list[str]:
    """Names of the `RIVALS` that are no terms of a model."""
    own = {parameter.name for parameter in model.parameters}
    names = (f"{symbol}[{joint}]" for symbol in RIVALS for joint in model.arm.joint_names)
    return [name for name in names if name not in own]


def with_rival_terms(model: TorqueModel, names: Sequence[str]) -> TorqueModel:
    """A model with some of the `RIVALS`.

    Args:
        model: The terms that there are.
        names: Parameters of the rivals, such as `mu[joint_2]`.
    """
    structure = dict(model.structure)
    for name in names:
        symbol, joint = kind_and_joint(name)
        kind, options = RIVALS[symbol]
        known = structure.get(kind, {"at": []})["at"]
        structure[kind] = {"at": [*known, {"joint": joint, **options}]}
    return TorqueModel(model.arm, structure)


def too_large(name: str, value: float) -> bool:
    """Whether a value is beyond `LARGEST`.

    Args:
        name: Of the hypothesis.
        value: Its value: a gain's logarithm, a zero or tilt (rad), a delay (s).
    """
    return abs(value) > LARGEST.get(kind_and_joint(name)[0], np.inf)


class Hypotheses:
    """A set of hypotheses, and the linear problem around their most probable values.

    Attributes:
        found: Names of the hypotheses.
        beyond: Names of those that were found and left, their values beyond `LARGEST`.
        rivals: Names of the physics that is none of them, and may be taken for one (`RIVALS`).
        tilts: Names of the axes of a tilt.
        wiring: What is undone in the motions.
        fitted: The model with the values that the linear problem is around.
        linear: The linear problem.
        kept: Joint -> names of its own parameters that a gain, or friction by the load, leaves as written.
    """

    def __init__(
        self, model: IdentifiedModel, motions: Sequence[Motion], known: TorqueModel, written: Mapping[str, float]
    ) -> None:
        """Begin with none.

        Args:
            model: The simulation's torque model with values, and `with_rivals`.
            motions: As recorded, in the bandwidth to look at.
            known: The simulation's own terms.
            written: What is in its file, by name.
        """
        self.motions = motions
        self.written = written
        self.kept: dict[str, tuple[str, ...]] = {}
        # Hypotheses are compared with the same others again and again.
        self._evidences: dict[object, float] = {}
        self.rivals = _rivals_of(known)
        self.arm = model.model.arm
        self.found: list[str] = []
        self.beyond: set[str] = set()
        self._noise: tuple[list[str], Noise] | None = None
        self.wiring = Wiring.right(len(self.arm.joints))
        self.fitted = model
        turned = [float(np.linalg.norm(np.cross(axis, self.arm.gravity))) for axis in np.eye(3)]
        # About the axis nearest to gravity a tilt changes least: the other two say all.
        axes = sorted(np.argsort(turned)[1:]) if any(turned) else []
        self.tilts = tuple(f"{TILT}[{AXES[k]}]" for k in axes)
        self.design_effect = np.ones(len(self.arm.joints))
        self.ordinary = {GAIN: KEPT_SD, DELAY: STAMP_PERIODS / min(motion.rate_hz for motion in motions)}
        self.relinearise()

    def begin(self, wiring: Wiring, found: Sequence[str]) -> None:
        """Go on from what was found before, or some of it.

        Args:
            wiring: What is undone.
            found: Names of the hypotheses.
        """
        self.found, self.wiring = list(found), wiring
        self.relinearise()
        for name in found:
            self.keep(name)

    def of_delays(self, delays: Sequence[float]) -> list[list[float]]:
        """Log odds of each of some delays (s), beside what else was found.

        Args:
            delays: Compared outright, each with a linear problem of its own.

        Returns:
            Of each: by all data against none, or against the same of the other sign where that is more probable; then
            by every part (`Linear.parts`) against none.
        """
        parts: list[np.ndarray | None] = [None, *self.linear.parts()]

        def evidence(delay_s: float) -> FloatArray:
            linear = self.linear if delay_s == self.wiring.delay_s else self.linear.delayed(self.motions, delay_s)
            return np.array([self._of(linear, SPREAD[DELAY] if delay_s else None, part) for part in parts])

        compared = [*dict.fromkeys([0.0, *delays, *(-delay_s for delay_s in delays)])]
        logs = dict(zip(compared, each(evidence, compared)))
        found = []
        for delay_s in delays:
            whole, *by_part = (logs[delay_s] - logs[0.0] + self.log_prior([DELAY])).tolist()
            found.append([min(whole, float(logs[delay_s][0] - logs[-delay_s][0])), *by_part])
        return found

    def _of(self, linear: Linear, spread_s: float | None = None, blocks: np.ndarray | None = None) -> float:
        """Log evidence of a linear problem, from which another delay is removed, under the present noise.

        Args:
            linear: The problem.
            spread_s: Prior standard deviation of the whole delay, s; None: half a sampling period about this one.
            blocks: Blocks of time that count; None: all.
        """
        logs = []
        for scale in CAD_SCALES:
            prior = self._prior([name for name in self.found if name != DELAY], scale)
            number = linear.names.index(DELAY)
            prior.mean[number] = 0.0
            if spread_s is not None:
                prior.mean[number], prior.precision[number, number] = -linear.wiring.delay_s, spread_s**-2
            logs.append(linear.log_evidence(prior, self.variance, blocks))
        return float(logsumexp(logs))

    def leave_out(self, name: str) -> None:
        """Drop one of those found. A delay is none then at once: its derivative may not lead back (`settle`)."""
        self.found.remove(name)
        if name == DELAY:
            self.wiring = replace(self.wiring, delay_s=0.0)
            self.relinearise()

    def doubt_what_is_left(self) -> None:
        """Let joints whose residual is mostly model error count for as many rows as there are states to be wrong in.

        What is left beside any gain: what a missing one leaves is model error, and would hide it.
        """
        gains = [f"{GAIN}[{joint}]" for joint in self.arm.joint_names]
        values = self.solved([*dict.fromkeys([*self.found, *gains])]).values
        steps, model = values[[self.linear.names.index(name) for name in gains]], self.with_values(values)
        # As the columns are: a step of a gain is one of the torque that they are built around.
        left = [m.torque - model.torque(m) - steps * self.fitted.torque(m) for m in self.linear.motions]
        share = model_error_share(model, self.linear.motions, left)
        cluster = self.linear.rows.sum(axis=1) * self.relative_weight / STATE_GROUPS
        self.design_effect = np.where(share > MODEL_ERROR, 1.0 + share * np.maximum(cluster - 1.0, 0.0), 1.0)

    def tempered(self, odds: float, names: Sequence[str]) -> float:
        """Log odds of hypotheses with their likelihood as weak as the rows of their joints are dependent.

        Args:
            odds: Log odds with every row for itself.
            names: The hypotheses.
        """
        prior, joints = self.log_prior(names), {kind_and_joint(name)[1] for name in names}
        effect = max(
            (self.design_effect[k] for k, name in enumerate(self.arm.joint_names) if name in joints), default=1.0
        )
        return prior + (odds - prior) / effect

    def settle(self) -> None:
        """Move to the most probable values of what was found; what becomes larger than `LARGEST` leaves."""
        solution = self.solved(self.found)
        step, joints = dict(zip(self.linear.names, solution.values.tolist())), self.arm.joint_names
        now = self.wiring.by_column(joints)
        # A gain's column is the torque: its step is a factor's.
        step |= {name: float(np.log1p(max(step[name], LEAST_STEP))) for name in self.found if name.startswith(GAIN)}
        now |= {name: now[name] + step[name] for name in (*self.found, DELAY) if name in now}
        self.beyond |= {name for name in self.found if too_large(name, now.get(name, 0.0))}
        self.found = [name for name in self.found if name not in self.beyond]
        kept, before = {*self.found, DELAY}, self.wiring.delay_s
        self.wiring = Wiring.of_columns(joints, {k: v if k in kept else 0.0 for k, v in now.items()})
        self.fitted = with_events_earlier(self.with_values(solution.values), self.wiring.delay_s - before)
        if DELAY in self.found and abs(self.wiring.delay_s) > abs(before):
            # The derivative does not know the change of friction at a reversal, nor a filter's lag, and leads away from
            # delays that explain more. The way back to none needs no proof: whether the delay stays is asked later.
            linear = Linear(self.fitted, self.motions, self._whiteners, self.wiring)
            if self._of(linear.delayed(self.motions, before)) >= self._of(linear):
                self.fitted = with_events_earlier(self.fitted, before - self.wiring.delay_s)
                self.wiring = replace(self.wiring, delay_s=before)
        self.relinearise()

    def errors(self) -> dict[str, float]:
        """Standard error of each that was found, and of the delay."""
        spread = np.sqrt(np.diag(self.solved(self.found).covariance))
        return {name: float(spread[self.linear.names.index(name)]) for name in dict.fromkeys([*self.found, DELAY])}

    def log_odds(self, name: str) -> float:
        """Of a hypothesis among those found; of a delay as `of_delays`."""
        if name == DELAY:
            return self.of_delays([self.wiring.delay_s])[0][0]
        return self.gained(name, [one for one in self.found if one != name])

    def gained(self, name: str, beside: Sequence[str], blocks: np.ndarray | None = None) -> float:
        """Log odds of one hypothesis beside others.

        Args:
            name: The hypothesis.
            beside: The others.
            blocks: Numbers of the blocks of time to ask; None: all.
        """
        with_it = [*beside, name]
        if kind_and_joint(name)[0] not in SCALING:
            return self.tempered(self.evidence(with_it, blocks) - self.evidence(beside, blocks), [name])
        evidence = [self.unchanged(name, names, blocks)[0] for names in (with_it, beside)]
        return self.tempered(evidence[0] - evidence[1], [name])

    def unchanged(
        self, one: str, names: Sequence[str], blocks: np.ndarray | None = None
    ) -> tuple[float, tuple[str, ...]]:
        """The evidence, each of a joint's own parameters being as written or not, and which most probably are.

        Args:
            one: A hypothesis about the joint.
            names: Hypotheses.
            blocks: Of time; None: all.
        """
        joint = kind_and_joint(one)[1]
        own = [name for name in self.written if kind_and_joint(name)[1] == joint]
        others = self.kept_beside(names, but=joint)
        scales = [(self._log_evidence(names, scale, others, blocks), scale) for scale in CAD_SCALES]
        # Of the scales the best is enough for what is kept: that is a matter of this joint alone.
        here, scale = max(scales)
        logs = {}
        for kept in chain.from_iterable(combinations(own, k) for k in range(len(own) + 1)):
            spreads = {name: KEPT_SD if name in kept else ROTOR_SHARE for name in own}
            odds = len(kept) * np.log(UNCHANGED) + (len(own) - len(kept)) * np.log(1.0 - UNCHANGED)
            logs[kept] = self._log_evidence(names, scale, {**others, **spreads}, blocks) - here + odds
        whole = float(logsumexp([one for one, _ in scales])) + self.log_prior(names)
        return whole + float(logsumexp(list(logs.values()))), max(logs, key=lambda kept: logs[kept])

    def keep(self, name: str) -> None:
        """Take what a hypothesis most probably leaves as written for exactly that, wherever it is free."""
        kind, joint = kind_and_joint(name)
        if kind in SCALING:
            self.kept[joint] = self.unchanged(name, [*dict.fromkeys([*self.found, name])])[1]

    def kept_beside(self, names: Sequence[str], but: str = "") -> dict[str, float]:
        """Relative standard deviation of what is kept beside some hypotheses, but at one joint.

        Args:
            names: The hypotheses.
            but: The joint; empty: none.

        Returns:
            By parameter.
        """
        places = (kind_and_joint(name) for name in names)
        joints = {joint for kind, joint in places if kind in SCALING} - {but}
        return {name: KEPT_SD for joint in joints for name in self.kept.get(joint, ())}

    def gained_by(self, names: Sequence[str], beside: Sequence[str], part: np.ndarray) -> float:
        """Log odds of hypotheses beside others, by a part of the data.

        Args:
            names: The hypotheses.
            beside: The others.
            part: Numbers of its blocks of time.
        """
        if len(names) == 1:
            return self.gained(names[0], beside, part)
        kept = self.kept_beside(beside)
        odds = self.evidence([*beside, *names], part, kept) - self.evidence(beside, part, kept)
        return self.tempered(odds, names)

    def log_prior(self, names: Sequence[str]) -> float:
        """Logarithm of the prior probability of hypotheses."""
        return sum(float(np.log(ODDS[kind_and_joint(name)[0]])) for name in names)

    def candidates(self) -> list[str]:
        """Names of all that there may be."""
        revolute = [joint.name for joint in self.arm.joints if joint.revolute]
        gains = [f"{GAIN}[{joint}]" for joint in self.arm.joint_names]
        return [*gains, *(f"{ZERO}[{joint}]" for joint in revolute), DELAY, *self.tilts, *self.rivals]

    def relinearise(self) -> None:
        """Build the linear problem around the model and the wiring."""
        undone = self.wiring.undone(self.motions, self.fitted)
        if self._noise is None or self._noise[0] != self.found:
            # What rows count for a step of the same hypotheses hardly changes, and takes as long as all else.
            self._noise = list(self.found), weighted(self.fitted, undone, self._noise and self._noise[1])
        noise = self._noise[1]
        self._whiteners = noise.whiteners
        self.linear = Linear(self.fitted, self.motions, noise.whiteners, self.wiring)
        size = np.sqrt(np.mean(np.concatenate([motion.torque_rows for motion in undone]) ** 2, axis=0))
        self.centre, self.spread, self.payload = inertial_belief(self.arm, size)
        self.weak = weak_prior(self.linear)
        everything = self.solved(self.candidates(), np.ones(len(size)))
        self.variance = self.linear.variance(everything.values, noise, LEAST_FACTOR)
        sigma = np.array([whitener.sigma_Nm for whitener in noise.whiteners])
        self.relative_weight = np.where(np.isfinite(sigma), (noise.floor_Nm / sigma) ** 2, 0.0)
        self._evidences.clear()

    def _prior(self, names: Sequence[str], scale: float, own: Mapping[str, float] | None = None) -> Prior:
        """With inertials off the simulation's by `scale` of themselves, and these hypotheses free.

        Args:
            names: Hypotheses.
            scale: Of the inertials.
            own: Parameter of a joint's own -> relative standard deviation about what is written; None: of what is kept.
        """
        own = self.kept_beside(names) if own is None else own
        mean, precision, free = self.weak.mean.copy(), self.weak.precision.copy(), self.weak.free.copy()
        count = 10 * len(self.arm.joints)
        mean[:count] = self.centre
        precision[:count, :] = 0.0
        precision[:, :count] = 0.0
        precision[:count, :count] = np.diag(1.0 / ((scale * self.spread) ** 2 + self.payload**2))
        now = self.wiring.by_column(self.arm.joint_names)
        for number, name in enumerate(self.linear.names):
            if name in own:
                precision[number, :] = precision[:, number] = 0.0
            if name in self.rivals and name not in names:
                mean[number], free[number] = 0.0, False
            if name not in now:
                continue
            # The prior is of the whole; the column is of what is not undone yet.
            mean[number] = -now[name]
            kind, _ = kind_and_joint(name)
            if name in names or kind in self.ordinary:
                free[number] = True
                sd = SPREAD[kind] if name in names else self.ordinary[kind]
                precision[number, number] = 1.0 / sd**2
        for name, share in own.items():
            self._expect(name, share, mean, precision)
        return Prior(mean, precision, free)

    def _expect(self, name: str, share: float, mean: FloatArray, precision: FloatArray) -> None:
        """Add that a joint's own parameter is what is written, within a share of it, before the joint's gain.

        The columns are linear about the present value p0, which without the gain has the gain in it: with p as written
        and a gain g the unknown is p + g (p - p0). Otherwise friction is 4 % off beside a gain of 0.8.

        Args:
            name: Of the parameter.
            share: Relative standard deviation.
            mean: (P,) of the prior; changed.
            precision: (P, P) of the prior; changed.
        """
        number, gain = (self.linear.names.index(one) for one in (name, f"{GAIN}[{kind_and_joint(name)[1]}]"))
        written, known = self.written[name], (share * self.written[name]) ** -2
        beyond = written - float(self.fitted.parameters[number])
        mean[number] = written + beyond * mean[gain]
        direction = np.array([1.0, -beyond])
        precision[np.ix_([number, gain], [number, gain])] += known * np.outer(direction, direction)

    def evidence(
        self, names: Sequence[str], blocks: np.ndarray | None = None, own: Mapping[str, float] | None = None
    ) -> float:
        """Log evidence of hypotheses, with their prior (arguments as for `_log_evidence`)."""
        logs = [self._log_evidence(names, scale, own, blocks) for scale in CAD_SCALES]
        return float(logsumexp(logs)) + self.log_prior(names)

    def _log_evidence(
        self, names: Sequence[str], scale: float, own: Mapping[str, float] | None, blocks: np.ndarray | None = None
    ) -> float:
        """Of hypotheses at one scale of the inertials (arguments as `_prior`), computed once a linearisation."""
        own = self.kept_beside(names) if own is None else own
        key = frozenset(names), scale, frozenset(own.items()), None if blocks is None else tuple(blocks.tolist())
        if key not in self._evidences:
            self._evidences[key] = self.linear.log_evidence(self._prior(names, scale, own), self.variance, blocks)
        return self._evidences[key]

    def solved(
        self, names: Sequence[str], variance: FloatArray | None = None, blocks: np.ndarray | None = None
    ) -> Solution:
        """The unknowns with these hypotheses, at the most probable scale of the inertials.

        Args:
            names: Hypotheses.
            variance: (n,) factor on each joint's variance; None: the present one.
            blocks: Numbers of the blocks of time to fit to; None: all.
        """
        noise = self.variance if variance is None else variance
        logs = [self.linear.log_evidence(self._prior(names, scale), noise, blocks) for scale in CAD_SCALES]
        return self.linear.solve(self._prior(names, CAD_SCALES[int(np.argmax(logs))]), noise, blocks)

    def with_values(self, values: FloatArray) -> IdentifiedModel:
        """The model with the parameters of a solution (P,)."""
        return replace(self.fitted, parameters=values[: len(self.fitted.parameters)])
