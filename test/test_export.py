"""Exports against what they are exported from: MuJoCo, Pinocchio, usd-core and compiled C on the same motion."""

from __future__ import annotations

import importlib.util
import json
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import made_result
import numpy as np
import pinocchio as pin
import pytest
import small_arm
from exported_code import Library, module_of
from mujoco_arm import inverse_in_mujoco

from spacearm_ident.cli.main import main
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import Coupling, arm_from_urdf, load_arm
from spacearm_ident.dynamics.effects.position import HarnessSpring
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, Unbounded
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.dynamics.regressor import regressor
from spacearm_ident.errors import UserError
from spacearm_ident.export.controller import ZERO_SPEED, code_cost, control_law
from spacearm_ident.export.frames import rpy
from spacearm_ident.export.law import SLOW_SHARE, nearest
from spacearm_ident.export.mjcf import mjcf
from spacearm_ident.export.motion import motions_of, sweep
from spacearm_ident.export.write import FORMATS, export_model
from spacearm_ident.recording import read_recording
from spacearm_ident.results.formats import MJCF, SDF, URDF
from spacearm_ident.signals.prepare import prepare

UR10E = Path(__file__).parents[2] / "shared" / "recordings" / "real" / "ur10e" / "commissioning_validation.mcap"


def paper() -> IdentifiedModel:
    return load_model(config_path("paper_arm_model.yaml"))


def rich() -> IdentifiedModel:
    """A turning and a sliding joint with every term that a controller's law has, none of them zero."""
    arm = made_result.arm()
    names = arm.joint_names
    arm = replace(
        arm, couplings=(Coupling("motor", {names[0]: 1.0, names[1]: 0.5}),), gravity=np.array([0.5, 1.0, -9.0])
    )
    structure = {
        "rigid_body": {},
        "rotor_inertia": {},
        "joint_spring": {},
        "stribeck_friction": {"load": True},
        "viscous_friction": {"quadratic": {names[0]: "odd"}, "fastest": {names[1]: 0.1}},
        "coupled_motor": {},
        "torque_offset": {"joints": [names[1]]},
    }
    model = TorqueModel(arm, structure)
    levels = {"J_m": 0.3, "k_1": 2.0, "f_c": 3.0, "f_b": 4.5, "mu": 0.05, "k_v1": 1.5, "k_v2": 0.7, "k_v3": 0.4}
    levels["offset"] = 0.9
    values = [levels.get(p.symbol, p.prior) for p in model.parameters]
    constants = [{"v_b": 0.05, "d_s": 0.0}[c.symbol] for c in model.constants]
    return IdentifiedModel(model, np.array(values), np.array(constants), 10.0)


def states(model: IdentifiedModel, count: int = 60) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(3)
    return tuple(rng.uniform(-1.0, 1.0, (count, len(model.model.arm.joints))) * size for size in (2.0, 1.5, 4.0))


