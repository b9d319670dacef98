"""What an arm holds, found again within its errors, and told as each controller wants it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spacearm_ident.cli.main import main
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.dynamics.regressor import rigid_body_blocks
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.export.frames import principal
from spacearm_ident.export.motion import sweep
from spacearm_ident.export.payload import Held, find_payload, tool_frame
from spacearm_ident.export.payload_calls import franka, kuka, urscript
from spacearm_ident.recording import Recording, write_recording

MODEL = replace(load_model(config_path("paper_arm_model.yaml")), cutoff_hz=10.0)
ARM = MODEL.model.arm
MASS, CENTRE = 3.2, np.array([0.03, -0.05, 0.12])
INERTIA = Rotation.from_euler("xyz", [0.3, 0.2, 0.5]).as_matrix() @ np.diag([0.03, 0.04, 0.02])
INERTIA = INERTIA @ Rotation.from_euler("xyz", [0.3, 0.2, 0.5]).as_matrix().T


def run(
    mass: float,
    noise: float = 0.05,
    friction: float = 0.0,
    seed: int = 0,
    gain: float | np.ndarray = 1.0,
    moving: int = 6,
    centre: np.ndarray = CENTRE,
    size: float = 1.0,
    model: IdentifiedModel = MODEL,
) -> Recording:
    """Twelve seconds of the paper's arm with a body on its last link; joints after the first `moving` stand still.

    The body's inertia about its centre is `size` times that of INERTIA: none at 0, a point mass. `model` is the arm.
    """
    arm = model.model.arm
    motion = sweep(ARM)
    motion = motion[0:1200]
    turns = np.arange(6) < moving
    motion = replace(
        motion,
        position=np.where(turns, motion.position, motion.position[0]),
        velocity=motion.velocity * turns,
        acceleration=motion.acceleration * turns,
    )
    about = size * INERTIA * mass / MASS + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    phi = np.array([mass, *(mass * centre), *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    blocks = rigid_body_blocks(arm, motion.position, motion.velocity, motion.acceleration)
    extra = np.stack([phi @ blocks[row, len(ARM.joints) - 1] for row in range(len(ARM.joints))], axis=1)
    torque = model.torque(motion) + extra + friction * np.sign(motion.velocity)
    torque = gain * torque + noise * np.random.default_rng(seed).standard_normal(torque.shape)
    time = np.arange(len(torque)) / motion.rate_hz
    return Recording(
        ARM.joint_names, time, motion.position, motion.velocity, torque, (slice(0, len(time)),), 10**18, urdf=ARM.urdf
    )


def near(value: np.ndarray, truth: np.ndarray, error: np.ndarray) -> None:
    """Within four standard errors, and those are not so large that anything would be."""
    assert np.all(np.abs(value - truth) < 4.0 * error + 1e-4)


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_body_is_found_within_its_errors_though_friction_changed(friction):
    held = find_payload(MODEL, [run(MASS, friction=friction)])
    assert held.mass == pytest.approx(MASS, abs=max(4 * held.mass_error, 0.01)) and held.mass_error < 0.05
    _, rotation, origin = tool_frame(ARM, None)
    near(held.centre, rotation.T @ (CENTRE - origin), held.centre_error)
    assert held.centre_error.max() < 0.01
    assert held.inertia is not None
    near(held.inertia, rotation.T @ INERTIA @ rotation, held.inertia_error)
    assert np.all(held.after_Nm <= held.before_Nm + 1e-9)


@pytest.mark.parametrize("size", [0.0, 0.3])
@pytest.mark.parametrize("noise, within_kg, within_m", [(0.05, 0.003, 0.0004), (1.0, 0.03, 0.01)])
@pytest.mark.parametrize("distance_m", [0.0, 0.12, 0.3])
def test_centre_is_right_where_the_inertia_is_not_determined(distance_m, noise, within_kg, within_m, size):
    """A point mass in particular: about the joint its inertia is m d^2; left out, mass and centre made up for it."""
    centre = distance_m * np.array([0.3, -0.4, 0.866])
    held = find_payload(MODEL, [run(MASS, noise=noise, centre=centre, size=size, seed=3)])
    assert abs(held.mass - MASS) < min(4.0 * held.mass_error, within_kg)
    _, rotation, origin = tool_frame(ARM, None)
    truth = rotation.T @ (centre - origin)
    near(held.centre, truth, held.centre_error)
    assert np.abs(held.centre - truth).max() < within_m and held.centre_error.max() < within_m


def test_an_inertia_that_the_motion_does_not_determine_is_not_reported_and_widens_the_centre():
    """The wrist still, the body's own inertia is hardly turned: the errors allow for any that a compact body has."""
    held = find_payload(MODEL, [run(MASS, noise=0.5, moving=3)])
    assert held.inertia is None and held.inertia_error is None
    _, rotation, origin = tool_frame(ARM, None)
    near(held.centre, rotation.T @ (CENTRE - origin), held.centre_error)


