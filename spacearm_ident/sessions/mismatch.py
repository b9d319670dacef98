"""A mismatch session: bags in, an explanation and its result folder out.

The one pass behind `spacearm mismatch` and the identifier node: whatever asks, the answer is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.model_file import load_model
from ..errors import UserError
from ..identification.effort import in_newton_metres
from ..identification.identify import Progress
from ..mismatch.explain import explain
from ..mismatch.finding import Explanation, unfit
from ..mismatch.run_set import RunSet
from ..recording import Recording
from ..report.folder import refuse_to_replace
from ..report.mismatch_folder import write_mismatch
from .identification import corrected, find_arm, within
from .mistakes import mistakes
from .next_run import described, next_run
from .reading import Comparing, Reading

MODEL_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class MismatchSession:
    """What came out: the explanation, the page to open, all recordings that were read, and the arm."""

    explanation: Explanation
    page: Path
    recordings: tuple[Recording, ...]
    arm: Arm


def explain_session(
    field: Sequence[Path],
    reference: Sequence[Path],
    judged: Sequence[Path],
    directory: Path,
    comparing: Comparing,
    *,
    command: str | None = None,
    progress: Progress | None = None,
) -> MismatchSession:
    """Read, explain, write the result folder.

    Args:
        field: Bags to explain.
        reference: Bags of the healthy arm, or one model file, which may be of another gravity than the recordings;
            none: the arm's own fit is the base.
        judged: Bags to judge on; none: the last third of each of `field` is held out.
        directory: Result folder.
        comparing: How. Without an arm of its own: the model's, or of the bags' `/robot_description`.
        command: How to do it again; kept with the result.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A file cannot be read or does not fit, or the folder cannot be written.
    """
    report = progress or (lambda share, what: None)
    reading, at_first = comparing.reading, within(report, 0.0, 0.1)
    for path in reference:
        refuse_to_replace(path, directory)
    known = _reference(reference, reading, at_first)
    runs = RunSet(reading.read(field, at_first), known, reading.read(judged, at_first))
    arm = _arm(comparing, runs)
    if runs.known is not None:
        runs = replace(runs, reference=runs.known.with_gravity(arm.gravity))
    runs = runs.each(lambda part: corrected(in_newton_metres(part, arm), arm))
    wrong = mistakes(runs, arm, within(report, 0.1, 0.15))
    if wrong:
        explanation = unfit(arm.joint_names, wrong)
    else:
        explanation = explain(arm, runs, comparing.excluded, progress=within(report, 0.15, 0.95))
    planned = next_run(explanation, arm, *runs.every)
    explanation = described(explanation, planned, arm, *runs.every)
    page = write_mismatch(explanation, arm, runs, planned, directory, command)
    return MismatchSession(explanation, page, tuple(runs.every), arm)


def _reference(paths: Sequence[Path], reading: Reading, progress: Progress) -> list[Recording] | IdentifiedModel:
    """Bags, or the one model file."""
    models = [path for path in paths if path.suffix in MODEL_SUFFIXES]
    if not models:
        return reading.read(paths, progress)
    if len(paths) > 1:
        raise UserError("give bags of the healthy arm or one model file as reference, not both")
    return load_model(models[0])


def _arm(comparing: Comparing, runs: RunSet) -> Arm:
    """The arm, under the gravity of the recordings: what is stated, else a model's own.

    Raises:
        UserError: As `find_arm`.
    """
    file, gravity, known = comparing.reading.arm, comparing.gravity, runs.known
    if known is None:
        return find_arm(file, gravity, runs.every)
    arm = known.model.arm if file is None else find_arm(file, None, runs.every)
    if gravity is not None:
        return arm.with_gravity(np.array(gravity, dtype=float))
    return arm if arm.gravity_stated else arm.with_gravity(known.model.arm.gravity)
