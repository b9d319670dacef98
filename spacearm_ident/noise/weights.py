"""How much each row of a regression tells: noise level, correlation in time, outliers.

The information of a row is 1/(sigma^2 kappa): sigma from the residual, kappa its integrated autocorrelation time
(residuals of a low-passed signal, or of a model that leaves something out, repeat themselves, and counting them
as independent is why residual-based intervals come out too short). A fit takes from its residual what its columns
can follow, the slow part first, so the residual looks whiter than the noise was: no correlation is taken to be
smaller than what the low-pass makes of white noise. Outliers are bounded after Huber (1964).

Joints are weighted against each other by the RMS of their residuals, outliers included, and kappa is the mean over
the joints of a motion. On a real arm the slow part of a residual is model error, and so are its tails. With a kappa for
each joint, the joint with the largest model error hardly counts when the shared inertials are decided, and is then
predicted worse than by plain weighted least squares: Panda joint 6, 14.2 % of its torque against 5.3 %
(docs/real_arms.md). With a robust sigma, a joint whose model fails at reversals alone decides them, and its neighbours
are predicted worse: Panda joints 5 and 6, 9.3 and 7.6 % without bounds of physics, against 8.7 and 6.5 % with the RMS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..regression.regression import Regression

HUBER = 3.0
"""Residuals beyond so many standard deviations lose weight; 99.7 % of Gaussian ones keep it."""
WINDOW = 5.0
"""Sokal's automatic window: the correlation sum is cut at so many correlation times."""


@dataclass(frozen=True)
class Noise:
    """The residual of one joint in one motion.

    Attributes:
        sigma_Nm: Robust standard deviation.
        correlation_rows: Integrated autocorrelation time kappa, rows (1: white).
        rows: Rows used.
    """

    sigma_Nm: float
    correlation_rows: float
    rows: int


def residual_noise(residual: FloatArray, place: np.ndarray, white: FloatArray) -> Noise:
    """Noise of a residual.

    Args:
        residual: (M,) N·m.
        place: (M,) row numbers in time (gaps where the joint stood still).
        white: (L,) autocorrelation of reduced white noise, `Motion.white_correlation`.
    """
    if len(residual) < 2:
        return Noise(float("inf"), 1.0, len(residual))
    sigma = 1.4826 * float(np.median(np.abs(residual)))
    # Clip at the Huber bound, so that one outlier does not make the whole residual look white, or loud.
    clipped = np.clip(residual, -HUBER * sigma, HUBER * sigma) if sigma > 0 else residual
    spread = float(np.sqrt(np.mean(clipped**2)))
    if spread == 0.0:
        return Noise(0.0, 1.0, len(residual))
    return Noise(spread, _correlation_time(autocovariance(clipped, place, white), white), len(residual))


def autocovariance(residual: FloatArray, place: np.ndarray, white: FloatArray) -> FloatArray:
    """(L,) autocovariance by lag in rows, gaps left out of the count, up to a quarter of the record.

    Over the length of the low-pass it is nowhere less than white noise of the same variance would have it.

    Args:
        residual: (M,) of one joint.
        place: (M,) row of the motion that each is of, ascending.
        white: (L,) autocorrelation of reduced white noise, `Motion.white_correlation`.
    """
    products, pairs = lagged_products(residual, place)
    lags = max(1, len(products) // 4)
    covariance = products[:lags] / np.maximum(pairs[:lags], 1.0)
    reach = min(len(white), lags)
    covariance[:reach] = np.maximum(covariance[:reach], covariance[0] * white[:reach])
    return np.asarray(covariance)


def lagged_products(residual: FloatArray, place: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """(L,) sums of products of rows by lag in rows, and (L,) how many pairs of rows each is of.

    Args:
        residual: (M,) of one joint.
        place: (M,) row of the motion that each is of, ascending.
    """
    length = int(place[-1] - place[0]) + 1
    signal, present = np.zeros(length), np.zeros(length)
    signal[place - place[0]] = residual
    present[place - place[0]] = 1.0
    size = 2 * length
    products = np.fft.irfft(np.abs(np.fft.rfft(signal, size)) ** 2, size)[:length]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(present, size)) ** 2, size)[:length]
    return np.asarray(products), np.asarray(pairs)


