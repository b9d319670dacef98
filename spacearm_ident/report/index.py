"""`index.html` of a folder that holds several results: every run in a row, and what moved since the one before."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import quote

from ..errors import UserError
from .comparison import FAR, comparison_html, differences, moved
from .folder import REPORT, replacing
from .html import page
from .markup import NOTHING, Markup, breakable, element, join, listed, number, percent
from .mismatch_folder import DOCUMENT
from .store import FIGURES, Result, load_result
from .verdict import judge_result

INDEX: Final = "index.html"
MOST_NAMED: Final = 4


@dataclass(frozen=True)
class Entry:
    """A folder with a result, or with one that cannot be read.

    Attributes:
        name: Path below the indexed folder.
        result: What it holds; None where it cannot be read.
        problem: Why not.
    """

    name: str
    result: Result | None
    problem: str = ""


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
    entries = find_results(directory, progress)
    mismatches = find_mismatches(directory)
    if not entries and not mismatches:
        raise UserError(
            f"no result in {directory} or below: give a folder that holds some of 'spacearm identify --out'"
        )
    with replacing(directory) as staging:
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
    with replacing(directory) as staging:
        (staging / file).write_text(text, encoding="utf-8")
    return directory / file


def find_results(directory: Path, progress: Progress = lambda share, what: None) -> list[Entry]:
    """All results below a folder, oldest first; those that cannot be read last."""
    folders = _holding(directory, FIGURES)
    entries = []
    for number_, folder in enumerate(folders):
        progress(number_ / len(folders), f"reading {folder.name}")
        name = _name(folder, directory)
        try:
            entries.append(Entry(name, load_result(folder)))
        except UserError as error:
            entries.append(Entry(name, None, str(error)))
    return sorted(
        entries, key=lambda entry: (entry.result is None, entry.result.written if entry.result else "", entry.name)
    )


def find_mismatches(directory: Path) -> list[MismatchEntry]:
    """All explained mismatches below a folder, by name."""
    entries = []
    for folder in _holding(directory, DOCUMENT):
        name = _name(folder, directory)
        try:
            data = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
            found = tuple(f"{item['effect']} at {', '.join(item['joints'])}" for item in data["findings"])
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
    """The whole page."""
    count = f"{len(entries)} runs" if len(entries) != 1 else "1 run"
    body = join(
        element("h1", f"Results in {title}"),
        element("p", f"{count}, oldest first", class_="quiet"),
        _runs(entries) if entries else None,
        _mismatches(mismatches) if mismatches else None,
    )
    return page(f"Results in {title}", body)


def _runs(entries: Sequence[Entry]) -> Markup:
    heads = (
        "run",
        "written, UTC",
        "arm",
        "verdict",
        "worst residual, moving",
        "lowest R",
        "moved since the run before",
    )
    texts = (0, 1, 2, 3, 6)
    header = element("tr", *(element("th", h, class_="text" if k in texts else None) for k, h in enumerate(heads)))
    rows, last = [], dict[tuple[str, ...], Entry]()
    for entry in entries:
        if entry.result is None:
            rows.append(
                element(
                    "tr", _link(entry.name), element("td", entry.problem, class_="text wrap", colspan=len(heads) - 1)
                )
            )
            continue
        arm = entry.result.identified.model.model.arm
        key = (arm.name, *arm.joint_names)
        rows.append(_run_row(entry.name, entry.result, last.get(key)))
        last[key] = entry
    return join(
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
        element(
            "p",
            f"Moved: by more than {FAR:g} standard errors of the difference, since the run before of the same arm; of "
            "those parameters that have an error in both. Side by side: ",
            element("code", "spacearm report DIR --compare RUN RUN"),
            ".",
            class_="quiet",
        ),
    )


def _run_row(name: str, result: Result, before: Entry | None) -> Markup:
    joints = result.validation.joints.values()
    verdict = judge_result(result.identified, result.validation)
    shares = [joint.moving.relative_rms for joint in joints if math.isfinite(joint.moving.relative_rms)]
    correlations = [j.everything.correlation for j in joints if math.isfinite(j.everything.correlation)]
    return element(
        "tr",
        _link(name),
        element("td", result.written[:16].replace("T", " "), class_="text"),
        element("td", result.identified.model.model.arm.name, class_="text wrap"),
        element("td", verdict.level, class_=f"text {verdict.level}", title=verdict.headline),
        element("td", percent(max(shares)) if shares else NOTHING),
        element("td", f"{min(correlations):.4f}" if correlations else NOTHING),
        element("td", *_since(result, before), class_="text wrap"),
    )


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
            _link(entry.name),
            element("td", entry.verdict.replace("_", " "), class_="text wrap"),
            element("td", "; ".join(entry.findings) or NOTHING, class_="text wrap"),
        )
        for entry in mismatches
    ]
    return join(
        element("h2", "Mismatches"),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )


def _link(name: str) -> Markup:
    """To a run's page. Relative, so that the folder may move; a scheme in a name stays part of the path."""
    target = f"./{quote(name)}/{REPORT}"
    return element("th", element("a", breakable(name), href=target), class_="text wrap")
