"""Write the result folder of `spacearm mismatch --simulation`: mismatch.json, models, the mended file, report.html."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..dynamics.model_file import save_model
from ..layers.comparison import Comparison
from ..layers.document import comparison_document
from ..layers.item import Mended
from ..mismatch.document import EXTENDED_MODEL
from ..recording.recording import Recording
from ..results.provenance import provenance
from ..simulations import Simulation
from .folder import REPORT, replacing
from .layers_html import comparison_html
from .mismatch_folder import DOCUMENT


def write_comparison(
    comparison: Comparison,
    simulation: Simulation,
    mended: Mended | None,
    fitted: Sequence[Recording],
    held: Sequence[Recording],
    directory: Path,
    command: str | None = None,
) -> Path:
    """Write everything, or nothing; returns the page.

    Args:
        comparison: The comparison.
        simulation: The simulation that was compared.
        mended: Its file with corrected values; None: none is written.
        fitted: Recordings it was fitted to, for the provenance.
        held: Held-out recordings, for the provenance.
        directory: Folder of the result; made where it does not exist. An earlier result in it is replaced.
        command: Command line that produces the result again; None: not stated.

    Raises:
        UserError: The folder cannot be written.
    """
    sources = provenance(fitted, held, command)
    document = comparison_document(comparison, simulation.source, mended)
    page = comparison_html(comparison, simulation, mended, sources)
    with replacing(directory, DOCUMENT) as part:
        text = json.dumps({**document, "provenance": sources}, indent=2, allow_nan=False)
        (part / DOCUMENT).write_text(text + "\n", encoding="utf-8")
        if comparison.model is not None:
            save_model(replace(comparison.model, provenance=sources), part / EXTENDED_MODEL)
        if mended is not None:
            (part / mended.name).write_text(mended.text, encoding="utf-8")
        (part / REPORT).write_text(page, encoding="utf-8")
    return directory / REPORT
