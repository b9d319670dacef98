"""`spacearm new-arm`: the files load once they are filled in, say what they assume, and are not overwritten."""

from __future__ import annotations

import math
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from spacearm_ident.cli.main import main
from spacearm_ident.commissioning.starter import COMFORTABLE, DataSheet, buses_for, gear_ratios, starter_files
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.errors import UserError

CONFIG = Path(__file__).parent.parent / "config"
URDF, EDS = CONFIG / "paper_arm.urdf", CONFIG / "spacearm_drive.eds"
SHEET = {
    "--gear-ratio": (160, 160, 120, 100, 100, 100),
    "--torque-constant": (0.21, 0.21, 0.18, 0.11, 0.11, 0.09),
    "--rated-current": (3, 6, 5, 3, 3, 2.5),
    "--counts-per-turn": (1048576,),
}
WORDS = [word for option, values in SHEET.items() for word in (option, *map(str, values))]

INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK = f'<link name="{{0}}"><inertial><mass value="1"/>{INERTIA}</inertial></link>'
JOINT = '<joint name={0} type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 0 1"/>{4}</joint>'
LIMIT = '<limit lower="-1" upper="2" effort="{0}" velocity="{1}"/>'


def small_urdf(*joints: tuple[str, str, str], more: str = "") -> str:
    """A chain of joints, each a name, a type and its `<limit>`."""
    body = '<link name="l0"/>'
    for k, (name, kind, limit) in enumerate(joints):
        body += LINK.format(f"l{k + 1}") + JOINT.format(quoteattr(name), kind, f"l{k}", f"l{k + 1}", limit)
    return f'<robot name="small">{body}{more}</robot>'


def new_arm(out: Path, *words: str) -> int:
    return main(["new-arm", str(URDF), "--out", str(out), "--eds", str(EDS), *words])


def test_filled_in_from_data_sheets_it_is_the_arm_we_configured_by_hand(tmp_path):
    assert new_arm(tmp_path / "arm", "--interface", "local", *WORDS) == 0
    mine, ours = load_arm_can(tmp_path / "arm" / "arm_can.yaml"), load_arm_can(CONFIG / "paper_arm_can.yaml")
    assert mine.buses == ours.buses
    assert [(axis.node_id, axis.bus, axis.scale, axis.limits, axis.temperature_object) for axis in mine.bus.axes] == [
        (axis.node_id, axis.bus, axis.scale, axis.limits, axis.temperature_object) for axis in ours.bus.axes
    ]
    assert mine.bus.period == ours.bus.period and mine.bus.heartbeat_timeout == ours.bus.heartbeat_timeout
    for joint, known in zip(mine.arm.joints, ours.arm.joints):
        assert (joint.velocity_limit, joint.effort_limit) == (known.velocity_limit, known.effort_limit)
        assert joint.acceleration_limit <= known.acceleration_limit


def test_drives_that_count_in_rated_torque_need_no_rated_current(tmp_path):
    words = ["--rated-torque" if word == "--rated-current" else word for word in WORDS]
    assert new_arm(tmp_path, "--interface", "local", *words) == 0
    scales = load_arm_can(tmp_path / "arm_can.yaml").bus.scales
    assert [scale.rated for scale in scales] == list(SHEET["--rated-current"])
    assert {scale.torque_source for scale in scales} == {"rated_torque"}


def test_what_nobody_can_guess_is_refused_by_name_until_it_is_there(tmp_path, capsys):
    assert new_arm(tmp_path) == 0
    assert "fill in 24 values" in capsys.readouterr().out
    with pytest.raises(UserError, match=r"joint_1: gear_ratio is still empty"):
        load_arm_can(tmp_path / "arm_can.yaml")
    assert "joint_1: gear_ratio" in load_arm(tmp_path / "arm.yaml").empty, "an excitation does not need it"
    assert new_arm(tmp_path, "--force", *WORDS[: WORDS.index("--rated-current")]) == 0
    load_arm(tmp_path / "arm.yaml")
    with pytest.raises(UserError, match=r"joint_1: counts_per_turn is still empty"):
        load_arm_can(tmp_path / "arm_can.yaml")


