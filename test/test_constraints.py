"""Limits: margins of motions whose extremes are known, distances of spheres, and what a broken limit is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import road_arms
import small_arm
from planted_arm import THREE_LINKS, Link, urdf_of

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.urdf_chain import bounded
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.clearance import Clearance
from spacearm_ident.excitation.constraints import (
    Requirements,
    broken,
    check,
    limits_for_excitation,
    model_torque,
    require,
)
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.segments import Chirp, Cruise, Motion, MotionLimits, Quintic, Rest, still
from spacearm_ident.excitation.trajectory import FourierTrajectory, Trajectory

ARM = arm_from_urdf(small_arm.URDF)
LIMITS = MotionLimits(np.full(2, -2.0), np.full(2, 3.0), np.full(2, 2.0), np.full(2, 6.0), np.full(2, 50.0))
BALLS = """<robot name="balls"><link name="base">
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="one"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="two"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><origin xyz="0.4 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0"/><axis xyz="0 -1 0"/>
<limit lower="-3" upper="3" velocity="1" effort="99"/></joint>
<joint name="j2" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/>
<limit lower="-3.1" upper="3.1" velocity="1" effort="99"/></joint></robot>"""


def needs(**changes):
    whole = np.array([joint.effort_limit for joint in ARM.joints])
    return replace(Requirements(LIMITS, whole, nominal_model(ARM)), **changes)


def series(a, hz=0.5):
    return FourierTrajectory(ARM.joint_names, np.array([0.5, 0.5]), np.array([[a], [0.0]]), np.zeros((2, 1)), hz, 1)


def by(margins, kind, where):
    return next(m for m in margins if (m.kind, m.where) == (kind, where))


def test_margins_of_a_sine_are_its_amplitudes():
    run = Trajectory(ARM.joint_names, (series(1.0),))
    margins = check(run, needs(structural_hz=2.0))
    omega = np.pi
    assert by(margins, "position", "shoulder").value == pytest.approx(0.5 + 1 / omega, abs=1e-4)
    assert by(margins, "position", "shoulder").used == pytest.approx(1 / omega / 2.5, abs=1e-4)
    assert by(margins, "velocity", "shoulder").value == pytest.approx(1.0, abs=1e-4)
    assert by(margins, "acceleration", "shoulder").value == pytest.approx(omega, abs=1e-4)
    assert by(margins, "jerk", "shoulder").value == pytest.approx(omega**2, rel=1e-3)
    assert by(margins, "frequency", "N_h·f0").used == pytest.approx(0.25)
    assert by(margins, "velocity", "elbow").value == 0.0
    require(margins)


def test_torque_at_rest_is_weight_times_lever():
    """Upper arm level: m g x com; link masses 4 and 2, elbow 0.4 along, c.o.m. 0.2 and 0.15 further."""
    posture = np.array([np.pi / 2, 0.0])
    margins = check(Trajectory(ARM.joint_names, (Rest(posture, 0.1),)), needs())
    expected = 9.81 * (4 * 0.2 + 2 * (0.4 + 0.15))
    assert by(margins, "torque", "shoulder").value == pytest.approx(expected, rel=1e-6)
    assert by(margins, "torque", "shoulder").limit == 100.0


def test_unlimited_torques_are_not_judged():
    assert not [
        m
        for m in check(Trajectory(ARM.joint_names, (series(1.0),)), needs(torque_Nm=np.full(2, np.inf)))
        if m.kind == "torque"
    ]


@pytest.mark.parametrize(
    ("segment", "requirement", "message"),
    [
        (series(2.5, 0.2), {}, r"velocity of shoulder: 2\.5 rad/s at .* allowed is 2 rad/s; .*--fundamental"),
        (series(1.9, 0.6), {}, r"acceleration of shoulder: 7\.16"),
        (Rest(np.array([0.0, -2.5]), 0.1), {}, r"position of elbow: -2\.5 rad .* allowed is -2 rad"),
        (
            Rest(np.array([1.5, 0.0]), 0.1),
            {"torque_Nm": np.array([9.0, 9.0])},
            r"torque of shoulder: 18\.\d+ N·m.*--start",
        ),
        (series(1.0), {"structural_hz": 0.4}, r"frequency of N_h·f0: 0\.5 Hz .* 0\.4 Hz; .*--harmonics"),
    ],
)
def test_a_broken_limit_is_named_with_figures_and_remedy(segment, requirement, message):
    with pytest.raises(UserError, match=message) as caught:
        require(check(Trajectory(ARM.joint_names, (segment,)), needs(**requirement)))
    assert "\n" not in str(caught.value)


def test_jerk_of_a_chirp_is_found_and_a_chirp_may_pass_the_structural_frequency():
    chirp = Chirp(np.zeros(2), np.array([0.002, 0.0]), 1.0, 9.0, 4.0)
    margins = check(Trajectory(ARM.joint_names, (chirp,)), needs(structural_hz=2.0))
    t = np.linspace(0.0, 4.0, 200_001)
    jerk = np.gradient(chirp.evaluate(t).qdd[:, 0], t)
    assert by(margins, "jerk", "shoulder").value == pytest.approx(np.abs(jerk).max(), rel=0.02)
    assert not [m for m in margins if m.kind == "frequency"]


def distance(q):
    """Centre of the outer ball from the origin in the plane of the arm, less both radii."""
    x, z = 0.4 * np.cos(q[0]) + 0.4 * np.cos(q[0] + q[1]), 0.4 * np.sin(q[0]) + 0.4 * np.sin(q[0] + q[1])
    return np.hypot(x, z) - 0.15, z - 0.05


def test_distances_of_balls_and_ground_are_those_of_geometry():
    arm = arm_from_urdf(BALLS)
    clearance = Clearance(arm, -0.2, np.full(2, -3.0), np.full(2, 3.0))
    assert "collision" in clearance.source
    postures = np.random.default_rng(0).uniform(-2.8, 2.8, (20, 2))
    found = clearance.distances(postures)
    for q, row in zip(postures, found):
        own, height = distance(q)
        assert row[clearance.pairs.index(("base", "two"))] == pytest.approx(own, abs=1e-6)
        assert row[clearance.pairs.index(("two", "ground"))] == pytest.approx(height + 0.2, abs=1e-6)


def test_a_folded_arm_is_found_to_collide():
    arm = arm_from_urdf(BALLS)
    clearance = Clearance(arm, None, np.full(2, -3.1), np.full(2, 3.1))
    limits = MotionLimits(np.full(2, -3.1), np.full(2, 3.1), np.ones(2), np.ones(2))
    want = Requirements(limits, np.full(2, np.inf), nominal_model(arm), clearance=clearance)
    stretch = Cruise(np.array([0.0, 0.0]), np.array([0.0, 0.5]), 2.0)
    fold = Cruise(np.array([0.0, 2.0]), np.array([0.0, 0.5]), 2.2)
    require(check(Trajectory(arm.joint_names, (stretch,)), want))
    with pytest.raises(
        UserError, match=r"clearance of base and two: -0\.1\d* m at 2\.\d* s, where the least allowed is 0\.02 m"
    ):
        require(check(Trajectory(arm.joint_names, (fold,)), want))


def test_a_barrier_is_nothing_far_away_infinite_too_near_and_has_the_derivative_differences_give():
    clearance = Clearance(arm_from_urdf(BALLS), None, np.full(2, -3.0), np.full(2, 3.0))
    assert clearance.barrier(np.array([[0.3, 0.4]]), 0.1)[0] == 0.0
    assert clearance.barrier(np.array([[0.3, 3.0]]), 0.1)[0] == np.inf
    near = np.array([[0.3, 2.5], [1.0, -2.6]])
    value, slope = clearance.barrier(near, 0.3)
    assert value > 0
    for place in np.ndindex(near.shape):
        step = np.zeros_like(near)
        step[place] = 1e-5
        difference = (clearance.barrier(near + step, 0.3)[0] - clearance.barrier(near - step, 0.3)[0]) / 2e-5
        assert slope[place] == pytest.approx(difference, abs=1e-4)


@pytest.mark.parametrize("urdf, ground", [(BALLS, -0.2), (road_arms.GANTRY, 0.3), (road_arms.SCARA, 0.0)])
def test_nearest_and_barrier_are_those_of_all_pairs_though_far_ones_are_not_measured(urdf, ground):
    arm = arm_from_urdf(bounded(urdf))
    lower, upper = (
        np.array([np.clip(getattr(joint, end), -3, 3) for joint in arm.joints]) for end in ("lower", "upper")
    )
    clearance = Clearance(arm, ground, lower, upper)
    postures = np.random.default_rng(3).uniform(lower, upper, (60, len(lower)))
    distances = clearance.distances(postures)
    nearest = clearance.nearest(postures)
    assert nearest.distance_m == pytest.approx(distances.min(), abs=1e-6)
    assert distances[nearest.row, clearance.pairs.index(nearest.pair)] == pytest.approx(distances.min(), abs=1e-6)
    clear = postures[distances.min(axis=1) > clearance.needed_m + 0.01]
    share = (clearance.distances(clear) - clearance.needed_m) / 0.2
    near = share[share < 1.0]
    assert len(near) > 5
    value, slope = clearance.barrier(clear, 0.2)
    assert value == pytest.approx(np.sum(near - 1.0 - np.log(near)), rel=1e-4)
    step = 1e-6 * np.random.default_rng(4).normal(size=clear.shape)
    difference = clearance.barrier(clear + step, 0.2)[0] - clearance.barrier(clear - step, 0.2)[0]
    assert difference == pytest.approx(2 * np.sum(slope * step), rel=1e-2)


def test_a_period_repeated_has_the_margins_of_one_and_what_follows_is_checked_where_it_is():
    last = Rest(np.array([2.9, 0.5]), 0.1)
    once, often = (replace(series(1.0), periods=count) for count in (1, 4))
    for kind in ("position", "velocity", "acceleration", "torque"):
        first, again = (
            by(check(Trajectory(ARM.joint_names, (run,)), needs()), kind, "shoulder") for run in (once, often)
        )
        assert (again.value, again.at_s) == pytest.approx((first.value, first.at_s))
    join = Quintic(often.evaluate(8.0).at(0), still(last.position), 2.0)
    margins = check(Trajectory(ARM.joint_names, (often, join, last)), needs())
    assert by(margins, "position", "shoulder").at_s > 8.0
    assert by(margins, "position", "shoulder").value == pytest.approx(2.9, abs=1e-3)


def test_a_peak_between_the_coarse_instants_is_broken_all_the_same():
    late = series(1.0).shifted(0.01)  # fastest a hundredth of a second before its period ends: no coarse instant
    run = Trajectory(ARM.joint_names, (late,))
    fine, coarse = (by(check(run, needs(), coarser), "velocity", "shoulder").value for coarser in (1, 10))
    assert coarse < fine
    tight = needs(motion=replace(LIMITS, velocity=np.array([(coarse + fine) / 2, 2.0])))
    assert not broken(run, needs())
    assert [(margin.kind, margin.where) for margin in broken(run, tight)] == [("velocity", "shoulder")]


def test_links_without_geometry_are_capsules_and_a_folded_one_collides():
    arm = arm_from_urdf(urdf_of(THREE_LINKS))
    clearance = Clearance(arm, 0.0, np.full(3, -3.0), np.full(3, 3.0))
    assert "capsules" in clearance.source
    upright = clearance.nearest(np.zeros((1, 3)))
    down = clearance.nearest(np.array([[0.0, 2.8, 0.0]]))
    assert upright.distance_m > 0.1 and down.distance_m < 0.02 and "ground" in down.pair


def test_capsules_that_are_never_farther_apart_than_needed_are_not_checked():
    """Stretched 1 m the radius is 4 cm: the ends of a link of 10 cm leave 2 cm, and bent by over 90 degrees less."""
    axes, lengths = ((0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0)), (0.3, 0.3, 0.3, 0.1)
    names = ("one", "two", "three", "four")
    parents = ("base", *names)
    links = [
        Link(name, parent=parent, axis=axis, xyz=(0, 0, length))
        for name, parent, axis, length in zip(names, parents, axes, lengths)
    ]
    clearance = Clearance(arm_from_urdf(urdf_of(links)), None, np.full(4, -3.0), np.full(4, 3.0))
    assert clearance.unchecked == [("two", "four")] and ("one", "four") in clearance.pairs


def test_the_paper_arm_brings_its_own_geometry_and_stands_clear():
    arm = load_arm(config_path("paper_arm.yaml"))
    lower, upper = (np.array([getattr(joint, end) for joint in arm.joints]) for end in ("lower", "upper"))
    clearance = Clearance(arm, 0.0, lower, upper)
    assert "collision" in clearance.source and not clearance.unchecked
    assert clearance.nearest(np.zeros((1, 6))).distance_m > 0.05


def test_limits_a_urdf_does_not_give_are_assumed_and_told():
    limits, notes = limits_for_excitation(ARM, np.zeros(2))
    np.testing.assert_allclose(limits.acceleration, 2 * limits.velocity)
    assert any("acceleration_limit_rad_s2" in note for note in notes)
    endless = arm_from_urdf(small_arm.URDF.replace('name="elbow" type="revolute"', 'name="elbow" type="continuous"'))
    limits, notes = limits_for_excitation(endless, np.array([0.0, 1.0]))
    assert limits.upper[1] == pytest.approx(1.0 + np.pi) and any("half a turn" in note for note in notes)
    still = arm_from_urdf(small_arm.URDF.replace('velocity="3"', 'velocity="0"'))
    with pytest.raises(UserError, match="shoulder has no velocity limit; give velocity_limit_rad_s"):
        limits_for_excitation(still, np.zeros(2))


def stl(path, facets):
    """An ASCII STL of triangles, three corners each."""
    lines = ["solid body"]
    for corners in facets:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += ["vertex " + " ".join(map(str, corner)) for corner in corners] + ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid body"]))


def stl_of_cube(path, half):
    """An ASCII STL of a cube about the origin."""
    facets = []
    for axis in range(3):
        for sign in (-1, 1):
            u, v = np.roll(np.eye(3), axis, axis=1)[1:]
            n = sign * np.roll(np.eye(3), axis, axis=1)[0]
            corners = [half * (n + a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            facets += [[corners[k] for k in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
    stl(path, facets)


def test_meshes_count_as_their_convex_hulls_and_missing_ones_as_capsules(tmp_path):
    stl_of_cube(tmp_path / "cube.stl", 0.05)
    mesh = BALLS.replace('<sphere radius="0.05"/>', f'<mesh filename="file://{tmp_path}/cube.stl"/>')
    found = Clearance(arm_from_urdf(mesh), -1.0, np.full(2, -3.0), np.full(2, 3.0))
    row = found.distances(np.zeros((1, 2)))[0]
    # Stretched, the cube's near face is at 0.75 m, the base's ball ends at 0.1 m, the floor is 1 m below.
    assert row[found.pairs.index(("base", "two"))] == pytest.approx(0.65, abs=1e-5)
    assert row[found.pairs.index(("two", "ground"))] == pytest.approx(0.95, abs=1e-5)
    lost = Clearance(arm_from_urdf(mesh.replace("cube.stl", "lost.stl")), None, np.full(2, -3.0), np.full(2, 3.0))
    assert "not found" in lost.source


@pytest.mark.parametrize("corners, height", [(12, 0.0), (300, 0.05)], ids=["flat", "too many neighbours at the tip"])
def test_a_mesh_without_convex_hull_is_named_and_capsules_stand_in(corners, height, tmp_path):
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), 0 * angles], axis=1)
    facets = [([0.0, 0.0, height], *ends) for ends in zip(rim, np.roll(rim, -1, axis=0))]
    stl(tmp_path / "cone.stl", facets)
    mesh = BALLS.replace('<sphere radius="0.05"/>', f'<mesh filename="file://{tmp_path}/cone.stl"/>')
    clearance = Clearance(arm_from_urdf(mesh), None, np.full(2, -3.0), np.full(2, 3.0))
    assert clearance.lacking == "no convex hull of its mesh cone.stl" and clearance.lacking in clearance.source
    assert "capsules" in clearance.source


def test_torque_counts_with_more_and_with_less_acceleration_where_asked():
    """As bridging a stall asks for: along a vertical swing more acceleration needs more, or gravity is helped less."""
    run = Trajectory(ARM.joint_names, (series(1.0),))
    asked = needs(torque_Nm=np.full(2, 1e3))

    def largest(*factors):
        margins = check(run, replace(asked, accelerations=factors))
        return np.array([m.value for m in margins if m.kind == "torque"])

    planned, more, both = largest(1.0), largest(1.0, 1.75), largest(1.0, 1.75, 0.58)
    assert np.all(more > 1.01 * planned) and np.all(both >= more - 1e-9)
    times = np.arange(0.0, run.duration_s, 0.002)
    motion = run.evaluate(times)
    scaled = model_torque(asked.identified, Motion(motion.q, motion.qd, 1.75 * motion.qdd), 500.0)
    assert np.allclose(more, np.maximum(planned, np.abs(scaled).max(axis=0)), rtol=1e-6)
