"""How large an effect seems to be where nothing changed: in parts of the reference, fitted as it is in the field.

A model that is not quite right leaves residuals that an effect can follow. How far it can, the healthy arm shows: the
effect is put into one part of the reference after the other and fitted together with the base, its constants searched
over their grids. What it seems to be there, N²·m² a row of what the base cannot take over, has the distribution of a
variance with few degrees of freedom; the finding's must be larger, by the F distribution.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.stats import f as fisher

from ..arrays import FloatArray
from .candidate import Candidate, refit
from .constants import grid_points
from .evidence import Evidence
from .left_out import LEVEL, LeftOut
from .scored import freedom
from .stacked import Stacked, stacked_effect

EXCITED = 0.2
"""Share of the field's excitation per row that an effect must have in the reference, which else says nothing of it."""


def exceeds_null(candidate: Candidate, values: FloatArray, evidence: Evidence, left_out: LeftOut) -> bool:
    """Whether an effect in the field is larger than it seems in parts of the reference.

    Args:
        candidate: The effect, with the constants found in the field.
        values: (k,) its parameters.
        evidence: Field and reference.
        left_out: Parts of the reference.

    Returns:
        False, too, where the reference does not excite the effect, or is too short to be divided.
    """
    healthy = evidence.healthy
    if not left_out.known or evidence.reference is None:
        return False
    parts = _parts(candidate, candidate.constants, healthy, left_out)
    size = sum(float(values @ part.gram @ values) for part in parts)
    if size < EXCITED * float(values @ candidate.gram @ values) * len(healthy.field) / evidence.rows:
        return False
    grid = grid_points(candidate.effect, healthy.field.motions) if candidate.constants else ()
    tried = chain([parts], (_parts(candidate, constants, healthy, left_out) for constants in grid))
    gains = [sum(refit([part]).gain for part in one) for one in tried]
    free = freedom(candidate.effect)
    # Noise alone gains one a free number and part.
    return size > float(fisher.ppf(1.0 - LEVEL, free, free * len(parts))) * max(*gains, free * len(parts))


def _parts(candidate: Candidate, constants: tuple[float, ...], healthy: Evidence, left_out: LeftOut) -> list[Candidate]:
    """The effect in one part of the reference after the other, and in no other."""
    stacked = stacked_effect(healthy.field, candidate.effect, constants)
    part = left_out.fold_of_row[stacked.rows]

    def inside(fold: int) -> Stacked:
        return Stacked(stacked.rows, np.where((part == fold)[:, None], stacked.columns, 0.0))

    return [healthy.candidate(candidate.effect, constants, inside(fold)) for fold in range(len(left_out.fits))]
