"""Arms from URDF and arm YAML: kinematics, limits, trees, and every way a description can be wrong."""

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import THREE_LINKS, TWO_LINKS, Link, urdf_of

from spacearm_ident.dynamics.arm import ARM_SCHEMA, arm_from_urdf, load_arm
from spacearm_ident.errors import UserError

WITHOUT_LIMIT = {"limit": ""}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.urdf").write_text(urdf_of(TWO_LINKS))
    return tmp_path


def from_yaml(folder, text, urdf="arm.urdf"):
    """The arm of a YAML whose first lines are the schema and the URDF."""
    path = folder / "arm.yaml"
    path.write_text(f"schema: {ARM_SCHEMA}\nurdf: {urdf}\n{text}\n")
    return load_arm(path)


def refused(folder, text, **more):
    with pytest.raises(UserError) as caught:
        from_yaml(folder, text, **more)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_urdf_gives_names_kinematics_inertials_and_limits():
    arm = arm_from_urdf(urdf_of(THREE_LINKS))
    assert arm.name == "planted"
    assert arm.joint_names == ("waist", "shoulder", "elbow")
    assert [joint.parent for joint in arm.joints] == [-1, 0, 1]
    np.testing.assert_allclose(arm.joints[2].translation, (0, 0, 0.5))
    np.testing.assert_allclose(arm.gravity, (0, 0, -9.81))
    elbow = arm.joints[2]
    assert (elbow.lower, elbow.upper, elbow.velocity_limit, elbow.effort_limit) == (-3, 3, 4, 200)
    assert np.isinf(elbow.acceleration_limit)
    # m, m c and I about the joint frame by Steiner's theorem, written out.
    mass, c = 2.0, np.array((-0.01, 0.02, 0.2))
    about = np.diag((0.03, 0.03, 0.01)) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    want = [mass, *(mass * c), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]]
    np.testing.assert_allclose(elbow.inertial, want, atol=1e-12)


def test_fixed_joints_are_merged_into_the_link_that_carries_them():
    flange = Link("flange", kind="fixed", parent="elbow", xyz=(0, 0, 0.4), mass=1.5, com=(0.1, 0, 0))
    mount = Link("mount", kind="fixed", xyz=(0, 0, 1.0))
    on_mount = (mount, replace(TWO_LINKS[0], parent="mount"), TWO_LINKS[1], flange)
    plain, merged = arm_from_urdf(urdf_of(TWO_LINKS)), arm_from_urdf(urdf_of(on_mount))
    assert merged.joint_names == plain.joint_names
    np.testing.assert_allclose(merged.joints[0].translation, (0, 0, 1.4))
    np.testing.assert_allclose(merged.joints[0].inertial, plain.joints[0].inertial)
    assert merged.joints[1].inertial[0] == pytest.approx(2.0 + 1.5)
    first_moment = np.array((-0.01, 0, 0.2)) * 2.0 + np.array((0.1, 0, 0.4)) * 1.5
    np.testing.assert_allclose(merged.joints[1].inertial[1:4], first_moment)


def test_continuous_and_prismatic_joints_keep_their_kind_and_axis():
    links = (
        Link("spin", kind="continuous", axis=(0, 0, 1), **WITHOUT_LIMIT),
        Link("tilt", kind="continuous", parent="spin", axis=(1, 2, 2), **WITHOUT_LIMIT),
        Link(
            "slide",
            kind="prismatic",
            parent="tilt",
            axis=(0, 3, 4),
            limit='lower="-0.2" upper="0.3" effort="0" velocity="0"',
        ),
    )
    spin, tilt, slide = arm_from_urdf(urdf_of(links)).joints
    assert spin.revolute and tilt.revolute and not slide.revolute
    np.testing.assert_allclose(tilt.axis, np.array((1, 2, 2)) / 3)
    np.testing.assert_allclose(slide.axis, (0, 0.6, 0.8))
    assert np.isinf([spin.lower, spin.upper, tilt.velocity_limit, tilt.effort_limit]).all()
    assert (slide.lower, slide.upper) == (-0.2, 0.3)
    # A limit of zero in a URDF means that nobody filled it in.
    assert np.isinf([slide.velocity_limit, slide.effort_limit]).all()


def test_a_tree_knows_which_joints_carry_which_link():
    links = (
        Link("trunk"),
        Link("left", parent="trunk", xyz=(0, 0.3, 0.5)),
        Link("left_hand", parent="left", xyz=(0, 0, 0.4)),
        Link("right", parent="trunk", xyz=(0, -0.3, 0.5)),
    )
    arm = arm_from_urdf(urdf_of(links))
    at = arm.joint_names.index
    assert arm.supports(at("left_hand")) == (at("left_hand"), at("left"), at("trunk"))
    assert arm.supports(at("right")) == (at("right"), at("trunk"))
    assert arm.supports(at("trunk")) == (at("trunk"),)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_several_degrees_of_freedom_is_refused(kind):
    with pytest.raises(UserError, match=r"'ball' .*make it revolute, continuous, prismatic or fixed"):
        arm_from_urdf(urdf_of((Link("ball", kind=kind, **WITHOUT_LIMIT),)))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not a URDF"),
        ("schema: spacearm_ident/arm/1", "not a URDF"),
        ("<robot name='cut'><link na", "not well-formed"),
        ("<robot name='empty'></robot>", "cannot be read"),
        ("<robot name='still'><link name='base'/></robot>", "no actuated joint"),
        (urdf_of((Link("j", kind="fixed"),)), "no actuated joint"),
        (urdf_of((Link("j", axis=(0, 0, 0)),)), "axis 0 0 0"),
    ],
)
def test_what_is_no_usable_urdf_is_refused_in_one_line(text, says):
    with pytest.raises(UserError, match=says) as caught:
        arm_from_urdf(text)
    assert "\n" not in str(caught.value)


