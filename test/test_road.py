"""The road of a new user, from a URDF that somebody else wrote to a model: command after command, nothing edited."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import road_arms
import yaml

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.urdf_chain import bounded, choose_joints, locked
from spacearm_ident.excitation.clearance import Clearance
from spacearm_ident.excitation.constraints import Requirements, allowed_torque, check, limits_for_excitation, require
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.segments import Rest
from spacearm_ident.excitation.trajectory import Trajectory
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.recording import read_recording, write_recording

QUICK = ("--fundamental", "0.2", "--harmonics", "3", "--periods", "2")
SHORT = ("--harmonics", "3", "--periods", "2")
"""Two periods of 10 s: with those of `QUICK`, of 5 s, a UR5's last joint reverses too seldom to know its friction."""
GOOD = 0.05
"""Relative RMS on a run that no fit has seen, while the joint moves, that issue 27 asks for."""


def spacearm(capsys, *words, expect=0) -> tuple[str, str]:
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert code == expect, f"{words}\n{out}\n{err}"
    return out, err


def walk(capsys, urdf: Path, folder: Path, *choice: str, motion: tuple[str, ...] = QUICK) -> dict:
    """The whole road, `motion` being options of excite; returns the joints of validation.json."""
    arm = folder / "arm.yaml"
    spacearm(capsys, "new-arm", urdf, "--out", folder, *choice)
    spacearm(capsys, "check", folder)
    spacearm(capsys, "excite", "--arm", arm, "--out", folder / "fit.yaml", *motion)
    spacearm(capsys, "excite", "--arm", arm, "--out", folder / "held.yaml", *motion, "--seed", 1, "--no-gentle")
    for run, seed in (("fit", 0), ("held", 1)):
        words = ("--trajectory", folder / f"{run}.yaml", "--out", folder / f"{run}.mcap", "--seed", seed)
        _, err = spacearm(capsys, "simulate", "--arm", arm, *words)
        assert "default friction: Coulomb 4%" in err
    bags = (folder / "fit.mcap", "--validate", folder / "held.mcap")
    out, _ = spacearm(capsys, "identify", *bags, "--arm", arm, "--out", folder / "identified")
    assert out.startswith("Good fit.")
    bags = (folder / "held.mcap", "--reference", folder / "fit.mcap")
    out, _ = spacearm(capsys, "mismatch", *bags, "--out", folder / "why")
    assert json.loads((folder / "why" / "mismatch.json").read_text())["verdict"] == "no_mismatch", out
    spacearm(capsys, "report", folder)
    assert (folder / "index.html").is_file()
    return json.loads((folder / "identified" / "validation.json").read_text())["joints"]


def assert_within(joints: dict, share: float) -> None:
    """The worst joint's residual RMS over torque RMS on the held-out recording, while it moves."""
    shares = {name: joint["moving"]["relative_rms"] for name, joint in joints.items()}
    assert max(shares.values()) < share, shares


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


@pytest.mark.long
@pytest.mark.parametrize(
    "text, choice",
    [
        (road_arms.SCARA, ()),
        (road_arms.GANTRY, ()),
        (road_arms.SERVICE_ROBOT, ("--lock", "head_pan=0.4")),
    ],
    ids=["scara", "gantry", "service-robot"],
)
def test_the_road_ends_in_a_good_model_with_nothing_edited(text, choice, tmp_path, capsys):
    assert_within(walk(capsys, written(tmp_path, text), tmp_path / "arm", *choice), GOOD)


