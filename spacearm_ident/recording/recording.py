"""`Recording`: what one bag holds, as arrays, with what was found wrong with it.

Everything above the recording package works on this object and never on files. Arrays follow one joint
order (`joints`), whatever order the messages had; time is seconds from `start_ns`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from ..arrays import FloatArray

TEMPERATURE_UNIT = "temperature_unit"
"""Kind of the issue that temperatures are beyond what a joint can have."""
READINGS: Final = frozenset({"log", "effort_converted", "other_states"})
"""Kinds of issue that say how a file was read."""


@dataclass(frozen=True)
class Issue:
    """One kind of defect found in a recording, with its place and count.

    Attributes:
        kind: Stable short name, for programs: `gap`, `repeated_stamp`, `backward_stamp`, `nan`,
            `missing_joint`, `cut_off`, `corrupt_chunk`, `undecodable_message`, `log_time_used`, `two_sources`,
            `temperature_unit`, ...
        message: One sentence for a person: what was found, and what was done about it.
        count: How many samples, messages or places.
        where_s: Time of the first occurrence, seconds from the start of the recording (None: whole file).
    """

    kind: str
    message: str
    count: int = 1
    where_s: float | None = None

    @property
    def is_reading(self) -> bool:
        """Whether it says how the file was read, and no defect: columns, units, which topic."""
        return self.kind in READINGS


@dataclass(frozen=True)
class Series:
    """A time series on its own clock: `time` (N,) seconds from the recording's start, `values` (N, ...)."""

    time: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class Source:
    """Where data came from: the file as named by the user, its size and the SHA-256 of its bytes."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class BaseSensor:
    """What a sensor fixed to the arm's base recorded, on its own clock; vectors in the sensor's axes. SI units.

    Attributes:
        topic: Where it was.
        frame: The sensor's frame.
        time: (K,) seconds from the recording's start, strictly increasing.
        rate: (K, 3) angular velocity, rad/s.
        force: (K, 3) specific force as an accelerometer feels it (acceleration less gravity), m/s^2; None: `velocity`.
        velocity: (K, 3) velocity of the frame's origin against the world, m/s; None: `force`.
        attitude: (K, 4) quaternion x y z w that turns sensor axes into the world's, where `velocity` is given.
        runs: Runs of samples without a gap inside.
        rotation: (3, 3) sensor axes to those of the base link; None as long as that is not known.
        origin: (3,) of the sensor's frame in the base link, m; None as long as that is not known.
    """

    topic: str
    frame: str
    time: FloatArray
    rate: FloatArray
    runs: tuple[slice, ...]
    force: FloatArray | None = None
    velocity: FloatArray | None = None
    attitude: FloatArray | None = None
    rotation: FloatArray | None = None
    origin: FloatArray | None = None

    @property
    def rate_hz(self) -> float:
        """Median sample rate in Hz."""
        return float(1.0 / np.median(np.diff(self.time)))


@dataclass(frozen=True)
class Recording:
    """Joint signals of one run. SI units, output side; times strictly increasing; no NaN in the arrays.

    Attributes:
        joints: Names of the n joints, the column order of every array.
        time: (N,) seconds from `start_ns`, strictly increasing.
        position: (N, n) rad (m for prismatic joints).
        velocity: (N, n) rad/s, or None where the recording has none.
        effort: (N, n) N·m (N), motor torque on the output side.
        segments: Runs of samples without a gap inside; filters never reach across their borders.
        start_ns: Epoch time of `time == 0`, nanoseconds.
        command: Set-points (M, n) on their own clock, where recorded.
        temperatures: Joint name -> °C on its own clock.
        base: What a sensor on the base recorded, where there is one.
        urdf: Robot description, where recorded.
        effortless: Joint left out for want of effort -> lowest and highest position, rad (m for prismatic joints).
        issues: What was found wrong and what was done about it.
        sources: The files behind it.
    """

    joints: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray | None
    effort: FloatArray
    segments: tuple[slice, ...]
    start_ns: int = 0
    command: Series | None = None
    temperatures: dict[str, Series] = field(default_factory=dict)
    base: BaseSensor | None = None
    urdf: str | None = None
    effortless: dict[str, tuple[float, float]] = field(default_factory=dict)
    issues: tuple[Issue, ...] = ()
    sources: tuple[Source, ...] = ()

    @property
    def rate_hz(self) -> float:
        """Median sample rate in Hz."""
        return float(1.0 / np.median(np.diff(self.time)))

    def between(self, start_s: float, stop_s: float) -> Recording:
        """The samples with start_s <= time < stop_s; times, command, temperatures, base and issues stay."""
        first, last = (int(k) for k in np.searchsorted(self.time, (start_s, stop_s)))
        cut = [slice(max(s.start, first) - first, min(s.stop, last) - first) for s in self.segments]
        part = slice(first, last)
        return replace(
            self,
            time=self.time[part],
            position=self.position[part],
            velocity=None if self.velocity is None else self.velocity[part],
            effort=self.effort[part],
            segments=tuple(s for s in cut if s.stop > s.start),
        )

    def in_order(self, joints: tuple[str, ...]) -> Recording:
        """The same recording with its columns in the order (and subset) of `joints`.

        Raises:
            KeyError: A joint is not in the recording.
        """
        missing = [name for name in joints if name not in self.joints]
        if missing:
            raise KeyError(", ".join(missing))
        columns = [self.joints.index(name) for name in joints]
        return replace(
            self,
            joints=tuple(joints),
            position=self.position[:, columns],
            velocity=None if self.velocity is None else self.velocity[:, columns],
            effort=self.effort[:, columns],
            command=None if self.command is None else Series(self.command.time, self.command.values[:, columns]),
        )
