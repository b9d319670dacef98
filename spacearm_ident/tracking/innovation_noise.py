"""`InnovationNoise`: how loud and how slow the innovations of a tracker are, as they come.

A row counts 1/(sigma^2 kappa): sigma is the innovations' standard deviation, kappa their integrated autocorrelation
time in rows, so that residuals which repeat themselves (a low-pass, physics the model leaves out) are not taken for
independent evidence. Both follow from exponentially weighted autocovariances, innovations bounded after Huber (1964),
the sum over lags tapered after Bartlett; nothing is taken to be whiter than the low-pass makes of white noise. A few
seconds of data cannot tell slow noise from fast: until they can, noise is believed to keep for a quarter of a second.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

HUBER = 3.0
LAGS = 80
MEMORY_ROWS = 2400.0
START_ROWS = 40
"""So many moving rows decide on the first noise level of a joint."""
LARGEST_CORRELATION = 100.0
BELIEF_ROWS, BELIEF_CORRELATION_ROWS = 200.0, 5.0
"""The belief before any data counts as so many rows; so long its noise keeps."""


class InnovationNoise:
    """Noise of n joints' innovations.

    Args:
        start: (n,) first standard deviations, N·m; NaN where not known yet.
        white: (L,) autocorrelation by lag in rows that the low-pass gives to a white signal; 1 at lag 0.

    Attributes:
        sigma: (n,) N·m.
        correlation: (n,) kappa, rows.
    """

    def __init__(self, start: FloatArray, white: FloatArray) -> None:
        joints = len(start)
        self.sigma = np.array(start, dtype=float)
        self._white = np.zeros(LAGS)
        self._white[: len(white[:LAGS])] = white[:LAGS]
        self.correlation = np.full(joints, 1.0 + 2.0 * float(self._white[1:].sum()))
        self._least = float(self.correlation[0]) if joints else 1.0
        self._products = np.zeros((LAGS, joints))
        self._pairs = np.zeros((LAGS, joints))
        self._recent = np.full((LAGS, joints), np.nan)

    def begin(self, joint: int, residual: FloatArray, unknowns: int) -> None:
        """Set the first noise level of a joint from the residual of a fit to it.

        Args:
            joint: Number of the joint.
            residual: (M,) N·m.
            unknowns: Number of parameters that were fitted.
        """
        middle = 1.4826 * float(np.median(np.abs(residual)))
        bounded = np.clip(residual, -HUBER * middle, HUBER * middle) if middle > 0 else residual
        freedom = max(1.0, len(residual) / self._least - unknowns) * self._least
        self.sigma[joint] = max(float(np.sqrt(np.sum(bounded**2) / freedom)), 1e-9)
        belief = np.maximum(self._white, np.exp(-np.arange(LAGS) / BELIEF_CORRELATION_ROWS))
        self._pairs[:, joint] = BELIEF_ROWS
        self._products[:, joint] = BELIEF_ROWS * self.sigma[joint] ** 2 * belief
        self._judge()

    def add(self, innovations: FloatArray) -> None:
        """Take rows (M, n) in the order of time, NaN where a joint has none."""
        fade = 1.0 - 1.0 / MEMORY_ROWS
        for row in innovations:
            bounded = np.clip(row, -HUBER * self.sigma, HUBER * self.sigma)
            self._recent = np.concatenate([bounded[None], self._recent[:-1]])
            products = self._recent * bounded
            present = np.isfinite(products)
            seen = present[0]
            self._products[:, seen] = fade * self._products[:, seen] + np.where(present, products, 0.0)[:, seen]
            self._pairs[:, seen] = fade * self._pairs[:, seen] + present[:, seen]
        self._judge()

    def _judge(self) -> None:
        known = self._pairs[0] > 0
        covariance = self._products[:, known] / np.maximum(self._pairs[:, known], 1.0)
        self.sigma[known] = np.sqrt(np.maximum(covariance[0], 1e-18))
        share = covariance[1:] / np.maximum(covariance[0], 1e-18)
        taper = 1.0 - np.arange(1, LAGS) / LAGS
        total = 1.0 + 2.0 * (taper[:, None] * share).sum(axis=0)
        self.correlation[known] = np.clip(total, self._least, LARGEST_CORRELATION)
