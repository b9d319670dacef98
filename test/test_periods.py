"""Periods found in positions alone, and the derivatives and noise that averaging over them gives."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import incommensurate, multisine
from scipy.interpolate import BPoly

from spacearm_ident.signals.periods import Period, find_period, fold, project

ENCODER = 2e-6


def excitation(rate, period_s, periods, seed=1, joints=3, rest_s=1.0, approach_s=2.0, fraction=0.0):
    """Rest, a smooth approach, whole periods, the way back, rest; encoder noise on top.

    Returns positions, and the sample at which the first period begins. `fraction` moves that between two samples.
    """
    rng = np.random.default_rng(seed)
    count = int((2 * (rest_s + approach_s) + periods * period_s) * rate)
    begin = rest_s + approach_s + fraction / rate
    time = np.arange(count) / rate - begin
    whole = periods * period_s
    still = np.zeros((3, joints))
    inside = (time >= 0) & (time <= whole)
    # All at once: the largest of these speeds scales them.
    signals = multisine(np.concatenate([[0.0], time[inside], [whole]]), joints, seed, 1 / period_s)
    at = [np.array([signal[end] for signal in signals]) for end in (0, -1)]
    position = np.zeros((count, joints))
    position[inside] = signals[0][1:-1]
    for joint in range(joints):
        there = BPoly.from_derivatives([-approach_s, 0.0], [still[:, joint], at[0][:, joint]])
        back = BPoly.from_derivatives([whole, whole + approach_s], [at[1][:, joint], still[:, joint]])
        coming, leaving = (time > -approach_s) & (time < 0), (time > whole) & (time < whole + approach_s)
        position[coming, joint] = there(time[coming])
        position[leaving, joint] = back(time[leaving])
    return position + ENCODER * rng.standard_normal(position.shape), begin * rate


@pytest.mark.parametrize("rate", [94.0, 200.0, 1000.0])
@pytest.mark.parametrize("period_s", [5.0, 7.3, 10.0])
@pytest.mark.parametrize("periods", [2, 5])
def test_the_period_is_found_between_approach_and_return(rate, period_s, periods):
    position, begin = excitation(rate, period_s, periods)
    found = find_period(position, rate)
    assert found is not None
    assert found.samples == pytest.approx(period_s * rate, abs=2e-5 * period_s * rate)
    assert found.count == periods
    # All of it, give or take what resembles the period where approach and period join smoothly.
    assert abs(found.start - begin) < 0.02 * period_s * rate
    assert found.stop <= begin + (periods + 0.02) * period_s * rate


@pytest.mark.parametrize(("rate", "period_s"), [(94.0, 7.3), (200.0, 5.0), (1000.0, 7.3)])
def test_what_is_found_folds_and_differentiates_to_the_planted_motion(rate, period_s):
    position, begin = excitation(rate, period_s, 4)
    found = find_period(position, rate)
    folded = fold(position, found)
    length = folded.shape[1]
    _, velocity, acceleration, _ = project(folded, rate * length / found.samples, 40.0)
    time = (found.start - begin) / rate + np.arange(length) / length * period_s
    _, want_velocity, want_acceleration = multisine(time, 3, 1, 1 / period_s)
    assert np.abs(velocity - want_velocity).max() < 3e-3 * want_velocity.std()
    assert np.sqrt(np.mean((acceleration - want_acceleration) ** 2)) < 5e-3 * want_acceleration.std()


def test_a_jerky_start_is_no_part_of_the_period():
    """The arm stands still until the first sample of the first period, and stops dead after the last."""
    rate, periods = 200.0, 3
    inner = multisine(np.arange(int(5 * periods * rate) + 1) / rate, 3, 1, 0.2)[0]
    position = np.concatenate([np.tile(inner[0], (300, 1)), inner, np.tile(inner[-1], (300, 1))])
    position += ENCODER * np.random.default_rng(0).standard_normal(position.shape)
    found = find_period(position, rate)
    assert found is not None and found.samples == 1000.0 and found.count == periods
    assert abs(found.start - 300) <= 2


def test_at_5_khz_too():
    position, _ = excitation(5000.0, 3.7, 3, joints=2)
    found = find_period(position, 5000.0)
    assert found is not None and found.count == 3
    assert found.samples == pytest.approx(3.7 * 5000, abs=0.5)


@given(
    period_s=st.floats(2.0, 6.0),
    seed=st.integers(0, 1000),
    fraction=st.floats(0, 1),
    rate=st.sampled_from([94.0, 125.0, 250.0]),
)
@settings(max_examples=40, deadline=None)
def test_any_length_of_period_is_found_whole_or_not_in_samples(period_s, seed, fraction, rate):
    position, _ = excitation(rate, period_s, 3, seed=seed, fraction=fraction)
    found = find_period(position, rate)
    assert found is not None
    assert found.count == 3
    assert found.samples == pytest.approx(period_s * rate, abs=0.05)


def test_a_recording_of_whole_periods_and_nothing_else_loses_none():
    time = np.arange(4 * 1000) / 200.0
    found = find_period(multisine(time, 2, 4, 1 / 5.0)[0], 200.0)
    assert found == Period(0, 1000.0, 4)


def test_the_shortest_period_wins_over_its_multiples():
    time = np.arange(6000) / 200.0
    found = find_period(multisine(time, 2, 4, 1 / 2.5)[0], 200.0)
    assert found is not None and found.samples == 500.0 and found.count == 12


def test_a_joint_that_rests_does_not_hide_the_period_of_the_others():
    position, _ = excitation(200.0, 5.0, 4)
    position[:, 1] = 0.7 + ENCODER * np.random.default_rng(0).standard_normal(len(position))
    found = find_period(position, 200.0)
    assert found is not None and found.count == 4


@pytest.mark.parametrize("seed", range(6))
def test_motion_that_never_repeats_has_no_period(seed):
    time = np.arange(12000) / 200.0
    position = incommensurate(time, 3, seed)[0]
    assert find_period(position, 200.0) is None


@pytest.mark.parametrize(
    "position",
    [
        np.zeros((5000, 2)),
        np.full((5000, 2), 1.3) + 1e-6 * np.random.default_rng(0).standard_normal((5000, 2)),
        np.linspace(0, 2, 5000)[:, None] * [1.0, -0.5],
        np.concatenate([np.zeros((3000, 1)), np.linspace(0, 1, 500)[:, None], np.ones((3000, 1))]),
    ],
    ids=["zero", "still", "ramp", "one step"],
)
def test_standstill_and_a_single_move_are_no_period(position):
    assert find_period(position, 200.0) is None


def test_two_runs_of_one_program_with_a_rest_between_are_found_or_left_but_never_mixed_up():
    """The pause makes the motion aperiodic: the lag must be that of the program with its pause."""
    leg, _ = excitation(200.0, 4.0, 1, rest_s=0.5, approach_s=1.0)
    found = find_period(np.concatenate([leg, leg]), 200.0)
    assert found is None or found.samples == pytest.approx(len(leg), abs=0.5)


class TestFold:
    def test_whole_periods_are_cut_without_interpolation(self):
        signal = np.arange(50.0)[:, None]
        np.testing.assert_array_equal(fold(signal, Period(5, 10.0, 4)), signal[5:45].reshape(4, 10, 1))

    def test_a_period_of_broken_samples_is_put_on_a_common_phase(self):
        """At 94 Hz, where linear interpolation would miss the fast lines by a percent."""
        rate, samples = 94.0, 94.0 * 3.137
        time = np.arange(int(4.2 * samples)) / rate
        angle = 2 * np.pi * time * rate / samples
        signal = np.stack([np.sin(angle + 1), np.cos(9 * angle)], axis=1)
        folded = fold(signal, Period(7, samples, 4))
        assert folded.shape == (4, round(samples), 2)
        phase = 2 * np.pi * (7 / samples + np.arange(folded.shape[1]) / folded.shape[1])
        want = np.stack([np.sin(phase + 1), np.cos(9 * phase)], axis=1)
        np.testing.assert_allclose(folded, np.broadcast_to(want, folded.shape), atol=2e-3)


class TestProjection:
    @pytest.mark.parametrize(("rate", "period_s"), [(94.0, 10.0), (200.0, 7.3), (1000.0, 5.0)])
    def test_derivatives_of_a_band_limited_period_are_exact(self, rate, period_s):
        length = round(rate * period_s)
        time = np.arange(length) * period_s / length
        q, qd, qdd = multisine(time, 2, 3, 1 / period_s)
        folded = np.broadcast_to(q, (3, *q.shape))
        position, velocity, acceleration, highest = project(folded, length / period_s, 40.0)
        np.testing.assert_allclose(position, q, atol=1e-12)
        np.testing.assert_allclose(velocity, qd, atol=1e-10)
        np.testing.assert_allclose(acceleration, qdd, atol=1e-8)
        assert highest >= 5 / period_s - 1e-9

    def test_noise_above_the_motion_s_lines_is_left_out(self):
        rng = np.random.default_rng(0)
        time = np.arange(2000) / 200.0
        q, qd, qdd = multisine(time, 2, 3, 0.1)
        folded = q + 1e-5 * rng.standard_normal((5, *q.shape))
        _, velocity, acceleration, highest = project(folded, 200.0, 40.0)
        assert highest < 2.0
        assert np.abs(velocity - qd).max() < 5e-5
        assert np.abs(acceleration - qdd).max() < 5e-4

    def test_a_gap_below_the_lines_does_not_lose_the_motion(self):
        """Lines 6 and 7 of a 10 s period alone: five quiet ones come first."""
        time = np.arange(2000) / 200.0
        q = (0.3 * np.sin(2 * np.pi * 0.6 * time) + 0.2 * np.sin(2 * np.pi * 0.7 * time + 1))[:, None]
        folded = q + 1e-6 * np.random.default_rng(0).standard_normal((4, *q.shape))
        position, *_ = project(folded, 200.0, 40.0)
        np.testing.assert_allclose(position, q, atol=1e-5)

    def test_a_joint_at_rest_adds_no_noise_to_the_others(self):
        rng = np.random.default_rng(0)
        time = np.arange(2000) / 200.0
        q, _, qdd = multisine(time, 2, 3, 0.1)
        q[:, 1], qdd[:, 1] = 0.3, 0.0
        _, _, acceleration, highest = project(q + 1e-5 * rng.standard_normal((5, *q.shape)), 200.0, 40.0)
        assert highest < 2.0
        assert np.abs(acceleration - qdd).max() < 5e-4

    def test_nothing_above_the_cut_off_is_kept(self):
        time = np.arange(1000) / 200.0
        q = (np.sin(2 * np.pi * time) + 0.1 * np.sin(2 * np.pi * 30 * time))[:, None]
        position, *_, highest = project(np.broadcast_to(q, (2, *q.shape)), 200.0, 10.0)
        assert highest <= 10.0
        np.testing.assert_allclose(position[:, 0], np.sin(2 * np.pi * time), atol=1e-12)
