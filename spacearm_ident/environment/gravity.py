"""Gravity estimated with the arm: all of its vector, or its direction alone.

Torque is linear in gravity and linear in the masses, not in both:

    tau = Y_0 x + sum_k g_k Y_k x,        k = x, y, z,

Y_0 the regressor without gravity, Y_k the torque of unit gravity along an axis. All columns of it are compressed
once, Y_k x as one column for each product of a component with a mass or first moment; then a search over the three
components, with the exact x at every trial (variable projection, as in `separable.py`), costs milliseconds. It starts
from the stated gravity, from zero and from the six axes, so that one stated quite wrongly does not hold it.

What tells the size: masses and first moments act inertially, too. On the ground that is little beside their weight,
and the standard error says so; the direction is what one estimates there. Each component has a prior at the arm's, give
or take `GRAVITY_SCALE`, so that one that no motion reveals stays there.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from ..arrays import FloatArray
from ..dynamics.arm import EARTH
from ..dynamics.model import TorqueModel
from ..dynamics.regressor import rigid_body_blocks
from ..errors import UserError
from ..estimate.environment import GRAVITY_SCALE, LEVEL, ZERO_ERROR, GravityEstimate, wald
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..solvers.separable import Solution

VECTOR, DIRECTION = "vector", "direction"
GRAVITY_CHOICES = (VECTOR, DIRECTION)
MOMENTS = 4
"""Of a link's ten parameters the first four, m and m c, have weight."""
STARTS = 2
STEP = 1e-3
"""Half the central difference, m/s^2."""


def require_gravity_choice(choice: str, gravity: FloatArray) -> str:
    """`choice`, if gravity (3,) can be estimated so; empty: not at all.

    Args:
        choice: Of the user.
        gravity: As the arm's description has it, m/s².

    Raises:
        UserError: There is no such choice, or no direction to begin from.
    """
    if choice and choice not in GRAVITY_CHOICES:
        raise UserError(f"gravity estimated as {choice!r}: choose one of {', '.join(GRAVITY_CHOICES)}")
    if choice == DIRECTION and not np.any(gravity):
        raise UserError(
            f"the direction of zero gravity cannot be estimated: give its size (--gravity), or estimate the {VECTOR}"
        )
    return choice


def gravity_columns(regression: Regression) -> list[tuple[list[int], FloatArray]]:
    """Per joint, columns (M, k) of the products of unit gravity with masses and first moments.

    Returns:
        With each column its number: 12 link + 4 axis + (0: m, 1-3: m c).
    """
    arm = regression.model.arm
    parts: list[tuple[list[int], list[FloatArray]]] = [([], []) for _ in arm.joints]
    for motion in regression.motions:
        reduced: list[list[FloatArray]] = [[] for _ in arm.joints]
        for piece in motion.parts():
            still = np.zeros_like(piece.position)
            fields = [rigid_body_blocks(arm.with_gravity(axis), piece.position, still, still) for axis in np.eye(3)]
            for joint, (numbers, _) in enumerate(parts):
                links = [link for (row, link) in fields[0] if row == joint]
                numbers[:] = [12 * link + k for link in links for k in range(12)]
                blocks = [field[joint, link][:MOMENTS] for link in links for field in fields]
                reduced[joint].append(piece.reduce(np.concatenate(blocks).T))
        for joint, (_, kept) in enumerate(parts):
            kept.append(np.concatenate(reduced[joint])[motion.moving[:, joint]])
    return [(numbers, np.concatenate(kept)) for numbers, kept in parts]


def first_inertial(model: TorqueModel) -> int:
    """Number of the first link's mass.

    Raises:
        UserError: The model has no rigid links.
    """
    if model.first_inertial is None:
        raise UserError("gravity can be estimated with rigid_body in the structure only: add it")
    return model.first_inertial


def weight_columns(
    columns: list[tuple[list[int], FloatArray]], model: TorqueModel, parameters: FloatArray
) -> list[FloatArray]:
    """Per joint, (M, 3) torque of unit gravity along each axis.

    Args:
        columns: From `gravity_columns`: per joint, the numbers of its columns and the columns (M, k).
        model: Which parameter is what; it must have rigid links.
        parameters: (p,) in the order of `model.parameters`, SI.

    Raises:
        UserError: The model has no rigid links.
    """
    first = first_inertial(model)
    moments = parameters[first : first + 10 * len(model.arm.joints)].reshape(-1, 10)[:, :MOMENTS]
    products = np.zeros((len(moments), 3, MOMENTS, 3))
    for axis in range(3):
        products[:, axis, :, axis] = moments
    flat = products.reshape(-1, 3)
    return [block @ flat[numbers] for numbers, block in columns]


def tangents(gravity: FloatArray, choice: str) -> FloatArray:
    """(3, d) ways in which gravity may change: all, or those that keep its size.

    Args:
        gravity: (3,) m/s².
        choice: Which of its numbers are estimated.
    """
    if choice == VECTOR:
        return np.eye(3)
    return np.asarray(np.linalg.svd(gravity[None, :])[2][1:].T)


