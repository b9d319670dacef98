"""Every effect's columns against closed forms, and the catalogue as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contract import CONTRACT
from effect_torque import (
    ARM,
    BASE,
    ODD,
    PENDULUM,
    RATE,
    W,
    arm_of,
    assert_same_torque,
    background_of,
    fitted,
    healthy,
    middle,
    motion_of,
    one,
    only,
    rnea,
    torque,
    wave,
)
from planted_arm import THREE_LINKS, Link

from spacearm_ident.dynamics.background import Background
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.effects.backlash import CONTACT_GRID
from spacearm_ident.dynamics.effects.compliance import GRID_SIZE, STIFFNESS_GRID
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.mismatch.candidate import Candidate
from spacearm_ident.mismatch.constants import grid_points
from spacearm_ident.mismatch.scored import plausible

# --- the catalogue --------------------------------------------------------------------------------------------------


PLACES = [(kind, place) for kind, effect in EFFECTS.items() for place in effect.variants(ARM)]


def test_every_name_of_the_contract_is_there():
    assert set(CONTRACT) <= set(EFFECTS)
    assert "unknown" not in EFFECTS
    assert all(kind == effect.kind for kind, effect in EFFECTS.items())


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
    assert places, f"{kind} has no place at any joint of `effect_torque.ARM`: give that arm what the effect needs"
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
    # nor does it feel a push on the shoulder, which is above it; where its zero is changes no torque.
    fewer = dict.fromkeys(("payload", "external_contact", "encoder_zero"), len(places) - 1)
    assert sum(felt) >= {"rotor_coupling": 1, **fewer}.get(kind, len(places))


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
    assert_same_torque(loaded.torque(motion), saved.torque(motion))


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
        ("time_delay", {"at": [{"joint": "elbow", "early": "no"}]}),
        ("vacuum_friction", {"at": [{"joints": []}]}),
        ("link_flexibility", {"at": [{"joint": "elbow"}]}),
        ("base_flexibility", {"at": [{"axis": [0, 1]}]}),
        ("base_flexibility", {"at": [{"axis": [0, 0, 0]}]}),
        ("position_friction", {"at": [{"joint": "elbow", "cycles": "many"}]}),
        ("harness_spring", {"at": [{"joint": "elbow", "side": "left"}]}),
        ("harness_spring", {"at": [{"joint": "elbow", "side": "above", "range": [1.0]}]}),
        ("friction_drift", {"at": [{"joint": "elbow", "of": ["colour"]}]}),
        ("rotor_coupling", {"at": [{"joint": "waist"}]}),
    ],
)
def test_places_that_say_too_little_are_refused_in_one_line(kind, options):
    with pytest.raises(UserError, match=kind) as caught:
        EFFECTS[kind].build(ARM, options)
    assert "\n" not in str(caught.value)


# --- functions of the joint's own motion ----------------------------------------------------------------------------


Q, V = W.position[:, 1], W.velocity[:, 1]
S = np.sign(V)


@pytest.mark.parametrize(
    ("kind", "place", "parameters", "constants", "want"),
    [
        ("torque_ripple", {}, [1.5 * np.cos(0.3), 1.5 * np.sin(0.3)], [20.0], 1.5 * np.sin(20 * Q + 0.3)),
        ("harness_spring", {}, [3.0, -3.0 * 0.2], [], 3.0 * (Q - 0.2)),
        ("harness_spring", {"side": "above"}, [3.0], [0.2], np.where(Q > 0.2, 3.0 * (Q - 0.2), 0.0)),
        ("harness_spring", {"side": "below"}, [3.0], [0.2], np.where(Q < 0.2, 3.0 * (Q - 0.2), 0.0)),
        ("friction_drift", {"of": ["f_c"]}, [0.7], [], 0.7 * S),
        ("friction_drift", {"of": ["k_v1"]}, [0.7], [], 0.7 * V),
        ("friction_drift", {"of": ["f_c", "k_v1"]}, [0.7, -0.2], [], 0.7 * S - 0.2 * V),
        ("friction_drift", {"of": ["f_c", "creep"]}, [0.7, 0.1], [], (0.7 + 0.1 * np.arange(len(Q)) / RATE) * S),
        ("position_friction", {"cycles": 2}, [0.6, 0.8], [], np.sin(2 * Q + np.arctan2(0.8, 0.6)) * S),
        ("position_friction", {"spot": True}, [2.0], [0.4, 0.3], 2.0 * np.exp(-(((Q - 0.4) / 0.3) ** 2)) * S),
        ("asymmetric_friction", {"of": ["level", "viscous"]}, [0.5, 0.3], [], 0.5 + 0.3 * np.abs(V)),
        ("stribeck", {}, [2.0], [0.1], 2.0 * np.exp(-(V**2) / 0.01) * S),
        ("stribeck", {"law": "exponential"}, [2.0], [0.1], 2.0 * np.exp(-np.abs(V) / 0.1) * S),
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


def test_a_gear_is_one_spring_whether_it_hardens_or_not():
    linear, hardens = (one("joint_elasticity", ARM, joint="elbow", **place) for place in ({}, {"hardens": True}))
    assert linear.replaces(hardens) and hardens.replaces(linear) and linear.replaces(linear)
    assert not linear.replaces(one("joint_elasticity", ARM, joint="shoulder"))
    assert not linear.replaces(one("backlash", ARM, joint="elbow"))


def test_a_spot_is_looked_for_where_a_joint_has_passed():
    effect = one("position_friction", ARM, joint="elbow", spot=True)
    spots = {centre for centre, _ in grid_points(effect, [W])}
    low, high = W.position[:, 2].min(), W.position[:, 2].max()
    assert spots == {centre for centre in effect.constants[0].grid if low <= centre < high} != set()
    assert not list(grid_points(effect, [replace(W, position=np.full_like(W.position, 0.05))]))


@pytest.mark.parametrize("side", ["above", "below"])
def test_a_one_sided_spring_begins_where_a_joint_is_often_enough_on_both_sides_and_pulls_back(side):
    effect = one("harness_spring", ARM, joint="elbow", side=side).over(ARM, [W])
    begins = np.array(list(grid_points(effect, [W])))[:, 0]
    assert len(begins) == 12
    for position in (begins.min(), begins.max()):
        assert 0.01 < np.mean(W.position[:, 2] > position) < 0.99
    candidate = Candidate(effect, (begins[3],), None, *np.zeros((3, 1)))
    assert plausible(candidate, np.array([2.0]), {}) and not plausible(candidate, np.array([-2.0]), {})
    assert EFFECTS["harness_spring"].at(ARM, effect.place) == effect
    still = replace(W, position=np.full_like(W.position, 0.05))
    assert not list(grid_points(effect.over(ARM, [still]), [still]))


def test_friction_below_the_noise_of_speed_is_nothing():
    noisy = replace(W, speed_noise=np.full(3, 10.0))
    for kind, place in (("friction_drift", {}), ("stribeck", {}), ("position_friction", {"cycles": 1})):
        effect = one(kind, ARM, joint="shoulder", **place)
        assert not torque(effect, noisy, np.ones(len(effect.parameters)), middle(effect)).any()


def test_friction_that_falls_below_every_speed_is_no_stribeck_curve():
    effect = one("stribeck", ARM, joint="elbow")
    (curve,) = effect.constants
    assert not effect.plausible(np.array([1.0]), (curve.grid[0],))
    assert effect.plausible(np.array([1.0]), (curve.grid[1],))


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


@pytest.mark.parametrize(
    ("f", "distance", "within_healthy_range"), [(0.7, 2e-4, True), (0.7, 3e-3, False), (4.5, 2e-4, False)]
)
def test_a_little_of_the_friction_that_builds_up_over_a_short_way_is_no_discovery(f, distance, within_healthy_range):
    """Bristles carry all of the joint's 4 N m; a sixth of it is how this motion turns round."""
    effect = one("presliding_hysteresis", arm_of(PENDULUM), joint="hip")
    candidate = Candidate(effect, (distance,), None, *np.zeros((3, 1)))
    assert plausible(candidate, np.array([f]), {"hip": 4.0}) != within_healthy_range
    assert plausible(candidate, np.array([f]), {})


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


