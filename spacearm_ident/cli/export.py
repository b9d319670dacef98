"""`spacearm export`: the identified model for simulators and controllers, with what a format costs."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..dynamics.arm import load_arm
from ..dynamics.model import IdentifiedModel
from ..errors import UserError
from ..estimate.identified import Validation
from ..export.thresholds import PER_HOUR
from ..export.write import FORMATS, export_model, read_result, summary, with_drives
from ..identification.effort import in_newton_metres
from ..identification.validation import validate
from ..results.provenance import FITTED
from ..sessions.identification import ON_OTHERS, corrected
from . import common

DESCRIPTION = """
Write an identified model for a simulator (mjcf, sdf, urdf with ros2_control tags, usd) or a controller (c: C99, one
header and one source; numpy, casadi: one Python module). A simulator's joint has an inertia, a damping, a Coulomb
friction, at times a spring: they are fitted to all that was identified, on the motion of the validation, and what that
leaves is printed for each joint and stands at the head of the file. The physically consistent values are written. Code
has torque, gravity, friction compensation with a stated behaviour at zero speed, and the regressor; its law has no
memory. thresholds: for contact detection, by joint and speed, with the false alarms counted on held-out motion without
contact (YAML or JSON; in c and numpy as a function as well).
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("result", type=Path, metavar="DIR", help="result folder, or a model.yaml (then on a sweep)")
    command.add_argument("--to", required=True, choices=FORMATS, help="format; usd needs pip install usd-core")
    command.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help="where to; of c a folder: the files have the arm's name"
    )
    command.add_argument(
        "--arm",
        type=Path,
        metavar="FILE",
        help="arm YAML with gear ratios and torque constants: actuators of mjcf then take the motor's current, A, with "
        "their gain in N m/A; without it torque, N m; also the arm of logs given to --validate",
    )
    common.add_files_option(
        command, "--validate", "held-out recordings, for cost and thresholds; default: the result's own validation"
    )
    command.add_argument(
        "--false-alarms",
        type=float,
        default=PER_HOUR,
        metavar="PER_HOUR",
        help=f"that each threshold is set for, an hour of motion at a joint in a speed range (default {PER_HOUR:g})",
    )
    common.add_namespace_option(command)
    common.add_mapping_option(command)
    command.add_argument("--quiet", action="store_true", help="no progress bar and no notes on standard error")
    command.add_argument("--json", action="store_true", help="print values and cost as JSON on standard output")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, fit, write, and say what it costs."""
    model, validation = read_result(options.result)
    if options.arm is not None:
        model = with_drives(model, load_arm(options.arm))
    if options.validate:
        validation = _validated(options, model)
    origin = options.result.resolve().name
    fit, files = export_model(model, validation, options.to, options.out, origin, options.false_alarms)
    if options.json:
        common.print_json(
            {
                "files": [str(file) for file in files],
                "values": {joint: dict(values) for joint, values in fit.values.items()},
                "cost_Nm": dict(fit.cost_Nm),
                "most_Nm": dict(fit.most_Nm),
                "torque_Nm": dict(fit.torque_Nm),
                "not_held": list(fit.lost),
            }
        )
    else:
        print("\n".join(summary(fit, files)))
    return 0


def _validated(options: argparse.Namespace, model: IdentifiedModel) -> Validation:
    """The model's validation on the recordings named.

    Raises:
        UserError: The fit has seen one of them, or it cannot be read.
    """
    arm = model.model.arm
    with common.progress(options) as report:
        runs = common.reading_of(options).read(options.validate, report)
    seen = {source.get("sha256") for source in (model.provenance or {}).get(FITTED, [])}
    for run in runs:
        for source in run.sources:
            if source.sha256 in seen:
                raise UserError(f"{source.path}: the model was fitted to it; name held-out recordings")
    common.note_findings(options, runs)
    return validate(model, corrected(in_newton_metres(runs, arm), arm), ON_OTHERS, held_out=True)
