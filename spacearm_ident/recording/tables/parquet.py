"""Logs in Parquet, and LeRobot datasets: a folder with `meta/info.json` and Parquet files of episodes.

A column of lists of numbers, as LeRobot keeps a robot's state, becomes a column an element, under the names that the
dataset gives its elements. Time within an episode is frame_index / fps: the dataset's own `timestamp` has the seven
digits of a float32. Episodes follow each other with a pause between, so that nothing differentiates across them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spacearm_ident.documents import file_sha256, read_text
from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Issue, Source
from spacearm_ident.recording.tables.optional import optional
from spacearm_ident.recording.tables.table import MAX_COLUMNS, Column, Table, numbers, require_room, table_of

LEROBOT_INFO = "meta/info.json"
EPISODE, FRAME, TIME = "episode_index", "frame_index", "timestamp"
_BOOKKEEPING = ("index", "task_index")


def read_parquet(path: Path, source: Source) -> Table:
    """The numeric columns of a Parquet file, those of lists element by element.

    Args:
        path: A single Parquet file; the folder of a data set is for `read_lerobot`.
        source: Path, size and checksum, for the table.

    Raises:
        UserError: pyarrow is missing; or damaged, too large, without numeric columns.
    """
    return table_of(_arrays(path), (source,), str(path))


def _arrays(path: Path) -> dict[str, Any]:
    parquet = optional("pyarrow.parquet", "pyarrow", "reading Parquet")
    try:
        with parquet.ParquetFile(path) as file:
            rows, columns = file.metadata.num_rows, file.metadata.num_columns
            if columns > MAX_COLUMNS:
                raise UserError(f"{path}: {columns} columns, more than {MAX_COLUMNS}; is it a log of joint signals?")
            require_room(rows * columns * 8, str(path))
            table = file.read(use_threads=False)
        return {
            name: array
            for name, column in zip(table.column_names, table.columns, strict=True)
            if (array := _array(column)) is not None
        }
    except UserError:
        raise
    except Exception as error:  # pyarrow raises its own, and what its C++ came across
        raise UserError(
            f"{path}: cannot be read as Parquet ({type(error).__name__}: {error}); save it again"
        ) from error


def _array(column: Any) -> Any:
    """(N,) or (N, k) of a column of numbers, of dates, of lists of one length, or (N,) lists of words; else None."""
    types = optional("pyarrow.types", "pyarrow", "reading Parquet")
    kind = column.type
    if types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind) or types.is_timestamp(kind):
        return column.to_numpy()
    if not (types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind)) or column.null_count:
        return None
    if types.is_string(kind.value_type) or types.is_large_string(kind.value_type):
        words = np.empty(len(column), dtype=object)
        words[:] = [tuple(row) for row in column.to_pylist()]
        return words
    if not (types.is_floating(kind.value_type) or types.is_integer(kind.value_type)) or not len(column):
        return None
    values = np.concatenate([np.asarray(chunk.flatten().to_numpy(zero_copy_only=False)) for chunk in column.chunks])
    return values.reshape(len(column), -1) if values.size and values.size % len(column) == 0 else None


def read_lerobot(folder: Path) -> Table:
    """The episodes of a LeRobot dataset (versions 2 and 3), one after the other.

    Raises:
        UserError: pyarrow is missing; or the metadata or a file of it cannot be used.
    """
    info = _info(folder)
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise UserError(f"{folder}: a LeRobot dataset without data/*.parquet; fetch its data")
    sources, parts = [], []
    room = 0
    for file in files:
        parts.append(_arrays(file))
        room += sum(np.asarray(array).nbytes for array in parts[-1].values())
        require_room(room, str(folder))
        sources.append(Source(str(file), file.stat().st_size, file_sha256(file)))
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    try:
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in shared}
    except ValueError as error:
        raise UserError(f"{folder}: its files have columns of different shapes; name one file ({error})") from error
    return _episodes(folder, arrays, tuple(sources), info)


def _info(folder: Path) -> Mapping[str, Any]:
    try:
        info = json.loads(read_text(folder / LEROBOT_INFO, "the dataset's"))
        fps = float(info["fps"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(f"{folder / LEROBOT_INFO}: no usable JSON with 'fps' ({error}): mend it") from error
    if not 0.0 < fps < 1e6:
        raise UserError(f"{folder / LEROBOT_INFO}: fps is {fps:g}; give frames a second")
    return dict(info) | {"fps": fps}


def _episodes(folder: Path, arrays: dict[str, Any], sources: tuple[Source, ...], info: Mapping[str, Any]) -> Table:
    rows = len(next(iter(arrays.values()), ()))
    for name in (EPISODE, FRAME):
        if np.ndim(arrays.get(name, 0)) != 1:
            raise UserError(f"{folder}: no column {name}; is it a LeRobot dataset?")
    order = np.lexsort((arrays[FRAME], arrays[EPISODE]))
    episode, frame = (np.asarray(arrays[name], dtype=np.float64)[order] for name in (EPISODE, FRAME))
    starts = np.flatnonzero(np.diff(episode, prepend=np.nan) != 0)
    fps = float(info["fps"])
    time = frame / fps
    for before, start in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        time[start:] += time[start - 1] - time[start] + max(1.0, 100.0 / fps) if before < start else 0.0
    named: dict[str, Column] = {TIME: time}
    for name, array in arrays.items():
        if name not in (TIME, EPISODE, FRAME, *_BOOKKEEPING) and np.asarray(array).dtype.kind in "fiub":
            named |= _elements(name, np.asarray(array)[order], info)
    issues = []
    if len(starts) > 1:
        issues.append(Issue("episodes", f"{len(starts)} episodes one after the other, with pauses between"))
    if len(named) < 2 or rows < 2 or not np.isfinite(time).all():
        raise UserError(f"{folder}: no numeric columns of two rows or more; is it a log of joint signals?")
    return Table(named, sources, tuple(starts.tolist()), fps, tuple(issues))


def _elements(name: str, array: Any, info: Mapping[str, Any]) -> dict[str, Column]:
    """The columns of a feature under the names that the dataset gives its elements."""
    if array.ndim == 1:
        return {name: numbers(array)}
    features = info.get("features")
    feature = features.get(name) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):  # {"motors": [...]}
        names = next((value for value in names.values() if isinstance(value, list)), None)
    if not isinstance(names, list) or len(names) != array.shape[1] or len(set(map(str, names))) < len(names):
        names = [f"[{k}]" for k in range(array.shape[1])]
    return {f"{name}.{element}".replace(".[", "["): numbers(array[:, k]) for k, element in enumerate(names)}
