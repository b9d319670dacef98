"""The simulator of the blind series against closed forms and MuJoCo's inverse dynamics."""

import struct
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from bench.blind_layers import sizes
from bench.blind_layers.arms import MODELS, arms, true_model, urdf_of
from bench.blind_layers.bags import joint_state, write_bag
from bench.blind_layers.laws import added_torque, friction_level, lugre
from bench.blind_layers.motion import excitation, rigid_torque
from bench.blind_layers.plant import FRICTION_TIME_s, Noise, simulate

pytestmark = pytest.mark.skipif(not (MODELS / "ur5e.xml").exists(), reason=f"the models are not in {MODELS}")


MOVING = 0.02
"""rad/s above which dry friction has its level."""
STEP_s = 0.5e-3
"""The integrator's step where no joint is elastic."""


def _run(name, laws, payload=None, seconds=7.0, noise=0.0):
    arm = arms()[name]
    table = arm.table()
    if arm.urdf:
        for i, joint in enumerate(arm.joints):
            table["joints"][joint]["armature"] = float(arm.armature[i])
    rng = np.random.default_rng(3)
    model = true_model(arm, table)
    reference = excitation(arm, model, rng, seconds)
    level = np.full(len(arm.joints), noise)
    run = simulate(arm, table, laws, reference, Noise(2.0**20, 3e-6, 2e-3, level, level), rng, model)
    model.dof_solref[:] = (FRICTION_TIME_s, 1.0)
    rows = np.flatnonzero((np.abs(run.v) > MOVING).all(axis=1))[::3]
    part = replace(run, **{f.name: getattr(run, f.name)[..., rows, :] for f in fields(run) if f.name != "t"})
    # A recorded position lies half a step of the integrator after the velocity `v`.
    damped = model.dof_damping * 0.5 * STEP_s * part.a
    return arm, run, part, rigid_torque(model, mujoco.MjData(model), part.q, part.v, part.a) + damped


@pytest.mark.parametrize("name", ["ur5e", "iiwa14", "panda"])
def test_torque_is_mj_inverse_of_the_motion_where_nothing_is_added(name):
    _, _, run, inverse = _run(name, [])
    assert np.abs(run.torque - inverse).max() < 1e-6


def test_rotor_inertia_that_least_squares_finds_in_recorded_positions_is_the_table_s():
    arm = arms()["ur5e"]
    table = arm.table()
    for joint in table["joints"].values():
        joint["frictionloss"] = 0.0
    model, n, rng = true_model(arm, table), len(arm.joints), np.random.default_rng(1)
    reference = excitation(arm, model, rng, 7.0)
    quiet = Noise(2.0**30, 0.0, 0.0, np.zeros(n), np.zeros(n))
    run = simulate(arm, table, [], reference, quiet, rng, model)
    v = np.gradient(run.q, 1e-3, axis=0)
    a = np.gradient(v, 1e-3, axis=0)
    rest = run.torque - rigid_torque(model, mujoco.MjData(model), run.q, v, a)
    for j, name in enumerate(arm.joints):
        # Half a control period and half a step pass before a torque has acted.
        columns = sizes.low_pass(
            np.stack([a[:, j], v[:, j], np.gradient(run.torque[:, j], 1e-3)], axis=1), 1000.0, 20.0
        )
        found = np.linalg.lstsq(columns[200:-200], sizes.low_pass(rest, 1000.0, 20.0)[200:-200, j], rcond=None)[0]
        assert abs(found[0]) < 0.2 * STEP_s * float(table["joints"][name]["damping"])


def test_torque_lacks_exactly_the_added_torque_when_a_ripple_and_a_spring_are_added():
    laws = [
        {"effect": "torque_ripple", "joint": 1, "amplitude": 2.0, "cycles": 24, "phase": 0.3},
        {"effect": "harness_spring", "joint": 3, "stiffness": 0.8, "rest": 0.1},
    ]
    _, _, run, inverse = _run("ur5e", laws)
    assert np.abs(run.torque + run.added.sum(0) - inverse).max() < 1e-6
    expected = 2.0 * np.sin(24 * run.q[:, 1] + 0.3)
    assert np.allclose(run.added[0, :, 1], expected)
    assert np.allclose(run.added[1, :, 3], -0.8 * (run.q[:, 3] - 0.1))


