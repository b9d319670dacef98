"""`read_log`: a log as a `Recording`, by its mapping, or by the proposal where nothing in it is open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..documents import read_yaml
from ..dynamics.arm import Arm, load_arm
from ..errors import UserError
from ..recording.intake import Samples
from ..recording.log_mapping import (
    CURRENT_UNITS,
    TORQUE_UNITS,
    LogMapping,
    mapping_beside,
    read_mapping,
    samples_of,
)
from ..recording.reader import recording_of
from ..recording.recording import Issue, Recording
from ..recording.tables import Table, read_table
from .propose import propose
from .search import Proposal, too_slow
from .signals import SLOWEST_HZ


@dataclass(frozen=True)
class Imported:
    """A log as a recording, the mapping it was read by, and the proposal where there was no mapping file."""

    recording: Recording
    mapping: LogMapping
    proposal: Proposal | None = None


def propose_for(
    log: Path, arm_file: Path, answers: Mapping[str, str] | None = None, constants: Mapping[str, float] | None = None
) -> tuple[Table, Proposal]:
    """The columns of a log and the mapping proposed for them.

    Args:
        log: The file.
        arm_file: URDF or arm YAML.
        answers: What the user says, by `ANSWERS`.
        constants: Joint -> N·m for each A, or at 100 %.

    Raises:
        UserError: The log or the arm cannot be read; or as `propose`.
    """
    arm = load_arm(arm_file)
    table = read_table(log)
    declared = _declared(arm, arm_file)
    return table, propose(table, arm, str(log), arm_file, answers, constants, declared)


def read_log(
    log: Path, arm_file: Path | None = None, mapping_file: Path | None = None, otherwise: Path | None = None
) -> Imported:
    """Read a log.

    Args:
        log: CSV, npz, mat, HDF5, Parquet, or a LeRobot folder.
        arm_file: URDF or arm YAML; None: that of the mapping.
        mapping_file: Its mapping; None: the one beside it, else what is proposed.
        otherwise: The arm where neither `arm_file` nor the mapping names one; the recording says that it was taken.

    Raises:
        UnfitDataError: Below 90 Hz, or without torque.
        UserError: It cannot be read, the arm is not known, or the proposal leaves something open.
    """
    if not log.exists():
        raise UserError(f"{log}: no such file or folder; give a bag or a log")
    file = mapping_file or mapping_beside(log)
    mapping = None if file is None else read_mapping(file)
    arm_file = arm_file or (None if mapping is None else mapping.arm)
    if arm_file is None and otherwise is not None:
        imported = read_log(log, otherwise, mapping_file)
        issue = Issue("log", f"no arm is named: taken to be that of {otherwise}")
        recording = imported.recording
        return replace(imported, recording=replace(recording, issues=(*recording.issues, issue)))
    if mapping is not None:
        if arm_file is None:
            raise UserError(f"{file} names no arm: name the arm's URDF or arm YAML (--arm FILE)")
        return Imported(recording_by(read_table(log), mapping, arm_file, str(log)), mapping)
    if arm_file is None:
        raise UserError(f"{log}: a log says nothing of its arm: name the arm's URDF or arm YAML (--arm FILE)")
    table, proposal = propose_for(log, arm_file)
    if proposal.mapping is None:
        first, more = proposal.questions[0], len(proposal.questions) - 1
        rest = f" (and {more} more)" if more else ""
        raise UserError(f"{log}: open{rest}: {first}; give the answer to 'spacearm import {log} --arm {arm_file}'")
    return Imported(recording_by(table, proposal.mapping, arm_file, str(log)), proposal.mapping, proposal)


def recording_by(table: Table, mapping: LogMapping, arm_file: Path, where: str) -> Recording:
    """The recording that a mapping makes of a log's columns; effort is in what the arm declares.

    Args:
        table: The log's columns.
        mapping: Which column is what, in which unit.
        arm_file: URDF or arm YAML.
        where: What the log is called in messages.

    Raises:
        UnfitDataError: Below 90 Hz.
        UserError: A joint that the arm does not have, a column that the log does not have, or no usable row.
    """
    arm = load_arm(arm_file)
    if unknown := set(mapping.joints) - set(arm.joint_names):
        raise UserError(f"{where}: the mapping's joint {min(unknown)!r} is none of {', '.join(arm.joint_names)}")
    states, command = samples_of(table, mapping, where)
    states = replace(states, effort=states.effort / _published(arm, mapping, arm_file, where))
    told = f"columns read as {_words(mapping)}"
    issues = (*table.issues, Issue("log", told))
    recording = recording_of(states, _not_empty(command), table.sources, arm.urdf, issues)
    if recording.rate_hz < SLOWEST_HZ * (1.0 - 1e-6):
        raise too_slow(where, recording.rate_hz)
    return recording


def _words(mapping: LogMapping) -> str:
    there = {signal for columns in mapping.columns.values() for signal in columns}
    units = ", ".join(f"{signal} {unit}" for signal, unit in mapping.units.items() if signal in there)
    clock = f"time {mapping.time_unit}" if mapping.time is not None else f"{mapping.rate_hz:g} rows a second"
    clock += f" and {mapping.fraction_unit}" if mapping.fraction is not None else ""
    return f"{clock}, {units}, of {len(mapping.joints)} joints"


def _not_empty(command: Samples | None) -> Samples | None:
    return command if command is not None and np.isfinite(command.position).all(axis=1).any() else None


def _declared(arm: Arm, arm_file: Path) -> str | None:
    """The unit other than N m in which an arm YAML declares effort; None: none."""
    if not arm.effort_declared or arm_file.suffix not in (".yaml", ".yml"):
        return None
    unit = str(read_yaml(arm_file, "the arm")["effort"]["unit"])
    return None if unit == "N m" else unit


def _published(arm: Arm, mapping: LogMapping, arm_file: Path, where: str) -> np.ndarray:
    """(n,) what effort is divided by so that the arm's declaration, applied to it later, gives N·m.

    Raises:
        UserError: Effort is no torque, and neither the mapping nor the arm says what makes it one.
    """
    scale = {joint.name: joint.effort_scale for joint in arm.joints}
    if mapping.is_torque:
        return np.array([scale[joint] for joint in mapping.joints])
    kind = "A" if mapping.units["effort"] in CURRENT_UNITS else "percent"
    if _declared(arm, arm_file) == kind:
        return np.ones(len(mapping.joints))
    assert mapping.units["effort"] not in TORQUE_UNITS
    raise UserError(
        f"{where}: effort is in {mapping.units['effort']}: say what makes it torque, as effort_constants in the "
        f"mapping or as 'effort: {{unit: {kind}, constants: ...}}' in an arm YAML given as --arm"
    )
