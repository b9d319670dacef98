"""`mismatch.json`: an explanation as the contract has it, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..arrays import FloatArray
from ..documents import finite
from .finding import Detectable, Explanation, Finding

SCHEMA = "spacearm_ident/mismatch/1"
EXTENDED_MODEL = "extended_model.yaml"
NEXT_RUN = "next_experiment.yaml"
"""An excitation file; beside `mismatch.json` where the next experiment is a motion that this arm can make."""


def to_document(explanation: Explanation) -> dict[str, Any]:
    """Plain data; figures that are not known are null."""
    return {
        "schema": SCHEMA,
        "verdict": explanation.verdict,
        "noise_floor_Nm": by_joint(explanation.joints, explanation.noise_floor_Nm),
        "detectable_Nm": by_joint(explanation.joints, explanation.detectable_Nm),
        "residual_before_Nm": by_joint(explanation.joints, explanation.before_Nm),
        "residual_after_Nm": by_joint(explanation.joints, explanation.after_Nm),
        "residuals_on": explanation.judged_on,
        "findings": [_finding(finding) for finding in explanation.findings],
        "unexplained": [
            {"joints": list(left.joints), "where": left.where, "fraction": finite(left.fraction)}
            for left in explanation.unexplained
        ],
        "already_in_reference": list(explanation.already_there),
        "reasons": list(explanation.reasons),
        "would_have_seen": [smallest_size(one) for one in explanation.would_have_seen],
        "next_experiment": explanation.next_experiment,
        "next_experiment_file": NEXT_RUN if explanation.next_motion else None,
        "next_experiment_motion": explanation.next_motion or None,
        "next_experiment_cautions": list(explanation.next_cautions),
        "model": EXTENDED_MODEL if explanation.model is not None else None,
    }


def smallest_size(one: Detectable) -> dict[str, Any]:
    """What was not found, with the smallest size that would have been, as plain data; null where none would."""
    named = {"quantity": one.quantity} if one.quantity else {}
    return {"name": one.name, "joints": list(one.joints), "size": finite(one.size), "unit": one.unit, **named}


def by_joint(joints: Sequence[str], values: FloatArray) -> dict[str, float | None]:
    """Joint -> its value (n,), as JSON has it: null where it is not known.

    Args:
        joints: Names of the n joints.
        values: (n,) in any unit; NaN and infinite values become null.
    """
    return {joint: finite(value) for joint, value in zip(joints, values)}


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "joints": list(finding.joints),
        "where": finding.where,
        "equation": finding.equation,
        "parameters": {
            name: {"value": finite(q.value), "unit": q.unit, "ci95": [finite(q.low), finite(q.high)]}
            for name, q in finding.parameters.items()
            if q.known  # Else it has neither value nor interval.
        },
        "confidence": finding.confidence,
        "visibility": finite(finding.visibility),
        "unchecked": finding.unchecked or None,
        "remedy": finding.remedy or None,
        "alternatives": [
            {"effect": a.effect, "joints": list(a.joints), "score": finite(a.score), "why_not": a.why_not}
            for a in finding.alternatives
        ],
        "validation": {
            "rms_before_Nm": {joint: finite(value) for joint, value in finding.before_Nm.items()},
            "rms_after_Nm": {joint: finite(value) for joint, value in finding.after_Nm.items()},
            "explained_fraction": finite(finding.explained),
        },
    }
