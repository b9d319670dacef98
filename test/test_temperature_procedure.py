"""The calibration of alpha as a user does it: excite, simulate at three temperatures, calibrate-temperature."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from planted_arm import TWO_LINKS, urdf_of
from simulated_arm import paper_arm

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import save_model
from spacearm_ident.errors import UserError
from spacearm_ident.excitation import composite
from spacearm_ident.recording import read_recording
from spacearm_ident.simulation.arm_process import hidden_physics
from spacearm_ident.simulation.closed_loop import SensorNoise
from spacearm_ident.simulation.live_arm import LiveArm
from spacearm_ident.simulation.plant import Plant
from spacearm_ident.simulation.thermal import ThermalParameters

JOINTS = ("shoulder", "elbow")
LEVELS = {"f_c": (6.0, 3.0), "f_b": (6.0, 3.0), "k_v1": (4.0, 2.0), "J_m": (0.5, 0.2)}
SLOPES = (-0.01, -0.006)
ALPHA = dict(zip(JOINTS, (-0.06, -0.018)))
SWEEP = (-20, 20, 60)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory) -> Path:
    """A small, quick arm with its model, what is hidden in it, and its run for temperature."""
    folder = tmp_path_factory.mktemp("workshop")
    limit = 'lower="-0.34" upper="0.34" effort="80" velocity="0.55"'
    links = tuple(replace(link, limit=limit) for link in TWO_LINKS)
    (folder / "arm.urdf").write_text(urdf_of(links))
    arm = arm_from_urdf(urdf_of(links))
    drives = {"torque_limit_Nm": 80, "acceleration_limit_rad_s2": 20}
    description = {"schema": "spacearm_ident/arm/1", "urdf": "arm.urdf", "joints": dict.fromkeys(JOINTS, drives)}
    (folder / "arm.yaml").write_text(yaml.safe_dump(description))
    structure = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
    model = TorqueModel(arm, structure)
    values = [LEVELS[p.symbol][JOINTS.index(p.joint)] if p.symbol in LEVELS else p.prior for p in model.parameters]
    save_model(IdentifiedModel(model, np.array(values), np.zeros(len(model.constants)), 10.0), folder / "model.yaml")
    warmth = {"effect": "temperature_friction", "parameters": {"coulomb_slope": list(SLOPES), "viscous_slope": 0}}
    warmth["parameters"]["rise"] = 0
    hidden = {"schema": "spacearm_ident/conceal/1", "effects": [warmth]}
    (folder / "warmth.yaml").write_text(yaml.safe_dump(hidden))
    words = ["excite", "--arm", folder / "arm.yaml", "--model", folder / "model.yaml", "--for", "temperature"]
    with pytest.MonkeyPatch.context() as patch:
        # Two speeds, once: enough for three temperatures, and quick.
        patch.setattr(composite, "TEMPERATURE_REPEATS", 1)
        patch.setattr(composite, "TEMPERATURE_SHARES", (0.2, 0.6))
        assert main([*map(str, words), "--ground", "none", "--out", str(folder / "runs.yaml"), "--quiet"]) == 0
    return folder


def simulated(workshop: Path, celsius: float) -> str:
    bag = workshop / f"at_{celsius:g}.mcap"
    if not bag.exists():
        words = ["simulate", "--model", workshop / "model.yaml", "--trajectory", workshop / "runs.yaml"]
        words += ["--conceal", workshop / "warmth.yaml", "--temperature", celsius, "--out", bag]
        words += ["--seed", celsius + 100]
        assert main([*map(str, words), "--quiet"]) == 0
    return str(bag)


@pytest.mark.long
@pytest.mark.parametrize("given", [[], ["--model"]], ids=["bags alone", "with the model"])
def test_the_planted_alpha_comes_back_within_its_errors(workshop, tmp_path, capsys, given):
    bags = [simulated(workshop, celsius) for celsius in SWEEP]
    model = [*given, str(workshop / "model.yaml")] if given else []
    assert main(["calibrate-temperature", *bags, *model, "--out", str(tmp_path), "--quiet"]) == 0
    joints = json.loads((tmp_path / "temperature.json").read_text())["joints"]
    assert set(joints) == set(JOINTS)
    for joint, alpha in ALPHA.items():
        found = joints[joint]["alpha"]
        assert abs(found["value"] - alpha) < 4 * found["standard_error"] < 0.2 * abs(alpha)
        assert joints[joint]["f_c0_Nm"] == pytest.approx(LEVELS["f_c"][JOINTS.index(joint)], rel=0.05)


def test_one_temperature_is_no_sweep(workshop, tmp_path, capsys):
    bag, model = simulated(workshop, 20), str(workshop / "model.yaml")
    capsys.readouterr()
    assert main(["calibrate-temperature", bag, "--model", model, "--out", str(tmp_path / "out"), "--quiet"]) == 1
    assert "too few or too narrow: record at least" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_bag_says_how_warm_the_arm_was(workshop):
    recording = read_recording(simulated(workshop, 60))
    assert set(recording.temperatures) == set(JOINTS)
    for series in recording.temperatures.values():
        assert series.values == pytest.approx(60.0, abs=0.5)


def test_no_arm_works_at_a_thousand_degrees(workshop, tmp_path, capsys):
    words = ["simulate", "--model", workshop / "model.yaml", "--trajectory", workshop / "runs.yaml"]
    words += ["--temperature", 1000, "--out", tmp_path / "bag.mcap"]
    assert main([str(word) for word in words]) == 2
    assert "give one from" in capsys.readouterr().err


def breakaway(hidden: str, celsius: float) -> np.ndarray:
    """Dry friction of the paper's arm behind the live drives, N·m."""
    config = Path(__file__).parent.parent / "config"
    arm = load_arm(config / "paper_arm.yaml")
    live = LiveArm(
        paper_arm(),
        arm,
        noise=SensorNoise.none(),
        ambient=celsius,
        hidden=hidden_physics(config / hidden, arm.joint_names) if hidden else None,
    )
    on, off = np.ones(6, dtype=bool), np.zeros(6, dtype=bool)
    for _ in range(3):
        live.step(np.zeros(6), on, off, 1e-3)
    assert live.temperature == pytest.approx(np.full(6, celsius), abs=0.1)
    plant: Plant = live.plant
    return plant.law.dry_level(plant.position, np.full(6, 1.0), plant.housing_temperature)


