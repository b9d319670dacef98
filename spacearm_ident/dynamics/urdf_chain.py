"""One arm out of a robot's URDF: the joints of a chain are kept, every other one is locked where it is.

A robot's description holds more than the arm to identify: fingers, a head, wheels, a torso. `choose_joints` says which
joints are the arm's, `locked` writes a URDF in which only they move. A locked joint becomes a fixed one, its position
in its origin, so that all it carries counts as part of the link that carries it: a gripper is payload. Joints that
mimic others have no drive of their own and are never the arm's.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..documents import parse_xml
from ..errors import UserError
from .urdf_check import check_urdf

DRIVEN = frozenset({"revolute", "continuous", "prismatic"})
"""Joint types with one coordinate."""
FREE = frozenset({"planar", "floating"})
"""Types with more; an arm on a fixed base has none that moves."""
HAND_DEPTH = 4
"""Most joints from palm to fingertip; longer branches are arms, legs or heads."""
_HAND_NAMES = re.compile(r"finger|gripper|knuckle|jaw", re.IGNORECASE)


@dataclass(frozen=True)
class UrdfJoint:
    """A joint element: its name, type, the links it joins, and the joint it mimics (empty: none)."""

    name: str
    kind: str
    parent: str
    child: str
    mimics: str

    @property
    def driven(self) -> bool:
        """Whether it may be one of an arm's joints."""
        return self.kind in DRIVEN and not self.mimics


@dataclass(frozen=True)
class Selection:
    """Which joints move.

    Attributes:
        joints: The arm's, base to tip.
        hand: Joints behind the arm's last one, mimicking ones included; they are locked, and payload.
        others: All other joints that are locked.
    """

    joints: tuple[str, ...]
    hand: tuple[str, ...]
    others: tuple[str, ...]


class JointTree:
    """The joints of a URDF by the links they join.

    Raises:
        UserError: It is no URDF, or `check_urdf` refuses it.
    """

    def __init__(self, urdf: str) -> None:
        if "<robot" not in urdf:
            raise UserError("this is not a URDF: it has no <robot> element")
        check_urdf(urdf)
        self.robot = parse_xml(urdf, "the URDF")
        self.elements = {element.get("name", ""): element for element in self.robot.findall("joint")}
        self.joints = tuple(_joint(element) for element in self.robot.findall("joint"))
        self.by_name = {joint.name: joint for joint in self.joints}
        self._above = {joint.child: joint for joint in self.joints}

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(element.get("name", "") for element in self.robot.findall("link"))

    def path(self, tip: str, base: str | None = None) -> list[UrdfJoint]:
        """All joints from link `base` (None: the root) to link `tip`.

        Raises:
            UserError: One is no link, or `tip` is not behind `base`.
        """
        for link in (tip, base):
            if link is not None and link not in self.links:
                raise UserError(f"the URDF has no link {link!r}: its links are {_some(self.links)}")
        found: list[UrdfJoint] = []
        link = tip
        while link != base and link in self._above:
            found.append(self._above[link])
            link = found[-1].parent
        if base is not None and link != base:
            raise UserError(f"link {tip!r} is not behind link {base!r} in the URDF: exchange --base and --tip?")
        return found[::-1]

    def moving_below(self) -> dict[str, list[str]]:
        """Joint with a coordinate -> the next such joints towards the tips, mimicking ones included; '' is the root."""
        below: dict[str, list[str]] = {"": []}
        for joint in self.joints:
            if joint.kind in DRIVEN:
                ahead = [other.name for other in self.path(joint.parent) if other.kind in DRIVEN]
                below.setdefault(ahead[-1] if ahead else "", []).append(joint.name)
        return below


def choose_joints(urdf: str, base: str | None = None, tip: str | None = None, names: Sequence[str] = ()) -> Selection:
    """Which joints are the arm's.

    Args:
        urdf: Text of the description.
        base: Link at which the arm begins; None: the root.
        tip: Link at which it ends. None: the longest chain behind `base` is taken, up to the hand. A hand is what
            branches into short chains, mimics, or has the name of a gripper.
        names: The arm's joints by name, in place of `base` and `tip`.

    Raises:
        UserError: A joint or link is not there, cannot be driven, or several chains are equally long.
    """
    tree = JointTree(urdf)
    if names:
        chosen = _named(tree, names)
    elif tip is not None:
        chosen = [joint.name for joint in tree.path(tip, base) if joint.driven]
    else:
        chosen = _longest(tree, base)
    if not chosen:
        raise UserError("no joint between base and tip can be driven: choose others with --base, --tip or --joints")
    behind = {joint.name for joint in tree.joints if chosen[-1] in {other.name for other in tree.path(joint.parent)}}
    locked_ones = [j.name for j in tree.joints if j.kind in DRIVEN | FREE and j.name not in chosen]
    return Selection(
        tuple(chosen),
        tuple(name for name in locked_ones if name in behind),
        tuple(name for name in locked_ones if name not in behind),
    )


