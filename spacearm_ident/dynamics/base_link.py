"""Where a sensor sits on the arm's base, and whether the base moves at all: what turns a recorded sensor to use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..errors import UserError
from ..recording.recording import BaseSensor, Recording
from ..signals.base_motion import moves
from .arm import Arm

DISAGREEMENT = 0.3
"""m/s^2 by which an accelerometer at rest may differ from what gravity would make it read."""


def base_link(urdf: str) -> str:
    """Name of the link that carries the arm of a robot description."""
    return str(pin.buildModelFromXML(urdf).frames[1].name)


def base_inertial(arm: Arm) -> FloatArray:
    """(10,) CAD parameters of the base link and all that is fixed to it, about its frame; zero where there are none."""
    inertia = pin.buildModelFromXML(arm.urdf).inertias[0]
    return np.array(inertia.toDynamicParameters()) if inertia.mass > 0 else np.zeros(10)


def without_still_base(recording: Recording) -> Recording:
    """The recording without its base sensor where the base does not move by it: the base is fixed then."""
    return recording if recording.base is None or moves(recording.base) else replace(recording, base=None)


def placed(recordings: Sequence[Recording], arm: Arm) -> list[Recording]:
    """The recordings with their base sensors placed on the arm; a sensor on a base that stands still is left out.

    Without a base sensor, or where it stands still, the base is fixed and gravity that of the arm.

    Args:
        recordings: With or without a base sensor.
        arm: Its URDF gives the pose of the sensor's frame on the base link.

    Raises:
        UserError: The frame of a sensor that moves is not fixed to the base link.
    """
    return [
        one if one.base is None else replace(one, base=_placed(one.base, arm))
        for one in map(without_still_base, recordings)
    ]


def frame_fault(sensor: BaseSensor, arm: Arm) -> tuple[str, str] | None:
    """What is wrong with the frame of a sensor, and its remedy; None where it is fixed to the base link of the arm.

    Args:
        sensor: Base sensor, with the name of the frame that its messages state.
        arm: Its URDF says which frames are fixed to the base link.
    """
    model = pin.buildModelFromXML(arm.urdf)
    frame = next((frame for frame in model.frames[1:] if frame.name == sensor.frame), None)
    if frame is not None and frame.parentJoint == 0:
        return None
    why = "no frame of the URDF" if frame is None else "not fixed to its base"
    return (
        f"{sensor.topic} is in the frame {sensor.frame!r}, {why}",
        f"let it be {model.frames[1].name!r}, or join it to that by a fixed joint of the URDF (--arm); --fixed-base "
        "leaves the topic out",
    )


def _placed(sensor: BaseSensor, arm: Arm) -> BaseSensor:
    if (fault := frame_fault(sensor, arm)) is not None:
        raise UserError(": ".join(fault))
    model = pin.buildModelFromXML(arm.urdf)
    place = next(frame.placement for frame in model.frames[1:] if frame.name == sensor.frame)
    return replace(sensor, rotation=np.array(place.rotation), origin=np.array(place.translation))


def base_notes(recordings: Sequence[Recording], arm: Arm) -> list[str]:
    """What was done with each base sensor, in words.

    Args:
        recordings: As they were read.
        arm: Theirs.
    """
    notes = []
    for number, recording in enumerate(recordings, start=1):
        sensor = recording.base
        if sensor is None:
            continue
        where = f"recording {number}: {sensor.topic}"
        if moves(sensor):
            free = "needs no" if sensor.force is not None else "the arm's"
            notes.append(f"{where}: identified with the moving base it measures ({free} gravity)")
            continue
        notes.append(f"{where}: the base does not move and is taken as fixed")
        if sensor.force is not None and (words := _odd_gravity(sensor, arm)):
            notes.append(f"{where}: {words}")
    return notes


def _odd_gravity(sensor: BaseSensor, arm: Arm) -> str:
    """A word of warning where an accelerometer at rest reads something else than the arm's gravity."""
    try:
        rotation = _placed(sensor, arm).rotation
    except UserError:
        return ""
    assert rotation is not None and sensor.force is not None
    gravity = -rotation @ sensor.force.mean(axis=0)
    if np.linalg.norm(gravity - arm.gravity) <= DISAGREEMENT:
        return ""
    measured, said = (" ".join(f"{value:.2f}" for value in vector) for vector in (gravity, arm.gravity))
    return f"at rest it feels gravity {measured} m/s^2 where the arm's is {said}: check --gravity"