def test_load_friction_on_the_motors_side_grows_with_friction_too_and_not_with_the_rotor():
    whole, inertia = np.full((len(Q), 3), 7.0), 0.4
    known = Background(None, None, {"J_m[shoulder]": inertia}, lambda: 0.0 * whole, lambda: whole, lambda: 0.0 * whole)
    term = one("load_friction", ARM, joint="shoulder", side="motor")
    load = 7.0 - inertia * W.acceleration[:, 1]
    np.testing.assert_allclose(torque(term, W, [0.1], (), known), only(1, 0.1 * np.abs(load) * S))
    assert [parameter.name for parameter in term.parameters] == ["mu_in[shoulder]"]


def test_load_friction_on_the_motors_side_carries_its_own_torque_too():
    """What the motor gives is the rest and mu times itself: tau = rest + mu |tau| sgn(qd)."""
    rest = 20.0 * np.sin(7.0 * Q + 1.0)
    whole, mu = np.stack([rest] * 3, axis=1), 0.3
    known = Background(None, None, {"mu_in[shoulder]": mu}, lambda: 0.0 * whole, lambda: whole, lambda: 0.0 * whole)
    friction = torque(one("load_friction", ARM, joint="shoulder", side="motor"), W, [mu], (), known)[:, 1]
    assert np.any(friction * rest > 1.0) and np.any(friction * rest < -1.0)
    np.testing.assert_allclose(friction, mu * np.abs(rest + friction) * S)


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