def test_nothing_held_is_said_to_be_nothing():
    with pytest.raises(UnfitDataError, match="no payload detected"):
        find_payload(MODEL, [run(0.0, noise=0.3, seed=2)])


def test_errors_are_as_large_as_the_scatter():
    """Of five runs with other noise."""
    found = [find_payload(MODEL, [run(MASS, noise=0.5, seed=seed)]) for seed in range(5)]
    scatter = np.std([held.mass for held in found], ddof=1)
    claimed = np.mean([held.mass_error for held in found])
    assert 0.3 < claimed / scatter < 4.0
    assert max(abs(held.mass - MASS) for held in found) < 5 * claimed


def test_a_wrong_gain_scales_the_mass_and_not_the_centre():
    """As the caveat says, of model and recording alike."""
    scaled = replace(MODEL, parameters=1.1 * MODEL.parameters)
    held = find_payload(scaled, [run(MASS, noise=0.01, gain=1.1)])
    assert held.mass == pytest.approx(1.1 * MASS, rel=0.01)
    _, rotation, origin = tool_frame(ARM, None)
    assert np.abs(held.centre - rotation.T @ (CENTRE - origin)).max() < 0.003


def example(inertia: np.ndarray | None) -> Held:
    zero = np.zeros(6)
    errors = None if inertia is None else np.zeros((3, 3))
    return Held("tool0", 2.5, np.array([0.01, -0.02, 0.1]), inertia, 0.1, np.zeros(3), errors, zero, zero)


def test_the_calls_hold_what_was_found():
    inertia = np.array([[0.03, 0.001, 0.002], [0.001, 0.04, -0.003], [0.002, -0.003, 0.02]])
    held = example(inertia)
    assert urscript(held) == (
        "set_target_payload(2.500, [0.0100, -0.0200, 0.1000], "
        "[0.030000, 0.040000, 0.020000, 0.001000, 0.002000, -0.003000])"
    )
    assert urscript(example(None)) == "set_target_payload(2.500, [0.0100, -0.0200, 0.1000])"
    assert "{{0.0100, -0.0200, 0.1000}}" in franka(held) and franka(held).count("-0.003000") == 2
    numbers = [float(number) for number in re.findall(r"-?\d+\.\d+", kuka(held))]
    mass, x, y, z, *angles_and_moments = numbers
    assert (mass, x, y, z) == (2.5, 10.0, -20.0, 100.0)
    a, b, c, *moments = angles_and_moments
    axes = Rotation.from_euler("ZYX", [a, b, c], degrees=True).as_matrix()
    assert np.abs(axes @ np.diag(moments) @ axes.T - inertia).max() < 1e-5
    assert np.allclose(sorted(principal(inertia)[0]), np.linalg.eigvalsh(inertia))


def test_the_command_tells_it_and_refuses_a_frame_that_is_not_there(tmp_path, capsys):
    write_recording(tmp_path / "held.mcap", run(MASS))
    model = str(config_path("paper_arm_model.yaml"))
    assert main(["payload", str(tmp_path / "held.mcap"), "--model", model, "--json", "--quiet"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["mass"]["value"] == pytest.approx(MASS, rel=0.05)
    assert set(said["calls"]) == {"URScript", "KUKA", "Franka"} and "gain" in said["caveat"]
    assert main(["payload", str(tmp_path / "held.mcap"), "--model", model, "--quiet"]) == 0
    assert "set_target_payload(" in capsys.readouterr().out
    with pytest.raises(UserError, match="no link 'nowhere'"):
        tool_frame(ARM, "nowhere")
