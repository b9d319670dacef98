"""Concealed physics against closed forms and conservation laws."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from contract import CONTRACT
from simulated_arm import CONFIG, paper_arm, paper_drives

from spacearm_ident.cli.main import main
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import Motion, Quintic, Rest, Trajectory
from spacearm_ident.recording import read_recording
from spacearm_ident.simulation.closed_loop import SETTLE_S, Truth, simulate_truth
from spacearm_ident.simulation.concealed import EFFECTS, Concealment, concealed_from_dict, load_concealed, make_effect
from spacearm_ident.simulation.concealed.effect import State
from spacearm_ident.simulation.mechanism import rigid_body_model
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.servo import DriveData
from spacearm_ident.simulation.thermal import ThermalParameters

MASS, LENGTH, G, ROTOR = 2.0, 0.5, 9.81, 0.3
INERTIA = MASS * LENGTH**2
SIX = tuple(f"joint_{k}" for k in range(1, 7))


def chain(axes: str = "y", *, gravity: float = G, centre: float = LENGTH, **changes) -> PlantParameters:
    """Frictionless links with a point mass each, `centre` beyond their joint along x; joints LENGTH apart."""
    n = len(axes)
    rows, links = [], ['<link name="b"/>']
    for k, axis in enumerate(axes):
        vector = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axis]
        at = f"{LENGTH if k else 0} 0 0"
        links.append(
            f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k else "b"}"/>'
            f'<child link="l{k}"/><origin xyz="{at}"/><axis xyz="{vector}"/>'
            '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        )
        body = pin.Inertia(MASS, np.array([centre, 0.0, 0.0]), 0.01 * np.eye(3))
        rows.append(body.toDynamicParameters())
    flat = dict.fromkeys(("joint_spring", "f_c", "f_b", "k_v1", "k_v2", "k_v3"), np.zeros(n))
    base = PlantParameters(
        joints=tuple(f"j{k}" for k in range(n)),
        urdf=f'<robot name="r">{"".join(links)}</robot>',
        gravity=np.array([0.0, 0.0, -gravity]),
        rigid_body=np.array(rows),
        rotor_inertia=np.full(n, ROTOR),
        v_b=np.full(n, 1e-3),
        **flat,
    )
    return replace(base, **{name: np.broadcast_to(np.asarray(v, float), (n,)).copy() for name, v in changes.items()})


def effect(parameters: PlantParameters, name: str, joints=(), law=None, **values):
    return make_effect(parameters.joints, name, joints, values, law)


def plant_with(parameters, *effects, position=None):
    position = np.zeros(len(parameters.joints)) if position is None else np.asarray(position, float)
    return Concealment(effects).plant(parameters, position, ThermalParameters(0.0), None)


def stepped(plant, torque, seconds, h=2.5e-4):
    torque = np.atleast_1d(np.asarray(torque, float))
    for _ in range(round(seconds / h)):
        plant.step(torque, h)
    return plant


def truth_of(torque, qd=None) -> Truth:
    torque = np.asarray(torque, float)
    zeros = np.zeros_like(torque)
    qd = zeros if qd is None else qd
    time = np.arange(len(torque)) * 1e-3
    n = torque.shape[1]
    return Truth(
        tuple(f"j{k}" for k in range(n)), time, zeros, qd, zeros, torque, zeros, time[:1], zeros[:1], "",
        DriveData.plain(n),
    )  # fmt: skip


# --- springs, gaps, bodies ---------------------------------------------------------------------------


def test_a_spring_between_motor_and_link_sags_by_load_over_stiffness():
    arm = chain(f_c=200.0, f_b=200.0)
    plant = plant_with(arm, effect(arm, "joint_elasticity", stiffness=2000.0, damping=20.0))
    stepped(plant, 0.0, 1.2)
    assert plant.position[0] == 0.0
    link = plant._configuration[0]
    assert link == pytest.approx(MASS * G * LENGTH * np.cos(link) / 2000.0, rel=1e-6)
    assert plant.load()[0] == pytest.approx(-MASS * G * LENGTH * np.cos(link), rel=1e-6)


def test_motor_and_link_swing_against_each_other_at_their_resonance():
    arm, stiffness = chain(gravity=0.0), 500.0
    plant = plant_with(arm, effect(arm, "joint_elasticity", stiffness=stiffness, damping=0.0))
    plant.velocity = np.array([1.0])
    link = INERTIA + 0.01
    omega = np.sqrt(stiffness * (1 / ROTOR + 1 / link))
    mean, swing = ROTOR / (ROTOR + link), link / (ROTOR + link)
    for _ in range(400):
        plant.step(np.zeros(1), 2.5e-4)
        t = plant.time + SETTLE_S
        assert plant.position[0] == pytest.approx(mean * t + swing * np.sin(omega * t) / omega, abs=2e-5)


def test_a_hardening_spring_sags_less():
    arm = chain(f_c=200.0, f_b=200.0)
    sag = []
    for law in EFFECTS["joint_elasticity"].laws:
        plant = plant_with(arm, effect(arm, "joint_elasticity", law=law, stiffness=4000.0, damping=20.0))
        sag.append(stepped(plant, 0.0, 0.6)._configuration[0])
    assert 0.3 * sag[0] < sag[1] < 0.8 * sag[0]


def test_in_the_gap_the_motor_turns_alone_and_beyond_it_with_the_link():
    arm, gap, torque = chain(gravity=0.0), 0.02, 0.6
    plant = plant_with(arm, effect(arm, "backlash", gap=gap, stiffness=5e4, damping=40.0))
    alone = np.sqrt(gap * ROTOR / torque)  # crossing half the gap from its middle
    stepped(plant, torque, 0.95 * alone)
    assert plant._configuration[0] == 0.0
    assert plant.position[0] == pytest.approx(0.5 * torque / ROTOR * (0.95 * alone) ** 2, rel=1e-3)
    stepped(plant, torque, 0.5)
    before = plant.velocity[0]
    stepped(plant, torque, 0.5)
    assert (plant.velocity[0] - before) / 0.5 == pytest.approx(torque / (ROTOR + INERTIA + 0.01), rel=0.02)
    assert plant.position[0] - plant._configuration[0] >= gap / 2


def test_a_bending_link_sags_by_load_over_stiffness_and_no_motor_sees_it():
    arm = chain("yy", f_c=500.0, f_b=500.0)
    plant = plant_with(arm, effect(arm, "link_flexibility", ["j0"], stiffness=900.0, damping=40.0, place=0.5))
    stepped(plant, [0.0, 0.0], 1.2)
    np.testing.assert_array_equal(plant.position, 0.0)
    bend = plant._configuration[1]
    arm_length = 0.5 * LENGTH + LENGTH  # from the hinge to the second mass; the first link's own mass is before it
    assert bend == pytest.approx(MASS * G * arm_length * np.cos(bend) / 900.0, rel=1e-5)


def test_a_free_base_turns_back_and_makes_the_arm_feel_light():
    arm = chain("z", gravity=0.0, centre=0.0)
    mass = 6.0 * MASS
    plant = plant_with(arm, effect(arm, "floating_base", base_ratio=6.0, gyration=0.2, below=1.0))
    stepped(plant, 0.5, 0.1, h=1e-3)
    link, base = 0.01, mass * 0.2**2
    # The rotor is reflected inertia of the joint alone: its own spin about the base is what the gear makes of it.
    expected = 0.5 / (ROTOR + 1 / (1 / link + 1 / base))
    assert plant.velocity[0] == pytest.approx(0.1 * expected, rel=1e-6)


def test_on_a_free_base_momentum_stays_zero_and_energy_is_what_the_motors_gave():
    arm = replace(chain("zyy", gravity=0.0), rotor_inertia=np.zeros(3))
    plant = plant_with(arm, effect(arm, "floating_base", base_ratio=4.0))
    mechanism, work, torque = plant._mechanism, 0.0, np.array([0.4, -0.3, 0.2])
    for _ in range(800):
        before = plant.position
        plant.step(torque, 2.5e-4)
        work += torque @ (plant.position - before)
    nq, m = mechanism._tree.nq, mechanism._m
    momentum = pin.computeCentroidalMomentum(
        mechanism._tree, mechanism._data, plant._configuration[:nq], plant._speed[:m]
    )
    assert mechanism.energy(plant._configuration, plant._speed) == pytest.approx(work, rel=2e-4)
    assert work > 0.02
    assert np.abs(momentum.vector).max() < 1e-4
    assert np.abs(plant._speed[:6]).max() > 1e-2


def test_a_parallel_rotor_couples_by_its_inertia_times_gear_ratio_and_a_square_one_not():
    for axes, coupling in (("zz", 0.2), ("zy", 0.0)):
        arm = chain(axes)
        plant = plant_with(arm, effect(arm, "rotor_coupling", ["j1"], inertia=0.2, gear_ratio=100.0))
        changed = plant._mechanism.inertia(plant._configuration) - plant.inertia()
        assert changed[0, 1] == pytest.approx(coupling, abs=1e-9)
        assert changed[1, 1] == pytest.approx(0.0, abs=1e-9)
        assert abs(changed[0, 0]) < 0.01 * max(coupling, 1)


def test_a_turning_rotor_is_a_gyroscope():
    """Turning joint 1 while the rotor of joint 3 (square to it) spins costs a torque at joint 2, I·N·q̇3·q̇1."""
    arm = chain("zyx", gravity=0.0, centre=0.0)
    spinning = plant_with(arm, effect(arm, "rotor_coupling", ["j2"], inertia=0.2))
    v = np.array([0.7, 0.0, 1.3])
    plain = plant_with(arm)._mechanism.bias(np.zeros(3), v)
    extra = spinning._mechanism.bias(spinning._configuration, v) - plain
    assert abs(extra[1]) == pytest.approx(0.2 * 0.7 * 1.3, rel=1e-6)
    assert v @ extra == pytest.approx(0.0, abs=1e-9)


def test_contact_is_the_force_through_the_lever_in_its_window_alone():
    arm = chain("yy", gravity=0.0)
    push = effect(
        arm, "external_contact", ["j1"], force=10.0, direction=[0, 0, 1], point=[0.2, 0, 0], start=1, duration=2
    )
    mechanism = plant_with(arm, push)._mechanism
    still, home = np.zeros(2), mechanism.start(np.zeros(2))
    for time, share in ((0.9, 0.0), (2.0, 1.0), (3.1, 0.0)):
        mechanism.time = time
        # Upwards at x = 0.7 and 0.2 turns about y by −F·x.
        np.testing.assert_allclose(mechanism.bias(home, still), share * 10.0 * np.array([0.7, 0.2]), atol=1e-12)


def test_a_wheel_in_a_link_turns_square_to_motion_and_axis_and_does_no_work():
    arm = chain("zy", gravity=0.0)
    plant = plant_with(arm, effect(arm, "link_gyroscope", ["j1"], momentum=3.0))
    plain, v = plant_with(arm), np.array([0.8, 0.5])
    extra = plant._mechanism.bias(plant._configuration, v) - plain._mechanism.bias(np.zeros(2), v)
    # The wheel lies along x; turning about z swings it towards y: 3.0 N·m·s times the rate, about y.
    assert extra[1] == pytest.approx(3.0 * 0.8, rel=1e-9)
    assert extra @ v == pytest.approx(0.0, abs=1e-9)


def test_a_soft_base_rocks_by_moment_over_stiffness():
    arm = chain(f_c=500.0, f_b=500.0)
    plant = plant_with(arm, effect(arm, "soft_base", stiffness=5e3, damping=300.0, mass=40.0))
    stepped(plant, 0.0, 1.5)
    moment = MASS * G * LENGTH
    assert plant._mechanism._base_offset(plant._configuration[:7])[4] == pytest.approx(moment / 5e3, rel=0.02)


def test_payload_adds_its_weight_and_its_inertia():
    arm = chain()
    payload = effect(arm, "payload", ["j0"], mass=0.8, centre=[0.3, 0, 0], radius=0.05)
    plant = plant_with(arm, payload)
    assert plant.load()[0] == pytest.approx(-(MASS * LENGTH + 0.8 * 0.3) * G)
    assert plant.inertia()[0, 0] == pytest.approx(INERTIA + 0.01 + ROTOR + 0.8 * 0.3**2 + 0.4 * 0.8 * 0.05**2)


def test_a_tilted_base_turns_gravity_by_its_angle():
    arm = chain("zy")
    level = plant_with(arm, position=[0.0, -np.pi / 2])
    tilted = plant_with(arm, effect(arm, "base_tilt", angle=0.05, azimuth=0.0), position=[0.0, -np.pi / 2])
    # The second link points straight up: its load is the tilt's; the vertical joint feels nothing about its own axis.
    assert level.load()[1] == pytest.approx(0.0, abs=1e-9)
    assert abs(tilted.load()[1]) == pytest.approx(MASS * G * LENGTH * np.sin(0.05), rel=1e-6)
    turned = plant_with(arm, effect(arm, "base_tilt", angle=0.05, azimuth=np.pi / 2))
    assert abs(turned.load()[0]) == pytest.approx(MASS * G * np.sin(0.05) * 3 * LENGTH, rel=1e-6)
    assert plant_with(arm).load()[0] == pytest.approx(0.0, abs=1e-9)


# --- friction ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_gear_efficiency_divides_the_load_when_driving_and_multiplies_it_when_driven(side):
    arm, eta = chain(), 0.8
    plant = plant_with(arm, effect(arm, "gear_efficiency", efficiency=eta))
    plant.velocity = np.array([side * 0.2])
    load = plant.load()[0]
    assert load < 0
    balance = load / eta if load * side > 0 else load * eta
    plant.step(np.array([balance]), 1e-5)
    assert plant.velocity[0] == pytest.approx(side * 0.2, abs=1e-6)
    plant.step(np.array([balance + 1.0]), 1e-5)
    assert plant.velocity[0] > side * 0.2 + 1e-6


def test_load_friction_is_mu_times_load_both_ways():
    arm = chain()
    for side in (1.0, -1.0):
        plant = plant_with(arm, effect(arm, "load_friction", mu=0.1))
        plant.velocity = np.array([side * 0.2])
        load = plant.load()[0]
        plant.step(np.array([load + side * 0.1 * abs(load)]), 1e-5)
        assert plant.velocity[0] == pytest.approx(side * 0.2, abs=1e-6)


@pytest.mark.parametrize("law", ["usual", "maxwell"])
def test_before_it_slips_a_joint_gives_like_a_spring_and_then_carries_its_friction(law):
    arm, distance = chain(gravity=0.0, f_c=5.0, f_b=5.0, k_v1=5.0), 0.01
    bristles = effect(arm, "presliding_hysteresis", law=law, distance=distance, damping=1e-3)
    plant = stepped(plant_with(arm, bristles), 1.0, 1.5)
    bent = plant.position[0]
    assert 0 < bent < 0.3 * distance and abs(plant.velocity[0]) < 5e-3
    state = State(1)
    state.qd = np.array([0.1])
    bristles.advance(state, 10 * distance / 0.1)
    assert bristles.torque(state)[0] == pytest.approx(5.0, rel=1e-3)
    # Back over the full distance and a little: the other way round.
    state.qd = np.array([-0.1])
    bristles.advance(state, 4 * distance / 0.1)
    assert bristles.torque(state)[0] == pytest.approx(-5.0, rel=1e-3)


def test_maxwell_slip_reverses_by_masings_rule():
    """The branch after a reversal is the first loading curve, twice as large both ways."""
    arm = chain(f_c=3.0, f_b=3.0)
    fresh = effect(arm, "presliding_hysteresis", law="maxwell", distance=0.01)
    state = State(1)
    first, back = [], []
    for curve, speed, scale in ((first, 1.0, 1.0), (back, -1.0, 2.0)):
        state.qd = np.array([speed])
        for _ in range(20):
            fresh.advance(state, scale * 0.01 / 20)
            curve.append(float(fresh.torque(state)[0]))
    fresh.level(state, np.ones(1))
    np.testing.assert_allclose((first[-1] - np.array(back)) / 2, first, atol=1e-12)


def test_friction_effects_change_the_level_as_they_say():
    arm = chain("yy", f_c=5.0, f_b=5.0)
    state, level = State(2), np.array([5.0, 5.0])
    state.q, state.qd = np.array([0.3, 0.0]), np.array([0.1, 0.1])

    def changed(name, law=None, **values):
        return (effect(arm, name, ["j0"], law, **values).level(state, level) - level).tolist()

    assert changed("stribeck", amplitude=2.0, velocity=0.1) == pytest.approx([2 / np.e, 0])
    assert changed("stribeck", "lorentz", amplitude=2.0, velocity=0.1) == pytest.approx([1.0, 0])
    assert changed("position_friction", amplitude=2.0, cycles=2, phase=0.1) == pytest.approx([2 * np.sin(0.7), 0])
    assert changed("asymmetric_friction", coulomb=0.5) == pytest.approx([0.5, 0])
    assert changed("friction_drift", coulomb=-0.5) == pytest.approx([-0.5, 0])
    state.qd = -state.qd
    assert changed("asymmetric_friction", coulomb=0.5) == pytest.approx([-0.5, 0])


def test_torques_of_position_are_what_they_say():
    arm, state = chain("yy"), State(2)
    state.q, state.qd = np.array([0.4, -0.5]), np.array([0.2, 0.3])
    ripple = effect(arm, "torque_ripple", ["j1"], amplitude=1.5, cycles=20, phase=0.3)
    assert ripple.torque(state).tolist() == pytest.approx([0, 1.5 * np.sin(-10 + 0.3)])
    assert effect(arm, "harness_spring", ["j0"], stiffness=3, centre=0.1).torque(state).tolist() == pytest.approx(
        [0.9, 0]
    )
    product = effect(arm, "position_product", ["j0", "j1"], stiffness=2.0)
    assert product.torque(state).tolist() == pytest.approx([-0.4, 0])


def test_a_shared_gear_stage_pulls_both_joints_against_their_common_motion():
    arm, state = chain("yy"), State(2)
    stage = effect(arm, "wrist_coupling", ["j0", "j1"], coulomb=1.0, viscous=2.0, ratio=-0.5)
    state.qd = np.array([0.1, 0.4])
    stage.advance(state, 0.1)
    common = 0.1 - 0.5 * 0.4
    torque = -1.0 + 2.0 * common
    np.testing.assert_allclose(stage.torque(state), [torque, -0.5 * torque])
    state.qd = np.array([0.2, 0.4])
    assert np.abs(stage.torque(state)[0]) == pytest.approx(1.0)


def test_friction_falls_with_the_temperature_of_the_oil():
    arm = chain(gravity=0.0, f_c=10.0, f_b=10.0, k_v1=4.0)
    for law in ("usual", "lagged"):
        warm = effect(
            arm, "temperature_friction", law=law, coulomb_slope=-0.01, start=20, rise=20, time_constant=2, lag=3
        )
        plant = plant_with(arm, warm)
        stepped(plant, 0.0, SETTLE_S + 2.0, h=1e-3)
        rise = 20 * (1 - np.exp(-1))
        oil = rise if law == "usual" else 20 * (1 - (3 * np.exp(-2 / 3) - 2 * np.exp(-1)) / (3 - 2))
        assert plant.housing_temperature[0] - 20 == pytest.approx(rise, rel=0.01)
        level = plant.law.dry_level(*np.zeros((2, 1)), plant.housing_temperature)[0]
        assert level == pytest.approx(10.0 * (1 - 0.01 * oil), rel=3e-3)


PASSIVE = {
    "load_friction": {"mu": 0.15},
    "gear_efficiency": {"efficiency": 0.8},
    "presliding_hysteresis": {"distance": 5e-3},
    "position_friction": {"amplitude": 2.0},
    "asymmetric_friction": {"coulomb": 1.5},
    "stribeck": {"amplitude": 3.0},
    "joint_elasticity": {"stiffness": 4e3},
    "backlash": {"gap": 0.01},
    "link_flexibility": {"stiffness": 3e3},
    "wrist_coupling": {"coulomb": 2.0},
    "rotor_coupling": {"inertia": 0.1},
    "loose_bolt": {"amplitude": 3.0},
    "resting_friction": {"amplitude": 3.0},
}


@pytest.mark.parametrize(("name", "law"), [(name, law) for name in PASSIVE for law in EFFECTS[name].laws])
def test_passive_effects_never_create_energy(name, law):
    arm = chain("zyy", f_c=1.0, f_b=1.5, k_v1=0.5)
    joints = {2: ["j1", "j2"], 1: ["j1"]}.get(EFFECTS[name].joints_needed, ["j1"])
    start = [0.2, -0.4, 0.5]
    plant = plant_with(arm, effect(arm, name, joints, law, **PASSIVE[name]), position=start)
    plant.velocity = np.array([1.0, -1.5, 2.0])
    at_first, farthest = energy(plant), 0.0
    for _ in range(60):
        stepped(plant, np.zeros(3), 0.02)
        assert energy(plant) <= at_first * (1 + 1e-5) + 1e-4
        farthest = max(farthest, np.abs(plant.position - start).max())
    assert farthest > 0.1


def energy(plant):
    """Of the bodies and hinges, J; what springs at motors and bristles store is left out, and never negative."""
    if hasattr(plant._mechanism, "energy"):
        return plant._mechanism.energy(plant._configuration, plant._speed)
    model = rigid_body_model(plant.parameters)
    kinetic = 0.5 * plant.velocity @ plant.inertia() @ plant.velocity
    return kinetic + pin.computePotentialEnergy(model, model.createData(), plant.position)


# --- drives, sensors, time ---------------------------------------------------------------------------


def test_drives_give_what_their_fault_makes_of_what_they_report():
    arm = chain("yy")
    plant = plant_with(arm)

    def given(asked, name, law=None, **values):
        return effect(arm, name, ["j0"], law, **values).motor(np.array([asked, asked]), plant).tolist()

    assert given(8.0, "torque_constant", scale=0.9) == pytest.approx([7.2, 8])
    assert given(8.0, "torque_constant", "warming", scale=0.9) == pytest.approx([7.2, 8])
    assert given(8.0, "current_offset", offset=-1.5) == pytest.approx([9.5, 8])
    assert given(8.0, "motor_saturation", torque=10.0) == pytest.approx([10 * np.tanh(0.8), 8])
    assert given(-8.0, "motor_saturation", "knee", torque=10.0) == pytest.approx([-8 + 0.4 * 3, -8])
    plant.thermal.winding[:] = 60.0
    assert given(8.0, "torque_constant", "warming", scale=1, slope=-2e-3) == pytest.approx([8 * 0.92, 8])


def test_a_late_torque_is_the_same_sine_later():
    time = np.arange(2000) * 1e-3
    truth = truth_of(np.sin(2 * np.pi * time)[:, None])
    for law, side in (("usual", 1), ("early", -1)):
        late = make_effect(("j0",), "time_delay", (), {"delay": 0.0045}, law).reported(truth).torque[:, 0]
        np.testing.assert_allclose(late[50:-50], np.sin(2 * np.pi * (time - side * 0.0045))[50:-50], atol=2e-5)


def test_a_smoothed_ramp_lags_by_the_time_constant_and_other_joints_do_not():
    ramp = np.outer(np.arange(3000) * 1e-3, [1.0, 1.0])
    slow = make_effect(("j0", "j1"), "filter_lag", ["j1"], {"corner": 5.0}).reported(truth_of(ramp)).torque
    np.testing.assert_array_equal(slow[:, 0], ramp[:, 0])
    assert ramp[-1, 1] - slow[-1, 1] == pytest.approx(1 / (2 * np.pi * 5.0), rel=0.02)


def test_an_eccentric_encoder_shows_a_wrong_angle_and_its_speed():
    wrong = make_effect(("j0",), "encoder_eccentricity", (), {"amplitude": 0.01, "cycles": 3, "phase": 0.2})
    t = np.linspace(0, 2, 400)[:, None]
    truth = replace(truth_of(np.zeros((400, 1))), q=np.sin(t), qd=np.cos(t))
    seen = Concealment([wrong]).reported(truth)
    np.testing.assert_allclose(seen.q, np.sin(t) + 0.01 * np.sin(3 * np.sin(t) + 0.2), atol=1e-12)
    np.testing.assert_allclose(seen.qd, np.cos(t) * (1 + 0.03 * np.cos(3 * np.sin(t) + 0.2)), atol=1e-7)


@pytest.fixture(scope="module")
def short_run():
    """Half a radian and back: 2.4 s of the paper's arm."""
    home, there = np.zeros(6), np.full(6, 0.3)
    still = np.zeros(6)
    out = Quintic(Motion(home, still, still), Motion(there, still, still), 1.0)
    back = Quintic(Motion(there, still, still), Motion(home, still, still), 1.0)
    return Trajectory(paper_arm().joints, (Rest(home, 0.2), out, back, Rest(home, 0.2)))


