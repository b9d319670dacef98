"""Draw the trials: a true arm, a simulation of it with differences, four recordings, and the sealed answer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from . import sizes
from .arms import Arm, Payload, Table, arms, changed, true_model, urdf_of
from .bags import write_bag
from .laws import ELASTIC, Law
from .motion import RATE_HZ, excitation, rigid_torque
from .plant import FRICTION_TIME_s, Noise, Run, simulate

BAGS = ("field_1", "field_2", "field_3", "validation")
"""Names of a trial's recordings."""

KNOWN = (
    "stribeck",
    "asymmetric_friction",
    "load_friction",
    "temperature_friction",
    "position_friction",
    "presliding_hysteresis",
    "torque_ripple",
    "joint_elasticity",
    "backlash",
    "harness_spring",
    "external_contact",
    "current_offset",
)
"""Effects that contracts.md has a name for."""

ABSENT = ("absent:pump", "absent:hose", "absent:detent")
"""Effects that it has no name for."""

ZERO_rad = float(np.radians(1.0))
"""Error of an encoder's zero, rad."""

DELAY_s = 5e-3
"""Delay of effort behind motion, s."""


def kind_of(trial: int) -> str:
    """What a trial may conceal: `none`, `parameters`, `physics`, `wiring` or `mixed`."""
    return {0: "none", 5: "parameters", 8: "physics", 11: "wiring"}.get(trial % 15, "mixed")


