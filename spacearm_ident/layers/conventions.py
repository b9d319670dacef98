"""Layer 0: gains, zeros, a delay and a tilt that the data demand, the simulation's parameters as uncertain as may be.

Hypotheses (`hypotheses`) are added one at a time. The best joins if every recording (each half of a single one)
supports it by itself, for model error is not the same in all; everything is linearised again, until nothing gains;
what gains nothing beside the others is removed. Signs, units, order and gravity are for `conventions.search`, before
this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import expit
from scipy.stats import chi2

from ..conventions.evidence import GAIN_SD as ORDINARY_GAIN_SD
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..mismatch.competition import GATE
from ..signals.motion import Motion
from .hypotheses import DRIVEN, LOADED, SCALING, Hypotheses, too_large, with_rival_terms, with_rivals
from .wiring import DELAY, GAIN, TILT, Wiring, kind_and_joint

SURE = 5.0
"""Log odds from which a hypothesis is taken: one false in 150, were residuals noise; all parts must agree besides."""
PROBABLE, CLEAR = 0.0, 0.5 * GATE
"""Those from which friction by the load is taken if it is not a gain: without it the joint's friction and damping would
be named as changed, by one factor. From these on a gain or such a law that is not taken leaves open which of the three
it is (`Wired.open_factors`). And those from which it is sure, as any other physics must be."""
NOT_A_GAIN = float(np.log(19.0))
"""Log odds of friction by the load against a gain from which it is none: 95 %. The other way round it is `SURE`: that
friction of the arm differs may be said sooner than that its recordings were multiplied."""
AGREE, ALIKE = 0.001, 0.1
"""Probability below which values from different parts do not agree, and the share of the size by which they differ
(standard deviation) because of what is not described yet: their errors take residuals for noise. As much as a law is
off at most (`mismatch.intervals.LAW_ERROR`); values of a false zero differ by more than their size."""
DELAYS = (-0.06, -0.03, -0.015, 0.015, 0.03, 0.06)
"""Delays to begin with, s: between them, and from none to the first, Gauss and Newton's steps find the way. What is as
probable early as late is friction that changes more slowly at a reversal than the simulation's, and no delay (Rokae:
either of 15 ms has odds of e^11)."""
SHORT_LIST = 4
"""Best hypotheses that the parts are asked about."""
MOST = 8
"""Most columns that a search adds."""
SETTLING = 2
"""Times that everything is linearised again once nothing is added, or before what is left is judged."""


@dataclass(frozen=True)
class Suspicion:
    """Deviations of conventions that are probable but not certain enough to be a finding.

    Attributes:
        names: Columns of the deviations, all of which are present together.
        values: The size of each: a gain, a zero (rad), a delay (s) or a tilt (rad).
        probability: Of all of them, against no further deviation.
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
    state = Hypotheses(with_rivals(model), motions, model.model, written)
    if known is None:
        _begin_late(state)
    else:
        state.begin(known.wiring, known.found)
        _doubt_the_delay(state)
    for _ in range(1 if known is None else 1 + SETTLING):
        state.settle()
    if known is not None:
        state.doubt_what_is_left()
    while len(state.found) < MOST and (best := _best_addition(state)) is not None:
        state.found = [*state.found, *best]
        state.settle()
    for _ in range(SETTLING if state.found else 0):
        state.settle()
    odds = {name: state.log_odds(name) - _least((name,)) for name in state.found}
    while odds and min(odds.values()) < 0.0:
        state.leave_out(min(odds, key=lambda name: odds[name]))
        state.settle()
        odds = {name: state.log_odds(name) - _least((name,)) for name in state.found}
    _drop_what_helps_a_rival(state)
    return _answer(state, model.model)


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
    state = Hypotheses(with_rivals(model), motions, model.model, written)
    state.begin(known.wiring, [name for name in known.found if name not in names])
    for _ in range(1 + SETTLING):
        state.settle()
    return _answer(state, model.model)


def _least(names: Sequence[str]) -> float:
    """Log odds from which hypotheses are taken."""
    return PROBABLE if kind_and_joint(names[0])[0] in (LOADED, DRIVEN) else SURE * len(names)


def _begin_late(state: Hypotheses) -> None:
    """Begin with the most probable of `DELAYS`, if it is sure and every part of the data supports it.

    A delay moves the change of friction at a reversal away from where the velocity changes sign. Rows there do not
    count, so that a torque that is late by more than a few milliseconds shows in rows further away, and not at all in
    the derivative by a delay that is none.
    """
    least = state.log_prior([DELAY])
    odds = {delay_s: one[0] for delay_s, one in zip(DELAYS, state.of_delays(DELAYS)) if min(one[1:]) >= least}
    best = max(odds, key=lambda delay_s: odds[delay_s], default=None)
    if best is not None and odds[best] > SURE:
        state.found, state.wiring = [DELAY], replace(state.wiring, delay_s=best)
        state.relinearise()


