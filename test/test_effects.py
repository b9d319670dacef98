"""Every effect's columns against closed forms, and against Pinocchio where the arm's dynamics enter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from contract import CONTRACT
from planted_arm import THREE_LINKS, TWO_LINKS, Link, multisine, urdf_of

from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.background import Background
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.recording.motion import Motion

RATE = 250.0
PENDULUM = (Link("hip", mass=2.0, com=(0.0, 0.0, -0.5), inertia=(0.03, 0, 0, 0.03, 0, 0.01)),)
HANGING_NM, PENDULUM_INERTIA = 2.0 * 9.81 * 0.5, 0.03 + 2.0 * 0.5**2
BASE = {"rigid_body": {}, "rotor_inertia": {}, "viscous_friction": {}}
ODD = {**BASE, "viscous_friction": {"quadratic": "odd"}}


def arm_of(links=THREE_LINKS, gravity=(0.0, 0.0, -9.81)) -> Arm:
    return arm_from_urdf(urdf_of(links), np.array(gravity))


def motion_of(joints, q, qd, qdd, rate=RATE, temperature=None, noise=0.0, start=0.0) -> Motion:
    count, zero = len(joints), np.zeros_like(q)
    return Motion(
        joints, rate, start, q, qd, qdd, zero, np.full(count, noise), np.zeros(count), temperature=temperature
    )


def wave(joints, seconds=4.0, seed=0, speed=1.5, **more) -> Motion:
    time = np.arange(0.0, seconds, 1 / more.get("rate", RATE))
    return motion_of(joints, *multisine(time, len(joints), seed, 0.25, 4, speed), **more)


def healthy(arm: Arm, structure=BASE, **values) -> IdentifiedModel:
    """Rigid links as in the URDF; others by symbol, the same at every joint."""
    model = TorqueModel(arm, structure)
    count = 10 * len(arm.joints)
    rigid = np.concatenate([joint.inertial for joint in arm.joints])
    others = [values.get(parameter.symbol, 0.0) for parameter in model.parameters[count:]]
    return IdentifiedModel(model, np.concatenate([rigid, others]), np.zeros(0))


def background_of(arm: Arm, motion: Motion, structure=BASE, **values) -> Background:
    known = healthy(arm, structure, **values)
    return known.model.background(motion, known.parameters, known.constants)


def one(kind, arm, **place):
    (effect,) = EFFECTS[kind].build(arm, {"at": [place]})
    return effect


def torque(effect, motion, parameters, constants=(), background=None):
    """(N, n) what the effect adds."""
    total = np.zeros_like(motion.position)
    for row, (indices, columns) in effect.columns(motion, constants, background).items():
        total[:, row] += columns @ np.asarray(parameters, dtype=float)[indices]
    return total


def only(row, values, count=3):
    total = np.zeros((len(values), count))
    total[:, row] = values
    return total


def rnea(links, q, qd, qdd, gravity=(0.0, 0.0, -9.81), change=None):
    model = pin.buildModelFromXML(urdf_of(links))
    model.gravity.linear = np.array(gravity, dtype=float)
    if change is not None:
        change(model)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd)])


def fitted(signal, time, omega):
    """Complex amplitude of a sine of known frequency: a in Im(a e^(i w t))."""
    columns = np.stack([np.sin(omega * time), np.cos(omega * time)], axis=1)
    sine, cosine = np.linalg.lstsq(columns, signal, rcond=None)[0]
    return complex(sine, cosine)


# --- the catalogue --------------------------------------------------------------------------------------------------

ARM = arm_of()
PLACES = [(kind, place) for kind, effect in EFFECTS.items() for place in effect.variants(ARM)]


def middle(effect):
    return [constant.grid[len(constant.grid) // 2] for constant in effect.constants]


def test_every_name_of_the_contract_is_there():
    assert set(CONTRACT) <= set(EFFECTS)
    assert "unknown" not in EFFECTS
    assert all(kind == effect.kind for kind, effect in EFFECTS.items())
    assert all(set(effect.confused_with) <= set(EFFECTS) for effect in EFFECTS.values())


NEEDS_NO_BACKGROUND = {
    "friction_drift",
    "temperature_friction",
    "presliding_hysteresis",
    "position_friction",
    "asymmetric_friction",
    "stribeck",
    "torque_ripple",
    "harness_spring",
    "wrist_coupling",
    "current_offset",
}


@pytest.mark.parametrize("kind", EFFECTS)
def test_columns_are_finite_everywhere_and_zero_before_the_model_is_known(kind):
    motion = wave(ARM.joint_names, temperature=np.full((1000, 3), 35.0))
    background = background_of(ARM, motion, k_v1=3.0, k_v2=0.3, k_v3=-0.1, J_m=0.3)
    places = [place for name, place in PLACES if name == kind]
    assert places
    felt = []
    for place in places:
        effect = one(kind, ARM, **place)
        constants = [1.0 if c.symbol == "start" else value for c, value in zip(effect.constants, middle(effect))]
        known = effect.columns(motion, constants, background)
        assert all(np.isfinite(values).all() for _, values in known.values())
        felt.append(any(values.any() for _, values in known.values()))
        unknown = effect.columns(motion, middle(effect), None)
        for indices, values in unknown.values():
            assert values.shape == (len(motion.position), len(indices)) and np.isfinite(values).all()
            assert kind in NEEDS_NO_BACKGROUND or not values.any()
    # A rotor couples nothing to a carrier that turns across its axis; an upright first axis carries no point's weight,
    # nor does it feel a push on the shoulder, which is above it.
    fewer = len(places) - 1
    assert sum(felt) >= {"rotor_coupling": 1, "payload": fewer, "external_contact": fewer}.get(kind, len(places))


@pytest.mark.parametrize("kind", EFFECTS)
def test_a_model_with_every_variant_at_once_loads_back_to_the_same_torque(kind, tmp_path):
    """Several places at one joint keep a value each."""
    places = [dict(place) for name, place in PLACES if name == kind]
    base = healthy(ARM, k_v1=3.0, k_v2=0.3, k_v3=-0.1, J_m=0.3)
    model = TorqueModel(ARM, {**BASE, kind: {"at": places}})
    names = [item.name for item in (*model.parameters, *model.constants)]
    assert len(set(names)) == len(names)
    more = len(model.parameters) - len(base.parameters)
    constants = [value for term in model.terms if term.constants for value in middle(term)]
    saved = IdentifiedModel(
        model, np.concatenate([base.parameters, np.linspace(0.01, 0.02, more)]), np.array(constants), 20.0
    )
    save_model(saved, tmp_path / "model.yaml")
    loaded = load_model(tmp_path / "model.yaml")
    np.testing.assert_array_equal(loaded.parameters, saved.parameters)
    np.testing.assert_array_equal(loaded.constants, saved.constants)
    motion = wave(ARM.joint_names, seconds=1.0, temperature=np.full((250, 3), 35.0))
    np.testing.assert_array_equal(loaded.torque(motion), saved.torque(motion))


STRANGERS = [
    (kind, {**place, **{key: ["nobody"] if key == "joints" else "nobody"}})
    for kind, place in PLACES
    for key in ("joint", "joints", "with")
    if key in place
]


@pytest.mark.parametrize("kind", sorted({kind for kind, _ in STRANGERS}))
def test_a_joint_that_the_arm_does_not_have_is_refused(kind):
    for name, place in STRANGERS:
        if name == kind:
            with pytest.raises(UserError, match="nobody") as caught:
                EFFECTS[kind].build(ARM, {"at": [place]})
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("torque_ripple", {"at": "shoulder"}),
        ("torque_ripple", {"at": ["shoulder"]}),
        ("torque_ripple", {"at": [{}]}),
        ("time_delay", {"at": [{}]}),
        ("vacuum_friction", {"at": [{"joints": []}]}),
        ("link_flexibility", {"at": [{"joint": "elbow"}]}),
        ("base_flexibility", {"at": [{"axis": [0, 1]}]}),
        ("base_flexibility", {"at": [{"axis": [0, 0, 0]}]}),
        ("position_friction", {"at": [{"joint": "elbow", "cycles": "many"}]}),
        ("friction_drift", {"at": [{"joint": "elbow", "of": ["colour"]}]}),
        ("rotor_coupling", {"at": [{"joint": "waist"}]}),
    ],
)
def test_places_that_say_too_little_are_refused_in_one_line(kind, options):
    with pytest.raises(UserError, match=kind) as caught:
        EFFECTS[kind].build(ARM, options)
    assert "\n" not in str(caught.value)


# --- functions of the joint's own motion ----------------------------------------------------------------------------

W = wave(ARM.joint_names, seed=3)
Q, V = W.position[:, 1], W.velocity[:, 1]
S = np.sign(V)


@pytest.mark.parametrize(
    ("kind", "place", "parameters", "constants", "want"),
    [
        ("torque_ripple", {}, [1.5 * np.cos(0.3), 1.5 * np.sin(0.3)], [20.0], 1.5 * np.sin(20 * Q + 0.3)),
        ("harness_spring", {}, [3.0, -3.0 * 0.2], [], 3.0 * (Q - 0.2)),
        ("friction_drift", {"of": ["f_c"]}, [0.7], [], 0.7 * S),
        ("friction_drift", {"of": ["k_v1"]}, [0.7], [], 0.7 * V),
        ("friction_drift", {"of": ["f_c", "k_v1"]}, [0.7, -0.2], [], 0.7 * S - 0.2 * V),
        ("friction_drift", {"of": ["f_c", "creep"]}, [0.7, 0.1], [], (0.7 + 0.1 * np.arange(len(Q)) / RATE) * S),
        ("position_friction", {"cycles": 2}, [0.6, 0.8], [], np.sin(2 * Q + np.arctan2(0.8, 0.6)) * S),
        ("asymmetric_friction", {"of": ["level", "viscous"]}, [0.5, 0.3], [], 0.5 + 0.3 * np.abs(V)),
        ("stribeck", {}, [2.0], [0.1], 2.0 * np.exp(-(V**2) / 0.01) * S),
        ("current_offset", {}, [-1.5], [], np.full_like(Q, -1.5)),
    ],
)
def test_laws_of_one_joint_are_what_they_say_and_touch_no_other(kind, place, parameters, constants, want):
    effect = one(kind, ARM, joint="shoulder", **place)
    np.testing.assert_allclose(torque(effect, W, parameters, constants), only(1, want), atol=1e-12)
    assert effect.joints == ("shoulder",)


def test_amplitude_and_phase_are_shown():
    for kind, place, values in (
        ("torque_ripple", {}, [1.5 * np.cos(0.3), 1.5 * np.sin(0.3), 20.0]),
        ("position_friction", {"cycles": 2}, [1.5 * np.cos(0.3), 1.5 * np.sin(0.3)]),
        ("encoder_eccentricity", {}, [1.5 * np.cos(0.3), 1.5 * np.sin(0.3)]),
    ):
        shown = one(kind, ARM, joint="elbow", **place).shown(np.array(values))
        assert shown["amplitude"][0] == pytest.approx(1.5) and shown["phase"][0] == pytest.approx(0.3)


def test_a_second_harmonic_has_a_name_of_its_own():
    first = one("torque_ripple", ARM, joint="elbow")
    second = first.again(ARM)
    assert not {p.name for p in first.parameters} & {p.name for p in second.parameters}
    assert second.constants[0].name != first.constants[0].name


def test_friction_below_the_noise_of_speed_is_nothing():
    noisy = replace(W, speed_noise=np.full(3, 10.0))
    for kind, place in (("friction_drift", {}), ("stribeck", {}), ("position_friction", {"cycles": 1})):
        effect = one(kind, ARM, joint="shoulder", **place)
        assert not torque(effect, noisy, np.ones(len(effect.parameters)), middle(effect)).any()


def test_friction_follows_the_temperature_above_twenty_degrees():
    warmth = np.linspace(20.0, 40.0, len(Q))[:, None] * np.array([0.0, 1.0, 0.0]) + 20.0
    effect = one("temperature_friction", ARM, joint="shoulder", of=["f_c", "k_v1"])
    want = (-0.02 * S - 0.01 * V) * np.linspace(20.0, 40.0, len(Q))
    np.testing.assert_allclose(torque(effect, replace(W, temperature=warmth), [-0.02, -0.01]), only(1, want))
    assert not torque(effect, W, [-0.02, -0.01]).any()
    assert effect.needs_temperature


def test_presliding_lacks_what_the_bristles_still_have_to_bend():
    """After a reversal z = 1 - 2 exp(-x/d_s) at the distance x beyond it."""
    velocity = np.repeat([0.5, -0.5], 500)[:, None]
    still = motion_of(("hip",), np.zeros_like(velocity), velocity, np.zeros_like(velocity))
    effect = one("presliding_hysteresis", arm_of(PENDULUM), joint="hip")
    lack = torque(effect, still, [2.0], [0.03])[500:, 0]
    beyond = 0.5 * np.arange(1, 501) / RATE
    state = -1.0 + 2.0 * np.exp(-beyond / 0.03)
    np.testing.assert_allclose(lack, 2.0 * (state + 1.0), atol=1e-9)


def test_vacuum_takes_the_higher_powers_of_speed_away():
    background = background_of(ARM, W, k_v1=3.0, k_v2=0.3, k_v3=-0.1)
    want = -0.75 * (0.3 * W.velocity**2 - 0.1 * W.velocity**3)
    everywhere = one("vacuum_friction", ARM, joints=list(ARM.joint_names))
    np.testing.assert_allclose(torque(everywhere, W, [0.75], (), background), want)
    np.testing.assert_allclose(
        torque(one("vacuum_friction", ARM, joint="shoulder"), W, [0.75], (), background), only(1, want[:, 1])
    )
    resisting = background_of(ARM, W, ODD, k_v1=3.0, k_v2=0.3, k_v3=-0.1)
    want = -0.75 * (0.3 * W.velocity * np.abs(W.velocity) - 0.1 * W.velocity**3)
    np.testing.assert_allclose(torque(everywhere, W, [0.75], (), resisting), want)


# --- functions of the model's torque --------------------------------------------------------------------------------


def test_load_friction_opposes_the_motion_whatever_the_load_does():
    load = np.stack([np.zeros_like(Q), 20.0 * np.sin(7.0 * Q + 1.0), np.zeros_like(Q)], axis=1)
    rub = torque(one("load_friction", ARM, joint="shoulder"), W, [0.1], (), Background.known(load))
    np.testing.assert_allclose(rub, only(1, 0.1 * np.abs(load[:, 1]) * S))
    assert np.all(rub[:, 1] * V >= 0)


def test_a_gear_loses_the_share_of_power_it_says_driving_and_driven():
    load = np.stack([20.0 * np.sin(7.0 * Q + 1.0)] * 3, axis=1)
    eta = 0.8
    loss = torque(one("gear_efficiency", ARM, joint="shoulder"), W, [1.0], [eta], Background.known(load))[:, 1]
    assert np.all(loss * V >= 0)
    power_out, power_in = load[:, 1] * V, (load[:, 1] + loss) * V
    driving, driven = power_out > 1e-3, power_out < -1e-3
    assert driving.any() and driven.any()
    np.testing.assert_allclose(power_out[driving] / power_in[driving], eta)
    np.testing.assert_allclose(power_in[driven] / power_out[driven], eta)


def test_scale_and_saturation_are_powers_of_the_models_torque():
    known = background_of(ARM, W, k_v1=3.0, J_m=0.3)
    rigid = rnea(THREE_LINKS, W.position, W.velocity, W.acceleration)
    tau = (rigid + 0.3 * W.acceleration + 3.0 * W.velocity)[:, 1]
    warm = replace(W, temperature=np.full_like(W.position, 45.0))
    for kind, place, motion, want in (
        ("torque_constant", {}, W, tau),
        ("torque_constant", {"of": "temperature"}, warm, 25.0 * tau),
        ("motor_saturation", {}, W, tau**3),
    ):
        made = torque(one(kind, ARM, joint="shoulder", **place), motion, [0.02], (), known)
        np.testing.assert_allclose(made, only(1, 0.02 * want), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0005, 0.004, 0.0133])
def test_a_late_torque_is_the_same_sine_later(delay):
    time, omega = np.arange(1000) / RATE, 2 * np.pi * 1.0
    sine = Background.known(np.outer(np.sin(omega * time), np.ones(3)))
    change = torque(one("time_delay", ARM, joint="elbow"), replace(W), [1.0], [delay], sine)
    late = np.sin(omega * (time - delay))
    np.testing.assert_allclose((sine.torque + change)[20:, 2], late[20:], atol=1e-4)
    assert not change[:, :2].any()


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("lag", [0.0005, 0.004, 0.04])
@pytest.mark.parametrize("frequency", [0.5, 5.0])
def test_a_low_pass_takes_amplitude_and_turns_phase(rate, lag, frequency):
    """1/(1 + i w T), at the coarse rate and at the full one."""
    time, omega = np.arange(int(4 * rate)) / rate, 2 * np.pi * frequency
    motion = wave(("a",), rate=rate)
    sine = Background.known(np.sin(omega * time)[:, None])
    change = torque(one("filter_lag", arm_of((Link("a"),)), joint="a"), motion, [1.0], [lag], sine)
    late = (sine.torque + change)[:, 0]
    whole = time >= 2.0
    found, want = fitted(late[whole], time[whole], omega), 1 / (1 + 1j * omega * lag)
    assert abs(found) == pytest.approx(abs(want), rel=2e-3)
    assert np.angle(found) == pytest.approx(np.angle(want), rel=2e-3)


def test_a_constant_torque_is_never_late():
    level = Background.known(np.full((1000, 3), 7.0))
    for kind in ("time_delay", "filter_lag"):
        change = torque(one(kind, ARM, joints=list(ARM.joint_names)), W, [1.0], [0.0133], level)
        np.testing.assert_allclose(change, 0.0, atol=1e-12)


# --- bodies: against Pinocchio --------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", [0, 1, 2])
def test_a_payload_is_what_a_heavier_link_costs(link):
    """A point's moment statically; mass, moment and inertia about the joint in motion."""
    mass, centre, spread = 3.0, np.array([0.0, 0.0, 0.3]), np.array([0.01, 0.02, 0.03])

    def heavier(model):
        model.inertias[link + 1] += pin.Inertia(mass, centre, np.diag(spread))

    about_joint = spread + mass * 0.3**2 * np.array([1.0, 1.0, 0.0])
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