def test_friction_of_the_stribeck_law_holds_where_the_joint_moves():
    law = {"effect": "stribeck", "joint": 2, "height": 4.0, "speed": 0.2}
    _, _, run, inverse = _run("ur5e", [law])
    extra = (run.torque - inverse)[:, 2]
    expected = 4.0 * np.exp(-((run.v[:, 2] / 0.2) ** 2)) * np.sign(run.v[:, 2])
    assert np.abs(extra - expected).max() < 0.05


def test_contact_adds_the_jacobian_transpose_of_its_force():
    law = {"effect": "external_contact", "joint": 0, "force": [10.0, -5.0, 20.0], "start": 2.0, "length": 1.5}
    _, _, run, inverse = _run("iiwa14", [law])
    assert np.abs(run.added).max() > 1.0
    assert np.abs(run.torque + run.added.sum(0) - inverse).max() < 1e-6


def test_deflection_of_an_elastic_joint_is_the_load_over_the_stiffness_at_rest():
    law = {"effect": "joint_elasticity", "joint": 1, "stiffness": 5000.0, "damping": 20.0}
    arm, run, *_ = _run("ur5e", [law])
    rigid = true_model(arm, arm.table())
    rigid.dof_frictionloss[:] = 0.0
    rest = run.q[-1:].copy()
    # The link sags by load / K: gravity at the sagged pose, found by iteration, must be what the gear carries.
    pose = rest.copy()
    for _ in range(30):
        load = rigid_torque(rigid, mujoco.MjData(rigid), pose, pose * 0, pose * 0)[0, 1]
        pose[0, 1] = rest[0, 1] - load / 5000.0
    assert abs(run.torque[-200:, 1].mean() - load) < 8.0 + 0.1  # within Coulomb friction
    assert abs(load) > 10.0


def test_lugre_is_coulomb_in_steady_sliding_and_a_spring_at_small_displacement():
    law = {"level": 3.0, "sigma": 1500.0, "micro": 0.0}
    z = 0.0
    for _ in range(4000):
        z, torque = lugre(law, z, 0.1, 1e-3)
    assert torque == pytest.approx(-3.0, rel=1e-6)
    z = 0.0
    for _ in range(100):
        z, torque = lugre(law, z, 1e-4, 1e-4)
    assert torque == pytest.approx(-1500.0 * 1e-6, rel=1e-2)


def test_friction_levels_have_their_closed_forms():
    def level(law, v=1.0, load=10.0, celsius=40.0):
        return friction_level(law, 5.0, np.pi / 2, v, load, celsius)

    assert level({"effect": "stribeck", "height": 2.0, "speed": 0.1}, v=0.1) == pytest.approx(5 + 2 / np.e)
    assert level({"effect": "asymmetric_friction", "share": 0.2}) == pytest.approx(6.0)
    assert level({"effect": "asymmetric_friction", "share": 0.2}, v=-1.0) == pytest.approx(4.0)
    assert level({"effect": "load_friction", "mu": 0.1}, load=-10.0) == pytest.approx(6.0)
    assert level({"effect": "temperature_friction", "coulomb_per_C": 0.01}) == pytest.approx(4.5)
    assert level({"effect": "position_friction", "share": 0.3, "phase": 0.0}) == pytest.approx(6.5)
    detent = {"effect": "absent:detent", "amplitude": 2.0, "rest": 0.0, "width": 0.1}
    assert added_torque(detent, 0.1, 0.0, 0.0) == pytest.approx(2.0)


def test_effort_noise_is_what_the_answer_states():
    _, _, run, inverse = _run("panda", [], noise=0.2)
    assert np.abs(run.torque - inverse).max() < 1e-6
    assert np.std(run.effort - run.torque) == pytest.approx(0.2 * np.sqrt(2), rel=0.03)


