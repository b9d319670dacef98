"""An identification session: recordings in, a validated model and its result folder out.

The one pass behind `spacearm identify`, the identifier node and its `replay`: whatever asks, the numbers are the
same because the code is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..bayes.from_prior import GroundPrior
from ..conventions.check import check_conventions, recording_name
from ..conventions.finding import ConventionReport
from ..dynamics.arm import Arm, arm_from_urdf, load_arm, without_joints
from ..dynamics.effects import Effect
from ..dynamics.mimics import follower_words, require_open_chain
from ..dynamics.model import Structure, TorqueModel
from ..dynamics.model_file import load_model
from ..dynamics.urdf_chain import JointTree
from ..errors import UserError
from ..estimate.identified import Identified, Validation
from ..forks import beside
from ..identification.identify import Progress, Settings, identify, with_provenance
from ..identification.validation import split, validate
from ..recording import Recording
from ..results.provenance import OPTIONS, provenance
from ..results.recorded_runs import recorded_runs

ON_OTHERS = "on other recordings than the fit"
ON_THE_FITTED = "on recordings of the fit itself"
ON_THE_LAST_THIRD = "on the last third of the last recording, held out of the fit"


@dataclass(frozen=True)
class Session:
    """What came out: model, validation, report, and what is wrong with the data."""

    identified: Identified
    validation: Validation
    page: Path
    conventions: ConventionReport


def identify_session(
    fitted: Sequence[Recording],
    validated: Sequence[Recording] | None,
    arm: Arm,
    settings: Settings,
    directory: Path,
    *,
    command: str | None = None,
    asked: Mapping[str, Any] | None = None,
    known: Identified | None = None,
    progress: Progress | None = None,
) -> Session:
    """Identify, validate, write the result folder.

    Args:
        fitted: Runs to identify the arm from.
        validated: Runs to validate on. None or empty: the last third of the last fitted run is held out of the fit;
            none of it where a prior is updated by what little there is, then the figures are on the fit itself.
        arm: What is known before.
        settings: Decisions of the user.
        directory: Result folder.
        command: How to do it again; kept with the result.
        asked: What of `settings` and `arm` is not by default, as plain data; kept with the result as `OPTIONS`.
        known: The identification of all of `fitted`, where there is one already: then it is only validated.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UnfitDataError: The data cannot carry an identification or a validation.
        UserError: The recordings do not fit the arm, or the folder cannot be written.
    """
    report = progress or (lambda share, what: None)
    kept, copies = _without_copies(fitted)
    fitted, validated = kept, kept if validated is fitted else validated
    whole, what = corrected(fitted, arm), _what(fitted, validated or ())
    judges = whole if validated is fitted else corrected(validated or (), arm)
    every = [*whole, *([] if judges is whole else judges)]
    check = partial(check_conventions, every, arm, gravity_known=not settings.gravity)
    if validated:
        judged = judges
    elif settings.prior is not None:
        judged, what = whole, ON_THE_FITTED
    elif known is None:
        first, last = split(whole[-1])
        whole, judged = [*whole[:-1], first], [last]
    else:
        raise UserError("nothing to validate the known model on: name a recording")
    report(0.0, "checking conventions")
    with beside(check) as checked:
        try:
            identified = known or identify(whole, arm, settings, within(report, 0.0, 0.6))
            report(0.6, "validating")
            validation = validate(identified.model, judged, what, held_out=what != ON_THE_FITTED)
            # Imported here, while the other process checks: with matplotlib it takes half as long as an identification.
            from ..report.folder import write_result
        except Exception:
            # What is wrong with the recordings is said before what could not be made of them.
            checked()
            raise
        if known is None:
            identified = replace(identified, notes=(*identified.notes, *copies))
        identified = with_provenance(identified, _origin(fitted, validated or fitted[-1:], command, settings, asked))
        found = cache(checked)
        further = partial(_further, identified, settings, found)
        report(0.7, "writing the report")
        runs = recorded_runs(fitted, [] if validated is fitted else (validated or ()), arm)
        page = write_result(identified, validation, directory, further, runs, lambda: found().unfit)
        conventions = found()
    report(1.0, "done")
    return Session(identified, validation, page, conventions)


def _further(identified: Identified, settings: Settings, checked: Callable[[], ConventionReport]) -> dict[str, Any]:
    """What `validation.json` has beside the validation."""
    tried = identified.coupling
    further: dict[str, Any] = {
        "conventions": checked().as_dict(),
        "coupling_tried": tried and tried.as_dict(),
    }
    if settings.gains is not None:
        further["torque_gains"] = settings.gains.as_dict()
    return further


def _origin(
    fitted: Sequence[Recording],
    validated: Sequence[Recording],
    command: str | None,
    settings: Settings,
    asked: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Provenance of a result: recordings, versions, the command, its prior, and what was not by default."""
    origin = provenance(fitted, validated, command)
    if settings.prior is not None:
        origin["prior"] = settings.prior.source
    if asked is not None:
        origin[OPTIONS] = dict(asked)
    return origin


