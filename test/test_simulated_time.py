"""`use_sim_time`: who heeds it (recorder; the trajectory node in its own tests), who says that it does not."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (pip install '.[ros]')")

from live_nodes import LIVE, output
from mcap.reader import make_reader

pytestmark = LIVE

EPOCH_S = 1000


def tell(probe, publisher, seconds):
    from rosgraph_msgs.msg import Clock

    message = Clock()
    message.clock.sec = seconds
    publisher.publish(message)
    probe.spin(0.02)


def test_a_recording_under_simulated_time_has_the_log_times_of_the_graphs_clock(graph, tmp_path):
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String

    processes, probe = graph
    clock = probe.node.create_publisher(Clock, "/clock", 10)
    words = probe.node.create_publisher(String, "/words", 10)
    processes.node("recorder", f"directory:={tmp_path / 'bags'}", "use_sim_time:=true")
    reply = probe.must("/recorder/start")
    # The clock stands, and what is on the graph is recorded none the less: no watch hangs on it.
    end = time.monotonic() + 60.0
    while time.monotonic() < end and words.get_subscription_count() == 0:
        tell(probe, clock, EPOCH_S)
    for _ in range(50):
        tell(probe, clock, EPOCH_S)
        words.publish(String(data="then"))
    assert probe.call("/recorder/stop")[0]
    (bag,) = Path(reply.removeprefix("recording to ")).glob("*.mcap")
    with bag.open("rb") as stream:
        times = [m.log_time for _, channel, m in make_reader(stream).iter_messages() if channel.topic == "/words"]
    assert times and set(times) == {EPOCH_S * 10**9}


@pytest.mark.parametrize("name", ["canopen_driver", "simulated_arm"])
def test_who_keeps_the_time_of_this_machine_says_so(graph, tmp_path, monkeypatch, name):
    monkeypatch.setenv("SPACEARM_RUNTIME_DIR", str(tmp_path / "run"))
    processes, probe = graph
    node = processes.node(name, "use_sim_time:=true")
    probe.wait_for(lambda: "use_sim_time is not heeded" in output(node), "a word on it")
    # Its watches go on although there is no /clock at all.
    probe.wait_for(lambda: name in probe.statuses, "diagnostics")
    assert probe.values(name)
