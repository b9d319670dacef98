"""What gives way between motor and link: against Pinocchio and closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from effect_torque import (
    ARM,
    HANGING_NM,
    PENDULUM,
    PENDULUM_INERTIA,
    RATE,
    arm_of,
    background_of,
    fitted,
    middle,
    motion_of,
    one,
    rnea,
    torque,
    wave,
)
from planted_arm import THREE_LINKS, TWO_LINKS, Link, urdf_of
from scipy.special import ellipk

from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.effects.backlash import gap
from spacearm_ident.dynamics.effects.compliance import spring
from spacearm_ident.dynamics.effects.linearised import Sensitivity, by_position


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


def swung(inertia, load, gravity=0.0):
    """What swings, of constant inertia and gravity gradient."""
    own, pulled, none = (value * np.ones_like(load) for value in (inertia, gravity, 0.0))
    return Sensitivity(RATE, own[:, None], none[:, None], pulled[:, None], own, none, pulled, load)


@pytest.mark.parametrize("natural_hz", [3.0, 10.0, 20.0])
def test_a_link_that_is_let_go_rings_at_its_own_frequency(natural_hz):
    """And as long as its damping says, about where it comes to rest."""
    time, inertia, load, damping = np.arange(0.0, 3.0, 1 / RATE), 2.0, 30.0, 0.01
    omega, link = 2 * np.pi * natural_hz, swung(inertia, load * (time >= 1.0))
    deflection, acceleration = (
        signal[:, 0, 0] for signal in spring([link], np.array([inertia * omega**2]), np.array([damping]))
    )
    swing = deflection * inertia * omega**2 / load - 1.0
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0) & (time[1:] > 1.0))
    crossing = time[up] - swing[up] / (swing[up + 1] - swing[up]) / RATE
    frequency = np.sqrt(1 - damping**2) * omega
    assert np.mean(np.diff(crossing)) == pytest.approx(2 * np.pi / frequency, rel=5e-4)
    late = time > 1.5
    parts = (
        np.stack([np.cos(frequency * time), np.sin(frequency * time)], axis=1)
        * np.exp(-damping * omega * time)[:, None]
    )
    fit = np.linalg.lstsq(parts[late], swing[late], rcond=None)[0]
    assert np.hypot(*fit) * np.exp(-damping * omega) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(
        acceleration[late], -(omega**2) * (deflection[late] - load / inertia / omega**2), atol=0.06 * load
    )


@pytest.mark.parametrize("wound_up", [0.1, 1.0, 3.0])
def test_a_link_on_a_spring_that_hardens_swings_the_faster_the_further_it_was_wound_up(wound_up):
    """Let go at rest it is Duffing's oscillator, whose period is an elliptic integral."""
    time, inertia, omega, doubles_at = np.arange(0.0, 6.0, 1 / RATE), 2.0, 2 * np.pi * 1.5, 2e-3
    stiffness, bent = inertia * omega**2, wound_up**2
    load = stiffness * doubles_at * wound_up * (1.0 + bent) * (time < 1.0)
    deflection, _ = spring([swung(inertia, load)], np.array([stiffness]), np.zeros(1), np.array([doubles_at]))
    twist = deflection[:, 0, 0]
    np.testing.assert_allclose(twist[time < 0.99], wound_up * doubles_at, rtol=1e-6)
    up = np.flatnonzero((twist[:-1] < 0.0) & (twist[1:] >= 0.0))
    crossing = time[up] - twist[up] / (twist[up + 1] - twist[up]) / RATE
    period = 4.0 * ellipk(bent / (2.0 * (1.0 + bent))) / (omega * np.sqrt(1.0 + bent))
    assert np.mean(np.diff(crossing)) == pytest.approx(period, rel=5e-3)


