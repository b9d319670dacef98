"""`time_of`: which column is the time, in which unit; by name, else by the only rate that recorders have."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..recording.log_mapping import TIME_UNITS
from .groups import Clock
from .search import Search, too_slow
from .signals import FASTEST_HZ, SLOWEST_HZ, steps_s


def time_of(log: Search) -> tuple[str | None, str, float | None, FloatArray]:
    """The time of a log's rows; what is open is asked.

    Returns:
        Column (None: there is none), its unit, rows a second where there is no column, and (N,) s, or row numbers
        while the rate is open.

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
    clock = Clock(asked, None, False, True) if asked is not None else next(iter(log.clocks), None)
    if clock is None or (clock.counts_rows and asked is None and "time_unit" not in log.answers):
        what = "no column is a time" if clock is None else f"{clock.name!r} counts rows and is no time"
        log.ask(f"{what}: how many rows a second", "rate_hz=HZ")
        return None, "s", None, rows
    values = log.table.columns[clock.name]
    own = np.asarray(values - values[0] if values.dtype.kind == "i" else values, dtype=np.float64)
    step, _ = steps_s(own)
    unit = log.answers.get("time_unit") or clock.unit
    possible = [one for one, size in TIME_UNITS.items() if SLOWEST_HZ <= 1.0 / (size * step) <= FASTEST_HZ]
    if unit is None and len(possible) == 1:
        unit = possible[0]
        log.tell("time", clock.name, unit, f"only so a rate that recorders have, {1 / step:.5g} rows a unit")
    elif unit is None and step >= 1.0 / SLOWEST_HZ and step < 10.0:
        unit = "s"  # every smaller unit gives a rate beyond any recorder: the log is slow, and is refused below
    elif unit is None:
        log.ask(f"{clock.name!r} has {1 / step:.4g} rows a unit: which unit", "time_unit=s|ms|us|ns")
        return clock.name, "s", None, own
    else:
        why = "told" if "time_unit" in log.answers else "written"
        log.tell("time", clock.name, unit, f"{why}; {1 / (step * _unit(unit)):.5g} Hz")
    _require_rate(log, 1.0 / (step * _unit(unit)))
    return clock.name, unit, None, own * _unit(unit)


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
