"""`Search`: what is asked of one log, what is known of it, and the proposal that grows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..errors import UnfitDataError, UserError
from ..recording.log_mapping import SI, UNITS, LogMapping
from ..recording.tables import Table
from .groups import Clock, Group, find_clocks, find_groups, names_joints
from .signals import SLOWEST_HZ, WINDOW_S, steps_s


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


class Search:
    """One log with its arm, and the proposal that each decision adds to.

    Attributes:
        table: The log's columns.
        arm: The arm that it is of.
        where: The log, for messages.
        answers: What the user says, by `ANSWERS`.
        constants: Joint -> N·m for each A, or at 100 %.
        declared: Unit in which the arm YAML declares effort; None: it does not.
        clocks: Columns that can be a time, the likeliest first.
        groups: Columns that differ in the joint alone.
        listed_by: List of the log that gives the order of the joints; None: their numbers do.
        found: The proposal.
    """

    def __init__(
        self, table: Table, arm: Arm, where: str, answers: Mapping[str, str], constants: Mapping[str, float],
        declared: str | None,
    ) -> None:  # fmt: skip
        """Raises UserError for an answer to no question, or a constant of no joint."""
        if unknown := set(answers) - set(ANSWERS):
            raise UserError(f"nothing to set by the name {min(unknown)!r}; one of {', '.join(ANSWERS)}")
        if unknown := set(constants) - set(arm.joint_names):
            raise UserError(f"effort constant of {min(unknown)!r}: the arm has {', '.join(arm.joint_names)}")
        self.table, self.arm, self.where, self.answers = table, arm, where, answers
        self.constants, self.declared = constants, declared
        self.found = Proposal()
        self.clocks: list[Clock] = find_clocks(table)
        self.groups: list[Group]
        self.listed_by: str | None = None
        listed = () if names_joints(table, arm) else self._listed()
        self.groups, lines = find_groups(table, arm, self.clocks, listed)
        self.found.left_out += lines
        self._revolute = np.array([joint.revolute for joint in arm.joints])

    def _listed(self) -> tuple[str, ...]:
        """The joints in the order in which the log lists them; one that is in doubt is asked."""
        own = set(self.arm.joint_names)
        for name, values in self.table.lists.items():
            words = {word for value in values for word in value}
            if len(values) == 1 and own <= words and len(words) == len(values[0]):
                self.listed_by = name
                return values[0]
            if own & words:
                what = "changes over the log" if len(values) > 1 else "lists not each joint of the arm once"
                self.found.questions.append(
                    f"{name!r} {what}, so that the numbers of the columns say no joint: write a mapping file by hand"
                )
            elif any(len(value) == len(own) for value in values):
                self.found.left_out.append(
                    f"{name}: lists {', '.join(values[0])}, none of them a joint of the arm; its joints' order is taken"
                )
        return ()

    def ask(self, question: str, answer: str) -> None:
        """Add a question with the `--set` that answers it."""
        self.found.questions.append(f"{question}: --set {answer}")

    def tell(self, signal: str, columns: str, unit: str, because: str) -> None:
        """Add a row to the table that the user sees.

        Args:
            signal: What the columns are taken for.
            columns: Their names.
            unit: Their unit.
            because: Why.
        """
        sliding = {"rad": "m", "rad/s": "m/s", "N m": "N"}.get(SI[signal]) if unit and signal in SI else None
        if sliding and not self._revolute.all():
            unit = f"{unit}, {sliding}" if self._revolute.any() else sliding
        self.found.rows.append(Understood(signal, columns, unit, because))

    def scale(self, factor: float) -> FloatArray:
        """(n,) a factor between units of angle, 1 for joints that slide."""
        return np.where(self._revolute, factor, 1.0)

    def window(self, seconds: FloatArray) -> int:
        """Rows in `WINDOW_S`; ten where the steps of (N,) `seconds` are no seconds yet."""
        step, _ = steps_s(seconds)
        return max(2, round(WINDOW_S / step)) if 0 < step < 0.5 else 10


def too_slow(where: str, rate_hz: float) -> UnfitDataError:
    """What is said of a log below `SLOWEST_HZ`.

    Args:
        where: The log, for the message.
        rate_hz: Rows a second that were found.

    Returns:
        The error, to be raised by the caller.
    """
    return UnfitDataError(
        f"{where}: {rate_hz:.4g} rows a second, below {SLOWEST_HZ:g} Hz: too slow to differentiate twice; it can still "
        "show friction at constant speed and gravity at rest; log faster to identify"
    )
