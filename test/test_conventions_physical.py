"""A body on the last link and a base that floats are told from a factor on the torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from planted_arm import Link, incommensurate, plant, urdf_of
from test_conventions import FRICTION, LINKS, TRUE, scaled

from spacearm_ident.conventions.check import check_conventions
from spacearm_ident.conventions.finding import Finding, Level
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.free_base import FreeBase
from spacearm_ident.dynamics.regressor import rigid_body_torque
from spacearm_ident.identification.identify import identify
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording import Recording
from spacearm_ident.recording.recording import BaseSensor
from spacearm_ident.sessions.mistakes import mistakes

ORBIT, GROUND = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81)
ARM = arm_from_urdf(urdf_of(LINKS))
TORQUE_KINDS = ("effort_gain", "effort_unit")


def holding(links: tuple[Link, ...], mass: float, centre: tuple[float, float, float]) -> tuple[Link, ...]:
    """The arm with a ball of a radius of gyration of 0.15 m on its last link."""
    last = links[-1]
    body = pin.Inertia(mass, np.array(centre), mass * 0.15**2 * np.eye(3))
    ixx, ixy, ixz, iyy, iyz, izz = last.inertia
    own = pin.Inertia(last.mass, np.array(last.com), np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))
    whole = own + body
    tensor = whole.inertia
    six = tuple(float(tensor[pair]) for pair in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    return (*links[:-1], replace(last, mass=whole.mass, com=tuple(whole.lever), inertia=six))


def run(seed: int, gravity: tuple[float, ...] = ORBIT, true: tuple[Link, ...] = TRUE, base: bool = False) -> Recording:
    """A run of thirty seconds; `base`: the base is one of 40 kg and 4 kg m² that floats."""
    time = np.arange(0.0, 30.0, 1 / 200)
    made = plant(LINKS, FRICTION, incommensurate(time, 4, seed=seed, speed=1.2), 200.0, gravity, true_links=true)
    if base:
        arm = arm_from_urdf(urdf_of(true))
        inertials = np.array([joint.inertial for joint in arm.joints])
        made = replace(made, torque=made.torque + FreeBase(arm, inertials, made.q, made.qd, made.qdd).change(4.0, 40.0))
    return made.recording(noise=[0.2, 0.3, 0.1, 0.05], seed=seed, ar=0.5)


def findings(recording: Recording, gravity: tuple[float, ...] = ORBIT) -> list[Finding]:
    return list(check_conventions([recording], ARM.with_gravity(np.array(gravity))).findings)


def torques(found: list[Finding]) -> list[Finding]:
    return [one for one in found if one.kind in TORQUE_KINDS and not one.statement.startswith("suspected: effort")]


@pytest.mark.parametrize("mass", [8.0, 25.0])
def test_a_captured_body_is_no_unit_of_the_torque_in_zero_gravity(mass):
    found = findings(run(1, true=holding(TRUE, mass, (0.03, -0.05, 0.35))))
    (body,) = [one for one in found if one.kind == "payload"]
    assert body.level is Level.NOTE and body.corrections.none
    assert body.values["mass_kg"] == pytest.approx(mass, rel=0.25)
    assert not torques(found)


@pytest.mark.parametrize(("gravity", "factor"), [(ORBIT, 30.0), (GROUND, 6.0)])
def test_a_factor_on_all_torques_is_no_payload(gravity, factor):
    found = findings(scaled(run(2, gravity), "effort", slice(None), factor), gravity)
    assert [one.kind for one in found if one.level is Level.UNFIT] == ["effort_unit"]
    assert not [one for one in found if one.kind == "payload"]


def test_a_heavy_payload_is_no_unit_or_gain_on_the_ground():
    assert not torques(findings(run(3, GROUND, holding(TRUE, 10.0, (0.03, -0.05, 0.2))), GROUND))


def test_a_base_that_floats_unseen_is_no_gain():
    found = findings(run(4, base=True))
    assert [one.kind for one in found] == ["floating_base"]
    assert found[0].level is Level.NOTE and "/base_imu" in found[0].remedy and found[0].corrections.none


def test_motion_of_a_free_base_makes_the_torque_of_the_free_arm():
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 20, 4))
    inertials = np.array([joint.inertial for joint in ARM.joints])
    free = FreeBase(ARM, inertials, q, qd, qdd)
    on_base = rigid_body_torque(ARM.with_gravity(np.zeros(3)), inertials, q, qd, qdd, free.motion(4.0, 40.0, 0.5))
    assert np.allclose(on_base, free.fixed + free.change(4.0, 40.0, 0.5))


@pytest.fixture(scope="module")
def healthy() -> Recording:
    return run(5)


def test_a_captured_body_is_no_other_unit_than_the_reference_has(healthy):
    arm = ARM.with_gravity(np.zeros(3))
    field = run(6, true=holding(TRUE, 25.0, (0.03, -0.05, 0.35)))
    model = identify([healthy], arm).model
    for runs in (RunSet((field,), (healthy,)), RunSet((field,), model)):
        assert not mistakes(runs, arm)
    assert mistakes(RunSet((scaled(field, "effort", slice(None), 30.0),), model), arm)


def test_the_headline_says_so_where_nothing_was_tested(healthy):
    time = np.linspace(0.0, 30.0, 3001)
    swing = np.column_stack([np.sin(time), np.cos(time), np.sin(2 * time)])
    base = BaseSensor("/base_imu", "base", time=time, rate=swing, force=swing, runs=(slice(0, len(time)),))
    moving = replace(healthy, base=base)
    report = check_conventions([moving], ARM.with_gravity(np.zeros(3)))
    assert report.untested and "not tested" in report.verdict and "no mistake" not in report.verdict
    both = check_conventions([healthy, moving], ARM.with_gravity(np.zeros(3)))
    assert "not tested in" in both.verdict
