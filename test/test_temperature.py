"""alpha from constant-velocity runs over a temperature sweep, planted and computed with Pinocchio."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, plant, urdf_of

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.environment.plateaus import find_plateaus
from spacearm_ident.environment.temperature import calibrate_temperature, with_temperature
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.recording import write_recording
from spacearm_ident.recording.recording import Recording, Series

JOINTS = ("shoulder", "elbow")
RATE, SPEEDS = 100.0, (0.15, 0.5)
F_C, K_V1, ALPHA = (6.0, 3.0), (4.0, 2.0), (-0.06, -0.02)
NOISE = 0.1
SWEEP = (-20.0, 0.0, 20.0, 40.0)


def ramps() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each joint forth and back over 1 rad at every speed, the other still; 0.2 s of constant acceleration between."""
    pieces = []
    for joint in range(2):
        for speed in SPEEDS:
            for sign in (1.0, -1.0):
                ramp = np.full(20, sign * speed / 0.2)
                column = np.concatenate([np.zeros(20), ramp, np.zeros(int(RATE / speed)), -ramp, np.zeros(20)])
                piece = np.zeros((len(column), 2))
                piece[:, joint] = column
                pieces.append(piece)
    qdd = np.concatenate(pieces)
    qd = np.cumsum(qdd, axis=0) / RATE
    qd[np.abs(qd) < 1e-9] = 0.0
    return np.cumsum(qd, axis=0) / RATE, qd, qdd