def test_a_push_at_the_flange_is_held_by_the_transposed_jacobian_in_its_window():
    force, model = np.array([3.0, -5.0, 8.0]), pin.buildModelFromXML(urdf_of(THREE_LINKS))
    data = model.createData()
    want = np.zeros_like(W.position)
    time = 10.0 + np.arange(len(want)) / RATE
    for k in np.flatnonzero((time >= 11.0) & (time < 12.5)):
        pin.computeJointJacobians(model, data, W.position[k])
        jacobian = pin.getJointJacobian(model, data, 3, pin.LOCAL_WORLD_ALIGNED)[:3]
        want[k] = -jacobian.T @ force
    late = replace(W, start_s=10.0)
    made = torque(one("external_contact", ARM, joint="elbow"), late, force, [11.0, 1.5], background_of(ARM, late))
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


# --- what gives way -------------------------------------------------------------------------------------------------


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


def swing(amplitude, omega, seconds, arm=None, centre=0.0):
    arm = arm or arm_of(PENDULUM)
    angle = omega * np.arange(0.0, seconds, 1 / RATE)[:, None]
    state = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
    q, qd, qdd = (amplitude * x for x in state)
    return motion_of(arm.joint_names, q + centre, qd, qdd)


def test_moved_slowly_an_elastic_joint_sags_by_load_over_stiffness():
    """The link hangs where K d = load(q - d): solved by Newton's method, not linearised."""
    slow, stiffness = swing(0.5, 0.2, 30.0, centre=0.8), 500.0
    q = slow.position[:, 0]
    sag = np.zeros_like(q)
    for _ in range(20):
        load, slope = HANGING_NM * np.sin(q - sag), HANGING_NM * np.cos(q - sag)
        sag -= (stiffness * sag - load) / (stiffness + slope)
    arm = arm_of(PENDULUM)
    effect = one("joint_elasticity", arm, joint="hip")
    made = torque(effect, slow, [1.0], [stiffness, 0.05], background_of(arm, slow))[:, 0]
    want = HANGING_NM * (np.sin(q - sag) - np.sin(q))
    calm = slice(2500, None)
    np.testing.assert_allclose(made[calm], want[calm], atol=0.02 * np.abs(want).max())