def shared_urdf(name: str) -> Path:
    """A URDF of example-robot-data, which the test extra installs."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed (pip install -c constraints.txt -e '.[test]')")
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / name


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "ur_description/urdf/ur5_robot.urdf",
        "tiago_description/robots/tiago_no_hand.urdf",
    ],
    ids=["ur5", "tiago"],
)
def test_the_road_ends_in_a_good_model_and_no_mismatch_for_arms_of_others(name, tmp_path, capsys):
    """Two of them; `bench/road.py` walks with a dozen."""
    assert_within(walk(capsys, shared_urdf(name), tmp_path / "arm", motion=SHORT), GOOD)


@pytest.mark.parametrize(
    "name, joints, hand, others",
    [
        ("ur_description/urdf/ur5_robot.urdf", 6, 0, 0),
        ("panda_description/urdf/panda.urdf", 7, 2, 0),
        ("kinova_description/robots/kinova.urdf", 6, 0, 0),
        ("tiago_description/robots/tiago_no_hand.urdf", 8, 0, 4),
        ("so_arm_description/urdf/so101.urdf", 5, 1, 0),
    ],
)
def test_arms_of_others_are_found_in_their_urdf_with_meshes_and_a_posture_to_rest_in(
    name, joints, hand, others, tmp_path, capsys
):
    urdf = shared_urdf(name)
    chosen = choose_joints(urdf.read_text())
    assert (len(chosen.joints), len(chosen.hand), len(chosen.others)) == (joints, hand, others)
    out, _ = spacearm(capsys, "new-arm", urdf, "--out", tmp_path)
    assert "FILL IN" not in out and "meshes not found" not in out
    arm = load_arm(tmp_path / "arm.yaml")
    assert arm.joint_names == chosen.joints and arm.start is not None
    limits, _ = limits_for_excitation(arm, arm.start)
    clearance = Clearance(arm, 0.0, limits.lower, limits.upper)
    assert clearance.source == "the URDF's collision geometry"
    needs = Requirements(limits, allowed_torque(arm), nominal_model(arm), clearance=clearance)
    require(check(Trajectory(arm.joint_names, (Rest(arm.start, 0.1),)), needs))


def test_several_arms_are_not_chosen_among(tmp_path, capsys):
    urdf = shared_urdf("baxter_description/urdf/baxter.urdf")
    _, err = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "a", expect=2)
    assert "2 chains of 7 joints" in err and "--tip right_wrist or --tip left_wrist" in err
    assert not (tmp_path / "a").exists()
    out, _ = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "a", "--tip", "left_wrist")
    assert "an arm with 7 joints, left_s0" in out


# --- one arm out of a robot -------------------------------------------------------------------------------------


def test_the_hand_mimics_and_what_is_elsewhere_are_no_joints_of_the_arm():
    chosen = choose_joints(road_arms.SERVICE_ROBOT)
    assert chosen.joints == ("shoulder", "elbow", "wrist")
    assert chosen.hand == ("finger", "mirror") and chosen.others == ("wheel", "head_pan")
    assert choose_joints(road_arms.SERVICE_ROBOT, tip="head").joints == ("head_pan",)
    assert choose_joints(road_arms.SERVICE_ROBOT, base="upper", tip="palm").joints == ("elbow", "wrist")
    assert choose_joints(road_arms.SERVICE_ROBOT, names=("wrist", "shoulder")).joints == ("shoulder", "wrist")


def test_locked_joints_leave_kinematics_and_dynamics_of_the_robot_as_they_were():
    """Against Pinocchio's own reduced model, with the joints away from zero and the mirrored finger along."""
    at = {"head_pan": 0.4, "finger": 0.02, "elbow": -1.1}
    urdf = road_arms.SERVICE_ROBOT
    reduced = pin.buildModelFromXML(locked(urdf, ("wheel", "head_pan", "finger", "mirror", "elbow"), at))
    whole = pin.buildModelFromXML(urdf)
    reference = pin.neutral(whole)
    for name, value in {**at, "mirror": 0.02}.items():
        reference[whole.joints[whole.getJointId(name)].idx_q] = value
    gone = [whole.getJointId(name) for name in ("wheel", *at, "mirror")]
    theirs = pin.buildReducedModel(whole, gone, reference)
    assert tuple(reduced.names) == tuple(theirs.names)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, v, a = rng.normal(size=(3, reduced.nv))
        ours = pin.rnea(reduced, reduced.createData(), q, v, a)
        np.testing.assert_allclose(ours, pin.rnea(theirs, theirs.createData(), q, v, a), atol=1e-9)


