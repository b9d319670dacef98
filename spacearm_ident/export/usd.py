"""USD of an identified arm, as Isaac Sim reads it: an articulation with masses, joints, armature and friction.

Bodies and joints are UsdPhysics; the inertia of the rotor is `physxJoint:armature`, Coulomb and viscous friction are
`physxJointAxis:...` of PhysX's joint axis (N·m and N·m s/rad, degrees at the limits). Needs usd-core.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..recording.tables.optional import optional
from ..results.formats import ARMATURE, DAMPING, FRICTION
from .frames import Body, bodies_of, principal, quaternion
from .law import Nearest


def write_usd(model: IdentifiedModel, fit: Nearest, notes: list[str], path: Path) -> None:
    """Write a USD file (`.usda` is text, `.usd` and `.usdc` are binary).

    Args:
        model: Bodies, joint placements and gravity that the file gets.
        fit: The nearest parameters for `USD`.
        notes: Comment of the stage, a line each.
        path: File to write; its suffix chooses the encoding.

    Raises:
        UserError: usd-core is missing, or a body cannot be.
    """
    what = "writing USD"
    usd, geometry, physics = (optional(f"pxr.{name}", "usd-core", what) for name in ("Usd", "UsdGeom", "UsdPhysics"))
    pxr = optional("pxr.Gf", "usd-core", what), optional("pxr.Sdf", "usd-core", what)
    bodies = bodies_of(model)
    stage = usd.Stage.CreateNew(str(path))
    geometry.SetStageUpAxis(stage, geometry.Tokens.z)
    geometry.SetStageMetersPerUnit(stage, 1.0)
    physics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetMetadata("comment", "\n".join(notes))
    root = geometry.Xform.Define(stage, f"/{_name(model.model.arm.name)}")
    stage.SetDefaultPrim(root.GetPrim())
    physics.ArticulationRootAPI.Apply(root.GetPrim())
    _scene(stage, physics, model.model.arm.gravity, pxr)
    base = geometry.Xform.Define(stage, root.GetPath().AppendChild("base"))
    physics.RigidBodyAPI.Apply(base.GetPrim())
    fixed = physics.FixedJoint.Define(stage, root.GetPath().AppendChild("base_fixed"))
    fixed.CreateBody1Rel().SetTargets([base.GetPath()])
    paths, placed = {-1: base.GetPath()}, {-1: (np.eye(3), np.zeros(3))}
    for k, body in enumerate(bodies):
        rotation, origin = placed[body.joint.parent]
        placed[k] = rotation @ body.joint.rotation, origin + rotation @ body.joint.translation
        paths[k] = root.GetPath().AppendChild(_name(f"{body.joint.name}_link"))
        link = geometry.Xform.Define(stage, paths[k])
        link.AddTranslateOp().Set(pxr[0].Vec3d(*map(float, placed[k][1])))
        link.AddOrientOp().Set(_quaternion(pxr[0], placed[k][0]))
        _mass(physics, link.GetPrim(), body, pxr[0])
        _joint(stage, physics, root.GetPath(), body, (paths[body.joint.parent], paths[k]), fit, pxr)
    stage.GetRootLayer().Save()


def _scene(stage: Any, physics: Any, gravity: FloatArray, pxr: tuple[Any, Any]) -> None:
    scene = physics.Scene.Define(stage, "/physicsScene")
    size = float(np.linalg.norm(gravity))
    direction = gravity / size if size > 0 else np.array([0.0, 0.0, -1.0])
    scene.CreateGravityDirectionAttr().Set(pxr[0].Vec3f(*map(float, direction)))
    scene.CreateGravityMagnitudeAttr().Set(size)


def _mass(physics: Any, prim: Any, body: Body, gf: Any) -> None:
    """Mass, centre and principal inertia of a link."""
    physics.RigidBodyAPI.Apply(prim)
    mass = physics.MassAPI.Apply(prim)
    moments, axes = principal(body.inertia)
    mass.CreateMassAttr().Set(body.mass)
    mass.CreateCenterOfMassAttr().Set(gf.Vec3f(*map(float, body.centre)))
    mass.CreateDiagonalInertiaAttr().Set(gf.Vec3f(*map(float, moments)))
    mass.CreatePrincipalAxesAttr().Set(_quaternion(gf, axes))


def _joint(
    stage: Any, physics: Any, root: Any, body: Body, ends: tuple[Any, Any], fit: Nearest, pxr: tuple[Any, Any]
) -> None:
    """A joint about its x axis, which is turned onto that of the arm."""
    gf, sdf = pxr
    joint, values = body.joint, fit.values[body.joint.name]
    kind = physics.RevoluteJoint if joint.revolute else physics.PrismaticJoint
    made = kind.Define(stage, root.AppendChild(_name(joint.name)))
    made.CreateBody0Rel().SetTargets([ends[0]])
    made.CreateBody1Rel().SetTargets([ends[1]])
    made.CreateAxisAttr().Set("X")
    with warnings.catch_warnings():
        # The rotation about the axis itself is free; Ubuntu 24.04's scipy warns of it.
        warnings.filterwarnings("ignore", "Optimal rotation", UserWarning)
        onto = Rotation.align_vectors(joint.axis[None], np.array([[1.0, 0.0, 0.0]]))[0].as_matrix()
    made.CreateLocalPos0Attr().Set(gf.Vec3f(*map(float, joint.translation)))
    made.CreateLocalRot0Attr().Set(_quaternion(gf, joint.rotation @ onto))
    made.CreateLocalPos1Attr().Set(gf.Vec3f(0.0, 0.0, 0.0))
    made.CreateLocalRot1Attr().Set(_quaternion(gf, onto))
    unit = 180.0 / np.pi if joint.revolute else 1.0
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        made.CreateLowerLimitAttr().Set(joint.lower * unit)
        made.CreateUpperLimitAttr().Set(joint.upper * unit)
    axis = "angular" if joint.revolute else "linear"
    prim = made.GetPrim()
    prim.AddAppliedSchema("PhysxJointAPI")
    prim.AddAppliedSchema(f"PhysxJointAxisAPI:{axis}")
    attributes = {
        "physxJoint:armature": values[ARMATURE],
        f"physxJointAxis:{axis}:staticFrictionEffort": values[FRICTION],
        f"physxJointAxis:{axis}:dynamicFrictionEffort": values[FRICTION],
        f"physxJointAxis:{axis}:viscousFrictionCoefficient": values[DAMPING] / unit,
    }
    if np.isfinite(joint.velocity_limit):
        attributes["physxJoint:maxJointVelocity"] = joint.velocity_limit * unit
    for name, value in attributes.items():
        prim.CreateAttribute(name, sdf.ValueTypeNames.Float).Set(float(value))


def _quaternion(gf: Any, rotation: FloatArray) -> Any:
    w, x, y, z = map(float, quaternion(rotation))
    return gf.Quatf(w, x, y, z)


def _name(text: str) -> str:
    """A name as USD allows it in a path."""
    plain = re.sub(r"\W", "_", text, flags=re.ASCII) or "arm"
    return plain if not plain[0].isdigit() else f"_{plain}"
