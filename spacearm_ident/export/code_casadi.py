"""A Python module of an identified arm as CasADi functions: the law of `code_c`, to be differentiated and optimised.

The module needs casadi alone, and writing it needs none of it. It builds the functions from SX expressions when it is
imported, so they can be differentiated, expanded into other expressions, saved (`torque.save`) and turned into C code.
"""

from __future__ import annotations

from .controller import ControlLaw
from .template import fields_of, filled, identifier
from .thresholds import Thresholds

TEMPLATE = '''"""@NOTES@

casadi.Function of column vectors (n,), joints in the order @JOINTS@; SI units, torque on the output side:

    torque(q, qd, qdd) -> tau                      sgn(0) is 0
    gravity(q) -> tau                              holds the arm still: bodies, springs and offsets; no friction
    friction(q, qd, zero_speed) -> tau             qd / zero_speed between -1 and 1 in place of sgn(qd)
    smooth_torque(q, qd, qdd, zero_speed) -> tau   torque with tanh(qd / zero_speed) in place of sgn(qd)
    regressor(q, qd, qdd) -> Y (n, 10 n)           torque of the bodies = Y vec(INERTIALS), link by link

`friction` is zero at zero speed, without a jump: at standstill nothing is compensated. `smooth_torque` has derivatives
everywhere, as gradient-based optimisation needs. A zero_speed of 0 stands for ZERO_SPEED in both.
"""

import casadi as ca

JOINTS = @NAMES@
PARENT = @PARENT@
REVOLUTE = @REVOLUTE@
AXIS = @AXIS@
PLACE = @PLACE@  # joint frame to parent frame at zero
ORIGIN = @ORIGIN@
GRAVITY = @GRAVITY@
INERTIALS = @INERTIALS@  # m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint frames
inf = float("inf")
# J_m, k_1, offset, f_c, f_b, v_b, mu, k_v1, k_v2 (even), k_v2 (odd), k_v3, fastest speed of k_v2 and k_v3
NUMBERS = @NUMBERS@
MOTORS = @MOTORS@  # ratios, J_m, k_v1, f_c of coupled motors
ZERO_SPEED = @ZERO@  # rad/s (m/s)
N = len(JOINTS)


def _forward(q, qd, qdd):
    """Rotation, origin, angular velocity and acceleration, acceleration less gravity of every link, base to tip."""
    links = []
    for i in range(N):
        x = ca.SX(AXIS[i])
        w, e, a = links[PARENT[i]][2:] if PARENT[i] >= 0 else (ca.SX(3, 1), ca.SX(3, 1), -ca.SX(GRAVITY))
        place, origin = ca.SX(ca.DM(PLACE[i])), ca.SX(ORIGIN[i])
        if REVOLUTE[i]:  # Rodrigues
            c, s = ca.cos(q[i]), ca.sin(q[i])
            rotation = place @ (c * ca.SX.eye(3) + s * ca.skew(x) + (1 - c) * (x @ x.T))
        else:
            rotation, origin = place, origin + (place @ x) * q[i]
        a = a + ca.cross(e, origin) + ca.cross(w, ca.cross(w, origin))
        w, e, a = (rotation.T @ vector for vector in (w, e, a))
        if REVOLUTE[i]:
            e = e + x * qdd[i] + ca.cross(w, x) * qd[i]
            w = w + x * qd[i]
        else:
            a = a + x * qdd[i] + 2 * ca.cross(w, x) * qd[i]
        links.append((rotation, origin, w, e, a))
    return links


def _wrench(link, body):
    """Force, and moment about its origin, that carry a body along with its link."""
    _, _, w, e, a = link
    m, c = body[0], ca.SX(body[1:4])
    xx, xy, yy, xz, yz, zz = body[4:]
    inertia = ca.SX(ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    f = m * a + ca.cross(e, c) + ca.cross(w, ca.cross(w, c))
    return f, ca.cross(c, a) + inertia @ e + ca.cross(w, inertia @ w)


def _carry(link, f, n):
    """A wrench from a link's frame into its parent's."""
    f, n = link[0] @ f, link[0] @ n
    return f, n + ca.cross(link[1], f)


def _bodies(q, qd, qdd):
    links = _forward(q, qd, qdd)
    wrenches = [_wrench(link, body) for link, body in zip(links, INERTIALS)]
    tau = [0] * N
    for i in reversed(range(N)):
        f, n = wrenches[i]
        tau[i] = ca.dot(ca.SX(AXIS[i]), n if REVOLUTE[i] else f)
        if PARENT[i] >= 0:
            more = _carry(links[i], f, n)
            wrenches[PARENT[i]] = tuple(one + other for one, other in zip(wrenches[PARENT[i]], more))
    return tau


def _regressor(q, qd, qdd):
    links = _forward(q, qd, qdd)
    whole = ca.SX(N, 10 * N)
    for i in range(N):
        for k in range(10):
            f, n = _wrench(links[i], [float(k == other) for other in range(10)])
            j = i
            while j >= 0:
                whole[j, 10 * i + k] = ca.dot(ca.SX(AXIS[j]), n if REVOLUTE[j] else f)
                f, n = _carry(links[j], f, n)
                j = PARENT[j]
    return whole


def _friction(i, v, sign, load):
    _, _, _, f_c, f_b, v_b, mu, k_v1, k_v2_even, k_v2_odd, k_v3, fastest = NUMBERS[i]
    speed = ca.fabs(v)
    slow = speed if fastest == inf else ca.fmin(speed, fastest)
    level = f_c + (f_b - f_c) * ca.exp(-((v / v_b) ** 2)) if v_b > 0 else f_c
    rest = k_v1 * v + k_v2_even * slow * speed + k_v2_odd * slow * v + k_v3 * slow**2 * v
    return sign(v) * (level + mu * ca.fabs(load)) + rest


def _torque(q, qd, qdd, sign):
    rigid = _bodies(q, qd, qdd)
    tau = ca.vertcat(*rigid)
    for i in range(N):
        inertia, stiffness, offset = NUMBERS[i][:3]
        tau[i] += inertia * qdd[i] + stiffness * q[i] + offset + _friction(i, qd[i], sign, rigid[i])
    for *ratio, inertia, viscous, coulomb in MOTORS:
        ratio = ca.SX(ratio)
        v = ca.dot(ratio, qd)
        tau += ratio * (inertia * ca.dot(ratio, qdd) + viscous * v + coulomb * sign(v))
    return tau


def _compensation(q, qd, sign):
    still = ca.SX(N, 1)
    load = _bodies(q, still, still)
    tau = ca.vertcat(*(_friction(i, qd[i], sign, load[i]) for i in range(N)))
    for *ratio, _, viscous, coulomb in MOTORS:
        ratio = ca.SX(ratio)
        v = ca.dot(ratio, qd)
        tau += ratio * (viscous * v + coulomb * sign(v))
    return tau


def _gravity(q):
    still = ca.SX(N, 1)
    return ca.vertcat(*(one + NUMBERS[i][1] * q[i] + NUMBERS[i][2] for i, one in enumerate(_bodies(q, still, still))))


_q, _qd, _qdd, _zero = ca.SX.sym("q", N), ca.SX.sym("qd", N), ca.SX.sym("qdd", N), ca.SX.sym("zero_speed")
_width = ca.if_else(_zero > 0, _zero, ZERO_SPEED)
_state, _names = [_q, _qd, _qdd], ["q", "qd", "qdd"]
torque = ca.Function("torque", _state, [_torque(*_state, ca.sign)], _names, ["tau"])
gravity = ca.Function("gravity", [_q], [_gravity(_q)], ["q"], ["tau"])
friction = ca.Function(
    "friction",
    [_q, _qd, _zero],
    [_compensation(_q, _qd, lambda v: ca.fmax(-1, ca.fmin(1, v / _width)))],
    ["q", "qd", "zero_speed"],
    ["tau"],
)
smooth_torque = ca.Function(
    "smooth_torque",
    [*_state, _zero],
    [_torque(*_state, lambda v: ca.tanh(v / _width))],
    [*_names, "zero_speed"],
    ["tau"],
)
regressor = ca.Function("regressor", _state, [_regressor(*_state)], _names, ["Y"])
'''


def casadi_code(law: ControlLaw, notes: list[str], contact: Thresholds | None = None) -> tuple[str, str]:
    """The name of the module and its text.

    Args:
        law: Numbers that the module gets: bodies, joints and coupled motors of a physically consistent model.
        notes: What stands at its head, a line each.
        contact: Not used: the module has no contact detection. It is there so that both are called alike.
    """
    return identifier(f"{law.model.model.arm.name}_casadi"), filled(TEMPLATE, fields_of(law, notes))
