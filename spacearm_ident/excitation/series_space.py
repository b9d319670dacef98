"""Fourier trajectories as points of a vector space, and their motion limits as linear inequalities there.

Position, velocity, acceleration and jerk of eq. 9 are linear in a joint's coefficients (q0, a, b), so the motions
that keep the limits are a convex set, joint by joint. A trigonometric polynomial of degree N that stays below c at M
even points of its period stays below c / cos(pi N / M) everywhere (Ehlich and Zeller 1964): limits shrunk by that
cosine hold at every instant, not only at the points.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .segments import Motion, MotionLimits
from .trajectory import FourierTrajectory

_POINTS_A_HARMONIC = 24
_FREE = 1e3
"""Stands for a missing limit, rad and s: finite, so that a range has a middle."""

Basis = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class SeriesSpace:
    """Series of one fundamental and number of harmonics under motion limits.

    Points are z (n, 1 + 2 N_h): the mean's distance from the middle of the range, then a, then b, each in units of
    what alone would use up the tightest limit.

    Attributes:
        joints: Names of the n joints.
        harmonics: N_h.
        fundamental_hz: f0, Hz.
        rows: For every joint (r, 1 + 2 N_h): within the limits |rows @ z| <= 1.
    """

    def __init__(self, joints: tuple[str, ...], limits: MotionLimits, fundamental_hz: float, harmonics: int) -> None:
        self.joints, self.harmonics, self.fundamental_hz = joints, harmonics, fundamental_hz
        self._omega = 2 * np.pi * fundamental_hz * np.arange(1, harmonics + 1)
        lower, upper = np.clip(limits.lower, -_FREE, _FREE), np.clip(limits.upper, -_FREE, _FREE)
        self._middle, half = (upper + lower) / 2, (upper - lower) / 2
        velocity, acceleration = np.minimum(limits.velocity, _FREE), np.minimum(limits.acceleration, _FREE)
        bounds = [half, velocity, acceleration]
        alone = [half[:, None] * self._omega, velocity[:, None] + 0 * self._omega, acceleration[:, None] / self._omega]
        if limits.jerk is not None:
            bounds.append(limits.jerk)
            alone.append(limits.jerk[:, None] / self._omega**2)
        size = np.min(alone, axis=0)
        self._scale = np.concatenate([np.minimum(half, np.pi)[:, None], size, size], axis=1)
        points = _POINTS_A_HARMONIC * harmonics
        shrink = np.cos(np.pi * harmonics / points)
        basis = self.basis(points)
        self.rows = [
            np.concatenate([part * scale / (bound[j] * shrink) for part, bound in zip(basis, bounds)])
            for j, scale in enumerate(self._scale)
        ]

    @property
    def shape(self) -> tuple[int, int]:
        """(n, 1 + 2 N_h)."""
        return len(self.joints), 1 + 2 * self.harmonics

    def basis(self, samples: int) -> Basis:
        """(T, 1 + 2 N_h) each: q − middle, qd, qdd, jerk of unscaled coefficients at even points of a period."""
        omega = self._omega
        phase = np.outer(np.arange(samples) / (samples * self.fundamental_hz), omega)
        sin, cos = np.sin(phase), np.cos(phase)
        one, none = np.ones((samples, 1)), np.zeros((samples, 1))
        return (
            np.concatenate([one, sin / omega, -cos / omega], axis=1),
            np.concatenate([none, cos, sin], axis=1),
            np.concatenate([none, -sin * omega, cos * omega], axis=1),
            np.concatenate([none, -cos * omega**2, -sin * omega**2], axis=1),
        )

    def motion(self, z: FloatArray, basis: Basis) -> Motion:
        """Motion (T, n) of a point, on the times of a basis.

        Args:
            z: (n, 1 + 2 N_h) point.
            basis: Of T times.
        """
        q, qd, qdd = (part @ (self._scale * z).T for part in basis[:3])
        return Motion(self._middle + q, qd, qdd)

    def gradient(self, by_motion: Motion, basis: Basis) -> FloatArray:
        """(n, 1 + 2 N_h) derivative by z from that by the motion.

        Args:
            by_motion: Derivative by position, velocity and acceleration, (T, n) each.
            basis: Of the same times.
        """
        by_q, by_qd, by_qdd, _ = (part.T for part in basis)
        unscaled = by_q @ by_motion.q + by_qd @ by_motion.qd + by_qdd @ by_motion.qdd
        return np.asarray(unscaled.T * self._scale)

    def usage(self, z: FloatArray) -> FloatArray:
        """(n,) largest share of each joint's limits; at most 1 within them."""
        return np.array([np.abs(rows @ own).max() for rows, own in zip(self.rows, z)])

    def series(self, z: FloatArray, periods: int) -> FourierTrajectory:
        """The trajectory of a point.

        Args:
            z: (n, 1 + 2 N_h) point.
            periods: How often the trajectory repeats itself.
        """
        mean, a, b = np.split(self._scale * z, [1, 1 + self.harmonics], axis=1)
        return FourierTrajectory(self.joints, self._middle + mean[:, 0], a, b, self.fundamental_hz, periods)

    def point(self, series: FourierTrajectory) -> FloatArray:
        """The point of a trajectory of this fundamental with at most as many harmonics."""
        gap = np.zeros((len(self.joints), self.harmonics - series.a.shape[1]))
        mean = (series.q0 - self._middle)[:, None]
        return np.asarray(np.concatenate([mean, series.a, gap, series.b, gap], axis=1) / self._scale)
