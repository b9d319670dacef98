"""The simulated arm's mechanics against closed forms, conservation laws and brute force."""

from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.special import ellipk
from simulated_arm import arm_document, paper_arm

from spacearm_ident.errors import UserError
from spacearm_ident.simulation.plant import Plant, PlantParameters, rigid_body_model
from spacearm_ident.simulation.stick_slip import solve_stick_slip
from spacearm_ident.simulation.thermal import Thermal, ThermalParameters

MASS, LENGTH, GRAVITY = 2.0, 0.5, 9.81
INERTIA = MASS * LENGTH**2

PENDULUM_URDF = """<robot name="pendulum"><link name="base"/><link name="rod"/>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="100" velocity="10"/></joint></robot>"""


def pendulum(**changes) -> PlantParameters:
    """A point mass on a rod turning about y; zero hangs down. Frictionless unless changed."""
    ixx = MASS * LENGTH**2
    flat = np.zeros(1)
    return replace(
        PlantParameters(
            joints=("pivot",),
            urdf=PENDULUM_URDF,
            gravity=np.array([0.0, 0.0, -GRAVITY]),
            rigid_body=np.array([[MASS, 0, 0, -MASS * LENGTH, ixx, 0, ixx, 0, 0, 1e-9]]),
            rotor_inertia=flat,
            joint_spring=flat,
            f_c=flat,
            f_b=flat,
            v_b=np.array([1e-3]),
            k_v1=flat,
            k_v2=flat,
            k_v3=flat,
        ),
        **{name: np.atleast_1d(np.asarray(value, dtype=float)) for name, value in changes.items()},
    )


def without_friction(parameters: PlantParameters) -> PlantParameters:
    flat = np.zeros(len(parameters.joints))
    return replace(parameters, f_c=flat, f_b=flat, k_v1=flat, k_v2=flat, k_v3=flat)


def energy(plant: Plant) -> float:
    model = rigid_body_model(plant.parameters)
    potential = pin.computePotentialEnergy(model, model.createData(), plant.position)
    spring = 0.5 * plant.parameters.joint_spring @ plant.position**2
    return 0.5 * plant.velocity @ plant.inertia() @ plant.velocity + potential + spring


def stepped(plant: Plant, torque, seconds: float, dt: float = 1e-3) -> Plant:
    torque = np.atleast_1d(np.asarray(torque, dtype=float))
    for _ in range(round(seconds / dt)):
        plant.step(torque, dt)
    return plant


# --- motion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("amplitude", "rotor"), [(0.3, 0.0), (2.0, 0.0), (1.0, 0.7)])
def test_pendulum_swings_with_the_period_of_the_elliptic_integral(amplitude, rotor):
    plant = Plant(pendulum(rotor_inertia=rotor), position=[amplitude])
    frequency = np.sqrt(MASS * GRAVITY * LENGTH / (INERTIA + rotor))
    quarter = ellipk(np.sin(amplitude / 2) ** 2) / frequency
    stepped(plant, 0.0, quarter, dt=quarter / 2000)
    assert abs(plant.position[0]) < 1e-5 * amplitude
    assert plant.velocity[0] == pytest.approx(-2 * frequency * np.sin(amplitude / 2), rel=1e-5)


def test_spring_oscillates_without_gravity():
    plant = Plant(pendulum(gravity=[0, 0, 0], joint_spring=8.0), position=[0.4])
    omega = np.sqrt(8.0 / INERTIA)
    stepped(plant, 0.0, 1.0)
    assert plant.position[0] == pytest.approx(0.4 * np.cos(omega), abs=1e-6)


def test_energy_is_kept_without_friction_and_the_error_is_of_second_order():
    parameters = without_friction(paper_arm())
    posture = np.array([0.3, 0.6, -0.8, 0.5, 0.7, -0.4])
    drift = []
    for step in (1e-3, 5e-4):
        plant = Plant(parameters, position=posture, velocity=[0.8, -0.5, 0.9, 1.2, -1.0, 1.5])
        plant.longest_step_s = step
        before = energy(plant)
        stepped(plant, np.zeros(6), 1.0)
        drift.append(abs(energy(plant) - before))
    moved = 0.5 * plant.velocity @ plant.inertia() @ plant.velocity
    assert moved > 10.0
    assert drift[1] < 1e-4 * moved
    assert drift[1] < drift[0] / 3


def test_without_gravity_the_arm_at_rest_stays_and_the_moving_rotor_coasts():
    floating = replace(without_friction(paper_arm()), gravity=np.zeros(3), joint_spring=np.zeros(6))
    posture = np.array([0.3, 0.6, -0.8, 0.5, 0.7, -0.4])
    resting = stepped(Plant(floating, position=posture), np.zeros(6), 0.2)
    np.testing.assert_array_equal(resting.position, posture)
    coasting = stepped(Plant(pendulum(gravity=[0, 0, 0]), velocity=[0.7]), 0.0, 1.0)
    assert coasting.position[0] == pytest.approx(0.7, rel=1e-9)


