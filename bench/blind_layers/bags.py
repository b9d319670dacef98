"""Recordings as contracts.md, section 1, asks: MCAP, profile `ros2`, CDR payloads, `ros2msg` schemas.

Messages are packed here (OMG CDR, little endian, as rosbag2 stores them), not by the package under test.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from mcap.writer import Writer

_HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
SCHEMAS = {
    "std_msgs/msg/String": "string data\n",
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort\n" + _HEADER.lstrip("\n"),
    "sensor_msgs/msg/Temperature": "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n"
    + _HEADER.lstrip("\n"),
}
"""Definitions of the messages."""

START_ns = 1_760_000_000_000_000_000
"""Time of the first sample of a draw's first recording, ns since 1970."""


def _string(buffer: bytearray, text: str) -> None:
    buffer += b"\0" * (-len(buffer) % 4)
    raw = text.encode() + b"\0"
    buffer += struct.pack("<I", len(raw)) + raw


def _header(stamp_ns: int, frame: str) -> bytearray:
    buffer = bytearray(struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9))
    _string(buffer, frame)
    return buffer


def _doubles(buffer: bytearray, values: np.ndarray) -> None:
    buffer += b"\0" * (-len(buffer) % 4)
    buffer += struct.pack("<I", len(values))
    if len(values):
        buffer += b"\0" * (-len(buffer) % 8)
        buffer += np.asarray(values, "<f8").tobytes()


def joint_state(
    stamp_ns: int, names: tuple[str, ...], position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
) -> bytes:
    """A `sensor_msgs/msg/JointState` as CDR.

    Args:
        stamp_ns: ns since 1970.
        names: joints (n).
        position: rad (n or 0).
        velocity: rad/s (n or 0).
        effort: N m (n or 0).
    """
    buffer = _header(stamp_ns, "")
    buffer += b"\0" * (-len(buffer) % 4)
    buffer += struct.pack("<I", len(names))
    for name in names:
        _string(buffer, name)
    for values in (position, velocity, effort):
        _doubles(buffer, values)
    return b"\0\1\0\0" + bytes(buffer)


def temperature(stamp_ns: int, joint: str, celsius: float) -> bytes:
    """A `sensor_msgs/msg/Temperature` as CDR: frame = joint, °C."""
    buffer = _header(stamp_ns, joint)
    buffer += b"\0" * (-len(buffer) % 8)
    return b"\0\1\0\0" + bytes(buffer) + struct.pack("<dd", celsius, 0.0)


def write_bag(
    path: Path,
    names: tuple[str, ...],
    t: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray | None,
    effort: np.ndarray,
    urdf: str,
    command: np.ndarray | None = None,
    celsius: np.ndarray | None = None,
    offset_s: float = 0.0,
) -> None:
    """Write one recording.

    Args:
        path: MCAP file.
        names: joints (n).
        t: s (samples).
        position: rad (samples, n).
        velocity: rad/s (samples, n), or none.
        effort: N m (samples, n).
        urdf: content of `/robot_description`.
        command: set-points, rad (samples, n), or none.
        celsius: joint temperatures, °C (samples, n), or none; written at about 2 Hz.
        offset_s: start after `START_ns`, s.
    """
    empty = np.zeros(0)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="blind_layers")
        schema = {
            name: writer.register_schema(name=name, encoding="ros2msg", data=text.encode())
            for name, text in SCHEMAS.items()
        }

        def channel(topic: str, kind: str) -> int:
            return writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema[kind])

        states = channel("/joint_states", "sensor_msgs/msg/JointState")
        stamps = START_ns + np.round((t + offset_s) * 1e9).astype(np.int64)
        description = bytearray()
        _string(description, urdf)
        topic = channel("/robot_description", "std_msgs/msg/String")
        writer.add_message(topic, int(stamps[0]), b"\0\1\0\0" + bytes(description), int(stamps[0]))
        commands = channel("/joint_command", "sensor_msgs/msg/JointState") if command is not None else 0
        warm = channel("/joint_temperatures", "sensor_msgs/msg/Temperature") if celsius is not None else 0
        every = max(1, round(0.5 / float(t[1] - t[0])))
        for i, raw in enumerate(stamps):
            ns = int(raw)
            speed = empty if velocity is None else velocity[i]
            writer.add_message(states, ns, joint_state(ns, names, position[i], speed, effort[i]), ns)
            if command is not None:
                writer.add_message(commands, ns, joint_state(ns, names, command[i], empty, empty), ns)
            if celsius is not None and i % every == 0:
                for j, name in enumerate(names):
                    writer.add_message(warm, ns, temperature(ns, name, float(celsius[i, j])), ns)
        writer.finish()
