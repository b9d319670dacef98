"""`index.html` of a folder that holds several results: every run in a row, what moved since the one before, trends.

What `spacearm batch` could not identify is known from the `summary.json` it leaves there.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from ..errors import UserError, one_line
from ..estimate.identified import Validation
from ..identification.verdict import judge_result, relative_rms
from ..results.changes import FEWEST_DIFFERENCES, Change, changes
from ..results.course import LEVEL
from ..results.store import FIGURES, Result, load_result
from ..results.trends import Arm, arm_of, date_text, runs_by_arm
from .comparison import comparison_html
from .figures import short
from .folder import REPORT, replacing
from .mismatch_folder import DOCUMENT
from .pages import render
from .text import minute, number
from .trend_figures import trends_of

INDEX: Final = "index.html"
SUMMARY: Final = "summary.json"
LONGEST_NAME: Final = 60
"""Characters of a quantity's name in a row; a base parameter is a long sum."""


@dataclass(frozen=True)
class Entry:
    """A folder with a result, or with one that cannot be read.

    Attributes:
        name: Path below the indexed folder.
        result: What it holds, without signals; None where it cannot be read, or was not identified.
        problem: Why not; of unfit data as well, which have a result that is compared with none.
        page: Whether there is a report to link to.
        copy_of: Name of an entry that is made of the same data under the same options; empty: of none.
    """

    name: str
    result: Result | None
    problem: str = ""
    page: bool = True
    copy_of: str = ""

    @property
    def counted(self) -> Result | None:
        """The result, where it takes part in trends and comparisons: of fit data, which are counted once."""
        return None if self.problem or self.copy_of else self.result

    @property
    def issues(self) -> list[str]:
        """What was found wrong with its recordings and what was done about it, a sentence each."""
        return [issue for run in self.result.runs for issue in run.defects] if self.result else []

    @property
    def wrong_clock(self) -> str:
        """Why its clock gives no date; empty where it does, or nothing is known."""
        when = self.result.moment if self.result else None
        return when.wrong_clock if when else ""

    @property
    def placed(self) -> Result | None:
        """The result, where it has a place in time as well."""
        return None if self.wrong_clock else self.counted

    @property
    def recorded(self) -> str:
        """When its first run was, `2025-01-31 12:05` UTC; empty where it does not say."""
        when = self.result.moment if self.result else None
        return date_text(when.date) if when and when.date else ""

    @property
    def written(self) -> str:
        """When the result was, in the same form."""
        return minute(self.result.written) if self.result else ""

    @property
    def link(self) -> str | None:
        """Address of its report, relative to the page; None where there is none."""
        return _link(self.name) if self.page else None

    @property
    def order(self) -> tuple[bool, bool, str, str]:
        """By recording, where that is known, else by writing; then wrong clocks, last those without a result."""
        return (self.result is None, bool(self.wrong_clock), self.recorded or self.written, self.name)


@dataclass(frozen=True)
class MismatchEntry:
    """A folder that `spacearm mismatch` wrote: its verdict, and what it found."""

    name: str
    verdict: str
    findings: tuple[str, ...]

    @property
    def link(self) -> str:
        """Address of its report, relative to the page."""
        return _link(self.name)


Progress = Callable[[float, str], None]


def write_index(directory: Path, progress: Progress = lambda share, what: None) -> Path:
    """Write the index of a folder.

    Args:
        directory: Folder with result folders below it, at any depth; hidden ones are skipped.
        progress: Called with a share done in 0..1 and what is being read.

    Returns:
        The page.

    Raises:
        UserError: There is no result below it, or it cannot be written.
    """
    last = _last_batch(directory)
    entries = with_failures(find_results(directory, progress, last.by_folder), directory, last.failures, last.written)
    mismatches = find_mismatches(directory)
    if not entries and not mismatches:
        raise UserError(f"no result in {directory} or below: name a folder with results of 'spacearm identify --out'")
    with replacing(directory, marker=None) as staging:
        (staging / INDEX).write_text(index_html(directory.resolve().name, entries, mismatches), encoding="utf-8")
    return directory / INDEX


