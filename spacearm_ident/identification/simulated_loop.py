"""The arm simulated in closed loop: where a model's arm would be, told to follow a reference motion r.

The controller is what arm drives are: proportional in position and velocity, joint by joint, critically damped at a
bandwidth w of its own, with all the torque that the model knows fed forward but for dry friction, which no drive knows:

    tau = (all smooth torque at q, q', and at the acceleration r'') + K (r - q) + D (r' - q'),
    K = J w^2,  D = 2 J w,  J the mean inertia at the joint.

Put into the arm's equation of motion, everything smooth cancels. What is left is the tracking error e = r - q under the
one torque that is not fed forward:

    M(q) e'' + D e' + K e = F,   F in level(q') Sgn(q'),

so nothing has to be integrated but this. A step is implicit Euler's with friction implicit in the new velocity v
(Moreau's time stepping), the optimum of the convex 1/2 v'A v - b'v + h sum_i level_i |v_i|, A = M + h D + h^2 K, found
coordinate by coordinate; a joint that sticks comes out at exactly zero. Errors are milliradians, so M and the load on
the gears are taken along the reference. The loop forgets within a few 1/w how it began: the motion is cut into windows
that are simulated side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.coupling import CoupledMotor
from ..dynamics.friction import StribeckFriction
from ..dynamics.model import TorqueModel
from ..dynamics.rigid_body import RigidBody, RotorInertia
from ..signals.motion import Motion

INERTIA_EVERY_S = 0.02
"""How often along the reference the inertia is computed."""
WINDOW_S = 1.0
"""The motion is cut into windows of this length, so that a step is taken in all of them at once."""
MEMORY = 12.0
"""A window begins so many 1/w early: of how it began, less than 1e-4 is left by then."""
MOST_SWEEPS = 60
SWEEP_TOLERANCE = 1e-10
"""A velocity that changes by less than this in a sweep has settled, rad/s."""
INERTIAL = (RigidBody.kind, RotorInertia.kind, CoupledMotor.kind)


@dataclass(frozen=True)
class _Dry:
    """Dry friction of all joints, (n,) each: f_c, f_b - f_c, 1/v_b (0: none), mu."""

    coulomb: FloatArray
    excess: FloatArray
    slowness: FloatArray
    by_load: FloatArray

    def level(self, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """(n,) N·m that hold a joint, or brake it."""
        ratio = velocity * self.slowness
        return self.coulomb + self.excess * np.exp(-ratio * ratio) + self.by_load * load


def sampled(joints: Sequence[str], rate_hz: float, position: FloatArray) -> Motion:
    """A motion known by its positions alone, its derivatives by central differences; no torque.

    Args:
        joints: Names of the n joints.
        rate_hz: Sampling rate, Hz.
        position: (N, n) rad or m.
    """
    velocity = np.gradient(position, 1.0 / rate_hz, axis=0)
    acceleration = np.gradient(velocity, 1.0 / rate_hz, axis=0)
    return Motion.free_of_noise(tuple(joints), rate_hz, position, velocity, acceleration)


def follow(
    model: TorqueModel, parameters: FloatArray, constants: FloatArray, reference: Motion, bandwidth_hz: FloatArray
) -> FloatArray:
    """(N, n) positions of the arm on its way along a reference.

    Args:
        model: Terms; their dry friction is what the controller does not know.
        parameters: (p,) values, physically consistent.
        constants: (c,) values.
        reference: What it is told to do; the arm starts on it.
        bandwidth_hz: (n,) of the joints' critically damped loops, w / 2 pi.
    """
    dry = _dry_friction(model, parameters, constants)
    load = np.abs(model.torque(reference, parameters, constants, (RigidBody.kind,)))
    every = max(1, round(INERTIA_EVERY_S * reference.rate_hz))
    inertia = _inertia(model, parameters, constants, reference.position[::every])
    return reference.position - _tracking_error(reference, dry, load, inertia, every, 2.0 * np.pi * bandwidth_hz)


def _dry_friction(model: TorqueModel, parameters: FloatArray, constants: FloatArray) -> _Dry:
    """Dry friction of the joints' own friction terms; one that falls below zero is none."""
    values = np.zeros((4, len(model.arm.joints)))
    for term, first, constant in model.numbered():
        if isinstance(term, StribeckFriction):
            joint = model.arm.joint_names.index(term.parameters[0].joint)
            f_c, f_b = parameters[first : first + 2]
            v_b = constants[constant]
            mu = parameters[first + 2] if term.loaded else 0.0
            values[:, joint] = (
                max(f_c, 0.0),
                max(f_b - f_c, 0.0) if v_b > 0 else 0.0,
                1.0 / v_b if v_b > 0 else 0.0,
                max(mu, 0.0),
            )
    return _Dry(*values)


