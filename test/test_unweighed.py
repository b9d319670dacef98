"""What no payload explains, and a base that moves: weighed with its motion, refused with the cause without."""

from __future__ import annotations

import json
from dataclasses import replace

import floating_arm
import numpy as np
import pytest
from floating_arm import fly, recorded
from test_payload import MASS, MODEL, run

from spacearm_ident.cli.main import main
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, OwnRecordings, TorqueModel, structure_of
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.export.payload import about_joint, find_payload
from spacearm_ident.recording import write_recording

NO_GRAVITY = np.zeros(3)
IN_ORBIT = MODEL.with_gravity(NO_GRAVITY)
FLYING = arm_from_urdf(floating_arm.URDF)
HELD_KG, HELD_CENTRE = 1.2, np.array([0.03, -0.02, 0.25])
HELD = about_joint(np.array([HELD_KG, *(HELD_KG * HELD_CENTRE), 0.01, 0.0, 0.012, 0.0, 0.0, 0.008]))


def holding(model: IdentifiedModel, body: np.ndarray) -> IdentifiedModel:
    """The model with inertial parameters (10,) added to its last link."""
    last = model.model.first_inertial + 10 * (len(model.model.arm.joints) - 1)
    parameters = model.parameters.copy()
    parameters[last : last + 10] += body
    return replace(model, parameters=parameters)


def flying(body: np.ndarray = HELD) -> IdentifiedModel:
    """The arm of `floating_arm` without a part of its last link, which is the payload of every flight then.

    Its gravity is the Earth's, which an IMU in free fall needs not.
    """
    torque = TorqueModel(FLYING, structure_of(FLYING, "coulomb-viscous"))
    values = np.array([floating_arm.truth().get(parameter.name, 0.0) for parameter in torque.parameters])
    return holding(IdentifiedModel(torque, values, np.zeros(len(torque.constants)), 5.0), -body)


@pytest.mark.parametrize("mounted", [False, True])
def test_payload_on_a_free_base_is_found_within_its_errors_by_the_base_s_motion(mounted):
    model = flying()
    recording = recorded(fly(), seed=1, mounted=mounted)
    model = replace(model, model=TorqueModel(arm_from_urdf(recording.urdf), model.model.structure))
    held = find_payload(model, [recording])
    assert abs(held.mass - HELD_KG) < 4.0 * held.mass_error and held.mass_error < 0.02
    assert np.all(np.abs(held.centre - HELD_CENTRE) < 4.0 * held.centre_error + 1e-4)
    assert any("moving base" in note for note in held.notes)


def test_payload_on_a_free_base_whose_motion_is_not_recorded_is_no_absent_payload():
    unseen = replace(recorded(fly(), seed=1), base=None)
    with pytest.raises(UserError, match=r"which no body has.*without /base_imu") as refused:
        find_payload(flying().with_gravity(NO_GRAVITY), [unseen])
    assert not isinstance(refused.value, UnfitDataError), "exit code 1 says that nothing is held"


@pytest.mark.parametrize(("own_Nm", "excluded"), [(0.05, False), (50.0, True)])
def test_torque_that_no_body_explains_leaves_open_whether_one_is_held(own_Nm, excluded):
    """Where the model leaves far more than of its own recordings; a joint that it predicts badly there says nothing."""
    recording = run(0.0)
    effort = recording.effort.copy()
    effort[:, 0] += 0.8 * effort[:, 0].std() * np.sin(11.0 * recording.time)
    ones = np.ones((2, len(effort[0])))
    own = OwnRecordings(2, ones[0], ones, own_Nm * ones, own_Nm * ones, np.array([MODEL.parameters] * 2))
    with pytest.raises(UnfitDataError, match="no payload detected") as refused:
        find_payload(replace(MODEL, own=own), [replace(recording, effort=effort)])
    assert ("none excluded" in str(refused.value) and "of the torque of joint_1" in str(refused.value)) != excluded


def test_weightless_payload_without_base_motion_says_that_the_base_is_taken_as_fixed():
    held = find_payload(IN_ORBIT, [run(MASS, model=IN_ORBIT)])
    assert held.mass == pytest.approx(MASS, abs=4.0 * held.mass_error)
    assert any("taken as fixed" in note and "/base_imu" in note for note in held.notes)
    assert not find_payload(MODEL, [run(MASS)]).notes


@pytest.mark.parametrize("mass", [0.0, MASS, 60.0])
def test_recording_without_gravity_is_refused_by_a_model_of_the_ground_with_the_option(mass):
    with pytest.raises(UserError, match=r"contains no gravity.*--gravity 0 0 0$"):
        find_payload(MODEL, [run(mass, model=IN_ORBIT)])


def test_recording_on_the_ground_is_refused_by_a_weightless_model():
    with pytest.raises(UserError, match=r"--gravity 0 0 -9.81"):
        find_payload(IN_ORBIT, [run(MASS)])


def test_command_weighs_in_the_gravity_it_is_given(tmp_path, capsys):
    write_recording(tmp_path / "held.mcap", run(MASS, model=IN_ORBIT))
    words = ["payload", str(tmp_path / "held.mcap"), "--model", str(config_path("paper_arm_model.yaml")), "--quiet"]
    assert main(words) == 2
    assert "--gravity 0 0 0" in capsys.readouterr().err
    assert main([*words, "--gravity", "0", "0", "0", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["mass"]["value"] == pytest.approx(MASS, rel=0.05) and "taken as fixed" in told["notes"][0]


def test_mass_far_below_zero_is_a_wrong_model_and_no_absent_payload():
    """The model was identified with a payload, and the recording has none."""
    body = np.array([2.0, 0.0, 0.0, 0.2, 0.03, 0.0, 0.03, 0.0, 0.0, 0.01])
    with pytest.raises(UserError, match=r"which no body has.*have a payload in it") as refused:
        find_payload(holding(MODEL, body), [run(0.0)])
    assert not isinstance(refused.value, UnfitDataError), "exit code 1 says that nothing is held"


def test_advice_where_nothing_is_held_is_of_a_motion_that_shows_a_mass_there():
    with pytest.raises(UnfitDataError, match=r"no payload detected.*against gravity"):
        find_payload(MODEL, [run(0.0)])
    with pytest.raises(UnfitDataError, match=r"no payload detected.*angular accelerations"):
        find_payload(IN_ORBIT, [run(0.0, model=IN_ORBIT)])
    with pytest.raises(UnfitDataError, match=r"no payload detected.*angular accelerations"):
        find_payload(flying(np.zeros(10)), [recorded(fly(), seed=1)])
