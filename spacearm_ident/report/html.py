"""`report.html`: one page that needs nothing else, with what a review asks first at the top.

Verdict, figures of merit, torque over time, what the residual depends on, friction, parameters, structure, and
how it was obtained.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, partial
from importlib import resources

import numpy as np

from ..dynamics.arm import Arm
from ..estimate.counts import DEFINITION
from ..estimate.identified import Fit, Identified, JointValidation
from ..forks import each
from ..identification.verdict import FAIR, GOOD
from ..results.store import Result
from ..results.tables import base, by_joint
from . import figures
from .details import obtained, since_the_prior, structure
from .evidence_sections import correlated, masses_on_the_arm, recordings, spectrum, why_two_bandwidths
from .exports import exports
from .markup import NOTHING, Markup, breakable, element, join, listed, number, percent
from .opening import Opening, opening
from .parameter_tables import base_table, determination_key, matrix, whole_list

LEAST_P = 0.001
"""Probability under which only that bound is printed; ratio."""
SECURITY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""The page may not load anything, whatever text found its way into it."""


def report_html(result: Result) -> str:
    """The whole page."""
    identified, validation = result.identified, result.validation
    arm = identified.model.model.arm
    title = f"Identified dynamics of {arm.name}"
    sections: list[Callable[[], Markup | None]] = [
        lambda: _verdict(opening(identified, validation)),
        lambda: _validation(result),
        *_signals(result),
        lambda: join(*spectrum(result)),
        lambda: recordings(result),
        lambda: _parameters(result),
        lambda: exports(identified.model, validation),
        lambda: since_the_prior(identified),
        lambda: structure(identified),
        lambda: obtained(identified),
    ]
    body = join(
        element("h1", title),
        element("p", f"{len(arm.joints)} joints · written {_date(result.written)}", class_="quiet"),
        # Drawing takes longer than identification.
        *each(lambda section: section(), sections),
    )
    return page(title, body)


def page(title: str, body: Markup) -> str:
    """A whole document around a body, in the look of every report and unable to load anything.

    Args:
        title: Shown by the browser.
        body: Inside `<main>`.
    """
    head = join(
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=SECURITY),
        element("title", title),
        element("style", Markup(_style_sheet())),
    )
    whole = element("html", element("head", head), element("body", element("main", body)), lang="en")
    return f"<!DOCTYPE html>\n{whole}\n"


@cache
def _style_sheet() -> str:
    return resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")


def _date(written: str) -> str:
    """`2025-01-31 12:05 UTC` of an ISO 8601 time in UTC."""
    return f"{written[:10]} {written[11:16]} UTC"


def _verdict(first: Opening) -> Markup:
    verdict = first.verdict
    box = element(
        "section",
        element("h2", verdict.headline),
        element("ul", *(element("li", f"{reason}.") for reason in verdict.reasons)) if verdict.reasons else None,
        *(element("p", sentence) for sentence in first.sentences),
        class_=f"verdict {verdict.level}",
    )
    warnings = element("ul", *(element("li", text) for text in first.warnings), class_="warnings")
    return join(
        box,
        warnings if first.warnings else None,
        *(element("p", f"Note: {note.rstrip('.')}.", class_="quiet") for note in first.notes),
        element(
            "p",
            f"Good: the worst joint's residual is at most {100 * GOOD:g} % of its torque (RMS) while it moves; "
            f"fair: at most {100 * FAIR:g} %. Suspect: physically impossible, however well it fits.",
            class_="quiet",
        ),
    )


def _validation(result: Result) -> Markup:
    joints = result.validation.joints
    if not joints:
        return join(element("h2", "Validation"), element("p", "No joint was validated."))
    tested = any(joint.lack_of_fit for joint in joints.values())
    names = ["rows", "RMSE", "MAE", "max", "R", "residual / torque"]
    unit = _effort_units(result.identified.model.model.arm)
    heads = [element("th", name) for name in (*names, *(["lack of fit F"] if tested else []))]
    shares = [fit.relative_rms for joint in joints.values() for _, fit in _kinds(joint)]
    widest = max((share for share in shares if np.isfinite(share)), default=1.0) or 1.0
    header = element("tr", element("th", "joint", class_="text"), element("th", "samples", class_="text"), *heads)
    return join(
        element("h2", "Validation"),
        element(
            "p",
            f"Torque and prediction are compared up to {result.identified.bandwidth.cutoff_hz:.3g} Hz, the "
            "bandwidth of the fit, and as recorded (unfiltered). RMSE, MAE and maximum in "
            f"{unit}. At standstill static friction takes any value up to its limit, which no friction model predicts: "
            f"the residual is large there. All bars have one scale: a full cell is {percent(widest)}.",
            class_="quiet",
        ),
        why_two_bandwidths(result),
        element(
            "div",
            element("table", element("thead", header), *(_joint_rows(n, j, widest, tested) for n, j in joints.items())),
            class_="wide",
        ),
        element(
            "p",
            "Lack of fit: mean square of the residual that repeats from period to period over that of the scatter "
            "between periods; near 1 for a complete model.",
            class_="quiet",
        )
        if tested
        else None,
    )


def _effort_units(arm: Arm) -> str:
    """Units of a table over all joints, in words: `N·m`, `N`, or `N·m (N for slide)`."""
    sliding = [joint.name for joint in arm.joints if not joint.revolute]
    if not sliding:
        return "N·m"
    return "N" if len(sliding) == len(arm.joints) else f"N·m (N for {listed(sliding)})"


