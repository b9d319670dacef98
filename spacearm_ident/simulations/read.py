"""Read a simulation, whatever format it is in."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

from ..documents import parse_yaml, read_text
from ..dynamics.arm import ARM_SCHEMA, Arm, arm_from_urdf, load_arm
from ..dynamics.model_file import load_model
from ..errors import UserError
from .mjcf import read_mjcf
from .sdf import read_sdf
from .simulation import JointDynamics, Simulation, simulation_of

SIMULATION_SUFFIXES = (".xml", ".mjcf", ".urdf", ".sdf", ".world", ".yaml", ".yml")
"""Files that are read here; anything else given as a simulation is a bag that a simulator wrote."""


def read_simulation(path: Path, joints: Collection[str] = ()) -> Simulation:
    """Read an MJCF, a URDF, an SDF, an arm YAML or a `model.yaml`.

    Args:
        path: The file.
        joints: Of the recordings, by which the arm is chosen where an SDF has several models that move.

    Raises:
        UserError: The file is missing or is none of these; the message says what to give.
    """
    text = read_text(path, "the simulation")
    if path.suffix in (".yaml", ".yml"):
        data = parse_yaml(text, str(path))
        if isinstance(data, dict) and data.get("schema") == ARM_SCHEMA:
            return of_urdf(load_arm(path), path.name)
        # What `identify` blends into predicted torque belongs to no body: a simulation is an arm that could be.
        return Simulation(load_model(path).possible, "model", path.name)
    root = _root(text, path)
    if root == "mujoco":
        return read_mjcf(path)
    if root == "robot":
        return of_urdf(arm_from_urdf(text), path.name)
    if root == "sdf":
        return read_sdf(path, text, joints)
    raise UserError(f"{path} is no simulation: give an MJCF, a URDF, an SDF, a model.yaml, or a simulator's bag")


def of_urdf(arm: Arm, source: str) -> Simulation:
    """What simulators make of a URDF: its inertials, and `<dynamics damping friction>` where it has them.

    Args:
        arm: Its URDF states damping and friction of the joints; only joints of the arm get them.
        source: The file, as a person would name it.
    """
    joints, bodies = {}, {}
    for joint in ElementTree.fromstring(arm.urdf).findall("joint"):
        name = joint.get("name", "")
        child, dynamics = joint.find("child"), joint.find("dynamics")
        if child is not None:
            bodies[name] = child.get("link", name)
        if dynamics is not None and name in arm.joint_names:
            joints[name] = JointDynamics(
                damping=_number(dynamics, "damping", name), friction=_number(dynamics, "friction", name)
            )
    return simulation_of(arm, joints, "urdf", source, {name: bodies.get(name, name) for name in arm.joint_names})


def _number(element: ElementTree.Element, key: str, joint: str) -> float:
    try:
        return float(element.get(key) or 0.0)
    except ValueError as error:
        raise UserError(f"joint {joint!r}: <dynamics {key}> is not a number: {element.get(key)!r}") from error


def _root(text: str, path: Path) -> str:
    """Name of the root element."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UserError(f"{path} has a DOCTYPE or entities: take them out")
    try:
        return ElementTree.fromstring(text.strip()).tag
    except ElementTree.ParseError as error:
        raise UserError(f"{path} is not well-formed XML ({error}): mend it, or export it again") from error
