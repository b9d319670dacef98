"""`canopen_driver`: the arm on the ROS graph.

Publishes `/joint_states` and `/motor_currents` with every complete cycle (1 kHz, stamped at SYNC; no
velocity, which the drives do not send and a difference would only pretend), `/joint_temperatures`, the latched
`/robot_description`, `/diagnostics`. Takes `/joint_command`: positions, stamped with the time they are meant
for, under the rules in `driver.set_points`. Services: `/driver/enable`, `/driver/halt`, `/driver/recover`,
and `/driver/resume`, which recovers and enables where a held-up cycle alone was the cause of a stop (`driver.resume`).

The main thread serves ROS, the cyclic thread of `ArmDriver` the buses; it publishes its samples itself, as
prepared bytes.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Sequence

from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from ..canbus.pdo import Feedback
from ..canbus.realtime import BESIDE_THE_CYCLE
from ..config import config_path
from ..driver.arm_can import load_arm_can
from ..driver.arm_driver import ArmDriver
from ..driver.safety import Fault, Rule
from ..driver.status import DriverStatus, Phase
from ..errors import UserError
from .joint_stream import JointStateReader, JointStateWriter
from .runtime import LATCHED, STREAM, Level, LiveNode, Status, run

_WATCH_S = 0.05
_LEVELS = {Phase.CONNECTING: Level.WARN, Phase.FAULT: Level.ERROR}


class CanopenDriver(LiveNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__("canopen_driver")
        delay = self.parameter(
            "set_point_delay_s", 0.2, "set-points are played this long after their stamp (s)", low=0.005, high=0.5
        )
        priority = self.parameter("realtime_priority", 60, "SCHED_FIFO priority of the cycle; 0: none", low=0, high=99)
        temperature_hz = self.parameter(
            "temperature_hz", 1.0, "temperature readings a joint and second", low=0.1, high=10.0
        )
        self._patience = self.parameter(
            "connect_timeout_s",
            30.0,
            "give up (exit code 2) without drives after so long (s); 0: never",
            low=0.0,
            high=86400.0,
        )
        file = self.file_parameter("can_config", "CAN YAML of the arm; empty: config/paper_arm_can.yaml")
        self._config = load_arm_can(file or config_path("paper_arm_can.yaml"))
        self.hardware_id = self._config.arm.name
        joints = self._config.limits.joints
        self._states = self.create_publisher(JointState, "joint_states", STREAM)
        self._currents = self.create_publisher(JointState, "motor_currents", STREAM)
        self._temperatures = self.create_publisher(Temperature, "joint_temperatures", 10)
        self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=self._config.arm.urdf))
        self._state_writer = JointStateWriter(joints, "position", "effort")
        self._current_writer = JointStateWriter(joints, "effort")
        self._reader = JointStateReader(joints)
        self._shown: tuple[Phase, Fault | None] | None = None
        self._reconnections = 0
        self._logged: set[str] = set()
        self._closing = threading.Event()
        self._driver = ArmDriver(
            self._config,
            self._publish,
            self._publish_temperature,
            delay=delay,
            priority=priority,
            temperature_hz=temperature_hz,
        )
        self.create_subscription(JointState, "joint_command", self._command, STREAM, raw=True)
        driver = self._driver
        self.offer_switch("driver/enable", lambda on: self._said(driver.enable if on else driver.disable))
        self.offer("driver/halt", lambda: self._said(driver.halt))
        self.offer("driver/recover", lambda: self._said(driver.recover))
        self.offer("driver/resume", lambda: self._said(driver.resume))
        self._waiting_s = 0.0
        self.refuse_simulated_time("drives keep the time of this machine, and so do the stamps here")
        self.every(_WATCH_S, self._watch)
        self._driver.start()

    def diagnose(self) -> Sequence[Status]:
        """State, reason, counters, loads."""
        status = self._driver.status()
        if status.phase is not Phase.ENABLED:
            # The collector is off in this process (real time); what is young is collected while it may be.
            gc.collect()
        message = str(status.fault) if status.fault else status.phase.value
        if status.phase is Phase.CONNECTING:
            message = status.connection
        if status.warnings and status.phase not in _LEVELS:
            message = f"{message}; warning: {'; '.join(status.warnings)}"
        level = _LEVELS.get(status.phase, Level.WARN if status.warnings else Level.OK)
        return (Status(level, message, _values(status)),)

    def readiness(self) -> str | None:
        """Once the drives answer."""
        if self._driver.phase is Phase.CONNECTING:
            return None
        enable = self.resolve_service_name("driver/enable")
        return f"the drives of {self.hardware_id} are connected, and without power until {enable}"

    def close(self) -> None:
        """Stop the arm, then leave the buses."""
        self._driver.close()

    def _publish(self, stamp_ns: int, feedback: Feedback) -> None:
        self._states.publish(self._state_writer.payload(stamp_ns, feedback.position, feedback.torque))
        self._currents.publish(self._current_writer.payload(stamp_ns, feedback.current))

    def _publish_temperature(self, joint: int, celsius: float, stamp_ns: int) -> None:
        message = Temperature(temperature=celsius)
        message.header.frame_id = self._config.limits.joints[joint]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        self._temperatures.publish(message)

    def _command(self, payload: bytes) -> None:
        try:
            self._driver.command(*self._reader.read(payload))
        except UserError as error:
            if self._driver.phase is Phase.ENABLED:
                self._driver.trip(Fault(Rule.SET_POINT, str(error)))

    def _said(self, act: Callable[[], str]) -> str:
        """Act, and publish what came of it before the caller is answered: they may rely on others knowing it."""
        try:
            return act()
        finally:
            self.publish_diagnostics()

    def _watch(self) -> None:
        """Show changes at once; give up where it is hopeless."""
        phase, fault = shown = self._driver.phase, self._driver.fault
        if shown != self._shown:
            before, self._shown = self._shown, shown
            self.publish_diagnostics()
            if fault is not None:
                self.get_logger().error(f"arm stopped: {fault}")
            elif before is not None and before[1] is not None:
                # Or an old stop would be the last that is known of this node, and taken for the cause of its end.
                self.get_logger().info(f"arm recovered, {phase.value} now; it was stopped by: {before[1]}")
        if self._driver.reconnections != self._reconnections:
            self._reconnections = self._driver.reconnections
            self.get_logger().warning(self._driver.connection)
        self._log_once()
        self._waiting_s = self._waiting_s + _WATCH_S if phase is Phase.CONNECTING else 0.0
        refused = self._driver.refused
        if refused is None and self._patience and self._waiting_s > self._patience:
            doing = f", {self._driver.doing}" if self._driver.doing else ""
            refused = f"no connection within {self._patience:g} s (connect_timeout_s): {self._driver.connection}{doing}"
        if refused is not None:
            self.get_logger().fatal(refused)
            self.exit_code = 2

    def _log_once(self) -> None:
        """What the drives said when they were connected, or since: each once, however often they are."""
        said = [(Level.WARN, text) for text in self._driver.findings]
        said += [(Level.OK, text) for text in tuple(self._driver.notes)]
        for level, text in said:
            if text not in self._logged:
                self._logged.add(text)
                self.log(level, text)


def _values(status: DriverStatus) -> dict[str, object]:
    p50, p99, p999 = (1e6 * late for late in status.lateness_s)
    values: dict[str, object] = {
        "operation_enabled": status.phase is Phase.ENABLED,
        "state": status.phase.value,
        "fault": str(status.fault) if status.fault else "",
        "resumable": status.resumable,
        "connection": status.connection,
        "samples": status.samples,
        "cycles": status.cycles,
        "missed_cycles": status.missed,
        "incomplete_cycles": status.incomplete,
        "late_frames": status.late_frames,
        "malformed_frames": status.malformed,
        "lateness_p50_us": p50,
        "lateness_p99_us": p99,
        "lateness_p999_us": p999,
        "set_points": status.set_points,
        "set_points_buffered_s": status.buffered_s,
        "stalls_bridged": status.stalls,
        "playback_lag_s": status.lag_s,
        "temperature_failures": status.temperature_failures,
        "reconnections": status.reconnections,
        "warnings": "; ".join(status.warnings),
    }
    values |= {f"bus_{number}_load": str(load) for number, load in enumerate(status.loads)}
    values |= {joint: state.label if state else "unknown" for joint, state in status.states.items()}
    return values


def main(arguments: Sequence[str]) -> int:
    """Run the node; returns the exit code."""
    return run(CanopenDriver, arguments, priority=BESIDE_THE_CYCLE)