@pytest.mark.parametrize(("ratio", "damping"), [(0.5, 0.05), (3.0, 0.05), (1.3, 0.15)])
def test_below_its_resonance_a_link_is_heavier_and_above_it_is_gone(ratio, damping):
    """All in all the motor feels M qdd times the classical transmissibility of a damped spring."""
    arm = arm_of(PENDULUM, (0.0, 0.0, 0.0))
    natural = 12.0
    omega = ratio * natural
    motion = swing(0.02, omega, 40.0, arm)
    stiffness = PENDULUM_INERTIA * natural**2
    effect = one("joint_elasticity", arm, joint="hip")
    made = torque(effect, motion, [1.0], [stiffness, damping], background_of(arm, motion))[:, 0]
    rigid = PENDULUM_INERTIA * motion.acceleration[:, 0]
    time = np.arange(len(rigid)) / RATE
    late = time > 25.0
    found = fitted((rigid + made)[late], time[late], omega) / fitted(rigid[late], time[late], omega)
    spring = 1 + 2j * damping * ratio
    assert found == pytest.approx(spring / (spring - ratio**2), abs=0.01)


def test_play_under_a_load_that_stays_on_one_side_is_half_the_gap():
    slow, width, arm = swing(0.4, 0.3, 20.0, centre=0.9), 0.02, arm_of(PENDULUM)
    stiff = 1e9  # as stiff as teeth may be
    made = torque(one("backlash", arm, joint="hip"), slow, [1.0], [width, stiff], background_of(arm, slow))[:, 0]
    q = slow.position[:, 0]
    want = HANGING_NM * (np.sin(q - width / 2) - np.sin(q))
    np.testing.assert_allclose(made, want, atol=0.05 * np.abs(want).max())


