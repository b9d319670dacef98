"""The joint-torque regressor of a rigid chain, for all samples at once.

tau = Y(q, qd, qdd) phi, phi = [m, m·c, I] of every link about its joint frame (Pinocchio's order: m, mcx, mcy,
mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz). Row j of link i's block is the power of joint j's twist in the Newton-Euler
wrench of link i. With the twist of joint j seen in frame i as (l, w), link i's origin acceleration a (gravity
included), its angular velocity o and angular acceleration e,

    row . phi = m l.a + (m c).[ l x e + o x (o x l) + a x w ] + w.(I e) + (w x o).(I o)

(Featherstone 2008, ch. 5; Atkeson, An and Hollerbach 1986, eq. 12). Every term is a product of vectors known for
all samples, so there is no loop over time. Vectors are held as (3, N), one row a coordinate.

A moving base changes where the recursion starts and nothing else: from its angular velocity and acceleration and its
specific force instead of rest and minus gravity. Its own six rows, the wrench that would have to hold the base, come
from six more twists (Dubowsky and Papadopoulos 1993): on a free base that wrench is zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..signals.base_motion import BaseMotion
from .arm import Arm, Joint

INERTIAL_SYMBOLS = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True)
class _LinkMotion:
    """A link's motion in its own joint frame, and where that frame is in its carrier's; (3, N), one sample for all."""

    omega: FloatArray
    epsilon: FloatArray
    accel: FloatArray
    rotation: FloatArray
    origin: FloatArray


@dataclass(frozen=True)
class _Twists:
    """Twists of R rows seen in one frame; linear and angular (3, R, N), N one sample for all."""

    rows: tuple[int, ...]
    linear: FloatArray
    angular: FloatArray


BASE_ROWS = range(-6, 0)
"""Rows of the base: force and moment at the base link's origin, in its axes."""
BASE_LINK = -1
INERTIA_PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Row and column of the inertia, in the order of `INERTIAL_SYMBOLS`."""


def rigid_body_blocks(
    arm: Arm,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    base: BaseMotion | None = None,
    *,
    base_rows: bool = False,
) -> dict[tuple[int, int], FloatArray]:
    """The regressor's non-zero blocks.

    Args:
        arm: Arm of n joints.
        position: (N, n) rad or m.
        velocity: (N, n) rad/s or m/s.
        acceleration: (N, n) rad/s^2 or m/s^2.
        base: Motion of the base; fixed where None.
        base_rows: Whether the `BASE_ROWS` are wanted too, with the base link's own block.

    Returns:
        (joint row, link) -> (10, N) columns, one row a parameter, N·m (N) per unit of it. A base row is numbered as
        in `BASE_ROWS`, the base link `BASE_LINK`.
    """
    root = _base_motion(arm, len(position), base)
    motions = {BASE_LINK: root} | dict(enumerate(_link_motions(arm, root, position, velocity, acceleration)))
    twists = {BASE_LINK: _base_twists(base_rows)}
    blocks: dict[tuple[int, int], FloatArray] = {}
    for link, motion in motions.items():
        if link != BASE_LINK:
            twists[link] = _twists_in_child(twists[max(arm.joints[link].parent, BASE_LINK)], motion, link, arm)
        # All rows at once: with few samples a call of numpy costs more than what it computes.
        omega, epsilon, accel = (vector[:, None] for vector in (motion.omega, motion.epsilon, motion.accel))
        columns = link_columns(omega, epsilon, accel, twists[link].linear, twists[link].angular)
        blocks.update({(row, link): columns[:, k] for k, row in enumerate(twists[link].rows)})
    return blocks


def rigid_body_torque(
    arm: Arm,
    inertials: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    base: BaseMotion | None = None,
) -> FloatArray:
    """(N, n) torque of links whose inertials (n, 10) are known, N·m: the regressor times them, sooner.

    Recursive Newton-Euler (Luh, Walker and Paul 1980): motions from the base to the tip, wrenches back.

    Args:
        arm: The arm.
        inertials: (n, 10) of each link about its joint's frame, in Pinocchio's order; SI.
        position: (N, n) rad or m.
        velocity: (N, n) rad/s or m/s.
        acceleration: (N, n) rad/s² or m/s².
        base: Motion of the base; None: it stands still.
    """
    torque = np.zeros((len(arm.joints), len(position)))
    root = _base_motion(arm, len(position), base)
    motions = _link_motions(arm, root, position, velocity, acceleration)
    carried: dict[int, tuple[FloatArray, FloatArray]] = {}
    for link in reversed(range(len(arm.joints))):
        joint, motion, phi = arm.joints[link], motions[link], inertials[link]
        if link not in carried and not phi.any():
            continue
        force, moment = carried.get(link, (np.zeros(1), np.zeros(1)))
        if phi.any():
            own_force, own_moment = _wrench(phi, motion)
            force, moment = force + own_force, moment + own_moment
        torque[link] = joint.axis @ (moment if joint.revolute else force)
        if joint.parent >= 0:
            force = times(motion.rotation, force)
            moment = times(motion.rotation, moment) + cross(motion.origin, force)
            beside = carried.get(joint.parent)
            carried[joint.parent] = (force, moment) if beside is None else (beside[0] + force, beside[1] + moment)
    return torque.T


def _link_motions(
    arm: Arm, root: _LinkMotion, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> list[_LinkMotion]:
    """All links' motions, base to tip."""
    motions: list[_LinkMotion] = []
    for link, joint in enumerate(arm.joints):
        carrier = root if joint.parent < 0 else motions[joint.parent]
        motions.append(_child_motion(joint, carrier, position[:, link], velocity[:, link], acceleration[:, link]))
    return motions


