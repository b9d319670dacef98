"""The page of an adaptation: verdict first, why, what moved and by how much, and how it was judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..bayes.adaptation import Adaptation
from ..bayes.adaptation_causes import causes, reason
from ..estimate.identified import Validation
from ..results.provenance import FITTED, VALIDATED
from . import orbit_figures as figures
from .details import source_files
from .pages import render

MODELS = ("ground, on the ground", "ground, in orbit", "ground, gravity set", "adapted, in orbit")
"""The four validations, in the order in which they are handed about."""


def orbit_html(
    adaptation: Adaptation, validations: Sequence[Validation], wanted_r: float, sources: Mapping[str, Any]
) -> str:
    """The page of an adaptation, as HTML.

    Args:
        adaptation: The adapted model, and what changed.
        validations: One for each model, in the order of `MODELS`.
        wanted_r: Correlation R that every joint must exceed.
        sources: Provenance, as from `provenance`.
    """
    lowest = [worst(validation) for validation in validations]
    return render(
        "orbit.html",
        arm=adaptation.adapted.model.arm,
        adaptation=adaptation,
        validations=validations,
        worst=lowest,
        wanted_r=wanted_r,
        adapted=lowest[0].r > wanted_r and lowest[-1].r > wanted_r,
        causes=causes(adaptation),
        models=MODELS,
        key=list(zip(figures.ROLES, MODELS)),
        fits=figures.fits(validations, MODELS, wanted_r),
        over_temperature=figures.over_temperature(adaptation),
        changes=[(change, reason(adaptation, change)) for change in adaptation.changes],
        sources=source_files(sources, {FITTED: "Adapted to", VALIDATED: "Judged on"}),
    )


class Worst(NamedTuple):
    """The joint with the smallest correlation R, and R."""

    joint: str
    r: float


def worst(validation: Validation) -> Worst:
    """The joint with the smallest R over all samples."""
    joint = min(validation.joints, key=lambda name: validation.joints[name].everything.correlation)
    return Worst(joint, validation.joints[joint].everything.correlation)
