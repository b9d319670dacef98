"""What several commands share: options of the arm, reading bags, progress, output."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from ..documents import file_sha256
from ..dynamics.arm import Arm
from ..errors import UserError, one_line
from ..forks import Ticker
from ..recording import Recording, describe
from ..recording.messages import STATES_TOPIC
from ..results.provenance import versions
from ..sessions.identification import find_arm
from ..sessions.identification import within as within
from ..sessions.reading import Reading

Report = Callable[[float, str], None]


def decimals(values: Iterable[float]) -> int:
    """Places after the point for a table of torques: two digits of the smallest where there is room, 3 at least."""
    sizes = [abs(value) for value in values if value and math.isfinite(value)] or [1.0]
    least, most = (math.floor(math.log10(size)) for size in (min(sizes), max(sizes)))
    return max(3, min(1 - least, 6 - max(most, 0)))


def add_arm_options(command: argparse.ArgumentParser) -> None:
    """`--arm` and `--gravity`."""
    command.add_argument(
        "--arm", type=Path, metavar="FILE", help="URDF or arm YAML; default: /robot_description of the first bag"
    )
    add_gravity_option(command, "default: the arm's, else 0 0 -9.81")


def add_gravity_option(command: argparse.ArgumentParser, default: str) -> None:
    """`--gravity`.

    Args:
        command: Parser of the command.
        default: What holds without the option.
    """
    command.add_argument(
        "--gravity",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help=f"gravity in the base frame, m/s^2 (0 0 0 in orbit); {default}",
    )


def add_base_option(command: argparse.ArgumentParser) -> None:
    """`--fixed-base`."""
    command.add_argument(
        "--fixed-base", action="store_true", help="take the base for fixed though the bag holds its motion (/base_imu)"
    )


def add_namespace_option(command: argparse.ArgumentParser) -> None:
    """`--namespace`, and `--topic` for the same by the name of a topic."""
    command.add_argument(
        "--namespace",
        metavar="NAME",
        help="where bags hold several arms: the one in this namespace (arm_1: /arm_1/joint_states); /: the one in none",
    )
    command.add_argument(
        "--topic",
        dest="namespace",
        type=_of_topic,
        metavar="NAME",
        help="its joint states by the topic's full name, whatever that is (/left/measured_joints)",
    )


def _of_topic(topic: str) -> str:
    """A topic of joint states as `--namespace` has it: its namespace, or the topic itself where its name is another."""
    place, _, name = topic.rpartition("/")
    return (place or "/") if f"/{name}" == STATES_TOPIC else topic


def add_mapping_option(command: argparse.ArgumentParser) -> None:
    """`--mapping`."""
    command.add_argument(
        "--mapping",
        type=Path,
        metavar="FILE",
        help="what the columns of a log (CSV, npz, mat, Parquet, HDF5, LeRobot) are; default: LOG.mapping.yaml or "
        "mapping.yaml beside it, else as 'spacearm import' proposes",
    )


def add_files_option(
    command: argparse.ArgumentParser, name: str, what: str, *, metavar: str = "BAG", action: str = "extend"
) -> None:
    """An option that takes one or more files and may be repeated.

    Args:
        command: Parser of the command.
        name: Such as `--validate`.
        what: Its help.
        metavar: What stands for a file in the help.
        action: `extend`: one list of all; `append`: a list for each time it is given.
    """
    command.add_argument(name, nargs="+", action=action, default=[], type=Path, metavar=metavar, help=what)


def add_output_options(command: argparse.ArgumentParser) -> None:
    """`--json` and `--quiet`."""
    command.add_argument("--json", action="store_true", help="print the result as JSON on standard output")
    command.add_argument("--quiet", action="store_true", help="no progress bar and no notes on standard error")


def require_bag_name(path: Path) -> None:
    """Refuse the name of another kind of file for a bag, before anything is computed or written.

    Args:
        path: `NAME.mcap` for one file, or a folder, whose name may end in a number (`run.2`).

    Raises:
        UserError: It ends in another suffix.
    """
    if path.suffix != ".mcap" and path.suffix[1:2].isalpha():
        raise UserError(
            f"{path}: {path.suffix} is no suffix of a bag; name a file NAME.mcap, or a folder without suffix"
        )


def reading_of(options: argparse.Namespace) -> Reading:
    """How bags and logs are read, by those of the options above that a command has."""
    given = vars(options)
    return Reading(given.get("arm"), given.get("namespace"), given.get("mapping"), given.get("fixed_base", False))


def arm_of(options: argparse.Namespace, recordings: Sequence[Recording]) -> Arm:
    """The arm asked for, or the one the recordings describe.

    Args:
        options: Of the command: `arm`, `gravity`.
        recordings: Which may hold a description.

    Raises:
        UserError: Neither is there.
    """
    return find_arm(options.arm, options.gravity, recordings)


def note(options: argparse.Namespace, text: str) -> None:
    """A line for a person, on standard error, so that --json stays clean.

    Args:
        options: Of the command: `quiet`.
        text: One line.
    """
    if not options.quiet:
        sys.stdout.flush()  # the result comes first in a file that takes both streams, too
        print(one_line(text), file=sys.stderr)


def note_findings(options: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    """What was found in the recordings and what was dropped.

    Args:
        options: Of the command: `quiet`.
        recordings: As read.
    """
    for recording in recordings:
        for line in describe(recording):
            note(options, line)


def origin(options: argparse.Namespace, *files: Path | None) -> list[str]:
    """How a file was made, a line each: the command, the versions, its input files with their checksums."""
    lines = [options.command_line, ", ".join(f"{name} {version}" for name, version in versions().items())]
    return lines + [f"{path} sha256 {file_sha256(path)}" for path in files if path is not None]


def print_json(value: Any) -> None:
    """A result for programs."""
    print(json.dumps(value, indent=2, allow_nan=False))


LINE_EVERY_S = 10.0
"""Seconds between two lines of progress where standard error is no terminal; shorter work prints none."""
REFRESH_EVERY_S = 0.1
"""Seconds between two drawings of the progress bar, as rich itself has it: its clock runs through a long step."""


class _ProgressLines:
    """Progress for a log: share done, time taken so far, and the present step, a line each time."""

    def __init__(self) -> None:
        self._share, self._what = 0.0, "starting"
        self._begun = time.monotonic()

    def __call__(self, share: float, what: str) -> None:
        self._share, self._what = share, what

    def print(self) -> None:
        """A line on standard error."""
        seconds = time.monotonic() - self._begun
        print(f"{self._share:4.0%} {seconds:5.0f} s  {self._what}", file=sys.stderr, flush=True)


@contextmanager
def progress(options: argparse.Namespace) -> Iterator[Report]:
    """A progress bar on standard error where that is a terminal, else a line every `LINE_EVERY_S`."""
    console = Console(stderr=True)
    if options.quiet:
        yield lambda share, what: None
        return
    if not console.is_terminal:
        lines = _ProgressLines()
        with Ticker(lines.print, LINE_EVERY_S):
            yield lines
        return
    columns = (TextColumn("{task.description:<44}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    # Rich's own thread may hold a lock while work is shared among forked processes.
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task("starting", total=1.0)
        with Ticker(bar.refresh, REFRESH_EVERY_S):
            yield lambda share, what: bar.update(task, completed=share, description=what)
