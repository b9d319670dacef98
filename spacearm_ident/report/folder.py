"""The result folder of contracts.md §3: written whole or not at all, and its report made again from it alone."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import UserError
from ..estimate.identified import Identified, Validation
from ..mismatch.document import EXTENDED_MODEL, NEXT_RUN
from ..results.covariance_file import covariance_dict
from ..results.recorded_runs import RecordedRun
from ..results.store import ARRAYS, FIGURES, MODEL, VALIDATION, Result, load_result, save_result
from ..results.tables import base_parameters_csv, parameters_csv, torque_csv, validation_dict
from ..results.urdf import identified_urdf
from .html import report_html

REPORT = "report.html"
TORQUE = "torque.csv"
MARKERS = (FIGURES, "mismatch.json", "temperature.json")
"""The file that makes a folder the result of `identify`, `mismatch` and `calibrate-temperature`."""
RESULT_FILES = frozenset(
    {
        *MARKERS,
        *(MODEL, ARRAYS, REPORT, "parameters.csv", "base_parameters.csv", "identified.urdf", "covariance.json"),
        *(VALIDATION, TORQUE, EXTENDED_MODEL, NEXT_RUN),
        *("mended.xml", "mended.urdf", "mended.sdf"),
    }
)
"""Every file of any result."""
_STAGING = ".writing-"


def write_result(
    identified: Identified,
    validation: Validation,
    directory: Path,
    further: Callable[[], Mapping[str, Any]] = dict,
    runs: Sequence[RecordedRun] = (),
    unfit: Callable[[], tuple[str, ...]] = tuple,
) -> Path:
    """Write a result folder; an older result in it is replaced, of whatever command; anything else stays.

    Where the data came from is `identified.model.provenance`, as `results.provenance.provenance` makes it.

    Args:
        identified: The identification.
        validation: How well it predicts.
        directory: Made where it does not exist.
        further: Gives further keys of `validation.json`, as plain data; asked when the report, which takes longest,
            is there.
        runs: What was recorded, for the page.
        unfit: Gives `ConventionReport.unfit`; asked when the figures of the page, which take longest, are drawn.

    Returns:
        The report, for opening.

    Raises:
        UserError: The folder cannot be written, or the arm's URDF cannot carry the result.
    """
    result = Result(identified, validation, datetime.now(UTC).isoformat(timespec="seconds"), tuple(runs), unfit)
    with replacing(directory) as staging:
        (staging / REPORT).write_text(report_html(result), encoding="utf-8")
        save_result(result, staging)
        (staging / "parameters.csv").write_text(parameters_csv(identified), encoding="utf-8")
        (staging / "base_parameters.csv").write_text(base_parameters_csv(identified), encoding="utf-8")
        (staging / TORQUE).write_text(torque_csv(identified, validation), encoding="utf-8")
        (staging / "identified.urdf").write_text(identified_urdf(identified.model), encoding="utf-8")
        spread = json.dumps(covariance_dict(identified), indent=1, allow_nan=False)
        (staging / "covariance.json").write_text(spread + "\n", encoding="utf-8")
        judged = validation_dict(identified, validation, result.unfit)
        figures = json.dumps({**judged, **further()}, indent=2, allow_nan=False)
        (staging / VALIDATION).write_text(figures + "\n", encoding="utf-8")
    return directory / REPORT


def rewrite_report(directory: Path) -> Path:
    """Make `report.html` of a result folder again (the body of `spacearm report DIR`).

    Raises:
        UserError: It is not a result folder, or not a whole one.
    """
    result = load_result(directory)
    with replacing(directory, marker=None) as staging:
        (staging / REPORT).write_text(report_html(result), encoding="utf-8")
    return directory / REPORT


@contextmanager
def replacing(directory: Path, marker: str | None = FIGURES) -> Iterator[Path]:
    """A folder to write into, whose files replace those of `directory` once the block has ended well.

    A folder holds one result: every file of `RESULT_FILES` that is not written this time is removed, of whatever
    command it was. Anything else stays.

    It lies inside `directory`, which may be a mount point: files then move without being copied. An error or a
    crash before the end changes nothing. Moving takes one rename a file; the files that make the folder a result
    go first and the new one comes last, so that not even a power loss between two renames passes for a result.
    Whoever writes into the same folder meanwhile waits; what a killed process left behind is removed.

    Args:
        directory: Made where it does not exist.
        marker: The file that makes the folder a result; None: only the files written are replaced, none removed.

    Raises:
        UserError: The folder cannot be written.
    """
    made = False
    try:
        made = not directory.exists()
        directory.mkdir(parents=True, exist_ok=True)
        with _alone(directory), TemporaryDirectory(prefix=_STAGING, dir=directory) as name:
            staging = Path(name)
            yield staging
            _commit(staging, directory, marker)
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror or error}: choose another --out") from error
    finally:
        if made and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()


def _commit(staging: Path, directory: Path, marker: str | None) -> None:
    names = sorted((path.name for path in staging.iterdir()), key=lambda name: name == marker)
    for name in names:
        if (directory / name).is_dir():
            raise UserError(f"{directory / name} is a folder: move it away, or choose another --out")
    if marker is not None:
        for name in sorted(RESULT_FILES, key=lambda name: name not in MARKERS):
            if name in MARKERS or name not in names:
                (directory / name).unlink(missing_ok=True)
    for name in names:
        os.replace(staging / name, directory / name)


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Hold the folder's lock, and clear away what a process that held it before could not."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
            for left in directory.glob(f"{_STAGING}*"):
                shutil.rmtree(left, ignore_errors=True)
        yield
    finally:
        os.close(handle)


def refuse_to_replace(source: Path | None, directory: Path) -> None:
    """Refuse a result folder that holds a file the result is made from: it would be replaced.

    Args:
        source: A file that is read; None: none.
        directory: Result folder.

    Raises:
        UserError: It does.
    """
    if source is not None and source.name in RESULT_FILES and source.resolve().parent == directory.resolve():
        raise UserError(f"{source} is part of the result in {directory}, which would be replaced: choose another --out")
