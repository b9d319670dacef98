"""What no unbiased estimate can be expected to beat: the Cramér-Rao bound on the error of a predicted torque.

White torque noise of known size, every sample, joint states as recorded, the law that is true, and the weak prior that
`identify` has (v_b to a factor of e): the information is H = sum_j A_j' A_j / sigma_j^2 + P over parameters and log v_b
(A_j: joint j's columns and the derivative by its log v_b), and a validation row V is off by sqrt(V H^-1 V') at least.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.recording import Recording
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare

STEP = 1e-4
MOTION_HZ = 20.0
"""Joint states are low-passed here: what of them the fit may use."""


def least_rms(
    arm: Arm, fit: Sequence[Recording], validation: Sequence[Motion], law: dict[str, FloatArray], sigma: FloatArray
) -> FloatArray:
    """(n,) least expected RMS by joint of the torque predicted on reduced validation rows, N·m.

    Args:
        arm: Arm of n joints.
        fit: What is fitted.
        validation: What is predicted.
        law: Symbol -> (n,) true friction.
        sigma: (n,) standard deviation of the white noise on the torque, N·m.
    """
    model = TorqueModel(arm, structure_of(arm))
    motions, _ = prepare(fit, arm.joint_names, MOTION_HZ, average=False)
    prior = make_prior(model, motions)
    count, joints = len(model.parameters), len(arm.joints)
    unknown = np.concatenate([prior.free, np.arange(count, count + joints)])
    information = np.eye(len(unknown))
    information[: len(prior.free), : len(prior.free)] = (prior.rows.T @ prior.rows)[np.ix_(prior.free, prior.free)]
    for motion in motions:
        for columns, spread in zip(_columns(model, motion, law), sigma):
            weighted = columns[:, unknown] / spread
            information += weighted.T @ weighted
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    squares = np.zeros(joints)
    for motion in validation:
        for joint, columns in enumerate(_columns(model, motion, law)):
            rows = motion.reduce(columns[:, unknown])
            squares[joint] += np.einsum("ij,jk,ik->", rows, covariance, rows)
    return np.sqrt(squares / sum(len(motion.torque_rows) for motion in validation))


def _columns(model: TorqueModel, motion: Motion, law: dict[str, FloatArray]) -> list[FloatArray]:
    """Per joint, (N, p + n) columns of all parameters, and derivatives of its torque by the logarithms of the v_b."""
    names = model.arm.joint_names
    truth = np.array(
        [law[item.symbol][names.index(item.joint)] if item.symbol in law else 0.0 for item in model.parameters]
    )
    whole = [np.zeros((len(motion.position), len(truth) + len(names))) for _ in names]
    for term, first, _ in model.numbered():
        values = [law["v_b"][names.index(item.joint)] if item.symbol == "v_b" else 0.0 for item in term.constants]
        moved = [value * np.exp(STEP) for value in values]
        for row, (indices, columns) in term.columns(motion, values, None).items():
            numbers = first + np.array(indices)
            whole[row][:, numbers] = columns
            if values:
                change = term.columns(motion, moved, None)[row][1] - columns
                whole[row][:, len(truth) + row] = change @ truth[numbers] / STEP
    return whole