def test_what_the_urdf_lacks_is_assumed_and_marked(tmp_path):
    urdf = small_urdf(("turn", "continuous", ""), ("slide", "prismatic", LIMIT.format(80, 0)))
    texts = starter_files(arm_from_urdf(urdf), "a.urdf", None, DataSheet(), tmp_path)
    data = yaml.safe_load(texts["arm.yaml"])["joints"]
    assert data["turn"]["position_upper_rad"] == pytest.approx(math.pi)
    assert (data["slide"]["position_lower_rad"], data["slide"]["position_upper_rad"]) == (-1, 2)
    # One kilogram metre squared about a vertical axis: its inertia alone, at the acceleration assumed, twice.
    assert data["turn"]["torque_limit_Nm"] == pytest.approx(2 * 2 * 1.0 * 1.0, rel=0.05)
    assert data["slide"]["torque_limit_Nm"] == 80
    assert 0 < data["slide"]["velocity_limit_rad_s"] < data["turn"]["velocity_limit_rad_s"]
    marked = [line.strip() for line in texts["arm.yaml"].splitlines() if "# ASSUMED" in line]
    assert sum(line.startswith("velocity_limit") for line in marked) == 2
    assert sum(line.startswith("position_") for line in marked) == 2
    assert "eds: spacearm_drive.eds  # ASSUMED" in texts["arm_can.yaml"]


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous"])
@pytest.mark.parametrize(
    "limit", ["", '<limit lower="-1" upper="2"/>', '<limit velocity="3"/>', '<limit effort="80"/>']
)
def test_limits_that_the_urdf_leaves_out_are_assumed_and_marked(kind, limit, tmp_path):
    urdf = tmp_path / "small.urdf"
    urdf.write_text(small_urdf(("only", kind, limit)))
    assert main(["new-arm", str(urdf), "--out", str(tmp_path / "arm")]) == 0
    (joint,) = load_arm(tmp_path / "arm" / "arm.yaml").joints
    assert joint.lower < joint.upper and joint.velocity_limit > 0
    assert all(map(math.isfinite, (joint.lower, joint.upper, joint.velocity_limit, joint.effort_limit)))
    lines = (tmp_path / "arm" / "arm.yaml").read_text().splitlines()
    stated = {line.split(":")[0].strip() for line in lines if line.endswith("# URDF")}
    travel = {"position_lower_rad", "position_upper_rad"} if "lower" in limit and kind != "continuous" else set()
    velocity = {"velocity_limit_rad_s"} if "velocity" in limit else set()
    assert stated == travel | velocity | ({"torque_limit_Nm"} if "effort" in limit else set())


def test_gear_ratios_of_transmissions_are_taken():
    more = """<transmission name="t"><joint name="a"/><actuator name="m"><mechanicalReduction>-101</mechanicalReduction>
    </actuator></transmission><transmission name="u"><joint name="b"/><actuator name="n">
    <mechanicalReduction>many</mechanicalReduction></actuator></transmission>"""
    limit = LIMIT.format(10, 1)
    urdf = small_urdf(("a", "revolute", limit), ("b", "revolute", limit), more=more)
    assert gear_ratios(urdf) == {"a": 101.0}
    texts = starter_files(arm_from_urdf(urdf), "a.urdf", None, DataSheet(), Path("/x"))
    joints = yaml.safe_load(texts["arm.yaml"])["joints"]
    assert joints["a"]["gear_ratio"] == 101 and joints["b"]["gear_ratio"] is None


def test_nothing_is_overwritten_unless_it_is_said(tmp_path, capsys):
    assert new_arm(tmp_path) == 0
    (tmp_path / "arm.yaml").write_text("mine")
    (tmp_path / "arm_can.yaml").unlink()
    assert new_arm(tmp_path) == 2
    assert "arm.yaml exists already" in capsys.readouterr().err
    assert (tmp_path / "arm.yaml").read_text() == "mine" and not (tmp_path / "arm_can.yaml").exists()
    assert new_arm(tmp_path, "--force") == 0
    assert (tmp_path / "arm.yaml").read_text() != "mine"
    assert new_arm(tmp_path) == 0, "the same files again are no loss"


@pytest.mark.parametrize(
    "words, said",
    [
        (["--gear-ratio", "100", "50"], "--gear-ratio has 2 numbers"),
        (["--rated-current", "-3"], "--rated-current -3 must be above zero"),
        (["--rated-current", "3", "--rated-torque", "0.3"], "--rated-current and --rated-torque: give one"),
        (["--eds", "nowhere.eds"], "cannot read the EDS nowhere.eds"),
    ],
)
def test_what_does_not_fit_is_said_and_nothing_is_written(tmp_path, capsys, words, said):
    assert main(["new-arm", str(URDF), "--out", str(tmp_path / "new"), *words]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_no_urdf_is_said(tmp_path, capsys):
    assert main(["new-arm", str(CONFIG / "spacearm.yaml"), "--out", str(tmp_path / "new")]) == 2
    assert "this is not a URDF" in capsys.readouterr().err


@settings(max_examples=60, deadline=None)
@given(st.lists(st.text("abe_ :#{}[]',\"&*!|>%@`-?0123456789.~nulltrueyes", min_size=1), min_size=1, unique=True))
def test_any_joint_name_survives_the_yaml(names):
    names = list(dict.fromkeys(filter(None, (" ".join(name.split()) for name in names))))
    if not names:
        return
    arm = arm_from_urdf(small_urdf(*((name, "revolute", LIMIT.format(10, 1)) for name in names)))
    assert arm.joint_names == tuple(names)
    texts = starter_files(arm, "a: #b.urdf", "c'd.eds", DataSheet(), Path("/e: f #g"))
    data, can, nodes = (yaml.safe_load(texts[name]) for name in ("arm.yaml", "arm_can.yaml", "arm_nodes.yaml"))
    assert list(data["joints"]) == names and list(can["joints"]) == names
    assert (data["urdf"], can["eds"]) == ("a: #b.urdf", "c'd.eds")
    assert nodes["trajectory"]["ros__parameters"]["arm"] == "/e: f #g/arm.yaml"


@settings(deadline=None)
@given(st.integers(1, 12))
def test_buses_are_as_few_as_carry_the_axes(axes):
    buses, load = buses_for(axes)
    assert load.worst <= COMFORTABLE
    if buses > 1:
        fewer = -(-axes // (buses - 1))
        assert fewer > 3, "three axes fit on one bus"
    assert -(-axes // buses) <= 3
