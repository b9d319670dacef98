"""How slow short noise is: against its law written out in continuous time, and against noise that was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from spacearm_ident.noise.first_order import DECAYS, FirstOrder
from spacearm_ident.noise.weights import residual_noise
from spacearm_ident.signals.motion import Motion

RATE, CUTOFF = 200.0, 10.0


def motion(torque: np.ndarray) -> Motion:
    """Of noise alone, on one joint that always moves."""
    still = np.zeros_like(torque)
    limits = np.full(1, 1e-6), np.zeros(1)
    return Motion(("elbow",), RATE, 0.0, still, still + 1.0, still, torque, *limits, 1, CUTOFF, 5)


def noise(seconds: float, time_constant: float, seed: int) -> Motion:
    """Of first order; white where the time constant is zero."""
    decay = np.exp(-1.0 / (time_constant * RATE)) if time_constant else 0.0
    white = np.random.default_rng(seed).standard_normal((int(seconds * RATE) + 500, 1))
    return motion(lfilter([np.sqrt(1 - decay**2)], [1.0, -decay], white, axis=0)[500:])


def seen(one: Motion, residual: np.ndarray, fitted: float = 0.0) -> float:
    return FirstOrder.after(one.white_correlation).kappa_of(residual, np.arange(len(residual)), fitted)


def through_the_window(time_constant: float) -> tuple[float, float]:
    """Integrated correlation time of first-order noise behind the low-pass, and that of its square, s."""
    step = 2e-4
    time = np.arange(0.0, 1.0 / CUTOFF, step)
    window = np.sin(np.pi * time * CUTOFF) ** 2
    window /= window.sum()
    shift = np.arange(0.0, 10.0 * time_constant + 1.0 / CUTOFF, step)
    law = np.exp(-np.abs(np.arange(-len(window) + 1, len(shift) + len(window) - 1) * step) / time_constant)
    covariance = np.convolve(law, np.convolve(window, window[::-1]), mode="valid")
    covariance = covariance[: len(shift)]
    rho = covariance / covariance[0]
    return (2.0 * rho.sum() - 1.0) * step, (2.0 * (rho**2).sum() - 1.0) * step


@pytest.mark.parametrize("time_constant", [0.02, 0.05, 0.15])
def test_the_law_is_that_of_continuous_time(time_constant):
    """Read off 400 s: the correlation time within 5 %, and the share of its square."""
    one = noise(400.0, time_constant, 1)
    kappa = seen(one, one.torque_rows[:, 0])
    time, squared = through_the_window(time_constant)
    assert kappa / one.row_rate_hz == pytest.approx(time, rel=0.1)
    assert FirstOrder.after(one.white_correlation).squared_share(kappa) == pytest.approx(squared / time, rel=0.05)


def test_without_a_low_pass_it_is_the_textbooks():
    law = FirstOrder.after(np.ones(1))
    assert law.lag == 1 and law.correlation == pytest.approx(DECAYS)
    assert law.kappa == pytest.approx((1 + DECAYS) / (1 - DECAYS))
    assert law.squared == pytest.approx((1 + DECAYS**2) / (1 - DECAYS**2))


def test_white_noise_is_white_and_nothing_is_faster():
    one = noise(400.0, 0.0, 2)
    law = FirstOrder.after(one.white_correlation)
    assert law.kappa[0] == pytest.approx(1.0 + 2.0 * one.white_correlation[1:].sum())
    assert law.squared[0] == pytest.approx(1.0 + 2.0 * (one.white_correlation[1:] ** 2).sum())
    assert seen(one, one.torque_rows[:, 0]) == pytest.approx(law.kappa[0], rel=0.05)
    assert seen(one, np.resize([1.0, 1.0, -1.0, -1.0], 400)) == law.kappa[0]
    assert (np.diff(law.correlation) > 0).all() and (np.diff(law.kappa) > 0).all() and len(law.kappa) == len(DECAYS)


@pytest.mark.parametrize(("time_constant", "slower"), [(0.0, 1.0), (0.05, 1.8)])
def test_five_seconds_tell_it_though_the_fit_took_what_is_slow(time_constant, slower):
    """Slow cosines fitted away: Sokal's sum sees white noise either way, short lags with what was lost do not."""
    rows = noise(5.0, time_constant, 0).torque_rows[:, 0]
    phase = np.pi * (np.arange(len(rows)) + 0.5) / len(rows)
    basis = np.linalg.qr(np.cos(phase[:, None] * np.arange(8)))[0]
    found, summed = [], []
    for seed in range(60):
        one = noise(5.0, time_constant, seed)
        white = 1.0 + 2.0 * one.white_correlation[1:].sum()
        rows = one.torque_rows[:, 0]
        residual = rows - basis @ (basis.T @ rows)
        kappa = seen(one, residual, 8.0 / len(rows))
        found.append(kappa / white)
        summed.append(residual_noise(residual, np.arange(len(rows)), one.white_correlation).correlation_rows / white)
    assert np.median(summed) < 1.1
    assert np.median(found) == pytest.approx(slower, rel=0.15)


def test_gaps_and_silence_are_no_error():
    one = noise(5.0, 0.0, 3)
    law = FirstOrder.after(one.white_correlation)
    assert law.kappa_of(np.zeros(9), np.arange(9), 0.2) == law.kappa[0]
    assert law.kappa_of(np.ones(2), np.array([3, 90]), 0.2) == law.kappa[0]
    # Standstill leaves gaps: what lies across one is no pair.
    place = np.concatenate([np.arange(40), np.arange(70, 110)])
    rows = one.torque_rows[:, 0]
    assert law.kappa_of(rows[place], place, 0.0) < 2.0 * law.kappa[0]
