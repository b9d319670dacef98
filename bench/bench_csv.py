"""How long reading a million rows of CSV takes next to pyarrow alone: `python bench/bench_csv.py [rows]`."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pyarrow import csv

from spacearm_ident.recording.tables import read_table

REPEATS = 3


def write(path: Path, rows: int) -> None:
    """A time, six positions and six torques, six digits after the point."""
    values = np.random.default_rng(0).standard_normal((rows, 13))
    values[:, 0] = np.arange(rows) * 1e-3
    names = ["t", *(f"q{k}" for k in range(1, 7)), *(f"tau{k}" for k in range(1, 7))]
    np.savetxt(path, values, fmt="%.6f", delimiter=",", header=",".join(names), comments="")


def fastest(reads: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Name -> seconds of the fastest of `REPEATS`, taken in turn."""
    best = dict.fromkeys(reads, float("inf"))
    for _ in range(REPEATS):
        for name, read in reads.items():
            begin = time.perf_counter()
            read()
            best[name] = min(best[name], time.perf_counter() - begin)
    return best


def main() -> None:
    """Write, read, print."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write(path, rows)
        best = fastest({"pyarrow alone": lambda: csv.read_csv(path), "read_table": lambda: read_table(path)})
    for name, seconds in best.items():
        print(f"{name:14} {seconds:6.2f} s  {seconds / best['pyarrow alone']:.2f} times pyarrow")


if __name__ == "__main__":
    main()
