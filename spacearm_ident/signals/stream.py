"""`MotionStream`: raw samples in, rows of torque and of columns of the motion out, late by a known delay.

Off line the positions go through a zero-phase Butterworth filter, torque and columns through one period of a
Hann window (`signals.prepare`, `signals.motion`). Both are convolutions with symmetric kernels, so a causal
filter can do the same, only later: the longer kernel fades out within 1.5 periods of the cut-off, and a row is known
`delay_s` after the moment it belongs to, two periods of the cut-off (0.2 s at 10 Hz) and a few samples, plus what the
caller waits between two `add`. The row's time is that moment, not the time of its computation: rows are late,
not shifted.

Friction remembers (`dynamics.friction`): its state depends on the distance travelled. The columns of each new
piece therefore start from a history of the last second in which anything moved; standing still adds no travel, so
leaving it out of that history changes nothing. A joint that alone stands for longer than that while others move
is treated as if it had come to rest without friction.

Where the stamps leave a gap the filters start anew; no row lies within `delay_s` of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt
from scipy.signal.windows import hann

from ..arrays import FloatArray
from ..recording.intake import GAP_MEDIANS
from .bandwidth import choose_bandwidth
from .motion import HALF_LENGTH, Motion
from .prepare import STENCIL

REACH = 1.5
"""Half length of the positions' filter, in periods of its cut-off: more brings the residual no nearer."""
HISTORY_S = 1.0
NOISE_WINDOW_S, NOISE_EVERY_S = 4.0, 2.0
CLOCK_SET_BACK_S = 1.0
_MARGIN = 8
"""Samples at either end of a piece that interpolation onto an even grid does not use: a spline forgets by 4 each."""


@dataclass(frozen=True)
class StreamedRows:
    """Rows of an uninterrupted stretch.

    Attributes:
        time: (M,) s on the clock of the samples.
        torque: (M, n) N·m.
        columns: (M, n, k), low-passed as the torque.
        white_correlation: `Motion.white_correlation` of these rows.
    """

    time: FloatArray
    torque: FloatArray
    columns: FloatArray
    white_correlation: FloatArray


