"""From recordings to an `Identified` model: the one pass every front end calls.

Recordings -> motions -> regression -> solution, reweighted by its own residual -> structure -> standard errors ->
physically consistent full set -> what determined each of the parameters -> the free base that carries the arm. The
solver is the separable one unless another of `solvers` is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.base_link import base_notes, placed
from ..dynamics.base_parameters import BaseParameters, base_parameters
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel, structure_of
from ..errors import UnfitDataError, UserError
from ..recording.motion import Motion
from ..recording.recording import Recording
from ..recording.signals import prepare, require_joints
from . import instrumental, pso_lm
from .consistency import make_consistent
from .determination import judge, open_ended
from .identified import Choice, Identified
from .momentum import base_body
from .prior import Prior, make_prior
from .regression import Regression
from .separable import PRESENCE_GATE, Solution, solve, system, without_constants
from .solution_columns import all_columns, residuals_of
from .solvers import IDIM_IV, PSO_LM, SEEDED, SEPARABLE, Search, require_solver, search_of
from .structure import choose_structure
from .uncertainty import covariance
from .weights import Noise, reweight

Progress = Callable[[float, str], None]
REWEIGHTINGS = 2


@dataclass(frozen=True)
class Settings:
    """What a user may decide about an identification.

    Attributes:
        cutoff_hz: Low-pass cut-off; chosen from the data where None.
        structure: Terms and options; None: the paper's, and what of `structure.OPTIONAL` the data demand.
        solver: One of `solvers.SOLVERS`. `pso-lm` takes the paper's unknowns, and nothing the data might demand.
        seed: Of the particle swarms: the same seed gives the same result.
    """

    cutoff_hz: float | None = None
    structure: Structure | None = None
    solver: str = SEPARABLE
    seed: int = 0


@dataclass
class _Fit:
    """A regression, its solution and the noise its residual shows; how the solver worked, in words."""

    regression: Regression
    prior: Prior
    solution: Solution
    residuals: list[FloatArray]
    noise: list[list[Noise]]
    stages: tuple[str, ...] = ()


def identify(
    recordings: Sequence[Recording],
    arm: Arm,
    settings: Settings | None = None,
    progress: Progress | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Identified:
    """Identify an arm from one or more recordings.

    Args:
        recordings: Runs of the same arm; each must hold every joint of `arm`.
        arm: What is known before.
        settings: Decisions of the user.
        progress: Called with a share done in 0..1 and what is being done.
        provenance: Kept in the model file.

    Raises:
        UnfitDataError: No motion, no torque, or too short.
        UserError: A joint of the arm that a recording does not have, or no solver of that name.
    """
    settings = settings or Settings()
    require_solver(settings.solver)
    report = progress or (lambda share, what: None)
    _check(recordings, arm)
    report(0.0, "filtering")
    on_base = base_notes(recordings, arm)
    recordings = placed(recordings, arm)
    motions, bandwidth = prepare(recordings, arm.joint_names, settings.cutoff_hz)
    report(0.2, "searching the friction constants")
    choices: tuple[Choice, ...] = ()
    model = TorqueModel(arm, settings.structure or structure_of(arm))
    if settings.solver == PSO_LM:
        fit = _fit_as_published(TorqueModel(arm, pso_lm.as_published(model.structure)), motions, settings.seed)
    else:
        search = search_of(settings.solver, settings.seed)
        fit = _fit(model, motions, search)
        if settings.structure is None:
            report(0.5, "testing what else the data demand")
            structure, choices = choose_structure(fit.regression, fit.solution)
            if structure != fit.regression.model.structure:
                fit = _fit(TorqueModel(arm, structure), motions, search, fit)
    if settings.solver == IDIM_IV:
        report(0.7, "comparing with instrumental variables")
        fit = _fit_instrumental(fit, recordings, bandwidth.cutoff_hz)
    report(0.8, "standard errors and physical consistency")
    result = _conclude(fit, provenance or {}, choices, bandwidth, _solver_words(settings, fit.solution))
    body, words = base_body(motions, result.model, result.covariance)
    result = replace(result, base_body=body, notes=(*result.notes, *on_base, *words))
    report(1.0, "done")
    return result


def _check(recordings: Sequence[Recording], arm: Arm) -> None:
    if not recordings:
        raise UserError("no recording was given: name at least one bag")
    for recording in recordings:
        require_joints(recording, arm.joint_names)
        where = recording.sources[0].path if recording.sources else "the recording"
        if not np.any(recording.in_order(arm.joint_names).effort):
            raise UnfitDataError(
                f"{where}: every torque is zero: record effort = current x torque constant x gear ratio"
            )


def _fit(model: TorqueModel, motions: list[Motion], search: Search, start: _Fit | None = None) -> _Fit:
    """Solve, weight the rows by what the residual shows, solve again."""
    regression = Regression(model, motions, start.regression if start else None)
    prior = make_prior(model, motions)
    if start is None:
        solution = searched(regression, prior, search)
    else:
        for rows, known in zip(regression.rows, start.regression.rows):
            rows.set_weight(known.weight)
        solution = solve(regression, prior, start.solution.constants)
    solution, noise = reweighted(regression, prior, solution)
    return _Fit(regression, prior, solution, residuals_of(regression, solution), noise)


def searched(regression: Regression, prior: Prior, search: Search) -> Solution:
    """What a search over the constants finds, under weights that a more flexible one's residual shows."""
    _first_weights(regression)
    reweight(regression, residuals_of(regression, without_constants(regression, prior)))
    # What a model leaves out makes its residual loud and slow, and a test under its weights blind. So the search is
    # first free to take what helps, and what then is left weighs the rows of the search that counts.
    flexible = solve(regression, prior, search(regression, prior, 0.0), gate=0.0)
    for _ in range(REWEIGHTINGS):
        reweight(regression, residuals_of(regression, flexible))
        flexible = solve(regression, prior, flexible.constants)
    reweight(regression, residuals_of(regression, flexible))
    return solve(regression, prior, search(regression, prior, PRESENCE_GATE))


