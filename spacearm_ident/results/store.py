"""A result as files that give it back: `model.yaml`, `result.json` and `result.npz`.

The report is made from these alone, without the recordings, and a later identification may take them for its prior.
`result.json` carries the SHA-256 of the other two, so that a folder holding parts of two results is recognised.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..bayes.from_prior import GroundPrior
from ..conventions.finding import Level as Weight
from ..documents import file_sha256
from ..dynamics.base_parameters import BaseParameters
from ..dynamics.model_file import load_model, save_model
from ..errors import UserError
from ..estimate.environment import Environment
from ..estimate.identified import (
    BaseBody,
    Choice,
    Determination,
    Estimate,
    Fit,
    Identified,
    JointValidation,
    LackOfFit,
    Move,
    Spectrum,
    Trace,
    Validation,
)
from ..estimate.optional_terms import OptionalTerm
from ..signals.bandwidth import Bandwidth
from .provenance import FITTED, OPTIONS, Moment, moment
from .recorded_runs import RecordedRun

SCHEMA = "spacearm_ident/result/1"
MODEL, FIGURES, ARRAYS, VALIDATION = "model.yaml", "result.json", "result.npz", "validation.json"
PRIOR_ADVICE = "give the model.yaml in a result folder of 'spacearm identify'"
_RUN_ARRAYS = ("time", "position", "largest_speed")
_SPECTRUM_ARRAYS = ("frequency", "torque", "residual")
_TRACE_ARRAYS = ("time", "position", "velocity", "measured", "predicted", "moving")


@dataclass(frozen=True)
class Result:
    """What a result folder holds.

    Attributes:
        identified: The identification.
        validation: Of its model.
        written: When it was, ISO 8601.
        runs: What was recorded.
        checked: Gives `ConventionReport.unfit`: why the data are unfit, empty where they are fit or were not tested.
            A function, since the test of the conventions may be under way while the page is drawn.
        individual: Which arm of its type it is of, where whoever reads several results knows; empty: the only one.
    """

    identified: Identified
    validation: Validation
    written: str
    runs: tuple[RecordedRun, ...] = ()
    checked: Callable[[], tuple[str, ...]] = tuple
    individual: str = ""

    @property
    def moment(self) -> Moment | None:
        """When and how warm its recordings were; None where it does not say."""
        return moment(self.identified.model.provenance, self.written)

    @property
    def inputs(self) -> str | None:
        """What it was made of: checksums of the recordings, and options, as text; None where it does not say."""
        known = self.identified.model.provenance or {}
        sums = [source.get("sha256") for source in known.get(FITTED) or () if isinstance(source, dict)]
        return json.dumps([sums, known.get(OPTIONS)], sort_keys=True) if sums and all(sums) else None

    @property
    def unfit(self) -> tuple[str, ...]:
        """Why the data are unfit; waits for the test of the conventions where that is under way."""
        return self.checked()


def save_result(result: Result, directory: Path) -> None:
    """Write the three files into an existing directory.

    Args:
        result: Identification and validation with signals.
        directory: Folder, in which older files of the same names are replaced.
    """
    save_model(result.identified.model, directory / MODEL)
    np.savez_compressed(directory / ARRAYS, **_arrays(result))
    sums = {name: file_sha256(directory / name) for name in (MODEL, ARRAYS)}
    text = json.dumps(_as_json({"schema": SCHEMA, "sha256": sums, **_plain(result)}), indent=1, allow_nan=False)
    (directory / FIGURES).write_text(text + "\n", encoding="utf-8")


def load_result(directory: Path) -> Result:
    """Read a result back.

    Raises:
        UserError: Not a result folder, an incomplete one, or files of different results in it.
    """
    advice = "give a folder that 'spacearm identify --out' wrote"
    try:
        data = json.loads((directory / FIGURES).read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{directory} is not a result folder (no readable {FIGURES}): {advice}") from error
    except (ValueError, RecursionError) as error:
        raise UserError(f"{directory / FIGURES} is not JSON: {advice}, or identify again") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise UserError(f"{directory / FIGURES} is not a result of this version ({SCHEMA}): identify again")
    try:
        for name in (MODEL, ARRAYS):  # by our names, never by those a file brings
            expected = data["sha256"][name]
            if file_sha256(directory / name) != expected:
                raise UserError(f"{directory / name} is not the file this result was written with: identify again")
        with np.load(directory / ARRAYS, allow_pickle=False) as arrays:
            return _rebuild(data, dict(arrays), directory)
    except (OSError, KeyError, TypeError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        what = f"{type(error).__name__} {error}".splitlines()[0]
        raise UserError(f"the result in {directory} is incomplete ({what}): identify again") from error


def load_prior(path: Path) -> GroundPrior:
    """The model of a result folder with its covariance.

    Args:
        path: `model.yaml` of a result folder, or the folder.

    Raises:
        UserError: No model, no covariance beside it, or that of another model.
    """
    file = path / MODEL if path.is_dir() else path
    model = load_model(file)
    folder = file.parent
    try:
        sums = dict(json.loads((folder / FIGURES).read_text(encoding="utf-8"))["sha256"])
        with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
            covariance = np.asarray(arrays["covariance"], dtype=np.float64)
    except OSError as error:
        missing = Path(error.filename or folder / ARRAYS).name
        raise UserError(f"{file} has no covariance beside it ({missing}), a prior needs one: {PRIOR_ADVICE}") from error
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"the covariance beside {file} cannot be read: {PRIOR_ADVICE}, or identify again") from error
    if sums.get(MODEL) != file_sha256(file) or sums.get(ARRAYS) != file_sha256(folder / ARRAYS):
        raise UserError(f"{file} is not the model that the covariance beside it was written with: {PRIOR_ADVICE}")
    prior = GroundPrior(model, covariance, f"{file} (SHA-256 {sums[MODEL][:12]})")
    if covariance.shape != (len(prior.names),) * 2 or not np.isfinite(covariance).all():
        raise UserError(f"the covariance beside {file} does not fit it: identify again")
    return prior


def _arrays(result: Result) -> dict[str, Any]:
    identified = result.identified
    arrays = {
        "regrouping": identified.base.regrouping,
        "base_values": identified.base_values,
        "base_errors": identified.base_errors,
        "covariance": identified.covariance,
        "residual_sigma_Nm": identified.residual_sigma_Nm,
        "rows": np.asarray(identified.rows),
        "position_noise": identified.bandwidth.position_noise,
    }
    for k, trace in enumerate(result.validation.traces):
        arrays.update({f"trace_{k}_{name}": getattr(trace, name) for name in _TRACE_ARRAYS})
    for k, run in enumerate(result.runs):
        arrays.update({f"run_{k}_{name}": getattr(run, name) for name in _RUN_ARRAYS})
    if result.validation.spectrum is not None:
        arrays.update({f"spectrum_{name}": getattr(result.validation.spectrum, name) for name in _SPECTRUM_ARRAYS})
    return arrays


def _plain(result: Result) -> dict[str, Any]:
    identified, validation = result.identified, result.validation
    bandwidth = identified.bandwidth
    return {
        "written": result.written,
        "unfit": list(result.unfit),
        "estimates": [_estimate_dict(item) for item in identified.estimates],
        "base": {name: list(getattr(identified.base, name)) for name in ("independent", "names", "unseen")},
        "consistency_shift": identified.consistency_shift,
        "bandwidth": {key: getattr(bandwidth, key) for key in ("cutoff_hz", "crossing_hz", "dynamic_hz", "reason")},
        "choices": [asdict(choice) for choice in identified.choices],
        "solver": identified.solver,
        "joints_at_rest": list(identified.joints_at_rest),
        "joints_unresolved": list(identified.joints_unresolved),
        "notes": list(identified.notes),
        "environment": identified.environment.as_dict(),
        "moves": [asdict(move) for move in identified.moves],
        "base_body": identified.base_body
        and {
            name: [_estimate_dict(item) for item in getattr(identified.base_body, name)]
            for name in ("estimates", "combined")
        },
        "runs": [
            {
                **{key: getattr(run, key) for key in ("name", "fitted", "duration_s", "rate_hz", "samples")},
                "defects": list(run.defects),
                "read_as": list(run.read_as),
            }
            for run in result.runs
        ],
        "validation": {
            "joints": {name: asdict(joint) for name, joint in validation.joints.items()},
            "traces": [trace.source for trace in validation.traces],
            "what": validation.what,
            "held_out": validation.held_out,
        },
    }


def _estimate_dict(item: Estimate) -> dict[str, Any]:
    return {**asdict(item), "determination": item.determination.value}


def _as_json(value: Any) -> Any:
    """The same data with plain numbers; what JSON cannot say (NaN, infinity) becomes a string, not null.

    So that reading back needs no list of which fields are numbers: `float("nan")` undoes it.
    """
    if isinstance(value, dict):
        return {key: _as_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_json(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _choice(item: dict[str, Any]) -> Choice:
    """A decision about the structure; results of before November 2026 do not say of which term and joint."""
    # mypy takes the look-up of a member for a new one.
    kind = OptionalTerm(item["kind"]) if item.get("kind") else None  # type: ignore[call-arg]
    return Choice(item["term"], float(item["gain"]), item["accepted"], kind, item.get("joint", ""))


def _move(item: dict[str, Any]) -> Move:
    """A value before and after an update; results before 27 November 2026 call its variance reduction `told`."""
    return Move(**{"variance_reduction" if key == "told" else key: value for key, value in item.items()})


def _rebuild(data: dict[str, Any], arrays: dict[str, Any], directory: Path) -> Result:
    given = data["bandwidth"]
    hertz = {key: float(given[key]) for key in ("cutoff_hz", "crossing_hz", "dynamic_hz")}
    base = data["base"]
    identified = Identified(
        model=load_model(directory / MODEL),
        estimates=tuple(_estimate(item) for item in data["estimates"]),
        base=BaseParameters(
            tuple(base["independent"]), arrays["regrouping"], tuple(base["names"]), tuple(base["unseen"])
        ),
        consistency_shift=float(data["consistency_shift"]),
        bandwidth=Bandwidth(**hertz, position_noise=arrays["position_noise"], reason=given["reason"]),
        choices=tuple(_choice(item) for item in data["choices"]),
        solver=data["solver"],
        joints_at_rest=tuple(data["joints_at_rest"]),
        joints_unresolved=tuple(data.get("joints_unresolved", ())),
        notes=tuple(data["notes"]),
        environment=Environment.from_dict(data.get("environment", {})),
        moves=tuple(_move(item) for item in data.get("moves", ())),
        base_body=_base_body(data.get("base_body")),
        **{name: arrays[name] for name in ("base_values", "base_errors", "covariance", "residual_sigma_Nm", "rows")},
    )
    runs = tuple(
        RecordedRun(
            **{**run, "defects": tuple(run["defects"]), "read_as": tuple(run.get("read_as", ()))},
            **{name: arrays[f"run_{k}_{name}"] for name in _RUN_ARRAYS},
        )
        for k, run in enumerate(data.get("runs", ()))
    )
    unfit = tuple(data["unfit"]) if "unfit" in data else _unfit_before(directory)
    return Result(identified, _validation(data["validation"], arrays), data["written"], runs, lambda: unfit)


def _unfit_before(directory: Path) -> tuple[str, ...]:
    """Why data are unfit, of a result of before December 2026: only its `validation.json` has the conventions."""
    try:
        told = json.loads((directory / VALIDATION).read_text(encoding="utf-8"))["conventions"]
        wrong = [item for item in told["findings"] if item["level"] == Weight.UNFIT and not told["fit"]]
        lines = [f"{item['level']}: {item['kind']}: {item['statement']} -> {item['remedy']}" for item in wrong]
        return (str(told["verdict"]), *lines) if lines else ()
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return ()


def _base_body(data: dict[str, Any] | None) -> BaseBody | None:
    return BaseBody(**{name: tuple(map(_estimate, items)) for name, items in data.items()}) if data else None


def _estimate(item: dict[str, Any]) -> Estimate:
    numbers = {key: float(item.get(key, "nan")) for key in ("value", "standard_error", "gain_error")}
    return Estimate(**{**item, **numbers, "determination": Determination(item["determination"])})


def _validation(data: dict[str, Any], arrays: dict[str, Any]) -> Validation:
    traces = tuple(
        Trace(source, **{name: arrays[f"trace_{k}_{name}"] for name in _TRACE_ARRAYS})
        for k, source in enumerate(data["traces"])
    )
    joints = {
        name: JointValidation(
            _fit(joint["everything"]),
            _fit(joint["moving"]),
            _fit(joint["unfiltered"]),
            joint["lack_of_fit"] and LackOfFit(**{key: float(value) for key, value in joint["lack_of_fit"].items()}),
            _fit(joint["unfiltered_moving"]) if joint.get("unfiltered_moving") else None,
        )
        for name, joint in data["joints"].items()
    }
    known = "spectrum_frequency" in arrays
    spectrum = Spectrum(*(arrays[f"spectrum_{name}"] for name in _SPECTRUM_ARRAYS)) if known else None
    return Validation(joints, traces, data["what"], data["held_out"], spectrum)


def _fit(data: dict[str, Any]) -> Fit:
    numbers = {key: float(value) for key, value in data.items() if key != "rows"}
    return Fit(rows=int(data["rows"]), **numbers)
