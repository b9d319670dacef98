"""`Table`: the numeric columns of a log, by name, before anybody has said what they mean."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Issue, Source

MAX_TABLE_BYTES = 4 * 2**30
"""Most bytes of numbers that a log may announce or hold, as for a bag (`bag.MAX_KEPT_BYTES`)."""
MAX_COLUMNS = 4096
"""Most columns of a log; a seven-joint controller logs some hundred."""
FEWEST_ROWS = 2

Column = NDArray[np.float64] | NDArray[np.int64]


@dataclass(frozen=True)
class Table:
    """Columns of equal length.

    Attributes:
        columns: Name -> (N,) numbers, NaN where a cell is empty; whole numbers of 64 bits stay whole.
        sources: The files behind it.
        starts: First rows of the stretches that follow each other in time (episodes of a data set); the first is 0.
        rate_hz: Rows a second where the format itself says so.
        issues: What was found wrong and what was done about it.
        dates: Columns of dates with times, whole nanoseconds since 1970, UTC where the log names no zone; times of the
            day without a date are on the first of 1970.
        lists: Lists of words beside the numbers, such as the joints' names -> the different values that they take.
        texts: Columns of text that are none of these -> the first two different cells.
    """

    columns: Mapping[str, Column]
    sources: tuple[Source, ...]
    starts: tuple[int, ...] = (0,)
    rate_hz: float | None = None
    issues: tuple[Issue, ...] = ()
    dates: frozenset[str] = frozenset()
    lists: Mapping[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """N."""
        return len(next(iter(self.columns.values())))


def table_of(arrays: Mapping[str, Any], sources: tuple[Source, ...], where: str, rate_hz: float | None = None) -> Table:
    """A table of the arrays of a file that share the commonest length; matrices become a column each.

    Args:
        arrays: Name -> array of any kind and shape.
        sources: The files behind them.
        where: The file, for errors.
        rate_hz: Rows a second, where the format says so.

    Raises:
        UserError: No numeric array of two rows or more, or more than `MAX_COLUMNS` columns.
    """
    instants = {name: since_1970(array) for name, array in arrays.items() if np.asarray(array).dtype.kind == "M"}
    arrays = dict(arrays) | instants
    upright = {name: matrix for name, array in arrays.items() if (matrix := _matrix(array)) is not None}
    weight: Counter[int] = Counter()
    for matrix in upright.values():  # time runs along the longer side, whichever that is
        weight[max(matrix.shape)] += min(matrix.shape)
    rows = max(weight, key=lambda length: (weight[length], length), default=0)
    columns: dict[str, Column] = {}
    left = []
    for name, matrix in upright.items():
        if matrix.shape[0] != rows and matrix.shape[1] == rows:
            matrix = matrix.T
        if matrix.shape[0] != rows or len(columns) + matrix.shape[1] > MAX_COLUMNS:
            left.append(name)
        elif matrix.shape[1] == 1:
            columns[name] = numbers(matrix[:, 0])
        else:
            columns |= {f"{name}[{k}]": numbers(matrix[:, k]) for k in range(matrix.shape[1])}
    if rows < FEWEST_ROWS or not columns:
        raise UserError(f"{where}: no numeric columns of two rows or more; is it a log of joint signals?")
    issues = []
    if left:
        shown = ", ".join(left[:5]) + (", ..." if len(left) > 5 else "")
        issues.append(Issue("column_left_out", f"arrays not of {rows} rows left out: {shown}", len(left)))
    dates = frozenset(name for name, whole in instants.items() if whole is not None and name in columns)
    lists = {name: words for name, array in arrays.items() if (words := _words(array))}
    return Table(columns, sources, rate_hz=rate_hz, issues=tuple(issues), dates=dates, lists=lists)


def _matrix(array: Any) -> NDArray[Any] | None:
    """An array as a matrix of real numbers; None where it is none. A row of numbers is a column."""
    values = np.asarray(array)
    if values.dtype.kind not in "fiub" or values.ndim not in (1, 2) or 0 in values.shape:
        return None
    if values.ndim == 2 and values.shape[0] == 1:
        values = values[0]
    return values[:, None] if values.ndim == 1 else values


def _words(array: Any) -> tuple[tuple[str, ...], ...]:
    """The different lists of words of an array, which is one list or one a row; none where it holds no words."""
    values = np.asarray(array)
    if values.dtype.kind not in "UO" or values.ndim not in (1, 2):
        return ()
    rows = values.tolist()
    if values.ndim == 1 and not any(isinstance(row, list | tuple) for row in rows):
        rows = [rows]
    if not all(isinstance(row, list | tuple) and all(isinstance(word, str) for word in row) for row in rows):
        return ()
    return tuple(sorted({tuple(row) for row in rows}))


def numbers(column: NDArray[Any]) -> Column:
    """(N,) as float64, or int64 where whole: epoch nanoseconds do not fit into a float."""
    if column.dtype.kind in "iu" and column.dtype.itemsize == 8:
        return np.ascontiguousarray(column.astype(np.int64))
    return np.ascontiguousarray(column.astype(np.float64))


def since_1970(dates: Any) -> NDArray[np.int64] | None:
    """(N,) nanoseconds since 1970, a row without a date as `filled`; None where none has one, or of a matrix.

    Args:
        dates: numpy's datetime64 of any unit.
    """
    values = np.asarray(dates)
    if values.ndim != 1 or np.isnat(values).all():
        return None
    seconds = values.astype("datetime64[s]").astype(np.int64)
    sound = ~np.isnat(values) & (np.abs(seconds) < 2**62 // 10**9)  # beyond it nanoseconds overflow 64 bits
    if not sound.any():
        return None
    return filled(values, sound).astype("datetime64[ns]").astype(np.int64)


def filled(column: NDArray[Any], sound: NDArray[np.bool_]) -> NDArray[Any]:
    """A time of which a row that has none takes that of the row before: it is dropped as a repetition later.

    Args:
        column: (N,).
        sound: (N,) whether a row has a time; one at least does. Rows before the first take the first.
    """
    return column[np.maximum.accumulate(np.where(sound, np.arange(len(column)), np.argmax(sound)))]


def require_room(announced: int, where: str) -> None:
    """Refuse a log whose numbers would not fit.

    Args:
        announced: Bytes of numbers, counted or estimated before they are kept.
        where: The file, for the message.

    Raises:
        UserError: It announces more than `MAX_TABLE_BYTES`.
    """
    if announced > MAX_TABLE_BYTES:
        raise UserError(f"{where}: more than {MAX_TABLE_BYTES >> 30} GiB of numbers; split it")
