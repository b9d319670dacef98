"""Write the result folder of an adaptation: orbit.json, model.yaml (adapted), report.html."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..bayes.adaptation import Adaptation
from ..bayes.adaptation_causes import causes, reason
from ..documents import finite
from ..dynamics.model_file import save_model
from ..estimate.identified import Validation
from ..recording.recording import Recording
from ..results.provenance import provenance
from ..results.tables import fit_dict
from .folder import REPORT, replacing
from .orbit_html import MODELS, orbit_html, worst

SCHEMA = "spacearm_ident/orbit/1"
DOCUMENT = "orbit.json"
MODEL = "model.yaml"


def write_orbit(
    adaptation: Adaptation,
    validations: Sequence[Validation],
    orbit: tuple[Sequence[Recording], Sequence[Recording]],
    wanted_r: float,
    directory: Path,
    command: str | None = None,
) -> Path:
    """Write everything, or nothing; returns the page.

    Args:
        adaptation: The adapted model, and what changed.
        validations: One for each model, in the order of `orbit_html.MODELS`.
        orbit: Recordings adapted to, and held-out recordings, both in orbit.
        wanted_r: Correlation R that every joint must exceed.
        directory: Folder of the result; made where it does not exist. An earlier result in it is replaced.
        command: Command line that produces the result again; None: not stated.

    Raises:
        UserError: The folder cannot be written.
    """
    sources = provenance(*orbit, command)
    with replacing(directory) as part:
        document = {**orbit_dict(adaptation, validations, wanted_r), "provenance": sources}
        (part / DOCUMENT).write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        save_model(replace(adaptation.adapted, provenance=sources), part / MODEL)
        (part / REPORT).write_text(orbit_html(adaptation, validations, wanted_r, sources), encoding="utf-8")
    return directory / REPORT


def orbit_dict(adaptation: Adaptation, validations: Sequence[Validation], wanted_r: float) -> dict[str, Any]:
    """The content of `orbit.json`.

    Args:
        adaptation: The adapted model, and what changed.
        validations: One for each model, in the order of `orbit_html.MODELS`.
        wanted_r: Correlation R that every joint must exceed in the first and the last validation.
    """
    return {
        "schema": SCHEMA,
        "adapted": all(worst(validations[k])[1] > wanted_r for k in (0, -1)),
        "wanted_r": wanted_r,
        "causes": [{"cause": cause.name, "found": cause.found, "why": cause.why} for cause in causes(adaptation)],
        "changes": [
            {
                "name": change.symbol,
                "joint": change.joint,
                "unit": change.unit,
                "ground": change.before,
                "orbit": change.after,
                "orbit_error": change.after_error,
                "change": change.change,
                "change_error": change.change_error,
                "moved": change.moved,
                "why": reason(adaptation, change),
            }
            for change in adaptation.changes
        ],
        "gravity_m_s2": [
            {"value": finite(value), "standard_error": finite(error)}
            for value, error in zip(adaptation.gravity, adaptation.gravity_error)
        ],
        "validation": {
            name: {
                joint: {**fit_dict(figures.everything), "moving": fit_dict(figures.moving)}
                for joint, figures in validation.joints.items()
            }
            for name, validation in zip(MODELS, validations)
        },
    }