def _base_motion(arm: Arm, samples: int, base: BaseMotion | None) -> _LinkMotion:
    """Where the recursion starts."""
    place = np.eye(3)[:, :, None], np.zeros((3, 1))
    if base is None:
        still = np.zeros((3, samples))
        return _LinkMotion(still, still, np.tile(-arm.gravity[:, None], samples), *place)
    return _LinkMotion(base.rate.T, base.rate_dot.T, base.force(arm.gravity).T, *place)


def _base_twists(wanted: bool) -> _Twists:
    """The base's own six twists; none where its rows are not wanted."""
    if not wanted:
        return _Twists((), *np.zeros((2, 3, 0, 1)))
    axes = np.eye(6)[:, :, None]
    return _Twists(tuple(BASE_ROWS), axes[:3], axes[3:])


def _twists_in_child(carrier: _Twists, motion: _LinkMotion, link: int, arm: Arm) -> _Twists:
    """The twists of a carrier's frame in a link's, then that of the link's own joint."""
    joint, count = arm.joints[link], len(carrier.rows)
    rotation, origin = motion.rotation[:, :, None], motion.origin[:, None]
    linear, angular = np.zeros((2, 3, count + 1, motion.omega.shape[1]))
    linear[:, :count] = times_transposed(rotation, carrier.linear + cross(carrier.angular, origin))
    angular[:, :count] = times_transposed(rotation, carrier.angular)
    (angular if joint.revolute else linear)[:, count] = joint.axis[:, None]
    return _Twists((*carrier.rows, link), linear, angular)


def regressor(
    arm: Arm, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, base: BaseMotion | None = None
) -> FloatArray:
    """The whole joint-torque regressor, (N, n, 10 n), in N·m per SI unit of each inertial parameter.

    Args:
        arm: The arm.
        position: (N, n) rad or m.
        velocity: (N, n) rad/s or m/s.
        acceleration: (N, n) rad/s² or m/s².
        base: Motion of the base; fixed where None.
    """
    samples, joints = position.shape
    whole = np.zeros((joints, 10 * joints, samples))
    for (row, link), block in rigid_body_blocks(arm, position, velocity, acceleration, base).items():
        whole[row, 10 * link : 10 * link + 10] = block
    return whole.transpose(2, 0, 1)


