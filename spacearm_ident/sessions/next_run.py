"""The motion of the next experiment, within what the recordings show to be free.

What is suspected may be a stop or a cable: a joint goes no farther, and no faster, than it was recorded to go. Where
that is too little for the motion to be of use it goes farther, and the words beside it say so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..errors import UserError
from ..excitation.composite import (
    EXPERIMENT_OF,
    LARGEST_STROKE_RAD,
    LEAST_RANGE,
    PURPOSES,
    SLOW_RAD_S,
    SPEEDS_RAD_S,
    experiment_for,
)
from ..excitation.constraints import limits_for_excitation
from ..excitation.segments import MotionLimits
from ..excitation.trajectory import Trajectory
from ..mismatch.finding import Explanation
from ..recording import Recording
from ..signals.prepare import SPIKE_WINDOW

SPEED_OVER_S = 0.1
"""Time over which a recorded speed is a mean, s: never above what the joint reached, and of an encoder's step it makes
ten steps a second."""
_STEP_S = 0.01
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Recorded:
    """How far and how fast the joints went in recordings, (n,) each in the order of the arm, SI.

    Attributes:
        lower: Lowest positions.
        upper: Highest positions.
        velocity: Highest speeds, means over `SPEED_OVER_S`.
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray

    @classmethod
    def of(cls, arm: Arm, *recordings: Recording) -> Recorded:
        """What recordings of an arm show together.

        Args:
            arm: The arm of n joints.
            recordings: At least one.
        """
        paths = [path for recording in recordings for path in _paths(recording.in_order(arm.joint_names))]
        position = np.concatenate([position for _, position in paths])
        speeds = np.stack([_speed(*path) for path in paths])
        return cls(position.min(axis=0), position.max(axis=0), speeds.max(axis=0))


def _paths(recording: Recording) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Times (m,) and positions (m, n) of the parts of a recording, from its first position, without spikes.

    Where a reading failed for a sample or two the joint has not been.
    """
    yield recording.time[:1], recording.position[:1]
    for part in recording.segments:
        yield recording.time[part], median_filter(recording.position[part], size=(SPIKE_WINDOW, 1))


def _speed(time: FloatArray, position: FloatArray) -> FloatArray:
    """(n,) highest speed along positions (m, n), a mean over `SPEED_OVER_S`; zero where they do not last as long."""
    step = 1 if len(time) < 2 else max(round(SPEED_OVER_S / float(np.median(np.diff(time)))), 1)
    if len(time) <= step:
        return np.zeros(position.shape[1])
    passed = (time[step:] - time[:-step])[:, None]
    return np.asarray((np.abs(position[step:] - position[:-step]) / passed).max(axis=0))


def next_run(explanation: Explanation, arm: Arm, field: Recording, *others: Recording) -> Trajectory | None:
    """Trajectory of the next experiment; None where none is proposed or none keeps the limits.

    Args:
        explanation: The analysis; `next_effect` and `next_joints` say what the experiment is for.
        arm: The arm, with its motion limits.
        field: Recording whose first position the run starts from.
        others: Further recordings of the arm: what they reach is free as well.
    """
    purpose = EXPERIMENT_OF.get(explanation.next_effect, explanation.next_effect)
    if purpose not in PURPOSES:
        return None
    start = field.in_order(arm.joint_names).position[0]
    try:
        limits, _ = limits_for_excitation(arm, start)
        free = _within(limits, Recorded.of(arm, field, *others), _moved(explanation, arm))
        return experiment_for(purpose, arm, free, start=start, joints=explanation.next_joints or None)
    except UserError:
        return None


def _moved(explanation: Explanation, arm: Arm) -> np.ndarray:
    """(n,) whether the experiment moves a joint."""
    return np.array([not explanation.next_joints or name in explanation.next_joints for name in arm.joint_names])


def _within(limits: MotionLimits, recorded: Recorded, moved: np.ndarray) -> MotionLimits:
    """The arm's limits, of joints that move those of the recordings, widened where these are of no use."""
    centre, narrow = (recorded.upper + recorded.lower) / 2, recorded.upper - recorded.lower < LEAST_RANGE
    lower = np.where(narrow, centre - LARGEST_STROKE_RAD / 2, recorded.lower)
    upper = np.where(narrow, centre + LARGEST_STROKE_RAD / 2, recorded.upper)
    velocity = np.where(recorded.velocity < SLOW_RAD_S, SPEEDS_RAD_S[-1], recorded.velocity)
    return replace(
        limits,
        lower=np.where(moved, np.maximum(lower, limits.lower), limits.lower),
        upper=np.where(moved, np.minimum(upper, limits.upper), limits.upper),
        velocity=np.where(moved, np.minimum(velocity, limits.velocity), limits.velocity),
    )


def described(explanation: Explanation, planned: Trajectory | None, arm: Arm, *recordings: Recording) -> Explanation:
    """The analysis with the words that go with a planned experiment: what it moves, and where that was not recorded.

    Args:
        explanation: The analysis.
        planned: As of `next_run`.
        arm: The arm.
        recordings: Those that it was planned by.
    """
    if planned is None:
        return explanation
    purpose = EXPERIMENT_OF.get(explanation.next_effect, explanation.next_effect)
    motion = planned.evaluate(np.arange(0.0, planned.duration_s, _STEP_S))
    low, high, fast = motion.q.min(axis=0), motion.q.max(axis=0), np.abs(motion.qd).max(axis=0)
    recorded = Recorded.of(arm, *recordings)
    spans, cautions = [], []
    for k, joint in enumerate(arm.joints):
        units = joint.units
        span = f"{joint.name} from {low[k]:.3g} to {high[k]:.3g} {units.position}"
        if high[k] - low[k] > _ROUNDING:
            spans.append(f"{span} at up to {fast[k]:.2g} {units.velocity}")
        if low[k] < recorded.lower[k] - _ROUNDING or high[k] > recorded.upper[k] + _ROUNDING:
            shown = f"recorded: {recorded.lower[k]:.3g} to {recorded.upper[k]:.3g}"
            cautions.append(f"leaves the recorded range: {span} ({shown}), make sure it is free")
        if fast[k] > recorded.velocity[k] + _ROUNDING:
            shown = f"recorded: {recorded.velocity[k]:.2g}"
            cautions.append(f"faster than recorded: {joint.name} up to {fast[k]:.2g} {units.velocity} ({shown})")
    inside = "" if cautions else ", each within the range and the speed that the recordings show"
    words = f"{PURPOSES[purpose]}: {'; '.join(spans)}{inside}; {planned.duration_s:.0f} s"
    return replace(explanation, next_motion=words, next_cautions=tuple(cautions))
