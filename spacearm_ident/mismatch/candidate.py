"""`Candidate`: an effect with values of its constants; `refit`: candidates fitted together with the base model.

No row of the base is needed: inner products of what it cannot take over say all, of each candidate with itself, with
the residual and with the others. All are of one `Evidence`, which makes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from .stacked import Stacked

INVISIBLE = 1e-12
"""Share of its energy below which what the base leaves of a column is rounding."""

RANK_TOLERANCE = 1e-9
"""Share of the largest eigenvalue of a Gram matrix, of columns of equal length, below which an eigenvector is in its
null space. Chosen."""

UNDERFLOW = 1e-200
"""Energy of a column of which no inverse can be taken."""


@dataclass(frozen=True)
class Candidate:
    """An effect with values of its constants, in the field.

    Attributes:
        effect: The term.
        constants: Their values.
        stacked: Its columns.
        inside: (b, k) their coordinates in the base's orthonormal basis.
        gram: (k, k) inner products of what the base cannot take over.
        slope: (k,) inner products with the residual.
    """

    effect: Effect
    constants: tuple[float, ...]
    stacked: Stacked
    inside: FloatArray
    gram: FloatArray
    slope: FloatArray

    @property
    def held(self) -> np.ndarray:
        """(k,) whether a parameter is held at its prior."""
        return np.array([parameter.held for parameter in self.effect.parameters])

    @cached_property
    def energy(self) -> FloatArray:
        """(k,) sum of squares of each column."""
        columns = self.stacked.columns
        return np.asarray(np.einsum("rk,rk->k", columns, columns))


@dataclass(frozen=True)
class Refit:
    """Some effects fitted together with the base.

    Attributes:
        values: (k,) parameters of all candidates, one after the other.
        gain: Drop in chi-square on reference and field.
        covariance: (k, k) of the values; zero where held.
        visibility: (k,) share of each column's energy that the base cannot take over.
        gram: (k, k) inner products of what the base cannot take over.
    """

    values: FloatArray
    gain: float
    covariance: FloatArray
    visibility: FloatArray
    gram: FloatArray


def refit(candidates: Sequence[Candidate], others: Refit | None = None) -> Refit:
    """Fit candidates together with the base; parameters that are held stay at their priors.

    Args:
        candidates: To fit.
        others: Of all but the last of them, where it is known: most of the work.
    """
    if not candidates:
        empty = np.zeros(0)
        return Refit(empty, 0.0, np.zeros((0, 0)), empty, np.zeros((0, 0)))
    gram = _gram(candidates) if others is None else _gram_with(others.gram, candidates)
    slope, energy = (np.concatenate(each) for each in zip(*((c.slope, c.energy) for c in candidates)))
    values, gain, covariance = _solved(gram[None], slope[None], energy[None], *_held_at(candidates))
    visibility = np.diag(gram) / np.maximum(energy, 1e-300)
    return Refit(values[0], float(gain[0]), covariance[0], visibility, gram)


def refit_each(
    others: Sequence[Candidate], each: Sequence[Candidate], known: Refit, beside: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Each of some candidates of one effect fitted with the base and others: many small problems solved together.

    Args:
        others: Beside which each is fitted.
        each: One effect at m values of its constants.
        known: Of the others.
        beside: Of every other one, its inner products with each (`inner_each`).

    Returns:
        (m, k) parameters of each, and (m,) drop in chi-square on reference and field, the others' included.
    """
    known_slope, known_energy = (
        np.concatenate([np.zeros(0), *(getattr(c, name) for c in others)]) for name in ("slope", "energy")
    )
    first, count = len(known_slope), len(known_slope) + len(each[0].slope)
    gram = np.zeros((len(each), count, count))
    gram[:, :first, :first] = known.gram
    gram[:, first:, first:] = [one.gram for one in each]
    if others:
        gram[:, :first, first:] = np.concatenate(beside, axis=1)
        gram[:, first:, :first] = np.swapaxes(gram[:, :first, first:], 1, 2)
    slope, energy = np.empty((2, len(each), count))
    slope[:, :first], energy[:, :first] = known_slope, known_energy
    slope[:, first:], energy[:, first:] = [one.slope for one in each], [one.energy for one in each]
    values, gain, _ = _solved(gram, slope, energy, *_held_at([*others, each[0]]))
    return values[:, first:], gain


