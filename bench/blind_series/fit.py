"""A textbook fit of the reference recordings: the yardstick of strength, never shown to the program.

Ordinary weighted least squares of rigid-body parameters, rotor inertia, Coulomb and viscous friction and an
offset (Swevers, Verdonck, De Schutter 2007), on positions filtered without phase. What it leaves over on the
reference recordings is the "healthy residual" of a joint.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.signal import butter, filtfilt

CUTOFF = 10.0  #: of the zero-phase filter, Hz


def smooth(time: np.ndarray, position: np.ndarray, effort: np.ndarray, rate: float = 50.0):
    """Filtered motion and torque at an even, lower rate.

    Args:
        time: (T,) s, may be uneven.
        position: (T, n) rad.
        effort: (T, n) N m.
        rate: of the result, Hz.

    Returns:
        t (K,), q, v, a, tau (K, n) without the first and last 0.3 s.
    """
    fs = 500.0
    t = np.arange(time[0], time[-1], 1 / fs)
    b, a = butter(4, CUTOFF / (fs / 2))
    q = np.stack([np.interp(t, time, x) for x in position.T], 1)
    tau = np.stack([np.interp(t, time, x) for x in effort.T], 1)
    q, tau = filtfilt(b, a, q, axis=0), filtfilt(b, a, tau, axis=0)
    v = np.gradient(q, 1 / fs, axis=0)
    acc = np.gradient(v, 1 / fs, axis=0)
    pick = slice(int(0.3 * fs), -int(0.3 * fs), round(fs / rate))
    return t[pick], q[pick], v[pick], acc[pick], tau[pick]


def rms(x: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """RMS (n,) of x (T, n) over the samples in which the joint moves (T, n); at rest friction may be anything."""
    return np.sqrt((x**2 * moves).sum(0) / moves.sum(0))


class Fit:
    """Fit of the reference; `residual` gives what it leaves over elsewhere."""

    def __init__(self, model: pin.Model, recordings: list[tuple]) -> None:
        """Args: model: rigid-body model; recordings: (time, position, effort) each."""
        self.model, self.data = model, model.createData()
        parts = [self._rows(*smooth(*r)) for r in recordings]
        y = np.concatenate([p[0] for p in parts])  # (K, n, columns)
        tau = np.concatenate([p[1] for p in parts])
        moves = np.concatenate([p[2] for p in parts])
        weight = np.ones(model.nv)
        for _ in range(2):
            a = (y * weight[None, :, None])[moves]
            scale = np.linalg.norm(a, axis=0) + 1e-12
            x, *_ = np.linalg.lstsq(a / scale, (tau * weight)[moves], rcond=1e-8)
            self.x = x / scale
            rest = tau - y @ self.x
            weight = 1 / rms(rest, moves)
        self.healthy = rms(rest, moves)  #: residual RMS of the reference (n,), N m

    def _rows(self, t, q, v, a, tau):
        n = self.model.nv
        y = np.zeros((len(t), n, 10 * n + 4 * n))
        fast = np.abs(v).max(0)
        for k in range(len(t)):
            y[k, :, : 10 * n] = pin.computeJointTorqueRegressor(self.model, self.data, q[k], v[k], a[k])
        for j in range(n):
            y[:, j, 10 * n + 4 * j : 10 * n + 4 * j + 4] = np.stack(
                [a[:, j], v[:, j], np.tanh(v[:, j] / (0.01 * fast[j])), np.ones(len(t))], 1
            )
        return y, tau, np.abs(v) > 0.04 * fast

    def residual(self, time: np.ndarray, position: np.ndarray, effort: np.ndarray) -> np.ndarray:
        """Residual RMS (n,) of a recording, N m."""
        y, tau, moves = self._rows(*smooth(time, position, effort))
        return rms(tau - y @ self.x, moves)
