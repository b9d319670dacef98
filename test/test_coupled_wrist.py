"""A wrist whose last motor turns with two joints: in the model where held-out data show it, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from spacearm_ident.dynamics.arm import Coupling, load_arm
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.identify import identify
from spacearm_ident.identification.validation import split, validate
from spacearm_ident.recording import read_recording
from spacearm_ident.sessions.bags import Options

REAL = Path(__file__).parent.parent.parent / "shared" / "recordings" / "real"
TX40 = REAL / "tx40" / "excitation.mcap"


def identified(bag: Path, friction: str = "auto", ratio: float = 0.0, couple: bool = True) -> tuple[Identified, float]:
    """A real arm identified from the first two thirds, and what is left of its last joint in the third.

    Args:
        bag: Recording, beside the URDF of its arm.
        friction: As `Options`.
        ratio: Of the last joint in a coupling that the arm has before; 0: it has none.
        couple: As `Settings`.
    """
    if not bag.exists():
        pytest.skip(f"no recording {bag}")
    arm = load_arm(bag.parent / "arm.urdf")
    if ratio:
        ratios = {arm.joint_names[-2]: 1.0, arm.joint_names[-1]: ratio}
        arm = replace(arm, couplings=(Coupling("motor", ratios),))
    fit, held_out = split(read_recording(bag))
    found = identify([fit], arm, replace(Options(friction=friction).settings(arm), couple=couple))
    figures = validate(found.model, [held_out], "held out", held_out=True).joints[arm.joint_names[-1]]
    return found, figures.moving.relative_rms


def test_coupled_motor_of_a_real_wrist_is_in_the_model_with_its_sign_when_held_out_data_show_it():
    found, left = identified(TX40)
    without, left_without = identified(TX40, couple=False)
    assert found.coupling is not None and found.coupling.adopted
    assert dict(found.model.model.arm.couplings[0].ratios) == {"joint_5": 1.0, "joint_6": 1.0}
    assert "{joint_5: 1.0, joint_6: 1.0}" in found.coupling.line and found.coupling.line in " ".join(found.notes)
    assert without.coupling is None and not without.model.model.arm.couplings
    assert left < 0.6 * left_without


def test_coupled_motor_is_named_and_not_added_when_a_friction_law_was_asked_for():
    found, _ = identified(TX40, friction="coulomb-viscous")
    assert found.coupling is not None and found.coupling.helps and not found.coupling.adopted
    assert not found.model.model.arm.couplings
    assert "add to the arm YAML" in found.coupling.words


def test_coupling_is_not_tried_when_the_arm_has_one():
    assert identified(TX40, friction="coulomb-viscous", ratio=1.0)[0].coupling is None


def test_coupling_is_no_remedy_when_a_wrist_without_one_fits_badly():
    found, _ = identified(REAL / "airbot" / "run_3.mcap", friction="coulomb-viscous")
    assert found.coupling is None or not found.coupling.helps
