"""How plausible positions, speeds and torques are beside the URDF's limits, as a log-likelihood ratio."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from .rows import Rows
from .setup import Setup

POSITION_SLACK, POSITION_SD = 0.05, 0.15
"""How far past a URDF's limit a joint may well be, and the standard deviation beyond it, rad."""
SPEED_SD = 0.3
"""Standard deviation of the logarithm of a speed beyond the URDF's limit."""
USUAL_SPEED, USUAL_SPEED_SD = 6.0, 0.5
"""Speed that joints without a limit seldom exceed, rad/s, and the standard deviation of its logarithm."""
EFFORT_SLACK, EFFORT_SD = 1.5, 0.5
"""Factor on a URDF's torque limit that motors reach for moments, and standard deviation of the logarithm beyond."""
EXCURSION_SPREAD = 0.7
"""Of the logarithm of a joint's excursion about the median of all: scale of a Laplace distribution. A recording in
which one joint moves as much in degrees as the others in radians (a factor of 57) is seldom made."""
MOST = 12.0
"""Most that one limit may count for: limits in URDFs are wrong at times."""


class Ranges:
    """What the recorded columns range over, and how well that fits the joints of an arm under a setup."""

    def __init__(self, arm: Arm, rows: Rows) -> None:
        self.arm = arm
        self.low, self.high = rows.position.min(axis=0), rows.position.max(axis=0)
        self.speed = np.percentile(np.abs(rows.velocity), 99.5, axis=0)
        self.effort = np.percentile(np.abs(rows.torque(np.zeros(rows.position.shape[1]))), 99.5, axis=0)

    def excess(self, setup: Setup) -> FloatArray:
        """(n,) how far the joints go past their limits, rad; negative inside."""
        source, scale, offset = setup.position_from, setup.position_scale, setup.position_offset
        ends = np.stack([self.low[source] * scale, self.high[source] * scale]) + offset
        lower = np.array([joint.lower for joint in self.arm.joints])
        upper = np.array([joint.upper for joint in self.arm.joints])
        return np.asarray(np.maximum(lower - ends.min(axis=0), ends.max(axis=0) - upper))

    def speed_ratio(self, setup: Setup) -> FloatArray:
        """(n,) speed over its limit, or over the usual one."""
        limits = np.array([joint.velocity_limit for joint in self.arm.joints])
        usual = np.where(np.isfinite(limits), limits, USUAL_SPEED)
        return np.asarray(np.abs(setup.position_scale) * self.speed[setup.position_from] / usual)

    def excursions(self, setup: Setup) -> FloatArray:
        """Logarithm of what each revolute joint that moves ranges over, about the median of all."""
        turns = np.array([joint.revolute for joint in self.arm.joints])
        span = (self.high - self.low)[setup.position_from] * np.abs(setup.position_scale)
        logs = np.log(span[turns & (span > 0.0)])
        return np.asarray(logs - np.median(logs)) if len(logs) else logs

    def effort_ratio(self, setup: Setup) -> FloatArray:
        """(n,) torque, but for moments, over its limit; 0 where there is none."""
        limits = np.array([joint.effort_limit for joint in self.arm.joints])
        return np.asarray(self.effort[setup.effort_from] * np.abs(setup.effort_sign) / limits)

    def log_likelihood(self, setup: Setup) -> float:
        """Of the ranges: 0 where all are within limits and alike."""
        over = np.maximum(self.excess(setup) - POSITION_SLACK, 0.0) / POSITION_SD
        limited = np.array([np.isfinite(joint.velocity_limit) for joint in self.arm.joints])
        fast = np.log(np.maximum(self.speed_ratio(setup), 1.0)) / np.where(limited, SPEED_SD, USUAL_SPEED_SD)
        wide = (setup.gain_sd > 0.5) | (setup.common_gain_sd > 0)
        strong = np.where(
            wide,
            0.0,
            np.log(np.maximum(self.effort_ratio(setup) / EFFORT_SLACK, 1.0)) / EFFORT_SD,
        )
        unlike = float(np.abs(self.excursions(setup)).sum()) / EXCURSION_SPREAD
        return -unlike - float(sum(np.minimum(0.5 * one**2, MOST).sum() for one in (over, fast, strong)))
