"""`spacearm demo`: the main job on the simulated arm, on this machine, nothing needed beforehand."""

from __future__ import annotations

import argparse
import importlib.util
import json
import signal
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from ..config import config_path
from ..documents import read_yaml
from ..dynamics.arm import load_arm
from ..errors import UserError
from ..excitation.run import limits_of
from ..excitation.trajectory import Trajectory, random_feasible
from ..excitation.trajectory_file import save_trajectory
from ..report.folder import REPORT
from ..results.store import MODEL, load_result
from . import common, demo_orbit
from .identify import summary

if TYPE_CHECKING:
    from ..nodes.chain import Chain

DESCRIPTION = """
The whole chain on this machine: a simulated six-joint CANopen arm, the driver, the trajectory node, the recorder and
the identifier, each a process, over real CAN frames and real DDS. One run to identify the arm, one with other
coefficients to validate, then the report. Everything is written to DIR: result, recordings and each node's log.
It says in which ROS domain the nodes are, for spacearm watch and ros2 beside it. On a machine that does not keep the
cycle of 1 ms for all of them it begins again with 2, then with 4 ms, and says so.
With --orbit, offline and without ROS: the same arm simulated on the ground, then in zero gravity and vacuum from -40 to
+60 degC; the ground's model adapts, and says what moved, by how much, and why it thinks so.
"""
OUT = Path("demo_result")
ARM = "paper_arm.yaml"
CAN = "paper_arm_can.yaml"
IDENTIFIED_S = 120.0
ATTEMPTS = 2
"""How often a run is begun, by drives that fell out or after a stop left to a person, before the demo takes the next
cycle or gives up. Each time the trajectory node begins it again by itself, `RESTARTS` times; once more is for what
happens once. By judgement, not by a measurement."""
CYCLES_MS = (1, 2, 4)
"""Cycles of the drives, one after the other where a machine does not keep the one before."""
REASON_S = 5.0
"""How long one node may take to hear of what happened at another."""
INTERRUPTED = 130
"""Exit code, as a shell gives it."""
ENABLING_S = 8.0
"""How long drives take to be enabled at most; longer, and something has stopped them."""


class TooBusyError(UserError):
    """The machine does not keep the cycle of the drives."""


@dataclass(frozen=True)
class Plan:
    """One run: its excitation and how often it is repeated."""

    name: str
    seed: int
    periods: int
    fundamental_hz: float


