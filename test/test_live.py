"""The live residual against the offline one, on a computed arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_arm
from scipy.special import betainc

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel
from spacearm_ident.recording import Recording
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.signals.stream import derivative_taps
from spacearm_ident.tracking.live_residual import LiveResidual, Residuals

CUTOFF_HZ = 5.0


@pytest.fixture(scope="module")
def model() -> IdentifiedModel:
    """What small_arm's torque really is; one link is 10 % too heavy, so that there is a residual."""
    arm = arm_from_urdf(small_arm.URDF)
    structure = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
    torque = TorqueModel(arm, structure)
    known = {
        "J_m": small_arm.ROTOR,
        "f_c": small_arm.COULOMB,
        "f_b": small_arm.COULOMB,
        "k_v1": small_arm.VISCOUS,
    }
    values = np.array(
        [known[p.symbol][small_arm.JOINTS.index(p.joint)] if p.symbol in known else p.prior for p in torque.parameters]
    )
    values[10:14] *= 1.1
    return IdentifiedModel(torque, values, np.zeros(len(torque.constants)), CUTOFF_HZ)


def stream(live: LiveResidual, run: Recording, piece: int) -> Residuals:
    parts = []
    for start in range(0, len(run.time), piece):
        part = slice(start, start + piece)
        parts += live.add(run.time[part], run.position[part], run.effort[part])
    return Residuals(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("time", "measured", "predicted")))


def offline(model: IdentifiedModel, run: Recording, time: np.ndarray) -> np.ndarray:
    motions, _ = prepare([run], run.joints, model.cutoff_hz)
    assert len(motions) == 1 and not motions[0].cyclic
    motion = replace(motions[0], stride=1, block=1)
    residual = motion.reduce(motion.torque - model.torque(motion))
    return np.stack([np.interp(time, motion.time, column) for column in residual.T], axis=1)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


@pytest.mark.parametrize(("rate_hz", "piece"), [(250.0, 25), (1000.0, 97), (250.0, 1)])
def test_the_live_residual_is_the_offline_one(model, rate_hz, piece):
    run = small_arm.recording(8.0 if piece == 1 else 16.0, rate_hz)
    live = LiveResidual(model, rate_hz)
    rows = stream(live, run, piece)
    inner = (rows.time > 1.0) & (rows.time < run.time[-1] - 1.0)
    expected = offline(model, run, rows.time)[inner]
    assert rms(expected).min() > 0.1  # there is something to agree about
    assert (rms(rows.residual[inner] - expected) < 0.03 * rms(expected)).all()


def test_rows_come_evenly_and_within_the_stated_delay(model):
    run = small_arm.recording(6.0, 1000.0)
    live = LiveResidual(model, 1000.0, 50.0)
    newest, latest = -np.inf, 0.0
    for start in range(0, len(run.time), 10):
        part = slice(start, start + 10)
        for rows in live.add(run.time[part], run.position[part], run.effort[part]):
            assert np.allclose(np.diff(rows.time), 0.02)
            assert newest == -np.inf or np.isclose(rows.time[0] - newest, 0.02)
            newest = rows.time[-1]
        if newest > -np.inf:
            latest = max(latest, run.time[part][-1] - newest)
    assert live.stream.row_rate_hz == pytest.approx(50.0)
    assert latest <= live.stream.delay_s + 0.02 + 0.010  # a row's spacing and the piece handed over
    assert live.stream.delay_s < 2.3 / CUTOFF_HZ


def test_uneven_stamps_cost_nothing(model):
    even = small_arm.recording(12.0, 500.0, noise=0.0)
    rng = np.random.default_rng(3)
    time = even.time + rng.uniform(-0.3, 0.3, len(even.time)) / 500.0
    moved = [np.interp(time, even.time, column) for column in (*even.position.T, *even.effort.T)]
    uneven = replace(even, time=time, position=np.stack(moved[:2], axis=1), effort=np.stack(moved[2:], axis=1))
    rows = stream(LiveResidual(model, 500.0), uneven, 50)
    inner = (rows.time > 1.0) & (rows.time < 11.0)
    expected = offline(model, even, rows.time)[inner]
    assert (rms(rows.residual[inner] - expected) < 0.1 * rms(expected)).all()


