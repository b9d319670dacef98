"""A sensor on the arm's base: read with an account of what is wrong, placed on the base link, made into its motion."""

from __future__ import annotations

from dataclasses import replace

import floating_arm
import numpy as np
import pytest
from floating_arm import fly, recorded

from spacearm_ident.conventions.check import check_conventions
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.base_link import base_link, base_notes, placed
from spacearm_ident.dynamics.regressor import rigid_body_torque
from spacearm_ident.errors import UserError
from spacearm_ident.recording import RecordingWriter, cdr, copy_messages, messages, read_recording, write_recording
from spacearm_ident.recording.recording import BaseSensor
from spacearm_ident.signals.base_motion import moves
from spacearm_ident.signals.prepare import prepare

ARM = arm_from_urdf(floating_arm.URDF)
NOTHING = (0.0,) * 9


def motion_of(recording, urdf=floating_arm.URDF):
    (motion,), _ = prepare(placed([recording], arm_from_urdf(urdf)), floating_arm.JOINTS)
    return motion


def inner(flight, motion):
    """Where the motion's samples are in the flight."""
    first = round(motion.start_s * motion.rate_hz)
    return slice(first, first + len(motion.position))


def agrees(made, true, share):
    assert np.sqrt(np.mean((made - true) ** 2)) < share * np.sqrt(np.mean(true**2))


# --- reading --------------------------------------------------------------------------------------------------------


def bag(tmp_path, change=lambda k, message: message, shift_ns=0, **covariance):
    """A flight as a bag; `change(k, (stamp, frame, rate, force))` is what became of the k-th IMU message."""
    recording = recorded(fly(), noise=0.0)
    write_recording(tmp_path / "joints.mcap", replace(recording, base=None))
    path = tmp_path / "bag.mcap"
    first, second = covariance.get("rate", 0.0), covariance.get("force", 0.0)
    with RecordingWriter(path) as writer:
        copy_messages(tmp_path / "joints.mcap", writer)
        channel = writer.add_topic(messages.BASE_IMU_TOPIC, messages.IMU)
        for k, (time, rate, force) in enumerate(zip(recording.time, recording.base.rate, recording.base.force)):
            stamp = round(time * 1e9)
            changed = change(k, (stamp + shift_ns, "base", rate, force))
            if changed is None:
                continue
            own, frame, rate, force = changed
            numbers = (0, 0, 0, 1, *NOTHING, *rate, first, *NOTHING[1:], *force, second, *NOTHING[1:])
            writer.write(channel, stamp, cdr.encode_stamped(own, (frame,), numbers))
    return read_recording(path)


def kinds(recording):
    return {issue.kind: issue for issue in recording.issues}


def test_a_sound_imu_is_read_as_it_was_sent(tmp_path):
    recording = bag(tmp_path)
    assert recording.base.frame == "base" and not recording.issues
    np.testing.assert_array_equal(recording.base.rate, fly().rate)
    np.testing.assert_array_equal(recording.base.force, fly().acceleration)


def test_an_imu_missing_in_the_middle_costs_the_joint_states_of_that_time(tmp_path):
    recording = bag(tmp_path, lambda k, message: None if 600 <= k < 700 else message)
    issue = kinds(recording)["base_gap"]
    assert issue.count == 100 and issue.where_s == pytest.approx(6.0, abs=0.02) and "no base motion" in issue.message
    motions, _ = prepare(placed([recording], ARM), floating_arm.JOINTS)
    assert len(motions) == 2
    assert motions[0].start_s + len(motions[0].position) / 100 <= 6.0 and motions[1].start_s >= 7.0
    for motion in motions:
        agrees(motion.base.rate, fly().rate[inner(fly(), motion)], 0.01)


