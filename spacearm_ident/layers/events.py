"""Events of a model: it without them, and it with them at other times.

When an event begins was found in the recorded torque, late or not. Where a delay is undone the event moves with the
torque, and says nothing of the delay.
"""

from __future__ import annotations

from dataclasses import replace

from ..dynamics.effects.effect import Effect
from ..dynamics.model import IdentifiedModel, TorqueModel


def without_events(model: IdentifiedModel) -> IdentifiedModel:
    """The model of what lasts; itself where it has no event."""
    kinds = {term.kind for term in model.model.terms if isinstance(term, Effect) and term.event}
    if not kinds:
        return model
    structure = {kind: options for kind, options in model.model.structure.items() if kind not in kinds}
    return model.carried_to(TorqueModel(model.model.arm, structure))


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