class MotionStream:
    """Streaming counterpart of `signals.prepare`.

    Args:
        joints: Names, in the order of the samples.
        rate_hz: Rate of the samples; uneven ones are interpolated onto an even grid of this rate.
        cutoff_hz: Of positions, torque and columns; at most a fifth of the rate is used.
        output_hz: Rate of the rows wanted; `row_rate_hz` is the nearest that divides.
        columns: (N, n, k) of a motion of N samples, at full rate.

    Attributes:
        delay_s: Time between the moment a row belongs to and the sample that completes it.
        row_rate_hz: Rate of the rows.
        restarts: How often a gap or a clock set back made the filters start anew.
    """

    def __init__(
        self,
        joints: tuple[str, ...],
        rate_hz: float,
        cutoff_hz: float,
        output_hz: float,
        columns: Callable[[Motion], FloatArray],
    ) -> None:
        self.joints = joints
        self.rate_hz = rate_hz
        self.cutoff_hz = min(cutoff_hz, 0.2 * rate_hz)
        self._columns_of = columns
        self._block = max(1, int(rate_hz / (20 * self.cutoff_hz)))
        self._stride = max(1, round(rate_hz / self._block / output_hz))
        self.row_rate_hz = rate_hz / (self._block * self._stride)
        self._taps = derivative_taps(self.cutoff_hz, rate_hz)
        self._half = (self._taps.shape[1] - 1) // 2
        self._half_row = int(np.ceil(HALF_LENGTH / self.cutoff_hz * rate_hz))
        self.delay_s = (self._half + self._half_row + self._block + _MARGIN + 1) / rate_hz
        self.restarts = 0
        self._history = np.zeros((0, 4, len(joints)))
        self._noise = np.zeros(len(joints))
        self._noise_age = np.inf
        self._start_anew()

    def _start_anew(self) -> None:
        """Forget the stretch; friction's history and the noise stay."""
        joints = len(self.joints)
        self._raw_time = np.zeros(0)
        self._raw = np.zeros((0, 2, joints))
        self._grid_s: float | None = None
        self._even = np.zeros((0, 2, joints))
        self._even_s = 0.0
        self._full = np.zeros((0, 4, joints))
        self._columns: FloatArray | None = None
        self._full_s = 0.0
        self._noise_positions = np.zeros((0, joints))

    def add(self, time: FloatArray, position: FloatArray, effort: FloatArray) -> list[StreamedRows]:
        """Take samples; returns the rows they complete, a part for each uninterrupted stretch (often none).

        Args:
            time: (K,) s; samples at or before the last one's time are left out, unless the clock was set back.
            position: (K, n) rad, in the order of the arm's joints.
            effort: (K, n) N·m.
        """
        last = self._raw_time[-1] if len(self._raw_time) else -np.inf
        if len(time) and time[-1] < last - CLOCK_SET_BACK_S:
            last = -np.inf
            self.restarts += 1
            self._start_anew()
        latest = np.maximum.accumulate(np.concatenate([[last], time]))[:-1]
        sound = time > latest
        time, signals = time[sound], np.stack([position[sound], effort[sound]], axis=1)
        before = np.concatenate([[last], time[:-1]])
        gaps = np.flatnonzero((time - before > GAP_MEDIANS / self.rate_hz) & np.isfinite(before))
        results = []
        for number, (start, stop) in enumerate(zip([0, *gaps], [*gaps, len(time)])):
            if number > 0:
                self.restarts += 1
                self._start_anew()
            rows = self._add_stretch(time[start:stop], signals[start:stop])
            if rows is not None:
                results.append(rows)
        return results

    def _add_stretch(self, time: FloatArray, signals: FloatArray) -> StreamedRows | None:
        self._raw_time = np.concatenate([self._raw_time, time])
        self._raw = np.concatenate([self._raw, signals])
        self._resample()
        fresh = self._differentiate()
        if len(fresh):
            self._queue(fresh)
        return self._reduce()

    def _resample(self) -> None:
        """Raw samples onto the even grid, as far as the margin of the interpolation allows."""
        if len(self._raw_time) < 2 * _MARGIN + 2:
            return
        if self._grid_s is None:
            self._grid_s = self._even_s = float(self._raw_time[0])
        until = self._raw_time[-_MARGIN]
        count = max(0, int(np.floor((until - self._grid_s) * self.rate_hz)) + 1)
        grid = self._grid_s + np.arange(count) / self.rate_hz
        position = make_interp_spline(self._raw_time, self._raw[:, 0], k=3)(grid)
        effort = make_interp_spline(self._raw_time, self._raw[:, 1], k=1)(grid)
        self._even = np.concatenate([self._even, np.stack([position, effort], axis=1)])
        self._grid_s += count / self.rate_hz
        keep = max(0, int(np.searchsorted(self._raw_time, self._grid_s)) - 2 * _MARGIN)
        self._raw_time, self._raw = self._raw_time[keep:], self._raw[keep:]
        self._watch_noise(position)

    def _watch_noise(self, position: FloatArray) -> None:
        """Follow the noise of the positions, which decides below which speed a direction is not believed."""
        window = int(NOISE_WINDOW_S * self.rate_hz)
        self._noise_positions = np.concatenate([self._noise_positions, position])[-window:]
        self._noise_age += len(position) / self.rate_hz
        if self._noise_age > NOISE_EVERY_S and len(self._noise_positions) >= max(64, self._taps.shape[1]):
            self._noise = choose_bandwidth(self._noise_positions, self.rate_hz).position_noise
            self._noise_age = 0.0

    def _differentiate(self) -> FloatArray:
        """(K, 4, n) filtered position, its two derivatives and the torque at the samples that can be done now."""
        count = len(self._even) - 2 * self._half
        if count <= 0:
            return np.zeros((0, *self._history.shape[1:]))
        windows = np.lib.stride_tricks.sliding_window_view(self._even[:, 0], self._taps.shape[1], axis=0)
        filtered = np.einsum("knl,dl->kdn", windows, self._taps, optimize=True)
        fresh = np.concatenate([filtered, self._even[self._half : self._half + count, 1:]], axis=1)
        if not len(self._full):
            self._full_s = self._even_s + self._half / self.rate_hz
        self._even = self._even[count:]
        self._even_s += count / self.rate_hz
        return fresh

    def _queue(self, fresh: FloatArray) -> None:
        """Compute the columns of new samples behind the history of motion; queue both for the low-pass."""
        speed_noise = 6 * self._noise * np.linalg.norm(self._taps[1]) + 1e-9
        whole = np.concatenate([self._history, fresh])
        columns = self._columns_of(self._motion(whole, speed_noise))[len(self._history) :]
        self._full = np.concatenate([self._full, fresh])
        self._columns = columns if self._columns is None else np.concatenate([self._columns, columns])
        moved = (np.abs(whole[:, 1]) > speed_noise).any(axis=1)
        self._history = whole[moved][-int(HISTORY_S * self.rate_hz) :]

    def _reduce(self) -> StreamedRows | None:
        """Low-pass and thin out torque and columns; what is done with leaves the queue."""
        if self._columns is None or len(self._full) < 2 * self._half_row + 3 * self._block:
            return None
        motion = self._motion(self._full, np.zeros(len(self.joints)))
        torque = motion.reduce(self._full[:, 3])
        columns = motion.reduce(self._columns.reshape(len(self._columns), -1))
        done = len(torque) * self._stride * self._block
        rows = StreamedRows(
            motion.time, torque, columns.reshape(-1, *self._columns.shape[1:]), motion.white_correlation
        )
        self._full, self._columns = self._full[done:], self._columns[done:]
        self._full_s += done / self.rate_hz
        return rows

    def _motion(self, signals: FloatArray, speed_noise: FloatArray) -> Motion:
        position, velocity, acceleration, torque = signals.transpose(1, 0, 2)
        return Motion(
            joints=self.joints,
            rate_hz=self.rate_hz,
            start_s=self._full_s,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            torque=torque,
            speed_noise=speed_noise,
            resolved_speed=np.zeros(len(speed_noise)),
            block=self._block,
            cutoff_hz=self.cutoff_hz,
            stride=self._stride,
        )


