"""The paper's arm, simulated: standard errors of what the data determine keep their promise (few seeds; see bench/)."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_arm import CONFIG, paper_arm, paper_drives, paper_limits

from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.estimate.identified import Determination, Identified
from spacearm_ident.excitation.trajectory import random_feasible
from spacearm_ident.identification.identify import identify
from spacearm_ident.simulation.closed_loop import SensorNoise, measure, simulate_truth

SEEDS = range(4)


@pytest.fixture(scope="module")
def truth() -> dict[str, float]:
    known = load_model(CONFIG / "paper_arm_model.yaml")
    names = [item.name for item in (*known.model.parameters, *known.model.constants)]
    return dict(zip(names, [*known.parameters, *known.constants]))


@pytest.fixture(scope="module")
def results() -> list[Identified]:
    limits = paper_limits()
    fourier = random_feasible(paper_arm().joints, limits, seed=2, fundamental_hz=0.1, harmonics=5, periods=2)
    motion = simulate_truth(paper_arm(), fourier.run(limits), drives=paper_drives())
    arm = load_arm(CONFIG / "paper_arm.yaml")
    return [identify([measure(motion, SensorNoise(), seed)], arm) for seed in SEEDS]


def scores(results: list[Identified], truth: dict[str, float]) -> np.ndarray:
    return np.array(
        [
            (estimate.value - truth.get(estimate.name, 0.0)) / estimate.standard_error
            for result in results
            for estimate in result.estimates
            if estimate.identifiable
        ]
    )


def test_what_is_determined_is_within_its_errors(results, truth):
    z = scores(results, truth)
    assert len(z) > 35 * len(SEEDS)
    assert np.mean(np.abs(z) <= 3.0) >= 0.99
    # Nor are the errors so long that nothing could ever be outside.
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.2
    assert np.mean(np.abs(z) <= 1.96) > 0.9


def test_base_parameters_are_within_their_errors(results, truth):
    for result in results:
        values = np.array([truth.get(parameter.name, 0.0) for parameter in result.model.model.parameters])
        known = result.base_errors > 0
        off = (result.base_values - result.base.regrouping @ values)[known] / result.base_errors[known]
        assert np.mean(np.abs(off) <= 3.0) >= 0.97


def test_what_full_speed_cannot_show_is_not_called_determined(results, truth):
    """v_b of 1e-3 rad/s: neither it nor the static friction is seen by a motion of radians a second."""
    for result in results:
        for estimate in result.estimates:
            if estimate.symbol in ("v_b", "f_b"):
                assert estimate.determination in (Determination.BOUND, Determination.PRIOR, Determination.FIXED)


def test_coulomb_and_viscous_friction_are_determined_at_every_joint(results, truth):
    for result in results:
        for estimate in result.estimates:
            if estimate.symbol in ("f_c", "k_v1"):
                assert estimate.identifiable
                assert estimate.value == pytest.approx(truth[estimate.name], rel=0.05)
