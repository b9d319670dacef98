"""PSO-LM as the paper publishes it (§4.1): a particle swarm over every parameter, then Levenberg-Marquardt.

    Phi <- Phi - (J'J + mu 1)^-1 J'r,     r = tau_meas - tau_model,  J = dr/dPhi

mu is halved on success and doubled on failure, and each trial is one of the 100 iterations. Where mu exceeds 1e3 the
swarm takes over for another round, one of its particles starting from the best place so far. All 12 rigid-body and 6
friction parameters a joint are searched, the Stribeck velocities among them and on no other scale.

What the paper leaves open, and ours, each an argument: the box (`box_of`: as far from the prior as a parameter may
well be); the first mu; the number of rounds; and when LM is done before its last iteration (the step's predicted
gain is no more than rounding: without that rule a solution that cannot be improved is always handed back). LM is not
kept in the box but for the Stribeck velocities, which have no meaning at zero; the swarm's box grows where it left.

This solver is here to be compared with. `separable` finds better minima, a hundred times as fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import lstsq

from ..arrays import FloatArray
from ..dynamics.model import Structure, TorqueModel
from ..regression.prior import Prior
from ..regression.regression import Regression
from . import pso
from .separable import Solution, solve_linear, system
from .swarm_cost import SwarmCost, Unknowns

Linearise = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Phi (d,) -> residual r (m,) and Jacobian dr/dPhi (m, d), both through any one rotation of the rows."""

CONVERGED, HANDED_BACK, EXHAUSTED = "converged", "handed back", "iteration limit"


@dataclass(frozen=True)
class LmSettings:
    """Stage 2.

    Attributes:
        iterations: K_LM of the paper; every trial step counts.
        first_damping: First mu; ours, in (N·m)^2 per squared unit of Phi, as J'J is.
        hand_back: mu above which the swarm takes over.
        tolerance: Done when a step promises less than this share of F; 0: never. Ours.
    """

    iterations: int = 100
    first_damping: float = 1.0
    hand_back: float = 1e3
    tolerance: float = 1e-12


@dataclass(frozen=True)
class PsoLmSettings:
    """Both stages; `rounds` is ours."""

    swarm: pso.SwarmSettings = field(default_factory=pso.SwarmSettings)
    lm: LmSettings = field(default_factory=LmSettings)
    rounds: int = 3


@dataclass(frozen=True)
class Refined:
    """Where LM ended.

    Attributes:
        point: (d,) Phi.
        cost: F there.
        costs: (k + 1,) F at the start and after each of k trials.
        dampings: (k + 1,) mu likewise.
        status: Why it stopped.
    """

    point: FloatArray
    cost: float
    costs: FloatArray
    dampings: FloatArray
    status: str


@dataclass(frozen=True)
class Round:
    """One pass through both stages."""

    swarm: pso.SwarmResult
    refined: Refined

    @property
    def words(self) -> str:
        """What happened."""
        trials = len(self.refined.costs) - 1
        return (
            f"PSO F {self.swarm.history[0]:.6g} -> {self.swarm.cost:.6g} in {len(self.swarm.history) - 1} iterations, "
            f"LM -> {self.refined.cost:.6g} in {trials} ({self.refined.status}, mu {self.refined.dampings[-1]:.2g})"
        )


@dataclass(frozen=True)
class PsoLm:
    """The best of all rounds.

    Attributes:
        point: (d,) Phi.
        cost: F there.
        rounds: What each did, in their order.
    """

    point: FloatArray
    cost: float
    rounds: tuple[Round, ...]


