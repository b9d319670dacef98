"""The regression problem of a torque model on motions: columns and torque, row by joint, compressed.

Every joint has its own rows. Columns that do not depend on a searched constant are computed once and replaced by
their QR factors; whatever constants a solver tries, only the few columns they shape are computed anew and
projected. After that no array has more rows than there are parameters.

The fixed columns are most of what there is: some forty for every sample of every joint. They are computed a few
seconds of motion at a time and kept at the rate of the rows only, so that a long recording needs little more memory
than its own signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.background import Background
from ..dynamics.model import TorqueModel
from ..dynamics.term import Constant, Term, Values
from ..signals.motion import Motion

KEPT_VALUES = 4_000_000
"""So many rows of shaped columns are kept: with two columns a term, 64 MB."""
DERIVATIVE_STEP = 1e-4
"""Step of the forward difference by a constant's logarithm."""
NARROWEST_SHARE = 0.25
"""A friction peak down to this share of the speeds a reversal is blurred over still leaves its area in the rows beside
the reversal. Half of it and less was tried: real arms predict no better, and planted peaks are found no oftener."""


@dataclass
class Rows:
    """All moving rows of one joint over all motions.

    Attributes:
        indices: Numbers of the parameters with a fixed column here.
        fixed: (M, k) their columns.
        torque: (M,) N·m.
        owner: (M,) which motion a row belongs to.
        place: (M,) its row number within that motion.
        weight: (M,) square root of the row's information, 1/(N·m).
        trust: (M,) share of its information that a row keeps as a possible outlier.
    """

    indices: list[int]
    fixed: FloatArray
    torque: FloatArray
    owner: np.ndarray
    place: np.ndarray
    weight: FloatArray
    trust: FloatArray
    _factors: tuple[FloatArray, FloatArray] | None = None

    def group(self, group_of: Sequence[np.ndarray]) -> np.ndarray:
        """(M,) the group of every row, from that of every row of each motion."""
        return np.concatenate([group_of[k][self.place[self.owner == k]] for k in range(len(group_of))])

    def set_weight(self, weight: FloatArray, trust: FloatArray | None = None) -> None:
        """Weight the rows; `trust` is in the weight already.

        Args:
            weight: (M,) as the attribute.
            trust: (M,) as the attribute; None: every row is trusted.
        """
        self.weight = weight
        self.trust = np.ones(len(weight)) if trust is None else trust
        self._factors = None

    @property
    def basis(self) -> FloatArray:
        """(M, r) orthonormal basis of the weighted fixed columns."""
        return self._factored()[0]

    @property
    def triangle(self) -> FloatArray:
        """(r, k) coordinates of the weighted fixed columns in their basis."""
        return self._factored()[1]

    def _factored(self) -> tuple[FloatArray, FloatArray]:
        """Of these weights: many are set that nothing is solved under."""
        if self._factors is None:
            basis, triangle = np.linalg.qr(self.fixed * self.weight[:, None])
            self._factors = basis, triangle
        return self._factors


Shaped = dict[int, tuple[list[int], FloatArray]]
"""Joint row -> (parameter numbers, (M, k) unweighted columns)."""


