"""Layer 0: gains, zeros, a delay and a tilt that the data demand, the simulation's parameters as uncertain as may be.

Each is a hypothesis: its column is free, with a prior of its own, or absent. Hypotheses are compared by marginal
likelihood, summed over how far the simulation's inertials may be off (`CAD_SCALES`), so that a gain is not found where
a heavier link says the same. The best joins if every recording (each half of a single one) supports it by itself, for
model error is not the same in all; everything is linearised again, until nothing gains; what gains nothing beside the
others is removed. At a joint with little load a gain is the same as all of its friction and rotor inertia by that
factor: there it counts how many of them a gain leaves exactly as the file has them (`UNCHANGED`). A stamp is good to
half a sampling period, and a torque to two digits: so much delay and gain is always estimated, and is no finding. What
is a function of a joint's state is the same wherever the joint comes by again: where a residual is mostly that, once
physics has been searched for, its rows count for less (Kish's design effect, `STATE_GROUPS` clusters).
Signs, units, order and gravity are for `conventions.search`, before this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np
from scipy.special import expit, logsumexp
from scipy.stats import chi2

from ..arrays import FloatArray
from ..conventions.evidence import CAD_SCALES, inertial_belief
from ..conventions.evidence import GAIN_SD as ORDINARY_GAIN_SD
from ..dynamics.effects.friction import LoadFriction
from ..dynamics.effects.position import HarnessSpring
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..forks import each
from ..mismatch.competition import GATE
from ..mismatch.noise import Noise, model_error_share, weighted
from ..signals.motion import Motion
from .events import with_events_earlier
from .linear import STATE_GROUPS, Linear, Prior, Solution, weak_prior
from .parameters import DIGITS, OFF, ROTOR_SHARE
from .wiring import AXES, DELAY, GAIN, TILT, ZERO, Wiring, kind_and_joint

SURE = 5.0
"""Log odds from which a hypothesis is taken: one false in 150, were residuals noise; all parts must agree besides."""
PROBABLE, CLEAR = 0.0, 0.5 * GATE
"""Those from which friction by the load is taken if it is not a gain: without it the joint's friction and damping would
be named as changed, by one factor. From these on a gain or such a law that is not taken leaves open which of the three
it is (`Wired.open_factors`). And those from which it is sure, as any other physics must be."""
NOT_A_GAIN = float(np.log(19.0))
"""Log odds of friction by the load against a gain from which it is none: 95 %. The other way round it is `SURE`: that
friction of the arm differs may be said sooner than that its recordings were multiplied."""
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
only the values in the file distinguish the two (`Wired.laws`)."""
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
AGREE, ALIKE = 0.001, 0.1
"""Probability below which values from different parts do not agree, and the share of the size by which they differ
(standard deviation) because of what is not described yet: their errors take residuals for noise. As much as a law is
off at most (`mismatch.intervals.LAW_ERROR`); values of a false zero differ by more than their size."""
DELAYS = (-0.06, -0.03, -0.015, 0.015, 0.03, 0.06)
"""Delays to begin with, s: between them, and from none to the first, Gauss and Newton's steps find the way."""
LEAST_FACTOR = 1e-4
"""Smallest factor on a joint's variance: a hundredth of its residual's standard deviation."""
MODEL_ERROR = 0.5
"""Share of a joint's residual variance that is a function of its state from which it is model error more than noise."""
SHORT_LIST = 4
"""Best hypotheses that the parts are asked about."""
MOST = 8
"""Columns looked for at once."""
LEAST_STEP = -0.8
"""Smallest relative change of a gain at once: what is a larger one is `LARGEST`'s."""
SETTLING = 2
"""Times that everything is linearised again once nothing is added, or before what is left is judged."""


