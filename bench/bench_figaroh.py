"""Reading, regressor and identification beside figaroh, on the same bags, in one run and in alternating order.

    python3 -m venv /tmp/figaroh_venv && /tmp/figaroh_venv/bin/pip install figaroh==1.0.2
    python bench/bench_figaroh.py --figaroh-python /tmp/figaroh_venv/bin/python [--repeats 7]

Two cases: a simulated UR10e with the full Stribeck law (10,000 samples of 6 joints at 1 kHz, nothing periodic,
validated on a motion with other coefficients), and the real one's commissioning bags. What is timed:

- *reading*: `read_recording` of the MCAP file; figaroh has no bag reader, so the CSV of the same numbers by
  `pandas.read_csv`, as its examples do; and, for scale, `rosbags` on the MCAP file.
- *regressor*: the rigid-body regressor of all samples of the validation bag; figaroh's `build_regressor_basic` adds
  four columns a joint; Pinocchio's `computeJointTorqueRegressor` in a loop into a preallocated array.
- *identification*: everything after reading. Ours is `identify`: filter, search of the Stribeck velocities, choice
  of structure, standard errors, consistent inertials. figaroh's is `initialize()` (filter, derivatives, regressor)
  and `solve(wls=True)` (base parameters by QR, least squares, weighted least squares), with all its options:
  viscous and Coulomb friction, actuator inertia, offset. Once decimated by ten, its default, and once on every
  sample. It filters at the cut-off `identify` chose, and samples near the filter's edges are masked.

Both predict the validation bag from the same filtered motion; residual and torque are compared on the same rows.
Their models differ: figaroh has no Stribeck law, no quadratic or cubic friction, and none that grows with the load.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from rosbags.highlevel import AnyReader

from spacearm_ident.dynamics.arm import Arm, FloatArray, arm_from_urdf
from spacearm_ident.dynamics.regressor import regressor
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import Recording, messages, read_recording, write_recording
from spacearm_ident.recording.motion import Motion
from spacearm_ident.recording.signals import prepare

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS = ROOT.parent / "shared" / "recordings" / "real" / "ur10e"
SAMPLES, RATE_HZ = 10_000, 1000.0
CENTRE = np.array([0.0, -1.3, 1.2, -1.5, -1.5, 0.0])
FRICTION = {
    "f_c": np.array([14.0, 16.0, 11.0, 3.2, 3.0, 2.6]),
    "f_b": np.array([21.0, 23.0, 17.0, 5.1, 4.4, 4.0]),
    "v_b": np.array([0.03, 0.04, 0.05, 0.06, 0.05, 0.08]),
    "k_v1": np.array([22.0, 25.0, 15.0, 4.2, 3.6, 3.1]),
    "k_v2": np.array([0.6, -0.5, 0.4, 0.2, -0.15, 0.1]),
    "k_v3": np.array([-1.0, -0.8, -0.5, -0.12, -0.1, -0.08]),
}
ROTOR_INERTIA = np.array([3.2, 3.2, 1.6, 0.35, 0.33, 0.32])
TORQUE_NOISE = 0.0035
"""Standard deviation of the white noise on the torque, as a share of the joint's torque limit."""
DECIMATIONS = {"figaroh": 10, "figaroh, every sample": 1}


@dataclass(frozen=True)
class Case:
    """An arm, the bags to fit and the one to predict."""

    name: str
    arm: Arm
    fit: list[Path]
    validation: Path
    clean: Recording | None = None
    """The validation run with noiseless torque, where there is such a thing."""


def simulated(folder: Path) -> Case:
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    bags = []
    for name, seed in (("fit", 1), ("validation", 2)):
        bags.append(folder / f"simulated_{name}.mcap")
        write_recording(bags[-1], synthetic(arm, seed))
    return Case("simulated UR10e, Stribeck friction", arm, bags[:1], bags[1], synthetic(arm, 2, 0.0))


