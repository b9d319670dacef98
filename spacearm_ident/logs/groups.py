"""The columns of a log in groups: one signal of all joints each, joint by joint, and which columns can be a time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..recording.log_mapping import FRACTIONS, TIME_UNITS
from ..recording.tables import Table
from .signals import FASTEST_HZ, steps_s
from .words import INDEX, OTHER, TIME, Meaning, meaning_of, split_unit

EVEN = 0.95
"""Share of steps that must go forward, and be alike within a factor of ten, for a column to be a time."""

COUNTS_ROWS = "counts rows"
RESTARTS = "begins again every second"
"""Why a column that looks like a time is none; the second cannot be one whatever the user says."""


@dataclass(frozen=True)
class Group:
    """Columns that differ in the joint alone.

    Attributes:
        name: What a user calls it: the names with `#` for what differs.
        quantity: What the names say it is; None: nothing.
        unit: The unit they give; None: none.
        commanded, measured, motor_side: As `Meaning`.
        columns: Joint -> column, of every joint of the arm in its order.
        extra: Columns of the group beyond the arm's joints.
    """

    name: str
    quantity: str | None
    unit: str | None
    commanded: bool
    measured: bool
    motor_side: bool
    columns: Mapping[str, str]
    extra: tuple[str, ...] = ()

    def values(self, table: Table) -> FloatArray:
        """(N, n) as recorded, joints in the arm's order."""
        return np.stack([np.asarray(table.columns[name], dtype=np.float64) for name in self.columns.values()], axis=1)


@dataclass(frozen=True)
class Clock:
    """A column that can be a time.

    Attributes:
        name: The column.
        unit: The unit that its name gives; None: none.
        flaw: Why it is no time after all, `COUNTS_ROWS` or `RESTARTS`; None: it can be one.
        named: Whether its name says that it is a time.
        fraction: Column of the part of a second to be added to each of its whole seconds; None: none.
        fraction_unit: Unit of that, one of `FRACTIONS`.
    """

    name: str
    unit: str | None
    flaw: str | None
    named: bool
    fraction: str | None = None
    fraction_unit: str = "ns"

    @property
    def columns(self) -> str:
        """Its columns, for the user."""
        return self.name if self.fraction is None else f"{self.name}, {self.fraction}"

    def values(self, table: Table) -> FloatArray:
        """(N,) in its unit; from the first row or second on where a float may not keep it."""
        values = table.columns[self.name]
        own = np.asarray(values - values[0] if values.dtype.kind == "i" else values, dtype=np.float64)
        if self.fraction is None:
            return own
        fraction = np.asarray(table.columns[self.fraction], dtype=np.float64)
        return own - float(np.fmin.reduce(own)) + TIME_UNITS[self.fraction_unit] * fraction


def find_clocks(table: Table) -> list[Clock]:
    """Columns that can be a time, the likeliest first: named so and even, then even; those with a flaw last."""
    found = _split_clocks(table)
    split = {name for clock in found for name in (clock.name, clock.fraction)}
    for name in table.columns:
        meaning = meaning_of(name)
        of_a_joint = meaning.quantity is None and meaning.number is not None and not _nameless(name)
        dated = name in table.dates
        if name in split or (not dated and (meaning.quantity not in (TIME, INDEX, None) or of_a_joint)):
            continue
        unit = "ns" if dated else meaning.unit or _unit_alone(name)
        ticks = Clock(name, unit, None, False).values(table)
        _, share = steps_s(ticks)
        if share < EVEN:
            continue
        counts = bool(np.median(np.abs(np.diff(ticks) - 1.0)) < 1e-9) and (meaning.quantity == INDEX or unit is None)
        flaw = COUNTS_ROWS if counts else RESTARTS if _restarts(table, name, unit) else None
        found.append(Clock(name, unit, flaw, meaning.quantity == TIME or dated))
    return sorted(found, key=lambda clock: (clock.flaw is not None, not clock.named))


def _unit_alone(name: str) -> str | None:
    """The unit of a column whose name is that of a unit of time, of more than one letter."""
    rest, unit = split_unit(name)
    return unit if not rest and len(name) > 1 and unit in TIME_UNITS else None


