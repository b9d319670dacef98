"""A wrist whose last motor turns with two joints: the tool tries it where the wrist fits badly, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from spacearm_ident.dynamics.arm import Coupling, load_arm
from spacearm_ident.identification.coupling_trial import PLAIN_LAW, CouplingTrial, try_coupling
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.validation import split, validate
from spacearm_ident.recording import read_recording
from spacearm_ident.sessions.identification import settings_for

REAL = Path(__file__).parent.parent.parent / "shared" / "recordings" / "real"


def tried(folder: Path, bag: str, coupled: bool = False) -> CouplingTrial | None:
    """The trial on a real recording, after a plain fit; `coupled`: its arm has the coupling already."""
    if not (folder / bag).exists():
        pytest.skip(f"no recordings at {folder}")
    arm = load_arm(folder / "arm.urdf")
    if coupled:
        ratios = {arm.joint_names[-2]: 1.0, arm.joint_names[-1]: 1.0}
        arm = replace(arm, couplings=(Coupling("motor", ratios),))
    fit, held_out = split(read_recording(folder / bag))
    settings = settings_for(arm, PLAIN_LAW)
    validation = validate(identify([fit], arm, settings).model, [held_out], "held out", held_out=True)
    return try_coupling([fit], [held_out], arm, validation, Settings(settings.cutoff_hz))


def test_coupling_of_a_real_wrist_is_found_with_its_sign_when_the_wrist_fits_badly():
    trial = tried(REAL / "tx40", "excitation.mcap")
    assert trial is not None and trial.helps and trial.sign == 1.0
    assert all(after < 0.5 * before for before, after in zip(trial.before, trial.after))
    assert "{joint_5: 1.0, joint_6: 1.0}" in trial.line and trial.line in trial.words


def test_coupling_is_not_tried_when_the_arm_has_one():
    assert tried(REAL / "tx40", "excitation.mcap", coupled=True) is None


def test_coupling_is_no_remedy_when_a_wrist_without_one_fits_badly():
    trial = tried(REAL / "airbot", "run_1.mcap")
    assert trial is None or not trial.helps
