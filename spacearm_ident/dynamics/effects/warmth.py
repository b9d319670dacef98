"""`above_reference`: laws of temperature as a change from the temperature that a reference had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..friction import WARM_FROM, excess_temperature
from .effect import Effect

ABOVE = "above_C"
"""Key of a place: temperature from which a law counts, °C; without it T_0."""
THERMOMETER_K = 1.5
"""What a joint's thermometer may be off by (a thermistor of 5 %): a reference so near to T_0 is at T_0."""


def excess_of(effect: Effect, motion: Motion, row: int) -> FloatArray:
    """(N,) temperature of a joint above the one from which an effect counts, K; zero where none was recorded.

    Args:
        effect: With `ABOVE` in its place, or not.
        motion: N samples.
        row: Number of the joint.
    """
    return excess_temperature(motion, row, float(effect.place.get(ABOVE, WARM_FROM)))


def above_reference(effect: Effect, reference: Sequence[Motion]) -> Effect:
    """An effect of one joint, counted from the mean temperature of that joint in the reference.

    A base that was fitted to the reference is right at that temperature. Counted from T_0, a slope would have to be
    what the joint changed by, over how far it is from T_0.

    Args:
        effect: Whose columns are in proportion to the temperature above `ABOVE`.
        reference: Motions of the healthy arm.

    Returns:
        Itself where the reference was at T_0, as far as is known, or has no temperature of that joint.
    """
    joint = effect.place["joint"]
    measured = [m.temperature[:, m.joints.index(joint)] for m in reference if m.temperature is not None]
    known = np.concatenate([*measured, np.zeros(0)])
    known = known[np.isfinite(known)]
    if not known.size or abs(known.mean() - WARM_FROM) <= THERMOMETER_K:
        return effect
    return replace(effect, place={**effect.place, ABOVE: float(known.mean())})
