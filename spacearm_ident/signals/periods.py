"""Find the periods of a motion in its positions, and average over them.

Over whole periods a Fourier projection differentiates exactly: the acceleration's noise is that of the few
harmonics kept, and nothing is lost at the edges (Swevers et al. 1997, "Optimal robot excitation and
identification"). The scatter between the periods is the torque's pure error, which no model can explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter

from ..arrays import FloatArray

SEARCH_RATE_HZ = 25.0
SHORTEST_S = 0.5
TOLERANCE = 0.01
"""Positions a period apart agree to this share of each joint's own spread."""
TRIM_FACTOR, TRIM_FLOOR, TRIM_WINDOW = 5.0, 1e-5, 11
"""A sample belongs to the period if it repeats within so many times the median difference, or this share."""
REFITS = 4
SHORTFALL = 0.01
"""A last period that lacks no more than this share is counted: where the approach ends is not seen to the sample."""
PROBES = 8
"""Samples a period looked at before all of them are."""
CERTAIN_FACTOR, NOISE_FACTOR = 100.0, 4.0
"""A harmonic with so many times the noise's power is the motion's; it may be with the smaller of the two."""
ROUNDING = 1e-12
"""Least standard deviation of a position, as a share of its largest value. Arithmetic in double precision leaves 1e-15;
the finest encoders resolve 1e-9. Without it, rounding errors decide where the spectrum of computed positions ends."""
QUIET_HARMONICS = 5
"""So many harmonics in a row inside the noise end the motion's spectrum."""


@dataclass(frozen=True)
class Period:
    """Where a stretch of evenly sampled positions repeats itself.

    Attributes:
        start: First sample of the first whole period.
        samples: Length of a period in samples, not necessarily whole.
        count: Whole periods in a row, at least 2.
    """

    start: int
    samples: float
    count: int

    @property
    def stop(self) -> int:
        """One past the last sample used."""
        return self.start + int(np.floor(self.samples * self.count))