@pytest.mark.parametrize("times", [0.001, 0.3, 1.0, 7.0, 1000.0])
def test_stiffness_is_looked_for_where_an_arm_of_that_size_swings(times):
    size = times * GRID_SIZE / ARM.size
    arm = arm_of([replace(link, mass=size * link.mass) for link in THREE_LINKS])
    assert arm.size == pytest.approx(times * GRID_SIZE)
    grid = np.array(one("joint_elasticity", arm, joint="elbow").constants[0].grid)
    ratio = STIFFNESS_GRID[1] / STIFFNESS_GRID[0]
    np.testing.assert_allclose(grid[1:] / grid[:-1], ratio)
    assert grid[0] / times < ratio * STIFFNESS_GRID[0] and grid[-1] / times > STIFFNESS_GRID[-1] / ratio
    assert grid[0] * 1.01 > STIFFNESS_GRID[0] * min(times, 1.0) and grid[-1] >= STIFFNESS_GRID[-1]
    hits = one("backlash", arm, joint="elbow").constants[1].grid
    assert len(hits) == len(CONTACT_GRID) and (hits != CONTACT_GRID) == (times > 100.0)


def test_scale_and_saturation_are_powers_of_the_models_torque():
    known = background_of(ARM, W, k_v1=3.0, J_m=0.3)
    rigid = rnea(THREE_LINKS, W.position, W.velocity, W.acceleration)
    tau = (rigid + 0.3 * W.acceleration + 3.0 * W.velocity)[:, 1]
    warm = replace(W, temperature=np.full_like(W.position, 45.0))
    for kind, place, motion, want in (
        ("torque_constant", {}, W, tau),
        ("torque_constant", {"of": "temperature"}, warm, 25.0 * tau),
        ("motor_saturation", {}, W, tau**3),
        ("motor_saturation", {"terms": 2}, W, tau**3 + tau**5),
    ):
        effect = one(kind, ARM, joint="shoulder", **place)
        made = torque(effect, motion, [0.02] * len(effect.parameters), (), known)
        np.testing.assert_allclose(made, only(1, 0.02 * want), rtol=1e-9, atol=1e-9)


def test_a_motor_saturates_by_one_curve():
    one_term, two = (one("motor_saturation", ARM, joint="shoulder", **place) for place in ({}, {"terms": 2}))
    assert one_term.replaces(two) and two.replaces(one_term)
    assert not two.replaces(one("motor_saturation", ARM, joint="elbow", terms=2))


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("delay", [0.0005, 0.004, 0.0133])
def test_a_late_torque_is_the_same_sine_later(delay, early):
    time, omega = np.arange(1000) / RATE, 2 * np.pi * 1.0
    sine = Background.known(np.outer(np.sin(omega * time), np.ones(3)))
    effect = one("time_delay", ARM, joint="elbow", early=early)
    change = torque(effect, replace(W), [1.0], [delay], sine)
    signed = -delay if early else delay
    late = np.sin(omega * (time - signed))
    np.testing.assert_allclose((sine.torque + change)[20:-20, 2], late[20:-20], atol=1e-4)
    assert not change[:, :2].any()
    assert effect.shown(np.array([1.0, delay])) == {"delay": (signed, "s")}


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("lag", [0.0005, 0.004, 0.04])
@pytest.mark.parametrize("frequency", [0.5, 5.0])
@pytest.mark.parametrize("order", [1, 2])
def test_a_low_pass_takes_amplitude_and_turns_phase(rate, lag, frequency, order):
    """1/(1 + i w T), or 1/(1 + i w T - (w T)^2/2), at the coarse rate and at the full one."""
    time, omega = np.arange(int(4 * rate)) / rate, 2 * np.pi * frequency
    motion = wave(("a",), rate=rate)
    sine = Background.known(np.sin(omega * time)[:, None])
    effect = one("filter_lag", arm_of((Link("a"),)), joint="a", order=order)
    late = (sine.torque + torque(effect, motion, [1.0], [lag], sine))[:, 0]
    whole, bend = time >= 2.0, 0.5 * (order - 1)
    found = fitted(late[whole], time[whole], omega)
    want = 1 / (1 + 1j * omega * lag - bend * (omega * lag) ** 2)
    assert abs(found) == pytest.approx(abs(want), rel=2e-3)
    assert np.angle(found) == pytest.approx(np.angle(want), rel=2e-3)
    corner, _ = effect.shown(np.array([1.0, lag]))["corner"]
    at_corner = 2j * np.pi * corner * lag
    assert abs(1 + at_corner + bend * at_corner**2) == pytest.approx(np.sqrt(2.0))


@pytest.mark.parametrize("kind", ["time_delay", "filter_lag"])
def test_what_a_fit_knows_better_is_what_is_late(kind):
    level, bump = np.full((1000, 3), 7.0), np.exp(-(((np.arange(1000) - 500) / 20) ** 2))[:, None] * np.ones(3)
    told, known = Background.known(level), Background.known(level + bump)
    told.with_whole(level + bump)
    effect = one(kind, ARM, joint="elbow")
    made, want = (torque(effect, W, [1.0], [0.004], background) for background in (told, known))
    np.testing.assert_allclose(made, want, atol=1e-12)
    assert np.abs(want).max() > 0.02


def test_a_constant_torque_is_never_late():
    level = Background.known(np.full((1000, 3), 7.0))
    for kind in ("time_delay", "filter_lag"):
        change = torque(one(kind, ARM, joints=list(ARM.joint_names)), W, [1.0], [0.0133], level)
        np.testing.assert_allclose(change, 0.0, atol=1e-12)
