"""Mistakes of convention that make recordings unfit to be compared with a healthy arm.

`conventions.check` knows CAD alone. Where the healthy arm is known, from recordings or as a model, a mistake that was
inferred is tested on that as well: what has changed at an arm may look like a mistake under CAD (the torque of a heavy
sloshing load like amperes), and is then what is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from ..arrays import FloatArray
from ..conventions.change import RIGHT_OR_WRONG, TORQUE_SCALES, UNIT_FACTOR, Kind
from ..conventions.check import POSITION_UNIT, check_conventions, recording_name
from ..conventions.finding import DECISIVE, ConventionReport, Level
from ..conventions.finding import Finding as Mistake
from ..conventions.fixed_joints import KIND as FIXED_JOINT_MOVES
from ..conventions.jumps import POSITION_JUMP
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..errors import UnfitDataError, UserError
from ..export.payload import find_payload
from ..identification.identify import Progress, identify
from ..identification.validation import validate
from ..mismatch.run_set import RunSet
from ..recording.corrections import Corrections, JointCorrection
from ..recording.interleaved import TWO_SOURCES
from ..recording.recording import Recording
from .identification import within

MISTAKES = RIGHT_OR_WRONG | {
    *(Kind.EFFORT_UNIT, POSITION_UNIT, "robot_description"),
    *(FIXED_JOINT_MOVES, TWO_SOURCES, POSITION_JUMP),
}
"""Mistakes of convention that no physics looks like: a gain, a zero, gravity, a delay are effects."""
LARGEST_LEFT = 0.5
"""Share of the squares by which recorded torque differs from the healthy arm's that may be left, in the median of its
joints, when a mistake is undone: what is more than half something else is not that mistake. Planted ones leave 0 to 6 %
(UR10e, AIRBOT, Panda, xMate); a sloshing load, taken for amperes, 93 %."""
LEAST_UNIT = UNIT_FACTOR**0.5
"""Factor between the healthy arm's torque and the recorded one, in the median of the joints, from which another unit
is nearer than N·m."""
ALONE = "; the reference does not need it: identify that by itself, and give its model.yaml as the reference"
"""An arm YAML's corrections are applied to every recording of a command."""
UNDER_ITS_OWN = ", and give its model.yaml as the reference, with --gravity as in the field"
"""A model is carried over to the field's gravity; recordings are not."""
TINY = float(np.finfo(float).tiny)


def mistakes(runs: RunSet, arm: Arm, progress: Progress | None = None) -> tuple[str, ...]:
    """Mistakes of convention that make recordings unfit to be compared, as reasons with what to do.

    A mistake counts if `identify` calls it certain; in the field already if `check` calls the data unfit and the
    reference does not show it: an arm's own CAD errors, for which `identify` leaves room, would show in both. What was
    inferred, and what the healthy arm refutes, does not count. Torque in another unit than the reference's counts
    whatever CAD says, and so does a reference under another gravity than the field.

    Args:
        runs: What is to be compared with what; field and validation are examined alike.
        arm: What is known before.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A recording lacks a joint of the arm.
    """
    field, reference = [*runs.field, *runs.validation], runs.healthy
    share = len(field) / (len(field) + len(reference))
    report = progress or (lambda share, what: None)
    examined = check_conventions(field, arm, progress=within(report, 0.0, share))
    healthy = check_conventions(reference, arm, progress=within(report, share, 1.0)) if reference else None
    known = {(one.kind, one.joints) for one in healthy.findings} if healthy else set()
    found = [] if healthy is None else [*_wrong(healthy, DECISIVE), *_other_gravity(healthy, examined)]
    new = [one for one in _wrong(examined, 0.0 if healthy else DECISIVE) if (one.kind, one.joints) not in known]
    if found:
        found += new
    else:
        known_arm = _Healthy(runs, arm)
        found = [one for one in new if one.log_odds is None or known_arm.explained_by(one, new, field)]
        named = {name for one in found for name in one.recordings}
        found += [unit for one in field if recording_name(one) not in named and (unit := known_arm.other_unit(one))]
        if reference:
            found = [one if one.corrections.none else replace(one, remedy=one.remedy + ALONE) for one in found]
    return tuple(f"{', '.join(one.recordings)}: {one.statement} -> {one.remedy}" for one in found)


def _other_gravity(healthy: ConventionReport, examined: ConventionReport) -> list[Mistake]:
    """What is certain of the reference's gravity where the field has the stated one: one was recorded elsewhere."""
    if any(one.kind == Kind.GRAVITY for one in examined.findings):
        return []
    return [
        replace(one, remedy=f"identify the reference by itself with {one.remedy}{UNDER_ITS_OWN}")
        for one in healthy.findings
        if one.kind == Kind.GRAVITY and one.level is Level.UNFIT and (one.log_odds or 0.0) >= DECISIVE
    ]


def _wrong(report: ConventionReport, least: float) -> list[Mistake]:
    """Wrong conventions that no effect imitates: stated by the data, or inferred with at least these log odds."""
    unfit_ones = (one for one in report.findings if one.kind in MISTAKES and one.level is Level.UNFIT)
    return [one for one in unfit_ones if one.log_odds is None or one.log_odds >= least]


