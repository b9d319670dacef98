"""C99 of an identified arm: one header, one source, the mathematical library and nothing else; no memory, no state."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .controller import JOINT_NUMBERS, ZERO_SPEED, ControlLaw
from .template import filled, identifier
from .thresholds import Thresholds

HEADER = """/* @NOTES@ */
#ifndef @UPPER@_H
#define @UPPER@_H
#ifdef __cplusplus
extern "C" {
#endif

#define @UPPER@_N @N@ /* joints: @JOINTS@ */
#define @UPPER@_ZERO_SPEED @ZERO@ /* rad/s (m/s), see @NAME@_friction */

/* Bodies m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about their joint frames: kg, kg m, kg m^2. */
extern const double @NAME@_inertials[@UPPER@_N][10];

/* Joint torque, N m (N), on the output side. q rad (m), qd rad/s, qdd rad/s^2. sgn(0) is 0. */
void @NAME@_torque(const double *q, const double *qd, const double *qdd, double *tau);

/* Torque that holds the arm still: bodies, springs and offsets; no friction. */
void @NAME@_gravity(const double *q, double *tau);

/* Friction to be added to a controller's torque. In place of sgn(qd) it has qd / zero_speed between -1 and 1: zero at
   zero speed, without a jump; at standstill nothing is compensated. zero_speed <= 0 stands for @UPPER@_ZERO_SPEED. */
void @NAME@_friction(const double *q, const double *qd, double zero_speed, double *tau);

/* Y with bodies' torque = Y * inertials, row by row: Y[i * 10 * N + 10 * link + k]. */
void @NAME@_regressor(const double *q, const double *qd, const double *qdd, double *Y);
@CONTACT_HEADER@
#ifdef __cplusplus
}
#endif
#endif
"""

SOURCE = """/* @NOTES@ */
#include "@NAME@.h"
#include <math.h>

#define N @UPPER@_N
#define MOTORS @MOTORS@

static const int parent[N] = @PARENT@;
static const int revolute[N] = @REVOLUTE@;
static const double axis[N][3] = @AXIS@;
static const double place[N][9] = @PLACE@;   /* joint frame to parent frame at zero, row by row */
static const double origin[N][3] = @ORIGIN@;
static const double gravity[3] = @GRAVITY@;
const double @NAME@_inertials[N][10] = @INERTIALS@;
/* @NUMBERS@ */
enum { J_M, K_1, OFFSET, F_C, F_B, V_B, MU, K_V1, K_V2_EVEN, K_V2_ODD, K_V3, FASTEST, NUMBERS };
static const double number[N][NUMBERS] = @JOINT_NUMBERS@;
/* Coupled motors: their ratio to each joint, then J_m, k_v1, f_c. */
static const double motor[MOTORS + 1][N + 3] = @MOTOR_NUMBERS@;

typedef struct { double R[9], r[3], w[3], e[3], a[3]; } Link;

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

static void turn(const double *R, const double *a, double *b) { /* b = R a */
  for (int i = 0; i < 3; i++) b[i] = R[3 * i] * a[0] + R[3 * i + 1] * a[1] + R[3 * i + 2] * a[2];
}

static void back(const double *R, const double *a, double *b) { /* b = R' a */
  for (int i = 0; i < 3; i++) b[i] = R[i] * a[0] + R[3 + i] * a[1] + R[6 + i] * a[2];
}

/* Link frames, angular velocity and acceleration, and acceleration of the origin less gravity, base to tip. */
static void forward(const double *q, const double *qd, const double *qdd, Link *link) {
  static const double still[3] = {0, 0, 0};
  for (int i = 0; i < N; i++) {
    Link *l = &link[i];
    const Link *p = parent[i] < 0 ? 0 : &link[parent[i]];
    const double *w = p ? p->w : still, *e = p ? p->e : still, *x = axis[i], *P = place[i];
    double a[3], t[3], u[3], own[9];
    for (int k = 0; k < 3; k++) { a[k] = p ? p->a[k] : -gravity[k]; l->r[k] = origin[i][k]; }
    if (revolute[i]) { /* Rodrigues */
      const double c = cos(q[i]), s = sin(q[i]), d = 1.0 - c;
      own[0] = c + x[0] * x[0] * d, own[1] = x[0] * x[1] * d - x[2] * s, own[2] = x[0] * x[2] * d + x[1] * s;
      own[3] = x[1] * x[0] * d + x[2] * s, own[4] = c + x[1] * x[1] * d, own[5] = x[1] * x[2] * d - x[0] * s;
      own[6] = x[2] * x[0] * d - x[1] * s, own[7] = x[2] * x[1] * d + x[0] * s, own[8] = c + x[2] * x[2] * d;
      for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++)
          l->R[3 * r + k] = P[3 * r] * own[k] + P[3 * r + 1] * own[3 + k] + P[3 * r + 2] * own[6 + k];
    } else {
      for (int k = 0; k < 9; k++) l->R[k] = P[k];
      turn(P, x, t);
      for (int k = 0; k < 3; k++) l->r[k] += t[k] * q[i];
    }
    cross(e, l->r, t);
    cross(w, l->r, u);
    for (int k = 0; k < 3; k++) a[k] += t[k];
    cross(w, u, t);
    for (int k = 0; k < 3; k++) a[k] += t[k];
    back(l->R, w, l->w);
    back(l->R, e, l->e);
    back(l->R, a, l->a);
    cross(l->w, x, t); /* the turning of the axis; its own speed adds nothing to it */
    for (int k = 0; k < 3; k++) {
      if (revolute[i]) {
        l->e[k] += x[k] * qdd[i] + t[k] * qd[i];
        l->w[k] += x[k] * qd[i];
      } else {
        l->a[k] += x[k] * qdd[i] + 2.0 * t[k] * qd[i];
      }
    }
  }
}

