"""From a simulation to the arm: each layer finds what was changed in MuJoCo, and nothing where nothing was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import small_arm
from mujoco_arm import JOINTS, mjcf, mujoco_or_skip, pushed, recorded
from scipy.signal import lfilter

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.dynamics.model_file import save_model
from spacearm_ident.dynamics.regressor import INERTIAL_SYMBOLS
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.optional_terms import OptionalTerm
from spacearm_ident.layers.compare import compare
from spacearm_ident.layers.comparison import Comparison
from spacearm_ident.layers.conventions import Wired, find_wiring
from spacearm_ident.layers.discrete import find_mistakes
from spacearm_ident.layers.document import verdict
from spacearm_ident.layers.item import Item
from spacearm_ident.layers.joint_fit import JointFit, in_newton_metres
from spacearm_ident.layers.linear import Linear
from spacearm_ident.layers.parameters import Change, changes, combinations
from spacearm_ident.layers.physics import OPTIONAL, optional_terms, with_friction_terms
from spacearm_ident.layers.wiring import Wiring
from spacearm_ident.mismatch.finding import NO_MISMATCH, Finding
from spacearm_ident.mismatch.noise import model_error_share
from spacearm_ident.mismatch.preparation import banded
from spacearm_ident.recording import Recording
from spacearm_ident.recording.recording import Series
from spacearm_ident.recording.writer import write_recording
from spacearm_ident.sessions.reading import Comparing
from spacearm_ident.sessions.simulation import compare_session
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.simulations import Simulation, read_simulation

STRONG = {"armature": 1.0, "damping": 3.0, "friction": 4.0}
"""Joints beside whose friction and rotor inertia the links weigh little."""


def _written(tmp_path: Path, **changes: float) -> Path:
    """The file of a simulation."""
    mujoco_or_skip()
    path = tmp_path / "three.xml"
    path.write_text(mjcf(**changes))
    return path


@pytest.fixture
def simulation(tmp_path: Path) -> Simulation:
    return read_simulation(_written(tmp_path))


@pytest.fixture
def strong(tmp_path: Path) -> Simulation:
    return read_simulation(_written(tmp_path, **STRONG))


def _motions(*runs: Recording) -> list[Motion]:
    return banded(runs, JOINTS, 20.0, 70.0)


def _wired(simulation: Simulation, run: Recording) -> Wired:
    """The wiring that a recording of the simulation's arm demands."""
    return find_wiring(simulation.model, _motions(run), simulation.own)


def _compared(simulation: Simulation, **changes: float) -> Comparison:
    """Layers 0, 1 and 3 against an arm with changed parameters; no effect of the catalogue is considered."""
    text = mjcf(**changes)
    runs = [recorded(text, seed) for seed in (1, 2)]
    return compare(simulation, runs[:1], runs[1:], excluded=tuple(EFFECTS))


def _items(comparison: Comparison, layer: str) -> tuple[Item, ...]:
    return next(one.items for one in comparison.layers if one.name == layer)


def _recorded_as(recording: Recording, wiring: Wiring) -> Recording:
    """The recording as wiring that is off would have made it."""
    late = np.column_stack(
        [np.interp(recording.time - wiring.delay_s, recording.time, one) for one in recording.effort.T]
    )
    return replace(recording, effort=late * wiring.gain, position=recording.position - wiring.zero_rad)


def test_an_arm_that_is_its_simulation_has_no_items(simulation: Simulation) -> None:
    comparison = _compared(simulation)
    assert [item.name for layer in comparison.layers for item in layer.items] == []
    np.testing.assert_allclose(comparison.after_Nm, comparison.before_Nm, rtol=0.1)


def test_heavier_link_is_named_with_its_mass(simulation: Simulation) -> None:
    comparison = _compared(simulation, upper_mass=3.6)
    (item,) = _items(comparison, "parameters")
    assert (item.name, item.joints, item.was) == ("mass", ("shoulder",), 3.0)
    assert item.low < 3.6 < item.high
    assert np.all(comparison.after_Nm < 1.2 * 0.02)


def test_friction_and_damping_are_named_at_every_joint(simulation: Simulation) -> None:
    comparison = _compared(simulation, friction=1.1, damping=0.4)
    items = {(item.name, item.joints[0]): item for item in _items(comparison, "parameters")}
    assert set(items) == {(name, joint) for name in ("frictionloss", "damping") for joint in JOINTS}
    for (name, _), item in items.items():
        truth = {"frictionloss": 1.1, "damping": 0.4}[name]
        assert abs(item.value - truth) < 0.02
        assert item.replicated


