"""The report's last part: which structure was chosen on what evidence, and how the result was obtained."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..bayes.updated import REDUCED
from ..estimate.identified import Identified
from ..results.provenance import EPOCH, FITTED, OPTIONS, RECORDED, VALIDATED
from .markup import Markup, element, join, measured, number, unit_text


def structure(identified: Identified) -> Markup:
    """Terms of the model, and what was considered beyond them."""
    terms = ", ".join(dict.fromkeys(term.words for term in identified.model.model.terms))
    parts: list[object] = [element("h2", "Structure of the model"), element("p", f"Terms: {terms}.")]
    if identified.choices:
        ordered = sorted(identified.choices, key=lambda choice: (not choice.accepted, -choice.gain))
        header = element(
            "tr",
            element("th", "considered", class_="text"),
            element("th", "held-out gain, t"),
            element("th", "", class_="text"),
        )
        rows = [
            element(
                "tr",
                element("td", choice.term, class_="text wrap"),
                element("td", number(choice.gain)),
                element("td", element("strong", "in the model") if choice.accepted else "left out", class_="text"),
                class_=None if choice.accepted else "minor",
            )
            for choice in ordered
        ]
        table = element("table", element("thead", header), element("tbody", *rows))
        parts.append(element("div", table, class_="wide"))
        parts.append(
            element(
                "p",
                "Gain: mean reduction of the squared error on held-out blocks by the term, all refitted, over its "
                "standard error. A term of friction is added where its gain is significant.",
                class_="quiet",
            )
        )
    return join(*parts)


def since_the_prior(identified: Identified) -> Markup | None:
    """What an update moved, the farthest first; nothing without a prior."""
    if not identified.moves:
        return None
    heads = ("", "prior ± sd", "now ± standard error", "moved, sd of the prior", "determined by the data", "unit")
    header = element(
        "tr", *(element("th", head, class_="text" if k in (0, 5) else None) for k, head in enumerate(heads))
    )
    rows = [
        element(
            "tr",
            element("td", move.name, class_="text"),
            element("td", measured(move.before, move.spread)),
            element("td", measured(move.after, move.standard_error)),
            element("td", f"{move.deviations:+.2f}"),
            element("td", f"{move.variance_reduction:.0%}"),
            element("td", unit_text(move.unit), class_="text"),
            class_=None if move.variance_reduction > REDUCED else "minor",
        )
        for move in sorted(identified.moves, key=lambda move: -abs(move.deviations))
    ]
    return join(
        element("h2", "Since the prior"),
        element(
            "p",
            "The prior's standard deviation allows for a change of friction since then. Determined by the data: the "
            "reduction of the prior's variance; grey rows rest on the prior.",
            class_="quiet",
        ),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )


def obtained(identified: Identified) -> Markup:
    """Bandwidth, solver, rows, sources and versions."""
    bandwidth, arm = identified.bandwidth, identified.model.model.arm
    known = dict(identified.model.provenance or {})
    sources = [
        source_table(known.pop(which, None), title)
        for which, title in ((FITTED, "Fitted on"), (VALIDATED, "Validated on"))
    ]
    known.pop(OPTIONS, None)  # the command says it in words
    runs = known.pop(RECORDED, None)
    rows = [
        f"{joint.name}: {count} (residual {number(float(sigma))} {unit_text(joint.units.effort)} RMS)"
        for joint, count, sigma in zip(arm.joints, identified.rows, identified.residual_sigma_Nm)
    ]
    facts: list[tuple[str, object]] = [
        ("bandwidth", f"{number(bandwidth.cutoff_hz)} Hz: {bandwidth.reason}"),
        ("solver", identified.solver or "not recorded"),
        ("rows fitted", " · ".join(rows)),
        ("physical consistency", _consistency(identified.consistency_shift)),
        ("gravity", f"({', '.join(number(float(g), 4) for g in arm.gravity)}) m/s² in the base frame"),
        *recorded(runs),
        *((str(key).replace("_", " "), fact(value)) for key, value in known.items()),
    ]
    return join(
        element("h2", "How it was obtained"),
        element("dl", *(element(tag, text) for fact in facts for tag, text in zip(("dt", "dd"), fact))),
        *sources,
        element(
            "p",
            "Beside this page: model.yaml predicts torque again; parameters.csv and base_parameters.csv hold every "
            "number shown; torque.csv measured and predicted torque over time; "
            "identified.urdf carries the rigid-body part, damping and Coulomb friction; "
            "validation.json the figures of merit.",
            class_="quiet",
        ),
    )


def _consistency(shift: float) -> str:
    if shift == 0.0:
        return "the estimate was physically consistent without the bound"
    return f"imposing it moved no base parameter by more than {number(shift, 2)} of its standard errors"


def recorded(runs: Any) -> tuple[tuple[str, str], ...]:
    """The fact of when runs were recorded, for a page; none where the provenance does not say."""
    return (("recorded, UTC", "; ".join(_when(run) for run in runs)),) if isinstance(runs, list) else ()


def _when(run: Any) -> str:
    """Start and length of a run, and how warm its joints were."""
    known = run if isinstance(run, Mapping) else {}
    start = str(known.get("start", ""))
    when = "no date" if start.startswith(EPOCH) else start[:16].replace("T", " ")
    text = f"{when}, {_plain(known.get('duration_s', ''))} s"
    warm = known.get("temperature_C")
    return text + (f" at {fact(warm)} °C" if isinstance(warm, Mapping) else "")


def fact(value: Any) -> object:
    """A value of the provenance for a page."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, float):
        return number(value, 4)
    return element("code", value)


def _plain(value: Any) -> str:
    """A value inside a sentence: numbers as a person writes them, mappings and lists without their brackets."""
    if isinstance(value, Mapping):
        return " ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return " ".join(map(_plain, value))
    return number(value, 4) if isinstance(value, float) else str(value)


def source_table(sources: Any, title: str) -> Markup | None:
    """A table of files with sizes and checksums; nothing where the provenance does not say."""
    named = [source for source in sources or () if isinstance(source, Mapping)]
    if not named:
        return None
    header = (
        element("th", head, class_=kind) for head, kind in ((title, "text"), ("bytes", None), ("SHA-256", "text"))
    )
    table = element("table", element("thead", element("tr", *header)), element("tbody", *_source_rows(named)))
    return element("div", table, class_="wide")


def _source_rows(sources: Iterable[Mapping[str, Any]]) -> Iterable[Markup]:
    for source in sources:
        yield element(
            "tr",
            element("td", source.get("path", ""), class_="text wrap"),
            element("td", source.get("bytes", "")),
            element("td", element("code", source.get("sha256", "")), class_="text wrap"),
        )
