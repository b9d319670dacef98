"""What `real_pairs.py` puts into a real recording: wrong data, shortened data, and physics in real torque.

Laws and code are not the engine's: rigid-body torque is Pinocchio's, motion is differentiated here, and friction turns
round with tanh. A size is a multiple of a joint's healthy residual, which the bench measures without the engine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import Recording
from spacearm_ident.signals.prepare import prepare

SMOOTH_HZ = 8.0
"""Cut-off of the positions that are differentiated for planted torque."""
CREEP = 0.02
"""rad/s at which planted dry friction has three quarters of its level."""
CYCLES = 17.0
"""Of the planted ripple, a joint revolution: not in the grid of any effect's harmonic by design of the engine."""
PUSH_N = 60.0
"""Of the planted push, on the last link's origin, along x and z of the base, for the middle third of the recording."""


def differentiated(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, n) smoothed position, velocity and acceleration at the recording's own stamps, rad and seconds."""
    rate = recording.rate_hz
    grid = np.arange(recording.time[0], recording.time[-1], 1.0 / rate)
    even = make_interp_spline(recording.time, recording.position, k=1)(grid)
    smooth = sosfiltfilt(butter(4, SMOOTH_HZ, fs=rate, output="sos"), even, axis=0)
    spline = make_interp_spline(grid, smooth, k=5)
    at = np.clip(recording.time, grid[0], grid[-1])
    return spline(at), spline(at, 1), spline(at, 2)


def healthy_residual(arm: Arm, reference: Recording, field: Recording) -> FloatArray:
    """(n,) N·m RMS that `identify` on the reference leaves of the moving rows of the healthy field; 0 where none."""
    model = identify([reference], arm).model
    motions, _ = prepare([field], arm.joint_names, model.cutoff_hz)
    left = np.concatenate([motion.torque_rows - motion.reduce(model.torque(motion)) for motion in motions])
    moving = np.concatenate([motion.moving for motion in motions])
    count = np.maximum(moving.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.sum(np.where(moving, left, 0.0) ** 2, axis=0) / count))


def added(recording: Recording, torque: FloatArray) -> Recording:
    """The recording with torque (N, n) added to its effort, N·m."""
    return replace(recording, effort=recording.effort + torque)


def coulomb(recording: Recording, arm: Arm, joint: int, rms_Nm: float) -> Recording:
    """With more dry friction at one joint, of this RMS."""
    _, velocity, _ = differentiated(recording)
    shape = np.tanh(velocity[:, joint] / CREEP)
    return added(recording, _at(recording, joint, shape * rms_Nm / _rms(shape)))


def ripple(recording: Recording, arm: Arm, joint: int, rms_Nm: float) -> Recording:
    """With torque ripple over one joint's position, of this RMS."""
    position, _, _ = differentiated(recording)
    shape = np.sin(CYCLES * position[:, joint] + 0.7)
    return added(recording, _at(recording, joint, shape * rms_Nm / _rms(shape)))


def payload(recording: Recording, arm: Arm, joint: int, rms_Nm: float) -> Recording:
    """With a point mass on the last link, 8 cm along its z: what it adds at the joint named has this RMS."""
    model = pin.buildModelFromXML(arm.urdf)
    loaded = model.copy()
    body = pin.Inertia(1.0, np.array([0.0, 0.0, 0.08]), np.zeros((3, 3)))
    loaded.inertias[loaded.njoints - 1] = loaded.inertias[loaded.njoints - 1] + body
    motion = differentiated(recording)
    torque = _dynamics(loaded, arm, *motion) - _dynamics(model, arm, *motion)
    return added(recording, torque * rms_Nm / _rms(torque[:, joint]))


def push(recording: Recording, arm: Arm) -> Recording:
    """With a constant push on the last link's origin for the middle third of the recording."""
    model = pin.buildModelFromXML(arm.urdf)
    model.gravity.linear = np.array(arm.gravity)
    data, order = model.createData(), _order(model, arm)
    force, torque = np.array([PUSH_N, 0.0, PUSH_N]), np.zeros_like(recording.effort)
    first, last = (int(len(recording.time) * share) for share in (1 / 3, 2 / 3))
    for k in range(first, last):
        q = np.empty(model.nq)
        q[order] = recording.position[k]
        frame = pin.computeJointJacobians(model, data, q)
        frame = pin.getJointJacobian(model, data, model.njoints - 1, pin.LOCAL_WORLD_ALIGNED)
        torque[k] = -(frame[:3].T @ force)[order]
    return added(recording, torque)


def degrees(recording: Recording, joint: int) -> Recording:
    """With one joint's position (and velocity) in degrees."""
    factor = np.ones(len(recording.joints))
    factor[joint] = np.degrees(1.0)
    velocity = None if recording.velocity is None else recording.velocity * factor
    return replace(recording, position=recording.position * factor, velocity=velocity)


def exchanged(recording: Recording, one: int, other: int) -> Recording:
    """With two joints under each other's names."""
    joints = list(recording.joints)
    joints[one], joints[other] = joints[other], joints[one]
    return replace(recording, joints=tuple(joints))


def resting(recording: Recording, joint: int) -> Recording:
    """With one joint that neither moves nor feels anything but noise."""
    position, effort = recording.position.copy(), recording.effort.copy()
    rng = np.random.default_rng(joint)
    position[:, joint] = position[0, joint] + 1e-5 * rng.standard_normal(len(position))
    effort[:, joint] = effort[:, joint].mean() + 0.02 * rng.standard_normal(len(position))
    return replace(recording, position=position, velocity=None, effort=effort)


PLANTS: dict[str, Callable[[Recording, Arm, int, float], Recording]] = {
    "friction_drift": coulomb,
    "torque_ripple": ripple,
    "payload": payload,
}
"""By the name that is right: what plants it at a joint, with an RMS in N·m there."""


def _at(recording: Recording, joint: int, torque: FloatArray) -> FloatArray:
    whole = np.zeros_like(recording.effort)
    whole[:, joint] = torque
    return whole


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _order(model: pin.Model, arm: Arm) -> list[int]:
    """Where Pinocchio has each of the arm's joints."""
    return [model.joints[model.getJointId(name)].idx_q for name in arm.joint_names]


def _dynamics(
    model: pin.Model, arm: Arm, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """(N, n) inverse dynamics, N·m, in the order of the arm's joints."""
    model.gravity.linear = np.array(arm.gravity)
    data, order = model.createData(), _order(model, arm)
    torque = np.empty_like(position)
    for k in range(len(position)):
        q, v, a = np.zeros((3, model.nq))
        q[order], v[order], a[order] = position[k], velocity[k], acceleration[k]
        torque[k] = pin.rnea(model, data, q, v, a)[order]
    return torque