def test_a_gap_starts_the_filters_anew_and_spoils_no_row(model):
    run = small_arm.recording(14.0, 500.0)
    keep = (run.time < 6.0) | (run.time > 6.5)
    broken = replace(run, time=run.time[keep], position=run.position[keep], effort=run.effort[keep])
    live = LiveResidual(model, 500.0)
    rows = stream(live, broken, 50)
    assert live.stream.restarts == 1
    assert not ((rows.time > 6.0 - live.stream.delay_s / 2) & (rows.time < 6.5 + live.stream.delay_s / 2)).any()
    inner = ((rows.time > 1.0) & (rows.time < 6.0)) | ((rows.time > 7.5) & (rows.time < 13.0))
    whole = stream(LiveResidual(model, 500.0), run, 50)
    expected = np.stack([np.interp(rows.time[inner], whole.time, column) for column in whole.residual.T], axis=1)
    assert (rms(rows.residual[inner] - expected) < 0.05 * rms(expected)).all()


def test_a_clock_set_back_does_not_silence_it(model):
    run = small_arm.recording(5.0, 500.0)
    live = LiveResidual(model, 500.0)
    stream(live, replace(run, time=run.time + 1000.0), 50)
    rows = stream(live, run, 50)
    assert live.stream.restarts == 1
    assert rows.time.min() > 0.0 and rows.time.max() > 4.0


def test_repeated_and_late_samples_are_left_out(model):
    run = small_arm.recording(5.0, 500.0)
    order = np.sort(np.concatenate([np.arange(len(run.time)), np.arange(0, len(run.time), 7)]))
    order[100], order[101] = order[101], order[100]
    doubled = replace(run, time=run.time[order], position=run.position[order], effort=run.effort[order])
    once, twice = stream(LiveResidual(model, 500.0), run, 50), stream(LiveResidual(model, 500.0), doubled, 50)
    shared = min(len(once.time), len(twice.time))
    assert shared > 100
    assert np.allclose(once.time[:shared], twice.time[:shared])
    assert rms(once.residual[:shared] - twice.residual[:shared]).max() < 0.01


def test_friction_is_remembered_while_standing():
    """A joint that moved, and then stood for longer than the history, still carries the friction it stopped with."""
    rate, arm = 500.0, arm_from_urdf(small_arm.URDF)
    torque = TorqueModel(arm, {"stribeck_friction": {}})
    values = np.array([3.0, 3.0, 1.5, 1.5])
    constants = np.array([1e-2 if c.symbol == "d_s" else 0.0 for c in torque.constants])
    model = IdentifiedModel(torque, values, constants, CUTOFF_HZ)
    time = np.arange(0.0, 8.0, 1 / rate)
    position = betainc(4, 4, np.clip(time / 3.0, 0.0, 1.0))[:, None] * np.array([1.5, -1.5])
    run = Recording(small_arm.JOINTS, time, position, None, np.zeros_like(position), (slice(0, len(time)),))
    rows = stream(LiveResidual(model, rate), run, 50)
    standing = rows.time > 5.5
    assert standing.sum() > 50
    assert np.allclose(rows.predicted[standing], [3.0, -1.5], atol=0.05)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_the_kernels_differentiate(rate_hz):
    taps = derivative_taps(CUTOFF_HZ, rate_hz)
    half = (taps.shape[1] - 1) // 2
    t = np.arange(-half, half + 1) / rate_hz
    assert np.allclose(taps, np.flip(taps, axis=1) * np.array([[1], [-1], [1]]))
    assert np.allclose(taps @ np.ones_like(t), [1, 0, 0], atol=1e-6)
    assert np.allclose(taps @ t, [0, 1, 0], atol=1e-6)
    assert (taps @ t**2)[2] == pytest.approx(2.0, rel=1e-6)
    slow = np.sin(2 * np.pi * 1.0 * t + 0.3)
    w = 2 * np.pi
    assert np.allclose(taps @ slow, [np.sin(0.3), w * np.cos(0.3), -(w**2) * np.sin(0.3)], rtol=0.02)
