"""Concealed faults of drives and sensors, whole runs with them, and the file that names them."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from contract import CONTRACT
from pendulums import SIX, chain, effect, plant_with, truth_of
from simulated_arm import CONFIG, paper_arm, paper_drives

from spacearm_ident.cli.main import main
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import Motion, Quintic, Rest, Trajectory
from spacearm_ident.recording import read_recording
from spacearm_ident.simulation.closed_loop import simulate_truth
from spacearm_ident.simulation.concealed import EFFECTS, Concealment, concealed_from_dict, load_concealed, make_effect

# --- drives, sensors, time ---------------------------------------------------------------------------


def test_drives_give_what_their_fault_makes_of_what_they_report():
    arm = chain("yy")
    plant = plant_with(arm)

    def given(asked, name, law=None, **values):
        return effect(arm, name, ["j0"], law, **values).motor(np.array([asked, asked]), plant).tolist()

    assert given(8.0, "torque_constant", scale=0.9) == pytest.approx([7.2, 8])
    assert given(8.0, "torque_constant", "warming", scale=0.9) == pytest.approx([7.2, 8])
    assert given(8.0, "current_offset", offset=-1.5) == pytest.approx([9.5, 8])
    assert given(8.0, "motor_saturation", torque=10.0) == pytest.approx([10 * np.tanh(0.8), 8])
    assert given(-8.0, "motor_saturation", "knee", torque=10.0) == pytest.approx([-8 + 0.4 * 3, -8])
    plant.thermal.winding[:] = 60.0
    assert given(8.0, "torque_constant", "warming", scale=1, slope=-2e-3) == pytest.approx([8 * 0.92, 8])


def test_a_late_torque_is_the_same_sine_later():
    time = np.arange(2000) * 1e-3
    truth = truth_of(np.sin(2 * np.pi * time)[:, None])
    for law, side in (("usual", 1), ("early", -1)):
        late = make_effect(("j0",), "time_delay", (), {"delay": 0.0045}, law).reported(truth).torque[:, 0]
        np.testing.assert_allclose(late[50:-50], np.sin(2 * np.pi * (time - side * 0.0045))[50:-50], atol=2e-5)


def test_a_smoothed_ramp_lags_by_the_time_constant_and_other_joints_do_not():
    ramp = np.outer(np.arange(3000) * 1e-3, [1.0, 1.0])
    slow = make_effect(("j0", "j1"), "filter_lag", ["j1"], {"corner": 5.0}).reported(truth_of(ramp)).torque
    np.testing.assert_array_equal(slow[:, 0], ramp[:, 0])
    assert ramp[-1, 1] - slow[-1, 1] == pytest.approx(1 / (2 * np.pi * 5.0), rel=0.02)


def test_an_eccentric_encoder_shows_a_wrong_angle_and_its_speed():
    wrong = make_effect(("j0",), "encoder_eccentricity", (), {"amplitude": 0.01, "cycles": 3, "phase": 0.2})
    t = np.linspace(0, 2, 400)[:, None]
    truth = replace(truth_of(np.zeros((400, 1))), q=np.sin(t), qd=np.cos(t))
    seen = Concealment([wrong]).reported(truth)
    np.testing.assert_allclose(seen.q, np.sin(t) + 0.01 * np.sin(3 * np.sin(t) + 0.2), atol=1e-12)
    np.testing.assert_allclose(seen.qd, np.cos(t) * (1 + 0.03 * np.cos(3 * np.sin(t) + 0.2)), atol=1e-7)


@pytest.fixture(scope="module")
def short_run():
    """Half a radian and back: 2.4 s of the paper's arm."""
    home, there = np.zeros(6), np.full(6, 0.3)
    still = np.zeros(6)
    out = Quintic(Motion(home, still, still), Motion(there, still, still), 1.0)
    back = Quintic(Motion(there, still, still), Motion(home, still, still), 1.0)
    return Trajectory(paper_arm().joints, (Rest(home, 0.2), out, back, Rest(home, 0.2)))


def test_nothing_concealed_is_the_arm_itself(short_run):
    plain = simulate_truth(paper_arm(), short_run, drives=paper_drives())
    same = simulate_truth(paper_arm(), short_run, drives=paper_drives(), hidden=Concealment([]))
    for name in ("q", "qd", "torque", "temperature"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(same, name))


