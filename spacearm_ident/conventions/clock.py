"""How far the stamps of a recording are off the instants of sampling, read off the positions of several joints."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..recording.recording import Recording
from ..signals.motion import STUCK_RAD

REACH = 10
"""Samples on either side over which a speed is measured: the error of one stamp is then a tenth of it or less."""
STANDARD_ERRORS = 5.0
"""Standard errors by which the share that joints have in common must stand out of zero. Five, as nothing of it is a
matter of chance where stamps are off: there it stands out by tens."""
SHARING = 5
"""Neighbouring residuals that share a sample: so many times fewer of them are independent."""
LEAST_UNEVEN = 0.5
"""Share of the error by which stamps must be uneven themselves, RMS, to be its cause. Even stamps whose positions err
together are of a topic that is published oftener than the arm is sampled, and repeats positions."""


def clock_error_s(recording: Recording) -> float:
    """RMS distance of uneven stamps from the sampling instants, s; 0 where the positions do not show one.

    Each position is predicted from two neighbours on either side by a cubic over the stamps. A stamp that is off by d
    puts every joint off by d times its speed, at once; noise of encoders is each joint's own. So d^2 is the mean
    product of two joints' residuals over that of their speeds. It takes two joints that move. Where stamps come in
    batches the errors of neighbours are alike, and the estimate is below the true one.

    Args:
        recording: Any; of its joints those that move are used.
    """
    moves = np.ptp(recording.position, axis=0) > STUCK_RAD
    if moves.sum() < 2:
        return 0.0
    parts = [
        _residuals(recording.time[segment], recording.position[segment][:, moves])
        for segment in recording.segments
        if segment.stop - segment.start > 2 * REACH
    ]
    if not parts:
        return 0.0
    residual, speed = (np.concatenate([part[k] for part in parts]) for k in range(2))
    together = residual * speed
    own = (together**2).sum(axis=1)
    shared = together.sum(axis=1) ** 2 - own
    # Errors of arrival have long tails: the share is bounded, so that its mean has a standard error to believe.
    share = shared[own > 0.0] / own[own > 0.0]
    if not share.sum() > STANDARD_ERRORS * np.sqrt(SHARING * (share**2).sum()):
        return 0.0
    size = (speed**2).sum(axis=1) ** 2 - (speed**4).sum(axis=1)
    error_s = float(np.sqrt(max(float(shared.sum()), 0.0) / float(size.sum())))
    return error_s if _unevenness_s(recording) > LEAST_UNEVEN * error_s else 0.0


def _unevenness_s(recording: Recording) -> float:
    """RMS error of independent stamps of even samples, s, from how far each is off the middle of its neighbours'."""
    off = [time[1:-1] - 0.5 * (time[:-2] + time[2:]) for time in (recording.time[part] for part in recording.segments)]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2) / 1.5))


def _residuals(time: FloatArray, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M, n) what a cubic through four neighbours leaves of a position, as the error of one sample; and (M, n) speed.

    Args:
        time: (N,) s, strictly increasing; N > 2 `REACH`.
        position: (N, n) rad.
    """
    middle = np.arange(REACH, len(time) - REACH)
    neighbours = [middle + offset for offset in (-2, -1, 1, 2)]
    # Lagrange's weights of the neighbours at the middle's stamp.
    weights = [
        np.prod([(time[middle] - time[b]) / (time[a] - time[b]) for b in neighbours if b is not a], axis=0)
        for a in neighbours
    ]
    left = position[middle] - sum(w[:, None] * position[a] for w, a in zip(weights, neighbours))
    amplified = np.sqrt(1.0 + sum(w**2 for w in weights))
    early, late = middle - REACH, middle + REACH
    speed = (position[late] - position[early]) / (time[late] - time[early])[:, None]
    return np.asarray(left / amplified[:, None]), np.asarray(speed)
