"""The mapping file of a log: which column is which signal of which joint, in which unit, and what the time is.

    schema: spacearm_ident/log_mapping/1
    arm: arm.urdf                       # URDF or arm YAML, seen from this file; optional
    time: {column: Zeit [s], unit: s}   # or {rate_hz: 500}: evenly sampled, nothing else known
                                        # or {column: sec, unit: s, nanoseconds: nanosec}: whole seconds and the rest
                                        # (nanoseconds, microseconds or milliseconds)
    units: {position: deg, velocity: deg/s, effort: mA}
    joints:
      joint_1: {position: Winkel 1, velocity: Tempo 1, effort: Strom 1, command: Soll 1}
    effort_constants: {joint_1: 12.3}   # N·m on the output side for each A, or at 100 %; where effort is no torque
    counts_per_turn: {joint_1: 65536}   # where positions are encoder counts

`samples_of` turns a `Table` into joint states by it. Nothing is decided here: `spacearm import` proposes a mapping.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from spacearm_ident.arrays import FloatArray, IntArray
from spacearm_ident.documents import entries, read_yaml, write_whole
from spacearm_ident.errors import UserError
from spacearm_ident.recording.intake import Samples, listing
from spacearm_ident.recording.tables import Table
from spacearm_ident.recording.tables.table import Column, filled

MAPPING_SCHEMA = "spacearm_ident/log_mapping/1"
MAPPING_SUFFIX = ".mapping.yaml"
"""`run.csv` has its mapping in `run.csv.mapping.yaml` beside it; `mapping.yaml` is that of all logs of a folder."""
FOLDER_MAPPING = "mapping.yaml"

TURN = 2.0 * np.pi
TIME_UNITS: dict[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Unit of time -> seconds."""
FRACTIONS = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds"}
"""Unit of what is added to whole seconds -> its key in a mapping file."""
POSITION_UNITS: dict[str, float] = {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "mrad": 1e-3, "counts": TURN}
"""Unit of angle -> rad; `counts` are divided by the counts a turn first. A joint that slides is in m."""
VELOCITY_UNITS: dict[str, float] = {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0, "turn/s": TURN}
"""Unit of speed -> rad/s."""
TORQUE_UNITS: dict[str, float] = {"N m": 1.0, "mN m": 1e-3}
"""Unit of torque -> N·m."""
CURRENT_UNITS: dict[str, float] = {"A": 1.0, "mA": 1e-3}
"""Unit of current -> A."""
SHARE_UNITS: dict[str, float] = {"percent": 1.0, "permille": 0.1}
"""Unit of a share of the rated torque -> per cent."""
EFFORT_UNITS: dict[str, float] = {**TORQUE_UNITS, **CURRENT_UNITS, **SHARE_UNITS}
SIGNALS = ("position", "velocity", "effort", "command")
UNITS: dict[str, dict[str, float]] = {
    "position": POSITION_UNITS,
    "velocity": VELOCITY_UNITS,
    "effort": EFFORT_UNITS,
    "command": POSITION_UNITS,
}
SI = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
PAUSE_NS = 1_000_000_000
"""Pause put between two stretches of a log, ns: a gap at any rate that is read."""
_LONGEST_S = 2.0**62 / 1e9  # times that 64 bits of nanoseconds hold


