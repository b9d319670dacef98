"""`spacearm batch`: many bags in, a result folder each, a summary and their trends out."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..report.index import INDEX
from ..report.summary import IDENTIFIED
from ..sessions.batch import identify_batch
from . import common, identify

DESCRIPTION = """
Identify every bag by itself, as 'spacearm identify BAG' does, side by side, into DIR/NAME; the last third of each is
held out of its fit. DIR/index.html shows all, with trends and steps over date and temperature; summary.csv
and summary.json have the same for programs. A bag that is unfit or cannot be read is a row with its reason. The same
command again does only what is missing: a result of the same bag, options and versions stays.
"""
INTERRUPTED = 130


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="bags, or folders to look for bags in")
    command.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the result folders")
    command.add_argument("--jobs", type=int, metavar="N", help="processes at a time, one core each (default: cores)")
    command.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="have it done by the workers of a Dask cluster (tcp://host:8786), which must see bags and DIR under the "
        "same paths; needs pip install 'spacearm_ident[dask]'",
    )
    command.add_argument("--again", action="store_true", help="do again what is there already")
    command.add_argument(
        "--arm-by-folder",
        action="store_true",
        help="several arms of one type: the first folder of a bag's NAME tells which (arm1/monday.mcap); without it "
        "arms are told apart by the robot's name in the URDF and its joints alone",
    )
    identify.add_options(command)
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Identify all, and say what became of each."""
    try:
        with common.progress(options) as report:
            summary = identify_batch(
                options.bags,
                options.out,
                identify.options_of(options),
                jobs=options.jobs,
                scheduler=options.scheduler,
                again=options.again,
                by_folder=options.arm_by_folder,
                progress=report,
            )
    except KeyboardInterrupt:
        print("spacearm: interrupted; the same command goes on with what is missing", file=sys.stderr)
        return INTERRUPTED
    if options.json:
        common.print_json(summary)
    else:
        print(table(summary["runs"], options.out / INDEX))
    return 0 if all(row["status"] == IDENTIFIED for row in summary["runs"]) else 1


def table(rows: list[dict[str, Any]], page: Path) -> str:
    """The summary on a terminal: how many were identified, what to do next, a line a run.

    Args:
        rows: `runs` of `summary.json`, at least one; what became of each bag.
        page: Index page of the batch, which the user is told to open.
    """
    done = sum(row["status"] == IDENTIFIED for row in rows)
    rest = "" if done == len(rows) else f"; the reasons of the other {len(rows) - done} are below"
    width = max(len("run"), *(len(row["run"]) for row in rows))
    lines = [
        f"{done} of {len(rows)} bags identified{rest}",
        f"next: look at {page}",
        f"{'run':<{width}}  {'recorded, UTC':<17}{'fit':<9}{'R':>8}{'rel. RMS':>10}",
    ]
    for row in rows:
        if row["status"] != IDENTIFIED:
            lines.append(f"{row['run']:<{width}}  {row['status']}: {row['reason']}")
            continue
        when = (row["recorded"] or "-")[:16].replace("T", " ")
        r = "-" if row["r"] is None else f"{row['r']:.4f}"
        share = "-" if row["relative_rms"] is None else f"{row['relative_rms']:.1%}"
        lines.append(
            f"{row['run']:<{width}}  {when:<17}{row.get('verdict') or '-':<9}{r:>8}{share:>10}"
            + (f"  {'; '.join(row['issues'])}" if row["issues"] else "")
            + ("  as before" if row["skipped"] else "")
            + (f"  the same data as {row['copy_of']}: counted once" if row["copy_of"] else "")
            + (f"  {row['wrong_clock']}: in no trend over date" if row["wrong_clock"] else "")
        )
    return "\n".join([*lines, "R and rel. RMS: of the worst joint, on the last third of each bag, held out of its fit"])
