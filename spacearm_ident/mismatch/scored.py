"""A candidate's score: what it explains, less what its freedom costs; and measures of where and when it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect
from .candidate import Candidate
from .rivals import UNKNOWN
from .scene import Scene

TEMPER, TEMPER_SHARE = 10.0, 0.01
"""Score differences are worth less than chi-square says: neither the noise nor any law is quite what its model is. A
difference of one in the exponent is this much, and this share of the score, together."""
RARER = 20.0
"""How many times rarer than a change of the level of friction is what that may be taken for (`Effect.imitated_by`): the
level differs by several per cent between any two days, what friction depends on does not. In `bench/blind_series`,
seeds 13 to 16, the level had 0.33 to 0.77 of the score of those that were true; on healthy arms of another's writing
with friction of other days 0.90 to 1 of those that were false (docs/mismatch.md). Chosen."""
FELT = 0.05
"""A joint feels an effect that adds this share of the energy there that it does at the joint that feels it most."""
NOT_EXCITED, HALF, PLAIN = 0.2, 0.5, 1.0
"""An effect is not excited in the held-out rows if its law predicts less than this share of its field chi-square there,
half of what it predicts is seen, and it is as large in the field as the noise."""
PARTS, BEST = 12, 2
"""Of so many equal parts of the time, the best of an effect that are not counted where it is asked whether it lasts."""


@dataclass(frozen=True)
class Scored:
    """A candidate beside those accepted.

    Attributes:
        candidate: Effect and constants.
        gain: Drop in chi-square on field and reference.
        held_out: Drop on the recordings not fitted (0 where there are none).
        score: Both, less the penalty.
        plausible: Whether its values are such as this physics has.
        not_excited: Whether the held-out recordings do not excite it.
    """

    candidate: Candidate
    gain: float
    held_out: float
    score: float
    plausible: bool
    not_excited: bool = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Where it acts."""
        return self.candidate.effect.joints

    @property
    def named(self) -> bool:
        """Whether it is an effect of the catalogue."""
        return self.candidate.effect.kind != UNKNOWN


def freedom(effect: Effect) -> int:
    """How many numbers of an effect are fitted."""
    return (
        sum(not parameter.held for parameter in effect.parameters) + len(effect.per_recording) + len(effect.constants)
    )


def penalty(effect: Effect, rows: int) -> float:
    """What freedom costs, in chi-square: ln N a parameter (BIC), and as much a constant and its grid.

    Args:
        effect: A candidate; its `freedom` counts fitted parameters, per-recording parameters and constants.
        rows: N, rows that the candidate is scored on.

    Returns:
        freedom · ln N, and for each constant 2 ln G more, with G the values on its grid.
    """
    searched = sum(2 * np.log(len(constant.grid)) for constant in effect.constants)
    return float(freedom(effect) * np.log(rows) + searched)


def plausible(candidate: Candidate, values: FloatArray, coulomb: Mapping[str, float]) -> bool:
    """Whether values lie within their physical bounds and outside the deviation of healthy joints.

    Args:
        candidate: Effect with its constants.
        values: (k,) its parameters.
        coulomb: Joint -> Coulomb friction, N·m.
    """
    effect, constants = candidate.effect, candidate.constants
    for parameter, value in zip(effect.parameters, values):
        if not parameter.lower <= value <= parameter.upper or not np.isfinite(value):
            return False
    possible = effect.plausible(values, constants) and effect.is_within(values, coulomb)
    return possible and not effect.within_healthy_range(values, constants, coulomb)


def exponent(one: Scored, other: Scored) -> float:
    """How much likelier one explanation is than another: the logarithm of their odds, of scores and base rates.

    Args:
        one: Scored beside the same model as the other.
        other: The same; the doubt is of its score.
    """
    kinds = one.candidate.effect, other.candidate.effect
    rarer = float(np.log(RARER)) * ((kinds[1].imitated_by == kinds[0].kind) - (kinds[0].imitated_by == kinds[1].kind))
    return (one.score - other.score) / (TEMPER + TEMPER_SHARE * other.score) + rarer


def feels(energy: FloatArray) -> np.ndarray:
    """(n,) whether a joint feels an effect of this energy (n,) by joint."""
    return np.asarray(energy > FELT * energy.max())


def is_not_excited(gain: float, active_gain: float, drop: float, foretold: float, rows: int) -> bool:
    """Whether the held-out rows do not excite an effect: its law says so, they agree, and in the field it is plain.

    Args:
        gain: Drop in chi-square a field row.
        active_gain: The same, of those rows alone in which it acts.
        drop: Drop in chi-square of all held-out rows.
        foretold: What it would be, were the law right with these values: a change e of the whitened torque lowers
            chi-square by e^2 then, give or take 2 |e|.
        rows: How many held-out ones.
    """
    agrees = drop >= HALF * foretold - 2.0 * np.sqrt(foretold)
    return bool(foretold < NOT_EXCITED * gain * rows and agrees and active_gain > PLAIN)


def throughout(scene: Scene, without: FloatArray, beside: FloatArray) -> float:
    """Drop in chi-square from one residual to another, without the `BEST` of `PARTS` equal parts of the time.

    Args:
        scene: Rows of both residuals.
        without: (R,) whitened residual without the effect.
        beside: (R,) whitened residual with it.
    """
    part = scene.part(PARTS)
    drops = np.bincount(part, weights=without**2 - beside**2, minlength=PARTS)
    return float(np.sort(drops)[:-BEST].sum())
