"""`Evidence`: what the base model leaves over in the field, and what an effect would explain of it.

The base model is fitted to reference and field together; effects act in the field alone. So what the reference pins
down an effect need not fear, and what it leaves open an effect must share (joint refit). With Q an orthonormal basis
of the base model's columns over all rows, an effect's columns C enter as C - Q Q^T C, and its gain is the drop in
chi-square. Nothing of that needs a row again: Gram matrices of a few columns do.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..dynamics.term import Values
from ..noise.between import ordinary_shifts
from ..regression.prior import make_prior
from ..signals.motion import Motion
from .candidate import UNDERFLOW, Candidate, refit, with_own
from .reversals import learnt
from .scene import Scene, quiet
from .stacked import NUISANCE, Stacked, base_columns, nuisance_scale, sharpness, stacked_effect, stacked_effects

SINGULAR = 1e-13
"""Ratio of singular values below which normal equations are rounding."""

AT_ONCE = 4096
"""Rows that are factorised at a time: a few megabytes, and many more than there are columns."""

NEARER = 3.0
"""How many times as near its identified value as to its CAD value (`regression.prior`) a base parameter is expected
before the joint refit. Of 0.3, 1, 3, 10 and 30 the one with which the base predicts held-out recordings of four real
arms best: mean log ratio of its RMS to that of `identify` 0.030, without it 0.059."""


class Evidence:
    """Base model, field and (if any) reference, ready for candidates.

    Attributes:
        field: Field rows.
        reference: Reference rows, if any.
        common: Effects that reference and field share, part of the base.
        residual: (F,) what the base leaves over in the field.
        rows: Number of field rows.
    """

    def __init__(
        self,
        base: IdentifiedModel,
        field: Scene,
        reference: Scene | None,
        common: Sequence[tuple[Effect, tuple[float, ...]]] = (),
    ) -> None:
        """Fit the base.

        Args:
            base: Its model.
            field: Field rows.
            reference: Reference rows, if any.
            common: Effects that reference and field share, each with values of its constants.
        """
        self.base = base
        self.field = field
        self.reference = reference
        self.common = tuple(common)
        self.rows = len(field)
        scenes = [field] if reference is None else [field, reference]
        stacks = [base_columns(base, scene, self.common) for scene in scenes]
        torques = [scene.torque() for scene in scenes]
        self._width = stacks[0].shape[1]
        belief, near = _belief(base, scenes, self._width)
        stacks, torques = [*stacks, belief], [*torques, near]
        self._used = np.flatnonzero(np.any([columns.any(axis=0) for columns in stacks], axis=0))
        self._triangle = _triangle_of(stacks, self._used)
        slope = np.sum([columns.T @ torque for columns, torque in zip(stacks, torques)], axis=0)
        # Of the field's rows alone: of the reference's, which are more, nothing else is needed.
        in_field = stacks[0][:, self._used].T
        del stacks
        self._basis = solve_triangular(self._triangle, in_field, trans="T", overwrite_b=True).T
        self._inside = solve_triangular(self._triangle, slope[self._used], trans="T")
        self._squares = float(sum(torque @ torque for torque in torques))
        self.residual: FloatArray = torques[0] - self._basis @ self._inside

    @cached_property
    def healthy(self) -> Evidence:
        """The reference alone, with what it shares with the field; where there is none, the field itself."""
        return self if self.reference is None else Evidence(self.base, self.reference, None, self.common)

    @cached_property
    def in_vacuum(self) -> tuple[FloatArray, float]:
        """Base parameters (p,), were there no friction of second and third order in the field, and the squares left.

        A reference alone hardly tells k_v1 from k_v3. With the high orders H taken out of the field's rows, B - H in
        place of B = Q R, both recordings do: the normal equations in the coordinates R x.
        """
        count = len(self.base.model.parameters)
        own = self._used[self._used < count]
        gone = np.flatnonzero(self.base.model.of_high_order[own])
        whole = np.zeros(count)
        high = self._basis @ self._triangle[:, gone]
        back = solve_triangular(self._triangle, np.eye(len(self._used)))[gone]
        across = self._basis.T @ high @ back
        gram = np.eye(len(self._used)) - across - across.T + back.T @ (high.T @ high) @ back
        torque = self.residual + self._basis @ self._inside
        slope = self._inside - back.T @ (high.T @ torque)
        inside = np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ slope
        whole[own] = solve_triangular(self._triangle, inside)[: len(own)]
        return whole, self._squares - float(slope @ inside)

    def fit_reversals(self, scenes: Sequence[Scene]) -> None:
        """Tell scenes the torque of the healthy arm as it is fitted here, nuisance included, for what delays it.

        From the reference, where there is one: a late torque turns round late, whatever friction does there.
        """
        model, fitted = self.base.model, self.healthy.base_parameters([], np.zeros(0))
        count = len(model.parameters)
        held = np.array([parameter.held for parameter in model.parameters])
        parameters = np.where(held, self.base.parameters, fitted[:count])
        nuisance = fitted[count : count + self.nuisance].reshape(-1, NUISANCE)

        def load_and_friction(motion: Motion) -> tuple[FloatArray, FloatArray]:
            sharp = [made @ own for (_, made), own in zip(sharpness(motion).values(), nuisance)]
            refit = model.background(quiet(motion), parameters, self.base.constants)
            return refit.load, refit.torque - refit.load + np.stack(sharp, axis=1)

        healthy = self.healthy.field.motions
        ways = learnt(healthy, [load_and_friction(motion) for motion in healthy])
        for scene in scenes:
            for motion, background in zip(scene.motions, scene.backgrounds):
                load, friction = load_and_friction(motion)
                rows = [way(motion, row, friction[:, row]) for row, way in enumerate(ways)]
                background.with_whole(load + np.stack(rows, axis=1))

    def with_days(self, days: float) -> Evidence:
        """The same rows where friction of the field is another day's than the reference's.

        Columns that the field alone has, with a prior of their own, join the base: one step of the factorisation more.
        Friction's course over speed is free in both: a term that the reference's motions do not need, those of the
        field may, at other speeds.

        Args:
            days: Standard deviation of the difference, of the ordinary one between recordings (`ordinary_shifts`).
        """
        viscous = self.base.model.structure.get(ViscousFriction.kind, {})
        if viscous.get("held"):
            return self._of_structure(ViscousFriction.kind, {**viscous, "held": {}}).with_days(days)
        unknowns = np.pad(self.base.parameters, (0, self._width - len(self.base.parameters)))
        shifts = days * ordinary_shifts(self.base.model, unknowns)[self._used]
        columns = self._basis @ (self._triangle @ shifts)
        across = self._basis.T @ columns
        corner = cholesky(columns.T @ columns + np.eye(columns.shape[1]) - across.T @ across)
        beyond = solve_triangular(corner, (columns - self._basis @ across).T, trans="T").T
        slope = columns.T @ (self.residual + self._basis @ self._inside) - across.T @ self._inside
        inside = solve_triangular(corner, slope, trans="T")
        other = copy(self)
        other._basis = np.hstack([self._basis, beyond])
        other._inside = np.concatenate([self._inside, inside])
        other._triangle = np.block([[self._triangle, across], [np.zeros((len(corner), len(self._used))), corner]])
        other._used = np.concatenate([self._used, self._width + np.arange(len(corner))])
        other._width = self._width + len(corner)
        other.residual = self.residual - beyond @ inside
        return other

    def _of_structure(self, kind: str, options: dict[str, Any]) -> Evidence:
        """The same rows with other options of one kind of the base's terms, of the same parameters."""
        model = TorqueModel(self.base.model.arm, {**self.base.model.structure, kind: options})
        return Evidence(replace(self.base, model=model), self.field, self.reference, self.common)

    def candidate(self, effect: Effect, constants: Values, stacked: Stacked | None = None) -> Candidate:
        """An effect with given constants as a candidate in the field.

        Args:
            effect: The effect.
            constants: (c,) values of its constants.
            stacked: Its whitened columns in the field with these constants, where they are known; None: they are
                computed.
        """
        stacked = stacked or stacked_effect(self.field, effect, constants)
        return self._candidate(effect, constants, stacked, self._basis[stacked.rows].T @ stacked.columns)

    def again(self, known: Sequence[Candidate]) -> list[Candidate]:
        """Candidates of the same rows beside another base."""
        return [self.candidate(one.effect, one.constants, one.stacked) for one in known]

    def candidates(self, effect: Effect, points: Iterable[Values]) -> list[Candidate]:
        """The same at many values of its constants: the basis, most of the work, is gone through once.

        Args:
            effect: At its place.
            points: Values of its constants.

        Returns:
            One each; none where the effect gives no torque in the field.
        """
        constants = list(points)
        stacks = stacked_effects(self.field, effect, constants)
        if not stacks:
            return []
        return self._candidates(effect, constants, stacks)

    def reweighted(self, known: Sequence[Candidate], before: Evidence) -> list[Candidate]:
        """One effect at some values of its constants, known under other weights of the rows.

        Args:
            known: Of one effect, whitened by `before`.
            before: The evidence that they are of.
        """
        ratio = [old.sigma_Nm / new.sigma_Nm for old, new in zip(before.field.whiteners, self.field.whiteners)]
        factors = np.array(ratio)[self.field.joint] * self.field.weight / before.field.weight
        stacks = [candidate.stacked.times(factors) for candidate in known]
        return self._candidates(known[0].effect, [candidate.constants for candidate in known], stacks)

    def _candidates(self, effect: Effect, constants: Sequence[Values], stacks: Sequence[Stacked]) -> list[Candidate]:
        if effect.event:
            insides = [self._basis[stacked.rows].T @ stacked.columns for stacked in stacks]
        else:
            # Where an effect acts its place says, not its constants.
            columns = np.concatenate([stacked.columns for stacked in stacks], axis=1)
            insides = np.hsplit(self._basis[stacks[0].rows].T @ columns, len(stacks))
        return [self._candidate(effect, *known) for known in zip(constants, stacks, insides)]

    def _candidate(self, effect: Effect, constants: Values, stacked: Stacked, inside: FloatArray) -> Candidate:
        columns = stacked.columns
        gram = columns.T @ columns - inside.T @ inside
        slope = columns.T @ self.residual[stacked.rows]
        return Candidate(effect, tuple(float(c) for c in constants), stacked, inside, gram, slope)

    def beyond_base(self, columns: FloatArray) -> FloatArray:
        """(F, k) field columns less what the base can take over; columns.T times that is their Gram matrix."""
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    @property
    def nuisance(self) -> int:
        """Columns that follow the base model's own parameters."""
        return NUISANCE * len(self.base.model.arm.joints)

    @property
    def base_triangle(self) -> FloatArray:
        """(b, p) square root of the information on the base model's own parameters, nuisance free beside them."""
        count = len(self.base.model.parameters)
        own = self._used[self._used < count]
        # Nuisance columns come last: with them first in the factorisation, what is below is the own ones' share.
        order = np.concatenate([np.flatnonzero(self._used >= count), np.flatnonzero(self._used < count)])
        triangle: FloatArray = np.asarray(np.linalg.qr(self._triangle[:, order], mode="r"))
        beside = len(self._used) - len(own)
        whole = np.zeros((len(own), count))
        whole[:, own] = triangle[beside:, beside:]
        return whole

    def residual_beside(self, candidates: Sequence[Candidate]) -> FloatArray:
        """(F,) field residual with some effects and the base fitted together."""
        if not candidates:
            return self.residual
        values = refit(candidates).values
        taken_over = np.concatenate([c.inside for c in candidates], axis=1) @ values
        return np.asarray(self.residual - self.added(candidates, values) + self._basis @ taken_over)

    def added(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(F,) what effects of these values add to the whitened torque in the field, the base as it was.

        Args:
            candidates: The effects.
            values: (k,) of their parameters, one after the other.
        """
        torque: FloatArray = np.zeros(self.rows)
        for candidate, own in with_own(candidates, values):
            torque[candidate.stacked.rows] += candidate.stacked.columns @ own
        return torque

    def base_parameters(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """Parameters of the base (nuisance and common effects last) when these effects stand beside it.

        Args:
            candidates: The effects.
            values: (k,) of their parameters, one after the other.
        """
        whole = np.zeros(self._width)
        whole[self._used] = solve_triangular(self._triangle, self._beside(candidates, values))
        return whole

    def error_of(self, columns: FloatArray) -> FloatArray:
        """(V,) standard error of a torque that the base predicts, as the weights of its rows and its prior say.

        Args:
            columns: (V, p) of what is predicted, nuisance and common effects last (`stacked.base_columns`), N·m.
        """
        error = np.empty(len(columns))
        for first in range(0, len(columns), AT_ONCE):
            some = columns[first : first + AT_ONCE, self._used]
            within = solve_triangular(self._triangle, some.T, trans="T", overwrite_b=True)
            error[first : first + AT_ONCE] = np.linalg.norm(within, axis=0)
        return error

    def base_parameters_without(self, rows: np.ndarray) -> FloatArray:
        """Parameters of the base as fitted to all rows but some of the field's: (F,) true where left out.

        The normal equations in the orthonormal basis, less what these rows contribute.
        """
        basis = self._basis[rows]
        torque = self.residual[rows] + basis @ self._inside
        gram = np.eye(len(self._used)) - basis.T @ basis
        whole = np.zeros(self._width)
        inside = np.linalg.lstsq(gram, self._inside - basis.T @ torque, rcond=SINGULAR)[0]
        whole[self._used] = solve_triangular(self._triangle, inside)
        return whole

    def base_parameters_with(
        self, known: FloatArray, candidates: Sequence[Candidate], values: FloatArray
    ) -> FloatArray:
        """Parameters of the base, as `base_parameters`, where some of the base model's own are known.

        Args:
            known: (p,) values of the base model's own parameters; NaN where they are to be fitted.
            candidates: Effects beside the base.
            values: (k,) their parameters, one candidate after the other.
        """
        whole = np.zeros(self._width)
        whole[: len(known)] = np.nan_to_num(known)
        free = np.concatenate([np.isnan(known), np.ones(self._width - len(known), dtype=bool)])[self._used]
        target = self._beside(candidates, values) - self._triangle[:, ~free] @ whole[self._used[~free]]
        whole[self._used[free]] = np.linalg.lstsq(self._triangle[:, free], target, rcond=None)[0]
        return whole

    def _beside(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(b,) what these effects leave to the base, in its orthonormal basis."""
        inside = self._inside
        if candidates:
            inside = inside - np.concatenate([c.inside for c in candidates], axis=1) @ values
        return np.asarray(inside)


def _triangle_of(stacks: Sequence[FloatArray], used: np.ndarray) -> FloatArray:
    """(k, k) triangular factor of the columns `used` of stacks of rows (r, p), some rows at a time.

    A QR copies what it takes, and so would putting the stacks together: most of the memory that a fit of the base has.
    """
    triangle: FloatArray = np.zeros((0, len(used)))
    for stacked in stacks:
        for first in range(0, len(stacked), AT_ONCE):
            rows = stacked[first : first + AT_ONCE, used]
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))
    return triangle


