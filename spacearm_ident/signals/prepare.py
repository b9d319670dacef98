"""From a `Recording` to the `Motion`s of a regression: even sampling, derivatives, periods, standstill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from ..arrays import BoolArray, FloatArray
from ..errors import UnfitDataError, UserError
from ..recording.recording import Recording
from .bandwidth import BOUNDS_HZ, WINDOW_S, Bandwidth, choose_bandwidth
from .base_motion import BaseSamples, covered, on_grid
from .motion import STUCK_RAD, Motion
from .periods import Period, find_period, fold, project

SHORTEST_CUTOFF_PERIODS = 6.0
"""A stretch shorter than so many cut-off periods is all edge."""
EDGE_CUTOFF_PERIODS = 1.5
"""Nearer to an edge than so many cut-off periods the filter has guessed: accelerations are 1 % and more off there."""
PADDING_CUTOFF_PERIODS = 2.0
"""What the filter continues a stretch by; scipy's default is a few samples, far less than its memory at 1 kHz."""
EVEN_SHARE = 0.02
"""Stamps this close to an even grid, as a share of the sample time, need no interpolation."""
SPIKE_WINDOW, SPIKE_FACTOR = 5, 8.0
"""A torque so many standard deviations off the median of so many samples is a false reading; a step is not."""
PERIODIC_CUTOFF_HZ = 40.0
# Sixth-order central difference: at 5 Hz sampled at 100 Hz it is right to 1e-5, where the usual one errs by 2 %.
STENCIL = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60.0


@dataclass(frozen=True)
class _Stretch:
    """An uninterrupted run of samples on an even grid."""

    rate_hz: float
    start_s: float
    position: FloatArray
    torque: FloatArray
    temperature: FloatArray | None
    base: BaseSamples | None = None

    def __getitem__(self, part: slice) -> _Stretch:
        """The samples of `part`."""
        return _Stretch(
            self.rate_hz,
            self.start_s + part.start / self.rate_hz,
            self.position[part],
            self.torque[part],
            None if self.temperature is None else self.temperature[part],
            None if self.base is None else self.base[part],
        )


def require_joints(recording: Recording, joints: Sequence[str]) -> None:
    """Refuse a recording that lacks a joint.

    Args:
        recording: The recording.
        joints: Names that it has to have.

    Raises:
        UserError: The message names the joint, and those that are there.
    """
    missing = [joint for joint in joints if joint not in recording.joints]
    if missing:
        where = recording.sources[0].path if recording.sources else "the recording"
        raise UserError(
            f"{where} has no joint {missing[0]!r} of the arm (it has {', '.join(recording.joints)}): "
            "give the arm it was recorded from with --arm"
        )


def require_torque(motions: Sequence[Motion]) -> None:
    """Refuse motions in which a joint moves and none of its torque was recorded.

    No arm is like that: to fit it would give all others wrong masses. A joint that stands still may be without.

    Args:
        motions: All of a fit, with the same joints.

    Raises:
        UnfitDataError: The message names the joint.
    """
    for k, joint in enumerate(motions[0].joints):
        moving = [motion.torque_rows[motion.moving[:, k], k] for motion in motions]
        if any(len(rows) for rows in moving) and not any(rows.any() for rows in moving):
            raise UnfitDataError(
                f"{joint} moves, and its torque is zero throughout: record its effort (current x torque constant x "
                "gear ratio), or a run in which it stands still"
            )


