"""Helper of the tests: simulated arm and driver as processes, and a probe that streams, listens and injects faults."""

import math
import os
import struct
import threading
import time
from pathlib import Path

import can
import numpy as np
import yaml
from domains import domain
from live_nodes import Probe, Processes

from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.nodes.joint_stream import JointStateWriter
from spacearm_ident.recording.cdr import decode_joint_states

CONFIG = Path(__file__).parent.parent / "config"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
CHANNELS = ("arm0", "arm1")
FREEZE, EMERGENCY, CORRUPT = 1, 2, 3
LEAD_S = 0.6
"""Set-points are sent so long before they are due: this process may be held up, the tests are not about that."""
PERIOD_S = 0.002
"""The arm's cycle. With 1 ms five nodes, and the kernel's work for them, wanted 2.1 of two cores where an addition in
Python took 65 ns, and were held up again and again; these tests are not about that. The demo begins with 1 ms."""


def generous_config(folder: Path, **cycle: float) -> Path:
    """The arm's CAN YAML, with a period and limits that this machine can keep, and what else its `cycle` is to say."""
    data = yaml.safe_load((CONFIG / "paper_arm_can.yaml").read_text())
    data["arm"] = str(CONFIG / "paper_arm.yaml")
    data["cycle"] |= {"period_s": PERIOD_S, "heartbeat_timeout_s": 1.5, "stale_feedback_s": 0.5} | cycle
    path = folder / "can.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def smooth(t: float, amplitude: float = 0.06, period: float = 2.0) -> float:
    """Out and back once a period, at rest (to the second derivative) at both ends."""
    s = np.sin(np.pi * t / period)
    return float(amplitude * s**4)


