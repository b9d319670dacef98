"""Reading simulations: MJCF as MuJoCo has it, SDF and URDF with their joint dynamics, and files that are none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm
from mujoco_arm import JOINTS, inverse, mjcf, mujoco_or_skip, recorded

from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.regressor import rigid_body_torque
from spacearm_ident.errors import UserError
from spacearm_ident.export.law import nearest
from spacearm_ident.export.mended import mend
from spacearm_ident.export.sdf import sdf
from spacearm_ident.results.formats import ARMATURE, DAMPING, FRICTION, MJCF, SDF
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.simulations import Simulation, read_simulation
from spacearm_ident.simulations.names import affixes, renamed
from spacearm_ident.simulations.noise_free import noise_free
from spacearm_ident.simulations.simulation import without


def _states(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform(-1.5, 1.5, (3, 8, 3)))  # type: ignore[return-value]


def _torque(simulation: Simulation, states: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """Torque of the simulation's bodies, rotors and friction."""
    arm, (position, velocity, acceleration) = simulation.arm, states
    inertials = np.array([joint.inertial for joint in arm.joints])
    rigid = rigid_body_torque(arm, inertials, position, velocity, acceleration)

    def own(symbol: str) -> np.ndarray:
        return np.array([simulation.model.value(symbol, joint) for joint in arm.joint_names])

    return np.asarray(rigid + own("J_m") * acceleration + own("k_v1") * velocity + own("f_c") * np.sign(velocity))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "three.xml"
    path.write_text(mjcf())
    return path


def test_mjcf_predicts_the_torque_of_mujoco(file: Path) -> None:
    """Anchors off the origin, `ref`, welded bodies and full inertias are as MuJoCo has them."""
    mujoco_or_skip()
    simulation, states = read_simulation(file), _states()
    assert simulation.arm.joint_names == JOINTS
    assert simulation.bodies == {"base_turn": "post", "shoulder": "upper", "elbow": "fore"}
    np.testing.assert_allclose(_torque(simulation, states), inverse(mjcf(), *states), atol=1e-9)


def test_mjcf_of_a_free_body_is_refused_with_what_to_give(tmp_path: Path) -> None:
    mujoco_or_skip()
    path = tmp_path / "free.xml"
    body = '<body><freejoint name="f"/><geom size="0.1" mass="1"/></body>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(UserError, match="fixed to the world"):
        read_simulation(path)
    with pytest.raises(UserError, match="'body_1' has a free joint"):
        read_simulation(path)


OBJECTS = """
    <body name="crate" pos="0.1 0.2 0.3"><freejoint/><geom type="box" size="0.2 0.2 0.2" mass="5"/>
      <body name="lid"><joint name="lid_hinge" axis="1 0 0"/><geom size="0.1" mass="1"/></body></body>
    <body name="table"><geom size="0.1" mass="9"/>
      <body name="lamp" pos="1 0 0"><joint name="lamp_ball" type="ball"/><geom size="0.1" mass="1"/></body></body>
    <body name="frame" pos="2 0 0"><joint name="door" axis="0 0 1" damping="2"/><geom size="0.1" mass="7"/></body>"""
"""A free crate around the arm's hand with a hinged lid, a lamp on a ball joint on a fixed table, and a hinged door."""


def _beside(objects: str, **changes: float) -> str:
    """The arm's MJCF, a geom on its fore arm, behind other bodies of the world."""
    text = mjcf(**changes).replace("<worldbody>", f"<worldbody>{objects}")
    return text.replace('<joint name="elbow"', '<geom type="box" size="0.1 0.1 0.1"/><joint name="elbow"')


def test_mjcf_of_an_arm_beside_free_and_ball_jointed_bodies_is_the_arm(tmp_path: Path) -> None:
    mujoco_or_skip()
    path = tmp_path / "cell.xml"
    path.write_text(_beside(OBJECTS))
    simulation, states = read_simulation(path), _states()
    assert set(simulation.arm.joint_names) == {*JOINTS, "door"}
    assert simulation.notes == (
        "body 'crate' has a free joint: its kinematic tree is not in the comparison",
        "body 'lamp' has a ball joint: its kinematic tree is not in the comparison",
    )
    arm = without(simulation, ["door"])
    assert arm.arm.joint_names == JOINTS
    np.testing.assert_allclose(_torque(arm, states), inverse(mjcf(), *states), atol=1e-9)