def write_comparison(directory: Path, first: Path, second: Path) -> Path:
    """Write a page into `directory` that compares two results.

    Args:
        directory: Where to; also where to look for folders that are named as if from there.
        first: Result folder, by its path or its name in `directory`.
        second: Another.

    Raises:
        UserError: One is no result folder, they have nothing in common, or the page cannot be written.
    """
    folders = [directory / path if (directory / path).is_dir() else path for path in (first, second)]
    names = (_name(folders[0], directory), _name(folders[1], directory))
    text = comparison_html(names, (load_result(folders[0]), load_result(folders[1])))
    file = f"comparison_{_slug(names[0])}_{_slug(names[1])}.html"
    with replacing(directory, marker=None) as staging:
        (staging / file).write_text(text, encoding="utf-8")
    return directory / file


def find_results(
    directory: Path, progress: Progress = lambda share, what: None, by_folder: bool = False
) -> list[Entry]:
    """All results below a folder, oldest recording first; those that cannot be read last.

    Args:
        directory: Folder with result folders below it, at any depth; hidden ones are skipped.
        progress: Called with a share done in 0..1 and what is being read.
        by_folder: Whether the first folder of a name tells which arm it is.

    Returns:
        Entries whose results are without their signals, or that say why one cannot be read.
    """
    folders = _holding(directory, FIGURES)
    entries = []
    for number_, folder in enumerate(folders):
        progress(number_ / len(folders), f"reading {folder.name}")
        name = _name(folder, directory)
        try:
            result = load_result(folder)
            individual = folder_of_arm(name) if by_folder else ""
            result = replace(result, validation=replace(result.validation, traces=()), individual=individual)
            entries.append(Entry(name, result, unfit_reason(result.unfit)))
        except UserError as error:
            entries.append(Entry(name, None, str(error)))
    return sorted(entries, key=lambda entry: entry.order)


def with_failures(
    entries: Sequence[Entry], directory: Path, failures: Mapping[str, str], when: str | None = None
) -> list[Entry]:
    """The entries of a folder: copies known as such, and what a batch could not identify in place of older results.

    Args:
        entries: As `find_results`.
        directory: The folder.
        failures: Name -> reason.
        when: Of the batch (ISO 8601); later results count. None: now.
    """
    shown = {entry.name: entry for entry in entries}
    for name, reason in failures.items():
        there = shown.get(name)
        if there is not None and there.result is not None and there.problem == reason:
            continue  # The result is the one of this batch: its data are unfit.
        if when is None or there is None or there.result is None or there.result.written < when:
            shown[name] = Entry(name, None, reason, (directory / name / REPORT).is_file())
    first: dict[str, str] = {}
    found = []
    for entry in sorted(shown.values(), key=lambda entry: entry.order):
        made_of = entry.result.inputs if entry.result else None
        found.append(replace(entry, copy_of=first.get(made_of, "")) if made_of else entry)
        if made_of:
            first.setdefault(made_of, entry.name)
    return found


def unfit_reason(unfit: Sequence[str]) -> str:
    """`ConventionReport.unfit` in one line, for a row; empty where the data are fit."""
    return one_line("; ".join(unfit))


def folder_of_arm(name: str) -> str:
    """The first folder of a run's name, `arm1` of `arm1/2025/monday`; empty where it lies in none."""
    return name.partition("/")[0] if "/" in name else ""


@dataclass(frozen=True)
class LastBatch:
    """What is known of the last batch into a folder.

    Attributes:
        failures: Name -> reason, of what it could not identify.
        written: When that was, ISO 8601.
        by_folder: Whether the first folder of a name tells which arm it is.
    """

    failures: Mapping[str, str]
    written: str
    by_folder: bool