def _split_clocks(table: Table) -> list[Clock]:
    """Times in two columns that differ in the unit of their names alone, whole seconds and what is added."""
    by_rest: dict[str, dict[str, str]] = {}
    for name in table.columns:
        rest, unit = split_unit(name)
        if unit in ("s", *FRACTIONS):
            by_rest.setdefault(rest, {}).setdefault(unit, name)
    found = []
    for pair in by_rest.values():
        for part in FRACTIONS:
            if "s" not in pair or part not in pair:
                continue
            seconds, fraction = (np.asarray(table.columns[pair[unit]], dtype=np.float64) for unit in ("s", part))
            clock = Clock(pair["s"], "s", None, True, pair[part], part)
            sound = np.isfinite(seconds) & np.isfinite(fraction)
            within = (fraction[sound] >= 0.0) & (fraction[sound] * TIME_UNITS[part] < 1.0)
            whole = seconds[sound] == np.rint(seconds[sound])
            if within.all() and whole.all() and steps_s(clock.values(table))[1] >= EVEN:
                found.append(clock)
                break
    return found


def _restarts(table: Table, name: str, unit: str | None) -> bool:
    """Whether a column is the fraction of a second alone, which falls by most of a second where one ends.

    Without a unit it is one in any unit in which it stays within a second at a rate that recorders have.
    """
    values = np.asarray(table.columns[name], dtype=np.float64)
    values = values[np.isfinite(values)]
    step, _ = steps_s(values)
    return any(
        values.min() >= 0.0 and values.max() * size < 1.0 and np.diff(values).min() * size < -0.5
        and step * size > 1.0 / FASTEST_HZ
        for one, size in TIME_UNITS.items()
        if unit in (None, one)
    )  # fmt: skip


def find_groups(
    table: Table, arm: Arm, clocks: list[Clock], listed: tuple[str, ...] = ()
) -> tuple[list[Group], list[str]]:
    """The groups that have a column for every joint of the arm, and what stays over, as lines.

    Joints are told by their names in the columns' names, else by numbers, in the arm's order; columns without either,
    such as those of a file without a header, by their place: as many next to each other as the arm has joints.

    Args:
        table: The log's columns.
        arm: Whose joints are looked for.
        clocks: Columns that are stamps, which belong to no group.
        listed: The joints in the order of the numbers, as the log lists them; empty: it does not.
    """
    taken = {name for clock in clocks for name in (clock.name, clock.fraction)}
    meanings = {name: meaning_of(name) for name in table.columns if name not in taken}
    nameless = [name for name in meanings if _nameless(name)]
    members: dict[tuple[object, ...], list[tuple[str, int | str]]] = {}
    alone, others = [], []
    for name, meaning in meanings.items():
        if name in nameless or meaning.quantity in (TIME, INDEX, OTHER):
            if meaning.quantity == OTHER:
                others.append(name)
            continue
        joint = _joint_named(meaning, arm)
        if joint is None and meaning.number is None:
            alone.append(name)
            continue
        parts = meaning.parts if joint is None else _without(meaning.parts, joint)
        key = (meaning.quantity, meaning.unit, meaning.commanded, meaning.measured, meaning.motor_side, parts)
        members.setdefault(key, []).append((name, joint if joint is not None else meaning.number or 0))
    groups, lines = [], []
    for named in members.values():
        group = _group(named, meanings[named[0][0]], arm, listed)
        if group is None:
            alone += [name for name, _ in named]
        else:
            groups.append(group)
            if group.extra:
                lines.append(f"{', '.join(group.extra)}: beyond the {len(arm.joints)} joints of the arm, left out")
    groups += _by_place(nameless, arm)
    used = {name for group in groups for name in (*group.columns.values(), *group.extra)}
    left = [name for name in (*alone, *nameless) if name not in used]
    for names, why in ((left, "not a signal of every joint of the arm"), (others, "no position, velocity or effort")):
        if names:
            shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            lines.append(f"{shown}: {why}, left out")
    return groups, lines