@dataclass(frozen=True)
class LogMapping:
    """What the columns of a log are.

    Attributes:
        columns: Joint -> signal, one of `SIGNALS` -> column.
        units: Signal -> unit, one of `UNITS`; a command is in the unit of the position.
        time: Column of time; None: rows are `1 / rate_hz` apart.
        time_unit: One of `TIME_UNITS`.
        rate_hz: Rows a second, where there is no time.
        fraction: Column of what is added to a time in whole seconds; None: the time is whole.
        constants: Joint -> N·m on the output side for each A, or at 100 %; those missing are the arm's to know.
        counts: Joint -> encoder counts a turn of the joint, signed.
        arm: URDF or arm YAML.
        fraction_unit: Unit of `fraction`, one of `FRACTIONS`.
    """

    columns: Mapping[str, Mapping[str, str]]
    units: Mapping[str, str] = field(default_factory=lambda: dict(SI))
    time: str | None = None
    time_unit: str = "s"
    rate_hz: float | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, float] = field(default_factory=dict)
    arm: Path | None = None
    fraction: str | None = None
    fraction_unit: str = "ns"

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints in the order of the arrays."""
        return tuple(self.columns)

    @property
    def is_torque(self) -> bool:
        """Whether effort comes out as torque, without what only the arm knows."""
        return self.units.get("effort") in TORQUE_UNITS or set(self.constants) >= set(self.joints)


def mapping_beside(log: Path) -> Path | None:
    """The mapping file of a log, where one lies beside it."""
    candidates = (log.with_name(log.name + MAPPING_SUFFIX), log.parent / FOLDER_MAPPING)
    return next((path for path in candidates if path.is_file()), None)


def samples_of(table: Table, mapping: LogMapping, where: str) -> tuple[Samples, Samples | None]:
    """Joint states and set-points of a log.

    Effort is in N·m, or in A or per cent where `mapping.is_torque` is false.

    Args:
        table: The columns.
        mapping: What they are.
        where: The log, for errors.

    Raises:
        UserError: A column that the mapping names is not there, or the time cannot be one.
    """
    stamps = _stamps_ns(table, mapping, where)
    signals = {signal: _signal(table, mapping, signal, where) for signal in SIGNALS}
    states = Samples(mapping.joints, stamps, signals["position"], signals["velocity"], signals["effort"])
    if not np.isfinite(signals["command"]).any():
        return states, None
    nothing = np.full_like(signals["command"], np.nan)
    return states, Samples(mapping.joints, stamps, signals["command"], nothing, nothing)


def column(table: Table, name: str, where: str) -> Column:
    """A column by name.

    Args:
        table: Columns of a log.
        name: Name of the column.
        where: The log, for the error message.

    Raises:
        UserError: There is none of that name.
    """
    if name not in table.columns:
        raise UserError(f"{where}: no column {name!r}; it has {listing(list(table.columns), 12)}")
    return table.columns[name]


def _stamps_ns(table: Table, mapping: LogMapping, where: str) -> IntArray:
    """(N,) nanoseconds; a stretch whose time does not go on from that of the one before begins `PAUSE_NS` after it."""
    stamps = _own_stamps_ns(table, mapping, where)
    for start in table.starts[1:]:
        if stamps[start] <= stamps[start - 1] or mapping.time is None:
            stamps[start:] += stamps[start - 1] - stamps[start] + PAUSE_NS
    return stamps


def _own_stamps_ns(table: Table, mapping: LogMapping, where: str) -> IntArray:
    """(N,) nanoseconds; of whole nanoseconds none is lost."""
    if mapping.time is None:
        assert mapping.rate_hz is not None  # read_mapping and the proposal see to it
        return np.asarray(np.rint(np.arange(table.rows) * (1e9 / mapping.rate_hz)), dtype=np.int64)
    values = column(table, mapping.time, where)
    if mapping.fraction is not None:
        size = round(TIME_UNITS[mapping.fraction_unit] * 1e9)
        values = _joined_ns(values, column(table, mapping.fraction, where), size)
    if values.dtype.kind == "i":
        factor = 1 if mapping.fraction is not None else round(TIME_UNITS[mapping.time_unit] * 1e9)
        if np.abs(values).max() < 2**62 // factor:
            return np.asarray(values * factor, dtype=np.int64)
        raise UserError(f"{where}: {mapping.time!r} in {mapping.time_unit} is no time of this age; correct the unit")
    seconds = np.asarray(values, dtype=np.float64) * TIME_UNITS[mapping.time_unit]
    sound = np.isfinite(seconds) & (np.abs(seconds) < _LONGEST_S)
    if not sound.any():
        raise UserError(f"{where}: {mapping.time!r} in {mapping.time_unit} is no time of this age; correct the unit")
    return np.asarray(np.rint(filled(seconds, sound) * 1e9), dtype=np.int64)


def _joined_ns(seconds: Column, fraction: Column, size_ns: int) -> Column:
    """(N,) nanoseconds of a time in two columns, the second in `size_ns`: none is lost, which a float of both would."""
    nanoseconds = np.asarray(fraction, dtype=np.float64) * size_ns
    sound = np.isfinite(seconds) & (np.abs(seconds) < _LONGEST_S) & (np.abs(nanoseconds) < 1e9)
    if not sound.any():
        return np.full(len(seconds), np.nan)
    whole, rest = (np.asarray(np.rint(filled(part, sound)), dtype=np.int64) for part in (seconds, nanoseconds))
    return whole * 1_000_000_000 + rest


def _signal(table: Table, mapping: LogMapping, signal: str, where: str) -> FloatArray:
    """(N, n) of one signal in SI units; NaN for a joint that has no column of it."""
    values = np.full((table.rows, len(mapping.joints)), np.nan)
    unit = mapping.units.get("position" if signal == "command" else signal, "")
    for k, (joint, columns) in enumerate(mapping.columns.items()):
        if signal in columns:
            factor = UNITS[signal][unit]
            if unit == "counts":
                factor /= mapping.counts[joint]
            elif signal == "effort" and unit not in TORQUE_UNITS:
                factor *= _constant(mapping, joint, unit)
            values[:, k] = np.asarray(column(table, columns[signal], where), dtype=np.float64) * factor
    return values


def _constant(mapping: LogMapping, joint: str, unit: str) -> float:
    """N·m for each A or per cent; 1 where they are left to the arm."""
    if not mapping.is_torque:
        return 1.0
    return mapping.constants[joint] * (0.01 if unit in SHARE_UNITS else 1.0)


def mapping_to_dict(mapping: LogMapping, beside: Path) -> dict[str, Any]:
    """Plain data of a mapping file in the folder `beside`.

    Args:
        mapping: What the columns are; its arm is resolved from the working directory where it is relative.
        beside: Folder of the mapping file. An arm below it is named from there, another by its absolute path.
    """
    time: dict[str, Any] = {"column": mapping.time, "unit": mapping.time_unit}
    if mapping.fraction is not None:
        time[FRACTIONS[mapping.fraction_unit]] = mapping.fraction
    data: dict[str, Any] = {"schema": MAPPING_SCHEMA}
    if mapping.arm is not None:
        arm = mapping.arm.resolve()
        own = beside.resolve()
        data["arm"] = str(arm.relative_to(own)) if arm.is_relative_to(own) else str(arm)
    data["time"] = {"rate_hz": mapping.rate_hz} if mapping.time is None else time
    data["units"] = dict(mapping.units)
    data["joints"] = {joint: dict(columns) for joint, columns in mapping.columns.items()}
    if mapping.constants:
        data["effort_constants"] = dict(mapping.constants)
    if mapping.counts:
        data["counts_per_turn"] = dict(mapping.counts)
    return data


def save_mapping(mapping: LogMapping, path: Path) -> None:
    """Write a mapping file.

    Args:
        mapping: What the columns are.
        path: File to write, from whose folder the arm is named; an older one is replaced as a whole, or stays.

    Raises:
        UserError: It cannot be written.
    """
    text = yaml.safe_dump(mapping_to_dict(mapping, path.parent), sort_keys=False, allow_unicode=True, width=110)
    try:
        write_whole(path, text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); name another place") from error


def read_mapping(path: Path) -> LogMapping:
    """Read a mapping file.

    Raises:
        UserError: Not a mapping file, or a key of it is wrong; the message says which.
    """
    data = read_yaml(path, "the mapping")
    if not isinstance(data, dict) or data.get("schema") != MAPPING_SCHEMA:
        raise UserError(f"{path} is not a mapping: its first line should be 'schema: {MAPPING_SCHEMA}'")
    known = {"schema", "arm", "time", "units", "joints", "effort_constants", "counts_per_turn"}
    if unknown := set(data) - known:
        raise UserError(f"{path}: unknown key {sorted(unknown, key=str)[0]!r}")
    joints = entries(data.get("joints"), f"{path}: joints")
    columns = {str(joint): _columns(given, f"{path}: joints: {joint}") for joint, given in joints.items()}
    if not columns or not all({"position", "effort"} <= set(of) for of in columns.values()):
        raise UserError(f"{path}: joints: name a column of position and one of effort for each joint")
    units = {**SI, **{str(key): str(unit) for key, unit in entries(data.get("units"), f"{path}: units").items()}}
    for signal, unit in units.items():
        if unit not in UNITS.get(signal, {}):
            known_units = ", ".join(UNITS.get(signal, {})) or "nothing of that name has a unit"
            raise UserError(f"{path}: units: {signal}: {unit!r} is none of: {known_units}")
    constants = _factors(data.get("effort_constants"), f"{path}: effort_constants")
    counts = _factors(data.get("counts_per_turn"), f"{path}: counts_per_turn")
    if units["position"] == "counts" and not set(counts) >= set(columns):
        raise UserError(f"{path}: counts_per_turn: say it for each joint, positions are in counts")
    arm = data.get("arm")
    if arm is not None and (not isinstance(arm, str) or "\0" in arm):
        raise UserError(f"{path}: arm names a URDF or an arm YAML, not {arm!r}")
    return LogMapping(
        columns, units, **_time(data.get("time"), f"{path}: time"), constants=constants, counts=counts,
        arm=None if arm is None else path.parent / arm,
    )  # fmt: skip


def _columns(value: Any, where: str) -> dict[str, str]:
    given = entries(value, where)
    if unknown := set(given) - set(SIGNALS):
        raise UserError(f"{where}: unknown signal {sorted(unknown, key=str)[0]!r}; one of {', '.join(SIGNALS)}")
    return {signal: str(given[signal]) for signal in SIGNALS if given.get(signal) is not None}


def _factors(value: Any, where: str) -> dict[str, float]:
    return {str(joint): _factor(given, f"{where}: {joint}") for joint, given in entries(value, where).items()}


def _factor(value: Any, where: str) -> float:
    """A number other than zero."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if isinstance(value, bool) or not np.isfinite(number) or number == 0.0:
        raise UserError(f"{where} needs a number other than zero, not {value!r}")
    return number


