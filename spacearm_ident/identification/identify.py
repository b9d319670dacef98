"""From recordings to an `Identified` model: the one pass every front end calls.

Recordings -> motions -> regression -> solution, reweighted by its own residual -> structure -> standard errors ->
physically consistent full set -> what determined each of the parameters. The solver is the separable one unless
another of `solvers` is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.base_parameters import base_parameters
from ..dynamics.model import (
    IdentifiedModel,
    Structure,
    TorqueModel,
    over_temperature,
    structure_of,
)
from ..errors import UnfitDataError, UserError
from ..recording.motion import Motion
from ..recording.recording import Recording
from ..recording.signals import prepare, require_joints
from . import instrumental, output_error, pso_lm
from .comparison import compare
from .consistency import make_consistent
from .determination import judge, open_ended
from .environment import GRAVITY_SCALE, Environment, GravityEstimate, judge_vacuum, without_temperature
from .from_prior import GroundPrior
from .gravity import require_gravity_choice
from .identified import Choice, Identified
from .prior import Prior, make_prior
from .regression import Regression
from .separable import PRESENCE_GATE, Solution, solve, system, without_constants
from .solution_columns import all_columns, residuals_of
from .solvers import CLOE, IDIM_IV, PSO_LM, SEEDED, SEPARABLE, Search, require_solver, search_of
from .structure import choose_structure
from .uncertainty import covariance
from .updated import identify_from_prior
from .weighing import Weighing
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
        temperature: What of friction follows the joints' temperatures, some of `model.OVER_TEMPERATURE`; beside
            `structure`, which has none of it.
        gravity: How gravity is estimated, one of `gravity.GRAVITY_CHOICES`; empty: it is the arm's.
        prior: A ground model that the data update (`updated.py`): structure, masses and geometry are its own, gravity
            is the arm's. With it go `cutoff_hz` and `gravity` alone.
    """

    cutoff_hz: float | None = None
    structure: Structure | None = None
    solver: str = SEPARABLE
    seed: int = 0
    temperature: tuple[str, ...] = ()
    gravity: str = ""
    prior: GroundPrior | None = None


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
    if settings.prior is not None:
        report(0.0, "updating the prior")
        ground = settings.prior.under(arm.gravity)
        known = ground.model.model.arm.joint_names
        if known != arm.joint_names:
            raise UserError(f"the prior is of another arm: its joints are {', '.join(known)}")
        return identify_from_prior(recordings, ground, settings.cutoff_hz, settings.gravity, provenance)
    report(0.0, "filtering")
    motions, bandwidth = prepare(recordings, arm.joint_names, settings.cutoff_hz)
    report(0.2, "searching the friction constants")
    choices: tuple[Choice, ...] = ()
    model = TorqueModel(arm, over_temperature(settings.structure or structure_of(arm), arm, settings.temperature))
    if settings.solver == CLOE:
        output_error.require_simulated(model.structure)
    weighing = _weighing(settings, arm, motions)
    if settings.solver == PSO_LM:
        fit = _fit_as_published(TorqueModel(arm, pso_lm.as_published(model.structure)), motions, settings.seed)
    else:
        search = search_of(settings.solver, settings.seed)
        fit = weighing.settle(_fit(model, motions, search))
        if settings.structure is None:
            report(0.5, "testing what else the data demand")
            structure, choices = choose_structure(fit.regression, fit.solution)
            if structure != fit.regression.model.structure:
                fit = _fit(TorqueModel(fit.regression.model.arm, structure), motions, search, fit)
                fit = weighing.settle(fit)
    if settings.solver == IDIM_IV:
        report(0.7, "comparing with instrumental variables")
        fit = _fit_instrumental(fit, recordings, bandwidth.cutoff_hz)
    elif settings.solver == CLOE:
        report(0.7, "simulating the closed loop")
        fit = _fit_output_error(fit, recordings, bandwidth.cutoff_hz)
    report(0.8, "standard errors and physical consistency")
    fit, gravity = weighing.conclude(fit)
    further = weighing.further(fit)
    result = _conclude(
        fit, provenance or {}, choices, bandwidth, _solver_words(settings, fit.solution), gravity, further
    )
    report(1.0, "done")
    return result


def _weighing(settings: Settings, arm: Arm, motions: list[Motion]) -> Weighing[_Fit]:
    """How gravity is estimated, if it is.

    Raises:
        UserError: The solver asked for cannot.
    """
    for asked, words in ((settings.gravity, "gravity"), (settings.temperature, "friction over temperature")):
        if asked and settings.solver in (PSO_LM, IDIM_IV, CLOE):
            raise UserError(f"the solver {settings.solver} does not estimate {words}: take {SEPARABLE}")
    search = search_of(settings.solver, settings.seed)
    return Weighing(
        require_gravity_choice(settings.gravity, arm.gravity),
        arm.gravity,
        lambda model, start: _fit(model, motions, search, start),
        _covariance,
        lambda fit: max(sum(_freedom(fit).values()), 1.0),
    )


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
    shared = start.regression if start and start.regression.model.arm is model.arm else None
    regression = Regression(model, motions, shared)
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
    regression, prior, solution, noise = _refitted(known, plain)
    parameters = instrumental.instrumental(
        regression, Regression(model, first), Regression(model, second), prior, solution
    )
    residuals = residuals_of(regression, solution)
    fit = _Fit(regression, prior, replace(solution, parameters=parameters), residuals, noise)
    return _compared("instrumental variables", fit, solution.parameters)