def synthetic(arm: Arm, seed: int, noise: float = TORQUE_NOISE) -> Recording:
    rng = np.random.default_rng(seed)
    time_s = np.arange(SAMPLES) / RATE_HZ
    # Five sines a joint whose frequencies have no common period.
    omega = 2 * np.pi * rng.uniform(0.08, 0.6, (5, 6))
    amplitude, phase = rng.uniform(0.15, 0.5, (5, 6)) / np.sqrt(omega), rng.uniform(0, 2 * np.pi, (5, 6))
    angle = omega * time_s[:, None, None] + phase
    position = CENTRE + (amplitude * np.sin(angle)).sum(axis=1)
    velocity = (amplitude * omega * np.cos(angle)).sum(axis=1)
    acceleration = -(amplitude * omega**2 * np.sin(angle)).sum(axis=1)
    model = pin.buildModelFromXML(arm.urdf)
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *state) for state in zip(position, velocity, acceleration)])
    law = FRICTION
    level = law["f_c"] + (law["f_b"] - law["f_c"]) * np.exp(-((velocity / law["v_b"]) ** 2))
    torque += ROTOR_INERTIA * acceleration + level * np.sign(velocity)
    torque += law["k_v1"] * velocity + law["k_v2"] * velocity**2 + law["k_v3"] * velocity**3
    torque += noise * np.array([joint.effort_limit for joint in arm.joints]) * rng.normal(size=torque.shape)
    count = 2 * np.pi / 2**19
    return Recording(
        joints=arm.joint_names,
        time=time_s,
        position=np.rint(position / count) * count,
        velocity=velocity + 5e-4 * rng.normal(size=velocity.shape),
        effort=torque,
        segments=(slice(0, SAMPLES),),
        start_ns=1_753_000_000_000_000_000,
        urdf=arm.urdf,
    )


def real() -> Case:
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    fit = [RECORDINGS / f"{name}.mcap" for name in ("commissioning", "commissioning_2")]
    return Case("real UR10e", arm, fit, RECORDINGS / "commissioning_validation.mcap")


