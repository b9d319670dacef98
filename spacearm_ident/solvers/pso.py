"""Particle swarm optimisation of a function that takes a whole swarm at once (paper §4.1, stage 1, eq. 17 and 18).

    v <- w v + c1 r1 (p - x) + c2 r2 (g - x),    x <- x + v,    r1, r2 ~ U(0, 1), one of each a particle and coordinate

p is the best place that the particle has seen, g the best that any has; w falls linearly over the iterations. N, c1,
c2, w and the number of iterations have the paper's values. What it leaves open, and ours: the swarm starts evenly
spread over the box, at rest; a particle that would leave the box stops at its wall (its velocity across it becomes
zero); there is no other limit on velocities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError

Objective = Callable[[FloatArray], FloatArray]
"""(N, d) places -> (N,) costs; infinite or NaN where there is none."""


@dataclass(frozen=True)
class SwarmSettings:
    """How a swarm moves; the paper's values (§5.1.2).

    Attributes:
        particles: N.
        iterations: How often all of it moves.
        own, social: c1, c2.
        first_inertia, last_inertia: w at the first and the last iteration.
    """

    particles: int = 100
    iterations: int = 300
    own: float = 1.5
    social: float = 1.5
    first_inertia: float = 0.9
    last_inertia: float = 0.4


@dataclass(frozen=True)
class SwarmResult:
    """Where a swarm ended.

    Attributes:
        best: (d,) the best place any particle has seen.
        cost: Its cost.
        history: (iterations + 1,) best cost so far: of the first swarm, then after every move.
        evaluations: Places evaluated.
    """

    best: FloatArray
    cost: float
    history: FloatArray
    evaluations: int


def minimise(
    objective: Objective,
    lower: FloatArray,
    upper: FloatArray,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
    seeds: FloatArray | None = None,
) -> SwarmResult:
    """Search a box.

    Args:
        objective: Called once an iteration, with the whole swarm.
        lower: (d,) lower end of the box.
        upper: (d,) its upper end.
        rng: Source of all chance: the same generator state gives the same result.
        settings: How the swarm moves.
        seeds: (s, d) places that s of the particles start from (moved into the box where they lie outside).

    Raises:
        UserError: The box is empty or endless, there are no particles, or every place ever seen has no finite cost.
    """
    settings = settings or SwarmSettings()
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper)) and np.all(lower <= upper)):
        raise UserError("a particle swarm needs a finite box with its lower end below its upper end")
    if settings.particles < 1:
        raise UserError("a particle swarm needs at least one particle")
    place = rng.uniform(lower, upper, (settings.particles, len(lower)))
    if seeds is not None:
        place[: len(seeds)] = np.clip(seeds[: settings.particles], lower, upper)
    velocity = np.zeros_like(place)
    own, own_cost = place.copy(), _cost(objective, place)
    leader = int(np.argmin(own_cost))
    history = [own_cost[leader]]
    for inertia in np.linspace(settings.first_inertia, settings.last_inertia, settings.iterations):
        pull = settings.own * rng.random(place.shape) * (own - place)
        pull += settings.social * rng.random(place.shape) * (own[leader] - place)
        velocity = inertia * velocity + pull
        wanted = place + velocity
        place = np.clip(wanted, lower, upper)
        velocity[place != wanted] = 0.0
        cost = _cost(objective, place)
        better = cost < own_cost
        own[better], own_cost[better] = place[better], cost[better]
        leader = int(np.argmin(own_cost))
        history.append(own_cost[leader])
    if not np.isfinite(own_cost[leader]):
        raise UserError("no place the swarm saw has a finite cost: widen its box, or give it more particles")
    evaluations = settings.particles * (settings.iterations + 1)
    return SwarmResult(own[leader].copy(), float(own_cost[leader]), np.array(history), evaluations)


def _cost(objective: Objective, place: FloatArray) -> FloatArray:
    cost = np.asarray(objective(place), dtype=float)
    return np.where(np.isnan(cost), np.inf, cost)
