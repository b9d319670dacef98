"""`each`: a function of many items on all cores, in forked processes that have what this one has in memory.

`beside`: one function in another process while this one goes on. `Ticker`: the one kind of thread that does not keep
them from it.

For work that is too much entwined with what is in memory to be handed to another process: only results cross. This
process works, too, and what its own share leaves in caches stays.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, ClassVar, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 4096
"""Items at once: their numbers wait in a pipe, which holds 64 KiB."""
NUMBER = 8
"""Bytes of a number. A read of a pipe is one operation of the kernel: no lock that a killed process might hold."""
_RESTING = threading.Lock()
"""Held while a ticker's function runs, and while this process forks."""


def each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of a function without side effects, in the order of the items.

    Where this process has threads (other than tickers), whose locks a fork would copy, or is itself one of several,
    which share the cores already, it works alone. What a process that was killed leaves undone, this one does.

    Args:
        function: Anything callable; its results are pickled.
        items: What to compute it of, begun in this order.

    Raises:
        Exception: What the function raises.
    """
    if len(items) > MOST:
        return each(function, items[:MOST]) + each(function, items[MOST:])
    helpers = min(_cores(), len(items)) - 1
    if helpers < 1:
        return [function(item) for item in items]
    numbers, end = os.pipe()
    os.write(end, b"".join(number.to_bytes(NUMBER, "little") for number in range(len(items))))
    os.close(end)
    helping = []
    for _ in range(helpers):
        helper = _started(_help, function, items, numbers)
        if helper is None:
            break
        helping.append(helper)
    done: dict[int, Result] = {}
    # After the last fork: no process but this one has other threads.
    readers = [threading.Thread(target=_collect, args=(results, done), daemon=True) for _, results in helping]
    for reader in readers:
        reader.start()
    try:
        for number in _taken(numbers):
            done[number] = function(items[number])
    except BaseException:
        for process, _ in helping:
            process.kill()
        raise
    finally:
        os.close(numbers)
        for reader in readers:
            reader.join()
        for process, _ in helping:
            process.join()
    return [done[number] if number in done else function(item) for number, item in enumerate(items)]


@contextmanager
def beside(function: Callable[[], Result]) -> Iterator[Callable[[], Result]]:
    """Compute something in a forked process while this one goes on.

    Where `each` would work alone, it is computed here before anything else.

    Args:
        function: Without side effects; its result is pickled.

    Yields:
        What waits for the result, or raises what the function raises; called once, or never: the process is then
        ended.
    """
    helper = _started(_compute, function) if _cores() > 1 else None
    if helper is None:
        known = function()
        yield lambda: known
        return
    process, results = helper
    try:
        yield partial(_received, results, function)
    finally:
        results.close()
        process.kill()
        process.join()


def _received(results: Connection, function: Callable[[], Result]) -> Result:
    """What another process computed; what it left undone is computed here, and so are its errors."""
    try:
        result: Result = results.recv()
    except (EOFError, OSError):
        return function()
    return result


def _started(target: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection] | None:
    """A forked process, given the ends of a pipe after the arguments, and the end that its results come from.

    None where no memory, or no process, is left for one more.
    """
    context = multiprocessing.get_context("fork")
    results, given = context.Pipe(duplex=False)
    process = context.Process(target=target, args=(*arguments, results, given), daemon=True)
    try:
        process.start()
    except OSError:
        results.close()
        return None
    finally:
        given.close()
    return process, results


def _cores() -> int:
    """Processes that may work at once: one where a fork would copy other threads' locks, or is one of several."""
    alone = threading.active_count() > 1 + Ticker.running or multiprocessing.parent_process() is not None
    return 1 if alone else len(os.sched_getaffinity(0))


def _taken(numbers: int) -> Iterator[int]:
    """Numbers of items that nobody has taken yet, until none is left."""
    while number := os.read(numbers, NUMBER):
        yield int.from_bytes(number, "little")


def _help(
    function: Callable[[Item], Any], items: Sequence[Item], numbers: int, results: Connection, given: Connection
) -> None:
    """In a forked process: compute until no item is left, or nobody waits for results."""
    _begin(results)
    for number in _taken(numbers):
        try:
            given.send((number, function(items[number])))
        except Exception:
            # Its item stays undone, so the first process meets the error itself.
            return


def _compute(function: Callable[[], Any], results: Connection, given: Connection) -> None:
    """In a forked process: compute one result; an error leaves it undone."""
    _begin(results)
    with given, suppress(Exception):
        given.send(function())


def _begin(results: Connection) -> None:
    """In a forked process: leave signals and the other end of the pipe to the first one."""
    # Ctrl-C goes to all processes of a terminal: the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    results.close()


def _collect(results: Connection, done: dict[int, Any]) -> None:
    """Take over results until the process that gives them ends."""
    with results:
        while True:
            try:
                number, result = results.recv()
            except (EOFError, OSError):
                return
            done[number] = result


class Ticker:
    """Calls a function regularly, from when it is entered until it is left, in a thread at rest while this one forks.

    A fork copies the locks that other threads hold, and nobody in the new process opens them.

    Args:
        function: Must not fork.
        period_s: Seconds between calls.
    """

    running: ClassVar[int] = 0
    """Tickers of this process that have been entered and not been left."""

    def __init__(self, function: Callable[[], object], period_s: float) -> None:
        self._function, self._period_s = function, period_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ticker", daemon=True)

    def __enter__(self) -> Ticker:
        Ticker.running += 1
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()
        Ticker.running -= 1

    def _run(self) -> None:
        while not self._over.wait(self._period_s):
            with _RESTING:
                self._function()


def _in_child() -> None:
    """No thread but the one that forked is left."""
    Ticker.running = 0
    _RESTING.release()


os.register_at_fork(before=_RESTING.acquire, after_in_parent=_RESTING.release, after_in_child=_in_child)
