"""Contact thresholds: the rate they are set for is met on further motion, and what is counted is held out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml
from exported_code import Library, module_of
from scipy.signal import lfilter

from spacearm_ident.cli.main import main
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.export.controller import control_law
from spacearm_ident.export.motion import sweep
from spacearm_ident.export.thresholds import Rate, _excursions, contact_thresholds
from spacearm_ident.export.write import export_model, read_result
from spacearm_ident.recording import write_recording
from spacearm_ident.signals.motion import Motion

MODEL = small_arm.identified()
LAW = control_law(MODEL)
NOISE_NM = np.array([0.5, 0.2])
BANDWIDTH_HZ = 5.0


def moved(seed: int, repeats: int) -> Motion:
    """The sweep again and again, torque with noise that is correlated over some 0.1 s."""
    once = sweep(MODEL.model.arm)
    q, qd, qdd = (np.tile(values, (repeats, 1)) for values in (once.position, once.velocity, once.acceleration))
    motion = replace(once, position=q, velocity=qd, acceleration=qdd, torque=np.zeros_like(q))
    noise = lfilter([1.0], [1.0, -0.9], np.random.default_rng(seed).standard_normal(q.shape), axis=0)
    return replace(motion, torque=LAW.model.torque(motion) + NOISE_NM * noise * np.sqrt(1.0 - 0.81))


def test_further_motion_exceeds_thresholds_as_often_as_they_were_set_for():
    found = contact_thresholds(LAW, [moved(0, 60)], BANDWIDTH_HZ, 60.0)
    other = moved(1, 60)
    residual = np.abs(other.torque - LAW.model.torque(other))
    bounds, levels = found.tables()
    for k in range(2):
        part = (np.abs(other.velocity[:, k, None]) > bounds[k]).sum(axis=1)
        hours = len(part) / other.rate_hz / 3600.0
        begins = len(_excursions(residual[:, k] > levels[k][part], 1.0 / other.rate_hz, found.merge_s))
        assert 60.0 / 3.0 < begins / hours < 3.0 * 60.0
        assert np.all(levels[k] > 2.0 * NOISE_NM[k]) and np.all(levels[k] < 6.0 * NOISE_NM[k])


def test_a_rarer_false_alarm_asks_for_a_higher_threshold_at_every_joint():
    often, seldom = (contact_thresholds(LAW, [moved(0, 4)], BANDWIDTH_HZ, rate).tables()[1] for rate in (600.0, 1.0))
    assert np.all(seldom[:, 1:] > often[:, 1:])


def test_a_disturbance_of_the_held_out_part_is_counted_once_and_against_thresholds_set_without_it():
    motion = moved(2, 2)
    push = slice(300, 350)
    torque = motion.torque.copy()
    torque[push, 0] += 100.0
    found = contact_thresholds(LAW, [replace(motion, torque=torque)], BANDWIDTH_HZ, 1.0)
    quiet = contact_thresholds(LAW, [motion], BANDWIDTH_HZ, 1.0)

    def counted(thresholds, joint):
        parts = thresholds.joints[joint]
        return sum(part.rate.excursions for part in parts), sum(part.above for part in parts)

    excursions, above = np.subtract(counted(found, "shoulder"), counted(quiet, "shoulder"))
    assert excursions == 1 and above > 30
    assert counted(found, "elbow") == counted(quiet, "elbow")


def test_rows_closer_than_the_correlation_time_are_one_excursion():
    beyond = np.zeros(100, dtype=bool)
    beyond[[3, 5, 20, 21, 60]] = True
    assert _excursions(beyond, 0.01, 0.05) == [slice(3, 6), slice(20, 22), slice(60, 61)]
    assert _excursions(np.zeros(5, dtype=bool), 0.01, 0.05) == []


def test_the_interval_of_a_rate_is_garwood_s_and_open_above_without_time():
    assert Rate(0, 3600.0).ci95 == pytest.approx((0.0, 3.689), abs=1e-3)
    assert Rate(10, 3600.0).ci95 == pytest.approx((4.795, 18.39), abs=1e-2)
    assert Rate(0, 0.0).ci95 == (0.0, np.inf)


def test_a_range_without_enough_motion_has_no_threshold_and_counts_nothing():
    motion = moved(0, 1)
    names = ("position", "velocity", "acceleration", "torque")
    short = replace(motion, **{name: getattr(motion, name)[:60] for name in names})
    found = contact_thresholds(LAW, [short], BANDWIDTH_HZ, 1.0)
    parts = [part for own in found.joints.values() for part in own]
    assert all(not np.isfinite(part.threshold) and part.rate.seconds == 0.0 for part in parts)
    assert "none" in " ".join(found.lines())
    with pytest.raises(UnfitDataError, match="--validate"):
        contact_thresholds(LAW, [sweep(MODEL.model.arm)], BANDWIDTH_HZ, 1.0)


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    """A folder with two bags and a result that was fitted to one and validated on the other."""
    pytest.importorskip("clarabel", reason="needs clarabel")
    folder = tmp_path_factory.mktemp("result")
    for seed in (0, 1):
        write_recording(folder / f"run_{seed}.mcap", small_arm.recording(20.0, seed=seed))
    words = ["identify", str(folder / "run_0.mcap"), "--validate", str(folder / "run_1.mcap"), "--quiet"]
    assert main([*words, "--friction", "coulomb-viscous", "--out", str(folder / "result")]) == 0
    return folder


def test_the_command_writes_thresholds_of_held_out_recordings_only(result, tmp_path, capsys):
    words = ["export", str(result / "result"), "--to", "thresholds", "--out", str(tmp_path / "t.yaml")]
    assert main(words) == 0
    assert "false alarms" in capsys.readouterr().out
    document = yaml.safe_load((tmp_path / "t.yaml").read_text())
    assert set(document["joints"]) == set(small_arm.JOINTS) and document["arm"]["seconds"] > 5.0
    assert main([*words[:-1], str(tmp_path / "t.json"), "--validate", str(result / "run_1.mcap"), "--quiet"]) == 0
    again = json.loads((tmp_path / "t.json").read_text())
    assert again["joints"] == document["joints"]
    seen = [*words[:-1], str(tmp_path / "seen.yaml"), "--quiet", "--validate", str(result / "run_0.mcap")]
    assert main(seen) == 2 and "fitted to it" in capsys.readouterr().err
    alone = ["export", str(result / "result" / "model.yaml"), *words[2:-1], str(tmp_path / "alone.yaml")]
    assert main(alone) == 1 and "--validate" in capsys.readouterr().err
    assert main([*words[:-1], str(tmp_path / "t.txt")]) == 2 and main([*words, "--false-alarms", "0"]) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"t.yaml", "t.json"}


def test_c_and_numpy_have_the_thresholds_of_the_file(result, tmp_path):
    model, validation = read_result(result / "result")
    library, module = Library(model, validation, tmp_path), module_of(model, validation, "numpy", tmp_path)
    export_model(model, validation, "thresholds", tmp_path / "t.json", "a test")
    joints = json.loads((tmp_path / "t.json").read_text())["joints"].values()
    for part in range(4):
        ranges = [own[part] for own in joints]
        speed = np.array([-0.5 * (one["speed_from"] + one["speed_to"]) for one in ranges])
        expected = [np.inf if one["threshold"] is None else one["threshold"] for one in ranges]
        assert np.array_equal(library.call("threshold", (2,), speed), expected)
        assert np.array_equal(module.threshold(speed), expected)
    assert module.threshold(np.zeros((5, 2))).shape == (5, 2)
