"""The page of a comparison with a simulation: the verdict, the waterfall, each layer's items, the rest, what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..layers.comparison import Comparison
from ..layers.document import replicated_share
from ..layers.item import CONVENTIONS, PARAMETERS, PHYSICS, REST, Item, Layer, Mended, Strayed
from ..results.provenance import FITTED, RECORDED, VALIDATED
from ..simulations import Simulation
from . import layers_figures as figures
from . import mismatch_figures
from .details import fact, recorded, source_table
from .html import captioned, page
from .markup import NOTHING, Markup, breakable, element, join, listed, number, percent, unit_text
from .mismatch_html import card_id, finding_cards, smallest_sizes

TITLES = {
    CONVENTIONS: "Conventions and wiring",
    PARAMETERS: "Parameters that differ",
    PHYSICS: "Physics that the simulation lacks",
    REST: "Remaining residual",
}
KEY = {
    CONVENTIONS: ("prior", "conventions"),
    PARAMETERS: ("predicted", "parameters (hatched)"),
    PHYSICS: ("before", "physics (dotted)"),
    REST: ("residual", "remaining, above the noise"),
}
MOST_ITEMS = 12
"""Items of a layer that are shown at once; the others open on request."""
SOURCES = ((FITTED, "Recordings fitted"), (VALIDATED, "Held-out recordings"))


def comparison_html(
    comparison: Comparison, simulation: Simulation, mended: Mended | None, sources: Mapping[str, Any]
) -> str:
    """The page of a comparison, as HTML.

    Args:
        comparison: The comparison.
        simulation: The simulation that was compared.
        mended: Its file with corrected values; None: there is none.
        sources: Provenance, as from `provenance`.
    """
    title = f"From the simulation to the arm: {simulation.arm.name}"
    judged = f" · validated on {comparison.judged_on}" if comparison.judged_on else ""
    body = join(
        element("h1", title),
        element("p", f"{simulation.source} · {len(comparison.joints)} joints{judged}", class_="quiet"),
        _verdict(comparison, mended),
        *(_glance(comparison) if comparison.fit else ()),
        *(_layer(layer, _with_card(comparison)) for layer in comparison.layers),
        *_cards(comparison, simulation),
        _next(comparison),
        _mended(mended),
        smallest_sizes(comparison.would_have_seen, "Parameters that agree, with the smallest detectable change"),
        _obtained(comparison, sources),
    )
    return page(title, body)


def _verdict(comparison: Comparison, mended: Mended | None) -> Markup:
    if not comparison.fit:
        lines: Iterable[str] = comparison.reasons
        return element(
            "section",
            element("h2", "The data are unfit for a comparison"),
            *(element("p", line) for line in lines),
            class_="verdict unknown",
        )
    before, after = (_relative(comparison, rms) for rms in (comparison.before_Nm, comparison.after_Nm))
    headline = f"The residual of the simulation is {before} of the torque; with all layers {after}"
    sentences = [_layers_sentence(comparison), "Residual RMS over torque RMS, median joint."]
    share = replicated_share(comparison)
    if math.isfinite(share):
        lost = f"; not replicated, and left out: {', '.join(comparison.unconfirmed)}" if comparison.unconfirmed else ""
        sentences.append(
            f"Replicated in the held-out recordings: {percent(share)} of the items that they can test{lost}."
        )
    if mended is not None:
        sentences.append(f"The corrected simulation is {mended.name}, beside this page.")
    items = sum(len(layer.items) for layer in comparison.layers[:3])
    level = "found" if items else "good"
    return element(
        "section", element("h2", headline), *(element("p", line) for line in sentences), class_=f"verdict {level}"
    )


def _relative(comparison: Comparison, rms: np.ndarray) -> str:
    """Median over the joints of RMS over the torque's RMS, in words."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = rms / comparison.torque_Nm
    return percent(float(np.nanmedian(shares)))


def _layers_sentence(comparison: Comparison) -> str:
    parts = []
    for layer in comparison.layers[:3]:
        if layer.items:
            largest = layer.items[0]
            more = f" and {len(layer.items) - 1} more" if len(layer.items) > 1 else ""
            parts.append(f"{TITLES[layer.name].lower()}: {largest.title} at {listed(largest.joints)}{more}")
    return "; ".join(parts).capitalize() + "." if parts else "No significant difference."


