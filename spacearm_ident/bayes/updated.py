"""An update of a ground model as a whole result: values that a real arm could have, intervals, what moved.

`from_prior.update` gives the posterior of the linear model; here it is made physically consistent (the nearest set
under its own covariance, `consistency.py`) and put into the words of every other identification. A value is
`determined by the data` if they took away more than half of the prior's variance, else `from the prior`; both have
intervals, as honest as the prior is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import base_parameters
from ..dynamics.model import TorqueModel
from ..estimate.consistency import link_parameters, make_consistent
from ..estimate.environment import SEEN_SHARE, Environment, judge_vacuum, without_temperature
from ..estimate.identified import Determination, Estimate, Identified, Move
from ..recording.recording import Recording
from ..regression.prior import WIDENING
from ..signals.motion import moves_by_position
from .from_prior import GroundPrior, Updated, update

REDUCED = 0.5
"""Share of the prior's variance the data must take away for a value to be theirs."""
HELD_SHARE = 1e-6
"""An inertial the prior is certain of may move by this share of its CAD scale, for consistency's sake."""
MENTIONED, NOTABLE = 3, 1.0
"""So many moves are in the notes, if they are of more than so many standard deviations of the prior."""
EIGENVALUE = 1e-12


def identify_from_prior(
    recordings: Sequence[Recording],
    ground: GroundPrior,
    cutoff_hz: float | None = None,
    gravity: str = "",
    provenance: Mapping[str, Any] | None = None,
) -> Identified:
    """Identify from a ground model and a little data.

    Args:
        recordings: Each with every joint of the model; a few seconds in all are enough.
        ground: Prior, under the gravity that there is, or that is stated.
        cutoff_hz: Bandwidth; the ground model's where None.
        gravity: How gravity is estimated, one of `gravity.GRAVITY_CHOICES`; empty: it is not.
        provenance: Kept in the model file.

    Raises:
        UnfitDataError: Nothing moves, or all is too short.
        UserError: A recording lacks a joint.
    """
    result = update(recordings, ground, cutoff_hz=cutoff_hz, gravity=gravity)
    model = result.model.model
    count = len(model.parameters)
    values = _consistent(model, result)
    base = base_parameters(model)
    errors = base.errors(result.covariance)
    # Seen is here what the data determine better than the prior did.
    scale = result.before[:count] * np.sqrt(1.0 - REDUCED) / SEEN_SHARE
    freedom = dict(zip(model.arm.joint_names, map(float, result.freedom)))
    environment = Environment(
        judge_vacuum(model.parameters, result.model.parameters, result.covariance, scale, freedom),
        result.gravity,
        without_temperature(model, result.motions),
    )
    moves = _moves(ground, result, values)
    at_rest = tuple(joint for joint, rows in zip(model.arm.joint_names, result.effective_rows) if rows == 0.0)
    return Identified(
        model=replace(result.model.moved_to(values, result.model.constants), provenance=dict(provenance or {})),
        estimates=_estimates(result, values),
        base=base,
        base_values=base.regrouping @ result.model.parameters,
        base_errors=errors,
        covariance=result.covariance,
        consistency_shift=base.shift(values - result.model.parameters, errors),
        residual_sigma_Nm=result.residual_Nm[1],
        rows=result.rows,
        bandwidth=result.bandwidth,
        solver="Bayesian update of the prior model, linear about it",
        joints_at_rest=at_rest,
        joints_unresolved=tuple(
            joint for joint in at_rest if moves_by_position(result.motions, model.arm.joint_names.index(joint))
        ),
        notes=(*_notes(ground, result, moves), *environment.notes),
        environment=environment,
        moves=moves,
    )


def _consistent(model: TorqueModel, result: Updated) -> FloatArray:
    """(p,) the physically consistent parameters nearest to the posterior's mean, by its covariance."""
    count = len(model.parameters)
    spread = np.sqrt(np.maximum(np.diag(result.covariance), 0.0))[:count]
    scale = result.before[:count].copy()
    links = [number for numbers in link_parameters(model) for number in numbers]
    for number in links:
        cad = WIDENING * (model.parameters[number].scale or 1.0)
        scale[number] = max(scale[number], cad)
        spread[number] = max(spread[number], HELD_SHARE * cad)
    free = np.flatnonzero(spread > 0)
    block = result.covariance[np.ix_(free, free)] / np.outer(spread[free], spread[free])
    np.fill_diagonal(block, 1.0)
    size, directions = np.linalg.eigh((block + block.T) / 2)
    root = np.zeros((len(free), count))
    root[:, free] = directions.T / np.sqrt(np.maximum(size, EIGENVALUE))[:, None] / spread[free]
    return make_consistent(model, root, result.model.parameters, np.where(spread > 0, scale, 0.0))


def _estimates(result: Updated, values: FloatArray) -> tuple[Estimate, ...]:
    """An `Estimate` for every parameter and constant, in the model's order."""
    model = result.model.model
    centre = np.concatenate([values, result.model.constants])
    errors, factors = result.standard_errors, result.factors
    estimates = []
    for k, item in enumerate(model.unknowns):
        value, error = float(centre[k]), float(errors[k])
        is_f_c = item.symbol == "f_b" and model.parameters[k].held
        if result.before[k] <= 0 or is_f_c:
            held = "held at the prior's value" if value else "not in the prior"
            note = "equal to f_c, not in the prior" if is_f_c else held
            estimates.append(
                Estimate(item.symbol, item.joint, item.unit, value, float("nan"), Determination.FIXED, note)
            )
            continue
        reduction = float(result.variance_reduction[k])
        kind = Determination.DATA if reduction > REDUCED else Determination.PRIOR
        note = f"the data took {reduction:.0%} of the prior's variance"
        estimates.append(Estimate(item.symbol, item.joint, item.unit, value, error, kind, note, float(factors[k])))
    return tuple(estimates)


def _moves(ground: GroundPrior, result: Updated, values: FloatArray) -> tuple[Move, ...]:
    """Every parameter and constant that could move, in the model's order."""
    model = result.model.model
    was = np.concatenate([ground.model.parameters, ground.model.constants])
    now = np.concatenate([values, result.model.constants])
    columns = np.column_stack([was, result.before, now, result.standard_errors, result.variance_reduction])
    return tuple(
        Move(item.name, item.unit, *columns[k].tolist())
        for k, item in enumerate(model.unknowns)
        if result.before[k] > 0
    )


def _notes(ground: GroundPrior, result: Updated, moves: Sequence[Move]) -> tuple[str, ...]:
    decided = sum(move.variance_reduction > REDUCED for move in moves)
    source = f" {ground.source}" if ground.source else ""
    lines = [
        f"updated the prior model{source}: the data decided {decided} of {len(moves)} values, the prior the others"
    ]
    joints = result.model.model.arm.joint_names
    figures = [
        f"{joint} {before:.3g} to {after:.3g}"
        for joint, before, after, rows in zip(joints, *result.residual_Nm, result.rows)
        if rows
    ]
    lines.append(f"residual of the prior alone, and after the update, N m RMS: {', '.join(figures)}")
    ordered = sorted(moves, key=lambda move: -abs(move.deviations))
    large = [move for move in ordered if abs(move.deviations) > NOTABLE][:MENTIONED]
    if large:
        words = [f"{m.name} {m.before:.4g} to {m.after:.4g} {m.unit} ({m.deviations:+.1f} of its sd)" for m in large]
        lines.append(f"moved most: {', '.join(words)}")
    for joint, rows in zip(joints, result.effective_rows):
        if rows == 0.0:
            lines.append(f"{joint} never moves: what is said of its friction is the prior's")
    return tuple(lines)
