"""`Fit`: a regression and its solution under the weights that its own residual shows.

What every solver shares: how rows are weighted, what is known of the noise, the covariance that follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import BaseParameters, base_parameters
from ..dynamics.model import TorqueModel
from ..dynamics.rigid_body import TorqueOffset
from ..estimate.environment import GRAVITY_SCALE
from ..noise.between import friction_shifts
from ..noise.uncertainty import covariance
from ..noise.weights import Noise, reweight
from ..regression.prior import Prior, make_prior
from ..regression.regression import Regression
from ..signals.motion import Motion
from ..signals.prepare import require_torque
from ..solvers import pso_lm
from ..solvers.separable import PRESENCE_GATE, Solution, exact, grid_search, solve, system, without_constants
from ..solvers.solution_columns import columns_at, residuals_of
from .cad_scale import with_cad_scale

REWEIGHTINGS = 2


@dataclass
class Fit:
    """A regression, its solution and the noise its residual shows; how the solver worked, in words."""

    regression: Regression
    prior: Prior
    solution: Solution
    residuals: list[FloatArray]
    noise: list[list[Noise]]
    stages: tuple[str, ...] = ()


def fit_model(model: TorqueModel, motions: list[Motion], start: Fit | None = None) -> Fit:
    """Solve, weight the rows by what the residual shows, solve again.

    Args:
        model: Terms whose parameters and constants are fitted.
        motions: One or more, with the arm's joints in its order.
        start: A fit of a model of the same terms to the same motions. Its row weights and constants are where the
            solver begins, and its CAD scale is kept.

    Raises:
        UnfitDataError: A joint moves without any torque.
    """
    require_torque(motions)
    shared = start.regression if start and start.regression.model.arm is model.arm else None
    regression = Regression(model, motions, shared)
    prior = make_prior(model, motions, 1.0 if start is None else start.prior.cad_scale)
    if start is None:
        solution = searched(regression, prior)
        prior = with_cad_scale(regression, prior, solution.constants)
        solution = exact(regression, prior, solution.constants)
    else:
        for rows, known in zip(regression.rows, start.regression.rows):
            rows.set_weight(known.weight)
        solution = exact(regression, prior, allowed(regression, start.solution.constants))
    solution, noise = reweighted(regression, prior, solution)
    return Fit(regression, prior, solution, residuals_of(regression, solution), noise)


def allowed(regression: Regression, constants: FloatArray) -> FloatArray:
    """Constants of another structure of the same terms: zero where this one does not have them.

    Args:
        regression: Of the structure that has fewer.
        constants: (c,) of the other one.

    Returns:
        (c,) for this one.
    """
    absent = np.array([grid[-1] <= 0.0 for grid in regression.grids], dtype=bool)
    return np.where(absent, 0.0, constants)


def with_hidden_speeds(fit: Fit) -> Fit:
    """A fit with the Stribeck velocities that a model with an offset at every joint has, where its own has none.

    The constants of a fit of the paper's law shape the columns that are offered to the choice of terms. An offset that
    this law lacks stays in its residual, slow and large, and hides a Stribeck velocity from the search: that term could
    not be chosen then.

    Args:
        fit: Of the paper's law.

    Returns:
        The fit, with other constants where there are any; parameters and weights are as they were.
    """
    model, constants = fit.regression.model, fit.solution.constants
    lacking = {c.joint for c, value in zip(model.constants, constants) if c.symbol == "v_b" and not value}
    if not lacking:
        return fit
    with_offsets = fit_model(TorqueModel(model.arm, {**model.structure, TorqueOffset.kind: {}}), fit.regression.motions)
    known = {
        c.name: value for c, value in zip(with_offsets.regression.model.constants, with_offsets.solution.constants)
    }
    hidden = {joint for joint in lacking if known[f"v_b[{joint}]"] > 0.0}
    found = [known[c.name] if c.joint in hidden else value for c, value in zip(model.constants, constants)]
    return replace(fit, solution=replace(fit.solution, constants=np.array(found)))


def searched(regression: Regression, prior: Prior) -> Solution:
    """Constants that a search finds under weights that a more flexible one's residual shows, and exact parameters.

    Args:
        regression: Rows; their weights are set.
        prior: Of the parameters.
    """
    _first_weights(regression)
    first = without_constants(regression, prior)
    regression.update_background(first.parameters, first.constants)
    reweight(regression, residuals_of(regression, first))
    # What a model leaves out makes its residual loud and slow, and a test under its weights blind. So the search is
    # first free to take what helps, and what then is left weighs the rows of the search that counts. For weights the
    # grid's constants are near enough: to refine them took 0.45 of 1.9 s on two recordings of a UR10e.
    flexible = exact(regression, prior, grid_search(regression, gate=0.0))
    for _ in range(REWEIGHTINGS):
        reweight(regression, residuals_of(regression, flexible))
        flexible = exact(regression, prior, flexible.constants)
    reweight(regression, residuals_of(regression, flexible))
    return exact(regression, prior, grid_search(regression, PRESENCE_GATE))


def reweighted(regression: Regression, prior: Prior, solution: Solution) -> tuple[Solution, list[list[Noise]]]:
    """A solution under the weights that its own residual shows, its constants refined under the last, and that noise.

    Args:
        regression: Rows; their weights are set `REWEIGHTINGS` times.
        prior: Of the parameters.
        solution: Solution on these rows; the solver begins at its constants.

    Returns:
        The solution, and the noise of its residual by joint and motion.
    """
    for _ in range(REWEIGHTINGS - 1):
        reweight(regression, residuals_of(regression, solution))
        solution = exact(regression, prior, solution.constants)
    noise = reweight(regression, residuals_of(regression, solution))
    return solve(regression, prior, solution.constants), noise


def fit_as_published(model: TorqueModel, motions: list[Motion], seed: int) -> Fit:
    """PSO-LM on rows of equal weight; what its residual shows is for the standard errors only.

    Args:
        model: Of the paper's form, see `pso_lm.as_published`.
        motions: One or more, with the arm's joints in its order.
        seed: Seed of the particle swarm.

    Raises:
        UnfitDataError: A joint moves without any torque.
        UserError: As `pso_lm.solve`.
    """
    require_torque(motions)
    regression = Regression(model, motions)
    prior = make_prior(model, motions)
    solution, found = pso_lm.solve(regression, prior, seed)
    excess = pso_lm.gap(regression, prior, solution)
    stages = [f"round {number}: {part.words}" for number, part in enumerate(found.rounds, start=1)]
    stages.append(f"its residual is {excess:.4g} times what exact parameters leave beside its Stribeck velocities")
    residuals = residuals_of(regression, solution)
    noise = reweight(regression, residuals)
    matrix, vector = system(regression, prior, solution.constants)
    solution = replace(solution, cost=float(np.sum((matrix @ solution.parameters - vector) ** 2)))
    return Fit(regression, prior, solution, residuals, noise, tuple(stages))


def refitted(known: Fit, motions: list[Motion]) -> tuple[Regression, Prior, Solution, list[list[Noise]]]:
    """Least squares on the same recordings prepared in another way, from the constants that are known.

    Args:
        known: Fit of the model to the recordings; its CAD scale is kept.
        motions: The recordings, prepared in that way.

    Returns:
        Weighted rows, prior, solution, and the noise of its residual by joint and motion.
    """
    regression = Regression(known.regression.model, motions)
    prior = make_prior(known.regression.model, motions, known.prior.cad_scale)
    _first_weights(regression)
    return regression, prior, *reweighted(regression, prior, solve(regression, prior, known.solution.constants))


def _first_weights(regression: Regression) -> None:
    """Before any residual is known: rows in units of a tenth of their joint's torque."""
    for rows in regression.rows:
        if len(rows.torque):
            size = float(np.sqrt(np.mean(rows.torque**2))) or 1.0
            rows.set_weight(np.full(len(rows.torque), 10.0 / size))