def prepare(
    recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float | None = None, average: bool = True
) -> tuple[list[Motion], Bandwidth]:
    """Make recordings ready for regression, all at one bandwidth.

    Args:
        recordings: One or more runs of the same arm.
        joints: The arm's joints, in its order.
        cutoff_hz: Low-pass cut-off; chosen from the data where None, wider for the averaged periods than for the rest.
        average: Whether periods are averaged where there are any.

    Returns:
        The motions (periodic stretches averaged, the rest filtered) and the bandwidth with its reason.

    Raises:
        UnfitDataError: No stretch is long enough, or no joint moves.
        UserError: A recording lacks a joint, or is too slow for the cut-off asked for.
    """
    for recording in recordings:
        require_joints(recording, joints)
    stretches = [
        (number, stretch)
        for number, recording in enumerate(recordings)
        for stretch in _even_stretches(recording.in_order(tuple(joints)))
    ]
    if not stretches:
        raise UnfitDataError("no uninterrupted stretch of joint states is longer than a second: record a longer run")
    bandwidth = _bandwidth([stretch for _, stretch in stretches], cutoff_hz)
    asked = cutoff_hz is not None
    motions = [
        motion
        for number, stretch in stretches
        for motion in (
            _motions(stretch, joints, bandwidth, asked, number)
            if average
            else _filtered(stretch, joints, bandwidth, number)
        )
    ]
    if not motions:
        raise UnfitDataError(
            f"every stretch is shorter than {SHORTEST_CUTOFF_PERIODS / bandwidth.cutoff_hz:.2g} s: record a longer run"
        )
    if not any(motion.moving.any() for motion in motions):
        raise UnfitDataError(_why_nothing_moves(recordings, joints))
    return motions, bandwidth


def _why_nothing_moves(recordings: Sequence[Recording], joints: Sequence[str]) -> str:
    """Why no row counts as motion: none of the joints moves, or the speed of those that do is lost in noise."""
    ranges = np.max([np.ptp(one.in_order(tuple(joints)).position, axis=0) for one in recordings], axis=0)
    moving = [f"{name} by {size:.2g}" for name, size in zip(joints, ranges) if size > STUCK_RAD]
    if not moving:
        return "no joint moves in this recording: record an excitation run"
    text = f"joints move ({', '.join(moving)} rad), but their speeds nowhere stand out of the noise of their positions"
    if any(issue.kind == "log_time_used" for one in recordings for issue in one.issues):
        return (
            f"{text}: times of arrival stand in for header stamps, and are too uneven to differentiate; publish joint "
            "states with header stamps taken at the sampling instant, and record again"
        )
    return f"{text}: stamp joint states at the sampling instant, or record a faster run or finer positions"


def reversal_cutoff_hz(
    recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float, widest_hz: float
) -> float:
    """Low-pass of positions with which a velocity's reversal is resolved best.

    A narrow one blurs a reversal over the speed a / w, a wide one hides it in the encoder's noise, whose standard
    deviation in a velocity grows as w^(3/2). The best is where both are alike: the median over the joints that move.

    Args:
        recordings: One or more runs of the same arm.
        joints: The arm's joints, in its order.
        cutoff_hz: Least cut-off; accelerations and what moves are judged in it.
        widest_hz: Largest.

    Raises:
        UnfitDataError: As `prepare`.
        UserError: As `prepare`.
    """
    motions, bandwidth = prepare(recordings, joints, cutoff_hz, average=False)
    alike = []
    for motion in motions:
        moves = motion.moving.any(axis=0)
        blur, noise = motion.resolved_speed * cutoff_hz, _speed_noise(bandwidth.position_noise, motion.rate_hz, 1.0)
        alike.append((blur[moves] / noise[moves]) ** 0.4)
    return float(np.clip(np.median(np.concatenate(alike)), cutoff_hz, widest_hz))


def _bandwidth(stretches: Sequence[_Stretch], cutoff_hz: float | None) -> Bandwidth:
    """One bandwidth for all: the widest a stretch long enough to tell needs, or the one asked for."""
    lengths = [len(stretch.position) / stretch.rate_hz for stretch in stretches]
    enough = min(WINDOW_S, max(lengths))
    telling = [stretch for stretch, length in zip(stretches, lengths) if length >= enough]
    chosen = [choose_bandwidth(stretch.position, stretch.rate_hz) for stretch in telling]
    widest = max(chosen, key=lambda candidate: candidate.cutoff_hz)
    slowest = min(stretch.rate_hz for stretch in stretches)
    if cutoff_hz is None:
        slowest = min([slowest, *(stretch.base.rate_hz for stretch in stretches if stretch.base is not None)])
        return replace(widest, cutoff_hz=min(widest.cutoff_hz, 0.2 * slowest))
    if not 0.0 < cutoff_hz < 0.4 * slowest:
        raise UserError(
            f"a bandwidth of {cutoff_hz:g} Hz does not fit a recording at {slowest:.0f} Hz: "
            f"choose one below {0.4 * slowest:.0f} Hz"
        )
    return replace(widest, cutoff_hz=cutoff_hz, reason="as asked")


