"""Draw a blind series: bags in OUT/bags/NNN, answers in OUT/answers/NNN.json.

python draw.py --seed 1 --count 40 --out DIR
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import laws as laws_
import numpy as np
from arms import ARMS, cad
from calibrate import calibrate
from fit import Fit
from simulate import PERIOD, Run, day, fourier, simulate
from write import write_bag

STRENGTHS = (0.25, 1.0, 2.0, 5.0, 10.0)  #: multiples of the healthy residual
CUBIC = ("tx40", "rail4", "ur10")  #: arms with terms that vanish in vacuum


def composition(count: int, rng: np.random.Generator) -> list[str]:
    """Shuffle 25 % healthy, 50 % one listed effect, 15 % an absent kind, 10 % both."""
    healthy, absent, both = round(0.25 * count), round(0.15 * count), round(0.10 * count)
    kinds = ["healthy"] * healthy + ["absent"] * absent + ["both"] * both
    kinds += ["listed"] * (count - len(kinds))
    return list(rng.permutation(kinds))


def deck(items: list, rng: np.random.Generator):
    """Endless generator over shuffled copies of items: every kind comes before any comes again."""
    while True:
        for k in rng.permutation(len(items)):
            yield items[k]


def trials(count: int, rng: np.random.Generator, *kinds: list) -> Iterator[dict]:
    """Composition, arm, laws and strengths of each trial; `kinds`: listed laws, absent ones, arms."""
    listed, absent, arm, strength = (deck(items, rng) for items in (*kinds, list(STRENGTHS)))
    for k, kind in enumerate(composition(count, rng)):
        trial = {"trial": k, "composition": str(kind), "arm": next(arm), "seed": int(rng.integers(2**31)), "laws": []}
        if kind in ("listed", "both"):
            trial["laws"].append((next(listed), next(strength)))
        if kind in ("absent", "both"):
            trial["laws"].append((next(absent), next(strength)))
        yield trial


def plan(seed: int, count: int) -> list[dict]:
    """What each trial will be; drawn before anything is simulated."""
    rng = np.random.default_rng(seed)
    out = []
    for trial in trials(count, rng, laws_.LISTED, laws_.ABSENT, list(ARMS)):
        for law, _ in trial["laws"]:
            if law is laws_.VacuumFriction and trial["arm"] not in CUBIC:
                trial["arm"] = str(rng.choice(CUBIC))
            if law is laws_.WristCoupling:
                trial["arm"] = "tx40"
        out.append(trial)
    return out


def as_recording(run: Run) -> tuple:
    """Time, position and effort of a run."""
    return run.time, run.position, run.effort


def told(law: laws_.Law, wanted: float, calculated: float, achieved: float) -> dict:
    """A law in an answer; strengths are multiples of the healthy residual."""
    return {
        "name": law.name,
        "listed": law.listed,
        "also": list(law.also),
        "joints": law.joints,
        "strength": wanted,
        "calculated": calculated,
        "achieved": achieved,
        "truth": {k: [float(x), u] for k, (x, u) in law.truth().items()},
    }


def write_answer(out: Path, answer: dict) -> None:
    """Keep the answer of a trial apart from its bags."""
    (out / "answers").mkdir(exist_ok=True)
    (out / "answers" / f"{answer['trial']:03d}.json").write_text(json.dumps(answer, indent=1))


def words(answer: dict) -> str:
    """The laws of a trial in a line."""
    return ", ".join(
        f"{x['name']} at {'/'.join(x['joints'][:2])} x{x['strength']:g} (achieved {x['achieved']:.2f})"
        for x in answer["laws"]
    )


def build(trial: dict, out: Path) -> dict:
    """Simulate and write one trial; returns its answer."""
    rng = np.random.default_rng(trial["seed"])
    arm = ARMS[trial["arm"]]()
    urdf = cad(arm.urdf, rng)
    dirt = laws_.dirt(arm, rng)
    joints = rng.permutation(arm.n)
    laws = [kind(arm, int(joints[k]), rng) for k, (kind, _) in enumerate(trial["laws"])]
    for law in laws:  # an encoder on a rail has no eccentricity
        if isinstance(law, laws_.EncoderEccentricity) and arm.prismatic[law.joint]:
            law.joint = int(np.flatnonzero(~arm.prismatic)[rng.integers((~arm.prismatic).sum())])
    length = [float(rng.uniform(20, 26)) for _ in range(2)]
    motions = [fourier(arm, length[0], rng) for _ in range(3)] + [fourier(arm, length[1], rng) for _ in range(2)]
    warm = next((law for law in laws if isinstance(law, laws_.TemperatureFriction)), None)
    days = [day(arm, rng) for _ in range(3)]
    days += [day(arm, rng, warm.joint if warm else None, 25.0) for _ in range(2)]
    reference = simulate(arm, [(d, np.ones(3, bool)) for d in dirt], motions[:3], days[:3], int(rng.integers(2**31)))
    fit = Fit(arm.model, [as_recording(r) for r in reference])
    thin = slice(None, None, 4)
    q, v, a = (x[thin] for x in motions[3])
    t = np.arange(len(motions[3][0]))[thin] * PERIOD
    motion = (t, q, v, a, np.stack([days[3].at(x) for x in t]))
    strengths = [
        (wanted, calibrate(arm, law, motion, fit.healthy, wanted)) for law, (_, wanted) in zip(laws, trial["laws"])
    ]
    both = np.ones(2, bool)
    seed = int(rng.integers(2**31))
    # a change that upsets the loop would trip the drive of a real arm: it is halved until the loop holds
    halved = 0
    while True:
        try:
            field = simulate(arm, [(d, both) for d in dirt + laws], motions[3:], days[3:], seed)
            break
        except FloatingPointError:
            halved += 1
            if halved == 6:
                raise
            for law in laws:
                law.size /= 2
    folder = out / "bags" / f"{trial['trial']:03d}"
    epoch = 1.75e9 + 86400 * rng.integers(0, 30)
    for name, run in zip(("reference_1", "reference_2", "reference_3", "field", "validation"), reference + field):
        epoch += 86400 * rng.uniform(0.5, 3)
        write_bag(
            folder / f"{name}.mcap",
            urdf,
            arm.joints,
            run.time,
            run.position,
            run.velocity if arm.has_velocity else None,
            run.effort,
            run.temperature if warm else None,
            epoch,
        )
    before, after = fit.healthy, fit.residual(*as_recording(field[0]))
    held = fit.residual(*as_recording(field[1]))
    answer = {
        "trial": trial["trial"],
        "composition": trial["composition"],
        "arm": trial["arm"],
        "seed": trial["seed"],
        "halved": halved,
        "healthy_Nm": before.round(4).tolist(),
        "field_Nm": after.round(4).tolist(),
        "validation_Nm": held.round(4).tolist(),
        "dirt": [[d.name, d.joints, d.size] for d in dirt],
        "laws": [],
    }
    for law, (wanted, reached) in zip(laws, strengths):
        at = [arm.joints.index(j) for j in law.joints]
        seen = float(max(np.sqrt(max(after[j] ** 2 - before[j] ** 2, 0)) / before[j] for j in at))
        drawn = {
            k: (x.tolist() if hasattr(x, "tolist") else x)
            for k, x in vars(law).items()
            if isinstance(x, (int, float, str, np.generic)) and k not in ("size", "n", "dt")
        }
        answer["laws"].append(told(law, wanted, reached, seen) | {"drawn": drawn})
    write_answer(out, answer)
    return answer


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, default=0, help="first trial to build, of the count that is drawn")
    parser.add_argument("--last", type=int, default=None)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for trial in plan(options.seed, options.count)[options.first : options.last]:
        if (options.out / "answers" / f"{trial['trial']:03d}.json").exists():
            continue
        start = time.time()
        try:
            answer = build(trial, options.out)
        except FloatingPointError as error:
            print(f"{trial['trial']:03d} not drawn: {error}", flush=True)
            continue
        names, took = words(answer), time.time() - start
        print(f"{trial['trial']:03d} {trial['composition']:8s} {trial['arm']:6s} {names}  [{took:.0f} s]", flush=True)


if __name__ == "__main__":
    main()
