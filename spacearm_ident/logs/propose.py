"""`propose`: the mapping of a log, from its columns' names, their units, and what the arm makes of the numbers.

What is decided, and by what:

* Which group of columns is the position, velocity and effort: by its name. Without a name, by derivative (a group whose
  differences another follows is the position, the other the velocity) and by weight (effort follows the weight of the
  CAD's arm). Several of a kind: the one that says to be measured, on the joint side, torque rather than current.
* The unit: as written, else as the limits of the URDF, the velocity and the weight of the CAD's arm have it. A unit
  that is written and that the numbers contradict is a question, like whatever stays open; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.effort_limit import BEYOND_TORQUE
from ..errors import UnfitDataError, UserError
from ..recording.log_mapping import CURRENT_UNITS, TIME_UNITS, TORQUE_UNITS, UNITS, LogMapping
from ..recording.tables import Table
from .groups import Clock, Group, find_clocks, find_groups
from .signals import DERIVATIVE, FASTEST_HZ, SLOWEST_HZ, WINDOW_S, derivative_of, steps_s, weight_of
from .words import CURRENT, POSITION, TORQUE, VELOCITY

UNIT_OFF = 0.1
"""Relative error of a measured factor between two units that still is one of them: they are apart by 5 or more."""
BETTER = 0.8
"""Ratio of variances left from which one of two units explains the weight better: with 100 independent rows, fewer than
any usable log has, exp(-50 ln 0.8) is 10^5 to one."""
PAST_LIMIT = 1.1
"""How far past the URDF's limits positions may go, as a factor on the range: zeros are off, and limits are rounded."""
LIKE_WEIGHT = (0.5, 2.0)
"""Slopes of effort on the CAD's weight that say N m: CAD masses are within a factor of two; a joint torque a unit of
another quantity would have to be, at every loaded joint."""
LOADED = 0.6
"""Partial correlation with the weight from which a joint's effort follows it."""


@dataclass(frozen=True)
class Understood:
    """A row of the table that the user sees: signal, columns, unit, and what decided it."""

    signal: str
    columns: str
    unit: str
    because: str


@dataclass
class Proposal:
    """What was understood of a log.

    Attributes:
        mapping: The mapping; None where something is open.
        rows: What was understood, for the table.
        left_out: Columns that are not used, and why, a line each.
        questions: What could not be decided, a line each with the answer to give.
    """

    mapping: LogMapping | None = None
    rows: list[Understood] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)


ANSWERS = ("time", "time_unit", "rate_hz", "position", "velocity", "effort", "command", *(f"{s}_unit" for s in UNITS))
"""What a user may say: a column, a unit, a rate, or the name of a group."""


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
    return _Search(table, arm, where, dict(answers or {}), dict(constants or {}), declared).proposal(arm_file)


