"""`report.html`: one page that needs nothing else, with what a review asks first at the top.

Verdict, figures of merit, torque over time, what the residual depends on, friction, parameters, structure, and
how it was obtained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from ..bayes.updated import REDUCED
from ..dynamics.arm import Arm
from ..estimate.counts import DEFINITION
from ..estimate.identified import GAIN_DEVIATION, Determination, Estimate, Fit, Identified, JointValidation, LackOfFit
from ..forks import each
from ..identification.verdict import FAIR, GOOD
from ..results.provenance import FITTED, VALIDATED
from ..results.store import Result
from ..results.tables import base, by_joint
from . import evidence, figures, result_figures
from .details import Fact, provenance_facts, source_files
from .exports import exports
from .opening import opening
from .pages import render
from .text import NOTHING, listed, number, unit_text

LEAST_P = 0.001
"""Probability under which only that bound is printed; ratio."""
FIGURES = ("over_velocity", "friction", "spectrum", "motion", "masses", "parameters", "correlations")
"""Figures of the page that are one each."""
SOURCES = {FITTED: "Fitted on", VALIDATED: "Validated on"}


class Validated(NamedTuple):
    """A joint's rows in the table of the validation.

    Attributes:
        name: Of the joint.
        fits: Which samples, and the figures over them.
        lack_of_fit: F and its probability, in words.
    """

    name: str
    fits: tuple[tuple[str, Fit], ...]
    lack_of_fit: str


def report_html(result: Result) -> str:
    """The whole page."""
    identified, validation = result.identified, result.validation
    arm, listing = identified.model.model.arm, by_joint(identified)
    signals, correlated = _signals(result), evidence.correlated(identified)
    validated = [
        Validated(name, _fits(joint), _lack_of_fit(joint.lack_of_fit)) for name, joint in validation.joints.items()
    ]
    shares = [fit.relative_rms for joint in validated for _, fit in joint.fits]
    provenance = identified.model.provenance or {}
    drawings = _drawings(result, signals, correlated)  # before `unfit` is asked, which may still be worked out beside
    return render(
        "result.html",
        result=result,
        identified=identified,
        validation=validation,
        opening=opening(identified, validation, result.unfit),
        good=GOOD,
        fair=FAIR,
        validated=validated,
        tested=any(joint.lack_of_fit for joint in validation.joints.values()),
        widest=max((share for share in shares if np.isfinite(share)), default=1.0) or 1.0,
        effort_units=_effort_units(arm),
        above_bandwidth=evidence.above_bandwidth(result),
        signals=signals,
        drawings=drawings,
        defects=evidence.defects(result.runs),
        shown_run=next(iter(evidence.fitted_runs(result)), None),
        reached=evidence.reached(result),
        masses=evidence.masses(identified),
        definition=DEFINITION,
        determinations=list(Determination),
        drawn_joints=list(by_joint(identified, with_base=False)),
        sliding=_sliding(arm),
        listing=listing,
        matrix_rows=_matrix(listing),
        gain_deviation=GAIN_DEVIATION,
        base=base(identified),
        correlated=correlated,
        exports=exports(identified.model, validation),
        moves=sorted(identified.moves, key=lambda move: -abs(move.deviations)),
        reduced=REDUCED,
        choices=sorted(identified.choices, key=lambda choice: (not choice.accepted, -choice.gain)),
        facts=[*_facts(identified), *provenance_facts(provenance, SOURCES)],
        sources=source_files(provenance, SOURCES),
    )


def _sliding(arm: Arm) -> list[str]:
    """Names of the prismatic joints."""
    return [joint.name for joint in arm.joints if not joint.revolute]


def _effort_units(arm: Arm) -> str:
    """Units of a table over all joints, in words: `N·m`, `N`, or `N·m (N for slide)`."""
    sliding = _sliding(arm)
    if not sliding:
        return "N·m"
    return "N" if len(sliding) == len(arm.joints) else f"N·m (N for {listed(sliding)})"


def _fits(joint: JointValidation) -> tuple[tuple[str, Fit], ...]:
    """The rows of a joint's table: which samples, and the figures over them."""
    moves = joint.unfiltered_moving
    return (
        ("moving", joint.moving),
        *((("moving, unfiltered", moves),) if moves is not None else ()),
        ("all", joint.everything),
        ("all, unfiltered", joint.unfiltered),
    )


