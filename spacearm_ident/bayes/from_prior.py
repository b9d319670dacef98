"""Identification from seconds of data: a ground model as the prior, updated by what little there is.

The ground identification gives a mean (its values) and a covariance of all parameters and constants. On the way to
orbit friction may have changed, so its levels get room beyond that covariance (`CHANGES`); inertias have not. With
the prior factored as P = L L' the unknown departure from the ground is u = L v, v ~ N(0, 1), which holds what the
ground held and keeps the directions it knew well (singular covariances are welcome), and the posterior is that of
the linear model

    r = (A L) v + noise,        r = tau - A x_ground,

with constants linearised in their logarithms about the ground, then about where they came to lie until they stay. How
loud and how slow the noise is, its own residual says (`posterior.py`); intervals use Student's t as far as the data
decided a value. 95 % intervals hold 93 to 97 % on seeded repeats, white and slow noise alike (`test_from_prior.py`).

Gravity may be unknown as well: its change is one more linear unknown beside v, about a gravity and masses that are
moved to the posterior's until they stay. Here the prior knows the masses, so its size is told from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from ..arrays import FloatArray
from ..dynamics.base_link import placed
from ..dynamics.model import IdentifiedModel
from ..environment.gravity import DIRECTION, gravity_columns, gravity_result, is_zero, tangents, weight_columns
from ..errors import UserError
from ..estimate.environment import GRAVITY_SCALE, GravityEstimate
from ..estimate.identified import Identified
from ..recording.recording import Recording
from ..regression.regression import Regression
from ..signals.bandwidth import Bandwidth
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..solvers.solution_columns import columns_at
from .posterior import posterior

CHANGES: Mapping[str, float] = {"f_c": 0.3, "f_b": 0.3, "k_v1": 0.3, "k_v2": 1.0, "k_v3": 1.0}
"""Standard deviation of a change since the ground, as a share of the value; f_b follows f_c, its excess may change.
k_v2 and k_v3 may be gone: in vacuum they are."""
ROUNDS, STAYS = 6, 1e-3
"""m/s^2: gravity that moves by less has been found."""
RELINEARISATIONS, SETTLED = 4, 0.05
"""About constants that moved by more than this share of a standard error."""
FARTHEST = 1.0
"""Constants move no farther from the ground's than by this in their logarithms: there columns mean something else."""
SMALLEST_EIGENVALUE = 1e-12


@dataclass(frozen=True)
class GroundPrior:
    """The prior: values, and their covariance (p + c, p + c) over parameters, then constants.

    `source` says where it is from.
    """

    model: IdentifiedModel
    covariance: FloatArray
    source: str = ""

    @classmethod
    def of(cls, identified: Identified) -> GroundPrior:
        """The result of an identification as a prior."""
        return cls(identified.model, identified.covariance)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the rows of the covariance."""
        return tuple(item.name for item in self.model.model.unknowns)

    @property
    def factor(self) -> FloatArray:
        """(p + c, r) L of the covariance L L', which may be singular."""
        return _factor(self.covariance)

    def widened(self, changes: Mapping[str, float]) -> GroundPrior:
        """With room for a change of the parameters named by symbol, as a share of their values."""
        numbers = {name: k for k, name in enumerate(self.names)}
        covariance = self.covariance.copy()
        for name, number in numbers.items():
            symbol, joint = name.split("[", 1)
            if symbol not in changes or number >= len(self.model.parameters):
                continue
            value = float(self.model.parameters[number])
            partner = numbers.get(f"f_c[{joint}") if symbol == "f_b" else None
            if partner is not None and self.model.model.parameters[number].held:
                # Without a Stribeck term f_b is f_c, whatever that becomes. f_c is before it, and widened already.
                covariance[number], covariance[:, number] = covariance[partner], covariance[:, partner]
                covariance[number, number] = covariance[partner, partner]
            elif partner is not None:
                level = float(self.model.parameters[partner])
                common = (changes.get("f_c", 0.0) * level) ** 2
                covariance[number, number] += common + (changes[symbol] * (value - level)) ** 2
                covariance[number, partner] += common
                covariance[partner, number] += common
            else:
                covariance[number, number] += (changes[symbol] * value) ** 2
        return replace(self, covariance=covariance)

    def under(self, gravity: FloatArray) -> GroundPrior:
        """The same arm under another gravity vector (3,), m/s^2, base frame."""
        return replace(self, model=self.model.with_gravity(gravity))

    def in_vacuum(self) -> GroundPrior:
        """With k_v2 and k_v3 zero, and certain to be; a plain model, which has none, is not what there is then."""
        gone = self.model.model.of_high_order
        parameters = np.where(gone, 0.0, self.model.parameters)
        kept = np.ones(len(self.names), dtype=bool)
        kept[: len(gone)] = ~gone
        covariance = self.covariance * np.outer(kept, kept)
        return replace(self, model=replace(self.model.possible, parameters=parameters), covariance=covariance)