def _child_motion(joint: Joint, carrier: _LinkMotion, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> _LinkMotion:
    """Forward recursion over one joint, velocities and accelerations expressed in the child's frame."""
    axis = joint.axis[:, None]
    rotation, origin = joint_placement(joint, q)
    omega = times_transposed(rotation, carrier.omega)
    epsilon = times_transposed(rotation, carrier.epsilon)
    accel = times_transposed(
        rotation,
        carrier.accel + cross(carrier.epsilon, origin) + cross(carrier.omega, cross(carrier.omega, origin)),
    )
    if joint.revolute:
        epsilon = epsilon + axis * qdd + cross(omega, axis * qd)
        omega = omega + axis * qd
    else:
        accel = accel + axis * qdd + 2 * cross(omega, axis * qd)
    return _LinkMotion(omega, epsilon, accel, rotation, origin)


def joint_placement(joint: Joint, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3, 3, N or 1) child to parent, and (3, N or 1) its origin there, m; turned by Rodrigues' formula about the axis.

    Args:
        joint: With its fixed placement.
        q: (N,) rad or m.
    """
    origin = joint.translation[:, None]
    if not joint.revolute:
        return joint.rotation[:, :, None], origin + (joint.rotation @ joint.axis)[:, None] * q
    x, y, z = joint.axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    along = joint.rotation @ np.outer(joint.axis, joint.axis)
    parts = np.stack([joint.rotation - along, joint.rotation @ skew, along], axis=2)
    turned = parts.reshape(9, 3) @ np.stack([np.cos(q), np.sin(q), np.ones_like(q)])
    return turned.reshape(3, 3, -1), origin


def times_transposed(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Transposes of matrices (3, 3, N or 1) times vectors (3, N): of rotations, from the carrier to the child.

    Args:
        matrix: One rotation a sample, or one for all; (3, 3, 1, N or 1) for several vectors a sample.
        vector: Coordinates first; (3, k, N) for k vectors a sample.
    """
    return np.asarray(matrix[0] * vector[0] + matrix[1] * vector[1] + matrix[2] * vector[2])


def times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Matrices (3, 3, N or 1) times vectors (3, N): of rotations, from the child to the carrier.

    Args:
        matrix: One matrix a sample, or one for all.
        vector: One vector a sample, coordinates first; of a rotation's, in the child's axes.
    """
    return np.asarray(matrix[:, 0] * vector[0] + matrix[:, 1] * vector[1] + matrix[:, 2] * vector[2])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product along the first axis, the others broadcast; many times faster than `numpy.cross`.

    Args:
        a: (3, ...) left factor.
        b: (3, ...) right factor, broadcast with `a`.
    """
    first = a[1] * b[2] - a[2] * b[1]
    out = np.empty((3, *first.shape))
    out[0] = first
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


def _wrench(phi: FloatArray, motion: _LinkMotion) -> tuple[FloatArray, FloatArray]:
    """(3, N) force, and moment about its frame's origin, that carry a link of inertials `phi` (10,)."""
    omega, epsilon, accel = motion.omega, motion.epsilon, motion.accel
    first = phi[1:4, None]
    inertia = phi[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3)
    force = phi[0] * accel + cross(epsilon, first) + cross(omega, cross(omega, first))
    return force, cross(first, accel) + inertia @ epsilon + cross(omega, inertia @ omega)


def link_columns(
    omega: FloatArray, epsilon: FloatArray, accel: FloatArray, linear: FloatArray, angular: FloatArray
) -> FloatArray:
    """(10, R, N) columns of links in the rows of twists seen in their frames; the formula of the module's head.

    Args:
        omega: (3, R or 1, N) angular velocity of the link.
        epsilon: (3, R or 1, N) angular acceleration.
        accel: (3, R or 1, N) acceleration of its origin, gravity included.
        linear: (3, R, N) part of the twist.
        angular: (3, R, N) part of the twist.
    """
    twist_x_omega = cross(angular, omega)
    columns = np.empty((10, *twist_x_omega.shape[1:]))
    columns[0] = linear[0] * accel[0] + linear[1] * accel[1] + linear[2] * accel[2]
    columns[1:4] = cross(linear, epsilon) + cross(omega, cross(omega, linear)) + cross(accel, angular)
    for row, (i, j) in enumerate(INERTIA_PAIRS, start=4):
        columns[row] = angular[i] * epsilon[j] + twist_x_omega[i] * omega[j]
        if i != j:
            columns[row] += angular[j] * epsilon[i] + twist_x_omega[j] * omega[i]
    return columns
