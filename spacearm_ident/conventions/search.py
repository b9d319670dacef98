"""Which conventions explain a recording best: every `Change` against none, then what is left, until nothing gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.regressor import rigid_body_torque
from ..forks import each
from .change import PRIOR, Change, Kind, discrete_changes, gravities
from .evidence import (
    CAD_SCALES,
    FRICTION,
    GAIN_SD,
    OWN,
    Design,
    Evidence,
    Frame,
    Measured,
    mass_likelihood,
    predicted,
    rms,
    weigh,
)
from .plain import REST_RAD
from .plausible import Ranges
from .rows import LONGEST_DELAY_S, Rows
from .setup import Setup, motion_of, torque_of

SCREEN_ROWS = 130
"""Rows of a first look."""
SCREEN_ITERATIONS = 3
"""Alternations of a first look."""
SURE, CHANCE = 7.0, 0.02
"""Log odds from which a change is a fact: `SURE`, and what explaining a share `CHANCE` of the residual's variance
gains. The residual is what the model leaves out: a change that is wrong explains a little of it (Panda: 2 %)."""
SUSPECTED = 0.5
"""Share of those log odds from which a change is mentioned."""
SHORT_LIST, LONG_LIST = 6, 24
"""Changes that get a second look at least, and at most: all that the first look cannot surely tell from the best."""
MOST_CHANGES = 4
"""Mistakes looked for at once."""
ZERO_SD, ZERO_SCALE = 0.5, 0.1
"""Standard deviation of an encoder's zero, rad, and the CAD scale at which zeros are searched."""
BADLY_EXPLAINED = 0.15
"""Share of a joint's torque left unexplained from which zeros off by a quarter turn are tried, too."""
DELAY_SD = 0.05
"""Standard deviation of a delay, s."""


@dataclass(frozen=True)
class Scored:
    """A setup with its score: log-likelihood of data and ranges, and log prior of its changes."""

    changes: tuple[Change, ...]
    setup: Setup
    score: float
    evidence: Evidence