def test_play_is_the_same_alone_and_among_the_grid():
    moved, arm = swing(0.8, 0.5, 20.0), arm_of(PENDULUM)
    effect, background = one("backlash", arm, joint="hip"), background_of(arm, moved)
    gap, contact = (constant.grid for constant in effect.constants)
    for point in ((gap[3], contact[0]), (gap[10], contact[2])):
        among = torque(effect, moved, [1.0], point, background)
        alone = torque(effect, moved, [1.0], np.nextafter(point, 1), background)
        np.testing.assert_allclose(among, alone, atol=1e-3 * np.abs(alone).max())


@pytest.mark.parametrize("kind", ["link_flexibility", "halfway", "base_flexibility"])
def test_a_hinge_that_bends_is_the_arm_with_that_joint(kind):
    """Statically: the load about a real extra joint over its stiffness, and what all joints feel of it bent."""
    stiffness, axis = 4000.0, (1.0, 0.0, 0.0)
    still = motion_of(ARM.joint_names, np.tile([0.3, 0.7, -0.9], (250, 1)), *np.zeros((2, 250, 3)))
    if kind == "link_flexibility":
        shoulder = THREE_LINKS[1]
        hollow = replace(shoulder, mass=0.0, inertia=(0.0,) * 6)
        hinge = replace(shoulder, name="hinge", parent="shoulder", axis=axis, xyz=(0, 0, 0))
        links = (THREE_LINKS[0], hollow, hinge, replace(THREE_LINKS[2], parent="hinge"))
        number, effect = 2, one(kind, ARM, joint="shoulder", axis=list(axis))
    elif kind == "halfway":
        half = tuple(0.5 * x for x in THREE_LINKS[2].xyz)
        hinge = Link("hinge", parent="shoulder", axis=axis, xyz=half, mass=0.0, inertia=(0.0,) * 6)
        links = (*THREE_LINKS[:2], hinge, replace(THREE_LINKS[2], parent="hinge", xyz=half))
        number, effect = 2, one("link_flexibility", ARM, joint="shoulder", axis=list(axis), along=0.5)
    else:
        hinge = Link("hinge", axis=axis, mass=0.0, inertia=(0.0,) * 6)
        links = (hinge, replace(THREE_LINKS[0], parent="hinge"), *THREE_LINKS[1:])
        number, effect = 0, one(kind, ARM, axis=list(axis))
    model = pin.buildModelFromXML(urdf_of(links))
    data = model.createData()

    def held(bend):
        return pin.computeGeneralizedGravity(model, data, np.insert(still.position[0], number, bend)).copy()

    bend = 0.0
    for _ in range(50):
        bend = held(-bend)[number] / stiffness
    assert abs(bend) > 5e-5
    want = np.delete(held(-bend) - held(0.0), number)
    made = torque(effect, still, [1.0], [stiffness, 0.05], background_of(ARM, still))
    np.testing.assert_allclose(made[-1], want, atol=0.02 * np.abs(want).max())


