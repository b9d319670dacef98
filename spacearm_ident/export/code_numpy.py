"""A Python module of an identified arm that needs numpy alone: the law of `code_c` for one state or many at once."""

from __future__ import annotations

from .controller import ControlLaw
from .template import docstring_lines, fields_of, filled, identifier, literal
from .thresholds import Thresholds

TEMPLATE = '''"""@NOTES@

Arrays end in the joints (@JOINTS@): (n,) or (..., n). SI units, torque on the output side.
"""

import numpy as np

JOINTS = @NAMES@
PARENT = @PARENT@
REVOLUTE = @REVOLUTE@
AXIS = np.array(@AXIS@)
PLACE = np.array(@PLACE@)  # joint frame to parent frame at zero
ORIGIN = np.array(@ORIGIN@)
GRAVITY = np.array(@GRAVITY@)
INERTIALS = np.array(@INERTIALS@)  # m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint frames
J_M, K_1, OFFSET, F_C, F_B, V_B, MU, K_V1, K_V2_EVEN, K_V2_ODD, K_V3, FASTEST = np.array(@NUMBERS@)
MOTORS = np.array(@MOTORS@).reshape(-1, len(JOINTS) + 3)  # ratios, J_m, k_v1, f_c of coupled motors
ZERO_SPEED = @ZERO@  # rad/s (m/s)
TENSOR = [[4, 5, 7], [5, 6, 8], [7, 8, 9]]


def _forward(q, qd, qdd):
    """Rotation, origin, angular velocity and acceleration, acceleration less gravity of every link, base to tip."""
    links = []
    for i, x in enumerate(AXIS):
        if PARENT[i] < 0:
            w = e = np.zeros(q.shape[:-1] + (3,))
            a = np.broadcast_to(-GRAVITY, w.shape)
        else:
            w, e, a = links[PARENT[i]][2:]
        angle, speed, accel = (values[..., i, None] for values in (q, qd, qdd))
        rotation, origin = np.broadcast_to(PLACE[i], q.shape[:-1] + (3, 3)), np.broadcast_to(ORIGIN[i], w.shape)
        if REVOLUTE[i]:
            skew = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
            c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
            rotation = PLACE[i] @ (c * np.eye(3) + s * skew + (1 - c) * np.outer(x, x))
        else:
            origin = origin + (PLACE[i] @ x) * angle
        a = a + np.cross(e, origin) + np.cross(w, np.cross(w, origin))
        w, e, a = (np.einsum("...ji,...j->...i", rotation, vector) for vector in (w, e, a))
        if REVOLUTE[i]:
            e = e + x * accel + np.cross(w, x) * speed
            w = w + x * speed
        else:
            a = a + x * accel + 2 * np.cross(w, x) * speed
        links.append((rotation, origin, w, e, a))
    return links


def _wrench(link, body):
    """Force, and moment about its origin, that carry a body along with its link."""
    _, _, w, e, a = link
    c, inertia = body[1:4], body[TENSOR]
    f = body[0] * a + np.cross(e, c) + np.cross(w, np.cross(w, c))
    return f, np.cross(c, a) + e @ inertia + np.cross(w, w @ inertia)


def _carry(link, f, n):
    """A wrench from a link's frame into its parent's."""
    rotation, origin = link[:2]
    f, n = (np.einsum("...ij,...j->...i", rotation, vector) for vector in (f, n))
    return f, n + np.cross(origin, f)


def bodies(q, qd, qdd):
    """Torque of the rigid bodies alone."""
    q, qd, qdd = (np.asarray(values, dtype=float) for values in (q, qd, qdd))
    links = _forward(q, qd, qdd)
    wrenches = [_wrench(link, body) for link, body in zip(links, INERTIALS)]
    tau = np.zeros(q.shape)
    for i in reversed(range(len(JOINTS))):
        f, n = wrenches[i]
        tau[..., i] = (n if REVOLUTE[i] else f) @ AXIS[i]
        if PARENT[i] >= 0:
            more = _carry(links[i], f, n)
            wrenches[PARENT[i]] = tuple(one + other for one, other in zip(wrenches[PARENT[i]], more))
    return tau


def regressor(q, qd, qdd):
    """(..., n, 10 n) Y with bodies(q, qd, qdd) = Y @ INERTIALS.ravel()."""
    q, qd, qdd = (np.asarray(values, dtype=float) for values in (q, qd, qdd))
    links = _forward(q, qd, qdd)
    whole = np.zeros(q.shape + (10 * len(JOINTS),))
    for i in range(len(JOINTS)):
        for k, unit in enumerate(np.eye(10)):
            f, n = _wrench(links[i], unit)
            j = i
            while j >= 0:
                whole[..., j, 10 * i + k] = (n if REVOLUTE[j] else f) @ AXIS[j]
                f, n = _carry(links[j], f, n)
                j = PARENT[j]
    return whole


def _friction(v, sign, load):
    speed = np.abs(v)
    slow = np.minimum(speed, FASTEST)
    stribeck = np.where(V_B > 0, np.exp(-((v / np.where(V_B > 0, V_B, 1.0)) ** 2)), 0.0)
    level = F_C + (F_B - F_C) * stribeck + MU * np.abs(load)
    return sign * level + K_V1 * v + K_V2_EVEN * slow * speed + K_V2_ODD * slow * v + K_V3 * slow**2 * v


def torque(q, qd, qdd):
    """Joint torque; sgn(0) is 0."""
    q, qd, qdd = (np.asarray(values, dtype=float) for values in (q, qd, qdd))
    rigid = bodies(q, qd, qdd)
    tau = rigid + J_M * qdd + K_1 * q + OFFSET + _friction(qd, np.sign(qd), rigid)
    for *ratio, inertia, viscous, coulomb in MOTORS:
        speed = qd @ ratio
        effort = inertia * (qdd @ ratio) + viscous * speed + coulomb * np.sign(speed)
        tau = tau + effort[..., None] * np.array(ratio)
    return tau


def gravity(q):
    """Torque that holds the arm still: bodies, springs and offsets; no friction."""
    q = np.asarray(q, dtype=float)
    still = np.zeros_like(q)
    return bodies(q, still, still) + K_1 * q + OFFSET


def friction(q, qd, zero_speed=ZERO_SPEED):
    """Friction to be added to a controller's torque.

    In place of sgn(qd) it has qd / zero_speed between -1 and 1: zero at zero speed, without a jump; at standstill
    nothing is compensated.
    """
    q, qd = (np.asarray(values, dtype=float) for values in (q, qd))
    still = np.zeros_like(q)
    tau = _friction(qd, np.clip(qd / zero_speed, -1, 1), bodies(q, still, still))
    for *ratio, _, viscous, coulomb in MOTORS:
        speed = qd @ ratio
        tau = tau + (viscous * speed + coulomb * np.clip(speed / zero_speed, -1, 1))[..., None] * np.array(ratio)
    return tau
'''


