"""Identification beside figaroh, Pinocchio with numpy, and MuJoCo's system identification, in one run.

    python3 -m venv /tmp/figaroh_venv && /tmp/figaroh_venv/bin/pip install figaroh==1.0.2
    python3 -m venv /tmp/mujoco_venv && /tmp/mujoco_venv/bin/pip install 'mujoco[sysid]==4.0.0'
    python bench/peers.py --figaroh-python /tmp/figaroh_venv/bin/python --mujoco-python /tmp/mujoco_venv/bin/python

The simulated cases are a UR10e on the peers' problem: 10,000 samples of six joints at 1 kHz, one period of a Fourier
series of five harmonics of 0.1 Hz with random coefficients, as large as the limits of `LIMITS` allow, with white
noise on torque and velocity and a quantised position; fitted on one bag, validated on another of other coefficients.
Every round has other coefficients and other noise. Friction is the improved Stribeck law, or Coulomb and viscous.
The real case is the UR10e's commissioning bags.

Timed is everything after reading, in CPU seconds (all threads; a busy machine changes them little), in an order that
turns round every round; ratios are of the same round. Ours is
`identify`: filter, search of the Stribeck velocities, choice of structure, standard errors, consistent inertials.
figaroh's is `initialize()` and `solve(wls=True)` with all its options (viscous and Coulomb friction, actuator inertia,
offset), once decimated by ten, its default, and once on every sample. Pinocchio's is what one writes oneself: regressor
in a loop, friction columns, least squares, weights by joint, least squares. MuJoCo's is `mujoco.sysid.optimize` (see
`mujoco_worker.py`), which takes half a minute and more and so runs in the first round only. All of them filter at the
cut-off that `identify` chose; all predict the validation bag from the same filtered motion. Errors are against the
validation torque without its noise where there is such a thing, on all rows, standstill and reversals included. Beside
them stands what no unbiased estimate can be expected to beat (`least_error.py`), the median of the rounds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from least_error import least_rms
from pinocchio_wls import Pinocchio

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.regressor import regressor
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.recording import Recording, read_recording, write_recording
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS = ROOT.parent / "shared" / "recordings" / "real" / "ur10e"
SAMPLES, RATE_HZ = 10_000, 1000.0
CENTRE = np.array([0.0, -1.3, 0.6, 0.0, 0.0, 0.0])
LIMITS = np.array([[2.8, 1.5, 2.0, 2.8, 2.8, 2.8], [2.0, 2.0, 2.5, 3.0, 3.0, 3.0], [6.0, 6.0, 8.0, 12.0, 12.0, 12.0]])
"""Of position about the centre, velocity and acceleration."""
STRIBECK = {
    "f_c": np.array([14.0, 16.0, 11.0, 3.2, 3.0, 2.6]),
    "f_b": np.array([21.0, 23.0, 17.0, 5.1, 4.4, 4.0]),
    "v_b": np.array([0.03, 0.04, 0.05, 0.06, 0.05, 0.08]),
    "k_v1": np.array([22.0, 25.0, 15.0, 4.2, 3.6, 3.1]),
    "k_v2": np.array([0.6, -0.5, 0.4, 0.2, -0.15, 0.1]),
    "k_v3": np.array([-1.0, -0.8, -0.5, -0.12, -0.1, -0.08]),
}
PLAIN = {**STRIBECK, "f_b": STRIBECK["f_c"], "k_v2": np.zeros(6), "k_v3": np.zeros(6)}
ROTOR_INERTIA = np.array([3.2, 3.2, 1.6, 0.35, 0.33, 0.32])
TORQUE_NOISE = 0.0035
"""Standard deviation of the white noise on the torque, as a share of the joint's torque limit: 1.2 to 0.2 N·m."""
QUIET = TORQUE_NOISE / 10
REAL = "real UR10e"
TARGET_Nm, TARGET_TIME = 0.06, 0.5
LIMITATIONS = {
    "ours": "a Stribeck velocity below the speeds that its low-pass resolves",
    "figaroh": "Stribeck, quadratic, cubic and load-dependent friction; a presliding distance",
    "figaroh, every sample": "the same",
    "Pinocchio + numpy": "what nobody writes: here the same as figaroh, and no standard errors",
    "mujoco.sysid": "Stribeck, even quadratic and load-dependent friction; a presliding distance",
}


@dataclass(frozen=True)
class Round:
    """Bags to fit, the one to predict, and its noiseless twin where there is one."""

    fit: list[Path]
    validation: Path
    clean: Recording | None = None


@dataclass(frozen=True)
class Case:
    """A problem, as often as it is posed."""

    name: str
    arm: Arm
    rounds: list[Round]
    cutoff_hz: float | None = None
    law: dict[str, FloatArray] | None = None
    noise: float = 0.0


