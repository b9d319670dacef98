"""`Corrections`: what a recording's conventions are, where they are not those of this package, and their application.

An arm YAML says them under `corrections`; they are applied where recordings meet the arm, before anything is
computed: position = position_scale * recorded + position_offset_rad; effort = effort_scale * recorded, taken
`effort_delay_s` later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Recording, Series

CLOCKS = ("recorded", "even", "reversed")
"""As stamped; samples evenly spaced between first and last stamp of every segment; counting backwards."""
ALL = "all"
"""Stands for every joint."""


@dataclass(frozen=True)
class JointCorrection:
    """How one joint was recorded.

    Attributes:
        position_scale: Factor on the recorded position and velocity: -1 for a reversed axis, pi/180 for degrees.
        position_offset_rad: Added to the scaled position.
        position_from: Name under which its position was recorded; empty: its own.
        effort_scale: Factor on the recorded effort: -1 for a reversed sign, N·m a unit.
        effort_from: Name under which its effort was recorded; empty: its own.
        effort_delay_s: How much later than the motion its effort was stamped.
    """

    position_scale: float = 1.0
    position_offset_rad: float = 0.0
    position_from: str = ""
    effort_scale: float = 1.0
    effort_from: str = ""
    effort_delay_s: float = 0.0

    def as_yaml(self) -> str:
        """`key: value` of everything that is not as recorded, to four digits; a scale of positions to ten."""
        digits = {"position_scale": ".10g"}
        changed = {one.name: getattr(self, one.name) for one in fields(self) if getattr(self, one.name) != one.default}
        return ", ".join(
            f"{key}: {value if isinstance(value, str) else format(value, digits.get(key, '.4g'))}"
            for key, value in changed.items()
        )


@dataclass(frozen=True)
class Corrections:
    """Of every joint that needs one, and of the clock."""

    joints: Mapping[str, JointCorrection] = field(default_factory=dict)
    clock: str = CLOCKS[0]

    @property
    def none(self) -> bool:
        """Whether there is nothing to correct."""
        return not self.joints and self.clock == CLOCKS[0]

    def as_yaml(self, joints: Sequence[str]) -> str:
        """What an arm YAML says under `corrections`, on one line; once where every joint needs the same.

        Args:
            joints: All joints of the arm.
        """
        alike = len(joints) > 1 and len({self.joints.get(name, JointCorrection()) for name in joints}) == 1
        named = {ALL: self.joints[joints[0]]} if alike and self.joints else self.joints
        parts = [] if self.clock == CLOCKS[0] else [f"clock: {self.clock}"]
        if named:
            parts.append("joints: {" + ", ".join(f"{name}: {{{one.as_yaml()}}}" for name, one in named.items()) + "}")
        return "{" + ", ".join(parts) + "}"

    def applied(self, recording: Recording) -> Recording:
        """The recording as it would have been with the conventions kept.

        Raises:
            UserError: A joint that is to be corrected, or taken from, is not in the recording.
        """
        if self.none:
            return recording
        known = [self.joints.get(name, JointCorrection()) for name in recording.joints]
        named = {name for name in self.joints} | {c.position_from for c in known} | {c.effort_from for c in known}
        missing = sorted(named - {""} - set(recording.joints))
        if missing:
            raise UserError(f"corrections name the joint {missing[0]!r}, which the recording does not have")
        corrected = _reclocked(recording, self.clock)
        index = {name: k for k, name in enumerate(recording.joints)}
        source = [index[c.position_from or name] for name, c in zip(recording.joints, known)]
        effort_source = [index[c.effort_from or name] for name, c in zip(recording.joints, known)]
        scale = np.array([c.position_scale for c in known])
        offset = np.array([c.position_offset_rad for c in known])
        command = corrected.command
        return _undelayed(
            replace(
                corrected,
                position=corrected.position[:, source] * scale + offset,
                velocity=None if corrected.velocity is None else corrected.velocity[:, source] * scale,
                effort=corrected.effort[:, effort_source] * np.array([c.effort_scale for c in known]),
                command=None if command is None else Series(command.time, command.values[:, source] * scale + offset),
            ),
            np.array([c.effort_delay_s for c in known]),
        )


def _reclocked(recording: Recording, clock: str) -> Recording:
    """On an even clock, or with time running the other way."""
    if clock == "even":
        time = np.array(recording.time)
        for segment in recording.segments:
            time[segment] = np.linspace(time[segment][0], time[segment][-1], len(time[segment]))
        return replace(recording, time=time)
    if clock != "reversed":
        return recording
    last, count = float(recording.time[-1]), len(recording.time)
    command = recording.command
    return replace(
        recording,
        time=last - recording.time[::-1],
        position=recording.position[::-1],
        velocity=None if recording.velocity is None else -recording.velocity[::-1],
        effort=recording.effort[::-1],
        segments=tuple(slice(count - s.stop, count - s.start) for s in reversed(recording.segments)),
        command=None if command is None else Series(last - command.time[::-1], command.values[::-1]),
        temperatures={name: Series(last - s.time[::-1], s.values[::-1]) for name, s in recording.temperatures.items()},
    )


def _undelayed(recording: Recording, delay_s: FloatArray) -> Recording:
    """Efforts taken `delay_s` (n,) later; samples at the ends of a segment, that have none so late, are dropped."""
    if not delay_s.any():
        return recording
    effort = np.array(recording.effort)
    keep = np.zeros(len(effort), dtype=bool)
    for segment in recording.segments:
        time = recording.time[segment]
        inside = (time + delay_s.max(initial=0.0) <= time[-1]) & (time + delay_s.min(initial=0.0) >= time[0])
        keep[segment] = inside
        for k, delay in enumerate(delay_s):
            effort[segment, k] = np.interp(time + delay, time, recording.effort[segment, k])
    ends = np.concatenate(([0], np.cumsum(keep)))
    parts = [slice(int(ends[s.start]), int(ends[s.stop])) for s in recording.segments]
    return replace(
        recording,
        time=recording.time[keep],
        position=recording.position[keep],
        velocity=None if recording.velocity is None else recording.velocity[keep],
        effort=effort[keep],
        segments=tuple(part for part in parts if part.stop > part.start),
    )


def read_corrections(data: Any, joints: tuple[str, ...], where: str) -> Corrections:
    """The `corrections` of an arm YAML.

    Args:
        data: `{clock: even, joints: {NAME or all: {position_scale: -1, ...}}}`, or nothing.
        joints: The arm's joints.
        where: The file and key, for errors.

    Raises:
        UserError: Not of that form, or an unknown joint or key.
    """
    if data is None:
        return Corrections()
    if not isinstance(data, dict) or not set(data) <= {"clock", "joints"}:
        raise UserError(f"{where} holds 'clock' and 'joints', not {data!r}")
    clock = data.get("clock", CLOCKS[0])
    if clock not in CLOCKS:
        raise UserError(f"{where}: clock is one of {', '.join(CLOCKS)}, not {clock!r}")
    given = data.get("joints") or {}
    if not isinstance(given, dict):
        raise UserError(f"{where}: joints needs 'NAME: {{key: value}}' pairs, not {given!r}")
    unknown = [name for name in given if name != ALL and name not in joints]
    if unknown:
        raise UserError(f"{where}: joint {unknown[0]!r} is not in the URDF")
    for_all = _joint_values(given.get(ALL), joints, f"{where}: {ALL}")
    read = {name: {**for_all, **_joint_values(given.get(name), joints, f"{where}: {name}")} for name in joints}
    return Corrections({name: JointCorrection(**values) for name, values in read.items() if values}, str(clock))


def _joint_values(data: Any, joints: tuple[str, ...], where: str) -> dict[str, Any]:
    if data is None:
        return {}
    keys = {one.name: one.type for one in fields(JointCorrection)}
    if not isinstance(data, dict) or not set(data) <= set(keys):
        raise UserError(f"{where} takes {', '.join(keys)}, not {data!r}")
    values: dict[str, Any] = {}
    for key, value in data.items():
        if key.endswith("_from"):
            if value not in joints:
                raise UserError(f"{where}: {key} names a joint of the arm, not {value!r}")
            values[key] = value
            continue
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if not np.isfinite(number) or (key.endswith("_scale") and number == 0.0):
            raise UserError(f"{where}: {key} needs a number{' that is not 0' if 'scale' in key else ''}, not {value!r}")
        values[key] = number
    return values
