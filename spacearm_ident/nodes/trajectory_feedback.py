"""Where the arm is, out of `/joint_states`: joints in any order, others among them, other messages between.

A gripper's joints may be in the arm's messages, or in messages of their own on the same topic: what counts is the
newest message that names all joints of the run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Final

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from ..arrays import FloatArray
from ..errors import UserError
from ..recording import cdr
from .offers import raw_subscription, taken
from .runtime import LiveNode

DEPTH: Final = 10
"""Messages kept between two looks: the arm's is among them as long as it is every tenth."""


class Feedback:
    """The newest joint states of the arm; taken when asked for, so that a thousand a second cost nothing between.

    Args:
        node: Whose subscription it is.
    """

    def __init__(self, node: LiveNode) -> None:
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        topic = node.resolve_topic_name("joint_states")
        self._node, self._subscription = node, raw_subscription(node.unspun_node(), JointState, topic, qos)
        self._joints: tuple[str, ...] = ()
        self._names: tuple[str, ...] = ()
        self._block: cdr.JointStateBlock | None = None
        self._received_ns = 0

    def follow(self, joints: Sequence[str]) -> None:
        """From now on only messages that name all of `joints` count."""
        self._joints = tuple(joints)
        if self._block is not None and not set(self._joints) <= set(self._block.names):
            self._block = None

    @property
    def age_s(self) -> float:
        """Age of the newest message of all joints; infinite before the first."""
        self._take()
        return math.inf if self._block is None else 1e-9 * (time.time_ns() - self._received_ns)

    def position(self) -> FloatArray | None:
        """(n,) rad, in the order of the joints followed; None before the first, NaN where it is not a number."""
        self._take()
        if self._block is None or self._block.position is None:
            return None
        return self._block.position[0, self._columns(self._block)]

    @property
    def published(self) -> bool:
        """Whether anybody publishes joint states."""
        return self._node.count_publishers(self._subscription.topic_name) > 0

    def standing(self, timeout_s: float, slow: FloatArray) -> FloatArray:
        """Where the arm stands, (n,) rad in the order of the joints followed.

        Args:
            timeout_s: Older feedback is none.
            slow: (n,) rad/s that a standing joint may seem to have.

        Raises:
            UserError: That is not known, or it does not stand.
        """
        age, joints = self.age_s, self._joints
        if self._block is None and self._names:
            raise UserError(f"the trajectory moves {', '.join(joints)}, but /joint_states has {', '.join(self._names)}")
        if self._block is None or age > timeout_s:
            since = "there is none" if math.isinf(age) else f"the last is {age:.1f} s old"
            raise UserError(f"no feedback on /joint_states ({since}); start the driver")
        block, order = self._block, self._columns(self._block)
        if block.position is None:
            raise UserError("/joint_states carries no positions; check the driver")
        position = block.position[0, order]
        velocity = np.zeros(len(order)) if block.velocity is None else block.velocity[0, order]
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise UserError("/joint_states is not a number; check the driver")
        fast = np.flatnonzero(np.abs(velocity) > slow)
        if fast.size:
            raise UserError(f"{joints[fast[0]]} moves at {velocity[fast[0]]:.3f} rad/s; wait until the arm is at rest")
        return position

    def _columns(self, block: cdr.JointStateBlock) -> list[int]:
        return [block.names.index(name) for name in self._joints]

    def _take(self) -> None:
        for payload, info in reversed(list(taken(self._subscription))):
            blocks, _ = cdr.decode_joint_states([payload])
            if blocks and set(self._joints) <= set(blocks[0].names):
                self._block, self._received_ns = blocks[0], info["received_timestamp"]
                return
            if blocks:
                self._names = tuple(blocks[0].names)
