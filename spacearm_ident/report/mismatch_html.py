"""The page of a mismatch: verdict first, then each finding with its evidence, what is left, and what to do next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..mismatch.document import EXTENDED_MODEL
from ..mismatch.finding import DATA_UNFIT, NO_MISMATCH, Alternative, Detectable, Explanation, Finding, Quantity
from ..results.provenance import FITTED, RECORDED, VALIDATED
from . import mismatch_figures as figures
from .details import fact, recorded, source_table
from .html import captioned, page
from .markup import MINUS, NOTHING, Markup, breakable, element, join, listed, number, unit_text

UNKNOWN = "unknown"
SURE = ((0.95, "almost certainly"), (0.8, "probably"), (0.5, "perhaps"), (0.0, "possibly"))
"""Confidence from which a name is said so."""
LITTLE = 0.3
"""A finding that removes a smaller share of the held-out residual variance is a hint; ratio."""
REFERENCE = "reference"
SOURCES = ((FITTED, "Explained"), (REFERENCE, "Reference"), (VALIDATED, "Validated on"))


def mismatch_html(explanation: Explanation, arm: Arm, sources: Mapping[str, Any]) -> str:
    """The page of a mismatch, as HTML.

    Args:
        explanation: The analysis.
        arm: The arm that was analysed.
        sources: Provenance, as from `provenance`.
    """
    title = f"Mismatch of {arm.name}"
    drawn = figures.signals(explanation.traces)
    judged = f" · validated on {explanation.judged_on}" if explanation.judged_on else ""
    body = join(
        element("h1", title),
        element("p", f"{len(explanation.joints)} joints{judged}", class_="quiet"),
        _verdict(explanation),
        None if explanation.verdict == DATA_UNFIT else _glance(explanation, arm),
        *finding_cards(explanation, arm, drawn),
        None if drawn is None else _over_time(explanation, drawn),
        _unexplained(explanation),
        smallest_sizes(explanation.would_have_seen, "Effects that were not found, with the size that would have been"),
        _listing("In the reference as well", explanation.already_there),
        _listing("Next experiment", [explanation.next_experiment] if explanation.next_experiment else ()),
        _obtained(explanation, sources),
    )
    return page(title, body)


# --- verdict --------------------------------------------------------------------------------------------------


def _verdict(explanation: Explanation) -> Markup:
    level, headline, sentences = _judged(explanation)
    reasons = [] if explanation.verdict == DATA_UNFIT else list(explanation.reasons)
    return join(
        element(
            "section",
            element("h2", headline),
            *(element("p", sentence) for sentence in sentences),
            class_=f"verdict {level}",
        ),
        element("ul", *(element("li", reason) for reason in reasons), class_="warnings") if reasons else None,
    )


def _judged(explanation: Explanation) -> tuple[str, str, list[object]]:
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
    sentences: list[object] = [_surety(first)]
    if math.isfinite(first.explained):
        sentences.append(
            f"On {explanation.judged_on or 'held-out data'} it removes {_rounded(first.explained)} of the residual "
            "variance above the noise floor there."
        )
    if more:
        sentences.append(f"Also found: {'; '.join(f'{_name(other.effect)} at {_at(other)}' for other in more)}.")
    doubtful = any(finding.effect == UNKNOWN or finding.explained < LITTLE for finding in findings)
    return "poor" if first.effect == UNKNOWN else "fair" if doubtful else "found", headline, sentences


def _surety(finding: Finding) -> str:
    if finding.effect == UNKNOWN:
        return f"Where it appears: {finding.where}. No effect of the catalogue explains it as well."
    word = next(word for least, word in SURE if not finding.confidence < least)
    sure = f"{_sentence(word)} so: {_rounded(finding.confidence)} confidence"
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


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}"


def _rounded(share: float) -> str:
    return f"{100 * share:.0f} %" if math.isfinite(share) else NOTHING


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
        return "not visible in the held-out data"
    joint = max(sizes, key=sizes.__getitem__)
    where = f" at {joint}" if len(sizes) > 1 else ""
    return f"{number(sizes[joint], 2)} N·m RMS{where}"


# --- at a glance ----------------------------------------------------------------------------------------------


def _glance(explanation: Explanation, arm: Arm) -> Markup:
    heads = ("healthy (noise floor)", "detectable above", "before", "after", "before / floor", "after / floor")
    rows = []
    columns = (explanation.noise_floor_Nm, explanation.detectable_Nm, explanation.before_Nm, explanation.after_Nm)
    for joint, *values in zip(explanation.joints, *columns):
        floor, detectable, before, after = map(float, values)
        ratios = [value / floor if floor > 0 else math.nan for value in (before, after)]
        unit = "N·m" if joint not in arm.joint_names or arm.joints[arm.joint_names.index(joint)].revolute else "N"
        cells = (*(f"{number(v)} {unit}" if math.isfinite(v) else NOTHING for v in (floor, detectable, before, after)),)
        rows.append(
            element(
                "tr",
                element("th", breakable(joint), class_="text"),
                *(element("td", cell) for cell in (*cells, *(number(ratio, 2) for ratio in ratios))),
            )
        )
    header = element("tr", element("th", "joint", class_="text"), *(element("th", head) for head in heads))
    return join(
        element("h2", "Residual at a glance"),
        colour_key("before", "after"),
        captioned(
            figures.overview(explanation),
            "Residual RMS over the noise floor (1×), on a logarithmic axis; on each bar the residual RMS in N·m (N of "
            "prismatic joints); below the joint the finding. Before: the reference model alone; after: all findings.",
        ),
        element(
            "details",
            element("summary", "The same in figures"),
            element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
        ),
    )


def colour_key(*roles: str) -> Markup:
    """What the colours of a figure stand for."""
    marks = (
        element("span", element("span", class_="swatch", style=f"border-color: var(--{role})"), role) for role in roles
    )
    return element("div", *marks, class_="key")


# --- findings -------------------------------------------------------------------------------------------------


def finding_cards(explanation: Explanation, arm: Arm, drawn: figures.Signals | None) -> Iterable[Markup]:
    """A heading, and a card for each finding with its evidence.

    Args:
        explanation: The analysis; without findings nothing is yielded.
        arm: The arm, for names and units.
        drawn: Signals of all traces; None: cards without figures.
    """
    if not explanation.findings:
        return
    yield element("h2", "Findings")
    for place, finding in enumerate(explanation.findings, start=1):
        drawing = None if drawn is None else figures.dependence(finding, arm, drawn, explanation.noise_floor_Nm)
        yield element(
            "section",
            element(
                "h3",
                f"{place}. {_sentence(_name(finding.effect))}",
                element("small", element("code", finding.effect), f" at {_at(finding)}"),
            ),
            element("p", f"{_sentence(finding.where)}.") if finding.where != _name(finding.effect) else None,
            _facts(finding),
            _parameters(finding.parameters),
            None if drawing is None else captioned(*drawing),
            _alternatives(finding.alternatives),
            class_="card",
            id=card_id(finding.effect, finding.joints),
        )


def card_id(effect: str, joints: Iterable[str]) -> str:
    """Anchor of a finding's card."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join((effect, *joints)))


