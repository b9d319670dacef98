"""The recorder against a live graph: all of it, with times and losses; killed, without room, without a place."""

import resource
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from live_nodes import LIVE, end, output
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.duration import Duration
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.nodes.runtime import LATCHED, STREAM
from spacearm_ident.recording import cdr, read_recording, write_recording
from spacearm_ident.recording.background_writer import BackgroundWriter, Topic
from spacearm_ident.recording.bag import messages
from spacearm_ident.recording.definitions import definition_text
from spacearm_ident.recording.messages import JOINT_STATE, STRING, MessageType

pytestmark = LIVE

URDF = "<robot name='r'/>"

SENDER = """
import sys, time
import numpy as np
import rclpy
from sensor_msgs.msg import JointState
from spacearm_ident.nodes.runtime import STREAM
from spacearm_ident.recording import cdr
rclpy.init()
node = rclpy.create_node("sender")
publisher = node.create_publisher(JointState, "/joint_states", STREAM)
while publisher.get_subscription_count() == 0:
    time.sleep(0.01)
time.sleep(0.2)
start, rate, number = time.time(), float(sys.argv[1]), int(sys.argv[2])
for k in range(number):
    time.sleep(max(0.0, start + k / rate - time.time()))
    stamp = int(start * 1e9) + round(k * 1e9 / rate)
    publisher.publish(cdr.encode_joint_states([stamp], ["a", "b"], np.full((1, 2), float(k)), None, np.ones((1, 2)))[0])
print("sent", flush=True)
time.sleep(600)
"""


def started(probe) -> Path:
    success, reply = probe.call("/recorder/start")
    assert success, reply
    return Path(reply.removeprefix("recording to "))


def received(probe, topic: str) -> int:
    return int(probe.values("recorder: topics").get(topic, "0").split()[0])


def send(processes, rate: float, number: int):
    return processes.python("-c", SENDER, str(rate), str(number))


def test_a_stream_arrives_whole_and_in_order(processes, probe, tmp_path):
    processes.node("recorder", f"directory:={tmp_path / 'bags'}", "prefix:=arm")
    folder = started(probe)
    assert folder.parent == tmp_path / "bags" and folder.name.startswith("arm_")
    sender = send(processes, 1000, 3000)
    probe.wait_for(lambda: "sent" in output(sender), "all sent")
    probe.wait_for(lambda: received(probe, "/joint_states") == 3000, "all received")
    assert probe.values("recorder: topics")["/joint_states"] == "3000 received, 0 lost, 0 dropped"
    assert probe.values("recorder")["recording"] == "true"
    success, reply = probe.call("/recorder/stop")
    assert success and str(folder) in reply
    recording = read_recording(folder)
    assert recording.joints == ("a", "b") and not recording.issues
    assert np.array_equal(recording.position[:, 0], np.arange(3000.0))
    with AnyReader([folder]) as reader:
        assert {"/joint_states", "/diagnostics"} <= set(reader.topics)
        assert reader.topics["/joint_states"].msgcount == 3000
        assert reader.topics["/joint_states"].connections[0].digest == JOINT_STATE.type_hash
    with next(folder.glob("*.mcap")).open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(["/joint_states"]):
            (block,), _ = cdr.decode_joint_states([message.data])
            assert 0 <= message.publish_time - block.stamp_ns[0] < 10e9
            assert 0 <= message.log_time - message.publish_time < 10e9


