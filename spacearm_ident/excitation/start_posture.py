"""A posture in which an arm can rest before and after a run: inside its limits, clear of itself, holdable.

All zeros is that for few arms: a Panda's elbow cannot be straight, a UR lies on the floor. What is found has room to
all sides, so that an excitation may begin about it.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.demand import drawn_postures
from .constraints import Requirements, model_torque
from .segments import Motion

DRAWN = 600
"""Postures tried; of a six-joint arm's some tens are possible, even where floor and limits leave little."""
ROOM = 2.0
"""A comfortable posture has the needed distance so many times, uses this part of the allowed torque, and keeps away
from a limit by `LIMIT_ROOM` of the range."""
LIMIT_ROOM = 0.1


def possible_start(arm: Arm, needs: Requirements) -> FloatArray | None:
    """(n,) all zeros where that is comfortable, else the comfortable posture nearest to it.

    Args:
        arm: The arm.
        needs: What every posture must keep; its position limits are finite.

    Returns:
        The posture, rounded to 0.01 rad or m; where none is comfortable the roomiest possible one; None: there is none.
    """
    lower, upper = needs.motion.lower, needs.motion.upper
    zero = np.clip(np.zeros(len(lower)), lower, upper)
    middle = (lower + upper) / 2
    postures = np.asarray(np.round(np.vstack([zero, middle, drawn_postures(arm, DRAWN)]), 2), dtype=float)
    room = room_of(needs, postures)
    span = np.maximum(upper - lower, 1e-9)
    away = np.linalg.norm((postures - zero) / span, axis=1)
    comfortable = room >= 1.0
    if comfortable.any():
        return _plainer(needs, postures[np.flatnonzero(comfortable)[np.argmin(away[comfortable])]], zero)
    best = int(np.argmax(room))
    return np.asarray(postures[best]) + 0.0 if room[best] > 0.0 else None


def _plainer(needs: Requirements, posture: FloatArray, zero: FloatArray) -> FloatArray:
    """The posture with every joint at zero that may be there as well."""
    for joint, value in enumerate(zero):
        trial = posture.copy()
        trial[joint] = value
        if room_of(needs, trial[None])[0] >= 1.0:
            posture = trial
    return np.asarray(posture) + 0.0


def room_of(needs: Requirements, postures: FloatArray) -> FloatArray:
    """(T,) how comfortable postures (T, n) are: 1 and more is comfortable, above 0 possible, below not.

    Args:
        needs: Finite position limits, allowed torque and its model, distances where they are checked.
        postures: Rad or m, in the arm's order.

    Returns:
        The least of three: room to the position limits, room below the allowed torque when holding the posture, and
        room above the needed clearance. Clearance is computed only where the other two are above 0.
    """
    span = np.maximum(needs.motion.upper - needs.motion.lower, 1e-9)
    beside = np.minimum(postures - needs.motion.lower, needs.motion.upper - postures) / span
    room: FloatArray = beside.min(axis=1) / LIMIT_ROOM
    still = np.zeros_like(postures)
    used = np.abs(model_torque(needs.identified, Motion(postures, still, still), 1.0)) / needs.torque_Nm
    # All of the torque allowed is 0, half of it 1.
    room = np.minimum(room, ((1.0 - used) / (1.0 - 1.0 / ROOM)).min(axis=1))
    if needs.clearance is not None and needs.clearance.pairs:
        needed = needs.clearance.needed_m
        # Distances are the dearest: only where all else is possible.
        for row in np.flatnonzero(room > 0.0):
            distance = float(needs.clearance.distances(postures[row : row + 1]).min())
            room[row] = min(room[row], (distance - needed) / ((ROOM - 1.0) * needed))
    return room
