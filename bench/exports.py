"""MJCF and C of identified arms on held-out recordings: `python bench/exports.py [DIR of recordings]`.

Per joint where it moves: residual over torque of model.yaml, of MuJoCo's inverse dynamics, and the cost that export
stated, in per cent; then the time of a call of the C code's torque.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.export.law import SLOW_SHARE
from spacearm_ident.export.motion import motions_of, sweep
from spacearm_ident.export.write import export_model, read_result
from spacearm_ident.sessions.bags import Options, identify_bags

ARMS = {
    "ur10e": ("commissioning.mcap", "commissioning_validation.mcap"),
    "panda": ("run_1.mcap", "run_2.mcap"),
}
CALLS = 1_000_000
TIMER = """
#include <stdio.h>
#include <time.h>
#include "@.h"
int main(void) {
  double q[@N], v[@N], a[@N], tau[@N], sum = 0;
  struct timespec begin, end;
  for (int i = 0; i < @N; i++) q[i] = v[i] = a[i] = 0.1 * (i + 1);
  clock_gettime(CLOCK_MONOTONIC, &begin);
  for (int k = 0; k < CALLS; k++) { q[0] += 1e-7; @_torque(q, v, a, tau); sum += tau[0]; }
  clock_gettime(CLOCK_MONOTONIC, &end);
  double seconds = end.tv_sec - begin.tv_sec + 1e-9 * (end.tv_nsec - begin.tv_nsec);
  printf("%.2f us a call (%g)\\n", seconds * 1e6 / CALLS, sum);
  return 0;
}
"""


def inverse(path: Path, motion) -> np.ndarray:
    """(N, n) torque that MuJoCo's inverse dynamics asks of the motors, N m."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(model)
    torque = np.empty_like(motion.position)
    for k in range(len(torque)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.position[k], motion.velocity[k], motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


def table(name, model, validation, motions, measured, folder: Path) -> None:
    """Print the lines of an arm."""
    fit, _ = export_model(model, validation, "mjcf", folder / f"{name}.xml", name)
    speed = np.abs(np.concatenate([motion.velocity for motion in motions]))
    moving = speed > SLOW_SHARE * speed.max(axis=0)

    def share(predicted) -> np.ndarray:
        left = np.concatenate(predicted) - measured
        return 100 * np.sqrt((left**2 * moving).sum(axis=0) / (measured**2 * moving).sum(axis=0))

    own = share([model.torque(motion) for motion in motions])
    theirs = share([inverse(folder / f"{name}.xml", motion) for motion in motions])
    for k, joint in enumerate(fit.cost_Nm):
        stated = 100 * fit.cost_Nm[joint] / fit.torque_Nm[joint]
        within = theirs[k] <= own[k] + stated + 2.0
        print(f"{name:6} {joint:22} model {own[k]:5.2f}  MuJoCo {theirs[k]:5.2f}  stated {stated:5.2f}  {within}")


def timing(model, folder: Path) -> None:
    """Compile the C code with a loop around it, and run it."""
    if shutil.which("cc") is None:
        return
    _, files = export_model(model, None, "c", folder, "bench")
    name, n = files[0].stem, len(model.model.arm.joints)
    text = TIMER.replace("CALLS", str(CALLS)).replace("@N", f"{name.upper()}_N").replace("@", name)
    (folder / "main.c").write_text(text)
    words = ["cc", "-std=gnu99", "-O2", "main.c", f"{name}.c", "-o", "timer", "-lm"]
    subprocess.run(words, cwd=folder, check=True)
    print(f"C of {name}, {n} joints: {subprocess.run(['./timer'], cwd=folder, capture_output=True, text=True).stdout}")


def main() -> None:
    """All arms."""
    top = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/recordings/real")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, (fitted, held_out) in ARMS.items():
            identify_bags([top / name / fitted], [top / name / held_out], folder / name, Options())
            model, validation = read_result(folder / name)
            motions = motions_of(model, validation)
            measured = np.concatenate([motion.torque for motion in motions])
            table(name, model, validation, motions, measured, folder)
            timing(model, folder)
        model = load_model(config_path("paper_arm_model.yaml"))
        motion = sweep(model.model.arm)
        other = replace(motion, velocity=0.6 * motion.velocity, acceleration=0.36 * motion.acceleration)
        table("paper", model, None, [other], model.torque(other), folder)
        timing(model, folder)


if __name__ == "__main__":
    main()
