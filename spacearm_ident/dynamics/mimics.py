"""Joints that mimic one of the arm's and so move with it, which no model here does: they are locked.

A gripper's second finger is small beside its arm. The linkage of a parallelogram arm is not: the torque of the joint
that drives it holds that of the joint that follows, and the motion of what the follower carries is another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import UserError
from .arm import Arm
from .urdf_chain import DRIVEN, JointTree, UrdfJoint, hand_joints


@dataclass(frozen=True)
class Follower:
    """A joint that mimics one of the arm's.

    Attributes:
        name: The joint.
        leader: The arm's joint that it moves with, at the end of a row of mimics.
        carried: Joints of the arm behind it.
        in_chain: Whether it moves what is no gripper: a joint of the arm, or the end of the chain that its leader
            carries.
    """

    name: str
    leader: str
    carried: tuple[str, ...]
    in_chain: bool


def followers(urdf: str, joints: Sequence[str]) -> list[Follower]:
    """Joints that move with one of an arm's.

    Args:
        urdf: Text of the description, with its mimics.
        joints: The arm's.

    Raises:
        UserError: It is no URDF.
    """
    if "<mimic" not in urdf:
        return []
    tree, found = JointTree(urdf), []
    for joint in tree.joints:
        leader = _leader(tree, joint)
        if joint.kind not in DRIVEN or not joint.mimics or leader not in joints:
            continue
        carried = tuple(name for name in joints if joint in tree.path(tree.by_name[name].parent))
        behind_leader = tree.by_name[leader] in tree.path(joint.parent)
        in_chain = bool(carried) or (behind_leader and leader not in hand_joints(tree))
        found.append(Follower(joint.name, leader, carried, in_chain))
    return found


def require_open_chain(arm: Arm) -> Arm:
    """The arm, none of whose joints moves a part of the chain besides its own.

    Args:
        arm: As read, less the joints that recordings lack.

    Raises:
        UserError: As `refuse_coupled`.
    """
    refuse_coupled(arm.described, arm.joint_names)
    return arm


def refuse_coupled(urdf: str, joints: Sequence[str]) -> None:
    """Refuse an arm one of whose joints moves another joint of the chain as well.

    Args:
        urdf: Text of the description, with its mimics.
        joints: The arm's.

    Raises:
        UserError: One does; the message says what can be done.
    """
    if (words := coupled_words(urdf, joints)) is not None:
        raise UserError(". ".join(words))


def coupled_words(urdf: str, joints: Sequence[str]) -> tuple[str, str] | None:
    """What is wrong with an arm one of whose joints moves another of the chain, and what to do; None: none does.

    Args:
        urdf: Text of the description, with its mimics.
        joints: The arm's.
    """
    one = next((one for one in followers(urdf, joints) if one.in_chain), None)
    if one is None:
        return None
    what = ", ".join(one.carried) or "the end of the chain"
    others = " ".join(name for name in joints if name != one.leader)
    left = f"; or record with {one.leader} at rest, and make an arm without it: spacearm new-arm URDF --joints "
    return (
        f"joint {one.name} mimics {one.leader} and moves {what} with it, as in a parallelogram: such a coupled chain "
        f"is not modelled, and masses identified with {one.name} locked would be wrong",
        f"Take <mimic> out of the URDF if {one.name} has a drive of its own whose torque is recorded"
        + (f"{left}{others} --lock {one.leader}=POSITION" if others else ""),
    )


def follower_words(urdf: str, joints: Sequence[str]) -> list[str]:
    """A line on the joints beside the chain that move with one of the arm's; none where there are none.

    Args:
        urdf: Text of the description, with its mimics.
        joints: The arm's.
    """
    listed = ", ".join(f"{one.name} (with {one.leader})" for one in followers(urdf, joints) if not one.in_chain)
    if not listed:
        return []
    return [
        f"joints that mimic one of the arm's are taken as fixed, and what they carry as not moved by them: {listed}"
    ]


def _leader(tree: JointTree, joint: UrdfJoint) -> str:
    """The joint at the end of a row of mimics; empty where it ends nowhere."""
    seen: set[str] = set()
    while joint.mimics:
        if joint.mimics in seen or joint.mimics not in tree.by_name:
            return ""
        seen.add(joint.mimics)
        joint = tree.by_name[joint.mimics]
    return joint.name
