"""Logs as text: CSV, TSV, columns with white space between, with a decimal point or, in half of Europe, a comma.

The separator and the decimal mark are those under which most of the first lines split into the same number of cells
with the most numbers among them. Lines that begin with `#`, `%` or `//` are comments; the last of them, or the line
above the first row of numbers, names the columns; a line of units below the names is added to them. pyarrow reads the
body where it is installed (several times as fast); numpy does otherwise. Cells that are no number are NaN, and counted.
An array in a cell is a column for each of its numbers. What `ros2 topic echo --csv` prints of joint states, without any
names of columns, is known by its shape.
A column of dates with times, or of times of the day, is whole nanoseconds. Dates begin with the year (ISO 8601, also
with `/` or `.`), or are day.month.year; of day/month and month/day a number above 12 decides, else it is not read.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Issue, Source
from spacearm_ident.recording.tables.table import FEWEST_ROWS, MAX_COLUMNS, Column, Table, require_room, since_1970

_HEAD_BYTES = 256 * 1024
_LOOKED_AT = 40  # lines from which separator and decimal mark are told
_LONGEST_LINE = 64 * 1024
_COMMENTS = ("#", "%", "//")
_COMMENT_MARK = re.compile(r"\s*(?:[#%]|//)*\s*")  # a single slash begins the name of a topic
_DATE_TIME = re.compile(
    r"((?:19|20)\d\d)([-/.])(\d?\d)\2(\d?\d)[T ]"
    r"(\d?\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(?:Z|UTC|([+-])(\d\d):?(\d\d)?)?"
)  # ISO 8601, and as pandas writes it; 64 bits of nanoseconds hold no year far beyond
_YEAR_LAST = re.compile(r"(\d?\d)([-/.])(\d?\d)\2((?:19|20)\d\d)([T ].*)")
_LIST = re.compile(r"\[[^\[\]]*\]|\([^()]*\)")
_TIME_OF_DAY = re.compile(r"(\d?\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?")
_DAY_NS = 86_400 * 10**9
_ARRAY = re.compile(r"[\[(]\s*(?:[-+.\d]|nan)[^\[\]()]*[\s,;][^\[\]()]*[\])]")  # of two numbers or more, as it seems
_ARRAY_CELL = re.compile(r"\s*(?:array\('d',\s*)?[\[(]([^\[\]()]*)[\])]\)?\s*")  # of lists, numpy and array.array
_NUMBERED = re.compile(r"(.+)\[(\d+)\]")
_SEPARATORS = (";", "\t", ",", "|", " ")  # " " stands for any run of white space
_MAX_PREAMBLE = 200
_WHOLE_DIGITS = 15  # digits a float64 keeps


@dataclass(frozen=True)
class Dialect:
    """How a text is laid out: separator, decimal mark, lines before the first row, and the columns' names."""

    separator: str
    decimal: str
    skipped: int
    names: tuple[str, ...]


def read_text_table(path: Path, source: Source) -> Table:
    """The columns of a text.

    Args:
        path: The file.
        source: What is known of it, for messages.

    Raises:
        UserError: Not text, or no table of numbers in it.
    """
    data = path.read_bytes()
    if _ARRAY.search(_decoded(data[:_HEAD_BYTES], path)):
        data = _with_arrays_apart(_decoded(data, path)).encode()
    dialect = find_dialect(_decoded(data[:_HEAD_BYTES], path), str(path))
    require_room(data.count(b"\n") * len(dialect.names) * 8, str(path))
    bad = 0
    columns = _with_pyarrow(data, dialect)
    body, issues = "", []
    starts: tuple[int, ...] = (0,)
    if columns is None:
        body, starts, repeated = _without_heads(_decoded(data, path), dialect)
        if repeated:
            text = f"{repeated} header lines within the table left out: logs one after the other, with pauses between"
            issues.append(Issue("repeated_header", text, repeated))
        columns, bad = _read_body(body, dialect, str(path))
    if len(columns[0]) < FEWEST_ROWS:
        raise UserError(f"{path}: fewer than two rows of numbers; is it a log of joint signals?")
    named = _named(dialect, columns, lambda: body or _decoded(data, path).split("\n", dialect.skipped)[-1])
    texts = _texts(dialect, columns, body)
    dates, lists = _dates(texts), _lists(texts)
    bad -= sum(dates[name][1] if name in dates else len(cells_of) for name, cells_of in texts.items())
    named |= {name: stamps for name, (stamps, _) in dates.items()}
    if not named:
        raise UserError(f"{path}: no column of numbers; is it a log of joint signals?")
    words = [name for name, cells_of in texts.items() if name not in {*dates, *lists} and any(cells_of)]
    words = [name for name in words if not _NUMBERED.fullmatch(name)]
    if words:
        issues.append(Issue("column_left_out", f"columns without a number left out: {', '.join(words)}", len(words)))
    if bad:
        issues.append(Issue("cell", f"{bad} cells that are no number taken as missing", bad))
    examples = {name: tuple(dict.fromkeys(filter(None, texts[name])))[:2] for name in words}
    return Table(named, (source,), starts, issues=tuple(issues), dates=frozenset(dates), lists=lists, texts=examples)


