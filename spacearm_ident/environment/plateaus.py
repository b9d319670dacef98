"""Steady runs in recordings: stretches in which one joint turns at constant speed, and the friction they show.

At constant speed, the other joints still or at constant speeds of their own, a joint's torque is gravity, centrifugal
and Coriolis forces, and friction. Friction turns with the direction, the others do not: over the postures that a run
forth and a run back have in common, half the difference of the torques is friction, and no model is needed. Where a
model is given, its torque without friction is subtracted and every run counts by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..recording.recording import Recording
from ..signals.motion import Motion

SMOOTH_S, TRIM_S, SHORTEST_S = 0.1, 0.15, 0.5
STEADY_SHARE = 0.05
"""Speed of a steady run stays within this share of its median."""
SLOWEST = 5e-3
"""rad/s; below it a joint stands, or sticks and slips."""
SAME_SPEED, SAME_PLACE_RAD, LEAST_OVERLAP_RAD = 0.1, 0.05, 0.02


@dataclass(frozen=True)
class Plateau:
    """One steady run of one joint.

    Attributes:
        joint: Name.
        time_s: Of its middle.
        speed: Signed mean, rad/s.
        position: (N,) rad, of this joint.
        postures: (N, n) rad, of all joints.
        torque: (N,) N·m; without what a model says of the rest, where there is one.
        temperature: Mean, °C; NaN where not recorded.
    """

    joint: str
    time_s: float
    speed: float
    position: FloatArray
    postures: FloatArray
    torque: FloatArray
    temperature: float


@dataclass(frozen=True)
class FrictionPoint:
    """Friction of a joint at a speed (rad/s, not negative), a direction (+1, -1; 0: both) and a temperature (°C)."""

    speed: float
    direction: int
    temperature: float
    friction_Nm: float


def find_plateaus(recording: Recording, joint: str, model: IdentifiedModel | None = None) -> list[Plateau]:
    """All steady runs of a joint, the borders of which are left out.

    Args:
        recording: Its joints are those of the model, in its order, where there is one.
        joint: Name.
        model: What to subtract; friction stays in.
    """
    found = []
    column = recording.joints.index(joint)
    for segment in recording.segments:
        time, position = recording.time[segment], recording.position[segment]
        if len(time) < 8:
            continue
        samples = max(1, round(SMOOTH_S * recording.rate_hz))
        smooth = uniform_filter1d(position, samples, axis=0, mode="nearest")
        velocity = uniform_filter1d(np.gradient(smooth, time, axis=0), samples, axis=0, mode="nearest")
        for run in _steady_runs(velocity[:, column], recording.rate_hz):
            part = slice(segment.start + run.start, segment.start + run.stop)
            found.append(_plateau(recording, part, velocity[run], joint, model))
    return found


def _steady_runs(speed: FloatArray, rate_hz: float) -> Iterator[slice]:
    """Stretches of constant speed (N,), without their ends."""
    window = max(2, round(SHORTEST_S / 2 * rate_hz))
    change = np.abs(speed - uniform_filter1d(speed, window, mode="nearest"))
    steady = (np.abs(speed) > SLOWEST) & (change < STEADY_SHARE * np.abs(speed))
    borders = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(int), [0]])))
    trim = round(TRIM_S * rate_hz)
    for start, stop in zip(borders[::2] + trim, borders[1::2] - trim):
        middle = np.median(speed[start:stop]) if stop - start > SHORTEST_S * rate_hz else 0.0
        if middle != 0.0 and np.abs(speed[start:stop] - middle).max() < 2 * STEADY_SHARE * abs(middle):
            yield slice(int(start), int(stop))


def _plateau(
    recording: Recording, part: slice, velocity: FloatArray, joint: str, model: IdentifiedModel | None
) -> Plateau:
    column = recording.joints.index(joint)
    time, position, torque = recording.time[part], recording.position[part], recording.effort[part, column]
    if model is not None:
        steady = Motion.free_of_noise(recording.joints, recording.rate_hz, position, velocity, np.zeros_like(velocity))
        motion = replace(steady, start_s=float(time[0]), speed_noise=np.full(len(recording.joints), SLOWEST))
        rest = [kind for kind in model.model.structure if kind not in model.model.friction_kinds]
        torque = torque - model.torque(motion, rest)[:, column]
    series = recording.temperatures.get(joint)
    known = series is not None and len(series.time) > 0
    warm = float(np.mean(np.interp(time, series.time, series.values))) if known and series is not None else np.nan
    speed = float(velocity[:, column].mean())
    return Plateau(joint, float(time.mean()), speed, position[:, column], position, torque, warm)


def friction_points(plateaus: Sequence[Plateau], with_model: bool) -> list[FrictionPoint]:
    """Friction at every run (with a model), or at every pair of runs forth and back through the same postures.

    A run back goes with the nearest run forth in time that it fits; each is used once.

    Args:
        plateaus: Runs of one joint, of one recording.
        with_model: Whether their torque is without what a model says of the rest, so that friction alone is left.

    Returns:
        With a model, points of one direction each; without, of both directions (0), at the mean speed of the pair. Runs
        without a partner give none.
    """
    if with_model:
        ways = [int(np.sign(run.speed)) for run in plateaus]
        return [
            FrictionPoint(abs(run.speed), way, run.temperature, float(np.mean(run.torque) * way))
            for run, way in zip(plateaus, ways)
        ]
    forth = [run for run in plateaus if run.speed > 0]
    back = [run for run in plateaus if run.speed < 0]
    points = []
    while forth and back:
        pairs = [(abs(a.time_s - b.time_s), a, b) for a in forth for b in back if _fit_together(a, b)]
        if not pairs:
            break
        _, one, other = min(pairs, key=lambda pair: pair[0])
        forth = [run for run in forth if run is not one]
        back = [run for run in back if run is not other]
        low, high = _overlap(one, other)
        friction = 0.5 * (_mean_between(one, low, high) - _mean_between(other, low, high))
        warm = 0.5 * (one.temperature + other.temperature)
        points.append(FrictionPoint(0.5 * (one.speed - other.speed), 0, warm, friction))
    return points


def _fit_together(one: Plateau, other: Plateau) -> bool:
    low, high = _overlap(one, other)
    if abs(one.speed + other.speed) > SAME_SPEED * one.speed or high - low < LEAST_OVERLAP_RAD:
        return False
    return all(
        np.abs(_posture_at(one, place) - _posture_at(other, place)).max() < SAME_PLACE_RAD for place in (low, high)
    )


def _posture_at(run: Plateau, place: float) -> FloatArray:
    """(n,) positions of all joints where this one passes `place`, rad."""
    return np.asarray(run.postures[int(np.argmin(np.abs(run.position - place)))])


def _overlap(one: Plateau, other: Plateau) -> tuple[float, float]:
    """Positions that both pass."""
    return (
        max(float(one.position.min()), float(other.position.min())),
        min(float(one.position.max()), float(other.position.max())),
    )


def _mean_between(run: Plateau, low: float, high: float) -> float:
    """Mean torque over positions; time and position run alike at constant speed."""
    inside = (run.position >= low) & (run.position <= high)
    return float(np.mean(run.torque[inside])) if inside.any() else float("nan")