def _correlation_time(covariance: FloatArray, white: FloatArray) -> float:
    """1 + 2 sum of the autocorrelation, cut off where it has died away (Sokal 1997), at least white noise's."""
    time = 1.0 + 2.0 * np.cumsum(covariance[1:] / covariance[0])
    lags = np.arange(1, len(time) + 1)
    enough = np.flatnonzero(lags >= WINDOW * np.maximum(time, 1.0))
    value = time[enough[0]] if len(enough) else time[-1] if len(time) else 1.0
    return float(max(white_correlation_time(white), value))


def white_correlation_time(white: FloatArray) -> float:
    """Integrated autocorrelation time of reduced white noise, rows, from its autocorrelation (L,) by lag in rows."""
    return float(1.0 + 2.0 * white[1:].sum())


def reweight(regression: Regression, residuals: list[FloatArray]) -> list[list[Noise]]:
    """Set every joint's weights from its residual (M,); returns the noise by joint and motion.

    Args:
        regression: Its rows get new weights; those of outliers are lower (Huber 1964).
        residuals: One for each joint, N·m, of the joint's own rows.
    """
    motions = regression.motions
    result = [
        [
            residual_noise(residual[rows.owner == k], rows.place[rows.owner == k], motion.white_correlation)
            for k, motion in enumerate(motions)
        ]
        for rows, residual in zip(regression.rows, residuals)
    ]
    kappa = np.array([common_correlation([joint[k] for joint in result]) for k in range(len(motions))])
    size, sigma = _sizes(regression, residuals, result)
    # Outliers lower a joint's weight against the other joints, not that of all data against the prior.
    seen = np.isfinite(sigma)
    level = float(np.exp(np.mean(np.log(size[seen] / sigma[seen])))) if seen.any() else 1.0
    for rows, residual, own_size, own_sigma in zip(regression.rows, residuals, size, sigma):
        huber = np.minimum(1.0, HUBER * own_sigma[rows.owner] / np.maximum(np.abs(residual), 1e-300))
        rows.set_weight(np.asarray(np.sqrt(huber / kappa[rows.owner]) * level / own_size[rows.owner]), huber)
    return result


def _sizes(
    regression: Regression, residuals: list[FloatArray], noise: list[list[Noise]]
) -> tuple[FloatArray, FloatArray]:
    """(n, motions) RMS and robust sigma of the residuals, N·m; infinite where a joint has no rows in a motion.

    Neither is less than 1e-6 of the joint's torque, RMS: a residual of rounding errors says nothing of the arm.
    """
    size, sigma = np.full((2, len(noise), len(regression.motions)), np.inf)
    for joint, (rows, residual) in enumerate(zip(regression.rows, residuals)):
        floor = max(1e-6 * float(np.sqrt(np.mean(rows.torque**2))) if len(residual) else 0.0, 1e-9)
        for k, one in enumerate(noise[joint]):
            own = residual[rows.owner == k]
            if len(own) > 1:
                sigma[joint, k] = max(one.sigma_Nm, floor)
                size[joint, k] = max(float(np.sqrt(np.mean(own**2))), floor)
    return size, sigma


def common_correlation(noises: Sequence[Noise]) -> float:
    """Mean correlation time of several joints' residuals, in rows, each weighted by its number of rows.

    Args:
        noises: At least one.
    """
    rows = np.array([noise.rows for noise in noises], dtype=float)
    times = np.array([noise.correlation_rows for noise in noises])
    return float(rows @ times / rows.sum()) if rows.any() else 1.0