def draw_trial(trial: int, seed: int, bags: Path, sealed: Path) -> dict[str, Any]:
    """Write one trial.

    Args:
        trial: number of the trial.
        seed: seed of the series.
        bags: folder that gets `NNN/` with `simulation.xml` (or `.urdf`) and the four recordings.
        sealed: folder that gets `NNN.json`, the answer.

    Returns:
        The answer.
    """
    rng = np.random.default_rng([seed, trial])
    arm = list(arms().values())[(trial + trial // 15) % 3]
    kind, n = kind_of(trial), len(arm.joints)
    truth = arm.table()
    with_armature = not arm.urdf or (kind in ("parameters", "mixed") and rng.random() < 0.5)
    if arm.urdf and with_armature:
        for i, name in enumerate(arm.joints):
            truth["joints"][name]["armature"] = float(arm.armature[i])
    parameters = kind == "parameters" or (kind == "mixed" and rng.random() < 0.85)
    simulation = _perturb(arm, truth, rng) if parameters else changed(truth)
    for joint in simulation["joints"].values() if arm.urdf else ():
        joint["armature"] = 0.0
    payload = _payload(rng) if parameters and rng.random() < 0.15 else None
    wiring = _wiring(arm, rng) if kind == "wiring" or (kind == "mixed" and rng.random() < 0.6) else {}
    physics = kind == "physics" or (kind == "mixed" and rng.random() < 0.9)
    gravity = np.array([0.0, 0.0, -9.81])
    if "base_tilt" in wiring:
        axis, angle = wiring["base_tilt"]["axis"], wiring["base_tilt"]["angle"]
        gravity = np.cos(angle) * gravity + np.sin(angle) * np.cross(gravity, axis)
    rigid = true_model(arm, truth, (), payload, gravity)
    nominal = true_model(arm, arm.table(), timestep=1 / RATE_HZ)
    laws = _physics(arm, truth, rigid, with_armature, rng) if physics else []

    level = rng.uniform(0.5, 1.5)
    noise = Noise(
        2.0 ** rng.integers(18, 21), 3e-6, 2e-3, level * 0.015 * arm.frictionloss, level * 0.03 * arm.frictionloss
    )
    rate = float(rng.choice([200.0, 250.0, 500.0, 1000.0]))
    with_velocity, with_command = rng.random() < 0.7, rng.random() < 0.7
    thermal = any(law["effect"] == "temperature_friction" for law in laws)
    with_temperature = thermal or rng.random() < 0.4
    celsius = rng.permutation([22.0, 30.0, 38.0, 46.0])
    folder = bags / f"{trial:03d}"
    folder.mkdir(parents=True, exist_ok=True)
    sealed.mkdir(parents=True, exist_ok=True)
    simulation_file = folder / ("simulation.urdf" if arm.urdf else "simulation.xml")
    simulation_file.write_text(arm.write(simulation))
    urdf = urdf_of(arm, simulation)

    runs: list[Run] = []
    for b, bag in enumerate(BAGS):
        own = np.random.default_rng([seed, trial, b])
        reference = excitation(arm, rigid, own, float(own.uniform(20.0, 28.0)))
        here = [_of_recording(law, b, reference.shape[1] / RATE_HZ, own) for law in laws]
        warm = celsius[b] + own.uniform(-1.5, 1.5, n)
        run = simulate(arm, truth, here, reference, noise, own, nominal, payload, gravity, warm, 0.08)
        runs.append(run)
        q, v, effort = _record(arm, run, laws, wiring)
        skip = slice(None, None, int(RATE_HZ / rate))
        write_bag(
            folder / f"{bag}.mcap",
            arm.joints,
            run.t[skip],
            q[skip],
            v[skip] if with_velocity else None,
            effort[skip],
            urdf,
            run.command[skip] if with_command else None,
            run.celsius[skip] if with_temperature else None,
            600.0 * b,
        )
    floor = np.hypot(noise.torque, noise.current)
    answer = {
        "trial": trial,
        "seed": seed,
        "arm": arm.name,
        "kind": kind,
        "joints": arm.joints,
        "bodies": arm.bodies,
        "simulation": simulation,
        "truth": truth,
        "changed": _changes(truth, simulation),
        "payload": None if payload is None else vars(payload),
        "wiring": wiring,
        "laws": laws,
        "noise_Nm": floor.tolist(),
        "rate_Hz": rate,
        "velocity": bool(with_velocity),
        "temperatures": bool(with_temperature),
        **_sizes(arm, truth, payload, gravity, runs, laws, wiring, floor),
    }
    (sealed / f"{trial:03d}.json").write_text(json.dumps(answer, indent=1))
    return answer


def _perturb(arm: Arm, truth: Table, rng: np.random.Generator) -> Table:
    """The simulation's parameters: some of the truth's, changed."""
    table = changed(truth)
    n = len(arm.joints)

    def some(most: int) -> np.ndarray:
        return rng.choice(n, rng.integers(0, most + 1), replace=False)

    def factor(low: float, high: float) -> float:
        return float(1 + rng.choice([-1, 1]) * rng.uniform(low, high))

    for i in some(3):
        body = table["bodies"][arm.bodies[i]]
        body["mass"] = float(body["mass"]) * factor(0.08, 0.2)  # type: ignore[arg-type]
    for i in some(2):
        body, shift = table["bodies"][arm.bodies[i]], np.zeros(3)
        axes = rng.choice(3, rng.integers(1, 3), replace=False)
        shift[axes] = rng.choice([-1, 1], len(axes)) * rng.uniform(0.008, 0.02, len(axes))
        body["com"] = (np.array(body["com"]) + shift).tolist()
    for key, most in (("frictionloss", 3), ("damping", 3), ("armature", 2)):
        for i in some(most):
            if not (arm.urdf and key == "armature"):
                joint = table["joints"][arm.joints[i]]
                joint[key] = float(joint[key]) * factor(0.2, 0.5)  # type: ignore[arg-type]
    return table


def _payload(rng: np.random.Generator) -> Payload:
    """A tool of 0.5 to 1.5 kg that the simulation lacks."""
    mass = float(rng.uniform(0.5, 1.5))
    place = (float(rng.uniform(-0.02, 0.02)), float(rng.uniform(-0.02, 0.02)), float(rng.uniform(0.08, 0.15)))
    return Payload(mass, place, (mass * 1e-3, mass * 1e-3, mass * 7e-4))


def _wiring(arm: Arm, rng: np.random.Generator) -> dict[str, Any]:
    """Conventions that differ; at least one."""
    n, wiring = len(arm.joints), {}
    while not wiring:
        if rng.random() < 0.35:
            factor = float(1 + rng.choice([-1, 1]) * rng.uniform(0.12, 0.3))
            wiring["torque_constant"] = {"joint": int(rng.integers(n)), "factor": factor}
        if rng.random() < 0.3:
            wiring["zero"] = {"joint": int(rng.integers(n)), "offset": float(rng.choice([-1, 1]) * ZERO_rad)}
        if rng.random() < 0.3:
            wiring["delay"] = {"seconds": DELAY_s}
        turn = rng.random()
        if turn < 0.12:
            wiring["sign"] = {"joint": int(rng.integers(n)), "what": str(rng.choice(["effort", "all"]))}
        elif turn < 0.22:
            j = int(rng.integers(n - 1))
            wiring["exchanged"] = {"joints": [j, j + 1], "what": str(rng.choice(["effort", "all"]))}
        if rng.random() < 0.1:
            axis = rng.uniform(0, 2 * np.pi)
            wiring["base_tilt"] = {
                "axis": [float(np.cos(axis)), float(np.sin(axis)), 0.0],
                "angle": float(np.radians(rng.uniform(2.0, 5.0))),
            }
    return wiring


def _physics(arm: Arm, truth: Table, rigid: mujoco.MjModel, with_armature: bool, rng: np.random.Generator) -> list[Law]:
    """Two to four effects, at joints of their own; one in four trials has one that the catalogue lacks."""
    n = len(arm.joints)
    count = int(rng.integers(2, 5))
    choice = [k for k in KNOWN if with_armature or k not in ELASTIC]
    effects = [str(x) for x in rng.choice(choice, count, replace=False)]
    if rng.random() < 0.25:
        effects[-1] = str(rng.choice(ABSENT))
    data = mujoco.MjData(rigid)
    data.qpos[:] = (arm.lower + arm.upper) / 2
    mujoco.mj_forward(rigid, data)
    mass_matrix = np.zeros((rigid.nv, rigid.nv))
    mujoco.mj_fullM(rigid, data, mass_matrix)
    laws: list[Law] = []
    for effect, j in zip(effects, rng.permutation(n)[:count]):
        coulomb = float(truth["joints"][arm.joints[j]]["frictionloss"])  # type: ignore[arg-type]
        link = max(float(mass_matrix[j, j] - rigid.dof_armature[j]), 1e-3)
        law: Law = {"effect": effect, "joint": int(j)}
        u, sign = rng.uniform, float(rng.choice([-1, 1]))
        phase = u(0, 2 * np.pi)
        if effect == "stribeck":
            law |= {"height": coulomb * u(0.5, 1.2), "speed": u(0.1, 0.4)}
        elif effect == "asymmetric_friction":
            law |= {"share": sign * u(0.15, 0.35)}
        elif effect == "load_friction":
            law |= {"mu": u(0.08, 0.2)}
        elif effect == "temperature_friction":
            law |= {"coulomb_per_C": u(0.008, 0.02), "viscous_per_C": u(0.02, 0.04)}
        elif effect == "position_friction":
            law |= {"share": u(0.2, 0.45), "phase": phase}
        elif effect == "presliding_hysteresis":
            sigma = coulomb / u(1e-3, 5e-3)
            law |= {"level": coulomb, "sigma": sigma, "micro": 0.3 * float(np.sqrt(sigma * 0.1))}
        elif effect == "torque_ripple":
            law |= {
                "amplitude": coulomb * u(0.15, 0.4),
                "cycles": int(rng.choice([8, 16, 24, 50, 100])),
                "phase": phase,
            }
        elif effect == "harness_spring":
            law |= {"stiffness": coulomb * u(0.3, 0.8), "rest": (arm.lower[j] + arm.upper[j]) / 2 + sign * u(0, 0.5)}
        elif effect in ELASTIC:
            stiffness = arm.stiffness[j] * u(0.4, 1.0)
            law |= {"stiffness": stiffness, "damping": 0.1 * float(np.sqrt(stiffness * link))}
            if effect == "backlash":
                law |= {"gap": u(0.5e-3, 2e-3)}
        elif effect == "external_contact":
            direction = rng.normal(size=3)
            force = u(20, 50) * direction / np.linalg.norm(direction) * (0.5 if arm.name == "panda" else 1.0)
            law |= {"force": force.tolist()}
        elif effect == "current_offset":
            law |= {"offset": sign * coulomb * u(0.3, 0.6)}
        elif effect == "absent:pump":
            law |= {"amplitude": coulomb * u(0.3, 0.7), "hertz": u(0.5, 4.0)}
        elif effect == "absent:hose":
            law |= {"deviation": coulomb * u(0.3, 0.6), "correlation": 1.0}
        else:
            law |= {
                "amplitude": coulomb * u(0.6, 1.2),
                "width": u(0.1, 0.25),
                "rest": (arm.lower[j] + arm.upper[j]) / 2 + sign * u(0, 0.3),
            }
        laws.append({k: float(x) if isinstance(x, np.floating) else x for k, x in law.items()})
    return laws


def _of_recording(law: Law, recording: int, duration: float, rng: np.random.Generator) -> Law:
    """The law with what changes from recording to recording: the window of a contact, the phase of a pump."""
    if law["effect"] == "external_contact":
        length = rng.uniform(1.0, 2.5)
        return law | {"start": float(rng.uniform(3.0, duration - 3.0 - length)), "length": float(length)}
    if law["effect"] == "absent:pump":
        return law | {"phase_run": float(rng.uniform(0, 2 * np.pi))}
    return law


def _record(arm: Arm, run: Run, laws: list[Law], wiring: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and effort as logged, with faults of wiring (samples, n)."""
    q, v, effort = run.q_measured.copy(), run.v_measured.copy(), run.effort.copy()
    for law in laws:
        if law["effect"] == "current_offset":
            effort[:, law["joint"]] += law["offset"]
    if fault := wiring.get("torque_constant"):
        effort[:, fault["joint"]] /= fault["factor"]
    if fault := wiring.get("zero"):
        q[:, fault["joint"]] += fault["offset"]
    if fault := wiring.get("delay"):
        shift = round(fault["seconds"] * RATE_HZ)
        effort = np.concatenate([np.repeat(effort[:1], shift, axis=0), effort[:-shift]])
    if fault := wiring.get("sign"):
        j = fault["joint"]
        effort[:, j] *= -1
        if fault["what"] == "all":
            q[:, j], v[:, j] = -q[:, j], -v[:, j]
            run.command[:, j] = -run.command[:, j]
    if fault := wiring.get("exchanged"):
        order = np.arange(len(arm.joints))
        order[fault["joints"]] = order[fault["joints"][::-1]]
        effort = effort[:, order]
        if fault["what"] == "all":
            q, v, run.command = q[:, order], v[:, order], run.command[:, order]
    return q, v, effort


def _changes(truth: Table, simulation: Table) -> list[dict[str, Any]]:
    """The parameters that differ: where, which, was (simulation) and is (truth)."""
    rows = []
    for part in ("bodies", "joints"):
        for name, values in truth[part].items():
            for key, value in values.items():
                was = simulation[part][name][key]
                if not np.allclose(was, value, rtol=1e-12, atol=0):
                    rows.append({"where": name, "name": key, "was": was, "is": value})
    return rows


def _sizes(
    arm: Arm,
    truth: Table,
    payload: Payload | None,
    gravity: np.ndarray,
    runs: list[Run],
    laws: list[Law],
    wiring: dict[str, Any],
    floor: np.ndarray,
) -> dict[str, Any]:
    """Sizes of every law and fault over the noise, by joint (n), over all four recordings.

    Returns:
        `law_sizes` and `wiring_sizes`: RMS that friction and armature of the joint itself do not absorb;
        `law_sizes_free` and `wiring_sizes_free`: RMS that no parameter of the simulation absorbs.
    """
    rng = np.random.default_rng(0)
    rows = [np.sort(rng.choice(np.arange(100, len(r.t) - 100), sizes.SAMPLES, replace=False)) for r in runs]

    def of(name: str) -> np.ndarray:
        return np.concatenate([getattr(r, name)[i] for r, i in zip(runs, rows)])

    def low(values: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([sizes.low_pass(x, RATE_HZ, 30.0)[i] for x, i in zip(values, rows)])

    q, v, torque = of("q"), of("v"), of("torque")
    smooth = low([r.a for r in runs])
    weight, n = 1.0 / floor, len(floor)
    columns = sizes.regressor(true_model(arm, truth, (), payload, gravity), q, v, smooth)
    free, own = sizes.basis(columns, weight), sizes.basis(columns[:, -3 * n :], weight)
    rigid = true_model(arm, truth, (), payload, gravity)
    rigid.dof_solref[:] = (FRICTION_TIME_s, 1.0)
    data = mujoco.MjData(rigid)

    def elastic() -> np.ndarray:
        rests = []
        for r, i in zip(runs, rows):
            every = np.arange(0, len(r.t), 4)
            plain = rigid_torque(rigid, data, r.q[every], r.v[every], r.a[every])
            rest = sizes.low_pass(r.torque[every] + r.added.sum(0)[every] - plain, RATE_HZ / 4)
            rests.append(np.array([np.interp(r.t[i], r.t[every], rest[:, j]) for j in range(n)]).T)
        return np.concatenate(rests)

    differences: dict[str, np.ndarray] = {}
    absorbing: dict[str, np.ndarray] = {}
    law_sizes, law_free = [], []
    for k, law in enumerate(laws):
        if law["effect"] in ELASTIC:
            difference = elastic()
        elif law["effect"] == "current_offset":
            difference = np.zeros_like(q)
            difference[:, law["joint"]] = law["offset"]
        else:
            difference = np.concatenate([r.added[k][i] for r, i in zip(runs, rows)])
        if law["effect"] == "external_contact":
            inside = np.abs(difference).sum(1) > 0
            within = np.sqrt(np.mean(difference[inside] ** 2, axis=0)) * weight
            law_sizes.append(within.tolist())
            law_free.append(within.tolist())
            continue
        law_sizes.append(sizes.size(own, difference, weight).tolist())
        law_free.append(sizes.size(free, difference, weight).tolist())
    for name, fault in wiring.items():
        difference = np.zeros_like(q)
        if name == "torque_constant":
            difference[:, fault["joint"]] = torque[:, fault["joint"]] * (1 / fault["factor"] - 1)
        elif name == "delay":
            slope = [np.gradient(sizes.low_pass(r.torque, RATE_HZ, 30.0), 1 / RATE_HZ, axis=0) for r in runs]
            difference = -fault["seconds"] * np.concatenate([x[i] for x, i in zip(slope, rows)])
        elif name == "zero":
            moved = q.copy()
            moved[:, fault["joint"]] += fault["offset"]
            difference = rigid_torque(rigid, data, moved, v, smooth) - rigid_torque(rigid, data, q, v, smooth)
        elif name == "base_tilt":
            upright = true_model(arm, truth, (), payload)
            upright.dof_solref[:] = (FRICTION_TIME_s, 1.0)
            difference = rigid_torque(rigid, data, q, v, smooth)
            difference -= rigid_torque(upright, mujoco.MjData(upright), q, v, smooth)
        elif name == "sign" and fault["what"] == "all":
            # An axis reversed as a whole: friction and armature are as before, the bodies stand mirrored.
            mirror = np.ones(n)
            mirror[fault["joint"]] = -1.0
            state = [mirror * part for part in (q, v, smooth)]
            difference = mirror * rigid_torque(rigid, data, *state) - rigid_torque(rigid, data, q, v, smooth)
            columns = sizes.regressor(true_model(arm, truth, (), payload, gravity), *state)
            absorbing[name] = sizes.basis(np.tile(mirror, len(q))[:, None] * columns, weight)
        elif name == "sign":
            difference[:, fault["joint"]] = 2 * torque[:, fault["joint"]]
        else:
            i, j = fault["joints"]
            difference[:, i], difference[:, j] = torque[:, j] - torque[:, i], torque[:, i] - torque[:, j]
        differences[name] = difference
    return {
        "law_sizes": law_sizes,
        "law_sizes_free": law_free,
        "wiring_sizes": {k: sizes.size(own, x, weight).tolist() for k, x in differences.items()},
        "wiring_sizes_free": {
            k: sizes.size(absorbing.get(k, free), x, weight).tolist() for k, x in differences.items()
        },
    }
