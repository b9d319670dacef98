"""How a run reaches the arm: set-points streamed to this package's driver, or what other people's controllers take.

| `output` | message | who takes it |
|---|---|---|
| `joint_command` | sensor_msgs/msg/JointState, `rate_hz` a second, stamped | this package's driver |
| `joint_trajectory` | trajectory_msgs/msg/JointTrajectory, once, `path_rate_hz` points/s | JointTrajectoryController |
| `forward_positions` | std_msgs/msg/Float64MultiArray, `rate_hz` a second | forward_command_controller |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ..errors import UserError
from ..excitation.joint_trajectory import PATH_RATE_HZ
from ..excitation.run import Run
from ..excitation.trajectory import Motion, MotionLimits
from .runtime import STREAM, LiveNode
from .set_point_stream import PositionsMessage, SetPointStream
from .trajectory_choices import FORWARD_POSITIONS, JOINT_COMMAND, JOINT_TRAJECTORY, OUTPUT
from .trajectory_path import SentPath

TOPICS: Final = {
    JOINT_COMMAND: "joint_command",
    JOINT_TRAJECTORY: "joint_trajectory_controller/joint_trajectory",
    FORWARD_POSITIONS: "forward_position_controller/commands",
}
"""Output -> topic where none is given: the names that the controllers' own examples have."""


Stream = SetPointStream | SentPath
"""A run under way."""


class Output:
    """The way to the arm; declares its parameters.

    Args:
        node: The trajectory node.

    Raises:
        UserError: A parameter is missing or not understood.

    Attributes:
        kind: `output`.
        rate_hz: Set-points a second, of which a run's limits are checked.
    """

    def __init__(self, node: LiveNode) -> None:
        self.kind = node.parameter("output", JOINT_COMMAND, f"what is published: {', '.join(TOPICS)}", choices=OUTPUT)
        topic = node.parameter("output_topic", "", "topic it goes to; empty: as the controllers' examples name theirs")
        order = node.parameter(
            "output_joints", [""], "the controller's joints in its order; empty: as in the trajectory file"
        )
        self.rate_hz = node.parameter("rate_hz", 1000.0, "set-points a second, Hz", low=10.0, high=5000.0)
        self._path_rate_hz = node.parameter(
            "path_rate_hz", PATH_RATE_HZ, "points a second of a joint_trajectory, Hz", low=5.0, high=1000.0
        )
        self._priority = node.parameter("realtime_priority", 60, "SCHED_FIFO; 0 for none", low=0, high=99)
        self._order = tuple(name for name in order if name)
        if self.kind == FORWARD_POSITIONS and not self._order:
            raise UserError("parameter output_joints is empty: forward_positions needs the controller's joints")
        self._node, self._topic = node, topic or TOPICS[self.kind]
        kinds = {JOINT_TRAJECTORY: JointTrajectory, FORWARD_POSITIONS: Float64MultiArray}
        qos = QoSProfile(depth=10) if self.kind == JOINT_TRAJECTORY else STREAM
        self._publisher = node.create_publisher(kinds.get(self.kind, JointState), self._topic, qos)
        self._clock: Callable[[], int] | None = self.now_ns if node.simulated_time else None

    def now_ns(self) -> int:
        """The graph's clock: this machine's, or `/clock` under `use_sim_time`; ns."""
        return int(self._node.get_clock().now().nanoseconds)

    def require(self, joints: Sequence[str], arm: Sequence[str]) -> None:
        """Refuse a run that whoever listens could not take.

        Args:
            joints: Of the run.
            arm: Of the arm description.

        Raises:
            UserError: Its joints are not those that are driven, or nobody listens.
        """
        driven = self._order or tuple(arm)
        if set(joints) != set(driven):
            what = "the controller (output_joints)" if self._order else "the arm"
            raise UserError(f"the trajectory moves {', '.join(joints)}, but {what} has {', '.join(driven)}")
        if self.kind != JOINT_COMMAND and not self._publisher.get_subscription_count():
            raise UserError(
                f"nobody listens on {self._publisher.topic_name}: load and activate the controller, or name its topic "
                "in the parameter output_topic"
            )

    def start(self, run: Run, motion: Motion, limits: MotionLimits) -> Stream:
        """Begin a run, as set-points or as one path.

        Args:
            run: The planned run; its limits have been checked.
            motion: Its T set-points at `rate_hz`, (T, n) each.
            limits: Motion limits of the n joints, kept when the run is stopped.
        """
        if self.kind == JOINT_TRAJECTORY:
            publish, now = self._publisher.publish, self.now_ns
            return SentPath(run, limits, publish, now, order=self._order, rate_hz=self._path_rate_hz)
        encode = PositionsMessage(run.trajectory.joints, self._order).encode if self.kind == FORWARD_POSITIONS else None
        return SetPointStream(
            run,
            motion,
            limits,
            self.rate_hz,
            self._publisher.publish,
            self._priority,
            encode=encode,
            now_ns=self._clock,
        )
