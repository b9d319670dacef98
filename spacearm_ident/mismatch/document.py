"""`mismatch.json`: an explanation as the contract has it, for other programs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
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
        "noise_floor_Nm": _by_joint(explanation, explanation.noise_floor_Nm),
        "detectable_Nm": _by_joint(explanation, explanation.detectable_Nm),
        "residual_before_Nm": _by_joint(explanation, explanation.before_Nm),
        "residual_after_Nm": _by_joint(explanation, explanation.after_Nm),
        "residuals_on": explanation.judged_on,
        "findings": [_finding(finding) for finding in explanation.findings],
        "unexplained": [
            {"joints": list(left.joints), "where": left.where, "fraction": _finite(left.fraction)}
            for left in explanation.unexplained
        ],
        "already_in_reference": list(explanation.already_there),
        "reasons": list(explanation.reasons),
        "would_have_seen": [smallest_size(one) for one in explanation.would_have_seen],
        "next_experiment": explanation.next_experiment,
        "model": EXTENDED_MODEL if explanation.model is not None else None,
    }


def smallest_size(one: Detectable) -> dict[str, Any]:
    """What was not found, with the smallest size that would have been, as plain data; null where it is not known."""
    named = {"quantity": one.quantity} if one.quantity else {}
    return {"name": one.name, "joints": list(one.joints), "size": _finite(one.size), "unit": one.unit, **named}


def _by_joint(explanation: Explanation, values: FloatArray) -> dict[str, float | None]:
    return {joint: _finite(value) for joint, value in zip(explanation.joints, values)}


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "joints": list(finding.joints),
        "where": finding.where,
        "equation": finding.equation,
        "parameters": {
            name: {"value": _finite(q.value), "unit": q.unit, "ci95": [_finite(q.low), _finite(q.high)]}
            for name, q in finding.parameters.items()
        },
        "confidence": finding.confidence,
        "visibility": _finite(finding.visibility),
        "alternatives": [
            {"effect": a.effect, "joints": list(a.joints), "score": _finite(a.score), "why_not": a.why_not}
            for a in finding.alternatives
        ],
        "validation": {
            "rms_before_Nm": {joint: _finite(value) for joint, value in finding.before_Nm.items()},
            "rms_after_Nm": {joint: _finite(value) for joint, value in finding.after_Nm.items()},
            "explained_fraction": _finite(finding.explained),
        },
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
