"""The search for an effect's constants: its grid, between the grid's points, and all together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.term import Values
from ..signals.motion import Motion
from .candidate import Candidate
from .evidence import Evidence

REFINEMENTS, REACHES = 10, 6
"""Trials of one constant between its neighbours on the grid, and of one with a reach, which matters less."""
POLISHES, POLISH_STEP = 80, 0.2
"""Trials of all constants together, and how far apart, relatively, they begin."""
EVENT_POLISHES, EDGE_S = 400, 0.5
"""The same of an event, which has more constants and is computed faster; its edges move by so much."""
ALIKE = 0.1
"""Chi-square by which the points of a simplex differ at the end: nothing is decided by so little. Of 42 searches of
events in a blind trial half need less than 190 trials for it, and two all of theirs."""
Gain = Callable[[Values], float]
Method = Callable[[Effect, Values, Gain, float], Values]
"""From effect, constants, gain and present gain to constants: `refine` or `polish`."""


def grid_points(effect: Effect, motions: Sequence[Motion]) -> Iterator[tuple[float, ...]]:
    """Every point of its constants' grids; an event begins while something was recorded, a position was passed.

    Args:
        effect: The effect, for its constants.
        motions: Recordings that it may act in.
    """
    motions = [motion for motion in motions if not effect.elsewhere(motion)]
    begin, end = recorded_span(effect, motions)
    grids = []
    for constant in effect.constants:
        low, high = -np.inf, np.inf
        if constant.begins:
            low, high = begin, end
        elif constant.position:
            row = motions[0].joints.index(constant.joint)
            low = min(motion.position[:, row].min() for motion in motions)
            high = max(motion.position[:, row].max() for motion in motions)
        grids.append([value for value in constant.grid if low <= value < high])
    return product(*grids)


def recorded_span(effect: Effect, motions: Sequence[Motion]) -> tuple[float, float]:
    """Start and end of the recordings that an effect may act in, s.

    Args:
        effect: The effect.
        motions: Recordings; at least one is not elsewhere.
    """
    here = [motion for motion in motions if not effect.elsewhere(motion)]
    end = max(motion.start_s + len(motion.position) / motion.rate_hz for motion in here)
    return min(motion.start_s for motion in here), end


def search(
    method: Method,
    candidate: Candidate,
    evidence: Evidence,
    gain: Callable[[Candidate], float],
) -> Candidate:
    """The candidate with better constants, if the method finds any with a larger gain; else the candidate itself.

    Args:
        method: How.
        candidate: Effect with the constants to begin at.
        evidence: Computes a candidate's columns at other constants.
        gain: Drop in chi-square of a candidate; −∞ where its values are implausible.
    """
    effect = candidate.effect

    def gain_at(constants: Values) -> float:
        return gain(evidence.candidate(effect, constants))

    constants = method(effect, candidate.constants, gain_at, gain(candidate))
    return candidate if constants is candidate.constants else evidence.candidate(effect, constants)


def refine(effect: Effect, constants: Values, gain: Gain, best: float) -> Values:
    """Search each constant in turn between the neighbours of its grid point; twice where one has a reach.

    Args:
        effect: The effect, for its constants' grids.
        constants: (c,) values to begin at, each in its constant's unit.
        gain: From (c,) constants to the drop in chi-square.
        best: Gain at `constants`; other constants must exceed it.

    Returns:
        (c,) the constants with the largest gain found; `constants` itself where none is better.
    """
    rounds = 1 + any(constant.reach is not None for constant in effect.constants)
    for k, constant in [*enumerate(effect.constants)] * rounds:
        grid = np.array(constant.grid)
        near = int(np.argmin(np.abs(grid - constants[k])))
        bounds = constant.reach or (grid[max(near - 1, 0)], grid[min(near + 1, len(grid) - 1)])

        def loss(value: float, k: int = k, at: Values = constants) -> float:
            return -gain((*at[:k], value, *at[k + 1 :]))

        trials = REACHES if constant.reach else REFINEMENTS
        # Values that the physics has not gain minus infinity; the parabola through such a point is none.
        with np.errstate(invalid="ignore"):
            found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"maxiter": trials})
        if -found.fun > best:
            best, constants = -found.fun, (*constants[:k], float(found.x), *constants[k + 1 :])
    return constants


def polish(effect: Effect, constants: Values, gain: Gain, best: float) -> Values:
    """Search all constants together by the simplex of Nelder and Mead (1965), because coordinate search may stall.

    Args:
        effect: The effect, for its constants' bounds.
        constants: (c,) values to begin at, each in its constant's unit.
        gain: From (c,) constants to the drop in chi-square.
        best: Gain at `constants`; other constants must exceed it.

    Returns:
        (c,) the constants found; `constants` itself where none is better, or where there is only one.
    """
    if len(constants) < 2:
        return constants

    def loss(point: FloatArray) -> float:
        return -gain(tuple(point.tolist()))

    options = {
        "maxfev": EVENT_POLISHES if effect.event else POLISHES,
        "fatol": ALIKE,
        # Constants have many units.
        "xatol": np.inf,
        "initial_simplex": _simplex(effect, np.array(constants)),
    }
    bounds = [constant.bounds for constant in effect.constants]
    found = minimize(loss, constants, method="Nelder-Mead", bounds=bounds, options=options)
    return tuple(found.x.tolist()) if -found.fun > best else constants


def _simplex(effect: Effect, begin: FloatArray) -> FloatArray:
    """(k + 1, k) where to begin: at k constants, and a step along each; of an event, along either edge."""
    low, high = np.array([constant.bounds for constant in effect.constants]).T
    inward = np.where(begin - low < high - begin, 1.0, -1.0)
    far = np.minimum(POLISH_STEP * np.maximum(np.abs(begin), POLISH_STEP * high), 0.5 * (high - low))
    steps = np.diag(inward * far)
    if effect.event:
        symbols = [constant.symbol for constant in effect.constants]
        start, length = symbols.index("start"), symbols.index("length")
        steps[start, start] = -EDGE_S
        steps[[start, length], length] = EDGE_S
    return np.vstack([begin, begin + steps])
