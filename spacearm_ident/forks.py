"""`each`: a function of many items on all cores, in forked processes that have what this one has in memory.

For work that is too much entwined with what is in memory to be handed to another process: only results cross. This
process works, too, and what its own share leaves in caches stays.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 4096
"""Items at once: their numbers wait in a pipe, which holds 64 KiB."""
NUMBER = 8
"""Bytes of a number. A read of a pipe is one operation of the kernel: no lock that a killed process might hold."""


def each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of a function without side effects, in the order of the items.

    Where this process has other threads, whose locks a fork would copy, or is itself one of several, which share the
    cores already, it works alone. What a process that was killed leaves undone, this one does.

    Args:
        function: Anything callable; its results are pickled.
        items: What to compute it of, begun in this order.

    Raises:
        Exception: What the function raises.
    """
    if len(items) > MOST:
        return each(function, items[:MOST]) + each(function, items[MOST:])
    helpers = min(len(os.sched_getaffinity(0)), len(items)) - 1
    if helpers < 1 or threading.active_count() > 1 or multiprocessing.parent_process() is not None:
        return [function(item) for item in items]
    context = multiprocessing.get_context("fork")
    numbers, end = os.pipe()
    os.write(end, b"".join(number.to_bytes(NUMBER, "little") for number in range(len(items))))
    os.close(end)
    helping = []
    for _ in range(helpers):
        results, given = context.Pipe(duplex=False)
        process = context.Process(target=_help, args=(function, items, numbers, results, given), daemon=True)
        try:
            process.start()
        except OSError:
            # No memory, or no process, is left for one more.
            results.close()
            break
        finally:
            given.close()
        helping.append((process, results))
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


def _taken(numbers: int) -> Iterator[int]:
    """Numbers of items that nobody has taken yet, until none is left."""
    while number := os.read(numbers, NUMBER):
        yield int.from_bytes(number, "little")


def _help(
    function: Callable[[Item], Any], items: Sequence[Item], numbers: int, results: Connection, given: Connection
) -> None:
    """In a forked process: compute until no item is left, or nobody waits for results."""
    # Ctrl-C goes to all processes of a terminal: the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    results.close()
    for number in _taken(numbers):
        try:
            given.send((number, function(items[number])))
        except Exception:
            # Its item stays undone, so the first process meets the error itself.
            return


def _collect(results: Connection, done: dict[int, Any]) -> None:
    """Take over results until the process that gives them ends."""
    with results:
        while True:
            try:
                number, result = results.recv()
            except (EOFError, OSError):
                return
            done[number] = result