def reweighted(regression: Regression, prior: Prior, solution: Solution) -> tuple[Solution, list[list[Noise]]]:
    """A solution refined under the weights that its own residual shows, and that noise."""
    noise: list[list[Noise]] = []
    for _ in range(REWEIGHTINGS):
        noise = reweight(regression, residuals_of(regression, solution))
        solution = solve(regression, prior, solution.constants)
    return solution, noise


def _fit_as_published(model: TorqueModel, motions: list[Motion], seed: int) -> _Fit:
    """PSO-LM on rows of equal weight; what its residual shows is for the standard errors only."""
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
    return _Fit(regression, prior, solution, residuals, noise, tuple(stages))


def _fit_instrumental(known: _Fit, recordings: Sequence[Recording], cutoff_hz: float) -> _Fit:
    """Instrumental variables in the structure that least squares chose, and the verdict on how far apart they are."""
    model = known.regression.model
    plain, first, second = instrumental.split_motions(recordings, model.arm.joint_names, cutoff_hz)
    regression = Regression(model, plain)
    prior = make_prior(model, plain)
    _first_weights(regression)
    solution, noise = reweighted(regression, prior, solve(regression, prior, known.solution.constants))
    parameters = instrumental.instrumental(
        regression, Regression(model, first), Regression(model, second), prior, solution
    )
    residuals = residuals_of(regression, solution)
    base = _base_parameters(regression)
    fit = _Fit(regression, prior, replace(solution, parameters=parameters), residuals, noise)
    errors = _base_errors(base, _covariance(fit), len(parameters))
    verdict = instrumental.compare(base, parameters, solution.parameters, errors)
    return replace(fit, stages=(verdict.words,))


def _base_parameters(regression: Regression) -> BaseParameters:
    moving = any(motion.base is not None for motion in regression.motions)
    return base_parameters(regression.model, moving_base=moving)


def _base_errors(base: BaseParameters, spread: FloatArray, count: int) -> FloatArray:
    """(b,) standard errors of the base parameters."""
    return np.sqrt(np.maximum(np.diag(base.regrouping @ spread[:count, :count] @ base.regrouping.T), 0.0))


