"""Little data never crashes an identification: it gives a result, or says in one line why not and what to do."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from planted_arm import THREE_LINKS, Friction, incommensurate, plant

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.recording import Recording, write_recording
from spacearm_ident.sessions.bags import Options
from spacearm_ident.sessions.identification import identify_session

LAWS = [Friction(k_v2=0.0, k_v3=0.0)] * len(THREE_LINKS)


def little(
    seconds: float, rate_hz: float, moving: tuple[int, ...] = (0, 1, 2), silent: tuple[int, ...] = (), seed: int = 0
) -> Recording:
    """A short run of the planted arm: only some joints move, and of some no torque was recorded."""
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    motion = incommensurate(time, len(THREE_LINKS), seed, 1.0)
    for joint in set(range(len(THREE_LINKS))) - set(moving):
        motion[0][:, joint], motion[1][:, joint], motion[2][:, joint] = 0.3, 0.0, 0.0
    run = plant(THREE_LINKS, LAWS, motion, rate_hz).recording(0.05, seed, encoder=1e-5)
    effort = run.effort.copy()
    effort[:, list(silent)] = 0.0
    return replace(run, effort=effort)


def outcome(directory, fitted: Recording, judged: Recording | None) -> str:
    """`ok` with finite figures of every joint that moves, or the reason."""
    arm = arm_from_urdf(fitted.urdf)
    try:
        session = identify_session([fitted], judged and [judged], arm, Options().settings(arm), directory)
    except UnfitDataError as error:
        return str(error)
    figures = json.loads((directory / "validation.json").read_text())
    assert figures["verdict"] in ("good", "fair", "poor", "suspect", "unfit")
    assert np.isfinite(session.identified.model.parameters).all()
    return "ok"


@pytest.mark.long
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    seconds=st.floats(2.0, 10.0),
    rate_hz=st.floats(90.0, 200.0),
    moving=st.sets(st.integers(0, 2)),
    silent=st.sets(st.integers(0, 2)),
    hold_out=st.booleans(),
    seed=st.integers(0, 3),
)
@example(2.0, 90.0, {0, 1, 2}, set(), False, 0)
@example(2.0, 200.0, {1}, set(), False, 0)
@example(10.0, 100.0, {0, 1, 2}, {2}, False, 0)
@example(7.0, 90.0, {1, 2}, {0}, True, 0)
def test_little_data_give_a_result_or_a_reason(tmp_path_factory, seconds, rate_hz, moving, silent, hold_out, seed):
    fitted = little(seconds, rate_hz, tuple(moving), tuple(silent), seed)
    judged = None if hold_out else little(5.0, rate_hz, tuple(moving), tuple(silent), seed + 1)
    said = outcome(tmp_path_factory.mktemp("little"), fitted, judged)
    if not moving or silent == {0, 1, 2} or moving & silent or (hold_out and seconds < 6.0):
        assert said != "ok" and (": record" in said or "--validate" in said)
    else:
        assert said == "ok"


def test_a_joint_that_moves_without_torque_is_named_and_ends_with_exit_code_1(tmp_path, capsys):
    bag = tmp_path / "silent.mcap"
    write_recording(bag, little(8.0, 100.0, silent=(1,)))
    assert main(["identify", str(bag), "--out", str(tmp_path / "out"), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert "shoulder moves, and its torque is zero throughout: record its effort" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_validation_without_motion_is_said_to_be_the_validation(tmp_path):
    run = little(9.0, 100.0)
    still = replace(run, position=np.tile(run.position[:1], (len(run.time), 1)))
    with pytest.raises(UnfitDataError, match=r"validation on other recordings .* no joint moves"):
        identify_session([run], [still], arm_from_urdf(run.urdf), QUICK, tmp_path)


def test_rest_at_the_end_is_not_what_a_recording_is_judged_on(tmp_path):
    """Nine seconds of which three are rest: a third of six is held out; of five and a half it would be too short."""
    run = little(9.0, 100.0)
    for moving, enough in ((620, True), (540, False)):
        still = run.position.copy()
        still[moving:] = still[moving]
        resting = [replace(run, position=still)]
        if enough:
            assert identify_session(resting, None, arm_from_urdf(run.urdf), QUICK, tmp_path).validation.held_out
        else:
            with pytest.raises(UnfitDataError, match=r"5\.\d s of motion are too short .* --validate"):
                identify_session(resting, None, arm_from_urdf(run.urdf), QUICK, tmp_path)


QUICK = Options(friction="coulomb-viscous", cutoff_hz=5.0).settings(arm_from_urdf(little(2.0, 90.0).urdf))
