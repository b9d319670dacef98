"""`spacearm report`: make the page of a result folder again, an index of several, or a comparison of two."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..report.folder import rewrite_report
from ..report.index import write_comparison, write_index
from ..results.store import FIGURES
from . import common

DESCRIPTION = """
Write report.html of a result folder again, from what the folder holds. Of a folder that holds several results, at any
depth, write index.html: every run with its verdict and what moved since the run before. With --compare, write a page
that has two runs side by side, with the difference of every parameter in standard errors.
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("directory", type=Path, metavar="DIR", help="folder written by identify, or one of several")
    command.add_argument(
        "--compare", nargs=2, type=Path, metavar="RUN", help="two result folders, by path or by name in DIR"
    )
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write, and say where."""
    if options.compare:
        print(write_comparison(options.directory, *options.compare))
    elif (options.directory / FIGURES).is_file() or not options.directory.is_dir():
        print(rewrite_report(options.directory))
    else:
        with common.progress(options) as report:
            page = write_index(options.directory, report)
        print(page)
    return 0
