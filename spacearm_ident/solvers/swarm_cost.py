"""The paper's objective for a whole swarm at once, at a cost that does not depend on the length of the recording.

    F(Phi) = 1/2 sum |tau_meas - tau_model(Phi)|^2        (paper §4.1, eq. 13)

For one joint, tau_model = A x + C(v) y with fixed columns A and a few columns C shaped by one constant v (the
Stribeck velocity). With A = Q T (QR), and the part of C and tau outside Q's span summed into a Gram matrix,

    2 F = |T x + I(v) [y, -1]|^2 + [y, -1]' O(v) [y, -1],    I = Q'[C, tau],  O = [C, tau]' (1 - QQ') [C, tau],

exactly. I and O are sums over all samples, but functions of the one number v: they are summed at Chebyshev points in
log v, and interpolated. Columns such as exp(-(qd/v)^2) are analytic and bounded for |Im log v| < pi/4, whatever the
samples, so the error falls geometrically with the number of points (Trefethen 2013, "Approximation Theory and
Approximation Practice", ch. 8); points are doubled until it is that of rounding, which is checked, not assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..regression.prior import Prior
from ..regression.regression import Regression

TOLERANCE = 1e-10
"""Interpolation error allowed, as a share of the largest entry: squared columns and torques of order one."""
FIRST_POINTS, MOST_POINTS = 33, 1025


@dataclass(frozen=True)
class Unknowns:
    """The unknowns of a model as one vector Phi: free parameters, then the constants that are searched.

    Attributes:
        free: (f,) numbers of the parameters.
        searched: (s,) numbers of the constants.
        held: (p,) all parameters, of which the free ones are replaced.
        count: Constants in all; those not searched are zero.
    """

    free: np.ndarray
    searched: np.ndarray
    held: FloatArray
    count: int

    @classmethod
    def of(cls, regression: Regression, prior: Prior) -> Unknowns:
        """All that a model leaves free: its parameters of positive scale, its constants of positive grid."""
        searched = [k for k, grid in enumerate(regression.grids) if (grid > 0).any()]
        return cls(prior.free, np.array(searched, dtype=int), prior.held, len(regression.grids))

    def split(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Phi (f + s,) as parameters (p,) and constants (c,)."""
        parameters, constants = self.held.copy(), np.zeros(self.count)
        parameters[self.free] = point[: len(self.free)]
        constants[self.searched] = point[len(self.free) :]
        return parameters, constants


@dataclass(frozen=True)
class _Table:
    """A function of log v, (w,) values each, at Chebyshev points of the second kind."""

    points: FloatArray
    values: FloatArray

    def at(self, logarithm: FloatArray) -> FloatArray:
        """Values (N, w) at N places, by the barycentric formula (Berrut and Trefethen 2004)."""
        signs = (-1.0) ** np.arange(len(self.points))
        signs[[0, -1]] /= 2
        difference = logarithm[:, None] - self.points
        hit = difference == 0.0
        weights = signs / np.where(hit, 1.0, difference)
        weights = np.where(hit.any(axis=1)[:, None], hit, weights)
        return np.asarray((weights / weights.sum(axis=1, keepdims=True)) @ self.values)


@dataclass(frozen=True)
class _Joint:
    """What a joint's squares are computed from.

    Attributes:
        fixed, shaped: Places in Phi of what its columns belong to.
        triangle: (r, k) T.
        constant: Place in Phi of the constant that shapes columns; None where it is held or there is none.
        table: I and O, flattened one after the other.
    """

    fixed: np.ndarray
    shaped: np.ndarray
    triangle: FloatArray
    constant: int | None
    table: _Table

    def squares(self, swarm: FloatArray) -> FloatArray:
        """(N,) 2 F of this joint."""
        count, rank, width = len(swarm), len(self.triangle), len(self.shaped) + 1
        if self.constant is None:
            entries = np.broadcast_to(self.table.values[0], (count, self.table.values.shape[1]))
        else:
            entries = self.table.at(np.log(swarm[:, self.constant]))
        outer = np.column_stack([swarm[:, self.shaped], np.full(count, -1.0)])
        inside = swarm[:, self.fixed] @ self.triangle.T
        inside += np.einsum("nrk,nk->nr", entries[:, : rank * width].reshape(count, rank, width), outer)
        gram = entries[:, rank * width :].reshape(count, width, width)
        return np.asarray((inside**2).sum(axis=1) + np.einsum("ni,nij,nj->n", outer, gram, outer))


