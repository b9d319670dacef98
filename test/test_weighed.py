"""Torque gains from a known mass: planted ones, what is refused, and the road of a user on a real arm."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_payload import ARM, MASS, run

from spacearm_ident.cli.main import main
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.estimate.identified import GAIN_DEVIATION
from spacearm_ident.identification.weighed import Weight, calibrate_gains, parse_weight
from spacearm_ident.recording import write_recording
from spacearm_ident.sessions.bags import Options

REAL = Path(__file__).resolve().parents[1] / "../shared/recordings/real/ur10e"


@pytest.mark.parametrize("planted", [[1.0, 0.56, 0.5, 1.0, 1.2, 0.9], [1.04, 1.08, 1.03, 0.87, 1.09, 1.05]])
def test_planted_gains_are_recovered_within_their_errors_though_friction_changed(planted):
    without = run(0.0, noise=0.3, seed=1, gain=np.array(planted))
    loaded = run(MASS, noise=0.3, seed=2, gain=np.array(planted), friction=0.3)
    gains = calibrate_gains([without], [loaded], ARM, Weight(MASS))
    assert gains.determined.all() and gains.error.max() < 0.04 and gains.error[1:3].max() < 0.01
    assert np.abs(gains.value - planted).max() < 0.1
    assert np.abs((gains.value - planted) / gains.error).max() < 4.0


def test_effort_of_the_corrected_arm_is_divided_by_the_gains():
    gains = calibrate_gains([run(0.0, seed=1, gain=1.1)], [run(MASS, seed=2, gain=1.1)], ARM, Weight(MASS))
    assert np.allclose(gains.corrected(ARM).effort_scale, ARM.effort_scale / gains.value)
    assert gains.value == pytest.approx(np.full(6, 1.1), abs=0.05)


def test_a_mass_stated_too_large_makes_every_gain_too_small():
    """Gains scale with the mass that they come from."""
    gains = calibrate_gains([run(0.0, seed=1)], [run(MASS, seed=2)], ARM, Weight(1.25 * MASS))
    assert gains.value[1:4] == pytest.approx(np.full(3, 0.8), abs=0.03)


def test_joints_that_did_not_move_with_the_mass_keep_their_gain():
    without, loaded = (run(mass, seed=3, gain=1.1, moving=4) for mass in (0.0, MASS))
    gains = calibrate_gains([without], [loaded], ARM, Weight(MASS))
    assert not gains.determined[4:].any() and gains.determined[1:3].all()
    assert gains.value[4:] == pytest.approx([1.0, 1.0])
    assert gains.error[4:] == pytest.approx([GAIN_DEVIATION] * 2)
    assert "not determined, and left as recorded: joint_5, joint_6" in gains.words


def test_recordings_without_motion_of_the_mass_are_refused():
    recording = run(MASS, seed=4)
    still = replace(recording, position=recording.position[:1].repeat(len(recording.time), 0), velocity=None)
    with pytest.raises(UnfitDataError):
        calibrate_gains([still], [still], ARM, Weight(MASS))


@pytest.mark.parametrize("text", ["", "0", "-2@tool0", "tool0", "nan@tool0"])
def test_what_is_no_mass_is_refused(text):
    with pytest.raises(UserError, match="MASS@LINK"):
        parse_weight(text)


def test_a_link_that_carries_nothing_is_refused():
    with pytest.raises(UserError, match="no link 'gripper'"):
        calibrate_gains([run(0.0)], [run(MASS)], ARM, Weight(MASS, "gripper"))


def test_mass_and_recordings_with_it_go_together():
    with pytest.raises(UserError, match="both --weighed"):
        Options(weighed="2.5").weight()
    with pytest.raises(UserError, match="both --weighed"):
        Options(loaded=(Path("a.mcap"),)).weight()
    with pytest.raises(UserError, match="--prior"):
        Options(weighed="2.5", loaded=(Path("a.mcap"),), prior=Path("b")).weight()


def test_options_with_a_mass_are_a_command_line_and_have_the_recordings_content_as_fingerprint(tmp_path):
    bag = tmp_path / "loaded.mcap"
    write_recording(bag, run(MASS))
    options = Options(weighed=f"{MASS}@link_6", loaded=(bag,))
    assert options.words() == ["--loaded", str(bag), "--weighed", f"{MASS}@link_6"]
    before = options.fingerprint()
    assert replace(options, loaded=(bag.rename(tmp_path / "moved.mcap"),)).fingerprint() == before
    write_recording(bag, run(MASS, seed=1))
    assert options.fingerprint() != before


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no recordings of real arms at {REAL}")
def test_a_body_is_weighed_right_on_another_run_of_a_real_arm_whose_gains_were_calibrated(tmp_path, capsys):
    """2.805 kg on a scale; without the calibration its currents say 3.0 to 3.1 kg."""
    words = ["--friction", "coulomb-viscous", "--validate", str(REAL / "commissioning_validation.mcap")]
    mass = ["--weighed", "2.805@tool0", "--loaded", str(REAL / "field.mcap")]
    assert main(["identify", str(REAL / "commissioning.mcap"), *words, *mass, "--out", str(tmp_path / "model")]) == 0
    assert "(recorded over true torque) from the known mass of 2.805 kg at tool0" in capsys.readouterr().out
    gains = json.loads((tmp_path / "model/validation.json").read_text())["torque_gains"]
    assert 1.03 < gains["shoulder_lift_joint"]["value"] < 1.15
    assert main(["payload", str(REAL / "field_validation.mcap"), "--model", str(tmp_path / "model"), "--json"]) == 0
    held = json.loads(capsys.readouterr().out)["mass"]
    assert held["value"] == pytest.approx(2.805, rel=0.03)
