"""The paper's arm, simulated: how long identification takes, and whether its standard errors keep their promise.

    python bench/bench_simulated_arm.py [--repeats 20] [--trajectory-seeds 1 2] [--cache DIR]

60,000 samples of 6 joints a trajectory, simulated once (kept in DIR) and measured with seeded noise `--repeats`
times. Counted are the (parameter, seed) pairs that an identification calls determined by the data, and how many of
them lie within three standard errors of the truth. `--fundamental-hz` below 1/60 leaves no period to average over.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import Arm, load_arm
from spacearm_ident.dynamics.model_file import load_model, model_to_dict
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.excitation import trajectory
from spacearm_ident.excitation.run import limits_of
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import read_recording, write_recording
from spacearm_ident.simulation import closed_loop
from spacearm_ident.simulation.closed_loop import SensorNoise, Truth, measure, simulate_truth
from spacearm_ident.simulation.own_arm import drives_of
from spacearm_ident.simulation.parameters import PlantParameters

SAMPLES = 60_000
RATE_HZ = 1000.0
HIGHEST_HZ = 0.5
"""Highest harmonic of the motion."""
FAMILIES = {
    "inertia": ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"),
    "first moment": ("mcx", "mcy", "mcz", "m"),
    "rotor J_m": ("J_m",),
    "spring k_1": ("k_1",),
    "Coulomb f_c": ("f_c",),
    "static f_b, v_b, d_s": ("f_b", "v_b", "d_s"),
    "viscous k_v": ("k_v1", "k_v2", "k_v3", "k_v2_odd"),
    "other": (),
}


def fingerprint() -> str:
    """Changes with all that a simulated motion depends on."""
    folders = [Path(module.__file__).parent for module in (closed_loop, trajectory)]
    files = [config_path("paper_arm_model.yaml"), config_path("paper_arm.yaml"), config_path("paper_arm.urdf")]
    files += [path for folder in folders for path in sorted(folder.glob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def simulate(arm: Arm, seed: int, fundamental_hz: float, cache: Path) -> Truth:
    model = config_path("paper_arm_model.yaml")
    path = cache / f"truth_{seed}_{fundamental_hz:g}Hz_{fingerprint()}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())
    limits = limits_of(arm, arm.joint_names)
    periods = max(1, int(SAMPLES / RATE_HZ * fundamental_hz))
    fourier = trajectory.random_feasible(
        arm.joint_names,
        limits,
        seed=seed,
        fundamental_hz=fundamental_hz,
        harmonics=max(5, round(HIGHEST_HZ / fundamental_hz)),
        periods=periods,
    )
    start = time.perf_counter()
    plant = PlantParameters.from_model(model_to_dict(load_model(model)), arm.urdf)
    truth = simulate_truth(plant, fourier.run(limits), rate_hz=RATE_HZ, drives=drives_of(arm))
    print(f"simulated trajectory {seed}: {len(truth.time)} samples in {time.perf_counter() - start:.0f} s", flush=True)
    cache.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(truth))
    return truth


def scores(result: Identified, truth: dict[str, float]) -> list[tuple[str, str, float]]:
    """(symbol, name, error in standard errors) of every estimate that the data determine."""
    return [
        (estimate.symbol, estimate.name, (estimate.value - truth.get(estimate.name, 0.0)) / estimate.standard_error)
        for estimate in result.estimates
        if estimate.identifiable
    ]


def base_scores(result: Identified, truth: dict[str, float]) -> np.ndarray:
    """Errors of the base parameters, in standard errors; those that no data moved are left out."""
    values = np.array([truth.get(parameter.name, 0.0) for parameter in result.model.model.parameters])
    known = result.base_errors > 0
    return ((result.base_values - result.base.regrouping @ values)[known]) / result.base_errors[known]


def share(name: str, z: np.ndarray, bound: float) -> str:
    inside = int(np.sum(np.abs(z) <= bound))
    interval = binomtest(inside, len(z)).proportion_ci()
    return f"{name:38} {inside / len(z):7.2%}   {inside} of {len(z)} (95 %: {interval.low:.2%} to {interval.high:.2%})"


def family(symbol: str) -> str:
    return next((name for name, symbols in FAMILIES.items() if symbol in symbols), "other")


def report(seed: int, found: list[tuple[str, str, float]], base: np.ndarray) -> None:
    z = np.array([score for *_, score in found])
    by_family, by_name = defaultdict(list), defaultdict(list)
    for symbol, name, score in found:
        by_family[family(symbol)].append(score)
        by_name[name].append(score)
    print(f"trajectory {seed}")
    print(share("  within three standard errors", z, 3.0))
    print(share("  inside their 95 % interval", z, 1.959964))
    print(share("  base parameters within three", base, 3.0))
    for name in FAMILIES:
        if name in by_family:
            scored = np.array(by_family[name])
            print(
                f"    {name:22} rms z {np.sqrt(np.mean(scored**2)):5.2f}   median |z| {np.median(np.abs(scored)):4.2f} "
                f"(right: 0.67)   outside three: {np.sum(np.abs(scored) > 3)} of {len(scored)}"
            )
    worst = sorted(by_name.items(), key=lambda item: -np.sum(np.abs(item[1]) > 3))[:8]
    for name, scored in worst:
        if np.any(np.abs(scored) > 3):
            print(
                f"    {name:22} mean z {np.mean(scored):+5.2f}   spread {np.std(scored):5.2f}   "
                f"outside three: {np.sum(np.abs(scored) > 3)} of {len(scored)}"
            )


def run(options: argparse.Namespace, cache: Path) -> None:
    arm = load_arm(config_path("paper_arm.yaml"))
    model = load_model(config_path("paper_arm_model.yaml"))
    truth = {p.name: v for p, v in zip(model.model.parameters, model.parameters)}
    truth |= {c.name: v for c, v in zip(model.model.constants, model.constants)}
    reading, identifying, everything, every_base = [], [], [], []
    for number in options.trajectory_seeds:
        motion = simulate(arm, number, options.fundamental_hz, cache)
        found, base = [], []
        for seed in range(options.repeats):
            recording = measure(motion, SensorNoise(), seed).between(0.0, SAMPLES / RATE_HZ)
            with tempfile.TemporaryDirectory() as scratch:
                write_recording(Path(scratch) / "run.mcap", recording)
                start = time.perf_counter()
                recording = read_recording(Path(scratch) / "run.mcap")
                read = time.perf_counter()
            reading.append(read - start)
            start = time.perf_counter()
            result = identify([recording], arm)
            identifying.append(time.perf_counter() - start)
            found += scores(result, truth)
            base.append(base_scores(result, truth))
        report(number, found, np.concatenate(base))
        everything += [score for *_, score in found]
        every_base.append(np.concatenate(base))
    print(f"all: {len(recording.time)} samples of {len(arm.joints)} joints, {len(identifying)} identifications")
    print(share("  within three standard errors", np.array(everything), 3.0))
    print(share("  inside their 95 % interval", np.array(everything), 1.959964))
    print(share("  base parameters within three", np.concatenate(every_base), 3.0))
    ratio = float(np.median(np.array(identifying) / np.array(reading)))
    print(
        f"  reading {np.median(reading):.3f} s, identification {np.median(identifying):.3f} s "
        f"(fastest {min(identifying):.3f} s), {ratio:.1f} times as long as reading"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=20, help="noise seeds a trajectory (default 20)")
    parser.add_argument("--trajectory-seeds", type=int, nargs="+", default=[1, 2], metavar="SEED")
    parser.add_argument("--fundamental-hz", type=float, default=0.1, metavar="HZ", help="1/period (default 0.1)")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep simulated motions here")
    options = parser.parse_args()
    if options.cache is not None:
        run(options, options.cache)
        return
    with tempfile.TemporaryDirectory() as scratch:
        run(options, Path(scratch))


if __name__ == "__main__":
    main()
