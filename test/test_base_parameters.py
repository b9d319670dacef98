"""Base parameters: what regroups into what, against known counts, closed forms, and the null space itself."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import TWO_LINKS, Link, trees, urdf_of
from scipy.linalg import null_space

from spacearm_ident.dynamics.arm import Coupling, arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.signals.motion import Motion

RIGID = {"rigid_body": {}, "rotor_inertia": {}}

UR_LIKE = (
    Link("pan", axis=(0, 0, 1), xyz=(0, 0, 0.18)),
    Link("lift", parent="pan", xyz=(0, 0.18, 0)),
    Link("elbow", parent="lift", xyz=(0, -0.14, 0.61)),
    Link("wrist_1", parent="elbow", xyz=(0, 0, 0.57)),
    Link("wrist_2", parent="wrist_1", axis=(0, 0, 1), xyz=(0, 0.14, 0)),
    Link("wrist_3", parent="wrist_2", xyz=(0, 0, 0.12)),
)


def model_of(links, structure=None, gravity=(0, 0, -9.81), couplings=()):
    arm = replace(arm_from_urdf(urdf_of(links), np.array(gravity)), couplings=couplings)
    return TorqueModel(arm, structure or RIGID)


def any_motion(model, samples=12, seed=99):
    q, qd, qdd = np.random.default_rng(seed).uniform(-2, 2, (3, samples, len(model.arm.joints)))
    nothing = np.zeros(len(model.arm.joints))
    return Motion(model.arm.joint_names, 100.0, 0.0, q, qd, qdd, np.zeros_like(q), nothing, nothing)


def constants_of(model):
    return np.array([constant.grid[-1] for constant in model.constants])


def torque(model, parameters):
    return model.torque(any_motion(model), parameters, constants_of(model))


def position(model, name):
    return [parameter.name for parameter in model.parameters].index(name)


def assert_regrouped(model, base, tolerance=1e-9):
    """Only the base values matter: A x = A[:, independent] K x, and nothing in K's null space is felt."""
    parameters = np.random.default_rng(5).normal(size=len(model.parameters))
    reduced = np.zeros_like(parameters)
    reduced[list(base.independent)] = base.regrouping @ parameters
    whole = torque(model, parameters)
    size = np.abs(whole).max()
    np.testing.assert_allclose(torque(model, reduced), whole, rtol=0, atol=tolerance * size)
    hidden = null_space(base.regrouping) @ np.ones(len(parameters) - len(base.independent))
    if len(hidden) and np.any(hidden):
        np.testing.assert_allclose(torque(model, parameters + hidden), whole, rtol=0, atol=tolerance * size)


def test_a_planar_2r_arm_has_the_textbook_base_parameters():
    model = model_of(TWO_LINKS)
    base = base_parameters(model)
    assert [model.parameters[k].name for k in base.independent] == [
        "mcx[shoulder]",
        "mcz[shoulder]",
        "Iyy[shoulder]",
        "mcx[elbow]",
        "mcz[elbow]",
        "Iyy[elbow]",
        "J_m[elbow]",
    ]
    # Length of the upper arm .5 m, along z: its moment carries the forearm's mass, its inertia the square.
    row = dict(zip([model.parameters[k].name for k in base.independent], base.regrouping))
    inertia, moment = np.zeros(len(model.parameters)), np.zeros(len(model.parameters))
    for name, value in {"Iyy[shoulder]": 1.0, "J_m[shoulder]": 1.0, "m[elbow]": 0.25}.items():
        inertia[position(model, name)] = value
    for name, value in {"mcz[shoulder]": 1.0, "m[elbow]": 0.5}.items():
        moment[position(model, name)] = value
    np.testing.assert_allclose(row["Iyy[shoulder]"], inertia, atol=1e-9)
    np.testing.assert_allclose(row["mcz[shoulder]"], moment, atol=1e-9)
    for name in ("mcx[shoulder]", "mcx[elbow]", "mcz[elbow]", "Iyy[elbow]", "J_m[elbow]"):
        assert base.alone(position(model, name))
    assert not base.alone(position(model, "Iyy[shoulder]"))
    assert not base.alone(position(model, "m[elbow]"))
    unseen = {model.parameters[k].name for k in base.unseen}
    assert {"m[shoulder]", "mcy[shoulder]", "Ixx[shoulder]", "mcy[elbow]", "Izz[elbow]"} <= unseen
    assert_regrouped(model, base)


def test_without_gravity_a_2r_arm_shows_two_parameters_fewer():
    """The upper arm's first moment is felt through gravity alone."""
    base = base_parameters(model := model_of(TWO_LINKS, gravity=(0, 0, 0)))
    leads = [model.parameters[k].name for k in base.independent]
    assert leads == ["Iyy[shoulder]", "mcx[elbow]", "mcz[elbow]", "Iyy[elbow]", "J_m[elbow]"]
    assert position(model, "mcz[shoulder]") in base.unseen
    assert_regrouped(model, base)


