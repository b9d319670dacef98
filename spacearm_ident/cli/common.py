"""What several commands share: options of the arm, reading bags, progress, output."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from ..dynamics.arm import Arm, arm_from_urdf, load_arm
from ..errors import UserError
from ..recording import Recording, describe, read_recording

Report = Callable[[float, str], None]


def add_arm_options(command: argparse.ArgumentParser) -> None:
    """`--arm` and `--gravity`."""
    command.add_argument(
        "--arm", type=Path, metavar="FILE", help="URDF or arm YAML; default: /robot_description of the first bag"
    )
    command.add_argument(
        "--gravity",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="gravity in the base frame, m/s^2 (0 0 0 in orbit); default: the arm's, else 0 0 -9.81",
    )


def add_output_options(command: argparse.ArgumentParser) -> None:
    """`--json` and `--quiet`."""
    command.add_argument("--json", action="store_true", help="print the result as JSON on standard output")
    command.add_argument("--quiet", action="store_true", help="no progress bar and no notes on standard error")


def read_bags(paths: Sequence[Path], report: Report) -> list[Recording]:
    """Read bags one after the other."""
    recordings = []
    for number, path in enumerate(paths):
        report(number / len(paths), f"reading {path.name}")
        recordings.append(read_recording(path))
    return recordings


def arm_of(options: argparse.Namespace, recordings: Sequence[Recording]) -> Arm:
    """The arm asked for, or the one the recordings describe.

    Raises:
        UserError: Neither is there.
    """
    if options.arm is not None:
        arm = load_arm(options.arm)
    else:
        urdf = next((recording.urdf for recording in recordings if recording.urdf), None)
        if urdf is None:
            raise UserError("no bag holds a /robot_description: give the arm's URDF with --arm FILE")
        arm = arm_from_urdf(urdf)
    return arm if options.gravity is None else arm.with_gravity(np.array(options.gravity))


def note(options: argparse.Namespace, text: str) -> None:
    """A line for a person, on standard error, so that --json stays clean."""
    if not options.quiet:
        print(text, file=sys.stderr)


def note_findings(options: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    """What was found in the recordings and what was dropped."""
    for recording in recordings:
        for line in describe(recording):
            note(options, line)


def print_json(value: Any) -> None:
    """A result for programs."""
    print(json.dumps(value, indent=2, allow_nan=False))


@contextmanager
def progress(options: argparse.Namespace) -> Iterator[Report]:
    """A progress bar on standard error where that is a terminal; silent otherwise."""
    console = Console(stderr=True)
    if options.quiet or not console.is_terminal:
        yield lambda share, what: None
        return
    columns = (TextColumn("{task.description:<44}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda share, what: bar.update(task, completed=share, description=what)


def within(report: Report, start: float, stop: float) -> Report:
    """Progress of a part of the work, as progress of the whole."""
    return lambda share, what: report(start + (stop - start) * share, what)
