"""The extended model: the base model with the effects that were found, as any other model file has its terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.effects.friction import VacuumFriction
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..estimate.consistency import make_consistent
from ..regression.prior import make_prior
from .candidate import Candidate, with_own
from .evidence import Evidence
from .rivals import UNKNOWN


def extended_model(
    evidence: Evidence, accepted: Sequence[Candidate], values: FloatArray, is_term: Callable[[Effect], bool]
) -> IdentifiedModel:
    """The base model, refitted beside the effects, and the named effects with their values.

    Args:
        evidence: What was fitted.
        accepted: Effects.
        values: (k,) their parameters.
        is_term: Whether an effect is a term of the model; a function without a name is none.
    """
    base = evidence.base
    count = len(base.model.parameters)
    whole = evidence.base_parameters(accepted, values)
    if any(candidate.effect.kind == VacuumFriction.kind for candidate in accepted):
        # It takes away what the model itself has: the model must have what was taken away.
        removed = np.where(base.model.of_high_order, evidence.in_vacuum[0], np.nan)
        whole = evidence.base_parameters_with(removed, accepted, values)
    scale = make_prior(base.model, evidence.field.motions).scale
    parameters = np.where(scale > 0, whole[:count], base.parameters)
    parameters = make_consistent(base.model, evidence.base_triangle, parameters, scale)
    structure: Structure = {kind: dict(options) for kind, options in base.model.structure.items()}
    found: list[tuple[Effect, FloatArray, tuple[float, ...]]] = []
    for candidate, own in with_own(accepted, values):
        if candidate.effect.kind != UNKNOWN and is_term(candidate.effect):
            found.append((candidate.effect, own, candidate.constants))
    first = count + evidence.nuisance
    for effect, constants in evidence.common:
        own = whole[first : first + len(effect.parameters)]
        first += len(effect.parameters)
        if effect.kind != UNKNOWN:
            found.append((effect, own, constants))
    # Terms of a kind stand together: those of the base model first, whose own effects may be of the same kind.
    values_of: dict[str, list[FloatArray]] = {kind: [] for kind in structure}
    constants_of: dict[str, list[FloatArray]] = {kind: [] for kind in structure}
    for term, first, first_constant in base.model.numbered():
        values_of[term.kind].append(parameters[first : first + len(term.parameters)])
        constants_of[term.kind].append(base.constants[first_constant : first_constant + len(term.constants)])
    for effect, own, constants in found:
        known = structure.get(effect.kind, {"at": []})
        structure[effect.kind] = {**known, "at": [*known["at"], dict(effect.place)]}
        values_of.setdefault(effect.kind, []).append(own)
        constants_of.setdefault(effect.kind, []).append(np.array(constants))
    return IdentifiedModel(
        TorqueModel(base.model.arm, structure),
        np.concatenate([part for kind in structure for part in values_of[kind]]),
        np.concatenate([part for kind in structure for part in constants_of[kind]]),
        base.cutoff_hz,
        base.provenance,
    )
