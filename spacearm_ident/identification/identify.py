"""From recordings to an `Identified` model: the one pass every front end calls.

Recordings -> motions -> regression -> separable solution, reweighted by its own residual -> structure -> standard
errors -> physically consistent full set -> what determined each of the parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.base_parameters import BaseParameters, base_parameters
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel, structure_of
from ..errors import UnfitDataError, UserError
from ..recording.motion import Motion
from ..recording.recording import Recording
from ..recording.signals import prepare, require_joints
from .consistency import make_consistent
from .determination import judge, open_ended
from .identified import Choice, Identified
from .prior import Prior, make_prior
from .regression import Regression
from .separable import Solution, solve, system, without_constants
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
    """

    cutoff_hz: float | None = None
    structure: Structure | None = None


@dataclass
class _Fit:
    """A regression, its solution and the noise its residual shows."""

    regression: Regression
    prior: Prior
    solution: Solution
    residuals: list[FloatArray]
    noise: list[list[Noise]]


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
        UserError: A joint of the arm that a recording does not have.
    """
    settings = settings or Settings()
    report = progress or (lambda share, what: None)
    _check(recordings, arm)
    report(0.0, "filtering")
    motions, bandwidth = prepare(recordings, arm.joint_names, settings.cutoff_hz)
    report(0.2, "searching the friction constants")
    choices: tuple[Choice, ...] = ()
    fit = _fit(TorqueModel(arm, settings.structure or structure_of(arm)), motions)
    if settings.structure is None:
        report(0.5, "testing what else the data demand")
        structure, choices = choose_structure(fit.regression, fit.solution)
        if structure != fit.regression.model.structure:
            fit = _fit(TorqueModel(arm, structure), motions, fit)
    report(0.8, "standard errors and physical consistency")
    result = _conclude(fit, provenance or {}, choices, bandwidth)
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


def _fit(model: TorqueModel, motions: list[Motion], start: _Fit | None = None) -> _Fit:
    """Solve, weight the rows by what the residual shows, solve again."""
    regression = Regression(model, motions, start.regression if start else None)
    prior = make_prior(model, motions)
    if start is None:
        _first_weights(regression)
        reweight(regression, residuals_of(regression, without_constants(regression, prior)))
        # What a model leaves out makes its residual loud and slow, and a test under its weights blind. So the search is
        # first free to take what helps, and what then is left weighs the rows of the search that counts.
        flexible = solve(regression, prior, gate=0.0)
        for _ in range(REWEIGHTINGS):
            reweight(regression, residuals_of(regression, flexible))
            flexible = solve(regression, prior, flexible.constants)
        reweight(regression, residuals_of(regression, flexible))
        solution = solve(regression, prior)
    else:
        for rows, known in zip(regression.rows, start.regression.rows):
            rows.set_weight(known.weight)
        solution = solve(regression, prior, start.solution.constants)
    residuals = residuals_of(regression, solution)
    noise: list[list[Noise]] = []
    for _ in range(REWEIGHTINGS):
        noise = reweight(regression, residuals)
        solution = solve(regression, prior, solution.constants)
        residuals = residuals_of(regression, solution)
    return _Fit(regression, prior, solution, residuals, noise)


def _first_weights(regression: Regression) -> None:
    """Before any residual is known: rows in units of a tenth of their joint's torque."""
    for rows in regression.rows:
        if len(rows.torque):
            size = float(np.sqrt(np.mean(rows.torque**2))) or 1.0
            rows.set_weight(np.full(len(rows.torque), 10.0 / size))


def residuals_of(regression: Regression, solution: Solution) -> list[FloatArray]:
    """Per joint, (M,) measured minus predicted torque on the regression's rows, N·m."""
    columns, numbers = all_columns(regression, solution)
    return [
        rows.torque - block @ solution.parameters[number]
        for rows, block, number in zip(regression.rows, columns, numbers)
    ]


def all_columns(regression: Regression, solution: Solution) -> tuple[list[FloatArray], list[list[int]]]:
    """Per joint, all unweighted columns (M, k) at the solution, and the parameters they belong to."""
    columns = [[rows.fixed] for rows in regression.rows]
    numbers = [list(rows.indices) for rows in regression.rows]
    for term, first, count in regression.shaped_terms():
        for joint, (indices, shaped) in regression.shaped(term, solution.constants[first : first + count]).items():
            columns[joint].append(shaped)
            numbers[joint].extend(indices)
    return [np.concatenate(parts, axis=1) for parts in columns], numbers


def _conclude(fit: _Fit, provenance: Mapping[str, Any], choices: tuple[Choice, ...], bandwidth: Any) -> Identified:
    regression, prior, solution = fit.regression, fit.prior, fit.solution
    model = regression.model
    spread = _covariance(fit)
    matrix, _ = system(regression, prior, solution.constants)
    consistent = make_consistent(model, matrix, solution.parameters, prior.scale)
    base = base_parameters(model)
    values = base.regrouping @ solution.parameters
    count = len(model.parameters)
    errors = np.sqrt(np.maximum(np.diag(base.regrouping @ spread[:count, :count] @ base.regrouping.T), 0.0))
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
        solver=f"separable, Levenberg-Marquardt on all: {solution.status} after {solution.iterations} steps",
        joints_at_rest=at_rest,
        notes=_notes(regression.motions, at_rest),
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
