"""Detect joint states of two sources in one stream, from the positions in the order of arrival.

Two nodes that publish the same joints, of two arms or of one at two times, give positions that alternate between
two courses. No motion does that from sample to sample, and neither do positions that are published twice, late or in
batches.
"""

from __future__ import annotations

import numpy as np

from ..arrays import BoolArray, FloatArray

TWO_SOURCES = "two_sources"
"""Kind of the issue."""
JUMP_RAD = 1e-3
"""Step, rad or m, from which positions go anywhere: common encoders behind a gear are finer, and flicker by less."""
BACK_SHARE = 0.2
"""Distance to the sample before last, as a share of the step, up to which a sample is back where that was. At a
reversal a joint is that only if the extremum lies within a twentieth of an interval of the sample; two courses are
apart by five intervals of one of them, 25 ms at 200 Hz."""
LEAST_SHARE = 0.05
"""Share of samples that are back from which there are two sources: a second one at a twentieth of the other's rate.
Measured on 1 December 2026: 0 in all 33 recordings of `../shared/recordings`."""


def steps_back(position: FloatArray) -> int:
    """Number of samples at which all joints together are back where they were before the last sample.

    It takes two joints: noise of one that moves alone is back by chance in every eighth sample, of several seldom.

    Args:
        position: (N, n) in the order of arrival, finite.

    Returns:
        The number, where it is `LEAST_SHARE` of the samples or more and more than half of the joints that go to and fro
        at all do so together; else 0. A false reading of one joint is no second source.
    """
    count, joints = position.shape
    if count < 3 or joints < 2:
        return 0
    step = np.abs(position[2:] - position[1:-1])
    home = np.abs(position[2:] - position[:-2])
    whole = _back(np.linalg.norm(step, axis=1), np.linalg.norm(home, axis=1))
    if whole.sum() < LEAST_SHARE * count:
        return 0
    alike = _back(step, home)[whole].mean(axis=0)
    going = np.ptp(position, axis=0) > JUMP_RAD
    return int(whole.sum()) if going.sum() > 1 and np.median(alike[going]) > 0.5 else 0


def _back(step: FloatArray, home: FloatArray) -> BoolArray:
    return np.asarray((step > JUMP_RAD) & (home < BACK_SHARE * step))
