"""`HeldOut`: a recording that took no part in the fit, and what effects change there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from ..arrays import FloatArray
from .candidate import Candidate, without_effects
from .evidence import Evidence
from .scene import Scene
from .stacked import Stacked, base_columns, stacked_effect


class HeldOut:
    """A recording that took no part in the fit, and what effects change there."""

    def __init__(self, evidence: Evidence, scene: Scene) -> None:
        self.evidence = evidence
        self.scene = scene
        self.columns = base_columns(evidence.base, scene, evidence.common)
        self.torque = scene.torque()
        self._kept: dict[object, Any] = {}

    def residual(self, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(V,) whitened residual with these effects in the model.

        Args:
            candidates: The effects.
            values: (k,) of their parameters, one after the other.
        """
        residual = self.torque - self.columns @ self.evidence.base_parameters(candidates, values)
        return without_effects(residual, candidates, values, self._effect)

    def _effect(self, candidate: Candidate) -> Stacked:
        effect, constants = candidate.effect, candidate.constants
        # Kept with the effect, so that no other can be at its address.
        kept = self.keep((id(effect), constants), lambda: (effect, stacked_effect(self.scene, effect, constants)))
        return cast(Stacked, kept[1])

    def keep(self, what: object, compute: Callable[[], Any]) -> Any:
        """The result of a computation on this recording, done once.

        Args:
            what: Names the computation; hashable.
            compute: Called where it was not done before.
        """
        if what not in self._kept:
            self._kept[what] = compute()
        return self._kept[what]
