"""`index.html` of a folder that holds several results: every run in a row, what moved since the one before, trends.

What `spacearm batch` could not identify is known from the `summary.json` it leaves there.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from urllib.parse import quote

from ..errors import UserError
from ..estimate.identified import Validation
from ..identification.verdict import judge_result
from ..results.provenance import EPOCH, moment
from ..results.store import FIGURES, Result, load_result
from ..results.trends import arm_of, date_text, runs_by_arm
from .comparison import FAR, comparison_html, differences, moved
from .folder import REPORT, replacing
from .html import page
from .markup import NOTHING, Markup, breakable, element, join, listed, number, percent
from .mismatch_folder import DOCUMENT
from .trend_figures import arm_section

INDEX: Final = "index.html"
SUMMARY: Final = "summary.json"
MOST_NAMED: Final = 4


@dataclass(frozen=True)
class Entry:
    """A folder with a result, or with one that cannot be read.

    Attributes:
        name: Path below the indexed folder.
        result: What it holds, without signals; None where it cannot be read, or was not identified.
        problem: Why not.
        page: Whether there is a report to link to.
    """

    name: str
    result: Result | None
    problem: str = ""
    page: bool = True

    @property
    def recorded(self) -> str:
        """When its first run was, `2025-01-31 12:05` UTC; empty where it does not say."""
        when = moment(self.result.identified.model.provenance) if self.result else None
        text = date_text(when.start) if when else ""
        return "" if text.startswith(EPOCH) else text

    @property
    def written(self) -> str:
        """When the result was, in the same form."""
        return self.result.written[:16].replace("T", " ") if self.result else ""

    @property
    def order(self) -> tuple[bool, str, str]:
        """By recording, where that is known, else by writing; those without a result last."""
        return (self.result is None, self.recorded or self.written, self.name)


@dataclass(frozen=True)
class MismatchEntry:
    """A folder that `spacearm mismatch` wrote: its verdict, and what it found."""

    name: str
    verdict: str
    findings: tuple[str, ...]


Progress = Callable[[float, str], None]


def write_index(directory: Path, progress: Progress = lambda share, what: None) -> Path:
    """Write the index of a folder.

    Raises:
        UserError: There is no result below it, or it cannot be written.
    """
    entries = with_failures(find_results(directory, progress), directory, *_failures(directory))
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


def find_results(directory: Path, progress: Progress = lambda share, what: None) -> list[Entry]:
    """All results below a folder, oldest recording first; those that cannot be read last."""
    folders = _holding(directory, FIGURES)
    entries = []
    for number_, folder in enumerate(folders):
        progress(number_ / len(folders), f"reading {folder.name}")
        name = _name(folder, directory)
        try:
            result = load_result(folder)
            entries.append(Entry(name, replace(result, validation=replace(result.validation, traces=()))))
        except UserError as error:
            entries.append(Entry(name, None, str(error)))
    return sorted(entries, key=lambda entry: entry.order)


def with_failures(
    entries: Sequence[Entry], directory: Path, failures: Mapping[str, str], when: str | None = None
) -> list[Entry]:
    """The entries of a folder, with those that a batch could not identify in place of what older results say.

    Args:
        entries: As `find_results`.
        directory: The folder.
        failures: Name -> reason.
        when: Of the batch (ISO 8601); later results count. None: now.
    """
    shown = {entry.name: entry for entry in entries}
    for name, reason in failures.items():
        there = shown.get(name)
        if when is None or there is None or there.result is None or there.result.written < when:
            shown[name] = Entry(name, None, reason, (directory / name / REPORT).is_file())
    return sorted(shown.values(), key=lambda entry: entry.order)


def _failures(directory: Path) -> tuple[dict[str, str], str]:
    """What the last batch into a folder could not identify, with its reason, and when that was; nothing if none was."""
    try:
        data = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
        found = {str(run["run"]): str(run["reason"]) for run in data["runs"] if run["reason"]}
        return found, str(data["written"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}, ""


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
    count = f"{len(entries)} runs" if len(entries) != 1 else "1 run"
    arms = runs_by_arm(entry.result for entry in entries if entry.result is not None)
    body = join(
        element("h1", f"Results in {title}"),
        element("p", f"{count}, oldest first", class_="quiet"),
        _runs(entries) if entries else None,
        *(arm_section(arm, runs) for arm, runs in arms.items()),
        _mismatches(mismatches) if mismatches else None,
    )
    return page(f"Results in {title}", body)


def _runs(entries: Sequence[Entry]) -> Markup:
    heads = (
        "run",
        "recorded, UTC",
        "written, UTC",
        "arm",
        "verdict",
        "worst residual, moving",
        "lowest R",
        "changed since the run before",
    )
    kinds = ("text", "text", "text", "text", "text", "wrap", "wrap", "text wrap")
    header = element("tr", *(element("th", head, class_=kind) for head, kind in zip(heads, kinds)))
    rows, last = [], dict[tuple[str, ...], Entry]()
    for entry in entries:
        if entry.result is None:
            rows.append(
                element("tr", _link(entry), element("td", entry.problem, class_="text wrap", colspan=len(heads) - 1))
            )
            continue
        key = arm_of(entry.result)
        rows.append(_run_row(entry, entry.result, last.get(key)))
        last[key] = entry
    return join(
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
        element(
            "p",
            f"Changed: by more than {FAR:g} standard errors of the difference to the run before of the arm; counted "
            "among parameters with a standard error in both. Side by side: ",
            element("code", "spacearm report DIR --compare RUN RUN"),
            ".",
            class_="quiet",
        ),
    )


def _run_row(entry: Entry, result: Result, before: Entry | None) -> Markup:
    verdict = judge_result(result.identified, result.validation)
    worst, lowest = merit(result.validation)
    return element(
        "tr",
        _link(entry),
        element("td", entry.recorded or NOTHING, class_="text"),
        element("td", entry.written, class_="text"),
        element("td", result.identified.model.model.arm.name, class_="text wrap"),
        element("td", verdict.level, class_=f"text {verdict.level}", title=verdict.headline),
        element("td", percent(worst)),
        element("td", f"{lowest:.4f}" if math.isfinite(lowest) else NOTHING),
        element("td", *_since(result, before), class_="text wrap note"),
    )


def merit(validation: Validation) -> tuple[float, float]:
    """Residual over torque (RMS) of the worst joint while it moves, and the lowest R; NaN where no joint has one."""
    joints = validation.joints.values()
    shares = [joint.moving.relative_rms for joint in joints if math.isfinite(joint.moving.relative_rms)]
    correlations = [j.everything.correlation for j in joints if math.isfinite(j.everything.correlation)]
    return max(shares, default=math.nan), min(correlations, default=math.nan)


def _since(result: Result, before: Entry | None) -> tuple[object, ...]:
    if before is None or before.result is None:
        return (NOTHING,)
    found = differences(before.result.identified, result.identified)
    compared = sum(math.isfinite(item.errors) for item in found)
    far = moved(found)
    names = [f"{item.name} ({number(item.errors, 2)})" for item in far]
    detail = element("span", f": {listed(names, MOST_NAMED)}", class_="quiet") if far else None
    return (f"{len(far)} of {compared}", detail)


def _mismatches(mismatches: Sequence[MismatchEntry]) -> Markup:
    header = element("tr", *(element("th", head, class_="text") for head in ("folder", "verdict", "findings")))
    rows = [
        element(
            "tr",
            _link(entry),
            element("td", entry.verdict.replace("_", " "), class_="text wrap"),
            element("td", "; ".join(entry.findings) or NOTHING, class_="text wrap"),
        )
        for entry in mismatches
    ]
    return join(
        element("h2", "Mismatches"),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )


def _link(entry: Entry | MismatchEntry) -> Markup:
    """To a run's page. Relative, so that the folder may move; a scheme in a name stays part of the path."""
    name = breakable(entry.name)
    if isinstance(entry, Entry) and not entry.page:
        return element("th", name, class_="text wrap")
    return element("th", element("a", name, href=f"./{quote(entry.name)}/{REPORT}"), class_="text wrap")
