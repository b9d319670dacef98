"""Closed-form checks of the simulator, the laws and the writer.  Run: pytest bench/blind_series."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import laws as laws_
from arms import ARMS, Arm, _chain, cad
from calibrate import calibrate, strength
from fit import Fit, smooth
from score import judge, report
from simulate import PERIOD, Day, fourier, simulate
from write import read_bag, write_bag


def pendulum(limit: float = 1e-12) -> Arm:
    """A point mass of 2 kg at 0.5 m on a horizontal axis; no friction, and no torque beyond `limit`, N m."""
    urdf = _chain(
        "pendulum", [("revolute", "0 1 0", "0 0 0", "0 0 0", 2.0, "0 0 -0.5", (1e-9, 1e-9, 1e-9), limit, 10, -9, 9)]
    )
    one = [1.0]
    return Arm(
        "pendulum",
        urdf,
        [0.0],
        one,
        one,
        one,
        [0.0],
        one,
        [0.0],
        [0.0],
        one,
        one,
        [1e-3],
        [limit],
        [1e-6],
        [0.0],
        1000,
        "none",
        True,
    )


def still(arm: Arm, angle: float, seconds: float):
    """A motion that stays at an angle."""
    steps = int(seconds / PERIOD)
    return np.full((steps, arm.n), angle), np.zeros((steps, arm.n)), np.zeros((steps, arm.n))


def day_of(arm: Arm) -> Day:
    """A day at 20 C without warming: friction is at its nominal level."""
    return Day(20.0, np.zeros(arm.n), 20.0)


def test_free_pendulum_has_the_period_of_the_closed_form():
    arm = pendulum()
    run = simulate(arm, [], [still(arm, 0.1, 6.0)], [day_of(arm)], 1, noise=False)[0]
    q = run.clean["tq"][:, 0]
    falls = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    period = np.mean(np.diff(falls)) * PERIOD
    assert period == pytest.approx(2 * np.pi * np.sqrt(0.5 / 9.81) * (1 + 0.1**2 / 16), rel=2e-3)
    assert np.abs(q[-2000:]).max() == pytest.approx(0.1, rel=0.01)


def test_block_with_coulomb_friction_stops_where_the_closed_form_says():
    arm = pendulum()
    arm.model.gravity.linear = np.zeros(3)
    arm.coulomb, arm.presliding = np.array([0.2]), np.array([1e-6])
    push = laws_.HarnessSpring(arm, 0, np.random.default_rng(0))
    push.torque = lambda s, out: out.__iadd__(0.5 * (s.t < 1.0))
    # 0.5 - 0.2 = 0.3 N m for 1 s on 0.5 kg m^2: 0.6 rad/s; then 0.2 N m brakes within 1.5 s

    run = simulate(arm, [(push, np.ones(1, bool))], [still(arm, 0.0, 4.0)], [day_of(arm)], 1, noise=False)[0]
    assert run.clean["tv"][1000, 0] == pytest.approx(0.6, rel=0.01)
    assert run.clean["tq"][-1, 0] == pytest.approx(0.5 * 0.6 * 1.0 + 0.5 * 0.6 * 1.5, rel=0.01)


@pytest.mark.parametrize("name", ARMS)
def test_inverse_dynamics_of_motion_plus_friction_is_the_reported_torque_without_dirt(name):
    arm = ARMS[name]()
    rng = np.random.default_rng(2)
    run = simulate(arm, [], [fourier(arm, 6.0, rng)], [day_of(arm)], 1, noise=False)[0]
    c, data = run.clean, arm.model.createData()
    tau = np.stack([pin.rnea(arm.model, data, c["tq"][k], c["tv"][k], c["ta"][k]) for k in range(0, 6000, 20)])
    tau += arm.rotor * c["ta"][::20] + c["fric"][::20]
    assert np.abs(tau - c["tau"][::20]).max() < 0.03 * np.abs(c["tau"]).max()  # the drive's log is half a period later
    assert np.abs(tau - c["net"][::20] - c["fric"][::20]).max() < 1e-8 * np.abs(tau).max()


def test_stiff_joint_elasticity_moves_like_the_rigid_arm():
    arm = ARMS["panda"]()
    motion = fourier(arm, 6.0, np.random.default_rng(4))
    law = laws_.JointElasticity(arm, 3, np.random.default_rng(1))
    law.size = 1 / 40_000
    rigid, soft = (
        simulate(arm, x, [motion], [day_of(arm)], 1, noise=False)[0] for x in ([], [(law, np.ones(1, bool))])
    )
    assert np.abs(rigid.effort - soft.effort)[:, 3].std() < 0.05 * rigid.effort[:, 3].std()
    twist = soft.position[:, 3] - soft.clean["tq"][:, 3]  # read at the motor
    assert np.std(twist * 40_000 - soft.clean["net"][:, 3]) < 0.05 * np.std(soft.clean["net"][:, 3])


def test_backlash_twist_stays_near_half_the_gap():
    arm = ARMS["ur10"]()
    law = laws_.Backlash(arm, 3, np.random.default_rng(1))
    law.size = 0.01
    run = simulate(
        arm, [(law, np.ones(1, bool))], [fourier(arm, 8.0, np.random.default_rng(4))], [day_of(arm)], 1, noise=False
    )[0]
    twist = run.position[:, 3] - run.clean["tq"][::8, 3]
    assert 0.005 < np.abs(twist).max() < 0.005 + 1.3 * np.abs(run.clean["net"][:, 3]).max() / law.k


def test_payload_and_tilt_change_the_static_torque_as_statics_says():
    arm = pendulum()
    law = laws_.Payload(arm, None, np.random.default_rng(0))
    law.size, law.centre = 3.0, np.array([0, 0, -0.7])
    model = arm.model.copy()
    law.model(model)
    data = model.createData()
    zero = np.zeros(1)
    assert abs(pin.rnea(model, data, np.array([np.pi / 2]), zero, zero)[0]) == pytest.approx(
        9.81 * (2 * 0.5 + 3 * 0.7), rel=1e-6
    )
    tilt = laws_.BaseTilt(arm, None, np.random.default_rng(0))
    tilt.size, tilt.axis = 0.1, np.array([0, 1.0, 0])
    model = arm.model.copy()
    tilt.model(model)
    assert abs(pin.rnea(model, model.createData(), zero, zero, zero)[0]) == pytest.approx(9.81 * np.sin(0.1), rel=1e-6)


@pytest.mark.parametrize(
    "kind",
    [
        laws_.FrictionDrift,
        laws_.TorqueRipple,
        laws_.MotorSaturation,
        laws_.JointElasticity,
        laws_.EncoderEccentricity,
        laws_.TimeDelay,
    ],
)
def test_calibrated_size_gives_the_wanted_strength(kind):
    arm = ARMS["ur10"]()
    rng = np.random.default_rng(5)
    q, v, a = (x[::4] for x in fourier(arm, 12.0, rng))
    motion = (np.arange(len(q)) * 4e-3, q, v, a, np.full_like(q, 22.0))
    law = kind(arm, 1, rng)
    calibrate(arm, law, motion, 0.02 * arm.limit, 0.5)
    assert law.size == law.largest or strength(arm, law, motion, 0.02 * arm.limit) == pytest.approx(0.5, rel=0.1)


def test_fit_leaves_little_of_a_clean_arm():
    arm = ARMS["panda"]()
    rng = np.random.default_rng(6)
    runs = simulate(arm, [], [fourier(arm, 12.0, rng) for _ in range(2)], [day_of(arm)] * 2, 3)
    fit = Fit(arm.model, [(r.time, r.position, r.effort) for r in runs])
    assert np.all(fit.healthy < 0.08 * np.abs(runs[0].effort).max(0))


def test_smooth_keeps_a_slow_sine_and_its_derivatives():
    t = np.arange(0, 10, 0.008)
    x = np.sin(2 * t)[:, None]
    when, q, _, a, _ = smooth(t, x, x)
    inner = slice(50, -50)
    assert np.allclose(q[inner, 0], np.sin(2 * when[inner]), atol=1e-3)
    assert np.allclose(a[inner, 0], -4 * np.sin(2 * when[inner]), atol=2e-2)


def test_bag_reads_back_to_what_was_written(tmp_path):
    arm = ARMS["rail4"]()
    urdf = cad(arm.urdf, np.random.default_rng(0))
    t = np.arange(50) * 0.004
    x = np.random.default_rng(1).standard_normal((3, 50, 4))
    write_bag(tmp_path / "a.mcap", urdf, arm.joints, t, x[0], None, x[2], x[1])
    back = read_bag(tmp_path / "a.mcap")
    assert back["joints"] == arm.joints and back["urdf"] == urdf and back["velocity"] is None
    assert np.array_equal(back["position"], x[0]) and np.array_equal(back["effort"], x[2])
    assert np.allclose(back["time"], t, atol=1e-6)


@pytest.mark.parametrize("kind", laws_.LISTED + laws_.ABSENT, ids=lambda k: k.name)
def test_every_law_moves_the_logged_torque(kind):
    arm = ARMS["tx40"]()
    rng = np.random.default_rng(7)
    q, v, a = (x[::4] for x in fourier(arm, 10.0, rng))
    law = kind(arm, 2, rng)
    motion = (np.arange(len(q)) * 4e-3, q, v, a, np.full_like(q, 40.0))
    calibrate(arm, law, motion, 0.02 * arm.limit, 1.0)
    assert strength(arm, law, motion, 0.02 * arm.limit) > 0.02


def test_score_counts_names_joints_and_intervals():
    law = {
        "name": "torque_ripple",
        "listed": True,
        "also": [],
        "joints": ["j3"],
        "strength": 2,
        "achieved": 2.0,
        "truth": {"amplitude": [1.0, "N m"]},
    }
    answer = {"trial": 0, "composition": "listed", "arm": "a", "laws": [law]}
    good = {
        "effect": "torque_ripple",
        "joints": ["j3"],
        "confidence": 0.9,
        "parameters": {"amplitude": {"value": 1.05, "unit": "N m", "ci95": [0.9, 1.2]}},
    }
    extra = {"effect": "backlash", "joints": ["j1"], "confidence": 0.6, "parameters": {}}
    lines = [{"trial": 0, "seconds": 1, "verdict": "mismatch", "findings": f} for f in ([good], [good, extra], [])]
    r = report([(answer, x) for x in lines])
    assert r["totals"]["listed right"] == 1 and r["totals"]["findings right"] == 2 and r["totals"]["findings"] == 3
    assert r["by_strength"]["listed x2"]["named at joint"] == 2 and r["coverage"] == {"torque_ripple.amplitude": [2, 2]}
    assert r["brier"] == pytest.approx((0.01 * 2 + 0.36) / 3)


def test_score_takes_unknown_for_an_absent_kind_and_silence_for_a_healthy_arm():
    law = {"name": "bumper", "listed": False, "also": [], "joints": ["j2"], "strength": 5, "achieved": 5.0, "truth": {}}
    unknown = {"effect": "unknown", "joints": ["j2"], "confidence": 0.9, "parameters": {}}
    line = {"trial": 0, "seconds": 1, "verdict": "mismatch", "findings": [unknown]}
    assert judge({"composition": "absent", "laws": [law]}, line)["all"]
    assert not judge({"composition": "healthy", "laws": []}, line)["all"]
    assert judge({"composition": "healthy", "laws": []}, line | {"verdict": "no_mismatch", "findings": []})["all"]
