"""Whether 95 % intervals from seconds of data hold 95 %, through the whole chain, on seeded repeats.

    python bench/coverage.py [--of update adaptation] [--runs 20] [--repeats 4] [--cache DIR]

update: the paper's arm, simulated on the ground for 3 periods of 10 s and identified (fresh noise every time), is the
prior of 5 s in zero gravity (and, of other runs, of 500 samples at 250 Hz), under friction that was drawn from what
the prior allows; `--runs` motions and draws, `--repeats` noise seeds each.
adaptation: the runs of `spacearm demo --orbit`, measured with `--repeats` noise seeds; what changed since the ground.
Simulated motions are kept in DIR. Runs of one motion share what that motion hides, so the interval printed counts them
by motion (bootstrap), not by value.
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_simulated_arm import fingerprint

from spacearm_ident.bayes.adaptation import adapt
from spacearm_ident.bayes.from_prior import CHANGES, GroundPrior
from spacearm_ident.bayes.updated import identify_from_prior
from spacearm_ident.cli.demo_orbit import RUNS, WEIGHTLESS, Run
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import Arm, load_arm
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.estimate.identified import Determination
from spacearm_ident.excitation.run import limits_of
from spacearm_ident.excitation.trajectory import random_feasible
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import Recording
from spacearm_ident.simulation.closed_loop import SensorNoise, Truth, measure, simulate_truth
from spacearm_ident.simulation.concealed import Concealment, load_concealed
from spacearm_ident.simulation.concealed.from_model import simulated_arm
from spacearm_ident.simulation.own_arm import drives_of
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.thermal import ThermalParameters

FIRST_SEED = 100
"""Of the update's motions: none of the demo's."""
SECONDS, LEAN_SAMPLES, LEAN_HZ = 5.0, 500, 250.0
LARGEST_DRAW = 3.0
"""Standard deviations: friction stays above zero."""
NORMAL = 1.959964
Score = tuple[int, str, float, float]
"""Motion, name, error in standard errors, half width of the interval in standard errors."""


@dataclass(frozen=True)
class Workshop:
    """The arm, and a folder of what was simulated of it."""

    arm: Arm
    plant: PlantParameters
    cache: Path

    def truth(self, one: Run, plant: PlantParameters, hidden: str | None = None, seconds: float | None = None) -> Truth:
        """What a run is without noise; simulated once."""
        path = self.cache / f"{one.name}_{fingerprint()}.pkl"
        if path.exists():
            return pickle.loads(path.read_bytes())
        limits = limits_of(self.arm, self.arm.joint_names)
        trajectory = random_feasible(
            self.arm.joint_names, limits, seed=one.seed, fundamental_hz=one.fundamental_hz, periods=one.periods
        ).run(limits)
        drives = drives_of(self.arm)
        effects = load_concealed(config_path(hidden), self.arm.joint_names) if hidden else None
        truth = simulate_truth(
            replace(plant, gravity=WEIGHTLESS) if one.orbit else plant,
            trajectory if seconds is None else Cut(trajectory, seconds),
            drives=drives,
            thermal=ThermalParameters(drives.copper_loss, ambient=one.temperature),
            hidden=Concealment(effects) if effects else None,
        )
        self.cache.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(truth))
        print(f"simulated {one.name}", flush=True)
        return truth


class Cut:
    """The first seconds of a trajectory."""

    def __init__(self, trajectory, seconds: float) -> None:
        self.joints, self.duration_s = trajectory.joints, seconds
        self.evaluate = trajectory.evaluate


def thinned(recording: Recording, samples: int, rate_hz: float) -> Recording:
    """The last samples at a lower rate, as from a slow bus."""
    step = round(recording.rate_hz / rate_hz)
    part = slice(len(recording.time) - step * samples, None, step)
    return replace(
        recording,
        time=recording.time[part],
        position=recording.position[part],
        velocity=None,
        effort=recording.effort[part],
        segments=(slice(0, samples),),
        command=None,
    )


def drawn(plant: PlantParameters, seed: int) -> PlantParameters:
    """Friction as it may have changed on the way up."""
    rng = np.random.default_rng([seed, 5])

    def change(values: np.ndarray, symbol: str) -> np.ndarray:
        return values * (1.0 + CHANGES[symbol] * np.clip(rng.standard_normal(6), -LARGEST_DRAW, LARGEST_DRAW))

    f_c = change(plant.f_c, "f_c")
    return replace(
        plant,
        f_c=f_c,
        f_b=f_c + change(plant.f_b - plant.f_c, "f_b"),
        k_v1=change(plant.k_v1, "k_v1"),
        k_v2=change(plant.k_v2, "k_v2"),
        k_v3=change(plant.k_v3, "k_v3"),
    )


def known(plant: PlantParameters) -> dict[str, float]:
    """True values by name."""
    model = load_model(config_path("paper_arm_model.yaml"))
    names = {p.name: v for p, v in zip(model.model.parameters, model.parameters)}
    for symbol in ("f_c", "f_b", "k_v1", "k_v2", "k_v3"):
        names |= {f"{symbol}[{joint}]": float(v) for joint, v in zip(plant.joints, getattr(plant, symbol))}
    return names


def update(shop: Workshop, runs: int, repeats: int) -> dict[str, list[Score]]:
    """A ground model updated by five seconds, or by 500 samples."""
    (first,) = RUNS["ground"]
    below = shop.truth(first, shop.plant)
    found = defaultdict(list)
    for number in range(runs):
        plant = drawn(shop.plant, number)
        above = shop.truth(Run(f"update_{number}", FIRST_SEED + number, 1, 20.0), plant, seconds=6.0)
        values = known(plant)
        for seed in range(number * repeats, (number + 1) * repeats):
            ground = identify([measure(below, SensorNoise(), 10_000 + seed)], shop.arm)
            prior = GroundPrior.of(ground).under(WEIGHTLESS)
            bag = measure(above, SensorNoise(), 20_000 + seed)
            for name, part in (
                ("5 s", bag.between(1.0, 1.0 + SECONDS)),
                ("500 samples", thinned(bag, LEAN_SAMPLES, LEAN_HZ)),
            ):
                result = identify_from_prior([part], prior)
                _score(found, name, number, result, values)
    return found


def _score(found, kind: str, number: int, result, values: dict[str, float]) -> None:
    for estimate in result.estimates:
        if not estimate.standard_error > 0 or estimate.name not in values:
            continue
        z = (estimate.value - values[estimate.name]) / estimate.standard_error
        entry = (number, estimate.name, z, estimate.factor)
        friction = estimate.symbol in CHANGES
        if friction:
            found[f"{kind}: friction"].append(entry)
        if estimate.determination is Determination.DATA:
            found[f"{kind}: determined by the data"].append(entry)
    truth = np.array([values.get(p.name, 0.0) for p in result.model.model.parameters])
    off = result.base_values - result.base.regrouping @ truth
    for k in np.flatnonzero(result.base_errors > 0):
        found[f"{kind}: base parameters"].append((number, result.base.names[k], off[k] / result.base_errors[k], NORMAL))


def adaptation(shop: Workshop, repeats: int) -> dict[str, list[Score]]:
    """The demo's runs, adapted to."""
    below = [shop.truth(one, shop.plant, "paper_arm_warmth.yaml") for one in RUNS["ground"]]
    above = [shop.truth(one, shop.plant, "paper_arm_orbit.yaml") for one in RUNS["orbit"]]
    warmth, _, level = load_concealed(config_path("paper_arm_orbit.yaml"), shop.arm.joint_names)
    planted = {"f_c": level.values["coulomb"], "k_v2": -shop.plant.k_v2, "k_v3": -shop.plant.k_v3}
    planted |= {"k_v1": np.zeros(6), "alpha_v": np.zeros(6)}
    planted["alpha_c"] = warmth.values["coulomb_slope"] * shop.plant.f_c
    found = defaultdict(list)
    for seed in range(repeats):
        ground = identify([measure(truth, SensorNoise(), 3000 + seed) for truth in below], shop.arm)
        bags = [measure(truth, SensorNoise(), 4000 + 10 * seed + k) for k, truth in enumerate(above)]
        result = adapt(GroundPrior.of(ground), bags, WEIGHTLESS)
        for change in result.changes:
            joint = shop.arm.joint_names.index(change.joint)
            z = (change.change - float(planted[change.symbol][joint])) / change.change_error
            entry = (seed, f"{change.symbol}[{change.joint}]", z, NORMAL)
            found["adaptation: all changes"].append(entry)
            found[f"adaptation: {change.symbol}"].append(entry)
    return found