def freedom(fit: Fit) -> dict[str, float]:
    """Joint -> effective rows beyond its own columns; at least one."""
    numbers = columns_at(fit.regression, fit.solution.constants)[1]
    effective = [sum(noise.rows / noise.correlation_rows for noise in joint) for joint in fit.noise]
    joints = fit.regression.model.arm.joint_names
    return {name: max(rows - len(own), 1.0) for name, rows, own in zip(joints, effective, numbers)}


def covariance_of(fit: Fit, further: Sequence[FloatArray] = ()) -> FloatArray:
    """Covariance of parameters and constants (the latter in their own units), and of what else is unknown.

    Of the residual, and of what differs between recordings (`between.py`).

    Args:
        fit: With p parameters and c constants.
        further: Per joint, columns (M, d) of unknowns numbered last, gravity's, with a prior of `GRAVITY_SCALE`.

    Returns:
        (p + c + d, p + c + d) in the units of the parameters and constants.
    """
    regression, solution = fit.regression, fit.solution
    count = len(regression.model.parameters)
    columns, numbers = columns_at(regression, solution.constants)
    for term, first, terms in regression.shaped_terms():
        for k in range(terms):
            if solution.constants[first + k] <= 0:
                continue
            derivative = regression.derivatives(term, solution.constants[first : first + terms], k, solution.parameters)
            for joint, column in derivative.items():
                columns[joint] = np.column_stack([columns[joint], column])
                numbers[joint].append(count + first + k)
    correlation = [[noise.correlation_rows for noise in joint] for joint in fit.noise]
    prior, known = fit.prior, count + len(regression.model.constants)
    more = further[0].shape[1] if further else 0
    if further:
        columns = [np.column_stack(pair) for pair in zip(columns, further)]
        numbers = [[*own, *range(known, known + more)] for own in numbers]
        beliefs = np.pad(prior.rows, ((0, more), (0, known + more - count)))
        beliefs[len(prior.rows) :, known:] = np.eye(more) / GRAVITY_SCALE
        prior = replace(prior, rows=beliefs)
    by_logarithm = covariance(
        regression, prior, solution.constants, columns, numbers, fit.residuals, correlation, known + more
    )
    between = friction_shifts(regression, solution.parameters, columns, numbers, fit.residuals, known + more)
    by_logarithm += between.T @ between
    unit = np.concatenate([np.ones(count), solution.constants, np.ones(more)])
    return np.asarray(by_logarithm * np.outer(unit, unit))


def revealed(regression: Regression) -> BaseParameters:
    """The base parameters that motions of this kind can reveal: more where the base moves, and is measured."""
    moving = any(motion.base is not None for motion in regression.motions)
    return base_parameters(regression.model, moving_base=moving)
