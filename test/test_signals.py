"""From recordings to motions: derivatives, edges, gaps, periods and their noise, standstill, and the bandwidth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import incommensurate, multisine
from scipy.signal import butter, sosfilt

from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.recording.recording import Recording, Series, Source
from spacearm_ident.signals.bandwidth import choose_bandwidth
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare, reversal_cutoff_hz

JOINTS = ("one", "two")


def recording_of(time, position, effort=None, segments=None, **more):
    effort = np.zeros_like(position) if effort is None else effort
    segments = segments or (slice(0, len(time)),)
    return Recording(JOINTS[: position.shape[1]], time, position, None, effort, segments, **more)


def even(rate, seconds):
    return np.arange(int(rate * seconds)) / rate


def uneven(rate, seconds, seed=0):
    """Stamps a tenth of a sample off the grid on average, as over a network."""
    rng = np.random.default_rng(seed)
    return even(rate, seconds) + np.abs(rng.normal(0, 0.1 / rate, int(rate * seconds)))


def motion_of(velocity, rate=200.0, periods=1, cutoff=5.0, block=2, stride=5, noise=0.0, resolved=0.0):
    velocity = np.asarray(velocity, dtype=float).reshape(len(velocity), -1)
    position = np.cumsum(velocity, axis=0) / rate
    joints = velocity.shape[1]
    return Motion(
        JOINTS[:joints],
        rate,
        0.0,
        position,
        velocity,
        np.gradient(velocity, 1 / rate, axis=0),
        np.zeros_like(velocity),
        np.full(joints, noise),
        np.full(joints, resolved),
        block=block,
        cutoff_hz=cutoff,
        stride=stride,
        periods=periods,
    )


class TestDerivatives:
    @pytest.mark.parametrize("rate", [94.0, 250.0, 1000.0, 5000.0])
    @pytest.mark.parametrize("stamps", [even, uneven])
    def test_of_a_known_motion_are_right_up_to_the_last_row(self, rate, stamps):
        """Every row that is kept, the first and the last included: no row is spoilt by the filter's edge."""
        time = stamps(rate, 15.0)
        q = incommensurate(time, 2, 3)[0]
        (motion,), _ = prepare([recording_of(time, q)], JOINTS)
        inner = motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
        _, qd, qdd = incommensurate_at(time, inner)
        velocity, acceleration = motion.reduce(qd), motion.reduce(qdd)
        assert np.abs(motion.velocity_rows - velocity).max() < 2e-3 * velocity.std()
        assert np.abs(motion.reduce(motion.acceleration) - acceleration).max() < 1e-2 * acceleration.std()
        middle = slice(20, -20)
        assert np.abs((motion.reduce(motion.acceleration) - acceleration)[middle]).max() < 2e-3 * acceleration.std()

    def test_of_averaged_periods_are_right_at_every_sample(self):
        time = even(200.0, 30.0)
        q, qd, qdd = multisine(time, 2, 3)
        rng = np.random.default_rng(0)
        (motion,), _ = prepare([recording_of(time, q + 2e-6 * rng.standard_normal(q.shape))], JOINTS)
        assert motion.periods == 3 and motion.cyclic
        first = round(motion.start_s * 200)
        part = slice(first, first + len(motion.position))
        assert np.abs(motion.velocity - qd[part]).max() < 1e-4 * qd.std()
        assert np.abs(motion.acceleration - qdd[part]).max() < 1e-4 * qdd.std()

    def test_encoder_noise_grows_into_the_acceleration_no_more_than_the_bandwidth_lets_it(self):
        time = even(1000.0, 20.0)
        q = incommensurate(time, 2, 3)[0]
        noisy = q + 3e-6 * np.random.default_rng(0).standard_normal(q.shape)
        (motion,), bandwidth = prepare([recording_of(time, noisy)], JOINTS)
        inner = motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
        error = motion.reduce(motion.acceleration) - motion.reduce(incommensurate_at(time, inner)[2])
        # White noise of density 2 s^2 / rate below the cut-off, twice differentiated: integral of w^4.
        bound = 3e-6 * np.sqrt(2 / 1000.0 * (2 * np.pi) ** 4 * bandwidth.cutoff_hz**5 / 5)
        assert np.sqrt(np.mean(error**2)) < 1.2 * bound


