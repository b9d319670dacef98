"""Effects that move bodies or couple joints: against Pinocchio and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from effect_torque import (
    ARM,
    RATE,
    W,
    arm_of,
    background_of,
    one,
    only,
    rnea,
    torque,
    wave,
)
from planted_arm import THREE_LINKS, urdf_of

from spacearm_ident.dynamics.effects import EFFECTS

# --- bodies: against Pinocchio --------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", [0, 1, 2])
def test_a_payload_is_what_a_heavier_link_costs(link):
    """A point's moment statically; mass, moment and inertia about the joint in motion, products of inertia too."""
    mass, centre = 3.0, np.array([0.04, -0.06, 0.3])
    spread = np.array([[0.01, 0.002, -0.001], [0.002, 0.02, 0.003], [-0.001, 0.003, 0.03]])

    def heavier(model):
        model.inertias[link + 1] += pin.Inertia(mass, centre, spread)

    around = spread + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    about_joint = around[np.triu_indices(3)][[0, 1, 3, 2, 4, 5]]
    state = W.position, W.velocity, W.acceleration
    want = rnea(THREE_LINKS, *state, change=heavier) - rnea(THREE_LINKS, *state)
    full = one("payload", ARM, joint=ARM.joint_names[link], inertia=True)
    made = torque(full, W, [mass, *(mass * centre), *about_joint], (), background_of(ARM, W))
    np.testing.assert_allclose(made, want, atol=1e-9)
    still = replace(W, velocity=0 * W.velocity, acceleration=0 * W.acceleration)
    held = (W.position, still.velocity, still.acceleration)
    want = rnea(THREE_LINKS, *held, change=heavier) - rnea(THREE_LINKS, *held)
    point = one("payload", ARM, joint=ARM.joint_names[link])
    made = torque(point, still, [mass, *(mass * centre)], (), background_of(ARM, still))
    np.testing.assert_allclose(made, want, atol=1e-9)
    assert point.plausible(np.array([mass, *(mass * centre)]), ())
    assert not point.plausible(np.array([0.1, *(mass * centre)]), ())


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilted_base_is_gravity_from_another_side(axis):
    angle, still = 1e-5, np.zeros_like(W.position)
    turn = pin.exp3(angle * np.eye(3)[axis])
    level, tilted = (rnea(THREE_LINKS, W.position, still, still, g) for g in (ARM.gravity, turn.T @ ARM.gravity))
    tilt = np.zeros(2)
    tilt[axis] = angle
    made = torque(one("base_tilt", ARM), W, tilt, (), background_of(ARM, W))
    np.testing.assert_allclose(made / angle, (tilted - level) / angle, atol=1e-3)
    assert np.abs(made).max() > 0


@pytest.mark.parametrize("tilt", [(0.3, 0.0), (-0.2, 0.25)])
def test_a_base_that_is_tilted_far_is_gravity_turned_not_sheared(tilt):
    still = np.zeros_like(W.position)
    turn = pin.exp3(np.array([*tilt, 0.0]))
    level, tilted = (rnea(THREE_LINKS, W.position, still, still, g) for g in (ARM.gravity, turn.T @ ARM.gravity))
    effect, here = one("base_tilt", ARM), background_of(ARM, W)
    made = torque(effect.around(tilt), W, np.array(tilt), (), here)
    np.testing.assert_allclose(made, tilted - level, atol=1e-9)
    in_a_model = replace(here, values={**here.values, "tilt_x[base]": tilt[0], "tilt_y[base]": tilt[1]}, kept={})
    np.testing.assert_allclose(torque(effect, W, np.array(tilt), (), in_a_model), tilted - level, atol=1e-9)


def test_without_gravity_no_base_is_tilted():
    assert not list(EFFECTS["base_tilt"].variants(arm_of(gravity=(0.0, 0.0, 0.0))))