def _facts(finding: Finding) -> Markup:
    rms = [
        f"{joint} {number(before)} → {number(finding.after_Nm.get(joint, math.nan))}"
        for joint, before in finding.before_Nm.items()
    ]
    facts: list[tuple[str, object]] = [
        ("physics", join(element("code", typeset(finding.equation)), f" · {finding.source}")),
        ("confidence", _meter(finding.confidence, "that the name is right")),
        (
            "explains",
            _meter(finding.explained, "of the residual variance above the noise floor there, on held-out data"),
        ),
        ("RMS without → with it", f"{', '.join(rms) or NOTHING} N·m"),
    ]
    if math.isfinite(finding.visibility):
        facts.append(
            (
                "visibility",
                f"{_rounded(finding.visibility)} of its torque cannot be absorbed by the base model's parameters",
            )
        )
    return element("dl", *(element(tag, text) for named in facts for tag, text in zip(("dt", "dd"), named)))


def _meter(share: float, of: str) -> Markup:
    part = 100 * min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    bar = element("span", element("span", style=f"width: {part:.0f}%"), class_="meter")
    return join(bar, f"{_rounded(share) if math.isfinite(share) else 'not testable'} ", element("small", of))


def _parameters(parameters: Mapping[str, Quantity]) -> Markup | None:
    if not parameters:
        return None
    header = element("tr", element("th", "parameter", class_="text"), *(element("th", h) for h in ("value", "95 %")))
    rows = []
    for name, quantity in parameters.items():
        low, high, unit = quantity.low, quantity.high, unit_text(quantity.unit)
        known = math.isfinite(low) and math.isfinite(high)
        rows.append(
            element(
                "tr",
                element("th", breakable(name), class_="text"),
                element("td", f"{number(quantity.value, 4)} {unit}".rstrip()),
                element("td", f"{number(low, 4)} to {number(high, 4)}" if known else NOTHING),
                class_="minor" if known and low <= 0.0 <= high else None,
            )
        )
    table = element("table", element("thead", header), element("tbody", *rows), class_="narrow")
    return element("div", table, class_="wide")


