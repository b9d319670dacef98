"""In which formats a simulator or a controller gets the model, and what each lacks: a part of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..dynamics.model import IdentifiedModel
from ..estimate.identified import Validation
from ..results.formats import MJCF, SDF, URDF, USD, lost_in_code, lost_words

SIMULATORS = (
    (MJCF, "MuJoCo", "arm.xml"),
    (SDF, "Gazebo", "arm.sdf"),
    (URDF, "ROS 2, ros2_control, Pinocchio, Drake", "arm.urdf"),
    (USD, "Isaac Sim", "arm.usda"),
)
"""Format, who reads it, and a name for its file."""
CONTROLLERS = (
    ("c", "C99, no dependencies", "code"),
    ("numpy", "Python", "arm.py"),
    ("casadi", "CasADi", "arm_casadi.py"),
)
"""Name of the format, who reads it, and a name for its file."""


class Offer(NamedTuple):
    """A format of `spacearm export`.

    Attributes:
        form: Name of the format.
        reader: Who reads it.
        file: A name for its file.
        lost: What of the model it cannot represent.
    """

    form: str
    reader: str
    file: str
    lost: Sequence[str]


def exports(model: IdentifiedModel, validation: Validation) -> list[Offer]:
    """The formats of `spacearm export`, each with what of the model it does not hold.

    Args:
        model: The identified model.
        validation: Of it: thresholds for contact detection are offered where it was held out.
    """
    offers = [Offer(form.name, who, file, lost_words(model, form)) for form, who, file in SIMULATORS]
    others = list(CONTROLLERS)
    if validation.held_out and validation.traces:
        others.append(("thresholds", "contact detection, by joint and speed", "thresholds.yaml"))
    return offers + [Offer(*other, lost_in_code(model)) for other in others]
