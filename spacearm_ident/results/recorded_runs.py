"""What was recorded, for the page: the motion of every recording, how fast each joint went, and the defects found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..recording.recording import Recording

MOST_SAMPLES = 500
"""Samples of a recording's motion that are kept for its picture; count."""


@dataclass(frozen=True)
class RecordedRun:
    """One recording of a result.

    Attributes:
        name: Of the file.
        fitted: Whether the model was fitted to it; else it is a held-out one.
        duration_s, rate_hz: Length, s, and median sample rate, Hz.
        samples: Samples used.
        defects: What was found wrong with it and what was done about it, a sentence each.
        read_as: How its file was read where that had to be decided, a sentence each.
        time: (M,) s, thinned.
        position: (M, n) rad or m, joints in the order of the arm.
        largest_speed: (n,) rad/s or m/s, over all samples.
    """

    name: str
    fitted: bool
    duration_s: float
    rate_hz: float
    samples: int
    defects: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    largest_speed: FloatArray
    read_as: tuple[str, ...] = ()


def recorded_runs(fitted: Sequence[Recording], held_out: Sequence[Recording], arm: Arm) -> tuple[RecordedRun, ...]:
    """Every recording once, those of the fit first; a recording that lacks a joint of the arm is left out.

    Args:
        fitted: Recordings the model was fitted to.
        held_out: Held-out recordings.
        arm: The arm, for the joints and their order.
    """
    pairs = [*((recording, True) for recording in fitted), *((recording, False) for recording in held_out)]
    return tuple(_run(recording, fit, arm) for recording, fit in pairs if set(arm.joint_names) <= set(recording.joints))


def _run(recording: Recording, fitted: bool, arm: Arm) -> RecordedRun:
    ordered = recording.in_order(arm.joint_names)
    kept = np.unique(np.linspace(0, len(ordered.time) - 1, MOST_SAMPLES).astype(int))
    velocity = ordered.velocity
    if velocity is None:
        pieces = [ordered.position[part] for part in ordered.segments if part.stop - part.start > 1]
        velocity = np.concatenate([np.diff(piece, axis=0) * ordered.rate_hz for piece in pieces] or [np.zeros((1, 1))])
    return RecordedRun(
        Path(recording.sources[0].path).name if recording.sources else "recording",
        fitted,
        float(ordered.time[-1] - ordered.time[0]),
        ordered.rate_hz,
        len(ordered.time),
        tuple(_sentence(issue.message, issue.where_s) for issue in recording.issues if not issue.is_reading),
        ordered.time[kept],
        ordered.position[kept],
        np.broadcast_to(np.abs(velocity).max(axis=0), (len(arm.joints),)).copy(),
        tuple(_sentence(issue.message, issue.where_s) for issue in recording.issues if issue.is_reading),
    )


def _sentence(message: str, where_s: float | None) -> str:
    return message if where_s is None else f"{message} (from {where_s:.3f} s)"
