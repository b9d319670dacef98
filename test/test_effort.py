"""Effort not in N·m: converted where the arm says so, refused where it cannot be torque, the same off line and live."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_arm
import yaml

from spacearm_ident.cli.main import main
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.effort_limit import BEYOND_TORQUE
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.identification.effort import in_newton_metres
from spacearm_ident.recording import write_recording

NM_PER_A = np.array([12.0, -8.0])
"""A motor mounted the other way round has a negative constant."""


def arm_file(folder, effort=None, joints=None):
    (folder / "arm.urdf").write_text(small_arm.URDF)
    document = {"schema": "spacearm_ident/arm/1", "urdf": "arm.urdf", "joints": joints or {}}
    (folder / "arm.yaml").write_text(yaml.safe_dump(document | ({} if effort is None else {"effort": effort})))
    return folder / "arm.yaml"


def constants(values):
    return dict(zip(small_arm.JOINTS, np.asarray(values).tolist(), strict=True))


def in_unit(scale):
    recording = small_arm.recording()
    return replace(recording, effort=recording.effort / scale)


@pytest.mark.parametrize(
    ("effort", "joints", "scale"),
    [
        ({"unit": "A", "constants": constants(NM_PER_A)}, {}, NM_PER_A),
        ({"unit": "percent", "constants": constants([80.0, 40.0])}, {}, np.array([0.8, 0.4])),
        (
            {"unit": "A", "constants": {"elbow": 8.0}},
            {"shoulder": {"gear_ratio": 100, "torque_constant_Nm_per_A": 0.12}},
            np.array([12.0, 8.0]),
        ),
        ({"unit": "N m"}, {}, np.ones(2)),
    ],
    ids=["A", "percent", "A by gear and torque constant", "N m"],
)
def test_effort_becomes_torque_as_the_arm_declares(tmp_path, effort, joints, scale):
    arm = load_arm(arm_file(tmp_path, effort, joints))
    (converted,) = in_newton_metres([in_unit(scale)], arm)
    np.testing.assert_allclose(converted.effort, small_arm.recording().effort, rtol=1e-12)
    assert ("effort_converted" in {issue.kind for issue in converted.issues}) is bool(np.any(scale != 1.0))


def test_identification_of_amperes_is_that_of_newton_metres_and_the_model_keeps_the_unit(tmp_path, capsys):
    write_recording(tmp_path / "torque.mcap", small_arm.recording())
    write_recording(tmp_path / "current.mcap", in_unit(NM_PER_A))
    arm = arm_file(tmp_path, {"unit": "A", "constants": constants(NM_PER_A)})
    how = ("--friction", "coulomb-viscous", "--bandwidth", "5", "--quiet")
    assert main(["identify", str(tmp_path / "torque.mcap"), *how, "--out", str(tmp_path / "a")]) == 0
    words = ["identify", str(tmp_path / "current.mcap"), *how, "--arm", str(arm), "--out", str(tmp_path / "b")]
    assert main(words) == 0
    models = [load_model(tmp_path / name / "model.yaml") for name in "ab"]
    np.testing.assert_allclose(models[1].parameters, models[0].parameters, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(models[1].model.arm.effort_scale, NM_PER_A)
    capsys.readouterr()


def test_amperes_that_the_arm_declares_are_torque_to_the_check_and_without_are_another_unit(tmp_path, capsys):
    write_recording(tmp_path / "current.mcap", in_unit(NM_PER_A))
    arm = arm_file(tmp_path, {"unit": "A", "constants": constants(NM_PER_A)})
    words = ["check", str(tmp_path / "current.mcap"), "--quiet", "--arm"]
    assert main([*words, str(arm)]) == 0
    assert "data fit: no mistake of convention found" in capsys.readouterr().out
    assert main([*words, str(tmp_path / "arm.urdf")]) == 1
    assert "not in N·m" in capsys.readouterr().out


def test_a_model_file_keeps_the_declared_unit_and_has_none_where_none_was_declared(tmp_path):
    arm = load_arm(arm_file(tmp_path, {"unit": "percent", "constants": constants([80.0, 40.0])}))
    known = small_arm.identified()
    save_model(known, tmp_path / "plain.yaml")
    save_model(replace(known, model=replace(known.model, arm=arm)), tmp_path / "scaled.yaml")
    assert "effort" not in yaml.safe_load((tmp_path / "plain.yaml").read_text())
    again = load_model(tmp_path / "scaled.yaml").model.arm
    np.testing.assert_allclose(again.effort_scale, [0.8, 0.4])
    assert again.effort_declared


def test_live_residuals_of_amperes_are_those_of_newton_metres(tmp_path):
    pytest.importorskip("rclpy", reason="needs ROS 2")
    from spacearm_ident.nodes.residual_stream import ResidualStream

    arm = load_arm(arm_file(tmp_path, {"unit": "A", "constants": constants(NM_PER_A)}))
    known = small_arm.identified()
    rows = []
    for model, run in (
        (known, small_arm.recording()),
        (replace(known, model=replace(known.model, arm=arm)), in_unit(NM_PER_A)),
    ):
        stream = ResidualStream(model, 50.0)
        rows.append([row.residual for row in stream.add(small_arm.payloads(run, order=(1, 0)))])
    assert len(rows[0]) > 100
    np.testing.assert_allclose(rows[1], rows[0], atol=1e-9)


def test_effort_that_cannot_be_torque_is_refused_before_anything_is_identified(tmp_path, capsys):
    write_recording(tmp_path / "milli.mcap", in_unit(1e-3))
    assert main(["identify", str(tmp_path / "milli.mcap"), "--quiet", "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "effort of shoulder is beyond 3 times its limit of 100 N·m" in error and "effort: {unit: A}" in error
    assert not (tmp_path / "out").exists()
    # Whoever declares N·m is believed; the limits may be the URDF's placeholders.
    declared = load_arm(arm_file(tmp_path, {"unit": "N m"}))
    assert in_newton_metres([in_unit(1e-3)], declared)


def test_peaks_within_the_criterion_and_damaged_samples_are_no_other_unit():
    arm = arm_from_urdf(small_arm.URDF)
    recording = small_arm.recording()
    effort = recording.effort.copy()
    effort[: len(effort) // 25, 0] = 1.01 * BEYOND_TORQUE * 100.0
    assert in_newton_metres([replace(recording, effort=effort)], arm)
    effort[: len(effort) // 10, 0] = 1.01 * BEYOND_TORQUE * 100.0
    with pytest.raises(UserError, match="shoulder"):
        in_newton_metres([replace(recording, effort=effort)], arm)
    endless = replace(arm, joints=tuple(replace(joint, effort_limit=np.inf) for joint in arm.joints))
    assert in_newton_metres([replace(recording, effort=1e6 * effort)], endless)


@pytest.mark.parametrize(
    ("effort", "words"),
    [
        ("A", "needs 'key: value' pairs"),
        ({"unit": "mA"}, "one of N m, A, percent"),
        ({"unit": "A"}, "constants has no shoulder: give N·m on the output side for each A"),
        ({"unit": "percent", "constants": {"shoulder": 80}}, "constants has no elbow: give .* at 100 %"),
        ({"unit": "A", "constants": {"knee": 1}}, "'knee' is not in the URDF"),
        ({"unit": "A", "constants": constants([0.0, 1.0])}, "shoulder: 0 turns nothing into torque"),
        ({"unit": "N m", "constants": constants([1.0, 1.0])}, "needs no constants"),
    ],
)
def test_a_declaration_that_is_not_understood_says_where_and_what_to_do(tmp_path, effort, words):
    with pytest.raises(UserError, match=words):
        load_arm(arm_file(tmp_path, effort))


def test_our_driver_refuses_an_arm_whose_effort_is_in_another_unit(tmp_path):
    from driven_arm import CONFIG

    arm = yaml.safe_load((CONFIG / "paper_arm.yaml").read_text())
    arm["urdf"] = str(CONFIG / "paper_arm.urdf")
    arm["effort"] = {"unit": "A"}
    (tmp_path / "paper_arm.yaml").write_text(yaml.safe_dump(arm))
    can = (CONFIG / "paper_arm_can.yaml").read_text()
    (tmp_path / "can.yaml").write_text(can)
    with pytest.raises(UserError, match="this driver publishes N·m"):
        load_arm_can(tmp_path / "can.yaml")
