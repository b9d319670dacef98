"""A MuJoCo simulation in closed loop along what the arm did: the feedback that it needs, and how far it strays.

It runs forward under the recorded torque, and a slow feedback on the recorded motion holds it near. One that were the
arm would need none and stay there; what feedback adds is the torque that the simulation has wrong, as its user meets
it: with the engine's own integrator and friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..layers.item import Strayed
from ..signals.motion import Motion

BANDWIDTH_HZ = 2.0
"""Of the feedback, critically damped for a joint's own inertia: an arm whose gravity is wrong stays near its motion."""
LONGEST_S = 20.0
"""Of the longest recording; more takes longer and says the same."""
LOST = 2.0 * np.pi
"""rad or m: further away nothing is near any more, and what it strays and needs is infinite."""
SETTLING_S = 1.0
"""Left out at the beginning: what the feedback needs to find its level."""


def follow(mujoco: ModuleType, model: Any, gains_of: Any, motions: Sequence[Motion]) -> Strayed:
    """Run a model along the longest of some motions.

    Args:
        mujoco: The module.
        model: Its `MjModel`; actuators, contacts and joint limits do not act.
        gains_of: The `MjModel` whose inertias scale the feedback: the same for all that are compared.
        motions: Of the arm, with its torque.
    """
    motion = max(motions, key=lambda one: len(one.position) / one.rate_hz)
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_ACTUATION | off.mjDSBL_CONTACT | off.mjDSBL_LIMIT)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in motion.joints]
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    inertia = _inertia(mujoco, gains_of, motion, places, dofs)
    omega = 2.0 * np.pi * BANDWIDTH_HZ
    step_s, duration_s = model.opt.timestep, min(LONGEST_S, (len(motion.position) - 1) / motion.rate_hz)
    position, velocity, torque = _at_steps(motion, np.arange(0.0, duration_s, step_s))
    data = mujoco.MjData(model)
    rest = data.qpos.copy()
    strayed, added = np.full_like(position, np.inf), np.full_like(position, np.inf)
    data.qpos[places], data.qvel[dofs] = position[0], velocity[0]
    for row in range(len(position)):
        away, slow = position[row] - data.qpos[places], velocity[row] - data.qvel[dofs]
        strayed[row], added[row] = away, inertia * (omega**2 * away + 2.0 * omega * slow)
        if not np.all(np.abs(away) < LOST):
            added[row:] = strayed[row:] = np.inf
            break
        data.qfrc_applied[dofs] = torque[row] + added[row]
        now, speed = data.qpos[places].copy(), data.qvel[dofs].copy()
        # Whatever the recording knows nothing of (a gripper) is held.
        data.qpos[:], data.qvel[:] = rest, 0.0
        data.qpos[places], data.qvel[dofs] = now, speed
        mujoco.mj_step(model, data)
    kept = slice(round(SETTLING_S / step_s), None)
    far, more = (np.sqrt(np.mean(signal[kept] ** 2, axis=0)).tolist() for signal in (strayed, added))
    return Strayed(dict(zip(motion.joints, far)), dict(zip(motion.joints, more)))


def _inertia(mujoco: ModuleType, model: Any, motion: Motion, places: Any, dofs: Any) -> FloatArray:
    """(n,) diagonal of the mass matrix where a motion begins, kg m^2 or kg."""
    data, column, found = mujoco.MjData(model), np.zeros(model.nv), []
    data.qpos[places] = motion.position[0]
    mujoco.mj_forward(model, data)
    for unit in np.eye(model.nv)[dofs]:
        mujoco.mj_mulM(model, data, column, unit)
        found.append(float(column @ unit))
    return np.array(found)


def _at_steps(motion: Motion, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, n) position, velocity and torque at times after the first sample, s."""
    known = np.arange(len(motion.position)) / motion.rate_hz

    def at(signal: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(time, known, one) for one in signal.T])

    return at(motion.position), at(motion.velocity), at(motion.torque)
