"""Joints that move in a recording and are fixed in the arm that it is to be identified as."""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.urdf_chain import JointTree, of_a_hand
from ..errors import UserError
from ..recording.recording import Recording
from .finding import Finding, Level
from .plain import FIXED_RANGE

KIND = "fixed_joint_moves"
"""Of its findings."""
MODELLED_OR_AT_REST = "identify the whole chain (give the whole URDF as --arm), or record with these joints at rest"
"""Remedy where the joints have an effort, or are no part of what is identified."""


def moving_though_fixed(recording: Recording, arm: Arm) -> list[Finding]:
    """Recorded joints that move and are fixed in the arm's description.

    Where one carries a joint of the arm, the arm's base moves in a way that the model does not know, unless a sensor
    behind that joint has recorded it. Where a joint of the arm carries one, the payload changes. Wheels may drive the
    base. All others, such as those of another arm on the same base, say nothing of this arm. A joint that is fixed
    since a recording lacks it, or its effort, and that is no gripper's, is one of the arm: what it moves is no payload.

    Args:
        recording: With all joints that were recorded, the arm's and others.
        arm: What the user says it is of.
    """
    ranges = {name: high - low for name, (low, high) in recording.effortless.items() if name not in arm.joint_names}
    for k, name in enumerate(recording.joints):
        if name not in arm.joint_names:
            ranges[name] = float(np.ptp(recording.position[:, k]))
    if not ranges:
        return []
    tree = JointTree(arm.urdf)
    ranges = {name: size for name, size in ranges.items() if name in tree.by_name}
    moving = [name for name, size in ranges.items() if size > FIXED_RANGE]
    above = {
        name: {joint.name for joint in tree.path(tree.by_name[name].parent)} for name in (*moving, *arm.joint_names)
    }
    carrying = set().union(*(above[name] for name in arm.joint_names))
    base = recording.base
    measured = {joint.name for joint in tree.path(base.frame)} if base and base.frame in tree.links else set()

    def finding(names: list[str], level: Level, effect: str, remedy: str = MODELLED_OR_AT_REST) -> list[Finding]:
        if not names:
            return []
        sizes = ", ".join(f"{name} by {ranges[name]:.2g}" for name in names)
        text = f"joints that are fixed in the arm move in the recording: {sizes} (rad; m if prismatic); {effect}"
        values = {"range": {name: round(ranges[name], 4) for name in names}}
        return [Finding(KIND, level, tuple(names), text, remedy, values=values)]

    carriers = [name for name in moving if name in carrying and name not in measured]
    carried = [name for name in moving if name not in carrying and above[name] & set(arm.joint_names)]
    beside = [] if base is not None else [name for name in moving if name not in carrying and name not in carried]
    described = (_described(recording) or tree) if beside else tree
    wheels = [name for name in beside if _is_wheel(described, name)]
    lacking = [name for name in (*carriers, *carried) if name in arm.locked and not of_a_hand(name)]
    carriers, carried = ([name for name in names if name not in lacking] for names in (carriers, carried))
    return [
        *finding(
            lacking,
            Level.UNFIT,
            "a recording lacks them or their effort, they are fixed for that, and the model of the others is wrong",
            "record their effort as well, or a run in which they stand still",
        ),
        *finding(carriers, Level.UNFIT, "the model does not know how they move the arm that they carry"),
        *finding(carried, Level.NOTE, "they are taken for a rigid part of the arm's payload"),
        *finding(
            wheels,
            Level.NOTE,
            "if they drive the base, it accelerates the arm, and the model does not know",
            "record /base_imu or /base_odometry as well, or a run in which the base stands",
        ),
    ]


def _described(recording: Recording) -> JointTree | None:
    """The robot of the recording's own description: an arm's file has fixed what is not the arm's."""
    try:
        return JointTree(recording.urdf) if recording.urdf else None
    except UserError:
        return None


def _is_wheel(tree: JointTree, name: str) -> bool:
    """Whether a joint is one as of a wheel: it turns without end, carries none, and at most a swivel carries it."""
    joint = tree.by_name.get(name)
    if joint is None or joint.kind != "continuous" or name in tree.moving_below():
        return False
    above = [one.kind for one in tree.path(joint.parent) if one.driven]
    return above in ([], ["continuous"])
