"""Closed-loop output error: the simulated loop obeys mechanics, and noise in positions leaves its estimates alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from planted_arm import Friction, incommensurate, two_link_run

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification import output_error
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.simulated_loop import follow, sampled
from spacearm_ident.recording.recording import Recording, Series
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.simulation.closed_loop import SensorNoise, measure, simulate_truth
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.plant import Plant
from spacearm_ident.solvers.separable import solve

PLANTED = two_link_run([Friction(f_c=f_c, J_m=J_m, k_v2=0.0, k_v3=0.0) for f_c, J_m in ((5.0, 0.5), (3.0, 0.2))])
ARM = arm_from_urdf(PLANTED.urdf)
STRUCTURE = structure_of(ARM, "coulomb-viscous")
MODEL = TorqueModel(ARM, STRUCTURE)
TRUTH = np.array([PLANTED.values.get(item.name, 0.0) for item in MODEL.parameters])
CONSTANTS = np.zeros(len(MODEL.constants))


def column(symbol: str) -> FloatArray:
    return np.array([PLANTED.values[f"{symbol}[{joint}]"] for joint in ARM.joint_names])


def plant_parameters() -> PlantParameters:
    zero, f_c = np.zeros(2), column("f_c")
    rigid = np.stack([joint.inertial for joint in ARM.joints])
    return PlantParameters(
        ARM.joint_names,
        ARM.urdf,
        ARM.gravity,
        rigid,
        column("J_m"),
        zero,
        f_c,
        f_c,
        zero + 1.0,
        column("k_v1"),
        zero,
        zero,
    )


def reference(seconds: float) -> Motion:
    position, _, _ = incommensurate(np.arange(0.0, seconds, 1e-3), 2)
    return sampled(ARM.joint_names, 1000.0, position)


def commanded(noise: float = 0.05, seed: int = 0, encoder: float = 0.0) -> Recording:
    recording = PLANTED.recording(noise=noise, seed=seed, encoder=encoder)
    return replace(recording, command=Series(recording.time, PLANTED.q))


def identified(recording: Recording, solver: str) -> Identified:
    return identify([recording], ARM, Settings(20.0, STRUCTURE, solver))


def off(result: Identified) -> FloatArray:
    """Base parameters off the planted ones, in standard errors; those held fixed left out."""
    known = result.base_errors > 0
    return np.asarray(((result.base_values - result.base.regrouping @ TRUTH)[known]) / result.base_errors[known])


def test_the_simulated_loop_is_the_plant_under_the_same_controller():
    told = reference(4.0)
    bandwidth = np.array([12.0, 18.0])
    droop = follow(MODEL, TRUTH, CONSTANTS, told, bandwidth) - told.position
    # The plant integrates the whole arm and knows nothing of what cancels.
    plant = Plant(plant_parameters(), position=told.position[0], velocity=told.velocity[0])
    smooth = MODEL.torque(told, TRUTH, CONSTANTS, ("rigid_body", "rotor_inertia", "viscous_friction"))
    own = np.mean([np.diag(Plant(plant_parameters(), position=q).inertia()) for q in told.position[::20]], axis=0)
    omega = 2.0 * np.pi * bandwidth
    reached = np.empty_like(told.position)
    for k, (q, qd) in enumerate(zip(told.position, told.velocity)):
        reached[k] = plant.position
        behind, slower = q - plant.position, qd - plant.velocity
        plant.step(smooth[k] + own * (omega**2 * behind + 2.0 * omega * slower), 1e-3)
    settled = slice(500, None)
    apart = (reached - told.position - droop)[settled]
    assert np.abs(droop[settled]).max() > 3e-4
    assert (apart.std(axis=0) < 0.1 * droop[settled].std(axis=0)).all()


def test_at_constant_speed_the_arm_is_behind_by_friction_over_stiffness():
    time = np.arange(0.0, 3.0, 1e-3)
    told = sampled(ARM.joint_names, 1000.0, np.stack([np.zeros_like(time), 0.2 * time], axis=1))
    behind = told.position - follow(MODEL, TRUTH, CONSTANTS, told, np.array([10.0, 10.0]))
    inertia = Plant(plant_parameters()).inertia()[1, 1]  # of a last link it does not change with the posture
    assert behind[500:, 1] == pytest.approx(column("f_c")[1] / (inertia * (20.0 * np.pi) ** 2), rel=1e-3)
    # The shoulder stands: what the elbow's acceleration would do to it is held by friction.
    assert np.abs(behind[500:, 0]).max() < 1e-4


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_in_the_positions_biases_least_squares_and_not_these(seed):
    recording = commanded(seed=seed, encoder=1e-3)
    plain, result = identified(recording, "separable"), identified(recording, "cloe")
    assert np.abs(off(plain)).max() > 8.0
    assert np.abs(off(result)).max() < 4.0
    how, verdict, prior = result.notes
    assert "URDF's inertials" in prior
    assert "along the recorded commands" in how and "settled" in result.solver
    assert "disagree with least squares" in verdict and "noise in the measured positions" in verdict


def test_without_commands_they_are_nearer_and_say_what_noise_is_left():
    recording = replace(commanded(encoder=1e-3), command=None)
    plain, result = identified(recording, "separable"), identified(recording, "cloe")
    truth = result.base.regrouping @ TRUTH
    known = (result.base_errors > 0) & (plain.base_errors > 0)
    errors = [np.abs(each.base_values - truth)[known] / result.base_errors[known] for each in (plain, result)]
    assert np.linalg.norm(errors[1]) < 0.5 * np.linalg.norm(errors[0])
    assert "noise below 10 Hz stays" in result.notes[0] and "disagree with least squares" in result.notes[1]


@pytest.mark.parametrize("told", [True, False])
def test_without_noise_they_agree(told):
    recording = commanded() if told else replace(commanded(), command=None)
    result = identified(recording, "cloe")
    assert "agree with least squares" in result.notes[1] and "disagree" not in result.notes[1]
    assert np.abs(off(result)).max() < 4.0


def test_commands_that_the_arm_did_not_follow_are_not_taken():
    recording = commanded()
    other = np.roll(PLANTED.q, 3000, axis=0)
    result = identified(replace(recording, command=Series(recording.time, other)), "cloe")
    assert "along recorded positions" in result.notes[0] and "disagree" not in result.notes[1]


class _Followed:
    """A motion to follow from rest, as the simulated drives ask for it."""

    joints, duration_s = ARM.joint_names, 12.0

    def __init__(self) -> None:
        self._time = np.arange(-1.0, self.duration_s + 1.0, 1e-3)
        start = np.clip(self._time / 2.0, 0.0, 1.0)[:, None] ** 3
        motion = sampled(self.joints, 1000.0, start * incommensurate(self._time, 2)[0])
        self._signals = motion.position, motion.velocity, motion.acceleration

    def evaluate(self, t: FloatArray) -> SimpleNamespace:
        columns = ([np.interp(t, self._time, column) for column in signal.T] for signal in self._signals)
        return SimpleNamespace(**dict(zip(("q", "qd", "qdd"), (np.stack(column, axis=1) for column in columns))))


@cache
def driven() -> Recording:
    """The arm under its drives: position loop 8 Hz over velocity loop 40 Hz, friction unknown to them."""
    return measure(simulate_truth(plant_parameters(), _Followed(), rate_hz=500.0), SensorNoise(position_counts=2**19))


@cache
def simulated_from(bandwidth_hz: float) -> output_error.Outcome:
    motions, bandwidth = prepare([driven()], ARM.joint_names, 10.0, average=False)
    regression = Regression(MODEL, motions)
    for rows in regression.rows:
        rows.set_weight(np.full(len(rows.torque), 5.0))
    prior = make_prior(MODEL, motions)
    known = solve(regression, prior, CONSTANTS)
    return output_error.solve([driven()], regression, prior, known, bandwidth.cutoff_hz, bandwidth_hz)


@pytest.mark.parametrize("first_hz", [6.0, 60.0])
def test_the_loop_is_matched_to_the_recorded_one_wherever_it_begins(first_hz):
    found, usual = simulated_from(first_hz), simulated_from(20.0)
    words = found.words.split("joints' loops of ")[1].split(" Hz")[0].split(" to ")
    # A position loop over a velocity loop is as stiff as a critically damped one of sqrt(8 * 40) Hz, at this inertia.
    assert [float(word) for word in words] == pytest.approx([np.sqrt(8.0 * 40.0)] * 2, rel=0.3)
    assert found.solution.status == "settled"
    assert found.solution.parameters == pytest.approx(usual.solution.parameters, rel=0.01, abs=0.01)


def test_a_structure_with_effects_is_refused():
    structure = {**STRUCTURE, "time_delay": {"joints": [ARM.joint_names[0]]}}
    with pytest.raises(UserError, match="cloe simulates rigid arms with friction, not time_delay: take the solver"):
        identify([commanded()], ARM, Settings(20.0, structure, "cloe"))
