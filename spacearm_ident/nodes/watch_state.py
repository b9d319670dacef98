"""`WatchState`: what the live graph says, as a table of its present state; knows neither ROS nor terminals.

Messages go in as plain values with the time of their arrival, `view` gives what a screen shows. What has not been
heard for `SILENT_S` is shown as silent, never as it last was.
"""

from __future__ import annotations

import json
import math
import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from ..canbus.cia402 import State

SILENT_S: Final = 3.0
"""Nodes speak every second."""
RATE_S: Final = 2.0
"""Over how long the rate of the joint states is taken."""
KEPT: Final = 16
"""Sets of parameters remembered, for how they converge."""
LEVELS: Final = ("ok", "warn", "error", "silent")
DRIVER, IDENTIFIER = "canopen_driver", "identifier"
_DRIVE_STATES: Final = frozenset({*(state.label for state in State), "unknown"})
_LOAD: Final = re.compile(r"bus_(\d+)_load")

Values = Mapping[str, str]


@dataclass(frozen=True)
class NodeRow:
    """A node, or a part of one, and what it says; `level` is one of `LEVELS`."""

    name: str
    level: str
    message: str


@dataclass(frozen=True)
class JointRow:
    """A joint; None (or an empty state) is what nobody has said. SI on the output side, °C."""

    name: str
    drive: str = ""
    position: float | None = None
    torque: float | None = None
    residual_rms: float | None = None
    temperature: float | None = None


@dataclass(frozen=True)
class Cycle:
    """How well the driver's cycle keeps time; lateness in µs at 50, 99 and 99.9 %."""

    cycles: int
    missed: int
    incomplete: int
    late_frames: int
    lateness_us: tuple[float, ...]
    loads: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """The excitation run: `done` is the share of its periods that has begun and ended."""

    state: str
    name: str
    period: int
    periods: int
    done: float
    reason: str


@dataclass(frozen=True)
class ParameterRow:
    """A parameter with a standard error, and how it came to it.

    Attributes:
        change: From the value before, in present standard errors; None for the first.
        errors: Standard errors so far, the present one last.
    """

    name: str
    value: float
    error: float
    unit: str
    change: float | None
    errors: tuple[float, ...]


@dataclass(frozen=True)
class View:
    """All that is shown.

    Attributes:
        arm: Its name, as the nodes know it.
        rate_hz: Of the joint states; None where none come.
        identifying: Share done of an identification under way, else None.
        identification: What came out last.
        known: How many parameters have a standard error, of `parameters_total`.
    """

    arm: str
    rate_hz: float | None
    nodes: tuple[NodeRow, ...]
    joints: tuple[JointRow, ...]
    cycle: Cycle | None
    run: Run | None
    identifying: float | None
    identification: str
    parameters: tuple[ParameterRow, ...]
    known: int
    parameters_total: int


@dataclass
class _Heard:
    level: int
    message: str
    values: Values
    at_s: float


@dataclass
class _Parameter:
    unit: str = ""
    history: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=KEPT))


