"""What the numbers of a log say: whether one column is the derivative of another, a time, or the weight of the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.regressor import rigid_body_torque

WINDOW_S = 0.04
"""Time over which a difference of positions is compared with the mean velocity: encoder steps drown within it."""
SLOWEST_HZ = 90.0
FASTEST_HZ = 8_000.0
"""Rates of rows of a log, Hz: below the first (contracts §1) nothing can be identified; the second is that of the
shortest cycle of drives (EtherCAT, 125 us). Seconds of a log at 20 Hz would else be milliseconds at 20 kHz."""
DERIVATIVE = 0.9
"""Correlation with the difference of the positions from which a column is their velocity: noise of the derivative over
`WINDOW_S` is below a third of the motion in any recording at hand, and unrelated signals correlate below 0.5."""
LOADED = 0.6
"""Partial correlation with the weight from which a joint's effort follows it."""
MOST_ROWS = 4000
"""Rows that are looked at for weight: friction and gravity vary slowly."""


def steps_s(time: FloatArray) -> tuple[float, float]:
    """Median step of a time, and the share of steps that are above zero and within a tenth and ten of it."""
    steps = np.diff(time)
    steps = steps[np.isfinite(steps)]
    ahead = steps[steps > 0]
    if not len(ahead):
        return 0.0, 0.0
    median = float(np.median(ahead))
    return median, float(np.mean((steps > 0.1 * median) & (steps < 10.0 * median)))


@dataclass(frozen=True)
class Slope:
    """How a column follows the derivative of another: factor, and correlation over the windows."""

    factor: float
    correlation: float


def derivative_of(position: FloatArray, velocity: FloatArray, time: FloatArray, window: int) -> Slope | None:
    """How a column follows the derivative of another.

    Args:
        position: (N,).
        velocity: (N,).
        time: (N,) s, or the number of the row.
        window: Rows over which they are compared.

    Returns:
        `velocity` = factor · d position / d time; None where one of them hardly varies.
    """
    sound = np.isfinite(position) & np.isfinite(velocity) & np.isfinite(time)
    if sound.sum() < 4 * window:
        return None
    q, v, t = position[sound], velocity[sound], time[sound]
    area = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    risen, swept = q[window:] - q[:-window], area[window:] - area[:-window]
    # Steps of time that go back, or pauses, are no windows.
    whole = t[window:] - t[:-window]
    usual = (whole > 0) & (whole < 3.0 * np.median(whole))
    risen, swept = risen[usual], swept[usual]
    if len(risen) < 10 or np.std(risen) <= 1e-9 * (1.0 + np.std(q)) or np.std(swept) == 0.0:
        return None
    product = float(risen @ swept)
    correlation = product / float(np.sqrt((risen @ risen) * (swept @ swept)))
    # Geometric mean of the two regressions: noise of either does not pull it down.
    return Slope(float(np.sign(product) * np.sqrt((swept @ swept) / (risen @ risen))), correlation)


@dataclass(frozen=True)
class Weight:
    """How effort follows the weight of the arm of the CAD.

    Attributes:
        slope: (n,) effort a N·m of weight; NaN where the weight of a joint hardly varies.
        correlation: (n,) partial, beside an offset and the direction of motion; 0 where it hardly varies.
        left: (n,) share of the effort's variance that is left.
    """

    slope: FloatArray
    correlation: FloatArray
    left: FloatArray


def weight_of(arm: Arm, position: FloatArray, effort: FloatArray) -> Weight:
    """How effort follows the weight of the arm.

    Args:
        arm: With CAD inertials.
        position: (N, n) rad or m.
        effort: (N, n) in any unit.

    Source: least squares of effort on CAD gravity, an offset, and the sign and size of the motion, joint by joint.
    """
    n = len(arm.joints)
    rows = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    step = max(1, int(rows.sum()) // MOST_ROWS)
    # Differences of the finite rows alone: a row beside an empty one, as every row of a log of two topics is, has none.
    moved = np.gradient(position[rows], axis=0) if rows.sum() > 1 else np.zeros((int(rows.sum()), n))
    q, tau, moved = position[rows][::step], effort[rows][::step], moved[::step]
    slope, correlation, left = np.full(n, np.nan), np.zeros(n), np.ones(n)
    if len(q) < 20:
        return Weight(slope, correlation, left)
    still = np.zeros_like(q)
    weight = rigid_body_torque(arm, np.array([joint.inertial for joint in arm.joints]), q, still, still)
    for k in range(n):
        beside = np.column_stack([np.ones(len(q)), np.sign(moved[:, k]), moved[:, k]])
        own, of_tau = (values - beside @ np.linalg.lstsq(beside, values, rcond=None)[0] for values in (weight, tau))
        own, of_tau = own[:, k], of_tau[:, k]
        if np.std(own) > 0.02 * (1e-3 + np.abs(weight).max()) and np.std(of_tau) > 0:
            product = float(own @ of_tau)
            slope[k] = product / float(own @ own)
            correlation[k] = product / float(np.sqrt((own @ own) * (of_tau @ of_tau)))
            left[k] = 1.0 - correlation[k] ** 2
    return Weight(slope, correlation, left)
