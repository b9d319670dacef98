"""Stand-ins of ros2_control for tests: a controller manager's word, a broadcaster, two controllers, an arm behind them.

A process of its own; its arm is `small_arm`, followed exactly, with a gripper that does not move. What is on the graph
is what ros2_control puts there, at its rates:

- `/joint_states`, 250 Hz by their stamps (a tick that is late is made up, as it would have been), joints in another
  order, the gripper's among them, `effort` in A of the motors;
- `/diagnostics`, the status `controller_manager: Controllers Activity` (here five times a second, for quick tests);
- `arm_controller/joint_trajectory` is taken by a JointTrajectoryController as that does: times count from arrival,
  quintics between the points, from the state before to the first of them, the last one held; `forward/commands` by a
  forward_command_controller. Only the active one of them moves the arm.
- `mock/switch` (std_srvs/srv/SetBool): activate or deactivate the controller.

In a namespace all names but `/diagnostics` lie below it; the status there is `controller_manager: ...` even so, or with
`full_name` (`diagnostic_updater.use_fqn`) `/right/controller_manager: ...`.

    python mock_controllers.py arm_controller|forward [slow] [full_name] [--ros-args -r __ns:=/right]
"""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pinocchio as pin
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from small_arm import COULOMB, JOINTS, ROTOR, URDF, VISCOUS
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from spacearm_ident.excitation.segments import Motion, Quintic
from spacearm_ident.nodes.joint_stream import JointStateWriter

RATE_HZ = 250.0
TELL_S = 0.2
NM_PER_A = np.array([12.0, 8.0])
"""On the output side; what an arm YAML must say of this arm."""
NOISE_A = 0.02
SLOWED = 0.5
"""Pace of a controller whose robot's speed is scaled down."""
START = np.array([0.1, -0.2])


class Path:
    """What a JointTrajectoryController follows."""

    def __init__(self, message: JointTrajectory, before: Motion, now: float) -> None:
        order = [message.joint_names.index(name) for name in JOINTS]
        self.since = now
        self.times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        self.states = [
            Motion(*(np.array(values)[order] for values in (p.positions, p.velocities, p.accelerations)))
            for p in message.points
        ]
        if self.times[0] > 0.0:
            self.times.insert(0, 0.0)
            self.states.insert(0, before)

    def at(self, now: float, pace: float) -> Motion:
        t = pace * max(0.0, now - self.since)
        k = int(np.searchsorted(self.times, t, side="right"))
        if k >= len(self.times):
            rest = np.zeros(len(JOINTS))
            return Motion(self.states[-1].q, rest, rest)
        first, second = self.times[k - 1], self.times[k]
        return Quintic(self.states[k - 1], self.states[k], second - first).evaluate(t - first).at(0)


class MockArm:
    """All of it."""

    def __init__(self, controller: str, pace: float) -> None:
        rclpy.init()
        self.node = rclpy.create_node("controller_manager")
        self.controller, self.pace, self.active = controller, pace, True
        rest = np.zeros(len(JOINTS))
        self.state, self.path = Motion(START, rest, rest), None
        self.model = pin.buildModelFromXML(URDF)
        self.data = self.model.createData()
        self.random = np.random.default_rng(0)
        self.epoch_ns = time.time_ns() - time.monotonic_ns()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.description = self.node.create_publisher(String, "robot_description", latched)
        self.description.publish(String(data=URDF))
        self.writer = JointStateWriter(("gripper", *reversed(JOINTS)), "position", "velocity", "effort")
        self.states = self.node.create_publisher(JointState, "joint_states", QoSProfile(depth=100))
        self.diagnostics = self.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.node.create_subscription(JointTrajectory, "arm_controller/joint_trajectory", self.take_path, 10)
        self.node.create_subscription(Float64MultiArray, "forward/commands", self.take_positions, 100)
        self.node.create_service(SetBool, "mock/switch", self.switch)

    def take_path(self, message: JointTrajectory) -> None:
        if self.active and self.controller == "arm_controller":
            self.path = Path(message, self.state, time.monotonic())

    def take_positions(self, message: Float64MultiArray) -> None:
        if self.active and self.controller == "forward":
            # Its joints are in the order of the joint states, as its configuration has them.
            q = np.array(message.data)[::-1]
            rest = np.zeros(len(JOINTS))
            self.state = Motion(q, rest, rest)

    def switch(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.active = request.data
        if not self.active:
            # A position interface holds what it was given last.
            rest = np.zeros(len(JOINTS))
            self.path, self.state = None, Motion(self.state.q, rest, rest)
        response.success = True
        return response

    def torque(self) -> np.ndarray:
        q, qd, qdd = self.state
        rigid = pin.rnea(self.model, self.data, q, qd, qdd)
        return rigid + COULOMB * np.sign(qd) + VISCOUS * qd + ROTOR * qdd

    def step(self, due: float) -> None:
        """One tick of the controllers, meant for `due` (s, monotonic), whenever the machine gets round to it."""
        if self.path is not None:
            self.state = self.path.at(due, self.pace)
        q, qd, _ = self.state
        current = self.torque() / NM_PER_A + NOISE_A * self.random.standard_normal(len(JOINTS))
        stamp_ns = self.epoch_ns + round(1e9 * due)
        columns = (np.concatenate([[finger], own[::-1]]) for finger, own in ((0.02, q), (0.0, qd), (0.0, current)))
        self.states.publish(self.writer.payload(stamp_ns, *columns))

    def tell(self) -> None:
        states = {self.controller: "active" if self.active else "inactive", "joint_state_broadcaster": "active"}
        manager = self.node.get_fully_qualified_name() if "full_name" in sys.argv else self.node.get_name()
        status = DiagnosticStatus(
            name=f"{manager}: Controllers Activity",
            message="All controllers are active",
            hardware_id="ros2_control",
            values=[KeyValue(key=name, value=state) for name, state in states.items()],
        )
        self.diagnostics.publish(DiagnosticArray(status=[status]))

    def work(self) -> None:
        due = time.monotonic()
        for k in range(10**9):
            self.step(due)
            if k % round(TELL_S * RATE_HZ) == 0:
                self.tell()
            due += 1.0 / RATE_HZ
            time.sleep(max(0.0, due - time.monotonic()))


def main() -> None:
    arm = MockArm(sys.argv[1], SLOWED if "slow" in sys.argv else 1.0)
    threading.Thread(target=arm.work, daemon=True).start()
    rclpy.spin(arm.node)


if __name__ == "__main__":
    main()
