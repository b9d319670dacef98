"""Draws for `mismatch --simulation`: a simulation with parameters off, against an arm in MuJoCo, and the score.

    python bench/layers.py run --draws 12 --seed 1 --out DIR      draw, compare, score; a JSON line a draw
    python bench/layers.py score DIR                              score what is there again
    python bench/layers.py real --out DIR                         the five real arms of ../shared, a line each
    python bench/layers.py turns --out DIR                        the AIRBOT, each of three runs held out in turn,
                                                                  beside `identify` from the same two runs

The arm is one of ../shared/models with friction, damping and armature of its size. Of the simulation every mass is
±20 % off, every centre of mass ±2 cm, damping and friction loss ±50 %. Each with probability one half: a torque
constant up to ±30 % off, an encoder zero 1° off, torque 5 ms late. Two or three effects are left out, or none.
Recordings are MuJoCo's inverse dynamics along a motion, with textbook laws of the effects added and coloured noise.
Not blind: whoever wrote these laws knows the catalogue; `answer.json` is not read before scoring.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.identification.identify import identify
from spacearm_ident.mismatch.preparation import banded, position_cut_off_hz
from spacearm_ident.mismatch.scene import one_way
from spacearm_ident.recording import Recording, read_recording
from spacearm_ident.recording.writer import write_recording

MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"
ARMS = {"ur5e": "ur5e.xml", "iiwa14": "iiwa14.xml"}
RATE_HZ, SECONDS = 250.0, 40.0
NOISE = 0.01
"""Noise of the torque, of its RMS."""
FloatArray = np.ndarray


@dataclass(frozen=True)
class Motion:
    """Motion of a run, (N, n) each, and its torque without what is left out."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray


def _stribeck(m: Motion, j: int, size: float) -> FloatArray:
    v = m.velocity[:, j]
    return size * np.tanh(v / 0.01) / (1 + (v / 0.08) ** 2)


def _load(m: Motion, j: int, size: float) -> FloatArray:
    load = m.torque[:, j]
    return size * np.abs(load) / max(np.sqrt(np.mean(load**2)), 1e-9) * np.tanh(m.velocity[:, j] / 0.01)


def _offset(m: Motion, j: int, size: float) -> FloatArray:
    return np.full(len(m.time), size)


def _ripple(m: Motion, j: int, size: float) -> FloatArray:
    return np.asarray(np.sqrt(2) * size * np.sin(16 * m.position[:, j] + 0.7))


def _spring(m: Motion, j: int, size: float) -> FloatArray:
    q = m.position[:, j]
    return np.asarray(size * (q - q.mean()) / max(q.std(), 1e-9))


def _position(m: Motion, j: int, size: float) -> FloatArray:
    return np.asarray(np.sqrt(2) * size * np.sin(2 * m.position[:, j]) * np.tanh(m.velocity[:, j] / 0.01))


def _dahl(m: Motion, j: int, size: float) -> FloatArray:
    z, out, step = 0.0, np.empty(len(m.time)), np.abs(m.velocity[:, j]) / RATE_HZ
    sign = np.sign(m.velocity[:, j])
    for k in range(len(out)):
        z += (sign[k] - z) * (1 - np.exp(-step[k] / 0.02))
        out[k] = z
    return np.asarray(3 * size * (out - sign))


EFFECTS: dict[str, tuple[Callable[[Motion, int, float], FloatArray], tuple[str, ...]]] = {
    "stribeck": (_stribeck, ("stribeck",)),
    "load_friction": (_load, ("load_friction", "gear_efficiency")),
    "current_offset": (_offset, ("current_offset", "asymmetric_friction")),
    "torque_ripple": (_ripple, ("torque_ripple",)),
    "harness_spring": (_spring, ("harness_spring",)),
    "position_friction": (_position, ("position_friction",)),
    "presliding_hysteresis": (_dahl, ("presliding_hysteresis",)),
}
"""Effect -> law, and the names that count as right (the same torque in these data)."""


