"""The simulation, mended: the same file with identified values, as far as its format can hold them.

What a format has no place for is fitted by what it has (`export.law.nearest`), and what that costs is stated by joint.
The file is read again as any simulation is, and judged as it is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..documents import parse_xml, parse_yaml
from ..dynamics.model import IdentifiedModel
from ..errors import UserError
from ..layers.item import Mended
from ..results.formats import ARMATURE, DAMPING, FRICTION, MJCF, REST, SDF, STIFFNESS, URDF
from ..results.urdf import CORRECTED_NOTE, identified_urdf
from ..signals.motion import Motion
from ..simulations import Simulation, read_simulation
from ..simulations.mjcf import mujoco_or_error, simulation_of_mujoco
from ..simulations.simulation import without
from .closed_loop import follow
from .frames import bodies_of, principal, quaternion
from .law import Nearest, nearest
from .mended_sdf import LEAST, mended_sdf


def mend(simulation: Simulation, path: Path, model: IdentifiedModel, motions: Sequence[Motion]) -> Mended | None:
    """The simulation's own file with a model's values; None for a format that holds the model as it is.

    Args:
        simulation: As it was read.
        path: Its file.
        model: The values; bodies such as can be.
        motions: Where the format's parameters are to be near the model's; with the arm's torque there.

    Raises:
        UserError: A body that cannot be, or a file that MuJoCo refuses.
    """
    form = {"mjcf": MJCF, "urdf": URDF, "sdf": SDF}.get(simulation.format)
    if form is None:
        return None
    fit = nearest(model, form, motions)
    if simulation.format == "mjcf":
        mujoco = mujoco_or_error()
        text, original = _mjcf(mujoco, path, model, fit), mujoco.MjModel.from_xml_path(str(path))
        new = _compiled(mujoco, text, path)
        runs = [follow(mujoco, one, original, motions) for one in (original, new)]
        excess = _excess(simulation_of_mujoco(mujoco, new, path), model, motions)
        return replace(_mended("mended.xml", text, fit), excess=excess, closed_loop=(runs[0], runs[1]))
    dynamics = {joint: (own[DAMPING], own[FRICTION]) for joint, own in fit.values.items()}
    if simulation.format == "sdf":
        own = path.read_text(encoding="utf-8")
        mended = _mended("mended.sdf", mended_sdf(path, own, simulation.arm, model, fit), fit)
        mended = replace(mended, excess=_excess(_read_again(mended.text, mended.name, model), model, motions))
        if _springs(simulation, fit):
            return mended
        # MuJoCo reads no SDF; a URDF holds the same bodies, damping and friction.
        before, text = identified_urdf(simulation.model), identified_urdf(model, dynamics)
    else:
        before = _own_urdf(path)
        text = identified_urdf(model, dynamics, before, CORRECTED_NOTE)
        mended = _mended("mended.urdf", text, fit)
        mended = replace(mended, excess=_excess(_read_again(text, mended.name, model), model, motions))
    original, new = (_urdf_in_mujoco(one, simulation) for one in (before, text))
    if original is None or new is None:
        return mended
    runs = [follow(mujoco_or_error(), one, original, motions) for one in (original, new)]
    return replace(mended, closed_loop=(runs[0], runs[1]))


def _own_urdf(path: Path) -> str:
    """The text of the URDF that a file is, or that an arm YAML names."""
    text = path.read_text(encoding="utf-8")
    if path.suffix not in (".yaml", ".yml"):
        return text
    return (path.parent / str(parse_yaml(text, str(path))["urdf"])).read_text(encoding="utf-8")


def _springs(simulation: Simulation, fit: Nearest) -> bool:
    """Whether a joint has a spring, before or after, which a URDF has no place for."""
    was = (value for name, value in simulation.values.items() if name.startswith(f"{STIFFNESS}["))
    return any(was) or any(own.get(STIFFNESS, 0.0) for own in fit.values.values())


def _mended(name: str, text: str, fit: Nearest) -> Mended:
    return Mended(name, text, fit.lost, fit.cost_Nm, fit.torque_Nm)


def _read_again(text: str, name: str, model: IdentifiedModel) -> Simulation:
    """The simulation of a description's text, with the joints of a model."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(text, encoding="utf-8")
        return read_simulation(path, model.model.arm.joint_names)


def _excess(file: Simulation, model: IdentifiedModel, motions: Sequence[Motion]) -> FloatArray:
    """(n,) RMS of what a file leaves of the motions' torque where a joint moves, over what the model leaves."""
    arm = model.model.arm
    same = without(file, [name for name in file.arm.joint_names if name not in arm.joint_names])
    squares = np.zeros((2, len(arm.joints)))
    for motion in motions:
        for k, one in enumerate((same.model.with_gravity(arm.gravity), model)):
            left = motion.torque_rows - motion.reduce(one.torque(motion))
            squares[k] += (left**2 * motion.moving).sum(axis=0)
    return np.asarray(np.sqrt(squares[0] / np.where(squares[1] > 0.0, squares[1], np.inf)))


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


def _compiled(mujoco: ModuleType, text: str, path: Path) -> Any:
    """The `MjModel` of an MJCF's text, its meshes where those of the file `path` are.

    Raises:
        UserError: MuJoCo refuses it.
    """
    try:
        spec = mujoco.MjSpec.from_string(text)
        spec.modelfiledir = str(path.parent)
        return spec.compile()
    except ValueError as error:
        raise UserError(f"MuJoCo refuses the corrected MJCF: {str(error).strip().splitlines()[0]}") from error


def _mjcf(mujoco: ModuleType, path: Path, model: IdentifiedModel, fit: Nearest) -> str:
    """The MJCF with new inertials, armature, damping, friction loss and springs; everything else as it was."""
    spec = mujoco.MjSpec.from_file(str(path))
    # What would replace the inertials that are written here.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass, spec.compiler.boundmass, spec.compiler.boundinertia = -1.0, 0.0, 0.0
    joints = frozenset(model.model.arm.joint_names)
    for body in bodies_of(model):
        joint = spec.joint(body.joint.name)
        carrier = joint.parent
        carrier.explicitinertial = True
        carrier.mass = body.mass
        carrier.ipos = body.centre + joint.pos
        moments, axes = principal(body.inertia)
        carrier.inertia, carrier.fullinertia, carrier.iquat = moments, [np.nan] * 6, quaternion(axes)
        for fixed in _fixed(carrier, joints):
            # Its mass is part of the body that carries it: kept here as well, it would count twice.
            fixed.explicitinertial = True
            fixed.mass = LEAST
            fixed.ipos, fixed.iquat = [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
            fixed.inertia, fixed.fullinertia = [LEAST] * 3, [np.nan] * 6
        values = fit.values[body.joint.name]
        joint.armature = values[ARMATURE]
        joint.damping = _first(joint.damping, values[DAMPING])
        joint.frictionloss = values[FRICTION]
        joint.stiffness = _first(joint.stiffness, values[STIFFNESS])
        if values[STIFFNESS]:
            in_degrees = spec.compiler.degree and body.joint.revolute
            joint.springref = np.degrees(values[REST]) if in_degrees else values[REST]
    spec.compile()
    return str(spec.to_xml())


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