def test_a_floating_base_moves_as_momentum_demands():
    """Pinocchio's free-flyer with zero momentum and no force on its base."""
    mass, radius, below = 40.0, 0.4, 0.25
    model = pin.buildModelFromXML(urdf_of(THREE_LINKS), pin.JointModelFreeFlyer())
    model.gravity.linear = np.zeros(3)
    model.inertias[1] = pin.Inertia(mass, np.array([0.0, 0.0, -below]), mass * radius**2 * np.eye(3))
    data = model.createData()
    some = slice(0, 1000, 100)
    want = []
    for q, qd, qdd in zip(W.position[some], W.velocity[some], W.acceleration[some]):
        whole = np.concatenate([[0, 0, 0, 0, 0, 0, 1], q])
        inertia = pin.crba(model, data, whole)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        base = -np.linalg.solve(inertia[:6, :6], inertia[:6, 6:] @ qd)
        speed = np.concatenate([base, qd])
        pin.computeCentroidalMomentum(model, data, whole, speed)
        np.testing.assert_allclose(data.hg.vector, 0.0, atol=1e-9)
        bias = pin.rnea(model, data, whole, speed, np.zeros(9))
        accelerated = -np.linalg.solve(inertia[:6, :6], inertia[:6, 6:] @ qdd + bias[:6])
        want.append(pin.rnea(model, data, whole, speed, np.concatenate([accelerated, qdd]))[6:])
    fixed = rnea(THREE_LINKS, W.position[some], W.velocity[some], W.acceleration[some], np.zeros(3))
    made = torque(one("floating_base", ARM), W, [1.0], [mass * radius**2, mass, below], background_of(ARM, W))
    np.testing.assert_allclose(made[some], np.array(want) - fixed, atol=1e-8)
    assert np.abs(made).max() > 0.1


def test_a_base_as_heavy_as_a_house_does_not_float():
    made = torque(one("floating_base", ARM), W, [1.0], [1e11, 1e9, 0.3], background_of(ARM, W))
    np.testing.assert_allclose(made, 0.0, atol=1e-5)


