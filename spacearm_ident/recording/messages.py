"""The ROS 2 message types a recording is made of: names, definition texts, type hashes.

Written from the public interface definitions of ROS 2 Jazzy (`std_msgs`, `sensor_msgs`, `nav_msgs`, `geometry_msgs`),
comments left out. A definition text is in the `ros2msg` schema encoding of MCAP: the definition itself, then each type
it depends on behind a line of 80 `=` and a line `MSG: package/Name`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MessageType:
    """A message type as a bag declares it.

    Attributes:
        name: Full name, `package/msg/Name`.
        text: Definition with all its dependencies (`ros2msg`).
        type_hash: REP-2016 hash, `RIHS01_...`, as Jazzy computes it; empty where unknown.
    """

    name: str
    text: str
    type_hash: str = ""


_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_GEOMETRY = {
    "Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
}


def _with_header(text: str, *geometry: str) -> str:
    used = [(f"geometry_msgs/{name}", _GEOMETRY[name]) for name in geometry]
    parts = [("std_msgs/Header", _HEADER), ("builtin_interfaces/Time", _TIME), *used]
    rule = "=" * 80
    return text + "".join(f"{rule}\nMSG: {name}\n{body}" for name, body in parts)


STRING = MessageType(
    "std_msgs/msg/String",
    "string data\n",
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
)
JOINT_STATE = MessageType(
    "sensor_msgs/msg/JointState",
    _with_header("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"),
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
)
TEMPERATURE = MessageType(
    "sensor_msgs/msg/Temperature",
    _with_header("std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n"),
    "RIHS01_72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
)
IMU = MessageType(
    "sensor_msgs/msg/Imu",
    _with_header(
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        *("Quaternion", "Vector3"),
    ),
    "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
)
ODOMETRY = MessageType(
    "nav_msgs/msg/Odometry",
    _with_header(
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n",
        *("PoseWithCovariance", "Pose", "Point", "Quaternion", "TwistWithCovariance", "Twist", "Vector3"),
    ),
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
)

DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""What a joint_state_broadcaster of ros2_control publishes beside joint states: named interfaces of each joint."""
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
"""State of a joint_trajectory_controller. In every release of control_msgs its first point is the set-point
(`reference`, formerly `desired`), its second the measurement (`feedback`, formerly `actual`)."""

DESCRIPTION_TOPIC = "/robot_description"
STATES_TOPIC = "/joint_states"
COMMAND_TOPIC = "/joint_command"
TEMPERATURES_TOPIC = "/joint_temperatures"
TEMPERATURES_C = (-100.0, 200.0)
"""Least and largest temperature that a joint can have, °C, the unit of sensor_msgs/msg/Temperature. Windings are
insulated for 180 (class H of IEC 60085), lubricants for space are rated down to -80. Kelvin of any arm above -73 °C and
tenths of a degree of one above 20 °C are beyond it; which of the two a reading of 293 is (20 or 29.3 °C) nothing tells,
so that none is converted."""
BASE_IMU_TOPIC = "/base_imu"
BASE_ODOMETRY_TOPIC = "/base_odometry"

TOPIC_TYPES: dict[str, MessageType] = {
    DESCRIPTION_TOPIC: STRING,
    STATES_TOPIC: JOINT_STATE,
    COMMAND_TOPIC: JOINT_STATE,
    TEMPERATURES_TOPIC: TEMPERATURE,
    BASE_IMU_TOPIC: IMU,
    BASE_ODOMETRY_TOPIC: ODOMETRY,
}