def refine(
    linearise: Linearise,
    start: FloatArray,
    settings: LmSettings | None = None,
    lower: FloatArray | None = None,
    upper: FloatArray | None = None,
) -> Refined:
    """Levenberg-Marquardt with the paper's mu.

    Args:
        linearise: The problem.
        start: (d,) where to begin.
        settings: The rule's numbers.
        lower: (d,) walls at which steps end; none where None.
        upper: (d,) likewise.
    """
    settings = settings or LmSettings()
    lower = np.full(len(start), -np.inf) if lower is None else lower
    upper = np.full(len(start), np.inf) if upper is None else upper
    point, damping, status = start, settings.first_damping, EXHAUSTED
    residual, jacobian = linearise(point)
    cost = 0.5 * float(residual @ residual)
    costs, dampings = [cost], [damping]
    for _ in range(settings.iterations):
        step, promised = _step_between(residual, jacobian, damping, lower - point, upper - point)
        if promised <= settings.tolerance * cost:
            status = CONVERGED
            break
        trial = np.clip(point + step, lower, upper)
        trial_residual, trial_jacobian = linearise(trial)
        trial_cost = 0.5 * float(trial_residual @ trial_residual)
        if trial_cost < cost:
            point, residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
            damping /= 2
        else:
            damping *= 2
        costs.append(cost)
        dampings.append(damping)
        if damping > settings.hand_back:
            status = HANDED_BACK
            break
    return Refined(point, cost, np.array(costs), np.array(dampings), status)


def _step_between(
    residual: FloatArray, jacobian: FloatArray, damping: float, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, float]:
    """A step, and what it promises; coordinates that stand at a wall and would cross it are left where they are."""
    free = np.ones(len(lower), dtype=bool)
    while True:
        step = np.zeros(len(lower))
        step[free], promised = _step(residual, jacobian[:, free], damping)
        crossing = ((step < 0) & (lower >= 0)) | ((step > 0) & (upper <= 0))
        if not crossing.any():
            return step, promised
        free &= ~crossing