def incommensurate_at(recorded, time):
    """`incommensurate` at other times: its amplitudes are scaled by the peak over the recorded ones."""
    q, qd, qdd = incommensurate(np.concatenate([recorded, time]), 2, 3)
    whole = incommensurate(recorded, 2, 3)[1]
    factor = np.abs(whole).max(axis=0) / np.abs(qd[: len(recorded)]).max(axis=0)
    return tuple(signal[len(recorded) :] * factor for signal in (q, qd, qdd))


class TestStretches:
    def test_a_gap_makes_two_motions_and_no_row_across_it(self):
        time = np.concatenate([even(200.0, 10.0), 14.0 + even(200.0, 8.0)])
        q = incommensurate(time, 2, 1)[0]
        segments = (slice(0, 2000), slice(2000, 3600))
        effort = np.where(time[:, None] < 12, 1.0, 5.0) * np.ones((1, 2))
        motions, _ = prepare([recording_of(time, q, effort, segments)], JOINTS)
        assert [motion.source for motion in motions] == [0, 0]
        assert motions[0].time.max() < 10.0 and motions[1].time.min() > 14.0
        np.testing.assert_allclose(motions[0].torque_rows, 1.0)
        np.testing.assert_allclose(motions[1].torque_rows, 5.0)

    def test_a_stretch_too_short_is_left_out_and_the_rest_used(self):
        time = even(200.0, 12.0)
        q = incommensurate(time, 2, 1)[0]
        segments = (slice(0, 150), slice(150, 380), slice(380, 2400))
        motions, _ = prepare([recording_of(time, q, segments=segments)], JOINTS)
        assert len(motions) == 1 and motions[0].start_s > 380 / 200

    def test_rows_carry_the_time_of_what_they_average(self):
        """A torque that is its own time: the low-pass is symmetric, so the mean of the window is its centre."""
        for rate in (94.0, 1000.0):
            time = 3.0 + even(rate, 12.0)
            q = incommensurate(time, 2, 1)[0]
            (motion,), _ = prepare([recording_of(time, q, np.stack([time, -time], axis=1))], JOINTS)
            np.testing.assert_allclose(motion.torque_rows[:, 0], motion.time, atol=1e-9)
            np.testing.assert_allclose(motion.torque_rows[:, 1], -motion.time, atol=1e-9)

    def test_columns_are_taken_by_joint_name(self):
        time = even(200.0, 10.0)
        q = incommensurate(time, 2, 1)[0]
        effort = np.tile([1.0, 2.0], (len(time), 1))
        (motion,), _ = prepare([recording_of(time, q, effort)], ("two", "one"))
        assert motion.joints == ("two", "one")
        np.testing.assert_allclose(motion.torque_rows[0], [2.0, 1.0])
        (alone,), _ = prepare([recording_of(time, q, effort)], ("two",))
        assert alone.torque_rows.shape[1] == 1

    def test_several_recordings_share_one_bandwidth_and_keep_their_numbers(self):
        slow, fast = even(100.0, 20.0), even(1000.0, 10.0)
        recordings = [
            recording_of(slow, incommensurate(slow, 2, 1)[0]),
            recording_of(fast, np.sin(2 * np.pi * 2.7 * fast)[:, None] * [0.3, 0.2] + fast[:, None] ** 2 / 20),
        ]
        motions, bandwidth = prepare(recordings, JOINTS)
        assert [motion.source for motion in motions] == [0, 1]
        assert {motion.cutoff_hz for motion in motions} == {bandwidth.cutoff_hz}
        assert bandwidth.cutoff_hz > 5.0

    def test_a_slow_recording_holds_the_common_bandwidth_down(self):
        slow, fast = even(40.0, 20.0), even(1000.0, 10.0)
        fast_motion = np.sin(2 * np.pi * 5 * fast)[:, None] * [0.1, 0.1] + fast[:, None] ** 2 / 20
        recordings = [recording_of(slow, incommensurate(slow, 2, 1)[0]), recording_of(fast, fast_motion)]
        _, bandwidth = prepare(recordings, JOINTS)
        assert bandwidth.cutoff_hz <= 0.2 * 40.0

    def test_approach_periods_and_return_become_three_motions(self):
        time = even(200.0, 28.0)
        ramp = np.clip(np.minimum(time / 4, (28 - time) / 4), 0, 1)
        envelope = (6 * ramp**5 - 15 * ramp**4 + 10 * ramp**3)[:, None]
        q = envelope * multisine(time, 2, 3, 0.2)[0]
        motions, _ = prepare([recording_of(time, q)], JOINTS)
        assert [motion.cyclic for motion in motions] == [False, True, False]
        assert motions[1].periods == 4
        assert motions[1].start_s == pytest.approx(4.0, abs=0.2)