def _solver_words(settings: Settings, solution: Solution) -> str:
    seed = f" (seed {settings.seed})" if settings.solver in SEEDED else ""
    return f"{settings.solver}{seed}, Levenberg-Marquardt on all: {solution.status} after {solution.iterations} steps"


def _first_weights(regression: Regression) -> None:
    """Before any residual is known: rows in units of a tenth of their joint's torque."""
    for rows in regression.rows:
        if len(rows.torque):
            size = float(np.sqrt(np.mean(rows.torque**2))) or 1.0
            rows.set_weight(np.full(len(rows.torque), 10.0 / size))


def _conclude(
    fit: _Fit, provenance: Mapping[str, Any], choices: tuple[Choice, ...], bandwidth: Any, solver: str
) -> Identified:
    regression, prior, solution = fit.regression, fit.prior, fit.solution
    model = regression.model
    spread = _covariance(fit)
    matrix, _ = system(regression, prior, solution.constants)
    consistent = make_consistent(model, matrix, solution.parameters, prior.scale)
    base = _base_parameters(regression)
    values = base.regrouping @ solution.parameters
    count = len(model.parameters)
    errors = _base_errors(base, spread, count)
    at_rest = tuple(
        joint
        for k, joint in enumerate(model.arm.joint_names)
        if not any(motion.moving[:, k].any() for motion in regression.motions)
    )
    unseen = open_ended(regression, prior, solution)
    estimates = judge(model, prior, base, consistent, solution.constants, spread, regression.grids, at_rest, unseen)
    identified_model = IdentifiedModel(model, consistent, solution.constants, bandwidth.cutoff_hz, dict(provenance))
    return Identified(
        model=identified_model,
        estimates=estimates,
        base=base,
        base_values=values,
        base_errors=errors,
        covariance=spread,
        consistency_shift=_shift(base, consistent - solution.parameters, errors),
        residual_sigma_Nm=np.array([np.sqrt(np.mean(r**2)) if len(r) else np.nan for r in fit.residuals]),
        rows=np.array([len(r) for r in fit.residuals]),
        bandwidth=bandwidth,
        choices=choices,
        solver=solver,
        joints_at_rest=at_rest,
        notes=(*_notes(regression.motions, at_rest), *fit.stages),
    )


def _covariance(fit: _Fit) -> FloatArray:
    """Covariance of parameters and constants (the latter in their own units)."""
    regression, solution = fit.regression, fit.solution
    count = len(regression.model.parameters)
    columns, numbers = all_columns(regression, solution)
    for term, first, terms in regression.shaped_terms():
        for k in range(terms):
            if solution.constants[first + k] <= 0:
                continue
            derivative = regression.derivatives(term, solution.constants[first : first + terms], k, solution.parameters)
            for joint, column in derivative.items():
                columns[joint] = np.column_stack([columns[joint], column])
                numbers[joint].append(count + first + k)
    correlation = [[noise.correlation_rows for noise in joint] for joint in fit.noise]
    width = count + len(regression.model.constants)
    by_logarithm = covariance(regression, fit.prior, columns, numbers, fit.residuals, correlation, width)
    unit = np.concatenate([np.ones(count), solution.constants])
    return np.asarray(by_logarithm * np.outer(unit, unit))


def _shift(base: BaseParameters, change: FloatArray, errors: FloatArray) -> float:
    """Largest change of a base parameter in its standard errors."""
    known = errors > 0
    return float(np.max(np.abs(base.regrouping @ change)[known] / errors[known], initial=0.0))


def _notes(motions: Sequence[Motion], at_rest: Sequence[str]) -> tuple[str, ...]:
    notes = []
    averaged = [motion for motion in motions if motion.cyclic]
    for motion in averaged:
        notes.append(
            f"recording {motion.source + 1}: {motion.periods} periods of "
            f"{len(motion.position) / motion.rate_hz:.4g} s averaged"
        )
    for joint in at_rest:
        notes.append(f"{joint} never moves: nothing is known of its friction, and less of its inertia")
    return tuple(notes)


def with_provenance(identified: Identified, provenance: Mapping[str, Any]) -> Identified:
    """The same result with its sources and versions noted in the model."""
    return replace(identified, model=replace(identified.model, provenance=dict(provenance)))
