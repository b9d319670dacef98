"""What the writers of code share: names as languages allow them, the law as Python literals, templates filled."""

from __future__ import annotations

import re

import numpy as np

from ..arrays import FloatArray
from .controller import JOINT_NUMBERS, ZERO_SPEED, ControlLaw


def identifier(name: str) -> str:
    """A name as C and Python allow it."""
    plain = re.sub(r"[^a-z0-9_]", "_", name.lower()) or "arm"
    return plain if plain[0].isalpha() else f"arm_{plain}"


def fields_of(law: ControlLaw, notes: list[str]) -> dict[str, str]:
    """The law as Python literals by the names that a template has in `@`; `NUMBERS` joint by joint.

    Args:
        law: Numbers of the bodies, joints and coupled motors.
        notes: What stands at the head, a line each; made safe for a docstring.

    Returns:
        Name without `@` -> text that stands in its place, for `filled`.
    """
    arm = law.model.model.arm
    assert law.joints.shape[1] == len(JOINT_NUMBERS)
    return {
        "NOTES": "\n".join(docstring_lines(notes)),
        "JOINTS": ", ".join(arm.joint_names).replace("\\", "/").replace('"', "'"),
        "NAMES": repr(arm.joint_names),
        "PARENT": repr([joint.parent for joint in arm.joints]),
        "REVOLUTE": repr([joint.revolute for joint in arm.joints]),
        "AXIS": literal([joint.axis for joint in arm.joints]),
        "PLACE": repr([joint.rotation.tolist() for joint in arm.joints]),
        "ORIGIN": literal([joint.translation for joint in arm.joints]),
        "GRAVITY": repr(np.asarray(arm.gravity).tolist()),
        "INERTIALS": literal(list(law.inertials)),
        "NUMBERS": literal(list(law.joints)),
        "MOTORS": repr(law.motors.tolist()),
        "ZERO": repr(ZERO_SPEED),
    }


def docstring_lines(lines: list[str]) -> list[str]:
    """Lines that cannot end or escape the docstring they stand in."""
    return [line.replace("\\", "/").replace('"""', "'''") for line in lines]


def filled(template: str, fields: dict[str, str]) -> str:
    """A template with `@NAME@` replaced by fields.

    Args:
        template: Text of the code; names are capitals and underscores.
        fields: Name -> text for every name of the template, without `@`.
    """
    return re.sub(r"@([A-Z_]+)@", lambda match: fields[match.group(1)], template)


def literal(rows: list[FloatArray]) -> str:
    """Rows of numbers as a Python list, every digit kept, a row a line."""
    return "[\n    " + ",\n    ".join(repr(row.tolist()) for row in rows) + ",\n]"
