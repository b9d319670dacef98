"""Where in a recording its motion is, and a recording cut so that the last share of the motion is held out.

Recordings often begin and end at rest. A part held out by the clock could then be rest alone, which judges nothing.
"""

from __future__ import annotations

import numpy as np

from ..recording.recording import Recording

AT_REST = 0.01
"""Share of its range by which a joint leaves where the recording begins or ends; joints whose range is below this share
of the largest do not count. Above the noise of an encoder in any motion that identifies."""


def moving_span(recording: Recording) -> tuple[float, float]:
    """First and last time, s, at which joints are elsewhere than where the recording begins and ends.

    Args:
        recording: With its positions; where nothing moves, all of it is the span.
    """
    lowest, highest = recording.position.min(axis=0), recording.position.max(axis=0)
    spread = highest - lowest
    moves = spread > AT_REST * spread.max(initial=0.0)
    position, room = recording.position[:, moves], AT_REST * spread[moves]
    left = np.flatnonzero((np.abs(position - position[0]) > room).any(axis=1))
    arrived = np.flatnonzero((np.abs(position - position[-1]) > room).any(axis=1))
    if not len(left) or not len(arrived) or left[0] >= arrived[-1]:
        return float(recording.time[0]), float(recording.time[-1])
    return float(recording.time[left[0]]), float(recording.time[arrived[-1]])


def cut_by_motion(
    recording: Recording, share: float, span: tuple[float, float] | None = None
) -> tuple[Recording, Recording]:
    """A recording without the last share of its motion, and that share with what rest follows it.

    Args:
        recording: To cut.
        share: Of the motion's time that is cut off.
        span: Where its motion is, s, if that is known (`moving_span`).
    """
    start, stop = span or moving_span(recording)
    cut = stop - share * (stop - start)
    return recording.between(-np.inf, cut), recording.between(cut, np.inf)
