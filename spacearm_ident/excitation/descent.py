"""Minimise a smooth function over a convex set |A z| <= 1: feasible sequential quadratic programming.

Each step solves min g.d + d'Bd/2 over the set (a small quadratic programme, Clarabel), B the damped BFGS estimate of
the Hessian (Nocedal and Wright 2006, procedure 18.2), and searches back along d. The set is convex, so every point
on the way keeps the limits and the function needs no merit or penalty for them; what else must hold (torque,
clearance) is a barrier inside the function, infinite where it does not, and the search comes back from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from ..arrays import FloatArray

Function = Callable[[FloatArray], tuple[float, FloatArray]]
"""z (n, m) -> value (may be infinite) and gradient (n, m)."""

_ARMIJO = 1e-4
_SHORTEST = 1e-4
_NEAR = 0.85
_SLACK = 1e-6
_ROUNDS = 6
_BOX = 0.5
"""No step moves a coordinate by more, in units of what alone uses up a limit."""


@dataclass(frozen=True)
class Descent:
    """Where a descent ended: point (n, m), value, steps taken, and why it stopped."""

    point: FloatArray
    value: float
    steps: int
    status: str


def descend(
    function: Function,
    start: FloatArray,
    rows: Sequence[FloatArray],
    steps: int,
    tolerance: float = 1e-4,
    report: Callable[[int, float], None] | None = None,
) -> Descent:
    """Descend from a feasible point.

    Args:
        function: What to minimise.
        start: (n, m), within the limits, where `function` is finite.
        rows: For each of the n blocks (r, m): the set is |rows @ z[block]| <= 1.
        steps: At most so many.
        tolerance: Done when eight steps together gain less than this.
        report: Called with every step's number and value.
    """
    z, (value, gradient) = start.copy(), function(start)
    hessian = np.eye(start.size)
    trail = [value]
    box = _BOX
    for step in range(1, steps + 1):
        direction = _direction(gradient.ravel(), hessian, z, rows, box)
        slope = float(gradient.ravel() @ direction)
        if slope > -1e-9:
            return Descent(z, value, step, "stationary")
        share = 1.0
        while True:
            trial = z + share * direction.reshape(z.shape)
            trial_value, trial_gradient = function(trial)
            if trial_value <= value + _ARMIJO * share * slope:
                break
            share *= _shorter(value, slope, trial_value, share)
            if share < _SHORTEST:
                if box < 1e-3:
                    return Descent(z, value, step, "no further descent")
                box, hessian, trial = box / 10, np.eye(start.size), z
                break
        if trial is not z:
            moved = share * direction
            hessian = _damped_bfgs(hessian, moved, (trial_gradient - gradient).ravel(), first=step == 1)
            box = min(_BOX, 2 * box) if share > 0.9 else max(box * 0.5, 2 * float(np.abs(moved).max()))
            z, value, gradient = trial, trial_value, trial_gradient
        trail.append(value)
        if report is not None:
            report(step, value)
        if len(trail) > 8 and trail[-9] - trail[-1] < tolerance:
            return Descent(z, value, step, "converged")
    return Descent(z, value, steps, "iteration limit")


def _shorter(value: float, slope: float, trial: float, share: float) -> float:
    """Factor on `share`, to where the parabola through both values with this slope is lowest, within reason."""
    if not np.isfinite(trial):
        return 0.25
    return float(np.clip(-slope * share / (2 * (trial - value - slope * share)), 0.1, 0.5))


def _direction(
    gradient: FloatArray, hessian: FloatArray, z: FloatArray, rows: Sequence[FloatArray], box: float
) -> FloatArray:
    """Step of the quadratic programme (n m,).

    Most limits are far away: it is solved with the near ones, then again with those its solution broke.
    """
    here = [a @ own for own, a in zip(z, rows)]
    side = [np.where(np.abs(used) > _NEAR, np.sign(used), 0.0) for used in here]
    quadratic = sparse.csc_matrix(np.triu(hessian))
    for _ in range(_ROUNDS):
        step = _programme(quadratic, gradient, here, side, rows, box)
        after = [used + a @ own for used, a, own in zip(here, rows, step.reshape(z.shape))]
        broken = [(np.abs(used) > 1.0 + _SLACK) & (known == 0.0) for used, known in zip(after, side)]
        if not any(new.any() for new in broken):
            break
        side = [np.where(new, np.sign(used), known) for known, new, used in zip(side, broken, after)]
    # What the solver's tolerance, or rounds left undone, leave outside: come back onto the set, which is convex.
    share = 1.0
    for used, then in zip(here, after):
        out = np.abs(then) > 1.0
        if out.any():
            room = (1.0 - np.sign(then[out]) * used[out]) / np.abs(then[out] - used[out])
            share = min(share, max(float(room.min()), 0.0))
    return step * share


def _programme(
    quadratic: sparse.csc_matrix,
    gradient: FloatArray,
    here: Sequence[FloatArray],
    side: Sequence[FloatArray],
    rows: Sequence[FloatArray],
    box: float,
) -> FloatArray:
    """Minimum of g.d + d'Bd/2 with |d| <= box under the rows whose `side` is not zero, each on that side."""
    blocks = [a[sign != 0] * sign[sign != 0, None] for a, sign in zip(rows, side)]
    rooms = [np.maximum(1.0 - (sign * used)[sign != 0], 0.0) for used, sign in zip(here, side)]
    constraints = _with_box(blocks)
    bounds = np.concatenate([*rooms, np.full(2 * len(gradient), box)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cone = [clarabel.NonnegativeConeT(len(bounds))]
    return np.array(clarabel.DefaultSolver(quadratic, gradient, constraints, bounds, cone, settings).solve().x)


def _with_box(blocks: Sequence[FloatArray]) -> sparse.csc_matrix:
    """The blocks on a diagonal, above the identity and minus the identity.

    Column by column: scipy's stacking takes as long as the programme's solution.
    """
    count, size = sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)
    data, rows, lengths = [], [], []
    first = column = 0
    for block in blocks:
        tall, wide = block.shape
        columns = np.arange(column, column + wide)[:, None]
        box = np.hstack([count + columns, count + size + columns])
        rows.append(np.hstack([np.tile(np.arange(first, first + tall), (wide, 1)), box]).ravel())
        data.append(np.hstack([block.T, np.tile([1.0, -1.0], (wide, 1))]).ravel())
        lengths += [tall + 2] * wide
        first, column = first + tall, column + wide
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return sparse.csc_matrix((np.concatenate(data), np.concatenate(rows), starts), (count + 2 * size, size))


def _damped_bfgs(hessian: FloatArray, moved: FloatArray, change: FloatArray, first: bool) -> FloatArray:
    if first:
        hessian = hessian * max(float(change @ change) / max(abs(float(change @ moved)), 1e-12), 1e-6)
    pushed = hessian @ moved
    curvature, own = float(moved @ change), float(moved @ pushed)
    if curvature < 0.2 * own:
        theta = 0.8 * own / (own - curvature)
        change = theta * change + (1 - theta) * pushed
        curvature = float(moved @ change)
    return hessian - np.outer(pushed, pushed) / own + np.outer(change, change) / curvature