def draw(arm: str, seed: int, out: Path) -> None:
    """Write simulation.xml, real_1.mcap, real_2.mcap and answer.json."""
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, len(arm)])
    spec = mujoco.MjSpec.from_file(str(MODELS / ARMS[arm]))
    joints = [joint.name for joint in spec.joints]
    model = spec.compile()
    size = _gravity_rms(model)
    truth = _true_arm(spec, joints, size, rng)
    (out / "simulation.xml").write_text(_simulation(truth, joints, rng))
    true_text = truth.to_xml()
    true_model = mujoco.MjModel.from_xml_string(true_text)
    wiring = _wiring(joints, rng)
    runs = [_motion(true_model, rng) for _ in range(2)]
    chosen = _effects(joints, runs, rng)
    for name, motion in zip(("real_1.mcap", "real_2.mcap"), runs):
        write_recording(out / name, _recorded(motion, joints, wiring, chosen, rng))
    answer = {
        "true": _values(true_model, joints),
        "wiring": wiring,
        "effects": [{"effect": e, "joint": joints[j], "rms_Nm": s, "over_noise": r} for e, j, s, r in chosen],
    }
    (out / "answer.json").write_text(json.dumps(answer, indent=1))


def _gravity_rms(model: Any) -> FloatArray:
    """(n,) torque that holds the arm still, RMS over postures."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    held = []
    for _ in range(50):
        data.qpos[:] = rng.uniform(-1.5, 1.5, model.nq)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        mujoco.mj_inverse(model, data)
        held.append(np.array(data.qfrc_bias))
    return np.maximum(np.sqrt(np.mean(np.square(held), axis=0)), 0.3)


def _true_arm(spec: Any, joints: list[str], size: FloatArray, rng: np.random.Generator) -> Any:
    """The arm with friction of its size: Coulomb 10 to 25 % of the torque of gravity, damping and armature likewise."""
    for k, name in enumerate(joints):
        joint = spec.joint(name)
        joint.frictionloss = float(rng.uniform(0.1, 0.25) * (size[k] + 0.1 * size.max()))
        joint.damping = _first(joint.damping, float(rng.uniform(0.1, 0.3) * (size[k] + 0.1 * size.max())))
        joint.armature = float(rng.uniform(0.02, 0.06) * (size[k] + 0.1 * size.max()))
    return spec


def _first(old: Any, value: float) -> Any:
    try:
        return [value, *([0.0] * (len(list(old)) - 1))]
    except TypeError:
        return value


def _simulation(truth: Any, joints: list[str], rng: np.random.Generator) -> str:
    """The MJCF that the engineer has."""
    spec = truth.copy()
    for name in joints:
        joint = spec.joint(name)
        body = joint.parent
        body.mass *= float(rng.uniform(0.8, 1.2))
        body.ipos = np.array(body.ipos) + rng.uniform(-0.02, 0.02, 3)
        joint.frictionloss *= float(rng.uniform(0.5, 1.5))
        joint.damping = _first(joint.damping, float(np.ravel(joint.damping)[0] * rng.uniform(0.5, 1.5)))
    spec.compile()
    return str(spec.to_xml())


def _wiring(joints: list[str], rng: np.random.Generator) -> dict[str, Any]:
    wiring: dict[str, Any] = {}
    if rng.random() < 0.5:
        wiring["effort_gain"] = [
            joints[rng.integers(len(joints))],
            float(1 + rng.choice([-1, 1]) * rng.uniform(0.1, 0.3)),
        ]
    if rng.random() < 0.5:
        wiring["encoder_zero"] = [joints[rng.integers(1, len(joints) - 1)], float(np.deg2rad(rng.choice([-1.0, 1.0])))]
    if rng.random() < 0.5:
        wiring["delay"] = ["", 0.005]
    return wiring


def _motion(model: Any, rng: np.random.Generator) -> Motion:
    """A sum of sines with a base of 0.08 Hz for three quarters of the time, and a slow part with reversals."""
    n, time_s = model.nv, np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    q, v, a = np.zeros((3, len(time_s), n))
    for joint in range(n):
        for harmonic in range(1, 6):
            omega, phase = 2 * np.pi * 0.08 * harmonic, rng.uniform(0, 2 * np.pi)
            amplitude = rng.uniform(0.15, 0.45) / harmonic**0.6
            q[:, joint] += amplitude * np.sin(omega * time_s + phase)
            v[:, joint] += amplitude * omega * np.cos(omega * time_s + phase)
            a[:, joint] -= amplitude * omega**2 * np.sin(omega * time_s + phase)
    torque = np.empty_like(q)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    for row, state in enumerate(zip(q, v, a)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse
    torque += np.array(model.dof_frictionloss) * np.tanh(v / 0.003)
    return Motion(time_s, q, v, a, torque)


def _effects(joints: list[str], runs: list[Motion], rng: np.random.Generator) -> list[tuple[str, int, float, float]]:
    """Effect, joint, RMS in N m, and the same over the noise's; none in every fourth draw."""
    if rng.random() < 0.25:
        return []
    names = list(rng.choice(list(EFFECTS), int(rng.integers(2, 4)), replace=False))
    chosen = []
    for name in names:
        joint, over = int(rng.integers(len(joints))), float(rng.uniform(3.0, 10.0))
        noise = NOISE * float(np.sqrt(np.mean(runs[1].torque[:, joint] ** 2)))
        law = EFFECTS[name][0]
        unit = float(np.sqrt(np.mean(law(runs[1], joint, 1.0) ** 2)))
        chosen.append((name, joint, over * noise / max(unit, 1e-9), over))
    return chosen