def test_a_push_is_held_by_the_transposed_jacobian_of_its_point_in_its_window():
    force, model = np.array([3.0, -5.0, 8.0]), pin.buildModelFromXML(urdf_of(THREE_LINKS))
    want = np.zeros_like(W.position)
    time, point, rise = 10.0 + np.arange(len(want)) / RATE, np.array([0.1, -0.05, 0.08]), 0.2
    frame = model.addFrame(pin.Frame("touched", 3, 0, pin.SE3(np.eye(3), point), pin.FrameType.OP_FRAME))
    data = model.createData()
    for k in np.flatnonzero((time >= 11.0) & (time < 12.5)):
        jacobian = pin.computeFrameJacobian(model, data, W.position[k], frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        edge = min(1.0, (time[k] - 11.0) / rise, (12.5 - time[k]) / rise)
        want[k] = -jacobian.T @ force * np.sin(0.5 * np.pi * edge) ** 2
    late = replace(W, start_s=10.0)
    constants = [11.0, 1.5, rise, *point]
    made = torque(one("external_contact", ARM, joint="elbow"), late, force, constants, background_of(ARM, late))
    np.testing.assert_allclose(made, want, atol=1e-9)


def test_a_touch_is_no_blow():
    push = one("external_contact", ARM, joint="elbow")
    assert push.plausible(np.array([40.0, 0.0, 200.0]), (11.0, 1.5))
    assert not push.plausible(np.array([40.0, 0.0, -500.0]), (11.0, 1.5))


# --- coupling -------------------------------------------------------------------------------------------------------


def test_a_rotor_couples_by_how_far_axes_point_the_same_way_and_symmetrically():
    model = pin.buildModelFromXML(urdf_of(SKEW))
    data, arm = model.createData(), arm_of(SKEW)
    motion = wave(arm.joint_names, seed=5)
    aligned = np.empty((len(motion.position), 3))
    for k, q in enumerate(motion.position):
        pin.forwardKinematics(model, data, q)
        axes = [data.oMi[j + 1].rotation @ arm.joints[j].axis for j in range(3)]
        aligned[k] = [axis @ axes[2] for axis in axes]
    background, qdd = background_of(arm, motion), motion.acceleration
    want = np.stack(
        [
            aligned[:, 0] * qdd[:, 2],
            aligned[:, 1] * qdd[:, 2],
            aligned[:, 0] * qdd[:, 0] + aligned[:, 1] * qdd[:, 1],
        ],
        axis=1,
    )
    effect = one("rotor_coupling", arm, joint="elbow")
    np.testing.assert_allclose(torque(effect, motion, [1.0], (), background), want, atol=1e-9)
    pair = one("rotor_coupling", arm, joint="elbow", **{"with": "shoulder"})
    want[:, 0], want[:, 2] = 0.0, aligned[:, 1] * qdd[:, 1]
    np.testing.assert_allclose(torque(pair, motion, [1.0], (), background), want, atol=1e-9)


def test_neighbours_at_right_angles_couple_through_bevel_gears():
    links = (
        THREE_LINKS[0],
        replace(THREE_LINKS[1], rpy=(np.pi / 2, 0.0, 0.0)),
        replace(THREE_LINKS[2], rpy=(1.57, 0.0, 0.0)),
    )
    arm = arm_of(links)
    motion = wave(arm.joint_names, seed=5)
    background, qdd = background_of(arm, motion), motion.acceleration
    pair = one("rotor_coupling", arm, joint="elbow", **{"with": "shoulder"})
    want = np.stack([np.zeros(len(qdd)), qdd[:, 2], qdd[:, 1]], axis=1)
    np.testing.assert_allclose(torque(pair, motion, [1.0], (), background), want, atol=1e-9)
    # A rotor about the elbow's own axis does not feel the shoulder.
    assert not torque(one("rotor_coupling", arm, joint="elbow"), motion, [1.0], (), background)[:, 1].any()


SKEW = (THREE_LINKS[0], replace(THREE_LINKS[1], rpy=(0.4, 0.2, 0.1)), replace(THREE_LINKS[2], rpy=(-0.5, 0.3, 0.2)))


@pytest.mark.parametrize("ratio", [None, 1.0, -1.0])
def test_a_wrist_rubs_with_its_neighbour_or_with_both(ratio):
    place = {} if ratio is None else {"ratio": ratio}
    effect = one("wrist_coupling", ARM, joint="elbow", **{"with": "shoulder"}, **place)
    mine = ratio or 0.0
    speed, bend = (x[:, 1] + mine * x[:, 2] for x in (W.velocity, W.acceleration))
    common = 0.1 * bend + 0.5 * speed + 2.0 * np.sign(speed)
    want = only(2, common) if ratio is None else only(1, common) + only(2, mine * common)
    np.testing.assert_allclose(torque(effect, W, [0.1, 0.5, 2.0]), want, atol=1e-12)


@pytest.mark.parametrize("ratio", [1.0, -1.0])
def test_a_motor_that_turns_with_both_joints_no_longer_turns_with_one(ratio):
    """Its power is of the common motion: what the reference has of it at its own joint is taken away there."""
    effect = one("wrist_coupling", ARM, joint="elbow", **{"with": "shoulder"}, ratio=ratio, moved=True)
    felt = torque(effect, W, [0.1, 0.5, 2.0])
    power = np.sum(felt * W.velocity, axis=1)
    speed, bend = (x[:, 1] + ratio * x[:, 2] for x in (W.velocity, W.acceleration))
    own_speed, own_bend = W.velocity[:, 2], W.acceleration[:, 2]
    taken = own_speed * (0.1 * own_bend + 0.5 * own_speed + 2.0 * np.sign(own_speed))
    np.testing.assert_allclose(power, speed * (0.1 * bend + 0.5 * speed + 2.0 * np.sign(speed)) - taken, atol=1e-12)
    assert effect.needs_reference
    assert not one("wrist_coupling", ARM, joint="elbow", **{"with": "shoulder"}, ratio=ratio).needs_reference


@pytest.mark.parametrize(
    ("values", "gear"),
    [([0.0, 0.6, 1.7], True), ([0.01, -0.001, 0.06], True), ([0.0, 1.5, -0.15], False), ([0.0, 1.5, 0.1], False)],
)
def test_a_gear_rubs_dry_and_brakes(values, gear):
    """[J, k, f]: what grows with speed alone, as a gyroscope's torque does, is no gear."""
    effect = one("wrist_coupling", ARM, joint="elbow", **{"with": "shoulder"})
    assert effect.plausible(np.array(values), ()) is gear
    both = one("wrist_coupling", ARM, joint="elbow", **{"with": "shoulder"}, ratio=1.0)
    assert not both.plausible(-np.array(values), ())
