"""`forks`: the results of work in several processes, whatever happens to those that help."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import threading
import time

import pytest

from spacearm_ident.forks import MOST, Ticker, beside, each

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


@pytest.fixture
def alone(monkeypatch):
    """As in a process of its own: the threads of test runners wait, and hold no lock that a fork would copy."""
    monkeypatch.setattr(threading, "active_count", lambda: 1)


TWO_CORES = pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: nothing is shared")


def test_results_are_in_the_order_of_the_items(alone):
    factor = 3
    assert each(lambda item: factor * item, range(2 * MOST + 5)) == [3 * item for item in range(2 * MOST + 5)]
    assert each(lambda item: item, []) == []


@TWO_CORES
def test_other_processes_take_their_share(alone):
    def where(_: int) -> int:
        time.sleep(0.02)
        return os.getpid()

    assert len(set(each(where, range(20)))) > 1


@TWO_CORES
def test_what_this_process_computes_stays_in_its_memory(alone):
    kept: dict[int, int] = {}

    def keep(item: int) -> int:
        time.sleep(0.02)
        kept[item] = os.getpid()
        return kept[item]

    found = each(keep, range(20))
    assert kept == {item: pid for item, pid in enumerate(found) if pid == os.getpid()}
    assert 0 < len(kept) < 20


@TWO_CORES
def test_what_a_killed_process_leaves_is_done_by_this_one(alone):
    own = os.getpid()

    def risky(item: int) -> int:
        time.sleep(0.02)
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return item

    assert each(risky, range(20)) == list(range(20))


@TWO_CORES
def test_results_larger_than_a_pipe_come_whole(alone):
    found = each(lambda item: bytes([item]) * 3_000_000, range(8))
    assert [set(one) for one in found] == [{item} for item in range(8)]


def test_an_error_is_raised_here_and_leaves_no_process(alone):
    def fails(item: int) -> int:
        if item == 3:
            raise ValueError("three")
        return item

    before = set(multiprocessing.active_children())
    with pytest.raises(ValueError, match="three"):
        each(fails, range(20))
    assert set(multiprocessing.active_children()) <= before


@TWO_CORES
def test_without_memory_for_another_process_it_works_alone(alone, monkeypatch):
    def no_memory() -> int:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(os, "fork", no_memory)
    assert set(each(lambda _: os.getpid(), range(20))) == {os.getpid()}


def test_with_other_threads_it_works_alone():
    waits = threading.Event()
    other = threading.Thread(target=waits.wait)
    other.start()
    try:
        assert set(each(lambda _: os.getpid(), range(20))) == {os.getpid()}
    finally:
        waits.set()
        other.join()


@TWO_CORES
def test_tickers_leave_it_all_cores_and_hold_no_lock_in_another_process(monkeypatch):
    count_all, of_the_runner = threading.active_count, threading.active_count() - 1
    monkeypatch.setattr(threading, "active_count", lambda: count_all() - of_the_runner)
    held, ticks = threading.Lock(), []

    def tick() -> None:
        with held:
            time.sleep(0.005)
            ticks.append(1)

    def where(_: int) -> int:
        with held:
            time.sleep(0.002)
            return os.getpid()

    with Ticker(tick, 0.001):
        found = [pid for _ in range(20) for pid in each(where, range(4))]
        assert threading.active_count() == 2
    assert len(set(found)) > 2 and len(ticks) > 5
    count = len(ticks)
    time.sleep(0.05)
    assert len(ticks) == count, "none after the end"


@TWO_CORES
def test_one_function_is_computed_beside_this_process(alone):
    with beside(os.getpid) as other:
        assert other() != os.getpid()
    with beside(lambda: bytes(3_000_000)) as large:
        assert len(large()) == 3_000_000
    assert not multiprocessing.active_children()


def test_what_is_computed_beside_raises_here():
    def fails() -> int:
        raise ValueError("three")

    with pytest.raises(ValueError, match="three"), beside(fails) as result:
        result()
    assert not multiprocessing.active_children()


@TWO_CORES
def test_what_a_killed_process_leaves_is_computed_when_it_is_asked_for(alone):
    own = os.getpid()

    def risky() -> int:
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return 5

    with beside(risky) as result:
        assert result() == 5


@TWO_CORES
def test_a_result_nobody_asks_for_ends_its_process(alone):
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt), beside(lambda: time.sleep(60)):
        raise KeyboardInterrupt
    assert time.monotonic() - begun < 30 and not multiprocessing.active_children()
