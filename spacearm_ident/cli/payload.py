"""`spacearm payload`: what the arm holds, with errors, in the calls of those who make arms."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..export.payload import Held, find_payload
from ..export.payload_calls import CALLS, GAIN_CAVEAT
from ..export.write import read_result
from ..identification.effort import in_newton_metres
from ..sessions.identification import corrected
from . import common

DESCRIPTION = """
Identify what the arm holds from recordings with it and a model of the arm without it (a result folder of identify, or
its model.yaml): mass, centre of mass and inertia with standard errors, in the frame of the flange, and as
set_target_payload of URScript, load data of KUKA and setLoad of Franka. Ten seconds in which the last joints move
against gravity, or accelerate where there is none, are enough for mass and centre; an inertia that the motion does not
excite is left out. Friction may have changed since the model; gains may not. A moving base counts by /base_imu. Exit
code 1: no payload was detected; 2: the model does not fit the recordings (another gravity, a negative mass).
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recordings with the payload")
    command.add_argument(
        "--model", required=True, type=Path, metavar="DIR", help="result of the arm without it, or a model.yaml"
    )
    command.add_argument(
        "--frame", metavar="LINK", help="report it in this link's frame; default: the flange (tool0, flange, ...)"
    )
    command.add_argument("--arm", type=Path, metavar="FILE", help="for logs: URDF or arm YAML")
    common.add_gravity_option(command, "default: the model's")
    common.add_base_option(command)
    common.add_namespace_option(command)
    common.add_mapping_option(command)
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, fit, report."""
    model, _ = read_result(options.model)
    if options.gravity is not None:
        model = model.with_gravity(np.array(options.gravity))
    arm = model.model.arm
    with common.progress(options) as report:
        runs = common.reading_of(options).read(options.bags, report)
        held = find_payload(model, corrected(in_newton_metres(runs, arm), arm), options.frame)
    if options.json:
        common.print_json(document(held))
    else:
        print("\n".join(lines(held, arm.joint_names)))
    common.note_findings(options, runs)
    return 0


def document(held: Held) -> dict[str, Any]:
    """The result for programs."""
    inertia = None
    if held.inertia is not None and held.inertia_error is not None:
        inertia = {"value": held.inertia.tolist(), "standard_error": held.inertia_error.tolist(), "unit": "kg m^2"}
    return {
        "frame": held.frame,
        "mass": {"value": held.mass, "standard_error": held.mass_error, "unit": "kg"},
        "centre": {"value": held.centre.tolist(), "standard_error": held.centre_error.tolist(), "unit": "m"},
        "inertia_about_centre": inertia,
        "residual_before_Nm": held.before_Nm.tolist(),
        "residual_after_Nm": held.after_Nm.tolist(),
        "calls": {name: call(held) for name, call in CALLS.items()},
        "notes": list(held.notes),
        "caveat": GAIN_CAVEAT,
    }


def lines(held: Held, joints: tuple[str, ...]) -> list[str]:
    """The result on a terminal.

    Args:
        held: The payload found.
        joints: Names in the arm's order, for the residuals of `held`; a joint without a residual is not listed.
    """
    centre = ", ".join(f"{value:.4f} ± {error:.4f}" for value, error in zip(held.centre, held.centre_error))
    shown = [
        f"payload: mass {held.mass:.3f} ± {held.mass_error:.3f} kg, centre {centre} m in {held.frame} (± std. error)",
        "next: set it in the controller with its call below",
    ]
    if held.inertia is None or held.inertia_error is None:
        shown.append("inertia: not determined by this motion; the calls below leave it out or set it to 0")
    else:
        for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            value, error = held.inertia[row, column], held.inertia_error[row, column]
            name = f"I{'xyz'[row]}{'xyz'[column]}"
            shown.append(f"{name} {value:.5f} ± {error:.5f} kg m^2 about the centre")
    drop = ", ".join(
        f"{j} {b:.2f} to {a:.2f}" for j, b, a in zip(joints, held.before_Nm, held.after_Nm) if np.isfinite(a)
    )
    shown += [f"{name}: {call(held)}" for name, call in CALLS.items()]
    notes = [f"note: {words}" for words in (*held.notes, GAIN_CAVEAT)]
    return [*shown, f"residual RMS without and with it, N m: {drop}", *notes]
