"""Instrumental variables see what noise in the positions does to least squares, and nothing where there is none."""

from __future__ import annotations

import numpy as np
import pytest
import small_arm
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.cross_check import compare
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.instrumental import halves, split_motions
from spacearm_ident.recording.recording import Recording

PLANTED = two_link_run([Friction(f_c=f_c, J_m=J_m, k_v2=0.0, k_v3=0.0) for f_c, J_m in ((5.0, 0.5), (3.0, 0.2))])
ARM = arm_from_urdf(PLANTED.urdf)
STRUCTURE = structure_of(ARM, "coulomb-viscous")


def identified(recording: Recording, solver: str) -> Identified:
    # At 20 Hz the noise of the acceleration is no longer small.
    return identify([recording], ARM, Settings(20.0, STRUCTURE, solver))


def off(result: Identified) -> np.ndarray:
    """Base parameters off the planted ones, in standard errors; those held fixed left out."""
    truth = np.array([PLANTED.values.get(item.name, 0.0) for item in result.model.model.parameters])
    known = result.base_errors > 0
    return ((result.base_values - result.base.regrouping @ truth)[known]) / result.base_errors[known]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_in_the_positions_biases_least_squares_and_not_these(seed):
    recording = PLANTED.recording(noise=0.05, seed=seed, encoder=1e-3)
    plain, result = identified(recording, "separable"), identified(recording, "idim-iv")
    assert np.abs(off(plain)).max() > 8.0
    assert np.abs(off(result)).max() < 5.0
    verdict, prior = result.notes
    assert "URDF's inertials" in prior
    assert "disagree with least squares" in verdict and "J_m[shoulder]" in verdict


@pytest.mark.parametrize("encoder", [0.0, 1e-5])
def test_without_it_they_agree(encoder):
    recording = PLANTED.recording(noise=0.05, encoder=encoder)
    plain, result = identified(recording, "separable"), identified(recording, "idim-iv")
    assert "agree with least squares" in result.notes[0] and "disagree" not in result.notes[0]
    known = plain.base_errors > 0
    assert result.base_values[known] == pytest.approx(plain.base_values[known], abs=float(plain.base_errors.max()))


def test_either_half_knows_nothing_of_the_other():
    recording = small_arm.recording(4.0)
    first, second = halves(recording)
    assert np.array_equal(first.position[::2], recording.position[::2])
    assert np.array_equal(second.position[1::2], recording.position[1::2])
    assert first.position == pytest.approx(recording.position, abs=1e-6)
    spoilt = recording.position.copy()
    spoilt[1::2] = 99.0
    other, _ = halves(Recording(recording.joints, recording.time, spoilt, None, recording.effort, recording.segments))
    assert np.array_equal(other.position, first.position)


def test_all_three_motions_have_the_same_rows():
    recording = PLANTED.recording(noise=0.05, encoder=1e-4)
    for motions in zip(*split_motions([recording], ARM.joint_names, 10.0)):
        assert all(np.array_equal(motion.time, motions[0].time) for motion in motions)
        assert all(np.array_equal(motion.torque_rows, motions[0].torque_rows) for motion in motions)


def test_a_stretch_too_short_to_split_is_refused():
    whole = small_arm.recording(4.0)
    short = Recording(whole.joints, whole.time[:5], whole.position[:5], None, whole.effort[:5], (slice(0, 5),))
    with pytest.raises(UnfitDataError, match="cannot be split"):
        halves(short)


def test_the_verdict_names_the_worst():
    base = base_parameters(TorqueModel(ARM, STRUCTURE))
    errors = np.ones(len(base.names))
    same = np.zeros(base.regrouping.shape[1])
    moved = same.copy()
    moved[base.independent[2]] = 3.0
    assert " agree with" in compare("instrumental variables", base, same, errors)
    words = compare("instrumental variables", base, moved, errors)
    assert " disagree with" in words and f"most at {base.names[2]} (" in words
    assert "at 1 base parameters" in words and "3 standard errors" in words
    # One that is held fixed has no standard error, and is no disagreement.
    errors[2] = 0.0
    assert " agree with" in compare("instrumental variables", base, moved, errors)