def _joint_rows(name: str, joint: JointValidation, widest: float, tested: bool) -> Markup:
    lack = joint.lack_of_fit
    text = NOTHING if lack is None else f"{number(lack.f)} (p {_p_value(lack.p_value)})"
    kinds = _kinds(joint)
    rows = []
    for k, (kind, fit) in enumerate(kinds):
        cells = [element("td", value) for value in (fit.rows, *map(number, (fit.rmse, fit.mae, fit.largest)))]
        cells.append(element("td", f"{fit.correlation:.4f}" if np.isfinite(fit.correlation) else NOTHING))
        part = 100 * min(1.0, fit.relative_rms / widest) if np.isfinite(fit.relative_rms) else 0.0
        cells.append(element("td", percent(fit.relative_rms), class_="share", style=f"--part: {part:.0f}%"))
        first = element("th", breakable(name), class_="text", rowspan=len(kinds)) if k == 0 else None
        last = element("td", text, rowspan=len(kinds)) if tested and k == 0 else None
        rows.append(
            element(
                "tr",
                first,
                element("td", kind, class_="text"),
                *cells,
                last,
                class_="minor" if "unfiltered" in kind else None,
            )
        )
    return element("tbody", *rows, class_="group")


def _kinds(joint: JointValidation) -> tuple[tuple[str, Fit], ...]:
    """The rows of a joint's table: which samples, and the figures over them."""
    moves = joint.unfiltered_moving
    return (
        ("moving", joint.moving),
        *((("moving, unfiltered", moves),) if moves is not None else ()),
        ("all", joint.everything),
        ("all, unfiltered", joint.unfiltered),
    )


def _p_value(value: float) -> str:
    """As a person writes it: nobody knows a distribution's tail to the hundredth power of ten."""
    return f"< {LEAST_P}" if value < LEAST_P else f"= {number(value, 2)}"


def _signals(result: Result) -> Iterable[Callable[[], Markup]]:
    """Every figure that is drawn from the validation's signals, to be drawn."""
    model, validation = result.identified.model, result.validation
    names, joints = model.model.arm.joint_names, model.model.arm.joints
    found = {
        name: figures.joint_signals(validation.traces, k, joint.revolute)
        for k, (name, joint) in enumerate(zip(names, joints))
    }
    signals = {name: mine for name, mine in found.items() if mine is not None}
    if not signals:
        return
    yield _key
    for name, mine in signals.items():
        yield partial(_over_time, name, mine, validation.joints.get(name))
    yield lambda: join(
        element("h2", "Residual over velocity"),
        captioned(
            figures.over_velocity(signals),
            "Blue: the joint moves; grey: it is at rest. Line: mean over ranges of equally many moving samples. "
            "Where it differs from zero, the model lacks a friction term.",
        ),
    )
    pose = np.mean(np.concatenate([trace.position for trace in validation.traces if len(trace.time)]), axis=0)
    yield lambda: join(
        element("h2", "Friction"),
        captioned(
            figures.friction(model, signals, pose),
            "Line: the model's friction in steady motion, in the mean pose of the recording. Dots: the same plus the "
            "residual, which is the measured torque minus all other terms of the model, while the joint moves.",
        ),
    )


def _key() -> Markup:
    """Heading of the torques over time, and what their colours mean."""
    swatches = (
        element("span", element("span", class_="swatch", style=f"border-color: var(--{role})"), role)
        for role in ("measured", "predicted", "residual")
    )
    standstill = element("span", element("span", class_="swatch block"), "standstill")
    return join(element("h2", "Torque over time"), element("div", *swatches, standstill, class_="key"))


def _over_time(name: str, signals: figures.JointSignals, joint: JointValidation | None) -> Markup:
    """One joint's torques over time."""
    small = joint and element(
        "small",
        f"residual {number(joint.everything.rmse)} {signals.torque_unit} RMS, "
        f"{percent(joint.everything.relative_rms)} of the torque ({percent(joint.moving.relative_rms)} moving)",
    )
    heading = element("h3", breakable(name), small)
    return element("section", heading, figures.over_time(signals, name), class_="joint")


def captioned(drawing: Markup, caption: str) -> Markup:
    """A figure with its caption.

    Args:
        drawing: An `<svg>`.
        caption: Plain text.
    """
    return element("figure", drawing, element("figcaption", caption))


def _slide_units(identified: Identified) -> str:
    """What the units of prismatic joints are in a figure whose panels are labelled with those of revolute ones."""
    sliding = [joint.name for joint in identified.model.model.arm.joints if not joint.revolute]
    return f" Prismatic, with m in place of rad and N in place of N·m: {listed(sliding)}." if sliding else ""


def _parameters(result: Result) -> Markup:
    identified = result.identified
    key = [f"{place} {joint}" for place, joint in enumerate(by_joint(identified, with_base=False), start=1)]
    return join(
        masses_on_the_arm(result),
        element("h2", "Parameters"),
        element("p", DEFINITION, class_="quiet"),
        determination_key(),
        captioned(
            figures.parameters(identified),
            f"Values with their 95 % intervals, where the data determine one. {' · '.join(key)}."
            f"{_slide_units(identified)}",
        ),
        element("h3", "Values ± standard errors"),
        matrix(identified),
        element("details", element("summary", "Every parameter with its interval"), whole_list(identified)),
        element(
            "details",
            element("summary", f"{len(base(identified))} base parameters, the combinations that motion can reveal"),
            base_table(identified),
        ),
        correlated(identified),
    )