@pytest.mark.parametrize(
    "more, said",
    [
        ('<mimic joint="finger" multiplier="much"/>', "mimic multiplier='much'"),
        ('<mimic joint="mirror"/>', None),
        ("<xacro:note text='a prefix that nobody declared'/>", None),
    ],
)
def test_what_others_write_into_a_urdf_is_read_or_refused_in_a_line(more, said, tmp_path, capsys):
    text = road_arms.SERVICE_ROBOT.replace('<mimic joint="finger" multiplier="1" offset="0"/>', more)
    urdf = written(tmp_path, f"\n<?xml version='1.0'?>{text}")
    out, err = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "arm", expect=2 if said else 0)
    assert said in err if said else "an arm with 3 joints, shoulder, elbow, wrist" in out


DECLARED = '<robot xmlns:macro="http://www.ros.org/wiki/xacro" '


@pytest.mark.parametrize(
    "old, new, named",
    [
        ("</robot>", '<macro:property name="m" value="1"/></robot>', "<macro:property>"),
        ('<mimic joint="finger"', '<mimic macro:if="1" joint="finger"', "mimic macro:if"),
        (
            '<mimic joint="finger" multiplier="1"',
            '<mimic joint="finger" multiplier="${gain}"',
            "mimic multiplier='${gain}'",
        ),
        ("</robot>", '<gazebo><plugin name="${NAME}"/></gazebo></robot>', None),
    ],
    ids=["element", "attribute", "expression", "namespace declared, a plug-in's own expression"],
)
def test_a_xacro_that_is_not_expanded_is_named_with_the_remedy(old, new, named, tmp_path, capsys):
    text = road_arms.SERVICE_ROBOT.replace("<robot ", DECLARED)
    assert DECLARED in text and old in text
    urdf = written(tmp_path, text.replace(old, new))
    out, err = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "arm", expect=2 if named else 0)
    if named is None:
        assert "an arm with 3 joints, shoulder, elbow, wrist" in out
    else:
        assert f"xacro file that is not expanded ({named}): run 'xacro FILE > robot.urdf'" in err


def test_a_continuous_joint_made_revolute_is_the_same_arm():
    model, angle = pin.buildModelFromXML(bounded(road_arms.SCARA)), 0.7
    whole = pin.buildModelFromXML(road_arms.SCARA)
    assert model.nq == model.nv == whole.nv < whole.nq
    q = np.array([0.1, 0.2, -0.1, angle])
    ours = pin.crba(model, model.createData(), q)
    theirs = pin.crba(whole, whole.createData(), pin.integrate(whole, pin.neutral(whole), q))
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize(
    "words, said",
    [
        (("--tip", "nowhere"), "no link 'nowhere': its links are wheels"),
        (("--base", "palm", "--tip", "upper"), "'upper' is not behind link 'palm'"),
        (("--joints", "mirror"), "it mimics finger, name that one"),
        (("--joints", "knee"), "the URDF has no such joint; the joints that can be driven are head_pan"),
        (("--joints", "elbow", "--tip", "palm"), "leave out --base and --tip"),
        (("--lock", "shoulder=1"), "'shoulder' cannot be locked at a position: it is one of the arm's own"),
        (("--lock", "mirror=0.01"), "it mimics finger"),
        (("--lock", "head_pan"), "write NAME=VALUE"),
        (("--tip", "torso"), "no joint between base and tip can be driven"),
    ],
)
def test_a_choice_that_cannot_be_is_named_and_nothing_is_written(words, said, tmp_path, capsys):
    urdf = written(tmp_path, road_arms.SERVICE_ROBOT)
    _, err = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "arm", *words, expect=2)
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "arm").exists()


# --- what new-arm writes ----------------------------------------------------------------------------------------


def test_every_guess_is_marked_and_nothing_is_demanded_that_is_not_needed(tmp_path, capsys):
    urdf = written(tmp_path, road_arms.SERVICE_ROBOT.replace('effort="6"', 'effort="0"'))
    spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "arm")
    text = (tmp_path / "arm" / "arm.yaml").read_text()
    data = yaml.safe_load(text)["joints"]
    assert set(data) == {"shoulder", "elbow", "wrist"}
    assert all("gear_ratio" not in keys for keys in data.values()), "nor is the transmission's 1 a gear ratio"
    lines = {line.split(":")[0].strip(): line for line in text.splitlines() if line.startswith("    ")}
    assert "# ASSUMED: 2 times the torque its CAD links need" in lines["torque_limit_Nm"], (
        "the last joint's is the last"
    )
    assert -2.2 < data["elbow"]["start_position_rad"] < -0.2
    assert not (tmp_path / "arm" / "arm_can.yaml").exists()
    moving = [
        j for j in ET.parse(tmp_path / "arm" / "robot.urdf").getroot().iter("joint") if j.get("type") == "revolute"
    ]
    assert [j.get("name") for j in moving] == ["shoulder", "elbow", "wrist"]


