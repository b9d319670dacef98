"""Trajectory files, `spacearm_ident/trajectory/1`: a YAML list of segments.

schema: spacearm_ident/trajectory/1
joints: [joint_1, joint_2]            # the order of every list below
segments:
- {kind: rest, duration_s: 1.0, position: [0.0, 0.0]}
- {kind: quintic, duration_s: 3.0}    # from where the last segment ends to where the next starts
- kind: fourier                       # paper eq. 9
  fundamental_hz: 0.1
  periods: 5
  q0: [0.2, -0.4]                     # rad
  a: [[0.1, 0.2], [0.3, 0.1]]         # rad/s, one row a joint, one column a harmonic
  b: [[0.0, 0.1], [0.2, 0.1]]
- {kind: quintic, duration_s: 3.0}
- {kind: cruise, duration_s: 2.0, position: [0.5, 0.0], velocity: [0.01, 0.0]}   # constant speed from there
- {kind: quintic, duration_s: 3.0}
- {kind: chirp, duration_s: 20.0, centre: [0.0, 0.0], amplitude: [0.01, 0.0], start_hz: 0.5, end_hz: 15.0}
- {kind: quintic, duration_s: 3.0}
- {kind: rest, duration_s: 1.0, position: [0.0, 0.0]}
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from spacearm_ident.arrays import FloatArray
from spacearm_ident.documents import read_yaml, write_whole
from spacearm_ident.errors import UserError, one_line
from spacearm_ident.excitation.segments import Chirp, Cruise, Quintic, Rest, Segment
from spacearm_ident.excitation.trajectory import FourierTrajectory, Trajectory

SCHEMA = "spacearm_ident/trajectory/1"

Entry = dict[str, Any]


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory file.

    Raises:
        UserError: The file cannot be read, is not such a file, or its segments do not join; the line says
            where and what to do.
    """
    document = read_yaml(Path(path), "the trajectory")
    try:
        return trajectory_from_dict(document)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def save_trajectory(trajectory: Trajectory, path: str | Path, origin: Sequence[str] = ()) -> None:
    """Write a trajectory file that loads back to the same numbers.

    Args:
        trajectory: The motion.
        path: Where to; a file that is there is replaced, whole or not at all.
        origin: How it was made: lines of comment at its head.

    Raises:
        UserError: The file cannot be written.
    """
    text = yaml.safe_dump(trajectory_to_dict(trajectory), sort_keys=False, default_flow_style=None, width=100)
    try:
        write_whole(Path(path), "".join(f"# {one_line(line)}\n" for line in origin) + text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error}); choose another place") from error


def trajectory_to_dict(trajectory: Trajectory) -> Entry:
    """The document of a trajectory file as plain data."""
    return {
        "schema": SCHEMA,
        "joints": list(trajectory.joints),
        "segments": [_segment_to_dict(segment) for segment in trajectory.segments],
    }


def trajectory_from_dict(document: object) -> Trajectory:
    """Build the trajectory a document describes.

    Raises:
        UserError: The document is not a valid trajectory.
    """
    fields = _fields(document, "the file", ("schema", "joints", "segments"))
    if fields["schema"] != SCHEMA:
        raise UserError(f"schema is {fields['schema']!r}; this program reads {SCHEMA!r}")
    joints = fields["joints"]
    if not isinstance(joints, list) or not joints or not all(isinstance(name, str) for name in joints):
        raise UserError("joints must be a list of joint names")
    if len(set(joints)) < len(joints):
        raise UserError("joints names one joint twice; name each once")
    entries = fields["segments"]
    if not isinstance(entries, list) or not entries:
        raise UserError("segments must be a list of at least one segment")
    names = tuple(joints)
    segments = [_segment(entry, f"segment {i}", names) for i, entry in enumerate(entries, start=1)]
    return Trajectory(names, _joined(segments))


