"""Joints that move in a recording and are fixed in the arm that it is to be identified as."""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.urdf_chain import JointTree
from ..recording.recording import Recording
from .finding import Finding, Level
from .plain import FIXED_RANGE

KIND = "fixed_joint_moves"
"""Of its findings."""


def moving_though_fixed(recording: Recording, arm: Arm) -> list[Finding]:
    """Recorded joints that move and are fixed in the arm's description.

    Where one carries a joint of the arm, the arm's base moves in a way that the model does not know, unless a sensor
    behind that joint has recorded it. Where a joint of the arm carries one, the payload changes. All others, such as
    those of another arm on the same base, say nothing of this arm.

    Args:
        recording: With all joints that were recorded, the arm's and others.
        arm: What the user says it is of.
    """
    columns = {name: k for k, name in enumerate(recording.joints) if name not in arm.joint_names}
    if not columns:
        return []
    tree = JointTree(arm.urdf)
    ranges = {name: float(np.ptp(recording.position[:, k])) for name, k in columns.items() if name in tree.by_name}
    moving = [name for name, size in ranges.items() if size > FIXED_RANGE]
    above = {
        name: {joint.name for joint in tree.path(tree.by_name[name].parent)} for name in (*moving, *arm.joint_names)
    }
    carrying = set().union(*(above[name] for name in arm.joint_names))
    base = recording.base
    measured = {joint.name for joint in tree.path(base.frame)} if base and base.frame in tree.links else set()

    def finding(names: list[str], level: Level, effect: str) -> list[Finding]:
        if not names:
            return []
        sizes = ", ".join(f"{name} by {ranges[name]:.2g}" for name in names)
        text = f"joints that are fixed in the arm move in the recording: {sizes} (rad; m if prismatic); {effect}"
        remedy = "identify the whole chain (give the whole URDF as --arm), or record with these joints at rest"
        values = {"range": {name: round(ranges[name], 4) for name in names}}
        return [Finding(KIND, level, tuple(names), text, remedy, values=values)]

    carriers = [name for name in moving if name in carrying and name not in measured]
    carried = [name for name in moving if name not in carrying and above[name] & set(arm.joint_names)]
    return [
        *finding(carriers, Level.UNFIT, "the model does not know how they move the arm that they carry"),
        *finding(carried, Level.NOTE, "they are taken for a rigid part of the arm's payload"),
    ]
