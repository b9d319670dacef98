"""`spacearm excite`: an excitation trajectory, optimised under all limits."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..canbus.arm_bus import EXTRAPOLATION
from ..documents import finite
from ..driver.playback import BRIDGED_ACCELERATION, EASED_ACCELERATION, acceleration_for_stalls
from ..driver.safety import Margins
from ..dynamics.arm import Arm, load_arm
from ..dynamics.mimics import require_open_chain
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..dynamics.model_file import load_model
from ..errors import UserError
from ..excitation.clearance import NEEDED_M, Clearance
from ..excitation.composite import PURPOSES, compose, with_slow_segment
from ..excitation.constraints import Margin, Requirements, allowed_torque, check, limits_for_excitation
from ..excitation.criteria import CRITERIA, CRITERION_WORDS, DEFAULT_CRITERION, Question
from ..excitation.genetic import evolve
from ..excitation.joint_trajectory import PATH_RATE_HZ, save_joint_trajectory
from ..excitation.nominal import nominal_model
from ..excitation.optimise import GENTLE, Excitation, gentle, optimise, optimise_harmonics
from ..excitation.problem import Problem
from ..excitation.segments import MotionLimits
from ..excitation.smooth_columns import left_out
from ..excitation.start_posture import possible_start, room_of
from ..excitation.trajectory import Trajectory
from ..excitation.trajectory_file import save_trajectory
from ..report.excitation_html import excitation_html, write_page
from ..sessions.identification import within
from . import common

DESCRIPTION = """
Optimise an excitation trajectory for an arm: a finite Fourier series whose recording determines the dynamics best, with
approach and return, under limits of position, velocity, acceleration, jerk, torque, frequency and clearance, all of
them verified with their margins. Beside it a gentle run of the same kind (40 % of the limits), to be recorded first,
and a page that shows motion, limits, torques and postures. The same --seed gives the same trajectory, another seed one
with other coefficients: use it for validation. With --for, a composite run for one question instead (constant speeds,
slow reversals, chirps).
"""
AUTO = "auto"
METHODS = {"gradient": optimise, "genetic": evolve}
INFORMATION_HZ = 1000.0


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    common.add_arm_options(command)
    command.add_argument(
        "--model", type=Path, metavar="FILE", help="model.yaml: the model to plan with; default: CAD inertials"
    )
    command.add_argument("--out", required=True, type=Path, metavar="FILE", help="trajectory file to write")
    command.add_argument(
        "--joint-trajectory",
        type=Path,
        metavar="FILE",
        help="the run also as a trajectory_msgs/msg/JointTrajectory in YAML, for 'ros2 topic pub --stdin'",
    )
    command.add_argument(
        "--for", dest="purpose", choices=tuple(PURPOSES), help="a composite run for this instead of a Fourier series"
    )
    command.add_argument("--joints", nargs="+", metavar="JOINT", help="with --for: the joints to move; default: all")
    command.add_argument(
        "--criterion",
        choices=CRITERIA,
        default=DEFAULT_CRITERION,
        help=f"what to make small (default {DEFAULT_CRITERION})",
    )
    command.add_argument("--optimiser", choices=tuple(METHODS), default="gradient", help="default gradient")
    command.add_argument(
        "--harmonics",
        default=AUTO,
        metavar="N",
        help="auto (default): the fewest after which the criterion improves little",
    )
    command.add_argument("--fundamental", type=float, default=0.1, metavar="HZ", help="default 0.1")
    command.add_argument("--periods", type=int, default=5, help="how often the period is repeated (default 5)")
    command.add_argument(
        "--no-gentle", dest="gentle", action="store_false", help="no gentle run, for an arm that has been moved before"
    )
    command.add_argument(
        "--slow", type=int, default=0, metavar="N", help="append N slow sines of 10 s, at most 0.01 rad/s (default 0)"
    )
    _add_limit_options(command)
    command.add_argument("--seed", type=int, default=0, help="default 0")
    common.add_output_options(command)
    command.set_defaults(run=run)


def _add_limit_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--start",
        type=float,
        nargs="+",
        metavar="RAD",
        help="posture of rest before and after (default: the arm file's, or one found)",
    )
    command.add_argument("--jerk", type=float, nargs="+", metavar="RAD/S3", help="jerk limit: one, or one a joint")
    command.add_argument(
        "--structural-frequency", type=float, metavar="HZ", help="lowest resonance of the structure: stay below it"
    )
    command.add_argument(
        "--ground", default=AUTO, metavar="Z", help="height of the floor, m; none; auto: 0 where gravity pulls down"
    )
    command.add_argument(
        "--clearance", type=float, default=NEEDED_M, metavar="M", help=f"least distance (default {NEEDED_M:g})"
    )
    command.add_argument(
        "--no-stall-margin",
        dest="stall_margin",
        action="store_false",
        help="use the full torque and acceleration limits: for an arm that is not driven by this package's driver",
    )
    command.add_argument(
        "--noise", type=float, nargs="+", metavar="NM", help="torque noise a joint (default: by torque limit)"
    )


def run(options: argparse.Namespace) -> int:
    """Load, optimise, write."""
    identified = model_of(options)
    stated = _per_joint(options.start, identified.model.arm.joint_names, "--start")
    home = stated if stated is not None else identified.model.arm.start
    needs, notes = requirements(
        options, identified, np.zeros(len(identified.model.arm.joints)) if home is None else home
    )
    if home is None:
        home = _found_start(identified.model.arm, needs, notes)
    excitation = first = None
    with common.progress(options) as report:
        if options.purpose is not None:
            report(0.3, f"composing for {options.purpose}")
            trajectory = compose(options.purpose, needs, home, options.joints)
        else:
            if options.joints is not None:
                raise UserError("--joints goes with --for: a Fourier excitation moves all joints")
            excitation = best(options, identified, needs, home, within(report, 0.0, 0.95))
            trajectory = excitation.run
            if words := ", ".join(left_out(identified.model)):
                notes.append(
                    f"optimised without these terms of the model, which the check and the figures have: {words}"
                )
            if options.gentle:
                first = gentle(excitation)
            if options.slow:
                trajectory = with_slow_segment(trajectory, needs, options.slow)
        margins = check(trajectory, needs) if excitation is None or options.slow else excitation.margins
        report(0.97, "writing")
        files = write(options, needs, trajectory, margins, first)
    if options.json:
        common.print_json(document(options, trajectory, margins, excitation) | files)
    else:
        print(summary(options, trajectory, margins, excitation, needs, files))
    for line in notes:
        common.note(options, line)
    return 0


def write(
    options: argparse.Namespace,
    needs: Requirements,
    trajectory: Trajectory,
    margins: Sequence[Margin],
    first: Excitation | None,
) -> dict[str, str]:
    """Write the runs and their page; returns what was written beside the run, for `document`.

    Args:
        options: Of the command line: output paths, arm and model.
        needs: All limits, and the model that predicts torque.
        trajectory: The run to record.
        margins: How near `trajectory` comes to each limit.
        first: The gentle excitation, to be recorded first; None: none is written.

    Returns:
        Kind (`page`, `joint_trajectory`, `gentle`) -> path of the file written.

    Raises:
        UserError: A file cannot be written.
    """
    origin = common.origin(options, options.arm, options.model)
    save_trajectory(trajectory, options.out, origin)
    files = {}
    if options.joint_trajectory is not None:
        save_joint_trajectory(trajectory, options.joint_trajectory, origin)
        files["joint_trajectory"] = str(options.joint_trajectory)
    if first is not None:
        path = options.out.with_name(f"{options.out.stem}_gentle{options.out.suffix}")
        save_trajectory(first.run, path, origin)
        files["gentle"] = str(path)
        if options.joint_trajectory is not None:
            message = options.joint_trajectory
            save_joint_trajectory(first.run, message.with_name(f"{message.stem}_gentle{message.suffix}"), origin)
    page = options.out.with_suffix(".html")
    runs = [(options.out.name, trajectory)] + ([] if first is None else [(Path(files["gentle"]).name, first.run)])
    write_page(page, excitation_html(needs, runs, worst(margins)))
    return files | {"page": str(page)}


def _found_start(arm: Arm, needs: Requirements, notes: list[str]) -> FloatArray:
    """(n,) start posture, rad or m: all zeros where the arm can rest there, else a posture that is searched for."""
    zero = np.zeros(len(arm.joints))
    if room_of(needs, zero[None])[0] > 0.0:
        return zero
    found = possible_start(arm, needs)
    if found is None:
        return zero
    words = " ".join(f"{value:g}" for value in found)
    notes.append(f"start posture {words}, since all zeros violates a limit (another: --start, start_position_rad)")
    return found


def model_of(options: argparse.Namespace) -> IdentifiedModel:
    """The model to plan with: identified, or of the CAD links alone.

    Raises:
        UserError: Neither arm nor model is given, or they are of different arms.
    """
    if options.arm is None and options.model is None:
        raise UserError("no arm: give --arm ARM (URDF or arm YAML), --model model.yaml, or both")
    identified = None if options.model is None else load_model(options.model)
    known = None if options.arm is not None or identified is None else identified.model.arm
    arm = known or require_open_chain(load_arm(options.arm))
    if options.gravity is not None:
        arm = arm.with_gravity(np.array(options.gravity))
    if identified is None:
        return nominal_model(arm)
    if identified.model.arm.joint_names != arm.joint_names:
        raise UserError(
            f"{options.model} is of an arm with the joints {', '.join(identified.model.arm.joint_names)}; "
            f"{options.arm} has {', '.join(arm.joint_names)}"
        )
    return replace(identified.possible, model=TorqueModel(arm, identified.model.structure))


def requirements(
    options: argparse.Namespace, identified: IdentifiedModel, start: FloatArray
) -> tuple[Requirements, list[str]]:
    """All limits that an excitation must keep, and notes on what was assumed for them.

    Args:
        options: Of the command line: limits, clearance, ground and structural frequency.
        identified: Model that predicts torque; its arm has the limits.
        start: (n,) posture of rest, rad or m; a joint without position limits may move about it.

    Raises:
        UserError: An option has a value out of range, or a joint has no velocity limit.
    """
    arm = identified.model.arm
    for name in ("fundamental", "structural_frequency"):
        value = getattr(options, name)
        if value is not None and not value > 0:
            raise UserError(f"--{name.replace('_', '-')} {value:g} must be above zero")
    if options.periods < 1 or options.slow < 0:
        raise UserError("--periods must be at least 1 and --slow at least 0")
    jerk = _per_joint(options.jerk, arm.joint_names, "--jerk")
    if jerk is not None and not np.all(jerk > 0):
        raise UserError("--jerk must be above zero")
    limits, notes = limits_for_excitation(arm, start, jerk)
    accelerations: tuple[float, ...] = (1.0,)
    if options.stall_margin:
        accelerations = (1.0, BRIDGED_ACCELERATION, EASED_ACCELERATION)
        slower = acceleration_for_stalls(limits.velocity, limits.acceleration, EXTRAPOLATION, Margins().velocity)
        notes += _stall_notes(limits, slower)
        limits = replace(limits, acceleration=slower)
    clearance = Clearance(arm, _ground(options.ground, arm.gravity), limits.lower, limits.upper, options.clearance)
    notes.append(f"clearance: {len(clearance.pairs)} pairs, from {clearance.source}")
    if clearance.unchecked:
        pairs = ", ".join(f"{a}-{b}" for a, b in clearance.unchecked)
        notes.append(f"clearance not checked for pairs that overlap in nearly every posture: {pairs}")
    if options.model is None:
        notes.append("torque from CAD inertials alone; --model adds identified friction and rotor inertias")
    structural_hz = options.structural_frequency
    needs = Requirements(limits, allowed_torque(arm), identified, structural_hz, clearance, accelerations)
    return needs, notes


def _stall_notes(limits: MotionLimits, acceleration: FloatArray) -> list[str]:
    """What the margin for stalls of the driver's cycle asks for, a line each."""
    lines = [
        f"torque limits kept at {BRIDGED_ACCELERATION:g} times the planned acceleration, margin for delayed cycles of "
        "the driver (--no-stall-margin: without it)"
    ]
    if np.any(acceleration < limits.acceleration):
        lines.append(
            "acceleration kept below its limit, so that a delayed cycle does not exceed the velocity limit: "
            + ", ".join(f"{value:.3g}" for value in acceleration.tolist())
            + " rad/s²"
        )
    return lines


