"""MCAP recordings: profile ros2, CDR payloads, ros2msg schemas."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Self

import numpy as np
from mcap.writer import CompressionType, Writer

COMMON = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + COMMON
)
TEMPERATURE = "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n" + COMMON


class Cdr:
    """Little-endian CDR; alignment counts from behind the four bytes of encapsulation."""

    def __init__(self) -> None:
        self.body = bytearray()

    def align(self, size: int) -> None:
        """Pad to a multiple of size."""
        self.body += b"\0" * (-len(self.body) % size)

    def put(self, code: str, size: int, *values) -> Self:
        """Append values of one struct code, aligned to size bytes."""
        self.align(size)
        self.body += struct.pack("<" + code * len(values), *values)
        return self

    def string(self, text: str) -> Self:
        """Append a string with its length and null byte."""
        raw = text.encode() + b"\0"
        self.put("I", 4, len(raw))
        self.body += raw
        return self

    def doubles(self, values) -> Self:
        """Append a sequence of float64."""
        self.put("I", 4, len(values))
        if len(values):
            self.align(8)
            self.body += np.asarray(values, "<f8").tobytes()
        return self

    def bytes(self) -> bytes:
        """The message with its encapsulation header."""
        return b"\0\1\0\0" + bytes(self.body)


def write_bag(
    path: Path,
    urdf: str,
    joints: list[str],
    time: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray | None,
    effort: np.ndarray,
    temperature: np.ndarray | None = None,
    epoch: float = 1_750_000_000.0,
) -> None:
    """Write a recording.

    Args:
        path: of the file; its folder is made.
        urdf: text of /robot_description.
        joints: names (n).
        time: (T,) s from the start.
        position: (T, n) rad.
        velocity: (T, n) rad/s; None: left empty.
        effort: (T, n) N m.
        temperature: (T, n) C, written at 2 Hz a joint; None: no such topic.
        epoch: s of the first stamp.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        out = Writer(stream, compression=CompressionType.ZSTD)
        out.start(profile="ros2", library="blind_series")
        text = out.register_channel(
            "/robot_description", "cdr", out.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        )
        states = out.register_channel(
            "/joint_states", "cdr", out.register_schema("sensor_msgs/msg/JointState", "ros2msg", JOINT_STATE.encode())
        )
        start = int(epoch * 1e9)
        out.add_message(text, start, Cdr().string(urdf).bytes(), start)
        warm = None
        if temperature is not None:
            warm = out.register_channel(
                "/joint_temperatures",
                "cdr",
                out.register_schema("sensor_msgs/msg/Temperature", "ros2msg", TEMPERATURE.encode()),
            )
        due = 0.0
        for k, t in enumerate(time):
            stamp = start + round(t * 1e9)
            sec, nano = divmod(stamp, 10**9)
            m = Cdr().put("i", 4, sec).put("I", 4, nano).string("")
            m.put("I", 4, len(joints))
            for name in joints:
                m.string(name)
            m.doubles(position[k]).doubles([] if velocity is None else velocity[k]).doubles(effort[k])
            out.add_message(states, stamp, m.bytes(), stamp)
            if warm is not None and t >= due:
                due += 0.5
                for j, name in enumerate(joints):
                    m = (
                        Cdr()
                        .put("i", 4, sec)
                        .put("I", 4, nano)
                        .string(name)
                        .put("d", 8, float(temperature[k, j]), 0.01)
                    )
                    out.add_message(warm, stamp, m.bytes(), stamp)
        out.finish()


def read_bag(path: Path) -> dict:
    """Read a recording: urdf, joints, time (T,) s, epoch, position, velocity (or None), effort (T, n)."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    urdf, rows, joints = "", [], []
    with path.open("rb") as stream:
        for _, channel, _, m in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic == "/robot_description":
                urdf = m.data
            elif channel.topic == "/joint_states":
                joints = joints or list(m.name)
                rows.append((m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec, m.position, m.velocity, m.effort))
    time = np.array([r[0] for r in rows])
    velocity = np.array([list(r[2]) for r in rows])
    return {
        "urdf": urdf,
        "joints": joints,
        "time": time - time[0],
        "epoch": time[0],
        "position": np.array([list(r[1]) for r in rows]),
        "velocity": velocity if velocity.size else None,
        "effort": np.array([list(r[3]) for r in rows]),
    }
