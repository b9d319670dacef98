"""The page of an adaptation: verdict first, why, what moved and by how much, and how it was judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..bayes.adaptation import Adaptation, Change
from ..bayes.adaptation_causes import Cause, causes, reason
from ..estimate.identified import Validation
from ..results.provenance import FITTED, VALIDATED
from . import orbit_figures as figures
from .details import source_table
from .html import captioned, page
from .markup import NOTHING, Markup, breakable, element, join, measured, number, percent, unit_text

MODELS = ("ground, on the ground", "ground, in orbit", "ground, gravity set", "adapted, in orbit")
"""The four validations, in the order in which they are handed about."""
SAID: Mapping[bool | None, str] = {True: "yes", False: "no", None: "not determined"}


def orbit_html(
    adaptation: Adaptation, validations: Sequence[Validation], wanted_r: float, sources: Mapping[str, Any]
) -> str:
    """The page of an adaptation, as HTML.

    Args:
        adaptation: The adapted model, and what changed.
        validations: One for each model, in the order of `MODELS`.
        wanted_r: Correlation R that every joint must exceed.
        sources: Provenance, as from `provenance`.
    """
    arm = adaptation.adapted.model.arm
    title = f"{arm.name}, adapted to orbit"
    warm = adaptation.levels.temperature
    body = join(
        element("h1", title),
        element("p", f"{len(arm.joints)} joints · {len(warm)} runs adapted to", class_="quiet"),
        _verdict(adaptation, validations, wanted_r),
        element("h2", "Why it moved"),
        _causes(causes(adaptation)),
        element("h2", "How well each model predicts"),
        _key(),
        captioned(
            figures.fits(validations, MODELS, wanted_r),
            "On held-out runs of both. R over all samples, in which no "
            "model knows what friction holds at standstill; residual while the joint moves.",
        ),
        _fits(validations),
        element("h2", "Friction over temperature"),
        captioned(
            figures.over_temperature(adaptation),
            "Dots: friction level of each run by itself, alpha left out, with its 95 % interval; line: f_c + alpha "
            "(T − 20 °C) of the adapted model; square: the ground's level.",
        ),
        element("h2", "What moved, and by how much"),
        _changes(adaptation),
        element("h2", "Recordings"),
        source_table(sources.get(FITTED), "Adapted to"),
        source_table(sources.get(VALIDATED), "Judged on"),
    )
    return page(title, body)


def worst(validation: Validation) -> tuple[str, float]:
    """The joint with the smallest R over all samples."""
    joint = min(validation.joints, key=lambda name: validation.joints[name].everything.correlation)
    return joint, validation.joints[joint].everything.correlation


def _verdict(adaptation: Adaptation, validations: Sequence[Validation], wanted_r: float) -> Markup:
    (_, ground), (fallen_at, fallen), (lone_at, lone), (_, adapted) = map(worst, validations)
    good = ground > wanted_r and adapted > wanted_r
    headline = f"{'Adapted' if good else 'Not adapted'}: R is {adapted:.4f} at the worst joint in orbit"
    names = [cause.name for cause in causes(adaptation) if cause.found]
    sentences = (
        f"On the ground it was {ground:.4f}. Wanted: above {wanted_r:g} on every joint, before and after.",
        f"Without adaptation it falls to {fallen:.4f} ({fallen_at}); with gravity set and nothing else, "
        f"to {lone:.4f} ({lone_at}), and the residual of the moving joint is "
        f"{percent(validations[2].joints[lone_at].moving.relative_rms)} of its torque instead of "
        f"{percent(validations[3].joints[lone_at].moving.relative_rms)}.",
        f"At work: {', '.join(names) or 'nothing'}.",
    )
    return element(
        "section",
        element("h2", headline),
        *(element("p", sentence) for sentence in sentences),
        class_=f"verdict {'good' if good else 'poor'}",
    )


def _causes(found: Iterable[Cause]) -> Markup:
    rows = (
        element(
            "tr",
            element("th", cause.name, class_="text"),
            element("td", SAID[cause.found], class_="text"),
            element("td", cause.why, class_="text wrap"),
        )
        for cause in found
    )
    heads = (element("th", head, class_="text") for head in ("cause", "at work", "why that is thought"))
    return element("table", element("thead", element("tr", *heads)), element("tbody", *rows))


def _key() -> Markup:
    marks = (
        element("span", element("span", class_="swatch", style=f"border-color: var(--{role})"), name)
        for name, role in zip(MODELS, figures.ROLES)
    )
    return element("div", *marks, class_="key")


def _fits(validations: Sequence[Validation]) -> Markup:
    rows = []
    for joint in validations[0].joints:
        cells = []
        for validation in validations:
            every, moving = validation.joints[joint].everything, validation.joints[joint].moving
            cells += [f"{every.correlation:.4f}", f"{moving.correlation:.4f}", percent(moving.relative_rms)]
        header = element("th", breakable(joint), class_="text")
        rows.append(element("tr", header, *(element("td", cell) for cell in cells)))
    top = element(
        "tr", element("th", "", class_="text"), *(element("th", name, colspan=3, class_="wrap") for name in MODELS)
    )
    under = [element("th", name) for _ in MODELS for name in ("R", "R moving", "residual")]
    head = element("thead", top, element("tr", element("th", "joint", class_="text"), *under))
    return element("div", element("table", head, element("tbody", *rows)), class_="wide")


def _changes(adaptation: Adaptation) -> Markup:
    heads = ("ground", "orbit", "change", "standard errors")
    header = element(
        "tr",
        element("th", "parameter", class_="text"),
        element("th", "joint", class_="text"),
        *(element("th", head) for head in heads),
        element("th", "thought to be", class_="text"),
    )
    rows = (_row(adaptation, change) for change in adaptation.changes)
    note = element(
        "p",
        "The error of a change includes the uncertainty of the ground model. f_c is the level at 20 °C where alpha is "
        "known. f_b and v_b, which these motions do not show, follow f_c.",
        class_="quiet",
    )
    return join(
        note, element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide")
    )


def _row(adaptation: Adaptation, change: Change) -> Markup:
    before = measured(change.before, change.before_error) if change.before or change.before_error else NOTHING
    cells = (
        before,
        measured(change.after, change.after_error),
        measured(change.change, change.change_error),
        number(change.significance, 2),
    )
    return element(
        "tr",
        element("td", f"{change.symbol}, {unit_text(change.unit)}", class_="text"),
        element("td", change.joint, class_="text"),
        *(element("td", cell) for cell in cells),
        element("td", reason(adaptation, change), class_="text wrap"),
        class_=None if change.moved else "minor",
    )