class Regression:
    """A torque model's columns on the moving rows of some motions."""

    def __init__(self, model: TorqueModel, motions: Sequence[Motion], known: Regression | None = None) -> None:
        """Compute all columns that no constant shapes.

        Args:
            model: The structure.
            motions: At least one; all with the model's joints.
            known: Regression of the same arm on the same motions: of the terms it shares, columns are taken over.
        """
        self.model = model
        self.motions = list(motions)
        self.background: list[Background | None] = [None] * len(self.motions)
        self._terms = list(model.numbered())
        self._kept: dict[tuple[int, tuple[float, ...]], Shaped] = {}
        self.rows = [self._rows(joint) for joint in range(len(model.arm.joints))]
        longest = max(len(rows.torque) for rows in self.rows)
        self._most_kept = max(4 * len(self._terms), KEPT_VALUES // max(longest, 1))
        self._fixed: list[tuple[Term, Shaped]] = []
        self._fill_fixed(known._fixed if known else [])

    def _rows(self, joint: int) -> Rows:
        place = [np.flatnonzero(motion.moving[:, joint]) for motion in self.motions]
        torque = [motion.torque_rows[where, joint] for motion, where in zip(self.motions, place)]
        owner = np.repeat(np.arange(len(place)), [len(where) for where in place])
        count = len(owner)
        fixed, one = np.empty((count, 0)), np.ones(count)
        return Rows([], fixed, np.concatenate(torque), owner, np.concatenate(place), weight=one, trust=one)

    def _fill_fixed(self, known: list[tuple[Term, Shaped]]) -> None:
        for term, first, _ in self._terms:
            if term.constants or term.depends:
                continue
            fixed = next((columns for other, columns in known if other == term), None) or self._fixed_columns(term)
            self._fixed.append((term, fixed))
            for joint, (indices, columns) in fixed.items():
                rows = self.rows[joint]
                rows.indices = [*rows.indices, *(first + index for index in indices)]
                rows.fixed = np.concatenate([rows.fixed, columns], axis=1)

    def _fixed_columns(self, term: Term) -> Shaped:
        """Columns of a term without constants, numbered within it; those of parameters held at zero are left out."""
        indices: dict[int, list[int]] = {}
        reduced: dict[int, list[FloatArray]] = {}
        for motion in self.motions:
            for part in motion.parts() if term.pointwise else (motion,):
                for joint, (numbers, columns) in term.columns(part, (), None).items():
                    free = [k for k, number in enumerate(numbers) if not term.parameters[number].held]
                    if free:
                        indices[joint] = [numbers[k] for k in free]
                        reduced.setdefault(joint, []).append(part.reduce(columns[:, free]))
        return {joint: (indices[joint], self._moving(joint, np.concatenate(reduced[joint]))) for joint in indices}

    def _moving(self, joint: int, reduced: FloatArray) -> FloatArray:
        """The joint's moving rows of reduced columns of all motions."""
        return np.asarray(reduced[np.concatenate([motion.moving[:, joint] for motion in self.motions])])

    def _gather(self, joint: int, columns: Sequence[FloatArray]) -> FloatArray:
        """Reduce full-rate columns of every motion and keep the joint's moving rows."""
        return self._moving(joint, np.concatenate([motion.reduce(part) for motion, part in zip(self.motions, columns)]))

    def shaped(self, term_number: int, constants: Values) -> Shaped:
        """Columns of one term that has constants, at given values of them.

        The last ones computed are kept, where there is room all of a grid's: it is searched under several weights.

        Args:
            term_number: Number of the term in the model.
            constants: Values of all constants of that term, in its order.
        """
        values = tuple(float(value) for value in constants)
        key = term_number, values
        if key not in self._kept:
            if len(self._kept) >= self._most_kept:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self._shaped(term_number, values)
        return self._kept[key]

    def _shaped(self, term_number: int, constants: tuple[float, ...]) -> Shaped:
        term, first, _ = self._terms[term_number]
        per_motion = [
            term.columns(motion, constants, background) for motion, background in zip(self.motions, self.background)
        ]
        return {
            joint: (
                [first + index for index in per_motion[0][joint][0]],
                self._gather(joint, [part[joint][1] for part in per_motion]),
            )
            for joint in per_motion[0]
        }

    def term(self, number: int) -> Term:
        """A term of the model by its number."""
        return self._terms[number][0]

    @cached_property
    def grids(self) -> list[FloatArray]:
        """For every constant, the values of its grid that these motions can tell apart."""
        return [self.visible(constant) for constant in self.model.constants]

    def visible(self, constant: Constant) -> FloatArray:
        """Values of a constant's grid that these motions can tell apart."""
        grid = np.array(constant.grid)
        if constant.speed:
            joint = self.model.arm.joint_names.index(constant.joint)
            moving = [motion for motion in self.motions if motion.moving[:, joint].any()]
            seen = [max(m.speed_noise[joint], NARROWEST_SHARE * m.resolved_speed[joint]) for m in moving]
            floor = min(seen, default=np.inf)
            above = grid[grid > floor]
            ends = [floor] if len(above) and floor > grid[grid > 0][0] else []
            grid = np.concatenate([grid[grid == 0], ends, above])
        return grid

    def shaped_terms(self) -> list[tuple[int, int, int]]:
        """(term number, first constant, number of constants) of the terms whose columns change with a solution."""
        return [
            (number, first, len(term.constants))
            for number, (term, _, first) in enumerate(self._terms)
            if term.constants or term.depends
        ]

    def derivatives(
        self, term_number: int, constants: Values, which: int, parameters: FloatArray
    ) -> dict[int, FloatArray]:
        """Joint row -> (M,) derivative of the term's torque by the logarithm of one constant, N·m.

        Args:
            term_number: Number of the term in the model.
            constants: Values of all constants of that term, in its order.
            which: Number within the term of the constant to differentiate by; its value is not zero.
            parameters: (p,) of the whole model.
        """
        moved = list(constants)
        moved[which] *= np.exp(DERIVATIVE_STEP)
        here, there = self.shaped(term_number, constants), self._shaped(term_number, tuple(moved))
        return {
            joint: (there[joint][1] - columns) @ parameters[indices] / DERIVATIVE_STEP
            for joint, (indices, columns) in here.items()
        }

    def update_background(self, parameters: FloatArray, constants: FloatArray) -> None:
        """Take what the model says under `parameters` for what terms need to know of the others.

        Args:
            parameters: (p,) of the whole model.
            constants: (c,) of the whole model.
        """
        if self.model.depends:
            self._kept.clear()
            self.background = [self.model.background(motion, parameters, constants) for motion in self.motions]

    def compress(
        self, joint: int, extra_indices: Sequence[int], extra: FloatArray, width: int
    ) -> tuple[FloatArray, FloatArray]:
        """A joint's weighted rows as a small equivalent system (S, s): |S x - s| up to a constant.

        Args:
            joint: Row.
            extra_indices: Unknowns that the further columns belong to.
            extra: (M, e) unweighted further columns (shaped ones, derivatives).
            width: Number of unknowns in all.

        Returns:
            S (r + e + 1, width) and s (r + e + 1,), the last row holding the residual no unknown can lower.
        """
        rows = self.rows[joint]
        tail = np.column_stack([extra, rows.torque]) * rows.weight[:, None]
        inside = rows.basis.T @ tail
        outside = np.asarray(np.linalg.qr(tail - rows.basis @ inside, mode="r"))
        rank = len(rows.triangle)
        small = np.zeros((rank + len(outside), width))
        small[:rank, rows.indices] = rows.triangle
        small[:rank, list(extra_indices)] += inside[:, :-1]
        small[rank:, list(extra_indices)] += outside[:, :-1]
        return small, np.concatenate([inside[:, -1], outside[:, -1]])
