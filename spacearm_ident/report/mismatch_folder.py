"""Write the result folder of `spacearm mismatch`: mismatch.json, extended_model.yaml, report.html."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from ..dynamics.arm import Arm
from ..dynamics.model_file import save_model
from ..excitation.trajectory import Trajectory
from ..excitation.trajectory_file import save_trajectory
from ..mismatch.document import EXTENDED_MODEL, NEXT_RUN, to_document
from ..mismatch.finding import Explanation
from ..mismatch.run_set import RunSet
from ..results.provenance import FITTED, provenance
from .folder import REPORT, replacing
from .mismatch_html import mismatch_html

DOCUMENT = "mismatch.json"


def write_mismatch(
    explanation: Explanation,
    arm: Arm,
    runs: RunSet,
    planned: Trajectory | None,
    directory: Path,
    command: str | None = None,
) -> Path:
    """Write everything, or nothing; returns the page.

    Args:
        explanation: The analysis.
        arm: The arm that was analysed.
        runs: What was compared with what, for the provenance.
        planned: The experiment that would tell; None: none is proposed.
        directory: Folder of the result; made where it does not exist. An earlier result in it is replaced.
        command: Command line that produces the result again; None: not stated.

    Raises:
        UserError: The folder cannot be written.
    """
    sources = {**provenance(runs.field, runs.validation, command), "reference": provenance(runs.healthy, ())[FITTED]}
    page = mismatch_html(explanation, arm, sources)
    with replacing(directory, DOCUMENT) as part:
        document = {**to_document(explanation), "provenance": sources}
        (part / DOCUMENT).write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        if explanation.model is not None:
            save_model(replace(explanation.model, provenance=sources), part / EXTENDED_MODEL)
        if planned is not None:
            save_trajectory(planned, part / NEXT_RUN, _origin(explanation))
        (part / REPORT).write_text(page, encoding="utf-8")
    return directory / REPORT


def _origin(explanation: Explanation) -> list[str]:
    """Lines at the head of the next experiment's file."""
    return [
        f"next experiment of spacearm mismatch: {explanation.next_experiment}",
        *([explanation.next_motion] if explanation.next_motion else []),
        *explanation.next_cautions,
        "positions were recorded joint by joint, not in every combination: watch the first run, at low speed",
    ]
