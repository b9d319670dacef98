"""SDF of an identified arm (1.9): links, joints with damping, Coulomb friction and spring; no meshes."""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ..dynamics.model import IdentifiedModel
from ..results.formats import DAMPING, FRICTION, REST, STIFFNESS
from .frames import Body, bodies_of, comment, rpy, words
from .law import Nearest


def sdf(model: IdentifiedModel, fit: Nearest, notes: list[str]) -> str:
    """The text of an SDF world with the model in it, under the arm's gravity.

    Args:
        model: Bodies, joint placements and gravity that the file gets.
        fit: The nearest parameters for `SDF`.
        notes: What stands at its head, a line each.

    Raises:
        UserError: A body that cannot be.
    """
    arm = model.model.arm
    bodies = bodies_of(model)
    lines = [
        '<?xml version="1.0"?>',
        *comment(notes),
        '<sdf version="1.9">',
        '  <world name="world">',
        f"    <gravity>{words(list(arm.gravity))}</gravity>",
        f"    <model name={quoteattr(arm.name)}>",
        '      <link name="base_link"/>',
        '      <joint name="base_fixed" type="fixed"><parent>world</parent><child>base_link</child></joint>',
    ]
    for body in bodies:
        carrier = "base_link" if body.joint.parent < 0 else _link(bodies[body.joint.parent])
        lines += _body(body, carrier) + _joint(body, carrier, fit)
    return "\n".join([*lines, "    </model>", "  </world>", "</sdf>", ""])


def _link(body: Body) -> str:
    return f"{body.joint.name}_link"


def _body(body: Body, carrier: str) -> list[str]:
    """A link, its frame the joint's at zero."""
    tensor = "".join(
        f"<i{'xyz'[row]}{'xyz'[column]}>{float(body.inertia[row, column])!r}</i{'xyz'[row]}{'xyz'[column]}>"
        for row in range(3)
        for column in range(row, 3)
    )
    pose = words([*body.joint.translation, *rpy(body.joint.rotation)])
    return [
        f"      <link name={quoteattr(_link(body))}>",
        f"        <pose relative_to={quoteattr(carrier)}>{pose}</pose>",
        f"        <inertial><pose>{words(list(body.centre))} 0 0 0</pose><mass>{body.mass!r}</mass>",
        f"          <inertia>{tensor}</inertia></inertial>",
        "      </link>",
    ]


def _joint(body: Body, carrier: str, fit: Nearest) -> list[str]:
    joint, values = body.joint, fit.values[body.joint.name]
    kind = ("revolute" if np.isfinite(joint.upper) else "continuous") if joint.revolute else "prismatic"
    spring = ""
    if values.get(STIFFNESS, 0.0) > 0.0:
        spring = (
            f"<spring_stiffness>{values[STIFFNESS]!r}</spring_stiffness>"
            f"<spring_reference>{values[REST]!r}</spring_reference>"
        )
    limits = {
        "lower": joint.lower,
        "upper": joint.upper,
        "effort": joint.effort_limit,
        "velocity": joint.velocity_limit,
    }
    bounds = "".join(f"<{name}>{value!r}</{name}>" for name, value in limits.items() if np.isfinite(value))
    return [
        f'      <joint name={quoteattr(joint.name)} type="{kind}">',
        f"        <parent>{escape(carrier)}</parent><child>{escape(_link(body))}</child>",
        f"        <axis><xyz>{words(list(joint.axis))}</xyz>",
        f"          <dynamics><damping>{values[DAMPING]!r}</damping><friction>{values[FRICTION]!r}</friction>{spring}"
        "</dynamics>",
        f"          <limit>{bounds}</limit></axis>",
        "      </joint>",
    ]
