"""`spacearm new-arm`: the configuration files of an arm, from its URDF and its drives' data sheet."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..commissioning.arm_check import limits_like_degrees
from ..commissioning.starter import ARM_FILE, CAN_FILE, NODES_FILE, DataSheet, completed, starter_files
from ..dynamics.arm import Arm, arm_from_urdf
from ..dynamics.meshes import package_folders, resolve_meshes
from ..dynamics.mimics import follower_words, refuse_coupled
from ..dynamics.urdf_chain import Selection, choose_joints, locked
from ..errors import UserError
from ..excitation.clearance import Clearance
from ..excitation.constraints import Requirements, allowed_torque, limits_for_excitation
from ..excitation.nominal import nominal_model
from ..excitation.start_posture import possible_start
from ..recording.intake import listing as listed

DESCRIPTION = f"""
Write the files of an arm into DIR: its URDF with every joint locked that is not the arm's, {ARM_FILE} (limits, a
posture to start from), {NODES_FILE} (parameters of the ROS nodes), layouts for Foxglove and PlotJuggler. Every value
is marked with its source: URDF, ASSUMED, or FILL IN where no default is possible; 'spacearm check DIR' lists what is
still missing. With --eds, --interface or a number from a data sheet also {CAN_FILE}, for CANopen drives. Without
--base, --tip or --joints the arm is the longest chain; fingers, grippers and joints that mimic others become payload.
An arm one of whose joints moves another of the chain (a mimic joint of a parallelogram) is refused: it is not modelled.
"""
SHEET = {
    "gear_ratio": "motor turns a joint turn (also taken from the URDF's transmissions)",
    "torque_constant": "N m/A at the motor",
    "rated_current": "A: current at 1000 per mille of object 0x6077",
    "rated_torque": "N m at the motor: instead of it, where 0x6077 is per mille of the rated torque (0x6076)",
    "counts_per_turn": "encoder counts a motor turn",
}


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument(
        "urdf",
        type=Path,
        metavar="URDF",
        help="robot description (of a xacro file the expanded one): kinematics, limits, CAD inertials",
    )
    command.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder to write")
    command.add_argument("--eds", type=Path, metavar="FILE", help="the drives' electronic data sheet (CiA 306)")
    command.add_argument(
        "--interface",
        metavar="NAME",
        help="of CANopen drives, python-can's name (socketcan unless said); local: the simulated arm",
    )
    _add_chain_options(command)
    for key, words in SHEET.items():
        option = f"--{key.replace('_', '-')}"
        command.add_argument(option, type=float, nargs="+", default=(), metavar="N", help=words)
    command.add_argument("--force", action="store_true", help="overwrite files that are there")
    command.set_defaults(run=run)


def _add_chain_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--base", metavar="LINK", help="link at which the arm begins (default: the root)")
    command.add_argument("--tip", metavar="LINK", help="link at which it ends (default: the end of the longest chain)")
    command.add_argument("--joints", nargs="+", default=(), metavar="JOINT", help="its joints, instead of base and tip")
    command.add_argument(
        "--lock",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=VALUE",
        help="position of a joint that is not the arm's, rad or m (default: 0, or the limit next to it)",
    )
    command.add_argument(
        "--package-path",
        nargs="+",
        action="extend",
        default=[],
        metavar="FOLDER",
        help="folder that holds the packages whose meshes the URDF names (also ROS_PACKAGE_PATH, AMENT_PREFIX_PATH)",
    )


def run(options: argparse.Namespace) -> int:
    """Read, choose the arm's joints, write, print what is next."""
    whole = _read(options.urdf, "URDF")
    if options.joints and (options.base or options.tip):
        raise UserError("--joints selects the whole arm: leave out --base and --tip")
    try:
        chosen, urdf, arm = _arm(whole, options)
    except UserError as error:
        raise UserError(f"{options.urdf}: {error}") from error
    texts = {options.urdf.name: urdf}
    if options.eds is not None:
        texts[options.eds.name] = _read(options.eds, "EDS")
    if options.rated_current and options.rated_torque:
        raise UserError("--rated-current and --rated-torque: give one, what 1000 per mille of 0x6077 stands for")
    sheet = DataSheet(**{key: getattr(options, key) for key in SHEET})
    eds = None if options.eds is None else options.eds.name
    canopen = bool(eds or options.interface or any(getattr(options, key) for key in SHEET))
    start, lacking = _start(arm)
    texts |= starter_files(
        arm,
        options.urdf.name,
        eds,
        sheet,
        options.out.resolve(),
        options.interface or "socketcan",
        canopen=canopen,
        start=None if start is None else start.tolist(),
        package_path=package_folders(urdf, arm.package_path),
    )
    _write(options.out, texts, options.force)
    moved = follower_words(whole, chosen.joints)
    print("\n".join([*_summary(options, chosen, arm, texts, start, lacking, canopen), *moved]))
    return 0


