"""Bias of omitted parameters: by how much the others would move if one that a model holds fixed were estimated.

A spring k_1 held at zero is no part of a fit, and what little of it there is leans on the parameters whose columns
look like its own: on the simulated arm a spring of 0.02 N·m/rad, 0.1 % of the joint's torque, shifted k_v2 by three
of the standard errors that hold only if there is none. Freeing it is no cure: where the data hardly tell it from
the rest, predictions of other motions become worse. So the estimate stays, and its mean square error is its variance
plus the square of the estimated shift (Claeskens and Hjort 2003, "The focused information criterion"); that of noise
alone is not taken out of it, so that standard errors are rather too long than too short.

So it is with a Stribeck term that the model does not have. f_c, k_v2 and k_v3 imitate one at the speeds of the data
and are then far from what they are beside it: on a simulated arm f_c by 16 standard errors. What it would be is taken
at the Stribeck velocity that helps the joint most, where friction falls with speed.

An offset that the model does not have is another matter. Every torque sensor has some zero error, and held-out data do
not miss it where mass moments can imitate it; there its estimate is vague, and a square of it may be near zero by
chance. So the variance of the estimate is added to its square, as if the offset had been estimated.

With H the information of all that is estimated, r the weighted residual, p the held parameter's weighted column and
c = A'p, partial regression (Frisch and Waugh 1933) gives what it would be, k = p'r / (p'p - c'H^-1 c), and the shift
of the others, -H^-1 c k. Where p nearly lies among the columns, as a spring's among gravity's, the difference in the
denominator keeps four digits of the sixteen; it is computed as what the columns leave of p, a sum of squares, from an
H^-1 c refined by that remainder (Björck 1996, "Numerical methods for least squares problems", section 6.6.5: corrected
seminormal equations).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..arrays import FloatArray
from ..dynamics.rigid_body import TorqueOffset
from ..dynamics.term import Term
from ..regression.prior import WIDENING
from ..regression.regression import Regression
from ..regression.stribeck import absent_terms, likeliest_width

REFINEMENTS = 3
"""Steps of iterative refinement; each divides the error by the inverse of H's condition number times the rounding
error, a thousand or more, so that the third is beyond what double precision shows."""


def held_columns(regression: Regression) -> list[tuple[int, FloatArray]]:
    """(joint row, (M,) unweighted column) of every parameter held fixed that no constant shapes."""
    held = []
    for term in regression.model.terms:
        if term.constants:
            continue
        lacking = [number for number, parameter in enumerate(term.parameters) if parameter.held]
        held += _columns_of(regression, term, lacking)
    return held


def offset_columns(regression: Regression) -> list[tuple[int, FloatArray]]:
    """(joint row, (M,) unweighted column) of a torque offset at every joint at which the model has none."""
    model = regression.model
    there = {one.joint for one in model.parameters if one.symbol == TorqueOffset.symbol}
    absent = [joint for joint in model.arm.joint_names if joint not in there]
    terms = TorqueOffset.build(model.arm, {"joints": absent}) if absent else ()
    return [found for term in terms for found in _columns_of(regression, term, range(len(absent)))]


def _columns_of(regression: Regression, term: Term, numbers: Collection[int]) -> list[tuple[int, FloatArray]]:
    """(joint row, (M,) unweighted column) of some parameters of a term without constants."""
    if not numbers:
        return []
    per_motion = [term.columns(motion, (), None) for motion in regression.motions]
    found = []
    for joint, (indices, _) in per_motion[0].items():
        for k in (k for k, index in enumerate(indices) if index in numbers):
            parts = [
                motion.reduce(columns[joint][1][:, k])[motion.moving[:, joint]]
                for motion, columns in zip(regression.motions, per_motion)
            ]
            found.append((joint, np.concatenate(parts)))
    return found


def hidden_shifts(
    regression: Regression,
    constants: FloatArray,
    inverse: FloatArray,
    beliefs: FloatArray,
    weighted: list[FloatArray],
    numbers: list[list[int]],
    residuals: list[FloatArray],
) -> FloatArray:
    """What each held parameter, were it estimated, would change.

    Args:
        regression: Weighted rows.
        constants: (c,) at the solution.
        inverse: (u, u) inverse information of the unknowns.
        beliefs: (b, u) the prior's rows.
        weighted: Per joint, all weighted columns (M, k).
        numbers: Per joint, the unknown each column belongs to.
        residuals: Per joint, (M,) unweighted residual at the solution.

    Returns:
        (h, u), a row a held parameter.
    """
    shifts = []

    def freed(joint: int, column: FloatArray) -> tuple[FloatArray, float, float]:
        """(u,) the unknowns that follow a column of a joint, and value and standard error of its parameter."""
        rows = regression.rows[joint]
        belief = float(np.sum(column**2)) / (WIDENING**2 * float(np.sum(rows.torque**2)))
        own = column * rows.weight
        follow, left = _explained(own, joint, inverse, beliefs, weighted, numbers)
        value = float(own @ (residuals[joint] * rows.weight)) / (left + belief)
        return follow, value, float((left + belief) ** -0.5)

    for joint, column in held_columns(regression):
        if column.any():
            follow, value, _ = freed(joint, column)
            shifts.append(-follow * value)
    for joint, column in offset_columns(regression):
        if column.any():
            follow, value, error = freed(joint, column)
            shifts += [-follow * value, follow * error]
    for absent in absent_terms(regression, constants):
        joint, weight = absent.joint, regression.rows[absent.joint].weight
        width = likeliest_width(regression, absent, weighted[joint], residuals[joint] * weight)
        if width > 0.0:
            follow, value, _ = freed(joint, absent.column(regression, width))
            if value > 0.0:  # a fall of friction with speed; a rise is no Stribeck effect
                shifts.append(-follow * value)
    return np.array(shifts).reshape(-1, len(inverse))


def _explained(
    own: FloatArray,
    joint: int,
    inverse: FloatArray,
    beliefs: FloatArray,
    weighted: list[FloatArray],
    numbers: list[list[int]],
) -> tuple[FloatArray, float]:
    """(u,) the unknowns H^-1 c that come nearest to a joint's weighted column, and the square of what they leave."""
    follow = np.zeros(len(inverse))
    rest = [own if row == joint else np.zeros(len(block)) for row, block in enumerate(weighted)]
    for _ in range(1 + REFINEMENTS):
        gradient = -beliefs.T @ (beliefs @ follow)
        for unknowns, block, part in zip(numbers, weighted, rest):
            gradient[unknowns] += block.T @ part
        follow = follow + inverse @ gradient
        rest = [-block @ follow[unknowns] for unknowns, block in zip(numbers, weighted)]
        rest[joint] += own
    return follow, float(sum(part @ part for part in rest) + np.sum((beliefs @ follow) ** 2))
