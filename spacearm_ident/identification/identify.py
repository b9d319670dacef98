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

from ..arrays import FloatArray
from ..bayes.from_prior import CHANGES, GroundPrior
from ..bayes.updated import identify_from_prior
from ..dynamics.arm import Arm
from ..dynamics.base_link import base_notes, placed
from ..dynamics.coupling import CoupledMotor
from ..dynamics.model import (
    IdentifiedModel,
    Structure,
    TorqueModel,
    over_temperature,
    structure_of,
)
from ..environment.gravity import require_gravity_choice
from ..environment.momentum import base_body
from ..errors import UnfitDataError, UserError
from ..estimate.consistency import make_consistent
from ..estimate.coupling import CouplingTrial
from ..estimate.determination import judge, open_ended
from ..estimate.environment import Environment, GravityEstimate, judge_vacuum, without_temperature
from ..estimate.identified import Choice, Identified
from ..recording.recording import TEMPERATURE_UNIT, Recording
from ..signals.motion import Motion, moves_by_position
from ..signals.prepare import prepare, require_joints
from ..solvers import pso_lm
from ..solvers.choice import CLOE, IDIM_IV, PSO_LM, SEPARABLE, require_solver
from ..solvers.separable import Solution, system
from . import output_error
from .blend import blend_notes, blended
from .block_grams import BlockGrams
from .cad_scale import prior_note
from .coupled_wrist import try_coupling
from .cross_check import fit_instrumental, fit_output_error
from .fit import Fit, covariance_of, fit_as_published, fit_model, freedom, revealed, with_hidden_speeds
from .gravity_loop import GravityLoop
from .own_recordings import own_recordings, parts_left_out
from .structure import choose_structure
from .torque_gain import assumed_covariance, gain_shifts, with_gain
from .weighed import TorqueGains

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Settings:
    """What a user may decide about an identification.

    Attributes:
        cutoff_hz: Low-pass cut-off; chosen from the data where None.
        structure: Terms and options; None: what `choose` makes of the paper's.
        choose: Chooses the structure from a fit of the paper's; by default by held-out prediction (`structure.py`).
        solver: One of `solvers.SOLVERS`. `pso-lm` takes the paper's unknowns, and nothing the data might demand.
        seed: Of the particle swarm: the same seed gives the same result.
        temperature: What of friction follows the joints' temperatures, some of `model.OVER_TEMPERATURE`; beside
            `structure`, which has none of it.
        gravity: How gravity is estimated, one of `gravity.GRAVITY_CHOICES`; empty: it is the arm's.
        prior: A ground model that the data update (`updated.py`): structure, masses and geometry are its own, gravity
            is the arm's. With it go `cutoff_hz` and `gravity` alone.
        gains: Torque gains from a known mass, by which the recordings' torque has been divided; None: as recorded.
        blend: Whether torque is predicted by what predicts held-out data best (`blend.py`); not where the physically
            consistent parameters alone are used.
        couple: Whether a coupled motor is looked for where the wrist fits badly (`coupled_wrist.py`), and is in the
            model where held-out data show it and no structure was asked for.
    """

    cutoff_hz: float | None = None
    structure: Structure | None = None
    solver: str = SEPARABLE
    seed: int = 0
    temperature: tuple[str, ...] = ()
    gravity: str = ""
    prior: GroundPrior | None = None
    gains: TorqueGains | None = None
    blend: bool = True
    couple: bool = True
    choose: Callable[[Fit], tuple[Structure, tuple[Choice, ...]]] = choose_structure


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
    if settings.temperature:
        _require_celsius(recordings, arm)
    if settings.prior is not None:
        report(0.0, "updating the prior")
        ground = settings.prior.under(arm.gravity)
        known = ground.model.model.arm.joint_names
        if known != arm.joint_names:
            raise UserError(f"the prior is of another arm: its joints are {', '.join(known)}")
        return identify_from_prior(recordings, ground, settings.cutoff_hz, settings.gravity, provenance)
    report(0.0, "filtering")
    on_base = base_notes(recordings, arm)
    recordings = placed(recordings, arm)
    motions, bandwidth = prepare(recordings, arm.joint_names, settings.cutoff_hz)
    report(0.2, "searching the friction constants")
    model = TorqueModel(arm, over_temperature(settings.structure or structure_of(arm), arm, settings.temperature))
    if settings.solver == CLOE:
        output_error.require_simulated(model.structure)
    gravity_loop = _gravity_loop(settings, arm, motions)
    fit, choices, coupling = _fitted(model, motions, settings, gravity_loop, report)
    if settings.solver == IDIM_IV:
        report(0.7, "comparing with instrumental variables")
        fit = fit_instrumental(fit, recordings, bandwidth.cutoff_hz)
    elif settings.solver == CLOE:
        report(0.7, "simulating the closed loop")
        fit = fit_output_error(fit, recordings, bandwidth.cutoff_hz)
    report(0.8, "standard errors and physical consistency")
    fit, gravity = gravity_loop.conclude(fit)
    further = gravity_loop.further(fit)
    words = _solver_words(settings, fit.solution)
    result = _conclude(fit, provenance or {}, choices, bandwidth, words, gravity, further, settings.gains)
    body, on_body = base_body(motions, result.model, result.covariance)
    if settings.blend:
        result = replace(result, model=_with_own_recordings(result, fit, settings))
    weighed = () if settings.gains is None else (settings.gains.words,)
    coupled = () if coupling is None else (coupling.words,)
    notes = (*weighed, *result.notes, *on_base, *on_body, *blend_notes(result.model), *coupled)
    result = replace(result, base_body=body, notes=notes, coupling=coupling)
    report(1.0, "done")
    return result


