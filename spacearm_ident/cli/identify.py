"""`spacearm identify`: bags in, a result folder out."""

from __future__ import annotations

import argparse
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

from ..conventions.finding import UNFIT_MODEL, ConventionReport
from ..dynamics.model import FRICTION_LAWS
from ..environment.gravity import GRAVITY_CHOICES, VECTOR
from ..estimate.counts import counts
from ..estimate.identified import GAIN_DEVIATION, Identified, Validation
from ..estimate.optional_terms import OptionalTerm
from ..identification.verdict import judge_result
from ..results.tables import validation_dict
from ..sessions.bags import AUTO, Options, identify_bags
from ..solvers.choice import SEPARABLE, SOLVERS
from . import common

DESCRIPTION = """
Identify an arm's dynamics from one or more recordings (MCAP files, rosbag2 folders, other bags and logs: see
'spacearm import --help') and write a folder with
model.yaml, parameters.csv, identified.urdf, validation.json and report.html. The first line is the verdict: good,
fair, poor, suspect (physically impossible), or data unfit (a mistake of convention: see 'spacearm check --help'). Exit
code 3: poor or suspect, 1: data unfit; the folder is written.
"""
POOR_OR_SUSPECT = 3
"""Exit code where it ran, and the model is not to be used before its reasons are cleared."""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recordings to fit, of the same arm")
    common.add_files_option(
        command,
        "--validate",
        "recordings to validate on; default: the last third of the motion in the last BAG is held out of the fit",
    )
    command.add_argument("--out", required=True, type=Path, metavar="DIR", help="result folder")
    add_options(command)
    common.add_output_options(command)
    command.set_defaults(run=run)


def add_options(command: argparse.ArgumentParser) -> None:
    """How to identify: what `options_of` reads."""
    common.add_arm_options(command)
    common.add_base_option(command)
    common.add_namespace_option(command)
    common.add_mapping_option(command)
    command.add_argument(
        "--bandwidth",
        dest="cutoff_hz",
        type=float,
        metavar="HZ",
        help="low-pass cut-off; default: chosen from the data and printed",
    )
    command.add_argument(
        "--friction",
        choices=(AUTO, *FRICTION_LAWS),
        default=AUTO,
        help="friction law; auto (default): the terms that predict held-out data best, joint by joint",
    )
    command.add_argument(
        "--structure",
        type=Path,
        metavar="FILE",
        help="identify the terms of this model file, its effects (extended_model.yaml) included; instead of --friction",
    )
    _add_surroundings(command)
    _add_known_mass(command)
    command.add_argument(
        "--solver",
        choices=SOLVERS,
        default=SEPARABLE,
        help="separable (default): grid, then Levenberg-Marquardt; pso-lm: the paper's, over all its parameters, "
        "to compare with; idim-iv: instrumental variables, and cloe: closed-loop output error (columns of a simulated "
        "arm, best with /joint_command recorded), to see whether noise in the positions biases least squares",
    )
    command.add_argument("--seed", type=int, default=0, metavar="N", help="of the particle swarm (default 0)")


def _add_surroundings(command: argparse.ArgumentParser) -> None:
    """Options about temperature, gravity, and what is known from before."""
    command.add_argument(
        "--temperature",
        type=_symbols,
        default=(),
        metavar="LIST",
        help="friction that follows the recorded joint temperatures: f_c, k_v1, v_b, or some with commas between; "
        "default: none",
    )
    command.add_argument(
        "--estimate-gravity",
        nargs="?",
        const=VECTOR,
        default="",
        choices=GRAVITY_CHOICES,
        help="estimate gravity with the arm: its vector (default), or its direction alone, the size that of --gravity",
    )
    command.add_argument(
        "--prior",
        type=Path,
        metavar="FILE",
        help="update this model (model.yaml in a result folder, its covariance beside it) by the BAGs, for 5 s of "
        "data. Nothing is held out of the fit; with --friction vacuum its k_v2 and k_v3 are 0",
    )


def _add_known_mass(command: argparse.ArgumentParser) -> None:
    """A known mass, by which torque gains are calibrated."""
    command.add_argument(
        "--weighed",
        default="",
        metavar="MASS@LINK",
        help="calibrate each joint's torque gain with a known mass, in kg, fixed to this link of the URDF (2.5@tool0; "
        "without @LINK the last one) in the recordings of --loaded; recorded torque is then divided by the gains",
    )
    common.add_files_option(
        command, "--loaded", "recordings with the known mass, of the arm as it is in the BAGs without it"
    )


