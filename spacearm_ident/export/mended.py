"""The simulation, mended: the same file with identified values, as far as its format can hold them.

What a format has no place for is fitted by what it has (`export.law.nearest`), and what that costs is stated by joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..documents import parse_xml
from ..dynamics.model import IdentifiedModel
from ..errors import UserError
from ..layers.item import Mended
from ..results.formats import ARMATURE, DAMPING, FRICTION, MJCF, SDF, STIFFNESS, URDF
from ..results.urdf import identified_urdf
from ..signals.motion import Motion
from ..simulations import Simulation
from ..simulations.mjcf import mujoco_or_error
from .closed_loop import follow
from .frames import bodies_of, quaternion
from .law import Nearest, nearest
from .sdf import sdf


def mend(simulation: Simulation, path: Path, model: IdentifiedModel, motions: Sequence[Motion]) -> Mended | None:
    """The simulation's own file with a model's values; None for a format that holds the model as it is.

    Args:
        simulation: As it was read.
        path: Its file.
        model: The values; bodies such as can be.
        motions: Where the format's parameters are to be near the model's; with the arm's torque there.

    Raises:
        UserError: A body that cannot be.
    """
    form = {"mjcf": MJCF, "urdf": URDF, "sdf": SDF}.get(simulation.format)
    if form is None:
        return None
    fit = nearest(model, form, motions)
    if simulation.format == "mjcf":
        mujoco = mujoco_or_error()
        spec, original = _mjcf(mujoco, path, model, fit), mujoco.MjModel.from_xml_path(str(path))
        runs = [follow(mujoco, one, original, motions) for one in (original, spec.compile())]
        return replace(_mended("mended.xml", str(spec.to_xml()), fit), closed_loop=(runs[0], runs[1]))
    dynamics = {joint: (own[DAMPING], own[FRICTION]) for joint, own in fit.values.items()}
    text = identified_urdf(model, dynamics)
    if simulation.format == "sdf":
        mended = _mended("mended.sdf", sdf(model, fit, [f"{simulation.source}, mended by spacearm_ident"]), fit)
        if _springs(simulation, fit):
            return mended
        # MuJoCo reads no SDF; a URDF holds the same bodies, damping and friction.
        before = identified_urdf(simulation.model)
    else:
        mended, before = _mended("mended.urdf", text, fit), path.read_text()
    original, new = (_urdf_in_mujoco(one, simulation) for one in (before, text))
    if original is None or new is None:
        return mended
    runs = [follow(mujoco_or_error(), one, original, motions) for one in (original, new)]
    return replace(mended, closed_loop=(runs[0], runs[1]))


def _springs(simulation: Simulation, fit: Nearest) -> bool:
    """Whether a joint has a spring, before or after, which a URDF has no place for."""
    was = (value for name, value in simulation.values.items() if name.startswith(f"{STIFFNESS}["))
    return any(was) or any(own.get(STIFFNESS, 0.0) for own in fit.values.values())


def _mended(name: str, text: str, fit: Nearest) -> Mended:
    return Mended(name, text, fit.lost, fit.cost_Nm, fit.torque_Nm)


def _urdf_in_mujoco(text: str, simulation: Simulation) -> Any | None:
    """The `MjModel` of a URDF without its shapes; None where MuJoCo is not installed or refuses it.

    A link that moves and has no mass is given the least that MuJoCo accepts.
    """
    try:
        mujoco = mujoco_or_error()
    except UserError:
        return None
    root = parse_xml(text, simulation.source)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for old in root.findall("mujoco"):
        root.remove(old)
    least = {"boundmass": str(LEAST), "boundinertia": str(LEAST), "balanceinertia": "true"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", least)
    try:
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError):
        return None
    model.opt.gravity = simulation.arm.gravity
    # Without the rotors, which a URDF cannot hold, damping beside the inertia of a last link is stiff.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def _mjcf(mujoco: ModuleType, path: Path, model: IdentifiedModel, fit: Nearest) -> Any:
    """The MJCF with new inertials, armature, damping and friction loss; everything else as it was."""
    spec = mujoco.MjSpec.from_file(str(path))
    joints = frozenset(model.model.arm.joint_names)
    for body in bodies_of(model):
        joint = spec.joint(body.joint.name)
        carrier = joint.parent
        carrier.explicitinertial = True
        carrier.mass = body.mass
        carrier.ipos = body.centre + joint.pos
        principal, axes = np.linalg.eigh(body.inertia)
        carrier.inertia, carrier.fullinertia = principal, [np.nan] * 6
        carrier.iquat = quaternion(axes * np.sign(np.linalg.det(axes)))
        for fixed in _fixed(carrier, joints):
            # Its mass is part of the body that carries it: kept here as well, it would count twice.
            fixed.explicitinertial = True
            fixed.mass = LEAST
            fixed.inertia = [LEAST] * 3
            fixed.fullinertia = [np.nan] * 6
        values = fit.values[body.joint.name]
        joint.armature = values[ARMATURE]
        joint.damping = _first(joint.damping, values[DAMPING])
        joint.frictionloss = values[FRICTION]
        if values.get(STIFFNESS):
            joint.stiffness = _first(joint.stiffness, values[STIFFNESS])
    return spec


LEAST = 1e-9
"""kg and kg m^2: nothing to an arm, and enough for MuJoCo to accept a body."""


def _first(old: Any, value: float) -> Any:
    """A value in the shape that this MuJoCo keeps it: a number, or the first coefficient of a polynomial."""
    try:
        coefficients = list(old)
    except TypeError:
        return value
    return [value, *([0.0] * (len(coefficients) - 1))]


def _fixed(body: Any, joints: frozenset[str]) -> list[Any]:
    """Bodies that none of the arm's joints moves against a body that carries them, directly or through one another."""
    found = []
    for child in body.bodies:
        if not any(joint.name in joints for joint in child.joints):
            found += [child, *_fixed(child, joints)]
    return found
