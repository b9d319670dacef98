"""`model.yaml`: a torque model with its values, as text that loads back to the same numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..arrays import FloatArray
from ..documents import read_text, read_yaml
from ..errors import UserError
from .arm import JOINT_KEYS, Arm, arm_from_description
from .model import IdentifiedModel, OwnRecordings, Plain, Structure, TorqueModel, Unbounded

MODEL_SCHEMA = "spacearm_ident/model/1"


def model_to_dict(identified: IdentifiedModel) -> dict[str, Any]:
    """Plain data of a model file: terms with options and values by symbol and joint, the URDF inside."""
    arm = identified.model.arm
    return {
        "schema": MODEL_SCHEMA,
        "name": arm.name,
        "joints": list(arm.joint_names),
        "gravity_m_s2": [float(g) for g in arm.gravity],
        "bandwidth_hz": identified.cutoff_hz,
        "drives": {
            joint.name: {
                key: getattr(joint, attribute)
                for key, attribute in JOINT_KEYS.items()
                if np.isfinite(getattr(joint, attribute))
            }
            for joint in arm.joints
        },
        **_effort(arm),
        "couplings": [{"name": c.name, "ratios": dict(c.ratios)} for c in arm.couplings],
        "terms": _terms(identified.model, identified.parameters, identified.constants),
        **_unbounded(identified),
        **_plain(identified),
        **_own(identified),
        "provenance": dict(identified.provenance or {}),
        "urdf": arm.urdf,
    }


def _terms(model: TorqueModel, parameters: FloatArray, constants: FloatArray) -> list[dict[str, Any]]:
    """Terms with options, and values by symbol and joint."""
    values = _by_kind(model, parameters)
    for term, _, first_constant in model.numbered():
        own = values[term.kind]
        for k, constant in enumerate(term.constants):
            own.setdefault(constant.symbol, {})[constant.joint] = float(constants[first_constant + k])
    return [
        {"kind": kind, **({"options": dict(options)} if options else {}), "values": values[kind]}
        for kind, options in model.structure.items()
    ]


def _by_kind(model: TorqueModel, parameters: FloatArray) -> dict[str, dict[str, dict[str, float]]]:
    """Parameters by kind of term, symbol and joint."""
    values: dict[str, dict[str, dict[str, float]]] = {kind: {} for kind in model.structure}
    for term, first, _ in model.numbered():
        for k, parameter in enumerate(term.parameters):
            values[term.kind].setdefault(parameter.symbol, {})[parameter.joint] = float(parameters[first + k])
    return values


def _unbounded(identified: IdentifiedModel) -> dict[str, Any]:
    """Parameters that predict better than possible ones, and their share at each joint; empty where there are none."""
    if identified.unbounded is None:
        return {}
    names, share = identified.model.arm.joint_names, identified.unbounded.share
    values = _by_kind(identified.model, identified.unbounded.parameters)
    return {"unbounded": {"share": dict(zip(names, share.tolist())), "values": values}}


def _plain(identified: IdentifiedModel) -> dict[str, Any]:
    """The plain model that is part of the prediction, and its share at each joint; empty where there is none."""
    if identified.plain is None:
        return {}
    model, names = identified.plain.model, identified.model.arm.joint_names
    terms = _terms(model, identified.plain.parameters, identified.plain.constants)
    return {"plain": {"share": dict(zip(names, identified.plain.share.tolist())), "terms": terms}}


def _own(identified: IdentifiedModel) -> dict[str, Any]:
    """What the model leaves of its own recordings; empty where that is not known.

    Parameters of a fit stand in the order of the values of `terms`, which nobody need read.
    """
    own, names = identified.own, identified.model.arm.joint_names
    if own is None:
        return {}
    figures = {"rows": own.rows, "left_out_Nm": own.left_out_Nm, "fitted_Nm": own.fitted_Nm}
    parts = [
        {
            **{key: dict(zip(names, values[k].tolist())) for key, values in figures.items()},
            "parameters": _Row(own.parameters[k].tolist()),
        }
        for k in range(len(own.rows))
    ]
    by_joint = {"acceleration": own.acceleration, "density": own.density}
    known = {key: dict(zip(names, values.tolist())) for key, values in by_joint.items() if values is not None}
    return {"own_recordings": {"count": own.recordings, **known, "parts": parts}}


def _effort(arm: Arm) -> dict[str, Any]:
    """The unit of published effort, where it was declared: in A, whatever unit it was, for the constants say it all."""
    if not arm.effort_declared:
        return {}
    if all(joint.effort_scale == 1.0 for joint in arm.joints):
        return {"effort": {"unit": "N m"}}
    return {"effort": {"unit": "A", "constants": {joint.name: joint.effort_scale for joint in arm.joints}}}


def save_model(identified: IdentifiedModel, path: Path) -> None:
    """Write a model file; floats keep every digit.

    Args:
        identified: Structure, values and what else `model_to_dict` holds.
        path: File to write; its folder must exist, an older file is replaced.
    """
    text = yaml.dump(model_to_dict(identified), sort_keys=False, width=100, Dumper=_Dumper)
    path.write_text(text, encoding="utf-8")


def load_model(path: Path) -> IdentifiedModel:
    """Read a model file.

    Raises:
        UserError: Missing, not a model file, an unknown term, or a value that is missing.
    """
    data = read_yaml(path, "the model")
    if not isinstance(data, dict) or data.get("schema") != MODEL_SCHEMA:
        raise UserError(f"{path} is not a model file: it should begin with 'schema: {MODEL_SCHEMA}'")
    try:
        return _model_from_dict(data, path)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise UserError(f"{path}: {type(error).__name__} {error}: the file is incomplete or edited wrongly") from error


def _model_from_dict(data: Mapping[str, Any], path: Path) -> IdentifiedModel:
    urdf = data.get("urdf")
    if urdf is None:
        urdf = read_text(path.parent / str(data["urdf_file"]), f"the URDF that {path} names,")
    description = {
        "name": data["name"],
        "gravity_m_s2": data["gravity_m_s2"],
        "joints": data.get("drives") or {},
        "couplings": data.get("couplings") or [],
        "effort": data.get("effort"),
    }
    arm = arm_from_description(urdf, description, str(path))
    model, values = _read_terms(arm, data["terms"])
    return IdentifiedModel(
        model,
        _values(model, values, "parameters"),
        _values(model, values, "constants"),
        data.get("bandwidth_hz"),
        data.get("provenance") or {},
        _read_unbounded(model, data.get("unbounded")),
        _read_plain(arm, data.get("plain")),
        _read_own(model, data.get("own_recordings")),
    )


def _read_terms(arm: Arm, terms: Sequence[Mapping[str, Any]]) -> tuple[TorqueModel, dict[str, Any]]:
    """The structure of a list of terms, and its values by kind."""
    structure: Structure = {term["kind"]: dict(term.get("options") or {}) for term in terms}
    return TorqueModel(arm, structure), {term["kind"]: term["values"] for term in terms}


def _read_unbounded(model: TorqueModel, data: Mapping[str, Any] | None) -> Unbounded | None:
    if data is None:
        return None
    return Unbounded(_values(model, data["values"], "parameters"), _share(model.arm, data))


def _read_plain(arm: Arm, data: Mapping[str, Any] | None) -> Plain | None:
    if data is None:
        return None
    model, values = _read_terms(arm, data["terms"])
    parameters, constants = _values(model, values, "parameters"), _values(model, values, "constants")
    return Plain(model, parameters, constants, _share(arm, data))


def _read_own(model: TorqueModel, data: Mapping[str, Any] | None) -> OwnRecordings | None:
    if data is None:
        return None
    parts = data["parts"]
    rows, left, fitted = (
        np.array([_by_joint(model.arm, part[key]) for part in parts]) for key in ("rows", "left_out_Nm", "fitted_Nm")
    )
    parameters = [np.array([float(value) for value in part["parameters"]]) for part in parts]
    if any(len(own) != len(model.parameters) or not np.isfinite(own).all() for own in parameters):
        raise UserError(f"every part of own_recordings needs {len(model.parameters)} finite parameters")
    acceleration = _by_joint(model.arm, data["acceleration"])
    density = _by_joint(model.arm, data["density"]) if "density" in data else None
    return OwnRecordings(int(data["count"]), acceleration, rows, left, fitted, np.stack(parameters), density)


def _by_joint(arm: Arm, values: Mapping[str, Any]) -> FloatArray:
    """(n,) figures that are not negative, by joint.

    Raises:
        UserError: One that is, or is not finite.
    """
    found = np.array([float(values[joint]) for joint in arm.joint_names])
    if not (np.isfinite(found) & (found >= 0.0)).all():
        raise UserError("the figures of own_recordings must be finite and not negative")
    return found


def _share(arm: Arm, data: Mapping[str, Any]) -> FloatArray:
    """(n,) shares in a prediction, by joint.

    Raises:
        UserError: One that is not between 0 and 1.
    """
    share = np.array([float(data["share"][joint]) for joint in arm.joint_names])
    if not ((share >= 0.0) & (share <= 1.0)).all():
        raise UserError("the shares of a prediction must lie between 0 and 1")
    return share


def _values(model: TorqueModel, values: Mapping[str, Any], which: str) -> FloatArray:
    """Values by kind, symbol and joint in the model's order; all must be there and finite."""
    ordered = []
    for term in model.terms:
        for item in getattr(term, which):
            by_joint = values[term.kind].get(item.symbol)
            if by_joint is None or item.joint not in by_joint:
                raise UserError(f"the model has no value for {item.name} of {term.kind}")
            value = float(by_joint[item.joint])
            if not np.isfinite(value):
                raise UserError(f"the model's {item.name} is not a finite number")
            ordered.append(value)
    return np.array(ordered)


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]  # PyYAML is untyped
    """Multi-line text as a block, floats with all their digits."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = "|" if "\n" in text and not any(line != line.rstrip() for line in text.split("\n")) else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


class _Row(list):  # type: ignore[type-arg]
    """Numbers that stand side by side."""


def _row(dumper: yaml.SafeDumper, row: _Row) -> yaml.SequenceNode:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)


_Dumper.add_representer(str, _text)
_Dumper.add_representer(_Row, _row)
