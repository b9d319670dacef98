"""`export_model`: an identified model into the file of a format, with what the format costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ..documents import write_whole
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.model_file import load_model
from ..errors import UnfitDataError, UserError
from ..estimate.identified import Validation
from ..results.formats import MJCF, SDF, URDF, USD, Format
from ..results.store import FIGURES, MODEL, load_result
from ..signals.motion import Motion
from .code_c import c_code
from .code_casadi import casadi_code
from .code_numpy import numpy_code
from .controller import ControlLaw, code_cost, control_law
from .law import Nearest, nearest
from .mjcf import mjcf
from .motion import motions_of
from .sdf import sdf
from .thresholds import PER_HOUR, Thresholds, contact_thresholds, document_text
from .urdf import urdf
from .usd import write_usd

TEXTS: dict[str, tuple[Format, Callable[[IdentifiedModel, Nearest, list[str]], str]]] = {
    "mjcf": (MJCF, mjcf),
    "sdf": (SDF, sdf),
    "urdf": (URDF, urdf),
}
"""Formats that are one text: what each holds, and its writer."""
MODULES: dict[str, Callable[[ControlLaw, list[str], Thresholds | None], tuple[str, str]]] = {
    "numpy": numpy_code,
    "casadi": casadi_code,
}
"""Formats that are one Python module: the writer of its name and text."""
FORMATS = (*TEXTS, "usd", "c", *MODULES, "thresholds")


def read_result(path: Path) -> tuple[IdentifiedModel, Validation | None]:
    """The model of a result folder with its validation, or of a model file without.

    Raises:
        UserError: Neither can be read.
    """
    if path.is_dir() and (path / FIGURES).is_file():
        result = load_result(path)
        return result.identified.model, result.validation
    return load_model(path / MODEL if path.is_dir() else path), None


def with_drives(model: IdentifiedModel, arm: Arm) -> IdentifiedModel:
    """A model with the gear ratios and torque constants of an arm, which model files do not hold.

    Args:
        model: Model read from a file.
        arm: Arm with all joints of the model, found by name; only its drives are taken over.

    Raises:
        UserError: A joint of the model is not in the arm.
    """
    known = {joint.name: joint for joint in arm.joints}
    own = model.model.arm
    if missing := [joint.name for joint in own.joints if joint.name not in known]:
        raise UserError(f"--arm: no joint {missing[0]!r}; it has {', '.join(known)}")
    joints = tuple(
        replace(joint, gear_ratio=known[joint.name].gear_ratio, torque_constant=known[joint.name].torque_constant)
        for joint in own.joints
    )
    return replace(model, model=replace(model.model, arm=replace(own, joints=joints)))


def export_model(
    model: IdentifiedModel,
    validation: Validation | None,
    form: str,
    out: Path,
    origin: str,
    per_hour: float = PER_HOUR,
) -> tuple[Nearest, list[Path]]:
    """Write a model in a format.

    Args:
        model: The identified model; its physically consistent values are written.
        validation: Of it; its motion is where the format's parameters are fitted and its cost is taken; None: a sweep.
        form: One of `FORMATS`.
        out: The file; for `c` a folder, or the source or header, whose names then follow the arm's.
        origin: Where the model comes from, for the head of the file.
        per_hour: False alarms an hour that thresholds for contact detection are set for.

    Returns:
        The format's parameters with their cost, and the files written.

    Raises:
        UnfitDataError: Thresholds without held-out motion.
        UserError: Another format, a body that cannot be, or the file cannot be written.
    """
    if form not in FORMATS:
        raise UserError(f"no format {form!r}: choose one of {', '.join(FORMATS)}")
    if not 0.0 < per_hour < float("inf"):
        raise UserError(f"thresholds need a number of false alarms an hour above zero, not {per_hour:g}")
    motions = motions_of(model, validation)
    where = "the motion it was validated on" if validation is not None and validation.traces else "a sweep"
    if form == "thresholds":
        return _write_thresholds(model, validation, motions, out, (origin, where), per_hour)
    if form == "c" or form in MODULES:
        law = control_law(model)
        cost = code_cost(model, law, motions)
        notes = _notes(origin, cost, where)
        contact = None
        if validation is not None and validation.held_out and validation.traces:
            contact = contact_thresholds(law, motions, model.cutoff_hz or motions[0].cutoff_hz, per_hour)
            cost = replace(cost, further=tuple(contact.lines()))
        if form == "c":
            folder = out if out.suffix not in (".c", ".h") else out.parent
            name, header, source = c_code(law, notes, contact)
            return cost, _written({folder / f"{name}.h": header, folder / f"{name}.c": source})
        name, text = MODULES[form](law, notes, contact)
        return cost, _written({out / f"{name}.py" if out.is_dir() else out: text})
    if form == "usd":
        fit = nearest(model, USD, motions)
        if out.suffix not in (".usda", ".usd", ".usdc"):
            raise UserError(f"{out}: USD files end in .usda (text), .usd or .usdc; name one of them")
        _make_room(out)
        write_usd(model, fit, _notes(origin, fit, where), out)
        return fit, [out]
    holds, writer = TEXTS[form]
    fit = nearest(model, holds, motions)
    return fit, _written({out: writer(model, fit, _notes(origin, fit, where))})


def _write_thresholds(
    model: IdentifiedModel,
    validation: Validation | None,
    motions: Sequence[Motion],
    out: Path,
    origin: tuple[str, str],
    per_hour: float,
) -> tuple[Nearest, list[Path]]:
    """Thresholds for contact detection, YAML or, by the file's name, JSON."""
    if validation is None or not validation.traces or not validation.held_out:
        raise UnfitDataError(
            "thresholds need held-out motion without contact: name a result folder that was validated on "
            "held-out recordings, or name such recordings with --validate"
        )
    if out.suffix not in (".yaml", ".yml", ".json"):
        raise UserError(f"{out}: thresholds are written as .yaml or .json; name one of them")
    law = control_law(model)
    cost = code_cost(model, law, motions)
    found = contact_thresholds(law, motions, model.cutoff_hz or motions[0].cutoff_hz, per_hour)
    notes = [f"Identified by spacearm_ident from {origin[0]}; measured {validation.what}."]
    text = document_text(found, notes, out.suffix == ".json")
    return replace(cost, further=tuple(found.lines())), _written({out: text})


def _notes(origin: str, fit: Nearest, where: str) -> list[str]:
    """The head of a file: where it comes from, and what it costs."""
    return [
        f"Identified by spacearm_ident from {origin}; physically consistent values, SI units.",
        f"Fitted to the identified model, and its cost taken, on {where}.",
        *fit.lines(),
    ]


def _make_room(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); name another place") from error


def _written(texts: dict[Path, str]) -> list[Path]:
    """Write texts, whole or not at all."""
    for path, text in texts.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, text)
        except OSError as error:
            raise UserError(f"{path}: cannot be written ({error.strerror}); name another place") from error
    return list(texts)


def summary(fit: Nearest, files: Sequence[Path]) -> list[str]:
    """What a user sees: the cost, and the files.

    Args:
        fit: The format's parameters with their cost.
        files: What was written.

    Returns:
        Lines for a terminal.
    """
    return [*fit.lines(), *(f"written: {file}" for file in files)]