class TestRefusals:
    def test_too_short_a_recording(self):
        time = even(200.0, 0.8)
        with pytest.raises(UnfitDataError, match="longer than a second"):
            prepare([recording_of(time, incommensurate(time, 2, 1)[0])], JOINTS)

    def test_all_of_it_edge(self):
        time = even(200.0, 1.1)
        with pytest.raises(UnfitDataError, match=r"shorter than 1\.2 s"):
            prepare([recording_of(time, incommensurate(time, 2, 1)[0])], JOINTS, 5.0)

    def test_no_motion(self):
        time = even(200.0, 10.0)
        still = np.full((len(time), 2), 0.4) + 1e-6 * np.random.default_rng(0).standard_normal((len(time), 2))
        with pytest.raises(UnfitDataError, match="no joint moves"):
            prepare([recording_of(time, still)], JOINTS)
        with pytest.raises(UnfitDataError, match="no joint moves"):
            prepare([recording_of(time, np.zeros((len(time), 2)))], JOINTS)

    def test_a_missing_joint_is_named_with_what_is_there(self):
        time = even(200.0, 10.0)
        bag = recording_of(time, incommensurate(time, 2, 1)[0], sources=(Source("run.mcap", 1, "00"),))
        with pytest.raises(UserError, match=r"run\.mcap has no joint 'three'.*one, two"):
            prepare([bag], ("one", "three"))

    @pytest.mark.parametrize("cutoff", [0.0, -1.0, 40.0, 1000.0])
    def test_a_bandwidth_that_does_not_fit_the_rate(self, cutoff):
        time = even(94.0, 10.0)
        with pytest.raises(UserError, match="choose one below 38 Hz"):
            prepare([recording_of(time, incommensurate(time, 2, 1)[0])], JOINTS, cutoff)


