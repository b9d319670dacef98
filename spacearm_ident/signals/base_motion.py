"""`BaseMotion`: how the arm's base moves, at the samples of a `Motion`, and how it comes out of a `BaseSensor`.

The dynamics of an arm on a moving base are those of one on a fixed base whose base link has an angular velocity, an
angular acceleration, and in place of minus gravity a specific force f = a - g (Featherstone 2008, ch. 5 and 9). An
accelerometer measures just that, so neither attitude nor gravity need be known. A sensor at r from the base link's
origin O feels

    f_r = f_O + e x r + o x (o x r),        a_r = dv_r/dt + o x v_r   (velocity in axes that turn with the base),

with the angular velocity o and e = do/dt, in the base link's axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation, Slerp

from ..arrays import FloatArray
from ..recording.recording import BaseSensor

STILL_BLOCK_S = 0.2
STILL_FACTOR = 5.0
"""A base moves if the means of such blocks scatter by more than so many times what the sensor's noise makes them."""
STILL_RATE = 0.02
"""rad/s: a base that turns steadily at more moves too; less may be a gyroscope's offset."""
ALIASING_SHARE = 0.4
"""A sensor faster than the joints is low-passed at this share of their rate."""


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base link in its own axes.

    Attributes:
        rate: (N, 3) angular velocity, rad/s.
        rate_dot: (N, 3) angular acceleration, rad/s^2.
        acceleration: (N, 3) of the link's origin, m/s^2: less gravity (a specific force) where `attitude` is None.
        attitude: (N, 3, 3) base link's axes to the world's, where gravity is yet to be taken off.
    """

    rate: FloatArray
    rate_dot: FloatArray
    acceleration: FloatArray
    attitude: FloatArray | None = None

    def force(self, gravity: FloatArray) -> FloatArray:
        """(N, 3) specific force at the base link's origin, m/s^2; `gravity` (3,) in world axes, where it is needed."""
        if self.attitude is None:
            return self.acceleration
        return np.asarray(self.acceleration - np.einsum("nji,j->ni", self.attitude, gravity))

    def __getitem__(self, part: slice) -> BaseMotion:
        """The samples of `part`."""
        return self.mapped(lambda signal: signal[part])

    def mapped(self, change: Callable[[FloatArray], FloatArray]) -> BaseMotion:
        """Every array (N, ...) put through the same change."""
        attitude = None if self.attitude is None else change(self.attitude)
        return BaseMotion(change(self.rate), change(self.rate_dot), change(self.acceleration), attitude)


@dataclass(frozen=True)
class BaseSamples:
    """A base sensor's signals on the grid of a stretch, in the base link's axes; attributes as of `BaseSensor`.

    `rate_hz` is what the sensor had.
    """

    rate_hz: float
    rate: FloatArray
    force: FloatArray | None
    velocity: FloatArray | None
    attitude: FloatArray | None
    origin: FloatArray

    def __getitem__(self, part: slice) -> BaseSamples:
        """The samples of `part`."""
        force, velocity, attitude = (
            None if signal is None else signal[part] for signal in (self.force, self.velocity, self.attitude)
        )
        return replace(self, rate=self.rate[part], force=force, velocity=velocity, attitude=attitude)

    def motion(
        self, smooth: Callable[[FloatArray], FloatArray], differentiate: Callable[[FloatArray], FloatArray]
    ) -> BaseMotion:
        """The base link's motion, by the low-pass and the derivative that the joints go through as well.

        Args:
            smooth: From (N, k) samples to as many, through the joints' low-pass.
            differentiate: From (N, k) samples to their low-passed derivative by time.
        """
        rate = smooth(self.rate)
        rate_dot = differentiate(rate)
        if self.force is not None:
            acceleration = smooth(self.force)
        else:
            assert self.velocity is not None
            velocity = smooth(self.velocity)
            acceleration = differentiate(velocity) + np.cross(rate, velocity)
        lever = np.cross(rate_dot, self.origin) + np.cross(rate, np.cross(rate, self.origin))
        return BaseMotion(rate, rate_dot, acceleration - lever, self.attitude)


def on_grid(sensor: BaseSensor, grid: FloatArray, rate_hz: float) -> BaseSamples | None:
    """A sensor's signals at the times of an even grid (N,) s; None where its place on the base is not known.

    Args:
        sensor: One of its runs must cover the grid.
        grid: Times, s.
        rate_hz: Of the grid.
    """
    if sensor.rotation is None or sensor.origin is None:
        return None
    run = [run for run in sensor.runs if sensor.time[run.start] <= grid[0]][-1]
    time, turn = sensor.time[run], sensor.rotation.T
    grid = np.minimum(grid, time[-1])
    low_pass = None
    if sensor.rate_hz > 1.5 * rate_hz:
        low_pass = butter(4, ALIASING_SHARE * rate_hz, fs=sensor.rate_hz, output="sos")

    def placed(signal: FloatArray | None) -> FloatArray | None:
        if signal is None:
            return None
        values = signal[run] if low_pass is None else sosfiltfilt(low_pass, signal[run], axis=0)
        return np.asarray(make_interp_spline(time, values @ turn, k=3)(grid))

    attitude = None
    if sensor.attitude is not None:
        turned = Slerp(time, Rotation.from_quat(sensor.attitude[run]))(grid)
        attitude = np.asarray(turned.as_matrix() @ turn)
    rate = placed(sensor.rate)
    assert rate is not None
    return BaseSamples(sensor.rate_hz, rate, placed(sensor.force), placed(sensor.velocity), attitude, sensor.origin)


def covered(sensor: BaseSensor | None, time: FloatArray, segment: slice) -> list[slice]:
    """The parts of a segment in which the base's motion is known.

    Args:
        sensor: Sensor on the base; None, or one of unknown orientation: the whole segment counts.
        time: (N,) time of the recording's samples, s.
        segment: Range of those samples.

    Returns:
        Ranges of samples, in the same numbering; empty where the sensor covers none.
    """
    if sensor is None or sensor.rotation is None:
        return [segment]
    parts = []
    for run in sensor.runs:
        if run.stop - run.start < 4:
            continue
        first, last = sensor.time[run.start], sensor.time[run.stop - 1]
        start = int(np.searchsorted(time[segment], first, side="left"))
        stop = int(np.searchsorted(time[segment], last, side="right"))
        if stop > start:
            parts.append(slice(segment.start + start, segment.start + stop))
    return parts


def moves(sensor: BaseSensor) -> bool:
    """Whether the base moves by more than the sensor's noise, or turns steadily."""
    linear = sensor.force if sensor.force is not None else sensor.velocity
    assert linear is not None
    block = max(1, round(STILL_BLOCK_S * sensor.rate_hz))
    blocks = len(sensor.time) // block
    if blocks < 2 or np.linalg.norm(sensor.rate.mean(axis=0)) > STILL_RATE:
        return True
    for signal in (sensor.rate, linear):
        noise = np.median(np.abs(np.diff(signal, axis=0)), axis=0) * 1.4826 / np.sqrt(2 * block)
        means = signal[: blocks * block].reshape(blocks, block, 3).mean(axis=1)
        if (means.std(axis=0) > STILL_FACTOR * noise).any():
            return True
    return False
