"""The posterior of r = M v + noise, v ~ N(0, 1), under noise that its own residual shows.

A row counts 1/(sigma^2 kappa) as in `weights.py`. Of a few seconds, what a fit takes from its residual matters: sigma
is corrected for it (the trace h of the hat matrix over effective rows), and so is kappa, read off short lags
(`first_order.py`) and no smaller than what `weights.py` sees. Degrees of freedom of sigma^2 are those of Satterthwaite,
(tr W)^2 / tr W^2 with W the covariance of the residual: of N rows, kappa_2 the correlation time of the square,

    N / kappa_2 before a fit,    (N / kappa - h / 2) kappa / kappa_2 after it,

for a spectrum that falls to zero the h slowest of whose directions were taken (within 5 % for the Hann window's).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..errors import UnfitDataError
from ..noise.first_order import FirstOrder
from ..noise.weights import HUBER, residual_noise
from ..regression.regression import Regression

ITERATIONS = 8
START_NOISE = 0.01
"""Noise that weights begin with, as a share of a joint's torque."""
LEAST_FREEDOM = 3.0


@dataclass(frozen=True)
class Posterior:
    """What the rows say.

    Attributes:
        mean: (r,).
        covariance: (r, r).
        sigma: (n,) N·m, noise of a row.
        effective_rows: (n,) rows over their correlation time.
        freedom: (n,) degrees of freedom of sigma^2.
    """

    mean: FloatArray
    covariance: FloatArray
    sigma: FloatArray
    effective_rows: FloatArray
    freedom: FloatArray


@dataclass(frozen=True)
class _JointNoise:
    """Of one joint: sigma of a row, effective rows, kappa_2 over kappa."""

    sigma: float
    effective: float
    squared_share: float


def posterior(
    regression: Regression, matrices: list[FloatArray], targets: list[FloatArray], density: FloatArray | None = None
) -> Posterior:
    """Iterate mean and noise.

    Args:
        regression: Whose rows these are.
        matrices: Per joint, (M, r).
        targets: Per joint, (M,) N·m.
        density: (n,) least power density of the noise, (N·m)²·s, where more is known of it than the rows show.

    Raises:
        UnfitDataError: No joint has rows.
    """
    laws = [FirstOrder.after(motion.white_correlation) for motion in regression.motions]
    # From the data's side: the ground's own residual is slow and large, weights made from it would believe no row, and
    # a fit that believes none stays there.
    loud = [START_NOISE**2 * float(np.sum(rows.torque**2)) / max(len(rows.torque), 1) for rows in regression.rows]
    weights = [np.full(len(target), 1.0 / (power + 1e-18)) for target, power in zip(targets, loud)]
    rate_hz = np.mean([motion.row_rate_hz for motion in regression.motions])
    with np.errstate(divide="ignore"):
        most = 1.0 / (rate_hz * (np.zeros(len(targets)) if density is None else density))
    mean, spread = _solved(matrices, targets, weights)
    hats = np.zeros(len(targets))
    for _ in range(ITERATIONS + 1):
        residuals = [target - matrix @ mean for matrix, target in zip(matrices, targets)]
        noise = [_noise(regression, laws, k, residual, hats[k]) for k, residual in enumerate(residuals)]
        weights = [_weight(residual, one, worth) for residual, one, worth in zip(residuals, noise, most)]
        mean, spread = _solved(matrices, targets, weights)
        hats = np.array([np.sum((m @ spread) * m * weight[:, None]) for m, weight in zip(matrices, weights)])
    effective = np.array([one.effective for one in noise])
    if not effective.any():
        raise UnfitDataError("no joint moves long enough to identify anything: record a few seconds of motion")
    freedom = (effective - hats / 2.0) / np.array([one.squared_share for one in noise])
    sigma = np.array([one.sigma for one in noise])
    return Posterior(mean, spread, sigma, effective, np.maximum(freedom, LEAST_FREEDOM))


def _solved(
    matrices: list[FloatArray], targets: list[FloatArray], weights: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Mean (r,) and covariance (r, r) under weights (M,) a joint."""
    information, score = np.eye(matrices[0].shape[1]), np.zeros(matrices[0].shape[1])
    for matrix, target, weight in zip(matrices, targets, weights):
        information += matrix.T @ (matrix * weight[:, None])
        score += matrix.T @ (target * weight)
    spread = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return np.asarray(spread @ score), spread


def _weight(residual: FloatArray, noise: _JointNoise, most: float) -> FloatArray:
    """(M,) information of the rows, 1/(N·m)², none more than `most`; outliers bounded."""
    share = noise.effective / max(len(residual), 1)
    huber = np.minimum(1.0, HUBER * noise.sigma / np.maximum(np.abs(residual), 1e-300))
    return np.asarray(huber * min(share / noise.sigma**2, most))


def _noise(regression: Regression, laws: list[FirstOrder], joint: int, residual: FloatArray, hat: float) -> _JointNoise:
    """Noise of one joint over all motions; `hat` is the number of effective rows that the fit used up."""
    rows = regression.rows[joint]
    squares = effective = shares = 0.0
    for number, (motion, law) in enumerate(zip(regression.motions, laws)):
        mine = rows.owner == number
        if mine.sum() < 2:
            continue
        noise = residual_noise(residual[mine], rows.place[mine], motion.white_correlation)
        bounded = np.clip(residual[mine], -HUBER * noise.sigma_Nm, HUBER * noise.sigma_Nm)
        kappa = max(noise.correlation_rows, law.kappa_of(bounded, rows.place[mine], hat / len(residual)))
        squares += noise.rows * noise.sigma_Nm**2
        effective += noise.rows / kappa
        shares += noise.rows / kappa * law.squared_share(kappa)
    if effective == 0.0:
        return _JointNoise(1.0, 0.0, 1.0)
    freedom = max(effective - hat, LEAST_FREEDOM, 0.25 * effective)
    floor = 1e-6 * float(np.sqrt(np.mean(rows.torque**2))) + 1e-9
    sigma = float(np.sqrt(squares / len(residual) * effective / freedom))
    return _JointNoise(max(sigma, floor), effective, shares / effective)
