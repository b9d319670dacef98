"""Many bags, each identified by itself as `spacearm identify BAG` would: side by side, going on where it had ended.

Each bag has its result folder. One that is unfit, cannot be read or kills its process is a row in the summary with
its reason, not the end. What is there already is kept where it is what would come out again: of the same bag (by its
checksum), under the same options (their files by content) and the same versions.
"""

from __future__ import annotations

import os
import shlex
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..documents import file_sha256
from ..dynamics.arm import load_arm
from ..dynamics.model_file import load_model
from ..errors import UnfitDataError, UserError, one_line
from ..identification.identify import Progress
from ..recording.bag import bag_files
from ..recording.log_mapping import FOLDER_MAPPING, mapping_beside
from ..recording.ros_bags import is_mcap, is_ros_bag
from ..recording.tables import is_log
from ..recording.zstd import ZSTD_SUFFIX
from ..report.folder import REPORT
from ..report.index import folder_of_arm, unfit_reason
from ..report.summary import FAILED, IDENTIFIED, UNFIT, Row, write_summary
from ..results.provenance import FITTED, OPTIONS, VALIDATED, versions
from ..results.store import FIGURES, Result, load_prior, load_result
from ..solvers.choice import require_solver
from .bags import Options, identify_bags
from .identification import within
from .side_by_side import Lost, on_cluster, on_cores

METADATA = "metadata.yaml"


@dataclass(frozen=True)
class Task:
    """One bag to identify: its name in the summary, where its result goes, and how."""

    name: str
    bag: Path
    directory: Path
    options: Options

    @property
    def command(self) -> str:
        """The command that does the same."""
        return shlex.join(["spacearm", "identify", str(self.bag), *self.options.words(), "--out", str(self.directory)])


