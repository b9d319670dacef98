"""MJCF of an identified arm: bodies, armature, damping, Coulomb friction, springs, motors; no meshes or contacts."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np

from ..dynamics.model import IdentifiedModel
from ..results.formats import ARMATURE, DAMPING, FRICTION, REST, STIFFNESS
from .frames import Body, bodies_of, children_of, comment, quaternion, words
from .law import Nearest

SHARP = "0.9999 0.9999 0.001 0.5 2"
"""Impedance of the friction constraint, MuJoCo's highest: by default a light joint reaches its Coulomb friction only
at some 0.1 rad/s, which no parameter here could make good."""


def mjcf(model: IdentifiedModel, fit: Nearest, notes: list[str]) -> str:
    """The text of an MJCF.

    Args:
        model: The identified model.
        fit: The nearest parameters for `MJCF`.
        notes: What stands at its head, a line each.

    Raises:
        UserError: A body that cannot be.
    """
    arm = model.model.arm
    bodies = bodies_of(model)
    lines = [
        *comment(notes),
        f"<mujoco model={quoteattr(arm.name)}>",
        '  <compiler angle="radian" autolimits="true" balanceinertia="false"/>',
        f'  <default><joint solimpfriction="{SHARP}"/></default>',
        f'  <option gravity="{words(list(arm.gravity))}" integrator="implicitfast"/>',
        "  <worldbody>",
        *_children(model, bodies, fit, -1, "    "),
        "  </worldbody>",
        "  <actuator>",
        *(_motor(body) for body in bodies),
        "  </actuator>",
        "</mujoco>",
        "",
    ]
    return "\n".join(lines)


def _children(model: IdentifiedModel, bodies: list[Body], fit: Nearest, parent: int, indent: str) -> list[str]:
    """The bodies that a body carries, each with all it carries."""
    lines = []
    for k in children_of(model.model.arm, parent):
        body = bodies[k]
        name = quoteattr(f"{body.joint.name}_body")
        frame = f'pos="{words(list(body.joint.translation))}" quat="{words(list(quaternion(body.joint.rotation)))}"'
        full = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        lines += [
            f"{indent}<body name={name} {frame}>",
            f'{indent}  <inertial pos="{words(list(body.centre))}" mass="{body.mass!r}"',
            f'{indent}            fullinertia="{words(list(full))}"/>',
            f"{indent}  {_joint(body, fit)}",
            *_children(model, bodies, fit, k, indent + "  "),
            f"{indent}</body>",
        ]
    return lines


def _joint(body: Body, fit: Nearest) -> str:
    joint, values = body.joint, fit.values[body.joint.name]
    kind = "hinge" if joint.revolute else "slide"
    parts = [f"<joint name={quoteattr(joint.name)}", f'type="{kind}"', f'axis="{words(list(joint.axis))}"']
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        parts.append(f'range="{words([joint.lower, joint.upper])}"')
    parts += [
        f'armature="{values[ARMATURE]!r}"',
        f'damping="{values[DAMPING]!r}"',
        f'frictionloss="{values[FRICTION]!r}"',
    ]
    if values.get(STIFFNESS, 0.0) > 0.0:
        parts.append(f'stiffness="{values[STIFFNESS]!r}" springref="{values[REST]!r}"')
    return " ".join(parts) + "/>"


def _motor(body: Body) -> str:
    """An actuator within the joint's limit: N·m of the output side, or A of the motor where its constants are known."""
    name, limit = body.joint.name, body.joint.effort_limit
    gain = body.joint.torque_per_ampere
    words_of = f"name={quoteattr(f'{name}_motor')} joint={quoteattr(name)}"
    bounds = f' ctrlrange="{words([-limit / abs(gain), limit / abs(gain)])}"' if np.isfinite(limit) else ""
    if gain == 1.0:
        return f"    <motor {words_of}{bounds}/>"
    force = f' forcerange="{words([-limit, limit])}"' if np.isfinite(limit) else ""
    return f'    <general {words_of} gainprm="{gain!r}"{bounds}{force}/> <!-- control: motor current, A -->'
