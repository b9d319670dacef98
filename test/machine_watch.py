"""Whether the machine itself kept time while a test ran.

A virtual machine may be stopped from outside, for longer than any arm forgives, and it may be slowed down, so that five
nodes with a cycle of 1 ms do not find the time on it. What fails then says nothing about the code. One process a core,
before all others (`SCHED_FIFO`), sleeps and writes down where it slept too long, and how long a few additions take; a
live test that fails while that was so is skipped with this as the reason (`conftest.py`). Where the real-time class is
not permitted it sleeps as one of all: what has slept is woken before what computes, within milliseconds.
"""

import contextlib
import os
import statistics
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

LOOP = 5_000
"""Additions whose time is taken: a third of a millisecond."""
LOOP_EVERY_S = 0.5
PACE = ".pace"
"""Suffix of the file that says how long additions took."""
SLOW_NS = 52.0
"""An addition that takes longer, ns, median of all. Where it took 65 the demo's nodes, and the kernel's work for them,
wanted 2.1 cores (driver 0.9, arm 0.8, the other three 0.4), and were held up again and again. Two cores give real-time
threads 95 % each, and what is not in real time waits its turn: 1.7 cores are what can be had in time."""


def loop_ns() -> float:
    """Time that this core takes for an addition now, ns."""
    total, begin = 0, time.perf_counter_ns()
    for k in range(LOOP):
        total += k
    return (time.perf_counter_ns() - begin) / LOOP


def addition_ns(count: int = 301) -> float:
    """The median of so many such times, ns; they take a tenth of a second."""
    return statistics.median(loop_ns() for _ in range(count))


def watch(core: int, path: Path) -> None:
    """Write begin and end (s, `time.monotonic`) of every gap on one core, until the parent has gone.

    Beside them, in a file of its own, goes how long an addition takes: when (s), and the time (ns).
    """
    parent = os.getppid()
    os.sched_setaffinity(0, {core})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with path.open("a", buffering=1) as file, path.with_suffix(PACE).open("a", buffering=1) as paces:
        before = timed = time.monotonic()
        while os.getppid() == parent:
            time.sleep(NOTED_S / 4)
            now = time.monotonic()
            if now - before > NOTED_S:
                file.write(f"{before} {now}\n")
            if now - timed > LOOP_EVERY_S:
                timed = now
                paces.write(f"{now} {loop_ns()}\n")
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

        On a machine that stood still it is run again first, as often as it is marked to be, until `PATIENT` tests have
        been excused; a slow machine is not faster a moment later.
        """
        if not item.get_closest_marker("live"):
            return ""
        failed = f"it failed ({call.excinfo.exconly().splitlines()[0]:.200})" if call.excinfo else "it failed"
        since = time.monotonic() - time.time()
        begin, end = call.start + since, call.stop + since
        if (taken_ns := self.addition_ns(begin, end)) > SLOW_NS:
            what = f"took {taken_ns:.0f} ns for an addition (at most {SLOW_NS:.0f} leave time for five nodes)"
            return f"{failed}, and the machine {what}: run it on another"
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

    def addition_ns(self, begin: float, end: float) -> float:
        """Median time of an addition, ns, between two times of `time.monotonic`; zero where none was taken."""
        notes = [note for path in self._paths.values() for note in _pairs(path.with_suffix(PACE))]
        return statistics.median([ns for when, ns in notes if begin < when < end] or [0.0])

    def close(self) -> None:
        """End them."""
        for process in self._processes:
            process.kill()
            process.wait()


if __name__ == "__main__":
    watch(int(sys.argv[1]), Path(sys.argv[2]))