def _fit_output_error(known: _Fit, recordings: Sequence[Recording], cutoff_hz: float) -> _Fit:
    """Closed-loop output error in the structure that least squares chose, and the verdict on how far apart they are."""
    plain, _ = prepare(recordings, known.regression.model.arm.joint_names, cutoff_hz, average=False)
    regression, prior, solution, noise = _refitted(known, plain)
    found = output_error.solve(recordings, regression, prior, solution, cutoff_hz)
    residuals = residuals_of(found.regression, found.solution)
    fit = _Fit(found.regression, prior, found.solution, residuals, noise, (found.words,))
    return _compared("closed-loop output errors", fit, found.least_squares)


def _refitted(known: _Fit, motions: list[Motion]) -> tuple[Regression, Prior, Solution, list[list[Noise]]]:
    """Least squares on the same recordings made ready in another way, from the constants that are known."""
    regression = Regression(known.regression.model, motions)
    prior = make_prior(known.regression.model, motions)
    _first_weights(regression)
    return regression, prior, *reweighted(regression, prior, solve(regression, prior, known.solution.constants))


def _compared(method: str, fit: _Fit, least_squares: FloatArray) -> _Fit:
    """The fit, with the verdict on how far from least squares (p,) it is."""
    base = base_parameters(fit.regression.model)
    verdict = compare(method, base, fit.solution.parameters, least_squares, base.errors(_covariance(fit)))
    return replace(fit, stages=(*fit.stages, verdict.words))


def _solver_words(settings: Settings, solution: Solution) -> str:
    if settings.solver == CLOE:
        return f"{CLOE}, {solution.status} after {solution.iterations} simulations"
    seed = f" (seed {settings.seed})" if settings.solver in SEEDED else ""
    return f"{settings.solver}{seed}, Levenberg-Marquardt on all: {solution.status} after {solution.iterations} steps"


def _freedom(fit: _Fit) -> dict[str, float]:
    """Joint -> effective rows beyond its own columns; at least one."""
    numbers = all_columns(fit.regression, fit.solution)[1]
    effective = [sum(noise.rows / noise.correlation_rows for noise in joint) for joint in fit.noise]
    joints = fit.regression.model.arm.joint_names
    return {name: max(rows - len(own), 1.0) for name, rows, own in zip(joints, effective, numbers)}


def _first_weights(regression: Regression) -> None:
    """Before any residual is known: rows in units of a tenth of their joint's torque."""
    for rows in regression.rows:
        if len(rows.torque):
            size = float(np.sqrt(np.mean(rows.torque**2))) or 1.0
            rows.set_weight(np.full(len(rows.torque), 10.0 / size))


def _conclude(
    fit: _Fit,
    provenance: Mapping[str, Any],
    choices: tuple[Choice, ...],
    bandwidth: Any,
    solver: str,
    gravity: GravityEstimate | None,
    further: list[FloatArray],
) -> Identified:
    regression, prior, solution = fit.regression, fit.prior, fit.solution
    model = regression.model
    whole = len(model.parameters) + len(model.constants)
    spread = _covariance(fit, further)[:whole, :whole]
    matrix, _ = system(regression, prior, solution.constants)
    consistent = make_consistent(model, matrix, solution.parameters, prior.scale)
    base = base_parameters(model)
    values = base.regrouping @ solution.parameters
    errors = base.errors(spread)
    at_rest = tuple(
        joint
        for k, joint in enumerate(model.arm.joint_names)
        if not any(motion.moving[:, k].any() for motion in regression.motions)
    )
    unseen = open_ended(regression, prior, solution)
    estimates = judge(model, prior, base, consistent, solution.constants, spread, regression.grids, at_rest, unseen)
    environment = Environment(
        judge_vacuum(model.parameters, solution.parameters, spread, prior.scale, _freedom(fit)),
        gravity,
        without_temperature(model, regression.motions),
    )
    identified_model = IdentifiedModel(model, consistent, solution.constants, bandwidth.cutoff_hz, dict(provenance))
    return Identified(
        model=identified_model,
        estimates=estimates,
        base=base,
        base_values=values,
        base_errors=errors,
        covariance=spread,
        consistency_shift=base.shift(consistent - solution.parameters, errors),
        residual_sigma_Nm=np.array([np.sqrt(np.mean(r**2)) if len(r) else np.nan for r in fit.residuals]),
        rows=np.array([len(r) for r in fit.residuals]),
        bandwidth=bandwidth,
        choices=choices,
        solver=solver,
        joints_at_rest=at_rest,
        notes=(*_notes(regression.motions, at_rest), *environment.notes, *fit.stages),
        environment=environment,
    )


def _covariance(fit: _Fit, further: Sequence[FloatArray] = ()) -> FloatArray:
    """Covariance of parameters and constants (the latter in their own units), and of what else is unknown.

    `further`: per joint, columns (M, d) of unknowns numbered last, gravity's, believed within `GRAVITY_SCALE`.
    """
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
    prior, known = fit.prior, count + len(regression.model.constants)
    more = further[0].shape[1] if further else 0
    if further:
        columns = [np.column_stack(pair) for pair in zip(columns, further)]
        numbers = [[*own, *range(known, known + more)] for own in numbers]
        beliefs = np.pad(prior.rows, ((0, more), (0, known + more - count)))
        beliefs[len(prior.rows) :, known:] = np.eye(more) / GRAVITY_SCALE
        prior = replace(prior, rows=beliefs)
    by_logarithm = covariance(regression, prior, columns, numbers, fit.residuals, correlation, known + more)
    unit = np.concatenate([np.ones(count), solution.constants, np.ones(more)])
    return np.asarray(by_logarithm * np.outer(unit, unit))


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
