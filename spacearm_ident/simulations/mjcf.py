"""MJCF, read by MuJoCo itself: defaults, includes, inertia from shapes and units are as the simulator has them."""

from __future__ import annotations

from collections.abc import Collection
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

    Kinematic trees with a free or a ball joint are objects beside the arm: they are left out, and a note names them.

    Raises:
        UserError: MuJoCo is not installed or refuses the file, or no tree has hinges and slides alone.
    """
    mujoco = mujoco_or_error()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError, RuntimeError) as error:
        detail = (str(error).strip().splitlines() or ["no reason given"])[0]
        raise UserError(f"MuJoCo cannot read {path}: {detail}") from error
    return simulation_of_mujoco(mujoco, model, path)


def simulation_of_mujoco(mujoco: ModuleType, model: Any, path: Path) -> Simulation:
    """The arm of a compiled `MjModel`, as `read_mjcf` reads it from a file.

    Args:
        mujoco: The module, which is an optional dependency.
        model: The `MjModel`.
        path: File, for messages and names.

    Raises:
        UserError: It has no joint, or no tree has hinges and slides alone.
    """
    if model.njnt == 0:
        raise UserError(f"{path} has no joint: name the MJCF of an arm")
    objects = _objects(mujoco, model)
    joints = [k for k in range(model.njnt) if int(model.jnt_bodyid[k]) not in objects]
    notes = tuple(
        f"body {name!r} has a {kind} joint: its kinematic tree is not in the comparison"
        for name, kind in dict.fromkeys(objects.values())
    )
    if not joints:
        raise UserError(
            f"{path}: no joint is left to compare: {'; '.join(notes)}: give the arm fixed to the world, "
            "with hinges and slides"
        )
    links = _links(mujoco, model, objects)
    arm = arm_from_urdf(urdf_of(_name(mujoco, model, "OBJ_MODEL", 0, path.stem), links), np.array(model.opt.gravity))
    kept = set(arm.joint_names)
    bodies = {_joint_name(mujoco, model, k): _body_name(mujoco, model, int(model.jnt_bodyid[k])) for k in joints}
    dynamics = {_joint_name(mujoco, model, k): _dynamics(model, k) for k in joints}
    return simulation_of(
        arm,
        {name: one for name, one in dynamics.items() if name in kept},
        "mjcf",
        path.name,
        bodies,
        (*notes, *_notes(model)),
        [Part(name, *where) for name, where in inertials_of(links).items() if where[0] in kept],
    )


def _objects(mujoco: ModuleType, model: Any) -> dict[int, tuple[str, str]]:
    """Body of a tree with a free or a ball joint -> name of the tree's body that has it, and `free` or `ball`.

    A tree begins at a body that moves on one that does not: arm and object may stand on the same fixed table.
    """
    kinds = {int(mujoco.mjtJoint.mjJNT_FREE): "free", int(mujoco.mjtJoint.mjJNT_BALL): "ball"}
    tree = {0: 0}
    for body in range(1, model.nbody):
        tree[body] = tree[int(model.body_parentid[body])] or (body if model.body_jntnum[body] else 0)
    found: dict[int, tuple[str, str]] = {}
    for joint, kind in enumerate(model.jnt_type):
        if int(kind) in kinds:
            body = int(model.jnt_bodyid[joint])
            found.setdefault(tree[body], (_body_name(mujoco, model, body), kinds[int(kind)]))
    return {body: found[first] for body, first in tree.items() if first in found}


def _links(mujoco: ModuleType, model: Any, objects: Collection[int]) -> list[TreeLink]:
    """The bodies, a link for each, without objects; a body of several joints has massless links between them."""
    links: list[TreeLink] = []
    anchor: dict[int, FloatArray] = {0: np.zeros(3)}
    for body in range(1, model.nbody):
        if body in objects:
            continue
        name, parent = _body_name(mujoco, model, body), int(model.body_parentid[body])
        carrier = ROOT if parent == 0 else _body_name(mujoco, model, parent)
        rotation, place = _matrix(model.body_quat[body]), model.body_pos[body] - anchor[parent]
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        here = np.zeros(3)
        for number, joint in enumerate(range(first, first + count)):
            at, last = np.array(model.jnt_pos[joint]), number == count - 1
            own = _tree_joint(mujoco, model, joint)
            # At `ref` the body stands as it is written; the link's zero is the joint's.
            ref = float(model.qpos0[int(model.jnt_qposadr[joint])])
            start = Rotation.from_rotvec(-ref * own.axis).as_matrix() if own.kind != "prismatic" else None
            turned = rotation if start is None else rotation @ start
            moved = place + rotation @ (at - here)
            if start is None:
                moved = moved - rotation @ own.axis * ref
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


def _tree_joint(mujoco: ModuleType, model: Any, joint: int) -> TreeJoint:
    name, kind = _joint_name(mujoco, model, joint), int(model.jnt_type[joint])
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
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