@dataclass(frozen=True)
class Suspicion:
    """What the data make probable and do not prove.

    Attributes:
        names: Columns that would be off together.
        values: Of each: a gain, a zero (rad), a delay (s) or a tilt (rad).
        probability: Against nothing more being off.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    probability: float


@dataclass(frozen=True)
class Wired:
    """What was found.

    Attributes:
        wiring: What the recordings are off by.
        found: Names of the columns that the data demand, such as `gain[joint_2]`.
        errors: Standard error of each and of the delay: of a gain's logarithm, a zero (rad), a delay (s), a tilt (rad).
        suspected: What else is more probable than not, the most probable first.
        model: The simulation's terms, and `laws`, with values that fit beside it; events when they are beside it.
        laws: Friction by the load that the data demand and the model did not have: parameter -> value, standard error.
        open_factors: Joint -> a gain, such as `gain[joint_2]`, or friction by the load that is more probable than not
            and was not taken: the joint's friction and damping by one factor may be that.
        doubted: Names of `laws` that neither leave friction and damping as written nor are sure (`CLEAR`): with one
            load or another either of the two alone is as written. Held-out recordings must need them.
    """

    wiring: Wiring
    found: tuple[str, ...]
    errors: Mapping[str, float]
    suspected: tuple[Suspicion, ...]
    model: IdentifiedModel
    laws: Mapping[str, tuple[float, float]]
    open_factors: Mapping[str, str]
    doubted: tuple[str, ...]


def find_wiring(
    model: IdentifiedModel,
    motions: Sequence[Motion],
    written: Mapping[str, float],
    known: Wired | None = None,
) -> Wired:
    """Find what gains, zeros, delay and tilt the data demand.

    Args:
        model: The simulation's torque model with values; physics that it lacks may have been added.
        motions: As recorded, in the bandwidth to look at.
        written: Friction, damping and rotor inertias in the simulation's file, by name (`Simulation.own`).
        known: What was found before that physics was known; tested again beside it.
    """
    state = _State(_with_rivals(model), motions, model.model, written)
    if known is None:
        state.begin_late()
    else:
        state.begin(known, known.found)
    for _ in range(1 if known is None else 1 + SETTLING):
        state.settle()
    if known is not None:
        state.doubt_what_is_left()
    while len(state.found) < MOST and (best := state.best_addition()) is not None:
        state.found = [*state.found, *best]
        state.settle()
    for _ in range(SETTLING if state.found else 0):
        state.settle()
    odds = {name: state.log_odds(name) - _least((name,)) for name in state.found}
    while odds and min(odds.values()) < 0.0:
        state.found.remove(min(odds, key=lambda name: odds[name]))
        state.settle()
        odds = {name: state.log_odds(name) - _least((name,)) for name in state.found}
    state.drop_what_helps_a_rival()
    return state.answer(model.model)


def without_columns(
    model: IdentifiedModel, motions: Sequence[Motion], written: Mapping[str, float], known: Wired, names: Sequence[str]
) -> Wired:
    """What was found less some of its columns, the rest fitted again.

    Args:
        model: As for `find_wiring`, and so are `motions` and `written`.
        motions: As recorded.
        written: What is in the simulation's file.
        known: What was found.
        names: Columns to leave out.
    """
    state = _State(_with_rivals(model), motions, model.model, written)
    state.begin(known, [name for name in known.found if name not in names])
    for _ in range(1 + SETTLING):
        state.settle()
    return state.answer(model.model)


def _with_rivals(model: IdentifiedModel) -> IdentifiedModel:
    """With `RIVALS` at every joint, hypotheses beside gains, zeros and tilt; a spring comes with a constant torque."""
    own = {parameter.name for parameter in model.model.parameters}
    names = [f"{symbol}[{joint}]" for symbol in RIVALS for joint in model.model.arm.joint_names]
    return model.carried_to(_with_rival_terms(model.model, [name for name in names if name not in own]))


def _with_rival_terms(model: TorqueModel, names: Sequence[str]) -> TorqueModel:
    """A model with some of the `RIVALS`, such as `mu[joint_2]`."""
    structure = dict(model.structure)
    for name in names:
        symbol, joint = kind_and_joint(name)
        kind, options = RIVALS[symbol]
        known = structure.get(kind, {"at": []})["at"]
        structure[kind] = {"at": [*known, {"joint": joint, **options}]}
    return TorqueModel(model.arm, structure)


def _least(names: Sequence[str]) -> float:
    """Log odds from which hypotheses are taken."""
    return PROBABLE if kind_and_joint(names[0])[0] in (LOADED, DRIVEN) else SURE * len(names)


def _too_large(name: str, value: float) -> bool:
    return abs(value) > LARGEST.get(kind_and_joint(name)[0], np.inf)


class _State:
    """A set of hypotheses, and the linear problem around their most probable values."""

    def __init__(
        self, model: IdentifiedModel, motions: Sequence[Motion], known: TorqueModel, written: Mapping[str, float]
    ) -> None:
        self.motions = motions
        self.written = written
        self.kept: dict[str, tuple[str, ...]] = {}
        # Hypotheses are compared with the same others again and again.
        self._evidences: dict[object, float] = {}
        own = {parameter.name for parameter in known.parameters}
        rivals = [f"{symbol}[{joint}]" for symbol in RIVALS for joint in known.arm.joint_names]
        self.rivals = [name for name in rivals if name not in own]
        self.arm = model.model.arm
        self.found: list[str] = []
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

    def begin(self, known: Wired, found: Sequence[str]) -> None:
        """Go on from what was found before, or some of it."""
        self.found, self.wiring = list(found), known.wiring
        self.relinearise()
        for name in found:
            self._keep(name)

    def begin_late(self) -> None:
        """Begin with the most probable of `DELAYS`, if all parts of the data support it.

        A delay moves the change of friction at a reversal away from where the velocity changes sign. Rows there do not
        count, so that a torque that is late by more than a few milliseconds shows in rows further away, and not at all
        in the derivative by a delay that is none.
        """
        parts: list[np.ndarray | None] = [None, *self.linear.parts()]
        log_prior = float(np.log(ODDS[DELAY]))

        def odds(delay_s: float) -> list[float]:
            late = Linear(self.fitted, self.motions, self._whiteners, replace(self.wiring, delay_s=delay_s))
            return [self._of(late, part) - self._of(self.linear, part) + log_prior for part in parts]

        found = each(odds, DELAYS)
        whole, delay_s = max((min(one), delay_s) for one, delay_s in zip(found, DELAYS))
        if whole > SURE:
            self.found, self.wiring = [DELAY], replace(self.wiring, delay_s=delay_s)
            self.relinearise()

    def _of(self, linear: Linear, blocks: np.ndarray | None) -> float:
        """Log evidence of rows of a linear problem under the present noise, no more being off."""
        logs = [linear.log_evidence(self._prior((), scale), self.variance, blocks) for scale in CAD_SCALES]
        return float(logsumexp(logs))

    def doubt_what_is_left(self) -> None:
        """Let joints whose residual is mostly model error count for as many rows as there are states to be wrong in.

        What is left beside any gain: what a missing one leaves is model error, and would hide it.
        """
        gains = [f"{GAIN}[{joint}]" for joint in self.arm.joint_names]
        values = self._solved([*dict.fromkeys([*self.found, *gains])]).values
        steps, model = values[[self.linear.names.index(name) for name in gains]], self._with(values)
        # As the columns are: a step of a gain is one of the torque that they are built around.
        left = [m.torque - model.torque(m) - steps * self.fitted.torque(m) for m in self.linear.motions]
        share = model_error_share(model, self.linear.motions, left)
        cluster = self.linear.rows.sum(axis=1) * self.relative_weight / STATE_GROUPS
        self.design_effect = np.where(share > MODEL_ERROR, 1.0 + share * np.maximum(cluster - 1.0, 0.0), 1.0)

    def _tempered(self, odds: float, names: Sequence[str]) -> float:
        """Log odds of hypotheses with their likelihood as weak as the rows of their joints are dependent."""
        prior, joints = self._log_prior(names), {kind_and_joint(name)[1] for name in names}
        effect = max(
            (self.design_effect[k] for k, name in enumerate(self.arm.joint_names) if name in joints), default=1.0
        )
        return prior + (odds - prior) / effect

    def settle(self) -> None:
        """Move to the most probable values of what was found; what becomes larger than `LARGEST` leaves."""
        solution = self._solved(self.found)
        step, joints = dict(zip(self.linear.names, solution.values.tolist())), self.arm.joint_names
        now = self.wiring.by_column(joints)
        # A gain's column is the torque: its step is a factor's.
        step |= {name: float(np.log1p(max(step[name], LEAST_STEP))) for name in self.found if name.startswith(GAIN)}
        now |= {name: now[name] + step[name] for name in (*self.found, DELAY) if name in now}
        self.found = [name for name in self.found if not _too_large(name, now.get(name, 0.0))]
        kept, before = {*self.found, DELAY}, self.wiring.delay_s
        self.wiring = Wiring.of_columns(joints, {k: v if k in kept else 0.0 for k, v in now.items()})
        self.fitted = with_events_earlier(self._with(solution.values), self.wiring.delay_s - before)
        self.relinearise()

    def drop_what_helps_a_rival(self) -> None:
        """Leave out gains that only make up for a law of friction by the load that is not quite the arm's."""
        now = self.wiring.by_column(self.arm.joint_names)
        kept = [name for name in self.found if not self._helps(name, now.get(name, 0.0))]
        if kept != self.found:
            self.found = kept
            self.settle()

    def _helps(self, name: str, value: float) -> bool:
        """Whether this is a small gain, as its logarithm, where friction by the load was found or is known."""
        kind, joint = kind_and_joint(name)
        values = {p.name: float(v) for p, v in zip(self.fitted.model.parameters, self.fitted.parameters)}
        beside = [f"{symbol}[{joint}]" for symbol in SCALING - {GAIN}]
        loaded = any(one in self.found or (one not in self.rivals and values.get(one, 0.0) > 0.0) for one in beside)
        return kind == GAIN and abs(value) < ORDINARY_GAIN_SD and loaded

    def answer(self, model: TorqueModel) -> Wired:
        """What was found, with the values of a model's terms."""
        errors, values = self.errors(), dict(zip(self.linear.names, self._solved(self.found).values.tolist()))
        laws = [name for name in self.found if name in self.rivals and kind_and_joint(name)[0] in SCALING]
        laws = [name for name in laws if self._agreed([name])]
        return Wired(
            self.wiring,
            tuple(name for name in self.found if name not in self.rivals),
            errors,
            self.suspected(),
            self.fitted.carried_to(_with_rival_terms(model, laws)),
            {name: (values[name], errors[name]) for name in laws},
            self._open_factors(laws),
            tuple(name for name in laws if not self._is_clear(name)),
        )

    def best_addition(self) -> tuple[str, ...] | None:
        """The hypotheses that gain most beside those found, if they gain enough."""
        sure = [(odds, names) for odds, names in self._additions() if odds > _least(names)]
        best = sorted(sure, reverse=True)[:SHORT_LIST]
        # A rival is there to be ruled out: beside what is still missing it need not be the same in all parts.
        return next((names for _, names in best if self._holds(names)), None)

    def _holds(self, names: tuple[str, ...]) -> bool:
        kind, joint = kind_and_joint(names[0])
        if kind in (LOADED, DRIVEN) and not self._beats_the_gain(names[0], joint):
            return False
        if names[0] in self.rivals:
            return self._possible(names[0])
        gains = [name for name in names if name.startswith(GAIN)]
        # Of two that need each other either is judged beside the other.
        beside = {gain: [*self.found, *(name for name in names if name != gain)] for gain in gains}
        return self._agreed(names) and all(self._beats_friction(gain, beside[gain]) for gain in gains)

    def _beats_friction(self, gain: str, beside: Sequence[str]) -> bool:
        """Whether a gain beside others is as sure against friction by the load, where possible, as against nothing."""
        joint = kind_and_joint(gain)[1]
        laws = (f"{LOADED}[{joint}]", f"{DRIVEN}[{joint}]")
        rivals = [law for law in laws if law in self.rivals and law not in self.found]
        odds = self._gained(gain, beside)
        return not any(odds - self._gained(law, beside) < SURE and self._possible(law) for law in rivals)

    def _beats_the_gain(self, law: str, joint: str) -> bool:
        gain = f"{GAIN}[{joint}]"
        if gain in self.found:
            return False
        return self._gained(law, self.found) - self._gained(gain, self.found) > NOT_A_GAIN

    def _is_clear(self, law: str) -> bool:
        """Whether friction by the load among what was found leaves both friction and damping as written, or is sure."""
        joint, odds = kind_and_joint(law)[1], self.log_odds(law)
        self._keep(law)
        own = {name for name in self.written if name in (f"f_c[{joint}]", f"k_v1[{joint}]")}
        return odds > CLEAR or (len(own) > 1 and own <= set(self.kept[joint]))

    def _open_factors(self, laws: Sequence[str]) -> dict[str, str]:
        """Joint -> the most probable of a gain and friction by the load, where one is probable and none was taken.

        It must leave friction or damping as written; parts of the data need not agree on its size.
        """
        best = {}
        for joint in self.arm.joint_names:
            names = [f"{kind}[{joint}]" for kind in (GAIN, LOADED, DRIVEN)]
            if names[0] in self.found or set(names) & set(laws):
                continue
            beside = [name for name in self.found if name not in names]
            odds = {name: self._gained(name, beside) for name in names if name in (*self.rivals, names[0])}
            name = max(odds, key=lambda one: odds[one])
            if odds[name] > PROBABLE:
                self._keep(name)
                if any(one.startswith(("f_c", "k_v1")) for one in self.kept[joint]):
                    best[joint] = name if name == names[0] or self._possible(name) else names[0]
        return best

    def _possible(self, rival: str) -> bool:
        """Whether friction that grows with the load does grow, and by no more than such friction does."""
        if kind_and_joint(rival)[0] not in SCALING:
            return True
        self._keep(rival)
        value = self._solved([*self.found, rival]).values[self.linear.names.index(rival)]
        own = next(one for one in self.fitted.model.parameters if one.name == rival)
        return bool(max(own.lower, 0.0) < value < own.upper)

    def suspected(self) -> tuple[Suspicion, ...]:
        """The best addition that is more probable than none, and that all parts of the data support."""
        wired = (one for one in self._additions() if one[1][0] not in self.rivals)
        probable = sorted((one for one in wired if one[0] > 0.0), reverse=True)[:SHORT_LIST]
        best = next((one for one in probable if self._agreed(one[1])), None)
        if best is None:
            return ()
        solution = self._solved([*self.found, *best[1]])
        now = self.wiring.by_column(self.arm.joint_names)
        values = [now.get(name, 0.0) + float(solution.values[self.linear.names.index(name)]) for name in best[1]]
        if any(self._helps(name, value) for name, value in zip(best[1], values)):
            return ()
        shown = [float(np.exp(v)) if name.startswith(GAIN) else v for name, v in zip(best[1], values)]
        return (Suspicion(best[1], tuple(shown), float(expit(best[0]))),)

    def _additions(self) -> list[tuple[float, tuple[str, ...]]]:
        """What may be off beside what was found: log odds, and the columns; two gains may need each other."""
        kept = self._kept(self.found)
        here = self._evidence(self.found, own=kept)
        others = [name for name in self._candidates() if name not in (*self.found, *self.tilts)]
        pairs: list[tuple[str, ...]] = [*combinations([name for name in others if name.startswith(GAIN)], 2)]
        if self.tilts and not set(self.tilts) & set(self.found):
            pairs.append(self.tilts)
        singles = [(self._gained(name, self.found), (name,)) for name in others]
        together = ((self._evidence([*self.found, *names], own=kept) - here, names) for names in pairs)
        return [*singles, *((self._tempered(odds, names), names) for odds, names in together)]

    def errors(self) -> dict[str, float]:
        """Standard error of each that was found, and of the delay."""
        spread = np.sqrt(np.diag(self._solved(self.found).covariance))
        return {name: float(spread[self.linear.names.index(name)]) for name in dict.fromkeys([*self.found, DELAY])}

    def log_odds(self, name: str) -> float:
        """Of a hypothesis among those found."""
        return self._gained(name, [one for one in self.found if one != name])

    def _gained(self, name: str, beside: Sequence[str], blocks: np.ndarray | None = None) -> float:
        """Log odds of one hypothesis beside others."""
        with_it = [*beside, name]
        if kind_and_joint(name)[0] not in SCALING:
            return self._tempered(self._evidence(with_it, blocks) - self._evidence(beside, blocks), [name])
        evidence = [self._unchanged(name, names, blocks)[0] for names in (with_it, beside)]
        return self._tempered(evidence[0] - evidence[1], [name])

    def _unchanged(
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
        others = self._kept(names, but=joint)
        scales = [(self._log_evidence(names, scale, others, blocks), scale) for scale in CAD_SCALES]
        # Of the scales the best is enough for what is kept: that is a matter of this joint alone.
        here, scale = max(scales)
        logs = {}
        for kept in chain.from_iterable(combinations(own, k) for k in range(len(own) + 1)):
            spreads = {name: KEPT_SD if name in kept else ROTOR_SHARE for name in own}
            odds = len(kept) * np.log(UNCHANGED) + (len(own) - len(kept)) * np.log(1.0 - UNCHANGED)
            logs[kept] = self._log_evidence(names, scale, {**others, **spreads}, blocks) - here + odds
        whole = float(logsumexp([one for one, _ in scales])) + self._log_prior(names)
        return whole + float(logsumexp(list(logs.values()))), max(logs, key=lambda kept: logs[kept])

    def _keep(self, name: str) -> None:
        """Take what a hypothesis most probably leaves as written for exactly that, wherever it is free."""
        kind, joint = kind_and_joint(name)
        if kind in SCALING:
            self.kept[joint] = self._unchanged(name, [*dict.fromkeys([*self.found, name])])[1]

    def _kept(self, names: Sequence[str], but: str = "") -> dict[str, float]:
        """Relative standard deviation of what is kept beside some hypotheses, but at one joint."""
        places = (kind_and_joint(name) for name in names)
        joints = {joint for kind, joint in places if kind in SCALING} - {but}
        return {name: KEPT_SD for joint in joints for name in self.kept.get(joint, ())}

    def _agreed(self, names: Sequence[str]) -> bool:
        """Whether every part of the data supports hypotheses beside the others found, and with values that agree."""
        beside = [name for name in self.found if name not in names]
        together = [*beside, *names]
        for name in names:
            self._keep(name)
        places = [self.linear.names.index(name) for name in names]
        solutions = []
        for part in self.linear.parts():
            if self._gain_of_part(names, beside, part) < self._log_prior(names):
                return False
            solution = self._solved(together, blocks=part)
            if any(_too_large(name, float(solution.values[k])) for k, name in zip(places, names)):
                return False
            solutions.append((solution.values[places], np.diag(solution.covariance)[places]))
        values, variances = (np.stack(each) for each in zip(*solutions))
        # Of a tilt about two axes the size is the whole: the smaller of the two is off by what the larger leaves.
        sizes = values if kind_and_joint(names[0])[0] != TILT else np.linalg.norm(values, axis=1, keepdims=True)
        variances = variances + (ALIKE * sizes) ** 2
        mean = np.sum(values / variances, axis=0) / np.sum(1.0 / variances, axis=0)
        squares = np.sum((values - mean) ** 2 / variances, axis=0)
        return bool(np.all(chi2.sf(squares, max(len(values) - 1, 1)) > AGREE))

    def _gain_of_part(self, names: Sequence[str], beside: Sequence[str], part: np.ndarray) -> float:
        """Log odds of hypotheses beside others, by a part of the data."""
        if len(names) == 1:
            return self._gained(names[0], beside, part)
        kept = self._kept(beside)
        odds = self._evidence([*beside, *names], part, kept) - self._evidence(beside, part, kept)
        return self._tempered(odds, names)

    def _log_prior(self, names: Sequence[str]) -> float:
        return sum(float(np.log(ODDS[kind_and_joint(name)[0]])) for name in names)

    def _candidates(self) -> list[str]:
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
        everything = self._solved(self._candidates(), np.ones(len(size)))
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
        own = self._kept(names) if own is None else own
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

    def _evidence(
        self, names: Sequence[str], blocks: np.ndarray | None = None, own: Mapping[str, float] | None = None
    ) -> float:
        logs = [self._log_evidence(names, scale, own, blocks) for scale in CAD_SCALES]
        return float(logsumexp(logs)) + self._log_prior(names)

    def _log_evidence(
        self, names: Sequence[str], scale: float, own: Mapping[str, float] | None, blocks: np.ndarray | None = None
    ) -> float:
        """Of hypotheses at one scale of the inertials (arguments as `_prior`), computed once a linearisation."""
        own = self._kept(names) if own is None else own
        key = frozenset(names), scale, frozenset(own.items()), None if blocks is None else tuple(blocks.tolist())
        if key not in self._evidences:
            self._evidences[key] = self.linear.log_evidence(self._prior(names, scale, own), self.variance, blocks)
        return self._evidences[key]

    def _solved(
        self, names: Sequence[str], variance: FloatArray | None = None, blocks: np.ndarray | None = None
    ) -> Solution:
        noise = self.variance if variance is None else variance
        logs = [self.linear.log_evidence(self._prior(names, scale), noise, blocks) for scale in CAD_SCALES]
        return self.linear.solve(self._prior(names, CAD_SCALES[int(np.argmax(logs))]), noise, blocks)

    def _with(self, values: FloatArray) -> IdentifiedModel:
        return replace(self.fitted, parameters=values[: len(self.fitted.parameters)])
