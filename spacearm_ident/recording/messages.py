"""The ROS 2 message types a recording is made of: names, definition texts, type hashes.

Written from the public interface definitions of ROS 2 Jazzy (`std_msgs`, `sensor_msgs`), comments left out.
A definition text is in the `ros2msg` schema encoding of MCAP: the definition itself, then each type it
depends on behind a line of 80 `=` and a line `MSG: package/Name`.
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


def _with_header(text: str) -> str:
    parts = ((None, text), ("std_msgs/Header", _HEADER), ("builtin_interfaces/Time", _TIME))
    rule = "=" * 80
    return "".join(body if name is None else f"{rule}\nMSG: {name}\n{body}" for name, body in parts)


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

DESCRIPTION_TOPIC = "/robot_description"
STATES_TOPIC = "/joint_states"
COMMAND_TOPIC = "/joint_command"
TEMPERATURES_TOPIC = "/joint_temperatures"

TOPIC_TYPES: dict[str, MessageType] = {
    DESCRIPTION_TOPIC: STRING,
    STATES_TOPIC: JOINT_STATE,
    COMMAND_TOPIC: JOINT_STATE,
    TEMPERATURES_TOPIC: TEMPERATURE,
}
