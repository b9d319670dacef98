"""Calibration of confidence: how often a finding's name was right in blind trials, by what stands beside it.

A weight among the explanations that were compared says nothing of those that were not. Beside a second finding at the
same joint a name is often that of a law which is nearly the one at work, and what is then left is called `unknown`
though the catalogue has its cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

from .finding import Finding
from .rivals import UNKNOWN


class Situation(Enum):
    """What a finding is and what stands beside it at its joints."""

    NAMED_ALONE = "an effect, and no other finding at its joints"
    NAMED_BESIDE = "an effect, and another finding at its joints"
    UNKNOWN_ALONE = "`unknown`, and no effect at its joints"
    UNKNOWN_BESIDE = "`unknown`, and an effect at its joints"


RIGHT = {
    Situation.NAMED_ALONE: 0.91,
    Situation.NAMED_BESIDE: 0.58,
    Situation.UNKNOWN_ALONE: 0.57,
    Situation.UNKNOWN_BESIDE: 0.18,
}
"""Share of findings whose name was right, divided by their mean weight: 200 blind trials with a healthy reference
(`bench/reliability.py`; names of the same torque count as right)."""


def situations(places: Sequence[tuple[str, Sequence[str]]]) -> list[Situation]:
    """The situation of every finding among the others.

    Args:
        places: Name and joints of each.
    """
    found = []
    for number, (effect, joints) in enumerate(places):
        others = (*places[:number], *places[number + 1 :])
        beside = {name for name, where in others if not set(where).isdisjoint(joints)}
        if effect == UNKNOWN:
            found.append(Situation.UNKNOWN_BESIDE if beside - {UNKNOWN} else Situation.UNKNOWN_ALONE)
        else:
            found.append(Situation.NAMED_BESIDE if beside else Situation.NAMED_ALONE)
    return found


def calibrated(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Findings, their weight among the explanations that were compared made the share of such findings that are right.

    Args:
        findings: All findings of a comparison with a healthy reference; `confidence` is a weight, 0..1.
    """
    where = situations([(one.effect, one.joints) for one in findings])
    return tuple(replace(one, confidence=one.confidence * RIGHT[own]) for one, own in zip(findings, where))
