"""A free base weighed by momentum, the arm on it identified, and what is said where momentum says nothing."""

from __future__ import annotations

import csv
from dataclasses import replace

import floating_arm
import numpy as np
import pytest
from floating_arm import combination, fly, recorded

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.base_link import placed
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.environment.momentum import base_body
from spacearm_ident.estimate.identified import Determination
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.validation import validate
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording import write_recording
from spacearm_ident.signals.prepare import prepare

ARM = arm_from_urdf(floating_arm.URDF)
ORBIT = ARM.with_gravity(np.zeros(3))
STRUCTURE = structure_of(ARM, "coulomb-viscous")
SETTINGS = Settings(structure=STRUCTURE)


def without_base(recording):
    return replace(recording, base=None)


@pytest.fixture(scope="module")
def identified():
    """With the arm's gravity left at the Earth's: an IMU needs none."""
    return identify([recorded(fly(), seed=1)], ARM, SETTINGS)


def known_arm() -> IdentifiedModel:
    model = TorqueModel(ARM, STRUCTURE)
    values = np.array([floating_arm.truth().get(parameter.name, 0.0) for parameter in model.parameters])
    return IdentifiedModel(model, values, np.zeros(len(model.constants)))


def weighed(recording, model=None):
    motions, _ = prepare(placed([recording], ARM), floating_arm.JOINTS)
    model = model or known_arm()
    return base_body(motions, model, np.zeros((len(model.parameters) + len(model.constants),) * 2))


def test_the_arm_on_a_moving_base_is_identified_within_its_errors(identified):
    known = identified.base_errors > 0
    true = np.array([combination(name) for name in identified.base.names])
    apart = (identified.base_values - true)[known] / identified.base_errors[known]
    assert np.abs(apart).max() < 4.0 and np.sqrt(np.mean(apart**2)) < 1.5
    assert any("moving base" in note for note in identified.notes)


def test_a_moving_base_reveals_more_than_gravity_does(identified):
    fixed = identify([without_base(recorded(fly(), seed=1))], ORBIT, SETTINGS)
    assert len(identified.base.names) > len(fixed.base.names)
    of_first = {item.symbol: item for item in identified.estimates if item.joint == "waist"}
    assert of_first["Ixy"].determination is Determination.DATA
    unseen = {item.symbol: item for item in fixed.estimates if item.joint == "waist"}
    assert unseen["Ixy"].determination is Determination.PRIOR


def test_validation_is_good_with_the_base_s_motion_and_bad_without(identified):
    other = recorded(fly(seed=5), seed=2)
    good = validate(identified.model, [other], "another flight", True)
    fixed = identify([without_base(recorded(fly(), seed=1))], ORBIT, SETTINGS)
    bad = validate(fixed.model, [without_base(other)], "another flight", True)
    for joint in floating_arm.JOINTS:
        assert good.joints[joint].moving.relative_rms < 0.02
        assert bad.joints[joint].moving.rmse > 3 * good.joints[joint].moving.rmse


def test_momentum_weighs_the_base_within_its_errors(identified):
    body = identified.base_body
    assert [item.name for item in body.estimates[:2]] == ["m[base]", "mcx[base]"]
    apart = [(item.value - combination(item.symbol)) / item.standard_error for item in body.combined]
    assert len(apart) == 10 and np.abs(apart).max() < 4.0
    by_name = {item.name: item for item in body.estimates}
    # The arm turns about z first: of what can be shifted along that axis only the sum with the first link is known.
    alone = {"mcx[base]", "mcy[base]", "Ixy[base]", "Ixz[base]", "Iyz[base]", "Izz[base]"}
    assert {name for name, item in by_name.items() if item.identifiable} == alone
    assert by_name["m[base]"].determination is Determination.COMBINED
    total = body.combined[0]
    assert total.symbol == "m[base] + m[waist] + m[shoulder] + m[elbow]"
    assert total.value == pytest.approx(34.0, rel=0.03) and total.standard_error < 0.6


def test_noise_of_the_sensor_does_not_bias_the_base():
    """A sensor three times as noisy: least squares would lose a hundredth of the mass to the noise in their columns."""
    apart = []
    for seed in range(8):
        body, _ = weighed(recorded(fly(), seed=seed, noise=3.0))
        apart.append([(item.value - combination(item.symbol)) / item.standard_error for item in body.combined])
    apart = np.array(apart)
    assert np.abs(apart.mean(axis=0)).max() < 4.0 / np.sqrt(8)
    assert 0.4 < np.sqrt(np.mean(apart**2)) < 1.6


def test_without_noise_the_base_is_what_it_is():
    body, words = weighed(recorded(fly(), noise=0.0))
    for item in body.combined:
        assert item.value == pytest.approx(combination(item.symbol), abs=0.01 * max(1.0, abs(item.value)))
    assert "momentum balance" in words[0]


def test_a_base_that_something_else_moves_is_not_weighed():
    flight, recording = fly(), recorded(fly())
    push = np.stack([np.sin(0.9 * flight.time), np.cos(0.7 * flight.time), np.sin(1.3 * flight.time)], axis=1)
    pushed = replace(recording, base=replace(recording.base, force=recording.base.force + 0.5 * push))
    body, (words,) = weighed(pushed)
    assert body is None and "is not the arm's" in words


def test_a_recording_without_base_motion_says_nothing_of_the_base():
    assert weighed(without_base(recorded(fly()))) == (None, [])


@pytest.mark.parametrize("recorded_base", [True, False])
def test_mismatch_finds_the_floating_base_only_where_its_motion_was_not_recorded(recorded_base):
    few = [kind for kind in EFFECTS if kind not in ("floating_base", "payload", "torque_constant", "friction_drift")]
    field, judged = recorded(fly(), seed=1), recorded(fly(seed=5), seed=2)
    if not recorded_base:
        field, judged = without_base(field), without_base(judged)
    reference = replace(known_arm(), model=replace(known_arm().model, arm=ORBIT))
    story = explain(ORBIT, RunSet([field], reference, [judged]), few)
    found = [finding.effect for finding in story.findings]
    assert ("floating_base" in found) is not recorded_base, found


def test_the_command_writes_the_base_and_the_flag_takes_it_for_fixed(tmp_path, capsys):
    write_recording(tmp_path / "flight.mcap", recorded(fly(), seed=1))
    words = ["identify", str(tmp_path / "flight.mcap"), "--friction", "coulomb-viscous"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "momentum balance" in capsys.readouterr().out
    with (tmp_path / "out" / "parameters.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file) if row["joint"] == "base"}
    assert len(rows) == 10
    with (tmp_path / "out" / "base_parameters.csv").open() as file:
        assert next(csv.DictReader(file))["name"].startswith("m[base] + ")
    before = (tmp_path / "out" / "report.html").read_text()
    assert "momentum balance" in before
    assert main(["report", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "report.html").read_text() == before
    assert main([*words, "--out", str(tmp_path / "fixed"), "--fixed-base", "--gravity", "0", "0", "0"]) == 0
    assert "[base]" not in (tmp_path / "fixed" / "parameters.csv").read_text()
