"""How much a joint's friction differs from one recording to the next: a component of variance of its parameters.

A residual tells how well a run's own friction is known. In the next run the lubricant is warmer, other teeth carry,
other poses are visited, and friction is not the same. So it is taken as random effects (Laird and Ware 1982, Biometrics
38, 963): in group g of a joint's rows its friction is that of the parameters with its factors moved by u_g,

    u_g ~ N(0, T),    residual in g = F_g u_g + noise,

where the columns of F are the torque of what depends on direction (f_c, f_b, mu), that of what grows with speed
(k_v1, k_v2, k_v3), and the derivatives by the logarithms of the constants (v_b, d_s). T is what makes the residual
likeliest, by EM, with the noise that the rows' weights say. The groups are the recordings where there are several,
and the mean of R recordings is off by T / R. Few groups decide a variance badly, so they have a prior, worth
`PSEUDO_RECORDINGS` of them: the T between blocks of time. One recording has that T alone. The next recording is then
taken to differ from it as one of its blocks from another, which becomes no less as a recording grows longer.

Where friction is the same all the time T comes out as next to zero, and standard errors are those of the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import TorqueModel
from ..regression.held_out import FEWEST_BLOCKS, time_blocks
from ..regression.regression import Regression

ORDINARY_DIRECTION, ORDINARY_SPEED, ORDINARY_CONSTANT = 0.03, 0.06, 0.2
"""Relative standard deviations between recordings, of what of friction depends on direction, of what grows with speed,
and of its constants. They are where the search for T begins, so they count only where blocks of time do not tell.
Assumed, not measured: joints some 3 K apart, at 1 % and 2 % a kelvin (friction of a robot's joint over temperature:
Bittencourt and Gunnarsson 2012, J. Dyn. Sys. Meas. Control 134, 051013); a fifth for constants is a guess."""
PSEUDO_RECORDINGS = 2.0
"""Pseudo-count: recordings that the variance between blocks of time is worth beside that between recordings. With two
recordings both then count alike."""
ITERATIONS = 60
"""Iterations of expectation maximisation. It converges as 1 / iterations where a variance tends to zero."""
_LEAST = 1e-12
"""Variance added to the diagonal of T, which is then regular."""


def friction_shifts(
    regression: Regression,
    parameters: FloatArray,
    columns: Sequence[FloatArray],
    numbers: Sequence[Sequence[int]],
    residuals: Sequence[FloatArray],
    width: int,
) -> FloatArray:
    """By how much the friction of these recordings is off that of the arm's recordings in general.

    Args:
        regression: Weighted rows.
        parameters: (p,) at the solution.
        columns: Per joint, unweighted columns (M, k), derivatives by the constants' logarithms included.
        numbers: Per joint, the unknown each column belongs to: parameters first, then constants.
        residuals: Per joint, (M,) unweighted residual.
        width: Number of unknowns u.

    Returns:
        (s, u) independent shifts of one standard deviation, to be added to a covariance as S'S.
    """
    blocks, recording = time_blocks(regression.motions)
    sources = [np.full(len(block), motion.source) for block, motion in zip(blocks, regression.motions)]
    recordings = len(np.unique(recording))
    kinds = friction_kinds(regression.model)
    shifts = [np.zeros((0, width))]
    for joint, rows in enumerate(regression.rows):
        directions, sizes = _factors(kinds, parameters, numbers[joint], width)
        if not len(directions) or not len(rows.torque):
            continue
        torque = columns[joint] @ directions[:, numbers[joint]].T * rows.weight[:, None]
        residual = residuals[joint] * rows.weight
        spread = np.diag(sizes**2)
        if len(recording) >= FEWEST_BLOCKS:
            spread = _variance(torque, residual, rows.group(blocks), spread)
        if recordings > 1:
            spread = _variance(torque, residual, rows.group(sources), spread, PSEUDO_RECORDINGS) / recordings
        value, vector = np.linalg.eigh(spread)
        shifts.append((np.sqrt(np.maximum(value, 0.0)) * vector).T @ directions)
    return np.concatenate(shifts)


def day_share(recordings: int) -> float:
    """Share of the ordinary variance of friction between recordings that is left beside what so many of them show.

    Ordinary variance counts as `PSEUDO_RECORDINGS`, which a few days alike would else make too sure.

    Args:
        recordings: Recordings of the healthy arm.
    """
    return PSEUDO_RECORDINGS / (PSEUDO_RECORDINGS + recordings)


def friction_kinds(model: TorqueModel) -> dict[int, tuple[str, float]]:
    """Which factor of friction an unknown belongs to, and how much that ordinarily differs between recordings.

    Args:
        model: Any.

    Returns:
        Number of the unknown, parameters first, then constants -> name of the factor, relative standard deviation.
    """
    count, kinds = len(model.parameters), {}
    for term, first, first_constant in model.numbered():
        for number, parameter in enumerate(term.parameters, start=first):
            if term.friction and parameter.dimension[1] > 0:
                kinds[number] = "speed", ORDINARY_SPEED
            elif term.friction:
                kinds[number] = "direction", ORDINARY_DIRECTION
        for number, constant in enumerate(term.constants, start=count + first_constant):
            if term.friction:
                kinds[number] = constant.name, ORDINARY_CONSTANT
    return kinds


def ordinary_shifts(model: TorqueModel, parameters: FloatArray) -> FloatArray:
    """By how much friction ordinarily differs between two recordings of a healthy arm, its constants held.

    Args:
        model: Of p parameters.
        parameters: Their values, first in (u,) unknowns.

    Returns:
        (u, s) one standard deviation a column: at each joint of what depends on direction, and of what grows with
        speed.
    """
    causes: dict[tuple[str, str], FloatArray] = {}
    for number, (kind, size) in friction_kinds(model).items():
        if number < len(model.parameters):
            cause = model.parameters[number].joint, kind
            causes.setdefault(cause, np.zeros(len(parameters)))[number] = size * parameters[number]
    return np.stack([*causes.values()], axis=1) if causes else np.zeros((len(parameters), 0))


def _factors(
    kinds: dict[int, tuple[str, float]], parameters: FloatArray, numbers: Sequence[int], width: int
) -> tuple[FloatArray, FloatArray]:
    """(f, u) changes of the unknowns with each factor of a joint's friction, and (f,) their ordinary sizes."""
    directions, sizes = [], []
    own = sorted((kinds[number], number) for number in set(numbers) if number in kinds)
    for (_, size), members in groupby(own, key=lambda item: item[0]):
        direction = np.zeros(width)
        for _, number in members:
            direction[number] = parameters[number] if number < len(parameters) else 1.0
        if direction.any():
            directions.append(direction)
            sizes.append(size)
    return np.array(directions).reshape(-1, width), np.array(sizes)


def _variance(
    torque: FloatArray, residual: FloatArray, group: np.ndarray, prior: FloatArray, pseudo_count: float = 0.0
) -> FloatArray:
    """(f, f) variance between groups of rows.

    Args:
        torque: (M, f) weighted columns of the factors.
        residual: (M,) weighted.
        group: (M,) of each row.
        prior: (f, f) where the iteration begins.
        pseudo_count: Groups that `prior` counts as.
    """
    members = [group == one for one in np.unique(group)]
    information = np.stack([torque[rows].T @ torque[rows] for rows in members])
    score = np.stack([torque[rows].T @ residual[rows] for rows in members])
    spread = prior
    for _ in range(ITERATIONS):
        posterior = np.linalg.inv(np.linalg.inv(spread + _LEAST * np.eye(len(spread))) + information)
        mean = np.einsum("gij,gj->gi", posterior, score)
        moments = (posterior + np.einsum("gi,gj->gij", mean, mean)).sum(axis=0)
        spread = (pseudo_count * prior + moments) / (pseudo_count + len(members))
    return np.asarray(spread)