def test_late_latched_best_effort_and_hidden_topics(processes, probe, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import String

    node = probe.node
    node.create_publisher(String, "/robot_description", LATCHED).publish(String(data=URDF))
    hidden = node.create_publisher(String, "/_hidden", 10)
    processes.node("recorder", f"directory:={tmp_path}")
    folder = started(probe)
    probe.wait_for(lambda: received(probe, "/robot_description") == 1, "the latched message")
    coarse = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    late = node.create_publisher(DiagnosticArray, "/late", coarse)
    probe.wait_for(lambda: late.get_subscription_count() == 1, "the recorder subscribes to the new topic")
    values = [KeyValue(key="k", value="v")]
    for _ in range(5):
        late.publish(DiagnosticArray(status=[DiagnosticStatus(name="part", values=values)]))
        hidden.publish(String(data="unseen"))
        probe.spin(0.02)
    probe.wait_for(lambda: received(probe, "/late") > 0, "late messages")
    assert probe.call("/recorder/stop")[0]
    assert read_recording_urdf(folder) == URDF
    with AnyReader([folder]) as reader:
        assert "/_hidden" not in reader.topics
        assert reader.topics["/robot_description"].connections[0].ext.offered_qos_profiles[0].durability.value == 1
    # A library that is not ours understands the definition texts.
    with next(folder.glob("*.mcap")).open("rb") as stream:
        decoded = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/late"]))
    assert decoded[0].decoded_message.status[0].values[0].value == "v"


def test_each_topic_keeps_what_its_publishers_offer(processes, probe, tmp_path):
    """In the channel's metadata and in metadata.yaml. Of history and depth discovery says nothing."""
    from std_msgs.msg import String

    coarse = QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        deadline=Duration(seconds=2, nanoseconds=500),
        lifespan=Duration(seconds=3),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=4),
    )
    offers = {"/coarse": [coarse], "/kept": [LATCHED], "/both": [STREAM, coarse]}
    publishers = {
        topic: [probe.node.create_publisher(String, topic, qos) for qos in profiles]
        for topic, profiles in offers.items()
    }
    probe.wait_for(
        lambda: all(probe.node.count_publishers(topic) == len(profiles) for topic, profiles in offers.items()),
        "the publishers",
    )
    processes.node("recorder", f"directory:={tmp_path}")
    folder = started(probe)
    everyone = [publisher for group in publishers.values() for publisher in group]
    probe.wait_for(lambda: all(one.get_subscription_count() == 1 for one in everyone), "subscribed to all")

    def heard():
        for publisher in everyone:
            publisher.publish(String(data="x"))
        return all(received(probe, topic) for topic in offers)

    probe.wait_for(heard, "a message of each topic")
    assert probe.call("/recorder/stop")[0]
    with AnyReader([folder]) as reader:
        found = {topic: reader.topics[topic].connections[0].ext.offered_qos_profiles for topic in offers}
    with next(folder.glob("*.mcap")).open("rb") as stream:
        channels = {channel.topic: channel for channel in make_reader(stream).get_summary().channels.values()}
    for topic, profiles in offers.items():
        assert len(found[topic]) == len(profiles), topic
        in_file = yaml.safe_load(channels[topic].metadata["offered_qos_profiles"])
        wanted = sorted(
            (
                qos.reliability.name,
                qos.durability.name,
                qos.liveliness.name if qos is coarse else "AUTOMATIC",
                *(qos_time.nanoseconds for qos_time in (qos.deadline, qos.lifespan) if qos is coarse),
            )
            for qos in profiles
        )
        said = sorted(
            (
                qos.reliability.name,
                qos.durability.name,
                qos.liveliness.name,
                *(10**9 * t.sec + t.nsec for t in (qos.deadline, qos.lifespan) if t.sec < 10**9),
            )
            for qos in found[topic]
        )
        assert said == wanted, topic
        assert sorted(qos["reliability"].upper() for qos in in_file) == [row[0] for row in wanted]


def read_recording_urdf(folder: Path) -> str:
    with AnyReader([folder]) as reader:
        chosen = [c for c in reader.connections if c.topic == "/robot_description"]
        ((connection, _, raw),) = reader.messages(chosen)
        return reader.deserialize(raw, connection.msgtype).data


def test_a_publisher_that_offers_less_joins_a_topic(processes, probe, tmp_path):
    from std_msgs.msg import String

    first = probe.node.create_publisher(String, "/talk", STREAM)
    processes.node("recorder", f"directory:={tmp_path}", "start_immediately:=true")
    probe.wait_for(lambda: first.get_subscription_count() == 1, "subscribed")
    coarse = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    second = probe.node.create_publisher(String, "/talk", coarse)
    probe.wait_for(lambda: second.get_subscription_count() == 1, "subscribed to both")
    before = received(probe, "/talk")

    def heard():
        second.publish(String(data="coarse"))
        return received(probe, "/talk") > before

    probe.wait_for(heard, "messages of the second publisher")