def _recorded(
    motion: Motion, joints: list[str], wiring: dict[str, Any], chosen: list[Any], rng: np.random.Generator
) -> Recording:
    torque = motion.torque.copy()
    for name, joint, size, _ in chosen:
        torque[:, joint] += EFFECTS[name][0](motion, joint, size)
    noise = rng.normal(size=torque.shape)
    for k in range(1, len(noise)):
        noise[k] += 0.6 * noise[k - 1]
    torque += NOISE * np.sqrt(np.mean(motion.torque**2, axis=0)) * noise * 0.8
    if "delay" in wiring:
        late = motion.time - wiring["delay"][1]
        torque = np.column_stack([np.interp(late, motion.time, one) for one in torque.T])
    position = np.round(motion.position * 2**20 / (2 * np.pi)) * (2 * np.pi) / 2**20
    if "effort_gain" in wiring:
        torque[:, joints.index(wiring["effort_gain"][0])] *= wiring["effort_gain"][1]
    if "encoder_zero" in wiring:
        position[:, joints.index(wiring["encoder_zero"][0])] -= wiring["encoder_zero"][1]
    return Recording(
        joints=tuple(joints),
        time=motion.time,
        position=position,
        velocity=motion.velocity,
        effort=torque,
        segments=(slice(0, len(motion.time)),),
    )


def _values(model: Any, joints: list[str]) -> dict[str, float]:
    """True value of every standard parameter, by the names that items use."""
    values = {}
    for k, name in enumerate(joints):
        body = int(model.jnt_bodyid[k])
        key, mass, centre = model.body(body).name, float(model.body_mass[body]), np.array(model.body_ipos[body])
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[body])
        turn = axes.reshape(3, 3)
        tensor = turn @ np.diag(model.body_inertia[body]) @ turn.T
        tensor = tensor + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        values[f"{key}.mass"] = mass
        values |= {f"{key}.m{axis}": float(mass * centre[i]) for i, axis in enumerate("xyz")}
        values |= {f"{key}.i{'xyz'[r]}{'xyz'[c]}": float(tensor[r, c]) for r in range(3) for c in range(r, 3)}
        dof = int(model.jnt_dofadr[k])
        values[f"{name}.armature"] = float(model.dof_armature[dof])
        values[f"{name}.damping"] = float(np.ravel(model.dof_damping[dof])[0])
        values[f"{name}.frictionloss"] = float(model.dof_frictionloss[dof])
    return values


# --- score ----------------------------------------------------------------------------------------------------


def score(out: Path) -> dict[str, Any]:
    """Figures of one draw: counts that add up over draws."""
    answer = json.loads((out / "answer.json").read_text())
    result = json.loads((out / "result" / "mismatch.json").read_text())
    layers = {layer["layer"]: layer for layer in result["layers"]}
    found = {"draw": out.name, **_score_wiring(answer["wiring"], layers["conventions"]["items"])}
    found |= _score_parameters(answer["true"], layers["parameters"]["items"])
    found |= _score_effects(answer["effects"], layers["physics"]["items"])
    ratios = [
        after / np.hypot(result["noise_floor_Nm"][joint], 1e-9) for joint, after in result["residual_after_Nm"].items()
    ]
    found["left_over_floor"] = round(float(np.median(ratios)), 2)
    return found


def _score_wiring(true: dict[str, Any], items: list[dict[str, Any]]) -> dict[str, int]:
    named = {(item["name"], item["joints"][0] if item["name"] != "delay" else "") for item in items}
    wanted = {(name, joint) for name, (joint, _) in true.items()}
    return {"wired": len(wanted), "wired_named": len(named & wanted), "wired_false": len(named - wanted)}


