"""A mismatch session: bags in, an explanation and its result folder out.

The one pass behind `spacearm mismatch` and the identifier node: whatever asks, the answer is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .dynamics.arm import Arm
from .dynamics.model import IdentifiedModel
from .dynamics.model_file import load_model
from .errors import UserError
from .identification.effort import in_newton_metres
from .identification.identify import Progress
from .mismatch.explain import explain
from .mismatch.finding import Explanation
from .recording import Recording
from .report.folder import refuse_to_replace
from .report.mismatch_folder import write_mismatch
from .session import corrected, find_arm, read_bags, within

MODEL_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class MismatchSession:
    """What came out: the explanation, the page to open, and all recordings that were read."""

    explanation: Explanation
    page: Path
    recordings: tuple[Recording, ...]


def explain_session(
    field: Sequence[Path],
    reference: Sequence[Path],
    judged: Sequence[Path],
    directory: Path,
    *,
    arm: Path | None = None,
    gravity: Sequence[float] | None = None,
    excluded: Sequence[str] = (),
    fixed_base: bool = False,
    namespace: str | None = None,
    command: str | None = None,
    progress: Progress | None = None,
) -> MismatchSession:
    """Read, explain, write the result folder.

    Args:
        field: Bags to explain.
        reference: Bags of the healthy arm, or one model file; none: the arm's own fit is the base.
        judged: Bags to judge on; none: the last third of each of `field` is held out.
        directory: Result folder.
        arm: URDF or arm YAML; None: the model's, or of the bags' `/robot_description`.
        gravity: (3,) m/s^2 instead of the arm's.
        excluded: Effects that are not to be considered.
        fixed_base: Take the base for fixed though the bags hold its motion.
        namespace: Of the arm, where a bag holds several.
        command: How to do it again; kept with the result.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A file cannot be read or does not fit, or the folder cannot be written.
    """
    report = progress or (lambda share, what: None)
    reading = within(report, 0.0, 0.1)
    for path in reference:
        refuse_to_replace(path, directory)
    known = _reference(reference, reading, fixed_base, namespace)
    bags, judges = (read_bags(paths, reading, fixed_base, namespace) for paths in (field, judged))
    healthy = [] if isinstance(known, IdentifiedModel) else known
    its_arm = _arm(arm, gravity, known, (*bags, *healthy, *judges))
    bags, healthy, judges = (corrected(in_newton_metres(runs, its_arm), its_arm) for runs in (bags, healthy, judges))
    known = known if isinstance(known, IdentifiedModel) else healthy
    recordings = (*bags, *healthy, *judges)
    explanation = explain(its_arm, known, bags, judges, excluded, progress=within(report, 0.1, 0.95))
    page = write_mismatch(explanation, its_arm, bags, judges, healthy, directory, command)
    return MismatchSession(explanation, page, recordings)


def _reference(
    paths: Sequence[Path], progress: Progress, fixed_base: bool, namespace: str | None
) -> list[Recording] | IdentifiedModel:
    """Bags, or the one model file."""
    models = [path for path in paths if path.suffix in MODEL_SUFFIXES]
    if not models:
        return read_bags(paths, progress, fixed_base, namespace)
    if len(paths) > 1:
        raise UserError("give bags of the healthy arm or one model file as reference, not both")
    return load_model(models[0])


def _arm(
    file: Path | None,
    gravity: Sequence[float] | None,
    reference: list[Recording] | IdentifiedModel,
    recordings: Sequence[Recording],
) -> Arm:
    if isinstance(reference, IdentifiedModel) and file is None and gravity is None:
        return reference.model.arm
    return find_arm(file, gravity, recordings)