/* Force, and moment about its origin, that carry a body along with its link. */
static void wrench(const Link *l, const double *b, double *f, double *n) {
  double t[3], u[3], h[3], g[3];
  const double *c = b + 1;
  cross(l->e, c, t);
  cross(l->w, c, u);
  cross(l->w, u, h);
  for (int k = 0; k < 3; k++) f[k] = b[0] * l->a[k] + t[k] + h[k];
  cross(c, l->a, t);
  const double I[9] = {b[4], b[5], b[7], b[5], b[6], b[8], b[7], b[8], b[9]};
  turn(I, l->e, h);
  turn(I, l->w, u);
  cross(l->w, u, g);
  for (int k = 0; k < 3; k++) n[k] = t[k] + h[k] + g[k];
}

static void carry(const Link *l, double *f, double *n) { /* a wrench from a link's frame into its parent's */
  double g[3], m[3], t[3];
  turn(l->R, f, g);
  turn(l->R, n, m);
  cross(l->r, g, t);
  for (int k = 0; k < 3; k++) { f[k] = g[k]; n[k] = m[k] + t[k]; }
}

static void bodies(const double *q, const double *qd, const double *qdd, double *tau) {
  Link link[N];
  double f[N][3], n[N][3];
  forward(q, qd, qdd, link);
  for (int i = 0; i < N; i++) wrench(&link[i], @NAME@_inertials[i], f[i], n[i]);
  for (int i = N - 1; i >= 0; i--) {
    tau[i] = dot(axis[i], revolute[i] ? n[i] : f[i]);
    if (parent[i] >= 0) {
      carry(&link[i], f[i], n[i]);
      for (int k = 0; k < 3; k++) { f[parent[i]][k] += f[i][k]; n[parent[i]][k] += n[i][k]; }
    }
  }
}

/* Friction of a joint; `sign` is that of its speed, or what stands in for it near zero. */
static double friction(const double *p, double v, double sign, double load) {
  const double speed = fabs(v), slow = speed < p[FASTEST] ? speed : p[FASTEST];
  const double ratio = p[V_B] > 0.0 ? v / p[V_B] : 0.0;
  const double level = p[V_B] > 0.0 ? p[F_C] + (p[F_B] - p[F_C]) * exp(-ratio * ratio) : p[F_C];
  return sign * (level + p[MU] * fabs(load)) + p[K_V1] * v + p[K_V2_EVEN] * slow * speed + p[K_V2_ODD] * slow * v +
         p[K_V3] * slow * slow * v;
}

static double sgn(double v) { return (v > 0.0) - (v < 0.0); }

static double near_zero(double v, double zero_speed) {
  const double s = v / zero_speed;
  return s > 1.0 ? 1.0 : s < -1.0 ? -1.0 : s;
}

void @NAME@_torque(const double *q, const double *qd, const double *qdd, double *tau) {
  bodies(q, qd, qdd, tau);
  for (int i = 0; i < N; i++) {
    const double *p = number[i];
    tau[i] += p[J_M] * qdd[i] + p[K_1] * q[i] + p[OFFSET] + friction(p, qd[i], sgn(qd[i]), tau[i]);
  }
  for (int m = 0; m < MOTORS; m++) {
    double v = 0.0, a = 0.0;
    for (int i = 0; i < N; i++) { v += motor[m][i] * qd[i]; a += motor[m][i] * qdd[i]; }
    for (int i = 0; i < N; i++)
      tau[i] += motor[m][i] * (motor[m][N] * a + motor[m][N + 1] * v + motor[m][N + 2] * sgn(v));
  }
}

void @NAME@_gravity(const double *q, double *tau) {
  static const double still[N] = {0};
  bodies(q, still, still, tau);
  for (int i = 0; i < N; i++) tau[i] += number[i][K_1] * q[i] + number[i][OFFSET];
}

void @NAME@_friction(const double *q, const double *qd, double zero_speed, double *tau) {
  static const double still[N] = {0};
  double load[N];
  if (zero_speed <= 0.0) zero_speed = @UPPER@_ZERO_SPEED;
  bodies(q, still, still, load);
  for (int i = 0; i < N; i++) tau[i] = friction(number[i], qd[i], near_zero(qd[i], zero_speed), load[i]);
  for (int m = 0; m < MOTORS; m++) {
    double v = 0.0;
    for (int i = 0; i < N; i++) v += motor[m][i] * qd[i];
    for (int i = 0; i < N; i++)
      tau[i] += motor[m][i] * (motor[m][N + 1] * v + motor[m][N + 2] * near_zero(v, zero_speed));
  }
}