def names_joints(table: Table, arm: Arm) -> bool:
    """Whether the name of a column holds that of a joint of the arm.

    Args:
        table: The log's columns.
        arm: Whose joints are looked for.
    """
    return any(_joint_named(meaning_of(name), arm) is not None for name in table.columns)


def _nameless(name: str) -> bool:
    """Whether a column has its place for a name, as the columns of a file without a header have."""
    return re.fullmatch(r"column \d+", name) is not None


def _joint_named(meaning: Meaning, arm: Arm) -> str | None:
    """The joint whose name a column's name holds; the longest where several do. Numbers are not looked at."""
    best: tuple[int, str] | None = None
    own = set(meaning.parts)
    for name in arm.joint_names:
        words = _distinctive(name)
        if words and words <= own and (best is None or len(words) > best[0]):
            best = (len(words), name)
    if best is None:
        return None
    # `wrist_1` and `wrist_2` differ by their numbers alone.
    alike = [name for name in arm.joint_names if _distinctive(name) == _distinctive(best[1])]
    if len(alike) == 1:
        return best[1]
    return next((name for name in alike if _trailing(name) == meaning.number), None)


def _distinctive(joint: str) -> frozenset[str]:
    """The words of a joint's name without numbers and without what every joint is called."""
    return frozenset(meaning_of(joint).parts) - {"joint", "j", "axis", "achse", "a", "q", "fr", "panda", "iiwa", "link"}


def _without(parts: tuple[str, ...], joint: str) -> tuple[str, ...]:
    words = set(meaning_of(joint).parts)
    return tuple(part for part in parts if part not in words)


def _trailing(joint: str) -> int | None:
    return meaning_of(joint).number


def _group(named: list[tuple[str, int | str]], meaning: Meaning, arm: Arm, listed: tuple[str, ...]) -> Group | None:
    """A group of columns with the joint, or the number, of each; None where a joint of the arm is missing."""
    by_joint = {of: name for name, of in named if isinstance(of, str)}
    by_number = {of: name for name, of in named if isinstance(of, int)}
    if by_joint and not by_number:
        columns = {joint: by_joint[joint] for joint in arm.joint_names if joint in by_joint}
    elif listed and by_number and not by_joint and len(by_number) == len(named):
        if len(listed) != len(by_number):
            return None
        place = dict(zip(listed, sorted(by_number), strict=True))
        columns = {joint: by_number[place[joint]] for joint in arm.joint_names}
    elif by_number and not by_joint and len(by_number) == len(named):
        own = [_trailing(joint) for joint in arm.joint_names]
        numbers = sorted(by_number)
        if None not in own and len(set(own)) == len(own) and set(own) <= set(numbers):
            order = [number for number in own if number is not None]
        else:
            order = numbers[: len(own)]
        if order != sorted(own, key=lambda k: k or 0) and order != list(range(numbers[0], numbers[0] + len(order))):
            return None
        columns = {joint: by_number[number] for joint, number in zip(arm.joint_names, order)}
    else:
        return None
    if len(columns) < len(arm.joints):
        return None
    extra = tuple(name for name, _ in named if name not in columns.values())
    return Group(
        _shared_name(list(columns.values())),
        meaning.quantity,
        meaning.unit,
        meaning.commanded,
        meaning.measured,
        meaning.motor_side,
        columns,
        extra,
    )


def _shared_name(names: list[str]) -> str:
    """Names with `#` for where they differ."""
    first = names[0]
    start = next((k for k in range(len(first)) if any(name[k : k + 1] != first[k] for name in names)), len(first))
    rest = min(len(name) for name in names) - start
    end = next((k for k in range(rest) if any(name[-1 - k] != first[-1 - k] for name in names)), rest)
    return f"{first[:start]}#{first[len(first) - end :] if end else ''}"


def _by_place(nameless: list[str], arm: Arm) -> list[Group]:
    """Columns without names, as many at a time as the arm has joints."""
    n = len(arm.joints)
    groups = []
    for start in range(0, len(nameless) - n + 1, n):
        block = nameless[start : start + n]
        name = f"{block[0]} to {block[-1].removeprefix('column ')}"
        groups.append(Group(name, None, None, False, False, False, dict(zip(arm.joint_names, block))))
    return groups if len(nameless) % n == 0 else []
