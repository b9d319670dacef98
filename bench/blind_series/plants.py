"""The same laws planted into the torque of real healthy recordings.

    python plants.py --recordings FOLDER --seed 1 --count 16 --out DIR

FOLDER holds one folder an arm (arm.urdf and recordings). The reference recordings are linked to, untouched; the
field and validation recordings are written anew in DIR with the planted torque. The motion is the recorded one,
so only laws that are a torque given the motion, or a change of the logged torque, can be planted. `run.py` and
`score.py` take DIR as they take a draw.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace

import laws as laws_
import numpy as np
import pinocchio as pin
from arms import strip
from calibrate import nominal, reach, walk
from draw import told, trials, words, write_answer
from fit import Fit, rms, smooth
from write import read_bag, write_bag

#: reference recordings, field, validation (None: the program holds out a part of the field) of one healthy arm each
SETS = {
    "airbot": (["run_1"], "run_2", "run_3"),
    "panda": (["run_1"], "run_2", None),
    "rokae": (["run_1"], "run_2", None),
    "ur10e": (["commissioning"], "commissioning_2", "commissioning_validation"),
}
LISTED = [k for k in laws_.LISTED if k.plantable]
ABSENT = [
    k
    for k in laws_.ABSENT
    if k in (laws_.BoucWen, laws_.Slosh, laws_.EddySector, laws_.Bumper, laws_.LooseBolt, laws_.Vibration)
]


def real_arm(urdf: str, bags: list[dict]) -> tuple[SimpleNamespace, Fit]:
    """What laws need of an arm (joint levels from a textbook fit of the reference), and the fit."""
    model = pin.buildModelFromXML(strip(urdf))
    order = [list(model.names)[1:].index(j) for j in bags[0]["joints"]]
    if order != sorted(order):
        raise ValueError("joints of the recording are not in the order of the URDF")
    fit = Fit(model, [(b["time"], b["position"], b["effort"]) for b in bags])
    n = model.nv
    tail = fit.x[10 * n :].reshape(n, 4)
    _, q, v, a, _ = smooth(bags[0]["time"], bags[0]["position"], bags[0]["effort"])
    level = np.maximum(np.abs(tail[:, 2]), fit.healthy)
    return SimpleNamespace(
        n=n,
        model=model,
        joints=list(bags[0]["joints"]),
        rotor=np.maximum(np.abs(tail[:, 0]), 1e-3),
        coulomb=level,
        viscous=np.maximum(np.abs(tail[:, 1]), level / np.abs(v).max(0)),
        speed=np.abs(v).max(0),
        acceleration=np.abs(a).max(0),
        middle=(q.max(0) + q.min(0)) / 2,
        span=(q.max(0) - q.min(0)) / 2,
        presliding=np.full(n, 1e-3),
        gear=np.full(n, 100.0),
        prismatic=np.zeros(n, bool),
        square=np.zeros(n),
        cubic=np.zeros(n),
    ), fit


def planted(arm: SimpleNamespace, law: laws_.Law, bag: dict) -> np.ndarray:
    """The effort (T, n) that a recording would hold with the law, its motion unchanged."""
    effort = bag["effort"].copy()
    t, q, v, a, tau = smooth(bag["time"], bag["position"], effort, rate=250.0)
    load = tau - arm.coulomb * np.tanh(v / (0.02 * arm.speed)) - arm.viscous * v
    zero = 0 * arm.rotor
    if type(law).log is not laws_.Law.log:
        law.log(effort, float(np.median(np.diff(bag["time"]))))
        return effort
    if hasattr(law, "inverse"):
        effort[:, law.joint] = law.inverse(effort[:, law.joint])
        return effort
    if type(law).model is not laws_.Law.model:
        other = arm.model.copy()
        law.model(other)
        delta = nominal(other, zero, q, v, a) - nominal(arm.model, zero, q, v, a)
    else:
        delta = -walk(arm, law, t, q, v, a, load, np.full_like(q, 20.0))
    for j in range(arm.n):
        effort[:, j] += np.interp(bag["time"], t, delta[:, j])
    return effort


def build(trial: dict, recordings: Path, out: Path) -> dict:
    """Plant and write one trial; returns its answer."""
    rng = np.random.default_rng(trial["seed"])
    folder = recordings / trial["arm"]
    references, field, held = SETS[trial["arm"]]
    healthy = [read_bag(folder / f"{name}.mcap") for name in references]
    arm, fit = real_arm(healthy[0]["urdf"], healthy)
    joints = rng.permutation(arm.n)
    laws = [kind(arm, int(joints[k]), rng) for k, (kind, _) in enumerate(trial["laws"])]
    target = out / "bags" / f"{trial['trial']:03d}"
    target.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(references, 1):
        link = target / f"reference_{k}.mcap"
        link.unlink(missing_ok=True)
        link.symlink_to((folder / f"{name}.mcap").resolve())
    reached: list[float] = []
    for role, name in (("field", field), ("validation", held)):
        if name is None:
            continue
        bag = read_bag(folder / f"{name}.mcap")
        _, _, v, _, clean = smooth(bag["time"], bag["position"], bag["effort"])
        moves = np.abs(v) > 0.04 * np.abs(v).max(0)
        if role == "field":
            before = fit.residual(bag["time"], bag["position"], bag["effort"])
            for law, (_, wanted) in zip(laws, trial["laws"]):

                def now(law=law, bag=bag, clean=clean, moves=moves):
                    change = smooth(bag["time"], bag["position"], planted(arm, law, bag))[4] - clean
                    ratio = rms(change, moves) / fit.healthy
                    return float(ratio[law.joint] if law.joint is not None else ratio.max())

                for _ in range(12):  # a law whose place the motion does not visit is drawn again
                    law.size = min(law.start, law.largest)
                    got = reach(law, now, wanted)
                    if got > 0.5 * wanted:
                        break
                    law.draw(rng)
                reached.append(got)
        for law in laws:
            bag["effort"] = planted(arm, law, bag)
        write_bag(
            target / f"{role}.mcap",
            bag["urdf"],
            bag["joints"],
            bag["time"],
            bag["position"],
            bag["velocity"],
            bag["effort"],
            epoch=bag["epoch"],
        )
    answer = {
        "trial": trial["trial"],
        "composition": trial["composition"],
        "arm": f"real {trial['arm']}",
        "seed": trial["seed"],
        "healthy_Nm": fit.healthy.round(4).tolist(),
        "field_unplanted_Nm": before.round(4).tolist(),
        "laws": [told(law, wanted, r, r) for law, (_, wanted), r in zip(laws, trial["laws"], reached)],
    }
    write_answer(out, answer)
    return answer


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    for trial in trials(options.count, rng, LISTED, ABSENT, list(SETS)):
        if (options.out / "answers" / f"{trial['trial']:03d}.json").exists():
            continue
        answer = build(trial, options.recordings, options.out)
        print(f"{trial['trial']:03d} {trial['composition']:8s} {trial['arm']:7s}", words(answer), flush=True)


if __name__ == "__main__":
    main()
