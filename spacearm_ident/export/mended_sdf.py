"""A simulation's own SDF with a model's values: inertials of the arm's links and `<dynamics>` of its joints."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..documents import parse_xml
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..results.attached import attached_links, divided
from ..results.formats import DAMPING, FRICTION, REST, STIFFNESS
from ..results.urdf import inertia_about_centre
from ..simulations.sdf import SdfModel, model_of_arm
from .frames import bodies_of, words
from .law import Nearest

LEAST = 1e-9
"""Mass (kg) and moments of inertia (kg m^2) of a link that has none: negligible, and accepted by physics engines."""
HEAD = re.compile(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", re.DOTALL)
"""What may precede the root element: white space, declarations and comments."""
NOTE = "<!-- Inertials and joint dynamics identified by spacearm_ident; the whole model is in extended_model.yaml -->"


def mended_sdf(path: Path, text: str, arm: Arm, model: IdentifiedModel, fit: Nearest) -> str:
    """The SDF with new values; everything else as it was, comments included.

    What a joint moves is one identified body. The joint's child link has it, less what hangs there by joints that the
    recordings lack and keeps its own; links that fixed joints attach have next to nothing, or they would count twice.

    Args:
        path: For messages.
        text: Contents of the file.
        arm: As it was read from there, without the joints that the recordings lack.
        model: The values; of an arm with the same joints and frames.
        fit: Its joints' damping, friction and stiffness.

    Raises:
        UserError: A body that cannot be.
    """
    root = parse_xml(text, str(path), comments=True)
    element = model_of_arm(root, path, arm.joint_names)
    frames = SdfModel(element, path)
    links = {one.get("name", ""): one for one in element.findall("link")}
    joints = {one.get("name", ""): one for one in element.findall("joint")}
    attached = attached_links(arm.urdf, arm.joint_names, arm.locked)
    for body in bodies_of(model):
        name = body.joint.name
        division = divided(np.array([model.value(symbol, name) for symbol in INERTIAL_SYMBOLS]), attached[name])
        carried = joints[name].findtext("child", "")
        # The anchor's frame has the link's axes.
        _set_body(links[carried], division.link, frames.in_anchor(carried)[1])
        for fixed in division.fixed:
            _set_inertial(links[fixed], LEAST, np.zeros(3), LEAST * np.eye(3))
        for kept in division.kept if division.share < 1.0 else ():
            _scale(links[kept], division.share)
        _set_dynamics(joints[name], fit.values[name])
    head = HEAD.match(text)
    assert head is not None  # It matches nothing, too.
    before, after = text[: head.end()], text[text.rindex(">") + 1 :]
    root.tail = None
    return f"{before}{NOTE}\n{ElementTree.tostring(root, encoding='unicode')}{after}"


def _set_body(link: ElementTree.Element, values: FloatArray, origin: FloatArray) -> None:
    """Give a link a body.

    Args:
        link: The element.
        values: (10,) m, m c, I about the joint's anchor, in the link's axes.
        origin: (3,) of the link's frame, from there.
    """
    _set_inertial(link, float(values[0]), values[1:4] / values[0] - origin, inertia_about_centre(values))


def _set_inertial(link: ElementTree.Element, mass: float, centre: FloatArray, inertia: FloatArray) -> None:
    """Set mass, centre (3,) and inertia (3, 3) about it, in the link's frame."""
    inertial = _child(link, "inertial")
    inertial.attrib.pop("auto", None)
    pose = _child(inertial, "pose")
    pose.attrib.clear()
    pose.text = f"{words(list(centre))} 0 0 0"
    _child(inertial, "mass").text = repr(float(mass))
    for row in range(3):
        for column in range(row, 3):
            name = f"i{'xyz'[row]}{'xyz'[column]}"
            _child(_child(inertial, "inertia"), name).text = repr(float(inertia[row, column]))


def _scale(link: ElementTree.Element, share: float) -> None:
    """Multiply a link's mass and moments of inertia, where it states them."""
    for one in (*link.findall("inertial/mass"), *link.findall("inertial/inertia/*")):
        if isinstance(one.tag, str) and one.text:
            one.text = repr(share * float(one.text))


def _set_dynamics(joint: ElementTree.Element, values: Mapping[str, float]) -> None:
    dynamics = _child(_child(joint, "axis"), "dynamics")
    _child(dynamics, "damping").text = repr(values[DAMPING])
    _child(dynamics, "friction").text = repr(values[FRICTION])
    # A spring that the file does not have and the model does not either is left out.
    if values[STIFFNESS] > 0.0 or dynamics.find("spring_stiffness") is not None:
        _child(dynamics, "spring_stiffness").text = repr(values[STIFFNESS])
        _child(dynamics, "spring_reference").text = repr(values[REST])


def _child(parent: ElementTree.Element, tag: str) -> ElementTree.Element:
    """The child of that name; added where there is none."""
    found = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if found is None else found