def test_mended_mjcf_keeps_free_bodies_and_its_closed_loop_is_the_one_of_the_arm_alone(tmp_path: Path) -> None:
    """The crate's seven positions and six velocities stand before the arm's, and it touches the arm all the time."""
    mujoco = mujoco_or_skip()
    other = tmp_path / "other.xml"
    other.write_text(mjcf(fore_mass=2.6, damping=0.9))
    truth = read_simulation(other).model
    motions, _ = prepare([recorded(mjcf(), seconds=6.0)], JOINTS)
    found = []
    for name, objects in (("cell.xml", OBJECTS), ("alone.xml", "")):
        path = tmp_path / name
        path.write_text(_beside(objects))
        simulation = read_simulation(path)
        arm = without(simulation, [joint for joint in simulation.arm.joint_names if joint not in JOINTS])
        mended = mend(arm, path, truth, motions)
        assert mended is not None and mended.closed_loop is not None
        found.append(mended)
    for one, alone in zip(found[0].closed_loop, found[1].closed_loop):
        for joint in JOINTS:
            assert np.isfinite(alone.feedback_Nm[joint])
            assert one.feedback_Nm[joint] == pytest.approx(alone.feedback_Nm[joint], rel=1e-3)
            assert one.position[joint] == pytest.approx(alone.position[joint], rel=1e-3)
    was, now = (mujoco.MjModel.from_xml_string(text) for text in (_beside(OBJECTS), found[0].text))
    assert now.nq == was.nq and list(now.jnt_type) == list(was.jnt_type)
    for body in ("crate", "lid", "table", "lamp", "frame"):
        assert now.body(body).mass == pytest.approx(was.body(body).mass)
        np.testing.assert_allclose(now.body(body).inertia, was.body(body).inertia)


def test_spring_about_another_position_stays_where_other_joints_are_fixed(tmp_path: Path) -> None:
    mujoco_or_skip()
    path = tmp_path / "sprung.xml"
    path.write_text(_beside(OBJECTS).replace('name="elbow"', 'name="elbow" stiffness="12" springref="0.5"'))
    arm = without(read_simulation(path), ["door"])
    assert arm.model.value("k_1", "elbow") == pytest.approx(12.0)
    assert arm.model.value("offset", "elbow") == pytest.approx(-6.0)


def test_sdf_reads_back_what_the_exporter_wrote(file: Path, tmp_path: Path) -> None:
    mujoco_or_skip()
    simulation = read_simulation(file)
    motions, _ = prepare([recorded(mjcf())], JOINTS)
    written = tmp_path / "three.sdf"
    written.write_text(sdf(simulation.model, nearest(simulation.model, SDF, motions), []))
    again, states = read_simulation(written), _states()
    without_rotor = inverse(mjcf(armature=0.0), *states)
    np.testing.assert_allclose(_torque(again, states)[:, 1:], without_rotor[:, 1:], rtol=0.2, atol=0.3)
    inertials = [[joint.inertial for joint in one.arm.joints] for one in (simulation, again)]
    np.testing.assert_allclose(inertials[0], inertials[1], atol=1e-12)


PLANE = '<model name="ground_plane"><static>true</static><link name="link"/></model>'


def _models(*names: str) -> str:
    """Models of one hinge, named after the model, in a world with Gazebo's ground plane."""
    inertia = "<ixx>1</ixx><iyy>1</iyy><izz>1</izz>"
    models = "".join(
        f'<model name="{name}">'
        f'<link name="l"><inertial><mass>{mass}</mass><inertia>{inertia}</inertia></inertial></link>'
        f'<joint name="{name}_hinge" type="revolute"><parent>world</parent><child>l</child>'
        "<axis><xyz>1 0 0</xyz></axis></joint></model>"
        for mass, name in enumerate(names, start=2)
    )
    return f'<sdf version="1.9"><world name="w">{PLANE}{models}</world></sdf>'


