"""`read_table`: the reader of a log's format, chosen by the name and by what the file begins with."""

from __future__ import annotations

import stat
from collections.abc import Callable
from pathlib import Path

from spacearm_ident.documents import file_sha256
from spacearm_ident.errors import UserError
from spacearm_ident.recording.recording import Source
from spacearm_ident.recording.tables.arrays import read_mat, read_npz
from spacearm_ident.recording.tables.hdf5 import read_hdf5
from spacearm_ident.recording.tables.parquet import LEROBOT_INFO, read_lerobot, read_parquet
from spacearm_ident.recording.tables.table import MAX_TABLE_BYTES, Table
from spacearm_ident.recording.tables.text import read_text_table

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".log")
READERS: dict[str, Callable[[Path, Source], Table]] = {
    **dict.fromkeys(TEXT_SUFFIXES, read_text_table),
    ".npz": read_npz,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".parquet": read_parquet,
}
"""Suffix of a log -> its reader."""


def is_log(path: Path) -> bool:
    """Whether a path is a log by its name: a file of a suffix in `READERS`, or a folder that is a LeRobot dataset."""
    return path.suffix.lower() in READERS or (path / LEROBOT_INFO).is_file()


def read_table(path: Path) -> Table:
    """The columns of a log.

    Raises:
        UserError: No such file, a format that is not read, damaged, too large, or a package for it is missing.
    """
    if (path / LEROBOT_INFO).is_file():
        return read_lerobot(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise UserError(f"{path}: logs are read as {', '.join(READERS)} or LeRobot folders; convert it to one of them")
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise UserError(f"{path}: not a regular file; name a log")
        if found.st_size > MAX_TABLE_BYTES:
            raise UserError(f"{path}: larger than {MAX_TABLE_BYTES >> 30} GiB; split it")
        if found.st_size == 0:
            raise UserError(f"{path}: the file is empty; log again or give another file")
        source = Source(str(path), found.st_size, file_sha256(path))
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({error}); check the path and its permissions") from error
    return reader(path, source)
