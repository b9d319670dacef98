"""The batched regressor against Pinocchio's, one sample at a time, on random trees."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import THREE_LINKS, Link, real, trees, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.regressor import BASE_LINK, BASE_ROWS, regressor, rigid_body_blocks, rigid_body_torque
from spacearm_ident.signals.base_motion import BaseMotion

SAMPLES = 4


def pinocchio_position(model, q):
    """An unbounded joint is its cosine and sine there."""
    whole = pin.neutral(model)
    for k in range(1, model.njoints):
        joint = model.joints[k]
        value = q[joint.idx_v]
        if joint.nq == 7:  # A free base stays where it is: only its velocity and acceleration count.
            continue
        whole[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else (value,)
    return whole


def reference(urdf, gravity, q, qd, qdd):
    """Pinocchio's regressor and inverse dynamics, sample by sample."""
    model = pin.buildModelFromXML(urdf)
    model.gravity.linear = np.asarray(gravity, dtype=float)
    data = model.createData()
    columns, torque = [], []
    for state in zip(q, qd, qdd):
        position = pinocchio_position(model, state[0])
        regressor_now = pin.computeJointTorqueRegressor(model, data, position, state[1], state[2])
        columns.append(np.array(regressor_now).reshape(model.nv, -1))  # A single row comes as a vector.
        torque.append(pin.rnea(model, data, position, state[1], state[2]).copy())
    return np.array(columns), np.array(torque)


@given(
    links=trees(),
    gravity=st.one_of(st.just((0.0, 0.0, 0.0)), st.tuples(*[real(-10, 10)] * 3)),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_it_is_pinocchio_s_on_any_tree(links, gravity, seed):
    urdf = urdf_of(links)
    arm = arm_from_urdf(urdf, np.array(gravity))
    q, qd, qdd = np.random.default_rng(seed).uniform(-3, 3, (3, SAMPLES, len(arm.joints)))
    columns, torque = reference(urdf, gravity, q, qd, qdd)
    mine = regressor(arm, q, qd, qdd)
    scale = max(1.0, np.abs(columns).max())
    np.testing.assert_allclose(mine, columns, rtol=0, atol=1e-10 * scale)
    inertials = np.concatenate([joint.inertial for joint in arm.joints])
    close = 1e-9 * max(1.0, np.abs(torque).max())
    np.testing.assert_allclose(mine @ inertials, torque, rtol=0, atol=close)
    direct = rigid_body_torque(arm, inertials.reshape(-1, 10), q, qd, qdd)
    np.testing.assert_allclose(direct, torque, rtol=0, atol=close)


@given(links=trees(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_on_a_moving_base_it_is_pinocchio_s_on_a_free_flyer(links, seed):
    rng = np.random.default_rng(seed)
    urdf = urdf_of(links)
    arm = arm_from_urdf(urdf)
    count = len(arm.joints)
    q, qd, qdd = rng.uniform(-3, 3, (3, SAMPLES, count))
    speed, rate, rate_dot, acceleration, gravity = rng.uniform(-3, 3, (5, SAMPLES, 3))
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    # The joints' torque must not depend on how fast the base goes straight on, nor on what of its force is gravity.
    base = BaseMotion(rate, rate_dot, acceleration - gravity)
    blocks = rigid_body_blocks(arm, q, qd, qdd, base, base_rows=True)
    for k in range(SAMPLES):
        model.gravity.linear = gravity[k]
        twist, joints = np.concatenate([speed[k], rate[k]]), np.zeros(model.nv)
        # Pinocchio's spatial acceleration is the classical one less the angular times the linear velocity.
        joints[:3], joints[3:6], joints[6:] = acceleration[k] - np.cross(rate[k], speed[k]), rate_dot[k], qdd[k]
        position = pinocchio_position(model, np.concatenate([np.zeros(6), q[k]]))
        theirs = pin.computeJointTorqueRegressor(
            model, model.createData(), position, np.concatenate([twist, qd[k]]), joints
        )
        mine = np.zeros((6 + count, 10 * (1 + count)))
        for (row, link), block in blocks.items():
            mine[6 + row, 10 * (link + 1) : 10 * (link + 2)] = block[:, k]
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-10 * max(1.0, np.abs(theirs).max()))
    assert {(row, BASE_LINK) for row in BASE_ROWS} < set(blocks)
    plain = rigid_body_blocks(arm, q, qd, qdd, base)
    assert set(plain) == {place for place in blocks if place[0] >= 0}
    assert all(np.array_equal(plain[place], blocks[place]) for place in plain)
    inertials = rng.uniform(-3, 3, (count, 10))  # The formula is linear: no link has to exist.
    torque = np.zeros((SAMPLES, count))
    for (row, link), block in plain.items():
        torque[:, row] += inertials[link] @ block
    direct = rigid_body_torque(arm, inertials, q, qd, qdd, base)
    np.testing.assert_allclose(direct, torque, rtol=0, atol=1e-10 * max(1.0, np.abs(torque).max()))


def test_blocks_are_there_exactly_where_a_joint_carries_a_link():
    links = (Link("trunk"), Link("left", parent="trunk"), Link("right", parent="trunk"))
    arm = arm_from_urdf(urdf_of(links))
    blocks = rigid_body_blocks(arm, *np.zeros((3, 2, 3)))
    at = arm.joint_names.index
    carried = {(at("trunk"), link) for link in range(3)} | {(at("left"), at("left")), (at("right"), at("right"))}
    assert set(blocks) == carried
    assert {block.shape for block in blocks.values()} == {(10, 2)}


def test_in_orbit_an_arm_at_rest_needs_no_torque():
    arm = arm_from_urdf(urdf_of(THREE_LINKS), np.zeros(3))
    q = np.random.default_rng(0).uniform(-3, 3, (5, 3))
    np.testing.assert_array_equal(regressor(arm, q, np.zeros_like(q), np.zeros_like(q)), 0.0)


@pytest.mark.parametrize("samples", [0, 1, 1000])
def test_any_number_of_samples_at_once_is_the_same_as_one_by_one(samples):
    arm = arm_from_urdf(urdf_of(THREE_LINKS))
    q, qd, qdd = np.random.default_rng(1).uniform(-3, 3, (3, samples, 3))
    together = regressor(arm, q, qd, qdd)
    assert together.shape == (samples, 3, 30)
    for k in range(0, samples, 97):
        alone = regressor(arm, q[k : k + 1], qd[k : k + 1], qdd[k : k + 1])[0]
        np.testing.assert_allclose(together[k], alone, atol=1e-12)