class BusWatch:
    """What goes over both buses while it is open, as one more participant sees it."""

    def __enter__(self):
        self._frames = [[] for _ in CHANNELS]
        self._until_s = math.inf
        self._buses = [LocalBus(channel) for channel in CHANNELS]
        self._threads = [threading.Thread(target=self._read, args=(k,)) for k in range(len(CHANNELS))]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        # Threads that are behind read on to this moment.
        self._until_s = time.time()
        for thread, bus in zip(self._threads, self._buses):
            thread.join()
            bus.shutdown()

    def _read(self, number):
        bus, frames = self._buses[number], self._frames[number]
        while True:
            message = bus.recv(0.05)
            if (time.time() if message is None else message.timestamp) > self._until_s:
                return
            if message is not None and not message.is_error_frame:
                frames.append((message.timestamp, message.arbitration_id, bytes(message.data)))

    def frames(self, bus, *can_ids):
        """Time (s) and data of the frames with one of these identifiers, in the order they were sent."""
        return sorted((at, data) for at, can_id, data in tuple(self._frames[bus]) if can_id in can_ids)

    def set_points(self, joint):
        """Time, target (counts) and controlword of each set-point of a joint."""
        return [(at, *struct.unpack("<iH", data)) for at, data in self.frames(joint // 3, 0x201 + joint)]

    def feedback(self, joint):
        """Time and position (counts) of each sound feedback of a joint."""
        frames = self.frames(joint // 3, 0x181 + joint)
        return [(at, struct.unpack_from("<i", data)[0]) for at, data in frames if len(data) == 8]

    def syncs_until_stop(self, joint, cause_s):
        """How many SYNCs of its bus lie between a moment and the first quick-stop word to a joint's drive."""
        words = [at for at, _, word in self.set_points(joint) if at > cause_s and not word & 0x04]
        assert words, f"joint_{joint + 1} was never told to stop"
        return sum(cause_s < at < words[0] for at, _ in self.frames(joint // 3, 0x080))


class DrivenArm:
    """Both processes, and the probe."""

    def __init__(self, folder: Path, **cycle: float):
        os.environ["ROS_DOMAIN_ID"] = domain("driven arm")
        os.environ["SPACEARM_RUNTIME_DIR"] = str(folder / "run")
        self.can_config = generous_config(folder, **cycle)
        self.processes = Processes(folder)
        self.probe = Probe()
        from sensor_msgs.msg import JointState

        from spacearm_ident.nodes.runtime import STREAM

        self.payloads, self.currents = [], []
        node = self.probe.node
        node.create_subscription(JointState, "/joint_states", self.payloads.append, STREAM, raw=True)
        node.create_subscription(JointState, "/motor_currents", self.currents.append, STREAM, raw=True)
        self._command = node.create_publisher(JointState, "/joint_command", STREAM)
        self._writer = JointStateWriter(JOINTS, "position")
        self.start_arm()
        self.start_driver()

    def start_arm(self, position=(0.0,)):
        start = "[" + ", ".join(f"{angle:.6f}" for angle in position) + "]"
        self.arm = self.processes.node("simulated_arm", f"can_config:={self.can_config}", f"start_position:={start}")

    def start_driver(self):
        # What an earlier driver said last must not be taken for the new one's words.
        self.probe.statuses.pop("canopen_driver", None)
        self.driver = self.second_driver()

    def second_driver(self):
        return self.processes.node(
            "canopen_driver", f"can_config:={self.can_config}", "set_point_delay_s:=0.4", "connect_timeout_s:=60.0"
        )

    def close(self):
        self.probe.close()
        self.processes.end()

    def call(self, name, data=None):
        return self.probe.call(name, data)

    # What the driver says -----------------------------------------------------------------------------

    @property
    def values(self):
        return self.probe.values("canopen_driver")

    @property
    def fault(self):
        return self.values.get("fault", "")

    @property
    def enabled(self):
        return self.values.get("operation_enabled") == "true"

    def drive_states(self):
        return {name: self.values.get(name, "") for name in JOINTS}

    def wait_for(self, condition, what):
        return self.probe.wait_for(condition, f"{what}; the driver says {self.values}")

    def healthy(self):
        """Out of whatever the last test left, enabled."""
        if self.arm.poll() is not None:
            self.start_arm()
            # Only a new driver takes over an arm that stands elsewhere than the one before.
            if self.driver.poll() is None:
                self.driver.terminate()
                self.driver.wait()
        if self.driver.poll() is not None:
            self.start_driver()
        self.wait_for(lambda: self.values.get("connection") == "connected", "a connection")
        if self.fault:
            self.probe.must("/driver/recover")
        self.probe.must("/driver/enable", True)
        self.wait_for(lambda: self.enabled and not self.fault, "enabled")

    # Motion -------------------------------------------------------------------------------------------

    def home(self, seconds=2.5):
        """Back to where the tests begin, if one before this has failed on its way: they count on a pose near zero,
        where the servo's position error is small: it has no integrator."""
        away = self.position()
        if np.abs(away).max() < 0.08:
            return
        first = self.stream(seconds, lambda t: -away * np.sin(np.pi * min(t, seconds) / (2 * seconds)) ** 2)
        end = first + round(1e9 * (seconds + LEAD_S))
        self.wait_for(lambda: self.fault or self.states(self.payloads[-1:])[0][0] > end, "the way home")

    def states(self, payloads=None):
        """Stamps (ns), positions and efforts so far."""
        blocks, bad = decode_joint_states(self.payloads if payloads is None else payloads)
        assert not bad and len(blocks) == 1
        return blocks[0].stamp_ns, blocks[0].position, blocks[0].effort

    def position(self):
        count = len(self.payloads)
        self.wait_for(lambda: len(self.payloads) > count, "joint states")
        return self.states(self.payloads[-1:])[1][0]

    def at_rest(self):
        first = self.position()
        self.probe.spin(0.1)
        return np.abs(self.position() - first).max() < 1e-4

    def send(self, stamp_ns, position):
        self._command.publish(self._writer.payload(stamp_ns, np.asarray(position, dtype=float)))

    def stream(self, seconds, motion=smooth, until=lambda: False, also=lambda k, q: q):
        """Stream `start + motion(t)` for all joints; returns the stamp of the first set-point."""
        start, first = self.position(), time.time_ns() + 20_000_000
        k, count = 0, round(1e3 * seconds) + 1
        while k < count and not until():
            while k < count and first + k * 1_000_000 < time.time_ns() + LEAD_S * 1e9:
                self.send(first + k * 1_000_000, also(k, start + motion(1e-3 * k)))
                k += 1
            self.probe.spin(0.02)
        return first

    # Faults -------------------------------------------------------------------------------------------

    def inject(self, joint, sub, value):
        """Write object 0x2F00 of a joint's drive, as another participant of its bus."""
        size = 1 if sub == CORRUPT else 2
        data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, 0x2F00, sub, value)
        self.send_frame(joint // 3, 0x600 + joint + 1, data)

    def send_frame(self, bus, can_id, data):
        with LocalBus(CHANNELS[bus]) as other:
            other.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            self.probe.spin(0.1)
