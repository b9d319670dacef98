"""An identification in a process of its own: the node that asks for it goes on living, whatever happens there.

`Worker` starts the process (spawned: nothing of ROS is inherited) and collects what it says; the node asks with
`poll`, and nothing here calls back. The process ends with its parent, even one that was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import shlex
import signal
import sys
import threading
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from ..errors import UnfitDataError, UserError
from ..identification.identified import Identified
from ..identification.identify import Progress
from ..recording import describe
from ..session import AUTO, Session, find_arm, identify_session, read_bags, settings_for, within
from .message_buffer import Capture, write_captures

UNFIT, USAGE, CRASHED = 1, 2, 3
_ENDING_S = 2.0
_NICENESS = 10


@dataclass(frozen=True)
class Job:
    """What to identify, in words that cross to another process.

    Attributes:
        fitted, validated: Bags; `validated` may be empty (hold-out) or `fitted` again (no hold-out).
        directory: Result folder.
        arm: URDF or arm YAML; None: of the bags' `/robot_description`.
        gravity: (3,) m/s^2 instead of the arm's; None: the arm's.
        friction, cutoff_hz, structure: As `session.settings_for`.
        captures: Written to `bag` before anything else.
        bag: Where to.
        known: Identification of `fitted`, where there is one.
    """

    fitted: tuple[Path, ...]
    validated: tuple[Path, ...]
    directory: Path
    arm: Path | None = None
    gravity: tuple[float, float, float] | None = None
    friction: str = AUTO
    cutoff_hz: float | None = None
    structure: Path | None = None
    captures: tuple[Capture, ...] = ()
    bag: Path | None = None
    known: Identified | None = None

    @property
    def command(self) -> str:
        """The offline command that does the same."""
        words = ["spacearm", "identify", *map(str, self.fitted)]
        if self.validated:
            words += ["--validate", *map(str, self.validated)]
        if self.arm is not None:
            words += ["--arm", str(self.arm)]
        if self.gravity is not None:
            words += ["--gravity", *(f"{value:g}" for value in self.gravity)]
        if self.friction != AUTO:
            words += ["--friction", self.friction]
        if self.structure is not None:
            words += ["--structure", str(self.structure)]
        if self.cutoff_hz is not None:
            words += ["--bandwidth", f"{self.cutoff_hz:g}"]
        return shlex.join([*words, "--out", str(self.directory)])


@dataclass(frozen=True)
class Step:
    """Progress: share done in 0..1, and what is being done."""

    share: float
    what: str


@dataclass(frozen=True)
class Done:
    """The result, and what was found in the recordings, a line each."""

    session: Session
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Failed:
    """No result: why, and the exit code that means it (`UNFIT`, `USAGE`, `CRASHED`)."""

    reason: str
    code: int


Event = Step | Done | Failed


class Worker:
    """One identification in its own process, from the constructor to a `Done` or `Failed` from `poll`."""

    def __init__(self, job: Job) -> None:
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), name="identification", daemon=True)
        # Starting takes long (imports) and the job is large (a run's data): a thread waits, not the node.
        self._thread = threading.Thread(target=self._collect, args=([job], theirs), daemon=True)
        self._thread.start()

    @property
    def process_id(self) -> int | None:
        """Of the process, once it has started."""
        return self._process.pid

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
        try:
            self._process.start()
            theirs.close()
            self._ours.send(jobs.pop())
            while isinstance(last, Step):
                last = self._ours.recv()
                self._events.put(last)
        except (EOFError, OSError) as error:
            reason = f"the identification could not be started: {error}"
            if self._process.pid is not None:
                self._process.join()
                how = _how_it_ended(self._process.exitcode)
                reason = f"the identification process {how} while {getattr(last, 'what', 'starting')}: try again"
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
    """The process: receive a `Job`, report, end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the node decides what becomes of this.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(CRASHED))  # Unwinds: no half-written folder stays behind.
    os.nice(_NICENESS)
    try:
        job: Job = connection.recv()
    except EOFError:
        return
    threading.Thread(target=_end_with_parent, args=(connection,), daemon=True).start()
    try:
        answer: Event = perform(job, lambda share, what: connection.send(Step(share, what)))
    except UnfitDataError as error:
        answer = Failed(str(error), UNFIT)
    except UserError as error:
        answer = Failed(str(error), USAGE)
    except Exception as error:
        traceback.print_exc()
        answer = Failed(f"the identification broke: {type(error).__name__}: {error}", CRASHED)
    connection.send(answer)


def _end_with_parent(connection: Connection) -> None:
    """Nothing is ever sent after the job: the end of the pipe is the end of the parent."""
    try:
        connection.recv()
    except (EOFError, OSError):
        os.kill(os.getpid(), signal.SIGTERM)


def perform(job: Job, progress: Progress) -> Done:
    """Do a job; what `spacearm identify` does, from the same bags.

    Raises:
        UserError: As `identify_session`.
    """
    if job.bag is not None:
        progress(0.0, "writing the recording")
        write_captures(job.bag, job.captures)
    fitted = read_bags(job.fitted, within(progress, 0.05, 0.2))
    again = job.validated == job.fitted
    validated = fitted if again else read_bags(job.validated, within(progress, 0.2, 0.3))
    recordings = [*fitted, *(() if again else validated)]
    arm = find_arm(job.arm, job.gravity, recordings)
    session = identify_session(
        fitted,
        validated,
        arm,
        settings_for(arm, job.friction, job.cutoff_hz, job.structure),
        job.directory,
        command=job.command,
        known=job.known,
        progress=within(progress, 0.3, 1.0),
    )
    return Done(session, tuple(line for recording in recordings for line in describe(recording)))