def _belief(base: IdentifiedModel, scenes: Sequence[Scene], width: int) -> tuple[FloatArray, FloatArray]:
    """Rows (b, width) of what is known before the fit of a base, and the right-hand side (b,) that they should give."""
    prior = make_prior(base.model, [motion for scene in scenes for motion in scene.motions])
    known = prior.rows.shape[1]
    # Common effects may be as large as they like; this only breaks ties.
    beside = np.full(width - known, 1e-3)
    beside[: NUISANCE * len(base.model.arm.joints)] = 1.0 / nuisance_scale(base)
    belief = np.zeros((len(prior.rows) + width - known, width))
    belief[: len(prior.rows), :known] = NEARER * prior.rows
    belief[len(prior.rows) :, known:] = np.diag(beside)
    return belief, np.concatenate([NEARER * prior.rows @ base.parameters, np.zeros(width - known)])


def left_by_base(base: IdentifiedModel, scene: Scene, columns: FloatArray) -> FloatArray:
    """(F,) what a base alone leaves of a scene, as `Evidence.residual`, by its normal equations: several times sooner.

    Args:
        base: Its model.
        scene: The F rows.
        columns: (F, width) of the base there (`base_columns`).
    """
    belief, near = _belief(base, [scene], columns.shape[1])
    torque = scene.torque()
    gram = columns.T @ columns + belief.T @ belief
    unit = 1.0 / np.sqrt(np.maximum(np.diag(gram), UNDERFLOW))
    slope = columns.T @ torque + belief.T @ near
    values = unit * np.linalg.lstsq(gram * np.outer(unit, unit), unit * slope, rcond=SINGULAR)[0]
    return np.asarray(torque - columns @ values)
