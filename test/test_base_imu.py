"""The simulated arm's IMU: what the base of a floating arm does, and rest on the ground."""

from __future__ import annotations

import json

import floating_arm
import numpy as np
import pytest
from planted_arm import THREE_LINKS, urdf_of
from scipy.ndimage import uniform_filter1d

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import save_model
from spacearm_ident.dynamics.regressor import BASE_LINK, rigid_body_blocks
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import FourierTrajectory, Trajectory
from spacearm_ident.excitation.trajectory_file import save_trajectory
from spacearm_ident.recording import read_recording
from spacearm_ident.signals.base_motion import BaseMotion
from spacearm_ident.simulation.closed_loop import SensorNoise, measure, simulate_truth
from spacearm_ident.simulation.concealed import Concealment
from spacearm_ident.simulation.concealed.file import make_effect
from spacearm_ident.simulation.concealed.from_model import simulated_arm

URDF = urdf_of(THREE_LINKS)
ARM = arm_from_urdf(URDF)
RATIO, RADIUS, BELOW = 3.0, 0.3, 0.5


@pytest.fixture(scope="module")
def model():
    torque = TorqueModel(ARM, structure_of(ARM, "coulomb-viscous"))
    known = floating_arm.truth()
    values = np.array([known.get(parameter.name, 0.0) for parameter in torque.parameters])
    return IdentifiedModel(torque, values, np.zeros(len(torque.constants)))


@pytest.fixture(scope="module")
def trajectory():
    a = np.array([[0.6, -0.3], [-0.5, 0.4], [0.7, 0.5]])
    series = FourierTrajectory(ARM.joint_names, np.zeros(3), a, np.zeros_like(a), 0.5, 1)
    return Trajectory(ARM.joint_names, (series,))


def truth_of(model, trajectory, *effects):
    parameters, _ = simulated_arm(model, URDF)
    hidden = [make_effect(parameters.joints, name, parameters=values) for name, values in effects]
    return simulate_truth(parameters, trajectory, hidden=Concealment(hidden) if hidden else None)


@pytest.fixture(scope="module")
def floating(model, trajectory):
    """Under gravity, which an IMU in free fall must not feel."""
    values = {"base_ratio": RATIO, "gyration": RADIUS, "below": BELOW}
    return truth_of(model, trajectory, ("floating_base", values))


def test_what_the_imu_feels_keeps_the_momentum_of_arm_and_base(floating):
    rate_dot = np.gradient(floating.base_rate, 1e-3, axis=0)
    base = BaseMotion(floating.base_rate, rate_dot, floating.base_force)
    blocks = rigid_body_blocks(ARM, floating.q, floating.qd, floating.qdd, base, base_rows=True)
    mass = RATIO * sum(joint.inertial[0] for joint in ARM.joints)
    z = -RADIUS * BELOW
    turn = mass * RADIUS**2
    body = np.array([mass, 0, 0, mass * z, turn + mass * z**2, 0, turn + mass * z**2, 0, 0, turn])
    own = np.stack([body @ blocks[row, BASE_LINK] for row in range(-6, 0)])
    of_arm = np.stack([sum(ARM.joints[k].inertial @ blocks[row, k] for k in range(3)) for row in range(-6, 0)])
    # At a reversal velocities jump within a sample: means over a few hold what a central difference smears.
    own, of_arm = (uniform_filter1d(signal, 25, axis=1) for signal in (own, of_arm))
    inner = slice(30, -30)
    for rows in (slice(0, 3), slice(3, 6)):
        left, size = (own + of_arm)[rows, inner], of_arm[rows, inner]
        assert np.sqrt(np.mean(size**2)) > 0.3
        assert np.sqrt(np.mean(left**2)) < 0.01 * np.sqrt(np.mean(size**2))


def test_on_a_fixed_base_it_feels_that_the_ground_holds_it(model, trajectory):
    recording = measure(truth_of(model, trajectory), SensorNoise(imu_rate_hz=100.0))
    assert recording.base.rate_hz == pytest.approx(100.0) and recording.base.frame == "base"
    np.testing.assert_allclose(recording.base.force.mean(axis=0), [0.0, 0.0, 9.81], atol=2e-3)
    assert recording.base.rate.std() == pytest.approx(SensorNoise().gyro_noise, rel=0.15)


def test_no_imu_unless_asked_for_and_none_faster_than_the_recording(floating):
    assert measure(floating, SensorNoise()).base is None
    with pytest.raises(UserError, match="up to the recording's 1000 Hz"):
        measure(floating, SensorNoise(imu_rate_hz=2000.0))


def test_the_command_records_the_imu_of_a_floating_arm(model, trajectory, tmp_path, capsys):
    save_model(model, tmp_path / "model.yaml")
    save_trajectory(trajectory, tmp_path / "traj.yaml")
    effect = {"effect": "floating_base", "parameters": {"base_ratio": RATIO}}
    conceal = {"schema": "spacearm_ident/conceal/1", "effects": [effect]}
    (tmp_path / "conceal.yaml").write_text(json.dumps(conceal))
    words = ["simulate", "--model", tmp_path / "model.yaml", "--trajectory", tmp_path / "traj.yaml"]
    words = [str(word) for word in (*words, "--conceal", tmp_path / "conceal.yaml", "--out", tmp_path / "run.mcap")]
    assert main([*words, "--base-imu"]) == 0
    base = read_recording(tmp_path / "run.mcap").base
    assert base.topic == "/base_imu" and base.rate_hz == pytest.approx(200.0) and np.abs(base.rate).max() > 0.05
    assert main([*words, "--base-imu", "-1"]) == 2
    assert "--base-imu" in capsys.readouterr().err
