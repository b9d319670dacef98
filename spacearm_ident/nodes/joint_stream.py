"""`sensor_msgs/msg/JointState` a thousand times a second: CDR bytes patched and read in place.

A message of the same joints always has the same layout, so only stamp and numbers are written into a prepared
payload, or read at known places of a received one. A typed message costs several times as much (issue 3).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from ..arrays import FloatArray
from ..errors import UserError
from ..recording.cdr import encode_joint_states

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_BEHIND_STAMP = 12


class JointStateWriter:
    """Payloads for `Publisher.publish`, all of the same joints and filled arrays."""

    def __init__(self, joints: Sequence[str], *filled: str) -> None:
        """Prepare the payload.

        Args:
            joints: Names.
            *filled: Which of `position`, `velocity`, `effort` the messages carry; the others stay empty.
        """
        n = len(joints)
        # Numbers that occur nowhere else in the payload, to find the arrays again.
        marks = {name: -1e300 * (1.0 + 0.1 * k) * np.ones((1, n)) for k, name in enumerate(filled)}
        position, velocity, effort = (marks.get(name) for name in ("position", "velocity", "effort"))
        payload = encode_joint_states([0], joints, position, velocity, effort)[0]
        self._buffer = bytearray(payload)
        self._arrays = [
            np.frombuffer(self._buffer, dtype="<f8", count=n, offset=payload.index(mark.tobytes()))
            for mark in marks.values()
        ]

    def payload(self, stamp_ns: int, *values: FloatArray) -> bytes:
        """The message with this stamp and these arrays (n,), in the order of `filled`."""
        _STAMP.pack_into(self._buffer, _STAMP_AT, *divmod(stamp_ns, 1_000_000_000))
        for array, value in zip(self._arrays, values):
            array[:] = value
        return bytes(self._buffer)


class JointStateReader:
    """Stamp and positions out of raw messages, in the order of `joints`, whatever order the sender has."""

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = tuple(joints)
        self._head = b""
        self._order: NDArray[np.intp] | None = None

    def read(self, payload: bytes) -> tuple[int, FloatArray]:
        """Stamp in nanoseconds, and positions (n,).

        Raises:
            UserError: A joint or its position is missing, or there are joints the arm does not have.
        """
        end = _BEHIND_STAMP + len(self._head)
        if not self._head or payload[_BEHIND_STAMP:end] != self._head:
            self._learn(payload)
            end = _BEHIND_STAMP + len(self._head)
        seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_AT)
        position = np.frombuffer(payload, dtype="<f8", count=len(self._joints), offset=end)
        return seconds * 1_000_000_000 + nanoseconds, position[self._order]

    def _learn(self, payload: bytes) -> None:
        """Understand the layout: everything from behind the stamp to the positions is the same next time."""
        self._head = b""
        message = deserialize_message(payload, JointState)
        names = list(message.name)
        odd = sorted(set(names) ^ set(self._joints))
        if odd or len(names) != len(self._joints):
            raise UserError(f"a set-point must name each of the arm's joints once; {', '.join(odd) or names}")
        if len(message.position) != len(names):
            raise UserError(f"a set-point has {len(message.position)} positions for {len(names)} joints")
        template = encode_joint_states([0], names, np.full((1, len(names)), -1e300), frame_id=message.header.frame_id)[
            0
        ]
        start = template.index(struct.pack("<d", -1e300))
        if payload[:4] != template[:4] or payload[_BEHIND_STAMP:start] != template[_BEHIND_STAMP:start]:
            raise UserError("a set-point is not little-endian CDR: use an rmw that sends plain CDR")
        self._head = payload[_BEHIND_STAMP:start]
        self._order = np.array([names.index(joint) for joint in self._joints])
