"""`spacearm check`: recordings against their conventions, or everything that must be well before the arm moves."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ..commissioning.arm_check import check_arm
from ..commissioning.can_check import check_can
from ..commissioning.machine_check import check_machine
from ..commissioning.params_check import check_params
from ..commissioning.result import CheckResult, Level
from ..commissioning.starter import ARM_FILE, CAN_FILE, NODES_FILE
from ..conventions.check import check_conventions
from ..conventions.finding import ConventionReport, sureness
from ..conventions.finding import Level as Weight
from ..errors import UserError
from ..identification.effort import as_declared
from ..recording.ros_bags import is_mcap, is_ros_bag
from ..recording.tables import is_log
from ..sessions.identification import corrected, locked_words, within
from . import common

DESCRIPTION = """
With BAGs (MCAP files, rosbag2 folders, or folders of them): test on the data whether units, signs, joint order, encoder
zeros, gravity, clock and gains are as an identification assumes; exit code 1 where the data are unfit.
Otherwise check this machine (packages, ROS, real time, disk) and, where they are named, an arm file, its CAN
configuration against arm, EDS and bus load, and a file of ROS parameters. Nothing is sent on a bus. A folder that
'spacearm new-arm' wrote names all its files at once. Exit code 1 where something fails; warnings alone are 0.
"""
NEXT_FIT = "spacearm identify, on these recordings"
NEXT_UNFIT = "apply the remedies below (->) or record again, then repeat this check"
NEXT_FIX = "apply the remedies below (->) of every line that fails or warns"
NEXT_SOUND = "spacearm excite --arm {arm} --out excitation.yaml, where nothing is recorded yet"
COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red"}
FINDING_COLOURS = {Weight.UNFIT: "bold red", Weight.NOTE: "yellow"}


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument(
        "paths", nargs="*", type=Path, metavar="BAG|ARM", help="recordings; or one URDF, arm YAML or folder of new-arm"
    )
    common.add_arm_options(command)
    common.add_base_option(command)
    common.add_mapping_option(command)
    common.add_namespace_option(command)
    command.add_argument("--can", type=Path, metavar="FILE", help="CAN YAML")
    command.add_argument("--params", type=Path, metavar="FILE", help="ROS parameters of the nodes")
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Check, print; returns 1 where something fails.

    Raises:
        UserError: Bags and files of an arm together, or options of the one with the other.
    """
    bags = [path for path in options.paths if is_bag(path)]
    if bags:
        if len(bags) < len(options.paths) or options.can or options.params:
            raise UserError("check recordings and files apart: name bags alone, the arm with --arm")
        return check_bags(options, bags)
    if len(options.paths) > 1 or options.arm or options.gravity:
        what = options.paths[0] if options.paths else "recordings"
        raise UserError(
            f"{what}: no recording; --arm and --gravity go with bags, and files of one arm are checked alone"
        )
    return check_files(options, options.paths[0] if options.paths else None)


def is_bag(path: Path) -> bool:
    """Whether a path is a recording or a folder of recordings, and not an arm's configuration."""
    if is_log(path) or is_ros_bag(path):
        return True
    if not path.is_dir():
        return is_mcap(path)
    return (path / "metadata.yaml").is_file() or any(map(is_mcap, (*path.glob("*"), *path.glob("*/*"))))


def check_bags(options: argparse.Namespace, bags: Sequence[Path]) -> int:
    """Test recordings against their conventions; returns 1 where they are unfit.

    Args:
        options: Of the command line.
        bags: To read.
    """
    with common.progress(options) as report:
        recordings = common.reading_of(options).read(bags, within(report, 0.0, 0.2))
        arm = common.arm_of(options, recordings)
        recordings = as_declared(recordings, arm)
        found = check_conventions(corrected(recordings, arm), arm, progress=within(report, 0.2, 1.0))
    if options.json:
        common.print_json(found.as_dict())
    else:
        show_findings(found)
    for line in locked_words(arm):
        common.note(options, line)
    common.note_findings(options, recordings)
    return 0 if found.fit else 1


def show_findings(report: ConventionReport) -> None:
    """The verdict, what to do next, each finding with its place, probability and remedy, and what remains undecided."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(Text(report.verdict, "bold" if report.fit else "bold red"))
    console.print(f"next: {NEXT_FIT if report.fit else NEXT_UNFIT}")
    for finding in report.findings:
        where = f" in {', '.join(finding.recordings)}" if len(report.recordings) > 1 else ""
        line = Text.assemble((f"{finding.level:<6}", FINDING_COLOURS[finding.level]), f"{finding.kind}{where}: ")
        line.append(finding.statement)
        console.print(line)
        if finding.log_odds is not None:
            console.print(Text(f"      {sureness(finding)}", "dim"))
        console.print(Text(f"      -> {finding.remedy}", "italic"))
    if report.undecided:
        console.print(Text(f"not decided by these data: {'; '.join(report.undecided)}", "dim"))


def check_files(options: argparse.Namespace, path: Path | None) -> int:
    """Check this machine and an arm's files; returns 1 where something fails.

    Args:
        options: Of the command line.
        path: URDF or arm YAML; None: the machine alone.
    """
    arm, can, params = files(path, options.can, options.params)
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
        show(results, arm)
    return 1 if any(result.level is Level.FAIL for result in results) else 0


def files(arm: Path | None, can: Path | None, params: Path | None) -> tuple[Path | None, Path | None, Path | None]:
    """The files meant: those named, and the others of a folder.

    Args:
        arm: Arm file, or a folder that holds `arm.yaml`; None: not given.
        can: CAN file; None: that of the folder, if it has one.
        params: Parameter file of the nodes; None: that of the folder, if it has one.

    Returns:
        Arm file, CAN file and parameter file; None where there is none to check.

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


def show(results: Sequence[CheckResult], arm: Path | None = None) -> None:
    """How many are right, what to do next, then a line each with its remedy.

    Args:
        results: Of every check.
        arm: The file that was checked; None: none was.
    """
    console = Console(highlight=False, soft_wrap=True)
    counts = {level: sum(result.level is level for result in results) for level in Level}
    console.print(", ".join(f"{count} {level}" for level, count in counts.items()))
    open_ones = counts[Level.FAIL] or counts[Level.WARN]
    console.print(f"next: {NEXT_FIX if open_ones else NEXT_SOUND.format(arm=arm or 'ARM')}")
    for result in results:
        line = Text.assemble((f"{result.level:<5}", COLOURS[result.level]), f"{result.subject:<16}", result.message)
        if result.advice:
            line.append(f" -> {result.advice}", "dim" if result.level is Level.OK else "italic")
        console.print(line)