def test_meshes_are_found_around_the_urdf_or_the_way_to_them_is_said(tmp_path, capsys):
    mesh = "package://my_arm_description/meshes/box.stl"
    box = '<box size="0.08 0.08 0.3"/>'
    text = road_arms.SERVICE_ROBOT.replace(f"<geometry>{box}", f'<geometry><mesh filename="{mesh}"/>')
    folder = tmp_path / "src" / "my_arm_description"
    (folder / "urdf").mkdir(parents=True)
    urdf = folder / "urdf" / "robot.urdf"
    urdf.write_text(text)
    out, _ = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "a")
    assert f"1 of 1 meshes not found ({mesh}): --package-path FOLDER names the one that holds the folder" in out
    (folder / "meshes").mkdir()
    (folder / "meshes" / "box.stl").write_text(_tetrahedron())
    out, _ = spacearm(capsys, "new-arm", urdf, "--out", tmp_path / "b")
    assert "meshes not found" not in out
    assert yaml.safe_load((tmp_path / "b" / "arm.yaml").read_text())["package_path"] == [str(tmp_path / "src")]
    elsewhere = written(tmp_path, text)
    out, _ = spacearm(capsys, "new-arm", elsewhere, "--out", tmp_path / "c", "--package-path", tmp_path / "src")
    assert "meshes not found" not in out


def _tetrahedron() -> str:
    corners = ["0 0 0", "0.1 0 0", "0 0.1 0", "0 0 0.1"]
    facets = ""
    for triple in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)):
        points = "\n".join(f"vertex {corners[k]}" for k in triple)
        facets += f"facet normal 0 0 1\nouter loop\n{points}\nendloop\nendfacet\n"
    return f"solid t\n{facets}endsolid t\n"


# --- excite -----------------------------------------------------------------------------------------------------


def test_the_gentle_run_keeps_to_its_share_and_the_page_loads_nothing(tmp_path, capsys):
    spacearm(capsys, "new-arm", written(tmp_path, road_arms.GANTRY), "--out", tmp_path)
    out, _ = spacearm(capsys, "excite", "--arm", tmp_path / "arm.yaml", "--out", tmp_path / "x.yaml", *QUICK)
    lines = out.splitlines()
    assert "all limits of 3 joints kept" in lines[0] and "next: record " in lines[1] and "x_gentle.yaml" in lines[1]
    assert "m/s²" in out and "rad" not in out.replace("gradient", "")
    arm = load_arm(tmp_path / "arm.yaml")
    full, gentle = (load_trajectory(tmp_path / f"{name}.yaml") for name in ("x", "x_gentle"))
    for run, share in ((full, 1.0), (gentle, 0.4)):
        motion = run.evaluate(np.arange(0.0, run.duration_s, 0.002))
        np.testing.assert_allclose(motion.q[0], arm.start, atol=1e-9)
        for values, limits in ((motion.qd, "velocity_limit"), (motion.qdd, "acceleration_limit")):
            used = np.abs(values).max(axis=0) / [getattr(joint, limits) for joint in arm.joints]
            assert (used <= share * (1 + 1e-6)).all()
            assert used.max() > 0.5 * share, "and it is worth the time"
    page = (tmp_path / "x.html").read_text()
    assert "All limits of 3 joints kept" in page and page.count("<svg") == 4
    assert not any(word in page for word in ("http://", "https://", "src=", "<script"))


def test_a_plain_urdf_that_cannot_rest_at_zero_is_given_a_posture(tmp_path, capsys):
    chosen = choose_joints(road_arms.SERVICE_ROBOT)
    urdf = written(tmp_path, locked(road_arms.SERVICE_ROBOT, (*chosen.hand, *chosen.others)))
    words = ("--for", "presliding", "--joints", "wrist", "--out", tmp_path / "x.yaml")
    out, err = spacearm(capsys, "excite", "--arm", urdf, *words)
    assert "all zeros violates a limit" in out + err
    assert -2.2 < load_trajectory(tmp_path / "x.yaml").evaluate(0.0).q[0, 1] < -0.2


