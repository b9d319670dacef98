"""The same function on many tasks at once: on the cores of this machine, or on a Dask cluster.

What a task costs its process stays with that task: when a process dies (out of memory, killed), the tasks that were
under way are tried again one at a time, and the one that kills its process again is given up, the others go on.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from ..blas_threads import VARIABLES
from ..errors import UserError

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECT_S = 10.0
KILLED = "its process was killed (out of memory?): try fewer --jobs, or a shorter recording"


@dataclass(frozen=True)
class Lost:
    """No result: the process that should have given it is gone."""

    reason: str


Outcomes = Iterator[tuple[Task, Result | Lost]]


def on_cores(perform: Callable[[Task], Result], tasks: Sequence[Task], jobs: int) -> Outcomes[Task, Result]:
    """Results of `perform` as they come, from `jobs` processes with one BLAS thread each.

    Args:
        perform: A function of a module; it and its tasks cross to other processes.
        tasks: What to do.
        jobs: How many at a time.

    Yields:
        Each task once, with its result; `Lost` where its process died twice, alone the second time.
    """
    waiting = list(tasks)
    while waiting:
        suspects: list[Task] = []
        for task, result in _pool_run(perform, waiting, jobs):
            if isinstance(result, Lost):
                suspects.append(task)
            else:
                yield task, result
        for task in suspects:
            yield from _pool_run(perform, [task], 1)


def _pool_run(perform: Callable[[Task], Result], waiting: list[Task], jobs: int) -> Outcomes[Task, Result]:
    """Take tasks from `waiting` until none is left or the pool breaks; then those under way are `Lost`."""
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    with _one_thread_each():
        pool = ProcessPoolExecutor(min(jobs, len(waiting)), context, _begin)
        under_way: dict[Future[Result], Task] = {}
        broken = False
        try:
            while under_way or (waiting and not broken):
                # No more than can run: whatever is handed over when a process dies is under suspicion.
                while waiting and not broken and len(under_way) < jobs:
                    try:
                        under_way[pool.submit(perform, waiting[0])] = waiting[0]
                        waiting.pop(0)
                    except BrokenProcessPool:
                        broken = True
                for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                    task = under_way.pop(future)
                    try:
                        result: Result | Lost = future.result()
                    except BrokenProcessPool:
                        broken, result = True, Lost(KILLED)
                    yield task, result
        finally:
            if under_way:  # Interrupted: nobody will hear what these are at.
                for process in set(multiprocessing.active_children()) - others:
                    process.terminate()
            pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """A process: Ctrl-C ends it without a word, and so does the end of the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started inside have one BLAS thread: they read the number when numpy is imported, and so must we."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_ALONE = threading.Lock()


def _alone(perform: Callable[[Task], Result], task: Task) -> Result:
    """Perform in one thread only of a worker that has several: figures are drawn in global state."""
    with _ALONE:
        return perform(task)


def on_cluster(perform: Callable[[Task], Result], tasks: Sequence[Task], address: str) -> Outcomes[Task, Result]:
    """Results of `perform` as they come, from the workers of a Dask cluster.

    Args:
        perform: A function of a module that the workers can import.
        tasks: What to do.
        address: Of the scheduler, such as `tcp://host:8786`.

    Yields:
        Each task once, with its result; `Lost` where the cluster gave it up.

    Raises:
        UserError: dask.distributed is not installed, or nobody answers at the address.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error) or type(error).__name__
        raise UserError(f"no Dask scheduler at {address} ({reason}): start one with 'dask scheduler'") from error
    with client:
        futures = {client.submit(_alone, perform, task, pure=False): task for task in tasks}
        for future in distributed.as_completed(list(futures), loop=client.loop):
            try:
                result: Result | Lost = future.result()
            except Exception as error:  # KilledWorker, a scheduler that is gone, a worker without this package
                result = Lost(f"the cluster gave it up ({type(error).__name__}: {error})")
            yield futures[future], result


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise UserError("--scheduler needs dask.distributed: pip install 'spacearm_ident[dask]'") from error
    return distributed
