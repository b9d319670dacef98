"""Events of recordings that no fit sees: what was found to happen in the field may happen there too, at another time.

It says nothing of how well the rest predicts. So it is looked for in what the rest leaves, and its rows do not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects import EFFECTS
from ..dynamics.effects.effect import Effect
from ..dynamics.term import Values
from ..signals.motion import Motion
from .candidate import Candidate
from .constants import grid_points
from .finding import Happened
from .held_out import HeldOut
from .rivals import UNKNOWN
from .scene import Scene
from .scored import penalty
from .stacked import Stacked, stacked_effect

EXPLAINS = 0.5
"""Share of what is above the noise while it lasts that an event must explain: less, and it is where the model errs."""
MARGIN_S = 0.5
"""Taken along on both sides: the step of the grid on which an event is looked for."""
MOST = 4
"""So many events of one recording are looked for. Where they last longer than such may (`Effect.often`), it is said to
have none."""


def happened(held_out: HeldOut, accepted: Sequence[Candidate], values: FloatArray, gate: float) -> list[Happened]:
    """Events of the kinds that were found in the field.

    Args:
        held_out: The recordings that no fit sees.
        accepted: What was found.
        values: (k,) parameters of all of it.
        gate: Score from which an event is one.
    """
    kinds = {c.effect.kind for c in accepted if c.effect.event and c.effect.kind != UNKNOWN}
    if not kinds:
        return []
    residual, scene = held_out.residual(accepted, values), held_out.scene
    source, found = np.array([motion.source for motion in scene.motions])[scene.owner], list[Happened]()
    for recording in np.unique(source).tolist():
        here = _in_recording(held_out, kinds, recording, residual, gate)
        rows = sum(np.sum(during(scene, event)) for event in here)
        if rows <= max(EFFECTS[kind].often for kind in kinds) * np.sum(source == recording):
            found += here
    return found


def _in_recording(
    held_out: HeldOut, kinds: set[str], recording: int, residual: FloatArray, gate: float
) -> list[Happened]:
    """Events of some kinds in one recording, the largest first, by what is left (R,) of all rows."""
    residual, found = residual.copy(), list[Happened]()
    tried = [one for kind in sorted(kinds) for one in _tried(held_out, kind, recording)]
    for _ in range(MOST):
        gains = [_gain(stacked, residual) - penalty(effect, len(residual)) for effect, _, stacked in tried]
        if not gains or max(gains) < gate:
            break
        effect, point, stacked = tried[int(np.argmax(gains))]
        own = residual[stacked.rows]
        if max(gains) < EXPLAINS * float(np.sum(own**2 - 1.0)):
            break
        found.append(event_of(effect, point, recording))
        residual[during(held_out.scene, found[-1])] = 0.0
    return found


def event_of(effect: Effect, constants: Values, recording: int) -> Happened:
    """An event in one recording, with its margin.

    Args:
        effect: The effect.
        constants: (c,) values in the order of its constants.
        recording: Number of the recording.
    """
    begin_s, end_s = effect.window(constants)
    return Happened(effect.kind, recording, begin_s - MARGIN_S, end_s + MARGIN_S)


def _tried(held_out: HeldOut, kind: str, recording: int) -> list[tuple[Effect, tuple[float, ...], Stacked]]:
    """Events of a kind everywhere and at any time in one recording."""

    def compute() -> Iterator[tuple[Effect, tuple[float, ...], Stacked]]:
        arm = held_out.evidence.base.model.arm
        for place in EFFECTS[kind].variants(arm):
            effect = EFFECTS[kind].at(arm, {**place, "recording": recording})
            if not effect.event:
                continue
            for point in grid_points(effect, held_out.scene.motions):
                yield effect, point, stacked_effect(held_out.scene, effect, point)

    return cast(list[tuple[Effect, tuple[float, ...], Stacked]], held_out.keep((kind, recording), lambda: [*compute()]))


def _gain(stacked: Stacked, residual: FloatArray) -> float:
    """Drop in chi-square with an effect's best parameters, everything else as it is."""
    slope = stacked.columns.T @ residual[stacked.rows]
    gram = stacked.columns.T @ stacked.columns
    return float(slope @ np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ slope)


def during(scene: Scene, event: Happened) -> np.ndarray:
    """(R,) rows of a scene while an event lasts.

    Args:
        scene: Recordings, stacked in R rows.
        event: In one of them.
    """
    here = np.zeros(len(scene), dtype=bool)
    for number, motion in enumerate(scene.motions):
        if motion.source == event.recording:
            for joint in range(len(motion.joints)):
                slot = scene.slot(joint, number)
                time = motion.time[scene.place[slot]]
                here[slot] = (time >= event.begin_s) & (time < event.end_s)
    return here


def voided(motions: Sequence[Motion], events: Sequence[Happened]) -> list[Motion]:
    """Motions of which no row counts while an event of their recording lasts.

    Args:
        motions: Numbered as the events' recordings are (`Motion.source`).
        events: In any of them.
    """
    return [
        replace(motion, void=tuple((e.begin_s, e.end_s) for e in events if e.recording == motion.source))
        for motion in motions
    ]


def without(held_out: HeldOut, events: Sequence[Happened]) -> HeldOut:
    """The recordings, of which no row counts while an event lasts.

    Args:
        held_out: The recordings that no fit sees.
        events: In them.
    """
    if not events:
        return held_out
    scene = held_out.scene
    motions = voided(scene.motions, events)
    return HeldOut(held_out.evidence, Scene(held_out.evidence.base, motions, scene.whiteners, scene.backgrounds))