def test_sdf_of_a_world_is_read_as_the_model_that_moves(tmp_path: Path) -> None:
    path = tmp_path / "world.sdf"
    path.write_text(_models("arm"))
    assert read_simulation(path).arm.joint_names == ("arm_hinge",)
    path.write_text(_models("door", "arm"))
    chosen = read_simulation(path, ("arm_hinge",))
    assert chosen.arm.joint_names == ("arm_hinge",)
    assert chosen.values["m[arm_hinge]"] == pytest.approx(3.0)


def test_sdf_of_several_models_that_move_is_read_as_the_one_whose_joints_differ_by_a_prefix(tmp_path: Path) -> None:
    path = tmp_path / "world.sdf"
    path.write_text(_models("door", "arm").replace('"door_hinge"', '"leaf"'))
    assert read_simulation(path, ("hinge",)).arm.joint_names == ("arm_hinge",)


@pytest.mark.parametrize("joints", [(), ("other",), ("door_hinge", "arm_hinge")])
def test_sdf_of_several_models_that_move_is_refused_with_their_names_where_none_is_the_recordings(
    tmp_path: Path, joints: tuple[str, ...]
) -> None:
    path = tmp_path / "world.sdf"
    path.write_text(_models("door", "arm"))
    with pytest.raises(UserError, match=r"door: door_hinge; arm: arm_hinge.*leave only the arm"):
        read_simulation(path, joints)


def test_urdf_takes_damping_and_friction_of_its_joints(file: Path, tmp_path: Path) -> None:
    mujoco_or_skip()
    urdf = read_simulation(file).arm.urdf
    path = tmp_path / "three.urdf"
    path.write_text(urdf.replace("</joint>", '<dynamics damping="1.5" friction="0.25"/></joint>'))
    simulation = read_simulation(path)
    assert simulation.model.value("k_v1", "elbow") == 1.5
    assert simulation.model.value("f_c", "shoulder") == 0.25
    assert simulation.body("elbow") == "fore"


def test_mended_mjcf_predicts_in_mujoco_what_the_model_predicts(file: Path, tmp_path: Path) -> None:
    """Values of another arm of the same structure, written into this file: the welded hand counts once."""
    mujoco_or_skip()
    other = tmp_path / "other.xml"
    other.write_text(mjcf(fore_mass=2.6, fore_y=0.03, damping=0.9, friction=0.3, armature=0.11))
    simulation, truth = read_simulation(file), read_simulation(other)
    motions, _ = prepare([recorded(mjcf())], JOINTS)
    mended = mend(simulation, file, truth.model, motions)
    assert mended is not None
    states = _states()
    np.testing.assert_allclose(inverse(mended.text, *states), inverse(other.read_text(), *states), atol=1e-5)
    # The torque is this file's own, not the other's: in closed loop it is this one that follows it.
    assert mended.closed_loop is not None
    right, wrong = mended.closed_loop
    for joint in JOINTS:
        assert right.feedback_Nm[joint] < 0.2 * wrong.feedback_Nm[joint]
        assert right.position[joint] < 0.2 * wrong.position[joint]


SPRING = ' stiffness="9" springref="0.3"'
SHAPES = '<geom type="box" size="0.1 0.05 0.04" pos="0.1 0 0" density="900"/>'
FINGER = """<body name="finger" pos="0 0.02 0.06">
            <joint name="finger" type="slide" axis="0 1 0" range="0 0.04" damping="5"/>
            <geom type="box" size="0.01 0.01 0.03" mass="0.05"/>
          </body></body>"""


def _rewritten(text: str, kind: str) -> str:
    """The MJCF as somebody else would write it."""
    if kind == "a spring about a position in degrees":
        text = text.replace('angle="radian"', 'angle="degree"').replace('ref="0.2"', f'ref="{np.degrees(0.2)}"')
        spring = SPRING.replace('"0.3"', f'"{np.degrees(0.3)}"')
        return text.replace('euler="0.3 0.2 0"', f'euler="{np.degrees(0.3)} {np.degrees(0.2)} 0"').replace(
            'name="elbow"', 'name="elbow"' + spring
        )
    if kind == "inertia from shapes alone":
        text = text.replace('angle="radian"', 'angle="radian" inertiafromgeom="true" settotalmass="30"')
        return re.sub("<inertial[^>]*/>", SHAPES, text)
    if kind == "fingers with shapes":
        return text.replace("</body>", FINGER, 1)
    return text