def test_many_changes_become_combinations_with_the_simulations_names(simulation: Simulation) -> None:
    """Where no few words do, the value of each combination is the true one within its interval."""
    changes = {"upper_mass": 3.5, "fore_mass": 1.5, "fore_y": 0.03, "armature": 0.08}
    comparison = _compared(simulation, **changes)
    items = _items(comparison, "parameters")
    assert items
    assert all(item.low <= item.value <= item.high for item in items)
    assert np.all(comparison.after_Nm < 1.2 * 0.02)


@pytest.mark.parametrize(
    ("wiring", "found"),
    [
        (Wiring(np.array([1.0, 0.75, 1.0]), np.zeros(3)), ("gain[shoulder]",)),
        (Wiring(np.ones(3), np.array([0.0, 0.03, 0.0])), ("zero[shoulder]",)),
        (Wiring(np.ones(3), np.zeros(3), 0.006), ("delay",)),
        (Wiring(np.ones(3), np.zeros(3), -0.0025), ()),
        (Wiring(np.ones(3), np.zeros(3)), ()),
    ],
    ids=["gain", "zero", "late", "half a sampling period early", "nothing"],
)
def test_wiring_that_is_off_is_found_with_its_size(
    simulation: Simulation, wiring: Wiring, found: tuple[str, ...]
) -> None:
    run = _recorded_as(recorded(mjcf(), 3), wiring)
    wired = _wired(simulation, run)
    assert wired.found == found
    np.testing.assert_allclose(wired.wiring.gain, wiring.gain, rtol=0.02)
    np.testing.assert_allclose(wired.wiring.zero_rad, wiring.zero_rad, atol=0.004)
    assert abs(wired.wiring.delay_s - wiring.delay_s) < 0.001


@pytest.mark.parametrize("by_state", [False, True])
def test_linear_problem_with_another_delay_is_the_one_built_with_it(simulation: Simulation, by_state: bool) -> None:
    motions = _motions(*(recorded(mjcf(), seed) for seed in (3, 4)))
    weights, other = in_newton_metres(simulation.arm), Wiring(np.array([1.0, 0.8, 1.0]), np.array([0.0, 0.02, 0.0]))
    known = Linear(simulation.model, motions, weights, other, by_state)
    late, rebuilt = (
        known.delayed(motions, 0.013),
        Linear(simulation.model, motions, weights, replace(other, delay_s=0.013)),
    )
    np.testing.assert_allclose(late.gram, rebuilt.gram, rtol=1e-12, atol=1e-12 * np.abs(rebuilt.gram).max())
    np.testing.assert_allclose(late.rms(late.start()), rebuilt.rms(rebuilt.start()), rtol=1e-12)
    assert late.wiring.delay_s == 0.013 and known.wiring.delay_s == 0.0
    assert (late.by_state is not None) == by_state
    assert not np.allclose(late.rms(late.start()), known.rms(known.start()), rtol=1e-3)


@pytest.mark.long
def test_a_gain_beside_a_push_is_found_with_its_size(simulation: Simulation) -> None:
    """Where the push acts was found beside torque that is off, and would explain the gain."""
    wiring = Wiring(np.array([0.8, 1.0, 1.0]), np.zeros(3))
    runs = [recorded(mjcf(), seed, noise_Nm=0.05) for seed in (1, 2, 3)]
    for number, begin_s in enumerate((7.0, 9.0)):
        runs[number] = pushed(runs[number], mjcf(), (20.0, -20.0, 20.0), begin_s, begin_s + 3.0)
    runs = [_recorded_as(run, wiring) for run in runs]
    comparison = compare(simulation, runs[:2], runs[2:])
    (gain,) = _items(comparison, "conventions")
    assert (gain.name, gain.joints) == ("effort_gain", ("base_turn",))
    assert gain.low < 0.8 < gain.high and gain.value == pytest.approx(0.8, abs=0.015)
    assert _items(comparison, "parameters") == ()
    assert [item.name for item in _items(comparison, "physics")] == ["external_contact"]
    assert np.all(comparison.after_Nm < 1.2 * comparison.noise_Nm)


@pytest.mark.long
def test_late_torque_beside_a_push_is_a_delay_of_the_recordings_and_no_physics(simulation: Simulation) -> None:
    """Before the push is known the delay does not show; it is searched for again once it is."""
    late, runs = Wiring(np.ones(3), np.zeros(3), 0.005), []
    for seed, begin_s in ((1, 4.0), (2, 15.0), (3, 9.0)):
        touched = pushed(recorded(mjcf(), seed), mjcf(), (12.0, -8.0, 10.0), begin_s, begin_s + 3.0)
        runs.append(_recorded_as(touched, late))
    comparison = compare(
        simulation, runs[:2], runs[2:], excluded=tuple(set(EFFECTS) - {"external_contact", "time_delay"})
    )
    (delay,) = _items(comparison, "conventions")
    assert delay.name == "delay"
    assert delay.low < 0.005 < delay.high
    assert {item.name for item in _items(comparison, "physics")} == {"external_contact"}


