"""`propose`: the mapping of a log, from its columns' names, their units, and what the arm makes of the numbers.

The order is that in which one decision helps the next: the time (`find_time`), which columns are which signal
(`find_signals`), their units (`find_units`). What stays open is a question; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..dynamics.arm import Arm
from ..recording.log_mapping import UNITS, LogMapping
from ..recording.tables import Table
from .find_signals import signals_of
from .find_time import time_of
from .find_units import effort_unit_of, position_unit_of, velocity_unit_of
from .groups import Group
from .search import Proposal, Search, Understood


def propose(
    table: Table, arm: Arm, where: str, arm_file: Path | None = None, answers: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None, declared: str | None = None,
) -> Proposal:  # fmt: skip
    """Propose the mapping of a log.

    Args:
        table: Its columns.
        arm: The arm that it is of.
        where: The log, for messages.
        arm_file: The arm's file, to be named in the mapping.
        answers: What the user says, by `ANSWERS`.
        constants: Joint -> N·m for each A, or at 100 %.
        declared: Unit in which the arm YAML declares effort, with its constants; None: it does not.

    Raises:
        UnfitDataError: Below 90 Hz, or without torque: the message says what the log can still be used for.
        UserError: An answer that cannot be.
    """
    log = Search(table, arm, where, dict(answers or {}), dict(constants or {}), declared)
    time, time_unit, rate_hz, seconds = time_of(log)
    chosen = signals_of(log, seconds)
    if "position" not in chosen:
        return log.found
    if log.listed_by is not None:
        log.tell("position", chosen["position"].name, "", f"joints in the order of {log.listed_by!r}")
    units = {"position": position_unit_of(log, chosen)}
    position = chosen["position"].values(table) * log.scale(UNITS["position"].get(units["position"], 1.0))
    if "velocity" in chosen:
        units["velocity"] = velocity_unit_of(log, chosen["velocity"], position, seconds)
    if "effort" not in chosen:
        return log.found
    units["effort"], of_drives = effort_unit_of(log, chosen["effort"], position)
    if time is None and rate_hz is not None:
        log.tell("time", "(none)", "", f"rows at {rate_hz:g} Hz, as told")
    if "command" in chosen:
        log.tell("command", chosen["command"].name, units["position"], "named, in the position's unit")
    log.found.rows = _by_signal(log.found.rows)
    if not log.found.questions:
        columns = _columns(chosen, arm)
        mapping = LogMapping(columns, units, None, time_unit, rate_hz, of_drives, {}, arm_file)
        if time is not None:
            mapping = replace(mapping, time=time.name, fraction=time.fraction, fraction_unit=time.fraction_unit)
        log.found.mapping = mapping
    return log.found


def _columns(chosen: Mapping[str, Group], arm: Arm) -> dict[str, dict[str, str]]:
    return {joint: {signal: group.columns[joint] for signal, group in chosen.items()} for joint in arm.joint_names}


def _by_signal(rows: list[Understood]) -> list[Understood]:
    """One row for each signal, in the table's order, with all that decided it."""
    merged: dict[str, Understood] = {}
    for row in rows:
        before = merged.get(row.signal)
        why = row.because if before is None else f"{before.because}; {row.because}"
        merged[row.signal] = replace(row, because=why)
    order = ("time", "position", "velocity", "effort", "command")
    return sorted(merged.values(), key=lambda row: order.index(row.signal))