def test_killed_while_recording_it_loses_at_most_the_last_second(processes, probe, tmp_path):
    recorder = processes.node("recorder", f"directory:={tmp_path}")
    folder = started(probe)
    send(processes, 500, 100_000)
    probe.wait_for(lambda: received(probe, "/joint_states") > 1500, "three seconds of data")
    killed_at = time.time()
    recorder.send_signal(signal.SIGKILL)
    recorder.wait()
    assert not (folder / "metadata.yaml").exists()
    recording = read_recording(folder)
    last = recording.start_ns * 1e-9 + recording.time[-1]
    assert killed_at - last < 1.0
    assert np.array_equal(np.diff(recording.position[:, 0]), np.ones(len(recording.time) - 1))
    assert len(recording.time) > 1000


def test_what_a_killed_recorder_left_can_be_identified(processes, probe, tmp_path):
    pytest.importorskip("clarabel", reason="needs clarabel in the processes that identify (README.md, ROS 2 Jazzy)")
    whole = tmp_path / "whole.mcap"
    write_recording(whole, small_arm.recording())
    recorder = processes.node("recorder", f"directory:={tmp_path}")
    folder = started(probe)
    player = processes.python("-m", "graph_arm", stdin=subprocess.PIPE)
    player.stdin.write(f"play {whole}\n".encode())
    player.stdin.flush()
    probe.wait_for(lambda: received(probe, "/joint_states") >= 3200, "all joint states")
    probe.spin(1.0)
    recorder.kill()
    recorder.wait()
    assert len(read_recording(folder).time) == 3200
    words = ("identify", str(folder), "--out", str(tmp_path / "result"), "--quiet", "--friction", "coulomb-viscous")
    command = processes.python("-m", "spacearm_ident.cli.main", *words)
    assert command.wait(120) == 0, output(command)
    model = load_model(tmp_path / "result" / "model.yaml")
    found = dict(zip((p.name for p in model.model.parameters), model.parameters))
    for k, joint in enumerate(small_arm.JOINTS):
        assert found[f"f_c[{joint}]"] == pytest.approx(small_arm.COULOMB[k], rel=0.05)
        assert found[f"k_v1[{joint}]"] == pytest.approx(small_arm.VISCOUS[k], rel=0.1)


def test_replies_name_what_is_wrong(processes, probe, tmp_path):
    place = tmp_path / "file"
    recorder = processes.node("recorder", f"directory:={place}")
    probe.wait_for(lambda: "recorder" in probe.statuses, "the recorder")
    place.write_text("")  # The place was good when the node started, and is no longer.
    success, reply = probe.call("/recorder/start")
    assert not success and "cannot be written" in reply and str(place) in reply
    probe.wait_for(lambda: probe.level("recorder") == 2, "an ERROR on /diagnostics")
    assert "cannot be written" in probe.statuses["recorder"].message
    place.unlink()
    folder = started(probe)
    success, reply = probe.call("/recorder/start")
    assert not success and reply == f"already recording to {folder}; stop first"
    assert probe.call("/recorder/stop")[0]
    assert probe.call("/recorder/stop") == (False, "not recording; start first")
    assert end(recorder) == 0


@pytest.mark.parametrize(("node", "parameter"), [("recorder", "directory"), ("identifier", "result_directory")])
@pytest.mark.parametrize("place", ["file", "file/below", "/proc/nope"])
def test_a_place_that_cannot_be_written_ends_the_start_with_exit_code_2(processes, tmp_path, node, parameter, place):
    (tmp_path / "file").write_text("kept")
    started = processes.node(node, f"{parameter}:={tmp_path / place}")
    assert started.wait(60) == 2
    (line,) = output(started).splitlines()
    assert line.startswith(f"parameter {parameter}: {tmp_path / place} cannot be written (")
    assert (tmp_path / "file").read_text() == "kept"


def test_a_place_that_is_not_there_yet_is_made_for_the_first_bag(processes, probe, tmp_path):
    place = tmp_path / "some" / "where"
    processes.node("recorder", f"directory:={place}")
    probe.wait_for(lambda: "recorder" in probe.statuses, "the recorder")
    assert not (tmp_path / "some").exists()
    assert started(probe).parent == place


def test_an_interrupt_finishes_the_bag(processes, probe, tmp_path):
    recorder = processes.node("recorder", f"directory:={tmp_path}")
    folder = started(probe)
    send(processes, 200, 100)
    probe.wait_for(lambda: received(probe, "/joint_states") == 100, "all received")
    assert end(recorder, signal.SIGTERM) == 0
    assert "Traceback" not in output(recorder)
    assert len(read_recording(folder).time) == 100
    with AnyReader([folder]) as reader:
        assert reader.topics["/joint_states"].msgcount == 100