PLANS = (Plan("excitation", 1, 5, 0.1), Plan("validation", 2, 3, 0.1))
FAST_PLANS = (Plan("excitation", 1, 3, 0.2), Plan("validation", 2, 2, 0.2))


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument(
        "--out", type=Path, metavar="DIR", help=f"where to (default {OUT}; with --orbit, {demo_orbit.OUT})"
    )
    command.add_argument("--orbit", action="store_true", help="ground, then orbit, offline; exit 1 where R <= 0.97")
    command.add_argument("--fast", action="store_true", help="shorter runs: a check of the chain, not of the numbers")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Start the nodes, call their services, wait for the result."""
    options.out = options.out or (demo_orbit.OUT if options.orbit else OUT)
    if options.orbit and options.fast:
        raise UserError("--fast shortens the live demo; --orbit has no shorter form: give one of them")
    if options.orbit:
        return demo_orbit.run(options)
    if importlib.util.find_spec("rclpy") is None:
        raise UserError(
            "the demo needs ROS 2 (rclpy): source a Jazzy setup file, or install spacearm_ident with its extra 'ros'"
        )
    # However it is ended, the nodes end first (a shell's background job begins with SIGINT ignored).
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    options.out.mkdir(parents=True, exist_ok=True)
    plans = FAST_PLANS if options.fast else PLANS
    since_s = time.time()
    files = [write_trajectory(plan, options.out) for plan in plans]
    try:
        with common.progress(options) as report:
            _live(options.out, plans, files, report)
    except KeyboardInterrupt:
        print(f"spacearm: interrupted; every node has ended. {left_behind(options.out, since_s)}", file=sys.stderr)
        return INTERRUPTED
    result = load_result(options.out)
    print(summary(result.identified, result.validation, options.out / REPORT))
    return 0


def write_trajectory(plan: Plan, directory: Path) -> Path:
    """Write a random excitation within the demo's arm's limits; returns the file, `directory`/`plan.name`.yaml.

    Args:
        plan: Its seed, its fundamental (Hz) and how often it is repeated.
        directory: Where to; it exists.
    """
    arm = load_arm(config_path(ARM))
    limits = limits_of(arm, arm.joint_names)
    series = random_feasible(
        arm.joint_names, limits, seed=plan.seed, fundamental_hz=plan.fundamental_hz, periods=plan.periods
    )
    path = directory / f"{plan.name}.yaml"
    save_trajectory(Trajectory(arm.joint_names, (series,)), path)
    return path


def _live(directory: Path, plans: tuple[Plan, ...], files: list[Path], report: common.Report) -> None:
    for cycle_ms, slower_ms in pairwise(CYCLES_MS):
        try:
            return _live_at(cycle_ms, directory, plans, files, report)
        except TooBusyError as error:
            print(
                f"spacearm: {error}\nspacearm: this machine does not keep a cycle of {cycle_ms} ms for arm and driver: "
                f"the demo begins again with {slower_ms} ms",
                file=sys.stderr,
            )
    return _live_at(CYCLES_MS[-1], directory, plans, files, report)


def _live_at(cycle_ms: int, directory: Path, plans: tuple[Plan, ...], files: list[Path], report: common.Report) -> None:
    from ..nodes.chain import Chain

    with Chain(directory, node_parameters(directory, cycle_ms)) as chain:
        beside = f"ROS_DOMAIN_ID={chain.domain}"
        print(f"spacearm: the nodes are in {beside}: {beside} spacearm watch shows them", file=sys.stderr, flush=True)
        report(0.0, "starting the nodes")
        begin(chain)
        for number, (plan, file) in enumerate(zip(plans, files)):
            perform(chain, plan, file, common.within(report, number / len(plans), (number + 1) / len(plans)))
        chain.call("/recorder/stop")
        chain.call("/driver/enable", False)
        codes = chain.close()
    failed = {name: code for name, code in codes.items() if code}
    if failed:
        raise UserError(f"nodes ended with an error: {failed}; see {directory / 'logs'}")


def left_behind(directory: Path, since_s: float) -> str:
    """What an interrupted demo has written, in a sentence.

    Args:
        directory: Where it wrote to; it may hold an earlier demo, too.
        since_s: When it began, s since the epoch.
    """

    def written(place: Path) -> bool:
        return place.stat().st_mtime >= since_s if place.is_file() else any(map(written, place.iterdir()))

    places = [*directory.glob("recordings/*"), *(place for place in directory.iterdir() if place.name != "recordings")]
    names = sorted(str(place.relative_to(directory)) for place in places if written(place))
    result = "there is no result yet"
    if (model := directory / MODEL).exists():
        bags = json.loads((directory / "validation.json").read_text())["bags"]
        validated = any(Path(bag).stem == PLANS[1].name for bag in bags)
        result = "the result is of " + ("both runs" if validated else "the first run, not validated on another")
        result = result if written(model) else "the result in it is of an earlier demo"
    return f"{directory} has {', '.join(names) or 'nothing'} of it; {result}"


def node_parameters(directory: Path, cycle_ms: int = CYCLES_MS[0]) -> dict[str, dict[str, object]]:
    """ROS parameters of the chain's nodes, by node; all that is written goes to `directory`.

    Args:
        directory: Of the demo.
        cycle_ms: Of the drives, ms; one other than that of the arm's CAN YAML is written to one in `directory`.
    """
    parameters: dict[str, dict[str, object]] = {
        "recorder": {"directory": str((directory / "recordings").resolve())},
        "identifier": {"result_directory": str(directory.resolve()), "arm": str(config_path(ARM))},
    }
    if cycle_ms == CYCLES_MS[0]:
        return parameters
    can = read_yaml(config_path(CAN), "the CAN YAML")
    can |= {"arm": str(config_path(ARM)), "eds": str(config_path(can["eds"]))}
    can["cycle"] |= {"period_s": 1e-3 * cycle_ms}
    path = (directory / CAN).resolve()
    path.write_text(yaml.safe_dump(can, sort_keys=False))
    return parameters | {
        "simulated_arm": {"can_config": str(path)},
        "canopen_driver": {"can_config": str(path)},
        "trajectory": {"rate_hz": 1e3 / cycle_ms},
    }


def begin(chain: Chain) -> None:
    """Once all nodes are up, record and enable the drives."""
    from ..nodes.chain import STARTED_S
    from ..nodes.main import NODES

    def ready() -> bool:
        return all(map(chain.status, NODES)) and chain.values("canopen_driver").get("connection") == "connected"

    chain.wait(ready, "all nodes and the drives", STARTED_S)
    chain.call("/recorder/start")
    enable(chain)


def enable(chain: Chain) -> None:
    """Enable the drives; again, where a machine too busy for the cycle has stopped them meanwhile.

    Raises:
        TooBusyError: They do not stay enabled.
    """
    from ..nodes.chain import STARTED_S

    def attempt() -> bool:
        # Starting five nodes at once may hold up the driver for longer than the drives forgive.
        chain.call("/driver/recover")
        chain.call("/driver/enable", True)
        give_up = time.monotonic() + ENABLING_S
        chain.wait(lambda: enabled(chain) or time.monotonic() > give_up, "enabled drives", STARTED_S)
        return enabled(chain)

    if not any(attempt() for _ in range(int(STARTED_S / ENABLING_S))):
        raise TooBusyError(f"the drives do not stay enabled: {chain.status('canopen_driver')}")


def enabled(chain: Chain) -> bool:
    """Whether the driver says that all drives are enabled."""
    return chain.values("canopen_driver").get("operation_enabled") == "true"


def perform(chain: Chain, plan: Plan, file: Path, report: common.Report) -> None:
    """Run an excitation; returns when the arm has been identified from it, or validated on it.

    Args:
        chain: The running nodes, with the drives enabled and the recorder started.
        plan: The run; its name is that of its bag.
        file: Trajectory file of the run.
        report: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: The run did not complete, or the identification failed.
    """
    go_through(chain, plan, file, report)
    _identified(chain, plan, report)


def go_through(chain: Chain, plan: Plan, file: Path, report: common.Report) -> None:
    """Run a trajectory; returns when the arm has come through it.

    A run that breaks off because the machine is too busy, the trajectory node begins again by itself. Drives that have
    fallen out, and runs that the driver leaves to a person, are begun again here, `ATTEMPTS` times in all: the arm is
    simulated.

    Args:
        chain: The running nodes, with the drives enabled.
        plan: The run; its length sets how long is waited for its end.
        file: Trajectory file of the run.
        report: Called with a share done in 0..1 and what is being done.

    Raises:
        TooBusyError: It did not come through.
        UserError: It was refused though the drives are enabled.
    """
    chain.set_parameter("trajectory", "trajectory_file", str(file.resolve()))
    reason = ""
    for _ in range(ATTEMPTS):
        try:
            begun_as = _start(chain)
        except UserError as refusal:
            if enabled(chain):
                raise
            reason = str(refusal)
            print(f"spacearm: {refusal}; enabling again", file=sys.stderr)
            enable(chain)
            continue
        reason = _moved(chain, plan, begun_as, report)
        if chain.excitation["complete"]:
            return
        # The driver leaves such a stop to a person. This arm is simulated: the demo stands in for one, and says so.
        print(f"spacearm: the {plan.name} run was stopped: {reason}; the demo begins it again", file=sys.stderr)
        enable(chain)
    raise TooBusyError(
        f"the {plan.name} run was stopped, or could not begin, {ATTEMPTS} times (is this machine too busy?), "
        f"at last: {reason}"
    )


def _start(chain: Chain) -> str:
    """Start a run; returns its id. The trajectory node may not have heard yet of the driver, or that it is enabled."""
    end = time.monotonic() + REASON_S
    while True:
        try:
            return chain.call("/excitation/start").partition(":")[0].removeprefix("run ")
        except UserError:
            if time.monotonic() > end:
                raise
        time.sleep(0.1)


def _moved(chain: Chain, plan: Plan, begun_as: str, report: common.Report) -> str:
    """Wait until a run, or the last that was begun in its place, is over; returns why it was stopped, or nothing."""
    from ..nodes.main import RESTARTS

    told = 0

    def over() -> bool:
        nonlocal told
        state = chain.excitation
        if state.get("begun_as") != begun_as:
            return False
        if state["state"] == "recovering" and state["restarts"] == told:
            told += 1
            print(f"spacearm: the {plan.name} run was stopped, to be begun again: {state['reason']}", file=sys.stderr)
        done = state.get("period", 0) / plan.periods if state.get("state") == "running" else 0.0
        report(0.8 * done, f"{plan.name}: {state.get('state', 'starting')}")
        return state.get("state") == "done"

    patience = (1 + RESTARTS) * (60.0 + plan.periods / plan.fundamental_hz)
    chain.wait(over, f"the end of the {plan.name} run", patience)
    return str(chain.excitation["reason"])


def _identified(chain: Chain, plan: Plan, report: common.Report) -> None:
    """Wait until the arm has been identified from a run, or validated on it."""
    bag = f"{plan.name}.mcap"

    def identified() -> bool:
        status, values = chain.status("identifier: identification"), chain.values("identifier: identification")
        report(0.9, f"{plan.name}: identifying")
        if bag in values.get("bags", "") and not status.startswith("identified"):
            raise UserError(f"the identification failed: {status}")
        return values.get("bags", "").endswith(bag)

    chain.wait(identified, f"the identification from the {plan.name} run", IDENTIFIED_S)
