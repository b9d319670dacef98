"""`Candidate`: an effect with values of its constants, and what the base model cannot take over of its torque."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from .stacked import Stacked


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
