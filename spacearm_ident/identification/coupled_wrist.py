"""Whether a motor that turns with the last two joints would explain a wrist that fits badly.

Six-joint arms of several makers drive the last joint through the one before it: the last motor turns with q_5 + q_6, or
q_5 - q_6 (`dynamics/coupling.py`). Without that coupling both joints fit badly, and no term of a single joint helps. So
where one of them does, the plain model is fitted with neither and with either coupling, a few tenths of a second each,
and held-out blocks decide as they do about every other optional term (`structure.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm, Coupling
from ..estimate.coupling import CouplingTrial
from ..regression.held_out import FEWEST_BLOCKS, LEVEL, bound, t_of_drop, time_blocks
from .block_grams import BlockGrams
from .fit import Fit
from .plain import plain_fit
from .verdict import GOOD

SIGNS = (1.0, -1.0)
"""Ratios of the last joint tried, that of the one before it being 1; motor turns a joint turn on the output side."""


def try_coupling(fit: Fit) -> CouplingTrial | None:
    """Try couplings of the last two joints where one of them fits badly.

    A coupling helps if both joints are predicted better in held-out blocks, each beyond chance: its motor acts on both.

    Args:
        fit: Of a model without a coupling. An arm that has one, or whose last two joints do not both turn and move, is
            left as it is.

    Returns:
        The better trial; None where there is nothing to try, or too little to decide by.
    """
    arm = fit.regression.model.arm
    if len(arm.joints) < 3 or arm.couplings or not all(joint.revolute for joint in arm.joints[-2:]):
        return None
    if not any(_share(fit, joint) > GOOD for joint in (-2, -1)):
        return None
    torque = _torque(fit)
    if ((torque > 0.0).sum(axis=0) < FEWEST_BLOCKS).any():
        return None
    first, last = arm.joint_names[-2:]
    couplings = [Coupling(f"motor_of_{last}", {first: 1.0, last: sign}) for sign in SIGNS]
    before = _held_out(fit, arm)
    tried = [_held_out(fit, replace(arm, couplings=(coupling,))) for coupling in couplings]
    better = int(np.argmin([(left.sum(axis=0) / before.sum(axis=0)).sum() for left in tried]))
    after, level = tried[better], bound(LEVEL / len(SIGNS), len(before))
    helps = all(t_of_drop(left, right) > level for left, right in zip(before.T, after.T))
    shares = [np.sqrt(left.sum(axis=0) / torque.sum(axis=0)).tolist() for left in (before, after)]
    return CouplingTrial(couplings[better], tuple(shares[0]), tuple(shares[1]), helps)


def _share(fit: Fit, joint: int) -> float:
    """Residual RMS of a joint's moving rows over its torque's; zero where it does not move."""
    torque = float(np.linalg.norm(fit.regression.rows[joint].torque))
    return float(np.linalg.norm(fit.residuals[joint])) / torque if torque > 0.0 else 0.0


def _torque(fit: Fit) -> FloatArray:
    """(blocks, 2) squares of the last two joints' torque, N²·m², summed over their moving rows by block of time."""
    block_of, recording = time_blocks(fit.regression.motions)
    both = fit.regression.rows[-2:]
    sums = [np.bincount(rows.group(block_of), rows.torque**2, len(recording)) for rows in both]
    return np.asarray(np.column_stack(sums))


def _held_out(fit: Fit, arm: Arm) -> FloatArray:
    """(blocks, 2) squares of the last two joints, N²·m², that the plain model of an arm leaves in held-out blocks."""
    regression, prior, solution = plain_fit(fit, arm)
    left = BlockGrams(regression, np.zeros_like(solution.constants)).left_out(prior)
    # The plain model's weight is one value a joint.
    size = [1.0 / rows.weight[0] for rows in regression.rows[-2:]]
    return np.asarray(left[:, -2:] * np.square(size))
