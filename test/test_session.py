"""One session behind the command and the node: what it validates on, and that it repeats itself."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import small_arm

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.recording import read_recording, write_recording
from spacearm_ident.sessions.bags import Options
from spacearm_ident.sessions.identification import find_arm, identify_session

ARM = arm_from_urdf(small_arm.URDF)
QUICK = Options(friction="coulomb-viscous", cutoff_hz=5.0).settings(ARM)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    for seed in (0, 1):
        write_recording(folder / f"{seed}.mcap", small_arm.recording(seed=seed))
    return [read_recording(folder / f"{seed}.mcap") for seed in (0, 1)]


def test_a_known_identification_is_validated_and_not_made_again(runs, tmp_path):
    whole = identify_session(runs[:1], runs[1:], ARM, QUICK, tmp_path / "whole", command="again")
    first = identify_session(runs[:1], runs[:1], ARM, QUICK, tmp_path / "steps")
    assert not first.validation.held_out
    second = identify_session(
        runs[:1], runs[1:], ARM, QUICK, tmp_path / "steps", command="again", known=first.identified
    )
    assert second.validation.held_out
    assert (tmp_path / "steps" / "model.yaml").read_bytes() == (tmp_path / "whole" / "model.yaml").read_bytes()
    written = [json.loads((tmp_path / name / "validation.json").read_text()) for name in ("whole", "steps")]
    assert written[0] == written[1]
    assert np.array_equal(whole.identified.covariance, second.identified.covariance)


def test_without_other_recordings_the_last_third_is_held_out(runs, tmp_path):
    held_out = identify_session(runs[:1], None, ARM, QUICK, tmp_path)
    cut = 2 / 3 * runs[0].time[-1]
    assert held_out.validation.held_out
    assert held_out.validation.traces[0].time.min() > cut
    assert (
        held_out.identified.rows.max()
        < 0.7 * identify_session(runs[:1], runs[1:], ARM, QUICK, tmp_path).identified.rows.max()
    )


def test_a_copy_of_a_recording_is_said_and_counts_once(runs, tmp_path):
    """Under another name, with other stamps: variances were halved, and terms that fit one predicted the other."""
    later = replace(runs[0], time=runs[0].time + 3600.0)
    alone = identify_session(runs[:1], runs[1:], ARM, QUICK, tmp_path / "alone").identified
    twice = identify_session([runs[0], later], runs[1:], ARM, QUICK, tmp_path / "twice").identified
    assert np.array_equal(alone.covariance, twice.covariance)
    assert [note for note in twice.notes if "is a copy of 0.mcap: it is counted once" in note]
    assert not [note for note in alone.notes if "copy" in note]


def test_a_bag_of_the_fit_does_not_pass_for_validation(runs, tmp_path):
    session = identify_session(runs, runs[1:], ARM, QUICK, tmp_path)
    assert not session.validation.held_out
    assert json.loads((tmp_path / "validation.json").read_text())["held_out"] is False


def test_progress_rises_from_nothing_to_all(runs, tmp_path):
    shares = []
    identify_session(runs[:1], runs[1:], ARM, QUICK, tmp_path, progress=lambda share, what: shares.append(share))
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == 1.0 and len(shares) > 4


def test_unfit_data_write_nothing(runs, tmp_path):
    still = small_arm.recording(still=(0, 1))
    with pytest.raises(UnfitDataError, match="moves"):
        identify_session([still], runs[:1], ARM, QUICK, tmp_path / "result")
    assert not (tmp_path / "result").exists()


def test_the_arm_comes_from_the_file_or_else_from_the_recordings(runs, tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(small_arm.URDF.replace("small_arm", "other_arm"))
    assert find_arm(file, None, runs).name == "other_arm"
    orbit = find_arm(None, (0.0, 0.0, 0.0), runs)
    assert orbit.name == "small_arm" and not orbit.gravity.any()
    with pytest.raises(UserError, match="--arm"):
        find_arm(None, None, [small_arm.recording(urdf=None)])


def test_settings_are_what_was_asked_for(runs, tmp_path):
    assert Options().settings(ARM).structure is None
    settings = Options(friction="vacuum", cutoff_hz=7.0).settings(ARM)
    session = identify_session(runs[:1], runs[1:], ARM, settings, tmp_path)
    model = load_model(tmp_path / "model.yaml")
    assert model.cutoff_hz == session.identified.bandwidth.cutoff_hz == 7.0
    assert model.model.structure["viscous_friction"] == {"vacuum": True}
    with pytest.raises(UserError, match="friction law"):
        Options(friction="sticky").settings(ARM)