@pytest.mark.parametrize(("name", "more"), [("torque_ripple", {"cycles": 30}), ("pump_disturbance", {})])
def test_a_concealed_torque_shows_at_its_joint_as_large_as_it_is_and_the_run_repeats(short_run, name, more):
    plain = simulate_truth(paper_arm(), short_run, drives=paper_drives())
    first, again = (
        simulate_truth(
            paper_arm(),
            short_run,
            drives=paper_drives(),
            hidden=Concealment([make_effect(SIX, name, ["joint_3"], {"amplitude": 2.0} | more)]),
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.torque, again.torque)
    moving = np.abs(plain.qd[:, 2]) > 0.05
    change = np.sqrt(np.mean((first.torque - plain.torque)[moving] ** 2, axis=0))
    assert change[2] == pytest.approx(2.0 / np.sqrt(2), rel=0.25)
    assert np.all(np.delete(change, 2) < 0.3 * change[2])


def test_an_arm_that_cannot_carry_what_is_concealed_stops_in_one_line(short_run):
    strong = Concealment([make_effect(SIX, "rotor_coupling", ["joint_4"], {"inertia": 1.0})])
    with pytest.raises(UserError, match=r"runs away within 0\.") as caught:
        simulate_truth(paper_arm(), short_run, drives=paper_drives(), hidden=strong)
    assert "\n" not in str(caught.value)


def test_in_vacuum_the_higher_powers_of_speed_go():
    thin = make_effect(SIX, "vacuum_friction", (), {"fraction": 0.75}).alter(paper_arm())
    np.testing.assert_allclose(thin.k_v3, 0.25 * paper_arm().k_v3)
    np.testing.assert_allclose(thin.k_v2, 0.25 * paper_arm().k_v2)
    np.testing.assert_array_equal(thin.k_v1, paper_arm().k_v1)


# --- files and names ---------------------------------------------------------------------------------


def test_every_name_of_the_contract_can_be_concealed_and_some_beyond():
    known = {name for name, kind in EFFECTS.items() if kind.known}
    assert known == set(CONTRACT)
    assert len(EFFECTS) - len(known) >= 5


def document(**entry):
    return {"schema": "spacearm_ident/conceal/1", "effects": [entry]}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (document(effect="riple"), "no effect 'riple'; the effects are .*torque_ripple"),
        (document(effect="payload", joints=["hip"]), "no joint 'hip'"),
        (document(effect="payload", parameters={"mass": 1}), r"takes 1 joint\(s\), not 0"),
        (
            document(effect="payload", joints=["joint_6"], parameters={"weight": 1}),
            "no parameter 'weight'; it takes mass",
        ),
        (document(effect="payload", joints=["joint_6"]), "give mass in kg"),
        (document(effect="payload", joints=["joint_6"], parameters={"mass": "big"}), "mass must be a number"),
        (document(effect="stribeck", parameters={"amplitude": 1}, law="square"), "no law 'square'"),
        (document(name="stribeck"), "an effect has the keys"),
        ({"schema": "other/1", "effects": []}, "schema is 'other/1'"),
        ([], "must be a mapping"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(content, complaint):
    with pytest.raises(UserError, match=complaint) as caught:
        concealed_from_dict(content, SIX)
    assert "\n" not in str(caught.value)


def test_what_the_arm_cannot_carry_is_refused():
    light = replace(paper_arm(), rotor_inertia=np.full(6, 1e-6))
    with pytest.raises(UserError, match="rotor inertia"):
        plant_with(light, make_effect(SIX, "joint_elasticity", ["joint_2"], {"stiffness": 1e4}))
    with pytest.raises(UserError, match="no link follows"):
        plant_with(paper_arm(), make_effect(SIX, "link_flexibility", ["joint_6"], {"stiffness": 1e4}))
    two = [make_effect(SIX, "joint_elasticity", ["joint_2"], {"stiffness": 1e4}) for _ in range(2)]
    with pytest.raises(UserError, match="not two"):
        plant_with(paper_arm(), *two)


def test_a_file_gives_its_effects_and_a_damaged_one_is_refused(tmp_path):
    path = tmp_path / "hide.yaml"
    path.write_text(yaml.safe_dump(document(effect="stribeck", joints=["joint_2"], parameters={"amplitude": [1.5]})))
    (found,) = load_concealed(path, SIX)
    assert found.name == "stribeck" and found.joints.tolist() == [1] and found.one("amplitude") == 1.5
    path.write_text("effects: [")
    with pytest.raises(UserError, match=r"hide\.yaml is not valid YAML"):
        load_concealed(path, SIX)


def test_the_command_conceals(tmp_path, capsys):
    trajectory, hide, bags = tmp_path / "t.yaml", tmp_path / "hide.yaml", []
    rests = [{"kind": "rest", "duration_s": 0.1, "position": [angle] * 6} for angle in (0.0, 0.1)]
    segments = [rests[0], {"kind": "quintic", "duration_s": 0.5}, rests[1]]
    segments = {"schema": "spacearm_ident/trajectory/1", "joints": list(SIX), "segments": segments}
    trajectory.write_text(yaml.safe_dump(segments))
    hide.write_text(yaml.safe_dump(document(effect="current_offset", joints=["joint_1"], parameters={"offset": 3.0})))
    common = ["--model", str(CONFIG / "paper_arm_model.yaml"), "--arm", str(CONFIG / "paper_arm.yaml"), "--noise", "0"]
    for name, more in (("plain", []), ("hidden", ["--conceal", str(hide)])):
        bags.append(tmp_path / f"{name}.mcap")
        out = ["--trajectory", str(trajectory), "--out", str(bags[-1]), *more]
        assert main(["simulate", *common, *out]) == 0
    plain, hidden = (read_recording(bag).effort[200:500] for bag in bags)
    change = np.mean(hidden - plain, axis=0)
    assert change[0] == pytest.approx(3.0, abs=0.3)
    assert np.abs(change[1:]).max() < 0.1
    hide.write_text(yaml.safe_dump(document(effect="gremlins")))
    assert (
        main(["simulate", *common, "--trajectory", str(trajectory), "--conceal", str(hide), "--out", str(bags[0])]) == 2
    )
    assert "no effect 'gremlins'" in capsys.readouterr().err
