"""The plain model and the black box that `real_arms.py` compares `identify` with, written without its code.

Only the motions are shared: filtered signals, the low-pass of the rows, and which rows move.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.signals.motion import Motion

ROUNDS = 4
"""Fits of the plain model; its weights by joint are re-estimated from the residual after each."""
RANK_TOLERANCE = 1e-8
"""Singular values of the scaled regressor below this share of the largest are not excited, as in `pinocchio_wls.py`."""
FOLDS = 5
"""Contiguous blocks of rows in cross-validation: neighbouring rows share a low-pass and must not be split at random."""
RIDGE_ROWS = 1000
"""Most rows of a kernel ridge: its cost grows with their cube."""
SEED = 0
"""Of gradient boosting, and of the rows drawn for a kernel ridge."""


class Plain:
    """Base parameters, rotor inertia, Coulomb and viscous friction and offset, by weighted least squares."""

    def __init__(self, arm: Arm, motions: Sequence[Motion]) -> None:
        """Fit on the moving rows.

        Args:
            arm: Geometry and gravity; its inertials are not used.
            motions: What to fit.
        """
        self.model = pin.buildModelFromXML(arm.urdf)
        self.model.gravity.linear = np.asarray(arm.gravity)
        matrix, side = self.rows(motions), torque_rows(motions)
        moving = moving_rows(motions)
        weight = np.ones(side.shape[1])
        for _ in range(ROUNDS):
            weights = (moving * weight)[moving]
            scaled = matrix[moving] * weights[:, None]
            size = np.linalg.norm(scaled, axis=0)
            size[size == 0.0] = 1.0
            solved = np.linalg.lstsq(scaled / size, side[moving] * weights, rcond=RANK_TOLERANCE)
            self.parameters = solved[0] / size
            residual = np.where(moving, side - matrix @ self.parameters, 0.0)
            weight = np.sqrt(np.maximum(moving.sum(axis=0), 1) / np.maximum((residual**2).sum(axis=0), 1e-18))

    def rows(self, motions: Sequence[Motion]) -> FloatArray:
        """(M, n, 14 n) regressor, low-passed as the torque is."""
        parts = [part for motion in motions for part in motion.parts()]
        flat = [part.reduce(self._regressor(part).reshape(len(part.position), -1)) for part in parts]
        n = self.model.nv
        return np.concatenate(flat).reshape(-1, n, 14 * n)

    def _regressor(self, motion: Motion) -> FloatArray:
        """(N, n, 14 n) rigid-body, Coulomb, viscous, rotor and offset columns at full rate."""
        data, neutral, n = self.model.createData(), pin.neutral(self.model), self.model.nv
        whole = np.zeros((len(motion.position), n, 14 * n))
        for row, q, v, a in zip(whole, motion.position, motion.velocity, motion.acceleration):
            turned = pin.integrate(self.model, neutral, q)  # A continuous joint has two coordinates.
            row[:, : 10 * n] = pin.computeJointTorqueRegressor(self.model, data, turned, v, a)
        own = np.arange(n)
        signals = np.sign(motion.velocity), motion.velocity, motion.acceleration, np.ones_like(motion.velocity)
        for k, signal in enumerate(signals):
            whole[:, own, (10 + k) * n + own] = signal
        return whole

    def torque(self, motions: Sequence[Motion]) -> FloatArray:
        """(M, n) predicted torque of the rows, N·m."""
        return np.asarray(self.rows(motions) @ self.parameters)


def torque_rows(motions: Sequence[Motion]) -> FloatArray:
    """(M, n) measured torque of the rows, N·m."""
    return np.concatenate([motion.torque_rows for motion in motions])


def moving_rows(motions: Sequence[Motion]) -> np.ndarray:
    """(M, n) whether a row is free of the joint's standstill."""
    return np.concatenate([motion.moving for motion in motions])


def features(motions: Sequence[Motion]) -> FloatArray:
    """(M, 3 n) position, velocity and acceleration of all joints, low-passed as the torque is."""
    states = [np.hstack([m.position, m.velocity, m.acceleration]) for m in motions]
    return np.concatenate([motion.reduce(state) for motion, state in zip(motions, states)])


def learners(inputs: int) -> dict[str, Any]:
    """Gradient boosting, and kernel ridges of two widths and two penalties, for so many inputs."""
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    found: dict[str, Any] = {
        "boosting": HistGradientBoostingRegressor(
            max_iter=100, max_leaf_nodes=15, l2_regularization=1.0, early_stopping=False, random_state=SEED
        )
    }
    for width, alpha in product((0.2, 1.0), (0.3, 3.0)):
        ridge = KernelRidge(kernel="rbf", gamma=width / inputs, alpha=alpha)
        found[f"ridge {width:g} {alpha:g}"] = make_pipeline(StandardScaler(), ridge)
    return found


def trained(learner: Any, name: str, inputs: FloatArray, target: FloatArray) -> Any:
    """The learner fitted to `target` (M,) at `inputs` (M, d); a kernel ridge to at most `RIDGE_ROWS` of them."""
    if name.startswith("ridge") and len(target) > RIDGE_ROWS:
        kept = np.random.default_rng(SEED).choice(len(target), RIDGE_ROWS, replace=False)
        inputs, target = inputs[kept], target[kept]
    return learner.fit(inputs, target)


def black_box(inputs: FloatArray, target: FloatArray) -> tuple[str, Any]:
    """The learner that predicts best in cross-validation over contiguous blocks, fitted to all rows.

    Args:
        inputs: (M, d) features.
        target: (M,) residual of the plain model, N·m.

    Returns:
        Its name, and the learner.
    """
    block = np.arange(len(target)) * FOLDS // len(target)
    error = dict.fromkeys(learners(inputs.shape[1]), 0.0)
    for fold, (name, learner) in product(range(FOLDS), learners(inputs.shape[1]).items()):
        out = block == fold
        predicted = trained(learner, name, inputs[~out], target[~out]).predict(inputs[out])
        error[name] += float(((target[out] - predicted) ** 2).sum())
    best = min(error, key=lambda name: error[name])
    return best, trained(learners(inputs.shape[1])[best], best, inputs, target)
