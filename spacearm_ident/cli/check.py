"""`spacearm check`: a line for everything that must be well before the arm moves."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from ..commissioning.arm_check import check_arm
from ..commissioning.can_check import check_can
from ..commissioning.machine_check import check_machine
from ..commissioning.params_check import check_params
from ..commissioning.result import CheckResult, Level
from ..commissioning.starter import ARM_FILE, CAN_FILE, NODES_FILE
from ..errors import UserError
from . import common

DESCRIPTION = """
Check this machine (packages, ROS, real time, disk) and, where they are named, an arm file, its CAN configuration
against arm, EDS and bus load, and a file of ROS parameters. Nothing is sent on a bus. A folder that 'spacearm new-arm'
wrote stands for all its files. Exit code 1 where something fails; warnings alone are 0.
"""
COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red"}


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser("check", help="check machine, arm and CAN configuration", description=DESCRIPTION)
    command.add_argument("arm", nargs="?", type=Path, metavar="ARM", help="URDF, arm YAML, or a folder of new-arm")
    command.add_argument("--can", type=Path, metavar="FILE", help="CAN YAML")
    command.add_argument("--params", type=Path, metavar="FILE", help="ROS parameters of the nodes")
    command.add_argument("--json", action="store_true", help="print the results as JSON")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Check, print; returns 1 where something fails."""
    arm, can, params = files(options.arm, options.can, options.params)
    results = check_machine(Path.cwd(), os.environ)
    if arm is not None:
        results += check_arm(arm)
    if can is not None:
        results += check_can(can, arm)
    if params is not None:
        results += check_params(params)
    if options.json:
        common.print_json([asdict(result) for result in results])
    else:
        show(results)
    return 1 if any(result.level is Level.FAIL for result in results) else 0


def files(arm: Path | None, can: Path | None, params: Path | None) -> tuple[Path | None, Path | None, Path | None]:
    """The files meant: those named, and the others of a folder.

    Raises:
        UserError: One that is named is not there.
    """
    if arm is not None and arm.is_dir():
        folder = arm
        arm = folder / ARM_FILE
        can = can or _if_there(folder / CAN_FILE)
        params = params or _if_there(folder / NODES_FILE)
    for path in (arm, can, params):
        if path is not None and not path.is_file():
            raise UserError(f"there is no file {path}: 'spacearm new-arm URDF --out DIR' writes one")
    return arm, can, params


def _if_there(path: Path) -> Path | None:
    return path if path.is_file() else None


def show(results: Sequence[CheckResult]) -> None:
    """A line each; what to do stands below it, and a count at the end."""
    console = Console(highlight=False, soft_wrap=True)
    for result in results:
        line = Text.assemble((f"{result.level:<5}", COLOURS[result.level]), f"{result.subject:<16}", result.message)
        if result.advice:
            line.append(f" -> {result.advice}", "dim" if result.level is Level.OK else "italic")
        console.print(line)
    counts = {level: sum(result.level is level for result in results) for level in Level}
    console.print(", ".join(f"{count} {level}" for level, count in counts.items()))
