"""The page of a mismatch: verdict first, then each finding with its evidence, what is left, and what to do next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..mismatch.document import NEXT_RUN
from ..mismatch.finding import DATA_UNFIT, NO_MISMATCH, Alternative, Explanation, Finding, Quantity
from ..results.provenance import FITTED, VALIDATED
from . import mismatch_figures as figures
from .details import Fact, provenance_facts, source_files
from .pages import render
from .text import MINUS, capital, listed, number, whole_percent

UNKNOWN = "unknown"
SURE = ((0.95, "almost certainly"), (0.8, "probably"), (0.5, "perhaps"), (0.0, "possibly"))
"""Confidence from which a name is said so."""
LITTLE = 0.3
"""A finding that removes a smaller share of the held-out residual variance is a hint; ratio."""
SOURCES = {FITTED: "Explained", "reference": "Reference", VALIDATED: "Validated on"}


def mismatch_html(explanation: Explanation, arm: Arm, sources: Mapping[str, Any]) -> str:
    """The page of a mismatch, as HTML.

    Args:
        explanation: The analysis.
        arm: The arm that was analysed.
        sources: Provenance, as from `provenance`.
    """
    drawn = figures.signals(explanation.traces)
    level, headline, sentences = _judged(explanation)
    facts = provenance_facts(sources, SOURCES)
    if explanation.model is not None and explanation.model.cutoff_hz is not None:
        facts.insert(0, Fact("bandwidth", f"{number(explanation.model.cutoff_hz)} Hz"))
    return render(
        "mismatch.html",
        arm=arm,
        explanation=explanation,
        level=level,
        headline=headline,
        sentences=sentences,
        overview=None if explanation.verdict == DATA_UNFIT else figures.overview(explanation),
        glance=_glance(explanation, arm),
        cards=finding_cards(explanation, arm, drawn),
        over_time=None if drawn is None else figures.over_time(explanation.joints, drawn, explanation.noise_floor_Nm),
        next_lines=_next_lines(explanation),
        unexplained=_unexplained(explanation),
        facts=facts,
        sources=source_files(sources, SOURCES),
    )


# --- verdict --------------------------------------------------------------------------------------------------


def _judged(explanation: Explanation) -> tuple[str, str, list[str]]:
    """Level, headline and what follows it."""
    findings = explanation.findings
    if explanation.verdict == DATA_UNFIT:
        return "unknown", "The data are unfit for a comparison", list(explanation.reasons)
    if explanation.verdict == NO_MISMATCH or not findings:
        above = listed([joint for left in explanation.unexplained for joint in left.joints])
        rest = f"A residual slightly above the noise remains at {above}, see below." if above else None
        if explanation.verdict == NO_MISMATCH and len(explanation.compared) < len(explanation.joints):
            headline = f"No mismatch at {listed(explanation.compared)}; nothing is known of the other joints"
            return "fair", headline, [rest] if rest else []
        return "good", "No mismatch: the reference explains the recordings", [rest] if rest else []
    first, more = findings[0], findings[1:]
    headline = f"Mismatch at {_at(first)}: {_name(first.effect)}, {_size(first)}"
    sentences = [_surety(first)]
    if first.unchecked:
        sentences.append(f"{capital(first.unchecked)}.")
    if math.isfinite(first.explained):
        where = "While it lasts" if first.unchecked else f"On {explanation.judged_on or 'held-out data'}"
        sentences.append(
            f"{where} it removes {whole_percent(first.explained)} of the residual variance above the noise floor there."
        )
    if more:
        sentences.append(f"Also found: {'; '.join(f'{_name(other.effect)} at {_at(other)}' for other in more)}.")
    doubtful = any(finding.effect == UNKNOWN or finding.explained < LITTLE for finding in findings)
    return "poor" if first.effect == UNKNOWN else "fair" if doubtful else "found", headline, sentences


def _surety(finding: Finding) -> str:
    if finding.effect == UNKNOWN:
        return f"Where it appears: {finding.where}. No effect of the catalogue explains it as well."
    word = next(word for least, word in SURE if not finding.confidence < least)
    sure = f"{capital(word)} so: {whole_percent(finding.confidence)} confidence"
    sentence = f"{sure}." if finding.where == _name(finding.effect) else f"{sure}: {finding.where}."
    close = [other for other in finding.alternatives if other.effect != UNKNOWN and other.score > 0.9]
    if close:
        return f"{sentence} Nearly indistinguishable in these data: {_name(close[0].effect)}."
    return sentence


def _name(effect: str) -> str:
    """An effect in words."""
    if effect == UNKNOWN:
        return "something that no known effect explains"
    return EFFECTS[effect].words if effect in EFFECTS else effect.replace("_", " ")


def _at(of: Finding | Alternative) -> str:
    return listed(of.joints) or "the whole arm"


def _size(finding: Finding) -> str:
    """The torque it accounts for at the joint where that is largest."""
    sizes = {
        joint: math.sqrt(max(before**2 - finding.after_Nm.get(joint, math.nan) ** 2, 0.0))
        for joint, before in finding.before_Nm.items()
        if math.isfinite(before) and math.isfinite(finding.after_Nm.get(joint, math.nan))
    }
    if not sizes or not max(sizes.values()) > 0:
        return "outside the held-out data" if finding.unchecked else "not visible in the held-out data"
    joint = max(sizes, key=sizes.__getitem__)
    where = f" at {joint}" if len(sizes) > 1 else ""
    return f"{number(sizes[joint], 2)} N·m RMS{where}"


def _glance(explanation: Explanation, arm: Arm) -> list[tuple[str, str, list[float], list[float]]]:
    """Joint, its unit, noise floor and smallest detectable, residual before and after, and these two over the floor."""
    units = {joint.name: "N·m" if joint.revolute else "N" for joint in arm.joints}
    columns = (explanation.noise_floor_Nm, explanation.detectable_Nm, explanation.before_Nm, explanation.after_Nm)
    rows = []
    for joint, *values in zip(explanation.joints, *columns):
        floor, detectable, before, after = map(float, values)
        ratios = [value / floor if floor > 0 else math.nan for value in (before, after)]
        rows.append((joint, units.get(joint, "N·m"), [floor, detectable, before, after], ratios))
    return rows


def _next_lines(explanation: Explanation) -> list[str]:
    """The next experiment, the file that has its motion, and where that was not recorded."""
    if not explanation.next_experiment:
        return []
    lines = [explanation.next_experiment]
    if explanation.next_motion:
        lines.append(f"{NEXT_RUN}, beside this page, is that motion: {explanation.next_motion}")
    return [*lines, *explanation.next_cautions]


# --- findings -------------------------------------------------------------------------------------------------


def finding_cards(explanation: Explanation, arm: Arm, drawn: figures.Signals | None) -> list[dict[str, Any]]:
    """Every finding with what its card shows beside it.

    Args:
        explanation: The analysis.
        arm: The arm, for names and units.
        drawn: Signals of all traces; None: cards without figures.
    """
    return [
        {
            "finding": finding,
            "anchor": card_id(finding.effect, finding.joints),
            "name": _name(finding.effect),
            "at": _at(finding),
            "equation": typeset(finding.equation),
            "sure_of": "that no known effect is the cause" if finding.effect == UNKNOWN else "that the name is right",
            "rms": [
                (joint, before, finding.after_Nm.get(joint, math.nan)) for joint, before in finding.before_Nm.items()
            ],
            "parameters": [(name, one, _may_be_zero(one)) for name, one in finding.parameters.items()],
            "drawing": drawn and figures.dependence(finding, arm, drawn, explanation.noise_floor_Nm),
            "alternatives": [(_name(other.effect), _at(other), other) for other in finding.alternatives],
        }
        for finding in explanation.findings
    ]


def card_id(effect: str, joints: Iterable[str]) -> str:
    """Anchor of a finding's card.

    Args:
        effect: Name of the effect, or of an item of a layer.
        joints: Names of the joints where it acts.

    Returns:
        Letters, digits, `_` and `-` alone; everything else has become `-`.
    """
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join((effect, *joints)))


def _may_be_zero(of: Quantity) -> bool:
    """Whether its interval is known and holds zero."""
    return math.isfinite(of.low) and math.isfinite(of.high) and of.low <= 0.0 <= of.high


_LETTERS = {
    **{"qdd": "q̈", "qd": "q̇", "q_d": "q̇", "tau": "τ", "mu": "μ", "eta": "η", "alpha": "α", "dz/ds": "dz/ds"},
    **{"df": "Δf", "dk": "Δk", "tau_load": "τ_load"},
}
_SIGNS = (("^-1", "⁻¹"), ("^2", "²"), ("^3", "³"), ("^T", "ᵀ"), (" x ", " × "), (" . ", " · "), ("-", MINUS))


def typeset(equation: str) -> str:
    """An equation in plain ASCII with the field's letters and signs: `mu |tau_load| sgn(qd)` with mu, tau, q-dot."""
    text = re.sub(r"[A-Za-z]+", lambda found: _LETTERS.get(found[0], found[0]), equation.replace("q_d", "qd"))
    for plain, sign in _SIGNS:
        text = text.replace(plain, sign)
    return text


def _unexplained(explanation: Explanation) -> list[str]:
    """Sentences on what is left; none where the data are unfit."""
    if explanation.verdict == DATA_UNFIT:
        return []
    if not explanation.unexplained:
        finite = np.isfinite(explanation.after_Nm).any()
        none = "None beyond what a healthy arm may leave."
        return [none if finite else "Not determined: there is no residual on held-out data."]
    return [
        f"{listed(left.joints)}: {whole_percent(left.fraction)} of the remaining variance is above the noise floor; "
        f"{left.where}."
        for left in explanation.unexplained
    ]