def test_gravity_is_earth_s_unless_said_otherwise():
    urdf = urdf_of(TWO_LINKS)
    np.testing.assert_array_equal(arm_from_urdf(urdf, np.zeros(3)).gravity, 0)
    tilted = arm_from_urdf(urdf).with_gravity([1.0, 2.0, -9.0])
    np.testing.assert_array_equal(tilted.gravity, (1, 2, -9))
    assert tilted.joint_names == ("shoulder", "elbow")


def test_a_yaml_adds_drives_limits_gravity_and_couplings(folder):
    arm = from_yaml(
        folder,
        """
name: two
gravity_m_s2: [0, 1.5, 0]
joints:
  shoulder: {gear_ratio: 120, torque_constant_Nm_per_A: 0.2, velocity_limit_rad_s: 1.2,
             acceleration_limit_rad_s2: 3, torque_limit_Nm: 80, position_lower_rad: -1, position_upper_rad: 1.5}
  elbow:
couplings:
- {name: wrist, ratios: {shoulder: 1, elbow: -0.5}}
- {ratios: {shoulder: 1, elbow: 1}}
""",
    )
    shoulder, elbow = arm.joints
    assert arm.name == "two"
    np.testing.assert_array_equal(arm.gravity, (0, 1.5, 0))
    assert (shoulder.gear_ratio, shoulder.torque_constant) == (120, 0.2)
    assert (shoulder.velocity_limit, shoulder.acceleration_limit, shoulder.effort_limit) == (1.2, 3, 80)
    assert (shoulder.lower, shoulder.upper) == (-1, 1.5)
    assert (elbow.gear_ratio, elbow.upper, elbow.effort_limit) == (1, 3, 200)
    assert [coupling.name for coupling in arm.couplings] == ["wrist", "shoulder+elbow"]
    assert arm.couplings[0].ratios == {"shoulder": 1.0, "elbow": -0.5}


def test_a_urdf_file_is_an_arm_by_itself(folder):
    assert load_arm(folder / "arm.urdf").joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("urdff: x", "unknown key 'urdff'"),
        ("1: x", "unknown key 1"),
        ("joints: {wrist: {gear_ratio: 2}}", "joint 'wrist' is not in the URDF"),
        ("joints: {elbow: {gear: 2}}", "elbow has an unknown key 'gear'"),
        ("joints: {elbow: {gear_ratio: many}}", "gear_ratio needs a number, not 'many'"),
        ("joints: {elbow: {gear_ratio: .nan}}", "gear_ratio needs a number"),
        ("joints: {elbow: {gear_ratio: [1]}}", "gear_ratio needs a number"),
        ("joints: {elbow: 100}", "elbow needs 'key: value' pairs"),
        ("joints: [elbow]", "joints needs 'key: value' pairs"),
        ("gravity_m_s2: [0, 0]", "gravity_m_s2 needs three numbers"),
        ("gravity_m_s2: down", "gravity_m_s2 needs three numbers"),
        ("gravity_m_s2: [0, 0, .inf]", "gravity_m_s2 needs three numbers"),
        ("couplings: 5", "couplings is a list"),
        ("couplings: [{name: w, ratios: {elbow: 1}}]", "at least two of the arm's joints"),
        ("couplings: [{name: w, ratios: {elbow: 1, wrist: 1}}]", "at least two of the arm's joints"),
        ("couplings: [{name: w, ratios: {elbow: 1, shoulder: one}}]", "ratio of shoulder needs a number"),
        ("couplings: [elbow]", "at least two of the arm's joints"),
        ("joints: {", "not valid YAML"),
    ],
)
def test_a_wrong_yaml_says_which_key(folder, text, says):
    assert says in refused(folder, text)


@pytest.mark.parametrize("urdf", ["missing.urdf", "binary.urdf", "."])
def test_an_unreadable_urdf_is_named(folder, urdf):
    (folder / "binary.urdf").write_bytes(b"\xff\xfe\x00<robot")
    assert "cannot read the URDF" in refused(folder, "", urdf=urdf)


@pytest.mark.parametrize("text", ["urdf: arm.urdf", "- a list", "just words", "schema: spacearm_ident/model/1"])
def test_a_yaml_without_the_schema_is_no_arm(folder, text):
    (folder / "arm.yaml").write_text(text)
    with pytest.raises(UserError, match=f"schema: {ARM_SCHEMA}"):
        load_arm(folder / "arm.yaml")


def test_a_yaml_without_a_urdf_asks_for_it(folder):
    (folder / "arm.yaml").write_text(f"schema: {ARM_SCHEMA}\n")
    with pytest.raises(UserError, match="'urdf' is missing"):
        load_arm(folder / "arm.yaml")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"nothing\.yaml"):
        load_arm(tmp_path / "nothing.yaml")