def find_period(position: FloatArray, rate_hz: float) -> Period | None:
    """The longest stretch that repeats, or None where nothing does.

    Args:
        position: (N, n) rad, evenly sampled.
        rate_hz: Sample rate, Hz.
    """
    step = max(1, round(rate_hz / SEARCH_RATE_HZ))
    coarse = position[::step]
    spread = coarse.std(axis=0)
    moving = spread > 1e-3
    if not moving.any():
        return None
    scaled = coarse[:, moving] / spread[moving]
    # A lag in whole samples may be half a sample off.
    steps = np.pad(np.abs(np.diff(scaled, axis=0)), ((1, 1), (0, 0)), mode="edge")
    slip = 0.6 * np.maximum(steps[1:], steps[:-1])
    best: tuple[float, int, int, int] | None = None
    for lag in range(max(1, round(SHORTEST_S * rate_hz / step)), len(scaled) // 2 + 1):
        probe = max(1, lag // PROBES)
        if _longest_run(_alike(scaled, lag, slip, probe))[1] < lag // probe:
            continue
        start, length = _longest_run(_alike(scaled, lag, slip))
        if length < lag or scaled[start : start + lag].std(axis=0).max() < 0.1:
            continue
        # A multiple of the period covers no more than the period itself: the shortest lag wins unless a longer
        # one explains clearly more of the recording.
        if best is None or length + lag > 1.2 * best[0]:
            best = (length + lag, lag, start, length)
    if best is None:
        return None
    _, lag, start, length = best
    first, last = start * step, min((start + length + lag) * step, len(position))
    return _exactly(position[:, moving] / spread[moving], lag * step, first, last, step)


def _alike(scaled: FloatArray, lag: int, slip: FloatArray, every: int = 1) -> np.ndarray:
    """Mask of the samples whose positions recur `lag` samples later, within the motion of half a sample (`slip`)."""
    apart = np.abs(scaled[lag::every] - scaled[:-lag:every]) - slip[:-lag:every]
    return np.asarray(apart.max(axis=1) < TOLERANCE)


def _exactly(scaled: FloatArray, lag: int, first: int, last: int, step: int) -> Period | None:
    """The period and its whole repetitions, from a lag and an extent that are right to `step` samples."""
    lag = _whole_samples(scaled[first:last], lag, step)
    first, last = max(0, first - step), min(last + step, len(scaled))
    apart, fraction = _mismatch(scaled[first:last], lag)
    if np.median(apart) > TOLERANCE:
        return None
    start, stop = _trim(apart, step)
    samples = lag + fraction
    count = int((stop - start + lag) / samples + SHORTFALL)
    first += start
    missing = samples * count - (stop - start + lag)
    if missing > 0:
        first = max(0, min(first - int(missing / 2), int(len(scaled) - samples * count)))
    if first + samples * count > len(scaled) + 1e-6:
        count -= 1
    return Period(first, samples, count) if count >= 2 else None


def _longest_run(hit: np.ndarray) -> tuple[int, int]:
    """Start and length of the longest run of True."""
    edge = np.flatnonzero(np.diff(np.concatenate(([False], hit, [False])).astype(np.int8)))
    if not len(edge):
        return 0, 0
    length = edge[1::2] - edge[::2]
    longest = int(np.argmax(length))
    return int(edge[2 * longest]), int(length[longest])


def _trim(apart: FloatArray, step: int) -> tuple[int, int]:
    """Where `apart` (N,) is small, without what only resembles the period: the approach's end, the return's begin."""
    limit = max(TRIM_FACTOR * float(np.median(apart)), TRIM_FLOOR)
    # Joints stick and slip at slightly different moments in each period: brief spikes are no end of the period.
    smooth = median_filter(apart[::step], size=TRIM_WINDOW, mode="constant", cval=np.inf)
    alike, length = _longest_run(smooth < limit)
    start, stop = alike * step, min((alike + length - 1) * step + 1, len(apart))
    # The run begins and ends somewhere between two of the samples looked at.
    start -= _run_at_end(apart[max(0, start - step) : start] < limit)
    stop += _run_at_end(apart[stop : stop + step][::-1] < limit)
    return start, stop


def _run_at_end(hit: np.ndarray) -> int:
    """How many samples at the end are True."""
    miss = np.flatnonzero(~hit)
    return len(hit) - 1 - int(miss[-1]) if len(miss) else len(hit)


def _whole_samples(scaled: FloatArray, lag: int, reach: int) -> int:
    """The period to a sample, by the median difference: approach and return at the ends have no say in it."""

    def cost(lag: int) -> float:
        return float(np.median(np.abs(scaled[lag:] - scaled[:-lag]).max(axis=1)))

    spacing = reach
    while spacing >= 1:
        around = [k for k in range(lag - 2 * spacing, lag + 2 * spacing + 1, spacing) if 0 < k < len(scaled)]
        lag = min(around, key=cost)
        spacing //= 2
    return lag


def _mismatch(scaled: FloatArray, lag: int) -> tuple[FloatArray, float]:
    """How far apart (N - lag,) positions a period apart are, and the fraction of a sample the period is longer.

    x(t + lag) - x(t) = -fraction x'(t): fitted where it holds, for approach and return obey no period.
    """
    difference = scaled[lag:] - scaled[:-lag]
    speed = np.gradient(scaled, axis=0)[lag:]
    apart, fraction = np.abs(difference).max(axis=1), 0.0
    for _ in range(REFITS):
        good = apart <= TRIM_FACTOR * np.median(apart)
        fraction = -float(np.sum(difference[good] * speed[good]) / max(np.sum(speed[good] ** 2), 1e-300))
        apart = np.abs(difference + fraction * speed).max(axis=1)
    # A whole number of samples is what a clocked trajectory gives; a fraction the noise could make is not believed.
    return apart, fraction if abs(fraction) > 0.02 else 0.0


def fold(signal: FloatArray, period: Period) -> FloatArray:
    """The whole periods of a signal (N, n) as (count, samples a period, n), on a common phase.

    Args:
        signal: Samples of all joints, in any unit.
        period: Where the periods are, and how long; values between samples are a cubic spline's.
    """
    length = round(period.samples)
    if abs(period.samples - length) * period.count < 0.05:
        stop = period.start + period.count * length
        if stop <= len(signal):
            return signal[period.start : stop].reshape(period.count, length, *signal.shape[1:])
    phase = period.start + period.samples * (np.arange(period.count * length) / length)
    spline = make_interp_spline(np.arange(len(signal)), signal, k=3)
    return np.asarray(spline(np.minimum(phase, len(signal) - 1)).reshape(period.count, length, *signal.shape[1:]))


def project(folded: FloatArray, rate_hz: float, cutoff_hz: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Position, velocity and acceleration of the mean period by Fourier projection.

    Args:
        folded: (count, N, n) positions, rad.
        rate_hz: Samples of a period over its duration.
        cutoff_hz: No harmonic above it is kept, whatever the spectrum says.

    Returns:
        Three (N, n) arrays, rad, rad/s and rad/s^2, and the highest frequency kept, Hz.
    """
    count, length, _ = folded.shape
    mean = folded.mean(axis=0)
    spectrum = np.fft.rfft(mean, axis=0)
    scatter = np.maximum(folded.var(axis=0, ddof=1).mean(axis=0), (ROUNDING * np.abs(mean).max(axis=0)) ** 2)
    noise_power = scatter / count * length
    frequency = np.fft.rfftfreq(length, 1.0 / rate_hz)
    power = np.abs(spectrum) ** 2
    # A spectrum may have gaps between its lines: what no noise could make is in, whatever lies empty below it.
    certain = np.flatnonzero((power > CERTAIN_FACTOR * noise_power).any(axis=1))
    loud = (power > NOISE_FACTOR * noise_power).any(axis=1)
    highest = _last_before_quiet(loud, int(certain[-1]) if len(certain) else 0)
    keep = (np.arange(len(frequency)) <= highest) & (frequency <= cutoff_hz)
    spectrum = spectrum * keep[:, None]
    derivative = (2j * np.pi * frequency)[:, None]
    signals = (spectrum, derivative * spectrum, derivative**2 * spectrum)
    position, velocity, acceleration = (np.fft.irfft(s, n=length, axis=0) for s in signals)
    return position, velocity, acceleration, float(frequency[keep].max())


def _last_before_quiet(loud: np.ndarray, first: int) -> int:
    """Highest harmonic from `first` on that is loud before `QUIET_HARMONICS` quiet ones in a row."""
    quiet = 0
    for index in range(first + 1, len(loud)):
        quiet = 0 if loud[index] else quiet + 1
        if quiet == QUIET_HARMONICS:
            return index - QUIET_HARMONICS
    return len(loud) - 1
