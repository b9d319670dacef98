"""The report's first lines: the verdict, what it rests on, and what a reader should know before using the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..estimate.counts import counts
from ..estimate.identified import Identified, JointValidation, Validation
from ..identification.verdict import FAIR, LACKING_P, Verdict, judge_result, relative_rms
from .text import listed, percent


@dataclass(frozen=True)
class Opening:
    """What the report opens with.

    Attributes:
        verdict: The verdict, its reasons included.
        sentences: What it rests on.
        warnings: What to know of the figures before using the model; empty when there is nothing.
        notes: Further facts about the data.
    """

    verdict: Verdict
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


def opening(identified: Identified, validation: Validation, unfit: Sequence[str] = ()) -> Opening:
    """Put a result into words.

    Args:
        identified: The identification, whose notes are taken over.
        validation: How well it predicts: verdict, sentences and warnings rest on it.
        unfit: Why the data are unfit, `ConventionReport.unfit`: then that is the verdict.
    """
    return Opening(
        judge_result(identified, validation, unfit),
        _sentences(identified, validation),
        _warnings(validation),
        identified.notes,
    )


def _sentences(identified: Identified, validation: Validation) -> tuple[str, ...]:
    sentences = [f"Validated {validation.what}{'' if validation.held_out else ', not held out'}."]
    shares = _known(validation, lambda joint: joint.everything.relative_rms)
    moving = relative_rms(validation)
    if shares:
        spread = f"Over all samples the residual is {_range(shares)} of the torque's RMS"
        spread += f"; while the joint moves, {_range(moving)}." if moving else "."
        sentences.append(spread)
    still = [name for name in moving if shares.get(name, 0.0) > FAIR >= moving[name]]
    if still:
        sentences.append(
            f"{listed(still)}: the large residual is from standstill, where static friction takes any value up to its "
            "limit and cannot be predicted."
        )
    correlations = _known(validation, lambda joint: joint.everything.correlation)
    if correlations:
        worst = min(correlations, key=correlations.__getitem__)
        sentences.append(f"Correlation R is at least {correlations[worst]:.4f} ({worst}).")
    return (*sentences, _determined(identified))


def _known(validation: Validation, figure: Callable[[JointValidation], float]) -> dict[str, float]:
    values = {name: figure(joint) for name, joint in validation.joints.items()}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def _range(shares: dict[str, float]) -> str:
    best, worst = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
    if best == worst:
        return f"{percent(shares[best])} ({best})"
    return f"{percent(shares[best])} ({best}, best) to {percent(shares[worst])} ({worst}, worst)"


def _determined(identified: Identified) -> str:
    found = counts(identified)
    parts = [f"{number} {kind.value}" for kind, number in found.by_determination.items()]
    return (
        f"Of the model's {found.parameters} parameters: {', '.join(parts)}. Of {found.base} base parameters, the "
        f"linear combinations that the motion can reveal, {found.base_determined} are determined by the data."
    )


def _warnings(validation: Validation) -> tuple[str, ...]:
    warnings = []
    if not validation.held_out:
        warnings.append(
            "The figures are on data the model was fitted to, and therefore too small: "
            "validate on another recording (spacearm identify … --validate BAG)."
        )
    lacking = [name for name, joint in validation.joints.items() if _lacks(joint)]
    if lacking:
        warnings.append(
            f"The residual of {listed(lacking)} repeats from period to period, so it is not noise: "
            "the model lacks a term."
        )
    return tuple(warnings)


def _lacks(joint: JointValidation) -> bool:
    return joint.lack_of_fit is not None and joint.lack_of_fit.p_value < LACKING_P
