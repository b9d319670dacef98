"""A tree of bodies as URDF text: what an `Arm` is made from, whatever format the tree was read in.

Links keep the frame of their body, moved to the joint's anchor; inertials are given about the centre of mass.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray

ROOT = "world"


@dataclass(frozen=True)
class TreeJoint:
    """A joint of the tree.

    Attributes:
        name: Of the joint.
        kind: `revolute`, `continuous`, `prismatic` or `fixed`.
        axis: (3,) in the link's frame.
        lower, upper: rad or m; not used for `continuous` and `fixed`.
        effort: N m or N; 0: none stated.
    """

    name: str
    kind: str
    axis: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0


@dataclass(frozen=True)
class TreeLink:
    """A body and the joint that carries it.

    Attributes:
        name: Unique.
        parent: Name of the carrying link.
        rotation: (3, 3) link frame to parent's link frame, all joints at zero.
        translation: (3,) origin in the parent's link frame, m.
        joint: How it hangs there.
        mass: kg.
        centre: (3,) centre of mass in the link frame, m.
        inertia: (3, 3) about the centre of mass in the link's axes, kg m^2.
    """

    name: str
    parent: str
    rotation: FloatArray
    translation: FloatArray
    joint: TreeJoint
    mass: float
    centre: FloatArray
    inertia: FloatArray


def urdf_of(name: str, links: Sequence[TreeLink]) -> str:
    """URDF text of a tree whose root link is `ROOT`.

    Args:
        name: Of the robot.
        links: Every link but the root, with its inertial and the joint that carries it, whatever the order.
    """
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(name)}>", f'  <link name="{ROOT}"/>']
    for link in links:
        lines += [f"  <link name={quoteattr(link.name)}>", *_inertial(link), "  </link>", *_joint(link)]
    return "\n".join([*lines, "</robot>", ""])


def _inertial(link: TreeLink) -> list[str]:
    if not link.mass > 0.0:
        return []
    i = link.inertia
    names = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
    tensor = " ".join(f'{name}="{float(i[row, column])!r}"' for name, row, column in names)
    return [
        f'    <inertial><origin xyz="{_words(link.centre)}"/><mass value="{link.mass!r}"/>',
        f"      <inertia {tensor}/></inertial>",
    ]


def _joint(link: TreeLink) -> list[str]:
    joint = link.joint
    with warnings.catch_warnings():
        # At a pitch of a right angle one of many equal answers is as good as another.
        warnings.simplefilter("ignore", UserWarning)
        rpy = Rotation.from_matrix(link.rotation).as_euler("xyz")
    lines = [
        f"  <joint name={quoteattr(joint.name)} type={quoteattr(joint.kind)}>",
        f'    <origin xyz="{_words(link.translation)}" rpy="{_words(rpy)}"/>',
        f"    <parent link={quoteattr(link.parent)}/><child link={quoteattr(link.name)}/>",
    ]
    if joint.kind != "fixed":
        lines.append(f'    <axis xyz="{_words(joint.axis)}"/>')
        lower, upper = (joint.lower, joint.upper) if joint.kind != "continuous" else (0.0, 0.0)
        lines.append(f'    <limit lower="{lower!r}" upper="{upper!r}" effort="{joint.effort!r}" velocity="0"/>')
    return [*lines, "  </joint>"]


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def inertials_of(links: Sequence[TreeLink]) -> dict[str, tuple[str, FloatArray]]:
    """Link with mass -> the joint that moves it, and its ten parameters about that joint's frame.

    Links that no joint moves are left out. Parameters are m, m c, I in Pinocchio's order.
    """
    placed: dict[str, tuple[str, FloatArray, FloatArray]] = {}
    found: dict[str, tuple[str, FloatArray]] = {}
    for link in links:
        joint, rotation, place = link.joint.name, np.eye(3), np.zeros(3)
        if link.joint.kind == "fixed":
            if link.parent not in placed:
                continue
            joint, outer, origin = placed[link.parent]
            rotation, place = outer @ link.rotation, origin + outer @ link.translation
        placed[link.name] = joint, rotation, place
        if link.mass > 0.0:
            centre = place + rotation @ link.centre
            tensor = rotation @ link.inertia @ rotation.T
            found[link.name] = joint, np.array(pin.Inertia(link.mass, centre, tensor).toDynamicParameters())
    return found
