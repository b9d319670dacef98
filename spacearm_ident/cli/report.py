"""`spacearm report`: make the page of a result folder again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..report.folder import rewrite_report


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser(
        "report",
        help="(re)write the HTML report of a result folder",
        description="Write report.html of a result folder again, from what the folder holds.",
    )
    command.add_argument("directory", type=Path, metavar="DIR", help="folder written by identify")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Rewrite and say where."""
    print(rewrite_report(options.directory))
    return 0
