"""`Motion`: joint signals made ready for regression, and the one linear map that torque and columns share.

A regression compares torque with columns computed from position, velocity and acceleration. Whatever low-pass
the torque goes through, every column must go through the same (Gautier's parallel filtering), and columns with
the sign of the velocity must be built before it, at full rate. So a `Motion` keeps the full-rate signals
together with its `reduce`: the map from full-rate samples to the fewer, independent rows of the regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal.windows import hann
from scipy.sparse import csr_array

from ..arrays import BoolArray, FloatArray
from .base_motion import BaseMotion

HALF_LENGTH = 0.5
"""Half length of the low-pass, in periods of its cut-off: there a Hann window passes half, at twice that nothing."""
REVERSAL_SHARE = 0.1
"""Speed below which rows near a reversal are left out, as a share of the speeds that the low-pass averages there."""
STANDSTILL_SHARE = 0.02
"""Share of a row's samples at standstill from which the row is at standstill."""
STUCK_RAD = 0.02
"""A revolute joint that ranges over less may never have slid: the friction of geared joints builds up over 1e-3 to 2e-2
rad (presliding; Armstrong-Helouvry et al. 1994), and what it holds no model of sliding friction explains. One that
ranges over more moves, whatever its speed is found to be; for joints that slide the same number in m."""
PART_SAMPLES = 16_384
"""Full-rate samples that are worked on at once, where there is no need to have all."""


def moves_by_position(motions: Sequence[HasPosition], joint: int) -> bool:
    """Whether a joint's position ranges over more than `STUCK_RAD` in one of some motions, whatever its speed seems.

    Args:
        motions: Or anything else with positions (N, n).
        joint: Its number.
    """
    return any(np.ptp(one.position[:, joint]) > STUCK_RAD for one in motions if len(one.position))


class HasPosition(Protocol):
    """What has positions (N, n), rad."""

    @property
    def position(self) -> FloatArray:
        """(N, n) rad."""


