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
"""Longest lag of the covariance that the spectrum is computed from: its resolution is half a hertz."""
FREQUENCIES = 256
"""Frequencies from zero to half the rate of the rows."""
UPPER_HALF = 0.5, 1.0
"""Of the cut-off: the band that says how large the noise is; mechanisms are slower, and above it the low-pass leaves
nothing."""


def white_and_slow(
    motions: Sequence[Motion], residuals: Sequence[FloatArray], counts: Sequence[np.ndarray]
) -> FloatArray:
    """Split a residual into noise that is white before the low-pass and a slow part.

    The spectrum is that of Blackman and Tukey (1958), rows that do not count left out of the covariance.

    Args:
        motions: Recordings of n joints.
        residuals: By motion, (M, n) N m.
        counts: By motion, (M, n) rows that count.

    Returns:
        (2, n) RMS of the white part and of the slow part, N m; NaN where no motion has `LONGEST_S` of a joint's rows.
    """
    variance, rows = np.zeros((2, residuals[0].shape[1])), np.zeros(residuals[0].shape[1])
    for motion, residual, count in zip(motions, residuals, counts):
        spectrum = _Spectrum(motion)
        for joint, counted in enumerate(count.T):
            place = np.flatnonzero(counted)
            if len(place) >= spectrum.lags:
                variance[:, joint] += len(place) * spectrum.variances(residual[place, joint], place)
                rows[joint] += len(place)
    return np.sqrt(variance / np.where(rows > 0, rows, np.nan))


class _Spectrum:
    """The cosine transform of covariances of a motion's rows, beside that of white noise."""

    def __init__(self, motion: Motion) -> None:
        rate_hz = motion.rate_hz / (motion.block * motion.stride)
        self.lags = int(LONGEST_S * rate_hz)
        taper = 0.5 * (1.0 + np.cos(np.pi * np.arange(self.lags) / self.lags))
        frequency = np.linspace(0.0, 0.5, FREQUENCIES)
        low, high = (share * motion.cutoff_hz / rate_hz for share in UPPER_HALF)
        upper = frequency[(frequency >= low) & (frequency <= high)]
        self._cosines = 2.0 * np.cos(2.0 * np.pi * np.outer(upper, np.arange(self.lags))) * taper
        self._cosines[:, 0] = 1.0
        known = motion.white_correlation[: self.lags]
        self._white = self._cosines[:, : len(known)] @ known

    def variances(self, residual: FloatArray, place: np.ndarray) -> FloatArray:
        """(2,) of the white part and of the slow part of one joint's rows (M,), at rows `place` of the motion."""
        products, pairs = (part[: self.lags] for part in lagged_products(residual, place))
        covariance = products / np.maximum(pairs, 1.0)
        level = max(float(np.median((self._cosines[:, : len(covariance)] @ covariance) / self._white)), 0.0)
        return np.array([min(level, covariance[0]), max(covariance[0] - level, 0.0)])
