"""`mismatch.json` of a comparison with a simulation, as contracts.md §4 has it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..documents import finite
from ..mismatch.document import EXTENDED_MODEL, by_joint, smallest_size, to_document
from ..mismatch.finding import DATA_UNFIT, MISMATCH, NO_MISMATCH, unfit
from .comparison import Comparison
from .item import Item, Layer, Mended


def comparison_document(comparison: Comparison, simulation: str, mended: Mended | None) -> dict[str, Any]:
    """Plain data; figures that are not known are null.

    Args:
        comparison: The answer.
        simulation: Name of the simulation's file.
        mended: The mended file beside the document, if there is one.
    """
    joints = comparison.joints
    explanation = comparison.explanation or unfit(joints, comparison.reasons)
    document = to_document(explanation)
    document |= {
        "verdict": verdict(comparison),
        "reasons": list(comparison.reasons),
        "noise_floor_Nm": by_joint(joints, comparison.noise_Nm),
        "residual_before_Nm": by_joint(joints, comparison.before_Nm),
        "residual_after_Nm": by_joint(joints, comparison.after_Nm),
        "torque_Nm": by_joint(joints, comparison.torque_Nm),
        "residuals_on": comparison.judged_on,
        "simulation": simulation,
        "layers": [_layer(layer, joints) for layer in comparison.layers],
        "ceiling_Nm": by_joint(joints, comparison.ceiling_Nm),
        "mended_Nm": by_joint(joints, comparison.mended_Nm),
        "would_have_seen": [smallest_size(one) for one in comparison.would_have_seen],
        "suspected": [
            {"names": list(one.names), "values": list(one.values), "probability": round(one.probability, 4)}
            for one in comparison.suspected
        ],
        "replicated_share": finite(replicated_share(comparison)),
        "unconfirmed": list(comparison.unconfirmed),
        "model": EXTENDED_MODEL if comparison.model is not None else None,
        "mended_simulation": None if mended is None else mended.name,
        "closed_loop": None if mended is None else _closed_loop(mended),
    }
    return document


def verdict(comparison: Comparison) -> str:
    """One of the contract's three."""
    if not comparison.fit:
        return DATA_UNFIT
    return MISMATCH if any(layer.items for layer in comparison.layers) else NO_MISMATCH


def replicated_share(comparison: Comparison) -> float:
    """Share of what was found that the held-out recordings confirm, of what they can confirm; NaN where nothing."""
    asked = [item.replicated for layer in comparison.layers for item in layer.items if item.replicated is not None]
    count = len(asked) + len(comparison.unconfirmed)
    return sum(asked) / count if count else float("nan")


def _layer(layer: Layer, joints: Sequence[str]) -> dict[str, Any]:
    return {
        "layer": layer.name,
        "joints": {
            joint: {"rms_before_Nm": finite(before), "rms_after_Nm": finite(after)}
            for joint, before, after in zip(joints, layer.before_Nm, layer.after_Nm)
        },
        "items": [_item(item) for item in layer.items],
        "notes": list(layer.notes),
    }


def _item(item: Item) -> dict[str, Any]:
    return {
        "name": item.name,
        "joints": list(item.joints),
        "where": item.where,
        "was": finite(item.was),
        "is": finite(item.value),
        "unit": item.unit,
        "ci95": [finite(item.low), finite(item.high)],
        "share": finite(item.share),
        "replicated": item.replicated,
        "combination": dict(item.combination),
        "equivalents": list(item.equivalents),
    }


def _closed_loop(mended: Mended) -> dict[str, Any] | None:
    if mended.closed_loop is None:
        return None
    return {
        name: {
            "position_rms": {joint: finite(value) for joint, value in run.position.items()},
            "feedback_rms_Nm": {joint: finite(value) for joint, value in run.feedback_Nm.items()},
        }
        for name, run in zip(("simulation", "mended"), mended.closed_loop)
    }