def _with_own_recordings(result: Identified, fit: Fit, settings: Settings) -> IdentifiedModel:
    """The model with what predicts held-out parts of its recordings best, and with what it leaves of them."""
    grams = BlockGrams(fit.regression, fit.solution.constants)
    parts, count = parts_left_out(fit, grams), len(result.model.parameters)
    departures = GroundPrior.of(result).widened(CHANGES).factor[:count]
    model = replace(result.model, own=own_recordings(fit, grams, parts, result.model.parameters, departures))
    if settings.solver == SEPARABLE and result.consistency_shift > 0.0:
        model = blended(model, fit, parts, settings.structure is None)
    return model


def _fitted(
    model: TorqueModel, motions: list[Motion], settings: Settings, gravity_loop: GravityLoop, report: Progress
) -> tuple[Fit, tuple[Choice, ...], CouplingTrial | None]:
    """The fit by least squares in the torque, and what was decided about the structure unless the user had."""
    if settings.solver == PSO_LM:
        published = TorqueModel(model.arm, pso_lm.as_published(model.structure))
        return fit_as_published(published, motions, settings.seed), (), None
    fit = gravity_loop.settle(fit_model(model, motions))
    coupling = try_coupling(fit) if settings.couple else None
    if settings.structure is not None:
        return fit, (), coupling
    if coupling is not None and coupling.helps:
        coupling = replace(coupling, adopted=True)
        arm = replace(fit.regression.model.arm, couplings=(coupling.coupling,))
        model = TorqueModel(arm, {**model.structure, CoupledMotor.kind: {}})
        fit = gravity_loop.settle(fit_model(model, motions))
    report(0.5, "choosing the terms that predict held-out data better")
    if settings.choose is choose_structure:
        fit = with_hidden_speeds(fit)
    structure, choices = settings.choose(fit)
    fit = gravity_loop.settle(fit_model(TorqueModel(fit.regression.model.arm, structure), motions, fit))
    return fit, choices, coupling


def _gravity_loop(settings: Settings, arm: Arm, motions: list[Motion]) -> GravityLoop:
    """How gravity is estimated, if it is.

    Raises:
        UserError: The solver asked for cannot, or not from a base that moves.
    """
    for asked, words in ((settings.gravity, "gravity"), (settings.temperature, "friction over temperature")):
        if asked and settings.solver in (PSO_LM, IDIM_IV, CLOE):
            raise UserError(f"the solver {settings.solver} does not estimate {words}: take {SEPARABLE}")
    if any(motion.base is not None for motion in motions):
        if settings.gravity:
            raise UserError("gravity cannot be estimated under a moving base: its IMU measures what is felt of it")
        if settings.solver == CLOE:
            raise UserError(f"the solver {CLOE} simulates a fixed base, and this one moves: take {SEPARABLE}")
    return GravityLoop(require_gravity_choice(settings.gravity, arm.gravity), arm.gravity, motions)


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


