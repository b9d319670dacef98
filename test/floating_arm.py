"""A three-joint arm on a free body, written with Pinocchio alone: conserved momentum, torque, and what an IMU feels.

Nothing of the package's own dynamics is used: joint motion is given, the base's velocity follows from momentum zero,
its acceleration and the torques from Pinocchio's Newton-Euler on the free flyer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
from planted_arm import THREE_LINKS, urdf_of

from spacearm_ident.recording.recording import BaseSensor, Recording

URDF = urdf_of(THREE_LINKS)
JOINTS = tuple(link.name for link in THREE_LINKS)
TURNING = np.array([[1.2, 0.1, -0.05], [0.1, 1.0, 0.08], [-0.05, 0.08, 0.8]])
BASE = pin.Inertia(25.0, np.array([0.05, -0.03, -0.2]), TURNING)
COULOMB, VISCOUS, ROTOR = np.array([0.6, 0.8, 0.4]), np.array([0.5, 0.7, 0.3]), np.array([0.2, 0.25, 0.1])
ORIGIN = np.array([0.12, -0.05, 0.3])
"""Of the IMU that does not sit in the base link's frame."""
TURN = pin.rpy.rpyToMatrix(0.3, -0.2, 1.1)
MOUNTED = URDF.replace(
    '<link name="base"/>',
    '<link name="base"/><link name="imu"/><joint name="mount" type="fixed"><parent link="base"/><child link="imu"/>'
    f'<origin xyz="{" ".join(map(str, ORIGIN))}" rpy="0.3 -0.2 1.1"/></joint>',
)


@dataclass(frozen=True)
class Flight:
    """(N, ...) joints, torque, and base: rate, classical acceleration and velocity in its axes, attitude."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    torque: np.ndarray
    rate: np.ndarray
    rate_dot: np.ndarray
    acceleration: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


def truth() -> dict[str, float]:
    """Every inertial and rotor parameter by name, the base's among them, and friction."""
    bodies = {"base": BASE}
    model = pin.buildModelFromXML(URDF)
    bodies |= {name: model.inertias[k + 1] for k, name in enumerate(JOINTS)}
    symbols = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    named = {
        f"{symbol}[{name}]": float(value)
        for name, body in bodies.items()
        for symbol, value in zip(symbols, body.toDynamicParameters())
    }
    for symbols, values in ((("J_m",), ROTOR), (("f_c", "f_b"), COULOMB), (("k_v1",), VISCOUS)):
        named |= {f"{symbol}[{name}]": float(value) for symbol in symbols for name, value in zip(JOINTS, values)}
    return named


def combination(name: str) -> float:
    """The true value of a base parameter, such as `mcz[base] - 0.3 m[elbow]`; what is not known counts nothing."""
    known, total, sign, factor = truth(), 0.0, 1.0, 1.0
    for word in name.split(" "):
        if word in "+-":
            sign, factor = (1.0 if word == "+" else -1.0), 1.0
        elif "[" in word:
            total += sign * factor * known.get(word, 0.0)
        else:
            factor = float(word)
    return total


@cache
def fly(duration_s: float = 20.0, rate_hz: float = 100.0, seed: int = 0) -> Flight:
    """The arm waves; the base answers."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration_s, 1.0 / rate_hz)
    frequency = 2 * np.pi * np.array([[0.17, 0.31, 0.53], [0.21, 0.37, 0.61], [0.23, 0.41, 0.67]])
    size = np.array([[0.8, 0.4, 0.2], [0.7, 0.4, 0.2], [0.9, 0.5, 0.2]])
    angle = time[:, None, None] * frequency + rng.uniform(0, 2 * np.pi, (3, 3))
    q = (size * np.sin(angle)).sum(axis=2)
    qd = (size * frequency * np.cos(angle)).sum(axis=2)
    qdd = -(size * frequency**2 * np.sin(angle)).sum(axis=2)
    model = pin.buildModelFromXML(URDF, pin.JointModelFreeFlyer())
    model.inertias[1] = BASE
    model.gravity.setZero()
    data = model.createData()
    pose = np.array([0.0, 0, 0, 0, 0, 0, 1])
    rows = []
    for k in range(len(time)):
        whole = np.concatenate([pose, q[k]])
        inertia = pin.crba(model, data, whole)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        twist = -np.linalg.solve(inertia[:6, :6], inertia[:6, 6:] @ qd[k])
        speed = np.concatenate([twist, qd[k]])
        bias = pin.rnea(model, data, whole, speed, np.concatenate([np.zeros(6), qdd[k]]))
        answer = -np.linalg.solve(inertia[:6, :6], bias[:6])
        torque = pin.rnea(model, data, whole, speed, np.concatenate([answer, qdd[k]]))[6:]
        linear = answer[:3] + np.cross(twist[3:], twist[:3])
        attitude = pin.Quaternion(pose[3:]).toRotationMatrix()
        rows.append((torque, twist[3:], answer[3:], linear, twist[:3], attitude))
        pose = pin.integrate(model, whole, np.concatenate([twist, np.zeros(3)]) / rate_hz)[:7]
    torque, rate, rate_dot, acceleration, velocity, attitude = (np.array(part) for part in zip(*rows))
    torque = torque + COULOMB * np.sign(qd) + VISCOUS * qd + ROTOR * qdd
    return Flight(time, q, qd, qdd, torque, rate, rate_dot, acceleration, velocity, attitude)


def recorded(flight: Flight, seed: int = 0, noise: float = 1.0, mounted: bool = False) -> Recording:
    """The flight through sensors: an IMU of a good MEMS kind at the joints' rate, in the base link or beside it."""
    rng = np.random.default_rng(seed)
    torque = flight.torque + noise * 0.03 * rng.standard_normal(flight.torque.shape)
    position = flight.q + noise * 2e-6 * rng.standard_normal(flight.q.shape)
    rate, force = flight.rate, flight.acceleration
    if mounted:
        force = force + np.cross(flight.rate_dot, ORIGIN) + np.cross(rate, np.cross(rate, ORIGIN))
        rate, force = rate @ TURN, force @ TURN
    rate = rate + noise * 4e-4 * rng.standard_normal(rate.shape)
    force = force + noise * 5e-3 * rng.standard_normal(force.shape)
    whole = (slice(0, len(flight.time)),)
    imu = BaseSensor("/base_imu", "imu" if mounted else "base", flight.time, rate, whole, force=force)
    urdf = MOUNTED if mounted else URDF
    return Recording(JOINTS, flight.time, position, None, torque, whole, base=imu, urdf=urdf)