def test_single_nans_are_counted_and_bridged(tmp_path):
    def spoil(k, message):
        return (*message[:2], np.full(3, np.nan), message[3]) if k % 100 == 50 else message

    recording = bag(tmp_path, spoil)
    assert kinds(recording)["nan"].count == 20 and "base_gap" not in kinds(recording)
    (motion,), _ = prepare(placed([recording], ARM), floating_arm.JOINTS)
    agrees(motion.base.rate, fly().rate[inner(fly(), motion)], 0.01)


def test_late_and_repeated_stamps_and_other_frames_are_left_out(tmp_path):
    def spoil(k, message):
        stamp, frame, rate, force = message
        return {
            300: (stamp - 10**9, frame, rate, force),
            301: (stamp - 10**7, frame, rate, force),
            500: (stamp, "camera", rate, force),
        }.get(k, message)

    recording = bag(tmp_path, spoil)
    assert kinds(recording)["backward_stamp"].count >= 1 and kinds(recording)["base_frame"].count == 1
    assert (np.diff(recording.base.time) > 0).all() and len(recording.base.time) >= 1997


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"shift_ns": 10**14}, "another clock"),
        ({"force": -1.0}, "too few messages"),
        ({"rate": -1.0}, "too few messages"),
        ({"change": lambda k, message: message if k < 10 else None}, "too few messages"),
    ],
)
def test_an_imu_of_no_use_is_said_to_be(tmp_path, options, words):
    recording = bag(tmp_path, **options)
    assert recording.base is None
    assert words in kinds(recording)["base_unusable"].message and "fixed" in kinds(recording)["base_unusable"].message


def test_cut_messages_are_counted(tmp_path):
    recording = bag(tmp_path)
    with RecordingWriter(tmp_path / "cut.mcap") as writer:
        channel = writer.add_topic(messages.BASE_IMU_TOPIC, messages.IMU)
        states = writer.add_topic(messages.STATES_TOPIC, messages.JOINT_STATE)
        stamps = [round(time * 1e9) for time in recording.time[:50]]
        for stamp, payload in zip(stamps, cdr.encode_joint_states(stamps, ("a",), *np.ones((3, 50, 1)))):
            writer.write(states, stamp, payload)
            whole = cdr.encode_stamped(stamp, ("base",), (0.0,) * 37)
            writer.write(channel, stamp, whole[:-1] if stamp == stamps[7] else whole)
    read = read_recording(tmp_path / "cut.mcap")
    assert kinds(read)["undecodable_message"].count == 1 and len(read.base.time) == 49


# --- placing and differentiating ------------------------------------------------------------------------------------


@pytest.mark.parametrize("mounted", [False, True])
def test_the_base_link_moves_as_it_did_wherever_the_imu_sits(mounted):
    recording = recorded(fly(), noise=0.0, mounted=mounted)
    motion = motion_of(recording, recording.urdf)
    here = inner(fly(), motion)
    agrees(motion.base.rate, fly().rate[here], 3e-3)
    agrees(motion.base.rate_dot, fly().rate_dot[here], 3e-3)
    agrees(motion.base.force(ARM.gravity), fly().acceleration[here], 3e-3)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, 0.0, -9.81)])
def test_an_odometry_gives_the_same_force_as_an_imu(gravity):
    flight = fly()
    quaternion = [floating_arm.pin.Quaternion(turn).coeffs() for turn in flight.attitude]
    whole = (slice(0, len(flight.time)),)
    odometry = BaseSensor(
        messages.BASE_ODOMETRY_TOPIC, "base", flight.time, flight.rate, whole,
        velocity=flight.velocity, attitude=np.array(quaternion),
    )  # fmt: skip
    motion = motion_of(replace(recorded(flight, noise=0.0), base=odometry))
    here = inner(flight, motion)
    felt = flight.acceleration - np.einsum("nji,j->ni", flight.attitude, np.array(gravity))
    agrees(motion.base.force(np.array(gravity)), felt[here], 5e-3)


