"""Where a result comes from: the files with their checksums, the versions, the command; kept in `model.yaml`."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from .. import __version__
from ..recording.intake import EPOCH_NS
from ..recording.recording import Recording

FITTED = "fitted_on"
VALIDATED = "validated_on"
RECORDED = "recorded"
EPOCH = datetime.fromtimestamp(EPOCH_NS / 1e9, UTC)
"""Stamps before count from the start of their clock: no date of recording."""
AHEAD = timedelta(hours=14)
"""How far a clock that is right may be ahead of UTC: the largest offset of a time zone, where it shows local time."""
OPTIONS = "options"
PACKAGES = ("numpy", "scipy", "pin", "clarabel")


def provenance(
    fitted: Iterable[Recording], validated: Iterable[Recording] = (), command: str | None = None
) -> dict[str, Any]:
    """What `IdentifiedModel.provenance` holds; plain data, the same for the same inputs and versions.

    Args:
        fitted: Recordings the model was fitted to.
        validated: Recordings it was validated on (the fitted ones again for a hold-out in time).
        command: How to do it again.
    """
    fitted = list(fitted)
    return {
        **({"command": command} if command else {}),
        FITTED: [asdict(source) for recording in fitted for source in recording.sources],
        RECORDED: [_run(recording) for recording in fitted],
        VALIDATED: [asdict(source) for recording in validated for source in recording.sources],
        "versions": versions(),
    }


def _run(recording: Recording) -> dict[str, Any]:
    """When a run was recorded, for how long, and how warm its joints were on average."""
    start = datetime.fromtimestamp(recording.start_ns // 10**9, UTC)
    warm = {joint: float(np.mean(series.values)) for joint, series in recording.temperatures.items()}
    return {
        "start": start.isoformat(),
        "duration_s": float(recording.time[-1]),
        **({"temperature_C": warm} if warm else {}),
    }


@dataclass(frozen=True)
class Moment:
    """When, and how warm, the runs were that a model was fitted to.

    Attributes:
        start: Of the first of them by its clock, UTC.
        temperature: Joint -> mean temperature over all of them that recorded it, degrees Celsius.
        known: When the result was written, which no recording of it can be later than; None: not known.
    """

    start: datetime
    temperature: dict[str, float]
    known: datetime | None = None

    @property
    def wrong_clock(self) -> str:
        """Why the clock gives no date, a clause; empty where it does."""
        if self.start < EPOCH:
            return f"its clock says {self.start.year}: not set, or counting from zero"
        if self.known is not None and self.start > self.known + AHEAD:
            return f"its clock says {self.start.date().isoformat()}: after it was identified"
        return ""

    @property
    def date(self) -> datetime | None:
        """The start; None where its clock gives no date."""
        return None if self.wrong_clock else self.start


def moment(known: Mapping[str, Any] | None, written: str = "") -> Moment | None:
    """Of a provenance; None where it does not say (results of earlier versions, files of others).

    Args:
        known: `provenance` of a model; None: it has none.
        written: When the result was, ISO 8601; empty: not known.
    """
    try:
        by = datetime.fromisoformat(written).astimezone(UTC) if written else None
        runs = list((known or {})[RECORDED])
        start = min(datetime.fromisoformat(run["start"]).astimezone(UTC) for run in runs)
        warm: dict[str, list[tuple[float, float]]] = {}
        for run in runs:
            for joint, value in run.get("temperature_C", {}).items():
                warm.setdefault(str(joint), []).append((float(value), float(run["duration_s"])))
        means = {joint: sum(v * s for v, s in pairs) / sum(s for _, s in pairs) for joint, pairs in warm.items()}
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError):
        return None
    return Moment(start, {joint: value for joint, value in means.items() if math.isfinite(value)}, by)


def versions() -> dict[str, str]:
    """Versions of this package and of what its numbers depend on."""
    return {"spacearm_ident": __version__, "python": platform.python_version(), **dict(_versions())}


def _versions() -> Iterable[tuple[str, str]]:
    for package in PACKAGES:
        try:
            yield package, version(package)
        except PackageNotFoundError:  # ROS machines have Pinocchio by another way.
            continue


def source_paths(known: Mapping[str, Any] | None, which: str) -> list[str]:
    """Paths under `FITTED` or `VALIDATED`; empty where the provenance does not say.

    Args:
        known: `provenance` of a model; None: it has none.
        which: `FITTED` or `VALIDATED`.
    """
    sources = (known or {}).get(which) or []
    return [str(source["path"]) for source in sources if isinstance(source, Mapping) and "path" in source]
