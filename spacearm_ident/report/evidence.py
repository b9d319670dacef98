"""Evidence on an identification's page: bandwidths, recordings, masses, correlations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Units
from ..estimate.identified import Determination, Identified
from ..identification.residual_spectrum import share_above
from ..results.recorded_runs import RecordedRun
from ..results.store import Result
from .result_figures import correlation
from .text import measured, number, percent

MOST_PAIRS = 12
"""Pairs of correlated parameters in the table; count."""
MOST_CORRELATED = 60
"""Parameters up to which the matrix of correlations is drawn; beyond, its cells are smaller than a point; count."""
STRONG = 0.9
"""Absolute correlation from which a pair is listed: half of each variance or more comes from the other; ratio."""


@dataclass(frozen=True)
class Reached:
    """How far and how fast a joint went in the fitted recordings.

    Attributes:
        name: Of the joint.
        units: Of its position and velocity.
        low, high: Range of its position.
        part_of_range: Of the range between its limits; NaN where they are not known.
        speed: Largest speed.
        part_of_limit: Of its velocity limit; NaN where that is not known.
    """

    name: str
    units: Units
    low: float
    high: float
    part_of_range: float
    speed: float
    part_of_limit: float


@dataclass(frozen=True)
class Correlated:
    """Correlations between the parameters that the data determine.

    Attributes:
        names: Of the parameters.
        matrix: (k, k) correlations.
        words: The strongest pairs, in a sentence.
    """

    names: list[str]
    matrix: FloatArray
    words: str

    @property
    def drawable(self) -> bool:
        """Whether the cells of a matrix on the page are large enough to be seen."""
        return len(self.names) <= MOST_CORRELATED


def above_bandwidth(result: Result) -> str | None:
    """Share of the unfiltered residual's power above the cut-off of the fit, in words; None where it is not known."""
    spectrum = result.validation.spectrum
    if spectrum is None:
        return None
    shares = share_above(spectrum, result.identified.bandwidth.cutoff_hz)
    known = shares[np.isfinite(shares)]
    if not len(known):
        return None
    low, high = percent(float(known.min())), percent(float(known.max()))
    return low if len(known) == 1 else f"{low} to {high}, by joint,"


def fitted_runs(result: Result) -> Sequence[RecordedRun]:
    """The recordings of the fit; all of them where none is marked as such."""
    return [run for run in result.runs if run.fitted] or list(result.runs)


def defects(runs: Iterable[RecordedRun]) -> list[str]:
    """A sentence for each defect of each recording, after how it was read."""
    return [f"{run.name}: {said}".rstrip(".") + "." for run in runs for said in (*run.read_as, *run.defects)]


def reached(result: Result) -> list[Reached]:
    """Range and largest speed of every joint over the fitted recordings, with the limits they are shares of."""
    fitted = fitted_runs(result)
    if not fitted:
        return []
    low = np.min([run.position.min(axis=0) for run in fitted], axis=0)
    high = np.max([run.position.max(axis=0) for run in fitted], axis=0)
    speed = np.max([run.largest_speed for run in fitted], axis=0)
    rows = []
    for k, joint in enumerate(result.identified.model.model.arm.joints):
        whole, limit = joint.upper - joint.lower, joint.velocity_limit
        rows.append(
            Reached(
                joint.name,
                joint.units,
                float(low[k]),
                float(high[k]),
                float((high[k] - low[k]) / whole) if np.isfinite(whole) and whole > 0.0 else float("nan"),
                float(speed[k]),
                float(speed[k] / limit) if np.isfinite(limit) and limit > 0.0 else float("nan"),
            )
        )
    return rows


def masses(identified: Identified) -> list[str]:
    """Identified and CAD mass of each link, in words; none where the arm has no CAD masses to compare with."""
    joints = identified.model.model.arm.joints
    if not any(joint.inertial[0] > 0.0 for joint in joints):
        return []
    found = {item.joint: item for item in identified.estimates if item.symbol == "m"}
    return [
        f"{k} {joint.name} {measured(found[joint.name].value, found[joint.name].standard_error)} kg "
        f"(CAD {number(float(joint.inertial[0]))})"
        for k, joint in enumerate(joints, start=1)
        if joint.name in found
    ]


def first_posture(result: Result) -> FloatArray:
    """(n,) the posture in which the validation begins, rad or m; without signals the arm's start, or zero."""
    arm = result.identified.model.model.arm
    for trace in result.validation.traces:
        if len(trace.time):
            return np.asarray(trace.position[0])
    return np.zeros(len(arm.joints)) if arm.start is None else arm.start


def correlated(identified: Identified) -> Correlated | None:
    """Correlations between the parameters that the data determine; None where there are less than two."""
    chosen = [
        k
        for k, item in enumerate(identified.estimates)
        if item.determination is Determination.DATA and identified.covariance[k, k] > 0.0
    ]
    if len(chosen) < 2:
        return None
    matrix = correlation(identified.covariance[np.ix_(chosen, chosen)])
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
    return Correlated(names, matrix, words)