@pytest.mark.parametrize("inertia", [-0.1, 1e-6, 1e-3])
@pytest.mark.parametrize("gravity", [-500.0, 0.0])
def test_a_link_without_inertia_follows_its_spring_however_it_is_loaded(inertia, gravity):
    """Fitted models may have such links; a twist that runs away is no number, and a ranking with it none either."""
    load = 300.0 * np.sign(np.random.default_rng(1).standard_normal(2000)).repeat(5)
    link = swung(inertia, load, gravity)
    stiffness, doubles_at = np.array([400.0, 2e3]), np.array([8e-4, 5e-3])
    for k in range(2):
        alone, _ = spring([link], stiffness[[k]], np.array([0.05]), doubles_at[[k]])
        assert np.abs(alone).max() < 4.0 * np.abs(np.cbrt(300.0 * doubles_at[k] ** 2 / stiffness[k]))
    both, acceleration = spring([link], stiffness, np.full(2, 0.05), doubles_at)
    assert np.isfinite(both).all() and np.isfinite(acceleration).all()
    assert np.isfinite(gap([link, link], np.array([1e-3]), np.array([1e5]), np.array([0.7]))).all()


@pytest.mark.filterwarnings("error")
def test_swing_that_no_stop_holds_has_no_torque_and_leaves_the_others_alone():
    """A link that its neighbours' motion drives ever faster, beside one that rests on its flank."""
    load = np.full(4000, 20.0)
    resting = swung(2.0, load)
    driven = replace(resting, own_coriolis=np.full(4000, -1e9))
    both, acceleration = gap([resting, driven], np.array([8e-3]), np.array([1e5]), np.array([0.01]))
    assert not both[:, 1].any() and not acceleration[:, 1].any()
    np.testing.assert_allclose(both[:, 0], gap([resting], *np.array([[8e-3], [1e5], [0.01]]))[0][:, 0], atol=1e-6)
    assert np.abs(both[:, 0]).min() > 3.9e-3


@pytest.mark.parametrize("gravity", [0.0, -150.0, 150.0])
def test_a_link_flies_from_flank_to_flank_as_its_load_and_its_weight_let_it(gravity):
    """To the middle M d'' = F - G d takes it along a parabola, a cosine, or a catenary where it would fall over."""
    time, inertia, width, force = np.arange(0.0, 1.0, 1 / RATE), 2.0, 8e-3, 2.0
    deflection, _ = gap(
        [swung(inertia, np.where(time < 0.5, -force, force), gravity)], *np.array([[width], [1e9], [1.0]])
    )
    fly = np.sqrt(width * inertia / force)
    if gravity:
        rate, rest, half = np.sqrt(complex(gravity / inertia)), force / gravity, 0.5 * width
        fly = abs(np.arccos(complex(rest / (half + rest))) / rate)
    angle = deflection[:, 0, 0]
    middle = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))[0]
    passed = time[middle] - angle[middle] / (angle[middle + 1] - angle[middle]) / RATE
    assert passed - (0.5 - 1 / RATE) == pytest.approx(fly, rel=0.04)


@pytest.mark.parametrize("share", [-0.3, 0.4])
def test_what_is_the_rotors_does_not_fly_with_the_link(share):
    """A first link's inertia and its rotor's are one sum: as if the link had that part of it less."""
    moved, heavy = swing(0.8, 0.5, 20.0), arm_of(PENDULUM)
    lighter = replace(PENDULUM[0], inertia=(0.03, 0, 0, 0.03 - share * PENDULUM_INERTIA, 0, 0.01))
    added = [
        torque(one("backlash", arm, joint="hip"), moved, [1.0], (1e-3, 1e5, 0.5, of_rotor), background_of(arm, moved))
        for arm, of_rotor in ((heavy, share), (arm_of([lighter]), 0.0))
    ]
    np.testing.assert_allclose(*added, atol=1e-6 * np.abs(added).max())
    assert len(one("backlash", ARM, joint="elbow").constants) == 3