class TestBandwidth:
    def test_of_a_slow_clean_motion_follows_its_power(self):
        time = even(1000.0, 30.0)
        q = np.sin(2 * np.pi * 1.5 * time)[:, None] + 1e-7 * np.random.default_rng(0).standard_normal((len(time), 1))
        chosen = choose_bandwidth(q, 1000.0)
        assert "99 % of the motion's power" in chosen.reason and "bandwidth used" not in chosen.reason
        assert chosen.dynamic_hz == pytest.approx(1.5, abs=0.2)
        assert chosen.cutoff_hz == pytest.approx(5 * chosen.dynamic_hz)
        assert chosen.crossing_hz > chosen.cutoff_hz

    def test_of_a_noisy_motion_ends_where_the_noise_begins(self):
        rng = np.random.default_rng(0)
        time = even(1000.0, 60.0)
        # A spectrum that falls smoothly: a random walk of the velocity, and coarse encoders.
        q = np.cumsum(np.cumsum(rng.standard_normal((len(time), 1)), axis=0), axis=0) * 1e-8
        chosen = choose_bandwidth(q + 2e-4 * rng.standard_normal(q.shape), 1000.0)
        assert "positions are noise" in chosen.reason
        assert chosen.crossing_hz < 5 * chosen.dynamic_hz

    @pytest.mark.parametrize("filtered_hz", [15.0, 60.0, 250.0])
    def test_noise_that_a_controller_has_filtered_is_noise(self, filtered_hz):
        """Nothing of it is left at the highest frequencies, where a white noise would be measured."""
        rng = np.random.default_rng(0)
        time = even(1000.0, 20.0)
        filtered = butter(2, filtered_hz, fs=1000.0, output="sos")
        q = incommensurate(time, 2, 1)[0] + 1e-4 * sosfilt(filtered, rng.standard_normal((len(time), 2)), axis=0)
        slow = choose_bandwidth(incommensurate(time, 2, 1)[0], 1000.0)
        chosen = choose_bandwidth(q, 1000.0)
        assert chosen.dynamic_hz == pytest.approx(slow.dynamic_hz, abs=0.2)
        assert slow.dynamic_hz < chosen.crossing_hz < 12.0

    @pytest.mark.parametrize("fast_hz", [6.0, 9.0])
    def test_a_fast_motion_on_a_slow_one_is_motion(self, fast_hz):
        """Between them the acceleration's spectrum is low, and rises again: but not for good."""
        rng = np.random.default_rng(0)
        time = even(1000.0, 20.0)
        shaking = 0.3 * 0.3 / fast_hz * np.sin(2 * np.pi * fast_hz * time)[:, None]
        noise = 1e-6 * sosfilt(butter(2, 60.0, fs=1000.0, output="sos"), rng.standard_normal((len(time), 1)), axis=0)
        chosen = choose_bandwidth(np.sin(2 * np.pi * 0.3 * time)[:, None] + shaking + noise, 1000.0)
        assert chosen.dynamic_hz == pytest.approx(fast_hz, abs=0.2) and chosen.cutoff_hz > fast_hz

    def test_a_motion_of_fast_lines_alone_is_not_taken_for_noise(self):
        """Its spectrum is empty from zero to 6 Hz; the noise begins above the line, not below it."""
        time = even(500.0, 30.0)
        q = 0.05 * np.sin(2 * np.pi * 6 * time)[:, None] + 1e-6 * np.random.default_rng(0).standard_normal(
            (len(time), 1)
        )
        assert choose_bandwidth(q, 500.0).cutoff_hz >= 6.0

    def test_is_kept_within_bounds_and_says_so(self):
        time = even(1000.0, 30.0)
        slow = choose_bandwidth(np.sin(2 * np.pi * 0.3 * time)[:, None], 1000.0)
        assert slow.cutoff_hz == 5.0 and "raised to 5 Hz, the smallest bandwidth used" in slow.reason
        fast = choose_bandwidth(np.sin(2 * np.pi * 9 * time)[:, None], 1000.0)
        assert fast.cutoff_hz == 20.0 and "lowered to 20 Hz" in fast.reason
        assert choose_bandwidth(np.sin(2 * np.pi * 4 * time[::20])[:, None], 50.0).cutoff_hz <= 10.0

    def test_of_standstill_says_that_nothing_moves(self):
        noise = 1e-5 * np.random.default_rng(0).standard_normal((4000, 2))
        chosen = choose_bandwidth(np.zeros((4000, 2)), 200.0)
        assert chosen.reason == "nothing moves"
        # White noise of an encoder at rest is measured.
        np.testing.assert_allclose(choose_bandwidth(noise, 200.0).position_noise, 1e-5, rtol=0.15)

    def test_is_what_was_asked_for_periods_too(self):
        time = even(200.0, 30.0)
        rng = np.random.default_rng(0)
        for q in (incommensurate(time, 2, 1)[0], multisine(time, 2, 1)[0]):
            noisy = q + 1e-6 * rng.standard_normal(q.shape)
            motions, bandwidth = prepare([recording_of(time, noisy)], JOINTS, 7.5)
            assert bandwidth.cutoff_hz == 7.5 and bandwidth.reason == "as asked"
            assert {motion.cutoff_hz for motion in motions} == {7.5}