def best(
    options: argparse.Namespace,
    identified: IdentifiedModel,
    needs: Requirements,
    start: FloatArray,
    report: common.Report,
) -> Excitation:
    """Optimise the Fourier excitation that the command line asks for.

    Args:
        options: Of the command line: criterion, harmonics, periods, noise, optimiser and seed.
        identified: Model whose parameters the excitation is to determine.
        needs: All limits.
        start: (n,) posture of rest before and after the run, rad or m.
        report: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: `--noise` or `--harmonics` is not understood, or no excitation within the limits is found.
    """
    question = Question.of(identified, _per_joint(options.noise, needs.joints, "--noise"))
    method = METHODS[options.optimiser]
    problem = Problem(question, needs, options.criterion, options.fundamental, 5, options.periods, start)
    if options.harmonics == AUTO:
        return optimise_harmonics(problem, options.seed, report, method)
    try:
        harmonics = int(options.harmonics)
    except ValueError:
        harmonics = 0
    if harmonics < 1:
        raise UserError(f"--harmonics {options.harmonics!r} is neither a whole number above zero nor auto")
    return method(replace(problem, harmonics=harmonics), options.seed, report)


def _per_joint(values: Sequence[float] | None, joints: Sequence[str], option: str) -> FloatArray | None:
    if values is None:
        return None
    if len(values) not in (1, len(joints)):
        raise UserError(f"{option} has {len(values)} numbers: give one, or one for each of {', '.join(joints)}")
    return np.broadcast_to(np.asarray(values, dtype=float), len(joints)).copy()


