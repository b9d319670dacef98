"""A driver that is held up in motion, again and again: does the arm go on?

    python bench/bench_stalls.py [--runs 21] [--extrapolation 0.06] [--share 1.0]

Driver and simulated arm are processes, as in `test/test_driver_node.py`; joints swing out and back once in 2.4 s at
up to 0.97 of their acceleration limits (`--share` of it), and SIGSTOP takes the driver off the processor for 15, 30
or 45 ms on the way. Prints a line a run: the stall, the stalls bridged and the cycles missed so far, what stopped the
arm.
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

STALLS_S = (0.015, 0.03, 0.045)
REACH = 0.35 * np.array([1.2, 1.0, 1.2, 1.6, 1.6, 2.0])
PERIOD_S = 2.4
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=21)
    parser.add_argument("--extrapolation", type=float, default=0.06, help="of the drives, s; 0: they stand at once")
    parser.add_argument("--share", type=float, default=1.0, help="of the reach")
    options = parser.parse_args()
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