def _time(value: Any, where: str) -> dict[str, Any]:
    given = entries(value, where)
    if set(given) == {"rate_hz"}:
        rate = _factor(given["rate_hz"], f"{where}: rate_hz")
        if not 1e-3 < rate < 1e6:
            raise UserError(f"{where}: rate_hz: {rate:g} rows a second cannot be")
        return {"rate_hz": rate}
    unit = str(given.get("unit", "s"))
    if not set(given) <= {"column", "unit", *FRACTIONS.values()} or "column" not in given or unit not in TIME_UNITS:
        raise UserError(f"{where} needs 'column' and 'unit' (one of {', '.join(TIME_UNITS)}), or 'rate_hz' alone")
    time = {"time": str(given["column"]), "time_unit": unit}
    fractions = [(unit, name) for unit, name in FRACTIONS.items() if given.get(name) is not None]
    if not fractions:
        return time
    if len(fractions) > 1:
        raise UserError(f"{where}: one column is added to the seconds: name one of {', '.join(FRACTIONS.values())}")
    ((fraction_unit, name),) = fractions
    if unit != "s":
        raise UserError(f"{where}: {name!r} are added to a column of whole seconds: its unit is s, not {unit}")
    return time | {"fraction": str(given[name]), "fraction_unit": fraction_unit}
