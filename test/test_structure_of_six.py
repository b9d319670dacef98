"""Terms missing at all joints at once are found, though each spoils what could be seen at the others."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.estimate.optional_terms import OptionalTerm
from spacearm_ident.identification.identify import identify

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
import peers


@pytest.mark.parametrize("seed", [2, 21])
def test_quadratic_and_cubic_friction_missing_at_every_joint_is_found(seed):
    """From the plain law one joint at a time, the search stops at two to four of the six."""
    arm = load_arm(config_path("paper_arm.yaml"))
    recording = peers.record(arm, peers.series(seed, peers.SAMPLES), peers.STRIBECK, peers.QUIET, seed + 5)
    found = {choice.term for choice in identify([recording], arm).choices if choice.accepted}
    curved = [joint for joint in arm.joint_names if any("cubic" in term and term.endswith(joint) for term in found)]
    assert len(curved) == 6


def test_stribeck_friction_at_every_joint_is_found_at_half_of_them_through_the_noise():
    """Its peaks act below 0.03 to 0.08 rad/s, in few blocks of time.

    With half as many blocks, and one level shared out among all terms of a joint, a fifth of them were found.
    """
    arm, found = load_arm(config_path("paper_arm.yaml")), 0
    for seed in (4, 8, 10):
        recording = peers.record(arm, peers.series(seed, peers.SAMPLES), peers.STRIBECK, peers.TORQUE_NOISE, seed + 5)
        choices = identify([recording], arm).choices
        found += sum(choice.accepted and choice.kind is OptionalTerm.STRIBECK for choice in choices)
    assert found >= 9