def _alternatives(others: tuple[Alternative, ...]) -> Markup:
    if not others:
        return element("p", "No other explanation scored close to it.", class_="quiet")
    heads = (("instead", "text"), ("at", "text"), ("score, of this", None), ("why not", "text"))
    header = element("tr", *(element("th", head, class_=kind) for head, kind in heads))
    rows = (
        element(
            "tr",
            element("td", _name(other.effect), " ", element("code", other.effect), class_="text wrap"),
            element("td", _at(other), class_="text"),
            element("td", _rounded(other.score)),
            element("td", other.why_not, class_="text wrap"),
        )
        for other in others
    )
    return element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide")


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


# --- the rest -------------------------------------------------------------------------------------------------


def _over_time(explanation: Explanation, drawn: figures.Signals) -> Markup:
    return join(
        element("h2", "Residual over time"),
        colour_key("before", "after"),
        captioned(
            figures.over_time(explanation.joints, drawn, explanation.noise_floor_Nm),
            "Measured minus predicted torque, N·m (N of prismatic joints), one row per joint; rare peaks are clipped. "
            "Gaps: standstill and samples left out. Band: noise, ± two standard deviations.",
        ),
    )


def _unexplained(explanation: Explanation) -> Markup | None:
    if explanation.verdict == DATA_UNFIT:
        return None
    if not explanation.unexplained:
        finite = np.isfinite(explanation.after_Nm).any()
        what = "None above the noise floor." if finite else "Not determined: there is no residual on held-out data."
        return join(element("h2", "Unexplained residual"), element("p", what))
    return _listing(
        "Unexplained residual",
        [
            f"{listed(left.joints)}: {_rounded(left.fraction)} of the remaining variance is above the noise floor; "
            f"{left.where}."
            for left in explanation.unexplained
        ],
    )


def _few(joints: tuple[str, ...]) -> str:
    """Names of one joint or two, else how many; an effect at no joint is one of the base."""
    return (listed(joints) if len(joints) < 3 else f"{len(joints)} joints together") or "the base"


def smallest_sizes(sizes: Sequence[Detectable], summary: str) -> Markup | None:
    """What was looked at and not found, with the smallest size that would have been; None where there is nothing.

    Args:
        sizes: By effect or parameter, and joints.
        summary: Words over the table.
    """
    if not sizes:
        return None
    rows = [
        element(
            "tr",
            element("th", one.name.replace("_", " "), class_="text", scope="row"),
            element("td", _few(one.joints), class_="text"),
            element("td", one.quantity.replace("_", " "), class_="text") if any(o.quantity for o in sizes) else None,
            element("td", f"{number(one.size)} {unit_text(one.unit)}".rstrip()),
        )
        for one in sizes
    ]
    named = [("value", "text")] if any(one.quantity for one in sizes) else []
    heads = (("not found", "text"), ("at", "text"), *named, ("smallest that would have been detected", None))
    header = element("tr", *(element("th", head, class_=kind, scope="col") for head, kind in heads))
    table = element("table", element("thead", header), element("tbody", *rows), class_="narrow")
    return element("details", element("summary", summary), element("div", table, class_="wide"))


def _listing(title: str, items: Iterable[str]) -> Markup | None:
    lines = list(items)
    if not lines:
        return None
    if len(lines) == 1:
        return join(element("h2", title), element("p", lines[0]))
    return join(element("h2", title), element("ul", *(element("li", line) for line in lines)))


def _obtained(explanation: Explanation, sources: Mapping[str, Any]) -> Markup:
    known = dict(sources)
    tables = [source_table(known.pop(which, None), title) for which, title in SOURCES]
    facts: list[tuple[str, object]] = list(recorded(known.pop(RECORDED, None)))
    facts += [(str(key).replace("_", " "), fact(value)) for key, value in known.items() if value]
    if explanation.model is not None and explanation.model.cutoff_hz is not None:
        facts.insert(0, ("bandwidth", f"{number(explanation.model.cutoff_hz)} Hz"))
    files = "Beside this page: mismatch.json has the same for programs"
    extended = f"; {EXTENDED_MODEL} is the base model with the findings, for simulate and identify"
    return join(
        element("h2", "How it was obtained"),
        element("dl", *(element(tag, text) for named in facts for tag, text in zip(("dt", "dd"), named))),
        *tables,
        element("p", f"{files}{extended if explanation.model is not None else ''}.", class_="quiet"),
    )
