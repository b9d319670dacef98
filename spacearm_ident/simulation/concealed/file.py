"""Files that say what to conceal, `spacearm_ident/conceal/1`.

schema: spacearm_ident/conceal/1
effects:
- effect: torque_ripple
  joints: [joint_3]
  parameters: {amplitude: 1.1, cycles: 24}   # one number, or one a joint
  law: modulated                             # optional
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.documents import read_yaml
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.concealed import absent, drive, friction, memory, sensor, structure
from spacearm_ident.simulation.concealed.effect import Effect, Parameter

SCHEMA = "spacearm_ident/conceal/1"

EFFECTS: dict[str, type[Effect]] = {
    kind.name: kind
    for module in (friction, memory, structure, drive, sensor, absent)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Effect) and kind.__module__ == module.__name__
}
"""Every effect by name."""


def load_concealed(path: str | Path, joints: Sequence[str]) -> list[Effect]:
    """Read such a file for an arm with these joints.

    Args:
        path: File of the schema `spacearm_ident/conceal/1`.
        joints: Names in the arm's order, by which effects say where they act.

    Raises:
        UserError: It cannot be read, or names what is not there; the line says what there is.
    """
    document = read_yaml(Path(path), "what to conceal,")
    try:
        return concealed_from_dict(document, joints)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def concealed_from_dict(document: object, joints: Sequence[str]) -> list[Effect]:
    """The effects a document describes.

    Args:
        document: Content of such a file, checked here.
        joints: Names in the arm's order, by which effects say where they act.

    Raises:
        UserError: As `load_concealed`.
    """
    if not isinstance(document, dict) or set(document) != {"schema", "effects"}:
        raise UserError("must be a mapping with the keys schema and effects")
    if document["schema"] != SCHEMA:
        raise UserError(f"schema is {document['schema']!r}; this program reads {SCHEMA!r}")
    entries = document["effects"]
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise UserError("effects must be a list of mappings with the keys effect, joints, parameters and law")
    return [make_effect(joints, **_entry(entry)) for entry in entries]


def make_effect(
    all_joints: Sequence[str],
    effect: str,
    joints: Sequence[str] = (),
    parameters: Mapping[str, Any] | None = None,
    law: str | None = None,
) -> Effect:
    """One effect for an arm with `all_joints`.

    Args:
        all_joints: Names of the n joints.
        effect: Its name.
        joints: Where; all joints where none is given, as far as the effect allows.
        parameters: Values; one number, or one a joint; lists for vectors.
        law: Its form; the usual unless given.

    Raises:
        UserError: Something is not known, missing or of the wrong form.
    """
    kind = EFFECTS.get(effect)
    if kind is None:
        raise UserError(f"no effect {effect!r}; the effects are {', '.join(EFFECTS)}")
    unknown = [name for name in joints if name not in all_joints]
    if unknown:
        raise UserError(f"{effect}: no joint {unknown[0]!r}; the joints are {', '.join(all_joints)}")
    if kind.joints_needed and len(joints) != kind.joints_needed:
        raise UserError(f"{effect}: takes {kind.joints_needed} joint(s), not {len(joints)}; name them in joints")
    given = dict(parameters or {})
    beyond = [name for name in given if name not in kind.parameters]
    if beyond:
        raise UserError(f"{effect}: no parameter {beyond[0]!r}; it takes {', '.join(kind.parameters)}")
    law = kind.laws[0] if law is None else law
    if law not in kind.laws:
        raise UserError(f"{effect}: no law {law!r}; it has {', '.join(kind.laws)}")
    where = np.array([all_joints.index(name) for name in (joints or all_joints)], dtype=np.intp)
    values = {
        name: _value(effect, name, parameter, given.get(name), len(where))
        for name, parameter in kind.parameters.items()
    }
    return kind(where, values, law)


def _entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    known = ("effect", "joints", "parameters", "law")
    wrong = [key for key in entry if key not in known]
    if wrong or "effect" not in entry:
        raise UserError(f"an effect has the keys {', '.join(known)}, not {', '.join(map(str, entry)) or 'none'}")
    if not isinstance(entry.get("joints", []), list) or not isinstance(entry.get("parameters") or {}, dict):
        raise UserError(f"{entry['effect']}: joints must be a list, parameters a mapping")
    words = (entry["effect"], *entry.get("joints", []), entry.get("law") or "")
    if not all(isinstance(word, str) for word in words):
        raise UserError(f"{entry['effect']}: effect, joints and law are names, not {words!r}")
    return dict(entry)


def _value(effect: str, name: str, parameter: Parameter, given: Any, joints: int) -> FloatArray:
    """Values (joints,) or (joints, size)."""
    shape = (joints, parameter.size) if parameter.size else (joints,)
    if given is None:
        if parameter.default is None:
            raise UserError(
                f"{effect}: give {name} in {parameter.unit} (plausible: {parameter.low:g} to {parameter.high:g})"
            )
        return np.full(shape, parameter.default)
    try:
        array = np.broadcast_to(np.asarray(given, dtype=float), shape).copy()
    except (TypeError, ValueError):
        array = np.full(shape, np.nan)
    if not np.isfinite(array).all():
        size = f"{parameter.size} numbers" if parameter.size else "a number, or one a joint,"
        raise UserError(f"{effect}: {name} must be {size} in {parameter.unit}, not {given!r}")
    return array