def inverse_among(gram: FloatArray, free: np.ndarray) -> FloatArray:
    """(..., k, k) inverse of Gram matrices among free rows (k,), in units that make them alike; zero elsewhere.

    Args:
        gram: (..., k, k).
        free: (k,) which rows and columns are inverted.
    """
    rows, columns = np.ix_(free, free)
    unit = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1)[..., free])
    inverse = np.zeros_like(gram)
    if free.any():
        units = unit[..., :, None] * unit[..., None, :]
        inverted = np.linalg.pinv(gram[..., rows, columns] / units, rcond=RANK_TOLERANCE, hermitian=True)
        inverse[..., rows, columns] = inverted / units
    return inverse


def _held_at(candidates: Sequence[Candidate]) -> tuple[np.ndarray, FloatArray]:
    """(k,) whether a parameter of any is held, and where."""
    held = np.concatenate([c.held for c in candidates])
    prior = np.array([p.prior for c in candidates for p in c.effect.parameters])
    return held, np.where(held, prior, 0.0)


def _solved(
    gram: FloatArray, slope: FloatArray, energy: FloatArray, held: np.ndarray, at: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least squares of m problems of k parameters.

    Args:
        gram: (m, k, k) inner products of what the base cannot take over.
        slope: (m, k) inner products with the residual.
        energy: (m, k) sum of squares of each column.
        held: (k,) whether a parameter is held.
        at: (k,) where; zero for the others.

    Returns:
        (m, k) values, (m,) drops in chi-square, (m, k, k) covariances.
    """
    values, covariance = np.tile(at, (len(gram), 1)), np.zeros_like(gram)
    # What moves no torque, or none that the base could not, stays where it is.
    free = ~held & (np.diagonal(gram, axis1=1, axis2=2) > np.maximum(INVISIBLE * energy, UNDERFLOW))
    alike, which = np.unique(free, axis=0, return_inverse=True)
    for number, own in enumerate(alike):
        mine = which.ravel() == number
        covariance[mine] = inverse_among(gram[mine], own)
    values += np.einsum("mij,mj->mi", covariance, slope - np.einsum("mij,mj->mi", gram, values))
    gain = 2 * np.einsum("mi,mi->m", slope, values) - np.einsum("mi,mij,mj->m", values, gram, values)
    return values, gain, covariance


def _gram(candidates: Sequence[Candidate]) -> FloatArray:
    """(k, k) inner products of what the base cannot take over of all candidates."""
    gram = np.zeros((0, 0))
    for count in range(1, len(candidates) + 1):
        gram = _gram_with(gram, candidates[:count])
    return gram


def _gram_with(gram: FloatArray, candidates: Sequence[Candidate]) -> FloatArray:
    """The same, where that of all but the last is known."""
    *others, last = candidates
    beside = np.concatenate([_inner(one, last) for one in others]) if others else np.zeros((0, len(last.gram)))
    return np.block([[gram, beside], [beside.T, last.gram]])


def _inner(one: Candidate, other: Candidate) -> FloatArray:
    """(k, l) inner products of what the base cannot take over."""
    return np.asarray(one.stacked.inner(other.stacked) - one.inside.T @ other.inside)


def inner_each(one: Candidate, each: Sequence[Candidate]) -> FloatArray:
    """(m, k, l) the same of one and each of m.

    Args:
        one: With k parameters.
        each: m candidates with l parameters each.
    """
    return np.stack([_inner(one, other) for other in each])


def with_own(candidates: Sequence[Candidate], values: FloatArray) -> Iterator[tuple[Candidate, FloatArray]]:
    """Each candidate with its own parameters out of those of all, one after the other (k,).

    Args:
        candidates: The effects.
        values: (k,) of their parameters.
    """
    first = 0
    for candidate in candidates:
        last = first + len(candidate.effect.parameters)
        yield candidate, values[first:last]
        first = last


def without_effects(
    residual: FloatArray,
    candidates: Sequence[Candidate],
    values: FloatArray,
    stack: Callable[[Candidate], Stacked],
) -> FloatArray:
    """Subtract the torque of effects from a residual; their per-recording parameters are refitted to it.

    Args:
        residual: (V,) residual of the base model, whitened or in N·m.
        candidates: Effects to subtract.
        values: (k,) their parameters, one candidate after the other.
        stack: Columns of a candidate in the rows of `residual`, in its unit.

    Returns:
        (V,) what is left; `residual` is not changed.
    """
    residual = residual.copy()
    stacks = [stack(candidate) for candidate in candidates]
    for stacked, (_, own) in zip(stacks, with_own(candidates, values)):
        residual[stacked.rows] -= stacked.columns @ own
    for candidate, stacked in zip(candidates, stacks):
        if candidate.effect.per_recording:
            per_recording = stacked.columns[:, candidate.effect.per_recording]
            residual[stacked.rows] -= (
                per_recording @ np.linalg.lstsq(per_recording, residual[stacked.rows], rcond=1e-9)[0]
            )
    return residual