class Scorer:
    """Scores setups of one recording; motions once computed are kept.

    Attributes:
        counts: (n,) independent samples of each joint's torque.
        idle: Recorded columns that move in no more rows than a joint has columns of its own, which fit those exactly.
        dead: Those whose torque says nothing.
    """

    def __init__(
        self,
        arm: Arm,
        rows: Rows,
        bonus: Callable[[Setup], float] = lambda setup: 0.0,
        dead: frozenset[int] = frozenset(),
        own: FloatArray | None = None,
    ) -> None:
        """Take a recording.

        Args:
            arm: The arm.
            rows: Its motion and torque.
            bonus: What else a setup explains, as a log-likelihood.
            dead: Joints whose torque says nothing.
            own: (n, OWN) what is known of Coulomb, presliding, viscous, rotor inertia and offset; None: nothing.
        """
        self.arm, self.rows, self.bonus = arm, rows, bonus
        self.ranges = Ranges(arm, rows)
        self.frame = Frame(arm, rms(rows.torque(np.zeros(len(arm.joints)))), own)
        self._designs: list[tuple[Setup, Design]] = []
        self.counts = self._independent()
        self.idle = frozenset(np.flatnonzero(rows.moving.sum(axis=0) <= OWN).tolist()) - dead
        self.dead = dead

    @property
    def sure(self) -> float:
        """Log odds from which a change is taken for a fact."""
        return SURE - 0.5 * float(np.log1p(-CHANCE)) * float(self.counts.sum())

    def screen(self) -> Scorer:
        """The same on fewer rows, each of which counts for more."""
        few = copy(self)
        few.rows = self.rows.thinned(max(1, len(self.rows.time) // SCREEN_ROWS))
        few._designs = []
        return few

    def silent(self, setup: Setup) -> frozenset[int]:
        """Joints of the arm that move too little, or whose torque says nothing, under a setup."""
        still = np.isin(setup.position_from, sorted(self.idle | self.dead))
        return frozenset(np.flatnonzero(still | np.isin(setup.effort_from, sorted(self.dead))).tolist())

    def where_all_move(self, columns: np.ndarray) -> Scorer:
        """The same with only those rows of some recorded columns in which all of them move."""
        other, moving = copy(self), self.rows.moving.copy()
        moving[:, columns] &= moving[:, columns].all(axis=1, keepdims=True)
        share = moving.sum(axis=0) / np.maximum(self.rows.moving.sum(axis=0), 1)
        other.rows, other.counts, other._designs = replace(self.rows, moving=moving), self.counts * share, []
        return other

    def design(self, setup: Setup) -> Design:
        """Columns of a setup's motion."""
        for known, design in self._designs:
            if known.same_motion(setup):
                return design
        made = Design(self.frame, motion_of(self.rows, setup))
        self._designs = [*self._designs[-5:], (setup, made)]
        return made

    def measured(self, setup: Setup) -> Measured:
        """Torque of a setup."""
        return Measured(
            torque_of(self.rows, setup), self.counts[setup.effort_from], setup.gain_sd, setup.common_gain_sd
        )

    def _independent(self) -> FloatArray:
        """(n,) independent samples that each joint's torque counts for.

        The more of two: by what the arm as recorded leaves of the torque, and by what the CAD inertials' torque times
        any factor, and friction, leave of it. The second is the same whatever the sign, unit or gain of a joint, where
        the first is nearly all of the torque, as slow as the motion, and counts for a handful of samples.
        """
        setup = Setup.as_recorded(self.arm)
        counts = np.empty(len(self.arm.joints))
        self.counts = np.full(len(counts), len(self.rows.time) / 5.0)
        design, measured = self.design(setup), self.measured(setup)
        residual = measured.torque - predicted(design, weigh(design, measured))
        for j, rows in enumerate(design.motion.moving.T):
            alone = design.times_cad(j, np.where(rows, measured.torque[:, j], 0.0))[1]
            left = residual[rows, j], alone[rows]
            counts[j] = rows.sum() / min(rows_a_sample(one, measured.torque[rows, j]) for one in left)
        return np.maximum(counts, 2.0)

    def score(
        self, changes: Sequence[Change], setup: Setup, scales: Sequence[float] = CAD_SCALES, iterations: int = 8
    ) -> Scored:
        """Score a setup.

        Args:
            changes: Departures from the conventions that `setup` undoes; their log priors are added to the score.
            setup: Assignment, scale, offset and timing of the recorded columns, and gravity.
            scales: Relative standard deviations of the CAD inertials; the evidence is averaged over them.
            iterations: Alternations between parameters, gains and error size, for each scale. Three times as many are
                made where a gain is free.
        """
        design, measured = self.design(setup), self.measured(setup)
        if measured.common_gain_sd or measured.gain_sd.max() > GAIN_SD:
            iterations *= 3
        evidence = weigh(design, measured, scales, iterations)
        value = evidence.log_likelihood + self.ranges.log_likelihood(setup) + self.bonus(setup)
        # A torque in other units is another density: the change of variables.
        value += float(measured.counts @ np.log(np.abs(setup.effort_sign)))
        if scales is CAD_SCALES:
            value += mass_likelihood(design, evidence)
        return Scored(tuple(changes), setup, value + sum(change.log_prior for change in changes), evidence)


def rows_a_sample(residual: FloatArray, torque: FloatArray) -> float:
    """Rows that one independent sample of a residual (M,) stands for, at least 1.

    The larger of two: 1 plus twice its autocorrelations to the first zero; and its power spectral density where the
    torque has its power, over its mean. The second sees a slow model error under white noise.

    Args:
        residual: (M,) at even intervals, N·m.
        torque: (M,) what the residual is of, N·m.
    """
    n = len(residual)
    if n < 8 or not residual.any():
        return float(max(n, 1))
    power = np.abs(np.fft.rfft(residual - residual.mean(), 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    ends = np.flatnonzero(correlation <= 0)
    slow = 1.0 + 2.0 * float(correlation[1 : int(ends[0]) if len(ends) else n].sum()) / float(correlation[0])
    weight = np.abs(np.fft.rfft(torque - torque.mean(), 2 * n)) ** 2
    band = float(power @ weight / max(weight.sum(), 1e-300) / power.mean())
    return float(max(1.0, slow, band))


@dataclass(frozen=True)
class Step:
    """One round of the search.

    Attributes:
        before: What it started from.
        after: The best that was found.
        rivals: Other single changes that came close, the best first.
        screened: The rest, after a first look only.
    """

    before: Scored
    after: Scored
    rivals: tuple[Scored, ...]
    screened: tuple[Scored, ...] = ()

    @property
    def gain(self) -> float:
        """Log odds of the change against none."""
        return self.after.score - self.before.score


def search(scorer: Scorer) -> list[Step]:
    """Rounds of `compete` until nothing is sure of a gain; the last one is the round that gained nothing."""
    steps = [compete(scorer, scorer.score((), Setup.as_recorded(scorer.arm)))]
    while steps[-1].gain > scorer.sure and len(steps) <= MOST_CHANGES:
        last = steps[-1]
        again = (*last.rivals, *last.screened) if last.after.changes[-1].kind is Kind.DELAY else None
        steps.append(compete(scorer, scorer.score(last.after.changes, last.after.setup), again))
    return steps


def compete(scorer: Scorer, start: Scored, again: Sequence[Scored] | None = None) -> Step:
    """The best single change of a setup, and those that came close.

    Args:
        scorer: Scores.
        start: The setup.
        again: Changes that were tried beside a delay that `start` has now: only the best of them are tried.
    """
    if again is None:
        scale = (min(start.evidence.scale, CAD_SCALES[-2]),)
        tried = []
        few = scorer.screen()
        for change in discrete_changes(scorer.arm):
            if is_testable(scorer, start, change):
                tried.append(few.score((*start.changes, change), change.on(start.setup), scale, SCREEN_ITERATIONS))
        tried += zeros(few, start)
        tried += delays(scorer, start)
        tried += tilts(scorer, start)
    else:
        changes = [one.changes[-1] for one in again if one.changes[-1].kind is not Kind.DELAY]
        tried = [replace(start, changes=(*start.changes, one), setup=one.on(start.setup)) for one in changes]
    close = SHORT_LIST
    if again is None:
        tried.sort(key=lambda one: -one.score)
        close = int(np.clip(sum(one.score > tried[0].score - scorer.sure for one in tried), SHORT_LIST, LONG_LIST))
    chosen = [one for k, one in enumerate(tried) if k < close or one.changes[-1].kind in _SECOND_LOOK]
    short = each(lambda one: judged(scorer, start, one), chosen)
    short = [one for one in short if _is_off(start, one)]
    short = _apart(sorted(short, key=lambda one: -one.score))
    best = short[0] if short and short[0].score > start.score else start
    # Beside a delay the others were not scored again.
    rest = [one for one in tried if all(one is not other for other in chosen)] if again is None else []
    return Step(start, best, tuple(one for one in short if one is not best), tuple(rest))


_SECOND_LOOK = (Kind.EFFORT_GAIN, Kind.EFFORT_UNIT, Kind.EFFORT_RATED, Kind.GRAVITY)
"""What masses add up to, and the direction of gravity, are looked at there only."""


def judged(scorer: Scorer, start: Scored, one: Scored) -> Scored:
    """A change, scored on all rows and CAD scales.

    One that takes torque to another motion on the rows in which all its joints move: elsewhere it would explain other
    data than `start`, and of such hypotheses the likelihoods do not compare.

    Args:
        scorer: Scores, on all rows.
        start: The setup without the change.
        one: The setup with the change, which is the last of its `changes`.
    """
    change = one.changes[-1]
    if change.kind not in (Kind.POSITIONS_EXCHANGED, Kind.EFFORTS_EXCHANGED):
        return refined_gravity(scorer, scorer.score(one.changes, one.setup))
    both = scorer.where_all_move(start.setup.position_from[list(change.joints)])
    whole = both.score(one.changes, one.setup)
    return replace(whole, score=start.score + whole.score - both.score(start.changes, start.setup).score)


def _is_off(start: Scored, one: Scored) -> bool:
    """Whether a gain that was set free, or gravity, went further than they ordinarily are off."""
    change = one.changes[-1]
    if change.kind is Kind.EFFORT_GAIN:
        return bool(abs(np.log(one.evidence.gains[change.joints[0]])) > 2.0 * GAIN_SD)
    if change.kind is Kind.GRAVITY:
        return tilted(start.setup.gravity, np.array(change.value))
    return True


def _apart(found: Sequence[Scored]) -> list[Scored]:
    """The same, the best first, without directions of gravity that the search led to a better one's."""
    kept: list[Scored] = []
    for one in found:
        last = one.changes[-1]
        known = [np.array(other.changes[-1].value) for other in kept if other.changes[-1].kind is Kind.GRAVITY]
        if last.kind is not Kind.GRAVITY or all(tilted(other, np.array(last.value)) for other in known):
            kept.append(one)
    return kept


def tilted(stated: FloatArray, gravity: FloatArray) -> bool:
    """Whether one gravity is another by size, or by at least `LEAST_TILT_RAD`.

    Args:
        stated: (3,) of the arm, m/s².
        gravity: (3,) that was found, m/s².
    """
    sizes = float(np.linalg.norm(stated) * np.linalg.norm(gravity))
    return bool(sizes == 0.0 or stated @ gravity < np.cos(LEAST_TILT_RAD) * sizes)


def is_testable(scorer: Scorer, start: Scored, change: Change) -> bool:
    """Whether a change is one that this arm and these data can be asked about.

    A gain needs CAD inertials, and a single joint's a large gravity torque; a joint without torque says
    nothing about its sign, gain or place.

    Args:
        scorer: Scores, with the arm, its CAD inertials and the joints that move or show torque.
        start: The scored setup that the change would be made to.
        change: The hypothesis.
    """
    if change.kind in (Kind.EFFORT_GAIN, Kind.EFFORT_UNIT, Kind.EFFORT_RATED):
        if scorer.frame.rough:
            return False
        return len(change.joints) != 1 or change.joints[0] in loaded_joints(scorer, start)
    own, silent = set(change.joints), scorer.silent(start.setup)
    if change.kind is Kind.DEGREES:
        # In degrees the smallest motion is a large one, and a joint that would be at rest in radians tells no unit: a
        # position that is 57 times smaller takes its noise out of all torques.
        column = start.setup.position_from[change.joints[0]]
        moved = np.radians(scorer.ranges.high[column] - scorer.ranges.low[column])
        return len(own) > 1 or (column not in scorer.idle and bool(moved > REST_RAD))
    if change.kind is Kind.JOINTS_EXCHANGED:
        # Torque stays with its motion.
        return not own <= silent and not own & scorer.dead
    return not own & silent


def loaded_joints(scorer: Scorer, start: Scored) -> tuple[int, ...]:
    """Joints whose torque is gravity's enough to tell a gain from CAD inertias or a payload that are not known.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup whose parameters are taken.

    Returns:
        Their numbers, in the arm's order.
    """
    design = scorer.design(start.setup)
    ratios = design.mass_ratios(start.evidence.parameters)
    return tuple(int(j) for j in np.flatnonzero(np.isfinite(ratios)))


def carried(scorer: Scorer, start: Scored) -> float:
    """The torque that carries the arm over that of its CAD masses: of the loaded joints the one nearest to 1.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup whose parameters are taken.

    Returns:
        The factor; NaN where no joint is loaded, CAD is a placeholder, or joints are off in opposite ways.
    """
    design = scorer.design(start.setup)
    ratios = design.mass_ratios(start.evidence.parameters)
    ratios = ratios[np.isfinite(ratios)]
    if scorer.frame.rough or not len(ratios) or ratios.min() <= 0.0:
        return float("nan")
    logs = np.log(ratios)
    return float(np.exp(logs[np.argmin(np.abs(logs))])) if np.all(logs > 0.0) or np.all(logs < 0.0) else float("nan")


def zeros(scorer: Scorer, start: Scored) -> list[Scored]:
    """The best encoder zero of each joint by Gauss-Newton; from a quarter turn, too, where little is explained.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup that a change would be made to.

    Returns:
        One scored setup a revolute joint, but for those at which none gains anything.
    """
    base = scorer.score(start.changes, start.setup, (ZERO_SCALE,), SCREEN_ITERATIONS)
    design, torque = scorer.design(base.setup), scorer.measured(base.setup).torque
    left = rms(np.where(design.motion.moving, torque - predicted(design, base.evidence), 0.0)) / (rms(torque) + 1e-12)
    quarter = 0.5 * np.pi
    firsts = (quarter, -quarter) if np.max(left) > BADLY_EXPLAINED else ()
    found = []
    for joint, one in enumerate(scorer.arm.joints):
        if not one.revolute:
            continue
        step, gain = _zero_step(scorer, base, joint, 0.0)
        ways = [_zero_from(scorer, base, joint, step)] if gain > 1.0 or firsts else []
        ways += [_zero_from(scorer, base, joint, first) for first in firsts]
        if ways:
            found.append(max(ways, key=lambda scored: scored.score))
    return found


def _zero_from(scorer: Scorer, start: Scored, joint: int, first: float) -> Scored:
    """The best zero of a joint on the way from a first guess, rad."""
    zero, tried = float(np.clip(first, -2.0, 2.0)), []
    for _ in range(4):
        change = Change(Kind.ENCODER_ZERO, (joint,), (zero,), zero_prior(zero, len(scorer.arm.joints)))
        here = scorer.score((*start.changes, change), change.on(start.setup), (ZERO_SCALE,), SCREEN_ITERATIONS)
        tried.append(here)
        if here.score < start.score - 100.0:
            break
        step = float(np.clip(_zero_step(scorer, here, joint, zero)[0], -0.4, 0.4))
        zero = float(np.clip(zero + step, -2.0, 2.0))
        if abs(step) < 0.01:
            break
    return max(tried, key=lambda scored: scored.score)


def zero_prior(zero: float, n: int) -> float:
    """Log prior of a zero: Gaussian, or a quarter turn.

    Args:
        zero: Of the joint's encoder, rad.
        n: Number of joints that it could be of.
    """
    return float(np.log(PRIOR / n) - 0.5 * (zero / ZERO_SD) ** 2 - 3.0)


def zero_error(scorer: Scorer, here: Scored, joint: int) -> float:
    """Standard error of a joint's zero with all parameters free, before any belief about it, rad.

    Args:
        scorer: Scores.
        here: The scored setup about which the torque is linearised.
        joint: Number of a revolute joint, in the arm's order.
    """
    square = float(_zero_normal(scorer, here, joint)[0][0, 0])
    return float(1.0 / np.sqrt(max(square, 1e-9)))


def _zero_step(scorer: Scorer, here: Scored, joint: int, zero: float) -> tuple[float, float]:
    """Gauss-Newton step of one joint's zero with all parameters free, rad, and the log-likelihood it should gain."""
    square, product = _zero_normal(scorer, here, joint)
    square, product = square + 1.0 / ZERO_SD**2, product - zero / ZERO_SD**2
    return float(product[0] / square[0, 0]), 0.5 * float(product[0] ** 2 / square[0, 0])


def _zero_normal(scorer: Scorer, here: Scored, joint: int) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (1, 1) and vector (1,) of a joint's zero with all parameters free."""
    design = scorer.design(here.setup)
    motion = design.motion
    inertials = scorer.frame.inertials(here.evidence.parameters[: design.rigid])
    arm = scorer.arm.with_gravity(motion.gravity)
    moved = motion.position.copy()
    moved[:, joint] += 1e-4
    slope = (
        rigid_body_torque(arm, inertials, moved, motion.velocity, motion.acceleration)
        - rigid_body_torque(arm, inertials, motion.position, motion.velocity, motion.acceleration)
    ) / 1e-4
    return reduced(scorer, here, slope[:, :, None])


def reduced(scorer: Scorer, here: Scored, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (k, k) and vector (k,) of k further columns of the rigid arm, all parameters free.

    The parameters' own columns are eliminated from both (Schur complement).

    Args:
        scorer: Scores.
        here: The scored setup whose motion, gains and residual are used.
        along: (M, n, k) derivatives of the rigid-body torque by the k further unknowns, N·m per unit of the unknown,
            before gains.
    """
    design, evidence = scorer.design(here.setup), here.evidence
    r, weight = design.rigid, evidence.weight
    residual = scorer.measured(here.setup).torque - predicted(design, evidence)
    along = along * (evidence.gains[:, None] * design.motion.moving[:, :, None])
    cross = np.zeros((len(evidence.parameters), along.shape[2]))
    for j, columns in enumerate(design.columns):
        product = weight[j] * (columns.T @ along[:, j])
        cross[:r] += evidence.gains[j] * product[:r]
        cross[r + OWN * j : r + OWN * (j + 1)] += product[r:]
    square = np.einsum("mjk,j,mjl->kl", along, weight, along, optimize=True)
    vector = np.einsum("mjk,j,mj->k", along, weight, residual, optimize=True)
    return square - cross.T @ np.linalg.solve(evidence.precision, cross), vector


def tilts(scorer: Scorer, start: Scored) -> list[Scored]:
    """Gravity that explains best what is left, of the size stated: a base mounted at any angle.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup that a change would be made to.

    Returns:
        One scored setup; none in orbit, or where the best gravity is the one stated.
    """
    size = float(np.linalg.norm(start.setup.gravity))
    if size == 0.0:
        return []
    # At inertials near CAD: those that were fitted under the arm's gravity would keep it.
    here, found = scorer.score(start.changes, start.setup, (ZERO_SCALE,), SCREEN_ITERATIONS), []
    for _ in range(TILT_STEPS):
        change = Change(Kind.GRAVITY, (), tuple(float(v) for v in gravity_step(scorer, here, size)))
        here = scorer.score((*start.changes, change), change.on(start.setup), (ZERO_SCALE,), SCREEN_ITERATIONS)
        found.append(here)
        if len(found) > 1 and here.score - found[-2].score < 1.0:
            break
    best = max(found, key=lambda one: one.score)
    return [best] if tilted(start.setup.gravity, best.setup.gravity) else []


def refined_gravity(scorer: Scorer, one: Scored) -> Scored:
    """Where gravity was changed: its direction, searched by Gauss-Newton with all parameters free.

    Args:
        scorer: Scores, with the arm and what was recorded.
        one: The scored setup; returned as it is where its last change is none of gravity.
    """
    last = one.changes[-1] if one.changes else None
    size = 0.0 if last is None or last.kind is not Kind.GRAVITY else float(np.linalg.norm(last.value))
    if last is None or size == 0.0:
        return one
    for _ in range(3):
        vector = gravity_step(scorer, one, size)
        change = replace(last, value=tuple(float(v) for v in vector))
        setup = replace(one.setup, gravity=vector)
        better = scorer.score((*one.changes[:-1], change), setup)
        if better.score <= one.score:
            break
        one = better
    if all(tilted(along, one.setup.gravity) for along in gravities(scorer.arm) if along.any()):
        return replace(one, score=one.score + _log_share_of_directions(scorer, one, size))
    return one


def _log_share_of_directions(scorer: Scorer, one: Scored, size: float) -> float:
    """Logarithm of the share of all directions of gravity that the data leave (Laplace): what fitting it costs.

    A base may be mounted at any angle, all as probable before; along an axis of its frame it is not fitted.
    """
    square, _ = _gravity_normal(scorer, one)
    _, _, turns = np.linalg.svd(one.setup.gravity[None])
    information = size**2 * turns[1:] @ square @ turns[1:].T + np.eye(2)
    return min(0.0, float(-np.log(2.0) - 0.5 * np.linalg.slogdet(information)[1]))


def gravity_step(scorer: Scorer, one: Scored, size: float) -> FloatArray:
    """(3,) gravity of a given size that explains what is left, all parameters free, m/s^2.

    Args:
        scorer: Scores.
        one: The scored setup whose gravity is changed by one Gauss-Newton step.
        size: Norm of the result, above zero, m/s^2.
    """
    square, product = _gravity_normal(scorer, one)
    vector = one.setup.gravity + np.linalg.solve(square + np.eye(3) / size**2, product)
    return np.asarray(size * vector / np.linalg.norm(vector))


def _gravity_normal(scorer: Scorer, one: Scored) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (3, 3) and vector (3,) of gravity with all parameters free."""
    design = scorer.design(one.setup)
    position = design.motion.position
    inertials, still = scorer.frame.inertials(one.evidence.parameters[: design.rigid]), np.zeros_like(position)
    pulls = [rigid_body_torque(scorer.arm.with_gravity(axis), inertials, position, still, still) for axis in np.eye(3)]
    return reduced(scorer, one, np.stack(pulls, axis=2))


def delays(scorer: Scorer, start: Scored) -> list[Scored]:
    """A delay that all joints share, and of every joint by itself where it is too long for friction to look like it.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup that a change would be made to.

    Returns:
        Scored setups whose delay is longer than `SHORTEST_DELAY_S` and shorter than `LONGEST_DELAY_S`.
    """
    n, silent = len(scorer.arm.joints), scorer.silent(start.setup)
    found = [_best_delay(scorer, start, tuple(range(n)))]
    least = LATE_S / np.maximum(1.0 - friction_shares(scorer, start), 0.2)
    for joint, own in enumerate(_own_delays(scorer, start)):
        if n > 1 and abs(own) > 0.5 * least[joint] and joint not in silent:
            found.append(_best_delay(scorer, start, (joint,), own))
    # At the end of what is looked for it is no maximum: something else is wrong.
    told = [one for one in found if SHORTEST_DELAY_S < abs(one.changes[-1].value[0]) < LONGEST_DELAY_S]
    return [
        one
        for one in told
        if len(one.changes[-1].joints) > 1 or abs(one.changes[-1].value[0]) > least[one.changes[-1].joints[0]]
    ]


def friction_shares(scorer: Scorer, start: Scored) -> FloatArray:
    """(n,) share of friction in the mean square of each joint's predicted torque, at most 1.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup whose parameters are taken.
    """
    design, evidence = scorer.design(start.setup), start.evidence
    r = design.rigid
    own = evidence.parameters[r:].reshape(-1, OWN)[:, :FRICTION]
    friction = np.einsum("jmc,jc->mj", design.columns[:, :, r : r + FRICTION], own)
    whole = np.mean(scorer.measured(start.setup).torque ** 2, axis=0)
    return np.asarray(np.minimum(np.mean(friction**2, axis=0) / (whole + 1e-12), 1.0))


TILT_STEPS = 12
"""Most Gauss-Newton steps from the arm's gravity to another."""
LEAST_TILT_RAD = 0.17
"""Tilt of the base from which it is looked for (10 degrees); less is for `spacearm mismatch`."""
LATE_S = 0.04
"""Delay from which the data are unfit, s: a first-order filter at 4 Hz; sound drives and recorders have shown 29 ms."""
CLOSE_S = 0.001
"""Span of trial delays from which the best of them is good enough, s."""
SHORTEST_DELAY_S = 0.01
"""Shorter delays are not looked for, s: they leave less in the torque than the model does."""
GRID_S = (-0.25, -0.15, -0.08, -0.04, -0.015, 0.015, 0.04, 0.08, 0.15, 0.25)
"""Delays that are tried first, s."""


def _own_delays(scorer: Scorer, start: Scored) -> FloatArray:
    """(n,) delay at which each joint's torque is nearest to what is predicted without one, s."""
    design = scorer.design(start.setup)
    fitted = predicted(design, start.evidence)
    grid = np.array([0.0, *GRID_S])
    lost = np.empty((len(grid), len(scorer.arm.joints)))
    for k, delay in enumerate(grid):
        torque = torque_of(scorer.rows, replace(start.setup, delay_s=start.setup.delay_s + delay))
        lost[k] = np.sum(np.where(design.motion.moving, torque - fitted, 0.0) ** 2, axis=0)
    return np.asarray(grid[np.argmin(lost, axis=0)])


def _best_delay(scorer: Scorer, start: Scored, joints: tuple[int, ...], first: float | None = None) -> Scored:
    scale = (start.evidence.scale,)

    def at(delay: float) -> Scored:
        clipped = float(np.clip(delay, -LONGEST_DELAY_S, LONGEST_DELAY_S))
        prior = np.log(PRIOR / (len(scorer.arm.joints) + 1)) - 0.5 * (clipped / DELAY_SD) ** 2 * 0.1 - 2.0
        change = Change(Kind.DELAY, joints, (clipped,), float(prior))
        return scorer.score((*start.changes, change), change.on(start.setup), scale, SCREEN_ITERATIONS)

    tried = [at(delay) for delay in (GRID_S if first is None else (0.5 * first, first, 1.5 * first))]
    for _ in range(3):
        best = max(tried, key=lambda one: one.score)
        centre = best.changes[-1].value[0]
        others = sorted((one.changes[-1].value[0], one.score) for one in tried)
        number = [value for value, _ in others].index(centre)
        if number in (0, len(others) - 1):
            tried.append(at(centre * 1.3))
            continue
        (left, lower), (middle, top), (right, upper) = others[number - 1 : number + 2]
        if right - left < CLOSE_S or left == middle or right == middle:
            break
        # Vertex of the parabola through the three (Brent 1973, Algorithms for minimization without derivatives, ch. 5).
        falls, rises = (top - lower) / (middle - left), (upper - top) / (right - middle)
        bend = (rises - falls) / (right - left)
        if bend >= 0:
            break
        tried.append(at(float(0.5 * (left + middle - falls / bend))))
    return max(tried, key=lambda one: one.score)
