"""Intervals of an effect's values, against closed forms and against how far values really scatter."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spacearm_ident.dynamics.term import Constant
from spacearm_ident.estimate.identified import GAIN_DEVIATION
from spacearm_ident.mismatch import intervals
from spacearm_ident.mismatch.intervals import LAW_ERROR, PER_FIT, PER_PARTS, Intervals
from spacearm_ident.mismatch.scored import PARTS
from spacearm_ident.mismatch.stacked import Stacked

ROWS = 1200
TIME = np.linspace(0.0, 1.0, ROWS, endpoint=False)
LEVEL, WAVE = np.ones(ROWS), np.sin(40.0 * TIME)
RATE = Constant("rate", "hip", "rad/s", (10.0, 90.0))


def fitted(torque, columns, base=LEVEL, held=(), constants=(), weighs=False, kind="payload"):
    """Least squares of base and columns at one joint, and their intervals; noise has variance one."""
    columns = np.stack(columns, axis=1)
    basis = base[:, None] / np.linalg.norm(base)
    beyond = columns - basis @ (basis.T @ columns)
    free = ~np.isin(np.arange(columns.shape[1]), held)
    values = np.zeros(columns.shape[1])
    values[free] = np.linalg.lstsq(beyond[:, free], torque, rcond=None)[0]
    residual = torque - basis @ (basis.T @ torque) - beyond @ values
    evidence = SimpleNamespace(
        rows=ROWS,
        field=SimpleNamespace(
            part=lambda count: count * np.arange(ROWS) // ROWS, joint=np.zeros(ROWS, int), whiteners=[None]
        ),
        residual_beside=lambda accepted: residual,
        beyond_base=lambda whole: whole - basis @ (basis.T @ whole),
    )
    candidate = SimpleNamespace(
        effect=SimpleNamespace(parameters=columns[0], constants=[RATE] * len(constants), weighs=weighs, kind=kind),
        constants=constants,
        held=~free,
        stacked=Stacked(slice(0, ROWS), columns),
    )
    return values, Intervals(evidence, [candidate], values)


def test_noise_alone_moves_a_value_by_what_the_fit_says():
    _, made = fitted(np.random.default_rng(0).standard_normal(ROWS), [WAVE])
    beyond = WAVE - WAVE.mean()
    assert made.fit[0][0, 0] == pytest.approx(1.0 / (beyond @ beyond))
    # Twelve parts tell a variance to a third or so.
    assert made.parts[0][0, 0] == pytest.approx(made.fit[0][0, 0], rel=0.8)
    widest = max(PER_FIT * made.fit[0][0, 0] ** 0.5, PER_PARTS * made.parts[0][0, 0] ** 0.5)
    assert made.half_width(0, np.array([-2.0])) == pytest.approx(2.0 * widest)


def test_body_is_known_no_better_than_the_gain_of_the_torque_that_weighs_it():
    """At one joint the gain is in the value as it is: 7 % of it, whatever the noise."""
    torque = 1000.0 * WAVE + np.random.default_rng(0).standard_normal(ROWS)
    (mass,), as_recorded = fitted(torque, [WAVE])
    _, weighed = fitted(torque, [WAVE], weighs=True)
    added = weighed.fit[0][0, 0] - as_recorded.fit[0][0, 0]
    assert added == pytest.approx((GAIN_DEVIATION * mass) ** 2)
    assert weighed.half_width(0, np.ones(1)) > 30.0 * as_recorded.half_width(0, np.ones(1))


def test_law_that_is_not_quite_nature_s_is_known_to_a_share_of_its_values():
    torque = 1000.0 * WAVE + np.random.default_rng(0).standard_normal(ROWS)
    (level,), exact = fitted(torque, [WAVE])
    _, made = fitted(torque, [WAVE], kind="friction_drift")
    added = made.fit[0][0, 0] - exact.fit[0][0, 0]
    assert added == pytest.approx((LAW_ERROR["friction_drift"] * level) ** 2)
    assert made.half_width(0, np.ones(1)) > 0.09 * level


@pytest.mark.parametrize("unruly", [0.0, 1.0])
def test_of_many_arms_the_truth_is_within_about_as_often_as_said(unruly):
    """Also where the amplitude is another in every part of the time, which no law of the catalogue's says."""
    rng = np.random.default_rng(1)
    part = PARTS * np.arange(ROWS) // ROWS
    hits, by_fit = [], []
    for _ in range(300):
        amplitude = 2.0 + unruly * rng.standard_normal(PARTS)[part]
        values, made = fitted(0.7 + amplitude * WAVE + rng.standard_normal(ROWS), [WAVE])
        hits.append(abs(values[0] - 2.0) < made.half_width(0, np.ones(1)))
        by_fit.append(abs(values[0] - 2.0) < PER_FIT * made.fit[0][0, 0] ** 0.5)
    assert 0.91 < np.mean(hits) < 0.999
    assert np.mean(by_fit) > 0.92 if unruly == 0.0 else np.mean(by_fit) < 0.5