class TestReduction:
    @given(seed=st.integers(0, 100), periods=st.sampled_from([1, 4]), block=st.integers(1, 4), stride=st.integers(1, 6))
    @settings(max_examples=30, deadline=None)
    def test_it_is_linear_and_keeps_constants(self, seed, periods, block, stride):
        motion = motion_of(np.ones(600), periods=periods, block=block, stride=stride)
        a, b = np.random.default_rng(seed).standard_normal((2, 600, 3))
        np.testing.assert_allclose(
            motion.reduce(2 * a - 3 * b), 2 * motion.reduce(a) - 3 * motion.reduce(b), atol=1e-12
        )
        np.testing.assert_allclose(motion.reduce(np.full((600, 2), 7.0)), 7.0)
        assert len(motion.reduce(a)) == len(motion.time) == len(motion.moving)

    @given(
        periods=st.sampled_from([1, 4]),
        block=st.integers(1, 4),
        stride=st.integers(1, 6),
        first=st.integers(0, 610),
        length=st.integers(0, 200),
    )
    @settings(max_examples=60, deadline=None)
    def test_of_a_part_it_is_that_of_the_whole_with_zeros_around(self, periods, block, stride, first, length):
        motion = motion_of(np.ones(601), periods=periods, block=block, stride=stride)
        whole, lasts = np.zeros((601, 2)), slice(min(first, 601), min(first + length, 601))
        whole[lasts] = np.random.default_rng(0).standard_normal(whole[lasts].shape)
        np.testing.assert_allclose(motion.reduce_part(whole[lasts], lasts.start), motion.reduce(whole), atol=1e-12)

    def test_it_has_no_phase(self):
        """A signal even about a row's time gives rows even about it; an odd one gives zero there."""
        motion = motion_of(np.ones(601), block=1, stride=5)
        time = np.arange(601) / 200.0
        centre = int(np.argmin(np.abs(motion.time - 1.5)))
        about = motion.time[centre]
        odd = motion.reduce((time - about) ** 3)
        assert abs(odd[centre]) < 1e-9
        np.testing.assert_allclose(odd[centre + 1 : centre + 10], -odd[centre - 9 : centre][::-1], atol=1e-9)

    def test_it_passes_half_at_the_cut_off_and_nothing_at_twice(self):
        motion = motion_of(np.ones(4000), rate=1000.0, cutoff=10.0, block=1, stride=1)
        time = np.arange(4000) / 1000.0
        for frequency, gain in ((1.0, 0.99), (10.0, 0.5), (20.0, 0.0), (45.0, 0.0)):
            passed = motion.reduce(np.sin(2 * np.pi * frequency * time))
            assert passed.std() * np.sqrt(2) == pytest.approx(gain, abs=0.02)

    def test_of_a_cycle_it_wraps_around(self):
        time = np.arange(1000) / 200.0
        motion = motion_of(np.ones(1000), periods=3, block=1, stride=5)
        signal = np.cos(2 * np.pi * time / 5.0)
        shifted = motion.reduce(np.roll(signal, 5 * 37))
        np.testing.assert_allclose(shifted, np.roll(motion.reduce(signal), 37), atol=1e-12)
        assert len(motion.time) == 200 and motion.time[0] == 0.0

    @pytest.mark.parametrize(("block", "stride"), [(1, 10), (2, 5), (3, 6)])
    def test_it_correlates_white_noise_as_it_says(self, block, stride):
        motion = motion_of(np.ones(60000), block=block, stride=stride, periods=2)
        rows = motion.reduce(np.random.default_rng(0).standard_normal((60000, 4)))
        said = motion.white_correlation
        assert said[0] == 1.0
        for lag in range(1, len(said) + 2):
            found = np.mean(rows[lag:] * rows[:-lag]) / np.mean(rows**2)
            assert found == pytest.approx(said[lag] if lag < len(said) else 0.0, abs=0.03)