def of_a_hand(joint: str) -> bool:
    """Whether a joint has the name of a gripper's."""
    return _HAND_NAMES.search(joint) is not None


def mimicking(urdf: str, leaders: Collection[str] | None = None) -> tuple[str, ...]:
    """Joints that mimic others, and so have no drive of their own.

    Args:
        urdf: Text of the description.
        leaders: Only those that mimic one of these; None: all.
    """
    mimics = [joint for joint in JointTree(urdf).joints if joint.kind in DRIVEN and joint.mimics]
    return tuple(joint.name for joint in mimics if leaders is None or joint.mimics in leaders)


def locked(urdf: str, joints: Iterable[str], at: Mapping[str, float] | None = None) -> str:
    """The URDF with some joints fixed where they are.

    Args:
        urdf: Text of the description.
        joints: Which to lock.
        at: Joint -> position, rad or m; zero elsewhere, or the limit nearest to it. What mimics goes with what it
            mimics. Planar and floating joints stay at zero.

    Raises:
        UserError: `at` names a joint that is not locked, or that has no position to lock.
    """
    tree, wanted, given = JointTree(urdf), set(joints), dict(at or {})
    for name in given:
        joint = tree.by_name.get(name)
        if joint is None or not joint.driven or name not in wanted:
            raise UserError(f"joint {name!r} cannot be locked at a position: {_why_not(joint)}")
    for element in tree.robot.findall("joint"):
        name = element.get("name", "")
        if name in wanted and element.get("type") in DRIVEN | FREE:
            _fix(element, _position(tree, element, given))
    return ET.tostring(tree.robot, encoding="unicode")


def locked_as_in(urdf: str, other: str) -> str:
    """The URDF with those joints fixed that are fixed in another one, where they are there.

    Args:
        urdf: Text of the description.
        other: Text of a description of the same robot in which some joints are locked.

    Raises:
        UserError: One of them is no URDF.
    """
    tree, theirs = JointTree(urdf), JointTree(other)
    names = [
        joint.name
        for joint in tree.joints
        if joint.kind in DRIVEN | FREE and joint.name in theirs.by_name and theirs.by_name[joint.name].kind == "fixed"
    ]
    driven = [name for name in names if tree.by_name[name].driven]
    return locked(urdf, names, {name: _moved_by(tree.elements[name], theirs.elements[name]) for name in driven})


def bounded(urdf: str) -> str:
    """The URDF with continuous joints made revolute, whose limits are far beyond any motion.

    Pinocchio keeps the angle of a continuous joint as cosine and sine; with this its coordinate is the angle.
    """
    if "continuous" not in urdf:
        return urdf
    robot = parse_xml(urdf, "the URDF")
    for element in robot.findall("joint"):
        if element.get("type") == "continuous":
            element.set("type", "revolute")
            limit = element.find("limit")
            limit = ET.SubElement(element, "limit", effort="0", velocity="0") if limit is None else limit
            limit.attrib |= {"lower": "-1e4", "upper": "1e4"}
    return ET.tostring(robot, encoding="unicode")


def with_limits(urdf: str) -> str:
    """The URDF with zeros for limits that it leaves out and that the parser asks for.

    It refuses a whole description for one joint without `<limit>`, or for a `<limit>` without effort or velocity.
    """
    robot, added = parse_xml(urdf, "the URDF"), False
    for element in robot.findall("joint"):
        limit = element.find("limit")
        if limit is None and element.get("type") in ("revolute", "prismatic"):
            limit = ET.SubElement(element, "limit")
        for key in ("effort", "velocity"):
            if limit is not None and key not in limit.attrib:
                limit.set(key, "0")
                added = True
    return ET.tostring(robot, encoding="unicode") if added else urdf


def _joint(element: ET.Element) -> UrdfJoint:
    def attribute(tag: str, key: str) -> str:
        found = element.find(tag)
        return "" if found is None else found.get(key, "")

    return UrdfJoint(
        element.get("name", ""),
        element.get("type", ""),
        attribute("parent", "link"),
        attribute("child", "link"),
        attribute("mimic", "joint"),
    )


def _named(tree: JointTree, names: Sequence[str]) -> list[str]:
    """The joints of these names, base to tip as the URDF's parser orders them."""
    for name in names:
        joint = tree.by_name.get(name)
        if joint is None or not joint.driven:
            known = _some([joint.name for joint in tree.joints if joint.driven])
            raise UserError(f"--joints {name}: {_why_not(joint)}; the joints that can be driven are {known}")
    return sorted(set(names), key=lambda name: len(tree.path(tree.by_name[name].child)))


def _why_not(joint: UrdfJoint | None) -> str:
    if joint is None:
        return "the URDF has no such joint"
    if joint.mimics:
        return f"it mimics {joint.mimics}, name that one"
    return f"it is {joint.kind}" if joint.kind not in DRIVEN else "it is one of the arm's own"


