"""How large each concealed difference is in torque, after what parameters could absorb.

A difference is a vector of torque over all joints and recordings, without noise. Its projection on the columns of the
parameters that may absorb it is removed: Coulomb and viscous friction and rotor inertia of each joint (the size that
counts), or these and the ten inertial parameters of every body (the size that no choice of parameters explains). The
RMS of the rest at a joint over that joint's noise is the size. Atkeson, An, Hollerbach (1986), Int. J. Robotics Res.
5(3), give the linear model.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

from .laws import ZERO_SPEED

SAMPLES = 250
"""Rows of each recording that the projection uses."""

POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [1, 1, 0], [0, 1, 1], [1, 0, 1]],
    float,
)
"""Places of a unit mass, m: its torque is quadratic in the place, and these ten span the ten inertial parameters."""


def regressor(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Columns that span what inertial parameters, friction and armature can do.

    Args:
        model: the rigid arm (n joints); it is changed and must not be used afterwards.
        q: rad (samples, n).
        v: rad/s (samples, n).
        a: rad/s² (samples, n).

    Returns:
        Observation matrix (samples n, columns).
    """
    samples, n = q.shape
    model.dof_armature[:] = model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.body_mass[:], model.body_inertia[:] = 0.0, 0.0
    model.body_iquat[:] = (1.0, 0.0, 0.0, 0.0)
    data = mujoco.MjData(model)
    columns = []
    for body in range(1, model.nbody):
        if model.body_weldid[body] == 0:
            continue
        for point in POINTS:
            model.body_mass[body], model.body_ipos[body] = 1.0, point
            block = np.zeros((samples, n))
            for i in range(samples):
                data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
                mujoco.mj_inverse(model, data)
                block[i] = data.qfrc_inverse
            columns.append(block.ravel())
            model.body_mass[body] = 0.0
    for values in (np.tanh(v / ZERO_SPEED), v, a):
        for j in range(n):
            block = np.zeros((samples, n))
            block[:, j] = values[:, j]
            columns.append(block.ravel())
    return np.array(columns).T


def basis(columns: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns, rows weighted.

    Args:
        columns: observation matrix (samples n, columns).
        weight: 1 / noise of each joint, 1/(N m) (n).

    Returns:
        Basis (samples n, rank).
    """
    scaled = columns * np.tile(weight, len(columns) // len(weight))[:, None]
    norms = np.linalg.norm(scaled, axis=0)
    u, s, _ = np.linalg.svd(scaled[:, norms > 0] / norms[norms > 0], full_matrices=False)
    return u[:, s > 1e-8 * s[0]]


def size(space: np.ndarray, difference: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """RMS of a difference that the basis does not absorb, over the noise (n).

    Args:
        space: `basis`.
        difference: N m (samples, n).
        weight: 1 / noise, 1/(N m) (n).
    """
    y = (difference * weight).ravel()
    y = y - space @ (space.T @ y)
    return np.sqrt(np.mean(y.reshape(difference.shape) ** 2, axis=0))


def low_pass(values: np.ndarray, rate: float, corner: float = 20.0) -> np.ndarray:
    """Zero-phase low-pass of the columns (samples, n); rate and corner in Hz."""
    return np.asarray(sosfiltfilt(butter(4, corner, fs=rate, output="sos"), values, axis=0))
