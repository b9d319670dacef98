"""The motion on which a format's cost is taken: what a result was validated on, or a sweep where there is no result."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.friction_curve import STEADY_HZ
from ..dynamics.model import IdentifiedModel
from ..estimate.identified import Trace, Validation
from ..signals.motion import Motion

SWEEP_S, SWEEP_HZ = 40.0, 100.0
"""Length and rate of the sweep that stands in for a recorded motion, s and Hz."""
USUAL_SPEED = 1.0
"""Top speed of the sweep of a joint without a velocity limit, rad/s (m/s); with one, half of it is taken."""


def motions_of(model: IdentifiedModel, validation: Validation | None) -> list[Motion]:
    """Motions at the rows of a validation's traces, or one sweep.

    Args:
        model: The identified model.
        validation: Of it; None: a sweep of all joints stands in.

    Returns:
        Motions with accelerations; `torque` is what was measured, zero for the sweep.
    """
    if validation is None or not validation.traces:
        return [sweep(model.model.arm)]
    return [part for trace in validation.traces for part in _of_trace(model.model.arm.joint_names, trace)]


def _of_trace(joints: tuple[str, ...], trace: Trace) -> list[Motion]:
    """A trace as motions, cut where its rows are not evenly apart."""
    steps = np.diff(trace.time)
    if not len(steps):
        return []
    usual = float(np.median(steps))
    cuts = [0, *(np.flatnonzero(np.abs(steps - usual) > 0.1 * usual) + 1).tolist(), len(trace.time)]
    parts = []
    for start, stop in pairwise(cuts):
        if stop - start < 5:
            continue
        part = slice(start, stop)
        acceleration = np.gradient(trace.velocity[part], usual, axis=0)
        parts.append(
            _motion(joints, 1.0 / usual, trace.position[part], trace.velocity[part], acceleration, trace.measured[part])
        )
    return parts


def sweep(arm: Arm) -> Motion:
    """All joints on sines of incommensurate frequencies, within limits, up to half their speed limits."""
    time = np.arange(0.0, SWEEP_S, 1.0 / SWEEP_HZ)
    position, velocity, acceleration = (np.empty((len(time), len(arm.joints))) for _ in range(3))
    for k, joint in enumerate(arm.joints):
        lower = joint.lower if np.isfinite(joint.lower) else -np.pi
        upper = joint.upper if np.isfinite(joint.upper) else np.pi
        top = 0.5 * joint.velocity_limit if np.isfinite(joint.velocity_limit) else USUAL_SPEED
        omega = 2.0 * np.pi * (0.11 + 0.037 * k)
        size = min(0.4 * (upper - lower), top / omega)
        angle = omega * time + 0.7 * k
        position[:, k] = 0.5 * (lower + upper) + size * np.sin(angle)
        velocity[:, k], acceleration[:, k] = size * omega * np.cos(angle), -size * omega**2 * np.sin(angle)
    return _motion(arm.joint_names, SWEEP_HZ, position, velocity, acceleration, np.zeros_like(position))


def steady(
    joints: tuple[str, ...],
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    rate_hz: float | None = None,
) -> Motion:
    """States as a motion.

    Args:
        joints: Names of the n joints.
        position: (N, n) rad or m.
        velocity: (N, n) rad/s or m/s.
        acceleration: (N, n) rad/s² or m/s².
        rate_hz: Of the states, Hz; None: each is by itself, and what friction remembers is long gone through.
    """
    return _motion(joints, rate_hz or STEADY_HZ, position, velocity, acceleration, np.zeros_like(position))


def _motion(
    joints: tuple[str, ...],
    rate_hz: float,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
) -> Motion:
    zero = np.zeros(position.shape[1])
    return Motion(joints, rate_hz, 0.0, position, velocity, acceleration, torque, zero, zero)
