"""The joint-torque regressor with its reverse derivative: what one number made of it gains by every joint state.

`dynamics.regressor` gives the columns Y(q, qd, qdd); an optimiser also needs, for a scalar f of all of them with
A = df/dY known, df/dq, df/dqd and df/dqdd. Reverse accumulation (Griewank and Walther 2008, ch. 3) costs about two
more evaluations of the columns, whatever the number of joints; differences would cost three a joint. So the forward
recursion is written again here in the form that keeps what the way back needs. With the notation of
`dynamics.regressor`, one link's row contracted with its share of A (A_m, A_c, and A_I as a symmetric matrix M) is

    S = A_m l.a + A_c.[ l x e + o x (o x l) + a x w ] + w.(M e) + (w x o).(M o).

Vectors are (3, T); those of a link's k supporting joints are stacked, (3, k, T), and outside the recursion those of all
K pairs of a link and a joint that carries it, (3, K, T): at the few samples of a descent numpy's calls cost more than
its arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm, Joint
from ..dynamics.regressor import INERTIA_PAIRS, cross, link_columns, times, times_transposed
from .segments import Motion


@dataclass
class _Link:
    """Forward quantities of one link, and the derivatives by them as they come in."""

    joint: Joint
    supports: tuple[int, ...]
    rotation: FloatArray
    origin: FloatArray
    omega: FloatArray
    epsilon: FloatArray
    accel: FloatArray
    linear: FloatArray
    angular: FloatArray
    # Parts that the rotation brought from the parent, before this joint's own motion was added.
    omega_in: FloatArray
    epsilon_in: FloatArray
    accel_in: FloatArray


class _Pairs(NamedTuple):
    """Forward quantities of K pairs of a link and a joint that carries it, (3, K, T) each: the link's, its twists."""

    omega: FloatArray
    epsilon: FloatArray
    accel: FloatArray
    linear: FloatArray
    angular: FloatArray


class DifferentiableRegressor:
    """The columns of an arm at T states, and the way back from them.

    Attributes:
        rows: (K,) joint of each pair of a joint and a link that it carries, link by link.
        links: (K,) its link.
    """

    def __init__(self, arm: Arm, motion: Motion) -> None:
        """Compute the columns of `motion` (T, n)."""
        self.arm = arm
        self._speed = motion.qd
        self._rate = motion.qdd
        self._links: list[_Link] = []
        samples = len(motion.q)
        zero = np.zeros((3, samples))
        gravity = np.tile(-arm.gravity[:, None], samples)
        none = np.zeros((3, 0, samples))
        root = (zero, zero, gravity, none, none)
        for index, joint in enumerate(arm.joints):
            parent = root if joint.parent < 0 else self._state(joint.parent)
            supports = (index,) if joint.parent < 0 else (*self._links[joint.parent].supports, index)
            state = (motion.q[:, index], motion.qd[:, index], motion.qdd[:, index])
            self._links.append(_forward(joint, supports, parent, *state))
        counts = [len(link.supports) for link in self._links]
        self._first = np.concatenate([[0], np.cumsum(counts)])
        self.rows = np.concatenate([link.supports for link in self._links]).astype(np.intp)
        self.links = np.repeat(np.arange(len(counts)), counts)
        self._pairs = _Pairs(
            *(
                np.stack([getattr(link, name) for link in self._links], axis=1)[:, self.links]
                for name in ("omega", "epsilon", "accel")
            ),
            *(np.concatenate([getattr(link, name) for link in self._links], axis=1) for name in ("linear", "angular")),
        )

    def _state(self, link: int) -> tuple[FloatArray, ...]:
        known = self._links[link]
        return known.omega, known.epsilon, known.accel, known.linear, known.angular

    def columns(self) -> FloatArray:
        """(10, K, T) columns of each pair's link in the row of its joint."""
        return link_columns(*self._pairs)

    def back(self, adjoint: FloatArray) -> Motion:
        """Derivatives by the states, (T, n) each, from those by the columns, (10, K, T)."""
        samples, joints = self._speed.shape
        out = Motion(*(np.zeros((samples, joints)) for _ in range(3)))
        by_link, by_twist = _contract(self._pairs, adjoint)
        summed = [np.add.reduceat(part, self._first[:-1], axis=1) for part in by_link]
        own = [slice(*ends) for ends in pairwise(self._first.tolist())]
        pending = [
            [*(part[:, link] for part in summed), *(part[:, own[link]] for part in by_twist)] for link in range(joints)
        ]
        for index in range(joints - 1, -1, -1):
            joint = self.arm.joints[index]
            parent = None if joint.parent < 0 else self._links[joint.parent]
            known = None if parent is None else (parent.omega, parent.epsilon, parent.linear, parent.angular)
            carried = _backward(self._links[index], pending[index], known, self._speed, self._rate, index, out)
            if joint.parent >= 0:
                pending[joint.parent] = [a + b for a, b in zip(pending[joint.parent], carried)]
        return out


