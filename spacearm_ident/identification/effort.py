"""Recorded effort as torque: the unit an arm's driver publishes is the arm's (`effort` in the arm YAML).

`/joint_states` should carry N·m. Drivers of other people publish what their robot tells: Universal Robots' driver the
motor currents in A, many CANopen drivers per cent of the rated torque. What the arm YAML declares is converted here,
once, before anything else looks at a recording. What it does not declare is taken for N·m, and refused where it
cannot be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.effort_limit import BEYOND_TORQUE
from ..errors import UserError
from ..recording import Recording
from ..recording.recording import Issue

SHARE = 0.05
"""Share of the samples that must lie beyond: a peak torque lasts for a second at most, damaged samples are fewer."""


def in_newton_metres(recordings: Sequence[Recording], arm: Arm) -> list[Recording]:
    """The recordings with effort as torque on the output side, N·m (N for a prismatic joint).

    Args:
        recordings: As read.
        arm: Whose driver published them.

    Returns:
        The same where the arm declares N·m, or nothing; with an issue `effort_converted` where it was converted.

    Raises:
        UserError: Effort not declared that cannot be torque.
    """
    done = as_declared(recordings, arm)
    if not arm.effort_declared:
        for recording in done:
            _require_torque(recording, arm)
    return done


def as_declared(recordings: Sequence[Recording], arm: Arm) -> list[Recording]:
    """The recordings with effort converted where the arm declares its unit, else as recorded, whatever that is.

    Args:
        recordings: As read.
        arm: Whose driver published them.
    """
    return [_converted(recording, arm) for recording in recordings]


def _converted(recording: Recording, arm: Arm) -> Recording:
    by_name = {joint.name: joint.effort_scale for joint in arm.joints}
    scale = np.array([by_name.get(name, 1.0) for name in recording.joints])
    if np.all(scale == 1.0):
        return recording
    changed = [(name, factor) for name, factor in zip(recording.joints, scale.tolist(), strict=True) if factor != 1.0]
    factors = ", ".join(f"{name} {factor:.4g}" for name, factor in changed)
    issue = Issue("effort_converted", f"effort multiplied by {factors}, as the arm declares its unit")
    return replace(recording, effort=recording.effort * scale, issues=(*recording.issues, issue))


def _require_torque(recording: Recording, arm: Arm) -> None:
    limits = {joint.name: joint.effort_limit for joint in arm.joints}
    for name, effort in zip(recording.joints, np.abs(recording.effort).T, strict=True):
        limit = limits.get(name, np.inf)
        if np.isfinite(limit) and np.mean(effort > BEYOND_TORQUE * limit) > SHARE:
            raise UserError(
                f"effort of {name} is beyond {BEYOND_TORQUE:g} times its limit of {limit:g} N·m in "
                f"{np.mean(effort > BEYOND_TORQUE * limit):.0%} of the samples (largest {effort.max():.4g}): not N·m; "
                "say 'effort: {unit: A}' or 'percent' in the arm YAML, with its constants, or correct the limit; "
                "'effort: {unit: N m}' takes it as it is"
            )