def test_what_is_held_has_no_width_and_what_shares_its_torque_is_wider():
    rng = np.random.default_rng(2)
    alike = WAVE + 0.1 * np.cos(90.0 * TIME)
    torque = rng.standard_normal(ROWS)
    first = np.array([1.0, 0.0])
    _, alone = fitted(torque, [WAVE, alike], held=[1])
    _, beside = fitted(torque, [WAVE, alike])
    assert alone.half_width(0, np.array([0.0, 1.0])) == 0.0
    assert beside.half_width(0, first) > 5.0 * alone.half_width(0, first) > 0.0


def test_what_the_data_do_not_tell_has_no_end_of_its_interval():
    """Of two equal columns their sum alone is determined, and of a column of zeros nothing."""
    torque = np.random.default_rng(0).standard_normal(ROWS)
    _, made = fitted(torque, [WAVE, WAVE, np.zeros(ROWS)])
    assert np.isfinite(made.half_width(0, np.array([1.0, 1.0, 0.0])))
    for slope in ([1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]):
        assert made.half_width(0, np.array(slope)) == np.inf
    _, held = fitted(torque, [WAVE, np.zeros(ROWS)], held=[1])
    assert held.half_width(0, np.array([0.0, 1.0])) == 0.0


def test_a_constant_is_as_sure_as_its_derivative_is_large(monkeypatch):
    """A wave whose rate is looked for: its error is that of least squares in the rate."""
    monkeypatch.setattr(
        intervals,
        "stacked_effect",
        lambda field, effect, constants: Stacked(slice(0, ROWS), np.sin(constants[0] * TIME)[:, None]),
    )
    _, made = fitted(3.0 * WAVE + np.random.default_rng(3).standard_normal(ROWS), [WAVE], constants=(40.0,))
    jacobian = np.stack([WAVE, 3.0 * TIME * np.cos(40.0 * TIME)], axis=1)
    jacobian -= jacobian.mean(axis=0)
    np.testing.assert_allclose(made.fit[0], np.linalg.inv(jacobian.T @ jacobian), rtol=0.1, atol=1e-4)


def test_a_constant_that_moves_nothing_is_anywhere_within_its_bounds(monkeypatch):
    monkeypatch.setattr(intervals, "stacked_effect", lambda *_: Stacked(slice(0, ROWS), WAVE[:, None]))
    _, made = fitted(3.0 * WAVE, [WAVE], constants=(40.0,))
    assert made.half_width(0, np.array([0.0, 1.0])) == pytest.approx(80.0 / 2, rel=0.3)


def test_nothing_accepted_is_nothing_to_be_sure_of():
    made = Intervals(SimpleNamespace(), [], np.zeros(0))
    assert made.fit == made.parts == []
