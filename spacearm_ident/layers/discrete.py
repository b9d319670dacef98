"""Layer 0, what is either right or wrong: signs, order, units, gravity, found before anything is fitted.

`conventions.search` compares what all recordings together would mean under every ordinary mistake, the simulation's own
friction and rotor inertias being known as roughly as they are. One that it is sure of, and that no recording by itself
contradicts, is undone here; gains, zeros and delays are left to `conventions.py`, which estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Final

import numpy as np

from ..arrays import FloatArray
from ..conventions.change import RIGHT_OR_WRONG, Change, Kind
from ..conventions.rows import MOST_ROWS, rows_of
from ..conventions.scorer import Scorer
from ..conventions.search import search
from ..conventions.setup import Setup
from ..conventions.words import joint_names, statement
from ..dynamics.arm import Arm
from ..recording.corrections import Corrections, JointCorrection
from ..recording.recording import Recording
from ..signals.prepare import prepare
from ..simulations.simulation import ARMATURE, DAMPING, FRICTION, Simulation

DISCRETE = RIGHT_OR_WRONG | {Kind.GRAVITY}


MOST_PARTS: Final = 3
"""As many recordings' rows are looked at together; of more of them, fewer each."""


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


def find_mistakes(recordings: Sequence[Recording], simulation: Simulation) -> Undoing:
    """Find signs, order, units and gravity that all recordings have wrong.

    Args:
        recordings: Made under the same conventions.
        simulation: Of the arm.

    Raises:
        UnfitDataError: A recording is too short to say.
    """
    arm = simulation.arm
    each = [prepare([recording.in_order(arm.joint_names)], arm.joint_names)[0] for recording in recordings]
    known = _known(simulation)
    parts = [Scorer(arm, rows_of(motions), own=known) for motions in each]
    together = [motion for motions in each for motion in motions]
    whole = Scorer(arm, rows_of(together, MOST_ROWS * min(len(each), MOST_PARTS)), own=known) if each[1:] else parts[0]
    last = search(whole)[-1].before
    shared = [
        change
        for change in last.changes
        if change.kind in DISCRETE and all(_gain(part, last.changes, change) > 0.0 for part in parts)
    ]
    setup = _setup(arm, shared)
    mistakes = (
        Mistake(str(change.kind), joint_names(arm, change), statement(arm, change, last.evidence)) for change in shared
    )
    return Undoing(tuple(mistakes), _corrections(setup, arm), arm.with_gravity(setup.gravity))


def _known(simulation: Simulation) -> FloatArray:
    """(n, OWN) what a simulation says of its joints' friction and rotor inertias."""
    symbols, values = (FRICTION, "", DAMPING, ARMATURE, ""), simulation.own
    names = simulation.arm.joint_names
    return np.array([[values.get(f"{symbol}[{name}]", 0.0) for symbol in symbols] for name in names])


def _gain(scorer: Scorer, changes: Sequence[Change], one: Change) -> float:
    """What one of some changes gains of a recording's log-likelihood, beside the others."""
    others = [change for change in changes if change is not one]
    scores = [scorer.score(some, _setup(scorer.arm, some)).score for some in (changes, others)]
    return scores[0] - scores[1] - one.log_prior


def _setup(arm: Arm, changes: Sequence[Change]) -> Setup:
    """Conventions after some changes."""
    return reduce(lambda setup, change: change.on(setup), changes, Setup.as_recorded(arm))


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