def _step(residual: FloatArray, jacobian: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """-(J'J + mu 1)^-1 J'r, by the QR of [J; sqrt(mu) 1], and what it gains if the problem is linear."""
    width = jacobian.shape[1]
    damped = np.concatenate([jacobian, np.sqrt(damping) * np.eye(width)])
    step = -lstsq(damped, np.concatenate([residual, np.zeros(width)]), lapack_driver="gelsy")[0]
    after = residual + jacobian @ step
    return step, 0.5 * float(residual @ residual - after @ after)


def minimise(
    cost: pso.Objective,
    linearise: Linearise,
    lower: FloatArray,
    upper: FloatArray,
    rng: np.random.Generator,
    settings: PsoLmSettings | None = None,
    walls: tuple[FloatArray, FloatArray] | None = None,
) -> PsoLm:
    """The two stages, round by round, until LM does not hand back.

    Args:
        cost: F of a swarm.
        linearise: The same problem for LM.
        lower: (d,) lower end of the swarm's box.
        upper: (d,) its upper end.
        rng: Source of all chance.
        settings: Numbers of both stages.
        walls: (d,) lower and upper end of LM's steps; endless where None.

    Raises:
        UserError: As `pso.minimise`.
    """
    settings = settings or PsoLmSettings()
    lowest, highest = walls or (np.full(len(lower), -np.inf), np.full(len(lower), np.inf))
    rounds: list[Round] = []
    best: Refined | None = None
    for _ in range(settings.rounds):
        seeds = None
        if best is not None:
            seeds = best.point[None]
            lower, upper = np.minimum(lower, best.point), np.maximum(upper, best.point)
        swarm = pso.minimise(cost, lower, upper, rng, settings.swarm, seeds)
        refined = refine(linearise, swarm.best, settings.lm, lowest, highest)
        rounds.append(Round(swarm, refined))
        best = refined if best is None or refined.cost < best.cost else best
        if refined.status != HANDED_BACK:
            break
    assert best is not None, "at least one round"
    return PsoLm(best.point, best.cost, tuple(rounds))


def as_published(structure: Structure) -> Structure:
    """A structure with the paper's unknowns: k_1 estimated at every joint, no presliding distance."""
    return {
        **structure,
        "joint_spring": {"free": True},
        "stribeck_friction": {**structure.get("stribeck_friction", {}), "presliding": False},
    }


def box_of(
    model: TorqueModel, regression: Regression, prior: Prior, unknowns: Unknowns
) -> tuple[FloatArray, FloatArray]:
    """The swarm's box, (d,) lower and (d,) upper ends: ours, since the paper states none.

    Each parameter is within its prior's scale of its prior mean and in its bounds, each constant in its grid. The prior
    of f_b, believed equal to f_c, counts as zero here.

    Args:
        model: Prior means and bounds of the parameters.
        regression: Grids of the constants.
        prior: Scales of the parameters.
        unknowns: The d coordinates: free parameters, then searched constants.
    """
    ends = []
    for number in unknowns.free:
        parameter, scale = model.parameters[number], float(prior.scale[number])
        ends.append((max(parameter.prior - scale, parameter.lower), min(parameter.prior + scale, parameter.upper)))
    for number in unknowns.searched:
        grid = regression.grids[number]
        ends.append((float(grid[grid > 0][0]), float(grid[-1])))
    lower, upper = np.array(ends).reshape(-1, 2).T
    return lower, upper


def linearised(regression: Regression, unknowns: Unknowns) -> Linearise:
    """Residual and Jacobian of a regression's weighted rows, compressed: no prior takes part.

    Args:
        regression: Weighted rows of a model.
        unknowns: What Phi is: free parameters, then searched constants.

    Returns:
        Function of Phi (d,) that gives the residual and its Jacobian; the columns of constants are derivatives by their
        values, not their logarithms.
    """
    width = len(regression.model.parameters)
    nothing = Prior(np.zeros((0, width)), np.zeros(0), np.zeros(width), unknowns.held, unknowns.free)
    used = np.concatenate([unknowns.free, np.arange(width, width + len(unknowns.searched))])

    def linearise(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        parameters, constants = unknowns.split(point)
        matrix, vector = system(regression, nothing, constants, parameters, unknowns.searched)
        # The system's last columns are derivatives by the constants' logarithms.
        matrix[:, width:] /= constants[unknowns.searched]
        return vector - matrix[:, :width] @ parameters, -matrix[:, used]

    return linearise


def solve(
    regression: Regression, prior: Prior, seed: int = 0, settings: PsoLmSettings | None = None
) -> tuple[Solution, PsoLm]:
    """PSO-LM on a regression, with the weights it has; the prior only gives the box.

    Args:
        regression: Weighted rows.
        prior: Scales of the parameters, and which of them are free.
        seed: Seed of the particle swarm.
        settings: Numbers of both stages; the defaults of `PsoLmSettings` where None.

    Returns:
        The solution, and how the two stages came to it.

    Raises:
        UserError: The model is not of the paper's form: more than one constant shapes a joint's columns, or they depend
            on the rest of the model. Or a constant's columns cannot be tabulated.
    """
    unknowns = Unknowns.of(regression, prior)
    lower, upper = box_of(regression.model, regression, prior, unknowns)
    walls = np.full(len(lower), -np.inf), np.full(len(lower), np.inf)
    for wall, end in zip(walls, (lower, upper)):
        wall[len(unknowns.free) :] = end[len(unknowns.free) :]
    cost = SwarmCost(regression, unknowns, lower, upper)
    rng = np.random.default_rng(seed)
    found = minimise(cost, linearised(regression, unknowns), lower, upper, rng, settings, walls)
    parameters, constants = unknowns.split(found.point)
    trials = sum(len(part.refined.costs) - 1 for part in found.rounds)
    return Solution(parameters, constants, 2 * found.cost, trials, found.rounds[-1].refined.status), found


def gap(regression: Regression, prior: Prior, solution: Solution) -> float:
    """Square root of the ratio of a solution's squares to those of the exact parameters at the same constants.

    Args:
        regression: Weighted rows.
        prior: Which parameters are free; its beliefs take no part.
        solution: With its cost on these rows, without a prior.

    Returns:
        The ratio; infinite where the exact parameters leave no residual.
    """
    empty = Prior(prior.rows[:0], prior.target[:0], prior.scale, prior.held, prior.free)
    exact = solve_linear(regression, empty, solution.constants)[1]
    return float(np.sqrt(solution.cost / exact)) if exact > 0 else float("inf")
