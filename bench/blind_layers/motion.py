"""Excitation: finite Fourier series within limits of position, velocity and torque.

Source: Swevers et al. (1997), Optimal robot excitation and identification, IEEE Trans. Robotics and Automation 13(5).
Coefficients are random here; a quintic ramp starts and ends the motion at rest.
"""

from __future__ import annotations

import mujoco
import numpy as np

from .arms import Arm

RATE_HZ = 1000.0
"""Rate of set-points and of the controller, Hz."""

REST_s = 1.0
"""Rest before and after the motion, s."""


def excitation(arm: Arm, model: mujoco.MjModel, rng: np.random.Generator, duration: float) -> np.ndarray:
    """Set-points of one recording.

    Args:
        arm: its range and limits.
        model: the rigid arm that checks torque limits (n degrees of freedom).
        rng: random numbers.
        duration: s, rest included.

    Returns:
        Position, velocity and acceleration, rad, rad/s, rad/s² (3, samples, n) at `RATE_HZ`.
    """
    n, count = len(arm.joints), int(duration * RATE_HZ)
    t = np.arange(count) / RATE_HZ
    moving = np.clip(t - REST_s, 0.0, duration - 2 * REST_s)
    base, scale = 2 * np.pi * rng.uniform(0.07, 0.12), 1.0
    k = np.arange(1, 7)
    raw = np.zeros((count, n))
    for j in range(n):
        a, b = rng.normal(size=(2, 6)) / k**0.7
        raw[:, j] = np.cos(np.outer(moving, base * k)) @ a + np.sin(np.outer(moving, base * k)) @ b
    middle, half = (arm.upper + arm.lower) / 2, (arm.upper - arm.lower) / 2
    raw -= (raw.max(0) + raw.min(0)) / 2
    raw /= np.abs(raw).max(0)
    start = middle + half * rng.uniform(-0.15, 0.15, n)
    reach = half * 0.85
    window = _ramp(moving / 2.0) * _ramp((duration - 2 * REST_s - moving) / 2.0)
    data = mujoco.MjData(model)
    for _ in range(8):
        q = start + window[:, None] * raw * reach * scale
        v = np.gradient(q, 1 / RATE_HZ, axis=0)
        excess = np.abs(v).max(0) / arm.velocity
        reach = reach / np.maximum(excess, 1.0)
        q = start + window[:, None] * raw * reach * scale
        v = np.gradient(q, 1 / RATE_HZ, axis=0)
        a = np.gradient(v, 1 / RATE_HZ, axis=0)
        peak = np.abs(rigid_torque(model, data, q[::20], v[::20], a[::20])).max(0)
        if np.all(peak < 0.8 * arm.effort):
            break
        scale *= 0.85
    return np.array([q, v, a])


def rigid_torque(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torque by `mj_inverse`, with the model's armature, damping and friction loss, N m (samples, n).

    Args:
        model: a model whose degrees of freedom are the joints.
        data: its workspace.
        q: rad (samples, n).
        v: rad/s (samples, n).
        a: rad/s² (samples, n).
    """
    torque = np.zeros_like(q)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse
    return torque


def _ramp(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)
