"""Friction against the paper's eq. 2 written out, and the bristle state against a step-by-step loop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import TWO_LINKS, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.friction import STRIBECK_GRID, bristle_state
from spacearm_ident.dynamics.model import FRICTION_LAWS, TorqueModel, structure_of
from spacearm_ident.dynamics.term import Parameter
from spacearm_ident.errors import UserError
from spacearm_ident.signals.motion import Motion

ARM = arm_from_urdf(urdf_of(TWO_LINKS))
RATE = 100.0


def motion_of(velocity, noise=0.0, periods=1):
    """Both joints move at (N,) velocities."""
    velocity = np.stack([velocity, velocity], axis=1)
    position = np.cumsum(velocity, axis=0) / RATE
    zero = np.zeros_like(velocity)
    speed_noise = np.full(2, noise)
    return Motion(ARM.joint_names, RATE, 0.0, position, velocity, zero, zero, speed_noise, np.zeros(2), periods=periods)


def friction(structure, velocity, values, **options):
    """(N,) friction of the shoulder under a structure's friction terms."""
    model = TorqueModel(ARM, structure)
    parameters = [values.get(parameter.symbol, 0.0) for parameter in model.parameters]
    constants = [values.get(constant.symbol, 0.0) for constant in model.constants]
    kinds = ("stribeck_friction", "viscous_friction")
    return model.torque(motion_of(velocity, **options), np.array(parameters), np.array(constants), kinds)[:, 0]


VALUES = {"f_c": 14.9, "f_b": 20.1, "v_b": 0.05, "k_v1": 19.7, "k_v2": 0.06, "k_v3": -0.17, "d_s": 0.0}


def test_eq_2_at_sampled_points():
    v = np.array([-1.0, -0.2, -0.05, -1e-3, 0.0, 1e-3, 0.05, 0.3, 2.0])
    want = []
    for speed in v:
        sign = 1.0 if speed > 0 else -1.0 if speed < 0 else 0.0
        dry = (14.9 + (20.1 - 14.9) * np.exp(-((speed / 0.05) ** 2))) * sign
        want.append(dry + 19.7 * speed + 0.06 * speed**2 - 0.17 * speed**3)
    np.testing.assert_allclose(friction(FRICTION_LAWS["paper"], v, VALUES), want, rtol=1e-12)


def test_the_sign_of_standstill_is_zero_and_noise_is_standstill():
    v = np.array([0.0, 1e-4, -1e-4, 0.02])
    np.testing.assert_array_equal(friction({"stribeck_friction": {}}, v[:1], VALUES), 0.0)
    quiet = friction({"stribeck_friction": {}}, v, VALUES)
    noisy = friction({"stribeck_friction": {}}, v, VALUES, noise=1e-3)
    assert quiet[1] > 14.9 and quiet[2] == -quiet[1]
    np.testing.assert_array_equal(noisy[:3], 0.0)
    assert noisy[3] == quiet[3]


def test_friction_goes_from_its_static_to_its_coulomb_level_and_never_back():
    v = np.geomspace(1e-6, 10, 400)
    dry = friction({"stribeck_friction": {}}, v, VALUES)
    assert np.all(np.diff(dry) <= 1e-12)
    assert dry[0] == pytest.approx(VALUES["f_b"]) and dry[-1] == pytest.approx(VALUES["f_c"])
    np.testing.assert_allclose(friction({"stribeck_friction": {}}, -v, VALUES), -dry)


def test_without_a_stribeck_velocity_friction_is_coulomb_s():
    v = np.array([-3.0, -0.001, 0.001, 1.0])
    plain = friction({"stribeck_friction": {}}, v, {**VALUES, "v_b": 0.0})
    np.testing.assert_allclose(plain, 14.9 * np.sign(v))


def test_quadratic_friction_even_as_printed_or_odd():
    v = np.array([-2.0, 0.5])
    only = {"k_v2": 0.7}
    np.testing.assert_allclose(friction({"viscous_friction": {}}, v, only), 0.7 * v**2)
    np.testing.assert_allclose(friction({"viscous_friction": {"quadratic": "odd"}}, v, only), 0.7 * v * np.abs(v))
    both = friction({"viscous_friction": {"quadratic": "both"}}, v, {"k_v2": 0.7, "k_v2_odd": 0.3})
    np.testing.assert_allclose(both, 0.7 * v**2 + 0.3 * v * np.abs(v))


def test_in_vacuum_the_high_orders_are_not_even_parameters():
    symbols = {parameter.symbol for parameter in TorqueModel(ARM, structure_of(ARM, "vacuum")).parameters}
    assert "k_v1" in symbols and not symbols & {"k_v2", "k_v3"}
    both = TorqueModel(ARM, {"viscous_friction": {"vacuum": True, "quadratic": "odd"}})
    assert {parameter.symbol for parameter in both.parameters} == {"k_v1"}


def test_coulomb_viscous_has_no_constant_to_search():
    model = TorqueModel(ARM, structure_of(ARM, "coulomb-viscous"))
    assert all(constant.grid == (0.0,) for constant in model.constants)
    v = np.array([-0.3, 0.3])
    np.testing.assert_allclose(friction(FRICTION_LAWS["coulomb-viscous"], v, {"f_c": 2.0, "k_v1": 3.0}), [-2.9, 2.9])


def test_what_a_structure_leaves_out_of_a_joint_is_held_there():
    structure = {
        "stribeck_friction": {"stribeck": ["elbow"]},
        "joint_spring": {"free": ["shoulder"]},
        "viscous_friction": {},
    }
    held = {parameter.name for parameter in TorqueModel(ARM, structure).parameters if parameter.held}
    assert held == {"f_b[shoulder]", "k_1[elbow]"}


