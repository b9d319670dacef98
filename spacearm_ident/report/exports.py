"""The part of the report that says in which formats a simulator or a controller gets the model, and what each lacks."""

from __future__ import annotations

from ..dynamics.model import IdentifiedModel
from ..estimate.identified import Validation
from ..results.formats import MJCF, SDF, URDF, USD, lost_in_code, lost_words
from .markup import Markup, element, join

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


def exports(model: IdentifiedModel, validation: Validation) -> Markup:
    """The formats of `spacearm export`, each with its command line and what of the model it does not hold.

    Args:
        model: The identified model.
        validation: Of it: thresholds for contact detection are offered where it was held out.
    """
    offers = [(form.name, who, file, lost_words(model, form)) for form, who, file in SIMULATORS]
    offers += [(name, who, file, lost_in_code(model)) for name, who, file in CONTROLLERS]
    if validation.held_out and validation.traces:
        offers.append(("thresholds", "contact detection, by joint and speed", "thresholds.yaml", lost_in_code(model)))
    rows = [
        element(
            "tr",
            element("td", who, class_="text wrap"),
            element("td", element("code", f"spacearm export . --to {name} --out {file}"), class_="text"),
            element("td", ", ".join(lost) or "nothing", class_="text wrap note"),
        )
        for name, who, file, lost in offers
    ]
    header = element("tr", *(element("th", text, class_="text") for text in ("for", "command", "cannot represent")))
    return join(
        element("h2", "For simulators and controllers"),
        element(
            "p",
            "Run in the folder of this page. Where a format cannot represent a term, its parameters are fitted to it; "
            "the remaining error of each joint's torque is printed and written at the head of the file.",
            class_="quiet",
        ),
        element("div", element("table", element("thead", header), element("tbody", *rows)), class_="wide"),
    )