@pytest.mark.parametrize(
    "kind", ["a spring about a position in degrees", "inertia from shapes alone", "fingers with shapes"]
)
def test_mended_mjcf_is_read_again_as_the_model_however_it_is_written(tmp_path: Path, kind: str) -> None:
    mujoco = mujoco_or_skip()
    path, other = tmp_path / "three.xml", tmp_path / "other.xml"
    path.write_text(_rewritten(mjcf(), kind))
    sprung = kind if "spring" in kind else ""
    other.write_text(_rewritten(mjcf(fore_mass=2.6, damping=0.9, friction=0.3, armature=0.02), sprung))
    strange = [name for name in read_simulation(path).arm.joint_names if name not in JOINTS]
    simulation, truth = without(read_simulation(path), strange), read_simulation(other).model
    motions, _ = prepare([recorded(other.read_text())], JOINTS)
    mended = mend(simulation, path, truth, motions)
    assert mended is not None and mended.excess is not None
    np.testing.assert_allclose(mended.excess, 1.0, atol=0.01)
    model = mujoco.MjModel.from_xml_string(mended.text)
    assert model.njnt == 3 + len(strange)
    if not strange:
        states = _states()
        np.testing.assert_allclose(inverse(mended.text, *states), inverse(other.read_text(), *states), atol=1e-4)


@pytest.mark.parametrize("suffix", ["xml", "sdf"])
@pytest.mark.parametrize("had", [False, True])
def test_spring_of_an_arm_goes_into_a_file_that_has_another_or_none(tmp_path: Path, suffix: str, had: bool) -> None:
    """Friction, damping and rotor inertia of its joint stay what they are."""
    mujoco_or_skip()
    source = tmp_path / "three.xml"
    armature = {"armature": 0.0} if suffix == "sdf" else {}
    source.write_text(mjcf(**armature).replace('name="elbow"', 'name="elbow"' + SPRING * had))
    simulation, path = read_simulation(source), tmp_path / f"three.{suffix}"
    motions, _ = prepare([recorded(source.read_text())], JOINTS)
    if suffix == "sdf":
        path.write_text(sdf(simulation.model, nearest(simulation.model, SDF, motions), []))
    place = {"joint": "elbow"}
    structure = {**simulation.model.model.structure, "harness_spring": {"at": [place]}}
    structure |= {"joint_spring": {}, "torque_offset": {"joints": []}} if not had else {}
    arm = simulation.model.carried_to(TorqueModel(simulation.arm, structure))
    names = [(p.symbol, p.joint) for p in arm.model.parameters]
    values = arm.parameters.copy()
    values[names.index(("stiffness", "elbow"))], values[names.index(("preload", "elbow"))] = 4.0, -1.2
    arm = replace(arm, parameters=values)
    motions = [replace(motion, torque=arm.torque(motion) + 0.01 * motion.torque) for motion in motions]
    mended = mend(read_simulation(path), path, arm, motions)
    assert mended is not None and not mended.lost
    (tmp_path / mended.name).write_text(mended.text)
    again = read_simulation(tmp_path / mended.name).model
    stiffness, constant = (13.0, -1.2 - 9.0 * 0.3) if had else (4.0, -1.2)
    assert again.value("k_1", "elbow") == pytest.approx(stiffness, rel=1e-4)
    assert again.value("offset", "elbow") == pytest.approx(constant, rel=1e-4)
    for symbol in ("f_c", "k_v1", "J_m"):
        assert again.value(symbol, "elbow") == pytest.approx(arm.value(symbol, "elbow"), rel=1e-4, abs=1e-9)


