"""Values of a `Change` that are searched: encoder zeros, directions of gravity, delays.

Zeros and gravity by Gauss-Newton steps with all parameters of the arm free, delays over a grid and by parabolas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..dynamics.regressor import rigid_body_torque
from .change import PRIOR, Change, Kind, gravities
from .evidence import FRICTION, OWN, predicted, rms
from .rows import LONGEST_DELAY_S
from .scorer import SCREEN_ITERATIONS, Scored, Scorer
from .setup import torque_of

ZERO_SD, ZERO_SCALE = 0.5, 0.1
"""Standard deviation of an encoder's zero, rad, and the CAD scale at which zeros are searched."""
ZERO_SMALL, ZERO_LARGE = 0.03, 0.1
"""Encoder zero below which nothing is said, and from which the data are unfit, rad."""
ZERO_UNKNOWN = 0.15
"""Standard error of an encoder zero from which the data cannot tell it, rad."""
BADLY_EXPLAINED = 0.15
"""Share of a joint's torque left unexplained from which zeros off by a quarter turn are tried, too."""
DELAY_SD = 0.05
"""Standard deviation of a delay, s."""
TILT_STEPS = 12
"""Most Gauss-Newton steps in the search for the direction of gravity, which begins at the arm's own."""
LEAST_TILT_RAD = 0.17
"""Tilt of the base from which it is looked for (10 degrees); less is for `spacearm mismatch`."""
LATE_S = 0.04
"""Delay of all joints from which the data are unfit, s: a first-order filter at 4 Hz; sound drives and recorders have
shown 29 ms. One joint's is not mentioned below it."""
CLOSE_S = 0.001
"""Span of trial delays from which the best of them is good enough, s."""
SHORTEST_DELAY_S = 0.01
"""Shorter delays are not looked for, s: they leave less in the torque than the model does."""
GRID_S = (-0.25, -0.15, -0.08, -0.04, -0.015, 0.015, 0.04, 0.08, 0.15, 0.25)
"""Delays that are tried first, s."""


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
        step, gain = zero_step(scorer, base, joint, 0.0)
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
        step = float(np.clip(zero_step(scorer, here, joint, zero)[0], -0.4, 0.4))
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


def zero_error(scorer: Scorer, here: Scored, joint: int, part: BoolArray | None = None) -> float:
    """Standard error of a joint's zero with all parameters free, before any belief about it, rad.

    Args:
        scorer: Scores.
        here: The scored setup about which the torque is linearised.
        joint: Number of a revolute joint, in the arm's order.
        part: (M,) rows that have the zero; None: all.
    """
    square = float(_zero_normal(scorer, here, joint, part)[0][0, 0])
    return float(1.0 / np.sqrt(max(square, 1e-9)))


def zero_step(
    scorer: Scorer, here: Scored, joint: int, zero: float, part: BoolArray | None = None
) -> tuple[float, float]:
    """Gauss-Newton step of one joint's zero with all parameters free, rad, and the log-likelihood it should gain.

    Args:
        scorer: Scores.
        here: The scored setup about which the torque is linearised.
        joint: Number of a revolute joint, in the arm's order.
        zero: That the setup, or the rows, have already, rad.
        part: (M,) rows that have the zero; None: all.
    """
    square, product = _zero_normal(scorer, here, joint, part)
    square, product = square + 1.0 / ZERO_SD**2, product - zero / ZERO_SD**2
    return float(product[0] / square[0, 0]), 0.5 * float(product[0] ** 2 / square[0, 0])


