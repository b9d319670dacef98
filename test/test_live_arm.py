"""The physics behind the live drives: what is reported is what happens."""

import numpy as np
import pytest
import yaml

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.simulation.closed_loop import SensorNoise
from spacearm_ident.simulation.live_arm import LOOP_HZ, LiveArm
from spacearm_ident.simulation.parameters import PlantParameters

DT = 1e-3
PARTS = round(DT * LOOP_HZ)
HALF = max(1, PARTS // 2)


@pytest.fixture
def arm():
    description = load_arm(config_path("paper_arm.yaml"))
    document = yaml.safe_load(config_path("paper_arm_model.yaml").read_text())
    return LiveArm(PlantParameters.from_model(document, description.urdf), description, noise=SensorNoise.none())


def test_the_torque_reported_is_the_mean_around_its_moment(arm):
    """Anything else is a bias of the inertia: torque samples must not depend on the phase of the servo cycles."""
    applied, reported, acceleration = [], [], []
    step = arm.plant.step

    def watched(torque, dt):
        applied.append(torque)
        step(torque, dt)

    arm.plant.step = watched
    yes, no = np.ones(6, dtype=bool), np.zeros(6, dtype=bool)
    for k in range(800):
        t = DT * (k + 1)
        arm.step(np.full(6, 0.05 * (1 - np.cos(2 * np.pi * t / 0.8))), yes, no, DT)
        reported.append(arm.torque)
        acceleration.append(0.05 * (2 * np.pi / 0.8) ** 2 * np.cos(2 * np.pi * t / 0.8))
    applied = np.array(applied).reshape(-1, PARTS, 6)
    mean = 0.5 * (applied[:-1, -HALF:].mean(axis=1) + applied[1:, :HALF].mean(axis=1))
    moving = slice(100, 700)
    error = (np.array(reported)[:-1] - mean)[moving]
    a = np.array(acceleration)[:-1][moving]
    missing_inertia = -(a @ error) / (a @ a)
    assert np.all(np.abs(missing_inertia) < 0.003 * np.diag(arm.plant.inertia()))
