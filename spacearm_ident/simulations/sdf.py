"""SDF (sdformat.org 1.5 to 1.11): links and joints of the model that moves, with `<dynamics>` of their axes.

Poses are x y z roll pitch yaw, rad or degrees. A link's is in the model frame, a joint's in its child link, unless
`relative_to` names another frame. Nested models, includes and splines of frames beyond links and joints are refused.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..dynamics.arm import arm_from_urdf
from ..errors import UserError
from .description import ROOT, TreeJoint, TreeLink, inertials_of, urdf_of
from .names import affixes
from .simulation import JointDynamics, Part, Simulation, simulation_of

KINDS = {"revolute": "revolute", "prismatic": "prismatic", "continuous": "continuous", "fixed": "fixed"}
UNBOUNDED = 1e3
"""rad or m: a range beyond it says nothing (SDF writes 1e16 for none)."""
Pose = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and translation (3,)."""


def read_sdf(path: Path, text: str, joints: Collection[str] = ()) -> Simulation:
    """Read the arm of an SDF: the model with joints that move, whatever stands beside it in the world.

    Args:
        path: For messages, and the simulation's name.
        text: Its contents.
        joints: Of the recordings; where several models have joints that move, the arm is the one that has some of them.

    Raises:
        UserError: No model in it is the arm, or several may be, or it has something that this reader does not do.
    """
    try:
        root = ElementTree.fromstring(text.strip())
        model = model_of_arm(root, path, joints)
        if model.find("include") is not None or model.find("model") is not None:
            raise UserError(f"{path}: nested models are not read: export the arm as one model")
        gravity = np.array([float(v) for v in (root.findtext(".//gravity") or "0 0 -9.81").split()])
        return SdfModel(model, path).simulation(gravity)
    except (ValueError, KeyError, AttributeError) as error:
        raise UserError(f"{path}: not an SDF that can be read ({error}): export it again, or as URDF") from error


def model_of_arm(root: ElementTree.Element, path: Path, joints: Collection[str]) -> ElementTree.Element:
    """The `<model>` that is the arm.

    Args:
        root: Of the SDF; models directly in it or in a world.
        path: For messages.
        joints: Of the recordings; where several models have joints that move, the arm is the one that has some of them,
            or has them under one prefix or suffix.

    Raises:
        UserError: No model has joints that move, or it is not clear which is the arm.
    """
    models = [*root.findall("model"), *root.findall("world/model")]
    if not models:
        raise UserError(f"{path} has no <model>: name the SDF of an arm (an <include> is not followed)")
    driven = [(model, _driven(model)) for model in models]
    moving = [(model, names) for model, names in driven if names]
    if not moving:
        listed = ", ".join(model.get("name", "") for model in models)
        raise UserError(
            f"{path}: no model of the SDF has a joint that moves ({listed}): name the SDF of an arm that is not static "
            "and has revolute, continuous or prismatic joints (an <include> is not followed)"
        )
    recorded = [(model, names) for model, names in moving if set(names) & set(joints)]
    recorded = recorded or [(model, names) for model, names in moving if affixes(names, tuple(joints))]
    if len(moving) > 1 and len(recorded) != 1:
        listed = "; ".join(f"{model.get('name', '')}: {', '.join(names)}" for model, names in moving)
        raise UserError(
            f"{path}: {len(moving)} models of the SDF have joints that move ({listed}), and "
            f"{len(recorded) or 'none'} of them have joints of the recordings ({', '.join(joints) or 'none known'}): "
            "leave only the arm's model in the file, or give its joints the recordings' names"
        )
    return (recorded if len(moving) > 1 else moving)[0][0]


def _driven(model: ElementTree.Element) -> list[str]:
    """Names of the joints of a model that move; none where it is static."""
    if (model.findtext("static") or "").strip() in ("true", "1"):
        return []
    joints = [one for one in model.findall("joint") if one.find("axis") is not None]
    return [one.get("name", "") for one in joints if KINDS.get(one.get("type", ""), "fixed") != "fixed"]