class TestStandstill:
    def test_rows_near_a_reversal_or_at_rest_do_not_move(self):
        rate = 200.0
        velocity = np.concatenate([np.full(600, 0.5), np.zeros(600), np.full(600, -0.5), np.full(600, 0.5)])
        motion = motion_of(velocity, rate, resolved=0.1)
        moving = dict(zip(np.round(motion.time, 6), motion.moving[:, 0]))
        half = 0.5 / motion.cutoff_hz
        for time, flag in moving.items():
            if 3.0 - half < time < 6.0 + half:
                assert not flag or min(abs(time - 3.0), abs(time - 6.0)) > 0.8 * half
            else:
                assert flag

    def test_a_speed_in_the_noise_is_standstill(self):
        assert not motion_of(np.full(600, 1e-3), noise=2e-3).moving.any()
        assert motion_of(np.full(600, 3e-3), noise=2e-3).moving.all()

    def test_each_joint_by_itself(self):
        velocity = np.stack([np.full(600, 0.3), np.zeros(600)], axis=1)
        moving = motion_of(velocity, noise=1e-6).moving
        assert moving[:, 0].all() and not moving[:, 1].any()


class TestReversalCutoff:
    """The low-pass of positions with which a reversal is resolved best."""

    @staticmethod
    def seen(step_rad, resting=False):
        """Positions of two joints that an encoder of a given resolution shows."""
        time, rng = even(200.0, 20.0), np.random.default_rng(0)
        q = incommensurate(time, 2, 3)[0]
        q[:, 1] *= not resting
        return recording_of(time, q + rng.uniform(-0.5, 0.5, q.shape) * step_rad)

    def test_it_is_where_blur_and_noise_hide_a_reversal_alike(self):
        """Of white noise s: 6 s w sqrt(2 f / (3 rate)) = a / w, with w = 2 pi f and a the acceleration."""
        step = 1e-3
        recording = self.seen(step)
        found = reversal_cutoff_hz([recording], JOINTS, 10.0, 70.0)
        acceleration = np.percentile(np.abs(incommensurate(recording.time, 2, 3)[2]), 95, axis=0)
        noise = 6 * 2 * np.pi * step / np.sqrt(12) * np.sqrt(2 / 200.0 / 3)
        expected = np.median((acceleration / (2 * np.pi * noise)) ** 0.4)
        assert 10.0 < expected < 70.0
        assert found == pytest.approx(expected, rel=0.1)

    def test_a_fine_encoder_allows_the_widest_and_none_less_than_the_torque_has(self):
        assert reversal_cutoff_hz([self.seen(1e-6)], JOINTS, 10.0, 70.0) == 70.0
        assert reversal_cutoff_hz([self.seen(3e-2)], JOINTS, 10.0, 70.0) == 10.0

    def test_a_joint_at_rest_has_no_say(self):
        both, one = (reversal_cutoff_hz([self.seen(1e-3, resting)], JOINTS, 10.0, 70.0) for resting in (False, True))
        assert one == pytest.approx(both, rel=0.2)


