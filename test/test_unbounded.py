"""Prediction goes beyond what an arm could be only where held-out data say so, and bodies never do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.identification.identified import Identified
from spacearm_ident.identification.identify import PSO_LM, Settings, identify
from spacearm_ident.identification.validation import validate
from spacearm_ident.recording.signals import prepare

LAWS = (Friction(k_v2=0.0, k_v3=0.0, f_b=1.0, f_c=1.0), Friction(k_v2=0.0, k_v3=0.0, f_b=1.0, f_c=1.0))
IMPOSSIBLE = (LAWS[0], replace(LAWS[1], J_m=-0.4))
"""An elbow that seems to have less inertia than its link alone: what an unmodelled spring would do."""


def identified_run(laws: tuple[Friction, Friction], seed: int = 0, settings: Settings | None = None) -> Identified:
    planted = two_link_run(laws, seconds=30.0, seed=seed, speed=2.0)
    return identify([planted.recording(noise=0.2, seed=seed)], arm_from_urdf(planted.urdf), settings)


def residual_rms(model: IdentifiedModel, laws: tuple[Friction, Friction]) -> np.ndarray:
    """(2,) RMS residual on a run that no fit has seen."""
    planted = two_link_run(laws, seconds=20.0, seed=7, speed=2.0)
    unseen = planted.recording(noise=0.2, seed=7)
    joints = validate(model, [unseen], "unseen", held_out=True).joints.values()
    return np.array([joint.moving.rmse for joint in joints])


@pytest.fixture(scope="module")
def beyond() -> Identified:
    return identified_run(IMPOSSIBLE)


def test_impossible_inertia_is_blended_into_the_prediction_of_its_joint(beyond):
    model = beyond.model
    assert model.unbounded is not None
    assert model.unbounded.share[1] > 0.9
    possible = replace(model, unbounded=None)
    assert residual_rms(model, IMPOSSIBLE)[1] < 0.5 * residual_rms(possible, IMPOSSIBLE)[1]


def test_bodies_stay_possible_and_the_user_is_told(beyond):
    assert beyond.model.value("J_m", "elbow") >= 0.0
    assert any("elbow" in note and "without physical bounds" in note for note in beyond.notes)


@pytest.mark.parametrize("seed", range(3))
def test_possible_arm_is_predicted_as_well_with_bounds_as_without(seed):
    model = identified_run(LAWS, seed).model
    with_bounds = residual_rms(replace(model, unbounded=None), LAWS)
    np.testing.assert_allclose(residual_rms(model, LAWS), with_bounds, rtol=0.01)


def test_published_solver_predicts_with_its_own_parameters_alone():
    assert identified_run(IMPOSSIBLE, settings=Settings(solver=PSO_LM)).model.unbounded is None


def test_model_file_keeps_what_predicts(beyond, tmp_path):
    save_model(beyond.model, tmp_path / "model.yaml")
    loaded = load_model(tmp_path / "model.yaml")
    assert loaded.unbounded is not None
    np.testing.assert_array_equal(loaded.unbounded.share, beyond.model.unbounded.share)
    np.testing.assert_array_equal(loaded.unbounded.parameters, beyond.model.unbounded.parameters)


def test_prediction_lies_between_the_possible_and_the_unbounded(beyond):
    model, arm = beyond.model, beyond.model.model.arm
    planted = two_link_run(IMPOSSIBLE, seconds=3.0, seed=3, speed=2.0)
    motion = prepare([planted.recording(noise=0.0, seed=3)], arm.joint_names, model.cutoff_hz)[0][0]
    possible = replace(model, unbounded=None).torque(motion)
    free = replace(model, parameters=model.unbounded.parameters, unbounded=None).torque(motion)
    np.testing.assert_allclose(model.torque(motion), possible + model.unbounded.share * (free - possible), atol=1e-9)
