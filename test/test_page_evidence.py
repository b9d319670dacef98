"""What the page of an identification shows as evidence: spectra, recordings and their defects, counts, torque."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm

from spacearm_ident.cli.main import main
from spacearm_ident.estimate.identified import Determination
from spacearm_ident.identification.residual_spectrum import residual_spectrum, share_above
from spacearm_ident.identification.validation import validate
from spacearm_ident.recording import write_recording
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.simulation.own_arm import default_model, torque_scale

SIGMA = 0.5


def prepared(noise: float = 0.0) -> Motion:
    motions, _ = prepare([small_arm.recording(duration_s=32.0, noise=noise)], small_arm.JOINTS, 5.0)
    return motions[0]


def test_spectrum_of_a_sine_peaks_at_its_frequency_and_holds_its_power():
    motion = prepared()
    time = np.arange(len(motion.torque)) / motion.rate_hz
    wave = np.stack([2.0 * np.sin(2 * np.pi * 7.0 * time), 0.5 * np.sin(2 * np.pi * 30.0 * time)], axis=1)
    found = residual_spectrum([motion], [motion.torque - wave])
    peaks = found.frequency[found.residual.argmax(axis=0)]
    np.testing.assert_allclose(peaks, [7.0, 30.0], rtol=0.06)
    np.testing.assert_array_equal(share_above(found, 15.0) > 0.9, [False, True])
    np.testing.assert_array_less(share_above(found, 15.0)[0], 0.02)


def test_spectrum_of_white_noise_is_flat_at_its_density():
    motion = prepared()
    noise = np.random.default_rng(0).normal(0.0, SIGMA, motion.torque.shape)
    found = residual_spectrum([motion], [motion.torque - noise])
    density = SIGMA**2 / (0.5 * motion.rate_hz)
    upper = found.frequency > 5.0
    np.testing.assert_allclose(found.residual[upper].mean(axis=0), density, rtol=0.1)


def test_spectrum_of_a_short_stretch_is_none():
    motion = prepared()[slice(0, 40)]
    assert residual_spectrum([motion], [motion.torque]) is None


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The result of the command on a run with invalid torque and a held-out run."""
    out = tmp_path_factory.mktemp("page")
    run = small_arm.recording(seed=0)
    effort = run.effort.copy()
    effort[100:105, 0] = np.nan
    write_recording(out / "run.mcap", replace(run, effort=effort))
    write_recording(out / "other.mcap", small_arm.recording(seed=1))
    words = ["identify", out / "run.mcap", "--validate", out / "other.mcap", "--out", out / "result", "--quiet"]
    assert main([str(word) for word in words]) == 0
    return out / "result"


def test_page_has_recordings_defects_spectrum_masses_and_correlations(folder: Path):
    page = (folder / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", " ", page)
    for heading in (
        "Residual over frequency",
        "Excitation and recordings",
        "Masses, identified and CAD",
        "Correlations",
    ):
        assert heading in text
    assert "Defects found in the recordings" in text and re.search(r"run\.mcap: [^.]*5", text)
    assert re.search(r"run\.mcap\s+fit\b", text) and re.search(r"other\.mcap\s+validation\b", text)


def test_number_of_parameters_is_the_same_on_page_in_json_and_in_the_table(folder: Path):
    counted = json.loads((folder / "validation.json").read_text())["parameters"]
    rows = list(csv.DictReader((folder / "parameters.csv").open()))
    kinds = {kind.value: counted.get(kind.value, 0) for kind in Determination}
    assert counted["total"] == sum(kinds.values())
    assert counted["total"] <= len(rows)
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", (folder / "report.html").read_text(encoding="utf-8")))
    assert f"{counted['total']} parameters" in text
    base = list(csv.DictReader((folder / "base_parameters.csv").open()))
    assert counted["base"] == len(base) >= counted["base_determined"] > 0


def test_torque_csv_has_the_residual_that_the_validation_states(folder: Path):
    rows = list(csv.DictReader((folder / "torque.csv").open()))
    stated = json.loads((folder / "validation.json").read_text())["joints"]
    for joint in small_arm.JOINTS:
        moving = [row for row in rows if row[f"{joint}_moving"] == "1"]
        left = [float(row[f"{joint}_measured_Nm"]) - float(row[f"{joint}_predicted_Nm"]) for row in moving]
        assert np.sqrt(np.mean(np.square(left))) == pytest.approx(stated[joint]["moving"]["rmse_Nm"], rel=0.05)


def test_validation_of_a_model_carries_a_spectrum_per_joint():
    model = small_arm.identified()
    found = validate(model, [small_arm.recording(seed=3)], "held out", held_out=True).spectrum
    assert found is not None and found.residual.shape == (len(found.frequency), 2)
    assert (found.residual.sum(axis=0) < found.torque.sum(axis=0)).all()


def test_torque_scale_ignores_a_placeholder_limit():
    """A limit far above what the links ask, as URDFs have where nobody knew it, changes neither friction nor noise."""
    arm = small_arm.identified().model.arm
    placeholder = replace(arm, joints=tuple(replace(joint, effort_limit=5000.0) for joint in arm.joints))
    open_ended = replace(arm, joints=tuple(replace(joint, effort_limit=np.inf) for joint in arm.joints))
    np.testing.assert_allclose(torque_scale(placeholder), torque_scale(open_ended))
    assert (torque_scale(placeholder) < 500.0).all()
    model = default_model(placeholder)
    assert model.value("J_m", "elbow") >= torque_scale(placeholder)[1] / 300.0
