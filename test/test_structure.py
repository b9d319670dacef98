"""Optional terms are in the model where they predict held-out data better, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import THREE_LINKS, Friction, incommensurate, plant, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.friction import StribeckFriction
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.estimate.identified import Determination, Identified
from spacearm_ident.estimate.optional_terms import OptionalTerm
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.joint_terms import JointTerms, structure_with

LAWS = (Friction(), Friction(f_c=3.0, k_v1=2.0, J_m=0.2))
PLAIN = tuple(replace(law, k_v2=0.0, k_v3=0.0, f_b=law.f_c) for law in LAWS)
SEEDS = range(4)


def found(result: Identified) -> set[tuple[OptionalTerm, str]]:
    """Terms beyond the plain law, and their joints."""
    return {
        (choice.kind, choice.joint)
        for choice in result.choices
        if choice.accepted and choice.kind is not OptionalTerm.OFFSET
    }


def run(shoulder: Friction, elbow: Friction, seed: int = 0, speed: float = 2.0, seconds: float = 40.0) -> Identified:
    planted = two_link_run((shoulder, elbow), seconds=seconds, seed=seed, speed=speed)
    return identify([planted.recording(noise=0.2, seed=seed)], arm_from_urdf(planted.urdf))


def test_plain_friction_gets_at_most_one_further_term_in_four_arms():
    # The level is 5 % a change. Of 80 joints of forty such arms two got three terms in all.
    assert sum(len(found(run(*PLAIN, seed=seed))) for seed in SEEDS) <= 1


@pytest.mark.parametrize("seed", SEEDS)
def test_load_friction_is_found_at_its_joint(seed):
    result = run(replace(PLAIN[0], mu=0.08), PLAIN[1], seed=seed)
    assert (OptionalTerm.LOAD, "shoulder") in found(result)
    assert (OptionalTerm.LOAD, "elbow") not in found(result)
    assert result.model.value("mu", "shoulder") == pytest.approx(0.08, rel=0.2)


@pytest.mark.parametrize("seed", SEEDS)
def test_offset_is_estimated_where_it_is_planted(seed):
    result = run(PLAIN[0], replace(PLAIN[1], offset=0.6), seed=seed, speed=1.0)
    assert result.model.value("offset", "elbow") == pytest.approx(0.6, abs=0.15)


@pytest.mark.parametrize("seed", SEEDS)
def test_stribeck_friction_is_found_beside_a_large_offset(seed):
    elbow = replace(PLAIN[1], f_b=5.0, v_b=0.2, offset=3.0)
    result = run(PLAIN[0], elbow, seed=seed)
    assert (OptionalTerm.STRIBECK, "elbow") in found(result)
    assert result.model.value("f_c", "elbow") == pytest.approx(elbow.f_c, rel=0.02)
    assert result.model.value("k_v1", "elbow") == pytest.approx(elbow.k_v1, rel=0.05)


@pytest.mark.parametrize("seed", SEEDS)
def test_quadratic_friction_is_found_in_its_own_form(seed):
    odd, even = replace(PLAIN[0], k_v2=2.0, odd=True), replace(PLAIN[1], k_v2=1.0)
    result = run(odd, even, seed=seed)
    assert (OptionalTerm.ODD, "shoulder") in found(result)
    assert (OptionalTerm.EVEN, "elbow") in found(result)
    assert result.model.value("k_v2", "shoulder") == pytest.approx(2.0, rel=0.2)


def sprung(stiffness: float, seed: int = 0, speed: float = 2.0) -> Identified:
    """Two joints with plain friction, and a spring at the elbow."""
    planted = two_link_run(PLAIN, seconds=40.0, seed=seed, speed=speed)
    recording = planted.recording(noise=0.2, seed=seed)
    pull = stiffness * recording.position * [0.0, 1.0]
    return identify([replace(recording, effort=recording.effort + pull)], arm_from_urdf(planted.urdf))


@pytest.mark.parametrize("seed", SEEDS)
def test_spring_is_found_at_its_joint(seed):
    result = sprung(4.0, seed)
    assert (OptionalTerm.SPRING, "elbow") in found(result)
    assert (OptionalTerm.SPRING, "shoulder") not in found(result)
    assert result.model.value("k_1", "elbow") == pytest.approx(4.0, rel=0.1)


def test_what_pushes_a_joint_away_from_its_middle_is_no_spring():
    assert OptionalTerm.SPRING not in {kind for kind, _ in found(sprung(-4.0))}


def test_spring_is_not_looked_for_in_a_small_part_of_a_joints_range():
    result = sprung(4.0, speed=0.1)
    assert not any(choice.kind is OptionalTerm.SPRING for choice in result.choices)


def test_recording_too_short_to_hold_out_blocks_gets_the_plain_law():
    result = run(replace(PLAIN[0], k_v2=2.0, odd=True), PLAIN[1], seconds=2.5)
    assert found(result) == set()


def test_terms_that_are_not_chosen_are_zero_and_marked():
    result = run(*PLAIN, seed=0)
    absent = {name for name in OptionalTerm if (name, "elbow") not in found(result)}
    assert OptionalTerm.CUBIC in absent
    estimate = next(one for one in result.estimates if one.name == "k_v3[elbow]")
    assert estimate.value == 0.0
    assert estimate.determination is Determination.FIXED
    assert "held-out" in estimate.note
    static = next(one for one in result.estimates if one.name == "f_b[elbow]")
    assert static.value == result.model.value("f_c", "elbow")


def test_recording_with_a_gap_in_its_speed_range_gets_no_curvature():
    """Below a quarter of the velocity limit a curvature is not decided."""
    law = replace(PLAIN[0], k_v2=30.0, odd=True)
    planted = two_link_run((law, PLAIN[1]), seconds=40.0, seed=0, speed=0.3)
    arm = arm_from_urdf(planted.urdf)
    slow = replace(arm, joints=tuple(replace(joint, velocity_limit=50.0) for joint in arm.joints))
    result = identify([planted.recording(noise=0.02, seed=0)], slow)
    polynomial = {OptionalTerm.EVEN, OptionalTerm.ODD, OptionalTerm.CUBIC}
    assert not polynomial & {kind for kind, _ in found(result)}


def test_higher_orders_grow_linearly_beyond_the_identified_speed():
    planted = two_link_run(LAWS, seconds=5.0, seed=0, speed=2.0)
    arm = arm_from_urdf(planted.urdf)
    laws = [JointTerms(frozenset(terms)) for terms in ({OptionalTerm.ODD}, {OptionalTerm.EVEN, OptionalTerm.CUBIC})]
    structure = structure_with(structure_of(arm), arm.joint_names, laws, [0.5, 0.5])
    result = identify([planted.recording(noise=0.1, seed=0)], arm, Settings(structure=structure))
    term = next(one for one in result.model.model.terms if one.kind == "viscous_friction")
    names = [parameter.name for parameter in term.parameters]

    class Moving:
        joints = arm.joint_names
        velocity = np.array([[0.4, 0.4], [1.0, 1.0], [2.0, 2.0], [-2.0, -2.0]])

    columns = {
        names[index]: column
        for _, (indices, block) in term.columns(Moving(), (), None).items()  # type: ignore[arg-type]
        for index, column in zip(indices, block.T)
    }
    first, second = arm.joint_names
    np.testing.assert_allclose(columns[f"k_v2[{first}]"], [0.16, 0.5, 1.0, -1.0])
    np.testing.assert_allclose(columns[f"k_v2[{second}]"], [0.16, 0.5, 1.0, 1.0])
    np.testing.assert_allclose(columns[f"k_v3[{second}]"], [0.064, 0.25, 0.5, -0.5])


def test_settings_with_a_structure_choose_nothing():
    planted = two_link_run(PLAIN, seconds=10.0, seed=0, speed=2.0)
    arm = arm_from_urdf(planted.urdf)
    result = identify([planted.recording(noise=0.2, seed=0)], arm, Settings(structure=structure_of(arm)))
    assert result.choices == ()


def test_an_arm_of_one_joint_shares_nothing_and_is_identified():
    motion = incommensurate(np.arange(0.0, 15.0, 1 / 250.0), 1, 1, 1.0)
    recording = plant((THREE_LINKS[0],), (Friction(),), motion, 250.0).recording(noise=0.1, seed=1)
    result = identify([recording], arm_from_urdf(recording.urdf))
    assert result.rows[0] > 0 and any(choice.joint == "waist" for choice in result.choices)


@pytest.mark.parametrize("term", OptionalTerm)
def test_a_row_of_the_optional_terms_is_of_its_class_and_puts_the_term_in_where_a_joint_has_it(term):
    arm, row = arm_from_urdf(two_link_run(PLAIN, seconds=1.0, seed=0, speed=2.0).urdf), term.row
    laws = [JointTerms(frozenset()), JointTerms(frozenset({term}))]
    model = TorqueModel(arm, structure_with(structure_of(arm), arm.joint_names, laws, [2.0, 2.0]))
    mine = [one for one in model.terms if isinstance(one, row.term)]
    free = {(parameter.symbol, parameter.joint) for one in mine for parameter in one.parameters if not parameter.held}
    searched = {(c.symbol[0], c.joint) for one in mine for c in one.constants if len(c.grid) > 1}
    symbol = "k_v2" if term is OptionalTerm.ODD else row.symbol
    if symbol:
        assert {joint for name, joint in free if name == symbol} == {"elbow"}, f"{symbol} is not there by {row.option}"
    if row.shape:
        assert {joint for name, joint in searched if name == row.shape} == {"elbow"}
    elif row.term is not StribeckFriction:
        shaped = [one for one in mine if one.constants or one.depends]
        assert not shaped, "a trial has one column of it: it must depend on no constant and on no other term"