def identify_batch(
    paths: Sequence[Path],
    directory: Path,
    options: Options,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    again: bool = False,
    by_folder: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Identify every bag, write the summary and the index.

    Args:
        paths: Bags, and folders to look for bags in.
        directory: Of the results, each in a folder of its own.
        options: How; the same for all.
        jobs: Processes at a time on this machine; None: its cores.
        scheduler: Address of a Dask scheduler whose workers do it instead; they see the same files.
        again: Do again what is there already.
        by_folder: Whether the first folder of a bag's name tells which arm it is, of several of one type.
        progress: Called with a share done in 0..1 and what is being done.

    Returns:
        The content of `summary.json`.

    Raises:
        UserError: There is no bag, one without the folder of its arm, an option cannot be used with any, or the folder
            cannot be written.
    """
    report = progress or (lambda share, what: None)
    check(options)
    if jobs is not None and jobs < 1:
        raise UserError(f"--jobs {jobs}: give at least one process")
    bags = find_bags(paths)
    homeless = next((bag for name, bag in bags.items() if not folder_of_arm(name)), None)
    if by_folder and homeless is not None:
        raise UserError(f"{homeless}: in no folder of an arm (--arm-by-folder): name the one above those of the arms")
    _make(directory)
    place, how = directory.resolve(), options.absolute()
    tasks = [Task(name, bag, place / name, how) for name, bag in bags.items()]
    rows = {}
    for number, task in enumerate([] if again else tasks):
        report(0.05 * number / len(tasks), f"looking at {task.name}")
        if (known := up_to_date(task)) is not None:
            rows[task.name] = _of_result(task, known.unfit, skipped=True)
    waiting = [task for task in tasks if task.name not in rows]
    doing = within(report, 0.05, 0.95)
    doing(len(rows) / len(tasks), f"{len(waiting)} of {len(tasks)} bags to identify")
    cores = len(os.sched_getaffinity(0))
    outcomes = on_cluster(perform, waiting, scheduler) if scheduler else on_cores(perform, waiting, jobs or cores)
    for task, outcome in outcomes:
        rows[task.name] = _row(task, outcome)
        doing(len(rows) / len(tasks), f"{task.name}: {rows[task.name].status}")
    return write_summary(directory, [rows[task.name] for task in tasks], within(report, 0.95, 1.0), by_folder)


def perform(task: Task) -> Row:
    """Identify one bag, in whatever process this is; what goes wrong is in the row."""
    try:
        session, _ = identify_bags((task.bag,), (), task.directory, task.options, command=task.command)
    except UnfitDataError as error:
        return Row(task.name, task.bag, UNFIT, str(error))
    except UserError as error:
        return Row(task.name, task.bag, FAILED, str(error))
    except Exception as error:
        traceback.print_exc()
        return Row(task.name, task.bag, FAILED, one_line(f"it broke: {type(error).__name__}: {error}"))
    return _of_result(task, session.conventions.unfit)


def _of_result(task: Task, unfit: Sequence[str], skipped: bool = False) -> Row:
    """The row of a bag that has a result: a model of unfit data is written, and is none to compare with others."""
    if unfit:
        return Row(task.name, task.bag, UNFIT, unfit_reason(unfit), skipped)
    return Row(task.name, task.bag, IDENTIFIED, skipped=skipped)


def _row(task: Task, outcome: Row | Lost) -> Row:
    if isinstance(outcome, Lost):
        return Row(task.name, task.bag, FAILED, one_line(outcome.reason))
    if outcome.status == IDENTIFIED and not (task.directory / FIGURES).is_file():
        reason = f"its worker wrote {task.directory}, which is not there: bags and --out on file systems that all share"
        return Row(task.name, task.bag, FAILED, reason)
    return outcome


def up_to_date(task: Task) -> Result | None:
    """The result that is there, where it is what would come out again; of an unreadable bag it never is."""
    try:
        result = load_result(task.directory)
        known = result.identified.model.provenance or {}
        sums = [file_sha256(file) for file in bag_files(task.bag)[0]]
        asked = task.options.fingerprint()
        there = [[source["sha256"] for source in known[which]] for which in (FITTED, VALIDATED)]
        same = there == [sums, sums] and known[OPTIONS] == asked and known["versions"] == versions()
    except (UserError, OSError, LookupError, TypeError):
        return None
    return result if same and (task.directory / REPORT).is_file() else None


def check(options: Options) -> None:
    """Refuse what would be wrong with every bag, before any is read.

    Raises:
        UserError: A file of the options cannot be read, or they contradict each other.
    """
    options.fingerprint()
    require_solver(options.solver)
    prior = load_prior(options.prior) if options.prior else None
    arm = load_arm(options.arm) if options.arm else prior.model.model.arm if prior else None
    if arm is not None:
        arm = arm if options.gravity is None else arm.with_gravity(np.array(options.gravity))
        options.settings(arm, prior)
    elif options.structure is not None:
        load_model(options.structure)


def find_bags(paths: Sequence[Path]) -> dict[str, Path]:
    """Name -> bag, of bags and of folders to look in: each once, no two of one name.

    A bag in a folder is named by its path from there, without `.mcap`; bags of one name by their path from the
    folder that holds them all.

    Raises:
        UserError: A path is not there, there is no bag in it, or two bags cannot be told apart by name.
    """
    named: dict[Path, str] = {}
    for path in paths:
        if not path.exists():
            raise UserError(f"{path}: no such file or folder; give bags, or folders that hold some")
        try:
            found = list(_bags_in(path))
        except OSError as error:
            raise UserError(f"{error.filename}: {error.strerror}; check its permissions") from error
        if not found:
            raise UserError(f"{path}: no bag in it (.mcap files, or rosbag2 folders with {METADATA}){_unmapped(path)}")
        for bag in found:
            inside = bag.relative_to(path) if bag != path else Path(bag.resolve().name)
            named.setdefault(bag.resolve(), inside.as_posix().removesuffix(ZSTD_SUFFIX).removesuffix(".mcap"))
    names = Counter(named.values())
    bags = {name if names[name] == 1 else _from_above(bag, name, named): bag for bag, name in named.items()}
    if len(bags) < len(named):
        lost = next(bag for bag in named if bag not in bags.values())
        raise UserError(f"{lost}: another bag has this name: rename one, or give the folder above both")
    return bags


def _bags_in(path: Path) -> Iterator[Path]:
    """The bag that a path is, or those below it; a folder with `metadata.yaml` is one bag, hidden ones are left out."""
    if path.is_file() or (path / METADATA).is_file() or is_log(path) or is_ros_bag(path):
        yield path
        return
    for entry in sorted(path.iterdir()):
        if entry.name.startswith("."):
            continue
        if entry.is_dir() and not entry.is_symlink():
            yield from _bags_in(entry)
        elif (is_mcap(entry) or is_ros_bag(entry) or _is_mapped(entry)) and not entry.is_dir():
            yield entry


def _is_mapped(path: Path) -> bool:
    """Whether a file is a log with a mapping beside it: a folder holds other tables as well."""
    return is_log(path) and mapping_beside(path) is not None


def _unmapped(path: Path) -> str:
    """What the logs of a folder without a bag lack; empty where it holds none."""
    logs = sorted(file for file in path.rglob("*") if file.is_file() and is_log(file))
    if not logs:
        return ""
    them = "1 log" if len(logs) == 1 else f"{len(logs)} logs"
    return (
        f", but {them} without a mapping of the columns: 'spacearm import {logs[0]} --arm ARM' writes one; that of all "
        f"in a folder may be called {FOLDER_MAPPING} (docs/logs.md)"
    )


def _from_above(bag: Path, name: str, named: dict[Path, str]) -> str:
    """A bag's path from the folder that holds all of its name."""
    above = os.path.commonpath([other.parent for other, its in named.items() if its == name])
    return bag.relative_to(above).as_posix()


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror or error}: choose another --out") from error
