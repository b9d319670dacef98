"""What a healthy arm leaves of the recordings that are judged, and what is more than that.

Three figures a joint: its floor, what it exceeds rarely, and what is a mismatch even where nothing explains it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..arrays import FloatArray
from .evidence import Evidence
from .left_out import LEVEL, LeftOfOwn, LeftOut
from .preparation import Prepared
from .residuals import Residuals
from .scored import BEST, PARTS

LEFT_OVER = 2.0
"""A joint whose residual variance is so many times the floor's has something unexplained, beside findings."""
UNNAMED = 2.5
"""The same where nothing was found at all: then it is a mismatch without a name. Simulated healthy arms had 1.5 at
most."""
GROWS = 0.4
"""Power of the RMS acceleration of a joint with which a healthy arm's residual grows, where the judged motion is faster
than the reference's. `bench/healthy_growth.py`: 0.39 +- 0.06 on pairs of real recordings, 0.47 +- 0.30 and 0.70 +- 0.18
on healthy arms of two blind series."""


@dataclass(frozen=True)
class Healthy:
    """A healthy arm on the judged recordings.

    Attributes:
        parameters: Of the base, from the reference alone (`Evidence.base_parameters`).
        floor_Nm: (n,) RMS that it leaves.
        largest_Nm: (n,) RMS that it leaves at most (`LeftOut.largest_Nm`); the floor where that is not known.
        left_out: Fits to parts of the reference; None without a recorded one.
    """

    parameters: FloatArray
    floor_Nm: FloatArray
    largest_Nm: FloatArray
    left_out: LeftOut | None = None

    @property
    def unexplained_Nm(self) -> FloatArray:
        """(n,) RMS after all findings above which something is left unexplained."""
        return np.asarray(np.maximum(self.largest_Nm, np.sqrt(LEFT_OVER) * self.floor_Nm))

    @property
    def detectable_Nm(self) -> FloatArray:
        """(n,) RMS above which it is a mismatch though nothing was found."""
        return np.asarray(np.maximum(self.largest_Nm, np.sqrt(UNNAMED) * self.floor_Nm))

    def beyond(self, lasting_Nm: FloatArray, whole_Nm: FloatArray) -> np.ndarray:
        """(n,) whether a residual is a mismatch though nothing was found.

        Args:
            lasting_Nm: (n,) its RMS without the `BEST` largest of `PARTS` parts of the time, in which an accident is.
            whole_Nm: (n,) its RMS. An event counts if these parts alone would raise the variance of the whole to
                `PARTS / BEST` times what is detectable: then the largest have that many times as much again.
        """
        with np.errstate(invalid="ignore"):
            event = whole_Nm > np.sqrt(PARTS / BEST) * self.detectable_Nm
            return np.asarray((lasting_Nm > self.detectable_Nm) | event)


def healthy_levels(evidence: Evidence, prepared: Prepared, judged: Sequence[Residuals]) -> list[Healthy]:
    """What a healthy arm leaves of each of some recordings that its fit does not see.

    The floor is what the base leaves of the reference. Where that is what the model lacks (`noise.weighted`), it is
    what is left of parts that a fit left out, and beside it the error of what they predict of the judged motion.
    The largest has more: a faster motion leaves more (`GROWS`); parts that are alike agree on what none of them shows,
    so that error is the fit's own where it is larger; and friction ordinarily differs by something on another day with
    a probability of `LEVEL` (`Prepared.days`). The floor has not: a higher one lets findings explain a larger share.
    Where a model is the reference, its file says what it leaves of its own recordings. Where it does not, and without a
    reference: the noise as it was estimated in the field.

    Args:
        evidence: Field and reference, with what they share.
        prepared: Noise of every joint.
        judged: Rows of recordings that are judged together.
    """
    noise = prepared.noise_floor_Nm
    alone = evidence if evidence.reference is None else evidence.healthy
    parameters = alone.base_parameters([], np.zeros(0))
    if evidence.reference is None or (prepared.modelled and prepared.own is None):
        return [Healthy(parameters, noise, noise)] * len(judged)
    left_out: LeftOut | LeftOfOwn
    if prepared.own is not None:
        left_out, accelerated, floor = prepared.own, prepared.own.acceleration, noise
    else:
        residuals = Residuals(alone, evidence.reference, prepared.plain)
        left_out, accelerated = LeftOut(alone, residuals), residuals.acceleration()
        floor = residuals.rms(residuals.of(parameters, [], np.zeros(0)))
        floor = np.where(np.isfinite(floor), floor, noise)
    largest = np.fmax(floor, left_out.largest_Nm)
    if prepared.weighted:
        floor = np.fmax(floor, left_out.rms_Nm)
    made = []
    for rows in judged:
        error = most_error = np.zeros(len(floor))
        grown = np.ones(len(floor))
        if prepared.weighted:
            error = left_out.error_Nm(rows)
            most_error = np.fmax(error, np.nan_to_num(rows.error_Nm(alone)))
            grown = _growth(rows.acceleration(), accelerated)
        ordinary = np.nan_to_num(rows.ordinary_Nm(evidence.base.model, parameters))
        day = norm.isf(LEVEL) * prepared.days * ordinary
        most = np.sqrt((grown * largest) ** 2 + (left_out.times * most_error) ** 2 + day**2)
        parts = left_out if isinstance(left_out, LeftOut) else None
        made.append(Healthy(parameters, np.hypot(floor, error), most, parts))
    return made


def _growth(judged: FloatArray, reference: FloatArray) -> FloatArray:
    """(n,) how many times as much a healthy arm leaves of a motion with these accelerations; 1 where one is unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = judged / reference
    return np.asarray(np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0) ** GROWS)