_FORMS: dict[str, tuple[type[Any], dict[str, int]]] = {
    "rest": (Rest, {"duration_s": 0, "position": 1}),
    "quintic": (Quintic, {"duration_s": 0}),
    "fourier": (FourierTrajectory, {"fundamental_hz": 0, "periods": 0, "q0": 1, "a": 2, "b": 2}),
    "cruise": (Cruise, {"duration_s": 0, "position": 1, "velocity": 1}),
    "chirp": (Chirp, {"duration_s": 0, "centre": 1, "amplitude": 1, "start_hz": 0, "end_hz": 0}),
}
"""Kind -> its class, and of each attribute the dimensions: 0 a positive number, 1 a number a joint, 2 a row a joint."""


def _segment(entry: object, where: str, joints: tuple[str, ...]) -> Segment | float:
    """One segment; a quintic comes back as its duration alone, to be joined to its neighbours."""
    kind = entry.get("kind") if isinstance(entry, dict) else None
    if not isinstance(kind, str) or kind not in _FORMS:
        raise UserError(f"{where}: kind {kind!r} is unknown; use one of {', '.join(_FORMS)}")
    made, form = _FORMS[kind]
    fields = _fields(entry, where, ("kind", *form))
    values: Entry = {"joints": joints} if kind == "fourier" else {}
    for key, dimensions in form.items():
        if key == "periods":
            values[key] = _count(fields, key, where)
        elif dimensions == 0:
            values[key] = _positive(fields, key, where)
        else:
            shape = values["a"].shape if key == "b" else (len(joints), None)[:dimensions]
            values[key] = _array(fields, key, where, shape)
    segment: Segment | float = values["duration_s"] if kind == "quintic" else made(**values)
    return segment


def _joined(segments: list[Segment | float]) -> tuple[Segment, ...]:
    out: list[Segment] = []
    for i, segment in enumerate(segments):
        if not isinstance(segment, float):
            out.append(segment)
            continue
        following = segments[i + 1] if i + 1 < len(segments) else None
        if not out or following is None or isinstance(following, float):
            raise UserError(f"segment {i + 1}: a quintic joins two segments of other kinds; put one on each side")
        last = out[-1]
        end, begin = last.evaluate(last.duration_s).at(0), following.evaluate(0.0).at(0)
        out.append(Quintic(end, begin, duration_s=segment))
    return tuple(out)


def _segment_to_dict(segment: Segment) -> Entry:
    for kind, (made, form) in _FORMS.items():
        if isinstance(segment, made):
            plain = {key: np.asarray(getattr(segment, key), dtype=float).tolist() for key in form}
            counts = {"periods": segment.periods} if isinstance(segment, FourierTrajectory) else {}
            return {"kind": kind, **plain, **counts}
    raise TypeError(f"no file form for {type(segment).__name__}")


def _fields(document: object, where: str, keys: Sequence[str]) -> Entry:
    """The mapping, with exactly these keys."""
    if not isinstance(document, dict):
        raise UserError(f"{where} must be a mapping with the keys {', '.join(keys)}")
    unknown = [str(key) for key in document if key not in keys]
    if unknown:
        raise UserError(f"{where}: unknown key {', '.join(unknown)}; the keys are {', '.join(keys)}")
    missing = [key for key in keys if key not in document]
    if missing:
        raise UserError(f"{where}: {', '.join(missing)} missing; add it")
    return document


def _count(fields: Entry, key: str, where: str) -> int:
    value = fields[key]
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise UserError(f"{where}: {key} must be a whole number of at least 1, not {value!r}")
    return value


def _positive(fields: Entry, key: str, where: str) -> float:
    value = float(_array(fields, key, where, ()))
    if value <= 0:
        raise UserError(f"{where}: {key} must be above zero, not {value:g}")
    return value


def _array(fields: Entry, key: str, where: str, shape: tuple[int | None, ...]) -> FloatArray:
    """Finite numbers of this shape (None: any length above zero)."""
    try:
        array = np.asarray(fields[key], dtype=float)
    except (TypeError, ValueError):
        array = np.full((), np.nan)
    fits = array.ndim == len(shape) and all(
        have == want or (want is None and have > 0) for have, want in zip(array.shape, shape, strict=False)
    )
    if not fits or not np.all(np.isfinite(array)):
        size = " × ".join("any" if want is None else str(want) for want in shape)
        raise UserError(f"{where}: {key} must be {f'finite numbers, {size}' if shape else 'a finite number'}")
    return array
