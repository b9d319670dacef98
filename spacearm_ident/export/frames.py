"""Bodies and frames of an arm as simulators want them: centres of mass, inertias about them, axes, quaternions."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..dynamics.arm import Arm, Joint
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..errors import UserError
from ..results.urdf import inertia_about_centre


@dataclass(frozen=True)
class Body:
    """The body that a joint moves, in the joint's frame.

    Attributes:
        joint: The joint.
        mass: kg.
        centre: (3,) centre of mass, m.
        inertia: (3, 3) about the centre of mass, kg m^2.
    """

    joint: Joint
    mass: float
    centre: FloatArray
    inertia: FloatArray


def bodies_of(model: IdentifiedModel) -> list[Body]:
    """The identified bodies in the arm's order.

    Raises:
        UserError: One has no positive mass, or an inertia that no body has.
    """
    bodies = []
    for joint in model.model.arm.joints:
        values = np.array([model.value(symbol, joint.name) for symbol in INERTIAL_SYMBOLS])
        if not values[0] > 0.0:
            raise UserError(f"the body of {joint.name!r} has no positive mass: give the arm a CAD prior with masses")
        centre = values[1:4] / values[0]
        inertia = inertia_about_centre(values)
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 0.0 or moments[2] > (1.0 + 1e-9) * (moments[0] + moments[1]):
            raise UserError(
                f"the body of {joint.name!r} has principal moments {', '.join(f'{one:.3g}' for one in moments)} "
                "kg m^2, which no body has: identify again, or give the arm a CAD prior with inertias"
            )
        bodies.append(Body(joint, float(values[0]), centre, inertia))
    return bodies


def principal(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal moments (3,) of an inertia, and their axes (3, 3) as the columns of a rotation."""
    moments, axes = np.linalg.eigh(inertia)
    return moments, axes * np.sign(np.linalg.det(axes))


def children_of(arm: Arm, parent: int) -> list[int]:
    """Indices of the joints that a body carries; -1: the base's.

    Args:
        arm: Its joints name their parents.
        parent: Index of the joint that moves the body.
    """
    return [k for k, joint in enumerate(arm.joints) if joint.parent == parent]


def quaternion(rotation: FloatArray) -> FloatArray:
    """(4,) w x y z of a rotation matrix."""
    # Ubuntu 24.04's scipy has no `scalar_first`.
    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)


def rpy(rotation: FloatArray) -> FloatArray:
    """(3,) roll, pitch, yaw as URDF and SDF have them."""
    with warnings.catch_warnings():
        # At a pitch of 90 degrees one angle is free; scipy takes zero for it, which is as good as any, and warns.
        warnings.filterwarnings("ignore", "Gimbal lock", UserWarning)
        return np.asarray(Rotation.from_matrix(rotation).as_euler("xyz"))


def comment(notes: Sequence[str]) -> list[str]:
    """The lines of an XML comment."""
    return ["<!--", *(f"  {note.replace('--', '- -')}" for note in notes), "-->"]


def words(values: FloatArray | list[float]) -> str:
    """Numbers with all their digits, spaces between."""
    return " ".join(repr(float(value)) for value in values)
