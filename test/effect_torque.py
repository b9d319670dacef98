"""Effects at their places on small arms, and the torque they add along a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from planted_arm import THREE_LINKS, Link, multisine, urdf_of

from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.background import Background
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.signals.motion import Motion

RATE = 250.0
PENDULUM = (Link("hip", mass=2.0, com=(0.0, 0.0, -0.5), inertia=(0.03, 0, 0, 0.03, 0, 0.01)),)
HANGING_NM, PENDULUM_INERTIA = 2.0 * 9.81 * 0.5, 0.03 + 2.0 * 0.5**2
BASE = {"rigid_body": {}, "rotor_inertia": {}, "viscous_friction": {}}
ODD = {**BASE, "viscous_friction": {"quadratic": "odd"}}


def arm_of(links=THREE_LINKS, gravity=(0.0, 0.0, -9.81)) -> Arm:
    return arm_from_urdf(urdf_of(links), np.array(gravity))


def motion_of(joints, q, qd, qdd, rate=RATE, temperature=None, noise=0.0, start=0.0) -> Motion:
    count, zero = len(joints), np.zeros_like(q)
    return Motion(
        joints, rate, start, q, qd, qdd, zero, np.full(count, noise), np.zeros(count), temperature=temperature
    )


def wave(joints, seconds=4.0, seed=0, speed=1.5, **more) -> Motion:
    time = np.arange(0.0, seconds, 1 / more.get("rate", RATE))
    return motion_of(joints, *multisine(time, len(joints), seed, 0.25, 4, speed), **more)


def healthy(arm: Arm, structure=BASE, **values) -> IdentifiedModel:
    """Rigid links as in the URDF; others by symbol, the same at every joint."""
    model = TorqueModel(arm, structure)
    count = 10 * len(arm.joints)
    rigid = np.concatenate([joint.inertial for joint in arm.joints])
    others = [values.get(parameter.symbol, 0.0) for parameter in model.parameters[count:]]
    return IdentifiedModel(model, np.concatenate([rigid, others]), np.zeros(0))


def background_of(arm: Arm, motion: Motion, structure=BASE, **values) -> Background:
    known = healthy(arm, structure, **values)
    return known.model.background(motion, known.parameters, known.constants)


def one(kind, arm, **place):
    (effect,) = EFFECTS[kind].build(arm, {"at": [place]})
    return effect


def torque(effect, motion, parameters, constants=(), background=None):
    """(N, n) what the effect adds."""
    total = np.zeros_like(motion.position)
    for row, (indices, columns) in effect.columns(motion, constants, background).items():
        total[:, row] += columns @ np.asarray(parameters, dtype=float)[indices]
    return total


def only(row, values, count=3):
    total = np.zeros((len(values), count))
    total[:, row] = values
    return total


def rnea(links, q, qd, qdd, gravity=(0.0, 0.0, -9.81), change=None):
    model = pin.buildModelFromXML(urdf_of(links))
    model.gravity.linear = np.array(gravity, dtype=float)
    if change is not None:
        change(model)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd)])


def fitted(signal, time, omega):
    """Complex amplitude of a sine of known frequency: a in Im(a e^(i w t))."""
    columns = np.stack([np.sin(omega * time), np.cos(omega * time)], axis=1)
    sine, cosine = np.linalg.lstsq(columns, signal, rcond=None)[0]
    return complex(sine, cosine)


ARM = arm_of()
# With gears, so that an effect that needs them has its places, too.
ARM = replace(ARM, joints=tuple(replace(joint, gear_ratio=100.0) for joint in ARM.joints))


def middle(effect):
    return [constant.grid[len(constant.grid) // 2] for constant in effect.constants]


W = wave(ARM.joint_names, seed=3)


def assert_same_torque(found, expected) -> None:
    """Equal but for the last digits: sums run in another order where an array begins elsewhere in memory."""
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