def _forward(
    joint: Joint,
    supports: tuple[int, ...],
    parent: tuple[FloatArray, ...],
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
) -> _Link:
    """One step outwards; as `dynamics.regressor`, with the twists stacked."""
    omega, epsilon, accel, linear, angular = parent
    axis, ones = joint.axis[:, None], np.ones_like(q)
    if joint.revolute:
        x, y, z = joint.axis
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        along = np.outer(joint.axis, joint.axis)
        turned = (np.eye(3) - along)[..., None] * np.cos(q) + skew[..., None] * np.sin(q) + along[..., None]
        rotation = np.einsum("ij,jkt->ikt", joint.rotation, turned)
        origin = np.tile(joint.translation[:, None], len(q))
    else:
        rotation = np.tile(joint.rotation[..., None], len(q))
        origin = joint.translation[:, None] + (joint.rotation @ joint.axis)[:, None] * q
    omega_in, epsilon_in = times_transposed(rotation, omega), times_transposed(rotation, epsilon)
    moved = accel + cross(epsilon, origin) + cross(omega, cross(omega, origin))
    accel_in = times_transposed(rotation, moved)
    linear_in = times_transposed(rotation[:, :, None], linear + cross(angular, origin[:, None]))
    angular_in = times_transposed(rotation[:, :, None], angular)
    own = (axis * ones)[:, None]
    nothing = np.zeros_like(own)
    omega_out, epsilon_out, accel_out = omega_in, epsilon_in, accel_in
    if joint.revolute:
        epsilon_out = epsilon_in + axis * qdd + cross(omega_in, axis * qd)
        omega_out = omega_in + axis * qd
        twist = (nothing, own)
    else:
        accel_out = accel_in + axis * qdd + 2 * cross(omega_in, axis * qd)
        twist = (own, nothing)
    return _Link(
        joint, supports, rotation, origin, omega_out, epsilon_out, accel_out,
        np.concatenate([linear_in, twist[0]], axis=1), np.concatenate([angular_in, twist[1]], axis=1),
        omega_in, epsilon_in, accel_in,
    )  # fmt: skip


def _contract(pairs: _Pairs, adjoint: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Derivatives of S by omega, epsilon, accel, and by linear and angular, (3, K, T) each."""
    o, e, a, linear, w = pairs
    mass, moment = adjoint[0], adjoint[1:4]
    inertia = np.empty((3, 3, *adjoint.shape[1:]))
    for row, (i, j) in enumerate(INERTIA_PAIRS, start=4):
        inertia[i, j] = inertia[j, i] = adjoint[row]
    spun = times(inertia, o)
    by_omega = (
        cross(cross(o, linear), moment) + cross(linear, cross(moment, o)) + cross(spun, w) + times(inertia, cross(w, o))
    )
    by_epsilon = cross(moment, linear) + times(inertia, w)
    by_accel = mass * linear + cross(w, moment)
    by_linear = mass * a + cross(e, moment) + cross(o, cross(o, moment))
    by_angular = cross(moment, a) + times(inertia, e) + cross(o, spun)
    return [by_omega, by_epsilon, by_accel], [by_linear, by_angular]


def _backward(
    link: _Link,
    incoming: list[FloatArray],
    parent: tuple[FloatArray, ...] | None,
    speed: FloatArray,
    rate: FloatArray,
    index: int,
    out: Motion,
) -> list[FloatArray]:
    """One step inwards: adds to the joint's own derivatives in `out`, returns those by the parent's quantities."""
    omega, epsilon, accel, linear, angular = incoming
    joint, axis = link.joint, link.joint.axis[:, None]
    qd = speed[:, index]
    # The joint's own motion.
    if joint.revolute:
        out.qdd[:, index] = (axis * epsilon).sum(axis=0)
        out.qd[:, index] = (axis * omega).sum(axis=0) + (cross(link.omega_in, axis) * epsilon).sum(axis=0)
        omega = omega + cross(axis * qd, epsilon)
    else:
        out.qdd[:, index] = (axis * accel).sum(axis=0)
        out.qd[:, index] = 2 * (cross(link.omega_in, axis) * accel).sum(axis=0)
        omega = omega + 2 * cross(axis * qd, accel)
    linear, angular = linear[:, :-1], angular[:, :-1]
    if joint.revolute:
        # v_child = R' v_parent turns by -axis x v_child a radian.
        turned = cross(link.omega_in, omega) + cross(link.epsilon_in, epsilon) + cross(link.accel_in, accel)
        turned += (cross(link.linear[:, :-1], linear) + cross(link.angular[:, :-1], angular)).sum(axis=1)
        out.q[:, index] = -(axis * turned).sum(axis=0)
    rotation, origin = link.rotation, link.origin
    omega, epsilon, accel = (times(rotation, v) for v in (omega, epsilon, accel))
    linear, angular = (times(rotation[:, :, None], v) for v in (linear, angular))
    if parent is not None:
        o, e, _, w = parent
        if not joint.revolute:
            slide = (joint.rotation @ joint.axis)[:, None]
            by_origin = cross(accel, e) + cross(o, cross(o, accel)) + cross(linear, w).sum(axis=1)
            out.q[:, index] = (slide * by_origin).sum(axis=0)
        omega = omega + cross(cross(o, origin), accel) + cross(origin, cross(accel, o))
        epsilon = epsilon + cross(origin, accel)
        angular = angular + cross(origin[:, None], linear)
    return [omega, epsilon, accel, linear, angular]