def test_a_link_on_a_spring_rings_between_its_slowest_and_its_fastest():
    """Hanging straight down, from either side of its swing: the root of (K + m g l) over m l^2 + I."""
    moved, arm = swing(0.8, 0.5, 20.0), arm_of(PENDULUM)
    background = background_of(arm, moved)
    effect = one("joint_elasticity", arm, joint="hip")
    sensitivity = effect.sensitivity(moved, background)
    low, high = effect.resonance(moved, (3000.0, 0.02), background)
    inertia, gravity = sensitivity.own_inertia, sensitivity.own_gravity
    assert np.ptp(inertia) < 1e-9 * inertia.max() and np.ptp(gravity) > 0
    rates = np.sqrt((3000.0 + gravity[[gravity.argmin(), gravity.argmax()]]) / inertia[0]) / (2 * np.pi)
    np.testing.assert_allclose((low, high), rates)
    assert one("backlash", arm, joint="hip").resonance(moved, (1e-3, 1e5), background) is None


def test_friction_that_falls_below_every_speed_is_no_stribeck_curve():
    effect = one("stribeck", ARM, joint="elbow")
    (curve,) = effect.constants
    assert not effect.plausible(np.array([1.0]), (curve.grid[0],))
    assert effect.plausible(np.array([1.0]), (curve.grid[1],))


