"""`spacearm new-arm`: the configuration files of an arm, from its URDF and its drives' data sheet."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..commissioning.starter import ARM_FILE, CAN_FILE, NODES_FILE, DataSheet, starter_files
from ..dynamics.arm import arm_from_urdf
from ..errors import UserError

DESCRIPTION = f"""
Write the files of an arm into DIR: {ARM_FILE} (limits, gears), {CAN_FILE} (buses and drives), {NODES_FILE} (parameters
of the ROS nodes), layouts for Foxglove and PlotJuggler, with URDF and EDS beside them. Every line of the YAML says
where its value is from: URDF, ASSUMED, or FILL IN for what nobody can guess; 'spacearm check DIR' says what is still
missing. What the data sheets say can be given here at once, one number for all joints or one a joint.
"""
SHEET = {
    "gear_ratio": "motor turns a joint turn (also taken from the URDF's transmissions)",
    "torque_constant": "N m/A at the motor",
    "rated_current": "A: what 1000 per mille of object 0x6077 stand for",
    "counts_per_turn": "encoder counts a motor turn",
}


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser("new-arm", help="write the configuration files of your arm", description=DESCRIPTION)
    command.add_argument("urdf", type=Path, metavar="URDF", help="robot description: kinematics, limits, CAD inertials")
    command.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder to write")
    command.add_argument("--eds", type=Path, metavar="FILE", help="the drives' electronic data sheet (CiA 306)")
    command.add_argument(
        "--interface",
        default="socketcan",
        metavar="NAME",
        help="python-can's interface (default socketcan); local: the simulated arm",
    )
    for key, words in SHEET.items():
        option = f"--{key.replace('_', '-')}"
        command.add_argument(option, type=float, nargs="+", default=(), metavar="N", help=words)
    command.add_argument("--force", action="store_true", help="overwrite files that are there")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, write, say what is next."""
    urdf = _read(options.urdf, "URDF")
    try:
        arm = arm_from_urdf(urdf)
    except UserError as error:
        raise UserError(f"{options.urdf}: {error}") from error
    texts = {options.urdf.name: urdf}
    if options.eds is not None:
        texts[options.eds.name] = _read(options.eds, "EDS")
    sheet = DataSheet(**{key: getattr(options, key) for key in SHEET})
    eds = None if options.eds is None else options.eds.name
    texts |= starter_files(arm, options.urdf.name, eds, sheet, options.out.resolve(), options.interface)
    _write(options.out, texts, options.force)
    empty = sum(line.count("# FILL IN:") for text in texts.values() for line in text.splitlines())
    print(f"{options.out}: {', '.join(texts)}")
    print(f"{empty} values to fill in; then: spacearm check {options.out}")
    return 0


def _read(path: Path, what: str) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError as error:
        raise UserError(f"cannot read the {what} {path}: {error.strerror or error}") from error


def _write(directory: Path, texts: dict[str, str], force: bool) -> None:
    """Write all files; nothing where one is in the way.

    Raises:
        UserError: One is there already with another content, or cannot be written.
    """
    encoded = {directory / name: text.encode(errors="surrogateescape") for name, text in texts.items()}
    try:
        changed = {path: data for path, data in encoded.items() if not path.exists() or path.read_bytes() != data}
        taken = [path for path in changed if path.exists()]
        if taken and not force:
            raise UserError(f"{taken[0]} is there already: choose another --out, or say --force to overwrite it")
        directory.mkdir(parents=True, exist_ok=True)
        for path, data in changed.items():
            path.write_bytes(data)
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror or error}: choose another --out") from error
