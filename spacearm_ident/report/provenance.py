"""Where a result comes from: the files with their checksums, the versions, the command; kept in `model.yaml`."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from .. import __version__
from ..recording.recording import Recording

FITTED = "fitted_on"
VALIDATED = "validated_on"
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
    return {
        **({"command": command} if command else {}),
        FITTED: [asdict(source) for recording in fitted for source in recording.sources],
        VALIDATED: [asdict(source) for recording in validated for source in recording.sources],
        "versions": versions(),
    }


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
    """Paths under `FITTED` or `VALIDATED`; empty where the provenance does not say."""
    sources = (known or {}).get(which) or []
    return [str(source["path"]) for source in sources if isinstance(source, Mapping) and "path" in source]