# --- friction ----------------------------------------------------------------------------------------


def test_on_a_slope_below_static_friction_a_joint_stays_put_exactly():
    holding = MASS * GRAVITY * LENGTH * np.sin(0.5)
    stuck = Plant(pendulum(f_c=0.5 * holding, f_b=1.001 * holding), position=[0.5])
    stepped(stuck, 0.0, 1.0)
    assert stuck.position[0] == 0.5 and stuck.velocity[0] == 0.0
    falling = Plant(pendulum(f_c=0.5 * holding, f_b=0.999 * holding), position=[0.5])
    stepped(falling, 0.0, 0.2)
    assert falling.position[0] < 0.499


@given(st.floats(0.5, 30.0), st.floats(0.0, 10.0), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=20, deadline=None)
def test_a_joint_breaks_away_at_its_static_friction(coulomb, excess, side):
    static = coulomb + excess
    plant = Plant(pendulum(gravity=[0, 0, 0], f_c=coulomb, f_b=static))
    stepped(plant, side * 0.999 * static, 0.05)
    assert plant.position[0] == 0.0
    stepped(plant, side * 1.001 * static, 0.05)
    assert side * plant.velocity[0] > 0.0


@given(
    speed=st.floats(0.02, 2.0),
    side=st.sampled_from([-1.0, 1.0]),
    quadratic=st.sampled_from(["even", "odd"]),
    coefficient=st.floats(-0.4, 0.8),
)
@settings(max_examples=30, deadline=None)
def test_constant_speed_takes_the_torque_of_the_friction_law(speed, side, quadratic, coefficient):
    fc, fb, vb, k1, k3 = 5.0, 8.0, 5e-3, 20.0, -0.2
    parameters = replace(
        pendulum(gravity=[0, 0, 0], f_c=fc, f_b=fb, v_b=vb, k_v1=k1, k_v2=coefficient, k_v3=k3),
        quadratic=quadratic,
    )
    v = side * speed
    square = v * v if quadratic == "even" else v * abs(v)
    law = (fc + (fb - fc) * np.exp(-((v / vb) ** 2))) * side + k1 * v + coefficient * square + k3 * v**3
    # Started 1 % beside it, the joint settles at the speed whose friction the torque is (slope above 10).
    plant = stepped(Plant(parameters, velocity=[1.01 * v]), law, 0.5)
    assert plant.velocity[0] == pytest.approx(v, rel=1e-5)


def test_a_steep_falling_stribeck_slope_stays_bounded():
    """10 N·m falling within 1 mrad/s on 0.01 kg·m²: a million per second, four steps a millisecond."""
    light = pendulum(gravity=[0, 0, 0], f_c=2.0, f_b=12.0)
    light = replace(light, rigid_body=light.rigid_body * 0.02)
    plant = Plant(light)
    fastest, stuck = 0.0, 0
    for tick in range(4000):
        pull = 200.0 * (0.05 * tick * 1e-3 - plant.position[0]) - 2.0 * plant.velocity[0]
        plant.step(np.array([pull]), 1e-3)
        fastest = max(fastest, abs(plant.velocity[0]))
        stuck += plant.velocity[0] == 0.0
    # Stick-slip: long rests, and slips no faster than the stored spring energy allows.
    assert 200 < stuck < 3990
    assert fastest < 12.0 / np.sqrt(200.0 * 0.01)
    assert plant.position[0] == pytest.approx(0.2, abs=12.0 / 200.0)


def test_friction_only_takes_energy_and_brings_the_arm_to_a_full_stop():
    plant = Plant(paper_arm(), position=[0.0, 1.2, 0.5, 0.3, 0.2, 0.1], velocity=[1.0, 1, 1, 1, 1, 1])
    level = energy(plant)
    for _ in range(300):
        stepped(plant, np.zeros(6), 0.02)
        assert energy(plant) <= level + 1e-6
        level = energy(plant)
        if not plant.velocity.any():
            break
    assert not plant.velocity.any()
    resting = plant.position.copy()
    stepped(plant, np.zeros(6), 0.5)
    np.testing.assert_array_equal(plant.position, resting)


def test_a_joint_sticks_exactly_while_its_neighbours_move():
    plant = Plant(replace(paper_arm(), gravity=np.zeros(3)), position=[0.0, 0.5, 0.5, 0.5, 0.5, 0.5])
    stepped(plant, [22.0, 0, 0, 0, 0, 0], 0.3)
    assert plant.position[0] > 0.01
    np.testing.assert_array_equal(plant.position[1:], 0.5)


@st.composite
def friction_problems(draw):
    root = draw(arrays(float, (3, 3), elements=st.floats(-2, 2)))
    inertia = root @ root.T + draw(st.floats(0.05, 1.0)) * np.eye(3)
    numbers = arrays(float, 3, elements=st.floats(-5, 5))
    return inertia, draw(numbers), np.abs(draw(numbers)), draw(numbers)