def series(seed: int, samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration of a random Fourier series that touches one of its limits a joint."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * 0.1 * np.arange(1, 6)[:, None]
    a, b = rng.normal(size=(2, 5, 6))
    angle = omega * (np.arange(samples) / RATE_HZ)[:, None, None]
    sin, cos = np.sin(angle), np.cos(angle)
    parts = [(a * sin - b * cos) / omega, a * cos + b * sin, (b * cos - a * sin) * omega]
    signals = [part.sum(axis=1) for part in parts]
    largest = [np.abs(signal).max(axis=0) / limit for signal, limit in zip(signals, LIMITS)]
    position, velocity, acceleration = (signal / np.max(largest, axis=0) for signal in signals)
    return CENTRE + position, velocity, acceleration


def record(arm: Arm, motion: tuple[FloatArray, ...], law: dict[str, FloatArray], noise: float, seed: int) -> Recording:
    """What the arm's drives would report on a motion; Pinocchio's torque and the friction law written out."""
    rng = np.random.default_rng(seed)
    position, velocity, acceleration = motion
    model = pin.buildModelFromXML(arm.urdf)
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *state) for state in zip(position, velocity, acceleration)])
    level = law["f_c"] + (law["f_b"] - law["f_c"]) * np.exp(-((velocity / law["v_b"]) ** 2))
    torque += ROTOR_INERTIA * acceleration + level * np.sign(velocity)
    torque += law["k_v1"] * velocity + law["k_v2"] * velocity**2 + law["k_v3"] * velocity**3
    torque += noise * np.array([joint.effort_limit for joint in arm.joints]) * rng.normal(size=torque.shape)
    count = 2 * np.pi / 2**19
    return Recording(
        joints=arm.joint_names,
        time=np.arange(len(position)) / RATE_HZ,
        position=np.rint(position / count) * count,
        velocity=velocity + 5e-4 * rng.normal(size=velocity.shape),
        effort=torque,
        segments=(slice(0, len(position)),),
        start_ns=1_753_000_000_000_000_000,
        urdf=arm.urdf,
    )


def simulated(
    name: str, folder: Path, rounds: int, law: dict[str, FloatArray], noise: float, cutoff_hz: float | None = None
) -> Case:
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    posed = []
    for number in range(rounds):
        bags = []
        for role, seed in (("fit", 10 * number + 1), ("validation", 10 * number + 2)):
            bags.append(folder / f"{abs(hash(name))}_{number}_{role}.mcap")
            write_recording(bags[-1], record(arm, series(seed, SAMPLES), law, noise, seed + 5))
        posed.append(Round(bags[:1], bags[1], record(arm, series(10 * number + 2, SAMPLES), law, 0.0, 0)))
    return Case(name, arm, posed, cutoff_hz, law, noise)


def real(rounds: int) -> Case:
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    fit = [RECORDINGS / f"{name}.mcap" for name in ("commissioning", "commissioning_2")]
    return Case(REAL, arm, [Round(fit, RECORDINGS / "commissioning_validation.mcap")] * rounds)