def _glance(comparison: Comparison) -> list[Markup | None]:
    """The waterfall, the torque, and the same in figures."""
    marks = (
        element("span", element("span", class_="swatch", style=f"border-color: var(--{role})"), words)
        for role, words in KEY.values()
    )
    torques = figures.torques(comparison)
    lines = (("measured", "measured"), ("before", "simulation (dashed)"), ("after", "corrected simulation"))
    drawn = (
        element("span", element("span", class_="swatch", style=f"border-color: var(--{role})"), words)
        for role, words in lines
    )
    return [
        element("h2", "What each layer removes"),
        element("div", *marks, class_="key"),
        captioned(
            figures.waterfall(comparison),
            "Each bar is the simulation's residual variance at a joint on held-out recordings; grey is noise. The "
            "black line is the ceiling: what a flexible function of positions, velocities and accelerations leaves "
            "beside the simulation's own terms, refitted.",
        ),
        _table(comparison),
        None if torques is None else element("h2", "Torque"),
        None if torques is None else element("div", *drawn, class_="key"),
        None
        if torques is None
        else captioned(
            torques,
            "N·m (N of prismatic joints), the first held-out recording. Gaps: standstill and velocity reversals.",
        ),
    ]


def _table(comparison: Comparison) -> Markup:
    heads = (
        "torque",
        "simulation",
        *(layer.name for layer in comparison.layers[:3]),
        "noise",
        "ceiling",
        "corrected simulation",
    )
    rows = []
    for row, joint in enumerate(comparison.joints):
        values = [
            comparison.torque_Nm[row],
            comparison.before_Nm[row],
            *(layer.after_Nm[row] for layer in comparison.layers[:3]),
            comparison.noise_Nm[row],
            comparison.ceiling_Nm[row],
            comparison.mended_Nm[row],
        ]
        cells = (element("td", number(float(value))) for value in values)
        rows.append(element("tr", element("th", breakable(joint), class_="text", scope="row"), *cells))
    header = element(
        "tr", element("th", "joint", class_="text", scope="col"), *(element("th", head, scope="col") for head in heads)
    )
    table = element("table", element("thead", header), element("tbody", *rows))
    caption = element(
        "p", "Residual RMS on held-out recordings after each layer, N·m (N of prismatic joints).", class_="quiet"
    )
    return element("details", element("summary", "The same in figures"), caption, element("div", table, class_="wide"))


def _with_card(comparison: Comparison) -> frozenset[str]:
    """Anchors of the cards on the page."""
    findings = () if comparison.explanation is None else comparison.explanation.findings
    return frozenset(card_id(finding.effect, finding.joints) for finding in findings)


def _layer(layer: Layer, cards: frozenset[str]) -> Markup:
    shown, hidden = layer.items[:MOST_ITEMS], layer.items[MOST_ITEMS:]
    body: list[Markup | None] = [element("h2", TITLES[layer.name])]
    if not layer.items:
        body.append(element("p", "No significant difference." if layer.name != REST else "None above the noise floor."))
    else:
        body.append(_items(layer.name, shown, cards))
    if hidden:
        words = f"{len(hidden)} more"
        body.append(element("details", element("summary", words), _items(layer.name, hidden, cards)))
    body += [element("p", f"{note[:1].upper()}{note[1:]}.", class_="quiet") for note in layer.notes]
    return join(*body)


def _items(layer: str, items: Iterable[Item], cards: frozenset[str]) -> Markup:
    if layer == REST:
        header = element(
            "tr",
            *(element("th", head, class_="text", scope="col") for head in ("at", "RMS, N·m", "what it depends on")),
        )
        rows = [
            element(
                "tr",
                element("td", listed(item.joints), class_="text"),
                element("td", number(item.value), class_="text"),
                element("td", item.where, class_="text wrap"),
            )
            for item in items
        ]
        return element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide")
    heads = (
        ("what", "text"),
        ("where", "text"),
        ("simulation", None),
        ("arm", None),
        ("95 %", None),
        ("share", None),
        ("replicated", None),
    )
    header = element("tr", *(element("th", head, class_=kind, scope="col") for head, kind in heads))
    body = element("tbody", *(_row(item, cards) for item in items))
    return element("div", element("table", element("thead", header), body), class_="wide")


def _row(item: Item, cards: frozenset[str]) -> Markup:
    unit = unit_text(item.unit)
    interval = f"{number(item.low)} to {number(item.high)}" if math.isfinite(item.low) else NOTHING
    name: object = item.title
    if (anchor := card_id(item.name, item.joints)) in cards:
        name = element("a", item.title, href=f"#{anchor}")
    replicated = {True: "yes", False: "no", None: "not testable"}[item.replicated]
    return element(
        "tr",
        element("th", name, class_="text wrap", scope="row"),
        element("td", _place(item), class_="text wrap"),
        element("td", f"{number(item.was)} {unit}".rstrip() if math.isfinite(item.was) else "absent"),
        element("td", f"{number(item.value)} {unit}".rstrip()),
        element("td", interval),
        element("td", percent(item.share)),
        element("td", replicated),
    )


