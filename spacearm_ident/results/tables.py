"""The machine-readable tables of a result folder: parameters, base parameters and validation figures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ..documents import finite
from ..dynamics.term import Parameter
from ..estimate.counts import counts
from ..estimate.identified import Determination, Estimate, Fit, Identified, Validation
from ..identification.verdict import judge_result
from .provenance import VALIDATED, source_paths

PAPER_SYMBOLS = (
    *("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "J_m", "k_1"),
    *("f_c", "f_b", "v_b", "k_v1", "k_v2", "k_v3"),
)
"""The paper's 18 parameters a joint, in the order of its Table 1."""
ABSENT = "not part of this model"
ROUNDING = 1e-9
"""Size under which a value from CAD is the rounding of a zero; kg, kg m or kg m²."""


def shown_value(item: Estimate) -> float:
    """The value that a page shows: CAD values in a rotated frame differ from zero by rounding."""
    rested = item.determination in (Determination.PRIOR, Determination.FIXED)
    return 0.0 if rested and abs(item.value) < ROUNDING else item.value


def by_joint(identified: Identified, with_base: bool = True) -> dict[str, list[Estimate]]:
    """Joint (then coupling, base link) -> its estimates: the paper's 18 first, then what else the model has.

    A joint always has the paper's 18; one that the model leaves out, such as k_v2 in vacuum, is zero and fixed. The
    base link is there where it was weighed, unless `with_base` is false.

    Args:
        identified: The result.
        with_base: Whether a base link that was weighed is listed.
    """
    known: dict[str, dict[str, Estimate]] = {joint: {} for joint in identified.model.model.arm.joint_names}
    arm_joints = set(known)
    of_base = identified.base_body.estimates if identified.base_body and with_base else ()
    for estimate in (*identified.estimates, *of_base):
        known.setdefault(estimate.joint, {})[estimate.symbol] = estimate
    ordered = {}
    for joint, estimates in known.items():
        paper = PAPER_SYMBOLS if joint in arm_joints else ()
        first = [estimates.get(symbol) or _absent(symbol, joint) for symbol in paper]
        ordered[joint] = first + [item for symbol, item in estimates.items() if symbol not in paper]
    return ordered


def _absent(symbol: str, joint: str) -> Estimate:
    return Estimate(symbol, joint, "", 0.0, math.nan, Determination.FIXED, ABSENT)


def parameters_csv(identified: Identified) -> str:
    """One row a parameter; an empty cell is a number that is not known."""
    return _csv(
        (
            *("name", "joint", "value", "unit", "standard_error", "ci95_low", "ci95_high"),
            *("identifiable", "determined_by", "note"),
            *("torque_gain_error", "ci95_with_gain_low", "ci95_with_gain_high"),
        ),
        (
            (
                *(item.symbol, item.joint, _cell(item.value), item.unit, _cell(item.standard_error)),
                *map(_cell, item.interval),
                "yes" if item.identifiable else "no",
                item.determination.value,
                item.note,
                *map(_cell, (item.gain_error, *item.interval_with_gain)),
            )
            for estimates in by_joint(identified).values()
            for item in estimates
        ),
    )


def base_parameters_csv(identified: Identified) -> str:
    """One row a base parameter, named by what it is made of; before physical consistency is imposed."""
    return _csv(
        ["name", "value", "standard_error", "ci95_low", "ci95_high"],
        ((item.symbol, *map(_cell, (item.value, item.standard_error, *item.interval))) for item in base(identified)),
    )


def base(identified: Identified) -> list[Estimate]:
    """Base parameters as estimates; the symbol is the whole expression, the joint that of its leading parameter."""
    leaders = (identified.model.model.parameters[k] for k in identified.base.independent)
    of_arm = [
        _base_estimate(name, leader, float(value), float(error))
        for name, leader, value, error in zip(
            identified.base.names, leaders, identified.base_values, identified.base_errors
        )
    ]
    return [*(identified.base_body.combined if identified.base_body else ()), *of_arm]


def _base_estimate(name: str, leader: Parameter, value: float, error: float) -> Estimate:
    """A base parameter without a standard error is one whose parameters are all held fixed."""
    known = error > 0.0
    rests = Determination.DATA if known else Determination.FIXED
    return Estimate(name, leader.joint, leader.unit, value, error if known else math.nan, rests)


def torque_csv(identified: Identified, validation: Validation) -> str:
    """Measured and predicted torque of the validation, one row a time: what the page's figures show.

    Signals are low-passed at the bandwidth of the fit. A joint has five columns: position, velocity, measured and
    predicted torque in the units their heads name, and 1 where it moves.

    Args:
        identified: The result, for names and units.
        validation: With the traces.
    """
    joints = identified.model.model.arm.joints
    heads = ["recording", "time_s"]
    for joint in joints:
        turns = joint.revolute
        units = ("rad", "rad_s", "Nm", "Nm") if turns else ("m", "m_s", "N", "N")
        kinds = ("position", "velocity", "measured", "predicted")
        heads += [*(f"{joint.name}_{kind}_{unit}" for kind, unit in zip(kinds, units)), f"{joint.name}_moving"]
    rows = []
    for trace in validation.traces:
        signals = np.stack([trace.position, trace.velocity, trace.measured, trace.predicted], axis=2)
        for time, values, moving in zip(trace.time, signals, trace.moving):
            cells = [trace.source, f"{time:.6f}"]
            for mine, moves in zip(values, moving):
                cells += [*(f"{value:.9g}" for value in mine), str(int(moves))]
            rows.append(cells)
    return _csv(heads, rows)


def validation_dict(identified: Identified, validation: Validation, unfit: Sequence[str] = ()) -> dict[str, Any]:
    """The content of `validation.json`; a figure that does not exist (NaN) is None.

    Args:
        identified: The result.
        validation: Of its model.
        unfit: Why the data are unfit, `ConventionReport.unfit`: then that is the verdict.
    """
    joints = {}
    verdict = judge_result(identified, validation, unfit)
    for name, joint in validation.joints.items():
        lack = joint.lack_of_fit
        judged = verdict.joints.get(name)
        joints[name] = {
            **fit_dict(joint.everything),
            "moving": fit_dict(joint.moving),
            "unfiltered": fit_dict(joint.unfiltered),
            "unfiltered_moving": joint.unfiltered_moving and fit_dict(joint.unfiltered_moving),
            "lack_of_fit": lack and {key: finite(value) for key, value in asdict(lack).items()},
            "verdict": str(judged.level) if judged else None,
            "reasons": list(judged.reasons) if judged else [],
        }
    named = source_paths(identified.model.provenance, VALIDATED)
    return {
        "verdict": str(verdict.level),
        "headline": verdict.headline,
        "reasons": list(verdict.reasons),
        "joints": joints,
        "bags": named or list(dict.fromkeys(trace.source for trace in validation.traces)),
        "on": validation.what,
        "held_out": validation.held_out,
        "bandwidth_hz": finite(identified.bandwidth.cutoff_hz),
        "parameters": counts(identified).as_dict(),
    }


def fit_dict(fit: Fit) -> dict[str, float | None]:
    """The five figures under the names of contracts.md §3."""
    return {
        "rmse_Nm": finite(fit.rmse),
        "mae_Nm": finite(fit.mae),
        "max_Nm": finite(fit.largest),
        "r": finite(fit.correlation),
        "relative_rms": finite(fit.relative_rms),
    }


def _cell(value: float) -> str:
    return repr(float(value)) if math.isfinite(value) else ""


def _csv(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