def estimate_gravity(
    regression: Regression,
    prior: Prior,
    solution: Solution,
    columns: list[tuple[list[int], FloatArray]],
    choice: str,
    stated: FloatArray,
) -> FloatArray:
    """The gravity that fits best, masses and all other linear parameters fitted with it.

    Args:
        regression: Weighted rows under the arm's gravity.
        prior: Of the parameters.
        solution: Its constants are kept.
        columns: From `gravity_columns`.
        choice: One of `GRAVITY_CHOICES`.
        stated: (3,) gravity before any data, m/s^2.

    Returns:
        (3,) m/s^2 in the base frame.
    """
    matrix, weight, vector = _compressed(regression, prior, solution, columns)
    here, size = regression.model.arm.gravity, float(np.linalg.norm(stated))

    def gravity_of(point: FloatArray) -> FloatArray:
        return point if choice == VECTOR else size * point / max(float(np.linalg.norm(point)), 1e-12)

    def residual(point: FloatArray) -> FloatArray:
        gravity = gravity_of(point)
        whole = matrix + np.tensordot(gravity - here, weight, axes=1)
        free = lstsq(whole[:, prior.free], vector - prior.fixed_part(whole), lapack_driver="gelsy")[0]
        left = whole[:, prior.free] @ free + prior.fixed_part(whole) - vector
        return np.concatenate([left, (gravity - stated) / GRAVITY_SCALE])

    length = size or -EARTH[2]
    starts = [here, *(sign * length * axis for sign, axis in itertools.product((1.0, -1.0), np.eye(3)))]
    if choice == VECTOR:
        starts.append(np.zeros(3))
    costs = [float(np.sum(residual(start) ** 2)) for start in starts]
    best = [starts[k] for k in np.argsort(costs, kind="stable")[:STARTS]]

    def slope(point: FloatArray) -> FloatArray:
        ways = STEP * np.eye(3)
        return np.stack([(residual(point + way) - residual(point - way)) / (2 * STEP) for way in ways], axis=1)

    found = [least_squares(residual, start, slope) for start in best]
    return np.asarray(gravity_of(min(found, key=lambda one: float(one.cost)).x))


def _compressed(
    regression: Regression, prior: Prior, solution: Solution, columns: list[tuple[list[int], FloatArray]]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrix (r, p) at the arm's gravity, its change (3, r, p) by a unit of each component, right-hand side (r,)."""
    model = regression.model
    count, first = len(model.parameters), first_inertial(model)
    width = count + 12 * len(model.arm.joints)
    blocks, sides = [], []
    for joint, (numbers, block) in enumerate(columns):
        indices, shaped = [count + number for number in numbers], [block]
        for term, start, terms in regression.shaped_terms():
            own = regression.shaped(term, list(solution.constants[start : start + terms])).get(joint)
            if own is not None:
                indices.extend(own[0])
                shaped.append(own[1])
        small, side = regression.compress(joint, indices, np.concatenate(shaped, axis=1), width)
        blocks.append(small)
        sides.append(side)
    blocks.append(np.pad(prior.rows, ((0, 0), (0, width - count))))
    sides.append(prior.target)
    stacked = np.column_stack([np.concatenate(blocks), np.concatenate(sides)])
    triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
    weight = np.zeros((3, len(triangle), count))
    for axis, link, k in itertools.product(range(3), range(len(model.arm.joints)), range(MOMENTS)):
        weight[axis, :, first + 10 * link + k] = triangle[:, count + 12 * link + 4 * axis + k]
    return triangle[:, :count], weight, triangle[:, -1]


def gravity_result(
    gravity: FloatArray, stated: FloatArray, covariance: FloatArray, choice: str, freedom: float
) -> GravityEstimate:
    """The estimate with its covariance and the test against zero.

    Args:
        gravity: (3,) estimate in the base frame, m/s².
        stated: (3,) gravity before any data, m/s².
        covariance: (3, 3) of the estimate, (m/s²)².
        choice: One of `GRAVITY_CHOICES`. Only `VECTOR` is tested against zero; otherwise the p value is 0.
        freedom: Degrees of freedom of the residual.
    """
    p_zero = 0.0
    if choice == VECTOR:
        p_zero = wald(gravity, covariance, freedom)[1]
    plain = tuple(tuple(float(value) for value in row) for row in covariance)
    return GravityEstimate(tuple(map(float, gravity)), plain, tuple(map(float, stated)), choice == DIRECTION, p_zero)


def is_zero(found: GravityEstimate) -> bool:
    """Whether there is no gravity: no component differs from zero, and those that are seen are known well."""
    seen = found.seen
    return bool(not found.size_held and seen.any() and found.p_zero > LEVEL and (found.errors[seen] < ZERO_ERROR).all())