def _ground(choice: str, gravity: FloatArray) -> float | None:
    if choice == "none":
        return None
    if choice == AUTO:
        return 0.0 if gravity[2] < 0 else None
    try:
        return float(choice)
    except ValueError:
        raise UserError(f"--ground {choice!r} is neither a height in metres nor none nor auto") from None


def worst(margins: Sequence[Margin]) -> list[Margin]:
    """Of every kind of limit the one nearest to being broken."""
    kinds = dict.fromkeys(margin.kind for margin in margins)
    return [max((m for m in margins if m.kind == kind), key=lambda m: m.used) for kind in kinds]


def document(
    options: argparse.Namespace, trajectory: Trajectory, margins: Sequence[Margin], excitation: Excitation | None
) -> dict[str, Any]:
    """The result as plain data, for `--json`.

    Args:
        options: Of the command line: output path, criterion and purpose.
        trajectory: The run to record.
        margins: How near it comes to each limit.
        excitation: The optimised excitation; None where the run was composed for a purpose (`--for`).
    """
    out: dict[str, Any] = {
        "trajectory": str(options.out),
        "joints": list(trajectory.joints),
        "duration_s": float(trajectory.duration_s),
        "margins": [asdict(margin) for margin in margins],
    }
    if excitation is None:
        return out | {"purpose": options.purpose, "spectrum": PURPOSES[options.purpose]}
    series = excitation.series
    return out | {
        "criterion": options.criterion,
        "criteria": {name: finite(value) for name, value in excitation.criteria.items()},
        "harmonics": series.a.shape[1],
        "fundamental_hz": series.fundamental_hz,
        "periods": series.periods,
        "tried": [{"harmonics": n, "value": finite(value)} for n, value in excitation.tried],
        "prediction_sd_Nm": dict(zip(trajectory.joints, excitation.prediction_sd.tolist())),
        "constants_relative_error": whole_errors(excitation, trajectory),
    }


