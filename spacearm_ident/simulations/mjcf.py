"""MJCF, read by MuJoCo itself: defaults, includes, inertia from shapes and units are as the simulator has them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..dynamics.arm import arm_from_urdf
from ..errors import UserError
from .description import ROOT, TreeJoint, TreeLink, inertials_of, urdf_of
from .simulation import JointDynamics, Part, Simulation, simulation_of

UNBOUNDED = 1e3
"""rad or m: a range beyond it says nothing."""


def mujoco_or_error() -> ModuleType:
    """The `mujoco` module.

    Raises:
        UserError: It is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise UserError("an MJCF is read by MuJoCo: pip install 'spacearm_ident[mujoco]'") from error
    module: ModuleType = mujoco
    return module


def read_mjcf(path: Path) -> Simulation:
    """Read the arm of an MJCF: every hinge and slide joint, its body with all that is fixed to it, its parameters.

    Raises:
        UserError: MuJoCo is not installed or refuses the file, or a joint is neither a hinge nor a slide.
    """
    mujoco = mujoco_or_error()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError, RuntimeError) as error:
        detail = (str(error).strip().splitlines() or ["no reason given"])[0]
        raise UserError(f"MuJoCo cannot read {path}: {detail}") from error
    return simulation_of_mujoco(mujoco, model, path)


def simulation_of_mujoco(mujoco: ModuleType, model: Any, path: Path) -> Simulation:
    """The same of an `MjModel`, which `path` has.

    Raises:
        UserError: It has no joint, or one that is neither a hinge nor a slide.
    """
    if model.njnt == 0:
        raise UserError(f"{path} has no joint: name the MJCF of an arm")
    links = _links(mujoco, model, path)
    arm = arm_from_urdf(urdf_of(_name(mujoco, model, "OBJ_MODEL", 0, path.stem), links), np.array(model.opt.gravity))
    kept = set(arm.joint_names)
    bodies = {
        _joint_name(mujoco, model, k): _body_name(mujoco, model, int(model.jnt_bodyid[k])) for k in range(model.njnt)
    }
    dynamics = {_joint_name(mujoco, model, k): _dynamics(model, k) for k in range(model.njnt)}
    return simulation_of(
        arm,
        {name: one for name, one in dynamics.items() if name in kept},
        "mjcf",
        path.name,
        bodies,
        _notes(model),
        [Part(name, *where) for name, where in inertials_of(links).items() if where[0] in kept],
    )


def _links(mujoco: ModuleType, model: Any, path: Path) -> list[TreeLink]:
    """The bodies, a link for each; a body of several joints has massless links between them."""
    links: list[TreeLink] = []
    anchor: dict[int, FloatArray] = {0: np.zeros(3)}
    for body in range(1, model.nbody):
        name, parent = _body_name(mujoco, model, body), int(model.body_parentid[body])
        carrier = ROOT if parent == 0 else _body_name(mujoco, model, parent)
        rotation, place = _matrix(model.body_quat[body]), model.body_pos[body] - anchor[parent]
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        here = np.zeros(3)
        for number, joint in enumerate(range(first, first + count)):
            at, last = np.array(model.jnt_pos[joint]), number == count - 1
            own = _tree_joint(mujoco, model, joint, path)
            # At `ref` the body stands as it is written; the link's zero is the joint's.
            start = (
                Rotation.from_rotvec(-model.qpos0[joint] * own.axis).as_matrix() if own.kind != "prismatic" else None
            )
            turned = rotation if start is None else rotation @ start
            moved = place + rotation @ (at - here)
            if start is None:
                moved = moved - rotation @ own.axis * model.qpos0[joint]
            child = name if last else f"{name}/{own.name}"
            links.append(_link(model, body, child, carrier, turned, moved, own, at if last else None))
            carrier, rotation, place, here = child, np.eye(3), np.zeros(3), at
        if count == 0:
            fixed = TreeJoint(f"{name}_fixed", "fixed")
            links.append(_link(model, body, name, carrier, rotation, place, fixed, here))
        anchor[body] = here
    return links


def _link(
    model: Any,
    body: int,
    name: str,
    parent: str,
    rotation: FloatArray,
    place: FloatArray,
    joint: TreeJoint,
    anchor: FloatArray | None,
) -> TreeLink:
    """A link; where the anchor is None, a massless one between two joints of a body."""
    if anchor is None:
        return TreeLink(name, parent, rotation, place, joint, 0.0, np.zeros(3), np.zeros((3, 3)))
    principal = _matrix(model.body_iquat[body])
    inertia = principal @ np.diag(model.body_inertia[body]) @ principal.T
    centre = model.body_ipos[body] - anchor
    return TreeLink(name, parent, rotation, place, joint, float(model.body_mass[body]), centre, inertia)


def _tree_joint(mujoco: ModuleType, model: Any, joint: int, path: Path) -> TreeJoint:
    name, kind = _joint_name(mujoco, model, joint), int(model.jnt_type[joint])
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
    if kind not in kinds:
        raise UserError(
            f"{path}: joint {name!r} is free or a ball: give the arm alone, fixed to the world, with hinges and slides"
        )
    axis = np.array(model.jnt_axis[joint])
    lower, upper = (float(value) for value in model.jnt_range[joint])
    limited = bool(model.jnt_limited[joint]) and max(abs(lower), abs(upper)) < UNBOUNDED
    effort = float(model.jnt_actfrcrange[joint][1]) if model.jnt_actfrclimited[joint] else 0.0
    word = kinds[kind]
    if not limited and word == "revolute":
        return TreeJoint(name, "continuous", axis, effort=effort)
    return TreeJoint(name, word, axis, lower if limited else -UNBOUNDED, upper if limited else UNBOUNDED, effort)


def _dynamics(model: Any, joint: int) -> JointDynamics:
    dof = int(model.jnt_dofadr[joint])
    return JointDynamics(
        armature=float(model.dof_armature[dof]),
        damping=float(model.dof_damping[dof]),
        friction=float(model.dof_frictionloss[dof]),
        stiffness=float(model.jnt_stiffness[joint]),
        rest=float(model.qpos_spring[int(model.jnt_qposadr[joint])]),
    )


def _notes(model: Any) -> tuple[str, ...]:
    """What of the simulation acts on its joints and is not in the torque model."""
    notes = []
    if model.neq:
        notes.append(f"{model.neq} equality constraint(s) of the MJCF are not in the comparison")
    if model.ntendon:
        notes.append(f"{model.ntendon} tendon(s) of the MJCF are not in the comparison")
    if model.opt.density or model.opt.viscosity:
        notes.append("the MJCF's medium (density, viscosity) is not in the comparison")
    return tuple(notes)


def _name(mujoco: ModuleType, model: Any, kind: str, number: int, otherwise: str) -> str:
    return mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mj{kind}"), number) or otherwise


def _joint_name(mujoco: ModuleType, model: Any, joint: int) -> str:
    return _name(mujoco, model, "OBJ_JOINT", joint, f"joint_{joint}")


def _body_name(mujoco: ModuleType, model: Any, body: int) -> str:
    return _name(mujoco, model, "OBJ_BODY", body, f"body_{body}")


def _matrix(quaternion: FloatArray) -> FloatArray:
    """(3, 3) of MuJoCo's w x y z."""
    return np.asarray(Rotation.from_quat(np.roll(np.asarray(quaternion, dtype=float), -1)).as_matrix())
