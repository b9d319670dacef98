"""Messages of a sensor on the arm's base to a sound `BaseSensor`, and the account of what was dropped.

`/base_imu` (sensor_msgs/msg/Imu) or `/base_odometry` (nav_msgs/msg/Odometry); the IMU where both are there, because it
needs neither attitude nor gravity. An IMU's `linear_acceleration` is what an accelerometer feels: +g upwards at rest on
the ground, nothing in free fall (REP-145). An odometry's twist is in the axes of `child_frame_id`.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from itertools import pairwise

import numpy as np

from spacearm_ident.arrays import BoolArray, FloatArray, IntArray
from spacearm_ident.recording import cdr, messages
from spacearm_ident.recording.contents import Bag, Stream
from spacearm_ident.recording.intake import Finding, Intake, gap_threshold_s, increasing
from spacearm_ident.recording.recording import BaseSensor

FEWEST = 16
"""Samples that a motion can be made of."""
_IMU_NUMBERS, _ODOMETRY_NUMBERS = 37, 85
_UNKNOWN = -1.0  # first element of a covariance: this quantity is not measured (REP-145)


def read_base(bag: Bag, states: Intake) -> tuple[BaseSensor | None, list[Finding]]:
    """The sensor on the base, if the bag has one that can be used, and what was found wrong with it.

    Args:
        bag: All streams; the IMU's topic is preferred to the odometry's.
        states: Joint states of the same bag; the sensor's times count from their first stamp.
    """
    for topic, texts, numbers in (
        (messages.BASE_IMU_TOPIC, 1, _IMU_NUMBERS),
        (messages.BASE_ODOMETRY_TOPIC, 2, _ODOMETRY_NUMBERS),
    ):
        if stream := bag.streams.get(topic):
            return _BaseIntake(topic, stream, states).sensor(texts, numbers)
    return None, []


class _BaseIntake:
    """One topic on its way to a sensor."""

    def __init__(self, topic: str, stream: Stream, states: Intake) -> None:
        self._topic, self._stream, self._states = topic, stream, states
        self._findings: list[Finding] = []

    def sensor(self, texts: int, numbers: int) -> tuple[BaseSensor | None, list[Finding]]:
        """Decode `texts` strings and `numbers` float64 a message, drop what cannot be used."""
        stamps, frames, values = self._decoded(texts, numbers)
        rate, linear, attitude = self._split(values)
        frame = Counter(frames.tolist()).most_common(1)[0][0] if len(frames) else ""
        keep = np.isfinite(np.concatenate([rate, linear], axis=1)).all(axis=1)
        if attitude is not None:
            keep &= np.abs(np.linalg.norm(attitude, axis=1) - 1.0) < 0.01
        self._note(keep, "nan", "messages with NaN, infinite or absent values left out", stamps)
        self._note(~keep | (frames == frame), "base_frame", f"messages of other frames than {frame} left out", stamps)
        keep &= frames == frame
        in_time: BoolArray = np.zeros(len(keep), dtype=bool)
        in_time[keep] = increasing(stamps[keep])
        text = "messages with repeated stamps or stamps out of order left out"
        self._note(~keep | in_time, "backward_stamp", text, stamps)
        stamps, rate, linear = stamps[in_time], rate[in_time], linear[in_time]
        if not self._usable(stamps):
            return None, self._findings
        start = self._states.samples.stamp_ns[0]
        time = (stamps - start) / 1e9
        imu = attitude is None
        sensor = BaseSensor(
            topic=self._topic,
            frame=frame,
            time=time,
            rate=rate,
            runs=self._runs(time),
            force=linear if imu else None,
            velocity=None if imu else linear,
            attitude=None if attitude is None else attitude[in_time],
        )
        return sensor, self._findings

    def _decoded(self, texts: int, numbers: int) -> tuple[IntArray, np.ndarray, FloatArray]:
        """Stamps (K,), frames (K,) and numbers (K, numbers) of the messages that can be decoded."""
        stamps, rows = self._states.decoded(self._stream, partial(cdr.decode_stamped, texts=texts, numbers=numbers))
        if lost := len(self._stream.payloads) - len(rows):
            self._find("undecodable_message", f"{lost} messages left out that cannot be decoded", lost)
        # The sensor's frame is the header's of an IMU, the child of an odometry: the last string of either.
        frames = np.array([words[-1].lstrip("/") for _, words, _ in rows], dtype=object)
        return stamps, frames, np.array([values for _, _, values in rows]).reshape(-1, numbers)

    def _split(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Angular velocity, specific force or velocity, and for the latter the attitude; NaN where not measured."""
        if self._topic == messages.BASE_ODOMETRY_TOPIC:
            return values[:, 46:49], values[:, 43:46], values[:, 3:7]
        rate, force = values[:, 13:16].copy(), values[:, 25:28].copy()
        rate[values[:, 16] == _UNKNOWN] = np.nan
        force[values[:, 28] == _UNKNOWN] = np.nan
        return rate, force, None

    def _usable(self, stamps: IntArray) -> bool:
        """Whether enough of it lies where the joint states are."""
        joints = self._states.samples.stamp_ns
        inside = int(((stamps >= joints[0]) & (stamps <= joints[-1])).sum())
        if inside >= FEWEST:
            return True
        why = "too few messages can be used"
        if len(stamps) >= FEWEST:
            apart = (int(stamps[0]) - int(joints[0])) / 1e9
            why = f"its stamps begin {apart:.6g} s after those of the joint states (another clock?)"
        self._find("base_unusable", f"not used: {why}; the base is taken for fixed", len(self._stream.payloads))
        return False

    def _runs(self, time: FloatArray) -> tuple[slice, ...]:
        """Runs without a gap, and the finding that says for how long the joint states are without base motion."""
        breaks: IntArray = np.flatnonzero(np.diff(time) > gap_threshold_s(time)) + 1
        runs = tuple(slice(start, stop) for start, stop in pairwise([0, *breaks.tolist(), len(time)]))
        start = self._states.samples.stamp_ns[0]
        joints = (self._states.samples.stamp_ns - start) / 1e9
        bare: BoolArray = np.ones(len(joints), dtype=bool)
        for run in runs:
            bare &= (joints < time[run.start]) | (joints > time[run.stop - 1])
        step = float(np.median(np.diff(time)))
        # What the sensor begins later or ends earlier by a few of its own samples is no loss worth a word.
        bare &= (joints > time[0] + 3 * step) | (joints < time[0] - 3 * step)
        bare &= (joints < time[-1] - 3 * step) | (joints > time[-1] + 3 * step)
        if count := int(bare.sum()):
            text = f"no base motion for {count} of {len(joints)} joint states, which are left out"
            self._find("base_gap", text, count, int(self._states.samples.stamp_ns[np.argmax(bare)]))
        return runs

    def _note(self, keep: BoolArray, kind: str, text: str, stamps: IntArray) -> None:
        """Put what is not kept on the account."""
        if count := int((~keep).sum()):
            self._find(kind, f"{count} {text}", count, int(stamps[np.argmin(keep)]))

    def _find(self, kind: str, text: str, count: int, stamp_ns: int | None = None) -> None:
        self._findings.append(Finding(kind, f"{self._topic}: {text}", count, stamp_ns))