def corrected(recordings: Sequence[Recording], arm: Arm) -> list[Recording]:
    """Recordings with the arm's `corrections` applied.

    Args:
        recordings: As recorded.
        arm: With corrections by joint.

    Raises:
        UserError: A joint that is to be corrected is not in one of them.
    """
    return [arm.corrections.applied(recording) for recording in recordings]


def _what(fitted: Sequence[Recording], validated: Sequence[Recording]) -> str:
    """What a validation is on; a file that took part in the fit does not test it."""
    if not validated:
        return ON_THE_LAST_THIRD
    seen = {source.sha256 for recording in fitted for source in recording.sources}
    again = any(source.sha256 in seen for recording in validated for source in recording.sources)
    return ON_THE_FITTED if again else ON_OTHERS


def _without_copies(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings without those of the same samples as one before, and a note on each that is left out.

    A copy would halve variances, and a term that fits one would be found to predict the other.
    """
    kept: list[Recording] = []
    notes = []
    for recording in recordings:
        first = next((one for one in kept if _same_samples(one, recording)), None)
        if first is None:
            kept.append(recording)
        else:
            notes.append(f"{recording_name(recording)} is a copy of {recording_name(first)}: it is counted once")
    return kept, notes


def _same_samples(one: Recording, other: Recording) -> bool:
    """Whether two recordings have the same positions and efforts of the same joints; a copy may have other stamps."""
    pairs = ((one.position, other.position), (one.effort, other.effort))
    return one.joints == other.joints and all(np.array_equal(*pair, equal_nan=True) for pair in pairs)


def find_arm(
    file: Path | None,
    gravity: Sequence[float] | None,
    recordings: Sequence[Recording],
    prior: GroundPrior | None = None,
) -> Arm:
    """The arm of a file, or else the one that the recordings describe; with a prior its own.

    Args:
        file: URDF or arm YAML; beside a prior only the gravity counts that it states.
        gravity: (3,) m/s^2 in the base frame, instead of the arm's own.
        recordings: Whose `/robot_description` is taken where there is no file.
        prior: Ground model to update.

    Raises:
        UserError: There is neither, it cannot be read, or one of its joints moves another of the chain as well.
    """
    if prior is not None:
        arm = prior.model.model.arm
        told = load_arm(file) if file is not None else None
        if told is not None and told.gravity_stated:
            arm = arm.with_gravity(told.gravity)
    elif file is not None:
        arm = load_arm(file)
    else:
        urdf = next((recording.urdf for recording in recordings if recording.urdf), None)
        if urdf is None:
            raise UserError("no bag holds a /robot_description: name the arm's URDF or arm YAML as 'arm' (--arm FILE)")
        arm = arm_from_urdf(urdf)
    if prior is None:
        arm = require_open_chain(_as_recorded(arm, recordings))
    return arm if gravity is None else arm.with_gravity(np.array(gravity, dtype=float))


def _as_recorded(arm: Arm, recordings: Sequence[Recording]) -> Arm:
    """The arm with those joints fixed that a recording lacks; where one has their positions but no effort, at those.

    Where a recording has joints that the description does not know, a joint may only have another name there: then the
    arm stays, and is refused for it.
    """
    lacking = {joint for joint in arm.joint_names for recording in recordings if joint not in recording.joints}
    strange = {joint for recording in recordings for joint in recording.joints} - set(JointTree(arm.urdf).by_name)
    if not lacking or strange or len(lacking) == len(arm.joints):
        return arm
    measured = {name: ends for recording in recordings for name, ends in recording.effortless.items()}
    return without_joints(arm, lacking, {name: sum(ends) / 2.0 for name, ends in measured.items() if name in lacking})


def locked_words(arm: Arm) -> list[str]:
    """Lines on the joints that were fixed, since the recordings lack them, or mimic others; none where none was."""
    words = follower_words(arm.described, arm.joint_names)
    if not arm.locked:
        return words
    where = "at the positions recorded, else at 0; elsewhere: new-arm --lock"
    return [f"not in the recordings, and taken as fixed: {', '.join(arm.locked)} ({where})", *words]


def structure_of_file(path: Path, arm: Arm) -> Structure:
    """The terms of a model file, for an arm.

    Args:
        path: A `model.yaml`.
        arm: The arm that is to have them.

    Raises:
        UserError: It cannot be read, or names joints that the arm does not have.
    """
    structure = load_model(path).model.structure
    try:
        terms = TorqueModel(arm, structure).terms
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    for term in terms:
        unknown = set(term.joints) - set(arm.joint_names) if isinstance(term, Effect) else set()
        if unknown:
            raise UserError(f"{path}: {term.kind}: the arm has no joint {min(unknown)!r}")
    return structure


def within(progress: Progress, start: float, stop: float) -> Progress:
    """A progress callback for a part of the work.

    Args:
        progress: Callback of the whole work: share done in 0..1, and what is being done.
        start: Share of the whole at which the part begins.
        stop: Share of the whole at which it ends.
    """
    return lambda share, what: progress(start + (stop - start) * share, what)
