"""`spacearm import`: what the columns of a log are, proposed, shown, and written as a mapping file."""  # noqa: N999

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..documents import write_whole
from ..dynamics.arm import load_arm
from ..errors import UserError, one_line
from ..logs.read import propose_for, recording_by
from ..logs.search import ANSWERS, Proposal
from ..recording import describe, write_recording
from ..recording.log_mapping import MAPPING_SUFFIX, mapping_to_dict, save_mapping
from ..report.import_html import import_html
from . import common

DESCRIPTION = """
Find out what the columns of a log are (CSV, TSV or columns with white space between, .npz, .mat, HDF5, Parquet, a
LeRobot dataset): which are positions, velocities, torques or currents, of which joint, in which unit, and what is the
time. Names are read in some ten languages; units and joints are tested against the arm: its limits, the derivative of
the positions, the weight of the CAD's arm. Show it as a table, write it as a mapping file, which every command then
finds beside the log, and draw the signals it gives on a page beside that (LOG.mapping.html). What cannot be decided is
asked, a line each, and answered with --set; nothing is guessed, and nothing written while a question is open (exit
code 2). Bags (.mcap, .db3, .bag) need no mapping. A log below 90 Hz or without torque is refused (exit code 1).
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("log", type=Path, metavar="LOG", help="the log")
    command.add_argument("--arm", type=Path, required=True, metavar="FILE", help="URDF or arm YAML")
    command.add_argument(
        "--mapping", type=Path, metavar="FILE", help=f"where the mapping goes (default: LOG{MAPPING_SUFFIX})"
    )
    command.add_argument("--out", type=Path, metavar="BAG", help="write an MCAP bag too: NAME.mcap, or a new folder")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help=f"answer a question; KEY: {', '.join(ANSWERS)}; of a signal VALUE is the name the table gives its columns",
    )
    command.add_argument(
        "--constants",
        nargs="+",
        action="extend",
        default=[],
        metavar="JOINT=VALUE",
        help="N m on the output side for each A (at 100 %%), where effort is a current (a share of the rated torque)",
    )
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Propose, show, write; returns 2 where a question is open."""
    if options.out is not None:
        common.require_bag_name(options.out)
    answers = {key: value for key, value in map(_pair, options.set)}
    constants = {joint: _number(joint, value) for joint, value in map(_pair, options.constants)}
    table, proposal = propose_for(options.log, options.arm, answers, constants)
    file = options.mapping or options.log.with_name(options.log.name + MAPPING_SUFFIX)
    if proposal.mapping is None:
        if options.json:
            common.print_json(_plain(proposal, file))
        else:
            show(proposal)
        return 2
    recording = recording_by(table, proposal.mapping, options.arm, str(options.log))
    picture = file.with_name(file.name.removesuffix(".yaml") + ".html")
    drawn = import_html(options.log, proposal, proposal.mapping, recording, load_arm(options.arm))
    save_mapping(proposal.mapping, file)
    _write_picture(picture, drawn)
    if options.out is not None:
        write_recording(options.out, recording, common.origin(options, options.arm, file))
    if options.json:
        common.print_json({**_plain(proposal, file), "picture": str(picture)})
        return 0
    show(proposal)
    for line in describe(recording):
        common.note(options, line)
    print(f"mapping: {file}\npicture: {picture}" + (f"\nbag: {options.out}" if options.out else ""))
    return 0


def _write_picture(path: Path, text: str) -> None:
    """Write the page.

    Raises:
        UserError: It cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); name another place") from error


def show(proposal: Proposal) -> None:
    """What was understood as a table, then what is left out and what is open."""
    width = max([len(row.columns) for row in proposal.rows] + [20]) + 2
    units = max([len(row.unit) for row in proposal.rows] + [6]) + 2
    if proposal.rows:
        print(f"{'signal':<10}{'columns, # for the joint':<{width + 4}}{'unit':<{units}}because")
    for row in proposal.rows:
        print(one_line(f"{row.signal:<10}{row.columns:<{width + 4}}{row.unit:<{units}}{row.because}"))
    for line in proposal.left_out:
        print(one_line(f"left out: {line}"))
    for question in proposal.questions:
        print(one_line(f"open: {question}"))


def _plain(proposal: Proposal, file: Path) -> dict[str, Any]:
    return {
        "mapping": None if proposal.mapping is None else mapping_to_dict(proposal.mapping, file.parent),
        "understood": [vars(row) for row in proposal.rows],
        "left_out": proposal.left_out,
        "questions": proposal.questions,
    }


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key or not value:
        raise UserError(f"{text!r} is no KEY=VALUE")
    return key.strip(), value.strip()


def _number(joint: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise UserError(f"--constants {joint} needs a number, not {text!r}") from error
    if not abs(value) < float("inf") or value == 0.0:
        raise UserError(f"--constants {joint} needs a finite number other than zero, not {text!r}")
    return value
