"""URDF of an identified arm: its own, with identified bodies, the nearest `<dynamics>`, and `<ros2_control>` tags."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from ..dynamics.model import IdentifiedModel
from ..results.formats import DAMPING, FRICTION
from ..results.urdf import identified_urdf
from .frames import comment
from .law import Nearest


def urdf(model: IdentifiedModel, fit: Nearest, notes: list[str]) -> str:
    """The text of a URDF with a mock ros2_control system (position in; position, velocity, effort out).

    Args:
        model: Model with values, of an arm that was read from a URDF.
        fit: Damping and friction by joint that come nearest to the model's friction.
        notes: Lines for a comment at the top.

    Raises:
        UserError: As `identified_urdf`.
    """
    dynamics = {joint: (values[DAMPING], values[FRICTION]) for joint, values in fit.values.items()}
    text = identified_urdf(model, dynamics)
    head, tail = text.rsplit("</robot>", 1)
    control = [] if "<ros2_control" in text else _control(model)
    return head + "\n".join([*comment(notes), *control, "</robot>"]) + tail


def _control(model: IdentifiedModel) -> list[str]:
    arm = model.model.arm
    lines = [
        f'  <ros2_control name={quoteattr(arm.name)} type="system">',
        "    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>",
    ]
    for joint in arm.joint_names:
        lines += [
            f"    <joint name={quoteattr(joint)}>",
            '      <command_interface name="position"/><command_interface name="effort"/>',
            *(f'      <state_interface name="{name}"/>' for name in ("position", "velocity", "effort")),
            "    </joint>",
        ]
    return [*lines, "  </ros2_control>"]
