"""Logs that are no bags: text, `.npz`, `.mat`, HDF5, Parquet and LeRobot datasets, as named columns (`Table`)."""

from spacearm_ident.recording.tables.read import is_log, read_table
from spacearm_ident.recording.tables.table import Column, Table

__all__ = ["Column", "Table", "is_log", "read_table"]