def test_a_sensor_slower_and_one_faster_than_the_joints_come_onto_their_clock():
    flight, recording = fly(), recorded(fly(), noise=0.0)
    base = recording.base
    slow = replace(base, time=base.time[::3], rate=base.rate[::3], force=base.force[::3], runs=(slice(0, 667),))
    motion = motion_of(replace(recording, base=slow))
    agrees(motion.base.rate_dot, flight.rate_dot[inner(flight, motion)], 0.01)
    part = slice(None, None, 4)  # joints at 25 Hz, sensor at 100 Hz
    joints = replace(
        recording,
        time=recording.time[part],
        position=recording.position[part],
        effort=recording.effort[part],
        segments=(slice(0, 500),),
    )
    motion = motion_of(joints)
    assert motion.rate_hz == pytest.approx(25.0)
    first = 4 * round(motion.start_s * 25)
    agrees(motion.base.rate, flight.rate[first : first + 4 * len(motion.position) : 4], 0.01)


def test_a_frame_that_is_not_of_the_base_is_refused_with_what_to_do():
    recording = recorded(fly())
    assert base_link(floating_arm.URDF) == "base"
    for frame, why in (("elbow_link", "not fixed to its base"), ("camera", "no frame of the URDF"), ("", "no frame")):
        with pytest.raises(UserError, match=why) as error:
            placed([replace(recording, base=replace(recording.base, frame=frame))], ARM)
        assert "'base'" in str(error.value) and "--fixed-base" in str(error.value)


def resting(recording):
    """The recording with its IMU at rest, upright on the ground; and the noise of its rate (K, 3)."""
    rng = np.random.default_rng(4)
    still = 4e-4 * rng.standard_normal(recording.base.rate.shape)
    force = 5e-3 * rng.standard_normal(still.shape) + [0.0, 0.0, 9.81]
    return replace(recording, base=replace(recording.base, rate=still, force=force)), still


def test_a_base_at_rest_is_taken_for_fixed_and_odd_gravity_is_told():
    recording = recorded(fly())
    at_rest, still = resting(recording)
    assert moves(recording.base) and not moves(at_rest.base)
    assert placed([at_rest], ARM)[0].base is None
    assert base_notes([at_rest], ARM) == ["recording 1: /base_imu: the base does not move and is taken as fixed"]
    (_, odd) = base_notes([at_rest], ARM.with_gravity(np.zeros(3)))
    assert "-9.81" in odd and "--gravity" in odd
    turning = replace(at_rest, base=replace(at_rest.base, rate=still + np.array([0.0, 0.0, 0.1])))
    assert moves(turning.base)


@pytest.mark.parametrize("frame", ["base", "nowhere"])
def test_check_takes_a_base_whose_sensor_is_at_rest_as_fixed(frame):
    """As an identification does: conventions are tested as if the sensor were not there."""
    at_rest, _ = resting(recorded(fly()))
    # Of a base that is held on the ground is the torque, too.
    speed = np.gradient(at_rest.position, at_rest.time, axis=0)
    inertials = np.array([joint.inertial for joint in ARM.joints])
    states = at_rest.position, speed, np.gradient(speed, at_rest.time, axis=0)
    effort = rigid_body_torque(ARM, inertials, *states) + 0.5 * np.sign(speed)
    at_rest = replace(at_rest, base=replace(at_rest.base, frame=frame), effort=effort)
    report, without = (check_conventions([one], ARM) for one in (at_rest, replace(at_rest, base=None)))
    assert report == without and not any("base moves" in text for text in report.undecided)
    assert any("base moves" in text for text in check_conventions([recorded(fly())], ARM).undecided)


def test_check_says_first_what_identify_says_of_an_unknown_frame_of_a_moving_base():
    recording = recorded(fly())
    lost = replace(recording, base=replace(recording.base, frame="nowhere"))
    with pytest.raises(UserError) as refused:
        placed([lost], ARM)
    report = check_conventions([lost], ARM)
    first = report.findings[0]
    assert not report.fit and first.kind == "base_frame"
    assert f"{first.statement}: {first.remedy}" == str(refused.value)
