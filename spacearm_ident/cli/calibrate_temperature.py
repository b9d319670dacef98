"""`spacearm calibrate-temperature`: bags over a temperature sweep in, alpha of every joint out."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from ..dynamics.model_file import load_model, save_model
from ..environment.temperature import (
    WANTED_SHARE,
    Figure,
    TemperatureCalibration,
    calibrate_temperature,
    calibration_dict,
    with_temperature,
)
from ..errors import UserError
from ..identification.effort import in_newton_metres
from ..report.folder import refuse_to_replace, replacing
from ..results.provenance import provenance
from . import common

DESCRIPTION = """
Fit how friction follows temperature, f_c(T) = f_c0 + alpha (T - 20 °C), from constant-velocity runs recorded at several
temperatures (spacearm excite --for temperature). Steady runs are found in the bags. Gravity is taken out by running
forth and back through the same postures, or by the model where one is given.
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recordings over a temperature sweep")
    command.add_argument("--model", type=Path, metavar="FILE", help="model.yaml: takes gravity out, and gets the term")
    command.add_argument("--out", type=Path, metavar="DIR", help="folder for temperature.json, and model.yaml")
    command.add_argument(
        "--error",
        type=float,
        default=100.0 * WANTED_SHARE,
        metavar="PERCENT",
        help="refuse a joint whose alpha is not known to this share of its friction a kelvin (default %(default)g)",
    )
    common.add_arm_options(command)
    common.add_namespace_option(command)
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, fit, write.

    Raises:
        UserError: Neither --out nor --json, or an error that is not above zero.
    """
    if options.out is None and not options.json:
        raise UserError("say where the result goes: --out DIR, or --json")
    if not options.error > 0.0:
        raise UserError("--error is a share in percent above zero")
    if options.out is not None:
        refuse_to_replace(options.model, options.out)
    with common.progress(options) as report:
        recordings = common.reading_of(options).read(options.bags, report)
    common.note_findings(options, recordings)
    model = load_model(options.model) if options.model else None
    if model is not None and options.gravity is not None:
        model = model.with_gravity(options.gravity)
    arm = None
    if model is not None:
        arm = model.model.arm
    elif options.arm is not None:
        arm = common.arm_of(options, recordings)
    joints = recordings[0].joints if arm is None else arm.joint_names
    recordings = recordings if arm is None else in_newton_metres(recordings, arm)
    calibration = calibrate_temperature(recordings, joints, model, options.error / 100.0)
    result = calibration_dict(calibration)
    if options.out is not None:
        known = provenance(recordings, (), options.command_line)
        text = json.dumps({**result, "provenance": known}, indent=2, allow_nan=False)
        with replacing(options.out, "temperature.json") as staging:
            (staging / "temperature.json").write_text(text + "\n", encoding="utf-8")
            if model is not None:
                before = {"model_before": dict(model.provenance)} if model.provenance else {}
                adapted = replace(with_temperature(model, calibration), provenance={**known, **before})
                save_model(adapted, staging / "model.yaml")
    if options.json:
        common.print_json(result)
    else:
        print(summary(calibration))
    return 0


def summary(calibration: TemperatureCalibration) -> str:
    """The result on a terminal."""
    lines = [
        f"{'joint':<20}{'alpha N m/K':>14}{'95 %':>20}{'alpha_v N m s/(rad K)':>24}{'95 %':>20}{'f_c0 N m':>10}"
        f"{'misfit N m':>12}{'runs':>6}"
    ]
    for joint, result in calibration.joints.items():
        level = "-" if result.f_c0 is None else f"{result.f_c0:.3f}"
        lines.append(
            f"{joint:<20}{_figure(result.alpha, 14)}{_figure(result.alpha_v, 24)}{level:>10}"
            f"{result.residual_Nm:>12.3f}{len(result.points):>6}"
        )
    lines.append(
        "alpha: Coulomb friction over temperature; alpha_v: viscosity, where speeds differ; misfit: standard deviation "
        "of a run about the straight lines"
    )
    lines += [f"{joint}: refused: {reason}" for joint, reason in calibration.refused.items()]
    for joints, words in (
        (calibration.no_temperature, "no temperature recorded"),
        (calibration.no_runs, "no steady run found"),
    ):
        if joints:
            lines.append(f"{', '.join(joints)}: {words}")
    return "\n".join(lines)


def _figure(figure: Figure | None, width: int) -> str:
    """A value and its 95 % interval as two columns of a table, the first so wide; dashes where there is none."""
    if figure is None:
        return f"{'-':>{width}}{'-':>20}"
    low, high = figure.interval
    return f"{figure.value:>{width}.4f}{f'{low:.4f} to {high:.4f}':>20}"
