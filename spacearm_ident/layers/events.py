"""Events of a model: its torque without them, it with them at other times, and recordings without them.

When an event begins was found in the recorded torque, late or not. Where a delay is undone the event moves with the
torque, and says nothing of the delay. Where it acts was found likewise: beside a gain that nobody knew of the point of
a touch is another, one that explains the gain. So its rows say nothing of the gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.model import IdentifiedModel
from ..mismatch.happened import event_of, voided
from ..signals.motion import Motion


def lasting_torque(model: IdentifiedModel, motion: Motion, torque: FloatArray) -> FloatArray:
    """Torque of what lasts.

    Args:
        model: A model with values.
        motion: N samples of n joints.
        torque: (N, n) of the whole model, N m.

    Returns:
        (N, n) N m.
    """
    lasting = model.parameters.copy()
    for term, first, _ in model.model.numbered():
        if isinstance(term, Effect) and term.event:
            lasting[first : first + len(term.parameters)] = 0.0
    same = np.array_equal(lasting, model.parameters)
    return torque if same else model.model.torque(motion, lasting, model.constants)


def with_events_earlier(model: IdentifiedModel, seconds: float) -> IdentifiedModel:
    """The model with its events at another time.

    Args:
        model: A model with values.
        seconds: How much earlier every event begins.
    """
    begins = [constant.begins for constant in model.model.constants]
    if not seconds or not any(begins):
        return model
    constants = model.constants.copy()
    constants[begins] -= seconds
    return replace(model, constants=constants)


def without_events(motions: Sequence[Motion], model: IdentifiedModel) -> list[Motion]:
    """Motions of which no row counts while an event of a model lasts; all count where most would be left out.

    Args:
        motions: Numbered as the events' recordings are (`Motion.source`).
        model: A model with values.
    """
    quiet = []
    for motion in motions:
        here = [
            (term, model.constants[first : first + len(term.constants)])
            for term, _, first in model.model.numbered()
            if isinstance(term, Effect) and term.event and not term.elsewhere(motion)
        ]
        spans = [event_of(term, constants, motion.source) for term, constants in here]
        taken = sum(one.end_s - one.begin_s for one in spans)
        most = max((term.often for term, _ in here), default=0.0)
        often = taken > most * len(motion.position) / motion.rate_hz
        quiet += [motion] if often else voided([motion], spans)
    return quiet
