"""Power spectral density of validation torque and residual at full rate: at which frequencies the model falls short."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from ..arrays import FloatArray
from ..estimate.identified import Spectrum
from ..signals.motion import Motion

WINDOW_S = 4.0
"""Length of Welch's windows, s: resolves 0.25 Hz, a twentieth of the lowest bandwidth of a fit."""
FEWEST_SAMPLES = 64
"""Samples under which a stretch has no spectrum worth showing."""
BANDS = 90
"""Logarithmic frequency bands that densities are averaged in; count, for a figure 700 units wide."""


def residual_spectrum(motions: Sequence[Motion], predicted: Sequence[FloatArray]) -> Spectrum | None:
    """Densities of measured torque and residual, averaged over motions by their length.

    Args:
        motions: Full-rate signals; of several rates the bands go up to half the lowest.
        predicted: Torque (N, n) a motion, N·m.

    Returns:
        The spectrum; None where every stretch is too short.
    """
    used = [(motion, torque) for motion, torque in zip(motions, predicted) if len(motion.torque) >= FEWEST_SAMPLES]
    if not used:
        return None
    slowest = min(motion.rate_hz for motion, _ in used)
    edges = np.geomspace(1.0 / WINDOW_S, 0.5 * slowest, BANDS + 1)
    sums = np.zeros((2, BANDS, used[0][0].torque.shape[1]))
    weights = np.zeros(BANDS)
    for motion, torque in used:
        window = min(len(torque), int(WINDOW_S * motion.rate_hz))
        for kind, signal in enumerate((motion.torque, motion.torque - torque)):
            frequency, density = welch(signal, motion.rate_hz, nperseg=window, detrend="constant", axis=0)
            place = np.digitize(frequency, edges) - 1
            inside = (place >= 0) & (place < BANDS) & (frequency > 0.0)
            np.add.at(sums[kind], place[inside], len(torque) * density[inside])
            if not kind:
                np.add.at(weights, place[inside], float(len(torque)))
    filled = weights > 0.0
    centre = np.sqrt(edges[:-1] * edges[1:])[filled]
    means = sums[:, filled] / weights[filled][:, None]
    return Spectrum(centre, means[0], means[1]) if len(centre) else None


def share_above(spectrum: Spectrum, cutoff_hz: float) -> FloatArray:
    """(n,) share of the unfiltered residual's power that lies above a frequency; NaN where there is no residual.

    Args:
        spectrum: Densities of the residual at full rate; a density counts with the width of its band.
        cutoff_hz: Frequency above which power is counted, such as the bandwidth of the fit.
    """
    power = np.gradient(spectrum.frequency)[:, None] * spectrum.residual
    total = power.sum(axis=0)
    above = power[spectrum.frequency > cutoff_hz].sum(axis=0)
    return np.asarray(np.divide(above, total, out=np.full(len(total), np.nan), where=total > 0.0))