def test_a_scale_of_nothing_is_no_scale():
    with pytest.raises(ValueError, match="held"):
        Parameter("f_b", "elbow", "N m", scale=0.0)


def test_an_unknown_law_or_form_is_refused_by_name():
    with pytest.raises(UserError, match=r"'sticky'.*paper, paper-odd, vacuum, coulomb-viscous"):
        structure_of(ARM, "sticky")
    with pytest.raises(UserError, match="'cubic'"):
        _ = TorqueModel(ARM, {"viscous_friction": {"quadratic": "cubic"}}).terms
    with pytest.raises(UserError, match="unknown term 'magic'"):
        _ = TorqueModel(ARM, {"magic": {}}).terms


def test_friction_that_grows_with_the_load_takes_its_size_and_the_motion_s_sign():
    structure = {"rigid_body": {}, "stribeck_friction": {"load": ["shoulder"]}}
    model = TorqueModel(ARM, structure)
    motion = motion_of(np.array([0.4, -0.4, 0.0, 0.7]))
    values = {"mu": 0.1, "m": 3.0, "mcx": 0.5}
    parameters = np.array([values.get(parameter.symbol, 0.0) for parameter in model.parameters])
    constants = np.zeros(len(model.constants))
    rigid = model.torque(motion, parameters, constants, ("rigid_body",))
    added = model.torque(motion, parameters, constants) - rigid
    np.testing.assert_allclose(added[:, 0], 0.1 * np.abs(rigid[:, 0]) * [1, -1, 0, 1])
    np.testing.assert_array_equal(added[:, 1], 0.0)
    assert [parameter.name for parameter in model.parameters if parameter.symbol == "mu"] == ["mu[shoulder]"]


def stepped(target, travel, distance, start):
    """The recurrence, one sample at a time."""
    state, out = np.array(start, dtype=float), []
    for goal, step in zip(target, travel):
        keep = np.exp(-step / distance)
        state = keep * state + (1 - keep) * goal
        out.append(state)
    return np.array(out)


finite = st.floats(-5, 5, allow_nan=False)


@st.composite
def journeys(draw):
    count = draw(st.integers(1, 40))
    target = draw(st.lists(st.tuples(finite, finite), min_size=count, max_size=count))
    travel = draw(st.lists(st.floats(0, 0.1), min_size=count, max_size=count))
    return np.array(target), np.array(travel), draw(st.floats(1e-4, 0.2))


@given(journeys())
@settings(max_examples=150, deadline=None)
def test_the_bristle_state_is_the_loop(journey):
    target, travel, distance = journey
    before = target.copy()
    np.testing.assert_allclose(
        bristle_state(target, travel, distance), stepped(target, travel, distance, (0, 0)), atol=1e-9
    )
    np.testing.assert_array_equal(target, before)


@given(journeys())
@settings(max_examples=150, deadline=None)
def test_on_a_cycle_it_ends_where_it_began(journey):
    target, travel, distance = journey
    state = bristle_state(target, travel, distance, cyclic=True)
    if travel.sum() / distance > 1e-3:  # Where nothing travels, any state is periodic.
        np.testing.assert_allclose(state, stepped(target, travel, distance, state[-1]), atol=1e-7)


def test_no_presliding_distance_is_no_memory():
    target = np.array([[1.0], [-1.0], [0.5]])
    np.testing.assert_array_equal(bristle_state(target, np.ones(3), 0.0), target)


def test_after_a_reversal_friction_turns_within_the_presliding_distance():
    """Constant speed one way, then the other: 1 - 2 exp(-s/d_s) of the Coulomb level, s from the reversal."""
    v = np.concatenate([np.full(400, 0.5), np.full(400, -0.5)])
    values = {"f_c": 10.0, "d_s": 0.02, "v_b": 0.0}
    dry = friction({"stribeck_friction": {}}, v, values)
    s = 0.5 / RATE * np.arange(1, 401)
    np.testing.assert_allclose(dry[400:], -10 * (1 - 2 * np.exp(-s / 0.02)), atol=1e-6)
    sharp = friction({"stribeck_friction": {}}, v, {**values, "d_s": 1e-6})
    np.testing.assert_allclose(sharp, 10 * np.sign(v), atol=1e-9)


def test_a_joint_that_has_stopped_keeps_the_friction_it_stopped_with():
    v = np.concatenate([np.full(300, 0.3), np.zeros(200)])
    dry = friction({"stribeck_friction": {}}, v, {**VALUES, "d_s": 1e-3})
    np.testing.assert_allclose(dry[300:], dry[299])


def test_in_a_cycle_the_first_sample_remembers_the_last():
    v = np.concatenate([np.full(100, 0.5), np.full(100, -0.5)])
    values = {"f_c": 10.0, "d_s": 0.02, "v_b": 0.0}
    once = friction({"stribeck_friction": {}}, v, values)
    again = friction({"stribeck_friction": {}}, v, values, periods=5)
    thrice = friction({"stribeck_friction": {}}, np.tile(v, 3), values)
    np.testing.assert_allclose(again, thrice[-200:], atol=1e-9)
    assert abs(again[0] - once[0]) > 1.0


def test_the_search_grid_is_sorted_and_begins_with_absence():
    assert STRIBECK_GRID[0] == 0.0
    assert list(STRIBECK_GRID) == sorted(set(STRIBECK_GRID))