def test_the_live_arm_feels_the_cold():
    warm, cold = (breakaway("paper_arm_warmth.yaml", celsius) for celsius in (20.0, -40.0))
    slopes = np.array([0.0045, 0.006, 0.004, 0.007, 0.006, 0.005])
    np.testing.assert_allclose(cold / warm, 1.0 + 60.0 * slopes, rtol=1e-3)
    np.testing.assert_allclose(breakaway("", -40.0), warm, rtol=1e-3)


def test_what_only_a_finished_recording_shows_is_refused_live(tmp_path):
    path = tmp_path / "delay.yaml"
    path.write_text("schema: spacearm_ident/conceal/1\neffects:\n- {effect: time_delay, parameters: {delay: 0.005}}\n")
    with pytest.raises(UserError, match="time_delay is done to a finished recording"):
        hidden_physics(path, JOINTS)


def test_explicit_start_wins_over_the_surroundings(workshop, tmp_path):
    document = yaml.safe_load((workshop / "warmth.yaml").read_text())
    document["effects"][0]["parameters"]["start"] = 5
    document["effects"][0]["parameters"]["coulomb_slope"] = -0.01
    (tmp_path / "hidden.yaml").write_text(yaml.safe_dump(document))
    hidden = hidden_physics(tmp_path / "hidden.yaml", paper_arm().joints)
    plant = hidden.plant(paper_arm(), np.zeros(6), ThermalParameters(ambient=40.0))
    assert np.array_equal(plant.housing_temperature, np.full(6, 5.0))
