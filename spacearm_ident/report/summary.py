"""`summary.json` and `summary.csv` of a batch, with the index page: every bag in a row, whatever became of it."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from ..documents import finite
from ..estimate.identified import Estimate
from ..identification.verdict import judge_result, relative_rms
from ..results.store import Result
from ..results.tables import by_joint
from ..results.trends import arm_of, runs_by_arm, trend_dict, trends
from .folder import replacing
from .index import (
    INDEX,
    SUMMARY,
    Progress,
    compared_runs,
    find_mismatches,
    find_results,
    index_html,
    merit,
    with_failures,
)

SCHEMA: Final = "spacearm_ident/batch/1"
TABLE: Final = "summary.csv"
IDENTIFIED, UNFIT, FAILED = "identified", "unfit", "failed"


@dataclass(frozen=True)
class Row:
    """What became of one bag.

    Attributes:
        name: Of its result, below the folder.
        bag: The recording.
        status: `IDENTIFIED`, `UNFIT` (readable, and cannot carry it, or breaks a convention) or `FAILED`.
        reason: Why not, one line.
        skipped: Whether it was up to date already.
    """

    name: str
    bag: Path
    status: str
    reason: str = ""
    skipped: bool = False


def write_summary(
    directory: Path,
    rows: Sequence[Row],
    progress: Progress = lambda share, what: None,
    by_folder: bool = False,
) -> dict[str, Any]:
    """Write both summaries and the index into a folder that holds the results.

    Args:
        directory: Folder that holds the results, each in a folder below it.
        rows: What became of each bag; one that is not identified is listed as a failure.
        progress: Called with a share done in 0..1 and what is being read.
        by_folder: Whether the first folder of a name tells which arm it is.

    Returns:
        The content of `summary.json`.

    Raises:
        UserError: The folder cannot be written.
    """
    found = find_results(directory, progress, by_folder)
    failures = {row.name: row.reason for row in rows if row.status != IDENTIFIED}
    entries = with_failures(found, directory, failures)
    results = {entry.name: entry.result for entry in entries if entry.result}
    counted = {entry.name: entry.counted for entry in entries if entry.counted}
    compared = compared_runs(entries)
    copies = {entry.name: entry.copy_of for entry in entries}
    described = [_run(row, results.get(row.name), compared.get(row.name), copies.get(row.name, "")) for row in rows]
    document = {
        "schema": SCHEMA,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "arm_by_folder": by_folder,
        "runs": described,
        "trends": [
            trend_dict(arm, trend)
            for arm, runs in runs_by_arm(counted[row.name] for row in rows if row.name in counted).items()
            for trend in trends(runs)
            if trend.slope is not None
        ],
    }
    with replacing(directory, marker=None) as staging:
        text = json.dumps(document, indent=1, allow_nan=False)
        (staging / SUMMARY).write_text(text + "\n", encoding="utf-8")
        (staging / TABLE).write_text(summary_csv(described), encoding="utf-8")
        page = index_html(directory.resolve().name, entries, find_mismatches(directory))
        (staging / INDEX).write_text(page, encoding="utf-8")
    return document


def _run(row: Row, result: Result | None, compared: Mapping[str, Any] | None, copy_of: str) -> dict[str, Any]:
    """One bag, for `summary.json`: the same keys whatever became of it, None where there is nothing.

    Args:
        row: What became of it.
        result: Where it has one.
        compared: Of `compared_runs`.
        copy_of: Run of the same data, which is counted instead of this one; empty: there is none.
    """
    when = result.moment if result else None
    fit = result if row.status == IDENTIFIED else None
    worst, lowest = merit(fit.validation) if fit else (math.nan, math.nan)
    judged = judge_result(result.identified, result.validation, result.unfit) if result else None
    listed = by_joint(fit.identified) if fit else None
    return {
        "run": row.name,
        "bag": str(row.bag),
        "status": row.status,
        "reason": row.reason,
        "skipped": row.skipped,
        "recorded": when.date.isoformat() if when and when.date else None,
        "wrong_clock": (when.wrong_clock or None) if when else None,
        "copy_of": copy_of or None,
        "written": result.written if result else None,
        "arm": arm_of(result)[0] if result else None,
        "issues": [issue for run in result.runs for issue in run.defects] if result else None,
        "verdict": str(judged.level) if judged else row.status if row.status == UNFIT else None,
        "r": finite(lowest),
        "relative_rms": finite(worst),
        "relative_rms_by_joint": relative_rms(fit.validation) if fit else None,
        "changed": _changed(compared),
        "temperature_C": (when.temperature if when else {}) if result else None,
        "parameters": None if listed is None else _parameters(item for items in listed.values() for item in items),
    }


def _changed(compared: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What changed since the run before, and of how many parameters that could be compared; None: there is none."""
    if not compared or compared["since"] is None:
        return None
    items = [
        {
            "name": item.name,
            "joint": item.joint,
            "difference": finite(item.value),
            "unit": item.unit,
            "error": finite(item.error),
            "ordinary": item.ordinary,
            "p_value": finite(item.p_value),
        }
        for item in compared["changed"]
    ]
    return {"since": compared["since"], "compared": compared["compared"], "parameters": items}


def _parameters(estimates: Iterable[Estimate]) -> dict[str, dict[str, Any]]:
    return {
        item.name: {
            "value": finite(item.value),
            "standard_error": finite(item.standard_error),
            "unit": item.unit,
            "determined_by": item.determination.value,
        }
        for item in estimates
    }


def summary_csv(runs: Sequence[Mapping[str, Any]]) -> str:
    """One row a bag: what `summary.json` says of it, a column a joint's residual and temperature, two a parameter.

    Numbers keep every digit; an empty cell is one that is not known.
    """
    about = ["run", "bag", "status", "reason", "recorded", "wrong_clock", "copy_of"]
    about += ["written", "arm", "issues", "r", "relative_rms"]
    warm = list(dict.fromkeys(joint for run in runs for joint in (run["temperature_C"] or {})))
    names = list(dict.fromkeys(name for run in runs for name in (run["parameters"] or {})))
    joints = list(dict.fromkeys(joint for run in runs for joint in (run["relative_rms_by_joint"] or {})))
    columns = [f"relative_rms[{joint}]" for joint in joints] + [f"temperature_C[{joint}]" for joint in warm]
    columns += [column for name in names for column in (name, f"standard error {name}")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*about, *columns])
    for run in runs:
        cells = ["; ".join(run[key] or ()) if key == "issues" else run[key] for key in about]
        cells += [(run["relative_rms_by_joint"] or {}).get(joint) for joint in joints]
        cells += [*((run["temperature_C"] or {}).get(joint) for joint in warm)]
        for name in names:
            item = (run["parameters"] or {}).get(name, {})
            cells += [item.get("value"), item.get("standard_error")]
        writer.writerow("" if cell is None else repr(cell) if isinstance(cell, float) else cell for cell in cells)
    return text.getvalue()