# --- simulate ---------------------------------------------------------------------------------------------------


def test_simulate_names_what_it_lacks(tmp_path, capsys):
    words = ("--trajectory", tmp_path / "x.yaml", "--out", tmp_path / "x.mcap")
    _, err = spacearm(capsys, "simulate", *words, expect=2)
    assert "nothing to simulate: name --arm" in err
    config = Path(__file__).parent.parent / "config"
    data = yaml.safe_load((config / "paper_arm_model.yaml").read_text())
    data["urdf_file"] = str(config / data["urdf_file"])
    data["terms"] = [term for term in data["terms"] if term["kind"] != "rigid_body"]
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(data))
    _, err = spacearm(capsys, "simulate", "--model", tmp_path / "model.yaml", *words, expect=2)
    assert "has no rigid_body term" in err
    weightless = written(
        tmp_path,
        '<robot name="r"><link name="a"/><link name="b"/>'
        + road_arms.joint("j", "revolute", "a", "b", "0 0 0", "0 0 1", road_arms.limit(-1, 1, 5, 1))
        + "</robot>",
    )
    _, err = spacearm(capsys, "simulate", "--arm", weightless, *words, expect=2)
    assert "no inertia: add <inertial>" in err


# --- recordings that lack joints of the description -------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A recording of the service robot's arm alone, and the URDF of the whole robot on fixed wheels."""
    folder = tmp_path_factory.mktemp("recorded")
    whole = locked(road_arms.SERVICE_ROBOT, ("wheel",))
    (folder / "whole.urdf").write_text(whole)
    arm = folder / "arm" / "arm.yaml"
    assert main(["new-arm", str(folder / "whole.urdf"), "--out", str(folder / "arm")]) == 0
    assert main(["excite", "--arm", str(arm), "--out", str(folder / "x.yaml"), *QUICK, "--no-gentle"]) == 0
    words = ["simulate", "--arm", str(arm), "--trajectory", str(folder / "x.yaml")]
    assert main([*words, "--out", str(folder / "x.mcap")]) == 0
    return folder


def test_joints_that_a_recording_lacks_are_taken_as_fixed_and_named(recorded, tmp_path, capsys):
    arm = ("--arm", recorded / "whole.urdf")
    assert "head_pan" in arm_from_urdf((recorded / "whole.urdf").read_text()).joint_names
    said = "not in the recordings, and taken as fixed: head_pan, finger"
    assert said in spacearm(capsys, "check", recorded / "x.mcap", *arm)[1]
    out, err = spacearm(capsys, "identify", recorded / "x.mcap", *arm, "--out", tmp_path / "id")
    assert said in err and out.startswith("Good fit.")
    assert said in spacearm(capsys, "mismatch", recorded / "x.mcap", *arm, "--out", tmp_path / "mm")[1]


def test_a_joint_of_another_name_is_refused_and_not_fixed(recorded, tmp_path, capsys):
    other = tmp_path / "other.urdf"
    other.write_text((recorded / "whole.urdf").read_text().replace('"elbow"', '"knee"'))
    _, err = spacearm(capsys, "identify", recorded / "x.mcap", "--arm", other, "--out", tmp_path / "id", expect=2)
    assert "has no joint" in err and "it has shoulder, elbow, wrist" in err


def test_a_recording_at_20_hz_is_refused_with_the_reason(recorded, tmp_path, capsys):
    whole = read_recording(recorded / "x.mcap")
    rows = np.arange(0, len(whole.time), 50)
    assert whole.velocity is not None
    slow = replace(
        whole,
        time=whole.time[rows],
        position=whole.position[rows],
        velocity=whole.velocity[rows],
        effort=whole.effort[rows],
        segments=(slice(0, len(rows)),),
        command=None,
        temperatures={},
    )
    write_recording(tmp_path / "slow.mcap", slow, [])
    _, err = spacearm(capsys, "identify", tmp_path / "slow.mcap", "--out", tmp_path / "id", expect=1)
    assert "20 Hz is too slow" in err and "100 Hz or more" in err