def _inertia(model: TorqueModel, parameters: FloatArray, constants: FloatArray, position: FloatArray) -> FloatArray:
    """(K, n, n) joint-space inertia, rotors included, at positions (K, n)."""
    joints = position.shape[1]

    def torque(joint: int | None) -> FloatArray:
        acceleration = np.zeros_like(position)
        if joint is not None:
            acceleration[:, joint] = 1.0
        motion = Motion.free_of_noise(model.arm.joint_names, 1.0, position, np.zeros_like(position), acceleration)
        return model.torque(motion, parameters, constants, INERTIAL)

    at_rest = torque(None)
    return np.stack([torque(joint) - at_rest for joint in range(joints)], axis=2)


def _tracking_error(
    reference: Motion, dry: _Dry, load: FloatArray, inertia: FloatArray, every: int, omega: FloatArray
) -> FloatArray:
    """(N, n) how far the arm is behind its reference, rad; all windows of the motion are simulated side by side."""
    h = 1.0 / reference.rate_hz
    own = np.diagonal(inertia, axis1=1, axis2=2).mean(axis=0)
    stiffness, damping = np.asarray(own * omega**2), np.asarray(2.0 * own * omega)
    implicit = inertia + np.diag(h * damping + h**2 * stiffness)
    inverse = np.asarray(np.linalg.inv(implicit), dtype=np.float64)
    samples, joints = reference.velocity.shape
    length, before = round(WINDOW_S / h), round(MEMORY / omega.min() / h)
    starts = np.arange(0, samples, length)
    errors = np.zeros((len(starts) * length, joints))
    error, rate = np.zeros((len(starts), joints)), np.zeros((len(starts), joints))
    velocity = reference.velocity[np.maximum(starts - before, 0)]
    for k in range(-before, length):
        now = np.clip(starts + k, 0, samples - 1)
        wanted, here = reference.velocity[now], now // every
        bound = h * dry.level(velocity, load[now])
        # Without friction the error would change at this rate, and the arm move at that velocity.
        momentum = _times(inertia[here], rate) - h * stiffness * error
        free = wanted - _times(inverse[here], momentum)
        after = free - _times(inverse[here], bound * np.sign(velocity))
        stuck = ~((after * velocity > 0.0) | (bound == 0.0)).all(axis=1)
        if stuck.any():
            system = implicit[here[stuck]]
            after[stuck] = _stick_or_slip(system, _times(system, free[stuck]), bound[stuck], velocity[stuck])
        rate, velocity = wanted - after, after
        error = error + h * rate
        if k >= 0:
            errors[starts + k] = error
    return errors[:samples]


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """(w, n) products of (w, n, n) and (w, n)."""
    return np.asarray(np.einsum("wij,wj->wi", matrices, vectors))


def _stick_or_slip(inertia: FloatArray, momentum: FloatArray, bound: FloatArray, guess: FloatArray) -> FloatArray:
    """(w, n) velocities that minimise 1/2 v'M v - momentum'v + bound'|v|, by coordinate descent from a guess."""
    velocity = guess.copy()
    for _ in range(MOST_SWEEPS):
        before = velocity.copy()
        for joint in range(velocity.shape[1]):
            own = inertia[:, joint, joint]
            pull = momentum[:, joint] - np.einsum("wi,wi->w", inertia[:, joint], velocity) + own * velocity[:, joint]
            velocity[:, joint] = np.sign(pull) * np.maximum(np.abs(pull) - bound[:, joint], 0.0) / own
        if np.abs(velocity - before).max() < SWEEP_TOLERANCE:
            break
    return velocity
