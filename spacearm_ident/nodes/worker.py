"""A job in a separate process, so that a crash or a long computation there does not stop the node.

`Worker` starts the process (spawned: it inherits nothing of ROS) and collects its messages; the node reads them with
`poll`, and there are no callbacks. The process ends with its parent, even one that was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import sys
import threading
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection

from ..blas_threads import one_thread
from ..errors import UnfitDataError, UserError
from .jobs import Compared, Done, Job

UNFIT, USAGE, CRASHED = 1, 2, 3
_ENDING_S = 2.0
_NICENESS = 10


@dataclass(frozen=True)
class Step:
    """Progress: share done in 0..1, and what is being done."""

    share: float
    what: str


@dataclass(frozen=True)
class Failed:
    """No result: why, and the exit code that means it (`UNFIT`, `USAGE`, `CRASHED`)."""

    reason: str
    code: int


Event = Step | Done | Compared | Failed


class Worker:
    """One job in its own process, from the constructor to `Done`, `Compared` or `Failed` from `poll`."""

    def __init__(self, job: Job) -> None:
        one_thread()
        self._name = job.name
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), name=job.name, daemon=True)
        # Starting takes long (imports) and the job is large (a run's data): a thread waits, not the node.
        self._thread = threading.Thread(target=self._collect, args=([job], theirs), daemon=True)
        self._thread.start()

    def poll(self) -> list[Event]:
        """What the process said since the last time."""
        events = []
        while not self._events.empty():
            events.append(self._events.get())
        return events

    def stop(self) -> None:
        """End the process, whatever it is doing; returns when it is gone."""
        if self._process.pid is not None:
            self._process.terminate()
        self._thread.join(_ENDING_S)
        if self._process.pid is not None and self._process.is_alive():
            self._process.kill()
            self._thread.join(_ENDING_S)

    def _collect(self, jobs: list[Job], theirs: Connection) -> None:
        """Start, hand over the one job (and keep no hold of its data), pass on what is said until the end."""
        last: Event = Step(0.0, "starting")
        # The process inherits it: Ctrl-C goes to all, and must not end this one while it is still importing.
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self._process.start()
            theirs.close()
            self._ours.send(jobs.pop())
            while isinstance(last, Step):
                last = self._ours.recv()
                self._events.put(last)
        except (EOFError, OSError) as error:
            reason = f"the {self._name} could not be started: {error}"
            if self._process.pid is not None:
                self._process.join()
                how = _how_it_ended(self._process.exitcode)
                reason = f"the {self._name} process {how} while {getattr(last, 'what', 'starting')}: try again"
            self._events.put(Failed(reason, CRASHED))
        finally:
            self._ours.close()
            if self._process.pid is not None:
                self._process.join()


def _how_it_ended(code: int | None) -> str:
    if code is not None and code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with code {code}"


def _work(connection: Connection) -> None:
    """Main function of the process: receive a `Job`, do it, report, end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the node decides what becomes of this.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(CRASHED))  # Unwinds: no half-written folder stays behind.
    os.nice(_NICENESS)
    try:
        job: Job = connection.recv()
    except EOFError:
        return
    threading.Thread(target=_end_with_parent, args=(connection,), daemon=True).start()
    try:
        answer: Event = job.perform(lambda share, what: connection.send(Step(share, what)))
    except UnfitDataError as error:
        answer = Failed(str(error), UNFIT)
    except UserError as error:
        answer = Failed(str(error), USAGE)
    except Exception as error:
        traceback.print_exc()
        answer = Failed(f"the {job.name} broke: {type(error).__name__}: {error}", CRASHED)
    connection.send(answer)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # Who asked has closed the pipe; this process ends by itself.


def _end_with_parent(connection: Connection) -> None:
    """Nothing is ever sent after the job: the end of the pipe is the end of the parent."""
    try:
        connection.recv()
    except (EOFError, OSError):
        os.kill(os.getpid(), signal.SIGTERM)
