"""`spacearm simulate`: record the simulated arm."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm, load_arm
from ..dynamics.mimics import require_open_chain
from ..dynamics.model import IdentifiedModel
from ..dynamics.model_file import load_model
from ..dynamics.rigid_body import RigidBody
from ..errors import UserError
from ..excitation.trajectory import Trajectory
from ..excitation.trajectory_file import load_trajectory
from ..recording import Recording, write_recording
from ..simulation.closed_loop import SensorNoise, measure, simulate_truth
from ..simulation.concealed import Concealment, Effect, load_concealed
from ..simulation.concealed.from_model import simulated_arm
from ..simulation.own_arm import STATED, default_model, drives_of, torque_scale
from ..simulation.parameters import PlantParameters
from ..simulation.thermal import ThermalParameters, surroundings
from . import common

DESCRIPTION = """
Move a simulated arm along a trajectory, in closed loop and with real sensors' noise, and write the recording as an
MCAP file (or, where BAG does not end in .mcap, as a rosbag2 folder). With --arm alone it is an arm of its description:
CAD inertials, and friction of a default that is stated. With --conceal the arm also obeys physics that
its model lacks: a YAML file `schema: spacearm_ident/conceal/1`, `effects: [{effect: torque_ripple, joints:
[joint_3], parameters: {amplitude: 1.1, cycles: 24}}]`.
"""


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="what the arm obeys: a model.yaml or extended_model.yaml; default: CAD inertials of --arm, and friction",
    )
    command.add_argument("--trajectory", required=True, type=Path, metavar="FILE", help="trajectory to follow")
    command.add_argument(
        "--out", required=True, type=Path, metavar="BAG", help="recording to write: NAME.mcap, or a new folder"
    )
    command.add_argument(
        "--arm", type=Path, metavar="FILE", help="URDF, or arm YAML with gear ratios, torque constants, torque limits"
    )
    command.add_argument("--conceal", type=Path, metavar="FILE", help="physics to add that the model lacks")
    command.add_argument(
        "--temperature",
        type=float,
        default=ThermalParameters.ambient,
        metavar="C",
        help="of the surroundings, and of the arm at the start, degC (default %(default)g); "
        "the arm's own losses warm it from there",
    )
    command.add_argument(
        "--gravity", type=float, nargs=3, metavar=("X", "Y", "Z"), help="instead of the model's, m/s^2 (0 0 0 in orbit)"
    )
    command.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default 0)")
    command.add_argument(
        "--base-imu",
        type=float,
        nargs="?",
        const=200.0,
        default=0.0,
        metavar="HZ",
        help="record an IMU on the base, /base_imu (default 200 Hz); the effect floating_base moves it",
    )
    command.add_argument("--noise", type=float, default=1.0, metavar="FACTOR", help="times the default noise; 0: none")
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Load, simulate, write."""
    if options.noise < 0:
        raise UserError(f"--noise {options.noise:g} is negative: 0 is none, 1 the default")
    if options.base_imu < 0:
        raise UserError(f"--base-imu {options.base_imu:g} is negative: use its rate in Hz, such as 200")
    common.require_bag_name(options.out)
    model, arm = model_of(options)
    parameters, effects = simulated_arm(model, arm.urdf)
    if options.gravity is not None:
        parameters = replace(parameters, gravity=np.array(options.gravity))
    trajectory = load_trajectory(options.trajectory)
    if options.conceal is not None:
        effects += load_concealed(options.conceal, parameters.joints)
    with common.progress(options) as report:
        recording = record(
            parameters,
            trajectory,
            arm,
            options.seed,
            options.noise,
            report,
            effects,
            options.temperature,
            imu_rate_hz=options.base_imu,
            effort_scale=torque_scale(arm) if options.model is None else None,
        )
        origin = common.origin(options, options.model, options.trajectory, options.arm, options.conceal)
        write_recording(options.out, recording, origin)
    if options.json:
        common.print_json({"bag": str(options.out), "samples": len(recording.time), "joints": list(recording.joints)})
    else:
        print(f"{options.out}: {recording.time[-1]:.1f} s, {len(recording.time)} samples")
        print(f"next: spacearm check {options.out}")
    if options.model is None:
        common.note(options, STATED)
    return 0


def model_of(options: argparse.Namespace) -> tuple[IdentifiedModel, Arm]:
    """What the arm obeys, and the arm with its drives.

    Raises:
        UserError: Neither model nor arm is given, or the model has no links.
    """
    if options.model is None:
        if options.arm is None:
            raise UserError("nothing to simulate: name --arm ARM (URDF or arm YAML), --model model.yaml, or both")
        arm = require_open_chain(load_arm(options.arm))
        return default_model(arm), arm
    model = load_model(options.model)
    if not any(isinstance(term, RigidBody) for term in model.model.terms):
        raise UserError(f"{options.model} has no rigid_body term: its links would have no mass; name a complete model")
    return model, model.model.arm if options.arm is None else load_arm(options.arm)


def record(
    parameters: PlantParameters,
    trajectory: Trajectory,
    arm: Arm,
    seed: int,
    noise: float,
    report: common.Report,
    effects: Sequence[Effect] = (),
    temperature: float = 20.0,
    *,
    imu_rate_hz: float = 0.0,
    effort_scale: FloatArray | None = None,
) -> Recording:
    """Simulate one run of an arm under its drives, with `effects` concealed in it, at a `temperature` (°C).

    Args:
        parameters: What the arm obeys.
        trajectory: What it follows.
        arm: Its drives' data.
        seed: Of the sensors' noise.
        noise: Times the default noise; 0: none.
        report: Called with a share done in 0..1 and what is being done.
        effects: Concealed physics.
        temperature: Of the surroundings, °C.
        imu_rate_hz: Of an IMU on the base; 0: none.
        effort_scale: (n,) N·m or N that the noise of torque is a share of; None: the torque limits.

    Raises:
        UserError: The trajectory is not of this arm, or no arm works at such a temperature.
    """
    if trajectory.joints != parameters.joints:
        raise UserError(
            f"the trajectory moves {', '.join(trajectory.joints)}; the arm has {', '.join(parameters.joints)}"
        )
    drives = drives_of(arm)
    truth = simulate_truth(
        parameters,
        trajectory,
        drives=drives,
        thermal=ThermalParameters(drives.copper_loss, ambient=surroundings(temperature)),
        hidden=Concealment(effects) if effects else None,
        progress=lambda share: report(share, "simulating"),
    )
    sensors = SensorNoise.times(noise) if noise else SensorNoise.none()
    return measure(truth, replace(sensors, imu_rate_hz=imu_rate_hz, effort_scale=effort_scale), seed)