def test_an_arm_like_a_ur_has_36_rigid_base_parameters_and_4_rotors():
    rigid = base_parameters(model_of(UR_LIKE, {"rigid_body": {}}))
    assert len(rigid.independent) == 36
    model = model_of(UR_LIKE)
    base = base_parameters(model)
    assert len(base.independent) == 40
    rotors = [model.parameters[k].joint for k in base.independent if model.parameters[k].symbol == "J_m"]
    assert len(rotors) == 4 and "pan" not in rotors
    assert_regrouped(model, base)
    assert len(base_parameters(model_of(UR_LIKE, gravity=(0, 0, 0))).independent) < 40


def test_friction_springs_and_offsets_are_base_parameters_of_their_own():
    structure = {**structure_of(model_of(TWO_LINKS).arm), "torque_offset": {}}
    model = model_of(TWO_LINKS, structure)
    base = base_parameters(model)
    assert len(base.independent) == 7 + 2 * (2 + 3 + 1 + 1)
    for symbol in ("f_c", "f_b", "k_v1", "k_v2", "k_v3", "k_1", "offset"):
        assert base.alone(position(model, f"{symbol}[shoulder]"))
    assert_regrouped(model, base)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_random_motions_the_answer_is_the_same(seed):
    """Friction that acts near standstill alone must not hang on whether a random speed happens to be small."""
    model = model_of(TWO_LINKS, structure_of(model_of(TWO_LINKS).arm))
    first, other = base_parameters(model, 100), base_parameters(model, seed)
    assert other.independent == first.independent
    assert other.unseen == first.unseen
    np.testing.assert_allclose(other.regrouping, first.regrouping, atol=1e-8)


def test_a_coupled_motor_adds_its_friction_and_regroups_its_inertia():
    """r r' of the motor's ratios is a combination of what the two links and the elbow's rotor feel."""
    coupling = Coupling("wrist", {"shoulder": 1.0, "elbow": -0.5})
    structure = structure_of(replace(model_of(TWO_LINKS).arm, couplings=(coupling,)))
    model = model_of(TWO_LINKS, structure, couplings=(coupling,))
    without = model_of(TWO_LINKS, structure_of(model_of(TWO_LINKS).arm))
    base = base_parameters(model)
    assert len(base.independent) == len(base_parameters(without).independent) + 2
    assert base.alone(position(model, "k_v1[wrist]")) and base.alone(position(model, "f_c[wrist]"))
    motor = {
        model.parameters[lead].name: row[position(model, "J_m[wrist]")]
        for lead, row in zip(base.independent, base.regrouping)
        if row[position(model, "J_m[wrist]")]
    }
    assert motor == pytest.approx({"Iyy[shoulder]": 1.5, "Iyy[elbow]": -0.5, "J_m[elbow]": 0.75})
    assert_regrouped(model, base)


def test_a_motor_coupled_twice_the_same_way_is_known_only_as_a_sum():
    twins = tuple(Coupling(name, {"shoulder": 1.0, "elbow": 1.0}) for name in ("left", "right"))
    model = model_of(TWO_LINKS, {"rigid_body": {}, "coupled_motor": {}}, couplings=twins)
    base = base_parameters(model)
    row = next(row for row in base.regrouping if row[position(model, "f_c[left]")])
    assert row[position(model, "f_c[right]")] == pytest.approx(1.0)
    assert not base.alone(position(model, "f_c[left]"))


def parsed(name):
    """A base parameter's name as {parameter: factor}."""
    parts = re.findall(r"(^|[+-] )([0-9.e+-]+ )?(\w+\[[\w+]+\])", name)
    assert "".join(f"{sign}{factor}{symbol}" + " " for sign, factor, symbol in parts).strip() == name
    return {symbol: (-1.0 if sign.startswith("-") else 1.0) * float(factor or 1) for sign, factor, symbol in parts}


@pytest.mark.parametrize("links", [TWO_LINKS, UR_LIKE])
def test_names_say_the_combination(links):
    model = model_of(links)
    base = base_parameters(model)
    for name, row, lead in zip(base.names, base.regrouping, base.independent):
        said = parsed(name)
        assert next(iter(said)) == model.parameters[lead].name
        found = np.array([said.get(parameter.name, 0.0) for parameter in model.parameters])
        np.testing.assert_allclose(found, row, rtol=1e-3, atol=1e-6)


@given(links=trees(), gravity=st.sampled_from([(0.0, 0.0, -9.81), (0.0, 0.0, 0.0), (3.0, -2.0, 7.0)]))
@settings(max_examples=30, deadline=None)
def test_on_any_tree_only_base_values_matter_and_none_is_redundant(links, gravity):
    model = model_of(links, gravity=gravity)
    base = base_parameters(model)
    assert_regrouped(model, base, tolerance=1e-5)
    leads = np.eye(len(model.parameters))[list(base.independent)]
    columns = np.array([torque(model, lead).ravel() for lead in leads])
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    assert np.linalg.svd(columns, compute_uv=False)[-1] > 1e-10