CONTACT = '''

# Speeds between the ranges, and thresholds in them: N m (N); inf where the held-out motion was too short to set one.
CONTACT_BOUNDS = np.array(@BOUNDS@)
CONTACT_LEVELS = np.array(@LEVELS@)


def threshold(qd):
    """Contact: |measured torque - torque(q, qd, qdd)| beyond this, both low-passed at @BANDWIDTH@ Hz.

    Set for @PER_HOUR@ false alarms an hour at each joint in each speed range. Counted on held-out motion:
    @COUNTED@
    """
    part = (np.abs(np.asarray(qd, dtype=float))[..., None] > CONTACT_BOUNDS).sum(axis=-1)
    return CONTACT_LEVELS[np.arange(len(JOINTS)), part]
'''


def numpy_code(law: ControlLaw, notes: list[str], contact: Thresholds | None = None) -> tuple[str, str]:
    """The name of the module and its text.

    Args:
        law: Numbers that the module gets: bodies, joints and coupled motors of a physically consistent model.
        notes: What stands at its head, a line each.
        contact: Thresholds for contact detection; None: the module has none.
    """
    fields = fields_of(law, notes)
    fields["NUMBERS"] = literal(list(law.joints.T)).replace("inf", "np.inf")
    text = filled(TEMPLATE, fields)
    if contact is not None:
        bounds, levels = contact.tables()
        own = {
            "BANDWIDTH": f"{contact.bandwidth_hz:g}",
            "PER_HOUR": f"{contact.wanted_per_hour:g}",
            "COUNTED": "\n    ".join(docstring_lines(contact.lines())),
            "BOUNDS": literal(list(bounds)),
            "LEVELS": literal(list(levels)).replace("inf", "np.inf"),
        }
        text += filled(CONTACT, own)
    return identifier(law.model.model.arm.name), text
