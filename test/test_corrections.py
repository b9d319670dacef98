"""Corrections of an arm YAML: read, refused in one line, applied."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_arm

from spacearm_ident.errors import UserError
from spacearm_ident.recording.corrections import read_corrections

NAMES = small_arm.JOINTS


def corrected(text: object):
    return read_corrections(text, NAMES, "arm.yaml: corrections").applied(small_arm.recording())


def test_position_velocity_and_effort_are_scaled_shifted_and_exchanged():
    first, second = NAMES
    before = small_arm.recording()
    after = corrected(
        {
            "joints": {
                "all": {"effort_scale": 2.0},
                first: {"position_scale": -1, "position_offset_rad": 0.3, "effort_from": second},
            }
        }
    )
    np.testing.assert_allclose(after.position[:, 0], 0.3 - before.position[:, 0])
    np.testing.assert_allclose(after.velocity[:, 0], -before.velocity[:, 0])
    np.testing.assert_allclose(after.effort, 2.0 * before.effort[:, [1, 1]])
    np.testing.assert_array_equal(after.position[:, 1], before.position[:, 1])


@pytest.mark.parametrize("delay", [0.05, -0.05])
def test_a_delay_takes_efforts_later_and_drops_what_has_none(delay):
    before = small_arm.recording()
    after = corrected({"joints": {"all": {"effort_delay_s": delay}}})
    samples = round(delay * 200)
    rows = np.searchsorted(before.time, after.time)
    np.testing.assert_allclose(after.effort, before.effort[rows + samples], atol=1e-6)
    assert len(after.time) == len(before.time) - abs(samples) == after.segments[0].stop


def test_an_even_clock_keeps_the_ends_of_every_segment():
    run = small_arm.recording()
    shaken = replace(run, time=run.time + 0.001 * np.sin(np.arange(len(run.time))))
    after = read_corrections({"clock": "even"}, NAMES, "x").applied(shaken)
    assert np.ptp(np.diff(after.time)) < 1e-9
    assert after.time[[0, -1]] == pytest.approx(shaken.time[[0, -1]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ([], "clock"),
        ({"clock": "late"}, "clock is one of"),
        ({"joints": {"nobody": {}}}, "nobody"),
        ({"joints": {NAMES[0]: {"position": 2}}}, "position_scale"),
        ({"joints": {NAMES[0]: {"effort_scale": 0}}}, "not 0"),
        ({"joints": {NAMES[0]: {"effort_scale": "much"}}}, "needs a number"),
        ({"joints": {NAMES[0]: {"position_from": "nobody"}}}, "names a joint"),
        ({"joints": 3}, "pairs"),
    ],
)
def test_a_correction_that_is_none_is_refused_in_one_line(text, says):
    with pytest.raises(UserError, match=says) as error:
        corrected(text)
    assert "\n" not in str(error.value)