def _score_parameters(true: dict[str, float], items: list[dict[str, Any]]) -> dict[str, int]:
    inside = wrong = count = 0
    for item in items:
        if not item["combination"]:
            continue
        count += 1
        value = sum(factor * true[key] for key, factor in item["combination"].items())
        low, high = item["ci95"]
        inside += low <= value <= high
        wrong += abs(value - item["was"]) < 0.5 * (high - low)
    return {"parameters": count, "parameters_inside": inside, "parameters_false": wrong}


def _score_effects(true: list[dict[str, Any]], items: list[dict[str, Any]]) -> dict[str, Any]:
    hit, right = 0, 0
    for one in true:
        names = EFFECTS[one["effect"]][1]
        hit += any(item["name"] in names and one["joint"] in item["joints"] for item in items)
    for item in items:
        right += any(item["name"] in EFFECTS[o["effect"]][1] and o["joint"] in item["joints"] for o in true)
    missed = [f"{o['effect']}@{o['joint']}" for o in true]
    return {
        "effects": len(true),
        "effects_named": hit,
        "effects_claimed": len(items),
        "effects_right": right,
        "left_out": missed,
        "claimed": [f"{item['name']}@{','.join(item['joints'])}" for item in items],
    }


def run(arms: list[str], draws: int, seed: int, out: Path) -> None:
    """Draw, compare and score; a JSON line a draw into DIR/scores.jsonl."""
    for number in range(draws):
        arm = arms[number % len(arms)]
        where = out / f"{arm}_{seed + number}"
        draw(arm, seed + number, where)
        begin = time.monotonic()
        done = _mismatch(where, ("simulation.xml",), ("real_1",), ("real_2",), where / "result")
        if done.returncode not in (0, 1):
            line: dict[str, Any] = {"draw": where.name, "failed": done.stderr.strip().splitlines()[-1:]}
        else:
            line = {**score(where), "seconds": round(time.monotonic() - begin)}
        print(json.dumps(line), flush=True)
        with (out / "scores.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
    totals(out)


REAL = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "real"
RUNS = {
    "airbot": (("simulation.xml",), ("run_1", "run_2"), ("run_3",)),
    "airbot_bag": (("simulation.mcap",), ("run_1", "run_2"), ("run_3",)),
    "ur10e": (("arm.urdf",), ("commissioning",), ("commissioning_2",)),
    "panda": (("arm.urdf",), ("run_1",), ("run_2",)),
    "rokae": (("arm.urdf",), ("run_1",), ("run_2",)),
    "tx40": (("arm.urdf",), ("excitation",), ()),
}
"""Arm -> its simulation (the authors' MJCF, or the URDF without friction), what is fitted, what is held out."""


def real(out: Path) -> None:
    """Compare every real arm with its simulation; RMS over the torque's, median joint, and what replicates."""
    print("| arm | simulation | conventions | parameters | physics | ceiling | mended | named | replicated | s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for arm, (simulation, fitted, held) in RUNS.items():
        begin = time.monotonic()
        result = _compared(REAL / arm.split("_")[0], simulation, fitted, held, out / arm)
        if isinstance(result, list):
            print(f"| {arm} | failed: {result} |", flush=True)
            continue
        print(_real_line(arm, result, time.monotonic() - begin), flush=True)


def _mismatch(
    folder: Path, simulation: Sequence[str], fitted: Sequence[str], held: Sequence[str], out: Path
) -> subprocess.CompletedProcess[str]:
    command = ["mismatch", *(str(folder / f"{name}.mcap") for name in fitted)]
    command += ["--simulation", *(str(folder / name) for name in simulation)]
    command += ["--validate", *(str(folder / f"{name}.mcap") for name in held)] if held else []
    where = [sys.executable, "-m", "spacearm_ident.cli.main", *command, "--out", str(out)]
    return subprocess.run(where, capture_output=True, text=True, check=False)


def _compared(
    folder: Path, simulation: Sequence[str], fitted: Sequence[str], held: Sequence[str], out: Path
) -> dict[str, Any] | list[str]:
    """What `mismatch` writes of an arm's recordings and its simulation, files of `folder`; the error where it fails."""
    done = _mismatch(folder, simulation, fitted, held, out)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1:]
    found: dict[str, Any] = json.loads((out / "mismatch.json").read_text())
    return found


def _real_line(arm: str, result: dict[str, Any], seconds: float) -> str:
    torque = np.array(list(result["torque_Nm"].values()))

    def share(values: dict[str, Any]) -> str:
        return f"{100 * float(np.median(np.array(list(values.values())) / torque)):.1f}"

    after = [
        share({joint: one["rms_after_Nm"] for joint, one in layer["joints"].items()}) for layer in result["layers"][:3]
    ]
    named = " + ".join(str(len(layer["items"])) for layer in result["layers"][:3])
    again = result["replicated_share"]
    cells = [
        arm,
        share(result["residual_before_Nm"]),
        *after,
        share(result["ceiling_Nm"]),
        share(result["mended_Nm"]),
        named,
    ]
    return "| " + " | ".join([*cells, "–" if again is None else f"{again:.0%}", f"{seconds:.0f}"]) + " |"


AIRBOT_RUNS = ("run_1", "run_2", "run_3")


def turns(out: Path) -> None:
    """What the corrected simulation of the AIRBOT leaves of a run that it has not seen, beside `identify`'s model.

    Both are from the other two runs, both judged in the bandwidth of the comparison on rows free of reversals; RMS over
    the torque's by joint, %.
    """
    print("| held out | | " + " | ".join(f"joint{k}" for k in range(1, 7)) + " | conventions |")
    print("|---" * 9 + "|")
    folder, shares = REAL / "airbot", []
    for held in AIRBOT_RUNS:
        names = [name for name in AIRBOT_RUNS if name != held]
        result = _compared(folder, ("simulation.xml",), names, (held,), out / held)
        if isinstance(result, list):
            raise SystemExit(f"{held}: {result}")
        cutoff_hz = load_model(out / held / "extended_model.yaml").cutoff_hz or 0.0
        own = np.array(list(result["mended_Nm"].values())) / np.array(list(result["torque_Nm"].values()))
        *fitted, unseen = [read_recording(folder / f"{name}.mcap") for name in (*names, held)]
        shares.append((own, _from_scratch(fitted, unseen, cutoff_hz)))
        found = ", ".join(f"{one['name']} {one['is']:.3g}" for one in result["layers"][0]["items"])
        _print_turn(held, *shares[-1], found)
    _print_turn("RMS of the three", *np.sqrt(np.mean(np.square(shares), axis=0)), "")


def _print_turn(held: str, own: FloatArray, scratch: FloatArray, found: str) -> None:
    for words, values, more in (("corrected simulation", own, found), ("`identify`", scratch, "")):
        print(f"| {held} | {words} | " + " | ".join(f"{100 * x:.1f}" for x in values) + f" | {more} |", flush=True)


def _from_scratch(fitted: list[Recording], held: Recording, cutoff_hz: float) -> FloatArray:
    """(n,) RMS that `identify` leaves of a recording over its torque's."""
    arm = load_arm(REAL / "airbot" / "arm.urdf")
    model, joints = identify(fitted, arm).model, arm.joint_names
    (motion,) = banded([held], joints, cutoff_hz, position_cut_off_hz([*fitted, held], joints, cutoff_hz))
    left, counts = motion.torque_rows - motion.reduce(model.torque(motion)), one_way(motion)
    squares = [np.where(counts, rows**2, 0.0).sum(axis=0) for rows in (left, motion.torque_rows)]
    return np.asarray(np.sqrt(squares[0] / squares[1]))


def totals(out: Path) -> None:
    """Sums over the draws."""
    lines = [json.loads(line) for line in (out / "scores.jsonl").read_text().splitlines()]
    keys = (
        "wired",
        "wired_named",
        "wired_false",
        "parameters",
        "parameters_inside",
        "parameters_false",
        "effects",
        "effects_named",
        "effects_claimed",
        "effects_right",
    )
    print({key: sum(line.get(key, 0) for line in lines) for key in keys}, len(lines), "draws")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="command")
    one = commands.add_parser("run")
    one.add_argument("--arm", nargs="+", choices=tuple(ARMS), default=list(ARMS))
    one.add_argument("--draws", type=int, default=4)
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--out", type=Path, required=True)
    again = commands.add_parser("score")
    again.add_argument("out", type=Path)
    for command in ("real", "turns"):
        commands.add_parser(command).add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "real":
        real(options.out)
    elif options.command == "turns":
        turns(options.out)
    elif options.command == "run":
        options.out.mkdir(parents=True, exist_ok=True)
        run(options.arm, options.draws, options.seed, options.out)
    else:
        for folder in sorted(path.parent for path in options.out.glob("*/answer.json")):
            print(json.dumps(score(folder)))


if __name__ == "__main__":
    main()
