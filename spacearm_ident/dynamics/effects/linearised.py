"""What a small further motion costs in torque: inverse dynamics, linearised about a recorded motion.

A compliance, an encoder error, a floating base move the arm a little beside what was recorded. The torque of that
little motion d(t) about an axis is M[:, a] d'' + C[:, a] d' + G[:, a] d, with the inertia and the gradients of the
model along the recording. The axis may be a joint's own or one that the arm does not have: a virtual joint is added
then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm, Joint
from ..background import Background
from ..regressor import rigid_body_torque

STEP = 1e-4
"""Half the central difference for the gradient, rad."""
POSTURES = 64
"""So many, the same at every call, are looked through for the least inertia."""
COARSE_HZ = 250.0
"""Inertias change slowly: they are computed at this rate and interpolated."""


@dataclass(frozen=True)
class Sensitivity:
    """Torque of a small motion about one axis.

    Attributes:
        rate_hz: Of the arrays below.
        inertia: (N, n) M[:, a], kg·m².
        coriolis: (N, n) d tau/dqd_a, N·m·s/rad.
        gradient: (N, n) d tau/dq_a, of gravity and of how inertial forces turn with the arm, N·m/rad.
        own_inertia: (N,) M[a, a].
        own_coriolis: (N,) d tau_a/dqd_a.
        own_gradient: (N,) d tau_a/dq_a.
        load: (N,) torque about the axis of the recorded motion, N·m.
    """

    rate_hz: float
    inertia: FloatArray
    coriolis: FloatArray
    gradient: FloatArray
    own_inertia: FloatArray
    own_coriolis: FloatArray
    own_gradient: FloatArray
    load: FloatArray

    def torque(self, motion: FloatArray, acceleration: FloatArray | None = None) -> FloatArray:
        """(N, n) torque of a small motion (N,) rad."""
        if acceleration is None:
            acceleration = np.gradient(np.gradient(motion)) * self.rate_hz**2
        velocity = np.gradient(motion) * self.rate_hz
        return np.asarray(
            self.inertia * acceleration[:, None] + self.coriolis * velocity[:, None] + self.gradient * motion[:, None]
        )


def by_position(motion: Motion, background: Background, joint: int) -> Sensitivity:
    """Sensitivity to a small motion of one of the arm's own joints; kept in `background`.

    Args:
        motion: N samples of n joints.
        background: What the rest of the model says of this motion; the arm and its inertials must be known.
        joint: Number of the joint, in the arm's order.
    """
    assert background.arm is not None
    arm = background.arm
    return background.keep(("position", joint), lambda: _sensitivity(motion, background, arm, joint, {}))  # type: ignore[no-any-return]


def by_virtual_joint(
    motion: Motion, background: Background, link: int, axis: tuple[float, ...], along: float = 0.0
) -> Sensitivity:
    """Sensitivity to a hinge that the arm does not have: in link `link` (-1: the base), about `axis`.

    Args:
        motion: What was recorded.
        background: What the model says of it.
        link: Number of the link.
        axis: In the link's frame.
        along: Where: 0 at the link's root, whose own mass then hangs on the hinge; else so much of the way to the next
            joint, and only what follows hangs on it.
    """
    assert background.arm is not None
    offset = along * next_joint(background.arm, link) if along else np.zeros(3)
    arm, places = with_virtual_joint(background.arm, link, np.array(axis, dtype=float), offset)
    return background.keep(  # type: ignore[no-any-return]
        ("virtual", link, axis, along), lambda: _sensitivity(motion, background, arm, link + 1, places, along == 0.0)
    )


def least_inertia(background: Background, joint: int) -> float:
    """Kg m² about a joint's own axis in the posture where that is least, of many.

    Args:
        background: With the healthy arm.
        joint: Its number.
    """
    arm, inertials = background.arm, background.inertials
    assert arm is not None and inertials is not None
    still = arm.with_gravity(np.zeros(3))

    def compute() -> float:
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSTURES, len(arm.joints)))
        unit = np.zeros_like(q)
        unit[:, joint] = 1.0
        return float(rigid_torque(still, inertials, q, None, unit)[:, joint].min())

    return background.keep(("least inertia", joint), compute)  # type: ignore[no-any-return]


def next_joint(arm: Arm, link: int) -> FloatArray:
    """(3,) m, where in the frame of a link the next joint is; zero where none follows.

    Args:
        arm: The arm.
        link: Its number, that of the joint that moves it.
    """
    return next((joint.translation for joint in arm.joints if joint.parent == link), np.zeros(3))


def with_virtual_joint(arm: Arm, link: int, axis: FloatArray, offset: FloatArray) -> tuple[Arm, dict[int, int]]:
    """The arm with a hinge in link `link`, at number `link + 1`.

    Args:
        arm: Arm of n joints.
        link: Number of the link; -1: the base.
        axis: (3,) axis of the hinge in the link's frame, of length 1.
        offset: (3,) position of the hinge in the link's frame, m.

    Returns:
        The arm, without couplings, and the new number of each joint by its old one. The joint `link` keeps its place;
        the hinge carries the joints that it carried.
    """
    places = {k: k if k <= link else k + 1 for k in range(len(arm.joints))}
    hinge = Joint("hinge", link, True, axis, np.eye(3), offset, np.zeros(10))
    joints: list[Joint] = []
    for k, joint in enumerate(arm.joints):
        if k == link + 1:
            joints.append(hinge)
        parent, translation = joint.parent, joint.translation
        if parent == link:
            parent, translation = link + 1, translation - offset
        else:
            parent = -1 if parent < 0 else places[parent]
        joints.append(replace(joint, parent=parent, translation=translation))
    if link + 1 == len(arm.joints):
        joints.append(hinge)
    return replace(arm, joints=tuple(joints), couplings=()), places


def rigid_torque(
    arm: Arm, inertials: FloatArray, q: FloatArray, qd: FloatArray | None = None, qdd: FloatArray | None = None
) -> FloatArray:
    """(N, n) torque of the rigid links, N·m (N where a joint slides).

    Args:
        arm: Arm of n joints, with gravity.
        inertials: (n, 10) inertial parameters of the links, SI.
        q: (N, n) rad or m.
        qd: (N, n) rad/s or m/s; zero unless given.
        qdd: (N, n) rad/s² or m/s²; zero unless given.
    """
    still = np.zeros_like(q)
    return rigid_body_torque(arm, inertials, q, still if qd is None else qd, still if qdd is None else qdd)


def _sensitivity(
    motion: Motion, background: Background, arm: Arm, axis: int, places: dict[int, int], whole: bool = True
) -> Sensitivity:
    """Computed on a coarse grid, then interpolated; `whole`: the link's own mass is beyond the hinge."""
    assert background.arm is not None and background.inertials is not None
    count = len(arm.joints)
    real = [places.get(k, k) for k in range(len(background.arm.joints))]
    inertials = np.zeros((count, 10))
    inertials[real] = background.inertials
    if count > len(real) and axis > 0 and whole:
        # What hung on the joint before the hinge hangs on the hinge.
        inertials[axis] = inertials[axis - 1]
        inertials[axis - 1] = 0.0
    step = max(1, int(motion.rate_hz / COARSE_HZ))
    some = slice(None, None, step)
    q = np.zeros((len(motion.position[some]), count))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    q[:, real], qd[:, real], qdd[:, real] = motion.position[some], motion.velocity[some], motion.acceleration[some]
    unit = np.zeros_like(q)
    unit[:, axis] = 1.0
    inertia = rigid_torque(arm.with_gravity(np.zeros(3)), inertials, q, None, unit)
    beside = STEP * unit
    gradient = rigid_torque(arm, inertials, q + beside, qd, qdd) - rigid_torque(arm, inertials, q - beside, qd, qdd)
    gradient /= 2 * STEP
    # Torque is quadratic in speed: this difference is no approximation.
    coriolis = 0.5 * (rigid_torque(arm, inertials, q, qd + unit) - rigid_torque(arm, inertials, q, qd - unit))
    load = rigid_torque(arm, inertials, q, qd, qdd)[:, axis]
    fine = np.arange(len(motion.position)) / step

    def spread(signal: FloatArray) -> FloatArray:
        return interpolate(signal, fine)

    return Sensitivity(
        motion.rate_hz,
        spread(inertia[:, real]),
        spread(coriolis[:, real]),
        spread(gradient[:, real]),
        spread(inertia[:, axis]),
        spread(coriolis[:, axis]),
        spread(gradient[:, axis]),
        spread(load),
    )


def interpolate(signal: FloatArray, at: FloatArray) -> FloatArray:
    """(N, ...) signal at fractional rows, linear.

    Args:
        signal: (N, ...).
        at: (M,) rows, fractions included.
    """
    low = np.minimum(at.astype(int), len(signal) - 1)
    high = np.minimum(low + 1, len(signal) - 1)
    part = (at - low).reshape(-1, *(1,) * (signal.ndim - 1))
    return np.asarray(signal[low] * (1 - part) + signal[high] * part)