@pytest.mark.parametrize("name", ["ur5e", "iiwa14", "panda"])
def test_robot_description_has_the_inverse_dynamics_of_the_simulation(name):
    arm = arms()[name]
    table = arm.table()
    for joint in table["joints"].values():
        joint.update(armature=0.0, damping=0.0, frictionloss=0.0)
    a, b = true_model(arm, table), mujoco.MjModel.from_xml_string(urdf_of(arm, table))
    b.dof_damping[:] = b.dof_frictionloss[:] = 0.0
    rng = np.random.default_rng(0)
    q = rng.uniform(arm.lower, arm.upper, (20, len(arm.joints)))
    v, acc = rng.normal(size=(2, *q.shape))
    expected = rigid_torque(a, mujoco.MjData(a), q, v, acc)
    assert np.allclose(expected, rigid_torque(b, mujoco.MjData(b), q, v, acc), atol=1e-7)


@pytest.mark.parametrize("name", ["ur5e", "iiwa14", "panda"])
def test_written_file_holds_the_parameters_of_the_table(name):
    arm = arms()[name]
    table = arm.table()
    table["bodies"][arm.bodies[2]] = {"mass": 1.25, "com": [0.01, 0.02, 0.03]}
    table["joints"][arm.joints[1]].update(damping=3.5, frictionloss=2.5)
    model = mujoco.MjModel.from_xml_string(arm.write(table))
    assert model.body(arm.bodies[2]).mass[0] == pytest.approx(1.25)
    assert model.body(arm.bodies[2]).ipos == pytest.approx([0.01, 0.02, 0.03])
    dof = model.joint(arm.joints[1]).dofadr[0]
    assert (model.dof_damping[dof], model.dof_frictionloss[dof]) == pytest.approx((3.5, 2.5))


def test_regressor_spans_every_parameter_and_a_ripple_stays():
    arm = arms()["iiwa14"]
    model = true_model(arm, arm.table())
    q, v, a = excitation(arm, model, np.random.default_rng(1), 20.0)[:, 1100:18000:60]
    weight = np.ones(7)
    space = sizes.basis(sizes.regressor(true_model(arm, arm.table()), q, v, a), weight)
    model.dof_frictionloss[:] = 0.0
    own = rigid_torque(model, mujoco.MjData(model), q, v, a)
    assert sizes.size(space, own, weight).max() < 1e-6
    ripple = np.zeros_like(q)
    ripple[:, 4] = np.sin(50 * q[:, 4])
    assert sizes.size(space, ripple, weight)[4] > 0.5


def test_joint_state_is_laid_out_as_cdr():
    raw = joint_state(1_500_000_000, ("a", "bcd"), np.array([1.0, 2.0]), np.zeros(0), np.array([3.0, 4.0]))
    assert raw[:4] == b"\0\1\0\0" and struct.unpack_from("<iI", raw, 4) == (1, 500_000_000)
    assert raw.endswith(struct.pack("<dd", 3.0, 4.0))


def test_bag_reads_back_with_another_library(tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    arm = arms()["ur5e"]
    t = np.arange(50) / 200.0
    q = np.random.default_rng(0).normal(size=(50, 6))
    write_bag(tmp_path / "a.mcap", arm.joints, t, q, None, 2 * q, urdf_of(arm, arm.table()), q, q + 30.0)
    messages = list(reader.read_ros2_messages(str(tmp_path / "a.mcap")))
    states = [m.ros_msg for m in messages if m.channel.topic == "/joint_states"]
    assert np.allclose([m.position for m in states], q) and np.allclose([m.effort for m in states], 2 * q)
    assert len(states[0].velocity) == 0 and tuple(states[0].name) == arm.joints
    warm = [m.ros_msg for m in messages if m.channel.topic == "/joint_temperatures"]
    assert warm[0].header.frame_id == arm.joints[0] and warm[0].temperature == pytest.approx(q[0, 0] + 30.0)
