"""`spacearm demo`: the main job on the simulated arm, on this machine, nothing needed beforehand."""

from __future__ import annotations

import argparse
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config import config_path
from ..dynamics.arm import load_arm
from ..errors import UserError
from ..excitation.trajectory import MotionLimits, Trajectory, random_feasible
from ..excitation.trajectory_file import save_trajectory
from ..report.folder import REPORT
from ..report.store import load_result
from . import common
from .identify import summary

DESCRIPTION = """
The whole chain on this machine: a simulated six-joint CANopen arm, the driver, the trajectory node, the recorder and
the identifier, each a process, over real CAN frames and real DDS. One run to identify the arm, one with other
coefficients to validate, then the report. Everything is written to DIR: result, recordings and each node's log.
"""
ARM = "paper_arm.yaml"
IDENTIFIED_S = 120.0


@dataclass(frozen=True)
class _Plan:
    """One run of the demo."""

    name: str
    seed: int
    periods: int
    fundamental_hz: float


PLANS = (_Plan("excitation", 1, 5, 0.1), _Plan("validation", 2, 3, 0.1))
FAST_PLANS = (_Plan("excitation", 1, 3, 0.2), _Plan("validation", 2, 2, 0.2))


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser("demo", help="the whole chain on the simulated arm", description=DESCRIPTION)
    command.add_argument(
        "--out", type=Path, default=Path("demo_result"), metavar="DIR", help="where to (default demo_result)"
    )
    command.add_argument("--fast", action="store_true", help="shorter runs: a check of the chain, not of the numbers")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Start the nodes, call their services, wait for the result."""
    if importlib.util.find_spec("rclpy") is None:
        raise UserError(
            "the demo needs ROS 2 (rclpy): source a Jazzy setup file, or install spacearm_ident with its extra 'ros'"
        )
    options.out.mkdir(parents=True, exist_ok=True)
    plans = FAST_PLANS if options.fast else PLANS
    files = [_write_trajectory(plan, options.out) for plan in plans]
    with common.progress(options) as report:
        _live(options.out, plans, files, report)
    result = load_result(options.out)
    print(summary(result.identified, result.validation, options.out / REPORT))
    return 0


def _write_trajectory(plan: _Plan, directory: Path) -> Path:
    """A random excitation within the arm's limits (until there is an optimised one)."""
    arm = load_arm(config_path(ARM))
    lower, upper, velocity, acceleration = np.array(
        [(j.lower, j.upper, j.velocity_limit, j.acceleration_limit) for j in arm.joints]
    ).T
    limits = MotionLimits(lower, upper, velocity, acceleration)
    series = random_feasible(
        arm.joint_names, limits, seed=plan.seed, fundamental_hz=plan.fundamental_hz, periods=plan.periods
    )
    path = directory / f"{plan.name}.yaml"
    save_trajectory(Trajectory(arm.joint_names, (series,)), path)
    return path


def _live(directory: Path, plans: tuple[_Plan, ...], files: list[Path], report: common.Report) -> None:
    from ..nodes.chain import STARTED_S, Chain

    parameters = {
        "trajectory": {"trajectory_file": str(files[0].resolve())},
        "recorder": {"directory": str((directory / "recordings").resolve())},
        "identifier": {"result_directory": str(directory.resolve()), "arm": str(config_path(ARM))},
    }
    with Chain(directory, parameters) as chain:
        report(0.0, "starting the nodes")
        chain.wait(lambda: chain.status("canopen_driver") == "disabled", "the drives", STARTED_S)
        chain.call("/recorder/start")
        chain.call("/driver/enable", True)
        chain.wait(
            lambda: chain.values("canopen_driver").get("operation_enabled") == "true", "enabled drives", STARTED_S
        )
        for number, (plan, file) in enumerate(zip(plans, files)):
            part = common.within(report, number / len(plans), (number + 1) / len(plans))
            chain.set_parameter("trajectory", "trajectory_file", str(file.resolve()))
            chain.call("/excitation/start")
            _follow(chain, plan, part)
        chain.call("/recorder/stop")
        chain.call("/driver/enable", False)
        codes = chain.close()
    failed = {name: code for name, code in codes.items() if code}
    if failed:
        raise UserError(f"nodes ended with an error: {failed}; see {directory / 'logs'}")


def _follow(chain: Any, plan: _Plan, report: common.Report) -> None:
    """Wait until a run is done and identified (or validated)."""
    bag = f"{plan.name}.mcap"

    def moving() -> bool:
        state = chain.excitation
        if state.get("reason"):
            raise UserError(f"the {plan.name} run was stopped: {state['reason']}")
        done = state.get("period", 0) / plan.periods if state.get("state") == "running" else 0.0
        report(0.8 * done, f"{plan.name}: {state.get('state', 'starting')}")
        return state.get("state") == "done"

    def identified() -> bool:
        status, values = chain.status("identifier: identification"), chain.values("identifier: identification")
        report(0.9, f"{plan.name}: identifying")
        if bag in values.get("bags", "") and not status.startswith("identified"):
            raise UserError(f"the identification failed: {status}")
        return values.get("bags", "").endswith(bag)

    chain.wait(moving, f"the end of the {plan.name} run", 60.0 + plan.periods / plan.fundamental_hz)
    chain.wait(identified, f"the identification from the {plan.name} run", IDENTIFIED_S)