def _last_batch(directory: Path) -> LastBatch:
    """Of `summary.json`; nothing failed where there is none."""
    try:
        data = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
        found = {str(run["run"]): str(run["reason"]) for run in data["runs"] if run["reason"]}
        return LastBatch(found, str(data["written"]), bool(data.get("arm_by_folder")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return LastBatch({}, "", False)


def find_mismatches(directory: Path) -> list[MismatchEntry]:
    """All explained mismatches below a folder, by name."""
    entries = []
    for folder in _holding(directory, DOCUMENT):
        name = _name(folder, directory)
        try:
            data = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
            found = tuple(f"{item['effect']} at {', '.join(item['joints'])}" for item in data["findings"])
            found += tuple(
                f"{layer['layer']}: {len(layer['items'])} differ" for layer in data.get("layers", ()) if layer["items"]
            )
            entries.append(MismatchEntry(name, str(data["verdict"]), found))
        except (OSError, ValueError, KeyError, TypeError) as error:
            entries.append(MismatchEntry(name, f"cannot be read ({type(error).__name__} {error})", ()))
    return entries


def _holding(directory: Path, file: str) -> list[Path]:
    """Folders below `directory` that hold a file; none that are hidden or being written."""
    found = sorted(path.parent for path in directory.rglob(file))
    return [
        folder
        for folder in found
        if folder != directory and not any(part.startswith(".") for part in folder.relative_to(directory).parts)
    ]


def _name(folder: Path, directory: Path) -> str:
    try:
        return folder.resolve().relative_to(directory.resolve()).as_posix()
    except ValueError:
        return folder.as_posix()


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.-]+", "-", name).strip("-.") or "result"


def index_html(title: str, entries: Sequence[Entry], mismatches: Sequence[MismatchEntry]) -> str:
    """The index page of a folder of results, as HTML.

    Args:
        title: Name of the folder.
        entries: Results of identifications, in the order of the page.
        mismatches: Results of `spacearm mismatch` in the folder.
    """
    arms = runs_by_arm(entry.counted for entry in entries if entry.counted is not None)
    return render(
        "index.html",
        folder=title,
        entries=entries,
        runs=compared_runs(entries),
        residuals=_residuals(entries),
        level=LEVEL,
        fewest=FEWEST_DIFFERENCES,
        trends=[found for arm, runs in arms.items() if (found := trends_of(arm, runs))],
        mismatches=mismatches,
    )


def compared_runs(entries: Sequence[Entry]) -> dict[str, dict[str, Any]]:
    """What page and summary say of every run that has a result.

    Args:
        entries: In the order of the page.

    Returns:
        Name -> its arm and verdict, `worst` and `lowest` (`merit`), `since`: the run before, of the same arm, and what
        changed since then (`changed`, in words `far`) of how many that could be `compared`; None where there is none.
    """
    placed = [(entry, entry.placed) for entry in entries if entry.placed is not None]
    names: dict[Arm, list[str]] = {}
    for entry, result in placed:
        names.setdefault(arm_of(result), []).append(entry.name)
    arms = runs_by_arm(result for _, result in placed)
    changed = {name: found for arm in names for name, found in zip(names[arm], changes(arms[arm]), strict=True)}
    since = {name: last for those in names.values() for last, name in pairwise(those)}
    shown = {}
    for entry in entries:
        if entry.result is None:
            continue
        result, arm = entry.result, arm_of(entry.result)
        moved = _moved(changed.get(entry.name, ()))
        worst, lowest = merit(result.validation)
        shown[entry.name] = {
            "arm": arm[0],
            "verdict": judge_result(result.identified, result.validation, result.unfit),
            "worst": worst,
            "lowest": lowest,
            "since": since.get(entry.name),
            "compared": len(changed[entry.name]) if entry.name in since else None,
            "changed": moved,
            "far": [
                f"{short(item.name, LONGEST_NAME)} ({number(item.errors, 2)}{'' if item.ordinary else '*'})"
                for item in moved
            ],
        }
    return shown


def _moved(found: Sequence[Change]) -> list[Change]:
    """Those that are more than ordinary, least probable first."""
    return sorted((item for item in found if item.moved), key=lambda item: (item.p_value, -abs(item.errors)))


def _residuals(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Of every arm its joints, and of its runs that are fit the residual over torque (RMS) of each while it moves."""
    tables: dict[tuple[str, ...], dict[str, Any]] = {}
    for entry in entries:
        if entry.counted is not None:
            name, *joints = arm = arm_of(entry.counted)
            table = tables.setdefault(arm, {"name": name, "joints": joints, "runs": []})
            table["runs"].append((entry, relative_rms(entry.counted.validation)))
    return list(tables.values())


def merit(validation: Validation) -> tuple[float, float]:
    """Residual over torque (RMS) of the worst joint while it moves, and the lowest R; NaN where no joint has one."""
    joints = validation.joints.values()
    correlations = [j.everything.correlation for j in joints if math.isfinite(j.everything.correlation)]
    return max(relative_rms(validation).values(), default=math.nan), min(correlations, default=math.nan)


def _link(name: str) -> str:
    """Address of a run's page, relative to the folder."""
    return f"./{quote(name)}/{REPORT}"
