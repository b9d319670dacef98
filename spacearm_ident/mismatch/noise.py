"""Noise of every joint, from what a base model leaves of the reference: what rows count for, and how they correlate.

Two models of it. *Coloured*: an autoregressive process, by which rows are whitened; right where the base model is, and
its residual is measurement noise. *Weighted*: rows keep their colour, and count for as much less as they are
correlated (an integrated autocorrelation time tau makes N rows worth N / tau); right where the residual is what the
model lacks. That is slow, as the motion is, and whitening would take away with it what carries gravity. Which of the
two holds, held-out parts of the reference decide (`preparation.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..errors import UnfitDataError
from ..noise.weights import common_correlation, residual_noise, white_correlation_time
from ..signals.motion import Motion
from .evidence import left_by_base
from .rivals import Rival, rivals
from .scene import FEWEST_ROWS, Scene, Whitener, fit_whitener, inflated, one_way, travel
from .stacked import base_columns, stacked_effect

ORDER = 6
"""Of the autoregressive model: it covers the length of the low-pass."""
SMOOTH = ("position", "friction_position", "torque", "velocity")
"""Of `rivals`: what noise does not follow."""
IN_FULL = 0.8
"""Share of a joint's largest row weight below which a row is not used to estimate sigma and colour."""


@dataclass(frozen=True)
class Noise:
    """Noise of every joint.

    Attributes:
        whiteners: By joint, what makes white rows of variance one.
        plain: By joint, what a row counts for by its speed and distance from a reversal alone.
        floor_Nm: (n,) standard deviation of a row that counts in full, N·m; infinite where it is not known.
        correlation: (n,) the residual's integrated autocorrelation time over that of white noise after the low-pass;
            NaN where it was not estimated.
    """

    whiteners: list[Whitener]
    plain: list[Whitener]
    floor_Nm: FloatArray
    correlation: FloatArray


NoiseModel = Callable[[IdentifiedModel, Sequence[Motion]], Noise]


def coloured(base: IdentifiedModel, motions: Sequence[Motion]) -> Noise:
    """The noise as an autoregressive process.

    Args:
        base: Model of the arm.
        motions: Recordings whose residual is noise.

    Raises:
        UnfitDataError: No joint moves for long enough.
    """
    plain, scene, residual = _unwhitened(base, motions)
    own = [fit_whitener(*_series(scene, residual, j), ORDER, _least(motions, j)) for j in range(len(plain))]
    whiteners, _, _ = _louder(base, motions, _known(own), 2)
    return Noise(whiteners, plain, _floor(whiteners), np.full(len(plain), np.nan))


def weighted(base: IdentifiedModel, motions: Sequence[Motion], near: Noise | None = None) -> Noise:
    """The noise as a variance and an autocorrelation time.

    Args:
        base: Model of the arm.
        motions: Recordings whose residual is noise.
        near: Noise of the same motions under a similar model, to start the iteration from.

    Raises:
        UnfitDataError: No joint moves for long enough.
    """
    plain, scene, residual = _unwhitened(base, motions, near)
    floor, relative = np.full((2, len(plain)), np.inf)
    noises = []
    white = np.array([white_correlation_time(motion.white_correlation) for motion in motions])
    for j in range(len(plain)):
        own, squares = [], 0.0
        for motion, series, kept in zip(motions, *_series(scene, residual, j)):
            place = np.flatnonzero(kept)
            own.append(residual_noise(series[place], place, motion.white_correlation))
            squares += float(np.sum(series[place] ** 2))
        rows = np.array([estimate.rows for estimate in own])
        if rows.sum() >= FEWEST_ROWS:
            floor[j] = max(float(np.sqrt(squares / rows.sum())), _least(motions, j))
            relative[j] = rows @ [estimate.correlation_rows for estimate in own] / (rows @ white)
        noises += own
    correlation = np.sqrt(common_correlation(noises))
    whiteners = [replace(weights, sigma_Nm=float(sigma * correlation)) for weights, sigma in zip(plain, floor)]
    return Noise(_known(whiteners), plain, floor, np.where(np.isfinite(relative), relative, np.nan))