class Figaroh:
    """figaroh in its own Python."""

    def __init__(self, python: Path, arm: Arm, folder: Path) -> None:
        urdf = folder / "arm.urdf"
        urdf.write_text(arm.urdf)
        worker = Path(__file__).with_name("figaroh_worker.py")
        self.process = subprocess.Popen(
            [python, worker, urdf, folder, *arm.joint_names],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._answer()

    def _answer(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"figaroh's worker ended:\n{self.process.stderr.read()[-2000:]}")
        return json.loads(line)

    def ask(self, do: str, **request: object) -> dict:
        """Have a method of the worker called, and its answer."""
        print(json.dumps({"do": do, **request}), file=self.process.stdin, flush=True)
        return self._answer()

    def close(self) -> None:
        """End the worker."""
        self.process.stdin.close()
        self.process.wait()


def clocked(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def alternate(contestants: dict[str, Callable[[], float]], repeats: int) -> None:
    """Time all, in an order that turns round every time; print medians and the median of the paired ratios."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    names = list(contestants)
    for repeat in range(repeats + 1):
        for name in names if repeat % 2 else names[::-1]:
            taken = contestants[name]()
            if repeat:  # The first round warms up.
                seconds[name].append(taken)
    ours = np.array(seconds[names[0]])
    for name in names:
        times = np.array(seconds[name])
        ratio = "" if name == names[0] else f"   {np.median(times / ours):6.2f} times as long as ours"
        print(f"    {name:42} {np.median(times):8.4f} s{ratio}")


def write_csv(path: Path, recording: Recording) -> None:
    joints = range(len(recording.joints))
    header = ",".join(["t", *(f"q{k}" for k in joints), *(f"tau{k}" for k in joints)])
    table = np.column_stack([recording.time, recording.position, recording.effort])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")


def read_with_rosbags(path: Path) -> None:
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == messages.STATES_TOPIC]
        for connection, _, payload in reader.messages(connections=connections):
            reader.deserialize(payload, connection.msgtype)


def pinocchio_loop(model: pin.Model, motion: Motion) -> FloatArray:
    data = model.createData()
    whole = np.empty((len(motion.position), model.nv, 10 * model.nv))
    states = zip(motion.position, motion.velocity, motion.acceleration)
    for k, (q, qd, qdd) in enumerate(states):
        whole[k] = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
    return whole


def compare(case: Case, python: Path, folder: Path, repeats: int) -> None:
    recordings = [read_recording(bag) for bag in case.fit]
    validation = read_recording(case.validation)
    result = identify(recordings, case.arm)
    motions, _ = prepare([validation], case.arm.joint_names, result.model.cutoff_hz)
    print(f"{case.name}: {sum(len(r.time) for r in recordings)} samples of {len(case.arm.joints)} joints")
    tables = [folder / f"fit_{k}.csv" for k in range(len(recordings))]
    for table, recording in zip(tables, recordings):
        write_csv(table, recording.in_order(case.arm.joint_names))
    files = [str(table) for table in tables]
    signals = [folder / f"motion_{k}.npz" for k in range(len(motions))]
    for path, motion in zip(signals, motions):
        np.savez(path, q=motion.position, qd=motion.velocity, qdd=motion.acceleration)
    figaroh = Figaroh(python, case.arm, folder)
    figaroh.ask("configure", rate_hz=round(recordings[0].rate_hz), cutoff_hz=result.bandwidth.cutoff_hz)

    print("  reading")
    contestants = {
        "read_recording (MCAP)": lambda: clocked(lambda: [read_recording(bag) for bag in case.fit]),
        "pandas.read_csv (CSV, for figaroh)": lambda: figaroh.ask("read", files=files)["seconds"],
        "rosbags (MCAP)": lambda: clocked(lambda: [read_with_rosbags(bag) for bag in case.fit]),
    }
    alternate(contestants, repeats)

    regressors(case, motions[0], str(signals[0]), figaroh, folder, repeats)

    print("  identification (after reading)")
    contestants = {"identify": lambda: clocked(lambda: identify(recordings, case.arm))}
    predictions: dict[str, list[FloatArray]] = {"ours": [result.model.torque(motion) for motion in motions]}
    for name, decimation in DECIMATIONS.items():
        request = {"files": files, "decimation": decimation, "motions": [str(signal) for signal in signals]}
        request["out"] = str(folder / f"figaroh_{decimation}.npz")
        contestants[name] = lambda request=request: figaroh.ask("identify", **request)["seconds"]
    alternate(contestants, repeats)
    for name, decimation in DECIMATIONS.items():
        torques = np.load(folder / f"figaroh_{decimation}.npz")
        predictions[name] = [torques[str(k)] for k in range(len(motions))]
    if case.clean is not None:
        exact, _ = prepare([case.clean], case.arm.joint_names, result.model.cutoff_hz)
        predictions["the noise alone"] = [motion.torque for motion in exact]
    figaroh.close()
    accuracy(motions, predictions)


def regressors(case: Case, motion: Motion, file: str, figaroh: Figaroh, folder: Path, repeats: int) -> None:
    print(f"  regressor ({len(motion.position)} samples)")
    model = pin.buildModelFromXML(case.arm.urdf)
    mine = regressor(case.arm, motion.position, motion.velocity, motion.acceleration)
    theirs = folder / "figaroh_regressor.npy"
    figaroh.ask("regressor", motion=file, out=str(theirs))
    stacked = mine.transpose(1, 0, 2).reshape(-1, mine.shape[2])
    apart = [np.abs(stacked - np.load(theirs)).max(), np.abs(mine - pinocchio_loop(model, motion)).max()]
    state = (motion.position, motion.velocity, motion.acceleration)
    contestants = {
        "regressor": lambda: clocked(lambda: regressor(case.arm, *state)),
        "figaroh's build_regressor_basic": lambda: figaroh.ask("regressor", motion=file)["seconds"],
        "Pinocchio in a loop": lambda: clocked(lambda: pinocchio_loop(model, motion)),
    }
    alternate(contestants, repeats)
    print(f"    largest difference from figaroh's {apart[0]:.1e}, from Pinocchio's {apart[1]:.1e}")


def accuracy(motions: list[Motion], predictions: dict[str, list[FloatArray]]) -> None:
    measured = np.concatenate([motion.torque_rows for motion in motions])
    moving = np.concatenate([motion.moving for motion in motions])
    rms = {}
    for what, rows in (("moving", moving), ("all", np.ones_like(moving))):
        size = np.sqrt(np.mean(measured**2, axis=0, where=rows))
        print(f"  validation, {what} rows: residual RMS / torque RMS by joint, %")
        for name, torques in predictions.items():
            predicted = np.concatenate([motion.reduce(torque) for motion, torque in zip(motions, torques)])
            rms[name] = np.sqrt(np.mean((measured - predicted) ** 2, axis=0, where=rows))
            words = " ".join(f"{value:6.2f}" for value in 100 * rms[name] / size)
            times = "" if name == "ours" else f"   {np.median(rms[name] / rms['ours']):.1f} times ours (median joint)"
            print(f"    {name:42} {words}{times}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figaroh-python", type=Path, metavar="PATH", help="Python of an environment with figaroh")
    parser.add_argument("--repeats", type=int, default=7, help="rounds (default 7)")
    options = parser.parse_args()
    if options.figaroh_python is None or not options.figaroh_python.exists():
        print("skipped: give --figaroh-python, the Python of an environment with figaroh (see the head of this file)")
        return
    if not RECORDINGS.is_dir():
        print(f"skipped: the UR10e's model and recordings are not at {RECORDINGS}")
        return
    with tempfile.TemporaryDirectory() as scratch:
        for case in (simulated(Path(scratch)), real()):
            compare(case, options.figaroh_python, Path(scratch), options.repeats)


if __name__ == "__main__":
    main()