@given(friction_problems())
@settings(deadline=None)
def test_stick_slip_is_the_one_solution_among_all_patterns(problem):
    inertia, momentum, bound, guess = problem
    best, lowest = np.zeros(3), np.inf
    for pattern in product([-1.0, 0.0, 1.0], repeat=3):
        sign = np.array(pattern)
        slip = np.flatnonzero(sign)
        v = np.zeros(3)
        if slip.size:
            v[slip] = np.linalg.solve(inertia[np.ix_(slip, slip)], (momentum - bound * sign)[slip])
        cost = 0.5 * v @ inertia @ v - momentum @ v + bound @ np.abs(v)
        if cost < lowest:
            best, lowest = v, cost
    found = solve_stick_slip(inertia, momentum, bound, guess)
    np.testing.assert_allclose(found, best, atol=1e-6)
    clearly_stuck = np.abs(momentum - inertia @ best) < 0.999 * bound
    assume(clearly_stuck.any())
    np.testing.assert_array_equal(found[clearly_stuck & (best == 0)], 0.0)


# --- temperature -------------------------------------------------------------------------------------


def test_temperatures_settle_where_heat_in_is_heat_out():
    data = ThermalParameters(copper_loss=np.array([0.01, 0.02]), ambient=-30.0)
    thermal = Thermal(data, 2)
    torque, friction = np.array([20.0, 10.0]), np.array([3.0, 0.0])
    for _ in range(12_000):
        thermal.heat(torque, friction, 1.0)
    copper = np.array([4.0, 2.0])
    housing = -30.0 + (copper + friction) * data.housing_to_ambient
    np.testing.assert_allclose(thermal.housing, housing, atol=1e-3)
    np.testing.assert_allclose(thermal.winding, housing + copper * data.winding_to_housing, atol=1e-3)


def test_a_turning_joint_warms_by_its_friction_power():
    plant = Plant(pendulum(gravity=[0, 0, 0], f_c=5.0, f_b=5.0), thermal=ThermalParameters(copper_loss=0.0))
    plant.velocity = np.array([2.0])
    stepped(plant, 5.0, 1.0)
    capacity = ThermalParameters().housing_heat_capacity
    assert plant.housing_temperature[0] == pytest.approx(20.0 + 10.0 / capacity, rel=1e-5)


# --- the arm of the paper ----------------------------------------------------------------------------


def test_every_link_of_the_paper_and_its_cad_prior_can_exist():
    for parameters in (paper_arm().rigid_body, cad_bodies()):
        for body in parameters:
            pseudo = pin.Inertia.FromDynamicParameters(body).toPseudoInertia().toMatrix()
            assert np.linalg.eigvalsh(pseudo)[0] > 1e-4


def cad_bodies() -> np.ndarray:
    model = pin.buildModelFromXML(paper_arm().urdf)
    return np.array([inertia.toDynamicParameters() for inertia in model.inertias[1:]])


def test_the_cad_prior_is_off_as_a_cad_prior_is():
    off = np.abs(cad_bodies()[:, 0] / paper_arm().rigid_body[:, 0] - 1.0)
    assert np.all((off > 0.05) & (off < 0.25))


def test_only_one_reading_of_the_printed_products_of_inertia_is_realisable():
    """The note in paper_arm_model.yaml: with the other sign no link about its origin can exist."""
    for body in paper_arm().rigid_body[:5]:
        printed = body.copy()
        printed[[5, 7, 8]] *= -1
        mass, first, tensor = printed[0], printed[1:4], printed[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3)
        centre = first / mass
        about_centre = tensor - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        assert np.linalg.eigvalsh(about_centre)[0] < 0


def test_arm_file_and_description_give_the_same_limits():
    model = pin.buildModelFromXML(paper_arm().urdf)
    drives = arm_document()["joints"]
    for index, name in enumerate(paper_arm().joints):
        assert model.upperEffortLimit[index] == drives[name]["torque_limit_Nm"]
        assert model.upperVelocityLimit[index] == drives[name]["velocity_limit_rad_s"]


def test_wrong_input_is_refused_with_what_to_do():
    with pytest.raises(UserError, match=r"moving joints are pivot, .*name the same joints"):
        Plant(replace(pendulum(), joints=("hinge",)))
    with pytest.raises(UserError, match="cannot be parsed"):
        Plant(replace(pendulum(), urdf="<robot"))
    with pytest.raises(UserError, match="v_b above zero"):
        pendulum(v_b=0.0)
    document = {"joints": ["pivot"], "gravity_m_s2": [0, 0, 0], "terms": [{"kind": "magnetism"}]}
    with pytest.raises(UserError, match="no term 'magnetism'"):
        PlantParameters.from_model(document, PENDULUM_URDF)
    document["terms"] = [{"kind": "rotor_inertia", "values": {"J_m": {"elbow": 1.0}}}]
    with pytest.raises(UserError, match="gives no J_m for 'pivot'"):
        PlantParameters.from_model(document, PENDULUM_URDF)
