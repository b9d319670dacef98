"""The part that is held out is of the motion: rest at either end of a recording does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.recording import Recording
from spacearm_ident.signals.moving_span import cut_by_motion, moving_span

RATE_HZ = 100.0


def resting(before_s: float, after_s: float, noise_rad: float = 2e-4) -> Recording:
    """Twelve seconds of motion between two rests, positions noisy throughout; time from zero."""
    run = two_link_run((Friction(), Friction()), seconds=12.0, rate_hz=RATE_HZ).recording()
    rows = [round(seconds * RATE_HZ) for seconds in (before_s, after_s)]
    position = np.pad(run.position, (rows, (0, 0)), mode="edge")
    position += noise_rad * np.random.default_rng(0).standard_normal(position.shape)
    effort = np.pad(run.effort, (rows, (0, 0)), mode="edge")
    count = len(position)
    return replace(
        run,
        time=np.arange(count) / RATE_HZ,
        position=position,
        velocity=None,
        effort=effort,
        segments=(slice(0, count),),
    )


@pytest.mark.parametrize(("before_s", "after_s"), [(0.0, 0.0), (3.0, 0.0), (0.0, 20.0), (5.0, 7.0)])
def test_span_is_the_motion_between_two_rests(before_s: float, after_s: float):
    start, stop = moving_span(resting(before_s, after_s))
    assert start == pytest.approx(before_s, abs=0.3)
    assert stop == pytest.approx(before_s + 12.0, abs=0.3)


def test_last_third_of_the_motion_is_held_out_when_the_recording_ends_at_rest():
    first, last = cut_by_motion(resting(5.0, 20.0), 1.0 / 3.0)
    assert len(first.time) + len(last.time) == 37.0 * RATE_HZ
    assert last.time[0] == pytest.approx(13.0, abs=0.3)


def test_whole_recording_counts_when_nothing_moves():
    still = resting(0.0, 0.0)
    still = replace(still, position=np.zeros_like(still.position))
    assert moving_span(still) == (still.time[0], still.time[-1])
