"""Curves, thinned signals and printed numbers of the reports."""

from __future__ import annotations

import gc
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_result import arm, identification, identified_model, trace

from spacearm_ident.dynamics.friction_curve import friction_curve
from spacearm_ident.report.figures import MARKER, joint_signals, over_time, parameters
from spacearm_ident.report.plotting import decimated
from spacearm_ident.report.text import measured, number


@pytest.mark.parametrize("distance", [0.0, 1e-3])
def test_friction_curve_is_the_papers_law_whatever_the_presliding_distance(distance: float) -> None:
    model = identified_model(arm())
    constants = np.array([distance if constant.symbol == "d_s" else 0.02 for constant in model.model.constants])
    v, torque = friction_curve(replace(model, constants=constants), 0, 1.5, np.zeros(2))
    assert v[0] == -1.5 and v[-1] == 1.5 and np.all(np.diff(v) > 0) and not np.any(v == 0)
    expected = (4 + (6 - 4) * np.exp(-((v / 0.02) ** 2))) * np.sign(v) + 8 * v - 0.5 * v**2 + 0.25 * v**3
    np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_recordings_are_joined_on_one_axis() -> None:
    traces = [trace(2, 100, "a"), trace(2, 0, "b"), trace(2, 50, "c", seed=5)]
    signals = joint_signals(traces, 1, False)
    assert np.all(np.diff(signals.time) > 0)
    assert (signals.starts, signals.sources) == ((0, 100), ("a", "c"))
    np.testing.assert_array_equal(signals.residual[100:], (traces[2].measured - traces[2].predicted)[:, 1])
    np.testing.assert_allclose(np.ptp(signals.time[100:]), 20.0)
    assert joint_signals([trace(2, 0)], 0, True) is None


def test_every_standstill_is_shaded_over_its_own_time_and_garbage_is_collected_again() -> None:
    still = np.zeros((100, 2), bool)
    still[10:21, 0] = still[50:61, 0] = True
    signals = joint_signals([replace(trace(2, 100, "a"), moving=~still)], 0, True)
    drawing = str(over_time(signals, "turn"))
    corners = [re.findall(r"[ML] ([\d.]+) ", path) for path in re.findall(r'd="([^"]*)"[^>]*var\(--band\)', drawing)]
    # Both panels show both stretches, at the same place.
    assert len(corners) == 4 and corners[:2] == corners[2:]
    left, right = (sorted({float(x) for x in box}) for box in corners[:2])
    assert len(left) == len(right) == 2
    assert left[1] - left[0] == pytest.approx(right[1] - right[0], rel=1e-3)
    assert right[0] - left[0] == pytest.approx(4 * (left[1] - left[0]), rel=1e-3)
    assert gc.isenabled()


def test_every_parameter_has_its_marker_and_every_known_error_its_interval() -> None:
    identified = identification(identified_model(arm()))
    drawing = str(parameters(identified))
    for determination, (role, _, _) in MARKER.items():
        items = [item for item in identified.estimates if item.determination is determination]
        assert items
        assert len(re.findall(rf"<use [^>]*var\(--{role}\)", drawing)) >= len(items)
    lines = re.findall(r'd="([^"]*)"[^>]*fill: none; stroke: var\(--data\); stroke-width: 1.2"', drawing)
    bars = sum(line.count("M ") for line in lines)
    assert bars == sum(math.isfinite(item.standard_error) for item in identified.estimates)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9000), st.integers(0, 99), st.integers(1, 3))
def test_thinning_for_a_figure_keeps_every_extreme(count: int, seed: int, signals: int) -> None:
    given_ = np.random.default_rng(seed).normal(size=(signals, count))
    kept = decimated(*given_, most=500)
    assert len(kept) <= 500
    assert kept[0] == 0 and kept[-1] == count - 1
    assert np.all(np.diff(kept) > 0)
    for signal in given_:
        assert {int(signal.argmin()), int(signal.argmax())} <= set(kept.tolist())


SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text: str) -> float:
    """A printed number as a float."""
    mantissa, _, exponent = text.replace("−", "-").partition("×10")
    return float(mantissa) * 10.0 ** int(exponent.translate(SUPERSCRIPTS) or 0)


@given(st.floats(-1e12, 1e12).filter(lambda value: abs(value) > 1e-12), st.integers(1, 5))
def test_printed_numbers_are_right_to_their_digits(value: float, digits: int) -> None:
    assert read(number(value, digits)) == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - digits))


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e5))
def test_values_are_printed_to_the_digits_of_their_error(value: float, error: float) -> None:
    printed, uncertainty = (read(part) for part in measured(value, error).split(" ± "))
    assert uncertainty == pytest.approx(error, rel=0.15)
    assert abs(printed - value) <= max(0.16 * error, 5.1e-3 * abs(value) * (error > 10 or error < 1e-6))


def test_numbers_as_a_person_writes_them() -> None:
    assert (number(14.879, 3), number(-0.05), number(9.9996), number(0.0)) == ("14.9", "−0.0500", "10.0", "0")
    assert (number(math.nan), number(6.02e23), number(1e-7, 2)) == ("–", "6.02×10²³", "1.0×10⁻⁷")
    assert measured(14.8791, 0.0213) == "14.879 ± 0.021"
    assert measured(14.8791, 0.52) == "14.9 ± 0.5"
    assert measured(-0.0001, 0.5) == "0.0 ± 0.5"
    assert measured(14.8791, math.nan) == "14.88"