def _exchanged(recording: Recording, one: int, other: int) -> Recording:
    """The recording with two joints under each other's names."""
    order = list(range(len(recording.joints)))
    order[one], order[other] = other, one
    return replace(recording, position=recording.position[:, order], effort=recording.effort[:, order])


def test_conventions_that_all_recordings_break_are_found_and_those_of_one_alone_are_not(simulation: Simulation) -> None:
    runs = [recorded(mjcf(), seed) for seed in (1, 2)]
    undoing = find_mistakes([_exchanged(run, 1, 2) for run in runs], simulation)
    assert [(one.name, one.joints) for one in undoing.mistakes] == [("joints_exchanged", ("shoulder", "elbow"))]
    np.testing.assert_allclose(
        undoing.corrections.applied(_exchanged(runs[0], 1, 2)).position, runs[0].position, atol=1e-12
    )
    assert find_mistakes([_exchanged(runs[0], 1, 2), runs[1]], simulation).mistakes == ()
    assert find_mistakes(runs, simulation).mistakes == ()


def test_friction_that_a_simulation_has_wrong_is_no_exchange(simulation: Simulation) -> None:
    known = {p.name: float(v) for p, v in zip(simulation.model.model.parameters, simulation.model.parameters)}
    wrong = known | {"f_c[elbow]": 2.5 * known["f_c[elbow]"], "f_c[shoulder]": 0.4 * known["f_c[shoulder]"]}
    told = replace(simulation, model=replace(simulation.model, parameters=np.array(list(wrong.values()))))
    assert find_mistakes([recorded(mjcf(), seed) for seed in (1, 2)], told).mistakes == ()


def test_tilted_base_is_found_about_the_axis_it_is_tilted_about(simulation: Simulation) -> None:
    """Turned by -0.03 rad about x the arm feels gravity as in a base frame turned by +0.03."""
    text = mjcf().replace(
        'timestep="0.001"', f'timestep="0.001" gravity="0 {-9.81 * np.sin(0.03)} {-9.81 * np.cos(0.03)}"'
    )
    wired = _wired(simulation, recorded(text, 3))
    assert "tilt[x]" in wired.found and set(wired.found) <= {"tilt[x]", "tilt[y]"}
    np.testing.assert_allclose(wired.wiring.tilt_rad, [0.03, 0.0, 0.0], atol=0.002)


@pytest.mark.parametrize(
    ("own", "gain", "noise_Nm", "found"),
    [
        (STRONG, 0.8, 1.0, ("gain[base_turn]",)),
        ({"armature": 0.8, "damping": 1.8, "friction": 2.2}, 0.8, 1.0, ()),
        (STRONG, 0.97, 0.05, ()),
    ],
    ids=["as written but for the gain", "less by shares of their own", "no better known than a file's digits"],
)
def test_gain_at_a_joint_without_load_is_told_by_what_it_leaves_as_written(
    strong: Simulation, own: dict[str, float], gain: float, noise_Nm: float, found: tuple[str, ...]
) -> None:
    run = _recorded_as(recorded(mjcf(**own), 3, noise_Nm=noise_Nm), Wiring(np.array([gain, 1.0, 1.0]), np.zeros(3)))
    wired = _wired(strong, run)
    assert wired.found == found
    np.testing.assert_allclose(wired.wiring.gain[0], gain if found else 1.0, atol=0.02)


def _rubbing(run: Recording, share: float, armature: float) -> Recording:
    """The recording with friction at the base's motor by a share of the torque that the motor gives to the gear."""
    speed = np.gradient(run.position, run.time, axis=0)
    load = run.effort - armature * np.gradient(speed, run.time, axis=0)
    driving = load * speed > 0.0
    rub = np.abs(load) * np.sign(speed) * np.where(driving, share / (1 - share), share / (1 + share))
    return replace(run, effort=run.effort + rub * np.array([1.0, 0.0, 0.0]))


def test_friction_by_the_load_on_the_motors_side_is_no_gain(simulation: Simulation) -> None:
    run = _rubbing(recorded(mjcf(), 3), 0.15, 0.05)
    wired = _wired(simulation, run)
    assert wired.found == () and wired.suspected == ()


def test_friction_by_the_load_where_there_is_little_is_named_and_not_friction_that_has_grown(
    strong: Simulation,
) -> None:
    """There it is all of a joint's friction by one factor: that the file has both right distinguishes the two."""
    runs = [_rubbing(recorded(mjcf(**STRONG), seed, noise_Nm=0.2), 0.15, 1.0) for seed in (1, 2)]
    others = [kind for kind in EFFECTS if kind != "load_friction"]
    comparison = compare(strong, runs[:1], runs[1:], excluded=others)
    assert _items(comparison, "conventions") == _items(comparison, "parameters") == ()
    (item,) = _items(comparison, "physics")
    assert (item.name, item.joints) == ("load_friction", ("base_turn",))
    assert item.low < 0.15 < item.high
    assert item.value == pytest.approx(0.15, abs=0.01)


