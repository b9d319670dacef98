"""`JointSamples`: raw joint-state messages in, samples in the order of the arm's joints out.

What arrives is as it was sent: joints in any order, some without effort, broken messages between. What can be used is,
what cannot is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..conventions.plain import FIXED_RANGE
from ..dynamics.urdf_chain import of_a_hand
from ..recording import cdr

RATE_SAMPLES = 64
"""Intervals from which the rate of the joint states is taken."""


@dataclass(frozen=True)
class Samples:
    """`time` (k,) s since the epoch of their source; `position` rad and `effort` N·m, (k, n)."""

    time: FloatArray
    position: FloatArray
    effort: FloatArray


class EffortWatch:
    """Which joints have no effort, before anything is identified from them.

    One joint's effort is enough: others without (a gripper's) are fixed where a bag is read. Where one of the arm's
    moves that is wrong (`conventions.fixed_joints`).

    Attributes:
        absent: The joints, where none of them has a finite effort in the latest messages; else empty.
        moving: Joints of the arm, no gripper's, that have moved without effort beside others that have it.
    """

    def __init__(self) -> None:
        self.absent: tuple[str, ...] = ()
        self.moving: tuple[str, ...] = ()
        self._ends: dict[str, tuple[float, float]] = {}

    def forget(self) -> None:
        """Forget where joints have been: a run begins."""
        self._ends = {}

    def look(self, payloads: Sequence[bytes], joints: Sequence[str]) -> None:
        """Take the latest messages.

        Args:
            payloads: Serialised joint states.
            joints: The arm's; where they are not known all in the messages count for `absent`, and none for `moving`.
        """
        measured: set[str] = set()
        seen: dict[str, None] = {}
        for block in cdr.decode_joint_states(payloads)[0]:
            for k, name in enumerate(block.names):
                if joints and name not in joints:
                    continue
                seen[name] = None
                if block.effort is not None and np.isfinite(block.effort[:, k]).any():
                    measured.add(name)
                if block.position is not None:
                    known = block.position[np.isfinite(block.position[:, k]), k]
                    low, high = self._ends.get(name, (np.inf, -np.inf))
                    self._ends[name] = (float(np.min(known, initial=low)), float(np.max(known, initial=high)))
        self._ends = {name: ends for name, ends in self._ends.items() if name not in measured}
        self.absent = () if measured else tuple(seen)
        self.moving = tuple(
            name
            for name, (low, high) in self._ends.items()
            if measured and name in joints and not of_a_hand(name) and high - low > FIXED_RANGE
        )


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
