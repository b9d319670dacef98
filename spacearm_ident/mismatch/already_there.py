"""Whether the reference shows an effect as well: no change of the arm then, but what the base model always lacked.

Such an effect joins the base, in reference and field alike.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .candidate import refit
from .current_model import CurrentModel
from .evidence import Evidence
from .residuals import unwhitened
from .scored import Scored, penalty
from .stacked import base_columns

SHARED = 0.3
"""An effect that explains this share as much in the reference, row for row, was there before; so was one that explains
this share of what it does in the field with the parameters that the reference shows, where that excites it less."""


def was_there_before(winner: Scored, current: CurrentModel) -> bool:
    """Whether the reference shows the same as the field does; false where there is no reference.

    Args:
        winner: The effect that is to be accepted, scored beside the current model.
        current: That model.
    """
    reference = current.evidence.reference
    if reference is None:
        return False
    effect, healthy = winner.candidate.effect, current.evidence.healthy
    alone = refit([healthy.candidate(effect, winner.candidate.constants)])
    gain = alone.gain - penalty(effect, len(reference))
    if gain <= 0.5 * current.gate:
        return False
    alike = gain / len(reference) > SHARED * winner.gain / current.evidence.rows
    return alike or _gain_at(winner, alone.values, current) > SHARED * winner.gain


def _gain_at(winner: Scored, values: FloatArray, current: CurrentModel) -> float:
    """Drop in chi-square of an effect with given parameters (k,), beside what is accepted and the base refitted."""
    fitted = refit([*current.accepted, winner.candidate])
    off = values - fitted.values[-len(values) :]
    own = fitted.covariance[-len(values) :, -len(values) :]
    return winner.gain - float(off @ np.linalg.pinv(own, hermitian=True) @ off)


def with_shared(winner: Scored, current: CurrentModel) -> Evidence | None:
    """The evidence with an effect that reference and field share in its base, everything refitted.

    None where the reference's torque at its joints is then fitted worse, every row counted alike: the effect has
    followed what is not its own.

    Args:
        winner: The effect, with the constants that it has in the field.
        current: What it was scored beside.
    """
    old = current.evidence
    shared = [*old.common, (winner.candidate.effect, winner.candidate.constants)]
    new = Evidence(old.base, old.field, old.reference, shared)
    joints = current.acts_on(winner.candidate)
    acts = [name in joints for name in old.base.model.arm.joint_names]
    worse = _left_of_reference(new)[acts].sum() > _left_of_reference(old)[acts].sum()
    return None if worse else new


def _left_of_reference(evidence: Evidence) -> FloatArray:
    """(n,) sum of squares that the base, with what it shares, leaves of the reference by joint, N²·m²."""
    assert evidence.reference is not None
    scene = unwhitened(evidence.base, evidence.reference)
    fitted = evidence.healthy.base_parameters([], np.zeros(0))
    return scene.by_joint((scene.torque() - base_columns(evidence.base, scene, evidence.common) @ fitted) ** 2)