def whole_errors(excitation: Excitation, trajectory: Trajectory) -> dict[str, float]:
    """Relative standard errors of the model's constants after the whole run, slow segment included.

    Args:
        excitation: Its problem gives the model at its current values and the noise of the joints.
        trajectory: The run to be recorded, from rest to rest.

    Returns:
        Name of a constant, such as a Stribeck velocity -> its relative error; empty where none is estimated.
    """
    times = np.arange(0.0, trajectory.duration_s, 1.0 / INFORMATION_HZ)
    information = excitation.problem.question.information(trajectory.evaluate(times), INFORMATION_HZ)
    return information.relative_errors(len(times))


def summary(
    options: argparse.Namespace,
    trajectory: Trajectory,
    margins: Sequence[Margin],
    excitation: Excitation | None,
    needs: Requirements,
    files: Mapping[str, str],
) -> str:
    """The result as text for a terminal.

    Args:
        options: Of the command line: output path, criterion and purpose.
        trajectory: The run to record.
        margins: How near it comes to each limit.
        excitation: The optimised excitation; None where the run was composed for a purpose (`--for`).
        needs: All limits, and the model that predicts torque.
        files: Kind -> path of the other files written, as from `write`.
    """
    lines = [f"{options.out}: {trajectory.duration_s:.1f} s, all limits of {len(needs.joints)} joints kept"]
    if "gentle" in files:
        lines.append(
            f"next: record {files['gentle']} first, at most {GENTLE:.0%} of the velocity and acceleration limits"
        )
    if "joint_trajectory" in files:
        lines.append(f"{files['joint_trajectory']}: {PATH_RATE_HZ:g} points a second, begins in the posture of rest")
    lines.append(f"page: {files['page']}: motion, limits, torques, postures")
    if excitation is None:
        lines.append(f"for {options.purpose}: {PURPOSES[options.purpose]}")
    else:
        series = excitation.series
        if excitation.tried:
            tried = ", ".join(f"{n}: {value:.4g}" for n, value in excitation.tried)
            lines.append(f"{options.criterion} by number of harmonics {tried}")
        lines.append(f"{series.a.shape[1]} harmonics of {series.fundamental_hz:g} Hz, {series.periods} periods")
        for name, value in excitation.criteria.items():
            chosen = "  <- optimised" if name == options.criterion else ""
            lines.append(f"  {CRITERION_WORDS[name]:<64}{value:>10.4g}{chosen}")
        arm = needs.identified.model.arm
        sd = ", ".join(f"{value:.3g} {j.units.effort}" for value, j in zip(excitation.prediction_sd, arm.joints))
        lines.append(f"standard deviation of predicted torque by joint: {sd}")
        errors = whole_errors(excitation, trajectory)
        if errors:
            lines.append("relative errors: " + ", ".join(f"{name} {value:.2g}" for name, value in errors.items()))
    lines.append(f"{'quantity':<14}{'closest to its limit':<28}{'value':>10}{'limit':>10} {'unit':<8}{'used':>6}")
    for m in worst(margins):
        lines.append(f"{m.kind:<14}{m.where:<28}{m.value:>10.4g}{m.limit:>10.4g} {m.unit:<8}{m.used:>6.0%}")
    return "\n".join(lines)
