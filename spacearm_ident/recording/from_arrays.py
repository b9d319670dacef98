"""`from_arrays`: arrays of a script as a `Recording`, before a reader has looked for defects in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from .recording import Recording, Series

LONGEST_STEP_S = 1.0
"""Between samples: milliseconds taken for seconds are this at 1 kHz, and so few samples show no motion of an arm."""


def from_arrays(
    time: Any,
    position: Any,
    effort: Any,
    joints: Sequence[str] | None,
    velocity: Any = None,
    temperature: Any = None,
) -> Recording:
    """A recording of arrays, lists or DataFrames; what it holds may be NaN.

    Args:
        time: (N,) s, increasing; of the recording's start, or of 1970.
        position: (N, n) rad, m for sliding joints.
        effort: (N, n) N·m, or the unit that the arm YAML declares.
        joints: n names; None: the columns of `position`, a DataFrame. Columns of other DataFrames are found by name.
        velocity: (N, n) rad/s; None: not recorded.
        temperature: (N, n) °C; None: not recorded.

    Raises:
        UserError: The shapes do not fit, names are missing or repeated, or time does not increase.
    """
    names = tuple(map(str, getattr(position, "columns", ()) if joints is None else joints))
    if not names or len(set(names)) != len(names):
        raise UserError("joints: give the names of the columns of position, each once, or a DataFrame that has them")
    stamps = _numbers("time", time)
    if stamps.ndim != 1 or len(stamps) < 2 or not np.isfinite(stamps).all():
        raise UserError(f"time is of shape {stamps.shape}: give (N,) finite seconds, at least two")
    back = np.flatnonzero(np.diff(stamps) <= 0.0)
    if back.size:
        k = int(back[0])
        raise UserError(f"time does not increase: {stamps[k]:.9g} s in row {k}, then {stamps[k + 1]:.9g} s")
    step = float(np.median(np.diff(stamps)))
    if step >= LONGEST_STEP_S:
        raise UserError(f"samples are {step:g} s apart: give time in seconds (of milliseconds, divide by 1e3)")
    signals = {
        name: _by_joint(name, values, names, len(stamps))
        for name, values in (("position", position), ("effort", effort), ("velocity", velocity))
        if values is not None
    }
    start_s = max(float(stamps[0]), 0.0)
    clock = stamps - stamps[0]
    warm = None if temperature is None else _by_joint("temperature", temperature, names, len(stamps))
    return Recording(
        joints=names,
        time=clock,
        position=signals["position"],
        velocity=signals.get("velocity"),
        effort=signals["effort"],
        segments=(slice(0, len(clock)),),
        start_ns=round(start_s * 1e9),
        temperatures={} if warm is None else {joint: Series(clock, column) for joint, column in zip(names, warm.T)},
    )


def _by_joint(name: str, values: Any, joints: tuple[str, ...], rows: int) -> FloatArray:
    """(N, n) numbers in the order of `joints`; of one joint (N,) does as well."""
    if hasattr(values, "columns"):
        missing = [joint for joint in joints if joint not in values.columns]
        if missing:
            raise UserError(f"{name} has no column {', '.join(missing)}: it has {', '.join(map(str, values.columns))}")
        values = values[list(joints)]
    numbers = _numbers(name, values)
    if numbers.ndim == 1 and len(joints) == 1:
        numbers = numbers[:, None]
    if numbers.shape != (rows, len(joints)):
        raise UserError(f"{name} is of shape {numbers.shape}: {rows} rows of {len(joints)} joints are needed")
    return numbers


def _numbers(name: str, values: Any) -> FloatArray:
    try:
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{name} is not an array of numbers: {error}") from error