def test_constant_torque_is_cost_where_a_format_has_no_spring_and_spoils_no_friction(file: Path) -> None:
    mujoco_or_skip()
    simulation = read_simulation(file)
    structure = {**simulation.model.model.structure, "torque_offset": {}}
    arm = simulation.model.carried_to(TorqueModel(simulation.arm, structure))
    values = arm.parameters.copy()
    values[[p.symbol == "offset" for p in arm.model.parameters]] = 7.0
    motions, _ = prepare([recorded(mjcf())], JOINTS)
    fit = nearest(replace(arm, parameters=values), MJCF, motions)
    assert fit.lost == ("torque offset",)
    for joint in JOINTS:
        assert fit.cost_Nm[joint] == pytest.approx(7.0)
        assert [fit.values[joint][name] for name in (DAMPING, FRICTION, ARMATURE)] == pytest.approx([0.6, 0.8, 0.05])


@pytest.mark.parametrize("suffix", ["urdf", "sdf"])
def test_mended_description_is_run_in_mujoco_beside_the_old_one(file: Path, tmp_path: Path, suffix: str) -> None:
    """Shapes of a URDF whose meshes are elsewhere do not keep it from that, nor that MuJoCo reads no SDF."""
    mujoco_or_skip()
    other = tmp_path / "other.xml"
    other.write_text(mjcf(fore_mass=2.6, damping=0.9, friction=0.3, armature=0.0))
    truth = read_simulation(other).model
    mesh = '<visual><geometry><mesh filename="package://nowhere/link.stl"/></geometry></visual></link>'
    path, old = tmp_path / f"three.{suffix}", read_simulation(file)
    motions, _ = prepare([recorded(other.read_text())], JOINTS)
    as_sdf = sdf(old.model, nearest(old.model, SDF, motions), [])
    path.write_text(as_sdf if suffix == "sdf" else old.arm.urdf.replace("</link>", mesh))
    simulation = read_simulation(path)
    mended = mend(simulation, path, truth, motions)
    assert mended is not None and mended.name == f"mended.{suffix}" and mended.closed_loop is not None
    was, now = mended.closed_loop
    for joint in JOINTS:
        assert now.feedback_Nm[joint] < 0.2 * was.feedback_Nm[joint]
        assert now.position[joint] < 0.2 * was.position[joint]


def test_mended_mjcf_counts_a_body_behind_a_fixed_joint_once(file: Path) -> None:
    """The elbow is not in the recordings: its bodies are the upper arm's, and weigh nothing by themselves."""
    mujoco = mujoco_or_skip()
    simulation = without(read_simulation(file), ["elbow"])
    run = recorded(mjcf())
    two = replace(
        run, joints=JOINTS[:2], position=run.position[:, :2], velocity=run.velocity[:, :2], effort=run.effort[:, :2]
    )
    motions, _ = prepare([two], JOINTS[:2])
    mended = mend(simulation, file, simulation.model, motions)
    assert mended is not None
    masses = [mujoco.MjModel.from_xml_string(text).body_mass.sum() for text in (mended.text, mjcf())]
    assert masses[0] == pytest.approx(masses[1], rel=1e-6)


