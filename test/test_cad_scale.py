"""The width of the inertials' prior is what makes the data most likely: narrow where CAD is right, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import THREE_LINKS, Friction, Link, incommensurate, plant
from scipy.stats import multivariate_normal

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.identification.cad_scale import CAD_SCALES, log_evidence
from spacearm_ident.identification.fit import Fit, fit_model
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.validation import validate
from spacearm_ident.recording import Recording
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.separable import system

LAWS = (Friction(k_v2=0.0, k_v3=0.0),) * 3
RATE_HZ = 200.0
NOISE = 0.5


def recorded(true_links: tuple[Link, ...], seed: int = 0, seconds: float = 15.0, speed: float = 1.0) -> Recording:
    """A run of an arm whose URDF is THREE_LINKS."""
    time = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    motion = incommensurate(time, 3, seed, speed)
    return plant(THREE_LINKS, LAWS, motion, RATE_HZ, true_links=true_links).recording(noise=NOISE, seed=seed)


def fitted(recording: Recording) -> Fit:
    arm = arm_from_urdf(recording.urdf)
    motions, _ = prepare([recording], arm.joint_names)
    return fit_model(TorqueModel(arm, structure_of(arm)), motions)


def off(links: tuple[Link, ...], factor: float) -> tuple[Link, ...]:
    """Links so many times as heavy as CAD says."""
    return tuple(
        replace(link, mass=factor * link.mass, inertia=tuple(factor * float(value) for value in link.inertia))
        for link in links
    )


def test_evidence_is_that_of_a_normal_distribution_of_the_torque():
    arm = arm_from_urdf(recorded(THREE_LINKS, seconds=6.0).urdf)
    motions, _ = prepare([recorded(THREE_LINKS, seconds=6.0)], arm.joint_names)
    model = TorqueModel(arm, structure_of(arm))
    regression = Regression(model, motions)
    constants = np.zeros(len(model.constants))
    found, expected = [], []
    for scale in CAD_SCALES:
        prior = make_prior(model, motions, scale)
        matrix, vector = (part[: -len(prior.rows)] for part in system(regression, prior, constants))
        found.append(log_evidence(matrix, vector, prior))
        # Beliefs `rows @ x ~ N(target, 1)`, as a distribution of x and so of the torque.
        spread = np.linalg.inv(prior.rows[:, prior.free])
        known = prior.target - prior.fixed_part(prior.rows)
        columns = matrix[:, prior.free] @ spread
        mean = columns @ known + prior.fixed_part(matrix)
        covariance = columns @ columns.T + np.eye(len(vector))
        expected.append(multivariate_normal.logpdf(vector, mean, covariance))
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6, atol=1e-6)
    assert np.ptp(found) > 1.0


def test_scale_narrows_the_inertials_of_all_links_but_the_last():
    arm = arm_from_urdf(recorded(THREE_LINKS, seconds=6.0).urdf)
    motions, _ = prepare([recorded(THREE_LINKS, seconds=6.0)], arm.joint_names)
    model = TorqueModel(arm, structure_of(arm))
    wide, narrow = make_prior(model, motions), make_prior(model, motions, 0.1)
    ratio = {one.name: b / a for one, a, b in zip(model.parameters, wide.scale, narrow.scale) if a > 0}
    assert ratio["m[waist]"] == ratio["Izz[shoulder]"] == pytest.approx(0.1)
    assert ratio["m[elbow]"] == ratio["J_m[waist]"] == ratio["f_c[shoulder]"] == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_right_cad_is_believed_most_and_wrong_cad_least(seed):
    assert fitted(recorded(THREE_LINKS, seed)).prior.cad_scale == min(CAD_SCALES)
    aside = (THREE_LINKS[0], replace(THREE_LINKS[1], com=(1.0, 0.01, 0.25)), THREE_LINKS[2])
    assert fitted(recorded(aside, seed)).prior.cad_scale == max(CAD_SCALES)


def test_second_fit_of_the_same_motions_keeps_the_scale():
    first = fitted(recorded(THREE_LINKS))
    regression = first.regression
    again = fit_model(regression.model, regression.motions, first)
    assert again.prior.cad_scale == first.prior.cad_scale < 1.0


def test_payload_that_cad_has_not_is_found_where_the_other_links_are_as_in_cad():
    loaded = (*THREE_LINKS[:2], replace(THREE_LINKS[2], mass=6.0, com=(-0.01, 0.02, 0.3)))
    result = identify([recorded(loaded, seconds=30.0, speed=2.0)], arm_from_urdf(recorded(THREE_LINKS).urdf))
    # First moment of the last link about the elbow: 6 kg x 0.3 m, of which CAD has 0.4.
    assert result.model.value("mcz", "elbow") == pytest.approx(1.8, rel=0.05)


def test_short_slow_motion_predicts_fast_motion_better_than_with_the_widest_prior(monkeypatch):
    wide, chosen = [], []
    for seed in range(4):
        slow = recorded(off(THREE_LINKS, 1.1), seed, seconds=8.0, speed=0.4)
        fast = recorded(off(THREE_LINKS, 1.1), seed + 100, speed=2.0)
        for scales, rms in ((CAD_SCALES[:1], wide), (CAD_SCALES, chosen)):
            monkeypatch.setattr("spacearm_ident.identification.cad_scale.CAD_SCALES", scales)
            model = identify([slow], arm_from_urdf(slow.urdf), Settings()).model
            joints = validate(model, [fast], "held out", held_out=True).joints.values()
            rms.append([joint.moving.rmse for joint in joints])
    assert np.mean(np.log(np.array(chosen) / np.array(wide))) < -0.1


def test_result_says_how_far_the_urdf_is_believed():
    result = identify([recorded(THREE_LINKS)], arm_from_urdf(recorded(THREE_LINKS).urdf))
    assert sum("URDF's inertials count as known to 20% of a link" in note for note in result.notes) == 1
