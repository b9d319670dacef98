"""Bags of ros2_control's own state messages, encoded by `rosbags` from their definitions, are read as joint states."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm
from made_bags import assert_same, issues
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from spacearm_ident.errors import UserError
from spacearm_ident.recording import cdr, messages, read_recording

RUN = small_arm.recording(2.0)
STAMPS = (RUN.start_ns + np.rint(RUN.time * 1e9).astype(np.int64)).tolist()
DYNAMIC, CONTROLLER = messages.DYNAMIC_JOINT_STATE, messages.CONTROLLER_STATE
POINT = "trajectory_msgs/JointTrajectoryPoint"
RELEASES = {"jazzy": ("reference", "feedback", "error", "output"), "foxy": ("desired", "actual", "error")}
SIGNALS = ("position", "velocity", "effort")


@functools.cache
def store_of(release: str = "jazzy"):
    """Types of a release of control_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    points = "".join(f"{POINT} {name}\n" for name in RELEASES[release])
    store.register(get_types_from_msg(f"std_msgs/Header header\nstring[] joint_names\n{points}", CONTROLLER))
    interface = "control_msgs/msg/InterfaceValue"
    store.register(get_types_from_msg("string[] interface_names\nfloat64[] values\n", interface))
    text = "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"
    store.register(get_types_from_msg(text, DYNAMIC))
    return store


def header_of(store, stamp: int):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="base")


def dynamic(run=RUN, order=SIGNALS, extra: bool = False) -> list[bytes]:
    """Dynamic joint states; `extra`: with a digital output beside the joints, which has no position."""
    store = store_of()
    value = store.types["control_msgs/msg/InterfaceValue"]
    payloads = []
    for k, stamp in enumerate(STAMPS):
        values = [
            value(list(order), np.array([getattr(run, signal)[k, joint] for signal in order]))
            for joint in range(len(run.joints))
        ]
        names = list(run.joints)
        if extra:
            names, values = ["gpio", *names], [value(["digital_output"], np.array([1.0])), *values]
        message = store.types[DYNAMIC](header_of(store, stamp), names, values)
        payloads.append(bytes(store.serialize_cdr(message, DYNAMIC)))
    return payloads


def controller(run=RUN, release: str = "jazzy", joints: int = 2, effort: bool = True) -> list[bytes]:
    """A controller's states; the set-point is 0.5 above the position and has no effort."""
    store = store_of(release)
    zero = store.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)

    def point(position, velocity, torque):
        rows = (np.asarray(row, dtype=np.float64) for row in (position, velocity, [], torque))
        return store.types["trajectory_msgs/msg/JointTrajectoryPoint"](*rows, zero)

    payloads = []
    for k, stamp in enumerate(STAMPS):
        q, v, tau = (getattr(run, signal)[k, :joints] for signal in SIGNALS)
        points = [point(q + 0.5, v, []), point(q, v, tau if effort else [])]
        points += [point(0 * q, [], []) for _ in RELEASES[release][2:]]
        message = store.types[CONTROLLER](header_of(store, stamp), list(run.joints[:joints]), *points)
        payloads.append(bytes(store.serialize_cdr(message, CONTROLLER)))
    return payloads


def joint_states(run=RUN, effort: bool = True) -> list[bytes]:
    return cdr.encode_joint_states(STAMPS, run.joints, run.position, run.velocity, run.effort if effort else None)