def of_field(base: IdentifiedModel, motions: Sequence[Motion]) -> Noise:
    """The noise as a variance, from recordings that may contain any physics beside the base's.

    Per joint, what the base leaves is fitted by splines of position, of
    position times direction, of torque and, recording by recording, of velocity. What that leaves is taken to be white
    before the low-pass: how slow it is, physics that no spline follows says as well. It is no filter either: one that
    makes the rest white would take what is sought, which is slow, for noise, and the base's errors at reversals for
    more than they are.

    Args:
        base: Model of the arm.
        motions: Recordings, whatever else their residual is.

    Raises:
        UnfitDataError: No joint moves for long enough.
    """
    _, scene, residual = _unwhitened(base, motions)
    plain, floor = in_field(base, scene, residual)
    white = np.mean([white_correlation_time(motion.white_correlation) for motion in motions])
    whiteners = [replace(weights, sigma_Nm=float(sigma * np.sqrt(white))) for weights, sigma in zip(plain, floor)]
    return Noise(_known(whiteners), plain, floor, np.full(len(plain), np.nan))


def in_field(base: IdentifiedModel, scene: Scene, residual: FloatArray) -> tuple[list[Whitener], FloatArray]:
    """What rows count for by speed and distance from a reversal, joint by joint, and the noise of those in full, N m.

    Args:
        base: Model of the arm.
        scene: Rows that are not whitened.
        residual: (R,) what base, and effects if any, leave of them.

    Returns:
        The scene's whiteners with another inflation, and (n,) a standard deviation as in `of_field`; infinite where it
        is not known.
    """
    noise = residual - _smooth(base, scene, residual)[0]
    whiteners = inflated(scene.whiteners, scene, noise)
    again = scene.reweighted(whiteners)
    return whiteners, _spread(again, noise * again.weight / scene.weight)


def model_error_share(model: IdentifiedModel, motions: Sequence[Motion], residuals: Sequence[FloatArray]) -> FloatArray:
    """(n,) share of each joint's residual variance that is a function of its own state: what the model leaves out.

    The coefficient of determination of the splines of `of_field`, adjusted for their number (Ezekiel 1930), rows being
    as independent as white noise is after the low-pass.

    Args:
        model: With the values whose residuals they are.
        motions: Recordings.
        residuals: (N, n) of each, N m.
    """
    joints = range(len(model.model.arm.joints))
    scene = Scene(model, motions, [Whitener(np.zeros(0), 1.0) for _ in joints])
    left = [motion.reduce(residual) for motion, residual in zip(motions, residuals)]
    slots = [(scene.slot(j, m), j, rows) for j in joints for m, rows in enumerate(left)]
    residual = np.concatenate([rows[scene.place[slot], j] for slot, j, rows in slots])
    explained, columns = _smooth(model, scene, residual)
    white = np.mean([white_correlation_time(motion.white_correlation) for motion in motions])
    chance = columns / np.maximum(scene.by_joint(np.ones(len(scene))) / white, columns + 1.0)
    share = scene.by_joint(explained**2) / np.maximum(scene.by_joint(residual**2), np.finfo(float).tiny)
    return np.asarray(np.maximum((share - chance) / (1.0 - chance), 0.0))


def in_full(whiteners: Sequence[Whitener], motion: Motion) -> np.ndarray:
    """(M, n) rows of a motion that count in full: neither slow nor near a reversal, as far as that matters there.

    Args:
        whiteners: (n,) what a row of each joint counts for.
        motion: M rows of n joints.
    """
    speed, gone = motion.velocity_rows, travel(motion)
    weights = [whitener.weight(speed[:, j], gone[:, j]) for j, whitener in enumerate(whiteners)]
    return one_way(motion) & (np.stack(weights, axis=1) > IN_FULL)


def _spread(scene: Scene, noise: FloatArray) -> FloatArray:
    """(n,) standard deviation of the rows (R,) of each joint that count in full; infinite where they are too few."""
    floor = np.full(len(scene.whiteners), np.inf)
    for j in range(len(floor)):
        rows = np.concatenate([series[kept] for series, kept in zip(*_series(scene, noise, j))])
        if len(rows) >= FEWEST_ROWS:
            floor[j] = max(float(np.sqrt(np.mean(rows**2))), _least(scene.motions, j))
    return floor