class _Search:
    """The one pass over a log; each step adds to the proposal."""

    def __init__(
        self, table: Table, arm: Arm, where: str, answers: dict[str, str], constants: dict[str, float],
        declared: str | None,
    ) -> None:  # fmt: skip
        if unknown := set(answers) - set(ANSWERS):
            raise UserError(f"nothing to set by the name {min(unknown)!r}; one of {', '.join(ANSWERS)}")
        if unknown := set(constants) - set(arm.joint_names):
            raise UserError(f"effort constant of {min(unknown)!r}: the arm has {', '.join(arm.joint_names)}")
        self.table, self.arm, self.where, self.answers = table, arm, where, answers
        self.constants, self.declared = constants, declared
        self.found = Proposal()
        self.revolute = np.array([joint.revolute for joint in arm.joints])
        self.clocks = find_clocks(table)
        self.groups, self.found.left_out = find_groups(table, arm, self.clocks)

    def proposal(self, arm_file: Path | None) -> Proposal:
        """Decide in the order in which one decision helps the next: time, signals, units."""
        time, unit, rate_hz, seconds = self._time()
        chosen = self._signals(seconds)
        if "position" not in chosen:
            return self.found
        units = {"position": self._position_unit(chosen)}
        position = chosen["position"].values(self.table) * self._scale(UNITS["position"].get(units["position"], 1.0))
        if "velocity" in chosen:
            units["velocity"] = self._velocity_unit(chosen["velocity"], position, seconds)
        if "effort" not in chosen:
            return self.found
        units["effort"], constants = self._effort_unit(chosen["effort"], position)
        self._tell(chosen, units, time, unit, rate_hz)
        if self.found.questions:
            return self.found
        columns = {
            joint: {signal: group.columns[joint] for signal, group in chosen.items()} for joint in self.arm.joint_names
        }
        self.found.mapping = LogMapping(columns, units, time, unit, rate_hz, constants, {}, arm_file)
        return self.found

    def _ask(self, question: str, answer: str) -> None:
        self.found.questions.append(f"{question}: --set {answer}")

    # Time

    def _time(self) -> tuple[str | None, str, float | None, FloatArray]:
        """Column, unit, rate where there is no column, and (N,) seconds or numbers of rows."""
        rows = np.arange(self.table.rows, dtype=np.float64)
        rate = self.answers.get("rate_hz") or (None if self.clocks else self.table.rate_hz)
        if rate is not None:
            hertz = _number(str(rate), "rate_hz")
            self._require_rate(hertz)
            return None, "s", hertz, rows / hertz
        asked = self.answers.get("time")
        if asked is not None and asked not in self.table.columns:
            raise UserError(f"{self.where}: no column {asked!r} for the time")
        clock = Clock(asked, None, False, True) if asked is not None else next(iter(self.clocks), None)
        if clock is None or (clock.counts_rows and asked is None and "time_unit" not in self.answers):
            what = "no column is a time" if clock is None else f"{clock.name!r} counts rows and is no time"
            self._ask(f"{what}: how many rows a second", "rate_hz=HZ")
            return None, "s", None, rows
        values = self.table.columns[clock.name]
        own = np.asarray(values - values[0] if values.dtype.kind == "i" else values, dtype=np.float64)
        step, _ = steps_s(own)
        unit = self.answers.get("time_unit") or clock.unit
        possible = [one for one, size in TIME_UNITS.items() if SLOWEST_HZ <= 1.0 / (size * step) <= FASTEST_HZ]
        if unit is None and len(possible) == 1:
            unit = possible[0]
            self.found.rows.append(
                Understood("time", clock.name, unit, f"only so a rate that recorders have, {1 / step:.5g} rows a unit")
            )
        elif unit is None and step >= 1.0 / SLOWEST_HZ and step < 10.0:
            unit = "s"  # slower than any recording in any smaller unit would be faster than any: it is slow
        elif unit is None:
            self._ask(f"{clock.name!r} has {1 / step:.4g} rows a unit: which unit", "time_unit=s|ms|us|ns")
            return clock.name, "s", None, own
        else:
            why = "told" if "time_unit" in self.answers else "written"
            self.found.rows.append(Understood("time", clock.name, unit, f"{why}; {1 / (step * _unit(unit)):.5g} Hz"))
        self._require_rate(1.0 / (step * _unit(unit)))
        return clock.name, unit, None, own * _unit(unit)

    def _require_rate(self, rate_hz: float) -> None:
        if rate_hz < SLOWEST_HZ * (1.0 - 1e-6):
            raise too_slow(self.where, rate_hz)

    # Signals

    def _signals(self, seconds: FloatArray) -> dict[str, Group]:
        """The group of each signal; what is open is asked."""
        chosen: dict[str, Group] = {}
        for signal in ("position", "velocity", "effort", "command"):
            group = self._told(signal) or self._named(signal)
            if group is not None:
                chosen[signal] = group
        if self.found.questions and not chosen:
            return chosen
        self._by_derivative(chosen, seconds)
        if "position" not in chosen:
            return self._without_position(chosen)
        if "effort" not in chosen and not any(q.startswith("effort") for q in self.found.questions):
            self._by_weight(chosen)
        return chosen

    def _told(self, signal: str) -> Group | None:
        if signal not in self.answers:
            return None
        wanted = self.answers[signal]
        group = next((group for group in self.groups if group.name == wanted), None)
        if group is None:
            raise UserError(f"{self.where}: no group of columns {wanted!r}: it has {self._names(self.groups)}")
        return group

    def _named(self, signal: str) -> Group | None:
        """The group whose names say that it is this signal; several that are alike are a question."""
        quantities = {"position": (POSITION,), "velocity": (VELOCITY,), "effort": (TORQUE, CURRENT)}
        commanded = signal == "command"
        wanted = quantities.get(signal, (POSITION,))
        fitting = [one for one in self.groups if one.quantity in wanted and one.commanded == commanded]
        if not fitting:
            return None

        def rank(group: Group) -> tuple[bool, bool, bool]:
            return group.quantity == CURRENT, group.motor_side and group.quantity != CURRENT, not group.measured

        best = [group for group in fitting if rank(group) == min(map(rank, fitting))]
        if len(best) > 1:
            if not commanded:
                self._ask(f"{signal} may be {self._names(best)}", f"{signal}=NAME")
            return None
        others = [group.name for group in fitting if group is not best[0]]
        if others:
            self.found.left_out.append(f"{', '.join(others)}: not the {signal}, {best[0].name} is preferred")
        return best[0]

    @staticmethod
    def _names(groups: Sequence[Group]) -> str:
        return ", ".join(repr(group.name) for group in groups) or "none"

    def _by_derivative(self, chosen: dict[str, Group], seconds: FloatArray) -> None:
        """Position and velocity among the groups whose names say nothing, from each other."""
        open_groups = [group for group in self.groups if group.quantity is None and not group.commanded]
        first = [chosen["position"]] if "position" in chosen else open_groups
        second = [chosen["velocity"]] if "velocity" in chosen else open_groups
        if "position" in chosen and "velocity" in chosen:
            return
        pairs = [(a, b) for a in first for b in second if a is not b and self._follows(a, b, seconds)]
        if len(pairs) == 1:
            for signal, group in zip(("position", "velocity"), pairs[0], strict=True):
                if signal not in chosen:
                    chosen[signal] = group
                    other = pairs[0][1 if signal == "position" else 0].name
                    why = f"{other} follows its differences" if signal == "position" else f"follows those of {other}"
                    self.found.rows.append(Understood(signal, group.name, "", why))
        elif len(pairs) > 1 and "position" not in chosen:
            self._ask(f"position may be {self._names(list(dict.fromkeys(pair[0] for pair in pairs)))}", "position=NAME")

    def _follows(self, position: Group, velocity: Group, seconds: FloatArray) -> bool:
        """Whether a group is the derivative of another, at every joint that moves."""
        q, v = position.values(self.table), velocity.values(self.table)
        slopes = [derivative_of(q[:, k], v[:, k], seconds, self._window(seconds)) for k in range(q.shape[1])]
        told = [slope for slope in slopes if slope is not None]
        return bool(told) and all(slope.correlation > DERIVATIVE for slope in told)

    def _window(self, seconds: FloatArray) -> int:
        step, _ = steps_s(seconds)
        return max(2, round(WINDOW_S / step)) if 0 < step < 0.5 else 10

    def _without_position(self, chosen: dict[str, Group]) -> dict[str, Group]:
        if not any(question.startswith("position") for question in self.found.questions):
            there = self._names([group for group in self.groups if group not in chosen.values()])
            if there == "none":
                raise UserError(
                    f"{self.where}: no columns of the positions of {len(self.arm.joints)} joints found; is --arm its "
                    f"arm? It has {', '.join(list(self.table.columns)[:12])}"
                )
            self._ask(f"position of the joints is not told by any name ({there})", "position=NAME")
        return {}

    def _by_weight(self, chosen: dict[str, Group]) -> None:
        """Effort among the groups whose names say nothing: what follows the weight of the arm."""
        used = list(chosen.values())
        open_groups = [one for one in self.groups if one.quantity is None and not one.commanded and one not in used]
        if not open_groups:
            raise UnfitDataError(
                f"{self.where}: no torque or current of the joints: without it no dynamics can be identified; the log "
                "can still show the motion itself, its limits and its spectrum"
            )
        position = chosen["position"].values(self.table)
        like = []
        for group in open_groups:
            for factor in (1.0, np.pi / 180.0):
                fit = weight_of(self.arm, position * self._scale(factor), group.values(self.table))
                if np.abs(fit.correlation).max() > LOADED and group not in like:
                    like.append(group)
        if len(like) == 1:
            chosen["effort"] = like[0]
            self.found.rows.append(Understood("effort", like[0].name, "", "follows the weight of the CAD's arm"))
        else:
            self._ask(f"effort may be {self._names(like or open_groups)}", "effort=NAME")

    # Units

    def _scale(self, factor: float) -> FloatArray:
        """(n,) a factor between units of angle, 1 for joints that slide."""
        return np.where(self.revolute, factor, 1.0)

    def _position_unit(self, chosen: Mapping[str, Group]) -> str:
        """Of the positions: as told or written, unless the limits forbid it; else as limits and weight have it."""
        group = chosen["position"]
        values = group.values(self.table)
        told = self.answers.get("position_unit")
        if told is not None:
            return _known_unit("position", told, self.found)
        possible = [
            unit for unit in ("rad", "deg") if self._within_limits(values * self._scale(UNITS["position"][unit]))
        ]
        if group.unit is not None:
            if group.unit == "counts":
                self._ask(
                    f"{group.name} is in counts: write counts_per_turn of each joint into a mapping file",
                    "position=NAME",
                )
            elif group.unit in ("rad", "deg") and group.unit not in possible:
                self._ask(
                    f"{group.name} says {group.unit}, but goes beyond the URDF's limits so", "position_unit=rad|deg"
                )
            else:
                self.found.rows.append(Understood("position", group.name, group.unit, "written, within the limits"))
            return group.unit
        if len(possible) > 1:
            possible = self._lighter(values, chosen.get("effort"), possible)
            why = "the effort follows the weight of the CAD's arm only so"
        else:
            why = "only so within the URDF's limits"
        if len(possible) != 1:
            self._ask(f"{group.name}: rad or deg fit the limits equally", "position_unit=rad|deg")
            return "rad"
        self.found.rows.append(Understood("position", group.name, possible[0], why))
        return possible[0]

    def _within_limits(self, angle: FloatArray) -> bool:
        """Whether positions (N, n), rad, stay within the URDF's limits; without limits, within two turns."""
        lowest, highest = np.nanpercentile(angle, (0.5, 99.5), axis=0)
        lower = np.array([joint.lower if np.isfinite(joint.lower) else -4 * np.pi for joint in self.arm.joints])
        upper = np.array([joint.upper if np.isfinite(joint.upper) else 4 * np.pi for joint in self.arm.joints])
        slack = (PAST_LIMIT - 1.0) * (upper - lower)
        return bool(np.all(lowest >= lower - slack) and np.all(highest <= upper + slack))

    def _lighter(self, values: FloatArray, effort: Group | None, units: list[str]) -> list[str]:
        """The unit in which effort follows the weight clearly better; all where none does."""
        if effort is None:
            return units
        left = {}
        for unit in units:
            fit = weight_of(self.arm, values * self._scale(UNITS["position"][unit]), effort.values(self.table))
            left[unit] = float(np.prod(fit.left))
        best = min(left, key=lambda unit: left[unit])
        return [best] if all(left[best] < BETTER * left[unit] for unit in units if unit != best) else units

    def _velocity_unit(self, group: Group, position: FloatArray, seconds: FloatArray) -> str:
        """Of the velocities: by their factor to the derivative of the positions."""
        told = self.answers.get("velocity_unit")
        if told is not None:
            return _known_unit("velocity", told, self.found)
        values = group.values(self.table)
        window = self._window(seconds)
        slopes = [derivative_of(position[:, k], values[:, k], seconds, window) for k in range(values.shape[1])]
        follow = [slope.factor for slope in slopes if slope is not None and abs(slope.correlation) > DERIVATIVE]
        timed = not any("rows a second" in question for question in self.found.questions)
        factor = float(np.median(np.abs(follow))) if follow and timed else float("nan")
        fitting = [unit for unit, size in UNITS["velocity"].items() if abs(factor * size - 1.0) < UNIT_OFF]
        if group.unit is not None and (not fitting or group.unit in fitting):
            why = f"written; {factor * UNITS['velocity'][group.unit]:.3g} times the positions' derivative"
            self.found.rows.append(Understood("velocity", group.name, group.unit, why if follow else "written"))
            return group.unit
        if len(fitting) == 1 and group.unit is None:
            why = f"{factor:.4g} times the derivative of the positions"
            self.found.rows.append(Understood("velocity", group.name, fitting[0], why))
            return fitting[0]
        if timed:
            what = f"says {group.unit} and" if group.unit else "does not say its unit and"
            measured = (
                f"is {factor:.4g} times the derivative of the positions" if follow else "does not follow the positions"
            )
            self._ask(f"{group.name} {what} {measured}", "velocity_unit=rad/s|deg/s|rpm")
        return group.unit or "rad/s"

    def _effort_unit(self, group: Group, position: FloatArray) -> tuple[str, dict[str, float]]:
        """Of the effort, with the constants that make it torque where the arm does not know them."""
        unit = self.answers.get("effort_unit") or group.unit
        if unit is None:
            unit = self._torque_by_weight(group, position)
        else:
            _known_unit("effort", unit, self.found)
            why = "told" if "effort_unit" in self.answers else "written"
            self.found.rows.append(Understood("effort", group.name, unit, why))
        if unit in TORQUE_UNITS:
            self._require_possible(group, unit)
            return unit, {}
        return unit, self._constants(group, unit)

    def _torque_by_weight(self, group: Group, position: FloatArray) -> str:
        if group.quantity != CURRENT:
            fit = weight_of(self.arm, position, group.values(self.table))
            loaded = np.abs(fit.correlation) > LOADED
            for unit, size in TORQUE_UNITS.items():
                slopes = np.abs(fit.slope[loaded]) * size
                if loaded.any() and np.all((slopes > LIKE_WEIGHT[0]) & (slopes < LIKE_WEIGHT[1])):
                    why = f"{np.median(slopes):.2g} times the weight of the CAD's arm"
                    self.found.rows.append(Understood("effort", group.name, unit, why))
                    return unit
        self._ask(
            f"{group.name}: the unit is not written, and the weight of the arm does not tell",
            "effort_unit='N m'|A|mA|percent",
        )
        return "N m"

    def _require_possible(self, group: Group, unit: str) -> None:
        """Ask where torque as written is beyond what the joints can have."""
        limits = np.array([joint.effort_limit for joint in self.arm.joints])
        largest = np.nanpercentile(np.abs(group.values(self.table)), 95, axis=0) * TORQUE_UNITS[unit]
        if np.any(largest > BEYOND_TORQUE * limits) and "effort_unit" not in self.answers:
            worst = self.arm.joint_names[int(np.argmax(largest / limits))]
            self._ask(
                f"{group.name} as {unit} is beyond {BEYOND_TORQUE:g} times the limit of {worst}",
                "effort_unit='N m'|'mN m'|A|mA|percent",
            )

    def _constants(self, group: Group, unit: str) -> dict[str, float]:
        """N·m for each A or at 100 %: as told; else none where the arm declares them; else of its drives."""
        if set(self.constants) >= set(self.arm.joint_names):
            return {joint: self.constants[joint] for joint in self.arm.joint_names}
        kind = "A" if unit in CURRENT_UNITS else "percent"
        if self.declared == kind and not self.constants:
            return {}
        drives = {joint.name: joint.gear_ratio * joint.torque_constant for joint in self.arm.joints}
        if unit in CURRENT_UNITS and all(value != 1.0 for value in drives.values()):
            return drives
        what = "N m on the output side for each A" if kind == "A" else "N m on the output side at 100 %"
        self.found.questions.append(
            f"{group.name} is in {unit}: say {what} for each joint, in the arm YAML (effort: unit, constants) given as "
            "--arm, or: --constants JOINT=VALUE ..."
        )
        return {}

    def _tell(
        self, chosen: Mapping[str, Group], units: dict[str, str], time: str | None, unit: str, rate_hz: float | None
    ) -> None:
        """Rows of what was decided without a row of its own."""
        if time is None and rate_hz is not None:
            self.found.rows.append(Understood("time", "(none)", "", f"rows at {rate_hz:g} Hz, as told"))
        if "command" in chosen:
            group = chosen["command"]
            self.found.rows.append(
                Understood("command", group.name, units["position"], "named, in the position's unit")
            )
        merged: dict[str, Understood] = {}
        for row in self.found.rows:
            before = merged.get(row.signal)
            why = row.because if before is None else f"{before.because}; {row.because}"
            merged[row.signal] = replace(row, because=why)
        order = ("time", "position", "velocity", "effort", "command")
        self.found.rows = sorted(merged.values(), key=lambda row: order.index(row.signal))


def too_slow(where: str, rate_hz: float) -> UnfitDataError:
    """What is said of a log below `SLOWEST_HZ`."""
    return UnfitDataError(
        f"{where}: {rate_hz:.4g} rows a second, below {SLOWEST_HZ:g} Hz: too slow to differentiate twice; it can still "
        "show friction at constant speed and gravity at rest; log faster to identify"
    )


def _unit(unit: str) -> float:
    if unit not in TIME_UNITS:
        raise UserError(f"{unit!r} is no unit of time: one of {', '.join(TIME_UNITS)}")
    return TIME_UNITS[unit]


def _known_unit(signal: str, unit: str, found: Proposal) -> str:
    if unit not in UNITS[signal]:
        raise UserError(f"{unit!r} is no unit of {signal}: one of {', '.join(UNITS[signal])}")
    if signal in ("position", "velocity"):
        found.rows.append(Understood(signal, "", unit, "told"))
    return unit


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value) or value <= 0.0:
        raise UserError(f"{what} needs a number above zero, not {text!r}")
    return value
