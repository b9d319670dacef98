"""Validation figures on closed forms, rows at rest apart, and a lack-of-fit test that keeps its level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_arm
import pytest
from planted_arm import Friction, two_link_run
from scipy.stats import kstest

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.estimate.identified import Validation
from spacearm_ident.identification.validation import fit_figures, split, validate
from spacearm_ident.signals.prepare import prepare

LAWS = (Friction(k_v2=0.0, k_v3=0.0), Friction(f_c=3.0, k_v2=0.0, k_v3=0.0, J_m=0.2))


def truth(planted: planted_arm.Planted) -> IdentifiedModel:
    structure = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
    model = TorqueModel(arm_from_urdf(planted.urdf), structure)
    values = np.array([planted.values[parameter.name] for parameter in model.parameters])
    return IdentifiedModel(model, values, np.zeros(len(model.constants)), None)


def test_the_figures_of_a_known_residual():
    measured = np.array([1.0, -2.0, 3.0, -4.0])
    figures = fit_figures(measured, measured - np.array([0.5, 0.5, -0.5, 1.5]))
    assert figures.rows == 4
    assert figures.rmse == pytest.approx(np.sqrt(3.0 / 4))
    assert figures.mae == pytest.approx(0.75)
    assert figures.largest == pytest.approx(1.5)
    assert figures.relative_rms == pytest.approx(np.sqrt(3.0 / 30.0))


def test_the_correlation_knows_neither_scale_nor_offset_but_the_other_figures_do():
    measured = np.sin(np.linspace(0, 20, 500))
    scaled = fit_figures(measured, 0.5 * measured + 2.0)
    assert scaled.correlation == pytest.approx(1.0)
    assert scaled.rmse > 1.0
    assert fit_figures(measured, -measured).correlation == pytest.approx(-1.0)
    assert fit_figures(measured, measured).rmse == 0.0


def test_where_nothing_varies_there_is_no_correlation():
    assert np.isnan(fit_figures(np.ones(5), np.arange(5.0)).correlation)
    assert np.isnan(fit_figures(np.zeros(5), np.ones(5)).relative_rms)
    assert fit_figures(np.empty(0), np.empty(0)).rows == 0


def test_standstill_is_in_the_outer_figures_only():
    """A joint that rests half the time, held by a torque the model does not know."""
    rate = 200.0
    time = np.arange(0.0, 16.0, 1.0 / rate)
    moves = np.minimum(time, 8.0)
    omega = 2 * np.pi * 0.5
    q = np.column_stack([0.5 * (1 - np.cos(omega * moves)), 0.3 * np.sin(omega * time)])
    qd = np.column_stack([0.5 * omega * np.sin(omega * moves) * (time < 8.0), 0.3 * omega * np.cos(omega * time)])
    qdd = np.gradient(qd, 1 / rate, axis=0)
    planted = planted_arm.plant(planted_arm.TWO_LINKS, LAWS, (q, qd, qdd), rate)
    recording = planted.recording()
    effort = recording.effort.copy()
    effort[time >= 8.0, 0] += 4.0
    result = validate(truth(planted), [replace(recording, effort=effort)], "", True).joints["shoulder"]
    assert result.everything.rows > 1.5 * result.moving.rows
    assert result.everything.rmse > 2.0
    assert result.moving.rmse < 0.3


def lack_of_fit(seed: int, more: float = 0.0) -> Validation:
    planted = two_link_run(LAWS, seconds=25.0, rate_hz=200.0, seed=3, periodic=True, speed=1.2)
    model = truth(planted)
    recording = planted.recording(noise=(0.5, 0.3), seed=seed)
    ripple = more * np.sin(7 * planted.q[:, 0])
    effort = recording.effort + np.column_stack([ripple, np.zeros_like(ripple)])
    return validate(model, [replace(recording, effort=effort)], "", True)


def test_under_a_right_model_the_p_value_is_uniform():
    tests = [joint.lack_of_fit for seed in range(25) for joint in lack_of_fit(seed).joints.values()]
    p = np.array([test.p_value for test in tests])
    assert kstest(p, "uniform").pvalue > 1e-3
    assert np.mean(p < 0.01) <= 0.06
    assert 0.9 < np.mean([test.f for test in tests]) < 1.1


def test_what_repeats_and_is_not_in_the_model_is_detected_at_its_joint():
    joints = lack_of_fit(0, more=0.4).joints
    assert joints["shoulder"].lack_of_fit.p_value < 1e-6
    assert joints["elbow"].lack_of_fit.p_value > 1e-3


def test_the_noise_of_the_mean_period_is_the_noise_put_in():
    """White noise of 0.5 N·m, mean of 5 periods, reduced by the low-pass's known gain; one draw tells it to 5 %."""
    found = np.mean([lack_of_fit(seed).joints["shoulder"].lack_of_fit.noise_Nm for seed in range(10)])
    planted = two_link_run(LAWS, seconds=25.0, rate_hz=200.0, seed=3, periodic=True, speed=1.2)
    (motion,) = (m for m in prepare([planted.recording()], planted.joints)[0] if m.cyclic)
    white = np.random.default_rng(0).standard_normal((len(motion.position), 400))
    gain = motion.reduce(white).std()
    assert found == pytest.approx(0.5 / np.sqrt(5) * gain, rel=0.06)


def test_the_last_third_is_held_out():
    recording = two_link_run(LAWS, seconds=12.0, rate_hz=100.0).recording()
    first, last = split(recording)
    assert len(first.time) + len(last.time) == pytest.approx(len(recording.time), abs=1)
    assert last.time[-1] - last.time[0] == pytest.approx(4.0, abs=0.1)
    with pytest.raises(UnfitDataError, match="--validate"):
        split(recording.between(0.0, 5.0))