def derivative_taps(cutoff_hz: float, rate_hz: float) -> FloatArray:
    """(3, L) symmetric kernels for position, velocity and acceleration: correlate with L samples about a moment.

    The first is the zero-phase Butterworth filter of `signals.prepare`, faded out within `REACH` periods, the others
    its central differences.

    Args:
        cutoff_hz: Of the low-pass.
        rate_hz: Of the samples.
    """
    reach = int(np.ceil(REACH / cutoff_hz * rate_hz))
    impulse = np.zeros(6 * reach + 1)
    impulse[3 * reach] = 1.0
    whole = sosfiltfilt(butter(4, cutoff_hz, fs=rate_hz, output="sos"), impulse, padlen=0)
    # Faded out, not cut off: differentiated twice, an edge would be a large impulse.
    kernel = whole[2 * reach : 4 * reach + 1] * hann(2 * reach + 3)[1:-1]
    kernel = (kernel + kernel[::-1]) / (2 * kernel.sum())
    # A correlation with the stencil of the filtered signal is one with the convolved kernel of the raw one.
    velocity = np.convolve(kernel, STENCIL * rate_hz)
    acceleration = np.convolve(velocity, STENCIL * rate_hz)
    return np.stack([np.pad(kernel, 6), np.pad(velocity, 3), acceleration])
