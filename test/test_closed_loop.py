"""The recorded simulated arm: torque that belongs to its motion, honest sensors, tracking."""

import numpy as np
import pinocchio as pin
import pytest
from simulated_arm import paper_arm, paper_drives, paper_limits

from spacearm_ident.excitation.trajectory import Rest, Trajectory, random_feasible
from spacearm_ident.simulation.closed_loop import SensorNoise, measure, simulate_truth
from spacearm_ident.simulation.plant import rigid_body_model
from spacearm_ident.simulation.servo import DriveData, ServoTuning

H = 1e-3


@pytest.fixture(scope="module")
def run():
    limits = paper_limits()
    series = random_feasible(paper_arm().joints, limits, seed=3, fundamental_hz=0.2, periods=2)
    return series.run(limits, rest_s=0.5)


@pytest.fixture(scope="module")
def truth(run):
    return simulate_truth(paper_arm(), run, drives=paper_drives())


@pytest.fixture(scope="module")
def still():
    posture = np.array([0.0, 0.4, 0.3, 0.0, 0.2, 0.0])
    return Trajectory(paper_arm().joints, (Rest(posture, 0.3),))


def root_mean_square(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def differentiated(truth):
    """Motion from positions alone, by central differences: inner samples of q, qd, qdd, torque."""
    q = truth.q
    qd, qdd = (q[2:] - q[:-2]) / (2 * H), (q[2:] - 2 * q[1:-1] + q[:-2]) / H**2
    return q[1:-1], qd, qdd, truth.torque[1:-1]


def stribeck_torque(v):
    """Friction of paper_arm while moving, written again from eq. 2."""
    p = paper_arm()
    dry = (p.f_c + (p.f_b - p.f_c) * np.exp(-((v / p.v_b) ** 2))) * np.sign(v)
    return dry + p.k_v1 * v + p.k_v2 * v**2 + p.k_v3 * v**3


def rigid_torque(q, qd, qdd):
    """Inverse dynamics with rotors, and the joint springs."""
    model = rigid_body_model(paper_arm())
    data = model.createData()
    rows = [pin.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)]
    return np.array(rows) + paper_arm().joint_spring * q


def test_recorded_torque_is_the_torque_of_the_recorded_motion(truth):
    """No delay, no bias: two parts in a thousand sample by sample, nothing on average."""
    q, qd, qdd, torque = differentiated(truth)
    error = torque - rigid_torque(q, qd, qdd) - stribeck_torque(qd)
    scale = root_mean_square(torque)
    for joint in range(6):
        moving = np.abs(qd[:, joint]) > 0.02
        assert moving.mean() > 0.7
        assert root_mean_square(error[moving, joint]) < 2e-3 * scale[joint]
        assert abs(error[moving, joint].mean()) < 1e-5 * scale[joint]
    exact = truth.torque - rigid_torque(truth.q, truth.qd, truth.qdd) - stribeck_torque(truth.qd)
    assert np.all(root_mean_square(np.where(np.abs(truth.qd) > 0.02, exact, 0.0)) < 2e-5 * scale)


def test_a_torque_half_a_sample_late_would_have_been_seen(truth):
    """The identity above can fail: the same torque, half a millisecond later, breaks its mean-free bound."""
    q, qd, qdd, torque = differentiated(truth)
    late = 0.5 * (torque[1:] + torque[:-1])
    error = late - rigid_torque(q, qd, qdd)[1:] - stribeck_torque(qd)[1:]
    moving = np.abs(qd[1:, 1]) > 0.02
    slope = np.polyfit(qdd[1:, 1][moving], error[moving, 1], 1)[0]
    assert abs(slope) > 3e-3


def test_friction_and_rotor_inertia_come_back_from_the_noise_free_run_without_bias(truth):
    p = paper_arm()
    q, qd, qdd, torque = differentiated(truth)
    rest = torque - rigid_torque(q, qd, np.zeros_like(qdd))
    moved = rigid_torque(q, np.zeros_like(qd), qdd) - rigid_torque(q, np.zeros_like(qd), np.zeros_like(qdd))
    rest -= moved - p.rotor_inertia * qdd
    for joint in range(6):
        moving = np.abs(qd[:, joint]) > 0.03
        v, a = qd[moving, joint], qdd[moving, joint]
        columns = np.column_stack([a, np.sign(v), v, v**2, v**3])
        found = np.linalg.lstsq(columns, rest[moving, joint], rcond=None)[0]
        want = [p.rotor_inertia[joint], p.f_c[joint], p.k_v1[joint], p.k_v2[joint], p.k_v3[joint]]
        np.testing.assert_allclose(found, want, rtol=1e-3, atol=2e-3)


