"""The bench on pairs of real recordings: what it plants, and how it counts answers."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import small_arm

from spacearm_ident.dynamics.arm import arm_from_urdf

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from real_pairs import outcome
from real_pairs_plants import PLANTS, degrees, exchanged, push, resting


@pytest.fixture(scope="module")
def healthy():
    return small_arm.recording(seed=0)


@pytest.mark.parametrize("effect", PLANTS)
def test_planted_torque_has_the_size_asked_for_at_its_joint(healthy, effect):
    arm = arm_from_urdf(healthy.urdf)
    planted = PLANTS[effect](healthy, arm, 1, 3.0)
    torque = planted.effort - healthy.effort
    assert np.sqrt(np.mean(torque[:, 1] ** 2)) == pytest.approx(3.0)
    assert np.any(torque[:, 0] != 0.0) == (effect == "payload")


def test_a_push_lasts_for_the_middle_third(healthy):
    torque = push(healthy, arm_from_urdf(healthy.urdf)).effort - healthy.effort
    acts = np.flatnonzero(np.any(torque != 0.0, axis=1)) / len(torque)
    assert acts.min() == pytest.approx(1 / 3, abs=0.01) and acts.max() == pytest.approx(2 / 3, abs=0.01)


def test_wrong_data_are_wrong_at_the_joint_named_alone(healthy):
    wrong = degrees(healthy, 0)
    np.testing.assert_allclose(wrong.position, healthy.position * [np.degrees(1.0), 1.0])
    assert exchanged(healthy, 0, 1).joints == healthy.joints[::-1]
    still = resting(healthy, 0)
    assert np.ptp(still.position[:, 0]) < 1e-3 < np.ptp(still.position[:, 1])


def line(verdict, *effects, group="pairs", right=("no_mismatch",), wanted=""):
    findings = [{"effect": effect, "joints": ["elbow"]} for effect in effects]
    return {"verdict": verdict, "findings": findings, "group": group, "right": right, "wanted": wanted}


@pytest.mark.parametrize(
    ("said", "counted"),
    [
        (line("no_mismatch"), "quiet"),
        (line("mismatch", "unknown"), "unknown"),
        (line("mismatch", "unknown", "payload"), "wrong name"),
        (line("data_unfit"), "unfit"),
        (line("data_unfit", group="wrong", right=("data_unfit",)), "right"),
        (line("mismatch", "payload", "unknown", group="plants", right=("payload",)), "right"),
        (line("mismatch", "payload", group="plants", right=("payload",), wanted="wrist"), "wrong name"),
        (line("no_mismatch", group="plants", right=("payload",), wanted="wrist"), "quiet"),
        ({**line("error"), "traceback": True}, "traceback"),
    ],
)
def test_answers_are_counted_as_what_they_are(said, counted):
    assert outcome(said) == counted
