"""What a run must keep, checked instant by instant: every limit with its margin.

Position, velocity, acceleration and jerk of the arm, torque by a model, the highest excited frequency under the
structure's first, distances of the arm from itself and the ground. `check` measures a finished run on a fine grid;
how an optimiser gets there is its own affair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..errors import UserError
from ..signals.motion import Motion as SampledMotion
from .clearance import Clearance
from .run import limits_of
from .segments import Motion, MotionLimits
from .trajectory import FourierTrajectory, Trajectory

STEP_S = 0.002
"""Grid on which limits are checked."""
CLEARANCE_STEP_S = 0.02
TORQUE_SHARE = 0.9
"""Share of a torque limit a run may use: the model that says so is not exact."""
_ROUNDING = 1e-6
_UP_TO_SPEED_S = 0.5
_BLOCK = 50_000
"""Samples whose torque is computed at once."""

REMEDIES = {
    "position": "choose a start posture inside the limits, or wider limits",
    "velocity": "give a lower --fundamental, or fewer --harmonics",
    "acceleration": "give a lower --fundamental, or fewer --harmonics",
    "jerk": "give a lower --fundamental, fewer --harmonics, or a higher --jerk",
    "torque": "start from a posture that gravity loads less (--start), or correct torque_limit_Nm in the arm file",
    "frequency": "give fewer --harmonics or a lower --fundamental",
    "clearance": "choose another --start, a smaller --clearance, or correct the geometry, the position limits or "
    "--ground",
}
"""What a person can do about a limit that cannot be kept."""


@dataclass(frozen=True)
class Requirements:
    """All hard limits.

    Attributes:
        motion: Position, velocity, acceleration and, where given, jerk.
        torque_Nm: (n,) allowed torque (infinite where none).
        identified: The model that predicts torque.
        structural_hz: The structure's first resonance, which no excited frequency may reach; None: not stated.
        clearance: Distances; None: not checked.
        accelerations: Multiples of the planned acceleration with which torque must be kept, 1 among them: what leads
            the arm back to its path after a stall asks for more of it, or for less.
    """

    motion: MotionLimits
    torque_Nm: FloatArray
    identified: IdentifiedModel
    structural_hz: float | None = None
    clearance: Clearance | None = None
    accelerations: tuple[float, ...] = (1.0,)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return self.identified.model.arm.joint_names


def allowed_torque(arm: Arm) -> FloatArray:
    """(n,) N·m that a run may ask for: `TORQUE_SHARE` of each torque limit of an arm."""
    return TORQUE_SHARE * np.array([joint.effort_limit for joint in arm.joints])


def limits_for_excitation(
    arm: Arm, start: FloatArray, jerk: FloatArray | None = None
) -> tuple[MotionLimits, list[str]]:
    """An arm's motion limits made complete, and what had to be assumed.

    A joint without position limits may turn half a turn to either side of `start`; one without an acceleration
    limit may reach its velocity limit in `_UP_TO_SPEED_S`.

    Args:
        arm: Arm of n joints; each needs a velocity limit.
        start: (n,) start posture, rad.
        jerk: (n,) limit of the jerk, rad/s³; None: no limit.

    Returns:
        The limits, and one note for each kind of limit that was assumed.

    Raises:
        UserError: A joint has no velocity limit, or no room between its position limits.
    """
    given = limits_of(arm, arm.joint_names)
    notes = []
    slow = [joint for joint in arm.joints if not np.isfinite(joint.velocity_limit)]
    if slow:
        raise UserError(f"{slow[0].name} has no velocity limit; give velocity_limit_rad_s in an arm YAML")
    acceleration = np.array([joint.acceleration_limit for joint in arm.joints])
    if not np.all(np.isfinite(acceleration)):
        acceleration = np.where(np.isfinite(acceleration), acceleration, given.velocity / _UP_TO_SPEED_S)
        notes.append(
            f"acceleration limits are not given: taken as the velocity limit in {_UP_TO_SPEED_S:g} s; "
            "give acceleration_limit_rad_s2 in an arm YAML"
        )
    tight = [joint for joint in arm.joints if not joint.upper > joint.lower]
    if tight:
        raise UserError(f"{tight[0].name} has no room between its position limits; correct them, or make it fixed")
    bounded = np.array([np.isfinite(joint.upper - joint.lower) for joint in arm.joints])
    if not bounded.all():
        notes.append("joints without position limits are kept within half a turn of the start posture")
    lower = np.where(bounded, given.lower, start - np.pi)
    upper = np.where(bounded, given.upper, start + np.pi)
    return MotionLimits(lower, upper, given.velocity, acceleration, jerk), notes


@dataclass(frozen=True)
class Margin:
    """How near a run comes to one limit.

    Attributes:
        kind: position, velocity, acceleration, jerk, torque, frequency or clearance.
        where: The joint, or the pair of links.
        value: The extreme.
        limit: What is allowed.
        unit: Of both.
        at_s: When, from the start of the run.
        used: Share of the limit used; above 1 it is broken. For clearance needed over had.
    """

    kind: str
    where: str
    value: float
    limit: float
    unit: str
    at_s: float
    used: float

    @property
    def kept(self) -> bool:
        """Whether the limit holds."""
        return self.used <= 1.0 + _ROUNDING

    def complaint(self) -> str:
        """In one line: which limit, by how much, and what to do."""
        relation = "the least allowed is" if self.kind == "clearance" else "allowed is"
        return (
            f"{self.kind} of {self.where}: {self.value:.4g} {self.unit} at {self.at_s:.2f} s, where {relation} "
            f"{self.limit:.4g} {self.unit}; {REMEDIES[self.kind]}"
        )


def check(run: Trajectory, needs: Requirements, coarser: int = 1) -> tuple[Margin, ...]:
    """The margin of every limit along a run.

    Args:
        run: Motion of the joints of `needs`.
        needs: Limits; those that are infinite or not given have no margin.
        coarser: Multiple of the grid's steps, `STEP_S` and `CLEARANCE_STEP_S`, at which the run is evaluated.
    """
    times = _instants(run, coarser * STEP_S)
    motion = run.evaluate(times)
    margins = [*motion_margins(needs.joints, motion, needs.motion, times)]
    if needs.motion.jerk is not None:
        margins += _extremes("jerk", needs.joints, _jerk(run, times), needs.motion.jerk, "rad/s³", times)
    if np.isfinite(needs.torque_Nm).any():
        torque = largest_torque(needs, motion, 1.0 / (coarser * STEP_S))
        margins += _extremes("torque", needs.joints, torque, needs.torque_Nm, "N·m", times)
    margins += frequency_margin(run, needs.structural_hz)
    if needs.clearance is not None:
        margins += _clearance_margin(run, needs.clearance, coarser * CLEARANCE_STEP_S)
    return tuple(_in_own_unit(margin, needs.identified.model.arm) for margin in margins)


def broken(run: Trajectory, needs: Requirements) -> list[Margin]:
    """The limits that a run breaks: of every tenth instant where some are broken there, else of all instants.

    Args:
        run: Motion of the joints of `needs`.
        needs: Limits.

    Returns:
        Empty where all are kept, on the whole grid.
    """
    for coarser in (10, 1):
        margins = [margin for margin in check(run, needs, coarser) if not margin.kept]
        if margins:
            return margins
    return []


def _instants(run: Trajectory, step_s: float) -> FloatArray:
    """(T,) s: a grid along a run, of a periodic part the first period alone, which the others repeat."""
    times = np.minimum(np.arange(int(np.ceil(run.duration_s / step_s)) + 1) * step_s, run.duration_s)
    wanted = np.ones(len(times), dtype=bool)
    for segment, start_s in zip(run.segments, run.starts_s()):
        if isinstance(segment, FourierTrajectory):
            wanted &= (times <= start_s + segment.period_s) | (times >= start_s + segment.duration_s)
    return np.asarray(times[wanted])


_QUANTITY = {
    "position": "position",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "jerk": "jerk",
    "torque": "effort",
}
"""Kind of margin -> the attribute of `Units` that it is in."""


def _in_own_unit(margin: Margin, arm: Arm) -> Margin:
    """The margin in metres and newtons where its joint slides."""
    joint = next((joint for joint in arm.joints if joint.name == margin.where and not joint.revolute), None)
    if joint is None or margin.kind not in _QUANTITY:
        return margin
    return replace(margin, unit=getattr(joint.units, _QUANTITY[margin.kind]).replace(" ", "·"))


def require(margins: Sequence[Margin]) -> None:
    """Refuse a run that breaks a limit.

    Raises:
        UserError: Names the limit broken worst, by how much, and what to do.
    """
    broken = [margin for margin in margins if not margin.kept]
    if broken:
        # A posture out of range is why all the rest is wrong.
        worst = min(broken, key=lambda margin: (margin.kind != "position", -margin.used))
        raise UserError(worst.complaint())


def model_torque(identified: IdentifiedModel, motion: Motion, rate_hz: float) -> FloatArray:
    """(T, n) N·m along a motion, exact friction included.

    Args:
        identified: The model with its values.
        motion: (T, n) each, joints in the arm's order.
        rate_hz: Sampling rate of the motion, Hz.
    """
    names = identified.model.arm.joint_names
    torque = np.empty_like(motion.q)
    for first in range(0, len(torque), _BLOCK):
        part = slice(first, first + _BLOCK)
        sampled = SampledMotion.free_of_noise(names, rate_hz, *(values[part] for values in motion))
        torque[part] = identified.torque(sampled)
    return torque


def largest_torque(needs: Requirements, motion: Motion, rate_hz: float) -> FloatArray:
    """(T, n) N·m: of all `needs.accelerations` what is largest along a motion, with its sign.

    Torque is linear in the acceleration at given positions and velocities: two of them tell all.

    Args:
        needs: The model, and the multiples of the acceleration.
        motion: (T, n) each, as planned.
        rate_hz: Sampling rate of the motion, Hz.
    """
    planned = model_torque(needs.identified, motion, rate_hz)
    most = max(needs.accelerations)
    if most == 1.0:
        return planned
    more = model_torque(needs.identified, Motion(motion.q, motion.qd, most * motion.qdd), rate_hz)
    slope = (more - planned) / (most - 1.0)
    worst = planned
    for factor in needs.accelerations:
        other = planned + (factor - 1.0) * slope
        worst = np.where(np.abs(other) > np.abs(worst), other, worst)
    return worst


def motion_margins(joints: Sequence[str], motion: Motion, limits: MotionLimits, times: FloatArray) -> list[Margin]:
    """Margins of position, velocity and acceleration; a position counts from the middle of its range.

    Args:
        joints: Names of the n joints.
        motion: (T, n) each.
        limits: (n,) each; those that are infinite have no margin.
        times: (T,) instants of the motion, s from the start of the run.
    """
    margins = []
    for j, name in enumerate(joints):
        low, high = float(limits.lower[j]), float(limits.upper[j])
        if np.isfinite(high - low):
            middle, half = (high + low) / 2, (high - low) / 2
            row = int(np.argmax(np.abs(motion.q[:, j] - middle)))
            value = float(motion.q[row, j])
            limit = high if value > middle else low
            margins.append(Margin("position", name, value, limit, "rad", times[row], abs(value - middle) / half))
    margins += _extremes("velocity", joints, motion.qd, limits.velocity, "rad/s", times)
    return margins + _extremes("acceleration", joints, motion.qdd, limits.acceleration, "rad/s²", times)


def frequency_margin(run: Trajectory, structural_hz: float | None) -> list[Margin]:
    """Margin of the highest harmonic under the structure's first resonance; a chirp is meant to pass it.

    Args:
        run: Its Fourier segments are looked at, the others are not.
        structural_hz: The structure's first resonance, Hz; None: not stated.

    Returns:
        One margin; none where no resonance is stated or the run has no Fourier segment.
    """
    series = [segment for segment in run.segments if isinstance(segment, FourierTrajectory)]
    highest = max((segment.fundamental_hz * segment.a.shape[1] for segment in series), default=0.0)
    if structural_hz is None or highest == 0.0:
        return []
    return [Margin("frequency", "N_h·f0", highest, structural_hz, "Hz", 0.0, highest / structural_hz)]


def _extremes(
    kind: str, joints: Sequence[str], values: FloatArray, limits: FloatArray, unit: str, times: FloatArray
) -> list[Margin]:
    margins = []
    for j, name in enumerate(joints):
        if np.isfinite(limits[j]):
            row = int(np.argmax(np.abs(values[:, j])))
            value, limit = float(abs(values[row, j])), float(limits[j])
            margins.append(Margin(kind, name, value, limit, unit, float(times[row]), value / limit))
    return margins


def _jerk(run: Trajectory, times: FloatArray) -> FloatArray:
    """(T, n) rad/s³, the mean over a grid step from its ends."""
    half = STEP_S / 2
    before, after = np.maximum(times - half, 0.0), np.minimum(times + half, run.duration_s)
    ends = run.evaluate(np.stack([before, after], axis=1).ravel()).qdd.reshape(len(times), 2, -1)
    return np.asarray((ends[:, 1] - ends[:, 0]) / (after - before)[:, None])


def _clearance_margin(run: Trajectory, clearance: Clearance, step_s: float) -> list[Margin]:
    times = _instants(run, step_s)
    postures = run.evaluate(times).q
    # Rest and the way back repeat what came before: a posture seen before need not be measured again.
    _, first = np.unique(np.round(postures, 9), axis=0, return_index=True)
    first.sort()
    nearest = clearance.nearest(postures[first])
    if nearest is None:
        return []
    used = clearance.needed_m / nearest.distance_m if nearest.distance_m > 0 else np.inf
    where, at_s = " and ".join(nearest.pair), float(times[first[nearest.row]])
    return [Margin("clearance", where, nearest.distance_m, clearance.needed_m, "m", at_s, used)]
