"""Predicted torque is what predicts held-out data best of consistent, unbounded and plain; bodies are consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_torque import assert_same_torque
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model import IdentifiedModel, Plain, TorqueModel, Unbounded, structure_of
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.fit import fit_model
from spacearm_ident.identification.identify import PSO_LM, Settings, identify
from spacearm_ident.identification.plain import plain_fit, plain_structure
from spacearm_ident.identification.validation import validate
from spacearm_ident.layers.compare import compare
from spacearm_ident.recording import Recording
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.simulations import read_simulation
from spacearm_ident.solvers.solution_columns import residuals_of
from spacearm_ident.tracking.rows import TrackedModel
from spacearm_ident.tracking.tracker import Tracker

LAWS = (Friction(k_v2=0.0, k_v3=0.0, f_b=1.0, f_c=1.0), Friction(k_v2=0.0, k_v3=0.0, f_b=1.0, f_c=1.0))
IMPOSSIBLE = (LAWS[0], replace(LAWS[1], J_m=-0.4))
"""An elbow that seems to have less inertia than its link alone: what an unmodelled spring would do."""


def identified_run(laws: tuple[Friction, Friction], seed: int = 0, settings: Settings | None = None) -> Identified:
    planted = two_link_run(laws, seconds=30.0, seed=seed, speed=2.0)
    return identify([planted.recording(noise=0.2, seed=seed)], arm_from_urdf(planted.urdf), settings)


def held_out_recording(laws: tuple[Friction, Friction]) -> Recording:
    """A run that no fit has seen."""
    return two_link_run(laws, seconds=20.0, seed=7, speed=2.0).recording(noise=0.2, seed=7)


def beyond_bounds(model: IdentifiedModel) -> np.ndarray:
    """(2,) share of the prediction that physical bounds do not hold."""
    parts = [part.share for part in (model.unbounded, model.plain) if part is not None]
    return np.sum(parts, axis=0) if parts else np.zeros(2)


def residual_rms(model: IdentifiedModel, laws: tuple[Friction, Friction]) -> np.ndarray:
    """(2,) RMS residual on a run that no fit has seen."""
    joints = validate(model, [held_out_recording(laws)], "held out", held_out=True).joints.values()
    return np.array([joint.moving.rmse for joint in joints])


@pytest.fixture(scope="module")
def beyond() -> Identified:
    return identified_run(IMPOSSIBLE)


def test_impossible_inertia_is_blended_into_the_prediction_of_its_joint(beyond):
    model = beyond.model
    assert beyond_bounds(model)[1] > 0.9
    assert residual_rms(model, IMPOSSIBLE)[1] < 0.5 * residual_rms(model.possible, IMPOSSIBLE)[1]


def test_bodies_stay_possible_and_a_note_says_that_the_prediction_is_not_theirs(beyond):
    assert beyond.model.value("J_m", "elbow") >= 0.0
    assert any("elbow" in note and "predicted torque is weighted with" in note for note in beyond.notes)


@pytest.mark.parametrize("seed", range(3))
def test_possible_arm_is_predicted_as_well_with_bounds_as_without(seed):
    model = identified_run(LAWS, seed).model
    with_bounds = residual_rms(model.possible, LAWS)
    np.testing.assert_allclose(residual_rms(model, LAWS), with_bounds, rtol=0.01)


def test_published_solver_predicts_with_its_own_parameters_alone():
    model = identified_run(IMPOSSIBLE, settings=Settings(solver=PSO_LM)).model
    assert model.unbounded is None and model.plain is None


def both(model: IdentifiedModel) -> IdentifiedModel:
    """A model into whose torque both alternatives are blended, with shares of our own."""
    simple = TorqueModel(model.model.arm, plain_structure(model.model.arm))
    values = np.linspace(0.1, 1.0, len(simple.parameters))
    unbounded = Unbounded(model.parameters + 0.1, np.array([0.2, 0.5]))
    return replace(
        model, unbounded=unbounded, plain=Plain(simple, values, np.zeros(len(simple.constants)), np.array([0.3, 0.5]))
    )


def test_model_file_keeps_what_predicts(beyond, tmp_path):
    model = both(beyond.model)
    save_model(model, tmp_path / "model.yaml")
    loaded = load_model(tmp_path / "model.yaml")
    assert loaded.unbounded is not None and loaded.plain is not None
    np.testing.assert_array_equal(loaded.unbounded.share, model.unbounded.share)
    np.testing.assert_array_equal(loaded.unbounded.parameters, model.unbounded.parameters)
    np.testing.assert_array_equal(loaded.plain.share, model.plain.share)
    motion = prepare([held_out_recording(LAWS)], model.model.arm.joint_names, model.cutoff_hz)[0][0]
    assert_same_torque(loaded.torque(motion), model.torque(motion))


def test_model_file_with_a_share_above_one_is_refused(beyond, tmp_path):
    model = both(beyond.model)
    save_model(replace(model, plain=replace(model.plain, share=np.array([0.3, 1.5]))), tmp_path / "model.yaml")
    with pytest.raises(UserError, match="between 0 and 1"):
        load_model(tmp_path / "model.yaml")


def test_prediction_is_the_convex_combination_of_the_three(beyond):
    model = both(beyond.model)
    motion = prepare([held_out_recording(LAWS)], model.model.arm.joint_names, model.cutoff_hz)[0][0]
    consistent = model.possible.torque(motion)
    free = replace(model.possible, parameters=model.unbounded.parameters).torque(motion)
    simple = IdentifiedModel(model.plain.model, model.plain.parameters, model.plain.constants)
    expected = [0.5, 0.0] * consistent + [0.2, 0.5] * free + [0.3, 0.5] * simple.torque(motion)
    np.testing.assert_allclose(model.torque(motion), expected, atol=1e-9)


def test_prediction_stays_when_terms_are_added_at_zero(beyond):
    """A payload at zero comes to the unbounded parameters as well, in its place among them."""
    model = both(beyond.model)
    motion = prepare([held_out_recording(LAWS)], model.model.arm.joint_names, model.cutoff_hz)[0][0]
    wider = TrackedModel(model, payload=True).model
    assert len(wider.unbounded.parameters) == len(wider.parameters) > len(model.parameters)
    assert_same_torque(wider.torque(motion), model.torque(motion))


def test_tracked_model_takes_a_friction_level_to_all_that_predicts(beyond):
    model = both(beyond.model)
    motion = prepare([held_out_recording(LAWS)], model.model.arm.joint_names, model.cutoff_hz)[0][0]
    tracked = TrackedModel(model)
    tracker = Tracker(tracked)
    number = tracked.symbols.index("k_v1")
    tracker.filters.side[1] = tracker.filters.root[1] @ np.eye(len(tracked.symbols))[number]  # k_v1 of the elbow + 1
    moved = tracker.model().torque(motion) - tracked.model.torque(motion)
    np.testing.assert_allclose(moved[:, 1], motion.velocity[:, 1], atol=1e-9)


def test_model_file_of_identify_is_compared_with_an_arm_as_a_simulation(beyond, tmp_path):
    """Its bodies are one arm's, which what is blended into the prediction is not."""
    assert beyond.model.unbounded is not None
    save_model(beyond.model, tmp_path / "model.yaml")
    simulation = read_simulation(tmp_path / "model.yaml")
    own, other = two_link_run(IMPOSSIBLE, seconds=20.0, seed=3, speed=2.0), held_out_recording(IMPOSSIBLE)
    comparison = compare(simulation, [own.recording(noise=0.2, seed=3)], [other], excluded=tuple(EFFECTS))
    np.testing.assert_allclose(comparison.before_Nm, residual_rms(beyond.model.possible, IMPOSSIBLE), rtol=0.1)
    assert comparison.after_Nm[1] < comparison.before_Nm[1]


