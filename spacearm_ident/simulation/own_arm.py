"""A simulated arm out of a description alone: CAD inertials, and friction and rotors of a stated default.

For walking the whole road before the arm is there, and to see what an excitation would reveal. The defaults are shares
of a joint's scale: its torque limit, since friction goes with the drive, not with the load; but at most twice what the
CAD links ask of the most loaded joint of its kind (`dynamics.demand`), since a limit in a URDF may be anything. They
are of the size that geared joints show; no particular arm's.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.demand import drawn_postures, joint_inertias, torque_asked
from ..dynamics.model import IdentifiedModel, TorqueModel, structure_of
from ..errors import UserError
from .servo import DriveData

COULOMB = 0.04
"""Coulomb friction f_c, share of the scale."""
STATIC = 0.05
"""Static friction f_b, share of the scale."""
VISCOUS = 0.04
"""Viscous torque k_v1 at the velocity limit, share of the scale."""
STRIBECK = 0.03
"""Stribeck velocity v_b, share of the velocity limit."""
ROTOR = 0.3
"""Rotor inertia on the output side, share of the joint's mean CAD inertia."""
ROTOR_ACCELERATION = 300.0
"""Acceleration of the unloaded rotor under the scale's torque, rad/s² or m/s²: bounds rotor inertia from below. A last
link may move next to nothing; with a rotor to match, no servo overcomes the friction of its own gear (TIAGo's joint 7
stood still). Ours: what drives of arms reach unloaded is of this order."""
USUAL_VELOCITY = 2.0
"""Velocity limit where none is stated, rad/s or m/s."""
STATED = (
    f"default friction: Coulomb {COULOMB:.0%}, static {STATIC:.0%}, viscous at full speed {VISCOUS:.0%} of a joint's "
    f"torque limit (of twice the largest torque that the CAD links need, if that is less); rotor inertias "
    f"{ROTOR:.0%} of the CAD inertia, or that torque over {ROTOR_ACCELERATION:g} rad/s² if that is larger"
)
"""The defaults in words."""


def default_model(arm: Arm) -> IdentifiedModel:
    """The arm with CAD inertials and default friction.

    Raises:
        UserError: A joint moves no mass: its torque would be nothing.
    """
    inertia = joint_inertias(arm, drawn_postures(arm)).mean(axis=0)
    light = [joint.name for joint, moved in zip(arm.joints, inertia) if not moved > 0.0]
    if light:
        raise UserError(f"the URDF gives what {light[0]} moves no inertia: add <inertial> to its links, or --model")
    scale = torque_scale(arm)
    speed = np.array([joint.velocity_limit for joint in arm.joints])
    speed = np.where(np.isfinite(speed), speed, USUAL_VELOCITY)
    values = {
        "f_c": COULOMB * scale,
        "f_b": STATIC * scale,
        "k_v1": VISCOUS * scale / speed,
        "J_m": np.maximum(ROTOR * inertia, scale / ROTOR_ACCELERATION),
        "v_b": STRIBECK * speed,
    }
    of = {name: number for number, name in enumerate(arm.joint_names)}
    model = TorqueModel(arm, structure_of(arm))
    parameters = [p.prior if p.symbol not in values else values[p.symbol][of[p.joint]] for p in model.parameters]
    constants = [values["v_b"][of[c.joint]] if c.symbol == "v_b" else c.grid[0] for c in model.constants]
    return IdentifiedModel(model, np.array(parameters), np.array(constants))


def torque_scale(arm: Arm) -> FloatArray:
    """(n,) N m or N that default friction and the noise of measured torque are shares of.

    The torque limit, or twice what the CAD links ask of the most loaded joint of its kind where that is less: a limit
    in a URDF may be a placeholder (2000 N m at a Kinova's shoulder), and no drive of such an arm has its noise.
    """
    asked = torque_asked(arm)
    limit = np.array([joint.effort_limit for joint in arm.joints])
    turns = np.array([joint.revolute for joint in arm.joints])
    most = np.array([2.0 * asked[turns == kind].max() for kind in turns])
    return np.asarray(np.minimum(limit, most))


def drives_of(arm: Arm) -> DriveData:
    """The arm's drives; usual gears and motors where its file states neither."""
    usual = DriveData.plain(len(arm.joints))
    ratio = np.array([joint.gear_ratio for joint in arm.joints])
    constant = np.array([joint.torque_constant for joint in arm.joints])
    unstated = (ratio == 1.0) & (constant == 1.0)
    return DriveData.plain(
        len(arm.joints),
        gear_ratio=np.where(unstated, usual.gear_ratio, ratio),
        torque_constant=np.where(unstated, usual.torque_constant, constant),
        torque_limit=np.array([joint.effort_limit for joint in arm.joints]),
    )
