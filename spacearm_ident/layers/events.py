"""Events of a model: its torque without them, and it with them at other times.

When an event begins was found in the recorded torque, late or not. Where a delay is undone the event moves with the
torque, and says nothing of the delay.
"""

from __future__ import annotations

from dataclasses import replace

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.model import IdentifiedModel
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
    events = {term.kind for term in model.model.terms if isinstance(term, Effect) and term.event}
    return model.torque(motion, [kind for kind in model.model.structure if kind not in events]) if events else torque


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