@pytest.mark.parametrize("pose", [f"<pose>1 2 3 {np.pi / 2} 0 0</pose>", '<pose degrees="true">1 2 3 90 0 0</pose>'])
def test_gravity_of_an_sdf_turns_with_the_pose_of_its_model(tmp_path: Path, pose: str) -> None:
    """A quarter turn about x brings the model's y to the world's z."""
    path = tmp_path / "wall.sdf"
    path.write_text(_models("arm").replace('name="arm">', f'name="arm">{pose}'))
    np.testing.assert_allclose(read_simulation(path).arm.gravity, [0.0, -9.81, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.xml", "<html></html>", "no simulation"),
        ("a.xml", "<mujoco", "well-formed"),
        ("a.xml", '<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "DOCTYPE"),
        ("a.sdf", "<sdf version='1.9'><world name='w'/></sdf>", "no <model>"),
        ("a.sdf", f"<sdf version='1.9'><world name='w'>{PLANE}</world></sdf>", "no model of the SDF.*ground_plane"),
        ("a.sdf", _models("arm").replace("1 0 0", "0 0 0"), "axis 0 0 0: give it a direction"),
        ("a.sdf", _models("arm").replace('"l">', '"l"><pose>1 2</pose>'), "six numbers"),
        ("a.yaml", "schema: other", "schema"),
    ],
)
def test_what_is_no_simulation_is_refused_with_what_to_give(tmp_path: Path, name: str, text: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(UserError, match=said):
        read_simulation(path)


@pytest.mark.parametrize(
    ("simulated", "recorded", "found"),
    [
        (("robot0_a", "robot0_b", "robot0_finger"), ("a", "b"), [("robot0_a", "robot0_b")]),
        (("left/a", "left/b"), ("b", "a"), [("left/b", "left/a")]),
        (("a_joint", "b_joint"), ("a", "b"), [("a_joint", "b_joint")]),
        (("a", "b"), ("ur_a", "ur_b"), [("a", "b")]),
        (("left/a", "left/b", "right/a", "right/b"), ("a", "b"), [("left/a", "left/b"), ("right/a", "right/b")]),
        (("l_a", "r_b"), ("a", "b"), []),
        (("a", "p_b"), ("a", "b"), []),
        (("p_a",), ("a", "b"), []),
    ],
)
def test_affixes_are_those_by_which_all_recorded_joints_are_the_simulations(
    simulated: tuple[str, ...], recorded: tuple[str, ...], found: list[tuple[str, ...]]
) -> None:
    assert [tuple(one.own(joint) for joint in recorded) for one in affixes(simulated, recorded)] == found


def test_renamed_simulation_has_the_same_torque_and_its_names_back(file: Path) -> None:
    mujoco_or_skip()
    file.write_text(mjcf().replace('name="elbow"', 'name="elbow" stiffness="12" springref="0.5"'))
    simulation, names = read_simulation(file), {"elbow": "e", "shoulder": "s"}
    other = renamed(simulation, names)
    assert other.arm.joint_names == ("base_turn", "s", "e")
    assert other.body("e") == "fore" and {part.joint for part in other.parts} == {"base_turn", "s", "e"}
    assert other.model.value("offset", "e") == simulation.model.value("offset", "elbow") != 0.0
    states = _states()
    np.testing.assert_array_equal(_torque(other, states), _torque(simulation, states))
    back = renamed(without(other, ["s"]), {new: old for old, new in names.items()})
    assert back.arm.joint_names == ("base_turn", "elbow") and back.arm.locked == ("shoulder",)


def test_recording_without_noise_is_a_simulators_and_one_with_noise_is_not() -> None:
    mujoco_or_skip()
    assert noise_free(recorded(mjcf(), noise_Nm=0.0))
    assert not noise_free(recorded(mjcf(), noise_Nm=0.02))
    frozen = recorded(mjcf(), noise_Nm=0.0)
    held = np.repeat(frozen.effort[::5], 5, axis=0)[: len(frozen.time)]
    assert not noise_free(replace(frozen, effort=held))


def test_what_a_simulation_with_fixed_joints_has_no_place_for_is_named() -> None:
    """Quadratic friction and an offset of the shoulder, and friction of the elbow, which is fixed."""
    known = small_arm.identified()
    quadratic = {
        **known.model.structure,
        "viscous_friction": {"vacuum": False},
        "torque_offset": {"joints": ["shoulder"]},
    }
    model = TorqueModel(known.model.arm, quadratic)
    size = {"offset": 0.3, "k_v2": 0.2, "k_v3": 0.0}
    values = [size[p.symbol] if p.symbol in size else known.value(p.symbol, p.joint) for p in model.parameters]
    identified = IdentifiedModel(model, np.array(values), np.zeros(len(model.constants)))
    fixed = without(Simulation(identified, "model", "model.yaml"), ["elbow"])
    assert fixed.notes == (
        "not in the recordings, and taken as fixed: elbow",
        "left out of the model with the joints taken as fixed: k_v2[shoulder], offset[shoulder]",
    )
    plain = without(Simulation(known, "model", "model.yaml"), ["elbow"])
    assert plain.notes == ("not in the recordings, and taken as fixed: elbow",)
