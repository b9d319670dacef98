"""Time and memory of `spacearm identify` by the length of a recording, up to 20 minutes of six joints at 1 kHz.

    python bench/growth.py --cache /tmp/growth

A simulated UR10e with Stribeck friction on sines that never repeat together, so that no periods can be averaged.
Every identification is a process of its own; time is its CPU time, memory its largest resident set. The bare start of
the program and the reading of the same bag are measured beside it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from peers import CENTRE, RATE_HZ, RECORDINGS, STRIBECK, TORQUE_NOISE, record

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.recording import write_recording

SIZES = (10_000, 30_000, 100_000, 300_000, 1_200_000)
READ = "import sys; from spacearm_ident.recording import read_recording; read_recording(sys.argv[1])"


def sines(samples: int, seed: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration: five sines a joint, 0.08 to 0.6 Hz, without a common period."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.08, 0.6, (5, 6))
    amplitude, phase = rng.uniform(0.15, 0.5, (5, 6)) / np.sqrt(omega), rng.uniform(0, 2 * np.pi, (5, 6))
    time_s = np.arange(samples) / RATE_HZ
    position, velocity, acceleration = np.tile(CENTRE, (samples, 1)), np.zeros((samples, 6)), np.zeros((samples, 6))
    for own, size, start in zip(omega, amplitude, phase):
        angle = own * time_s[:, None] + start
        position += size * np.sin(angle)
        velocity += size * own * np.cos(angle)
        acceleration -= size * own**2 * np.sin(angle)
    return position, velocity, acceleration


def bag_of(arm: Arm, samples: int, folder: Path) -> Path:
    """A bag of so many samples, written unless it is there."""
    path = folder / f"run_{samples}.mcap"
    if not path.exists():
        write_recording(path, record(arm, sines(samples), STRIBECK, TORQUE_NOISE, 3))
    return path


def cost(*command: str | Path) -> tuple[float, float]:
    """CPU seconds and largest resident set, MB, of a command."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(map(str, command))} failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep the bags here for another time")
    parser.add_argument("--samples", type=int, nargs="+", default=SIZES, help="lengths (default: 10 s to 20 min)")
    options = parser.parse_args()
    if not RECORDINGS.is_dir():
        print(f"skipped: the UR10e's model is not at {RECORDINGS}")
        return
    arm = arm_from_urdf((RECORDINGS / "arm.urdf").read_text())
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.cache or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        judged = bag_of(arm, min(SIZES), folder)
        start = cost("-m", "spacearm_ident.cli.main", "identify", "--help")
        print(f"start of the program: {start[0]:.1f} s, {start[1]:.0f} MB\n")
        print("| samples | minutes | reading, s | reading, MB | identify, s | identify, MB | time grows as N to the |")
        print("|---|---|---|---|---|---|---|")
        before: tuple[int, float] | None = None
        for samples in options.samples:
            bag = bag_of(arm, samples, folder)
            command = ("-m", "spacearm_ident.cli.main", "identify", bag, "--validate", judged, "--out", folder / "out")
            read, whole = cost("-c", READ, bag), cost(*command)
            power = np.log(whole[0] / before[1]) / np.log(samples / before[0]) if before else np.nan
            print(
                f"| {samples} | {samples / RATE_HZ / 60:.2g} | {read[0]:.1f} | {read[1]:.0f} | {whole[0]:.1f} "
                f"| {whole[1]:.0f} | {power:.2f} |",
                flush=True,
            )
            before = samples, whole[0]


if __name__ == "__main__":
    main()
