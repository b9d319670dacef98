"""Standard errors that hold when residuals are correlated.

For weighted least squares with rows A, weights W and a Gaussian prior P,
    cov = H^-1 (S + P) H^-1,  H = A' W A + P,  S = A' W^(1/2) Omega W^(1/2) A,
with Omega the autocovariance of the weighted residual, estimated per joint and motion; what of it is more than the
low-pass makes of white noise is tapered (Newey and West 1987). White residuals of the assumed size give back H^-1.
To this comes what parameters that are held fixed may hide (`omitted.py`).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..arrays import FloatArray
from ..regression.prior import Prior
from ..regression.regression import Regression
from .omitted import hidden_shifts
from .weights import autocovariance

TAPER_FACTOR = 4.0
"""The autocovariance is tapered to zero over so many correlation times."""


def covariance(
    regression: Regression,
    prior: Prior,
    constants: FloatArray,
    columns: list[FloatArray],
    numbers: list[list[int]],
    residuals: list[FloatArray],
    correlation: list[list[float]],
    width: int,
) -> FloatArray:
    """Covariance of all unknowns at the solution.

    Args:
        regression: Weighted rows.
        prior: Beliefs about the parameters (unknowns 0 ... p-1).
        constants: (c,) at the solution.
        columns: Per joint, all columns (M, k), unweighted, derivatives by searched constants included.
        numbers: Per joint, the unknown each column belongs to.
        residuals: Per joint, (M,) unweighted residual.
        correlation: Per joint and motion, correlation time in rows.
        width: Number of unknowns u.

    Returns:
        (u, u), zero for unknowns that are not estimated.
    """
    weighted = [block * rows.weight[:, None] for block, rows in zip(columns, regression.rows)]
    beliefs = np.pad(prior.rows, ((0, 0), (0, width - prior.rows.shape[1])))
    hessian = beliefs.T @ beliefs
    score = hessian.copy()
    for unknowns, block in zip(numbers, weighted):
        hessian[np.ix_(unknowns, unknowns)] += block.T @ block
    inverse = _inverse(hessian)
    for joint, rows in enumerate(regression.rows):
        index = np.ix_(numbers[joint], numbers[joint])
        freedom = _freedom(len(rows.torque), len(numbers[joint]), correlation[joint])
        for number, motion in enumerate(regression.motions):
            mine = rows.owner == number
            if mine.sum() < 2:
                continue
            # Rows as if none were an outlier, residuals as far as the bound on outliers lets them pull.
            trust = np.sqrt(rows.trust[mine])
            residual = residuals[joint][mine] * rows.weight[mine] * trust
            kernel = _kernel(residual, rows.place[mine], motion.white_correlation, correlation[joint][number])
            score[index] += freedom * _score(weighted[joint][mine] / trust[:, None], rows.place[mine], kernel)
    shifts = hidden_shifts(regression, constants, inverse, beliefs, weighted, numbers, residuals)
    return np.asarray(inverse @ score @ inverse + shifts.T @ shifts)


def _inverse(hessian: FloatArray) -> FloatArray:
    """Inverse on the unknowns that are estimated, zero elsewhere."""
    used = np.flatnonzero(np.diag(hessian) > 0)
    block = np.ix_(used, used)
    scale = 1.0 / np.sqrt(np.diag(hessian)[used])
    factor = cho_factor(hessian[block] * np.outer(scale, scale))
    inverse = np.zeros_like(hessian)
    inverse[block] = cho_solve(factor, np.diag(scale)) * scale[:, None]
    return inverse


def _freedom(rows: int, columns: int, correlation: list[float]) -> float:
    """What the fit took from the residual: effective rows over effective rows left.

    All of a joint's columns are counted though other joints help to decide the inertials: an estimated autocovariance
    leaves standard errors too small, never too large.
    """
    effective = rows / float(np.mean(correlation))
    return effective / max(effective - columns, 0.25 * effective) if rows else 1.0


def _kernel(residual: FloatArray, place: np.ndarray, white: FloatArray, correlation: float) -> FloatArray:
    """(L,) autocovariance of the weighted residual by lag: low-passed white noise, and a tapered rest if it adds."""
    acov = autocovariance(residual, place, white)
    lags = min(len(acov), max(len(white), int(np.ceil(TAPER_FACTOR * correlation))))
    least = acov[0] * np.pad(white, (0, max(0, lags - len(white))))[:lags]
    rest = (acov[:lags] - least) * (1.0 - np.arange(lags) / lags)
    return np.asarray(least + rest if rest.sum() > 0 else least)


def _score(weighted: FloatArray, place: np.ndarray, kernel: FloatArray) -> FloatArray:
    """A' Omega A of one joint's rows in one motion; Omega is a Toeplitz matrix applied by FFT."""
    lags = len(kernel)
    if lags == 1:
        return np.asarray(kernel[0] * (weighted.T @ weighted))
    length = int(place[-1] - place[0]) + 1
    size = length + lags
    spread = np.zeros((length, weighted.shape[1]))
    spread[place - place[0]] = weighted
    two_sided = np.zeros(size)
    two_sided[:lags] = kernel
    two_sided[-(lags - 1) :] += kernel[1:][::-1]
    spectrum = np.maximum(np.fft.rfft(two_sided).real, 0.0)
    smeared = np.fft.irfft(np.fft.rfft(spread, size, axis=0) * spectrum[:, None], size, axis=0)[:length]
    return np.asarray(spread.T @ smeared)
