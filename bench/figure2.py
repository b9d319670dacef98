"""The paper's Figure 2 again: nine ways to identify its arm, on its protocol, the same data in the same run.

    python bench/figure2.py [--seeds 20] [--results FILE] [--figure docs/figure2.png]

Protocol (paper §4.2): nominal parameters are Table 1's; each seed perturbs them into actual ones, which make the
torques. What the paper does not say, and ours: every parameter is off by up to 20 % (a link's mass, centre of mass and
inertia about it, so that the actual link exists), a Stribeck velocity by up to a factor of two; the excitation is one
period, 10 s, of a random five-harmonic Fourier trajectory within the arm's limits, sampled at 100 Hz, the validation
another; positions, velocities and accelerations are known exactly, and the torques have white noise of 2 % of their
RMS; the box is the nominal value +- half of it (for one near zero, of what is usual among the joints), for Stribeck
velocities a factor of five. LM and the Kalman filter start from the nominal values.

Two cases: `printed`, with the paper's Stribeck velocities (0.001 to 0.0055 rad/s, of which a 100 Hz recording of such
motion has few samples), and `visible`, the same fifty times larger. Every seed's figures are appended to the results
file as they come, and seeds that are there are not run again. Times are CPU seconds of one thread, everything
included from the samples on. The swarm and the genetic algorithm see the samples through `SwarmCost`, which makes an
evaluation some hundred times cheaper than over the samples; the answers are the same.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from figure2_methods import METHODS, Answer, Problem

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm, load_arm
from spacearm_ident.dynamics.base_parameters import BaseParameters, base_parameters
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.estimate.consistency import link_parameters, pseudo_inertia
from spacearm_ident.excitation.run import limits_of
from spacearm_ident.excitation.trajectory import random_feasible
from spacearm_ident.regression.prior import Prior, make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.motion import Motion
from spacearm_ident.solvers import pso_lm, separable
from spacearm_ident.solvers.pso_lm import as_published

CONFIG = Path(__file__).resolve().parent.parent / "config"
RATE_HZ, PERTURBATION, SPEED_RATIO, NOISE = 100.0, 0.2, 2.0, 0.02
BOX, BOX_RATIO = 0.5, 5.0
WRONG_MINIMUM = 1.01
CASES = {"printed": 1.0, "visible": 50.0}
CLAIMS = (
    ("torque error", "LM", -0.212),
    ("torque error", "PSO", -0.474),
    ("CPU time", "PSO", -0.576),
    ("CPU time", "neural network", -0.86),
)
FIGURES = {
    "torque_Nm": "torque error, N·m",
    "torque_share": "torque error, % of RMS",
    "parameters": "parameter error, %",
    "base": "base parameter error, %",
    "stribeck": "v_b off by a factor",
    "given": "v_b given, %",
    "consistent": "links that can exist, %",
    "seconds": "CPU time, s",
}


class Bench:
    """The paper's arm, and what is the same for all seeds."""

    def __init__(self) -> None:
        self.arm: Arm = load_arm(CONFIG / "paper_arm.yaml")
        self.model = TorqueModel(self.arm, as_published(structure_of(self.arm)))
        known = load_model(CONFIG / "paper_arm_model.yaml")
        self.parameters = np.array([known.value(item.symbol, item.joint) for item in self.model.parameters])
        self.constants = np.array(
            [known.value(item.symbol, item.joint) if item.symbol == "v_b" else 0.0 for item in self.model.constants]
        )
        self.base: BaseParameters = base_parameters(self.model)
        self.limits = limits_of(self.arm, self.arm.joint_names)
        self.size = self._sizes()

    def _sizes(self) -> FloatArray:
        """(p,) what is usual for each parameter: its own value, or a tenth of the largest of its kind."""
        symbols = np.array([item.symbol for item in self.model.parameters])
        kinds = {"mcx": "mc", "mcy": "mc", "mcz": "mc"}
        kind = np.array([kinds.get(symbol, symbol[0] if symbol[0] == "I" else symbol) for symbol in symbols])
        largest = {name: np.abs(self.parameters[kind == name]).max() for name in set(kind)}
        return np.maximum(np.abs(self.parameters), [0.1 * largest[name] for name in kind])

    def actual(self, rng: np.random.Generator, constants: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Perturbed parameters of links that can exist, and constants."""
        factor = 1.0 + PERTURBATION * rng.uniform(-1, 1, len(self.parameters))
        parameters = self.parameters * factor
        for numbers in link_parameters(self.model):
            parameters[numbers] = _perturbed_link(self.parameters[numbers], factor[numbers])
        numbers = {item.name: k for k, item in enumerate(self.model.parameters)}
        for joint in self.arm.joint_names:
            coulomb, static = numbers[f"f_c[{joint}]"], numbers[f"f_b[{joint}]"]
            extra = self.parameters[static] - self.parameters[coulomb]
            parameters[static] = parameters[coulomb] + factor[static] * extra
        return parameters, constants * SPEED_RATIO ** rng.uniform(-1, 1, len(constants))

    def motion(self, seed: int, parameters: FloatArray, constants: FloatArray) -> Motion:
        """One period of a random trajectory, with the torque of these parameters."""
        trajectory = random_feasible(self.arm.joint_names, self.limits, seed=seed)
        moved = trajectory.evaluate(np.arange(0.0, trajectory.period_s, 1.0 / RATE_HZ))
        still = np.zeros(len(self.arm.joints))
        # A cut-off of half the rate is next to none: each row is its sample, half, and a quarter of either neighbour.
        bare = Motion(
            self.arm.joint_names, RATE_HZ, 0.0, *moved, np.zeros_like(moved.q), still, still, cutoff_hz=RATE_HZ / 2
        )
        return replace(bare, torque=self.model.torque(bare, parameters, constants))

    def measured(
        self, seed: int, rng: np.random.Generator, parameters: FloatArray, constants: FloatArray
    ) -> tuple[Motion, FloatArray]:
        """The motion of a seed with noise on its torque, and (n,) the noise's standard deviation, N·m."""
        clean = self.motion(2 * seed + 1, parameters, constants)
        sigma = NOISE * np.sqrt(np.mean(clean.torque**2, axis=0))
        return replace(clean, torque=clean.torque + sigma * rng.standard_normal(clean.torque.shape)), sigma

    def run(self, case: str, seed: int) -> list[dict[str, Any]]:
        """All methods on one seed; a line for each."""
        rng = np.random.default_rng([seed, len(case)])
        nominal = self.constants * CASES[case]
        parameters, constants = self.actual(rng, nominal)
        noisy, sigma = self.measured(seed, rng, parameters, constants)
        unseen = self.motion(2 * seed + 2, parameters, constants)
        lines = []
        for name, method in METHODS.items():
            reach, chance = BOX * self.size, np.random.default_rng(seed)
            problem = Problem(self.model, noisy, self.parameters, nominal, reach, BOX_RATIO, sigma, chance)
            begun = time.process_time()
            try:
                answer = method(problem)
            except ImportError as error:
                print(f"{name} skipped: {error.name} is not installed: pip install spacearm_ident[bench]")
                continue
            seconds = time.process_time() - begun
            figures = self.judge(answer, unseen, parameters, constants)
            lines.append({"case": case, "seed": seed, "method": name, "seconds": seconds, **figures})
        return lines

    def judge(self, answer: Answer, unseen: Motion, parameters: FloatArray, constants: FloatArray) -> dict[str, Any]:
        """Figures of one answer against the truth; the torque's are without noise, on the other trajectory."""
        if answer.predict is not None:
            error = answer.predict(unseen) - unseen.torque
        else:
            error = self.model.torque(unseen, answer.parameters, answer.constants) - unseen.torque
        rms = np.sqrt(np.mean(error**2, axis=0))
        figures: dict[str, Any] = {
            "torque_Nm": float(np.sqrt(np.mean(error**2))),
            "torque_share": float(100 * np.mean(rms / np.sqrt(np.mean(unseen.torque**2, axis=0)))),
            "note": answer.note,
        }
        if answer.parameters is None or answer.constants is None:
            return figures
        off = answer.parameters - parameters
        scale = np.sqrt(self.base.regrouping**2 @ self.size**2)
        searched = constants > 0
        given = answer.constants[searched] > 0
        off_speed = np.log(answer.constants[searched][given] / constants[searched][given])
        links = [pseudo_inertia(answer.parameters[numbers]) for numbers in link_parameters(self.model)]
        return figures | {
            "parameters": float(100 * np.mean(np.abs(off) / self.size)),
            "base": float(100 * np.mean(np.abs(self.base.regrouping @ off) / scale)),
            "stribeck": float(np.exp(np.median(np.abs(off_speed)))) if given.any() else float("nan"),
            "given": float(100 * np.mean(given)),
            "consistent": float(100 * np.mean([np.linalg.eigvalsh(link)[0] > 0 for link in links])),
        }


def _perturbed_link(inertial: FloatArray, factor: FloatArray) -> FloatArray:
    """Mass, centre of mass and inertia about it times factors: an existing link stays one."""
    mass, moment = inertial[0], inertial[1:4]
    centre = moment / mass
    about_centre = _tensor(inertial[4:]) - mass * _steiner(centre)
    mass, centre = mass * factor[0], centre * factor[1:4]
    inertia = factor[4] * about_centre + mass * _steiner(centre)
    return np.array([mass, *(mass * centre), *inertia[(0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]])


def _tensor(six: FloatArray) -> FloatArray:
    xx, xy, yy, xz, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _steiner(centre: FloatArray) -> FloatArray:
    return np.asarray(centre @ centre * np.eye(3) - np.outer(centre, centre))


def medians(lines: list[dict[str, Any]], case: str) -> dict[str, dict[str, float]]:
    """Method -> figure -> median over the seeds."""
    result = {}
    for method in METHODS:
        own = [line for line in lines if line["case"] == case and line["method"] == method]
        if own:
            result[method] = {key: float(np.nanmedian([line[key] for line in own])) for key in FIGURES if key in own[0]}
    return result


def table(lines: list[dict[str, Any]], case: str) -> str:
    """Medians as a Markdown table, then the paper's ratios."""
    rows = medians(lines, case)
    count = len({line["seed"] for line in lines if line["case"] == case})
    words = [f"### {case}: medians over {count} seeds", ""]
    words += ["| method | " + " | ".join(FIGURES.values()) + " |", "|---" * (len(FIGURES) + 1) + "|"]
    for method, figures in rows.items():
        cells = [f"{figures[key]:.3g}" if key in figures else "–" for key in FIGURES]
        words.append(f"| {method} | " + " | ".join(cells) + " |")
    words += [
        "",
        "| PSO-LM against | the paper | here, median of the seeds' ratios | seeds in which it is less |",
        "|---|---|---|---|",
    ]
    for what, other, claim in CLAIMS:
        key = "seconds" if what == "CPU time" else "torque_Nm"
        ratio = _ratios(lines, case, key, other)
        if len(ratio):
            less = f"{np.sum(ratio < 1)} of {len(ratio)}"
            words.append(f"| {what} of {other} | {claim:+.1%} | {np.median(ratio) - 1:+.1%} | {less} |")
    return "\n".join(words)


def _ratios(lines: list[dict[str, Any]], case: str, key: str, other: str) -> FloatArray:
    """(seeds,) PSO-LM's figure over another method's, seed by seed."""

    def of(method: str) -> dict[int, float]:
        return {line["seed"]: line[key] for line in lines if (line["case"], line["method"]) == (case, method)}

    ours, theirs = of("PSO-LM"), of(other)
    return np.array([ours[seed] / theirs[seed] for seed in sorted(ours.keys() & theirs.keys())])


def draw(lines: list[dict[str, Any]], path: Path) -> None:
    """Torque error, base parameter error and time, every seed a dot."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    keys = ("torque_share", "base", "seconds")
    figure, grid = plt.subplots(len(CASES), len(keys), figsize=(11, 5.6), sharey=True, layout="constrained")
    names = list(METHODS)[::-1]
    for row, case in zip(grid, CASES):
        for axes, key in zip(row, keys):
            for place, name in enumerate(names):
                own = [x for x in lines if x["case"] == case and x["method"] == name and key in x]
                values = [line[key] for line in own]
                colour = "#c2410c" if name == "PSO-LM" else "#0f766e" if "ours" in name else "#64748b"
                axes.plot(values, [place] * len(values), "o", color=colour, alpha=0.35, markersize=4)
                if values:
                    axes.plot([np.median(values)], [place], "|", color=colour, markersize=14, markeredgewidth=2)
            axes.set_xscale("log")
            axes.set_yticks(range(len(names)), names)
            axes.grid(axis="x", alpha=0.3)
            axes.set_title(f"{FIGURES[key]} ({case})", fontsize=9)
    figure.savefig(path, dpi=110)


def minima(bench: Bench, seeds: int) -> str:
    """How often PSO-LM in its default, wide box ends above the minimum of its own objective that separable finds."""
    ratios, seconds = [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, len("visible")])
        parameters, constants = bench.actual(rng, bench.constants * CASES["visible"])
        noisy, _ = bench.measured(seed, rng, parameters, constants)
        regression = Regression(bench.model, [noisy])
        prior = make_prior(bench.model, [noisy])
        begun = time.process_time()
        found, _ = pso_lm.solve(regression, prior, seed)
        between = time.process_time()
        known = separable.solve(regression, prior, separable.grid_search(regression, gate=0.0))
        seconds.append((between - begun, time.process_time() - between))
        none = Prior(prior.rows[:0], prior.target[:0], prior.scale, prior.held, prior.free)
        ratios.append(found.cost / separable.solve_linear(regression, none, known.constants)[1])
    above = int(np.sum(np.array(ratios) > WRONG_MINIMUM))
    both = np.median(seconds, axis=0)
    return (
        f"wide box, visible: PSO-LM ended more than {WRONG_MINIMUM - 1:.0%} above the separable solver's minimum of "
        f"the same objective in {above} of {seeds} seeds (median {np.median(ratios):.4g} times, worst "
        f"{max(ratios):.4g}), in {both[0]:.2g} s against {both[1]:.2g} s"
    )


def main() -> None:
    """Run what is missing, print the tables, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    results = Path(tempfile.gettempdir()) / "figure2.jsonl"
    parser.add_argument("--results", type=Path, default=results, help="appended to; what is there is kept")
    parser.add_argument("--figure", type=Path, help="PNG to write")
    options = parser.parse_args()
    lines = [json.loads(text) for text in options.results.read_text().splitlines()] if options.results.exists() else []
    done = {(line["case"], line["seed"]) for line in lines}
    print(f"{options.results}: {len(done)} runs are there already")
    bench = Bench()
    for seed in range(options.seeds):
        for case in CASES:
            if (case, seed) in done:
                continue
            new = bench.run(case, seed)
            lines += new
            with options.results.open("a") as file:
                file.write("".join(json.dumps(line) + "\n" for line in new))
            print(f"{case} {seed}: " + ", ".join(f"{x['method']} {x['torque_Nm']:.3g} N m" for x in new), flush=True)
    print("\n\n".join(table(lines, case) for case in CASES))
    print("\n" + minima(bench, options.seeds))
    if options.figure is not None:
        draw(lines, options.figure)


if __name__ == "__main__":
    main()