def _decoded(data: bytes, path: Path) -> str:
    """Text of a file: UTF-8 or UTF-16 by its mark, else UTF-8, else the code page of Western Windows."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data[: len(data) // 2 * 2].decode("utf-16", "replace").replace("\r\n", "\n")
    if b"\0" in data[:_HEAD_BYTES]:
        raise UserError(f"{path}: not a text file; give a log of numbers, or name its format by the suffix")
    text = data.decode("utf-8-sig", "surrogateescape")
    if any("\udc80" <= character <= "\udcff" for character in text[:_HEAD_BYTES]):
        text = data.decode("cp1252", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _with_arrays_apart(text: str) -> str:
    """A text with the arrays in its cells taken apart, a column `NAME[k]` for each number; as it is where none are.

    A row whose array is of another length than most has empty cells there.
    """
    best: list[list[str]] = []
    most = 0
    for separator in (",", ";", "\t", "|"):
        try:
            rows = list(csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True))
        except csv.Error:
            continue
        count = sum(_array(cell) is not None for row in rows[:_LOOKED_AT] for cell in row)
        if count > most:
            best, most = rows, count
    lengths: dict[int, Counter[int]] = {}
    for row in best:
        for place, cell in enumerate(row):
            if numbers := _array(cell):
                lengths.setdefault(place, Counter())[len(numbers)] += 1
    width = {place: of.most_common(1)[0][0] for place, of in lengths.items()}
    if not width:
        return text
    apart = io.StringIO()
    writer = csv.writer(apart, lineterminator="\n")
    first = next(k for k, row in enumerate(best) if any(_array(cell) for cell in row))
    names = best[first - 1] if first and len(best[first - 1]) == len(best[first]) else None
    for row in best:
        whole: list[str] = []
        for place, cell in enumerate(row):
            if place not in width or len(row) <= max(width):
                whole.append(cell)
            elif row == names:
                whole += [f"{cell}[{k}]" for k in range(width[place])]
            else:
                numbers = _array(cell) or []
                whole += numbers if len(numbers) == width[place] else [""] * width[place]
        writer.writerow(whole)
    return apart.getvalue()


def _array(cell: str) -> list[str] | None:
    """The numbers of a cell that is an array; None of any other."""
    match = _ARRAY_CELL.fullmatch(cell)
    numbers = re.split(r"[\s,;]+", match[1].strip()) if match else []
    return numbers if numbers and all(_number(number, ".") is not None for number in numbers) else None


def _echoed(row: list[str]) -> tuple[str, ...] | None:
    """The columns of `ros2 topic echo --csv` on joint states, by the cells of a row; None of any other row.

    They are the stamp in two, the frame, the joints' names, and of each signal that is not empty a number a joint.
    """
    is_number = [_number(cell, ".") is not None for cell in row]
    joints = next((k for k, number in enumerate(is_number[3:]) if number), 0)
    signals, rest = divmod(len(row) - 3 - joints, joints) if joints else (0, 1)
    if rest or signals not in (1, 2, 3) or is_number[:3] != [True, True, False] or not all(is_number[3 + joints :]):
        return None
    if not (row[0].isdecimal() and row[1].isdecimal()) or len({*row[3 : 3 + joints], ""}) <= joints:
        return None
    # Of two signals the second may be the velocity or the effort, which its name leaves open.
    named = {1: ("position",), 2: ("position", "signal"), 3: ("position", "velocity", "effort")}[signals]
    return ("sec", "nanosec", "frame_id", *(f"{what}[{k}]" for what in ("name", *named) for k in range(joints)))


def find_dialect(text: str, where: str) -> Dialect:
    """The layout of a text by its first lines.

    Args:
        text: The beginning of a file, some lines at least.
        where: The file, for messages.

    Raises:
        UserError: Under no separator do rows of numbers follow each other.
    """
    lines = text.split("\n")
    if any(len(line) > _LONGEST_LINE for line in lines[:_MAX_PREAMBLE]):
        raise UserError(f"{where}: a line of more than {_LONGEST_LINE} characters; is it a log of joint signals?")
    best: tuple[int, int, Dialect] | None = None
    for separator in _SEPARATORS:
        for decimal in (".", ",") if separator != "," else (".",):
            found = _as_laid_out(lines[:-1] if len(lines) > 1 else lines, separator, decimal)
            if found is not None and (best is None or found[:2] > best[:2]):
                best = found
    if best is None:
        raise UserError(f"{where}: no rows of numbers found; give CSV, TSV or columns with white space between")
    if len(best[2].names) > MAX_COLUMNS:
        raise UserError(f"{where}: {len(best[2].names)} columns, more than {MAX_COLUMNS}; is it a log?")
    return best[2]


def _as_laid_out(lines: list[str], separator: str, decimal: str) -> tuple[int, int, Dialect] | None:
    """Count of numbers, whether there are names, and the layout, for one separator and decimal mark."""
    first = next((k for k, line in enumerate(lines[:_MAX_PREAMBLE]) if _is_row(line, separator, decimal)), None)
    if first is None:
        return None
    width = len(cells(lines[first], separator))
    count = 0
    for line in lines[first : first + _LOOKED_AT]:
        row = cells(line, separator)
        if len(row) == width and not line.startswith(_COMMENTS):
            count += sum(_number(cell, decimal) is not None for cell in row)
    heads = [line for line in lines[:first] if line.strip()]
    rows = [[cell.strip() for cell in cells(_COMMENT_MARK.sub("", line, count=1), separator)] for line in heads[-2:]]
    names = _with_units(*rows) if len(rows) == 2 else rows[0] if rows else []
    named = len(names) == width
    if named:
        return count, True, Dialect(separator, decimal, first, _unique(names))
    echoed = _echoed(cells(lines[first], separator)) if separator == "," else None
    return count, False, Dialect(separator, decimal, first, echoed or tuple(f"column {k + 1}" for k in range(width)))


def _with_units(above: list[str], last: list[str]) -> list[str]:
    """The columns' names of the last two lines above the numbers: those of the last, or of both where it has the units.

    Names differ and units repeat: a line whose words repeat, below one of as many of which none does, has the units.
    """
    names, units = ([cell.strip('"') for cell in row] for row in (above, last))
    words = [unit for unit in units if unit]
    if len(names) != len(units) or not all(names) or len(set(names)) < len(names) or len(set(words)) == len(words):
        return last
    bare = [unit.strip("[]()") for unit in units]
    return [f"{name} [{unit}]" if unit.strip("-") else name for name, unit in zip(names, bare, strict=True)]


def cells(line: str, separator: str) -> list[str]:
    """The cells of a line; quotes hold a cell together.

    Args:
        line: One line of a table.
        separator: Between cells; empty: white space.
    """
    if separator == " ":
        return line.split()
    if '"' in line:
        try:
            return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:
            return []
    return line.split(separator) if line.strip() else []


def _is_row(line: str, separator: str, decimal: str) -> bool:
    """Whether most cells of a line are numbers, at least two, and the others empty or one word."""
    row = cells(line, separator)
    if line.startswith(_COMMENTS) or len(row) < 2:
        return False
    count = sum(_number(cell, decimal) is not None for cell in row)
    return count >= 2 and 2 * count > len(row)


def _number(cell: str, decimal: str) -> float | None:
    """The number in a cell; None where it is none. Underscores and hexadecimals are none."""
    text = cell.strip().strip('"')
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    if not text or "_" in text or len(text) > 60:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _unique(names: list[str]) -> tuple[str, ...]:
    """Names of which none is empty or there twice."""
    seen: set[str] = set()
    for number, name in enumerate(names, start=1):
        name = name.strip('"') or f"column {number}"
        seen_name = name if name not in seen else f"{name} ({number})"
        names[number - 1] = seen_name
        seen.add(seen_name)
    return tuple(names)


def _read_body(body: str, dialect: Dialect, where: str) -> tuple[list[FloatArray], int]:
    """The columns, and how many cells were no number."""
    width = len(dialect.names)
    quick = _with_numpy(body, dialect)
    if quick is not None and quick.shape[1] == width:
        return list(quick.T), 0
    rows, bad = [], 0
    for line in body.split("\n"):
        row = _row(line, dialect, width)
        if row is None:
            bad += width if line.strip() else 0
            continue
        values = [_number(cell, dialect.decimal) for cell in row[:width]]
        bad += sum(value is None for value in values)
        rows.append([np.nan if value is None else value for value in values])
    if not rows:
        raise UserError(f"{where}: no rows of {width} cells; is it a log of joint signals?")
    return list(np.array(rows, dtype=np.float64).T), bad


def _without_heads(text: str, dialect: Dialect) -> tuple[str, tuple[int, ...], int]:
    """The lines below the head without repetitions of it, the rows before which it stood, and how often it was there.

    Logs one after the other in a file (`cat`) have the lines above the numbers once more.
    """
    *head, body = text.split("\n", dialect.skipped)
    above = {line for line in head if line.strip()}
    lines = body.split("\n")
    last = next((line for line in reversed(head) if line.strip()), None)
    if last not in lines:
        return body, (0,), 0
    kept, starts, rows = [], [0], 0
    for line in lines:
        if line == last:
            starts.append(rows)
        elif line not in above:
            kept.append(line)
            rows += _row(line, dialect, len(dialect.names)) is not None
    return "\n".join(kept), tuple(start for start in dict.fromkeys(starts) if start < rows), len(starts) - 1


def _row(line: str, dialect: Dialect, width: int) -> list[str] | None:
    """The cells of a line; None where it is no row of the table."""
    row = cells(line, dialect.separator)
    return None if len(row) not in (width, width + 1) or line.startswith(_COMMENTS) else row


def _with_pyarrow(data: bytes, dialect: Dialect) -> list[FloatArray] | None:
    """The columns of the whole file at once; None where pyarrow is missing, or a row is unlike the others."""
    if dialect.separator == " " or data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return None
    if b"\r" in data[:_HEAD_BYTES] and b"\r\n" not in data[:_HEAD_BYTES]:
        return None  # lines that end as on old Macintoshes: they cannot be counted here
    try:
        import pyarrow
        from pyarrow import csv as arrow
    except ImportError:
        return None
    start = 0
    for _ in range(dialect.skipped):
        start = data.index(b"\n", start) + 1
    if b'"' in data[start : start + _HEAD_BYTES]:
        return None
    names = [str(k) for k in range(len(dialect.names))]
    try:
        table = arrow.read_csv(
            pyarrow.BufferReader(pyarrow.py_buffer(data)[start:]),
            read_options=arrow.ReadOptions(column_names=names),
            parse_options=arrow.ParseOptions(delimiter=dialect.separator, quote_char=False),
            convert_options=arrow.ConvertOptions(
                column_types=dict.fromkeys(names, pyarrow.float64()),
                decimal_point=dialect.decimal,
                null_values=[""],
                check_utf8=False,
            ),
        )
    except (pyarrow.ArrowException, OSError, ValueError):
        return None
    if not len(table) or any(column.null_count for column in table.columns):
        return None  # what is missing is counted by the slower way
    return [column.to_numpy() for column in table.columns]


def _with_numpy(body: str, dialect: Dialect) -> FloatArray | None:
    """As `_with_pyarrow`, (N, k), by numpy."""
    text = body.replace(",", ".") if dialect.decimal == "," else body
    separator = None if dialect.separator == " " else dialect.separator
    try:
        return np.loadtxt(io.StringIO(text), delimiter=separator, ndmin=2, comments=None, dtype=np.float64)
    except (ValueError, OverflowError):
        return None


def _named(dialect: Dialect, columns: list[FloatArray], body: Callable[[], str]) -> dict[str, Column]:
    """Columns by name; whole numbers that a float cannot keep, epoch nanoseconds, are read once more as integers."""
    named: dict[str, Column] = {}
    for k, (name, column) in enumerate(zip(dialect.names, columns, strict=True)):
        finite = np.isfinite(column)
        if not finite.any():
            continue
        named[name] = np.ascontiguousarray(column)
        if finite.all() and np.abs(column).min() > 10.0**_WHOLE_DIGITS:
            whole = _whole(body(), k, dialect, len(column))
            named[name] = named[name] if whole is None else whole
    return named


def _texts(dialect: Dialect, columns: list[FloatArray], body: str) -> dict[str, list[str]]:
    """The cells of the columns without a number."""
    places = [k for k, column in enumerate(columns) if not np.isfinite(column).any()]
    if not places or not body:
        return {}
    width = len(dialect.names)
    rows = [row for line in body.split("\n") if (row := _row(line, dialect, width)) is not None]
    return {dialect.names[k]: [row[k].strip().strip('"') for row in rows] for k in places}


def _dates(texts: dict[str, list[str]]) -> dict[str, tuple[NDArray[np.int64], int]]:
    """Columns of which most cells are dates with times, or times of the day: nanoseconds, and how many cells are such.

    A time of the day counts from 1970; where it falls by more than half a day, midnight has passed.
    """
    found = {}
    for name, cells_of in texts.items():
        instants = np.array([_date(cell) for cell in _year_first(cells_of)], dtype="datetime64[ns]")
        count = int((~np.isnat(instants)).sum())
        stamps = since_1970(instants) if 2 * count > len(cells_of) else None
        if stamps is not None and any(_TIME_OF_DAY.fullmatch(cell) for cell in cells_of):
            stamps += _DAY_NS * np.cumsum(np.diff(stamps, prepend=stamps[0]) < -_DAY_NS // 2)
        if stamps is not None:
            found[name] = (stamps, count)
    return found


def _lists(texts: dict[str, list[str]]) -> dict[str, tuple[tuple[str, ...], ...]]:
    """Columns whose cells are lists of words, `['a', 'b']` or `(a, b)`, or columns of one list: the different ones."""
    found = {}
    numbered: dict[str, list[list[str]]] = {}
    for name, cells_of in texts.items():
        if match := _NUMBERED.fullmatch(name):
            numbered.setdefault(match[1], []).append(cells_of)
    for name, columns in numbered.items():
        found[name] = tuple(sorted(set(zip(*columns, strict=True))))
    for name, cells_of in texts.items():
        different = sorted({cell for cell in cells_of if cell})
        if different and all(_LIST.fullmatch(cell) for cell in different):
            found[name] = tuple(tuple(re.findall(r"[^\s,;'\"]+", cell[1:-1])) for cell in different)
    return found


def _year_first(cells_of: list[str]) -> list[str]:
    """The cells of a column, dates that end with the year turned to begin with it.

    With dots the day comes first, by convention. With other marks both orders
    are in use: a number above 12 is a day; where no number is, or in both places, the cells stay as they are.
    """
    found = [match for cell in cells_of if (match := _YEAR_LAST.fullmatch(cell))]
    dotted = all(match[2] == "." for match in found)
    day_first, month_first = (any(int(match[place]) > 12 for match in found) for place in (1, 3))
    if not found or (day_first is month_first and not dotted):
        return cells_of
    order = r"\4-\3-\1\5" if dotted or day_first else r"\4-\1-\3\5"
    return [_YEAR_LAST.sub(order, cell) for cell in cells_of]


def order_of_date_is_open(cell: str) -> bool:
    """Whether a cell is a date with a time of which the day and the month may change places."""
    match = _YEAR_LAST.fullmatch(cell)
    return match is not None and match[2] != "." and not np.isnat(_date(_YEAR_LAST.sub(r"\4-\3-\1\5", cell)))


def _date(cell: str) -> np.datetime64:
    """A date with a time, in UTC where it names no zone; a time of the day on the first of 1970; else not a time."""
    if of_day := _TIME_OF_DAY.fullmatch(cell):
        cell = f"1970-01-01T{of_day[1]:0>2}:{of_day[2]}:{of_day[3]}.{of_day[4] or 0}"
    match = _DATE_TIME.fullmatch(cell)
    if match is None:
        return np.datetime64("NaT", "ns")
    year, _, month, day, clock, fraction, sign, hours, minutes = match.groups()
    try:
        instant = np.datetime64(f"{year}-{month:0>2}-{day:0>2}T{clock:0>8}.{fraction or 0}", "ns")
    except ValueError:  # a thirteenth month
        return np.datetime64("NaT", "ns")
    ahead = np.timedelta64(60 * int(hours or 0) + int(minutes or 0), "m")
    return instant + ahead if sign == "-" else instant - ahead


def _whole(body: str, place: int, dialect: Dialect, rows: int) -> NDArray[np.int64] | None:
    """One column as 64-bit integers; None where a cell is none."""
    try:
        texts = [cells(line, dialect.separator)[place] for line in body.split("\n") if line.strip()]
        return np.array([int(text) for text in texts], dtype=np.int64) if len(texts) == rows else None
    except (ValueError, IndexError, OverflowError):
        return None
