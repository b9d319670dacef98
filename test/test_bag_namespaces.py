"""Bags with the names of the graph: which arm is read of one in namespaces, and what is said where it is not clear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm
from made_bags import START, bag_bytes, issues, numbers, read_bytes, state, states

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.recording import RecordingWriter, cdr, messages, read_recording, write_recording
from spacearm_ident.recording.bag import messages as bag_messages

IMU = cdr.encode_stamped(START, ("base",), (0.0,) * 37)


def write_renamed(path: Path, rows) -> None:
    """A bag of messages under other topics: (message, topic) in order."""
    with RecordingWriter(path) as writer:
        channels = {}
        for message, topic in rows:
            if topic not in channels:
                channels[topic] = writer.add_channel(replace(message.channel, topic=topic))
            writer.write(channels[topic], message.log_time_ns, message.payload)


def read(tmp_path: Path, arms: dict[str, int], others=(), namespace: str | None = None):
    """A bag of arms (namespace -> samples) read; `others` are (topic, payload), logged first."""
    rows = [(log, f"{place}/joint_states", payload) for place, count in arms.items() for log, payload in states(count)]
    data = bag_bytes([], others=[*((START - 1, *other) for other in others), *rows])
    return read_bytes(tmp_path, data, namespace=namespace)


@pytest.mark.parametrize("place", ["", "/arm_1", "/cell/arm_1"])
@pytest.mark.parametrize("asked", [True, False])
def test_the_only_arm_is_read_wherever_it_is(tmp_path, place, asked):
    others = [
        (f"{place}/joint_command", state(START, ("shoulder", "elbow", "wrist"), [1.0, 2.0, 3.0], None, None)),
        (f"{place}/joint_temperatures", cdr.encode_temperature(START, "elbow", 31.0)),
        (f"{place}/robot_description", cdr.encode_string("<robot/>")),
    ]
    recording = read(tmp_path, {place: 50}, others, namespace=(place or "/") if asked else None)
    assert numbers(recording) == list(range(50)) and recording.issues == ()
    assert recording.urdf == "<robot/>" and recording.temperatures["elbow"].values.tolist() == [31.0]
    assert recording.command is not None and recording.command.values.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize("asked", ["right", "/right", "/right/"])
def test_the_arm_asked_for_is_read_of_several(tmp_path, asked):
    others = [
        ("/left/robot_description", cdr.encode_string("<left/>")),
        ("/right/robot_description", cdr.encode_string("<right/>")),
        ("/left/joint_temperatures", cdr.encode_temperature(START, "elbow", 31.0)),
    ]
    recording = read(tmp_path, {"/left": 20, "/right": 30}, others, namespace=asked)
    assert numbers(recording) == list(range(30)) and recording.issues == ()
    assert recording.urdf == "<right/>" and not recording.temperatures


def test_a_bag_of_several_arms_is_refused_with_their_names_where_none_is_asked_for(tmp_path):
    with pytest.raises(UserError) as refusal:
        read(tmp_path, {"/left": 20, "/right": 30})
    assert "several arms (/left/joint_states, /right/joint_states)" in str(refusal.value)
    assert "--namespace left" in str(refusal.value)


def test_an_arm_that_is_not_in_the_bag_is_refused_with_those_that_are(tmp_path):
    with pytest.raises(UserError, match=r"no /arm/joint_states; it holds /left/joint_states, /right/joint_states"):
        read(tmp_path, {"/left": 20, "/right": 30}, namespace="arm")
    with pytest.raises(UserError, match=r"no /joint_states; it holds /left/joint_states"):
        read(tmp_path, {"/left": 20}, namespace="/")


def test_the_arm_outside_namespaces_goes_first_and_the_others_are_reported(tmp_path):
    recording = read(tmp_path, {"": 40, "/gripper": 7})
    assert numbers(recording) == list(range(40)) and issues(recording) == {"other_arm": 7}
    assert "/gripper/joint_states left out" in recording.issues[0].message
    assert read(tmp_path, {"": 40, "/gripper": 7}, namespace="/").issues == ()


@pytest.mark.parametrize("place", ["", "/cell", "/cell/left"])
def test_description_and_base_are_those_of_the_nearest_namespace_around_the_arm(tmp_path, place):
    base = [(f"{place}/base_imu", IMU), (f"{place}/robot_description", cdr.encode_string("<robot/>"))]
    far = [("/other/robot_description", cdr.encode_string("<other/>")), ("/joint_command", b"")]
    recording = read(tmp_path, {"/cell/left": 20}, [*far, *base])
    assert recording.urdf == "<robot/>"
    # One message is too few to use: it is the reader's account that shows that it was looked at, and nothing else was.
    assert set(issues(recording)) == {"base_unusable"}


def test_joint_states_of_another_type_are_no_arm(tmp_path):
    path = tmp_path / "bag.mcap"
    with RecordingWriter(path) as writer:
        writer.write(writer.add_topic("/odd/joint_states", messages.STRING), START, cdr.encode_string("x"))
        channel = writer.add_topic("/arm/joint_states", messages.JOINT_STATE)
        for stamp, payload in states(10):
            writer.write(channel, stamp, payload)
    assert numbers(read_recording(path)) == list(range(10))
    with pytest.raises(UserError, match=r"no /odd/joint_states; it holds /arm/joint_states"):
        read_recording(path, namespace="odd")


# --- the commands ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory):
    """A bag of two arms, the second of which does not move, as a recorder outside any namespace writes it."""
    folder = tmp_path_factory.mktemp("two")
    still = small_arm.recording(8.0)
    still = replace(still, position=np.tile(still.position[:1], (len(still.time), 1)), velocity=None)
    rows = []
    for place, recording in (("/moving", small_arm.recording(8.0)), ("/still", still)):
        write_recording(folder / "one.mcap", recording)
        rows += [(message, place + message.channel.topic) for message in bag_messages(folder / "one.mcap")]
    write_renamed(folder / "two", sorted(rows, key=lambda row: row[0].log_time_ns))
    return folder / "two"


def test_identify_takes_the_arm_it_is_told(two_arms, tmp_path, capsys):
    words = ["identify", str(two_arms), "--out", str(tmp_path / "out"), "--quiet", "--friction", "coulomb-viscous"]
    assert main(words) == 2
    assert "several arms (/moving/joint_states, /still/joint_states)" in capsys.readouterr().err
    assert main([*words, "--namespace", "moving"]) == 0
    model = load_model(tmp_path / "out" / "model.yaml")
    found = dict(zip((parameter.name for parameter in model.model.parameters), model.parameters, strict=True))
    for joint, level in zip(small_arm.JOINTS, small_arm.COULOMB, strict=True):
        assert found[f"f_c[{joint}]"] == pytest.approx(level, rel=0.05)


@pytest.mark.parametrize("command", ["mismatch", "calibrate-temperature"])
def test_the_other_commands_ask_for_the_arm_too(command, two_arms, tmp_path, capsys):
    assert main([command, str(two_arms), "--out", str(tmp_path / "out")]) == 2
    assert "--namespace moving" in capsys.readouterr().err
    assert main([command, str(two_arms), "--out", str(tmp_path / "out"), "--namespace", "none"]) == 2
    assert "no /none/joint_states" in capsys.readouterr().err


def test_an_arm_may_be_named_by_its_topic(two_arms, tmp_path, capsys):
    words = ["check", str(two_arms), "--quiet", "--topic"]
    assert main([*words, "/moving/joint_states"]) in (0, 1)
    assert "does not move" not in (told := capsys.readouterr().out) and "no joint moves" not in told
    main([*words, "/still/joint_states"])
    assert "no joint moves" in capsys.readouterr().out


def test_joint_states_of_any_name_are_read(tmp_path):
    path = tmp_path / "odd.mcap"
    write_recording(path, small_arm.recording(2.0))
    rows = [(m, m.channel.topic.replace("joint_states", "measured")) for m in bag_messages(path)]
    write_renamed(tmp_path / "odd", rows)
    with pytest.raises(UserError, match=r"no /joint_states .*which is the arm's with --topic \(/measured\)"):
        read_recording(tmp_path / "odd")
    recording = read_recording(tmp_path / "odd", namespace="/measured")
    np.testing.assert_array_equal(recording.position, read_recording(path).position)
    assert recording.urdf == read_recording(path).urdf


def test_of_two_arms_on_one_topic_the_messages_of_the_arm_meant_are_read(tmp_path):
    """The other one publishes twice as often."""
    left = states(40, joints=("left_a", "left_b", "left_c"))
    right = states(20, step_ns=2_000_000, joints=("right_a", "right_b", "right_c"))
    path = tmp_path / "bag.mcap"
    path.write_bytes(bag_bytes(sorted([*left, *((log + 500_000, payload) for log, payload in right)])))
    assert read_recording(path).joints == ("left_a", "left_b", "left_c")
    recording = read_recording(path, preferred=("right_c", "right_a", "right_b", "gripper"))
    assert recording.joints == ("right_a", "right_b", "right_c") and len(recording.time) == 20


def test_batch_passes_the_namespace_on(two_arms, tmp_path, capsys):
    words = ["batch", str(two_arms), "--out", str(tmp_path / "out"), "--quiet", "--jobs", "1"]
    assert main(words) == 1
    assert "several arms" in capsys.readouterr().out
    assert main([*words, "--namespace", "moving", "--friction", "coulomb-viscous"]) == 0