class WatchState:
    """What has been heard so far."""

    def __init__(self) -> None:
        self._arm = ""
        self._statuses: dict[str, _Heard] = {}
        self._run: dict[str, Any] = {}
        self._joints: dict[str, JointRow] = {}
        self._joints_at_s = -math.inf
        self._temperatures: dict[str, float] = {}
        self._counts: deque[tuple[float, int]] = deque()
        self._parameters: dict[str, _Parameter] = {}

    @property
    def nodes_heard(self) -> int:
        """How many nodes, or parts, have said something."""
        return len(self._statuses)

    def hear_status(self, name: str, level: int, message: str, hardware: str, values: Values, now_s: float) -> None:
        """Take in one status of `/diagnostics`.

        Args:
            name: Name of the node, or `node: part`, without namespace.
            level: Level of a `DiagnosticStatus`: 0 OK, 1 warning, 2 error, 3 stale.
            message: Summary of the status, one line.
            hardware: Hardware ID of the status: the arm's name.
            values: Key -> value of the status.
            now_s: Monotonic time, s.
        """
        self._statuses[name] = _Heard(level, message, values, now_s)
        if name == DRIVER or not self._arm:
            self._arm = hardware

    def hear_run(self, document: str) -> None:
        """`/excitation/state`; what is not understood is left out."""
        try:
            said = json.loads(document)
        except ValueError:
            return
        if isinstance(said, dict):
            self._run = said

    def hear_joints(
        self, names: Sequence[str], position: Sequence[float], torque: Sequence[float], count: int, now_s: float
    ) -> None:
        """Take in a joint state; not every message of the stream is needed.

        Args:
            names: Names of the n joints.
            position: (n,) rad or m; shorter or empty where not published.
            torque: (n,) N·m or N; shorter or empty where not published.
            count: Number of the message in its publisher's stream, from which the rate is computed.
            now_s: Monotonic time, s.
        """
        rows = {}
        for k, name in enumerate(names):
            at = (position[k] if k < len(position) else None, torque[k] if k < len(torque) else None)
            rows[name] = JointRow(name, position=at[0], torque=at[1])
        self._joints, self._joints_at_s = rows, now_s
        if self._counts and count <= self._counts[-1][1]:
            if count == self._counts[-1][1]:
                return
            self._counts.clear()  # another publisher
        self._counts.append((now_s, count))

    def hear_temperature(self, joint: str, celsius: float) -> None:
        """A reading of `/joint_temperatures`."""
        self._temperatures[joint] = celsius

    def hear_parameters(self, parameters: Iterable[tuple[str, Values]]) -> None:
        """`/identifier/parameters`: name and values of each; those not named any more are forgotten."""
        before, self._parameters = self._parameters, {}
        for name, values in parameters:
            known = before.get(name) or _Parameter()
            known.unit = values.get("unit", "")
            known.history.append((_number(values.get("value")), _number(values.get("standard_error"))))
            self._parameters[name] = known

    def view(self, now_s: float, most_parameters: int = 12) -> View:
        """What is so now.

        Args:
            now_s: On the clock of the arrivals.
            most_parameters: How many parameters to show: those that moved most, then those least well known.
        """
        driver = self._fresh(DRIVER, now_s)
        identifier = self._fresh(IDENTIFIER, now_s)
        last = self._statuses.get(f"{IDENTIFIER}: identification")
        rows = [row for name, item in self._parameters.items() if (row := _row(name, item)) is not None]
        rows.sort(key=lambda row: (-abs(row.change or 0.0), -row.error / (abs(row.value) or math.inf), row.name))
        busy = identifier is not None and identifier.get("identifying") == "true"
        return View(
            arm=self._arm,
            rate_hz=self._rate(now_s),
            nodes=tuple(self._node(name, heard, now_s) for name, heard in sorted(self._statuses.items())),
            joints=self._joint_rows(now_s, driver),
            cycle=_cycle(driver),
            run=_run(self._run),
            identifying=_number(identifier.get("progress")) if busy and identifier is not None else None,
            identification=last.message if last is not None else "",
            parameters=tuple(rows[:most_parameters]),
            known=len(rows),
            parameters_total=len(self._parameters),
        )

    def _fresh(self, name: str, now_s: float) -> Values | None:
        heard = self._statuses.get(name)
        return heard.values if heard is not None and now_s - heard.at_s <= SILENT_S else None

    def _node(self, name: str, heard: _Heard, now_s: float) -> NodeRow:
        age = now_s - heard.at_s
        if age > SILENT_S:
            return NodeRow(name, "silent", f"silent for {age:.0f} s; it last said: {heard.message}")
        return NodeRow(name, LEVELS[heard.level] if heard.level < len(LEVELS) else "error", heard.message)

    def _rate(self, now_s: float) -> float | None:
        while len(self._counts) > 2 and self._counts[0][0] < now_s - RATE_S:
            self._counts.popleft()
        if len(self._counts) < 2 or now_s - self._counts[-1][0] > RATE_S:
            return None
        (first_s, first), (last_s, last) = self._counts[0], self._counts[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else None

    def _joint_rows(self, now_s: float, driver: Values | None) -> tuple[JointRow, ...]:
        drives = {key: value for key, value in (driver or {}).items() if value in _DRIVE_STATES and key != "state"}
        residual = self._fresh(f"{IDENTIFIER}: residual", now_s) or {}
        moving = self._joints if now_s - self._joints_at_s <= SILENT_S else {}
        rows = []
        for name in dict.fromkeys([*moving, *drives, *self._joints]):
            rms = residual.get(f"rms_Nm[{name}]")
            row = replace(
                moving.get(name, JointRow(name)),
                drive=drives.get(name, ""),
                residual_rms=None if rms is None else _number(rms),
                temperature=self._temperatures.get(name),
            )
            rows.append(row)
        return tuple(rows)


def _row(name: str, known: _Parameter) -> ParameterRow | None:
    value, error = known.history[-1]
    if not (math.isfinite(error) and error > 0 and math.isfinite(value)):
        return None
    before = known.history[-2][0] if len(known.history) > 1 else math.nan
    change = (value - before) / error if math.isfinite(before) else None
    errors = tuple(e for _, e in known.history if math.isfinite(e))
    return ParameterRow(name, value, error, known.unit, change, errors)


def _cycle(driver: Values | None) -> Cycle | None:
    if driver is None or "cycles" not in driver:
        return None
    counts = [_count(driver.get(key)) for key in ("cycles", "missed_cycles", "incomplete_cycles", "late_frames")]
    late = tuple(_number(driver.get(f"lateness_{share}_us")) for share in ("p50", "p99", "p999"))
    loads = sorted((int(found[1]), value) for key, value in driver.items() if (found := _LOAD.fullmatch(key)))
    return Cycle(counts[0], counts[1], counts[2], counts[3], late, tuple(load for _, load in loads))


def _run(said: Mapping[str, Any]) -> Run | None:
    if "state" not in said:
        return None
    period, periods = _count(said.get("period")), _count(said.get("periods"))
    done = 1.0 if said.get("complete") is True else (period - 1) / periods if 0 < period <= periods else 0.0
    return Run(str(said["state"]), str(said.get("run") or ""), period, periods, done, str(said.get("reason") or ""))


def _number(text: object) -> float:
    try:
        return float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return math.nan


def _count(text: object) -> int:
    number = _number(text)
    return int(number) if math.isfinite(number) else 0
