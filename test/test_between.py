"""What differs between recordings is in the standard errors: friction that does, and none that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import structure_of
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.noise import between

SPREAD = 0.1
"""Planted relative standard deviation of friction between recordings."""
PLAIN = Friction(f_c=5.0, k_v1=4.0, k_v2=0.0, k_v3=0.0)


def of_scaled_friction(scales) -> Identified:
    """The two-link arm from recordings of other motions, its friction scaled in each."""
    recordings = []
    for seed, scale in enumerate(scales):
        law = replace(PLAIN, f_c=scale * PLAIN.f_c, k_v1=scale * PLAIN.k_v1)
        planted = two_link_run((law, law), seed=seed)
        recordings.append(planted.recording(noise=0.3, seed=seed))
    arm = arm_from_urdf(planted.urdf)
    return identify(recordings, arm, Settings(structure=structure_of(arm, "coulomb-viscous")))


def relative_error(result: Identified, symbol: str) -> float:
    found = [item for item in result.estimates if item.symbol == symbol]
    return float(np.mean([item.standard_error / item.value for item in found]))


@pytest.mark.parametrize("symbol", ["f_c", "k_v1"])
def test_friction_that_differs_between_recordings_is_as_uncertain_as_their_mean(symbol):
    scales = 1.0 + SPREAD * np.array([-1.2, 0.4, 1.3, -0.5])
    expected = np.std(scales, ddof=1) / np.sqrt(len(scales))
    assert relative_error(of_scaled_friction(scales), symbol) == pytest.approx(expected, rel=0.45)


def test_friction_that_is_the_same_is_as_certain_as_the_residual_says(monkeypatch):
    with_component = of_scaled_friction(np.ones(3))
    monkeypatch.setattr(between, "friction_shifts", lambda *given: np.zeros((0, given[-1])))
    monkeypatch.setattr("spacearm_ident.identification.fit.friction_shifts", between.friction_shifts)
    of_residual = of_scaled_friction(np.ones(3))
    for symbol in ("f_c", "k_v1"):
        assert relative_error(with_component, symbol) < 1.5 * relative_error(of_residual, symbol)


def test_one_recording_whose_friction_drifts_is_less_certain():
    planted = two_link_run((PLAIN, PLAIN))
    steady = planted.recording(noise=0.3)
    warming = np.linspace(1.0 + 2 * SPREAD, 1.0 - 2 * SPREAD, len(planted.q))[:, None]
    friction = PLAIN.f_c * np.sign(planted.qd) + PLAIN.k_v1 * planted.qd
    drifting = replace(steady, effort=steady.effort + (warming - 1.0) * friction)
    arm = arm_from_urdf(planted.urdf)
    settings = Settings(structure=structure_of(arm, "coulomb-viscous"))
    before, after = (relative_error(identify([one], arm, settings), "f_c") for one in (steady, drifting))
    assert after > 0.5 * SPREAD > before


def test_variance_between_groups_is_found_by_em():
    """Against the moment estimator of a balanced one-way layout with known noise."""
    rng = np.random.default_rng(1)
    groups, rows, spread = 200, 50, 0.3
    group = np.repeat(np.arange(groups), rows)
    torque = rng.standard_normal((len(group), 1))
    residual = torque[:, 0] * spread * rng.standard_normal(groups)[group] + rng.standard_normal(len(group))
    found = between._variance(torque, residual, group, np.eye(1))
    assert np.sqrt(found[0, 0]) == pytest.approx(spread, rel=0.15)