def test_plain_fit_recovers_the_parameters_of_a_plain_arm():
    planted = two_link_run(LAWS, seconds=20.0, seed=2, speed=2.0)
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([planted.recording(noise=0.0, seed=2)], arm.joint_names)
    fit = fit_model(TorqueModel(arm, structure_of(arm)), motions)
    regression, _, solution = plain_fit(fit)
    values = {p.name: value for p, value in zip(regression.model.parameters, solution.parameters)}
    for joint, law in zip(arm.joint_names, LAWS):
        assert values[f"f_c[{joint}]"] == pytest.approx(law.f_c, rel=0.02)
        assert values[f"k_v1[{joint}]"] == pytest.approx(law.k_v1, rel=0.02)
    residual = np.concatenate(residuals_of(regression, solution))
    torque = np.concatenate([rows.torque for rows in regression.rows])
    assert np.linalg.norm(residual) < 0.01 * np.linalg.norm(torque)


def test_plain_model_has_no_part_where_the_friction_law_is_curved_beyond_chance():
    curved = tuple(replace(law, f_b=6.0, v_b=0.3) for law in LAWS)
    model = identified_run((curved[0], replace(curved[1], J_m=-0.4))).model
    shares = np.zeros(2) if model.plain is None else model.plain.share
    np.testing.assert_array_equal(shares, 0.0)