def torque_at(model: IdentifiedModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """The model's torque state by state."""
    motion = replace(
        sweep(model.model.arm), position=q, velocity=qd, acceleration=qdd, torque=np.zeros_like(q), rate_hz=1e-9
    )
    return model.torque(motion)


# --- code ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[paper, rich], ids=["paper", "rich"])
def compiled(request, tmp_path_factory):
    """A model, and its exported C."""
    model = request.param()
    return model, Library(model, None, tmp_path_factory.mktemp("c"))


def test_c_has_the_model_s_torque_and_regressor(compiled):
    model, library = compiled
    n = len(model.model.arm.joints)
    q, qd, qdd = states(model)
    expected = torque_at(model, q, qd, qdd)
    whole = regressor(model.model.arm, q, qd, qdd)
    for k in range(len(q)):
        torque = library.call("torque", (n,), q[k], qd[k], qdd[k])
        assert np.abs(torque - expected[k]).max() < 1e-10 * max(1.0, np.abs(expected[k]).max())
        matrix = library.call("regressor", (n, 10 * n), q[k], qd[k], qdd[k])
        assert np.abs(matrix - whole[k]).max() < 1e-10


def test_c_and_numpy_agree_everywhere_and_on_friction_at_zero_speed(compiled, tmp_path):
    model, library = compiled
    n = len(model.model.arm.joints)
    module = module_of(model, None, "numpy", tmp_path)
    q, qd, qdd = states(model)
    assert np.abs(module.torque(q, qd, qdd) - torque_at(model, q, qd, qdd)).max() < 1e-10 * 100
    assert np.abs(module.regressor(q, qd, qdd) - regressor(model.model.arm, q, qd, qdd)).max() < 1e-10
    for k, speed in enumerate((1.0, 0.3 * ZERO_SPEED, 0.0)):
        one = q[k], speed * np.sign(qd[k])
        ours, theirs = library.call("friction", (n,), *one, -1.0), module.friction(*one)
        assert np.abs(ours - theirs).max() < 1e-10
        assert np.abs(library.call("gravity", (n,), one[0]) - module.gravity(one[0])).max() < 1e-9
    assert np.all(ours == 0.0)


@pytest.fixture(scope="module", params=[paper, rich], ids=["paper", "rich"])
def in_casadi(request, tmp_path_factory):
    """A model, and its exported module of CasADi functions."""
    pytest.importorskip("casadi", reason="needs casadi")
    model = request.param()
    return model, module_of(model, None, "casadi", tmp_path_factory.mktemp("casadi"))


def test_casadi_has_the_model_s_torque_gravity_friction_and_regressor(in_casadi, tmp_path):
    model, module = in_casadi
    other = module_of(model, None, "numpy", tmp_path)
    q, qd, qdd = states(model, 20)
    expected = torque_at(model, q, qd, qdd)
    whole = regressor(model.model.arm, q, qd, qdd)
    for k in range(len(q)):
        slow = qd[k] * 0.003
        torque = np.array(module.torque(q[k], qd[k], qdd[k])).ravel()
        assert np.abs(torque - expected[k]).max() < 1e-10 * max(1.0, np.abs(expected[k]).max())
        assert np.abs(np.array(module.regressor(q[k], qd[k], qdd[k])) - whole[k]).max() < 1e-10
        assert np.abs(np.array(module.gravity(q[k])).ravel() - other.gravity(q[k])).max() < 1e-9
        friction = np.array(module.friction(q[k], slow, 0.0)).ravel()
        assert np.abs(friction - other.friction(q[k], slow)).max() < 1e-10
    assert np.all(np.array(module.friction(q[0], np.zeros_like(q[0]), 0.0)) == 0.0)


def test_casadi_s_smooth_torque_has_the_slope_of_its_finite_differences_at_a_reversal(in_casadi):
    import casadi

    model, module = in_casadi
    n = len(model.model.arm.joints)
    q, qd = np.linspace(0.2, 0.8, n), np.zeros(n)
    symbols = [casadi.SX.sym(name, n) for name in ("q", "qd", "qdd")]
    slope = casadi.Function("slope", symbols, [casadi.jacobian(module.smooth_torque(*symbols, 0.05), symbols[1])])
    exact = np.array(slope(q, qd, np.zeros(n)))
    step = 1e-6
    for k in range(n):
        ends = [np.array(module.smooth_torque(q, sign * step * np.eye(n)[k], np.zeros(n), 0.05)) for sign in (1, -1)]
        assert exact[:, k] == pytest.approx(((ends[0] - ends[1]) / (2 * step)).ravel(), rel=1e-5, abs=1e-5)
    fast = np.full(n, 1.0)
    sharp, smooth = module.torque(q, fast, qd), module.smooth_torque(q, fast, qd, 0.05)
    assert np.abs(np.array(sharp - smooth)).max() < 1e-9


def test_friction_compensation_is_continuous_and_whole_beyond_its_zero_speed(compiled):
    model, library = compiled
    n = len(model.model.arm.joints)
    q, still = np.zeros(n), np.zeros(n)
    for speed in (0.02, -0.5):
        qd = np.full(n, speed)
        moving = torque_at(model, q[None], qd[None], still[None])[0]
        holding = library.call("gravity", (n,), q)
        # Gyroscopic torques of 0.5 rad/s stand between, in the friction that grows with the load as well.
        rigid = model.model.torque(
            replace(sweep(model.model.arm), position=q[None], velocity=qd[None], acceleration=still[None]),
            model.parameters,
            model.constants,
            ("rigid_body", "joint_spring", "torque_offset"),
        )[0]
        friction = library.call("friction", (n,), q, qd, 0.01)
        assert np.abs(friction - (moving - rigid)).max() < 0.06 * np.abs(rigid - holding).max() + 1e-9
    below, above = (library.call("friction", (n,), q, np.full(n, 0.01 + d), 0.01) for d in (-1e-9, 1e-9))
    assert np.abs(below - above).max() < 1e-5


def test_what_the_law_has_no_place_for_is_left_out_and_priced():
    model = paper()
    wider = TorqueModel(model.model.arm, {**model.model.structure, "torque_ripple": {"at": [{"joint": "joint_3"}]}})
    more = len(wider.parameters) - len(model.parameters), len(wider.constants) - len(model.constants)
    rippled = replace(
        model,
        model=wider,
        parameters=np.concatenate([model.parameters, np.full(more[0], 1.0)]),
        constants=np.concatenate([model.constants, np.full(more[1], 24.0)]),
    )
    law = control_law(rippled)
    assert np.array_equal(law.joints, control_law(model).joints)
    cost = code_cost(rippled, law, [sweep(model.model.arm)])
    assert cost.cost_Nm["joint_3"] > 0.3 and cost.cost_Nm["joint_2"] == 0.0 and cost.lost


@pytest.mark.parametrize("form", [MJCF, SDF, URDF])
def test_a_spring_that_pulls_beyond_a_position_is_left_out_and_priced(form):
    """No format has one; a linear spring of its stiffness would pull over the whole range."""
    model = paper()
    place = {"joint": "joint_3", "side": "above"}
    wider = TorqueModel(model.model.arm, {**model.model.structure, "harness_spring": {"at": [place]}})
    taut = replace(
        model,
        model=wider,
        parameters=np.append(model.parameters, 40.0),
        constants=np.append(model.constants, 0.1),
    )
    motions = [sweep(model.model.arm)]
    assert np.any(motions[0].position[:, 2] > 0.2)
    before, after = (nearest(one, form, motions) for one in (model, taut))
    if form is not URDF:
        assert after.values["joint_3"]["stiffness"] == before.values["joint_3"]["stiffness"]
    assert set(after.lost) - set(before.lost) == {HarnessSpring.beyond}
    assert after.cost_Nm["joint_3"] > before.cost_Nm["joint_3"] + 1.0
    assert after.cost_Nm["joint_2"] == before.cost_Nm["joint_2"]


# --- simulators ---------------------------------------------------------------------------------------------


def rms_moving(values: np.ndarray, motion) -> np.ndarray:
    moving = np.abs(motion.velocity) > SLOW_SHARE * np.abs(motion.velocity).max(axis=0)
    return np.array([np.sqrt(np.mean(values[moving[:, k], k] ** 2)) for k in range(values.shape[1])])


def require_stated_cost(model: IdentifiedModel, motion, fit, path: Path, slack: float) -> None:
    """MuJoCo is as far from the model as was stated, but for a share of the torque."""
    expected = model.torque(motion)
    distance = rms_moving(inverse_in_mujoco(path, motion) - expected, motion)
    cost = np.array(list(fit.cost_Nm.values()))
    size = rms_moving(expected, motion)
    assert np.all(distance <= cost + slack * size), (distance, cost, size)
    assert np.all(distance >= cost - slack * size), (distance, cost, size)


def test_mujoco_s_forward_dynamics_gives_the_motion_back_from_the_exported_law(tmp_path):
    """Bodies, armature, damping and friction loss, written here, drive the exported arm along the motion of the fit."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco")
    model = small_arm.identified()
    arm, motion = model.model.arm, sweep(model.model.arm)
    fit, _ = export_model(model, None, "mjcf", tmp_path / "arm.xml", "a test")
    values = {key: np.array([fit.values[joint][key] for joint in arm.joint_names]) for key in fit.values["elbow"]}
    bodies = TorqueModel(arm, {"rigid_body": {}})
    inertials = np.array([model.value(p.symbol, p.joint) for p in bodies.parameters])
    torque = bodies.torque(motion, inertials, np.zeros(0)) + values["armature"] * motion.acceleration
    torque += values["damping"] * motion.velocity + values["friction"] * np.sign(motion.velocity)
    simulated = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    simulated.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data, found = mujoco.MjData(simulated), np.empty_like(torque)
    for k in range(len(torque)):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = motion.position[k], motion.velocity[k], torque[k]
        mujoco.mj_forward(simulated, data)
        found[k] = data.qacc
    left = rms_moving(found - motion.acceleration, motion) / rms_moving(motion.acceleration, motion)
    assert np.all(left < 0.05), left  # friction loss is a soft constraint there


@pytest.mark.parametrize("model", [paper(), rich()], ids=["paper", "rich"])
def test_mujoco_is_off_by_the_stated_cost_on_the_motion_of_the_fit(model, tmp_path):
    fit, _ = export_model(model, None, "mjcf", tmp_path / "arm.xml", "a test")
    require_stated_cost(model, sweep(model.model.arm), fit, tmp_path / "arm.xml", 0.002)


def test_mujoco_is_off_by_the_stated_cost_on_a_recorded_motion(tmp_path):
    """The UR10e's own bodies of the CAD with friction as it has it; the motion is recorded."""
    if not UR10E.exists():
        pytest.skip("no ur10e/commissioning_validation.mcap in ../shared/recordings/real")
    run = read_recording(UR10E)
    arm = arm_from_urdf(run.urdf)
    model = TorqueModel(arm, {"rigid_body": {}, "rotor_inertia": {}, "stribeck_friction": {}, "viscous_friction": {}})
    levels = {"J_m": 0.5, "f_c": 4.0, "f_b": 6.0, "k_v1": 5.0, "k_v2": 0.3, "k_v3": -0.5}
    values = [levels.get(p.symbol, p.prior) for p in model.parameters]
    constants = [{"v_b": 0.05, "d_s": 0.0}[c.symbol] for c in model.constants]
    known = IdentifiedModel(model, np.array(values), np.array(constants), 10.0)
    motions, _ = prepare([run.between(0.0, 30.0)], arm.joint_names, 10.0)
    fit = nearest(known, MJCF, motions)
    (tmp_path / "arm.xml").write_text(mjcf(known, fit, []))
    for motion in motions[:1]:
        expected = known.torque(motion)
        distance = rms_moving(inverse_in_mujoco(tmp_path / "arm.xml", motion) - expected, motion)
        cost = np.array(list(fit.cost_Nm.values()))
        assert np.all(distance < cost + 0.02 * rms_moving(expected, motion))


def test_the_bodies_of_every_simulator_are_the_identified_ones(tmp_path):
    """Gravity and inertia without friction: MuJoCo, and Pinocchio by the URDF, against our regressor."""
    model = rich()
    bare = {"rigid_body": {}}
    rigid = TorqueModel(model.model.arm, bare)
    known = IdentifiedModel(rigid, np.array([p.prior for p in rigid.parameters]), np.zeros(0))
    motion = sweep(known.model.arm)
    expected = known.torque(motion)
    export_model(known, None, "urdf", tmp_path / "arm.urdf", "a test")
    read = pin.buildModelFromXML((tmp_path / "arm.urdf").read_text())
    read.gravity.linear = known.model.arm.gravity
    data = read.createData()
    rnea = np.array(
        [pin.rnea(read, data, *state) for state in zip(motion.position, motion.velocity, motion.acceleration)]
    )
    assert np.abs(rnea - expected).max() < 1e-9
    export_model(known, None, "mjcf", tmp_path / "arm.xml", "a test")
    assert np.abs(inverse_in_mujoco(tmp_path / "arm.xml", motion) - expected).max() < 1e-8


def test_parameters_are_refitted_not_cut_off():
    """Friction that rises with speed squared goes into damping: nearer than k_v1 alone would be."""
    model = paper()
    fit = nearest(model, MJCF, motions_of(model, None))
    motion = sweep(model.model.arm)
    for k, joint in enumerate(model.model.arm.joint_names):
        rest = (model.torque(motion) - model.torque(motion, ("rigid_body",)))[:, k]
        cut = model.value("J_m", joint) * motion.acceleration[:, k] + model.value("k_v1", joint) * motion.velocity[:, k]
        cut += model.value("f_c", joint) * np.sign(motion.velocity[:, k])
        assert fit.cost_Nm[joint] < rms_moving(np.tile((rest - cut)[:, None], 6), motion)[k]


def test_sdf_and_ros2_control_tags_name_every_joint(tmp_path):
    model = rich()
    names = set(model.model.arm.joint_names)
    fit, _ = export_model(model, None, "sdf", tmp_path / "arm.sdf", "a test")
    joints = {joint.get("name"): joint for joint in ET.parse(tmp_path / "arm.sdf").iter("joint")}
    assert names <= set(joints)
    assert all(float(joints[name].find("axis/dynamics/damping").text) == fit.values[name]["damping"] for name in names)
    assert {joints[name].get("type") for name in names} == {"revolute", "prismatic"}
    assert "rotor inertia J_m" in fit.lost
    export_model(small_arm.identified(), None, "urdf", tmp_path / "arm.urdf", "a test")
    control = ET.parse(tmp_path / "arm.urdf").getroot().find("ros2_control")
    assert {joint.get("name") for joint in control.findall("joint")} == set(small_arm.JOINTS)


def test_mjcf_s_actuators_turn_current_into_torque_where_drives_are_known_and_take_torque_else(tmp_path):
    """Of 0.5 of its range the actuator of a joint gives 0.5 of the joint's limit, in A with --arm, in N m without."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco")
    arm = load_arm(config_path("paper_arm.yaml"))
    words = ["export", str(config_path("paper_arm_model.yaml")), "--to", "mjcf", "--out"]
    assert main([*words, str(tmp_path / "torque.xml")]) == 0
    assert main([*words, str(tmp_path / "current.xml"), "--arm", str(config_path("paper_arm.yaml"))]) == 0
    gains = np.array([joint.gear_ratio * joint.torque_constant for joint in arm.joints])
    limits = np.array([joint.effort_limit for joint in paper().model.arm.joints])
    assert np.isfinite(limits).all() and np.all(gains > 1.0)
    for name, gain in (("torque", np.ones(6)), ("current", gains)):
        model = mujoco.MjModel.from_xml_path(str(tmp_path / f"{name}.xml"))
        data = mujoco.MjData(model)
        data.ctrl[:] = 0.5 * limits / gain
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator == pytest.approx(0.5 * limits, rel=1e-12)
        data.ctrl[:] = 10.0 * limits / gain
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator == pytest.approx(limits, rel=1e-12)


def test_drives_of_another_arm_are_refused_and_nothing_written(tmp_path, capsys):
    save_model(small_arm.identified(), tmp_path / "model.yaml")
    words = ["export", str(tmp_path / "model.yaml"), "--to", "mjcf", "--out", str(tmp_path / "arm.xml")]
    assert main([*words, "--arm", str(config_path("paper_arm.yaml"))]) == 2
    assert "no joint 'shoulder'" in capsys.readouterr().err and not (tmp_path / "arm.xml").exists()


def test_usd_holds_the_bodies_and_joints(tmp_path):
    pytest.importorskip("pxr", reason="needs usd-core")
    from pxr import Usd, UsdPhysics

    model = rich()
    fit, _ = export_model(model, None, "usd", tmp_path / "arm.usda", "a test")
    stage = Usd.Stage.Open(str(tmp_path / "arm.usda"))
    masses = [
        UsdPhysics.MassAPI(prim).GetMassAttr().Get() for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.MassAPI)
    ]
    expected = [model.value("m", joint) for joint in model.model.arm.joint_names]
    assert masses == pytest.approx(expected, rel=1e-6)
    turn = next(prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.RevoluteJoint))
    values = fit.values[turn.GetName()]
    assert turn.GetAttribute("physxJoint:armature").Get() == pytest.approx(values["armature"], rel=1e-6)
    assert UsdPhysics.RevoluteJoint(turn).GetUpperLimitAttr().Get() == pytest.approx(np.degrees(2.5), rel=1e-6)


def test_the_physically_consistent_values_are_exported_and_the_rest_priced(tmp_path):
    model = small_arm.identified()
    free = np.array(model.parameters)
    free[0] = -50.0
    blended = replace(model, unbounded=Unbounded(free, np.array([0.3, 0.3])))
    one, _ = export_model(model, None, "mjcf", tmp_path / "one.xml", "a test")
    other, _ = export_model(blended, None, "mjcf", tmp_path / "other.xml", "a test")
    assert one.values == other.values
    assert "without physical bounds" in " ".join(other.lost)
    assert max(other.cost_Nm.values()) >= max(one.cost_Nm.values())


def test_a_body_that_cannot_be_is_refused_and_nothing_written(tmp_path):
    model = small_arm.identified()
    values = np.array(model.parameters)
    values[0] = -1.0
    with pytest.raises(UserError, match="no positive mass"):
        export_model(replace(model, parameters=values), None, "mjcf", tmp_path / "arm.xml", "a test")
    assert not list(tmp_path.iterdir())


def test_the_command_exports_a_model_file_in_every_format(tmp_path, capsys):
    save_model(small_arm.identified(), tmp_path / "model.yaml")
    for form in FORMATS:
        if form == "thresholds":  # of held-out motion, which a model file has not: test_thresholds.py
            continue
        if form == "usd" and importlib.util.find_spec("pxr") is None:
            continue
        suffix = {"usd": "usda", "numpy": "py", "casadi": "py", "mjcf": "xml"}.get(form, form)
        out = tmp_path / form / f"arm.{suffix}"
        assert main(["export", str(tmp_path / "model.yaml"), "--to", form, "--out", str(out), "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert all(Path(file).stat().st_size for file in said["files"]) and set(said["cost_Nm"]) == set(
            small_arm.JOINTS
        )
    assert main(["export", str(tmp_path / "gone"), "--to", "mjcf", "--out", str(tmp_path / "x.xml")]) == 2


def test_a_format_that_holds_the_whole_model_states_no_cost_of_rounding():
    model = small_arm.identified()
    said = nearest(model, MJCF, motions_of(model, None)).lines()
    assert said == ["mjcf holds every term of this model", "  its torque is the model's at every joint"]
    model = rich()
    said = nearest(model, MJCF, motions_of(model, None)).lines()
    assert said[0].startswith("mjcf does not hold: ") and sum("costs" in line for line in said) == 2


def test_a_joint_turned_up_by_a_quarter_turn_is_written_without_a_warning():
    rotation = pin.rpy.rpyToMatrix(0.3, np.pi / 2, -0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        angles = rpy(rotation)
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(angles), rotation, atol=1e-7)
