"""The arm that a bag describes against the arm it is to be identified as."""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import Arm, Joint, arm_from_urdf
from ..dynamics.urdf_chain import locked_as_in
from ..errors import UserError
from ..recording.recording import Recording
from .finding import Finding, Level

LENGTH_M, ANGLE_RAD = 0.002, 0.01
"""Differences of a joint's origin and axis that calibrated URDFs of one arm show."""
MASS_SHARE = 0.02
"""Difference of total mass that is said."""


def compare_description(recording: Recording, arm: Arm) -> list[Finding]:
    """What the bag's /robot_description says otherwise than the arm given; nothing where it holds none.

    Joints that are locked in the arm are locked at the same positions in the bag's description before the two are
    compared: an arm that `spacearm new-arm` made from that description is the same arm.

    Args:
        recording: As read.
        arm: What the user says it is of.
    """
    if recording.urdf is None or recording.urdf == arm.urdf:
        return []
    try:
        told = arm_from_urdf(recording.urdf)
    except UserError as error:
        text = f"the bag's robot_description cannot be read: {error}"
        return [Finding("robot_description", Level.NOTE, (), text, "check the description that is published")]
    remedy = "leave --arm out to take the bag's own description, or give the URDF of the arm that was recorded"
    missing = [name for name in arm.joint_names if name not in told.joint_names]
    if missing:
        text = f"the bag describes {told.name!r} without {', '.join(missing)} of {arm.name!r}"
        return [Finding("robot_description", Level.UNFIT, tuple(missing), text, remedy)]
    told = arm_from_urdf(locked_as_in(recording.urdf, arm.urdf))
    there = {joint.name: joint for joint in told.joints}
    carriers = {joint.name: _carrier(told, joint) for joint in told.joints}
    differing, worst = [], 0.0
    for joint in arm.joints:
        length, angle = _difference(joint, there[joint.name])
        if length > LENGTH_M or angle > ANGLE_RAD or _carrier(arm, joint) != carriers[joint.name]:
            differing.append(joint.name)
            worst = max(worst, length)
    if differing:
        text = (
            f"the bag describes another arm ({told.name!r}) than the one given ({arm.name!r}): origins or axes of "
            f"{', '.join(differing)} differ, by up to {worst * 1e3:.0f} mm"
        )
        return [Finding("robot_description", Level.UNFIT, tuple(differing), text, remedy)]
    masses = [sum(float(joint.inertial[0]) for joint in one.joints) for one in (told, arm)]
    if abs(masses[0] - masses[1]) > MASS_SHARE * max(*masses, 1e-9):
        text = f"the bag's description has links of {masses[0]:.1f} kg in all, the arm given {masses[1]:.1f} kg"
        return [Finding("robot_description", Level.NOTE, (), text, "see to it that the CAD values meant are given")]
    return []


def _carrier(arm: Arm, joint: Joint) -> str:
    return "" if joint.parent < 0 else arm.joints[joint.parent].name


def _difference(a: Joint, b: Joint) -> tuple[float, float]:
    """Distance of origins, m, and angle between axes in the parent's frame, rad."""
    axis_a, axis_b = a.rotation @ a.axis, b.rotation @ b.axis
    angle = float(np.arccos(np.clip(axis_a @ axis_b, -1.0, 1.0)))
    return float(np.linalg.norm(a.translation - b.translation)), angle if a.revolute == b.revolute else np.pi