def line(name: str, scores: list[Score]) -> str:
    """Coverage with a 95 % interval that takes a motion, or a noise seed, as one draw."""
    groups = defaultdict(list)
    for number, _, z, factor in scores:
        groups[number].append(abs(z) <= factor)
    held, count = (np.array([f(g) for g in groups.values()], dtype=float) for f in (sum, len))
    pick = np.random.default_rng(0).integers(0, len(held), (2000, len(held)))
    low, high = np.quantile(held[pick].sum(1) / count[pick].sum(1), (0.025, 0.975))
    rms = float(np.sqrt(np.mean([z**2 for *_, z, _ in scores])))
    share = held.sum() / count.sum()
    return f"{name:<42}{share:>7.1%}  ({low:.1%} to {high:.1%})  {int(held.sum())} of {len(scores)}   RMS z {rms:.2f}"


def worst(scores: list[Score], shown: int = 6) -> list[str]:
    """Values that are farthest off: mean and spread of z."""
    by_name = defaultdict(list)
    for _, name, z, _ in scores:
        by_name[name].append(z)
    ordered = sorted(by_name.items(), key=lambda item: -float(np.mean(np.square(item[1]))))[:shown]
    return [f"    {name:<20} mean z {np.mean(z):+.2f}  spread {np.std(z):.2f}  of {len(z)}" for name, z in ordered]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    jobs: dict[str, Callable[[Workshop, argparse.Namespace], dict[str, list[Score]]]] = {
        "update": lambda shop, options: update(shop, options.runs, options.repeats),
        "adaptation": lambda shop, options: adaptation(shop, options.repeats),
    }
    parser.add_argument("--of", nargs="+", choices=jobs, default=list(jobs), help="which (default: both)")
    parser.add_argument("--runs", type=int, default=20, help="motions of the update (default 20)")
    parser.add_argument("--repeats", type=int, default=4, help="noise seeds, of a motion or of all runs (default 4)")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep simulated motions here")
    options = parser.parse_args()
    arm = load_arm(config_path("paper_arm.yaml"))
    plant, _ = simulated_arm(load_model(config_path("paper_arm_model.yaml")), arm.urdf)
    with tempfile.TemporaryDirectory() as scratch:
        shop = Workshop(arm, plant, options.cache or Path(scratch))
        for name in options.of:
            for kind, scores in jobs[name](shop, options).items():
                print(line(kind, scores))
                print(*worst(scores), sep="\n", flush=True)


if __name__ == "__main__":
    main()
