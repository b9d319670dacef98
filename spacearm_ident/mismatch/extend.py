"""The extended model: the base model with the effects that were found, as any other model file has its terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.effects.effect import Effect
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..identification.consistency import make_consistent
from ..identification.prior import make_prior
from .evidence import Candidate, Evidence
from .rivals import UNKNOWN


def extended_model(evidence: Evidence, accepted: Sequence[Candidate], values: FloatArray) -> IdentifiedModel:
    """The base model, refitted beside the effects, and the named effects with their values.

    Args:
        evidence: What was fitted.
        accepted: Effects.
        values: (k,) their parameters.
    """
    base = evidence.base
    whole = evidence.base_parameters(accepted, values)
    count = len(base.model.parameters)
    scale = make_prior(base.model, evidence.field.motions).scale
    parameters = np.where(scale > 0, whole[:count], base.parameters)
    parameters = make_consistent(base.model, evidence.base_triangle, parameters, scale)
    structure: Structure = {kind: dict(options) for kind, options in base.model.structure.items()}
    found: list[tuple[Effect, FloatArray, tuple[float, ...]]] = []
    first = 0
    for candidate in accepted:
        own = values[first : first + len(candidate.effect.parameters)]
        first += len(candidate.effect.parameters)
        if candidate.effect.kind != UNKNOWN:
            found.append((candidate.effect, own, candidate.constants))
    first = count + evidence.nuisance
    for effect, constants in evidence.common:
        own = whole[first : first + len(effect.parameters)]
        first += len(effect.parameters)
        if effect.kind != UNKNOWN:
            found.append((effect, own, constants))
    for effect, _, _ in found:
        structure.setdefault(effect.kind, {"at": []})["at"].append(dict(effect.place))
    # Terms of a kind stand together, in the order in which their places were named.
    found.sort(key=lambda item: list(structure).index(item[0].kind))
    return IdentifiedModel(
        TorqueModel(base.model.arm, structure),
        np.concatenate([parameters, *(own for _, own, _ in found)]),
        np.concatenate([base.constants, *(np.array(constants) for _, _, constants in found)]),
        base.cutoff_hz,
        base.provenance,
    )
