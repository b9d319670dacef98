"""What a flexible function of the same inputs could remove of a residual: the ceiling for any physics.

Kernel ridge regression (Gaussian kernel; Saunders, Gammerman and Vovk 1998) on positions, velocities, accelerations and
directions of all joints. Its length and ridge are chosen by blocked cross-validation on the fitted recordings, nothing
being one of the choices; what it leaves of held-out recordings is the ceiling.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from ..arrays import FloatArray
from ..regression.held_out import FOLDS
from ..signals.motion import Motion

MOST_ROWS = 1200
"""Rows that the regression is fitted to, evenly spaced: its cost grows with their cube."""
LENGTHS = (0.5, 1.0, 2.0)
"""Kernel lengths tried, in units of the median distance between inputs."""
RIDGES = (1e-2, 1e-1, 1.0, 10.0)
"""Ridges tried, in units of the kernel's variance: from little noise to almost only noise."""


@dataclass(frozen=True)
class Inputs:
    """Rows of inputs (M, k), joint by joint which of them count (M, n), and the block of time of each (M,)."""

    values: FloatArray
    counts: np.ndarray
    block: np.ndarray


def inputs_of(motions: Sequence[Motion], counts: Sequence[np.ndarray]) -> Inputs:
    """Inputs of motions.

    Args:
        motions: Motions.
        counts: By motion, (M, n) rows of each joint that count.
    """
    parts = [
        np.concatenate(
            [
                motion.reduce(motion.position),
                motion.velocity_rows,
                motion.reduce(motion.acceleration),
                motion.reduce(np.sign(motion.velocity)),
            ],
            axis=1,
        )
        for motion in motions
    ]
    values = np.concatenate(parts)
    block = np.arange(len(values)) * FOLDS // max(len(values), 1)
    return Inputs(values, np.concatenate(counts), block)


def black_box(fitted: Inputs, residual: FloatArray, judged: Inputs) -> FloatArray:
    """(M', n) residual that a flexible function fitted to some rows predicts at others, N m.

    Args:
        fitted: Inputs that it is fitted to.
        residual: (M, n) residual there; not used where a row does not count.
        judged: Inputs to predict at.
    """
    centre, spread = fitted.values.mean(axis=0), fitted.values.std(axis=0) + 1e-9
    known, asked = (fitted.values - centre) / spread, (judged.values - centre) / spread

    def predicted(joint: int) -> FloatArray:
        rows = np.flatnonzero(fitted.counts[:, joint])
        rows = rows[:: max(1, int(np.ceil(len(rows) / MOST_ROWS)))]
        if len(rows) < 2 * FOLDS:
            return np.zeros(len(asked))
        return _ridge(known[rows], residual[rows, joint], fitted.block[rows], asked)

    # Nearly all of it is LAPACK's, which lets other threads go on.
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
        return np.stack([*threads.map(predicted, range(residual.shape[1]))], axis=1)


def _ridge(inputs: FloatArray, target: FloatArray, block: np.ndarray, asked: FloatArray) -> FloatArray:
    squared = cdist(inputs, inputs, "sqeuclidean")
    median = float(np.median(squared[np.triu_indices_from(squared, 1)])) + 1e-12
    best, choice = float(target @ target), None
    for length in LENGTHS:
        kernel = np.exp(-0.5 * squared / (length**2 * median))
        for ridge in RIDGES:
            left = sum(_left_out(kernel, target, block == fold, ridge) for fold in np.unique(block))
            if left < best:
                best, choice = left, (length, ridge)
    if choice is None:
        return np.zeros(len(asked))
    length, ridge = choice
    kernel = np.exp(-0.5 * squared / (length**2 * median))
    weights = cho_solve(cho_factor(kernel + ridge * np.eye(len(kernel))), target)
    return np.asarray(np.exp(-0.5 * cdist(asked, inputs, "sqeuclidean") / (length**2 * median)) @ weights)


def _left_out(kernel: FloatArray, target: FloatArray, out: np.ndarray, ridge: float) -> float:
    """Squares of a fold that a fit to the others leaves."""
    rest = ~out
    own = kernel[np.ix_(rest, rest)] + ridge * np.eye(int(rest.sum()))
    error = target[out] - kernel[np.ix_(out, rest)] @ cho_solve(cho_factor(own), target[rest])
    return float(error @ error)