def _longest(tree: JointTree, base: str | None) -> list[str]:
    """The longest chain of driven joints behind a link, up to the hand.

    Raises:
        UserError: There are several.
    """
    hand = hand_joints(tree)
    inside = [j for j in tree.joints if j.driven and _behind(tree, j, base)]
    ends = [j for j in inside if j.name not in hand] or inside  # a finger may be all there is
    chains = [[other.name for other in tree.path(j.child, base) if other.driven] for j in ends]
    longest = [chain for chain in chains if len(chain) == max(map(len, chains))]
    if len(longest) > 1:
        tips = " or ".join(f"--tip {tree.by_name[chain[-1]].child}" for chain in longest[:6])
        raise UserError(f"the URDF has {len(longest)} chains of {len(longest[0])} joints: say which is the arm, {tips}")
    return longest[0] if longest else []


def _behind(tree: JointTree, joint: UrdfJoint, base: str | None) -> bool:
    if base is None:
        return True
    if base not in tree.links:
        tree.path(base)  # says which links there are
    return any(other.parent == base for other in tree.path(joint.child))


def hand_joints(tree: JointTree) -> set[str]:
    """Joints of hands: behind a joint that carries several short chains only, by name, and all behind those.

    A joint that mimics another is one as well where it carries none with a drive of its own.
    """
    below = tree.moving_below()

    def all_below(name: str) -> list[str]:
        return [one for child in below.get(name, ()) for one in (child, *all_below(child))]

    def depth(name: str) -> int:
        return 1 + max(map(depth, below.get(name, ())), default=0)

    found: set[str] = set()
    for name, children in below.items():
        if name and len(children) > 1 and all(depth(child) <= HAND_DEPTH for child in children):
            found.update(all_below(name))
    for joint in tree.joints:
        follows = joint.mimics and not any(tree.by_name[name].driven for name in all_below(joint.name))
        if follows or (_HAND_NAMES.search(joint.name) and depth(joint.name) <= HAND_DEPTH):
            found.update((joint.name, *all_below(joint.name)))
    return found


def _position(tree: JointTree, element: ET.Element, given: Mapping[str, float]) -> float:
    """Where a joint is locked, rad or m."""
    mimic = element.find("mimic")
    if mimic is not None:
        leader = tree.elements.get(mimic.get("joint", ""))
        own = 0.0 if leader is None or leader.find("mimic") is not None else _position(tree, leader, given)
        return own * float(mimic.get("multiplier", 1.0)) + float(mimic.get("offset", 0.0))
    name = element.get("name", "")
    if name in given:
        return given[name]
    limit = element.find("limit")
    if limit is None or element.get("type") == "continuous":
        return 0.0
    low, high = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
    return min(max(0.0, low), high) if low <= high else 0.0


def _fix(element: ET.Element, position: float) -> None:
    """Make a joint fixed, its motion from zero to `position` in its origin.

    Raises:
        UserError: It has no axis.
    """
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    if element.get("type") in DRIVEN and position:
        motion = position * _direction(element)
        if element.get("type") == "prismatic":
            moved = placement(element) * pin.SE3(np.eye(3), motion)
        else:
            moved = placement(element) * pin.SE3(pin.exp3(motion), np.zeros(3))
        origin.set("xyz", " ".join(f"{value:.12g}" for value in moved.translation))
        origin.set("rpy", " ".join(f"{value:.12g}" for value in pin.rpy.matrixToRpy(moved.rotation)))
    element.set("type", "fixed")
    for tag in ("axis", "mimic", "limit", "dynamics", "safety_controller", "calibration"):
        for part in element.findall(tag):
            element.remove(part)


def _moved_by(element: ET.Element, fixed: ET.Element) -> float:
    """Position, rad or m, that brings a joint nearest to where it is fixed.

    Raises:
        UserError: It has no axis.
    """
    motion = placement(element).actInv(placement(fixed))
    offset = motion.translation if element.get("type") == "prismatic" else pin.log3(motion.rotation)
    return float(_direction(element) @ offset)


def placement(element: ET.Element) -> pin.SE3:
    """The `<origin>` of a joint in its parent link, or of an inertial in its link."""
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    rotation = pin.rpy.rpyToMatrix(np.array(_numbers(given.get("rpy", "0 0 0"))))
    return pin.SE3(rotation, np.array(_numbers(given.get("xyz", "0 0 0"))))


def _direction(element: ET.Element) -> FloatArray:
    """(3,) unit axis of a joint in its own frame.

    Raises:
        UserError: It has none.
    """
    axis = element.find("axis")
    direction = np.array(_numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0")))
    if not direction.any():
        raise UserError(f"joint {element.get('name')!r} has the axis 0 0 0: give it a direction")
    return np.asarray(direction / np.linalg.norm(direction))


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def _some(names: Collection[str], most: int = 12) -> str:
    listed = list(names)
    return ", ".join(listed[:most]) + (f" and {len(listed) - most} more" if len(listed) > most else "")
