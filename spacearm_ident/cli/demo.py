"""`spacearm demo`: the main job on the simulated arm, on this machine, nothing needed beforehand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..config import config_path
from ..dynamics.arm import Arm, load_arm
from ..dynamics.model_file import load_model, model_to_dict
from ..excitation.trajectory import MotionLimits, Trajectory, random_feasible
from ..excitation.trajectory_file import save_trajectory
from ..identification.identify import Settings, identify, with_provenance
from ..identification.validation import validate
from ..recording import read_recording, write_recording
from ..report.folder import write_result
from ..report.provenance import provenance
from ..simulation.parameters import PlantParameters
from . import common
from .identify import summary
from .simulate import record

DESCRIPTION = """
Simulate an excitation run and a validation run of the paper's six-joint arm, record both to MCAP, identify the arm
from the first and validate it on the second. Everything is written to DIR.
"""
RUNS = (("excitation", 5, 1), ("validation", 3, 2))
"""Name, periods and seed of the runs: the same kind of motion with other coefficients."""


def add(commands: Any) -> None:
    """Add the command to a parser."""
    command = commands.add_parser("demo", help="the whole chain on the simulated arm", description=DESCRIPTION)
    command.add_argument(
        "--out", type=Path, default=Path("demo_result"), metavar="DIR", help="where to (default demo_result)"
    )
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Simulate, identify, validate, report."""
    arm = load_arm(config_path("paper_arm.yaml"))
    truth = load_model(config_path("paper_arm_model.yaml"))
    plant = PlantParameters.from_model(model_to_dict(truth), arm.urdf)
    options.out.mkdir(parents=True, exist_ok=True)
    bags = []
    with common.progress(options) as report:
        for number, (name, periods, seed) in enumerate(RUNS):
            trajectory = _trajectory(arm, periods, seed)
            save_trajectory(trajectory, options.out / f"{name}.yaml")
            part = common.within(report, 0.4 * number, 0.4 * (number + 1))
            recording = record(plant, trajectory, arm, seed, 1.0, part)
            bags.append(options.out / f"{name}.mcap")
            write_recording(bags[-1], recording)
        fitted, validated = ([read_recording(bag)] for bag in bags)
        identified = identify(fitted, arm, Settings(), common.within(report, 0.8, 0.9))
        validation = validate(identified.model, validated, "on a run with other coefficients", held_out=True)
        identified = with_provenance(identified, provenance(fitted, validated, "spacearm demo"))
        report(0.95, "writing the report")
        page = write_result(identified, validation, options.out)
    print(summary(identified, validation, page))
    return 0


def _trajectory(arm: Arm, periods: int, seed: int) -> Trajectory:
    """A random excitation within the arm's limits (until there is an optimised one)."""
    lower, upper, velocity, acceleration = np.array(
        [(j.lower, j.upper, j.velocity_limit, j.acceleration_limit) for j in arm.joints]
    ).T
    limits = MotionLimits(lower, upper, velocity, acceleration)
    return random_feasible(arm.joint_names, limits, seed=seed, periods=periods).run(limits)