def test_a_link_may_bend_halfway_square_to_its_length_where_another_follows():
    kind = EFFECTS["link_flexibility"]
    for place in kind.variants(ARM):
        assert place["along"] == 0.5
        following = {"waist": (0, 0, 0.3), "shoulder": (0, 0, 0.5)}[place["joint"]]
        assert np.dot(place["axis"], following) == pytest.approx(0.0)
        assert np.linalg.norm(place["axis"]) == pytest.approx(1.0)
    assert [place["joint"] for place in kind.variants(ARM)] == ["waist", "waist", "shoulder", "shoulder"]
    with pytest.raises(ValueError, match="along is a share"):
        kind.at(ARM, {"joint": "shoulder", "axis": [1, 0, 0], "along": 1.5})


@pytest.mark.parametrize("cycles", [1, 2])
def test_an_eccentric_encoder_shows_torque_of_a_motion_that_was_not(cycles):
    """What moved is q_read - e(q_read), by the chain rule; its torque by Pinocchio, less that of what was read."""
    sine, cosine, rotor, viscous = 2e-3, -1e-3, 0.3, 3.0
    arm = arm_of(PENDULUM)
    read = wave(arm.joint_names, rate=1000.0)
    q, qd, qdd = read.position, read.velocity, read.acceleration
    error = sine * np.sin(cycles * q) + cosine * np.cos(cycles * q)
    slope = cycles * (sine * np.cos(cycles * q) - cosine * np.sin(cycles * q))
    true = q - error, qd * (1 - slope), qdd * (1 - slope) + cycles**2 * error * qd**2

    def felt(position, velocity, acceleration):
        return rnea(PENDULUM, position, velocity, acceleration) + rotor * acceleration + viscous * velocity

    want = felt(*true) - felt(q, qd, qdd)
    effect = one("encoder_eccentricity", arm, joint="hip", cycles=cycles)
    made = torque(effect, read, [sine, cosine], (), background_of(arm, read, J_m=rotor, k_v1=viscous))
    inside = slice(5, -5)
    np.testing.assert_allclose(made[inside], want[inside], atol=0.01 * np.abs(want).max())


def test_play_and_springs_of_one_joint_are_felt_by_all_that_it_moves():
    arm = arm_of(TWO_LINKS)
    motion = wave(arm.joint_names)
    for kind in ("joint_elasticity", "backlash"):
        effect = one(kind, arm, joint="elbow")
        made = torque(effect, motion, [1.0], middle(effect), background_of(arm, motion))
        assert np.all(np.abs(made).max(axis=0) > 1e-3)
