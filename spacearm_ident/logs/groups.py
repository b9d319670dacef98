"""The columns of a log in groups: one signal of all joints each, joint by joint, and which columns can be a time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..recording.tables import Table
from .signals import steps_s
from .words import INDEX, OTHER, TIME, Meaning, meaning_of

EVEN = 0.95
"""Share of steps that must go forward, and be alike within a factor of ten, for a column to be a time."""


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
    """A column that can be a time: its name, the unit it gives, and whether it merely counts rows."""

    name: str
    unit: str | None
    counts_rows: bool
    named: bool


def find_clocks(table: Table) -> list[Clock]:
    """Columns that can be a time, the likeliest first: named so and even, then even; those that count rows last."""
    found = []
    for name, values in table.columns.items():
        meaning = meaning_of(name)
        of_a_joint = meaning.quantity is None and meaning.number is not None and not _nameless(name)
        if meaning.quantity not in (TIME, INDEX, None) or of_a_joint:
            continue
        seconds = np.asarray(values - values[0] if values.dtype.kind == "i" else values, dtype=np.float64)
        _, share = steps_s(seconds)
        if share < EVEN:
            continue
        steps = np.diff(seconds)
        counts = bool(np.median(np.abs(steps - 1.0)) < 1e-9) and (meaning.quantity == INDEX or meaning.unit is None)
        found.append(Clock(name, meaning.unit, counts, meaning.quantity == TIME))
    return sorted(found, key=lambda clock: (clock.counts_rows, not clock.named))


def find_groups(table: Table, arm: Arm, clocks: list[Clock]) -> tuple[list[Group], list[str]]:
    """The groups that have a column for every joint of the arm, and what stays over, as lines.

    Joints are told by their names in the columns' names, else by numbers, in the arm's order; columns without either,
    such as those of a file without a header, by their place: as many next to each other as the arm has joints.

    Args:
        table: The log's columns.
        arm: Whose joints are looked for.
        clocks: Columns that are stamps, which belong to no group.
    """
    taken = {clock.name for clock in clocks}
    meanings = {name: meaning_of(name) for name in table.columns if name not in taken}
    nameless = [name for name in meanings if _nameless(name)]
    members: dict[tuple[object, ...], list[tuple[str, int | str]]] = {}
    alone = []
    for name, meaning in meanings.items():
        if name in nameless or meaning.quantity in (TIME, INDEX, OTHER):
            if meaning.quantity == OTHER:
                alone.append(name)
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
        group = _group(named, meanings[named[0][0]], arm)
        if group is None:
            alone += [name for name, _ in named]
        else:
            groups.append(group)
            if group.extra:
                lines.append(f"{', '.join(group.extra)}: beyond the {len(arm.joints)} joints of the arm, left out")
    groups += _by_place(nameless, arm)
    used = {name for group in groups for name in (*group.columns.values(), *group.extra)}
    left = [name for name in (*alone, *nameless) if name not in used]
    if left:
        shown = ", ".join(left[:8]) + (", ..." if len(left) > 8 else "")
        lines.append(f"{shown}: not a signal of every joint, left out")
    return groups, lines


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


def _group(named: list[tuple[str, int | str]], meaning: Meaning, arm: Arm) -> Group | None:
    """A group of columns with the joint, or the number, of each; None where a joint of the arm is missing."""
    by_joint = {of: name for name, of in named if isinstance(of, str)}
    by_number = {of: name for name, of in named if isinstance(of, int)}
    if by_joint and not by_number:
        columns = {joint: by_joint[joint] for joint in arm.joint_names if joint in by_joint}
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