def test_friction_and_damping_by_one_factor_are_not_named_where_they_may_be_another_thing(strong: Simulation) -> None:
    runs = [recorded(mjcf(armature=1.0, damping=3.9, friction=5.2), seed, noise_Nm=1.0) for seed in (3, 4)]
    wired = _wired(strong, runs[0])
    assert list(wired.open_factors) == ["elbow"]
    comparison = compare(strong, runs[:1], runs[1:], excluded=tuple(EFFECTS))
    named = {(item.name, item.joints[0]) for item in _items(comparison, "parameters")}
    assert named == {(word, joint) for word in ("damping", "frictionloss") for joint in ("base_turn", "shoulder")}
    (parameters,) = [layer for layer in comparison.layers if layer.name == "parameters"]
    assert any(
        note.startswith("torque does not tell whether friction") and "of elbow" in note for note in parameters.notes
    )


def test_what_the_model_leaves_out_is_judged_once_values_have_settled(
    strong: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One step after a gain and friction have changed, what is left is the step's error, a function of the state."""
    run = _recorded_as(recorded(mjcf(**STRONG), 3, noise_Nm=0.02), Wiring(np.array([0.7, 1.0, 1.0]), np.zeros(3)))
    motions = _motions(run)
    known = find_wiring(strong.model, motions, strong.own)
    assert known.found == ("gain[base_turn]",)
    shares = []

    def share(*args: object) -> np.ndarray:
        shares.append(model_error_share(*args))
        return shares[-1]

    monkeypatch.setattr("spacearm_ident.layers.hypotheses.model_error_share", share)
    rough = replace(known, wiring=replace(known.wiring, gain=np.ones(3)))
    again = find_wiring(strong.model, motions, strong.own, rough)
    assert shares[0][0] < 0.2
    assert again.found == known.found
    np.testing.assert_allclose(again.wiring.gain[0], 0.7, atol=0.01)


def test_share_of_a_residual_that_is_a_function_of_the_joints_state(simulation: Simulation) -> None:
    """Adjusted for the number of functions that follow it: noise has none."""
    run = recorded(mjcf(), 1, noise_Nm=0.05)
    away = (run.position + 0.1) / 0.15
    bump = away * np.exp(-0.5 * away**2) * np.array([1.0, 0.0, 0.0])
    for size, least, most in ((0.0, 0.0, 0.1), (0.5, 0.6, 1.0)):
        motions = _motions(replace(run, effort=run.effort + size * bump))
        left = [motion.torque - simulation.model.torque(motion) for motion in motions]
        share = model_error_share(simulation.model, motions, left)
        assert least <= share[0] <= most
        assert np.all(share[1:] < 0.1)


def test_torque_of_the_position_that_no_term_has_makes_no_gain(strong: Simulation) -> None:
    """It is the same function in every recording, so that rows beyond the first of a place say nothing new."""
    runs = []
    for seed in (1, 2, 3):
        run = recorded(mjcf(armature=1.0, damping=4.5, friction=4.0), seed, noise_Nm=0.05)
        away = (run.position[:, 0] + 0.1) / 0.15
        runs.append(replace(run, effort=run.effort + np.outer(-6.0 * away * np.exp(-0.5 * away**2), [1.0, 0.0, 0.0])))
    comparison = compare(strong, runs[:2], runs[2:], excluded=tuple(EFFECTS))
    assert _items(comparison, "conventions") == ()
    assert [item.joints for item in _items(comparison, "rest")] == [("base_turn",)]


def test_static_level_that_was_left_out_is_not_in_the_corrected_simulation(simulation: Simulation) -> None:
    """A tie of it to the Coulomb friction is to their values: prior means that differ would stay between them."""
    model = simulation.model
    structure = {
        **model.model.structure,
        "stribeck_friction": {"presliding": False, "stribeck": ["elbow"], "load": []},
    }
    whole = model.carried_to(TorqueModel(model.model.arm, structure))
    constants = np.array([0.2 if one.name == "v_b[elbow]" else 0.0 for one in whole.model.constants])
    motions = _motions(*(recorded(mjcf(), seed) for seed in (1, 2)))
    whole = replace(whole, constants=constants)
    fit = JointFit(simulation, whole, find_wiring(whole, motions, simulation.own), motions[:1], motions[1:])
    fit.leave_out(optional_terms(whole, model.model))
    corrected = fit.mended(20.0, (), 0.02)
    assert corrected.value("f_b", "elbow") == pytest.approx(corrected.value("f_c", "elbow"), rel=1e-3)
    np.testing.assert_allclose(fit.judge.rms(fit.beside(corrected)), fit.judge.rms(fit.estimate.values), rtol=0.1)


@pytest.mark.parametrize("mass", [3.0, 3.6], ids=["as in the file", "heavier"])
def test_corrected_simulation_keeps_bodies_as_they_are_as_far_as_that_predicts(
    simulation: Simulation, mass: float
) -> None:
    """All are asked to stay, as if nothing differed; where one does, prediction on other recordings goes first."""
    motions = _motions(*(recorded(mjcf(upper_mass=mass), seed) for seed in (1, 2)))
    wired = find_wiring(simulation.model, motions, simulation.own)
    fit = JointFit(simulation, simulation.model, wired, motions[:1], motions[1:])
    known = combinations(fit.linear, simulation)
    values = fit.beside(fit.mended(20.0, [(one.vector, one.was) for one in known], 0.02))
    assert np.all(fit.judge.rms(values) < 1.1 * fit.judge.rms(fit.estimate.values))
    moved = max(abs(float(one.vector @ values) - one.was) / fit.estimate.error(one.vector) for one in known)
    assert (moved < 0.3) is (mass == 3.0)


@pytest.mark.long
def test_torque_that_follows_nothing_is_said_though_no_recording_tells_it_from_noise(simulation: Simulation) -> None:
    runs = [recorded(mjcf(), seed) for seed in (1, 2)]
    dragged = []
    for seed, run in enumerate(runs):
        kick = np.random.default_rng(seed).normal(size=len(run.time))
        step = float(np.median(np.diff(run.time)))
        wander = lfilter([np.sqrt(2.0 * step)], [1.0, step - 1.0], kick)
        dragged.append(replace(run, effort=run.effort + 0.3 * np.outer(wander + 1.0, [0.0, 0.0, 1.0])))
    for each, joints in ((runs, []), (dragged, [("elbow",)])):
        comparison = compare(simulation, each[:1], each[1:], excluded=tuple(EFFECTS))
        assert [item.joints for item in _items(comparison, "rest")] == joints
        # Its mean is no constant of its own.
        assert _items(comparison, "physics") == ()


def test_intervals_hold_where_friction_has_physics_that_is_not_in_the_model(simulation: Simulation) -> None:
    """What is left out is the same function of the position in every block of time."""
    text = mjcf(friction=1.1)
    runs = []
    for seed in (1, 2):
        run = recorded(text, seed)
        speed = np.gradient(run.position[:, 2], run.time)
        tight = 0.3 * np.sin(2.0 * run.position[:, 2]) * np.sign(speed)
        runs.append(replace(run, effort=run.effort + np.outer(tight, [0.0, 0.0, 1.0])))
    found = _items(compare(simulation, runs[:1], runs[1:], excluded=tuple(EFFECTS)), "parameters")
    friction = {item.joints[0]: item for item in found if item.name == "frictionloss"}
    assert set(friction) == set(JOINTS)
    for item in friction.values():
        assert item.low < 1.1 < item.high, item
    assert friction["elbow"].high - friction["elbow"].low > 10 * (friction["shoulder"].high - friction["shoulder"].low)


def test_current_offset_does_not_hide_a_torque_constant(simulation: Simulation) -> None:
    run = _recorded_as(recorded(mjcf(), 3), Wiring(np.array([1.0, 1.0, 0.8]), np.zeros(3)))
    run = replace(run, effort=run.effort + np.array([0.0, 0.0, 0.5]))
    wired = _wired(simulation, run)
    assert wired.found == ("gain[elbow]",)
    assert abs(wired.wiring.gain[2] - 0.8) < 0.02


def test_constant_torque_is_named_with_what_no_motion_tells_from_it(simulation: Simulation) -> None:
    runs = [recorded(mjcf(), seed) for seed in (1, 2)]
    runs = [replace(run, effort=run.effort + np.array([0.0, 0.0, 0.5])) for run in runs]
    others = [kind for kind in EFFECTS if kind != "current_offset"]
    (item,) = _items(compare(simulation, runs[:1], runs[1:], excluded=others), "physics")
    assert (item.name, item.joints, item.equivalents) == ("current_offset", ("elbow",), ("asymmetric_friction",))
    assert item.title == "current offset or asymmetric friction"


@pytest.mark.long
def test_effects_that_a_simulation_lacks_are_named_where_nothing_but_the_field_says_what_noise_is(
    simulation: Simulation,
) -> None:
    """A spring is slow and a ripple large: both would be noise to a model of the residual that contains them."""
    runs = [recorded(mjcf(), seed) for seed in (1, 2, 3)]
    torque = np.array([0.0, 0.5, 0.0]), np.array([2.0, 0.0, 0.0])
    runs = [
        replace(run, effort=run.effort + torque[0] * np.sin(31 * run.position) + torque[1] * run.position)
        for run in runs
    ]
    comparison = compare(simulation, runs[:2], runs[2:])
    items = {item.name: item for item in _items(comparison, "physics")}
    assert {name: item.joints for name, item in items.items()} == {
        "harness_spring": ("base_turn",),
        "torque_ripple": ("shoulder",),
    }
    assert items["harness_spring"].low < 2.0 < items["harness_spring"].high
    assert np.all(comparison.after_Nm < 1.5 * 0.02)


def test_stribeck_friction_that_the_search_named_is_in_the_model_once(simulation: Simulation) -> None:
    """A v_b beside a static level that is held is a second one, and so is a curve of the velocity that stays."""
    model = simulation.model
    base = model.model.structure
    named = {**base, "stribeck": {"at": [{"joint": "elbow"}]}}
    extended = model.carried_to(TorqueModel(model.model.arm, named))
    chosen = {
        **base,
        "stribeck_friction": {"presliding": False, "stribeck": ["shoulder", "elbow"], "load": []},
        "viscous_friction": {"held": {"base_turn": ["k_v2", "k_v3"]}},
    }
    identified = model.carried_to(TorqueModel(model.model.arm, chosen))
    slow = np.array([0.2 if constant.symbol == "v_b" else 0.0 for constant in identified.model.constants])
    curved = identified.parameters + [1.5 * (one.symbol == "k_v2") for one in identified.model.parameters]
    left = {"elbow": 1.0}
    finding = Finding("stribeck", ("elbow",), "", "", "", {}, 0.99, (), 100.0, 100.0, 1.0, left, left, 0.9)
    whole = with_friction_terms(
        extended, base, replace(identified, constants=slow, parameters=np.array(curved)), [finding]
    )
    speeds = dict(zip((constant.name for constant in whole.model.constants[:6]), whole.constants[:6]))
    assert speeds["v_b[shoulder]"] == 0.2
    assert speeds["v_b[elbow]"] == 0.0
    assert whole.value("k_v2", "shoulder") == 1.5
    assert whole.value("k_v2", "elbow") == 0.0


def test_every_optional_term_of_identify_may_be_missing_from_a_simulation_or_is_left_out_for_a_reason() -> None:
    absent = {term for term in OptionalTerm if term.row.symbol not in {one.symbol for one in OPTIONAL}}
    # The other form of k_v2; what acts beside reversals, where no row counts; what the search for effects finds.
    reasons = {OptionalTerm.ODD, OptionalTerm.PRESLIDING, OptionalTerm.SPRING}
    assert absent == reasons, "a term that identify may choose has no line in layers.physics.OPTIONAL, and is dropped"


def test_stribeck_velocity_is_fitted_with_the_friction_beside_it(simulation: Simulation) -> None:
    """The search has it a fifth too high; friction loss and damping take the difference until it is fitted, too."""
    model, runs = simulation.model, []
    for seed in (1, 2):
        run = recorded(mjcf(), seed, noise_Nm=0.02)
        speed = np.gradient(run.position[:, 1], run.time)
        extra = 4.0 * np.exp(-((speed / 0.3) ** 2)) * np.sign(speed)
        runs.append(replace(run, effort=run.effort + np.outer(extra, [0.0, 1.0, 0.0])))
    named = {**model.model.structure, "stribeck": {"at": [{"joint": JOINTS[1]}]}}
    whole = model.carried_to(TorqueModel(model.model.arm, named))
    whole = replace(whole, constants=np.append(np.zeros(len(whole.constants) - 1), 0.36))
    motions = _motions(*runs)
    wired = find_wiring(simulation.model, motions[:1], simulation.own)
    losses = []
    for _ in range(4):
        fit = JointFit(simulation, whole, replace(wired, found=(), laws={}), motions[:1], motions[1:])
        assert fit.depends_on_itself
        whole = fit.fitted
        losses.append(whole.value("f_c", JOINTS[1]))
    assert whole.constants[-1] == pytest.approx(0.3, rel=0.01)
    assert losses[-1] == pytest.approx(0.8, abs=0.02) and abs(losses[0] - 0.8) > 0.1


def test_no_joint_has_less_than_no_damping(simulation: Simulation) -> None:
    runs = [recorded(mjcf(), seed) for seed in (1, 2)]
    runs = [
        replace(run, effort=run.effort - np.gradient(run.position, run.time, axis=0) * np.array([0.0, 0.0, 1.0]))
        for run in runs
    ]
    damping = [
        item
        for item in _items(compare(simulation, runs[:1], runs[1:], excluded=tuple(EFFECTS)), "parameters")
        if item.name == "damping"
    ]
    assert [(item.joints, item.value) for item in damping] == [(("elbow",), 0.0)]


def _warm(seed: int, celsius: float, creep: float = 0.0) -> Recording:
    """A recording in which the elbow warms by 2 K and its friction falls by 2 % a kelvin from 20 degrees C."""
    run = recorded(mjcf(), seed)
    risen = 2.0 * run.time / run.time[-1]
    speed = np.gradient(run.position[:, 2], run.time)
    friction = -0.02 * (celsius + risen - 20.0) * (0.8 * np.sign(speed) + 0.9 * speed)
    friction += creep * risen * (np.sign(speed) + speed)
    temperatures = {
        joint: Series(run.time, celsius + risen if joint == "elbow" else np.full_like(run.time, 20.0))
        for joint in JOINTS
    }
    return replace(run, effort=run.effort + np.outer(friction, [0.0, 0.0, 1.0]), temperatures=temperatures)


@pytest.mark.long
def test_physics_that_held_out_data_need_stands_though_they_do_not_tell_its_size(simulation: Simulation) -> None:
    """Over two kelvin friction that creeps hides what temperature does, and not over the twenty between recordings."""
    fitted = [_warm(seed, celsius) for seed, celsius in ((1, 22.0), (2, 30.0), (3, 38.0))]
    others = [kind for kind in EFFECTS if kind != "temperature_friction"]
    (item,) = _items(compare(simulation, fitted, [_warm(4, 46.0, creep=0.02)], excluded=others), "physics")
    assert (item.name, item.joints, item.replicated) == ("temperature_friction", ("elbow",), False)
    assert abs(item.value + 0.02 * 0.8) < 0.001


def _in_a_shell(tmp_path: Path, simulation: Path, **changes: float) -> Path:
    """The result of the command on two recordings of a changed arm, no effect of the catalogue being considered."""
    for name, seed in (("real.mcap", 4), ("real_2.mcap", 5)):
        write_recording(tmp_path / name, recorded(mjcf(**changes), seed))
    words = [tmp_path / "real.mcap", "--validate", tmp_path / "real_2.mcap", "--simulation", simulation]
    assert main(["mismatch", *map(str, words), "--out", str(tmp_path / "out"), "--without", *EFFECTS]) == 0
    return tmp_path / "out"


def _refused(tmp_path: Path, simulation: Path, capsys: pytest.CaptureFixture) -> str:
    """What the command says that refuses a simulation."""
    write_recording(tmp_path / "real.mcap", recorded(mjcf(), 4, seconds=6.0))
    words = [tmp_path / "real.mcap", "--simulation", simulation, "--out", tmp_path / "out"]
    assert main(["mismatch", *map(str, words)]) == 2
    return capsys.readouterr().err


def test_command_line_writes_layers_the_mended_file_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = _in_a_shell(tmp_path, _written(tmp_path), fore_mass=2.3)
    assert "mass of fore" in capsys.readouterr().out
    document = json.loads((out / "mismatch.json").read_text())
    assert document["verdict"] == "mismatch"
    assert [layer["layer"] for layer in document["layers"]] == ["conventions", "parameters", "physics", "rest"]
    assert set(document["ceiling_Nm"]) == set(JOINTS)
    assert document["mended_simulation"] == "mended.xml"
    assert read_simulation(out / "mended.xml").arm.joint_names == JOINTS
    was, now = (document["closed_loop"][name]["feedback_rms_Nm"] for name in ("simulation", "mended"))
    assert now["elbow"] < 0.5 * was["elbow"] and now["shoulder"] < 0.5 * was["shoulder"]
    page = (out / "report.html").read_text()
    assert "mass of fore" in page and "mended.xml" in page and "In closed loop" in page


def test_corrected_column_is_of_the_file_where_its_format_cannot_hold_what_differs(
    simulation: Simulation, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """A URDF has no rotor inertia: 0.4 kg m^2 of three joints stay in the residual."""
    urdf = tmp_path / "three.urdf"
    urdf.write_text(simulation.arm.urdf)
    out = _in_a_shell(tmp_path, urdf, fore_mass=2.3, armature=0.4)
    document = json.loads((out / "mismatch.json").read_text())
    assert "cannot hold: rotor inertia J_m" in capsys.readouterr().out
    file = read_simulation(out / "mended.urdf").model
    motions, _ = prepare([recorded(mjcf(fore_mass=2.3, armature=0.4), 5)], JOINTS)
    left = np.concatenate([motion.torque_rows - motion.reduce(file.torque(motion)) for motion in motions])
    moving = np.concatenate([motion.moving for motion in motions])
    for k, joint in enumerate(JOINTS):
        rms = np.sqrt(np.mean(left[moving[:, k], k] ** 2))
        assert document["mended_Nm"][joint] == pytest.approx(rms, rel=0.15)
        assert document["mended_Nm"][joint] > 3.0 * document["residual_after_Nm"][joint]


def test_comparison_stands_where_no_corrected_file_can_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise UserError("no body has such moments")

    monkeypatch.setattr("spacearm_ident.sessions.simulation.mend", refused)
    out = _in_a_shell(tmp_path, _written(tmp_path), fore_mass=2.3, armature=0.4)
    document = json.loads((out / "mismatch.json").read_text())
    assert document["verdict"] == "mismatch" and document["mended_simulation"] is None
    said = "there is no corrected file: no body has such moments"
    assert said in capsys.readouterr().out
    assert said[1:] in (out / "report.html").read_text()  # It begins a sentence there.


def test_simulation_that_the_result_would_replace_is_refused_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "out").mkdir()
    sim = _written(tmp_path).rename(tmp_path / "out" / "mended.xml")
    assert "would be replaced" in _refused(tmp_path, sim, capsys)
    assert sim.read_text() == mjcf()


def test_simulation_of_other_joints_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    sim = _written(tmp_path)
    sim.write_text(mjcf().replace("elbow", "ellbogen"))
    assert "same names" in _refused(tmp_path, sim, capsys)
    assert not (tmp_path / "out").exists()


def test_simulation_whose_joints_have_a_prefix_is_compared_and_its_corrected_file_keeps_it(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    sim, text = _written(tmp_path), mjcf()
    for joint in JOINTS:
        text = text.replace(f'name="{joint}"', f'name="left/{joint}"')
    sim.write_text(text)
    out = _in_a_shell(tmp_path, sim, fore_mass=2.3)
    said = capsys.readouterr().out
    assert "mass of fore" in said and "left/elbow is elbow" in said
    document = json.loads((out / "mismatch.json").read_text())
    assert set(document["closed_loop"]["mended"]["feedback_rms_Nm"]) == set(JOINTS)
    mended = read_simulation(out / "mended.xml")
    assert mended.arm.joint_names == tuple(f"left/{joint}" for joint in JOINTS)
    # What torque does not divide between bodies stays near the file: 2.2 kg there, 2.7 kg in the arm.
    assert mended.values["m[left/elbow]"] == pytest.approx(2.7, rel=0.05)
    assert read_simulation(out / "extended_model.yaml").arm.joint_names == JOINTS


def test_simulation_of_two_arms_whose_names_may_both_be_the_recordings_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    sim, body = _written(tmp_path), mjcf().split("<worldbody>")[1].split("</worldbody>")[0]
    arms = "".join(body.replace('name="', f'name="{side}/') for side in ("left", "right"))
    sim.write_text(f"<mujoco><worldbody>{arms}</worldbody></mujoco>")
    said = _refused(tmp_path, sim, capsys)
    assert "prefix 'left/'" in said and "prefix 'right/'" in said and "keep one arm" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("was", "now", "named"), [(15.0, 15.04, False), (15.0, 15.2, True), (0.0, 0.04, True)])
def test_change_is_named_when_it_exceeds_the_digits_of_the_file(was: float, now: float, named: bool) -> None:
    """One per cent of the simulation's value, however small the error; of zero there are no digits."""
    change = Change("damping", ("elbow",), "elbow", "N m s/rad", np.ones(1), was)
    found = SimpleNamespace(of=lambda vector: now, error=lambda vector: 0.005)
    different, same = changes([change], found)
    assert [one is change for one in different] == [True] * named
    assert all(size == pytest.approx(0.15) for _, size in same) and len(same) == 1 - named


def test_bodies_of_an_identified_model_stay_where_the_recordings_lack_one_of_its_joints(tmp_path: Path) -> None:
    """The elbow's link, half as heavy again as in the URDF that the model began with, is held still."""
    identified, run = small_arm.identified(), small_arm.recording(still=(1,))
    of_elbow = np.array([p.joint == "elbow" and p.symbol in INERTIAL_SYMBOLS for p in identified.model.parameters])
    model = replace(identified, parameters=np.where(of_elbow, 1.5, 1.0) * identified.parameters)
    save_model(model, tmp_path / "model.yaml")
    (motion,), _ = prepare([run], small_arm.JOINTS)
    time = motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
    run = run.between(time[0], time[-1])
    assert run.velocity is not None and run.effort is not None
    more = np.interp(run.time, time, (model.torque(motion) - identified.torque(motion))[:, 0])
    short = replace(
        run,
        joints=("shoulder",),
        position=run.position[:, :1],
        velocity=run.velocity[:, :1],
        effort=run.effort[:, :1] + more[:, None],
    )
    write_recording(tmp_path / "run.mcap", short)
    session = compare_session([tmp_path / "model.yaml"], [tmp_path / "run.mcap"], [], tmp_path / "out", Comparing())
    assert session.simulation.values["m[shoulder]"] == pytest.approx(4.0 + 1.5 * 2.0)
    assert verdict(session.comparison) == NO_MISMATCH
