"""A finding of `spacearm mismatch`, for tests of what is made of it."""

from __future__ import annotations

from dataclasses import replace

from spacearm_ident.mismatch.finding import Finding


def made_finding(effect: str, *joints: str, **changes: object) -> Finding:
    """Of an effect at joints that removes nearly all of what was left there; `changes` are any other fields."""
    made = Finding(
        effect=effect,
        joints=joints,
        where="throughout",
        equation="",
        source="",
        parameters={},
        confidence=0.9,
        alternatives=(),
        gain=900.0,
        held_out_gain=800.0,
        visibility=0.9,
        before_Nm=dict.fromkeys(joints, 0.71),
        after_Nm=dict.fromkeys(joints, 0.1),
        explained=0.96,
    )
    return replace(made, **changes)  # type: ignore[arg-type]