@dataclass(frozen=True)
class Updated:
    """A ground model after an update.

    Attributes:
        model: Posterior mean.
        covariance: (p + c, p + c) of parameters and constants.
        variance_reduction: (p + c,) share of the prior's variance that the data took away: 0 is all prior, 1 all data.
        noise_Nm: (n,) standard deviation of a row.
        effective_rows: (n,) rows over their correlation time.
        freedom: (n,) degrees of freedom of what the data say of a joint.
        before: (p + c,) standard deviation of the prior, room for changes included.
        residual_Nm: (2, n) RMS of what the ground model leaves of the rows' torque, and of what this one leaves.
        rows: (n,) rows.
        bandwidth: Low-pass of the rows.
        gravity: Where it was estimated.
        motions: What the rows are from.
    """

    model: IdentifiedModel
    covariance: FloatArray
    variance_reduction: FloatArray
    noise_Nm: FloatArray
    effective_rows: FloatArray
    freedom: FloatArray
    before: FloatArray
    residual_Nm: FloatArray
    rows: np.ndarray
    bandwidth: Bandwidth
    gravity: GravityEstimate | None
    motions: tuple[Motion, ...]

    @property
    def standard_errors(self) -> FloatArray:
        """(p + c,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def factors(self) -> FloatArray:
        """(p + c,) half widths of the 95 % intervals in standard errors: Student's as far as the data decided."""
        joints = self.model.model.arm.joint_names
        places, least = [item.joint for item in self.model.model.unknowns], self.freedom.min()
        freedom = [self.freedom[joints.index(joint)] if joint in joints else least for joint in places]
        normal = float(student.ppf(0.975, np.inf))
        return np.asarray(normal + self.variance_reduction * (student.ppf(0.975, np.array(freedom)) - normal))

    @property
    def intervals(self) -> FloatArray:
        """(p + c, 2) 95 %."""
        values = np.concatenate([self.model.parameters, self.model.constants])
        half = self.factors * self.standard_errors
        return np.stack([values - half, values + half], axis=1)


def update(
    recordings: Sequence[Recording],
    ground: GroundPrior,
    changes: Mapping[str, float] | None = None,
    cutoff_hz: float | None = None,
    gravity: str = "",
) -> Updated:
    """Bayesian update of a ground model.

    Args:
        recordings: As short as a second each, five together are enough as a rule; joints as the model's.
        ground: Prior, under the gravity that there is, or that is stated.
        changes: Room for changes since, by symbol; `CHANGES` where None.
        cutoff_hz: Bandwidth; the ground model's where None.
        gravity: How gravity is estimated, one of `gravity.GRAVITY_CHOICES`; empty: it is not.

    Raises:
        UnfitDataError: Nothing moves, or all is too short.
        UserError: A recording lacks a joint.
    """
    wider = ground.widened(CHANGES if changes is None else changes)
    arm = ground.model.model.arm
    motions, bandwidth = prepare(
        placed(recordings, arm), arm.joint_names, cutoff_hz or ground.model.cutoff_hz, average=False
    )
    if not cutoff_hz and ground.model.cutoff_hz:
        bandwidth = replace(bandwidth, reason="the prior's")
    if not gravity:
        return _update(motions, bandwidth, wider)
    here, masses = arm.gravity, ground.model.parameters
    for _ in range(ROUNDS):
        result = _update(motions, bandwidth, wider.under(here), _Field(gravity, arm.gravity, masses))
        there = result.model.model.arm.gravity
        moved = float(np.linalg.norm(there - here))
        here, masses = there, result.model.parameters
        if moved < STAYS:
            break
    found = result.gravity
    if found is None or not is_zero(found):
        return result
    nothing = replace(found, vector=(0.0, 0.0, 0.0))
    return replace(_update(motions, bandwidth, wider.under(np.zeros(3))), gravity=nothing)


@dataclass(frozen=True)
class _Field:
    """Gravity as an unknown: one of `GRAVITY_CHOICES`, what is stated (3,), the parameters with the masses."""

    choice: str
    stated: FloatArray
    parameters: FloatArray


def _update(motions: list[Motion], bandwidth: Bandwidth, wider: GroundPrior, field: _Field | None = None) -> Updated:
    """The update, linear about the prior's arm and gravity, and about its own constants."""
    regression = Regression(wider.model.model, motions)
    blended = _blended(motions, wider.model)
    first = result = _linear_update(regression, bandwidth, wider, wider.model, blended, field)
    for _ in range(RELINEARISATIONS):
        about, count = result.model, len(result.model.parameters)
        result = _linear_update(regression, bandwidth, wider, about, blended, field)
        free = result.standard_errors[count:] > 0
        moved = np.abs(result.model.constants - about.constants)[free] / result.standard_errors[count:][free]
        if not (moved > SETTLED).any():
            break
    return replace(result, residual_Nm=np.array([first.residual_Nm[0], result.residual_Nm[1]]))


