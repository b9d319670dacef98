"""A residual is split into noise, white before the low-pass, and what is slower."""

from __future__ import annotations

import numpy as np
import pytest
from mujoco_arm import JOINTS, mjcf, recorded
from scipy.signal import lfilter

from spacearm_ident.mismatch.preparation import banded
from spacearm_ident.noise.slow import white_and_slow

SLOW_NM, NOISE_NM = 0.05, 0.1


@pytest.mark.parametrize("with_gaps", [False, True], ids=["all rows", "gaps"])
def test_white_noise_has_no_slow_part_and_a_wandering_or_periodic_torque_is_one(with_gaps: bool) -> None:
    motion = banded([recorded(mjcf(), 1)], JOINTS, 20.0, 70.0)[0]
    rng, step = np.random.default_rng(0), 1.0 / motion.rate_hz
    count = len(motion.position)
    wander = lfilter([np.sqrt(2.0 * step)], [1.0, step - 1.0], rng.normal(size=count))
    wander /= np.sqrt(np.mean(wander**2))
    beat = np.sqrt(2.0) * np.sin(2.0 * np.pi * 3.4 * step * np.arange(count))
    noise = NOISE_NM * rng.normal(size=(count, 3))
    rows = motion.reduce(noise + SLOW_NM * np.stack([np.zeros(count), wander, beat], axis=1))
    counts = np.abs(motion.velocity_rows) > (0.1 if with_gaps else -1.0)
    white, slow = white_and_slow([motion], [rows], [counts])
    np.testing.assert_allclose(white, np.sqrt(np.mean(motion.reduce(noise) ** 2)), rtol=0.15)
    np.testing.assert_allclose(slow[1:], SLOW_NM, rtol=0.25)
    assert slow[0] < 0.6 * white[0]


def test_too_few_rows_tell_nothing() -> None:
    motion = banded([recorded(mjcf(), 1)], JOINTS, 20.0, 70.0)[0]
    counts = np.zeros_like(motion.velocity_rows, dtype=bool)
    counts[:20] = True
    assert np.isnan(white_and_slow([motion], [np.ones_like(motion.velocity_rows)], [counts])).all()