class SwarmCost:
    """F for a swarm (N, d) of values of Phi: `cost(swarm)` is (N,), in (N·m)^2 under unit weights."""

    def __init__(self, regression: Regression, unknowns: Unknowns, lower: FloatArray, upper: FloatArray) -> None:
        """Sum everything that depends on the samples.

        Args:
            regression: Rows, with their weights.
            unknowns: What Phi is.
            lower: (d,) lower end of the box that constants stay in; parameters may leave it.
            upper: (d,) its upper end.

        Raises:
            UserError: A joint has columns shaped by more than one constant, or by what the rest of the model says.
        """
        self._regression, self._unknowns = regression, unknowns
        self._place = {int(number): k for k, number in enumerate(unknowns.free)}
        self._box = lower, upper
        self._joints = [self._joint(joint) for joint in range(len(regression.rows))]

    def __call__(self, swarm: FloatArray) -> FloatArray:
        """(N,) F of each of (N, d) values of Phi."""
        return np.asarray(0.5 * sum(joint.squares(swarm) for joint in self._joints))

    def _joint(self, joint: int) -> _Joint:
        rows = self._regression.rows[joint]
        fixed = np.array([self._place[number] for number in rows.indices], dtype=int)
        # A joint that never moves has no rows, and nothing to be shaped.
        terms = [term for term in self._terms() if len(rows.torque) and joint in self._shaped(term)]
        if not terms:
            entries = self._entries(joint, np.empty((len(rows.torque), 0)), [], [])
            return _Joint(fixed, np.empty(0, dtype=int), rows.triangle, None, _Table(np.zeros(1), entries[None]))
        constants = self._constants_of(terms[0])
        if len(terms) > 1 or len(constants) > 1 or self._regression.term(terms[0][0]).depends:
            name = self._regression.model.arm.joint_names[joint]
            raise UserError(
                f"pso-lm takes the paper's model, one nonlinear constant a joint, and {name} has more here: "
                "leave out the structure, or use the solver separable"
            )
        numbers = self._shaped(terms[0])[joint][0]
        shaped = np.array([self._place[number] for number in numbers if number in self._place], dtype=int)
        if not constants:
            table = _Table(np.zeros(1), self._sampled(terms[0], joint, np.zeros(1)))
            return _Joint(fixed, shaped, rows.triangle, None, table)
        place = len(self._unknowns.free) + int(np.flatnonzero(self._unknowns.searched == constants[0])[0])
        return _Joint(fixed, shaped, rows.triangle, place, self._table(terms[0], joint, place))

    def _terms(self) -> list[tuple[int, int, int]]:
        return self._regression.shaped_terms()

    def _constants_of(self, term: tuple[int, int, int]) -> list[int]:
        """Numbers of the term's constants that are searched."""
        return [k for k in range(term[1], term[1] + term[2]) if k in self._unknowns.searched]

    def _shaped(self, term: tuple[int, int, int], value: float = 0.0) -> dict[int, tuple[list[int], FloatArray]]:
        """Columns with the term's searched constants at `value`, the others absent."""
        constants = self._constants_of(term)
        return self._regression.shaped(term[0], [value * (k in constants) for k in range(term[1], term[1] + term[2])])

    def _sampled(self, term: tuple[int, int, int], joint: int, values: FloatArray) -> FloatArray:
        """(V, w) I and O at (V,) values of the constant."""
        entries = []
        for value in values:
            numbers, columns = self._shaped(term, float(value))[joint]
            free = [k for k, number in enumerate(numbers) if number in self._place]
            entries.append(self._entries(joint, columns, free, numbers))
        return np.array(entries)

    def _entries(self, joint: int, columns: FloatArray, free: list[int], numbers: list[int]) -> FloatArray:
        """(w,) I and O of a joint's columns (M, k); those of parameters that are held go with the torque."""
        rows = self._regression.rows[joint]
        held = [k for k in range(len(numbers)) if k not in free]
        torque = rows.torque - columns[:, held] @ self._unknowns.held[[numbers[k] for k in held]]
        whole = np.column_stack([columns[:, free], torque]) * rows.weight[:, None]
        inside = rows.basis.T @ whole
        outside = whole - rows.basis @ inside
        return np.concatenate([inside.ravel(), (outside.T @ outside).ravel()])

    def _table(self, term: tuple[int, int, int], joint: int, place: int) -> _Table:
        """Points doubled until those between are predicted to rounding."""
        lower, upper = (float(np.log(end[place])) for end in self._box)
        points = _chebyshev(lower, upper, FIRST_POINTS)
        table = _Table(points, self._sampled(term, joint, np.exp(points)))
        while True:
            finer = _chebyshev(lower, upper, 2 * len(table.points) - 1)
            between = self._sampled(term, joint, np.exp(finer[1::2]))
            error = np.abs(table.at(finer[1::2]) - between).max(axis=0)
            values = np.empty((len(finer), table.values.shape[1]))
            values[::2], values[1::2] = table.values, between
            # I is in units of the torque, O in those of its square: each is judged by its own size.
            width = sum(number in self._place for number in self._shaped(term)[joint][0]) + 1
            split = len(self._regression.rows[joint].triangle) * width
            share = max(_share(error[:split], values[:, :split]), _share(error[split:], values[:, split:]))
            table = _Table(finer, values)
            if share < TOLERANCE:
                return table
            if len(finer) >= MOST_POINTS:
                raise UserError(
                    f"pso-lm cannot tabulate the constant of {self._regression.term(term[0]).kind}: use another solver"
                )


def _share(error: FloatArray, values: FloatArray) -> float:
    return float(error.max(initial=0.0)) / (float(np.abs(values).max(initial=0.0)) or 1.0)


def _chebyshev(lower: float, upper: float, count: int) -> FloatArray:
    """(count,) points of the second kind; every other one of 2 count - 1 is one of them."""
    return np.asarray((lower + upper) / 2 - (upper - lower) / 2 * np.cos(np.pi * np.arange(count) / (count - 1)))
