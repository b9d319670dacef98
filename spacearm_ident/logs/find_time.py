"""`time_of`: which column is the time, in which unit; by name, else by the only rate that recorders have."""

from __future__ import annotations

import re

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..recording.log_mapping import FRACTIONS, TIME_UNITS
from ..recording.tables import Table
from ..recording.tables.text import order_of_date_is_open
from .groups import RESTARTS, Clock
from .search import Search, too_slow
from .signals import FASTEST_HZ, SLOWEST_HZ, steps_s
from .words import TIME, meaning_of

_LIKE_A_TIME = re.compile(r"\d:\d\d|\b(?:19|20)\d\d[-/.]\d|\d[-/.](?:19|20)\d\d\b")
"""In a cell of text: a time of the day, or a date with its year."""
FORMATS = "YYYY-MM-DD hh:mm:ss.fff, DD.MM.YYYY hh:mm:ss.fff, hh:mm:ss.fff, or a number in s, ms, us or ns"
"""Forms of a time that are read from text, for messages."""


def time_of(log: Search) -> tuple[Clock | None, str, float | None, FloatArray]:
    """The time of a log's rows; what is open is asked.

    Returns:
        Its column or two (None: there is none), its unit, rows a second where there is no column, and (N,) s, or row
        numbers while the rate is open.

    Raises:
        UnfitDataError: Below `SLOWEST_HZ`.
        UserError: An answer that cannot be.
    """
    rows = np.arange(log.table.rows, dtype=np.float64)
    rate = log.answers.get("rate_hz") or (None if log.clocks else log.table.rate_hz)
    if rate is not None:
        hertz = _number(str(rate), "rate_hz")
        _require_rate(log, hertz)
        return None, "s", hertz, rows / hertz
    asked = log.answers.get("time")
    if asked is not None and asked not in log.table.columns:
        raise UserError(f"{log.where}: no column {asked!r} for the time")
    clock = _asked(log, asked) if asked is not None else next(iter(log.clocks), None)
    told = asked is not None or "time_unit" in log.answers
    if clock is None or clock.flaw == RESTARTS or (clock.flaw and not told):
        what = "no column is a time" if clock is None else f"{clock.name!r} {clock.flaw} and is no time"
        question = _unread_time(log.table) or f"{what}:"
        log.ask(f"{question} how many rows a second", "rate_hz=HZ")
        return None, "s", None, rows
    own = clock.values(log.table)
    step, _ = steps_s(own)
    known = clock.fraction is not None or clock.name in log.table.dates
    unit = clock.unit if known else log.answers.get("time_unit") or clock.unit
    possible = [one for one, size in TIME_UNITS.items() if SLOWEST_HZ <= 1.0 / (size * step) <= FASTEST_HZ]
    if unit is None and len(possible) == 1:
        unit = possible[0]
        log.tell("time", clock.columns, unit, f"only so a rate that recorders have, {1 / step:.5g} rows a unit")
    elif unit is None and step >= 1.0 / SLOWEST_HZ and step < 10.0:
        unit = "s"  # every smaller unit gives a rate beyond any recorder: the log is slow, and is refused below
    elif unit is None:
        log.ask(f"{clock.name!r} has {1 / step:.4g} rows a unit: which unit", "time_unit=s|ms|us|ns")
        return clock, "s", None, own
    else:
        why = "told" if "time_unit" in log.answers else "written"
        if known:
            why = "dates" if clock.fraction is None else f"seconds and {FRACTIONS[clock.fraction_unit]}"
        log.tell("time", clock.columns, unit, f"{why}; {1 / (step * _unit(unit)):.5g} Hz")
    _require_rate(log, 1.0 / (step * _unit(unit)))
    return clock, unit, None, own * _unit(unit)


def _unread_time(table: Table) -> str:
    """Which column of text looks like a time, why it is not read, and what is read; empty: none does."""
    for name, cells in table.texts.items():
        if len(cells) < 2 or not (meaning_of(name).quantity == TIME or _LIKE_A_TIME.search(cells[0])):
            continue
        undecided = order_of_date_is_open(cells[0])
        why = "may be day/month or month/day" if undecided else "is in a format that is not read"
        return f"column {name!r} looks like a time, but {cells[0]!r} {why}; write {FORMATS}; or say"
    return ""


def _asked(log: Search, name: str) -> Clock:
    """The time that the user names, with what is added where it has two columns; a fraction of a second stays one."""
    found = next((clock for clock in log.clocks if clock.name == name), None)
    if found is not None and (found.fraction is not None or found.flaw == RESTARTS or name in log.table.dates):
        return found
    return Clock(name, None, None, True)


def _require_rate(log: Search, rate_hz: float) -> None:
    if rate_hz < SLOWEST_HZ * (1.0 - 1e-6):
        raise too_slow(log.where, rate_hz)


def _unit(unit: str) -> float:
    if unit not in TIME_UNITS:
        raise UserError(f"{unit!r} is no unit of time: one of {', '.join(TIME_UNITS)}")
    return TIME_UNITS[unit]


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value) or value <= 0.0:
        raise UserError(f"{what} needs a number above zero, not {text!r}")
    return value
