"""Logs in HDF5, and MATLAB's version 7.3, which is HDF5: every numeric dataset, by its path in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Source
from spacearm_ident.recording.tables.optional import optional
from spacearm_ident.recording.tables.table import MAX_COLUMNS, Table, require_room, table_of

_DEEPEST = 16


def read_hdf5(path: Path, source: Source) -> Table:
    """The numeric datasets of an HDF5 file.

    Links to other files, and data kept in other files, are left alone: a log is one file.

    Args:
        path: HDF5 file, or MATLAB's version 7.3.
        source: Path, size and checksum, for the table.

    Raises:
        UserError: h5py is missing; or damaged, too large, without numeric datasets.
    """
    h5py = optional("h5py", "h5py", "reading HDF5")
    arrays: dict[str, Any] = {}
    try:
        with h5py.File(path, "r") as file:
            _gather(h5py, file, "", _DEEPEST, arrays, str(path))
    except UserError:
        raise
    except Exception as error:  # h5py raises whatever its C library came across, of a dozen classes
        raise UserError(f"{path}: cannot be read as HDF5 ({type(error).__name__}: {error}); save it again") from error
    return table_of(arrays, (source,), str(path))


def _gather(h5py: Any, group: Any, prefix: str, depth: int, arrays: dict[str, Any], where: str) -> None:
    """Read the numeric datasets of a group, and of the groups in it."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group.get(name)
        if isinstance(item, h5py.Group) and depth and not str(name).startswith("#"):
            _gather(h5py, item, f"{prefix}{name}.", depth - 1, arrays, where)
        elif isinstance(item, h5py.Dataset) and _numeric(item) and len(arrays) < MAX_COLUMNS:
            require_room(sum(array.nbytes for array in arrays.values()) + item.size * 8, where)
            arrays[f"{prefix}{name}"] = item[()]


def _numeric(item: Any) -> bool:
    return item.dtype.kind in "fiub" and item.ndim in (1, 2) and not item.external and not item.is_virtual