def _doubt_the_delay(state: Hypotheses) -> None:
    """Leave out a delay that is no longer certain beside physics that was found since."""
    if DELAY in state.found and state.log_odds(DELAY) < SURE:
        state.leave_out(DELAY)


def _drop_what_helps_a_rival(state: Hypotheses) -> None:
    """Leave out gains that only make up for a law of friction by the load that is not quite the arm's."""
    now = state.wiring.by_column(state.arm.joint_names)
    kept = [name for name in state.found if not _helps(state, name, now.get(name, 0.0))]
    if kept != state.found:
        state.found = kept
        state.settle()


def _helps(state: Hypotheses, name: str, value: float) -> bool:
    """Whether this is a small gain, as its logarithm, where friction by the load was found or is known."""
    kind, joint = kind_and_joint(name)
    values = {p.name: float(v) for p, v in zip(state.fitted.model.parameters, state.fitted.parameters)}
    beside = [f"{symbol}[{joint}]" for symbol in SCALING - {GAIN}]
    loaded = any(one in state.found or (one not in state.rivals and values.get(one, 0.0) > 0.0) for one in beside)
    return kind == GAIN and abs(value) < ORDINARY_GAIN_SD and loaded


def _answer(state: Hypotheses, model: TorqueModel) -> Wired:
    """What was found, with the values of a model's terms."""
    errors, values = state.errors(), dict(zip(state.linear.names, state.solved(state.found).values.tolist()))
    laws = [name for name in state.found if name in state.rivals and kind_and_joint(name)[0] in SCALING]
    laws = [name for name in laws if _agreed(state, [name])]
    return Wired(
        state.wiring,
        tuple(name for name in state.found if name not in state.rivals),
        errors,
        _suspected(state),
        state.fitted.carried_to(with_rival_terms(model, laws)),
        {name: (values[name], errors[name]) for name in laws},
        _open_factors(state, laws),
        tuple(name for name in laws if not _is_clear(state, name)),
    )


def _best_addition(state: Hypotheses) -> tuple[str, ...] | None:
    """The hypotheses that gain most beside those found, if they gain enough."""
    sure = [(odds, names) for odds, names in _additions(state) if odds > _least(names)]
    best = sorted(sure, reverse=True)[:SHORT_LIST]
    # A rival is there to be ruled out: beside what is still missing it need not be the same in all parts.
    return next((names for _, names in best if _holds(state, names)), None)


def _holds(state: Hypotheses, names: tuple[str, ...]) -> bool:
    kind, joint = kind_and_joint(names[0])
    if kind in (LOADED, DRIVEN) and not _beats_the_gain(state, names[0], joint):
        return False
    if names[0] in state.rivals:
        return _possible(state, names[0])
    gains = [name for name in names if name.startswith(GAIN)]
    # Of two that need each other either is judged beside the other.
    beside = {gain: [*state.found, *(name for name in names if name != gain)] for gain in gains}
    return _agreed(state, names) and all(_beats_friction(state, gain, beside[gain]) for gain in gains)


def _beats_friction(state: Hypotheses, gain: str, beside: Sequence[str]) -> bool:
    """Whether a gain beside others is as sure against friction by the load, where possible, as against nothing."""
    joint = kind_and_joint(gain)[1]
    laws = (f"{LOADED}[{joint}]", f"{DRIVEN}[{joint}]")
    rivals = [law for law in laws if law in state.rivals and law not in state.found]
    odds = state.gained(gain, beside)
    return not any(odds - state.gained(law, beside) < SURE and _possible(state, law) for law in rivals)


def _beats_the_gain(state: Hypotheses, law: str, joint: str) -> bool:
    gain = f"{GAIN}[{joint}]"
    if gain in state.found:
        return False
    return state.gained(law, state.found) - state.gained(gain, state.found) > NOT_A_GAIN


def _is_clear(state: Hypotheses, law: str) -> bool:
    """Whether friction by the load among what was found leaves both friction and damping as written, or is sure."""
    joint, odds = kind_and_joint(law)[1], state.log_odds(law)
    state.keep(law)
    own = {name for name in state.written if name in (f"f_c[{joint}]", f"k_v1[{joint}]")}
    return odds > CLEAR or (len(own) > 1 and own <= set(state.kept[joint]))