def _arm(whole: str, options: argparse.Namespace) -> tuple[Selection, str, Arm]:
    """The joints chosen, the URDF in which only they move, and its arm."""
    chosen = choose_joints(whole, options.base, options.tip, options.joints)
    refuse_coupled(whole, chosen.joints)
    others = (*chosen.hand, *chosen.others)
    urdf = locked(whole, others, _positions(options.lock)) if others or options.lock else whole
    folders = (str(options.urdf.parent), *options.package_path)
    return chosen, urdf, replace(arm_from_urdf(urdf), package_path=folders)


def _positions(words: Sequence[str]) -> dict[str, float]:
    """`NAME=VALUE` words.

    Raises:
        UserError: One is something else.
    """
    found = {}
    for word in words:
        name, equals, value = word.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            equals = ""
        if not (equals and name and math.isfinite(found[name])):
            raise UserError(f"--lock {word}: write NAME=VALUE, as in --lock torso_lift_joint=0.15")
    return found


def _start(arm: Arm) -> tuple[FloatArray | None, str]:
    """A posture to start from, and why its clearance is that of capsules (empty: it is not).

    There is no posture (None) where none is possible, or limits leave no room.
    """
    full = completed(arm)
    try:
        limits, _ = limits_for_excitation(full, np.zeros(len(arm.joints)))
    except UserError:
        return None, ""
    ground = 0.0 if full.gravity[2] < 0 else None
    clearance = Clearance(full, ground, limits.lower, limits.upper)
    needs = Requirements(limits, allowed_torque(full), nominal_model(full), clearance=clearance)
    return possible_start(full, needs), clearance.lacking


def _summary(
    options: argparse.Namespace,
    chosen: Selection,
    arm: Arm,
    texts: Mapping[str, str],
    start: FloatArray | None,
    lacking: str,
    canopen: bool,
) -> list[str]:
    """What was written and decided, and what is next."""
    rows = [line for text in texts.values() for line in text.splitlines()]
    guesses = sum("# ASSUMED" in row for row in rows)
    empty = sum(row.count("# FILL IN:") for row in rows)
    lines = [f"{options.out}: the files of an arm with {len(arm.joints)} joints, {listed(arm.joint_names)}"]
    fill = f"fill in {empty} values (# FILL IN), " if empty else ""
    lines.append(f"next: {fill}review {guesses} assumed values (# ASSUMED), then spacearm check {options.out}")
    lines.append(f"written: {', '.join(texts)}")
    if chosen.hand:
        lines.append(f"payload of {arm.joint_names[-1]}, locked: {listed(chosen.hand)}")
    if chosen.others:
        lines.append(f"locked where they are (--lock NAME=VALUE: elsewhere): {listed(chosen.others)}")
    if start is None:
        lines.append("no possible start posture was found: name one with excite --start, or correct limits and masses")
    elif start.any():
        words = " ".join(f"{value:g}" for value in start)
        lines.append(f"start posture: {words} (rad, m), since all zeros violates a limit or nearly does")
    if far := limits_like_degrees(arm):
        lines.append(f"{listed(far)} may turn more than two turns from zero: are the URDF's limits in degrees? use rad")
    if advice := resolve_meshes(arm.urdf, arm.package_path).advice:
        lines.append(f"{advice}; until then clearance is checked with capsules")
    elif lacking:
        lines.append(f"{lacking}: clearance is checked with capsules")
    if not canopen:
        lines.append(
            "for CANopen drives and this package's driver, add --eds, --interface or a number of the data sheet"
        )
    return lines


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
            raise UserError(f"{taken[0]} exists already: choose another --out, or overwrite it with --force")
        directory.mkdir(parents=True, exist_ok=True)
        for path, data in changed.items():
            path.write_bytes(data)
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror or error}: choose another --out") from error
