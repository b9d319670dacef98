"""`JointSamples`: raw joint-state messages in, samples in the order of the arm's joints out.

What arrives is as it was sent: joints in any order, some without effort, broken messages between. What can be used is,
what cannot is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..recording import cdr

RATE_SAMPLES = 64
"""Intervals from which the rate of the joint states is taken."""


@dataclass(frozen=True)
class Samples:
    """`time` (k,) s since the epoch of their source; `position` rad and `effort` N·m, (k, n)."""

    time: FloatArray
    position: FloatArray
    effort: FloatArray


def without_effort(payloads: Sequence[bytes], joints: Sequence[str] = ()) -> tuple[str, ...]:
    """The joints, where none of them has a finite effort in any of the messages; else, and where none is named, empty.

    One is enough: joints that have none beside others that have (a gripper's) are fixed where a bag is read.

    Args:
        payloads: Serialised joint states.
        joints: Those that count; all in the messages unless given.
    """
    seen: dict[str, None] = {}
    for block in cdr.decode_joint_states(payloads)[0]:
        columns = [k for k, name in enumerate(block.names) if not joints or name in joints]
        if block.effort is not None and np.isfinite(block.effort[:, columns]).any():
            return ()
        seen |= dict.fromkeys(block.names[k] for k in columns)
    return tuple(seen)


class JointSamples:
    """Joint states of one arm, as they come.

    Args:
        joints: The arm's joints (n); messages may hold more.
        scale: (n,) N·m for each unit of effort (`Arm.effort_scale`); N·m unless given.

    Attributes:
        rate_hz: Of the messages, by the stamps of the first; NaN before.
        epoch_ns: The first stamp, from which time counts.
        left_out: Messages without a finite position and effort of every joint, or not to be decoded.
    """

    def __init__(self, joints: Sequence[str], scale: FloatArray | None = None) -> None:
        self.joints = tuple(joints)
        self._scale = np.ones(len(self.joints)) if scale is None else scale
        self.rate_hz = float("nan")
        self.epoch_ns = 0
        self.left_out = 0
        self._waiting: list[bytes] = []
        self._begun = False

    def take(self, payloads: Sequence[bytes]) -> Samples | None:
        """Take messages in the order of arrival; their samples, once there are enough to know the rate."""
        self._waiting.extend(payloads)
        unknown = np.isnan(self.rate_hz)
        if unknown and len(self._waiting) <= RATE_SAMPLES:
            return None
        stamps, position, effort = self._decode()
        if not len(stamps):
            return None
        if not self._begun:
            self.epoch_ns, self._begun = int(stamps[0]), True
        time = (stamps - self.epoch_ns) / 1e9
        if unknown:
            steps = np.diff(time)
            if not (steps > 0).any():
                return None
            self.rate_hz = float(1.0 / np.median(steps[steps > 0]))
        return Samples(time, position, effort)

    def _decode(self) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Stamps (k,) ns, positions and efforts (k, n) of the waiting messages that have them, in order of arrival."""
        payloads, self._waiting = self._waiting, []
        stamps = np.zeros(len(payloads), dtype=np.int64)
        values = np.full((len(payloads), 2, len(self.joints)), np.nan)
        for block in cdr.decode_joint_states(payloads)[0]:
            if block.position is None or block.effort is None or not set(self.joints) <= set(block.names):
                continue
            columns = [block.names.index(joint) for joint in self.joints]
            stamps[block.rows] = block.stamp_ns
            values[block.rows, 0] = block.position[:, columns]
            values[block.rows, 1] = self._scale * block.effort[:, columns]
        sound = np.isfinite(values).all(axis=(1, 2))
        self.left_out += int((~sound).sum())
        return stamps[sound], values[sound, 0], values[sound, 1]
