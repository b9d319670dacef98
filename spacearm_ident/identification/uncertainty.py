"""Standard errors that hold when residuals are correlated.

For weighted least squares with rows A, weights W and a Gaussian prior P,
    cov = H^-1 (S + P) H^-1,  H = A' W A + P,  S = A' W^(1/2) Omega W^(1/2) A,
with Omega the autocovariance of the weighted residual, estimated per joint and motion and tapered (Newey and West
1987). White residuals of the assumed size give back H^-1.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..dynamics.arm import FloatArray
from .prior import Prior
from .regression import Regression
from .weights import autocovariance

TAPER_FACTOR = 4.0
"""The autocovariance is tapered to zero over so many correlation times."""


def covariance(
    regression: Regression,
    prior: Prior,
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
        columns: Per joint, all columns (M, k), unweighted, derivatives by searched constants included.
        numbers: Per joint, the unknown each column belongs to.
        residuals: Per joint, (M,) unweighted residual.
        correlation: Per joint and motion, correlation time in rows.
        width: Number of unknowns u.

    Returns:
        (u, u), zero for unknowns that are not estimated.
    """
    information = np.zeros((width, width))
    score = np.zeros((width, width))
    for joint, rows in enumerate(regression.rows):
        weighted = columns[joint] * rows.weight[:, None]
        index = np.ix_(numbers[joint], numbers[joint])
        information[index] += weighted.T @ weighted
        freedom = _freedom(len(rows.torque), columns[joint].shape[1], correlation[joint])
        for motion in range(len(regression.motions)):
            mine = rows.owner == motion
            if mine.sum() < 2:
                continue
            residual = residuals[joint][mine] * rows.weight[mine]
            score[index] += freedom * _score(weighted[mine], residual, rows.place[mine], correlation[joint][motion])
    beliefs = np.zeros((width, width))
    beliefs[: prior.rows.shape[1], : prior.rows.shape[1]] = prior.rows.T @ prior.rows
    hessian = information + beliefs
    used = np.flatnonzero(np.diag(hessian) > 0)
    block = np.ix_(used, used)
    scale = 1.0 / np.sqrt(np.diag(hessian)[used])
    factor = cho_factor(hessian[block] * np.outer(scale, scale))
    inverse = cho_solve(factor, np.diag(scale)) * scale[:, None]
    result = np.zeros((width, width))
    result[block] = inverse @ (score + beliefs)[block] @ inverse
    return result


def _freedom(rows: int, parameters: int, correlation: list[float]) -> float:
    """What the fit took from the residual: effective rows over effective rows left."""
    effective = rows / float(np.mean(correlation))
    return effective / max(effective - parameters, 0.25 * effective) if rows else 1.0


def _score(weighted: FloatArray, residual: FloatArray, place: np.ndarray, correlation: float) -> FloatArray:
    """A' Omega A of one joint's rows in one motion; Omega is a tapered Toeplitz matrix applied by FFT."""
    acov = autocovariance(residual, place)
    lags = int(min(len(acov), max(1, np.ceil(TAPER_FACTOR * correlation)))) if correlation > 1.0 else 1
    kernel = acov[:lags] * (1.0 - np.arange(lags) / lags)
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
