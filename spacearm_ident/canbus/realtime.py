"""Make a thread keep its deadlines, as far as the operating system lets an ordinary user."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

_PR_SET_TIMERSLACK: Final = 29
#: mlockall(2): what is mapped now and later, page by page as it is used.
_MCL_CURRENT_FUTURE_ONFAULT: Final = 1 | 2 | 4
#: Threads give way to each other within this time, s; Python's default of 5 ms is five cycles.
SWITCH_INTERVAL: Final = 5e-4
#: Priority for the other threads of a process with a cycle.
BESIDE_THE_CYCLE: Final = 10
_AUTOGROUP_NICE: Final = -10


def prepare_process() -> None:
    """Keep garbage collector and pager (where permitted) from pausing the process; let its threads switch quickly.

    What exists now is never looked at again. Call it once, after everything has been loaded; whatever runs
    afterwards must not depend on cycles being collected.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL)
    ctypes.CDLL(None).mlockall(_MCL_CURRENT_FUTURE_ONFAULT)


def prepare_thread(priority: int = 60) -> str | None:
    """Wake the calling thread on time: 1 µs of timer slack, and `SCHED_FIFO` where permitted.

    Args:
        priority: Of `SCHED_FIFO`, 1 to 99; 0 leaves the scheduling class as it is.

    Returns:
        None, or a warning for the user where the real-time class is not permitted.
    """
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1000), 0, 0, 0)
    if priority <= 0:
        return None
    try:
        # Process 0 is the calling thread.
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return (
            f"no real-time priority ({error.strerror}): cycles will be late when the machine is busy; "
            "set `rtprio` for this user in /etc/security/limits.conf"
        )
    return None


def give_way(name: str, priority: int) -> None:
    """Lower the real-time threads of this process whose name, as the kernel has it, begins with `name`.

    Args:
        name: As in /proc/PID/task/TID/comm.
        priority: Of `SCHED_FIFO`, for those that have more of it.
    """
    for task in Path("/proc/self/task").iterdir():
        # A thread may end meanwhile.
        with contextlib.suppress(OSError):
            thread = int(task.name)
            above = os.sched_getparam(thread).sched_priority > priority
            if above and (task / "comm").read_text().startswith(name):
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def come_first(pid: int) -> None:
    """Have the kernel prefer the session that a process leads to others, where this may be asked for (sched(7))."""
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid}/autogroup").write_text(str(_AUTOGROUP_NICE))


def keep_apart(pid: int, number: int) -> None:
    """Keep a process that was just started to one core; no error where the system does not permit it.

    Args:
        pid: Of the process.
        number: Of the core among those this process may use, from 0; beyond the last it begins again.
    """
    cores = sorted(os.sched_getaffinity(0))
    with contextlib.suppress(OSError):
        os.sched_setaffinity(pid, {cores[number % len(cores)]})


class Pacer:
    """Slots of a cycle on absolute deadlines, with a record of how late each began.

    Attributes:
        missed: Slots that had passed before they could begin.
        slots: Slots that began.
    """

    #: Lateness is counted in bins of 1 µs up to this many.
    BINS: Final = 5000

    def __init__(self, period: float) -> None:
        """Slots of `period` seconds, from the first `wait` on."""
        self._period_ns = round(period * 1e9)
        self._next_ns = 0
        self._lateness = np.zeros(self.BINS, dtype=np.int64)
        self.missed = 0
        self.slots = 0

    def wait(self) -> float:
        """Sleep until the next slot; skip, and count, slots that are over.

        Returns:
            How late this slot begins, s; less than the period, for a thread that is kept asleep through several slots
            begins the last of them.
        """
        now = time.monotonic_ns()
        if self._next_ns == 0:
            self._next_ns = now
        over = (now - self._next_ns) // self._period_ns
        if over > 0:
            self.missed += over
            self._next_ns += over * self._period_ns
        while now < self._next_ns:
            time.sleep((self._next_ns - now) * 1e-9)
            now = time.monotonic_ns()
        late_ns = now - self._next_ns
        self._lateness[min(late_ns // 1000, self.BINS - 1)] += 1
        over, late_ns = divmod(late_ns, self._period_ns)
        self.missed += over
        self._next_ns += (over + 1) * self._period_ns
        self.slots += 1
        return late_ns * 1e-9

    def lateness(self, quantile: float) -> float:
        """Lateness, s, that this share of the slots stayed below (resolution 1 µs); 0 before any slot."""
        counts = np.cumsum(self._lateness)
        return 1e-6 * float(np.searchsorted(counts, quantile * counts[-1])) if counts[-1] else 0.0
