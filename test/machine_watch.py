"""Whether the machine itself kept time while a test ran.

A virtual machine may be stopped from outside, for longer than any arm forgives. What fails then says nothing about the
code. One process a core, before all others (`SCHED_FIFO`), sleeps and writes down where it slept too long; a live test
that fails again and again while that was so is skipped with this as the reason (`conftest.py`). Where the real-time
class is not permitted it sleeps as one of all: what has slept is woken before what computes, within milliseconds.

A machine that is slow throughout excuses nothing: the tests' arm has a cycle that it keeps all the same (`driven_arm`).
"""

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

PRIORITY = 90
"""Above that of every thread of ours (`canbus.realtime.prepare_thread`): what holds this up, they did not."""
NOTED_S = 0.02
"""Gaps from this on are written down: ten times what a core without a real-time kernel takes to wake a thread."""
WINDOW_S = 1.0
LOST_S = 0.1
"""A core that stood still for so long of one `WINDOW_S` did not keep time: half the delay after which the driver plays
set-points (0.2 s), whose other half are its nodes' own."""


def watch(core: int, path: Path) -> None:
    """Write begin and end (s, `time.monotonic`) of every gap on one core, until the parent has gone."""
    parent = os.getppid()
    os.sched_setaffinity(0, {core})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with path.open("a", buffering=1) as file:
        before = time.monotonic()
        while os.getppid() == parent:
            time.sleep(NOTED_S / 4)
            now = time.monotonic()
            if now - before > NOTED_S:
                file.write(f"{before} {now}\n")
            before = now


def most_lost(gaps: list[tuple[float, float]], begin: float, end: float) -> float:
    """Longest time, s, that these gaps (begin, end) take of any `WINDOW_S` that begins with one, from begin to end."""
    inside = [gap for gap in gaps if begin < gap[1] and gap[0] < end]
    return max((sum(b - a for a, b in inside if first <= a < first + WINDOW_S) for first, _ in inside), default=0.0)


def _pairs(path: Path) -> list[tuple[float, float]]:
    """What is in a file of notes."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [(float(a), float(b)) for a, b in (line.split() for line in lines)]


PATIENT = 3
"""So many tests are run again in vain, those after them no more: each waits half a minute for what never comes."""


class MachineWatch:
    """The watching processes."""

    def __init__(self, folder: Path):
        """Start them; their notes go into a folder."""
        self._excused = 0
        self._paths = {core: folder / f"core_{core}" for core in os.sched_getaffinity(0)}
        self._processes = [
            subprocess.Popen([sys.executable, __file__, str(core), str(path)], stderr=subprocess.DEVNULL)
            for core, path in self._paths.items()
        ]

    def excuse(self, item, call) -> str:
        """Why a live test that failed (pytest's item and phase) is not to be judged; empty where it is, or run again.

        It is run again first, as often as it is marked to be, until `PATIENT` tests have been excused.
        """
        if not item.get_closest_marker("live"):
            return ""
        failed = f"it failed ({call.excinfo.exconly().splitlines()[0]:.200})" if call.excinfo else "it failed"
        since = time.monotonic() - time.time()
        begin, end = call.start + since, call.stop + since
        again = item.get_closest_marker("flaky")
        last = again is None or getattr(item, "execution_count", 1) > again.kwargs["reruns"]
        if not last and self._excused < PATIENT:
            return ""
        lost_s = self.lost_s(begin, end)
        if lost_s < LOST_S:
            return ""
        self._excused += 1
        return f"{failed}, and the machine stood still for {lost_s:.2f} s of one second meanwhile: run it on another"

    def lost_s(self, begin: float, end: float) -> float:
        """How long the machine stood still at most, s of one `WINDOW_S`, between two times of `time.monotonic`."""
        time.sleep(NOTED_S)
        return max(most_lost(_pairs(path), begin, end) for path in self._paths.values())

    def close(self) -> None:
        """End them."""
        for process in self._processes:
            process.kill()
            process.wait()


if __name__ == "__main__":
    watch(int(sys.argv[1]), Path(sys.argv[2]))
