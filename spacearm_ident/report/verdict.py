"""The report's first lines: how good the model is, on what, and what a reader should know before using it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from ..identification.identified import Determination, Identified, JointValidation, Validation
from .markup import listed, number, percent
from .tables import PAPER_SYMBOLS, base, by_joint

GOOD, FAIR = 0.10, 0.25
"""Residual over torque of the worst joint while it moves, up to which a fit is called good or fair (ours)."""
LACKING_P = 0.01
LARGE_SHIFT = 3.0


@dataclass(frozen=True)
class Verdict:
    """What the report opens with.

    Attributes:
        level: `good`, `fair`, `poor` or `unknown`.
        headline: One line.
        sentences: What it rests on.
        warnings: What to know before using the model; empty when there is nothing.
        notes: Further facts about the data.
    """

    level: str
    headline: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


def judge_result(identified: Identified, validation: Validation) -> Verdict:
    """Put a result into words."""
    moving = {name: joint.moving.relative_rms for name, joint in validation.joints.items()}
    known = {name: share for name, share in moving.items() if math.isfinite(share)}
    if not known:
        level, headline = "unknown", "No joint could be validated: no torque, or no motion, in the validation data"
    else:
        worst = max(known.values())
        level = "good" if worst <= GOOD else "fair" if worst <= FAIR else "poor"
        every = "Every joint's torque is" if len(known) == len(identified.model.model.arm.joints) else "Torque is"
        headline = f"{level.capitalize()} fit. {every} predicted to within {percent(worst)} (RMS) while it moves"
    return Verdict(
        level, headline, _sentences(identified, validation), _warnings(identified, validation), identified.notes
    )


def _sentences(identified: Identified, validation: Validation) -> tuple[str, ...]:
    seen = "which the fit had not seen" if validation.held_out else "which the fit had seen"
    sentences = [f"Validated {validation.what}, {seen}."]
    shares = _known(validation, lambda joint: joint.everything.relative_rms)
    moving = _known(validation, lambda joint: joint.moving.relative_rms)
    if shares:
        spread = f"Over all samples the residual is {_range(shares)} of the torque's RMS"
        spread += f"; while the joint moves, {_range(moving)}." if moving else "."
        sentences.append(spread)
    still = [name for name in moving if shares.get(name, 0.0) > FAIR >= moving[name]]
    if still:
        sentences.append(
            f"{listed(still)}: the large residual is from standstill, where friction holds whatever is asked of it "
            "and no model of this kind can tell how much."
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
    joints = identified.model.model.arm.joint_names
    listing = by_joint(identified)
    found = Counter(item.determination for joint in joints for item in listing[joint] if item.symbol in PAPER_SYMBOLS)
    total = found.total()
    parts = [f"{found[kind]} {kind.value}" for kind in Determination if found[kind]]
    estimated = sum(item.identifiable for item in base(identified))
    return f"Of the {total} parameters of the paper's model: {', '.join(parts)}; {estimated} base parameters estimated."


def _warnings(identified: Identified, validation: Validation) -> tuple[str, ...]:
    warnings = []
    if not validation.held_out:
        warnings.append(
            "The figures are on data the model was fitted to, which flatters it: "
            "validate on another recording (spacearm identify … --validate BAG)."
        )
    missing = [name for name in identified.model.model.arm.joint_names if name not in validation.joints]
    if missing:
        warnings.append(f"Not validated: {listed(missing)}.")
    if identified.joints_at_rest:
        warnings.append(f"Never moved: {listed(identified.joints_at_rest)}; nothing is known of the friction there.")
    lacking = [name for name, joint in validation.joints.items() if _lacks(joint)]
    if lacking:
        warnings.append(
            f"The residual of {listed(lacking)} repeats from period to period, so it is not noise: "
            "the model leaves something out."
        )
    if identified.consistency_shift > LARGE_SHIFT:
        warnings.append(
            "Making the inertials physically consistent moved a base parameter by "
            f"{number(identified.consistency_shift, 2)} of its standard errors: the data pull towards bodies that "
            "cannot exist. Check the kinematics, the gravity vector and the torque constants."
        )
    return tuple(warnings)


def _lacks(joint: JointValidation) -> bool:
    return joint.lack_of_fit is not None and joint.lack_of_fit.p_value < LACKING_P