class TestPeriodNoise:
    @pytest.mark.parametrize("periods", [2, 5])
    def test_it_is_the_noise_that_was_put_in(self, periods):
        """Scatter of 3 x (periods - 1) averages, against what the low-pass leaves of white noise in a mean period."""
        sigma = np.array([0.5, 2.0])
        found, want = [], None
        for seed in range(6):
            rng = np.random.default_rng(seed)
            time = even(200.0, 10.0 * periods)
            q = multisine(time, 2, 3)[0]
            effort = 10 * np.sin(2 * np.pi * 0.3 * time)[:, None] + sigma * rng.standard_normal(q.shape)
            (motion,), _ = prepare([recording_of(time, q + 1e-6 * rng.standard_normal(q.shape), effort)], JOINTS)
            assert motion.periods == periods
            found.append(motion.noise_Nm**2)
            gain = motion.reduce(np.random.default_rng(99).standard_normal((len(motion.position), 500))).std()
            want = sigma * gain / np.sqrt(periods)
        # Rows of a 10 s period at 5 Hz and more hold some 70 independent values, six seeds: 3 standard errors.
        tolerance = 3 / np.sqrt(2 * 70 * 6 * (periods - 1))
        np.testing.assert_allclose(np.sqrt(np.mean(found, axis=0)), want, rtol=tolerance)

    def test_what_repeats_is_no_noise(self):
        time = even(200.0, 40.0)
        q = multisine(time, 2, 3)[0]
        (motion,), _ = prepare(
            [recording_of(time, q, np.sign(np.sin(2 * np.pi * 0.7 * time + 0.1))[:, None] * [5.0, 1.0])], JOINTS
        )
        assert motion.periods == 4
        assert np.all(motion.noise_Nm < 1e-9)

    def test_motion_that_does_not_repeat_has_no_such_figure(self):
        time = even(200.0, 20.0)
        (motion,), _ = prepare([recording_of(time, incommensurate(time, 2, 1)[0])], JOINTS)
        assert motion.noise_Nm is None and motion.periods == 1


class TestTemperature:
    def temperatures(self, time):
        """5 Hz, on another clock, rising by a kelvin in ten seconds."""
        clock = np.arange(-1.0, time[-1] + 1, 0.2)
        return {"one": Series(clock, 20 + clock / 10), "two": Series(clock, 30 - clock / 10)}

    def test_is_brought_to_the_samples(self):
        time = even(200.0, 20.0)
        bag = recording_of(time, incommensurate(time, 2, 1)[0], temperatures=self.temperatures(time))
        (motion,), _ = prepare([bag], JOINTS)
        sampled = motion.start_s + np.arange(len(motion.position)) / 200.0
        np.testing.assert_allclose(motion.temperature, np.stack([20 + sampled / 10, 30 - sampled / 10], axis=1))

    def test_is_averaged_with_the_periods(self):
        time = even(200.0, 40.0)
        bag = recording_of(time, multisine(time, 2, 3)[0], temperatures=self.temperatures(time))
        (motion,), _ = prepare([bag], JOINTS)
        phase = np.arange(len(motion.position)) / 200.0
        np.testing.assert_allclose(motion.temperature[:, 0], 20 + (phase + 15.0) / 10, atol=1e-9)

    @pytest.mark.parametrize("rate", [200.0, 200.03])
    def test_of_averaged_periods_is_not_a_number_where_a_joint_reports_none(self, rate):
        """The second rate makes a period no whole number of samples: a spline brings it to one."""
        time = even(rate, 40.0)
        bag = recording_of(time, multisine(time, 2, 3)[0], temperatures=self.temperatures(time))
        both, one = (
            prepare([replace(bag, temperatures=told)], JOINTS)[0][0]
            for told in (bag.temperatures, {"one": bag.temperatures["one"]})
        )
        assert both.periods == one.periods > 1
        np.testing.assert_array_equal(one.temperature[:, 0], both.temperature[:, 0])
        assert np.isnan(one.temperature[:, 1]).all()

    def test_is_not_a_number_where_a_joint_reports_none(self):
        time = even(200.0, 20.0)
        bag = recording_of(time, incommensurate(time, 2, 1)[0], temperatures=self.temperatures(time))
        (motion,), _ = prepare([replace(bag, temperatures={"one": bag.temperatures["one"]})], JOINTS)
        assert np.isfinite(motion.temperature[:, 0]).all() and np.isnan(motion.temperature[:, 1]).all()
        (motion,), _ = prepare([replace(bag, temperatures={})], JOINTS)
        assert motion.temperature is None
