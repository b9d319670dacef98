"""The part of a residual that is slower than noise.

Noise of a torque sensor or a current is white before the low-pass. What is left of a torque that no term explains (a
hose that drags, a pump, a law that is not in the catalogue) is slow, as everything is that a mechanism does. So the
upper half of the band says how large the noise is, and what the lower half has more than that is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..signals.motion import Motion
from .weights import lagged_products

LONGEST_S = 2.0
"""Longest lag of the covariance that the spectrum is computed from: half a hertz is told from the next."""
FREQUENCIES = 256
"""Frequencies from zero to half the rate of the rows."""
UPPER_HALF = 0.5, 1.0
"""Of the cut-off: the band that says how large the noise is."""


def white_and_slow(
    motions: Sequence[Motion], residuals: Sequence[FloatArray], counts: Sequence[np.ndarray]
) -> FloatArray:
    """Split a residual into noise that is white before the low-pass and a slow part.

    The spectrum is that of Blackman and Tukey (1958), rows that do not count left out of the covariance.

    Args:
        motions: Recordings of n joints, of one bandwidth.
        residuals: By motion, (M, n) N m.
        counts: By motion, (M, n) rows that count.

    Returns:
        (2, n) RMS of the white part and of the slow part, N m; NaN where a joint has less than `LONGEST_S` of rows.
    """
    first = motions[0]
    rate_hz = first.rate_hz / (first.block * first.stride)
    lags = int(LONGEST_S * rate_hz)
    taper = 0.5 * (1.0 + np.cos(np.pi * np.arange(lags) / lags))
    frequency = np.linspace(0.0, 0.5, FREQUENCIES)
    cosines = 2.0 * np.cos(2.0 * np.pi * np.outer(frequency, np.arange(lags))) * taper
    cosines[:, 0] = 1.0
    white = np.zeros(lags)
    white[: len(first.white_correlation)] = first.white_correlation[:lags]
    noise = cosines @ white
    low, high = (share * first.cutoff_hz / rate_hz for share in UPPER_HALF)
    upper = (frequency >= low) & (frequency <= high)
    found = np.full((2, residuals[0].shape[1]), np.nan)
    for joint in range(found.shape[1]):
        products, pairs = np.zeros((2, lags))
        for residual, count in zip(residuals, counts):
            place = np.flatnonzero(count[:, joint])
            if len(place):
                own = [part[:lags] for part in lagged_products(residual[place, joint], place)]
                products[: len(own[0])] += own[0]
                pairs[: len(own[1])] += own[1]
        if pairs[0] < lags:
            continue
        covariance = products / np.maximum(pairs, 1.0)
        level = max(float(np.median((cosines[upper] @ covariance) / noise[upper])), 0.0)
        found[:, joint] = np.sqrt([min(level, covariance[0]), max(covariance[0] - level, 0.0)])
    return found