def test_nothing_concealed_is_the_arm_itself(short_run):
    plain = simulate_truth(paper_arm(), short_run, drives=paper_drives())
    same = simulate_truth(paper_arm(), short_run, drives=paper_drives(), hidden=Concealment([]))
    for name in ("q", "qd", "torque", "temperature"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(same, name))


@pytest.mark.parametrize(("name", "more"), [("torque_ripple", {"cycles": 30}), ("pump_disturbance", {})])
def test_a_concealed_torque_shows_at_its_joint_as_large_as_it_is_and_the_run_repeats(short_run, name, more):
    plain = simulate_truth(paper_arm(), short_run, drives=paper_drives())
    first, again = (
        simulate_truth(
            paper_arm(),
            short_run,
            drives=paper_drives(),
            hidden=Concealment([make_effect(SIX, name, ["joint_3"], {"amplitude": 2.0} | more)]),
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.torque, again.torque)
    moving = np.abs(plain.qd[:, 2]) > 0.05
    change = np.sqrt(np.mean((first.torque - plain.torque)[moving] ** 2, axis=0))
    assert change[2] == pytest.approx(2.0 / np.sqrt(2), rel=0.25)
    assert np.all(np.delete(change, 2) < 0.3 * change[2])


def test_in_vacuum_the_higher_powers_of_speed_go():
    thin = make_effect(SIX, "vacuum_friction", (), {"fraction": 0.75}).alter(paper_arm())
    np.testing.assert_allclose(thin.k_v3, 0.25 * paper_arm().k_v3)
    np.testing.assert_allclose(thin.k_v2, 0.25 * paper_arm().k_v2)
    np.testing.assert_array_equal(thin.k_v1, paper_arm().k_v1)


# --- files and names ---------------------------------------------------------------------------------


def test_every_name_of_the_contract_can_be_concealed_and_some_beyond():
    known = {name for name, kind in EFFECTS.items() if kind.known}
    assert known == set(CONTRACT)
    assert len(EFFECTS) - len(known) >= 5


def document(**entry):
    return {"schema": "spacearm_ident/conceal/1", "effects": [entry]}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (document(effect="riple"), "no effect 'riple'; the effects are .*torque_ripple"),
        (document(effect="payload", joints=["hip"]), "no joint 'hip'"),
        (document(effect="payload", parameters={"mass": 1}), r"takes 1 joint\(s\), not 0"),
        (
            document(effect="payload", joints=["joint_6"], parameters={"weight": 1}),
            "no parameter 'weight'; it takes mass",
        ),
        (document(effect="payload", joints=["joint_6"]), "give mass in kg"),
        (document(effect="payload", joints=["joint_6"], parameters={"mass": "big"}), "mass must be a number"),
        (document(effect="stribeck", parameters={"amplitude": 1}, law="square"), "no law 'square'"),
        (document(name="stribeck"), "an effect has the keys"),
        ({"schema": "other/1", "effects": []}, "schema is 'other/1'"),
        ([], "must be a mapping"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(content, complaint):
    with pytest.raises(UserError, match=complaint) as caught:
        concealed_from_dict(content, SIX)
    assert "\n" not in str(caught.value)


def test_what_the_arm_cannot_carry_is_refused():
    light = replace(paper_arm(), rotor_inertia=np.full(6, 1e-6))
    with pytest.raises(UserError, match="rotor inertia"):
        plant_with(light, make_effect(SIX, "joint_elasticity", ["joint_2"], {"stiffness": 1e4}))
    with pytest.raises(UserError, match="no link follows"):
        plant_with(paper_arm(), make_effect(SIX, "link_flexibility", ["joint_6"], {"stiffness": 1e4}))
    two = [make_effect(SIX, "joint_elasticity", ["joint_2"], {"stiffness": 1e4}) for _ in range(2)]
    with pytest.raises(UserError, match="not two"):
        plant_with(paper_arm(), *two)


def test_a_file_gives_its_effects_and_a_damaged_one_is_refused(tmp_path):
    path = tmp_path / "hide.yaml"
    path.write_text(yaml.safe_dump(document(effect="stribeck", joints=["joint_2"], parameters={"amplitude": [1.5]})))
    (found,) = load_concealed(path, SIX)
    assert found.name == "stribeck" and found.joints.tolist() == [1] and found.one("amplitude") == 1.5
    path.write_text("effects: [")
    with pytest.raises(UserError, match=r"hide\.yaml is not valid YAML"):
        load_concealed(path, SIX)


def test_the_command_conceals(tmp_path, capsys):
    trajectory, hide, bags = tmp_path / "t.yaml", tmp_path / "hide.yaml", []
    rests = [{"kind": "rest", "duration_s": 0.1, "position": [angle] * 6} for angle in (0.0, 0.1)]
    segments = [rests[0], {"kind": "quintic", "duration_s": 0.5}, rests[1]]
    segments = {"schema": "spacearm_ident/trajectory/1", "joints": list(SIX), "segments": segments}
    trajectory.write_text(yaml.safe_dump(segments))
    hide.write_text(yaml.safe_dump(document(effect="current_offset", joints=["joint_1"], parameters={"offset": 3.0})))
    common = ["--model", str(CONFIG / "paper_arm_model.yaml"), "--arm", str(CONFIG / "paper_arm.yaml"), "--noise", "0"]
    for name, more in (("plain", []), ("hidden", ["--conceal", str(hide)])):
        bags.append(tmp_path / f"{name}.mcap")
        out = ["--trajectory", str(trajectory), "--out", str(bags[-1]), *more]
        assert main(["simulate", *common, *out]) == 0
    plain, hidden = (read_recording(bag).effort[200:500] for bag in bags)
    change = np.mean(hidden - plain, axis=0)
    assert change[0] == pytest.approx(3.0, abs=0.3)
    assert np.abs(change[1:]).max() < 0.1
    hide.write_text(yaml.safe_dump(document(effect="gremlins")))
    assert (
        main(["simulate", *common, "--trajectory", str(trajectory), "--conceal", str(hide), "--out", str(bags[0])]) == 2
    )
    assert "no effect 'gremlins'" in capsys.readouterr().err
