"""Each mark is given where it belongs: determined, combined, at a bound, prior, fixed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_arm
import pytest
from planted_arm import THREE_LINKS, Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import structure_of
from spacearm_ident.estimate.identified import Determination, Estimate
from spacearm_ident.identification.identify import Settings, identify

RATE_HZ = 250.0
TIME = np.arange(0.0, 24.0, 1 / RATE_HZ)


def estimates(planted: planted_arm.Planted, noise: float = 0.1) -> dict[str, Estimate]:
    """Of the paper's law with every term: marks of terms that prediction leaves out are in test_structure.py."""
    arm = arm_from_urdf(planted.urdf)
    result = identify([planted.recording(noise=noise)], arm, Settings(structure=structure_of(arm)))
    return {estimate.name: estimate for estimate in result.estimates}


@pytest.fixture(scope="module")
def three_links() -> dict[str, Estimate]:
    laws = [Friction(), Friction(f_c=4.0), Friction(f_c=3.0)]
    motion = planted_arm.incommensurate(TIME, 3, 0, 0.8)
    return estimates(planted_arm.plant(THREE_LINKS, laws, motion, RATE_HZ))


def marks(found: dict[str, Estimate], determination: Determination) -> set[str]:
    return {name for name, estimate in found.items() if estimate.determination is determination}


def test_friction_is_determined_by_the_data(three_links):
    friction = {f"{symbol}[{joint}]" for symbol in ("f_c", "k_v1") for joint in ("waist", "shoulder", "elbow")}
    assert friction <= marks(three_links, Determination.DATA)
    for name in friction:
        assert 0 < three_links[name].standard_error < 0.2 * abs(three_links[name].value)


def test_a_first_joint_of_vertical_axis_shows_its_inertia_about_it_and_nothing_else(three_links):
    """Izz with J_m, and with what the links above add: textbook (Gautier and Khalil 1990)."""
    unseen = {f"{symbol}[waist]" for symbol in ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz")}
    assert unseen <= marks(three_links, Determination.PRIOR)
    combined = marks(three_links, Determination.COMBINED)
    assert {"Izz[waist]", "J_m[waist]"} <= combined
    assert "base parameter" in three_links["J_m[waist]"].note


def test_a_quadratic_term_says_what_it_is_multiplied_by():
    """Rebuilt with the wrong one of qd^2 and qd |qd| torque is off in one direction by twice the term."""
    planted = two_link_run((Friction(k_v2=0.5), Friction(k_v2=0.5)), rate_hz=RATE_HZ)
    arm = arm_from_urdf(planted.urdf)
    forms = structure_of(arm) | {"viscous_friction": {"quadratic": {"shoulder": "even", "elbow": "odd"}}}
    result = identify([planted.recording(noise=0.1)], arm, Settings(structure=forms))
    notes = {estimate.name: estimate.note for estimate in result.estimates}
    assert notes["k_v2[shoulder]"].startswith("times qd^2") and "times qd |qd|" in notes["k_v2[elbow]"]
    assert "times qd^3" in notes["k_v3[elbow]"] and "times" not in notes["k_v1[elbow]"]


def test_what_the_prior_or_a_combination_decides_has_no_standard_error(three_links):
    for name in marks(three_links, Determination.PRIOR) | marks(three_links, Determination.COMBINED):
        assert np.isnan(three_links[name].standard_error) or not three_links[name].identifiable
        assert three_links[name].note


def test_the_spring_is_held_fixed(three_links):
    assert marks(three_links, Determination.FIXED) == {f"k_1[{joint}]" for joint in ("waist", "shoulder", "elbow")}


def test_every_parameter_has_its_mark_in_the_models_order(three_links):
    assert len(three_links) == 3 * 18 + 3  # The paper's 18 a joint, and a presliding distance.


def test_a_constant_that_is_not_there_is_at_its_bound(three_links):
    assert three_links["v_b[waist]"].determination is Determination.BOUND
    assert three_links["v_b[waist]"].value == 0.0
    assert three_links["f_b[waist]"].determination is Determination.PRIOR


def test_a_friction_that_would_have_to_be_negative_is_at_its_bound():
    planted = two_link_run((Friction(), Friction(f_c=-0.5)), rate_hz=RATE_HZ)
    found = estimates(planted)["f_c[elbow]"]
    assert found.determination is Determination.BOUND
    assert found.value == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("v_b", "speed"), [(0.15, 0.6), (0.02, 0.6)], ids=["wide", "half as wide as the blur"])
def test_a_visible_stribeck_peak_is_determined(v_b, speed, seed):
    laws = Friction(f_b=8.0, v_b=v_b), Friction(f_c=3.0)
    planted = two_link_run(laws, seconds=40.0, rate_hz=RATE_HZ, seed=seed, speed=speed)
    found = estimates(planted)
    for name in ("v_b[shoulder]", "f_b[shoulder]"):
        assert found[name].determination is Determination.DATA
        assert abs(found[name].value - planted.values[name]) < 4 * found[name].standard_error


@pytest.mark.parametrize("seed", range(4))
def test_of_a_peak_much_narrower_than_a_reversals_blur_neither_width_nor_height_is(seed):
    """Only its area is seen: a fit finds some width and height of that area, and must not sell them as known."""
    law, other = Friction(f_b=8.0, v_b=0.02), Friction(f_c=3.0)
    planted = two_link_run((law, other), seconds=30.0, rate_hz=RATE_HZ, seed=seed, speed=1.5)
    found = estimates(planted)
    for name in ("v_b[shoulder]", "f_b[shoulder]"):
        assert found[name].determination in (Determination.BOUND, Determination.PRIOR)


def test_friction_at_one_speed_is_known_only_in_a_combination():
    """Where a joint goes to and fro at speed v, f_c + k_v1 v is seen, and neither of them by itself."""
    laws = Friction(f_c=3.0), Friction(f_c=3.0)
    q, qd, qdd = (part.copy() for part in planted_arm.incommensurate(TIME, 2, 0, 0.8))
    turn = np.tanh(np.sin(2.0 * TIME) / 0.05)
    qd[:, 1] = 0.6 * turn
    q[:, 1] = np.cumsum(qd[:, 1]) / RATE_HZ
    qdd[:, 1] = np.gradient(qd[:, 1], 1 / RATE_HZ)
    planted = planted_arm.plant(planted_arm.TWO_LINKS, laws, (q, qd, qdd), RATE_HZ)
    result = identify([planted.recording(noise=0.5)], arm_from_urdf(planted.urdf))
    found = {estimate.name: estimate for estimate in result.estimates}
    assert found["k_v1[shoulder]"].determination is Determination.DATA
    assert found["k_v1[elbow]"].determination is Determination.COMBINED
    assert "f_c of elbow" in found["k_v1[elbow]"].note


def test_of_a_joint_at_rest_nothing_is_claimed():
    planted = two_link_run((Friction(), Friction(f_c=3.0)), rate_hz=RATE_HZ)
    q, qd, qdd = planted.q.copy(), planted.qd.copy(), planted.qdd.copy()
    q[:, 1], qd[:, 1], qdd[:, 1] = 0.3, 0.0, 0.0
    still = planted_arm.plant(planted_arm.TWO_LINKS, (Friction(), Friction(f_c=3.0)), (q, qd, qdd), RATE_HZ)
    result = identify([replace(still.recording(noise=0.1))], arm_from_urdf(still.urdf))
    assert result.joints_at_rest == ("elbow",)
    for estimate in result.estimates:
        if estimate.joint == "elbow":
            assert not estimate.identifiable
