"""What is no mistake and looks like a factor on the torque: a body on the last link, a base that nothing holds.

A unit or a gain scales every joint's torque alike. A payload adds what a body on the last link adds; a free base takes
away what it yields. Both are hypotheses like any `Change`, and the data tell them apart. They are looked for only where
a factor on the torque would be named: by themselves they would take up what the CAD inertials are off.
"""

from __future__ import annotations

import numpy as np

from ..dynamics.free_base import INERTIA_RATIOS, MASS_RATIOS
from .change import PHYSICAL, PRIOR, Change, Kind
from .evidence import CAD_SCALES
from .scorer import SCREEN_ITERATIONS, Scored, Scorer

PAYLOAD_RATIOS = (0.5, 2.0, 8.0)
"""Standard deviations of a payload's mass over the arm's that are tried. On the ground rated payloads are 0.1 to 0.3
of it (`evidence.PAYLOAD_SHARE` has them); a client in orbit may weigh several times as much as the arm."""
SURE_BODY = 3.0
"""Standard errors from which a mass is one, for `spacearm payload` as well."""


def physical(scorer: Scorer, start: Scored) -> tuple[list[Scored], float]:
    """A setup with a payload, and in zero gravity one with a free base, where they may be.

    Args:
        scorer: Scores, on all rows.
        start: The scored setup that they would be added to.

    Returns:
        Setups with one of them each, and the score with both; minus infinity where there are not both.
    """
    done = {one.kind for one in start.changes} & set(PHYSICAL)
    found: list[Scored | None] = [] if Kind.PAYLOAD in done else [payload(scorer, start)]
    if Kind.FLOATING_BASE not in done and not start.setup.gravity.any() and not scorer.base_held:
        found.append(_free_base(scorer, start))
    both = payload(scorer, found[1]) if len(found) == 2 and found[1] is not None else None
    return [one for one in found if one is not None], -np.inf if both is None else both.score


def payload(scorer: Scorer, start: Scored) -> Scored | None:
    """The setup with a body of unknown inertials on the last link; None where its mass is not positive.

    Args:
        scorer: Scores, on all rows.
        start: The scored setup that it would be added to.
    """
    arm, tried = scorer.arm, []
    for ratio in PAYLOAD_RATIOS:
        size = ratio * sum(joint.inertial[0] for joint in arm.joints)
        log_prior = float(np.log(PRIOR / len(PAYLOAD_RATIOS)))
        change = Change(Kind.PAYLOAD, (len(arm.joints) - 1,), (size,), log_prior)
        tried.append(scorer.score((*start.changes, change), change.on(start.setup)))
    best = max(tried, key=lambda one: one.score)
    body, error = best.evidence.body, best.evidence.body_kg_error
    return best if body is not None and body[0] > SURE_BODY * error else None


def _free_base(scorer: Scorer, start: Scored) -> Scored:
    """The setup with the free base that does best of those looked through."""
    few, scale = scorer.screen(), (min(start.evidence.scale, CAD_SCALES[-2]),)
    total = sum(joint.inertial[0] for joint in scorer.arm.joints)
    sizes = [(total * inertia, total * mass) for inertia in INERTIA_RATIOS for mass in MASS_RATIOS]
    changes = [Change(Kind.FLOATING_BASE, (), size, float(np.log(PRIOR / len(sizes)))) for size in sizes]
    tried = [few.score((*start.changes, one), one.on(start.setup), scale, SCREEN_ITERATIONS) for one in changes]
    best = max(tried, key=lambda one: one.score)
    return scorer.score(best.changes, best.setup)
