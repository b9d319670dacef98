"""The bandwidth of a recording, read off its own spectra.

Two frequencies bound what is worth keeping. Above the *crossing*, where the position's spectrum falls into its
noise, a low-pass loses nothing but noise: there the expected error of the acceleration (signal cut off
plus noise let through, both weighted by w^4) is least. And five times the *dynamic* frequency, below which
nearly all of the velocity's power lies, keeps the motion's harmonics undistorted (Gautier 1997, "Dynamic
identification of robots with power model": cut-off >= 5 w_dyn). The smaller of the two, the same for every
joint and for torque and regressor alike, is the bandwidth.

The noise need not be white. A controller that filters its encoders leaves noise whose spectrum falls, too, but not as
fast as that of a motion: motors drive accelerations, whose spectrum falls with the frequency. So noise begins where
the acceleration's spectrum begins to rise for good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from ..arrays import FloatArray

DYNAMIC_SHARE = 0.99
DYNAMIC_FACTOR = 5.0
BOUNDS_HZ = (5.0, 20.0)
"""Smallest and largest cut-off, Hz: what arms of this kind move at, and what a rigid model of them predicts."""
WINDOW_S = 8.0
"""Length of the spectra's window; what is shorter shows no lines, only their smear."""
FLOOR_FACTOR = 4.0
"""A line this far above the noise (6 dB) is taken for signal."""
BANDS_AN_OCTAVE, HIGHEST_HZ = 3, 40.0
"""Bands over which the acceleration's spectrum is averaged, and the last of them: what is above twice the largest
cut-off, where a controller's filters may let noise fall as a motion does, says nothing of what is below."""


@dataclass(frozen=True)
class Bandwidth:
    """The chosen cut-off and what it was chosen from.

    Attributes:
        cutoff_hz: Low-pass cut-off.
        crossing_hz: Frequency above which no joint's position stands out of its noise.
        dynamic_hz: Frequency below which 99 % of the velocity's power lies, largest of the joints.
        position_noise: (n,) standard deviation of the white noise on the position, rad.
        reason: One clause that says which of the two decided.
    """

    cutoff_hz: float
    crossing_hz: float
    dynamic_hz: float
    position_noise: FloatArray
    reason: str

    @property
    def motion_hz(self) -> float:
        """What the motion by itself needs, wherever the cut-off for torque was put."""
        return float(np.clip(min(self.crossing_hz, DYNAMIC_FACTOR * self.dynamic_hz), *BOUNDS_HZ))


def choose_bandwidth(position: FloatArray, rate_hz: float) -> Bandwidth:
    """Choose the low-pass cut-off for one evenly sampled stretch of joint positions.

    Args:
        position: (N, n) rad, evenly sampled.
        rate_hz: Sample rate, Hz.
    """
    window = min(len(position), max(64, int(WINDOW_S * rate_hz)))
    frequency, density = welch(position, rate_hz, nperseg=window, detrend="linear", axis=0)
    floor = np.median(density[frequency > 0.3 * rate_hz], axis=0)
    noise = np.sqrt(floor * rate_hz / 2)
    signal = (density > FLOOR_FACTOR * floor) & (frequency[:, None] < _noise_onset(frequency, density))
    velocity_power = np.cumsum(density * (frequency**2)[:, None] * signal, axis=0)
    moving = velocity_power[-1] > 0
    if not moving.any():
        return Bandwidth(BOUNDS_HZ[0], 0.0, 0.0, noise, "nothing moves")
    share = velocity_power[:, moving] / velocity_power[-1, moving]
    lines = [int(np.argmax(column >= DYNAMIC_SHARE)) for column in share.T]
    dynamic = float(frequency[max(lines)])
    below = ~signal[:, moving]
    for column, line in zip(below.T, lines):
        column[: line + 1] = False  # A spectrum may be empty below its lines: the noise begins above them.
    first = [np.argmax(column) if column.any() else len(frequency) - 1 for column in below.T]
    crossing = float(frequency[max(first)])
    wanted = min(crossing, DYNAMIC_FACTOR * dynamic)
    upper = min(BOUNDS_HZ[1], 0.2 * rate_hz)
    cutoff = float(np.clip(wanted, min(BOUNDS_HZ[0], upper), upper))
    reason = (
        f"five times the {dynamic:.2g} Hz below which 99 % of the motion's power lies"
        if DYNAMIC_FACTOR * dynamic <= crossing
        else f"above {crossing:.2g} Hz the positions are noise"
    )
    if cutoff > wanted:
        reason += f", raised to {cutoff:.2g} Hz, the smallest bandwidth used"
    elif cutoff < wanted:
        reason += f", lowered to {cutoff:.2g} Hz, the largest bandwidth used at this rate"
    return Bandwidth(cutoff, crossing, dynamic, noise, reason)


def _noise_onset(frequency: FloatArray, density: FloatArray) -> FloatArray:
    """(n,) frequency from which each acceleration's spectrum does nothing but rise, Hz; infinite where it falls.

    From the highest band down: the least one before the spectrum is `FLOOR_FACTOR` times that again.

    Args:
        frequency: (F,) Hz, of a spectrum.
        density: (F, n) of the positions.
    """
    highest = min(HIGHEST_HZ, 0.8 * frequency[-1])
    inside = (frequency > 0) & (frequency <= highest)
    acceleration = density[inside] * (frequency[inside] ** 4)[:, None]
    number = np.floor(BANDS_AN_OCTAVE * np.log2(highest / frequency[inside])).astype(int)
    # Numbers of the bands that hold a line, the highest band first.
    bands = np.unique(number)
    power = np.stack([acceleration[number == band].mean(axis=0) for band in bands])
    onset = np.full(density.shape[1], np.inf)
    for k, column in enumerate(power.T):
        least = np.minimum.accumulate(column)
        risen = np.flatnonzero(column > FLOOR_FACTOR * least)
        down_to = int(np.argmin(column[: risen[0] if len(risen) else None]))
        if column[0] > FLOOR_FACTOR * column[down_to]:
            onset[k] = highest * 2.0 ** (-(bands[down_to] + 0.5) / BANDS_AN_OCTAVE)
    return onset