def _even_stretches(recording: Recording) -> list[_Stretch]:
    """Each segment of a recording, interpolated onto an even grid where its stamps are uneven."""
    rate = recording.rate_hz
    stretches = []
    whole = [part for segment in recording.segments for part in covered(recording.base, recording.time, segment)]
    for segment in whole:
        time = recording.time[segment]
        if len(time) < max(32, rate):
            continue
        grid = time[0] + np.arange(int((time[-1] - time[0]) * rate + 1e-6) + 1) / rate
        position, torque = recording.position[segment], _without_spikes(recording.effort[segment])
        if len(grid) <= len(time) and np.abs(grid - time[: len(grid)]).max() < EVEN_SHARE / rate:
            position, torque = position[: len(grid)], torque[: len(grid)]
        else:
            grid = grid[grid <= time[-1]]
            position = make_interp_spline(time, position, k=3)(grid)
            torque = make_interp_spline(time, torque, k=1)(grid)
        base = None if recording.base is None else on_grid(recording.base, grid, rate)
        stretches.append(_Stretch(rate, float(time[0]), position, torque, _temperature(recording, grid), base))
    return stretches


def _without_spikes(torque: FloatArray) -> FloatArray:
    """(N, n) torque; single readings far off their neighbours are replaced, before a low-pass smears them out."""
    smooth = median_filter(torque, size=(SPIKE_WINDOW, 1))
    apart = np.abs(torque - smooth)
    usual = np.percentile(apart, 95, axis=0) / 1.96
    return np.where((apart > SPIKE_FACTOR * usual) & (usual > 0), smooth, torque)


def _temperature(recording: Recording, grid: FloatArray) -> FloatArray | None:
    """(N, n) °C on the grid, NaN for a joint that reports none; None where none does."""
    columns = np.full((len(grid), len(recording.joints)), np.nan)
    for k, joint in enumerate(recording.joints):
        series = recording.temperatures.get(joint)
        if series is not None and len(series.time):
            columns[:, k] = np.interp(grid, series.time, series.values)
    return None if np.isnan(columns).all() else columns


def _motions(stretch: _Stretch, joints: Sequence[str], bandwidth: Bandwidth, asked: bool, source: int) -> list[Motion]:
    """The averaged periods of a stretch, if it has any, and what lies before and after them."""
    # Where the base moves, the joints' periods need not be those of all that acts on the torque.
    period = find_period(stretch.position, stretch.rate_hz) if stretch.base is None else None
    if period is None:
        return _filtered(stretch, joints, bandwidth, source)
    return [
        *_filtered(stretch[0 : period.start], joints, bandwidth, source),
        _averaged(stretch, period, joints, bandwidth, asked, source),
        *_filtered(stretch[period.stop : len(stretch.position)], joints, bandwidth, source),
    ]


def _filtered(stretch: _Stretch, joints: Sequence[str], bandwidth: Bandwidth, source: int) -> list[Motion]:
    """The stretch low-passed, without its edges; nothing where it is all edge."""
    rate, cutoff = stretch.rate_hz, bandwidth.cutoff_hz
    # A base answers to accelerations, not to friction: what it does above the motion's bandwidth is its sensor's noise.
    slowest = cutoff if stretch.base is None else min(cutoff, bandwidth.motion_hz)
    if len(stretch.position) / rate < SHORTEST_CUTOFF_PERIODS / slowest:
        return []
    position = _low_passed(stretch.position, rate, cutoff)
    velocity = _differentiate(position, rate)
    acceleration = _differentiate(velocity, rate)
    base = None
    if stretch.base is not None:
        base = stretch.base.motion(
            lambda signal: _low_passed(signal, rate, slowest), lambda signal: _differentiate(signal, rate)
        )
    edge = int(np.ceil(EDGE_CUTOFF_PERIODS * rate / slowest))
    inner = slice(edge, len(position) - edge)
    position, velocity, acceleration, kept = position[inner], velocity[inner], acceleration[inner], stretch[inner]
    noise = _speed_noise(bandwidth.position_noise, rate, cutoff)
    block = max(1, int(rate / (20 * cutoff)))
    return [
        Motion(
            joints=tuple(joints),
            rate_hz=rate,
            start_s=kept.start_s,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            torque=kept.torque,
            speed_noise=noise,
            resolved_speed=_blur(acceleration, cutoff),
            block=block,
            cutoff_hz=cutoff,
            stride=max(1, int(rate / block / (4 * cutoff))),
            temperature=kept.temperature,
            base=None if base is None else base[inner],
            source=source,
        )
    ]