def _smooth(base: IdentifiedModel, scene: Scene, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(R,) the part of a residual that smooth functions of a joint's own motion and torque explain; (n,) how many."""
    explained, independent = np.zeros(len(residual)), np.zeros(len(scene.whiteners))
    places = [place for place in rivals(scene.motions) if place["of"] in SMOOTH and "with" not in place]
    for joint, name in enumerate(scene.motions[0].joints):
        rows = scene.rows_of(joint, joint)
        columns = []
        for place in (place for place in places if place["joint"] == name):
            own = stacked_effect(scene, Rival.at(base.model.arm, place), ()).columns
            days = [scene.slot(joint, m) for m in range(len(scene.motions))] if place["of"] == "velocity" else [rows]
            for day in days:
                inside, here = slice(day.start - rows.start, day.stop - rows.start), np.zeros_like(own)
                here[inside] = own[inside]
                columns.append(here)
        matrix = np.concatenate(columns, axis=1) if columns else np.zeros((rows.stop - rows.start, 0))
        values, _, independent[joint], _ = np.linalg.lstsq(matrix, residual[rows], rcond=1e-9)
        explained[rows] = matrix @ values
    return explained, independent


def _unwhitened(
    base: IdentifiedModel, motions: Sequence[Motion], near: Noise | None = None
) -> tuple[list[Whitener], Scene, FloatArray]:
    """What rows count for without their colour, the rows so weighed, and what the base leaves of them."""
    joints = range(len(base.model.arm.joints))
    start = near.plain if near else [Whitener(np.zeros(0), 1e4 * _least(motions, j)) for j in joints]
    plain, scene, columns = _louder(base, motions, start, 1 if near else 3)
    return plain, scene, left_by_base(base, scene, columns)


def _least(motions: Sequence[Motion], joint: int) -> float:
    """Smallest standard deviation that a joint's noise may have: a millionth of its torque, N·m."""
    return 1e-6 * max(float(np.sqrt(np.mean([np.mean(m.torque_rows[:, joint] ** 2) for m in motions]))), 1e-6)


def _known(whiteners: list[Whitener]) -> list[Whitener]:
    """The whiteners, if any joint's noise is known.

    Raises:
        UnfitDataError: No joint's is.
    """
    if not any(np.isfinite(whitener.sigma_Nm) for whitener in whiteners):
        raise UnfitDataError("no joint moves for half a second in one direction: record a longer run")
    return whiteners


def _louder(
    base: IdentifiedModel, motions: Sequence[Motion], whiteners: list[Whitener], times: int
) -> tuple[list[Whitener], Scene, FloatArray]:
    """What rows count for, found by fitting the base with it again and again; rows so weighed; its columns there."""
    scene = Scene(base, motions, whiteners)
    columns = base_columns(base, scene, ())
    for _ in range(times):
        whiteners = inflated(whiteners, scene, left_by_base(base, scene, columns))
        before, scene = scene.weight, scene.reweighted(whiteners)
        columns *= (scene.weight / before)[:, None]
    return whiteners, scene, columns


def _series(scene: Scene, residual: FloatArray, joint: int) -> tuple[list[FloatArray], list[np.ndarray]]:
    """By motion, one joint's residual (M,), N·m, and (M,) whether a row counts in full."""
    series, counts = [], []
    for m, motion in enumerate(scene.motions):
        slot = scene.slot(joint, m)
        whole, weight = np.zeros((2, len(motion.torque_rows)))
        whole[scene.place[slot]] = residual[slot] / scene.weight[slot] * scene.whiteners[joint].sigma_Nm
        weight[scene.place[slot]] = scene.weight[slot]
        series.append(whole)
        counts.append(weight > IN_FULL * scene.weight[scene.joint == joint].max(initial=0.0))
    return series, counts


def _floor(whiteners: Sequence[Whitener]) -> FloatArray:
    """(n,) standard deviation of the noise that the whiteners describe, N·m."""
    floors = []
    for whitener in whiteners:
        response = np.ones(512, dtype=complex)
        frequency = np.linspace(0, np.pi, 512)
        for lag, coefficient in enumerate(whitener.coefficients, start=1):
            response -= coefficient * np.exp(-1j * lag * frequency)
        floors.append(whitener.sigma_Nm * float(np.sqrt(np.mean(1.0 / np.maximum(np.abs(response), 0.02) ** 2))))
    return np.array(floors)
