"""Joints that mimic one of the arm's: refused where they move the chain, said where they are beside it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import small_arm
from road_arms import SERVICE_ROBOT, joint, limit, link

from spacearm_ident.cli.main import main
from spacearm_ident.commissioning.arm_check import check_arm
from spacearm_ident.commissioning.result import Level
from spacearm_ident.dynamics.arm import arm_from_urdf, without_joints
from spacearm_ident.dynamics.regressor import rigid_body_torque
from spacearm_ident.errors import UserError
from spacearm_ident.recording import write_recording
from spacearm_ident.sessions.identification import find_arm, locked_words


def parallelogram(roll: bool = True, fingers: bool = False) -> str:
    """An arm whose wrist keeps its direction in space; `fingers` mimic each other behind its last joint."""
    turning = limit(-2, 2, 40, 2)
    text = (
        '<robot name="palletizer">'
        + link("base", 5)
        + link("upper", 3, "0 0 0.15", (0.08, 0.08, 0.3))
        + link("fore", 2, "0 0 0.12", (0.07, 0.07, 0.25))
        + link("hand", 1, "0.05 0 0.05")
        + joint("shoulder", "revolute", "base", "upper", "0 0 0.3", "0 1 0", turning)
        + joint("elbow", "revolute", "upper", "fore", "0 0 0.32", "0 1 0", turning)
        + joint(
            "wrist", "revolute", "fore", "hand", "0 0 0.27", "0 1 0", turning + '<mimic joint="elbow" multiplier="-1"/>'
        )
    )
    if roll:
        text += link("tool", 0.5, "0.03 0 0.05") + joint(
            "roll", "revolute", "hand", "tool", "0 0 0.1", "0 0 1", turning
        )
    if fingers:
        finger = limit(0, 0.03, 20, 0.1)
        follows = finger + '<mimic joint="left_finger"/>'
        text += link("left", 0.05) + joint("left_finger", "prismatic", "tool", "left", "0 0.02 0.1", "0 1 0", finger)
        text += link("right", 0.05) + joint("right_finger", "prismatic", "tool", "right", "0 0 0.1", "0 -1 0", follows)
        text += link("pad", 0.01) + joint("left_pad", "revolute", "left", "pad", "0 0 0.1", "0 1 0", follows)
    return text + "</robot>"


def file_of(folder, text):
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


@pytest.mark.parametrize("roll, moved", [(True, "roll"), (False, "the end of the chain")])
def test_a_mimic_joint_that_moves_the_chain_is_refused_by_every_command(roll, moved, tmp_path, capsys):
    urdf = file_of(tmp_path, parallelogram(roll))
    said = f"joint wrist mimics elbow and moves {moved} with it"
    for words in (
        ("new-arm", urdf, "--out", tmp_path / "arm"),
        ("excite", "--arm", urdf, "--out", tmp_path / "e.yaml"),
    ):
        assert main([*map(str, words)]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "arm").exists()
    (failed,) = [one for one in check_arm(urdf) if one.level is Level.FAIL]
    assert said in failed.message and "<mimic>" in failed.advice
    with pytest.raises(UserError, match=said):
        find_arm(urdf, None, [])


def test_recordings_of_a_coupled_chain_are_refused_by_identify_and_check(tmp_path, capsys):
    bag = tmp_path / "run.mcap"
    write_recording(bag, small_arm.recording(8.0, 100.0))
    urdf = file_of(tmp_path, parallelogram(roll=False))
    for words in (("identify", bag, "--arm", urdf, "--out", tmp_path / "r"), ("check", bag, "--arm", urdf)):
        assert main([*map(str, words)]) == 2
        assert "joint wrist mimics elbow" in capsys.readouterr().err


def test_without_its_leader_a_mimic_joint_stands_where_that_stands(tmp_path):
    """Against Pinocchio's own dynamics of the whole arm."""
    urdf = parallelogram()
    arm = without_joints(arm_from_urdf(urdf), ["elbow"], {"elbow": 0.7})
    assert arm.joint_names == ("shoulder", "roll") and not locked_words(arm)[1:]
    whole = pin.buildModelFromXML(urdf.replace('<mimic joint="elbow" multiplier="-1"/>', ""))
    q = np.array([0.3, 0.7, -0.7, 0.4])
    v = a = np.zeros(4)
    theirs = pin.rnea(whole, whole.createData(), q, v, a)[[0, 3]]
    inertials = np.array([one.inertial for one in arm.joints])
    still = np.zeros((1, 2))
    ours = rigid_body_torque(arm, inertials, q[None, [0, 3]], still, still)[0]
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_the_remedy_that_the_refusal_names_is_an_arm(tmp_path, capsys):
    urdf = file_of(tmp_path, parallelogram())
    words = ("new-arm", urdf, "--joints", "shoulder", "roll", "--lock", "elbow=0.7", "--out", tmp_path / "arm")
    assert main([*map(str, words)]) == 0
    assert "arm with 2 joints, shoulder, roll" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text, joints, followers",
    [
        (SERVICE_ROBOT, ("shoulder", "elbow", "wrist", "finger"), "mirror (with finger)"),
        (
            parallelogram(fingers=True).replace('<mimic joint="elbow" multiplier="-1"/>', ""),
            ("shoulder", "elbow", "wrist", "roll", "left_finger"),
            "right_finger (with left_finger), left_pad (with left_finger)",
        ),
    ],
)
def test_a_gripper_that_mimics_is_said_and_not_refused(text, joints, followers, tmp_path, capsys):
    urdf = file_of(tmp_path, text)
    assert main(["new-arm", str(urdf), "--joints", *joints, "--out", str(tmp_path / "arm")]) == 0
    assert f"taken as fixed, and what they carry as not moved by them: {followers}" in capsys.readouterr().out
    assert main(["new-arm", str(urdf), "--joints", *joints[:-1], "--out", str(tmp_path / "less")]) == 0
    assert "taken as fixed, and what" not in capsys.readouterr().out
