"""What a parameter that a model holds fixed may hide: by how much the others would move if it were estimated.

A spring k_1 held at zero is no part of a fit, and what little of it there is leans on the parameters whose columns
look like its own: on the simulated arm a spring of 0.02 N·m/rad, 0.1 % of the joint's torque, shifted k_v2 by three
of the standard errors that hold only if there is none. Freeing it is no cure: where the data hardly tell it from
the rest, predictions of other motions become worse. So the estimate stays, and its mean square error is its variance
plus the square of the estimated shift (Claeskens and Hjort 2003, "The focused information criterion"); that of noise
alone is not taken out of it, so that standard errors are rather too long than too short.

With H the information of all that is estimated, r the weighted residual, p the held parameter's weighted column and
c = A'p, partial regression (Frisch and Waugh 1933) gives what it would be, k = p'r / (p'p - c'H^-1 c), and the shift
of the others, -H^-1 c k.
"""

from __future__ import annotations

import numpy as np

from ..dynamics.arm import FloatArray
from .prior import WIDENING
from .regression import Regression


def held_columns(regression: Regression) -> list[tuple[int, FloatArray]]:
    """(joint row, (M,) unweighted column) of every parameter held fixed that no constant shapes."""
    held = []
    for term in regression.model.terms:
        if term.constants or all(parameter.scale != 0.0 for parameter in term.parameters):
            continue
        per_motion = [term.columns(motion, (), None) for motion in regression.motions]
        for joint, (indices, _) in per_motion[0].items():
            for k, index in enumerate(indices):
                if term.parameters[index].scale == 0.0:
                    parts = [
                        motion.reduce(columns[joint][1][:, k])[motion.moving[:, joint]]
                        for motion, columns in zip(regression.motions, per_motion)
                    ]
                    held.append((joint, np.concatenate(parts)))
    return held


def hidden_shifts(
    regression: Regression,
    inverse: FloatArray,
    weighted: list[FloatArray],
    numbers: list[list[int]],
    residuals: list[FloatArray],
) -> FloatArray:
    """What each held parameter, were it estimated, would change.

    Args:
        regression: Weighted rows.
        inverse: (u, u) inverse information of the unknowns.
        weighted: Per joint, all weighted columns (M, k).
        numbers: Per joint, the unknown each column belongs to.
        residuals: Per joint, (M,) unweighted residual at the solution.

    Returns:
        (h, u), a row a held parameter.
    """
    shifts = []
    for joint, column in held_columns(regression):
        rows = regression.rows[joint]
        size = float(np.sum(column**2))
        if size == 0.0:
            continue
        belief = size / (WIDENING**2 * float(np.sum(rows.torque**2)))
        own = column * rows.weight
        cross = np.zeros(len(inverse))
        np.add.at(cross, numbers[joint], weighted[joint].T @ own)
        follow = inverse @ cross
        value = own @ (residuals[joint] * rows.weight) / (own @ own - cross @ follow + belief)
        shifts.append(-follow * value)
    return np.array(shifts).reshape(-1, len(inverse))
