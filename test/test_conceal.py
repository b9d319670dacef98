"""Concealed physics against closed forms and conservation laws."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from pendulums import INERTIA, LENGTH, MASS, ROTOR, G, chain, effect, plant_with, stepped

from spacearm_ident.simulation.closed_loop import SETTLE_S
from spacearm_ident.simulation.concealed import EFFECTS
from spacearm_ident.simulation.concealed.effect import State
from spacearm_ident.simulation.mechanism import rigid_body_model

# --- springs, gaps, bodies ---------------------------------------------------------------------------


def test_a_spring_between_motor_and_link_sags_by_load_over_stiffness():
    arm = chain(f_c=200.0, f_b=200.0)
    plant = plant_with(arm, effect(arm, "joint_elasticity", stiffness=2000.0, damping=20.0))
    stepped(plant, 0.0, 1.2)
    assert plant.position[0] == 0.0
    link = plant.configuration[0]
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
        sag.append(stepped(plant, 0.0, 0.6).configuration[0])
    assert 0.3 * sag[0] < sag[1] < 0.8 * sag[0]


def test_in_the_gap_the_motor_turns_alone_and_beyond_it_with_the_link():
    arm, gap, torque = chain(gravity=0.0), 0.02, 0.6
    plant = plant_with(arm, effect(arm, "backlash", gap=gap, stiffness=5e4, damping=40.0))
    alone = np.sqrt(gap * ROTOR / torque)  # crossing half the gap from its middle
    stepped(plant, torque, 0.95 * alone)
    assert plant.configuration[0] == 0.0
    assert plant.position[0] == pytest.approx(0.5 * torque / ROTOR * (0.95 * alone) ** 2, rel=1e-3)
    stepped(plant, torque, 0.5)
    before = plant.velocity[0]
    stepped(plant, torque, 0.5)
    assert (plant.velocity[0] - before) / 0.5 == pytest.approx(torque / (ROTOR + INERTIA + 0.01), rel=0.02)
    assert plant.position[0] - plant.configuration[0] >= gap / 2


def test_a_bending_link_sags_by_load_over_stiffness_and_no_motor_sees_it():
    arm = chain("yy", f_c=500.0, f_b=500.0)
    plant = plant_with(arm, effect(arm, "link_flexibility", ["j0"], stiffness=900.0, damping=40.0, place=0.5))
    stepped(plant, [0.0, 0.0], 1.2)
    np.testing.assert_array_equal(plant.position, 0.0)
    bend = plant.configuration[1]
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
    mechanism, work, torque = plant.mechanism, 0.0, np.array([0.4, -0.3, 0.2])
    for _ in range(800):
        before = plant.position
        plant.step(torque, 2.5e-4)
        work += torque @ (plant.position - before)
    nq, m = mechanism._tree.nq, mechanism._m
    momentum = pin.computeCentroidalMomentum(
        mechanism._tree, mechanism._data, plant.configuration[:nq], plant.speed[:m]
    )
    assert mechanism.energy(plant.configuration, plant.speed) == pytest.approx(work, rel=2e-4)
    assert work > 0.02
    assert np.abs(momentum.vector).max() < 1e-4
    assert np.abs(plant.speed[:6]).max() > 1e-2


def test_a_parallel_rotor_couples_by_its_inertia_times_gear_ratio_and_a_square_one_not():
    for axes, coupling in (("zz", 0.2), ("zy", 0.0)):
        arm = chain(axes)
        plant = plant_with(arm, effect(arm, "rotor_coupling", ["j1"], inertia=0.2, gear_ratio=100.0))
        changed = plant.mechanism.inertia(plant.configuration) - plant.inertia()
        assert changed[0, 1] == pytest.approx(coupling, abs=1e-9)
        assert changed[1, 1] == pytest.approx(0.0, abs=1e-9)
        assert abs(changed[0, 0]) < 0.01 * max(coupling, 1)


def test_a_turning_rotor_is_a_gyroscope():
    """Turning joint 1 while the rotor of joint 3 (square to it) spins costs a torque at joint 2, I·N·q̇3·q̇1."""
    arm = chain("zyx", gravity=0.0, centre=0.0)
    spinning = plant_with(arm, effect(arm, "rotor_coupling", ["j2"], inertia=0.2))
    v = np.array([0.7, 0.0, 1.3])
    plain = plant_with(arm).mechanism.bias(np.zeros(3), v)
    extra = spinning.mechanism.bias(spinning.configuration, v) - plain
    assert abs(extra[1]) == pytest.approx(0.2 * 0.7 * 1.3, rel=1e-6)
    assert v @ extra == pytest.approx(0.0, abs=1e-9)


def test_contact_is_the_force_through_the_lever_in_its_window_alone():
    arm = chain("yy", gravity=0.0)
    push = effect(
        arm, "external_contact", ["j1"], force=10.0, direction=[0, 0, 1], point=[0.2, 0, 0], start=1, duration=2
    )
    mechanism = plant_with(arm, push).mechanism
    still, home = np.zeros(2), mechanism.start(np.zeros(2))
    for time, share in ((0.9, 0.0), (2.0, 1.0), (3.1, 0.0)):
        mechanism.time = time
        # Upwards at x = 0.7 and 0.2 turns about y by −F·x.
        np.testing.assert_allclose(mechanism.bias(home, still), share * 10.0 * np.array([0.7, 0.2]), atol=1e-12)


def test_a_wheel_in_a_link_turns_square_to_motion_and_axis_and_does_no_work():
    arm = chain("zy", gravity=0.0)
    plant = plant_with(arm, effect(arm, "link_gyroscope", ["j1"], momentum=3.0))
    plain, v = plant_with(arm), np.array([0.8, 0.5])
    extra = plant.mechanism.bias(plant.configuration, v) - plain.mechanism.bias(np.zeros(2), v)
    # The wheel lies along x; turning about z swings it towards y: 3.0 N·m·s times the rate, about y.
    assert extra[1] == pytest.approx(3.0 * 0.8, rel=1e-9)
    assert extra @ v == pytest.approx(0.0, abs=1e-9)


def test_a_soft_base_rocks_by_moment_over_stiffness():
    arm = chain(f_c=500.0, f_b=500.0)
    plant = plant_with(arm, effect(arm, "soft_base", stiffness=5e3, damping=300.0, mass=40.0))
    stepped(plant, 0.0, 1.5)
    moment = MASS * G * LENGTH
    assert plant.mechanism._base_offset(plant.configuration[:7])[4] == pytest.approx(moment / 5e3, rel=0.02)


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
    if hasattr(plant.mechanism, "energy"):
        return plant.mechanism.energy(plant.configuration, plant.speed)
    model = rigid_body_model(plant.parameters)
    kinetic = 0.5 * plant.velocity @ plant.inertia() @ plant.velocity
    return kinetic + pin.computePotentialEnergy(model, model.createData(), plant.position)
