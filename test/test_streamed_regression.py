"""Columns computed a few seconds at a time are those computed at once, and a long recording needs little memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import THREE_LINKS, Friction, incommensurate, plant

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import CATALOGUE, TorqueModel, structure_of
from spacearm_ident.dynamics.term import Term
from spacearm_ident.identification.identify import identify
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.motion import PART_SAMPLES, Motion
from spacearm_ident.signals.prepare import prepare

LAWS = (Friction(f_c=5.0, f_b=8.0, v_b=0.15, k_v1=4.0), Friction(f_c=3.0, J_m=0.2), Friction(f_c=1.0, k_v2=0.3))
RATE_HZ = 1000.0


def planted(samples: int):
    motion = incommensurate(np.arange(samples) / RATE_HZ, len(THREE_LINKS))
    return plant(THREE_LINKS, LAWS, motion, RATE_HZ)


@pytest.fixture(scope="module")
def long_run():
    run = planted(3 * PART_SAMPLES)
    arm = arm_from_urdf(run.urdf)
    recording = run.recording(noise=0.05)
    return arm, recording, prepare([recording], arm.joint_names)[0]


def random_motion(samples: int, seed: int, **options) -> Motion:
    rng = np.random.default_rng(seed)
    signals = {name: rng.normal(size=(samples, 2)) for name in ("position", "velocity", "acceleration", "torque")}
    speed = np.full(2, 1e-3)
    return Motion(("a", "b"), RATE_HZ, 3.0, **signals, speed_noise=speed, resolved_speed=speed, **options)


@given(
    samples=st.integers(1000, 6000),
    piece=st.integers(100, 4000),
    block=st.integers(1, 12),
    stride=st.integers(1, 9),
    cutoff_hz=st.floats(2.0, 30.0),
)
@settings(max_examples=20, deadline=None)
def test_the_rows_of_the_parts_are_the_rows_of_the_whole(samples, piece, block, stride, cutoff_hz):
    motion = random_motion(samples, samples, block=block, stride=stride, cutoff_hz=cutoff_hz)
    parts = list(motion.parts(piece))
    for whole, by_part in (
        (motion.torque_rows, [part.torque_rows for part in parts]),
        (motion.moving, [part.moving for part in parts]),
        (motion.time, [part.time for part in parts]),
    ):
        np.testing.assert_allclose(np.concatenate(by_part), whole, rtol=1e-12, atol=1e-12)


def test_parts_are_no_longer_than_asked_for_where_the_filter_allows():
    motion = random_motion(50_000, 1, block=10, stride=5, cutoff_hz=5.0)
    parts = list(motion.parts(4000))
    assert len(parts) > 10
    assert max(len(part.position) for part in parts) <= 4000


def test_the_mean_of_periods_is_one_part():
    motion = random_motion(9000, 2, block=10, periods=4)
    assert list(motion.parts(1000)) == [motion]


def test_pieces_cover_every_sample_once():
    motion = random_motion(10_001, 3)
    taken = np.concatenate([motion[piece].position for piece in motion.pieces(3000)])
    np.testing.assert_array_equal(taken, motion.position)


def in_one(motion: Motion, samples: int = 0) -> Iterator[Motion]:
    yield motion


def test_regression_on_a_long_run_has_the_columns_of_all_samples_at_once(long_run, monkeypatch):
    arm, _, motions = long_run
    assert len(list(motions[0].parts())) > 1
    model = TorqueModel(arm, structure_of(arm))
    streamed = Regression(model, motions)
    monkeypatch.setattr(Motion, "parts", in_one)
    at_once = Regression(model, motions)
    for ours, theirs in zip(streamed.rows, at_once.rows):
        assert ours.indices == theirs.indices
        size = np.abs(theirs.fixed).max(axis=0) + 1e-300
        np.testing.assert_allclose(ours.fixed / size, theirs.fixed / size, rtol=0, atol=1e-12)


def test_identification_of_a_long_run_has_the_numbers_of_all_samples_at_once(long_run, monkeypatch):
    arm, recording, motions = long_run
    streamed = identify([recording], arm)
    torque = streamed.model.torque(motions[0])
    monkeypatch.setattr(Motion, "parts", in_one)
    monkeypatch.setattr(Motion, "pieces", lambda motion: [slice(0, len(motion.position))])
    at_once = identify([recording], arm)
    near = 1e-6 * at_once.base_errors
    assert np.all(np.abs(streamed.base_values - at_once.base_values) <= near)
    np.testing.assert_allclose(streamed.base_errors, at_once.base_errors, rtol=1e-6)
    np.testing.assert_allclose(streamed.model.constants, at_once.model.constants, rtol=1e-6)
    np.testing.assert_allclose(torque, streamed.model.torque(motions[0]), rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("kind", [term for term in CATALOGUE.values() if term.pointwise], ids=lambda term: term.kind)
def test_a_pointwise_term_needs_a_sample_and_nothing_else(kind: type[Term], long_run):
    arm, _, motions = long_run
    for term in kind.build(arm, {}):
        assert not term.constants and not term.depends
        whole = term.columns(motions[0], (), None)
        piece = slice(777, 1234)
        for joint, (numbers, columns) in term.columns(motions[0][piece], (), None).items():
            assert numbers == whole[joint][0]
            np.testing.assert_allclose(columns, whole[joint][1][piece], rtol=1e-12, atol=1e-12)


def peak_bytes(model: TorqueModel, motion: Motion) -> int:
    tracemalloc.start()
    try:
        Regression(model, [motion])
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_grows_with_the_rows_and_not_with_the_samples(long_run):
    arm, _, motions = long_run
    model = TorqueModel(arm, structure_of(arm))
    long = motions[0]
    short = long[slice(0, len(long.position) // 2)]
    rows = len(long.torque_rows) - len(short.torque_rows)
    width = sum(len(row.indices) for row in Regression(model, [replace(short)]).rows)
    # A dozen copies of the rows' columns, where a single copy of the samples' would be fifty times as much.
    assert peak_bytes(model, long) - peak_bytes(model, short) < 12 * 8 * rows * width
