"""`spacearm export`: the identified model for simulators and controllers, with what a format costs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..export.write import FORMATS, export_model, read_result, summary
from . import common

DESCRIPTION = """
Write an identified model for a simulator (mjcf, sdf, urdf with ros2_control tags, usd) or a controller (c: C99, one
header and one source; numpy, casadi: one Python module). A simulator's joint has an inertia, a damping, a Coulomb
friction, at times a spring: they are fitted to all that was identified, on the motion of the validation, and what that
leaves is printed for each joint and stands at the head of the file. The physically consistent values are written. Code
has torque, gravity, friction compensation with a stated behaviour at zero speed, and the regressor; its law has no
memory.
"""


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser(
        "export", help="write a model for simulators and controllers", description=DESCRIPTION
    )
    command.add_argument("result", type=Path, metavar="DIR", help="result folder, or a model.yaml (then on a sweep)")
    command.add_argument("--to", required=True, choices=FORMATS, help="format; usd needs pip install usd-core")
    command.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help="where to; of c a folder: the files have the arm's name"
    )
    command.add_argument("--json", action="store_true", help="print values and cost as JSON on standard output")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, fit, write, and say what it costs."""
    model, validation = read_result(options.result)
    fit, files = export_model(model, validation, options.to, options.out, options.result.name)
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
