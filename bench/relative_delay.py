"""By how much later one recording's torque is than another's of the same motion, without any model.

    python bench/relative_delay.py ONE.mcap OTHER.mcap

Each signal of the second is shifted until it fits the first best (least squares, 0.3 to 10 Hz): positions tell how the
two were started, torques how they were started and how late they are. The difference is what `spacearm mismatch` calls
a time delay of the one with the other as its reference; here no model of the arm takes part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from spacearm_ident.recording import Recording, read_recording

BAND_HZ = (0.3, 10.0)
"""Band in which signals are compared: above offsets and drift, below most of the encoder's and current's noise."""
RATE_HZ = 200.0
"""Of the common grid, 20 times the band."""
MARGIN_S, FARTHEST_S, STEP_S = 2.0, 0.3, 0.005
"""Left out at either end for the filter; largest shift; step of the first search, a twentieth of the band's period."""


def shift_s(one: Recording, other: Recording, signal: str, joint: int) -> float:
    """By how much later a joint's signal, `position` or `effort`, is in the second recording."""
    time = [recording.time - recording.time[0] for recording in (one, other)]
    grid = np.arange(MARGIN_S, min(time[0][-1], time[1][-1]) - MARGIN_S, 1.0 / RATE_HZ)
    sos = butter(2, BAND_HZ, "bandpass", fs=RATE_HZ, output="sos")
    values = [getattr(recording, signal)[:, joint] for recording in (one, other)]
    wanted = sosfiltfilt(sos, np.interp(grid, time[0], values[0]))

    def cost(shift: float) -> float:
        return float(np.sum((sosfiltfilt(sos, np.interp(grid + shift, time[1], values[1])) - wanted) ** 2))

    best = min(np.arange(-FARTHEST_S, FARTHEST_S, STEP_S), key=cost)
    return float(minimize_scalar(cost, bounds=(best - 2 * STEP_S, best + 2 * STEP_S), method="bounded").x)


def main() -> None:
    one, other = (read_recording(Path(name)) for name in sys.argv[1:3])
    delays = []
    for k, joint in enumerate(one.joints):
        position, effort = (1e3 * shift_s(one, other, signal, k) for signal in ("position", "effort"))
        delays.append(effort - position)
        print(
            f"{joint}: position {position:.1f} ms, torque {effort:.1f} ms later; difference {effort - position:.1f} ms"
        )
    print(f"median {np.median(delays):.1f} ms")


if __name__ == "__main__":
    main()
