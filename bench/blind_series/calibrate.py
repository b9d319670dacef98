"""Set the size of a law so that its torque change is a wanted multiple of the healthy residual."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from laws import Law, TwoMass
from scipy.signal import butter, filtfilt


def nominal(model: pin.Model, rotor: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Rigid-body torque (T, n) with rotor inertia, along a motion (T, n) each."""
    data = model.createData()
    return np.stack([pin.rnea(model, data, q[k], v[k], a[k]) for k in range(len(q))]) + a * rotor


def walk(arm, law: Law, t, q, v, a, load, temperature, seed: int = 0) -> np.ndarray:
    """Torque (T, n) that a law adds along a given motion, stepping through it.

    Args:
        arm: the arm.
        law: the law.
        t: (T,) s, even.
        q: (T, n) rad.
        v: (T, n) rad/s.
        a: (T, n) rad/s^2.
        load: transmitted torque, (T, n) N m.
        temperature: (T, n) C.
        seed: of the law's own randomness.
    """
    dt = float(np.median(np.diff(t)))
    law.reset(np.ones(1, bool), dt, np.random.default_rng(seed))
    model = arm.model
    s = SimpleNamespace(
        models=[model], datas=[model.createData()], period=dt, duration=t[-1] - t[0], z=np.zeros((1, arm.n))
    )
    out = np.zeros((len(t), arm.n))
    for k in range(len(t)):
        s.t, s.q, s.v, s.a, s.load, s.temperature = (
            t[k] - t[0],
            q[k : k + 1],
            v[k : k + 1],
            a[k : k + 1],
            load[k : k + 1],
            temperature[k : k + 1],
        )
        sign = np.sign(s.v)
        s.z = sign - (sign - s.z) * np.exp(-np.abs(s.v) * dt / arm.presliding)
        law.tick(s)
        law.torque(s, out[k : k + 1])
    return out


def change(arm, law: Law, t, q, v, a, temperature) -> np.ndarray:
    """Torque change (T, n) of a law along a motion, as seen in what is logged; N m.

    Laws of position reading and of two masses: by the change of motion in the log, low-passed at 20 Hz.
    """
    dt = float(np.median(np.diff(t)))
    load = nominal(arm.model, 0 * arm.rotor, q, v, a)
    tau = load + a * arm.rotor + arm.coulomb * np.tanh(v / 0.02) + arm.viscous * v
    j = law.joint
    if type(law).model is not Law.model:
        other = arm.model.copy()
        law.model(other)
        return nominal(other, 0 * arm.rotor, q, v, a) - load
    if type(law).log is not Law.log:
        late = tau.copy()
        law.log(late, dt)
        return late - tau
    moved = None
    if isinstance(law, TwoMass):
        moved = q.copy()
        moved[:, j] += law.twist(load[:, j])
    elif type(law).measure is not Law.measure:
        law.reset(np.ones(1, bool), dt, np.random.default_rng(0))
        moved = q.copy()
        for k in range(len(t)):
            law.measure(None, moved[k : k + 1])
    if moved is not None:
        b, c = butter(2, min(20 * 2 * dt, 0.9))
        delta = filtfilt(b, c, moved - q, axis=0)
        dv = np.gradient(delta, dt, axis=0)
        da = np.gradient(dv, dt, axis=0)
        rotor = arm.rotor.copy()
        if isinstance(law, TwoMass):
            rotor[j] = 0  # the rotor's own motion is the one read
        return nominal(arm.model, rotor, q + delta, v + dv, a + da) - nominal(arm.model, rotor, q, v, a)
    if type(law).actuate is not Law.actuate:
        law.reset(np.ones(1, bool), dt, np.random.default_rng(0))
        out = np.empty_like(tau)
        for k in range(len(t)):
            out[k : k + 1] = tau[k : k + 1]
            law.actuate(SimpleNamespace(q=q[k : k + 1], v=v[k : k + 1]), out[k : k + 1])
        return out - tau
    return walk(arm, law, t, q, v, a, load, temperature)


def strength(arm, law: Law, motion: tuple, healthy: np.ndarray) -> float:
    """RMS torque change over the healthy residual, the largest over the law's joints.

    Args:
        arm: the arm.
        law: the law.
        motion: t (T,), q, v, a, temperature (T, n).
        healthy: (n,), N m.
    """
    ratio = np.sqrt((change(arm, law, *motion) ** 2).mean(0)) / healthy
    return float(ratio[law.joint] if law.joint is not None else ratio.max())


def reach(law: Law, measured: Callable[[], float], wanted: float) -> float:
    """Set law.size so that measured() gives the wanted strength, within law.largest; returns what it gives."""
    power, before = 1.0, None
    for _ in range(2 if law.linear else 8):
        now = measured()
        if abs(now / wanted - 1) < 0.05:
            break
        if before and abs(np.log(law.size / before[0])) > 1e-3:  # secant in logarithms
            power = np.clip(np.log(max(now, 1e-9) / before[1]) / np.log(law.size / before[0]), 0.3, 3)
        before = law.size, max(now, 1e-9)
        law.size = float(np.clip(law.size * (wanted / before[1]) ** (1 / power), 1e-9, law.largest))
    return measured()


def calibrate(arm, law: Law, motion: tuple, healthy: np.ndarray, wanted: float) -> float:
    """Set law.size for the wanted multiple of the healthy residual, within law.largest.

    Returns:
        The multiple reached by the calculation.
    """
    law.size = min(law.start, law.largest)
    if law.name == "vacuum_friction":
        law.size = 1.0
        return strength(arm, law, motion, healthy)
    return reach(law, lambda: strength(arm, law, motion, healthy), wanted)
