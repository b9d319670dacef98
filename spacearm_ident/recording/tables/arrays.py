"""Logs of named arrays: `.npz` of numpy and `.mat` of MATLAB.

Both are archives of compressed parts, so what they hold can be a thousand times what they weigh: the sizes are looked
at before anything is kept, and nothing pickled is loaded.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Source
from spacearm_ident.recording.tables.hdf5 import read_hdf5
from spacearm_ident.recording.tables.table import Table, require_room, table_of

_MAT_HEADER = 128
_MAT_COMPRESSED = 15
_HDF5_MAGIC = b"\x89HDF"
_PIECE = 2**20
_DEEPEST = 8  # structs of a .mat that are looked into
_DAMAGED: tuple[type[Exception], ...] = (
    *(OSError, EOFError, ValueError, KeyError, TypeError, IndexError, AttributeError, SyntaxError),
    *(ArithmeticError, MemoryError, RuntimeError, zlib.error, zipfile.BadZipFile, struct.error, MatReadError),
)
"""What the readers of numpy and scipy raise on damaged files."""


def read_npz(path: Path, source: Source) -> Table:
    """The arrays of an `.npz`.

    Args:
        path: Archive; the sizes that it states are checked before it is loaded.
        source: Path, size and checksum, for the table.

    Raises:
        UserError: Damaged, too large, or without numeric arrays.
    """
    try:
        arrays = _npz_arrays(path)
    except _DAMAGED as error:
        raise _damaged(path, ".npz", error) from error
    return table_of(arrays, (source,), str(path))


def _npz_arrays(path: Path) -> dict[str, Any]:
    with zipfile.ZipFile(path) as archive:
        require_room(sum(item.file_size for item in archive.infolist()), str(path))
        for item in archive.infolist():
            with archive.open(item) as member:
                _require_honest(member, item.file_size, str(path))
    with np.load(path, allow_pickle=False) as loaded:
        return {name: loaded[name] for name in loaded.files if loaded[name].dtype.kind in "fiubMU"}


def _require_honest(member: Any, size: int, where: str) -> None:
    """Refuse an array whose header announces more than the archive holds of it: numpy would make room for it first."""
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = read(member)
    announced = kind.itemsize
    for length in shape:
        announced *= int(length)
    if announced > size:
        raise UserError(f"{where}: an array announces {announced} bytes, {size} are there; is the file damaged?")


def read_mat(path: Path, source: Source) -> Table:
    """The numeric arrays of a `.mat`, those in structs by `struct.field`; version 7.3 is HDF5.

    Args:
        path: File of level 5 or version 7.3, told apart by its header.
        source: Path, size and checksum, for the table.

    Raises:
        UserError: Damaged, too large, or without numeric arrays.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_MAT_HEADER)
        if head.startswith(_HDF5_MAGIC) or b"MATLAB 7.3" in head[:116]:
            return read_hdf5(path, source)
        require_room(_inflated(path, head), str(path))
        arrays = loadmat(path, simplify_cells=True)
    except _DAMAGED as error:
        raise _damaged(path, ".mat", error) from error
    named = {name: value for name, value in arrays.items() if not name.startswith("__")}
    return table_of(dict(_flat(named, "", _DEEPEST)), (source,), str(path))


def _flat(values: Mapping[str, Any], prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            if depth:
                yield from _flat(value, f"{prefix}{name}.", depth - 1)
        elif isinstance(value, np.ndarray):
            yield f"{prefix}{name}", value


def _inflated(path: Path, head: bytes) -> int:
    """Bytes that the elements of a level 5 file hold once inflated; stops counting where they are too many."""
    data = path.read_bytes()
    order = ">" if head[126:128] == b"MI" else "<"
    position, total = _MAT_HEADER, 0
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        position += 8
        total += size if kind != _MAT_COMPRESSED else _inflated_element(data[position : position + size], str(path))
        require_room(total, str(path))
        position += size
    return total


def _inflated_element(data: bytes, where: str) -> int:
    inflate = zlib.decompressobj()
    total = 0
    while data and not inflate.eof:
        total += len(inflate.decompress(data, _PIECE))
        data = inflate.unconsumed_tail
        require_room(total, where)
    return total


def _damaged(path: Path, what: str, error: BaseException) -> UserError:
    return UserError(f"{path}: cannot be read as {what} ({type(error).__name__}: {error}); save it again")
