"""Sections of an identification's page with evidence: bandwidths, spectra, recordings, masses, correlations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..estimate.identified import Determination, Identified
from ..identification.residual_spectrum import share_above
from ..results.recorded_runs import RecordedRun
from ..results.store import Result
from . import result_figures as figures
from .markup import Markup, element, join, measured, number, percent

MOST_PAIRS = 12
"""Pairs of correlated parameters in the table; count."""
MOST_CORRELATED = 60
"""Parameters up to which the matrix of correlations is drawn; beyond, its cells are smaller than a point; count."""
STRONG = 0.9
"""Absolute correlation from which a pair is listed: half of each variance or more comes from the other; ratio."""


def why_two_bandwidths(result: Result) -> Markup | None:
    """A sentence on why the unfiltered residual is larger than the one up to the cut-off of the fit."""
    spectrum, cutoff = result.validation.spectrum, result.identified.bandwidth.cutoff_hz
    if spectrum is None:
        return None
    shares = share_above(spectrum, cutoff)
    known = shares[np.isfinite(shares)]
    if not len(known):
        return None
    above = (
        percent(float(known.min()))
        if len(known) == 1
        else f"{percent(float(known.min()))} to {percent(float(known.max()))}, by joint,"
    )
    return element(
        "p",
        f"Why the two differ: {above} of the unfiltered residual's power lies above {cutoff:.3g} Hz. There the "
        "torque signal holds measurement noise, friction transitions at velocity reversals and vibration, which a "
        "rigid-body model does not predict. The filtered figure measures the model, the unfiltered one the error of "
        "a single torque sample. The spectra below show the frequencies.",
        class_="quiet",
    )


def spectrum(result: Result) -> Iterable[Markup]:
    """The residual's spectrum beside the torque's."""
    known = result.validation.spectrum
    if known is None:
        return
    yield element("h2", "Residual over frequency")
    yield _captioned(
        figures.spectrum(known, result.identified.bandwidth.cutoff_hz, result.identified.model.model.arm),
        "Power spectral density of the unfiltered torque (grey) and of the residual (orange) on the validation data; "
        "dashed: the bandwidth of the fit. Left of it the residual should lie far below the torque; a peak is "
        "an effect at that frequency.",
    )


def recordings(result: Result) -> Markup | None:
    """The motion that was recorded, how far and fast each joint went, and the defects of every recording."""
    if not result.runs:
        return None
    arm = result.identified.model.model.arm
    heads = ("recording", "used for", "duration, s", "rate, Hz", "samples")
    header = element("tr", *(element("th", head, class_="text" if k < 2 else None) for k, head in enumerate(heads)))
    rows = [
        element(
            "tr",
            element("th", run.name, class_="text wrap"),
            element("td", "fit" if run.fitted else "validation", class_="text"),
            *(element("td", number(value, 4)) for value in (run.duration_s, run.rate_hz)),
            element("td", run.samples),
        )
        for run in result.runs
    ]
    first = next((run for run in result.runs if run.fitted), result.runs[0])
    return join(
        element("h2", "Excitation and recordings"),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
        _defects(result.runs),
        _captioned(
            figures.motion(first, arm),
            f"Joint positions in {first.name}; dashed: position limits, where they are near.",
        ),
        _reached(result),
    )


def _defects(runs: Iterable[RecordedRun]) -> Markup:
    lines = [f"{run.name}: {defect}" for run in runs for defect in run.defects]
    if not lines:
        return element("p", "No defects found: no gaps, repeated or backward stamps, missing joints, invalid numbers.")
    return join(
        element("p", "Defects found in the recordings, and what was done about them:"),
        element("ul", *(element("li", f"{line.rstrip('.')}.") for line in lines)),
    )


def _reached(result: Result) -> Markup:
    """Range and largest speed of every joint over the fitted recordings, with the limits they are shares of."""
    arm = result.identified.model.model.arm
    fitted = [run for run in result.runs if run.fitted] or list(result.runs)
    low = np.min([run.position.min(axis=0) for run in fitted], axis=0)
    high = np.max([run.position.max(axis=0) for run in fitted], axis=0)
    speed = np.max([run.largest_speed for run in fitted], axis=0)
    heads = ("joint", "range of the fitted recordings", "share of the joint's range", "largest speed", "of its limit")
    header = element("tr", *(element("th", head, class_=None if k else "text") for k, head in enumerate(heads)))
    rows = []
    for k, joint in enumerate(arm.joints):
        whole = joint.upper - joint.lower
        part = float((high[k] - low[k]) / whole) if np.isfinite(whole) and whole > 0.0 else float("nan")
        of_limit = float(speed[k] / joint.velocity_limit) if joint.velocity_limit > 0.0 else float("nan")
        known = np.isfinite(joint.velocity_limit)
        rows.append(
            element(
                "tr",
                element("th", joint.name, class_="text wrap"),
                element("td", f"{number(float(low[k]))} … {number(float(high[k]))} {joint.units.position}"),
                element("td", percent(part)),
                element("td", f"{number(float(speed[k]))} {joint.units.velocity}"),
                element("td", percent(of_limit if known else float("nan"))),
            )
        )
    return element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide")


def masses_on_the_arm(result: Result) -> Markup | None:
    """Identified against CAD masses, drawn on the arm; nothing where the arm has no CAD masses to compare with."""
    identified = result.identified
    arm = identified.model.model.arm
    if not any(joint.inertial[0] > 0.0 for joint in arm.joints):
        return None
    positions = [trace.position for trace in result.validation.traces if len(trace.time)]
    start = arm.start
    pose = np.concatenate(positions)[0] if positions else np.zeros(len(arm.joints)) if start is None else start
    found = {item.joint: item for item in identified.estimates if item.symbol == "m"}
    words = [
        f"{k} {joint.name} {measured(found[joint.name].value, found[joint.name].standard_error)} kg "
        f"(CAD {number(float(joint.inertial[0]))})"
        for k, joint in enumerate(arm.joints, start=1)
        if joint.name in found
    ]
    return join(
        element("h2", "Masses, identified and CAD"),
        element("p", f"{' · '.join(words)}."),
        _captioned(
            figures.masses(identified, pose),
            "Each link\u2019s mass as a disc at its centre of mass, area by mass. Ring: CAD. Filled blue: determined "
            "by the data; filled grey: known only in a combination with others, at a bound, or from CAD, "
            "and not determined by itself. The arm is drawn in the first posture of the "
            "validation, from the side; numbers as above.",
        ),
    )


def correlated(identified: Identified) -> Markup | None:
    """Correlations between parameters that the data determine, the strongest pairs first."""
    chosen = [
        k
        for k, item in enumerate(identified.estimates)
        if item.determination is Determination.DATA and identified.covariance[k, k] > 0.0
    ]
    if len(chosen) < 2:
        return None
    matrix = figures.correlation(identified.covariance[np.ix_(chosen, chosen)])
    names = [identified.estimates[k].name for k in chosen]
    rows, columns = np.triu_indices(len(chosen), 1)
    order = np.argsort(-np.abs(matrix[rows, columns]))[:MOST_PAIRS]
    strong = [(rows[k], columns[k]) for k in order if abs(matrix[rows[k], columns[k]]) >= STRONG]
    words = (
        f"Pairs with a correlation of {STRONG:g} or more in size: "
        + "; ".join(f"{names[a]} and {names[b]} {number(float(matrix[a, b]), 2)}" for a, b in strong)
        + ". The data determine their combination better than either of them."
        if strong
        else f"No two of the {len(chosen)} parameters that the data determine are correlated by {STRONG:g} or more."
    )
    drawing = figures.correlations(names, matrix) if len(chosen) <= MOST_CORRELATED else None
    return join(
        element("h3", "Correlations"),
        element("p", words),
        drawing
        and element(
            "details",
            element("summary", f"Correlations of the {len(chosen)} parameters that the data determine"),
            _captioned(drawing, "Blue: positive, orange: negative; the area of a square is the size."),
        ),
    )


def _captioned(drawing: Markup, caption: str) -> Markup:
    return element("figure", drawing, element("figcaption", caption))