def _lack_of_fit(lack: LackOfFit | None) -> str:
    """F with its probability; nobody knows a distribution's tail to the hundredth power of ten."""
    if lack is None:
        return NOTHING
    p_value = f"< {LEAST_P}" if lack.p_value < LEAST_P else f"= {number(lack.p_value, 2)}"
    return f"{number(lack.f)} (p {p_value})"


def _signals(result: Result) -> dict[str, figures.JointSignals]:
    """Joint -> its signals in the validation, where there are any."""
    found = {
        joint.name: figures.joint_signals(result.validation.traces, k, joint.revolute)
        for k, joint in enumerate(result.identified.model.model.arm.joints)
    }
    return {name: mine for name, mine in found.items() if mine is not None}


def _drawings(
    result: Result, signals: dict[str, figures.JointSignals], correlated: evidence.Correlated | None
) -> dict[str, Any]:
    """Every figure by its name, None where there is nothing to draw; under `over_time` one for each joint."""
    wanted: dict[str, Callable[[], Markup] | None] = dict.fromkeys(FIGURES)
    identified, validation = result.identified, result.validation
    model, arm = identified.model, identified.model.model.arm
    if signals:
        pose = np.mean(np.concatenate([trace.position for trace in validation.traces if len(trace.time)]), axis=0)
        wanted["over_velocity"] = partial(figures.over_velocity, signals)
        wanted["friction"] = partial(figures.friction, model, signals, pose)
    if validation.spectrum is not None:
        cutoff_hz = identified.bandwidth.cutoff_hz
        wanted["spectrum"] = partial(result_figures.spectrum, validation.spectrum, cutoff_hz, arm)
    if result.runs:
        wanted["motion"] = partial(result_figures.motion, evidence.fitted_runs(result)[0], arm)
    if any(joint.inertial[0] > 0.0 for joint in arm.joints):
        wanted["masses"] = partial(result_figures.masses, identified, evidence.first_posture(result))
    wanted["parameters"] = partial(figures.parameters, identified)
    if correlated is not None and correlated.drawable:
        wanted["correlations"] = partial(result_figures.correlations, correlated.names, correlated.matrix)
    over_time = [partial(figures.over_time, mine, name) for name, mine in signals.items()]
    # Drawing takes longer than identification.
    drawn = each(lambda draw: draw and draw(), [*over_time, *wanted.values()])
    return {"over_time": dict(zip(signals, drawn)), **dict(zip(wanted, drawn[len(over_time) :]))}


def _matrix(listing: Mapping[str, Sequence[Estimate]]) -> list[tuple[str, str, list[Estimate | None]]]:
    """A row for each symbol: the symbol, its unit, and the estimate of each joint; None where a joint has none."""
    cells = {(item.symbol, joint): item for joint, items in listing.items() for item in items}
    rows = []
    for symbol in dict.fromkeys(symbol for symbol, _ in cells):
        mine = [cells.get((symbol, joint)) for joint in listing]
        rows.append((symbol, next((item.unit for item in mine if item and item.unit), ""), mine))
    return rows


def _facts(identified: Identified) -> list[Fact]:
    """Bandwidth, solver, rows, physical consistency and gravity."""
    bandwidth, arm = identified.bandwidth, identified.model.model.arm
    rows = [
        f"{joint.name}: {count} (residual {number(float(sigma))} {unit_text(joint.units.effort)} RMS)"
        for joint, count, sigma in zip(arm.joints, identified.rows, identified.residual_sigma_Nm)
    ]
    gravity = ", ".join(number(float(g), 4) for g in arm.gravity)
    return [
        Fact("bandwidth", f"{number(bandwidth.cutoff_hz)} Hz: {bandwidth.reason}"),
        Fact("solver", identified.solver or "not recorded"),
        Fact("rows fitted", " · ".join(rows)),
        Fact("physical consistency", _consistency(identified.consistency_shift)),
        Fact("gravity", f"({gravity}) m/s² in the base frame"),
    ]


def _consistency(shift: float) -> str:
    if shift == 0.0:
        return "the estimate was physically consistent without the bound"
    return f"imposing it moved no base parameter by more than {number(shift, 2)} of its standard errors"