def _open_factors(state: Hypotheses, laws: Sequence[str]) -> dict[str, str]:
    """Joint -> the most probable of a gain and friction by the load, where one is probable and none was taken.

    It must leave friction or damping as written; parts of the data need not agree on its size.
    """
    best = {}
    for joint in state.arm.joint_names:
        names = [f"{kind}[{joint}]" for kind in (GAIN, LOADED, DRIVEN)]
        if names[0] in state.found or set(names) & set(laws):
            continue
        beside = [name for name in state.found if name not in names]
        odds = {name: state.gained(name, beside) for name in names if name in (*state.rivals, names[0])}
        name = max(odds, key=lambda one: odds[one])
        if odds[name] > PROBABLE:
            state.keep(name)
            if any(one.startswith(("f_c", "k_v1")) for one in state.kept[joint]):
                best[joint] = name if name == names[0] or _possible(state, name) else names[0]
    return best


def _possible(state: Hypotheses, rival: str) -> bool:
    """Whether friction that grows with the load does grow, and by no more than such friction does."""
    if kind_and_joint(rival)[0] not in SCALING:
        return True
    state.keep(rival)
    value = state.solved([*state.found, rival]).values[state.linear.names.index(rival)]
    own = next(one for one in state.fitted.model.parameters if one.name == rival)
    return bool(max(own.lower, 0.0) < value < own.upper)


def _suspected(state: Hypotheses) -> tuple[Suspicion, ...]:
    """The best addition that is more probable than none, and that all parts of the data support."""
    wired = (one for one in _additions(state) if one[1][0] not in state.rivals)
    probable = sorted((one for one in wired if one[0] > 0.0), reverse=True)[:SHORT_LIST]
    best = next((one for one in probable if _agreed(state, one[1])), None)
    if best is None:
        return ()
    solution = state.solved([*state.found, *best[1]])
    now = state.wiring.by_column(state.arm.joint_names)
    values = [now.get(name, 0.0) + float(solution.values[state.linear.names.index(name)]) for name in best[1]]
    if any(_helps(state, name, value) for name, value in zip(best[1], values)):
        return ()
    shown = [float(np.exp(v)) if name.startswith(GAIN) else v for name, v in zip(best[1], values)]
    return (Suspicion(best[1], tuple(shown), float(expit(best[0]))),)


def _additions(state: Hypotheses) -> list[tuple[float, tuple[str, ...]]]:
    """What may be off beside what was found: log odds, and the columns; two gains may need each other."""
    kept = state.kept_beside(state.found)
    here = state.evidence(state.found, own=kept)
    others = [name for name in state.candidates() if name not in (*state.found, *state.beyond, *state.tilts)]
    pairs: list[tuple[str, ...]] = [*combinations([name for name in others if name.startswith(GAIN)], 2)]
    if state.tilts and not set(state.tilts) & set(state.found):
        pairs.append(state.tilts)
    singles = [(state.gained(name, state.found), (name,)) for name in others]
    together = ((state.evidence([*state.found, *names], own=kept) - here, names) for names in pairs)
    return [*singles, *((state.tempered(odds, names), names) for odds, names in together)]


def _agreed(state: Hypotheses, names: Sequence[str]) -> bool:
    """Whether every part of the data supports hypotheses beside the others found, and with values that agree."""
    beside = [name for name in state.found if name not in names]
    together = [*beside, *names]
    for name in names:
        state.keep(name)
    places = [state.linear.names.index(name) for name in names]
    solutions = []
    for part in state.linear.parts():
        if state.gained_by(names, beside, part) < state.log_prior(names):
            return False
        solution = state.solved(together, blocks=part)
        if any(too_large(name, float(solution.values[k])) for k, name in zip(places, names)):
            return False
        solutions.append((solution.values[places], np.diag(solution.covariance)[places]))
    values, variances = (np.stack(each) for each in zip(*solutions))
    # Of a tilt about two axes the size is the whole: the smaller of the two is off by what the larger leaves.
    sizes = values if kind_and_joint(names[0])[0] != TILT else np.linalg.norm(values, axis=1, keepdims=True)
    variances = variances + (ALIKE * sizes) ** 2
    mean = np.sum(values / variances, axis=0) / np.sum(1.0 / variances, axis=0)
    squares = np.sum((values - mean) ** 2 / variances, axis=0)
    return bool(np.all(chi2.sf(squares, max(len(values) - 1, 1)) > AGREE))
