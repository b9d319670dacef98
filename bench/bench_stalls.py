"""A driver that is held up in motion, again and again: does the arm go on?

    python bench/bench_stalls.py [--runs 21] [--extrapolation 0.06] [--share 1.0]
    python bench/bench_stalls.py --run excitation.yaml

Driver and simulated arm are processes, as in `test/test_driver_node.py`; joints swing out and back once in 2.4 s at
up to 0.97 of their acceleration limits (`--share` of it), and SIGSTOP takes the driver off the processor for 15, 30
or 45 ms on the way. Prints a line a run: the stall, the stalls bridged and the cycles missed so far, what stopped the
arm.

With `--run` nothing keeps time: playback, drives and arm are computed cycle by cycle, the driver held up every 0.7 s of
the run, and what is printed is the largest share of each of the monitor's limits.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
import driven_arm
from simulated_arm import paper_arm

from spacearm_ident.config import config_path
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.driver.playback import Playback
from spacearm_ident.driver.safety import Margins, MotionMonitor
from spacearm_ident.driver.set_points import SetPointStream
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.simulation.drives.motion import Motion
from spacearm_ident.simulation.live_arm import LiveArm

STALLS_S = (0.015, 0.03, 0.045)
REACH = 0.35 * np.array([1.2, 1.0, 1.2, 1.6, 1.6, 2.0])
PERIOD_S = 2.4
DELAY_S, START_NS = 0.2, 1_700_000_000_000_000_000
SETTLED_MS, LONGEST_MS = 300, 16_000
AT_S = 1.4
"""From the first set-point's sending; they are played 0.4 s after their stamps."""


def swing(arm: driven_arm.DrivenArm, stall_s: float, reach: np.ndarray) -> str:
    """One swing with a stall; what has stopped the arm, or nothing."""
    arm.healthy()
    arm.probe.spin(0.5)
    # A run that was stopped left the arm on the way: back, not on.
    reach = np.where(arm.position() > 0.02, -reach, reach)
    begin, waiting = time.monotonic(), [stall_s]

    def until() -> bool:
        if waiting and time.monotonic() - begin > AT_S:
            arm.driver.send_signal(signal.SIGSTOP)
            time.sleep(waiting.pop())
            arm.driver.send_signal(signal.SIGCONT)
        return bool(arm.fault)

    arm.stream(PERIOD_S, lambda t: reach * driven_arm.smooth(t, amplitude=1.0, period=PERIOD_S), until=until)
    arm.probe.spin(2.4)
    return str(arm.fault)


def shares(points: np.ndarray, stalls: dict[int, int], extrapolation: float) -> np.ndarray:
    """(3, n) largest share of the monitor's limits of velocity, acceleration and torque.

    Args:
        points: (T, n) set-points at 1 kHz.
        stalls: Millisecond -> length of the stall that begins then, ms.
        extrapolation: Of the drives, s.
    """
    config = load_arm_can(config_path("paper_arm_can.yaml"))
    limits, yes = config.limits, np.ones(points.shape[1], dtype=bool)
    arm = LiveArm(paper_arm(), config.arm, position=points[0])
    drives = [Motion(extrapolation) for _ in points[0]]
    for drive, angle in zip(drives, points[0].tolist(), strict=True):
        drive.hold(angle)
    monitor, stream = MotionMonitor(limits), SetPointStream(limits, points[0], DELAY_S)
    playback, target, last, until = Playback(1e-3, extrapolation), None, -1, 0
    largest, margins = np.zeros((3, points.shape[1])), Margins()
    allowed = (margins.velocity * limits.velocity, margins.acceleration * limits.acceleration, limits.torque)
    for k, point in enumerate(points):
        now = START_NS + k * 1_000_000
        if (fault := stream.put(now, point, now)) is not None:
            raise SystemExit(f"the run is no run of this arm: {fault}")
        until = max(until, k + stalls.get(k, 0))
        if k >= until:
            for drive, angle in zip(drives, [] if target is None else target.tolist(), strict=target is not None):
                drive.follow(angle, 1e-3, 1e-3 * (k - last - 1))
            target, last = playback.target(stream, now), k
            monitor.observe(1e-3 * k, arm.position, arm.torque, yes)
            seen = (monitor._velocity, monitor._acceleration, monitor._torque.mean(axis=0))
            if k > SETTLED_MS:
                largest = np.maximum(
                    largest, [np.abs(value) / limit for value, limit in zip(seen, allowed, strict=True)]
                )
        for drive in drives:
            drive.advance(1e-3)
        arm.step(np.array([drive.demand for drive in drives]), yes, ~yes, 1e-3)
    return largest


def computed(path: Path, extrapolation: float) -> None:
    """Print the shares of a run with no stall, and with stalls of several lengths."""
    run = load_trajectory(path)
    points = run.evaluate(1e-3 * np.arange(min(round(1e3 * run.duration_s), LONGEST_MS))).q
    for stall in (0, 15, 30, 45, 59):
        worst = np.zeros((3, points.shape[1]))
        for first in (2500, 2850) if stall else (2500,):
            stalls = {k: stall for k in range(first, len(points) - 600, 700)} if stall else {}
            worst = np.maximum(worst, shares(points, stalls, extrapolation))
        print(f"{stall:>2} ms  velocity {worst[0].max():.2f}  acceleration {worst[1].max():.2f}  ", end="")
        print(f"torque {worst[2].max():.2f} (joint {worst[2].argmax() + 1})", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=21)
    parser.add_argument("--extrapolation", type=float, default=0.06, help="of the drives, s; 0: they stand at once")
    parser.add_argument("--share", type=float, default=1.0, help="of the reach")
    parser.add_argument("--run", type=Path, help="an excitation file: computed instead")
    options = parser.parse_args()
    if options.run is not None:
        computed(options.run, options.extrapolation)
        return 0
    went_on = 0
    with tempfile.TemporaryDirectory() as folder:
        arm = driven_arm.DrivenArm(Path(folder), extrapolation_s=options.extrapolation)
        try:
            for run in range(options.runs):
                stall_s = STALLS_S[run % len(STALLS_S)]
                fault = swing(arm, stall_s, options.share * REACH)
                went_on += not fault
                counts = [arm.values.get(key) for key in ("stalls_bridged", "missed_cycles")]
                print(
                    f"{1e3 * stall_s:.0f} ms  {counts[0]} bridged  {counts[1]} missed  {fault or 'went on'}", flush=True
                )
        finally:
            arm.close()
    print(f"{went_on} of {options.runs} went on")
    return 0


if __name__ == "__main__":
    sys.exit(main())
