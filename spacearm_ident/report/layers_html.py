"""The page of a comparison with a simulation: the verdict, the waterfall, each layer's items, the rest, what to do."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..layers.comparison import Comparison
from ..layers.document import replicated_share
from ..layers.item import CONVENTIONS, PARAMETERS, PHYSICS, REST, Item, Layer, Mended
from ..results.provenance import FITTED, VALIDATED
from ..simulations import Simulation
from . import layers_figures as figures
from . import mismatch_figures
from .details import Fact, provenance_facts, source_files
from .mismatch_html import card_id, finding_cards
from .pages import render
from .text import listed, number, percent

TITLES = {
    CONVENTIONS: "Conventions and wiring",
    PARAMETERS: "Parameters that differ",
    PHYSICS: "Physics that the simulation lacks",
    REST: "Remaining residual",
}
MOST_ITEMS = 12
"""Items of a layer that are shown at once; the others open on request."""
SOURCES = {FITTED: "Recordings fitted", VALIDATED: "Held-out recordings"}


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
    explanation = comparison.explanation
    drawn = None if explanation is None else mismatch_figures.signals(explanation.traces)
    level, headline, sentences = _verdict(comparison, mended)
    cards = [] if explanation is None else finding_cards(explanation, simulation.arm, drawn)
    anchors = {card["anchor"] for card in cards}
    return render(
        "layers.html",
        comparison=comparison,
        simulation=simulation,
        mended=mended,
        level=level,
        headline=headline,
        sentences=sentences,
        waterfall=figures.waterfall(comparison) if comparison.fit else None,
        torques=figures.torques(comparison) if comparison.fit else None,
        layers=[_layer(layer, anchors) for layer in comparison.layers],
        cards=cards,
        facts=[Fact("bandwidth", f"{number(comparison.cutoff_hz)} Hz"), *provenance_facts(sources, SOURCES)],
        sources=source_files(sources, SOURCES),
    )


def _verdict(comparison: Comparison, mended: Mended | None) -> tuple[str, str, Sequence[str]]:
    """Level, headline and what follows it."""
    if not comparison.fit:
        return "unknown", "The data are unfit for a comparison", comparison.reasons
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
    return "found" if any(layer.items for layer in comparison.layers[:3]) else "good", headline, sentences


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


class Row(NamedTuple):
    """A row of a layer's table.

    Attributes:
        item: What differs.
        place: Where, with its joints.
        anchor: Of the card on the page that has more of it; None where there is none.
    """

    item: Item
    place: str
    anchor: str | None


def _layer(layer: Layer, anchors: Container[str]) -> dict[str, Any]:
    """A layer's title, the rows that are shown at once, the others, and notes."""
    found = [(item, card_id(item.name, item.joints)) for item in layer.items]
    rows = [Row(item, _place(item), anchor if anchor in anchors else None) for item, anchor in found]
    return {
        "name": layer.name,
        "title": TITLES[layer.name],
        "shown": rows[:MOST_ITEMS],
        "hidden": rows[MOST_ITEMS:],
        "notes": layer.notes,
    }


def _place(item: Item) -> str:
    """Where an item is, with its joints where the words do not name them."""
    named = any(joint in item.where for joint in item.joints)
    return item.where if named or not item.joints else f"{item.where} at {listed(item.joints)}"
