"""`identified.urdf`: the arm's own URDF with what was identified put in its place, and nothing else touched.

Identified inertials are of the body a joint moves, about the joint's frame, which is the frame of the joint's
child link. Links that fixed joints attach to it are part of that body: theirs are taken out, or they would count
twice. In a description whose other joints still move, what hangs on it by those keeps its own, and the link has the
rest. What hangs on the base by fixed joints alone moves nothing and stays as it was. A URDF has no place for
rotor inertias, springs, Stribeck friction or couplings: those live in `model.yaml`.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.dom.expatbuilder import ExpatBuilder
from xml.dom.minidom import Document, Element
from xml.parsers.expat import ExpatError

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..errors import UserError
from .attached import attached_links, divided

INERTIA_ATTRIBUTES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
NOTE = (
    " Inertials, damping (k_v1) and friction (f_c) identified by spacearm_ident;"
    " rotor inertias and the rest of the model are in model.yaml "
)


CORRECTED_NOTE = (
    " Inertials, damping and friction as spacearm_ident corrected them; the whole model is in extended_model.yaml "
)


def identified_urdf(
    identified: IdentifiedModel,
    dynamics: Mapping[str, tuple[float, float]] | None = None,
    own: str | None = None,
    note: str = NOTE,
) -> str:
    """The text of the URDF with identified inertials and `<dynamics damping friction>`.

    Links keep their names, frames, visuals and limits. The inertia is about the centre of mass along the link's
    axes. Damping is the joint's k_v1 (N·m·s/rad) and friction its f_c (N·m), neither below zero.

    Args:
        identified: The model.
        dynamics: Joint -> damping and friction, instead of those.
        own: Text of the arm's description with the joints that the arm has fixed; None: the arm's.
        note: Comment at the top.

    Raises:
        UserError: The URDF declares a document type, is not well-formed, or a link has no positive mass.
    """
    arm = identified.model.arm
    document = _parse(arm.urdf if own is None else own)
    robot = document.documentElement
    assert robot is not None  # A document without a root element is not well-formed.
    links = {link.getAttribute("name"): link for link in _children(robot, "link")}
    joints = {joint.getAttribute("name"): joint for joint in _children(robot, "joint")}
    moving = {name for name, joint in joints.items() if joint.getAttribute("type") != "fixed"}
    attached = attached_links(arm.urdf, arm.joint_names, moving)
    for name in arm.joint_names:
        values = np.array([identified.value(symbol, name) for symbol in INERTIAL_SYMBOLS])
        division = divided(values, attached[name])
        for merged in division.fixed:
            _remove(links[merged], "inertial")
        for kept in division.kept if division.share < 1.0 else ():
            _scale(links[kept], division.share)
        _set_inertial(document, links[_end(joints[name], "child")], division.link)
        _set_dynamics(document, joints[name], identified, (dynamics or {}).get(name))
    robot.insertBefore(document.createComment(note), robot.firstChild)
    return "\n".join(['<?xml version="1.0"?>', *(node.toxml() for node in document.childNodes), ""])


class _Builder(ExpatBuilder):
    """Builds the document; refuses a document type, and with it every entity that could expand or be fetched.

    Names are taken as written: namespaces are left alone, so that an undeclared prefix, which robots' parsers
    accept, is no error and comes out as it went in.
    """

    def start_doctype_decl_handler(self, *_: object) -> None:
        raise UserError("the URDF has a DOCTYPE: take it and its entities out (xacro does that)")


def _parse(text: str) -> Document:
    try:
        return _Builder().parseString(text.strip())
    except ExpatError as error:
        raise UserError(f"the URDF is not well-formed XML ({error}): mend it, or export it again") from error


def _children(parent: Element, tag: str) -> list[Element]:
    return [node for node in parent.childNodes if isinstance(node, Element) and node.tagName == tag]


def _end(joint: Element, which: str) -> str:
    """The link at one end of a joint, `parent` or `child`."""
    return str(_children(joint, which)[0].getAttribute("link"))


def _scale(link: Element, share: float) -> None:
    """Multiply a link's mass and moments of inertia, where it states them."""
    for inertial in _children(link, "inertial"):
        for one in [*_children(inertial, "mass"), *_children(inertial, "inertia")]:
            for key in ("value", *INERTIA_ATTRIBUTES):
                if one.hasAttribute(key):
                    one.setAttribute(key, repr(share * float(one.getAttribute(key))))


def _remove(parent: Element, tag: str) -> None:
    """Take out every child of that name, with the white space before it."""
    for node in _children(parent, tag):
        before = node.previousSibling
        if before is not None and before.nodeType == before.TEXT_NODE and not before.data.strip():
            parent.removeChild(before)
        parent.removeChild(node)


def _set_inertial(document: Document, link: Element, values: FloatArray) -> None:
    """Replace a link's inertial by (10,) m, m·c, I about the link's frame."""
    _remove(link, "inertial")
    mass = values[0]
    if not mass > 0.0:
        name = link.getAttribute("name")
        raise UserError(f"link {name!r} was identified without a positive mass: give the arm a CAD prior with masses")
    centre = values[1:4] / mass
    about_centre = inertia_about_centre(values)
    inertial = document.createElement("inertial")
    origin = _add(document, inertial, "origin")
    origin.setAttribute("xyz", " ".join(repr(float(c)) for c in centre))
    origin.setAttribute("rpy", "0 0 0")
    _add(document, inertial, "mass").setAttribute("value", repr(float(mass)))
    inertia = _add(document, inertial, "inertia")
    for attribute in sorted(INERTIA_ATTRIBUTES):
        row, column = ("xyz".index(axis) for axis in attribute[1:])
        inertia.setAttribute(attribute, repr(float(about_centre[row, column])))
    link.insertBefore(inertial, link.firstChild)
    link.insertBefore(document.createTextNode("\n    "), inertial)


def inertia_about_centre(values: FloatArray) -> FloatArray:
    """(3, 3) inertia about the centre of mass, by the parallel axis theorem.

    Args:
        values: (10,) m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the frame's origin, kg, kg m, kg m^2.
    """
    centre = values[1:4] / values[0]
    about_origin = values[4:][[0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(3, 3)
    return np.asarray(about_origin - values[0] * (centre @ centre * np.eye(3) - np.outer(centre, centre)))


def _add(document: Document, parent: Element, tag: str) -> Element:
    child = document.createElement(tag)
    parent.appendChild(child)
    return child


def _set_dynamics(
    document: Document, joint: Element, identified: IdentifiedModel, given: tuple[float, float] | None
) -> None:
    """Set damping and friction of a joint; what the model has no value for stays as it was."""
    present = _children(joint, "dynamics")
    dynamics = present[0] if present else document.createElement("dynamics")
    for place, (attribute, symbol) in enumerate((("damping", "k_v1"), ("friction", "f_c"))):
        try:
            value = identified.value(symbol, joint.getAttribute("name")) if given is None else given[place]
        except KeyError:
            continue
        dynamics.setAttribute(attribute, repr(max(0.0, value)))
    if not present and dynamics.hasAttributes():
        _append(document, joint, dynamics)


def _append(document: Document, parent: Element, child: Element) -> None:
    """Append a child on a line of its own."""
    last = parent.lastChild
    indented = last is not None and last.nodeType == last.TEXT_NODE
    place = last if indented else None
    parent.insertBefore(document.createTextNode("\n    "), place)
    parent.insertBefore(child, place)