class _Healthy:
    """The healthy arm that recordings are compared with; its model is identified when it is first needed."""

    def __init__(self, runs: RunSet, arm: Arm) -> None:
        self._runs, self._arm = runs, arm

    @cached_property
    def _model(self) -> IdentifiedModel | None:
        """None where there is none, or its recordings are unfit."""
        if self._runs.known or not self._runs.healthy:
            return self._runs.known
        try:
            return identify(self._runs.healthy, self._arm).model
        except UnfitDataError:
            return None

    def explained_by(self, mistake: Mistake, together: Sequence[Mistake], field: Sequence[Recording]) -> bool:
        """Whether a mistake, undone, takes away most of what its recordings differ by from this arm at its joints.

        Args:
            mistake: To be judged; it is, where nothing is known of the arm.
            together: All mistakes: those of the same recordings are undone with it, for they hide each other.
            field: Recordings that it may be in.
        """
        if self._model is None:
            return True
        found: list[_Beside] = []
        for recording in field:
            name = recording_name(recording)
            if name in mistake.recordings:
                some = [one.corrections for one in together if name in one.recordings]
                undone = reduce(lambda before, correction: correction.applied(before), some, recording)
                before, after = (_torques(self._model, one, mistake.joints) for one in (recording, undone))
                found += [_Beside(*pair, *other) for pair, other in zip(before, after)]
        if not found:
            return True
        left = float(np.median([one.left for one in found]))
        if left > LARGEST_LEFT:
            return False
        if mistake.kind not in TORQUE_SCALES:
            return True
        named = [one for one in field if recording_name(one) in mistake.recordings]
        return float(np.median([one.unit for one in found])) > LEAST_UNIT and left < _left_by_payload(
            self._model, named
        )

    def other_unit(self, recording: Recording) -> Mistake | None:
        """The mistake that a recording's torque is in another unit than this arm's, if it is."""
        if not self._may_differ(recording) or self._model is None:
            return None
        names = self._arm.joint_names
        found = [_Beside(*pair, *pair) for pair in _torques(self._model, recording)]
        alike = bool(found) and float(np.median([one.left for one in found])) < LARGEST_LEFT
        if not alike or float(np.median([one.unit for one in found])) < UNIT_FACTOR:
            return None
        if _left_by_payload(self._model, [recording]) <= float(np.median([one.left for one in found])):
            return None
        listed = ", ".join(f"{name} {1.0 / max(one.factor, TINY):.3g}" for name, one in zip(names, found))
        undo = Corrections({name: JointCorrection(effort_scale=one.factor) for name, one in zip(names, found)})
        return Mistake(
            kind=str(Kind.EFFORT_UNIT),
            level=Level.UNFIT,
            joints=names,
            statement=f"the torque is not in the reference's unit: recorded over expected is {listed}",
            remedy=f"find the unit of its effort; until then in the arm YAML: corrections: {undo.as_yaml(names)}",
            recordings=(recording_name(recording),),
            corrections=undo,
        )

    def _may_differ(self, recording: Recording) -> bool:
        """Whether torques of this size would be in another unit; a model costs nothing more, so it decides itself."""
        if not self._runs.healthy:
            return True
        known = np.concatenate([one.in_order(self._arm.joint_names).effort for one in self._runs.healthy])
        sizes = [
            np.sqrt(np.mean(some**2, axis=0)) for some in (recording.in_order(self._arm.joint_names).effort, known)
        ]
        ratio = float(np.median(np.log((sizes[0] + TINY) / (sizes[1] + TINY))))
        return abs(ratio) > float(np.log(LEAST_UNIT))


@dataclass(frozen=True)
class _Beside:
    """A joint's torque (M,) beside that of the healthy arm, as recorded and with a mistake undone."""

    recorded: FloatArray
    expected: FloatArray
    undone: FloatArray
    wanted: FloatArray

    @property
    def factor(self) -> float:
        """Factor on the torque, the mistake undone, that fits best: its size was inferred from CAD masses alone."""
        return max(float(self.undone @ self.wanted), 0.0) / max(float(self.undone @ self.undone), TINY)

    @property
    def left(self) -> float:
        """Share of the squares that is left then."""
        left = float(np.sum((self.wanted - self.factor * self.undone) ** 2))
        return left / max(float(np.sum((self.expected - self.recorded) ** 2)), TINY)

    @property
    def unit(self) -> float:
        """Factor, or one over it, between the healthy arm's torque and the recorded one."""
        ratio = float(np.linalg.norm(self.expected)) / max(float(np.linalg.norm(self.recorded)), TINY)
        return max(ratio, 1.0 / max(ratio, TINY))


def _left_by_payload(model: IdentifiedModel, recordings: Sequence[Recording]) -> float:
    """Share of the squares of the torque's difference that a body on the last link leaves, in the median of the joints.

    A unit scales friction and rotor torque as well, and every joint alike; a body does not. Infinite where there is no
    body, or the data show none.
    """
    try:
        held = find_payload(model, recordings)
    except (UnfitDataError, UserError):
        return float("inf")
    return float(np.median((held.after_Nm / np.maximum(held.before_Nm, TINY)) ** 2))


def _torques(
    model: IdentifiedModel, recording: Recording, joints: Sequence[str] = ()
) -> list[tuple[FloatArray, FloatArray]]:
    """Recorded torque and the model's, of some joints or of all, wherever each moves; none where the data are unfit."""
    names = model.model.arm.joint_names
    try:
        traces = validate(model, [recording], "", held_out=True).traces
    except UnfitDataError:
        return []
    pairs = []
    for joint in (names.index(name) for name in joints or names):
        parts = [(t.measured[t.moving[:, joint], joint], t.predicted[t.moving[:, joint], joint]) for t in traces]
        pairs.append((np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])))
    return pairs
