"""Set-points at 1 kHz over real DDS: rate held, set-points sent late, CPU of the trajectory node and the recorder.

    python bench/bench_publish.py [--busy] [--seconds 10]

A second process publishes /joint_states at 1 kHz; the recorder writes everything to a bag, which is then
counted. `--busy` keeps one core busy meanwhile. Run it on a ROS domain of your own (ROS_DOMAIN_ID).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

from bench_bus import cpu_s  # noqa: E402
from live_nodes import Probe, Processes, end  # noqa: E402
from simulated_arm import CONFIG, paper_limits  # noqa: E402

from spacearm_ident.excitation.trajectory import Trajectory, random_feasible  # noqa: E402
from spacearm_ident.excitation.trajectory_file import save_trajectory  # noqa: E402
from spacearm_ident.recording.bag import messages  # noqa: E402

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
FEEDBACK = """
import numpy as np, rclpy
from sensor_msgs.msg import JointState
import time
from spacearm_ident.canbus.realtime import Pacer, prepare_thread
from spacearm_ident.nodes.joint_stream import JointStateWriter
from spacearm_ident.nodes.runtime import STREAM
rclpy.init()
publisher = rclpy.create_node("feedback").create_publisher(JointState, "/joint_states", STREAM)
writer, zeros = JointStateWriter([f"joint_{i}" for i in range(1, 7)], "position", "velocity"), np.zeros(6)
prepare_thread()
pacer = Pacer(1e-3)
while True:
    pacer.wait()
    publisher.publish(writer.payload(time.time_ns(), zeros, zeros))
"""


def recorded(bag: Path, topic: str) -> np.ndarray:
    """Publish times of a topic's messages, s."""
    return 1e-9 * np.array([m.publish_time_ns for m in messages(bag, lambda channel: channel.topic == topic)])


def measure(folder: Path, seconds: float, busy: bool) -> None:
    periods = max(1, round(seconds / 5.0))
    series = random_feasible(JOINTS, paper_limits(), seed=1, fundamental_hz=0.2, periods=periods)
    save_trajectory(Trajectory(JOINTS, (series,)), folder / "excitation.yaml")
    processes, probe = Processes(folder), Probe()
    try:
        recorder = processes.node("recorder", f"directory:={folder}", "start_immediately:=true")
        processes.python("-c", FEEDBACK)
        if busy:
            processes.python("-c", "while True: pass")
        arguments = (f"trajectory_file:={folder / 'excitation.yaml'}", f"arm:={CONFIG / 'paper_arm.yaml'}")
        trajectory = processes.node("trajectory", *arguments, "require_enabled:=false")
        probe.wait_for(lambda: float(probe.values("trajectory").get("feedback_age_s", "inf")) < 0.1, "feedback")
        shares = {}
        for phase in ("idle", "streaming"):
            if phase == "streaming":
                print(probe.call("/excitation/start")[1])
                probe.wait_for(lambda: probe.values("trajectory").get("state") == "running", "the periodic part")
            before, begun = [cpu_s(p.pid) for p in (trajectory, recorder)], time.monotonic()
            time.sleep(seconds if phase == "streaming" else 4.0)
            elapsed = time.monotonic() - begun
            shares[phase] = [(cpu_s(p.pid) - b) / elapsed for p, b in zip((trajectory, recorder), before, strict=True)]
        probe.wait_for(lambda: probe.values("trajectory").get("state") == "done", "the end", 120.0)
        probe.spin(2.5)
        figures = probe.values("trajectory")
        lost = [probe.values("recorder: topics")[topic] for topic in ("/joint_command", "/joint_states")]
        end(recorder)
        sent_s, states_s = (recorded(next(folder.glob("run_*/")), t) for t in ("/joint_command", "/joint_states"))
        print(f"{figures['set_points']} set-points published, {figures['late']} of them late, {len(sent_s)} in the bag")
        print(f"lateness p99 {float(figures['late_p99_s']) * 1e6:.0f} µs")
        for name, times in (("set-points", sent_s), ("joint states", states_s)):
            print(
                f"{name}: mean rate {(len(times) - 1) / np.ptp(times):.2f} Hz by publish time, {len(times)} in the bag"
            )
        print(f"recorder: {lost}")
        for phase, (node, writer) in shares.items():
            print(f"CPU {phase}: trajectory {node:.1%}, recorder {writer:.1%} of a core")
    finally:
        probe.close()
        processes.end()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--busy", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder), options.seconds, options.busy)


if __name__ == "__main__":
    main()