class SdfModel:
    """A `<model>` element with its frames resolved."""

    def __init__(self, model: ElementTree.Element, path: Path) -> None:
        self._model, self._path = model, path
        self._elements = {one.get("name", ""): one for one in model if one.tag in ("link", "joint", "frame")}
        self._known: dict[str, Pose] = {"__model__": (np.eye(3), np.zeros(3)), "world": (np.eye(3), np.zeros(3))}

    def in_anchor(self, link: str) -> Pose:
        """A link's own frame in the frame that its inertial is read in: the link's, moved to its joint's anchor."""
        carried = {joint.findtext("child", ""): joint for joint in self._model.findall("joint")}
        return _after(_inverse(self._frame(link, carried)), self._pose(link))

    def simulation(self, gravity: FloatArray) -> Simulation:
        """The model as a simulation.

        Args:
            gravity: (3,) m/s^2, in the world. An arm's is in its base, and so in the model frame.
        """
        gravity = _pose_of(self._model)[0][0].T @ gravity
        links = [one for one in self._model.findall("link")]
        carried = {joint.findtext("child", ""): joint for joint in self._model.findall("joint")}
        frames = {one.get("name", ""): self._frame(one.get("name", ""), carried) for one in links}
        tree = [self._link(one, carried.get(one.get("name", "")), frames) for one in self._sorted(links, carried)]
        try:
            arm = arm_from_urdf(urdf_of(self._model.get("name", self._path.stem), tree), gravity)
        except UserError as error:
            raise UserError(f"{self._path}: {str(error).replace('the URDF', 'the SDF')}") from error
        names = set(arm.joint_names)
        joints = {one.get("name", ""): _dynamics(one) for one in carried.values() if one.get("name") in names}
        bodies = {one.get("name", ""): child for child, one in carried.items()}
        parts = [Part(name, *where) for name, where in inertials_of(tree).items() if where[0] in names]
        return simulation_of(arm, joints, "sdf", self._path.name, bodies, parts=parts)

    def _sorted(
        self, links: list[ElementTree.Element], carried: dict[str, ElementTree.Element]
    ) -> list[ElementTree.Element]:
        """Carriers before what they carry."""
        left, done, ordered = list(links), {"world"}, []
        while left:
            ready = [one for one in left if self._parent(carried.get(one.get("name", ""))) in done]
            if not ready:
                raise UserError(f"{self._path}: its links do not form a tree")
            ordered += ready
            done |= {one.get("name", "") for one in ready}
            left = [one for one in left if one not in ready]
        return ordered

    @staticmethod
    def _parent(joint: ElementTree.Element | None) -> str:
        return "world" if joint is None else joint.findtext("parent", "")

    def _pose(self, name: str) -> Pose:
        """A link's, joint's or frame's pose in the model frame."""
        if name not in self._known:
            element = self._elements[name]
            own, relative = _pose_of(element)
            base = relative or {"joint": element.findtext("child", ""), "frame": element.get("attached_to", "")}.get(
                element.tag, ""
            )
            self._known[name] = _after(self._pose(base), own) if base else own
        return self._known[name]

    def _frame(self, link: str, carried: dict[str, ElementTree.Element]) -> Pose:
        """A link's frame moved to its joint's anchor, in the model frame."""
        rotation, place = self._pose(link)
        joint = carried.get(link)
        return (rotation, place) if joint is None else (rotation, self._pose(joint.get("name", ""))[1])

    def _link(self, link: ElementTree.Element, joint: ElementTree.Element | None, frames: dict[str, Pose]) -> TreeLink:
        name = link.get("name", "")
        parent = self._parent(joint)
        rotation, place = _after(_inverse(frames.get(parent, self._known["world"])), frames[name])
        inward = _after(_inverse(frames[name]), self._pose(name))
        mass, centre, inertia = _inertial(link, inward)
        own = TreeJoint(f"{name}_fixed", "fixed") if joint is None else self._joint(joint, frames[name])
        carrier = ROOT if parent == "world" else parent
        return TreeLink(name, carrier, rotation, place, own, mass, centre, inertia)

    def _joint(self, joint: ElementTree.Element, frame: Pose) -> TreeJoint:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in KINDS:
            raise UserError(f"{self._path}: joint {name!r} is of type {kind!r}: make it revolute, prismatic or fixed")
        axis = joint.find("axis")
        if kind == "fixed" or axis is None:
            return TreeJoint(name, "fixed")
        written = axis.find("xyz")
        direction = np.array([float(v) for v in (written.text or "").split()] if written is not None else [0.0, 0, 1])
        expressed = "" if written is None else written.get("expressed_in", "")
        reference = self._pose(expressed or name)[0]
        if not np.any(direction):
            raise UserError(f"{self._path}: joint {name!r} has the axis 0 0 0: give it a direction")
        direction = frame[0].T @ reference @ direction / np.linalg.norm(direction)
        lower, upper = (float(axis.findtext(f"limit/{end}", "inf")) for end in ("lower", "upper"))
        effort = float(axis.findtext("limit/effort", "0"))
        bounded = max(abs(lower), abs(upper)) < UNBOUNDED
        if kind == "continuous" or (kind == "revolute" and not bounded):
            return TreeJoint(name, "continuous", direction, effort=max(effort, 0.0))
        ends = (lower, upper) if bounded else (-UNBOUNDED, UNBOUNDED)
        return TreeJoint(name, KINDS[kind], direction, *ends, max(effort, 0.0))


def _pose_of(element: ElementTree.Element) -> tuple[Pose, str]:
    """The pose that an element states, and the frame it is relative to."""
    pose = element.find("pose")
    if pose is None:
        return (np.eye(3), np.zeros(3)), ""
    values = np.array([float(value) for value in (pose.text or "0 0 0 0 0 0").split()])
    if values.shape != (6,):
        raise ValueError(f"a <pose> has six numbers, not {pose.text!r}")
    turned = Rotation.from_euler("xyz", values[3:], degrees=pose.get("degrees") in ("true", "1"))
    return (turned.as_matrix(), values[:3]), pose.get("relative_to", "")


def _inertial(link: ElementTree.Element, inward: Pose) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre and inertia about it, in the frame that the link's own is `inward` of."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    rotation, centre = _after(inward, _pose_of(inertial)[0])
    i = {name: float(inertial.findtext(f"inertia/{name}", "0")) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    tensor = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
    return float(inertial.findtext("mass", "0")), centre, rotation @ tensor @ rotation.T


def _dynamics(joint: ElementTree.Element) -> JointDynamics:
    def number(key: str) -> float:
        return float(joint.findtext(f"axis/dynamics/{key}", "0"))

    return JointDynamics(
        damping=number("damping"),
        friction=number("friction"),
        stiffness=number("spring_stiffness"),
        rest=number("spring_reference"),
    )


def _after(first: Pose, second: Pose) -> Pose:
    return first[0] @ second[0], first[1] + first[0] @ second[1]


def _inverse(pose: Pose) -> Pose:
    return pose[0].T, -pose[0].T @ pose[1]