def _averaged(
    stretch: _Stretch, period: Period, joints: Sequence[str], bandwidth: Bandwidth, asked: bool, source: int
) -> Motion:
    """The mean of the periods, with the scatter between them as its noise."""
    torque = fold(stretch.torque, period)
    positions = fold(stretch.position, period)
    rate = stretch.rate_hz * torque.shape[1] / period.samples
    widest = min(PERIODIC_CUTOFF_HZ, 0.2 * rate)
    position, velocity, acceleration, highest = project(positions, rate, widest)
    # Torque follows a reversal faster than the harmonics of the motion do: unless a cut-off was asked for, columns
    # and torque are compared as far as the projection holds all of the motion.
    cutoff = bandwidth.cutoff_hz if asked else min(max(bandwidth.cutoff_hz, 0.5 * highest), BOUNDS_HZ[1])
    noise = _speed_noise(positions.std(axis=0, ddof=1).mean(axis=0) / np.sqrt(period.count), rate, highest)
    block = max(1, int(rate / (20 * cutoff)))
    motion = Motion(
        joints=tuple(joints),
        rate_hz=rate,
        start_s=float(stretch.start_s + period.start / stretch.rate_hz),
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque.mean(axis=0),
        speed_noise=noise,
        resolved_speed=_blur(acceleration, cutoff),
        block=block,
        cutoff_hz=cutoff,
        stride=max(1, int(rate / block / (4 * cutoff))),
        periods=period.count,
        temperature=_averaged_temperature(stretch.temperature, period),
        source=source,
    )
    rows = np.stack([motion.reduce(one) for one in torque])
    return replace(motion, noise_Nm=np.sqrt(rows.var(axis=0, ddof=1).mean(axis=0) / period.count))


def _averaged_temperature(temperature: FloatArray | None, period: Period) -> FloatArray | None:
    """(M, n) °C, mean of the periods of (N, n); a joint without one keeps its NaN, which no spline takes."""
    if temperature is None:
        return None
    known: BoolArray = np.asarray(np.isfinite(temperature).all(axis=0))
    folded = fold(temperature[:, known], period).mean(axis=0)
    averaged = np.full((len(folded), len(known)), np.nan)
    averaged[:, known] = folded
    return averaged


def _low_passed(signal: FloatArray, rate_hz: float, cutoff_hz: float) -> FloatArray:
    """Zero-phase Butterworth along the first axis."""
    padding = int(PADDING_CUTOFF_PERIODS * rate_hz / cutoff_hz)
    return np.asarray(sosfiltfilt(butter(4, cutoff_hz, fs=rate_hz, output="sos"), signal, axis=0, padlen=padding))


def _speed_noise(position_noise: FloatArray, rate_hz: float, cutoff_hz: float) -> FloatArray:
    """(n,) six standard deviations of the velocity that white position noise leaves below the cut-off."""
    return np.asarray(6 * 2 * np.pi * position_noise * np.sqrt(2 / rate_hz * cutoff_hz**3 / 3) + 1e-9)


def _blur(acceleration: FloatArray, cutoff_hz: float) -> FloatArray:
    """(n,) speeds over which a low-pass of bandwidth w blurs a reversal under acceleration a: a/w."""
    return np.asarray(np.percentile(np.abs(acceleration), 95, axis=0) / (2 * np.pi * cutoff_hz))


def _differentiate(signal: FloatArray, rate_hz: float) -> FloatArray:
    """Central difference along the first axis; the three samples at either edge repeat their neighbour."""
    inner = sum(c * signal[k : len(signal) - 6 + k] for k, c in enumerate(STENCIL)) * rate_hz
    return np.concatenate([inner[:1].repeat(3, axis=0), inner, inner[-1:].repeat(3, axis=0)])