def _zero_normal(
    scorer: Scorer, here: Scored, joint: int, part: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (1, 1) and vector (1,) of a joint's zero with all parameters free."""
    design = scorer.design(here.setup)
    motion = design.motion
    inertials = design.frame.inertials(here.evidence.parameters[: design.rigid])
    arm = scorer.arm.with_gravity(motion.gravity)
    moved = motion.position.copy()
    moved[:, joint] += 1e-4
    slope = (
        rigid_body_torque(arm, inertials, moved, motion.velocity, motion.acceleration, motion.base)
        - rigid_body_torque(arm, inertials, motion.position, motion.velocity, motion.acceleration, motion.base)
    ) / 1e-4
    if part is not None:
        slope[~part] = 0.0
    return reduced(scorer, here, slope[:, :, None])


def reduced(
    scorer: Scorer, here: Scored, along: FloatArray, known: Sequence[int] = ()
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (k, k) and vector (k,) of k further columns of the rigid arm, all parameters free but some.

    The parameters' own columns are eliminated from both (Schur complement).

    Args:
        scorer: Scores.
        here: The scored setup whose motion, gains and residual are used.
        along: (M, n, k) derivatives of the rigid-body torque by the k further unknowns, N·m per unit of the unknown,
            before gains.
        known: Numbers of parameters that keep their values.
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
    free = np.setdiff1d(np.arange(len(cross)), known)
    cross = cross[free]
    return square - cross.T @ np.linalg.solve(evidence.precision[np.ix_(free, free)], cross), vector


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

    An axis of the base frame is kept unless another direction explains more than fitting it costs: beside it a constant
    torque at one joint, or noise, moves the best direction by degrees.

    Args:
        scorer: Scores, with the arm and what was recorded.
        one: The scored setup; returned as it is where its last change is none of gravity.
    """
    last = one.changes[-1] if one.changes else None
    size = 0.0 if last is None or last.kind is not Kind.GRAVITY else float(np.linalg.norm(last.value))
    if last is None or size == 0.0:
        return one
    first = one
    for _ in range(3):
        vector = gravity_step(scorer, one, size)
        change = replace(last, value=tuple(float(v) for v in vector))
        setup = replace(one.setup, gravity=vector)
        better = scorer.score((*one.changes[:-1], change), setup)
        if better.score <= one.score:
            break
        one = better
    on_axis = any(np.allclose(axis, first.setup.gravity) for axis in gravities(scorer.arm))
    if on_axis and one is first:
        return first
    fitted = replace(one, score=one.score + _log_share_of_directions(scorer, one))
    return first if on_axis and first.score >= fitted.score else fitted


def _log_share_of_directions(scorer: Scorer, one: Scored) -> float:
    """Logarithm of the share of all directions of gravity that the data leave (Laplace): what fitting it costs.

    A base may be mounted at any angle, all as probable before; along an axis of its frame it is not fitted.
    """
    information = _direction_information(scorer, one) + np.eye(2)
    return min(0.0, float(-np.log(2.0) - 0.5 * np.linalg.slogdet(information)[1]))


def direction_error(scorer: Scorer, here: Scored, known: Sequence[int] = ()) -> float:
    """Standard error of gravity's direction where the data tell it least, before any belief about it, rad.

    Args:
        scorer: Scores, with the arm and what was recorded.
        here: The scored setup, under a gravity that is not zero.
        known: Joints whose constant torque is taken for known.

    Returns:
        At most pi.
    """
    least = float(np.linalg.eigvalsh(_direction_information(scorer, here, known))[0])
    return float(1.0 / np.sqrt(max(least, np.pi**-2)))


def _direction_information(scorer: Scorer, one: Scored, known: Sequence[int] = ()) -> FloatArray:
    """Information (2, 2) on gravity's direction, 1/rad^2, all parameters free but the offsets of some joints."""
    square, _ = _gravity_normal(scorer, one, known)
    size, turns = float(np.linalg.norm(one.setup.gravity)), np.linalg.svd(one.setup.gravity[None])[2]
    return np.asarray(size**2 * turns[1:] @ square @ turns[1:].T)


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


def _gravity_normal(scorer: Scorer, one: Scored, known: Sequence[int] = ()) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (3, 3) and vector (3,) of gravity with all parameters free but the offsets of some joints."""
    design = scorer.design(one.setup)
    position = design.motion.position
    inertials, still = design.frame.inertials(one.evidence.parameters[: design.rigid]), np.zeros_like(position)
    pulls = [rigid_body_torque(scorer.arm.with_gravity(axis), inertials, position, still, still) for axis in np.eye(3)]
    offsets = [design.rigid + OWN * (joint + 1) - 1 for joint in known]
    return reduced(scorer, one, np.stack(pulls, axis=2), offsets)


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
    inside = [one for one in found if SHORTEST_DELAY_S < abs(one.changes[-1].value[0]) < LONGEST_DELAY_S]
    return [
        one
        for one in inside
        if len(one.changes[-1].joints) > 1 or abs(one.changes[-1].value[0]) > least[one.changes[-1].joints[0]]
    ]


def delay_past_reversals(scorer: Scorer, start: Scored, joints: tuple[int, ...]) -> tuple[Scored, Scored]:
    """A delay as the rows past each reversal show it, where friction that builds up late looks like none.

    A late torque is late in gravity and inertia, too. With 25 ms put into recordings of UR10e, Panda and xMate all rows
    give 25 to 38 ms, these 22 to 29 ms; with none put in, all rows of one give 12 ms and these 1 ms.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup that the delay is added to.
        joints: Whose torque is late.

    Returns:
        The setup without the delay and with it, both scored on these rows.
    """
    past = scorer.past_reversals()
    before = past.score(start.changes, start.setup, (start.evidence.scale,), SCREEN_ITERATIONS)
    return before, _best_delay(past, before, joints)


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


def tilted(stated: FloatArray, gravity: FloatArray) -> bool:
    """Whether one gravity is another by size, or by at least `LEAST_TILT_RAD`.

    Args:
        stated: (3,) of the arm, m/s².
        gravity: (3,) that was found, m/s².
    """
    sizes = float(np.linalg.norm(stated) * np.linalg.norm(gravity))
    return bool(sizes == 0.0 or stated @ gravity < np.cos(LEAST_TILT_RAD) * sizes)


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