def test_a_small_motion_beside_the_recorded_one_costs_what_the_whole_one_costs_more():
    """Against inverse dynamics of the moved arm, of which it is the exact derivative."""
    motion, small, number = wave(ARM.joint_names, speed=3.0), 1e-5, 1
    angle, unit = 9.0 * np.arange(len(motion.position)) / RATE, np.eye(3)[number]
    d, dd, ddd = small * np.sin(angle), 9.0 * small * np.cos(angle), -81.0 * small * np.sin(angle)
    state = motion.position, motion.velocity, motion.acceleration
    moved = (recorded + np.outer(more, unit) for recorded, more in zip(state, (d, dd, ddd)))
    want = rnea(THREE_LINKS, *moved) - rnea(THREE_LINKS, *state)
    made = by_position(motion, background_of(ARM, motion), number).torque(d, ddd)
    inner = slice(5, -5)
    np.testing.assert_allclose(made[inner], want[inner], atol=1e-3 * np.abs(want).max())


def test_play_under_a_load_that_stays_on_one_side_is_half_the_gap():
    slow, width, arm = swing(0.4, 0.3, 20.0, centre=0.9), 0.02, arm_of(PENDULUM)
    stiff = 1e9  # as stiff as teeth may be
    effect = one("backlash", arm, joint="hip")
    made = torque(effect, slow, [1.0], [width, stiff, 0.7, 0.0], background_of(arm, slow))[:, 0]
    q = slow.position[:, 0]
    want = HANGING_NM * (np.sin(q - width / 2) - np.sin(q))
    np.testing.assert_allclose(made, want, atol=0.05 * np.abs(want).max())


@pytest.mark.parametrize(("kind", "place"), [("backlash", {}), ("joint_elasticity", {"hardens": True})])
def test_what_is_not_linear_is_the_same_alone_and_among_the_grid(kind, place):
    moved, arm = swing(0.8, 0.5, 20.0), arm_of(PENDULUM)
    effect, background = one(kind, arm, joint="hip", **place), background_of(arm, moved)
    points = list(product(*(constant.grid for constant in effect.constants)))
    for point in (points[3 * len(points) // 26], points[5 * len(points) // 13]):
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


def test_a_mount_as_soft_all_round_rocks_about_either_axis_as_it_would_about_that_alone():
    moved = wave(ARM.joint_names)
    background, values = background_of(ARM, moved), (4000.0, 0.05)
    both, *each_way = (
        one("base_flexibility", ARM, **place) for place in ({}, {"axis": [1, 0, 0]}, {"axis": [0, 1, 0]})
    )
    alone = [torque(effect, moved, [1.0], values, background) for effect in each_way]
    assert min(np.abs(made).max() for made in alone) > 1e-3
    np.testing.assert_allclose(torque(both, moved, [1.0], values, background), sum(alone), atol=1e-12)
    bands = [effect.resonance(moved, values, background) for effect in each_way]
    assert both.resonance(moved, values, background) == (min(b[0] for b in bands), max(b[1] for b in bands))


def test_a_link_on_a_spring_rings_between_its_slowest_and_its_fastest():
    """Hanging straight down, from either side of its swing: the root of (K + m g l) over m l^2 + I."""
    moved, arm = swing(0.8, 0.5, 20.0), arm_of(PENDULUM)
    background = background_of(arm, moved)
    effect = one("joint_elasticity", arm, joint="hip")
    sensitivity = effect.sensitivity(moved, (3000.0, 0.02), background)
    low, high = effect.resonance(moved, (3000.0, 0.02), background)
    inertia, gravity = sensitivity.own_inertia, sensitivity.own_gradient
    assert np.ptp(inertia) < 1e-9 * inertia.max() and np.ptp(gravity) > 0
    rates = np.sqrt((3000.0 + gravity[[gravity.argmin(), gravity.argmax()]]) / inertia[0]) / (2 * np.pi)
    np.testing.assert_allclose((low, high), rates)
    hardens = one("joint_elasticity", arm, joint="hip", hardens=True)
    softest, stiffest = hardens.resonance(moved, (3000.0, 0.02, 1e-3), background)
    assert low <= softest < 1.2 * high and stiffest > 2.0 * high
    np.testing.assert_allclose(hardens.resonance(moved, (3000.0, 0.02, 10.0), background), (low, high), rtol=1e-3)
    assert one("backlash", arm, joint="hip").resonance(moved, (1e-3, 1e5), background) is None


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