def test_a_full_disk_ends_the_bag_and_not_the_node(processes, probe, tmp_path):
    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    recorder = processes.node("recorder", f"directory:={tmp_path}", preexec_fn=small_files)
    folder = started(probe)
    send(processes, 1000, 100_000)
    probe.wait_for(lambda: probe.level("recorder") == 2, "an ERROR on /diagnostics")
    assert "recording ended early" in probe.statuses["recorder"].message
    assert probe.values("recorder")["recording"] == "false"
    early = f"recording ended early: {folder} is incomplete: cannot be written (File too large)"
    said = [line for line in output(recorder).splitlines() if early in line]
    assert len(said) == 1 and "[ERROR]" in said[0] and "start the recorder with another directory" in said[0]
    success, reply = probe.call("/recorder/stop")
    assert not success and "incomplete" in reply and str(folder) in reply
    assert len(read_recording(folder).time) > 100  # what was written before is kept
    assert f"({sum(1 for _ in messages(folder))} of the " in reply

    places = set(tmp_path.iterdir())
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (0, 60_000))
    success, reply = probe.call("/recorder/start")
    assert not success and "cannot be written (File too large)" in reply
    assert set(tmp_path.iterdir()) == places  # no empty bag

    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
    again = started(probe)  # and it can start anew
    assert again != folder
    probe.wait_for(lambda: output(recorder).count("recording ended early") == 2, "the end of the second")
    assert end(recorder) == 0
    last = output(recorder).splitlines()[-1]
    assert "[ERROR]" in last and f"{again} is incomplete" in last


def test_a_buffer_that_is_full_drops_and_counts_and_never_waits(tmp_path):
    writer = BackgroundWriter(tmp_path / "bag", buffer_bytes=1000)
    topic = Topic("/x", STRING)
    payload = cdr.encode_string("x" * 92)
    kept = [writer.put(topic, k + 1, payload, k + 1) for k in range(200)]
    writer.close()
    assert writer.failure is None
    assert sum(kept) == writer.messages and kept.count(False) == writer.dropped
    assert kept[0] and writer.dropped > 0 and writer.fill == 0
    with Reader(tmp_path / "bag") as reader:
        assert [time_ns - 1 for _, time_ns, _ in reader.messages()] == [k for k, yes in enumerate(kept) if yes]


def test_a_type_without_definition_is_recorded_by_name(tmp_path):
    assert definition_text("sensor_msgs/msg/JointState", [tmp_path]) is None
    writer = BackgroundWriter(tmp_path / "bag")
    topic = Topic("/x", MessageType("own_msgs/msg/Thing", ""), described=False)
    assert writer.put(topic, 1, b"\0\1\0\0abcd", 1)
    writer.close()
    with next((tmp_path / "bag").glob("*.mcap")).open("rb") as stream:
        ((schema, _, message),) = make_reader(stream).iter_messages()
    assert (schema.name, schema.encoding, message.data) == ("own_msgs/msg/Thing", "", b"\0\1\0\0abcd")
    with Reader(tmp_path / "bag") as reader:
        assert [connection.msgtype for connection in reader.connections] == ["own_msgs/msg/Thing"]


def test_definitions_follow_their_dependencies(tmp_path):
    folder = tmp_path / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Whole.msg").write_text(
        "# A part.\nPart[<=3] parts\nint8 N=3 # Not a field\nother_msgs/Far far\nPart one\n"
    )
    (folder / "Part.msg").write_text("string<=5 name\n")
    assert definition_text("own_msgs/msg/Whole", [tmp_path]) is None  # other_msgs is missing
    (tmp_path / "other_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "other_msgs" / "msg" / "Far.msg").write_text("bool yes\n")
    text = definition_text("own_msgs/msg/Whole", [tmp_path])
    assert [line for line in text.splitlines() if line.startswith("MSG: ")] == [
        "MSG: own_msgs/Part",
        "MSG: other_msgs/Far",
    ]
    installed = definition_text("sensor_msgs/msg/JointState")
    assert "MSG: std_msgs/Header" in installed and "MSG: builtin_interfaces/Time" in installed
