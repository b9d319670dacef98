"""Validation of a model: residuals by joint, of moving and standing rows apart, and against the scatter of periods."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import f as f_distribution

from ..arrays import FloatArray
from ..dynamics.base_link import placed
from ..dynamics.model import IdentifiedModel
from ..errors import UnfitDataError
from ..estimate.identified import Fit, JointValidation, LackOfFit, Trace, Validation
from ..noise.weights import residual_noise
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..signals.moving_span import cut_by_motion, moving_span
from ..signals.prepare import prepare
from .residual_spectrum import residual_spectrum

HOLD_OUT = 1.0 / 3.0
SHORTEST_HOLD_OUT_S = 2.0


def validate(model: IdentifiedModel, recordings: Sequence[Recording], what: str, held_out: bool) -> Validation:
    """Predict recordings in the bandwidth the model was identified in, and compare.

    Args:
        model: Model with values.
        recordings: At least one, with the model's joints.
        what: In words, what the recordings are.
        held_out: Whether the fit had not seen them.

    Raises:
        UnfitDataError: The recordings are too short, or nothing moves.
        UserError: A recording lacks a joint of the model.
    """
    joints = model.model.arm.joint_names
    try:
        motions, _ = prepare(placed(recordings, model.model.arm), joints, model.cutoff_hz)
    except UnfitDataError as error:
        raise UnfitDataError(f"validation {what}: {error}, or name another recording with --validate") from error
    traces: list[Trace] = []
    full: list[tuple[FloatArray, FloatArray, np.ndarray]] = []
    for motion in motions:
        torque = model.torque(motion)
        name = recordings[motion.source].sources
        traces.append(
            Trace(
                Path(name[0].path).name if name else f"recording {motion.source + 1}",
                motion.time,
                motion.reduce(motion.position),
                motion.velocity_rows,
                motion.torque_rows,
                motion.reduce(torque),
                motion.moving,
            )
        )
        full.append((motion.torque, torque, _moving_samples(motion)))
    figures = {joint: _joint(k, traces, full, _lack_of_fit(k, motions, traces)) for k, joint in enumerate(joints)}
    spectrum = residual_spectrum(motions, [predicted for _, predicted, _ in full])
    return Validation(figures, tuple(traces), what, held_out, spectrum)


def _moving_samples(motion: Motion) -> np.ndarray:
    """(N, n) whether a full-rate sample belongs to a moving row: the nearest one, none beyond the first and last."""
    rows = motion.time
    if not len(rows):
        return np.zeros(motion.torque.shape, bool)
    time = motion.start_s + np.arange(len(motion.torque)) / motion.rate_hz
    middle = 0.5 * (rows[1:] + rows[:-1])
    half = 0.5 / motion.row_rate_hz
    inside = (time >= rows[0] - half) & (time <= rows[-1] + half)
    return np.asarray(motion.moving[np.searchsorted(middle, time)] & inside[:, None])


def split(recording: Recording, share: float = HOLD_OUT) -> tuple[Recording, Recording]:
    """A recording cut in time: what to fit, and the last part of the motion to validate on.

    Args:
        recording: With at least one motion; rest before it goes to the first part, rest behind it to the last.
        share: Of the motion's duration that is held out; default: a third.

    Raises:
        UnfitDataError: The last part would be too short to use.
    """
    start, stop = moving_span(recording)
    if share * (stop - start) < SHORTEST_HOLD_OUT_S:
        raise UnfitDataError(
            f"{stop - start:.1f} s of motion are too short to hold {share:.0%} out, at least "
            f"{SHORTEST_HOLD_OUT_S:g} s: record a longer run, or give another recording with --validate"
        )
    return cut_by_motion(recording, share, (start, stop))


def fit_figures(measured: FloatArray, predicted: FloatArray) -> Fit:
    """The five figures of a prediction (M,) against a measurement (M,), N·m.

    Args:
        measured: Torque of one joint; rows of all traces, or of those in motion, or samples at full rate.
        predicted: The model's torque at the same rows.

    Returns:
        All figures are NaN without rows. The correlation is NaN where one of the two is constant, the relative RMS
        where the measured torque is zero throughout.
    """
    if not len(measured):
        nan = float("nan")
        return Fit(0, nan, nan, nan, nan, nan)
    residual = measured - predicted
    rmse = float(np.sqrt(np.mean(residual**2)))
    size = float(np.sqrt(np.mean(measured**2)))
    varies = measured.std() > 0 and predicted.std() > 0
    return Fit(
        rows=len(measured),
        rmse=rmse,
        mae=float(np.mean(np.abs(residual))),
        largest=float(np.max(np.abs(residual))),
        correlation=float(np.corrcoef(measured, predicted)[0, 1]) if varies else float("nan"),
        relative_rms=rmse / size if size > 0 else float("nan"),
    )


def _joint(
    joint: int,
    traces: Sequence[Trace],
    full: Sequence[tuple[FloatArray, FloatArray, np.ndarray]],
    lack_of_fit: LackOfFit | None,
) -> JointValidation:
    measured = np.concatenate([trace.measured[:, joint] for trace in traces])
    predicted = np.concatenate([trace.predicted[:, joint] for trace in traces])
    moving = np.concatenate([trace.moving[:, joint] for trace in traces])
    as_recorded, as_predicted, moves = (np.concatenate([signals[k][:, joint] for signals in full]) for k in range(3))
    moves = moves.astype(bool)
    return JointValidation(
        everything=fit_figures(measured, predicted),
        moving=fit_figures(measured[moving], predicted[moving]),
        unfiltered=fit_figures(as_recorded, as_predicted),
        lack_of_fit=lack_of_fit,
        unfiltered_moving=fit_figures(as_recorded[moves], as_predicted[moves]),
    )


def _lack_of_fit(joint: int, motions: Sequence[Motion], traces: Sequence[Trace]) -> LackOfFit | None:
    """Mean square of the repeatable residual over the pure error of the mean period, where periods repeat.

    Rows are correlated, so the degrees of freedom are those of as many independent ones.
    """
    squares = noise = freedom = 0.0
    repeats = 0.0
    for motion, trace in zip(motions, traces):
        moving = motion.moving[:, joint]
        if motion.noise_Nm is None or moving.sum() < 10:
            continue
        residual = (trace.measured - trace.predicted)[moving, joint]
        noise_of = residual_noise(residual, np.flatnonzero(moving), motion.white_correlation)
        independent = len(residual) / noise_of.correlation_rows
        squares += float(np.mean(residual**2)) * independent
        noise += float(motion.noise_Nm[joint] ** 2) * independent
        freedom += independent
        repeats += independent * (motion.periods - 1)
    if freedom == 0.0 or noise == 0.0:
        return None
    ratio = squares / noise
    return LackOfFit(
        f=ratio,
        p_value=float(f_distribution.sf(ratio, freedom, repeats)),
        noise_Nm=float(np.sqrt(noise / freedom)),
    )
