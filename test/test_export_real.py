"""Exports of identified arms on held-out motion: MuJoCo within the stated cost, C with the same residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported_code import Library
from mujoco_arm import inverse_in_mujoco

from spacearm_ident.cli.main import main
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.export.controller import control_law
from spacearm_ident.export.law import SLOW_SHARE
from spacearm_ident.export.motion import motions_of, sweep
from spacearm_ident.export.write import export_model, read_result

REAL = Path(__file__).parents[2] / "shared" / "recordings" / "real"
ARMS = {
    "ur10e": ("commissioning.mcap", "commissioning_validation.mcap"),
    "panda": ("run_1.mcap", "run_2.mcap"),
}
"""Folder -> the recording of the fit and the one held out."""
SLACK = 0.02
"""Share of the torque by which MuJoCo may be further from the measurement than model and stated cost together."""


@pytest.fixture(scope="module", params=list(ARMS))
def real(request, tmp_path_factory) -> Path:
    """A result folder of a real arm."""
    pytest.importorskip("clarabel", reason="needs clarabel")
    fitted, held_out = (REAL / request.param / name for name in ARMS[request.param])
    if not fitted.exists() or not held_out.exists():
        pytest.skip(f"no {request.param} in ../shared/recordings/real")
    folder = tmp_path_factory.mktemp(request.param)
    words = ["identify", str(fitted), "--validate", str(held_out), "--quiet", "--friction", "coulomb-viscous"]
    assert main([*words, "--out", str(folder / "result")]) in (0, 3)
    return folder / "result"


def shares(motions, predicted) -> np.ndarray:
    """(n,) residual RMS over torque RMS where each joint moves."""
    measured = np.concatenate([motion.torque for motion in motions])
    speed = np.abs(np.concatenate([motion.velocity for motion in motions]))
    moving = speed > SLOW_SHARE * speed.max(axis=0)
    left = np.concatenate(predicted) - measured
    return np.sqrt((left**2 * moving).sum(axis=0) / (measured**2 * moving).sum(axis=0))


def test_mujoco_predicts_the_held_out_torque_of_a_real_arm_within_the_stated_cost(real, tmp_path):
    model, validation = read_result(real)
    fit, _ = export_model(model, validation, "mjcf", tmp_path / "arm.xml", "a test")
    motions = motions_of(model, validation)
    own = shares(motions, [model.torque(motion) for motion in motions])
    theirs = shares(motions, [inverse_in_mujoco(tmp_path / "arm.xml", motion) for motion in motions])
    stated = np.array([fit.cost_Nm[joint] / fit.torque_Nm[joint] for joint in fit.cost_Nm])
    assert np.all(theirs <= own + stated + SLACK), (own, theirs, stated)


def test_mujoco_accelerates_a_real_arm_as_recorded_under_the_exported_law(real, tmp_path):
    """Forward dynamics on the held-out motion: torque by bodies, armature, damping and friction loss, written here."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco")
    model, validation = read_result(real)
    arm = model.model.arm
    fit, _ = export_model(model, validation, "mjcf", tmp_path / "arm.xml", "a test")
    simulated = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    simulated.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data, mass = mujoco.MjData(simulated), np.zeros(simulated.nv)
    armature, damping, friction = (
        np.array([fit.values[joint].get(key, 0.0) for joint in arm.joint_names])
        for key in ("armature", "damping", "friction")
    )
    bodies = TorqueModel(arm, {"rigid_body": {}})
    inertials = np.array([model.value(p.symbol, p.joint) for p in bodies.parameters])
    motion = motions_of(model, validation)[0]
    torque = bodies.torque(motion, inertials, np.zeros(0)) + armature * motion.acceleration
    torque += damping * motion.velocity + friction * np.sign(motion.velocity)
    off = np.empty_like(torque)
    for k in range(len(off)):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = motion.position[k], motion.velocity[k], torque[k]
        mujoco.mj_forward(simulated, data)
        mujoco.mj_mulM(simulated, data, mass, data.qacc - motion.acceleration[k])
        off[k] = mass  # N·m by which the acceleration found differs from the recorded one
    moving = (np.abs(motion.velocity) > SLOW_SHARE * np.abs(motion.velocity).max(axis=0)).all(axis=1)
    share = np.sqrt((off[moving] ** 2).sum(axis=0) / (torque[moving] ** 2).sum(axis=0))
    assert moving.sum() > 50 and np.all(share < 0.05), (moving.sum(), share)


def test_mujoco_predicts_the_paper_s_arm_on_another_motion_within_the_stated_cost(tmp_path):
    model = load_model(config_path("paper_arm_model.yaml"))
    fit, _ = export_model(model, None, "mjcf", tmp_path / "arm.xml", "a test")
    motion = sweep(model.model.arm)
    slower = 0.6
    other = replace(motion, velocity=slower * motion.velocity, acceleration=slower**2 * motion.acceleration)
    expected = model.torque(other)
    left = inverse_in_mujoco(tmp_path / "arm.xml", other) - expected
    for k, joint in enumerate(model.model.arm.joint_names):
        moving = np.abs(other.velocity[:, k]) > SLOW_SHARE * np.abs(other.velocity[:, k]).max()
        rms, size = (np.sqrt(np.mean(values[moving, k] ** 2)) for values in (left, expected))
        assert rms <= fit.cost_Nm[joint] + SLACK * size


def test_the_c_code_leaves_the_residuals_of_the_model_on_held_out_motion(real, tmp_path):
    model, validation = read_result(real)
    library, law = Library(model, validation, tmp_path), control_law(model)
    for motion in motions_of(model, validation):
        states = zip(motion.position, motion.velocity, motion.acceleration)
        out = np.array([library.call("torque", (motion.position.shape[1],), *state) for state in states])
        expected = law.model.torque(motion)
        assert np.abs(out - expected).max() < 1e-10 * np.abs(expected).max()
        residual, own = motion.torque - out, motion.torque - expected
        assert np.abs(residual - own).max() < 1e-9