class Peer:
    """A peer in its own Python: its worker takes one JSON line a request and answers with one."""

    def __init__(self, python: Path, worker: str, arm: Arm, folder: Path) -> None:
        urdf = folder / "arm.urdf"
        urdf.write_text(arm.urdf)
        self.log = (folder / f"{worker}.log").open("w+")
        self.process = subprocess.Popen(
            [python, Path(__file__).with_name(worker), urdf, folder, *arm.joint_names],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
        )
        self._answer()

    def _answer(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            self.log.seek(0)
            raise SystemExit(f"{self.process.args[1].name} ended:\n{self.log.read()[-2000:]}")
        return json.loads(line)

    def ask(self, do: str, **request: object) -> dict:
        """Have a method of the worker called, and its answer."""
        print(json.dumps({"do": do, **request}), file=self.process.stdin, flush=True)
        return self._answer()

    def close(self) -> None:
        """End the worker."""
        self.process.stdin.close()
        self.process.wait()
        self.log.close()


Answer = tuple[float, list[FloatArray]]
"""Seconds, and the torque predicted for every validation motion."""


class Field:
    """One case's contestants, set up for one round after the other."""

    def __init__(self, case: Case, figaroh: Path, mujoco: Path | None, folder: Path) -> None:
        self.case, self.folder = case, folder
        self.figaroh = Peer(figaroh, "figaroh_worker.py", case.arm, folder)
        self.mujoco = Peer(mujoco, "mujoco_worker.py", case.arm, folder) if mujoco else None

    def enter(self, posed: Round) -> None:
        """Read the bags of a round and write what the peers read."""
        joints = self.case.arm.joint_names
        self.recordings = [read_recording(bag) for bag in posed.fit]
        result = identify(self.recordings, self.case.arm, Settings(self.case.cutoff_hz))
        self.cutoff_hz = result.bandwidth.cutoff_hz
        self.motions, _ = prepare([read_recording(posed.validation)], joints, result.model.cutoff_hz)
        truth = self.motions if posed.clean is None else prepare([posed.clean], joints, result.model.cutoff_hz)[0]
        self.truth = np.concatenate([motion.torque_rows for motion in truth])
        self.noise = np.concatenate([motion.torque_rows for motion in self.motions]) - self.truth
        self.tables = [str(self.folder / f"fit_{k}.csv") for k in range(len(self.recordings))]
        for table, recording in zip(self.tables, self.recordings):
            write_csv(table, recording.in_order(joints))
        self.signals = [self._save(f"validation_{k}", motion) for k, motion in enumerate(self.motions)]
        fitted, _ = prepare(self.recordings, joints, self.cutoff_hz, average=False)
        self.fitted = [self._save(f"fitted_{k}", motion) for k, motion in enumerate(fitted)]
        self.figaroh.ask("configure", rate_hz=round(self.recordings[0].rate_hz), cutoff_hz=self.cutoff_hz)

    def _save(self, name: str, motion: Motion) -> str:
        path = self.folder / f"{name}.npz"
        state = {"q": motion.position, "qd": motion.velocity, "qdd": motion.acceleration, "tau": motion.torque}
        np.savez(path, rate_hz=motion.rate_hz, cutoff_hz=self.cutoff_hz, **state)
        return str(path)

    def contestants(self, first: bool) -> dict[str, Callable[[], Answer]]:
        """All that take part; MuJoCo in the first round only."""
        files = {"files": self.tables}
        field: dict[str, Callable[[], Answer]] = {
            "ours": self._ours,
            "figaroh": lambda: self._peer(self.figaroh, decimation=10, **files),
            "figaroh, every sample": lambda: self._peer(self.figaroh, decimation=1, **files),
            "Pinocchio + numpy": self._pinocchio,
        }
        if first and self.mujoco:
            field["mujoco.sysid"] = lambda: self._peer(self.mujoco, fit=self.fitted)
        return field

    def _ours(self) -> Answer:
        start = time.process_time()
        result = identify(self.recordings, self.case.arm, Settings(self.case.cutoff_hz))
        return time.process_time() - start, [result.model.torque(motion) for motion in self.motions]

    def _pinocchio(self) -> Answer:
        start = time.process_time()
        model = Pinocchio(self.case.arm, self.recordings, self.cutoff_hz)
        return time.process_time() - start, [model.torque(motion) for motion in self.motions]

    def _peer(self, peer: Peer, **request: object) -> Answer:
        out = self.folder / "torque.npz"
        seconds = peer.ask("identify", motions=self.signals, out=str(out), **request)["seconds"]
        torques = np.load(out)
        return seconds, [torques[str(k)] for k in range(len(self.motions))]

    def error(self, torques: list[FloatArray]) -> FloatArray:
        """(n,) RMS by joint on all rows, N·m."""
        predicted = np.concatenate([motion.reduce(torque) for motion, torque in zip(self.motions, torques)])
        return np.sqrt(np.mean((self.truth - predicted) ** 2, axis=0))

    def least(self) -> FloatArray:
        """(n,) what that RMS is at the least for an unbiased estimate, N·m."""
        limits = np.array([joint.effort_limit for joint in self.case.arm.joints])
        return least_rms(self.case.arm, self.recordings, self.motions, self.case.law, self.case.noise * limits)


def write_csv(path: str, recording: Recording) -> None:
    names = [f"{kind}{k}" for kind in ("q", "tau") for k in range(len(recording.joints))]
    table = np.column_stack([recording.time, recording.position, recording.effort])
    np.savetxt(path, table, delimiter=",", header=",".join(["t", *names]), comments="")


def compete(case: Case, figaroh: Path, mujoco: Path | None, folder: Path) -> None:
    """All rounds of a case, and its table."""
    field = Field(case, figaroh, mujoco, folder)
    seconds: dict[str, list[float]] = {}
    errors: dict[str, list[FloatArray]] = {}
    least = []
    for number, posed in enumerate(case.rounds):
        field.enter(posed)
        if case.law is not None:
            least.append(field.least())
        contestants = field.contestants(number == 0)
        if number == 0:
            for name in ("figaroh", "Pinocchio + numpy"):  # Ours has run once to find the cut-off.
                contestants[name]()
        names = list(contestants)
        for name in names if number % 2 else names[::-1]:
            taken, torques = contestants[name]()
            seconds.setdefault(name, []).append(taken)
            errors.setdefault(name, []).append(field.error(torques))
    for peer in (field.figaroh, field.mujoco):
        if peer:
            peer.close()
    samples = sum(len(recording.time) for recording in field.recordings)
    kind = "measured" if case.rounds[0].clean is None else "noiseless"
    print(f"\n### {case.name}: {samples} samples, low-pass {field.cutoff_hz:.3g} Hz, {len(case.rounds)} rounds\n")
    print(f"Validation RMS against the {kind} torque by joint, N·m: median of the rounds (worst)\n")
    print("| | CPU s | times ours | joint 1 | 2 | 3 | 4 | 5 | 6 | cannot represent |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in LIMITATIONS:
        if name in seconds:
            print(line(name, seconds, errors))
    if case.rounds[0].clean is not None:
        noise = np.sqrt(np.mean(field.noise**2, axis=0))
        print(f"\nNoise of the torque on the same rows: {listed(noise)} N·m.")
        print(f"Cramér-Rao bound: {listed(np.median(least, axis=0))} N·m.")
        verdict(seconds, errors)
    sys.stdout.flush()


def listed(values: FloatArray) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def line(name: str, seconds: dict[str, list[float]], errors: dict[str, list[FloatArray]]) -> str:
    """A row of the table."""
    ratio = np.median([a / b for a, b in zip(seconds[name], seconds["ours"])])
    middle, worst = np.median(errors[name], axis=0), np.max(errors[name], axis=0)
    cells = " | ".join(f"{a:.3f} ({b:.3f})" for a, b in zip(middle, worst))
    return f"| {name} | {np.median(seconds[name]):.3f} | {ratio:.2f} | {cells} | {LIMITATIONS[name]} |"


def verdict(seconds: dict[str, list[float]], errors: dict[str, list[FloatArray]]) -> None:
    """Whether what was to be reached is reached."""
    middle = np.median(errors["ours"], axis=0)
    reached = int(np.sum(middle <= TARGET_Nm))
    ratio = np.median([a / b for a, b in zip(seconds["ours"], seconds["figaroh"])])
    outcome = "reached" if ratio <= TARGET_TIME else "not reached"
    print(
        f"RMS of at most {TARGET_Nm} N·m in the median: {reached} of {len(middle)} joints (worst {middle.max():.3f}); "
        f"time {ratio:.2f} of figaroh's (at most {TARGET_TIME}: {outcome})."
    )


def regressors(repeats: int = 5) -> None:
    """Our regressor beside Pinocchio's, in time and numbers."""
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    state = series(1, SAMPLES)
    model = pin.buildModelFromXML(arm.urdf)
    data = model.createData()
    seconds: dict[str, list[float]] = {"ours": [], "Pinocchio in a loop": []}
    whole = np.empty((SAMPLES, 6, 60))
    for _ in range(repeats):
        start = time.process_time()
        mine = regressor(arm, *state)
        middle = time.process_time()
        for k, sample in enumerate(zip(*state)):
            whole[k] = pin.computeJointTorqueRegressor(model, data, *sample)
        seconds["ours"].append(middle - start)
        seconds["Pinocchio in a loop"].append(time.process_time() - middle)
    words = ", ".join(f"{name} {np.median(values):.4f} s" for name, values in seconds.items())
    print(f"regressor of {SAMPLES} samples: {words}; largest difference {np.abs(mine - whole).max():.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figaroh-python", type=Path, metavar="PATH", help="Python of an environment with figaroh")
    parser.add_argument("--mujoco-python", type=Path, metavar="PATH", help="Python of one with mujoco[sysid]")
    parser.add_argument("--only", default="", metavar="WORDS", help="only the cases whose name has these words")
    parser.add_argument("--rounds", type=int, default=5, help="rounds a case (default 5)")
    options = parser.parse_args()
    if options.figaroh_python is None or not options.figaroh_python.exists():
        print("skipped: give --figaroh-python, the Python of an environment with figaroh (see the head of this file)")
        return
    if not RECORDINGS.is_dir():
        print(f"skipped: the UR10e's model and recordings are not at {RECORDINGS}")
        return
    if options.mujoco_python is None:
        print("without MuJoCo: give --mujoco-python, the Python of an environment with mujoco[sysid]")
    regressors()
    with tempfile.TemporaryDirectory() as scratch:
        folder, rounds = Path(scratch), options.rounds
        cases = {
            "Stribeck friction": (STRIBECK, TORQUE_NOISE),
            "Stribeck friction, --bandwidth 12": (STRIBECK, TORQUE_NOISE, 12.0),
            "Stribeck friction, a tenth of the noise, --bandwidth 12": (STRIBECK, QUIET, 12.0),
            "Coulomb and viscous friction": (PLAIN, TORQUE_NOISE),
            REAL: (),
        }
        for name, how in cases.items():
            if options.only in name:
                case = real(rounds) if name == REAL else simulated(name, folder, rounds, *how)
                compete(case, options.figaroh_python, options.mujoco_python, folder)


if __name__ == "__main__":
    main()
