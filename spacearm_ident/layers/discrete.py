"""Layer 0, what is either right or wrong: signs, order, units, gravity, found before anything is fitted.

`conventions.search` compares what recordings would mean under every ordinary mistake. One that it is sure of, in every
recording, is undone here; gains, zeros and delays are left to `conventions.py`, which estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..conventions.change import Change, Kind
from ..conventions.rows import rows_of
from ..conventions.search import Court, search
from ..conventions.setup import Setup
from ..conventions.words import joint_names, statement
from ..dynamics.arm import Arm
from ..recording.corrections import Corrections, JointCorrection
from ..recording.recording import Recording
from ..recording.signals import prepare

DISCRETE = frozenset(
    {
        Kind.EFFORT_SIGN,
        Kind.POSITION_SIGN,
        Kind.AXIS_REVERSED,
        Kind.DEGREES,
        Kind.POSITIONS_EXCHANGED,
        Kind.EFFORTS_EXCHANGED,
        Kind.JOINTS_EXCHANGED,
        Kind.TIME_REVERSED,
        Kind.GRAVITY,
    }
)


@dataclass(frozen=True)
class Mistake:
    """A convention that all recordings break.

    Attributes:
        name: Of the kind.
        joints: Where; empty: everywhere.
        words: A sentence.
    """

    name: str
    joints: tuple[str, ...]
    words: str


@dataclass(frozen=True)
class Undoing:
    """What puts the recordings right.

    Attributes:
        mistakes: Found.
        corrections: To apply to every recording.
        arm: The arm, under the gravity that the recordings show.
    """

    mistakes: tuple[Mistake, ...]
    corrections: Corrections
    arm: Arm


def find_mistakes(recordings: Sequence[Recording], arm: Arm) -> Undoing:
    """Find signs, order, units and gravity that all recordings have wrong.

    Raises:
        UnfitDataError: A recording is too short to say.
    """
    found: list[tuple[Change, ...]] = []
    words: dict[tuple[Kind, tuple[int, ...]], Mistake] = {}
    for recording in recordings:
        motions, _ = prepare([recording.in_order(arm.joint_names)], arm.joint_names)
        court = Court(arm, rows_of(motions))
        last = search(court)[-1].before
        changes = tuple(change for change in last.changes if change.kind in DISCRETE)
        found.append(changes)
        for change in changes:
            said = statement(arm, change, last.evidence)
            words[change.kind, change.joints] = Mistake(str(change.kind), joint_names(arm, change), said)
    shared = [c for c in found[0] if all(any(_same(c, d) for d in other) for other in found[1:])]
    setup = Setup.as_recorded(arm)
    for change in shared:
        setup = change.on(setup)
    return Undoing(
        tuple(words[change.kind, change.joints] for change in shared),
        _corrections(setup, arm),
        arm.with_gravity(setup.gravity),
    )


def _same(one: Change, other: Change) -> bool:
    """Whether two recordings show the same mistake; gravity is a vector that each estimates."""
    if one.kind is Kind.GRAVITY:
        return other.kind is Kind.GRAVITY and bool(np.dot(one.value, other.value) > 0.9 * np.dot(one.value, one.value))
    return (one.kind, one.joints) == (other.kind, other.joints)


def _corrections(setup: Setup, arm: Arm) -> Corrections:
    names = arm.joint_names
    joints = {}
    for k, name in enumerate(names):
        source, effort = names[int(setup.position_from[k])], names[int(setup.effort_from[k])]
        correction = JointCorrection(
            position_scale=float(setup.position_scale[k]),
            position_from="" if source == name else source,
            effort_scale=float(setup.effort_sign[k]),
            effort_from="" if effort == name else effort,
        )
        if correction != JointCorrection():
            joints[name] = correction
    return Corrections(joints, "reversed" if setup.time_sign < 0 else "recorded")
