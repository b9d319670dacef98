"""`simulated_arm`: six CiA 402 drives and the paper's arm behind them, on the CAN buses of the configuration.

Everything happens on the buses, in a thread of its own; the graph only sees `/diagnostics` (1 Hz). For tests,
any participant of a bus can make a drive fail through its object 0x2F00 (see `simulation.drives.faults`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from ..canbus.realtime import BESIDE_THE_CYCLE
from ..config import config_path
from ..driver.arm_can import load_arm_can
from ..simulation.arm_process import ArmProcess, live_arm
from ..simulation.thermal import COLDEST, WARMEST
from .runtime import Level, LiveNode, Status, run

_QUIET_S = 0.2
"""A bus without SYNC for so many cycles has no master any more."""
_MASTER_LEAVES_S = 5.0
"""Longest wait for the master to leave: the driver stops a moving arm within 3 s, and then takes the power off."""


class SimulatedArm(LiveNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__("simulated_arm")
        model = self.file_parameter("model", "model file the arm obeys; empty: config/paper_arm_model.yaml")
        noise = self.parameter("noise", 1.0, "times the usual noise of the current sensors; 0: none", low=0.0, high=1e3)
        seed = self.parameter("seed", 0, "of the noise", low=0, high=2**32 - 1)
        start = self.parameter(
            "start_position", [0.0], "joint angles at power-on (rad); a single one is for all joints"
        )
        ambient = self.parameter(
            "ambient_temperature",
            20.0,
            "of the surroundings, and of the arm at power-on (degC)",
            low=COLDEST,
            high=WARMEST,
        )
        conceal = self.file_parameter("conceal", "file of physics that the model lacks; empty: none")
        priority = self.parameter("realtime_priority", 60, "SCHED_FIFO priority of the drives; 0: none", low=0, high=99)
        file = self.file_parameter("can_config", "CAN YAML of the arm; empty: config/paper_arm_can.yaml")
        config = load_arm_can(file or config_path("paper_arm_can.yaml"))
        self.hardware_id = f"{config.arm.name} (simulated)"
        arm = live_arm(
            config,
            model or config_path("paper_arm_model.yaml"),
            noise=noise,
            seed=seed,
            position=start,
            ambient=ambient,
            conceal=conceal,
        )
        self.refuse_simulated_time("the simulated drives keep the time of this machine")
        self._buses = ", ".join(f"{address.interface} {address.channel}" for address in config.buses)
        self._process = ArmProcess(config, arm, priority=priority)
        self._process.start()

    def diagnose(self) -> Sequence[Status]:
        """Drive states and what the process could not keep up with."""
        process, network = self._process, self._process.network
        if process.failure is not None:
            self.get_logger().fatal(process.failure)
            self.exit_code = 1
        values: dict[str, object] = {
            "physics_steps": network.steps,
            "physics_steps_skipped": network.skipped,
            "sync_unanswered": network.unanswered,
            "frames_unsent": network.unsent,
        }
        values |= {f"node_{drive.node_id}": drive.state.label for drive in network.drives}
        if process.failure is not None:
            return (Status(Level.ERROR, process.failure, values),)
        if process.warning is not None:
            return (Status(Level.WARN, process.warning, values),)
        return (Status(Level.OK, "running", values),)

    def readiness(self) -> str | None:
        """Which drives it is."""
        return f"{len(self._process.network.drives)} drives of {self.hardware_id} on {self._buses}"

    def close(self) -> None:
        """Switch the drives off, once their master has left: Ctrl-C reaches both, and the driver must stop the arm."""
        end = time.monotonic() + _MASTER_LEAVES_S
        while self._process.network.quiet_s() < _QUIET_S and time.monotonic() < end:
            time.sleep(_QUIET_S)
        self._process.close()


def main(arguments: Sequence[str]) -> int:
    """Run the node; returns the exit code."""
    return run(SimulatedArm, arguments, priority=BESIDE_THE_CYCLE)