def bag(warm: float, seed: int = 0, alpha: tuple[float, float] = ALPHA, noise: float = NOISE) -> Recording:
    """Runs at one temperature; the sensors of temperature are noisy by 0.1 K."""
    laws = tuple(
        Friction(f_c=f + a * (warm - 20.0), k_v1=k, k_v2=0.0, k_v3=0.0, J_m=0.2) for f, k, a in zip(F_C, K_V1, alpha)
    )
    planted = plant(TWO_LINKS, laws, ramps(), RATE)
    rng = np.random.default_rng(1000 * seed + int(warm + 500))
    # Not only white: every run has a torque error of its own, as ripple makes it.
    slow = np.repeat(rng.standard_normal((len(planted.q) // 50 + 1, 2)), 50, axis=0)[: len(planted.q)]
    recording = planted.recording(noise, seed=int(rng.integers(1 << 30)), encoder=1e-6)
    clock = np.arange(0.0, recording.time[-1], 0.5)
    temperatures = {joint: Series(clock, warm + 0.1 * rng.standard_normal(len(clock))) for joint in JOINTS}
    return replace(recording, effort=recording.effort + noise * slow, temperatures=temperatures)


def model(f_c: tuple[float, float] = F_C) -> IdentifiedModel:
    arm = arm_from_urdf(urdf_of(TWO_LINKS))
    torque = TorqueModel(arm, {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]})
    known = {"f_c": f_c, "f_b": f_c, "k_v1": K_V1, "J_m": (0.2, 0.2)}
    values = [known[p.symbol][JOINTS.index(p.joint)] if p.symbol in known else p.prior for p in torque.parameters]
    return IdentifiedModel(torque, np.array(values), np.zeros(len(torque.constants)), 10.0)


def test_plateaus_are_found_and_only_they():
    recording = bag(20.0)
    runs = find_plateaus(recording, "elbow")
    assert [round(run.speed, 2) for run in runs] == [0.15, -0.15, 0.5, -0.5]
    assert all(run.temperature == pytest.approx(20.0, abs=0.2) for run in runs)
    assert all(0.6 < np.ptp(run.position) < 1.01 for run in runs)


@pytest.mark.parametrize("with_model", [False, True])
def test_alpha_lies_within_its_interval(with_model):
    """10 seeds of two joints: 20 intervals of 95 %."""
    inside, scaled = [], []
    for seed in range(10):
        result = calibrate_temperature([bag(t, seed) for t in SWEEP], JOINTS, model() if with_model else None)
        for joint, truth in zip(JOINTS, ALPHA):
            fit = result.joints[joint]
            inside.append(fit.alpha.interval[0] < truth < fit.alpha.interval[1])
            scaled.append((fit.alpha.value - truth) / fit.alpha.standard_error)
            assert fit.alpha.standard_error < 0.02
            assert fit.alpha_v is not None and abs(fit.alpha_v.value) < 5 * fit.alpha_v.standard_error
            assert fit.f_c0 == pytest.approx(F_C[JOINTS.index(joint)], abs=0.35)
    assert np.sum(inside) >= 17
    assert 0.6 < np.sqrt(np.mean(np.square(scaled))) < 1.6


def test_gravity_does_not_reach_alpha_without_noise():
    result = calibrate_temperature([bag(t, noise=0.0) for t in SWEEP], JOINTS)
    for joint, alpha, level, viscous in zip(JOINTS, ALPHA, F_C, K_V1):
        fit = result.joints[joint]
        assert fit.alpha.value == pytest.approx(alpha, abs=1.5e-3)
        assert fit.f_c0 == pytest.approx(level, abs=0.05) and fit.k_v1 == pytest.approx(viscous, abs=0.1)


def test_a_narrow_sweep_is_refused_with_the_span_that_would_do():
    with pytest.raises(UnfitDataError, match=r"19\.\d to 25\.\d °C leave alpha uncertain .* sweep \d+ K for"):
        calibrate_temperature([bag(t) for t in (20.0, 22.5, 25.0)], JOINTS, wanted_share=1e-3)
    with pytest.raises(UnfitDataError, match="too narrow: record at least"):
        calibrate_temperature([bag(t) for t in (20.0, 20.0, 21.0)], JOINTS)


def test_joints_without_temperature_or_runs_are_named():
    bags = [bag(t) for t in SWEEP]
    half = [replace(one, temperatures={"shoulder": one.temperatures["shoulder"]}) for one in bags]
    result = calibrate_temperature(half, JOINTS)
    assert result.no_temperature == ("elbow",) and list(result.joints) == ["shoulder"]
    with pytest.raises(UnfitDataError, match="record /joint_temperatures"):
        calibrate_temperature([replace(one, temperatures={}) for one in bags], JOINTS)
    still = [replace(one, position=np.zeros_like(one.position)) for one in bags]
    with pytest.raises(UnfitDataError, match="no steady run of shoulder, elbow"):
        calibrate_temperature(still, JOINTS)


def test_the_model_gets_the_term_and_predicts_the_sweep():
    """A model identified at -20 °C has too much friction for 20 °C; with the term it is right at both."""
    known = model((6.0 + 2.4, 3.0 + 0.8))
    sweep = [bag(t, 3) for t in SWEEP]
    wider = with_temperature(known, calibrate_temperature(sweep, JOINTS, known))
    assert wider.value("alpha_c", "shoulder") == pytest.approx(-0.06, abs=0.02)
    assert wider.value("f_c", "shoulder") == pytest.approx(6.0, abs=0.35)
    assert wider.value("f_b", "shoulder") == pytest.approx(wider.value("f_c", "shoulder"))


def test_command(tmp_path, capsys):
    paths = []
    for warm in SWEEP:
        paths.append(str(tmp_path / f"at_{warm:g}.mcap"))
        write_recording(paths[-1], bag(warm))
    save_model(model(), tmp_path / "known.yaml")
    words = ["calibrate-temperature", *paths, "--model", str(tmp_path / "known.yaml"), "--out", str(tmp_path / "out")]
    assert main(words) == 0
    printed = capsys.readouterr().out.splitlines()
    result = json.loads((tmp_path / "out" / "temperature.json").read_text())
    of_shoulder = result["joints"]["shoulder"]
    (shoulder,) = [line for line in printed if line.startswith("shoulder")]
    assert f"{of_shoulder['residual_Nm']:.3f}" in shoulder.split() and "misfit N m" in printed[0]
    viscous = of_shoulder["alpha_v"]
    assert ("-" if viscous is None else f"{viscous['value']:.4f}") in shoulder.split() and "alpha_v" in printed[0]
    low, high = result["joints"]["shoulder"]["alpha"]["ci95"]
    assert low < -0.06 < high and result["T_0_degC"] == 20.0
    assert load_model(tmp_path / "out" / "model.yaml").value("alpha_c", "elbow") == pytest.approx(-0.02, abs=0.02)
    assert main(["calibrate-temperature", *paths, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["no_temperature"] == []
    assert main(["calibrate-temperature", *paths[:1], "--json"]) == 1
    assert "no joint can be calibrated" in capsys.readouterr().err
    assert main(["calibrate-temperature", *paths]) == 2
    assert "--out DIR, or --json" in capsys.readouterr().err