def _linear_update(
    regression: Regression,
    bandwidth: Bandwidth,
    wider: GroundPrior,
    about: IdentifiedModel,
    blended: list[FloatArray],
    field: _Field | None,
) -> Updated:
    """The update, linear about the prior's arm and gravity, and the parameters and constants of `about`."""
    ground, model, constants = wider.model, wider.model.model, wider.model.constants
    regression.update_background(about.parameters, about.constants)
    unit = np.concatenate([np.ones(len(ground.parameters)), np.where(constants > 0, constants, 1.0)])
    factor = _factor(wider.covariance / np.outer(unit, unit))
    matrices, targets = _rows(regression, ground, about, factor)
    targets = [target - rows for target, rows in zip(targets, blended)]
    left = [_rms(target) for target in targets]
    rank, ways, expected = factor.shape[1], np.zeros((3, 0)), np.zeros(0)
    if field is not None:
        ways = tangents(model.arm.gravity, field.choice)
        expected = ways.T @ (field.stated - model.arm.gravity)
        for joint, weight in enumerate(weight_columns(gravity_columns(regression), model, field.parameters)):
            targets[joint] = targets[joint] - weight @ ways @ expected
            matrices[joint] = np.column_stack([matrices[joint], GRAVITY_SCALE * weight @ ways])
    result = posterior(regression, matrices, targets, None if ground.own is None else ground.own.density)
    mean, spread = result.mean, result.covariance
    departure = factor @ mean[:rank]
    covariance = factor @ spread[:rank, :rank] @ factor.T * np.outer(unit, unit)
    before = np.diag(wider.covariance)
    reduction = 1.0 - np.diag(covariance) / np.where(before > 0, before, 1.0)
    count = len(ground.parameters)
    moved = constants * np.exp(np.clip(departure[count:], -FARTHEST, FARTHEST))
    values = replace(ground.moved_to(ground.parameters + departure[:count], moved), cutoff_hz=bandwidth.cutoff_hz)
    found = None
    if field is not None:
        vector = model.arm.gravity + ways @ (expected + GRAVITY_SCALE * mean[rank:])
        if field.choice == DIRECTION:
            vector = vector * np.linalg.norm(field.stated) / np.linalg.norm(vector)
        spread_of = GRAVITY_SCALE**2 * ways @ spread[rank:, rank:] @ ways.T
        found = gravity_result(vector, field.stated, spread_of, field.choice, float(result.freedom.sum()))
        values = values.with_gravity(vector)
    return Updated(
        values,
        covariance,
        np.where(before > 0, reduction, 0.0),
        result.sigma,
        result.effective_rows,
        result.freedom,
        before=np.sqrt(before),
        residual_Nm=np.array([left, [_rms(t - m @ mean) for m, t in zip(matrices, targets)]]),
        rows=np.array([len(target) for target in targets]),
        bandwidth=bandwidth,
        gravity=found,
        motions=tuple(regression.motions),
    )


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2))) if len(signal) else float("nan")


def _factor(covariance: FloatArray) -> FloatArray:
    """L (u, r) of a covariance (u, u) that may be singular, P = L L'."""
    scale = np.sqrt(np.diag(covariance))
    used = np.flatnonzero(scale > 0)
    if not len(used):
        raise UserError("the prior's covariance is zero: nothing is left to estimate")
    block = covariance[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    size, directions = np.linalg.eigh((block + block.T) / 2)
    kept = size > SMALLEST_EIGENVALUE * size[-1]
    factor = np.zeros((len(covariance), int(kept.sum())))
    factor[used] = directions[:, kept] * np.sqrt(size[kept]) * scale[used, None]
    return factor


def _blended(motions: Sequence[Motion], ground: IdentifiedModel) -> list[FloatArray]:
    """Per joint, (M,) what is blended into the ground's torque beside its consistent parameters, N·m."""
    whole = [motion.reduce(ground.torque(motion) - ground.possible.torque(motion)) for motion in motions]
    joints = range(len(ground.model.arm.joints))
    return [np.concatenate([rows[m.moving[:, j], j] for rows, m in zip(whole, motions)]) for j in joints]


def _rows(
    regression: Regression, ground: IdentifiedModel, about: IdentifiedModel, factor: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Per joint, rows (M, r) of v and what is left of the torque (M,) at the ground's values, linear about others."""
    columns, numbers = columns_at(regression, about.constants)
    share, of_constants = ground.departure_share, ground.constant_share
    matrices = [block * share[j, number] @ factor[number] for j, (block, number) in enumerate(zip(columns, numbers))]
    targets = [
        rows.torque - block @ ground.parameters[number]
        for rows, block, number in zip(regression.rows, columns, numbers)
    ]
    count = len(ground.parameters)
    for term, first, terms in regression.shaped_terms():
        values = about.constants[first : first + terms]
        for k in range(terms):
            if values[k] > 0 and factor[count + first + k].any():
                back = np.log(ground.constants[first + k] / values[k])
                for joint, column in regression.derivatives(term, list(values), k, about.parameters).items():
                    column = column * of_constants[joint]
                    matrices[joint] = matrices[joint] + np.outer(column, factor[count + first + k])
                    targets[joint] = targets[joint] - column * back
    return matrices, targets
