"""`spacearm demo --orbit`: an arm commissioned on the ground, then in zero gravity, vacuum, heat and cold."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..bayes.adaptation_causes import causes, reason, with_error
from ..config import config_path
from ..dynamics.arm import Arm, load_arm
from ..dynamics.model_file import load_model
from ..errors import UnfitDataError
from ..excitation.run import limits_of
from ..excitation.trajectory import random_feasible
from ..excitation.trajectory_file import save_trajectory
from ..recording import Recording, read_recording, write_recording
from ..sessions.orbit import OrbitSession, orbit_session
from ..simulation.concealed import load_concealed
from ..simulation.concealed.from_model import simulated_arm
from . import common
from .simulate import record

ARM, MODEL = "paper_arm.yaml", "paper_arm_model.yaml"
OUT = Path("demo_orbit")
WEIGHTLESS = np.zeros(3)
SIMULATED_SHARE = 0.85
"""Of the whole time; the rest identifies, adapts and writes."""


@dataclass(frozen=True)
class Run:
    """One simulated run: a random excitation at a temperature (°C), on the ground or in orbit."""

    name: str
    seed: int
    periods: int
    temperature: float
    orbit: bool = True
    fundamental_hz: float = 0.1


def over_an_orbit(phase: float) -> float:
    """Temperature of the joints, °C: -40 in the middle of the shadow (phase 0), +60 in the sun (0.5)."""
    return round(10.0 - 50.0 * float(np.cos(2 * np.pi * phase)), 1)


RUNS = {
    "ground": (Run("ground", 1, 3, 20.0, orbit=False),),
    "ground_unseen": (Run("ground_unseen", 2, 2, 20.0, orbit=False),),
    "orbit": tuple(Run(f"orbit_{k + 1}", 3 + k, 1, over_an_orbit(k / 6)) for k in range(6)),
    "orbit_unseen": tuple(Run(f"orbit_unseen_{k + 1}", 21 + k, 1, over_an_orbit((4 * k + 1) / 12)) for k in range(2)),
}
"""What is identified from, judged on, adapted to and judged on."""


def run(options: argparse.Namespace) -> int:
    """Simulate, identify, adapt, judge.

    Raises:
        UnfitDataError: The adapted model is not good enough; the message says where.
    """
    out = options.out
    arm = load_arm(config_path(ARM))
    with common.progress(options) as report:
        bags = record_runs(out, arm, common.within(report, 0.0, SIMULATED_SHARE))
        session = orbit_session(
            (bags["ground"], bags["ground_unseen"]),
            (bags["orbit"], bags["orbit_unseen"]),
            arm,
            WEIGHTLESS,
            out,
            command=getattr(options, "command_line", None),
            progress=common.within(report, SIMULATED_SHARE, 1.0),
        )
    print(summary(session))
    if session.shortfall:
        raise UnfitDataError(f"{session.shortfall}; see {session.page}")
    return 0


def record_runs(out: Path, arm: Arm, report: common.Report) -> dict[str, list[Recording]]:
    """Simulate every run of `RUNS` to `out`/recordings, with its trajectory beside it, and read it back.

    Args:
        out: Folder of the demo; `recordings` below it is made where it does not exist.
        arm: Description of the simulated arm: limits, drive data and URDF.
        report: Called with a share done in 0..1 and what is being done.

    Returns:
        Group of `RUNS` -> its recordings, as read back from the bags.

    Raises:
        UserError: A bag or a trajectory cannot be written.
    """
    folder = out / "recordings"
    folder.mkdir(parents=True, exist_ok=True)
    total, done = sum(map(len, RUNS.values())), 0
    bags: dict[str, list[Recording]] = {}
    for group, runs in RUNS.items():
        for one in runs:
            path = folder / f"{one.name}.mcap"
            part = common.within(report, done / total, (done + 1) / total)
            write_recording(path, simulate(one, arm, folder / f"{one.name}.yaml", part))
            bags.setdefault(group, []).append(read_recording(path))
            done += 1
    return bags


def simulate(one: Run, arm: Arm, file: Path, report: common.Report) -> Recording:
    """One run, by the code of `spacearm simulate`; its trajectory is saved as `file`.

    Args:
        one: The run: excitation, temperature, °C, and whether it is in orbit.
        arm: Description of the simulated arm: limits, drive data and URDF.
        file: Where the trajectory is saved.
        report: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: The trajectory cannot be written, or the arm does not work at the temperature.
    """
    limits = limits_of(arm, arm.joint_names)
    series = random_feasible(
        arm.joint_names, limits, seed=one.seed, fundamental_hz=one.fundamental_hz, periods=one.periods
    )
    trajectory = series.run(limits)
    save_trajectory(trajectory, file)
    parameters, _ = simulated_arm(load_model(config_path(MODEL)), arm.urdf)
    if one.orbit:
        parameters = replace(parameters, gravity=WEIGHTLESS)
    hidden = load_concealed(config_path(f"paper_arm_{'orbit' if one.orbit else 'warmth'}.yaml"), arm.joint_names)
    what = f"{one.name} at {one.temperature:g} °C"
    return record(
        parameters,
        trajectory,
        arm,
        one.seed,
        1.0,
        lambda share, _: report(share, what),
        hidden,
        one.temperature,
    )


def summary(session: OrbitSession) -> str:
    """The result on a terminal."""
    adaptation = session.adaptation
    columns = (session.ground, session.unadapted, session.weightless, session.adapted)
    heads = ("on the ground", "orbit, as is", "gravity set", "adapted")
    lines = [
        "R over all samples (moving ones) on held-out runs:",
        f"{'joint':<10}" + "".join(f"{head:>18}" for head in heads) + f"{'residual moving':>24}",
    ]
    for joint in session.ground.joints:
        figures = [column.joints[joint] for column in columns]
        r = "".join(f"{f'{x.everything.correlation:.4f} ({x.moving.correlation:.4f})':>18}" for x in figures)
        shares = " > ".join(f"{x.moving.relative_rms:.1%}" for x in figures[1:])
        lines.append(f"{joint:<10}{r}{shares:>24}")
    lines += ["", f"{'moved':<24}{'ground':>10}{'orbit':>10}{'change':>22}{'':>2}why"]
    for change in adaptation.changes:
        if change.moved:
            name = f"{change.symbol}[{change.joint}]"
            moved = with_error(change.change, change.change_error, "+")
            why = reason(adaptation, change)
            lines.append(f"{name:<24}{change.before:>10.4f}{change.after:>10.4f}{moved:>22}  {why}")
    said = {True: "yes", False: "no", None: "not determined"}
    lines += ["", *(f"{cause.name}: {said[cause.found]}; {cause.why}" for cause in causes(adaptation))]
    lines.append(f"report: {session.page}")
    return "\n".join(lines)