def test_the_arm_follows_and_uses_its_range(truth):
    assert np.abs(truth.q - truth.command).max() < 8e-3
    assert np.all(np.abs(truth.qd).max(axis=0) > 0.4)
    assert np.all(np.abs(truth.torque) < paper_drives().torque_limit)
    assert not truth.qd[:200].any() and not truth.qd[-200:].any()
    assert np.all(truth.temperature[-1] > truth.temperature[0])


def test_the_recording_is_what_the_sensors_make_of_the_truth(truth, run):
    recording = measure(truth, SensorNoise(), seed=1)
    assert recording.joints == paper_arm().joints
    assert recording.time[-1] == pytest.approx(run.duration_s, abs=2e-3)
    np.testing.assert_allclose(np.diff(recording.time), H, atol=1e-9)
    count = 2 * np.pi / 2**19
    np.testing.assert_allclose(recording.position / count, np.rint(recording.position / count), atol=1e-6)
    assert np.abs(recording.position - truth.q).max() <= count / 2 * (1 + 1e-9)
    assert root_mean_square(recording.velocity - truth.qd) == pytest.approx(np.full(6, 5e-4), rel=0.1)
    np.testing.assert_allclose(recording.command.values, run.evaluate(recording.time).q, atol=1e-12)
    assert set(recording.temperatures) == set(recording.joints)
    assert recording.urdf == paper_arm().urdf
    noise = root_mean_square(recording.effort - truth.torque) / root_mean_square(truth.torque)
    assert np.all((noise > 0.008) & (noise < 0.022))


def test_torque_noise_is_white_with_a_little_colour_and_as_large_as_asked(truth):
    asked = SensorNoise(effort_white=0.004, effort_coloured=0.003, effort_correlation_s=0.02)
    noise = (measure(truth, asked, seed=2).effort - truth.torque) / paper_drives().torque_limit
    np.testing.assert_allclose(noise.std(axis=0), 0.005, rtol=0.1)
    lag = np.mean(noise[:-1] * noise[1:], axis=0)
    np.testing.assert_allclose(lag, 0.003**2 * np.exp(-H / 0.02), rtol=0.25)


def test_perfect_sensors_show_the_truth(truth):
    recording = measure(truth, SensorNoise.none())
    np.testing.assert_array_equal(recording.effort, truth.torque)
    np.testing.assert_array_equal(recording.position, truth.q)
    np.testing.assert_array_equal(recording.velocity, truth.qd)


def test_the_same_seed_gives_the_same_recording_and_another_only_other_noise(still):
    truth = simulate_truth(paper_arm(), still)
    one, same, other = (measure(truth, SensorNoise(), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.effort, same.effort)
    assert np.abs(one.effort - other.effort).max() > 0.1
    np.testing.assert_array_equal(one.position, other.position)


def test_at_rest_the_drives_carry_gravity_within_the_grip_of_friction(still):
    truth = simulate_truth(paper_arm(), still)
    assert not truth.qd.any()
    np.testing.assert_array_equal(truth.q, np.tile(truth.q[0], (len(truth.q), 1)))
    gravity = rigid_torque(truth.q[:1], truth.qd[:1], truth.qd[:1])[0]
    assert np.all(np.abs(truth.torque - gravity) <= paper_arm().f_b + 1e-9)
    assert np.abs(gravity).max() > 20.0


def test_a_weak_drive_saturates_at_its_limit(run):
    short = Trajectory(run.joints, run.segments[:2])
    weak = DriveData.plain(6, torque_limit=[20.5, 180.0, 100.0, 45.0, 40.0, 30.0])
    truth = simulate_truth(paper_arm(), short, drives=weak)
    assert np.abs(truth.torque[:, 0]).max() == pytest.approx(20.5)
    assert np.abs(truth.q - truth.command)[:, 0].max() > 0.02


def test_progress_rises_to_one(still):
    seen = []
    simulate_truth(paper_arm(), still, progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0 and len(seen) > 2


def test_arguments_that_do_not_fit_are_refused(still):
    with pytest.raises(ValueError, match="even multiple"):
        simulate_truth(paper_arm(), still, rate_hz=1000.0, tuning=ServoTuning(rate_hz=3000.0))
    with pytest.raises(ValueError, match="trajectory moves"):
        simulate_truth(paper_arm(), Trajectory(("a",), (Rest(np.zeros(1), 1.0),)))
