"""Can a recording carry the question at all? What is broken in it is said before anything is explained with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..recording.recording import Recording
from ..signals.prepare import require_joints

SATURATED_SHARE = 0.02
"""A joint whose torque stands at its extreme for this share of the samples is clipped."""
LOST_SHARE = 0.2
"""More time than this without samples, and what is left is not a recording of one motion."""
FEWEST_MOVING_S = 2.0


def faults(recordings: Sequence[Recording], joints: Sequence[str]) -> list[str]:
    """Reasons not to explain anything with these recordings, in words; empty where they are sound.

    Args:
        recordings: All that an explanation would use: reference, field and held-out ones.
        joints: Names in the arm's order; other joints of a recording are not looked at.

    Raises:
        UserError: A recording lacks a joint of the arm.
    """
    found = []
    for recording in recordings:
        where = recording.sources[0].path if recording.sources else "a recording"
        require_joints(recording, joints)
        ordered = recording.in_order(tuple(joints))
        found += [f"{where}: {text}" for text in (*_clock(ordered), *_torque(ordered), *_motion(ordered))]
    return found


def _clock(recording: Recording) -> list[str]:
    time = recording.time
    lost = sum(time[b.start] - time[a.stop - 1] for a, b in zip(recording.segments, recording.segments[1:]))
    span = float(time[-1] - time[0])
    if span > 0 and lost > LOST_SHARE * span:
        return [f"{lost:.1f} s of {span:.1f} s are missing: its time stamps are broken or samples were lost"]
    return []


def _torque(recording: Recording) -> list[str]:
    """A clipped torque repeats its extreme value; noise and motion never do."""
    texts = []
    for k, joint in enumerate(recording.joints):
        torque = recording.effort[:, k]
        if not np.any(torque):
            texts.append(f"the torque of {joint} is zero throughout")
            continue
        largest = float(np.abs(torque).max())
        share = float(np.mean(np.abs(np.abs(torque) - largest) < 1e-6 * largest))
        if share > SATURATED_SHARE:
            texts.append(f"the torque of {joint} stands at {largest:.3g} N m for {100 * share:.0f} % of it: saturated")
    return texts


def _motion(recording: Recording) -> list[str]:
    span = np.ptp(recording.position, axis=0)
    if float(span.max()) < 1e-3:
        return ["no joint moves: record an excitation run"]
    if recording.time[-1] - recording.time[0] < FEWEST_MOVING_S:
        return ["it is too short: record an excitation run of several seconds"]
    return []