void @NAME@_regressor(const double *q, const double *qd, const double *qdd, double *Y) {
  Link link[N];
  forward(q, qd, qdd, link);
  for (int k = 0; k < N * 10 * N; k++) Y[k] = 0.0;
  for (int i = 0; i < N; i++) {
    for (int k = 0; k < 10; k++) {
      double unit[10] = {0}, f[3], n[3];
      unit[k] = 1.0;
      wrench(&link[i], unit, f, n);
      for (int j = i; j >= 0; j = parent[j]) {
        Y[j * 10 * N + 10 * i + k] = dot(axis[j], revolute[j] ? n : f);
        carry(&link[j], f, n);
      }
    }
  }
}
@CONTACT_SOURCE@"""
CONTACT_HEADER = """
/* Contact: |measured torque - torque(q, qd, qdd)| beyond threshold, N m (N), both low-passed at @BANDWIDTH@ Hz. Set
   for @PER_HOUR@ false alarms an hour at each joint in each speed range; HUGE_VAL where the held-out motion was too
   short to set one. Above the fastest range the last threshold goes on, unmeasured. Counted on held-out motion:
   @COUNTED@ */
void @NAME@_threshold(const double *qd, double *threshold);
"""
CONTACT_SOURCE = """
static const double contact_bound[N][@PARTS@] = @BOUNDS@;
static const double contact_level[N][@PARTS@ + 1] = @LEVELS@;

void @NAME@_threshold(const double *qd, double *threshold) {
  for (int i = 0; i < N; i++) {
    int part = 0;
    while (part < @PARTS@ && fabs(qd[i]) > contact_bound[i][part]) part++;
    threshold[i] = contact_level[i][part];
  }
}
"""


def c_code(law: ControlLaw, notes: list[str], contact: Thresholds | None = None) -> tuple[str, str, str]:
    """The name of the files, the text of the header and that of the source.

    Args:
        law: The law.
        notes: What stands at their heads, a line each.
        contact: Thresholds for contact detection; None: the code has none.
    """
    arm = law.model.model.arm
    name = identifier(arm.name)
    n = len(arm.joints)
    fields = {
        "NOTES": "\n   ".join(note.replace("*/", "* /") for note in notes),
        "UPPER": name.upper(),
        "NAME": name,
        "N": str(n),
        "JOINTS": ", ".join(arm.joint_names).replace("*/", "* /"),
        "ZERO": repr(ZERO_SPEED),
        "MOTORS": str(len(law.motors)),
        "PARENT": _block(np.array([joint.parent for joint in arm.joints]), whole=True),
        "REVOLUTE": _block(np.array([int(joint.revolute) for joint in arm.joints]), whole=True),
        "AXIS": _block(np.array([joint.axis for joint in arm.joints])),
        "PLACE": _block(np.array([joint.rotation.ravel() for joint in arm.joints])),
        "ORIGIN": _block(np.array([joint.translation for joint in arm.joints])),
        "GRAVITY": _block(np.asarray(arm.gravity)),
        "INERTIALS": _block(law.inertials),
        "NUMBERS": ", ".join(JOINT_NUMBERS),
        "JOINT_NUMBERS": _block(law.joints),
        "MOTOR_NUMBERS": _block(np.vstack([law.motors, np.zeros(n + 3)])),
    }
    fields |= _contact_fields(contact, fields)
    return name, filled(HEADER, fields), filled(SOURCE, fields)


def _contact_fields(contact: Thresholds | None, fields: dict[str, str]) -> dict[str, str]:
    """What the templates hold of contact detection; nothing without thresholds."""
    if contact is None:
        return {"CONTACT_HEADER": "", "CONTACT_SOURCE": ""}
    bounds, levels = contact.tables()
    own = {
        **fields,
        "BANDWIDTH": f"{contact.bandwidth_hz:g}",
        "PER_HOUR": f"{contact.wanted_per_hour:g}",
        "COUNTED": "\n   ".join(line.replace("*/", "* /") for line in contact.lines()),
        "PARTS": str(bounds.shape[1]),
        "BOUNDS": _block(bounds),
        "LEVELS": _block(levels),
    }
    return {"CONTACT_HEADER": filled(CONTACT_HEADER, own), "CONTACT_SOURCE": filled(CONTACT_SOURCE, own)}


def _block(values: FloatArray, whole: bool = False) -> str:
    """Numbers as a C initialiser, every digit kept."""
    if values.ndim > 1:
        return "{\n  " + ",\n  ".join(_block(row, whole) for row in values) + "}"
    return "{" + ", ".join(str(int(value)) if whole else _c_number(float(value)) for value in values) + "}"


def _c_number(value: float) -> str:
    return "HUGE_VAL" if value == np.inf else repr(value)