def _require_celsius(recordings: Sequence[Recording], arm: Arm) -> None:
    """Refuse recordings that have no temperature of a joint for its unit, where friction is to follow them."""
    for recording in recordings:
        for issue in recording.issues:
            if issue.kind == TEMPERATURE_UNIT and not set(arm.joint_names) <= recording.temperatures.keys():
                raise UnfitDataError(
                    f"{issue.message}; publish degrees Celsius, or leave friction over temperature out"
                )


def _solver_words(settings: Settings, solution: Solution) -> str:
    if settings.solver == CLOE:
        return f"{CLOE}, {solution.status} after {solution.iterations} simulations"
    seed = f" (seed {settings.seed})" if settings.solver == PSO_LM else ""
    return f"{settings.solver}{seed}, Levenberg-Marquardt on all: {solution.status} after {solution.iterations} steps"


def _conclude(
    fit: Fit,
    provenance: Mapping[str, Any],
    choices: tuple[Choice, ...],
    bandwidth: Any,
    solver: str,
    gravity: GravityEstimate | None,
    further: list[FloatArray],
    gains: TorqueGains | None,
) -> Identified:
    regression, prior, solution = fit.regression, fit.prior, fit.solution
    model = regression.model
    whole = len(model.parameters) + len(model.constants)
    spread = covariance_of(fit, further)[:whole, :whole]
    matrix, _ = system(regression, prior, solution.constants)
    consistent = make_consistent(model, matrix, solution.parameters, prior.scale)
    consistent = static_as_coulomb(model, consistent)
    base = revealed(regression)
    values = base.regrouping @ solution.parameters
    errors = base.errors(spread)
    at_rest = tuple(
        joint
        for k, joint in enumerate(model.arm.joint_names)
        if not any(motion.moving[:, k].any() for motion in regression.motions)
    )
    unresolved = tuple(
        joint for joint in at_rest if moves_by_position(regression.motions, model.arm.joint_names.index(joint))
    )
    unseen = open_ended(regression, prior, solution)
    estimates = judge(model, prior, base, consistent, solution.constants, spread, regression.grids, at_rest, unseen)
    spread_of_gains = assumed_covariance(len(model.arm.joints)) if gains is None else gains.covariance
    estimates = with_gain(estimates, gain_shifts(fit, matrix), spread_of_gains)
    environment = Environment(
        judge_vacuum(model.parameters, solution.parameters, spread, prior.scale, freedom(fit)),
        gravity,
        without_temperature(model, regression.motions),
    )
    # The test against vacuum is made for orbit; on the ground its result is kept and not announced.
    said = replace(environment, vacuum=None) if np.any(model.arm.gravity) else environment
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
        joints_unresolved=unresolved,
        notes=(*_notes(regression.motions, at_rest, unresolved), *said.notes, *fit.stages, *prior_note(prior)),
        environment=environment,
    )


def static_as_coulomb(model: TorqueModel, parameters: FloatArray) -> FloatArray:
    """Parameters (p,) with f_b = f_c at every joint whose friction has no Stribeck term; it changes no torque.

    Args:
        model: A parameter f_b that it holds is one without a Stribeck term.
        parameters: (p,) in the model's order; not changed.
    """
    filled, places = parameters.copy(), {parameter.name: k for k, parameter in enumerate(model.parameters)}
    for k, parameter in enumerate(model.parameters):
        if parameter.symbol == "f_b" and parameter.held:
            filled[k] = parameters[places[f"f_c[{parameter.joint}]"]]
    return filled


def _notes(motions: Sequence[Motion], at_rest: Sequence[str], unresolved: Sequence[str]) -> tuple[str, ...]:
    notes = []
    averaged = [motion for motion in motions if motion.cyclic]
    for motion in averaged:
        notes.append(
            f"recording {motion.source + 1}: {motion.periods} periods of "
            f"{len(motion.position) / motion.rate_hz:.4g} s averaged"
        )
    for joint in at_rest:
        why = "moves, but its speed nowhere stands out of the noise" if joint in unresolved else "does not move"
        notes.append(f"{joint} {why}: its friction cannot be identified, its inertia only in part")
    return tuple(notes)


def with_provenance(identified: Identified, provenance: Mapping[str, Any]) -> Identified:
    """The same result with its sources and versions noted in the model.

    Args:
        identified: The result.
        provenance: Plain data for `model.yaml`: recordings with their checksums, versions, command.
    """
    return replace(identified, model=replace(identified.model, provenance=dict(provenance)))