@dataclass(frozen=True)
class Motion:
    """Evenly sampled signals of one uninterrupted stretch, or the mean of its periods.

    Attributes:
        joints: Column order of the arrays.
        rate_hz: Full rate.
        start_s: Time of the first sample in its recording.
        position: (N, n) rad.
        velocity: (N, n) rad/s, derivative of `position`.
        acceleration: (N, n) rad/s^2, derivative of `velocity`.
        torque: (N, n) N·m at full bandwidth (mean over the periods where `periods` > 1).
        speed_noise: (n,) speed under which the sign of the velocity is not believed, rad/s.
        resolved_speed: (n,) speeds that the low-pass blurs a reversal over: acceleration over bandwidth, rad/s.
        block: Full-rate samples averaged into one row before filtering.
        cutoff_hz: Low-pass of `reduce`.
        stride: Filtered blocks a row.
        periods: How many periods were averaged; 1 where nothing repeats.
        noise_Nm: (n,) standard deviation of a reduced torque row's pure error, from period-to-period scatter.
        temperature: (N, n) °C, NaN for a joint of which none was recorded; None where of no joint.
        base: How the base moves; None: it is fixed, or nothing of it was recorded.
        source: Which recording it came from (index in the caller's list).
        void: Times in the recording, s, from and to, whose rows do not count where it is judged.
        given_moving: (M, n) `moving` as another motion has it; None: as this one's velocity says.
    """

    joints: tuple[str, ...]
    rate_hz: float
    start_s: float
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    speed_noise: FloatArray
    resolved_speed: FloatArray
    block: int = 1
    cutoff_hz: float = 20.0
    stride: int = 1
    periods: int = 1
    noise_Nm: FloatArray | None = None
    temperature: FloatArray | None = None
    base: BaseMotion | None = None
    source: int = 0
    void: tuple[tuple[float, float], ...] = ()
    given_moving: BoolArray | None = None

    @classmethod
    def free_of_noise(
        cls,
        joints: tuple[str, ...],
        rate_hz: float,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> Motion:
        """A motion that was not recorded: it has no torque, and the sign of every velocity is believed.

        Args:
            joints: Names of the n joints.
            rate_hz: Of its samples.
            position: (N, n) rad or m.
            velocity: (N, n) rad/s or m/s.
            acceleration: (N, n) rad/s² or m/s².
        """
        zero = np.zeros(len(joints))
        return cls(joints, rate_hz, 0.0, position, velocity, acceleration, np.zeros_like(position), zero, zero)

    @property
    def cyclic(self) -> bool:
        """Whether the last sample is followed by the first."""
        return self.periods > 1

    @cached_property
    def _rows(self) -> np.ndarray:
        """Blocks at the centre of the rows kept: every `stride`-th, none within a filter length of an edge."""
        blocks = len(self.position) // self.block
        edge = 0 if self.cyclic else self._half_length
        return np.arange(edge, blocks - edge, self.stride)

    @cached_property
    def _half_length(self) -> int:
        """Half the length of the low-pass, in blocks."""
        return int(np.ceil(HALF_LENGTH / self.cutoff_hz * self.rate_hz / self.block))

    @cached_property
    def _taps(self) -> FloatArray:
        """Weights of the low-pass, by block."""
        taps = hann(2 * self._half_length + 3)[1:-1]
        return np.asarray(taps / taps.sum())

    @cached_property
    def white_correlation(self) -> FloatArray:
        """(L,) autocorrelation by lag in rows that `reduce` gives to a white signal; 1 at lag 0."""
        taps = self._taps
        products = np.array([taps[lag:] @ taps[: len(taps) - lag] for lag in range(0, len(taps), self.stride)])
        return np.asarray(products / products[0])

    @cached_property
    def _low_pass(self) -> csr_array:
        """(M, blocks) linear-phase low-pass and decimation in one; only what is kept is computed."""
        reach, blocks = self._half_length, len(self.position) // self.block
        taps = self._taps
        columns = (self._rows[:, None] + np.arange(-reach, reach + 1)) % blocks
        starts = np.arange(len(self._rows) + 1) * len(taps)
        values = np.tile(taps, len(self._rows))
        return csr_array((values, columns.ravel(), starts), shape=(len(self._rows), blocks))

    def reduce(self, signal: FloatArray) -> FloatArray:
        """Low-pass and thin out a full-rate signal (N, ...) to the regression's rows (M, ...).

        Linear and zero-phase: block mean, then a weighted mean over one period of the cut-off (Hann window), at
        every `stride`-th block. The window has no negative lobes and ends: what happens at a reversal is felt by
        the rows next to it and by no others. No row lies within half a window of an edge; the mean of periods has
        no edges.
        """
        blocks = len(signal) // self.block
        tail = signal.shape[1:]
        weights = np.full(self.block, 1.0 / self.block)
        whole = signal[: blocks * self.block]
        if self.block == 1:
            return np.asarray(self._low_pass @ whole)
        # A product with ones is several times as fast as a mean over an axis, and fastest along the memory.
        if signal.ndim == 2 and signal.flags.f_contiguous:
            mean = (whole.T.reshape(-1, blocks, self.block) @ weights).T
        else:
            mean = np.matmul(weights, whole.reshape(blocks, self.block, -1)).reshape(blocks, *tail)
        return np.asarray(self._low_pass @ mean)

    def reduce_part(self, part: FloatArray, first: int) -> FloatArray:
        """As `reduce` a signal (N, k) that is zero but for a part of it: only the rows that feel it are computed.

        Args:
            part: (n, k) samples.
            first: Number of the first of them.
        """
        begin = first // self.block
        end = min(-(-(first + len(part)) // self.block), len(self.position) // self.block)
        reduced = np.zeros((len(self._rows), part.shape[1]))
        if end <= begin:
            return reduced
        whole = np.zeros(((end - begin) * self.block, part.shape[1]))
        known = part[: end * self.block - first]
        whole[first - begin * self.block :][: len(known)] = known
        mean = np.zeros((len(self.position) // self.block, part.shape[1]))
        weights = np.full(self.block, 1.0 / self.block)
        mean[begin:end] = np.matmul(weights, whole.reshape(end - begin, self.block, -1))
        reach = self._half_length
        low, high = np.searchsorted(self._rows, (begin - reach, end + reach))
        felt = slice(None) if self.cyclic else slice(low, high)
        reduced[felt] = self._low_pass[felt] @ mean
        return reduced

    def smoothed(self, signal: FloatArray, cutoff_hz: float) -> FloatArray:
        """A full-rate signal (N, k) through a low-pass of the same kind, at full rate; it stays where it is.

        Args:
            signal: In any unit.
            cutoff_hz: Of the low-pass.
        """
        half = max(1, int(np.ceil(HALF_LENGTH / cutoff_hz * self.rate_hz)))
        taps = hann(2 * half + 3)[1:-1]
        return np.asarray(convolve1d(signal, taps / taps.sum(), axis=0, mode="wrap" if self.cyclic else "nearest"))

    def __getitem__(self, part: slice) -> Motion:
        """The full-rate samples of `part` (start and stop given, no step)."""
        return replace(
            self,
            start_s=self.start_s + part.start / self.rate_hz,
            position=self.position[part],
            velocity=self.velocity[part],
            acceleration=self.acceleration[part],
            torque=self.torque[part],
            temperature=None if self.temperature is None else self.temperature[part],
            base=None if self.base is None else self.base[part],
        )

    def pieces(self, samples: int = PART_SAMPLES) -> Iterator[slice]:
        """The full-rate samples, about so many at a time."""
        for start in range(0, len(self.position), samples):
            yield slice(start, min(start + samples, len(self.position)))

    def parts(self, samples: int = PART_SAMPLES) -> Iterator[Motion]:
        """Shorter motions whose rows, one after the other, are the rows of this one.

        Neighbours share the samples that the low-pass reaches over. What depends on one sample alone can be computed
        and reduced part by part, and never be there for all samples at once. The mean of periods is one part.
        """
        rows = self._rows
        if self.cyclic or len(self.position) <= samples:
            yield self
            return
        together = max(1, (samples // self.block - 2 * self._half_length) // self.stride)
        for first in range(0, len(rows), together):
            last = min(first + together, len(rows)) - 1
            blocks = rows[first] - self._half_length, rows[last] + self._half_length + 1
            yield self[int(blocks[0]) * self.block : int(blocks[1]) * self.block]

    @cached_property
    def time(self) -> FloatArray:
        """(M,) time of the regression's rows, seconds from the start of the recording."""
        full = self.start_s + np.arange(len(self.position)) / self.rate_hz
        blocks = len(full) // self.block
        return np.asarray(full[: blocks * self.block].reshape(blocks, self.block).mean(axis=1)[self._rows])

    @cached_property
    def torque_rows(self) -> FloatArray:
        """(M, n) reduced torque, N·m."""
        return self.reduce(self.torque)

    @cached_property
    def velocity_rows(self) -> FloatArray:
        """(M, n) reduced velocity, rad/s."""
        return self.reduce(self.velocity)

    @property
    def standstill(self) -> FloatArray:
        """(n,) speed under which friction is not believed to follow the velocity, rad/s."""
        return np.maximum(self.speed_noise, REVERSAL_SHARE * self.resolved_speed)

    @cached_property
    def moving(self) -> np.ndarray:
        """(M, n) whether a row is free of standstill, where friction is whatever balances the rest."""
        if self.given_moving is not None:
            return self.given_moving
        standing = (np.abs(self.velocity) < self.standstill).astype(float)
        return self.reduce(standing) < STANDSTILL_SHARE

    @property
    def row_rate_hz(self) -> float:
        """Rate of the regression's rows."""
        return self.rate_hz / (self.block * self.stride)
