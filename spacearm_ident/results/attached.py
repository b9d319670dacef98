"""What is attached to a link that a joint of the arm moves, and how an identified body is divided between them.

An identified body is all that moves with a joint. A description has it in several links: the one that the joint
carries, what fixed joints attach to it, and what hangs on it by joints that the recordings lack (a gripper's fingers).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..documents import parse_xml
from ..dynamics.urdf_chain import placement
from ..estimate.consistency import pseudo_inertia

KEPT_SHARE = 1e-3
"""Least pseudo-inertia (smallest eigenvalue) of what is left of a body, over the whole body's: a simulator's contacts
and constraints need a body that is not at the edge of what can be."""
HALVINGS = 30
"""Of the share that attached links keep; beyond it nothing is left of them."""


@dataclass(frozen=True)
class Attached:
    """A link that moves with the link of one of the arm's joints.

    Attributes:
        link: Its name.
        by_joint: Whether a joint that moves in the file is between them; otherwise fixed joints alone.
        inertial: (10,) m, m c, I about the frame of the arm's joint, its axes; zero where it has none.
    """

    link: str
    by_joint: bool
    inertial: FloatArray


@dataclass(frozen=True)
class Division:
    """An identified body, divided between links.

    Attributes:
        link: (10,) of the link that the joint carries, about the joint's frame.
        fixed: Links that have nothing of their own any more.
        kept: Links that keep their inertial.
        share: Times this: 1, or less where the identified body has no room for them.
    """

    link: FloatArray
    fixed: tuple[str, ...]
    kept: tuple[str, ...]
    share: float


def divided(body: FloatArray, attached: Sequence[Attached]) -> Division:
    """Divide a body: links behind joints keep their inertial, the link of the arm's joint has the rest.

    Args:
        body: (10,) m, m c, I about the joint's frame; of a body that can be.
        attached: What is attached to the link of the joint.
    """
    fixed = tuple(one.link for one in attached if not one.by_joint)
    kept = tuple(one.link for one in attached if one.by_joint)
    theirs = np.sum([np.zeros(10), *(one.inertial for one in attached if one.by_joint)], axis=0)
    if not theirs.any():
        return Division(body, fixed, kept, 1.0)
    least = KEPT_SHARE * np.linalg.eigvalsh(pseudo_inertia(body))[0]
    shares = [0.5**k for k in range(HALVINGS)]
    fits = (one for one in shares if np.linalg.eigvalsh(pseudo_inertia(body - one * theirs))[0] >= least)
    share = next(fits, 0.5**HALVINGS)
    return Division(body - share * theirs, fixed, kept, share)


def attached_links(urdf: str, joints: Sequence[str], moving: Collection[str]) -> dict[str, list[Attached]]:
    """Joint of the arm -> what is attached to its link.

    Args:
        urdf: Text of the description in which no joint but the arm's moves.
        joints: The arm's.
        moving: Joints that are fixed there and move in the file.
    """
    robot = parse_xml(urdf, "the URDF")
    links = {link.get("name", ""): link for link in robot.findall("link")}
    below: dict[str, list[ElementTree.Element]] = {}
    for joint in robot.findall("joint"):
        if joint.get("type") == "fixed":
            below.setdefault(_end(joint, "parent"), []).append(joint)

    def behind(link: str, pose: pin.SE3, by_joint: bool) -> list[Attached]:
        found = []
        for joint in below.get(link, ()):
            child, place = _end(joint, "child"), pose * placement(joint)
            moves = by_joint or joint.get("name", "") in moving
            found.append(Attached(child, moves, _inertial(links[child], place)))
            found += behind(child, place, moves)
        return found

    carried = {joint.get("name", ""): _end(joint, "child") for joint in robot.findall("joint")}
    return {name: behind(carried[name], pin.SE3.Identity(), False) for name in joints}


def _end(joint: ElementTree.Element, which: str) -> str:
    found = joint.find(which)
    return "" if found is None else found.get("link", "")


def _inertial(link: ElementTree.Element, pose: pin.SE3) -> FloatArray:
    """(10,) of a link whose frame stands at a pose, about the frame that the pose is in."""
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    inertia = None if inertial is None else inertial.find("inertia")
    if inertial is None or mass is None or not float(mass.get("value", "0")):
        return np.zeros(10)
    moments = {} if inertia is None else inertia.attrib
    rows = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    tensor = np.array([[float(moments.get(key, "0")) for key in row] for row in rows])
    own = pin.Inertia(float(mass.get("value", "0")), np.zeros(3), tensor)
    return np.array((pose * placement(inertial)).act(own).toDynamicParameters())