def _place(item: Item) -> str:
    """Where an item is, with its joints where the words do not name them."""
    named = any(joint in item.where for joint in item.joints)
    return item.where if named or not item.joints else f"{item.where} at {listed(item.joints)}"


def _cards(comparison: Comparison, simulation: Simulation) -> Iterable[Markup]:
    """The cards of the search for physics: equation, parameters, rivals and why not."""
    explanation = comparison.explanation
    if explanation is None or not explanation.findings:
        return ()
    drawn = mismatch_figures.signals(explanation.traces)
    return finding_cards(explanation, simulation.arm, drawn)


def _next(comparison: Comparison) -> Markup | None:
    words = None if comparison.explanation is None else comparison.explanation.next_experiment
    return None if not words else join(element("h2", "Next experiment"), element("p", f"{words}."))


def _mended(mended: Mended | None) -> Markup | None:
    if mended is None:
        return None
    rows = [
        element(
            "tr",
            element("th", breakable(joint), class_="text", scope="row"),
            element("td", number(cost)),
            element("td", percent(cost / mended.torque_Nm[joint]) if mended.torque_Nm[joint] > 0 else NOTHING),
        )
        for joint, cost in mended.cost_Nm.items()
    ]
    heads = (("joint", "text"), ("error, N·m RMS", None), ("of the torque", None))
    header = element("tr", *(element("th", head, class_=kind, scope="col") for head, kind in heads))
    lost = ", ".join(mended.lost) or "nothing"
    return join(
        element("h2", "The corrected simulation"),
        element(
            "p",
            element("code", mended.name),
            f" is the simulation's own file with identified values. Its format cannot represent: {lost}; its "
            "parameters are fitted to minimise the error below. The complete model is extended_model.yaml.",
        ),
        element(
            "div", element("table", element("thead", header), element("tbody", *rows), class_="narrow"), class_="wide"
        ),
        None if mended.closed_loop is None else _closed_loop(*mended.closed_loop),
    )


def _closed_loop(was: Strayed, now: Strayed) -> Markup:
    def added(joint: str) -> tuple[float, ...]:
        return was.feedback_Nm[joint], now.feedback_Nm[joint], was.position[joint], now.position[joint]

    rows = [
        element(
            "tr",
            element("th", breakable(joint), class_="text", scope="row"),
            *(element("td", number(value) if math.isfinite(value) else "unstable") for value in added(joint)),
        )
        for joint in was.position
    ]
    heads = ("feedback, N·m RMS", "corrected", "distance, rad (m) RMS", "corrected")
    header = element(
        "tr",
        element("th", "joint", class_="text", scope="col"),
        *(element("th", head, scope="col") for head in heads),
    )
    return join(
        element("h3", "In closed loop"),
        element(
            "p",
            "Both files, run in MuJoCo under the recorded torque along a held-out motion, with the same slow feedback "
            "on the recorded position: the torque that the feedback adds, and the distance from that position.",
        ),
        element(
            "div", element("table", element("thead", header), element("tbody", *rows), class_="narrow"), class_="wide"
        ),
    )


def _obtained(comparison: Comparison, sources: Mapping[str, Any]) -> Markup:
    known = dict(sources)
    tables = [source_table(known.pop(which, None), title) for which, title in SOURCES]
    facts: list[tuple[str, object]] = [("bandwidth", f"{number(comparison.cutoff_hz)} Hz")]
    facts += recorded(known.pop(RECORDED, None))
    facts += [(str(key).replace("_", " "), fact(value)) for key, value in known.items() if value]
    return join(
        element("h2", "How it was obtained"),
        element("dl", *(element(tag, text) for named in facts for tag, text in zip(("dt", "dd"), named))),
        *tables,
        element(
            "p",
            "Share: part of the simulation's residual variance above the noise, over all joints in units of each one's "
            "torque variance, that returns when this item alone is left as in the simulation. Replicated: estimated "
            "from the held-out recordings by themselves, with the same sign and within 99 % of the errors of both. "
            "Beside this page: mismatch.json has the same for programs, extended_model.yaml the model of all layers.",
            class_="quiet",
        ),
    )
