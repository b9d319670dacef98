"""The result folder of contracts.md §3: written whole or not at all, and its report made again from it alone."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from ..errors import UserError
from ..identification.identified import Identified, Validation
from .covariance_file import covariance_dict
from .html import report_html
from .store import FIGURES, Result, load_result, save_result
from .tables import base_parameters_csv, parameters_csv, validation_dict
from .urdf import identified_urdf

REPORT = "report.html"


def write_result(identified: Identified, validation: Validation, directory: Path) -> Path:
    """Write a result folder; an older result in it is replaced, anything else in it is left alone.

    Where the data came from is `identified.model.provenance`, as `report.provenance.provenance` makes it.

    Args:
        identified: The identification.
        validation: How well it predicts.
        directory: Made where it does not exist.

    Returns:
        The report, for opening.

    Raises:
        UserError: The folder cannot be written, or the arm's URDF cannot carry the result.
    """
    result = Result(identified, validation, datetime.now(UTC).isoformat(timespec="seconds"))
    with replacing(directory) as staging:
        save_result(result, staging)
        (staging / "parameters.csv").write_text(parameters_csv(identified), encoding="utf-8")
        (staging / "base_parameters.csv").write_text(base_parameters_csv(identified), encoding="utf-8")
        (staging / "identified.urdf").write_text(identified_urdf(identified.model), encoding="utf-8")
        spread = json.dumps(covariance_dict(identified), indent=1, allow_nan=False)
        (staging / "covariance.json").write_text(spread + "\n", encoding="utf-8")
        figures = json.dumps(validation_dict(identified, validation), indent=2, allow_nan=False)
        (staging / "validation.json").write_text(figures + "\n", encoding="utf-8")
        (staging / REPORT).write_text(report_html(result), encoding="utf-8")
    return directory / REPORT


def rewrite_report(directory: Path) -> Path:
    """Make `report.html` of a result folder again (the body of `spacearm report DIR`).

    Raises:
        UserError: It is not a result folder, or not a whole one.
    """
    result = load_result(directory)
    with replacing(directory) as staging:
        (staging / REPORT).write_text(report_html(result), encoding="utf-8")
    return directory / REPORT


@contextmanager
def replacing(directory: Path, optional: Sequence[str] = ()) -> Iterator[Path]:
    """A folder to write into, whose files replace those of `directory` once the block has ended well.

    Of the `optional` ones, those that are not written this time are removed: no two results are mixed.

    It lies inside `directory`, which may be a mount point: files then move without being copied. An error or a
    crash before the end changes nothing. Moving takes one rename a file; the file that makes the folder a result
    goes first and comes back last, so that not even a power loss between two renames passes for a result.
    """
    made = not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".writing-", dir=directory) as name:
            staging = Path(name)
            yield staging
            names = sorted((path.name for path in staging.iterdir()), key=lambda name: name == FIGURES)
            for name in names:
                if (directory / name).is_dir():
                    raise UserError(f"{directory / name} is a folder: move it away, or choose another --out")
            if FIGURES in names:
                (directory / FIGURES).unlink(missing_ok=True)
            for name in set(optional).difference(names):
                (directory / name).unlink(missing_ok=True)
            for name in names:
                os.replace(staging / name, directory / name)
    except OSError as error:
        raise UserError(f"cannot write {directory}: {error.strerror or error}: choose another --out") from error
    finally:
        if made and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()
