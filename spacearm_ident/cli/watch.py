"""`spacearm watch`: the live graph on a terminal."""

from __future__ import annotations

import argparse
import importlib.util
import math
import re
from dataclasses import asdict
from typing import Any

from rich.console import Console

from ..errors import UserError
from . import common

DESCRIPTION = """
Show the live graph: what every node says, drive states, positions, torques and residuals of the joints, how well the
cycle keeps time and how full the buses are, progress of run and identification, and the parameters that moved most
since the set before, with their standard errors so far. It only listens. Ctrl-C ends it.
"""
NAMESPACE = r"([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?"


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("--once", action="store_true", help="print one frame and end (exit code 1: no node is found)")
    command.add_argument("--json", action="store_true", help="the same as JSON; goes with --once")
    command.add_argument("--wait", type=float, default=10.0, metavar="S", help="with --once: for a node (default 10)")
    command.add_argument("--rate", type=float, default=4.0, metavar="HZ", help="frames a second (default 4)")
    command.add_argument("--parameters", type=int, default=12, metavar="N", help="most parameters shown (default 12)")
    command.add_argument("--namespace", default="", metavar="NS", help="of the nodes, such as arm_1 (default: none)")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Listen and show."""
    if not (options.rate > 0 and options.wait > 0 and options.parameters >= 0):
        raise UserError("--rate and --wait must be above zero, --parameters not below")
    namespace = options.namespace.strip("/")
    if not re.fullmatch(NAMESPACE, namespace):
        raise UserError(f"--namespace {options.namespace}: not a ROS namespace such as arm_1 or station/arm_1")
    console, once = Console(), options.once or options.json
    if not (once or console.is_terminal):
        raise UserError("this is no terminal: use --once for one frame, or --json")
    if importlib.util.find_spec("rclpy") is None:
        raise UserError("watch needs ROS 2 (rclpy): source a Jazzy setup file, or install spacearm_ident[ros]")
    from ..nodes.watch import look_once, watch
    from ..nodes.watch_screen import screen

    if not once:
        watch(console, options.rate, options.parameters, namespace)
        return 0
    view = look_once(options.wait, options.parameters, namespace)
    if options.json:
        common.print_json(plain(asdict(view)))
    else:
        console.print(screen(view))
    return 0


def plain(value: Any) -> Any:
    """The same data, with None for what is no number: JSON has neither NaN nor infinity."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