def bag(
    folder: Path, topics: dict[str, tuple[str, list[bytes]]], release: str = "jazzy", storage=StoragePlugin.MCAP
) -> Path:
    """A rosbag2 folder of topics: (type, a payload at each of `STAMPS`)."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        for topic, (kind, payloads) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store_of(release))
            for stamp, payload in zip(STAMPS, payloads, strict=False):
                writer.write(connection, stamp, payload)
    return folder


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("order", [SIGNALS, SIGNALS[::-1]])
def test_dynamic_joint_states_are_read_where_there_are_no_joint_states(tmp_path, storage, order):
    path = bag(tmp_path / "bag", {"/dynamic_joint_states": (DYNAMIC, dynamic(order=order))}, storage=storage)
    got = read_recording(path)
    assert_same(got, RUN)
    assert issues(got) == {"other_states": len(RUN.time)}
    assert "no /joint_states: /dynamic_joint_states (control_msgs/msg/DynamicJointState)" in got.issues[0].message


def test_what_has_no_position_in_dynamic_joint_states_is_left_out_and_said(tmp_path):
    got = read_recording(bag(tmp_path / "bag", {"/dynamic_joint_states": (DYNAMIC, dynamic(extra=True))}))
    assert_same(got, RUN)
    assert issues(got) == {"other_states": len(RUN.time), "joint_without_position": 1}


@pytest.mark.parametrize("release", RELEASES)
def test_what_a_controller_measures_is_read_with_its_set_points(tmp_path, release):
    path = bag(tmp_path / "bag", {"/arm_controller/state": (CONTROLLER, controller(release=release))}, release)
    got = read_recording(path)
    assert_same(got, RUN)
    np.testing.assert_array_equal(got.command.values, RUN.position + 0.5)
    assert issues(got) == {"other_states": len(RUN.time)}


def test_joint_states_with_effort_are_kept(tmp_path):
    other = replace(RUN, position=RUN.position + 1.0)
    topics = {
        "/joint_states": (messages.JOINT_STATE.name, joint_states()),
        "/dynamic_joint_states": (DYNAMIC, dynamic(other)),
    }
    got = read_recording(bag(tmp_path / "bag", topics))
    assert_same(got, RUN)
    assert not got.issues


@pytest.mark.parametrize("nothing", [None, np.nan, 0.0])
def test_joint_states_without_effort_are_replaced_and_said(tmp_path, nothing):
    """Drivers without an effort interface publish no effort, NaN or zero."""
    lacking = joint_states(effort=False)
    if nothing is not None:
        lacking = joint_states(replace(RUN, effort=np.full_like(RUN.effort, nothing)))
    topics = {
        "/joint_states": (messages.JOINT_STATE.name, lacking),
        "/arm_controller/controller_state": (CONTROLLER, controller()),
        "/robot_description": (messages.STRING.name, [cdr.encode_string("<robot/>")]),
    }
    got = read_recording(bag(tmp_path / "bag", topics))
    assert_same(got, RUN)
    assert got.urdf == "<robot/>"
    assert "no effort in /joint_states: /arm_controller/controller_state" in got.issues[0].message


def test_states_without_any_effort_are_refused_with_what_to_record(tmp_path):
    path = bag(tmp_path / "bag", {"/arm_controller/state": (CONTROLLER, controller(effort=False))})
    with pytest.raises(
        UserError, match=r"/arm_controller/state \(.*\) holds no effort; record /joint_states with effort"
    ):
        read_recording(path)


def test_of_two_controllers_that_of_more_joints_is_read(tmp_path):
    topics = {
        "/gripper_controller/state": (CONTROLLER, controller(joints=1)),
        "/arm_controller/state": (CONTROLLER, controller()),
    }
    path = bag(tmp_path / "bag", topics)
    assert_same(read_recording(path), RUN)
    got = read_recording(path, namespace="/gripper_controller/state")
    assert got.joints == RUN.joints[:1] and not got.issues


def test_of_two_arms_alike_one_is_asked_for(tmp_path):
    right = replace(RUN, position=RUN.position + 1.0)
    topics = {
        "/left/dynamic_joint_states": (DYNAMIC, dynamic()),
        "/right/dynamic_joint_states": (DYNAMIC, dynamic(right)),
        "/right/robot_description": (messages.STRING.name, [cdr.encode_string("<right/>")]),
    }
    path = bag(tmp_path / "bag", topics)
    with pytest.raises(UserError, match="choose one, such as --namespace /left/dynamic_joint_states"):
        read_recording(path)
    for asked in ("right", "/right/dynamic_joint_states"):
        got = read_recording(path, namespace=asked)
        assert_same(got, right)
        assert got.urdf == "<right/>"


def test_messages_of_these_types_cut_short_are_left_out_and_counted():
    for kind, payloads in ((DYNAMIC, dynamic()[:1]), (CONTROLLER, controller()[:1])):
        whole = payloads[0]
        cuts = [whole[:size] for size in range(len(whole))]
        blocks, bad = cdr.decode_joint_states([whole, *cuts], kind)
        # What follows the measured point is not looked at, so a cut there takes nothing away.
        assert sum(len(block.rows) for block in blocks) + len(bad) == len(cuts) + 1
        assert set(range(1, len(whole) // 2)) <= set(bad)
        for block in blocks:
            np.testing.assert_array_equal(block.position, np.repeat(RUN.position[:1], len(block.rows), axis=0))