def options_of(options: argparse.Namespace) -> Options:
    """What `add_options` added; each is called as its field there."""
    given: dict[str, Any] = {item.name: getattr(options, item.name) for item in fields(Options)}
    given |= {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
    return Options(**given)


def run(options: argparse.Namespace) -> int:
    """Read, identify, validate, write; the exit code says what the model is worth."""
    with common.progress(options) as report:
        session, findings = identify_bags(
            options.bags,
            options.validate,
            options.out,
            options_of(options),
            command=options.command_line,
            progress=report,
        )
    identified, validation = session.identified, session.validation
    conventions = session.conventions
    if options.json:
        surroundings = identified.environment.as_dict()
        figures = validation_dict(identified, validation, conventions.unfit)
        data = {"conventions": conventions.as_dict()}
        common.print_json({"result": str(options.out), **figures, **data, "environment": surroundings})
    else:
        print(summary(identified, validation, session.page, conventions))
    for line in findings:
        common.note(options, line)
    if conventions.certain:
        return 1
    return 0 if judge_result(identified, validation).usable else POOR_OR_SUSPECT


def _beyond_the_plain_law(identified: Identified) -> list[str]:
    """Lines on the terms that predict held-out data better than Coulomb and viscous friction, the joints of each."""
    joints: dict[str, list[str]] = {}
    for choice in identified.choices:
        if choice.accepted and choice.kind not in (None, OptionalTerm.OFFSET):
            joints.setdefault(choice.kind.row.words, []).append(choice.joint)
    return [
        f"in the model, because it predicts held-out data better: {term} at {', '.join(at)}"
        for term, at in joints.items()
    ]


def _symbols(text: str) -> tuple[str, ...]:
    """Names with commas between."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


UNFIT_NEXT = "apply the remedies below (->) or record again, then identify again"
"""Next step where the data are unfit."""


def summary(
    identified: Identified, validation: Validation, page: Path, conventions: ConventionReport | None = None
) -> str:
    """The result as text for a terminal: verdict, next step, figures of merit, and how they were obtained.

    Of unfit data the verdict is theirs: how well a model repeats data with a mistake says nothing for it.

    Args:
        identified: Identified model with estimates and bandwidth.
        validation: Figures of merit of that model by joint.
        page: The HTML report written.
        conventions: What was found wrong with the data; None: they were not tested.
    """
    bandwidth = identified.bandwidth
    units = {joint.name: joint.units.effort for joint in identified.model.model.arm.joints}
    verdict = judge_result(identified, validation)
    about = conventions.lines() if conventions is not None and conventions.findings else []
    unfit = conventions is not None and not conventions.fit
    lines = [
        *(about[:1] if unfit else verdict.lines),
        f"next: {UNFIT_NEXT if unfit else _next_step(verdict.usable, page, identified)}",
        f"report: {page}",
        *([*about[1:], UNFIT_MODEL] if unfit else []),
        f"validated {validation.what}",
        f"{'joint':<24}{'RMSE':>10}{'max':>10} {'unit':<5}{'R':>8}{'rel. RMS':>10}{'moving':>9}{'unfiltered':>12}",
    ]
    places = common.decimals(joint.everything.rmse for joint in validation.joints.values())
    for joint, figures in validation.joints.items():
        fit = figures.everything
        raw = figures.unfiltered_moving or figures.unfiltered
        lines.append(
            f"{joint:<24}{fit.rmse:>10.{places}f}{fit.largest:>10.{places}f} {units[joint]:<5}"
            f"{_known(fit.correlation, '.4f'):>8}{_known(fit.relative_rms, '.1%'):>10}"
            f"{_known(figures.moving.relative_rms, '.1%'):>9}{_known(raw.relative_rms, '.1%'):>12}"
        )
    lines += [
        f"RMSE, max, R, rel. RMS: all samples, low-pass filtered at {bandwidth.cutoff_hz:.3g} Hz, the bandwidth of the "
        "fit; moving: rel. RMS of the moving samples; unfiltered: the same as recorded",
        f"bandwidth {bandwidth.cutoff_hz:.3g} Hz: {bandwidth.reason}",
        *([] if identified.solver.startswith(SEPARABLE) else [f"solver {identified.solver}"]),
        *identified.notes,
        *_beyond_the_plain_law(identified),
        counts(identified).words,
    ]
    if any(math.isfinite(estimate.gain_error) for estimate in identified.estimates):
        lines.append(
            "confidence intervals assume exact torque gains; parameters.csv has them with the gains' error as well, "
            f"{GAIN_DEVIATION:.0%} without a known mass (--weighed): ci95_with_gain_low, ci95_with_gain_high"
        )
    return "\n".join(lines if unfit else [*lines, *about])


def _known(value: float, form: str) -> str:
    """A figure, or a dash where a joint has none: one that does not move has no moving samples."""
    return format(value, form) if math.isfinite(value) else "-"


def _next_step(usable: bool, page: Path, identified: Identified) -> str:
    """What to do with the result."""
    coupling = identified.coupling
    if coupling is not None and coupling.helps and not coupling.adopted:
        return f"add this line to the arm YAML (--arm) and identify again: {coupling.line}"
    if usable:
        return f"look at {page}; 'spacearm export {page.parent}' writes the model for a simulator or a controller"
    lead = f"; {_since_the_prior(identified)}" if identified.moves else ""
    return (
        f"do not use the model before the reasons above are cleared; {page} shows where and at which speeds it fails"
        f"{lead}"
    )


def _since_the_prior(identified: Identified) -> str:
    """What may have changed since a prior that was right, beyond what an update lets change, and how to ask for it."""
    gravity = "gravity may not be zero (--gravity)"
    if identified.model.model.arm.gravity.any():
        gravity = "gravity may be another (--gravity; of a tilted base: --estimate-gravity direction)"
    return (
        "if the prior was good, the arm may hold a payload (spacearm payload BAG --model PRIOR), its base may move "
        f"without /base_imu in the recording, or {gravity}"
    )
