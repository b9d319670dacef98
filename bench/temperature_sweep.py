"""The alpha calibration on the live chain, a sweep over ambient temperatures: alpha found beside alpha planted.

    python bench/temperature_sweep.py [--out DIR] [--temperatures -20 20 60] [--repeats 3]

What an engineer with a climate chamber does, with the simulated arm in it. One trajectory from `spacearm excite --for
temperature`; at each temperature all nodes are started anew (the arm's housings have that temperature then), the run is
made over CAN and DDS and recorded; `spacearm calibrate-temperature` takes the bags. Its numbers are held against the
slopes planted by `config/paper_arm_warmth.yaml`. A run is 200 s; `--repeats 1` goes through the speeds once, in 67 s.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from fault_chain import BreakableChain, newest_bag

from spacearm_ident.cli.demo import ARM, ATTEMPTS, Plan, go_through, node_parameters
from spacearm_ident.cli.main import main as spacearm
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.excitation import composite
from spacearm_ident.excitation.trajectory_file import load_trajectory

TEMPERATURES = (-20.0, 20.0, 60.0)
MODEL, WARMTH = "paper_arm_model.yaml", "paper_arm_warmth.yaml"
CLEAR = 3.0
"""Standard errors that an alpha may be off."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep trajectory, bags and result here")
    parser.add_argument(
        "--temperatures", type=float, nargs="+", metavar="C", default=TEMPERATURES, help="degC (default -20 20 60)"
    )
    parser.add_argument("--repeats", type=int, default=composite.TEMPERATURE_REPEATS, help="of all speeds in a run")
    options = parser.parse_args()
    composite.TEMPERATURE_REPEATS = options.repeats
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / "temperature.yaml"
        run("excite", "--for", "temperature", "--arm", config_path(ARM), "--model", config_path(MODEL), "--out", file)
        bags = [record(folder / f"at_{celsius:g}", file, celsius) for celsius in options.temperatures]
        run("calibrate-temperature", *bags, "--out", folder / "alpha")
        good = judge(folder / "alpha" / "temperature.json")
    print("all reached" if good else "NOT all reached")
    return 0 if good else 1


def run(*words: object) -> None:
    """A command as on a terminal, which shows it."""
    print("$ spacearm", *words, flush=True)
    if code := spacearm([*map(str, words), "--quiet"]):
        raise SystemExit(code)


def record(folder: Path, file: Path, celsius: float) -> Path:
    """The run at one temperature on the live chain; returns its bag."""
    parameters = node_parameters(folder)
    parameters["simulated_arm"] = {
        "ambient_temperature": celsius,
        "conceal": str(config_path(WARMTH)),
        "seed": round(celsius) + 300,
    }
    parameters["identifier"] |= {"auto_identify": False, "tracking": False}
    plan = Plan(f"{celsius:g} degC", 0, 1, 1.0 / load_trajectory(file).duration_s)
    # One that is patient with nodes that come up slowly on a busy machine.
    with BreakableChain(folder, parameters) as chain:
        chain.serve()
        travel(chain, plan, file)
        samples = chain.values("recorder: topics")["/joint_states"]
        print(f"{plan.name}: {chain.call('/recorder/stop')}; /joint_states: {samples}", flush=True)
        chain.call("/driver/enable", False)
    return newest_bag(folder)


def travel(chain: BreakableChain, plan: Plan, file: Path) -> None:
    """Go through the run, and begin again where a busy machine cannot even enable the drives after a stop."""
    for _ in range(ATTEMPTS):
        try:
            return go_through(chain, plan, file, lambda *_: None)
        except UserError as stopped:
            print(f"{plan.name}: {stopped}: beginning again", file=sys.stderr, flush=True)
            chain.serve()
    raise SystemExit(f"{plan.name}: no run came through: is this machine too busy?")


def judge(path: Path) -> bool:
    """Alpha found beside alpha planted; whether all are within `CLEAR` standard errors."""
    joints = json.loads(path.read_text(encoding="utf-8"))["joints"]
    model = load_model(config_path(MODEL))
    (effect,) = yaml.safe_load(config_path(WARMTH).read_text(encoding="utf-8"))["effects"]
    slopes = dict(zip(model.model.arm.joint_names, effect["parameters"]["coulomb_slope"], strict=True))
    print(f"{'joint':<10}{'planted N m/K':>14}{'found':>10}{'± error':>10}{'apart':>7}{'f_c0 N m':>10}{'planted':>9}")
    apart = []
    for joint, slope in slopes.items():
        level = model.value("f_c", joint)
        if joint not in joints:
            print(f"{joint:<10}{slope * level:>14.4f}   not fitted")
            apart.append(np.inf)
            continue
        found = joints[joint]["alpha"]
        apart.append((found["value"] - slope * level) / found["standard_error"])
        print(
            f"{joint:<10}{slope * level:>14.4f}{found['value']:>10.4f}{found['standard_error']:>10.4f}"
            f"{apart[-1]:>+7.1f}{joints[joint]['f_c0_Nm']:>10.3f}{level:>9.3f}"
        )
    return bool(np.all(np.abs(apart) < CLEAR))


if __name__ == "__main__":
    sys.exit(main())
