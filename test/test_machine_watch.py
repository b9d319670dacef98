"""A live test is excused by a machine that stood still or is slow, and by nothing else."""

import os
import time

import pytest
from machine_watch import LOOP_EVERY_S, LOST_S, PACE, PRIORITY, SLOW_NS, MachineWatch, loop_ns, most_lost


def test_what_is_lost_is_the_most_of_any_second():
    gaps = [(1.0, 1.04), (1.5, 1.58), (1.95, 2.0), (7.0, 7.3)]
    assert most_lost(gaps, 0.0, 5.0) == pytest.approx(0.17)
    assert most_lost(gaps, 0.0, 9.0) == pytest.approx(0.3)
    assert most_lost(gaps, 3.0, 6.0) == 0.0
    assert most_lost([], 0.0, 1.0) == 0.0


@pytest.mark.live
def test_a_core_that_is_kept_from_everybody_is_seen_and_one_that_is_busy_is_not(tmp_path):
    before, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY + 1))
    except PermissionError:
        pytest.skip("no real-time priority: nothing is watched then")
    os.sched_setscheduler(0, before, priority)
    cores = os.sched_getaffinity(0)
    watch = MachineWatch(tmp_path)
    try:
        time.sleep(0.5)
        os.sched_setaffinity(0, {min(cores)})
        lost = []
        for urgency in (PRIORITY - 1, PRIORITY + 1):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(urgency))
            begin = time.monotonic()
            while time.monotonic() < begin + 2 * LOST_S:
                pass
            os.sched_setscheduler(0, before, priority)
            time.sleep(0.1)
            lost.append(watch.lost_s(begin, time.monotonic()))
    finally:
        os.sched_setscheduler(0, before, priority)
        os.sched_setaffinity(0, cores)
        watch.close()
    assert lost[0] < LOST_S < lost[1]


def test_a_slow_machine_is_told_by_what_additions_took_while_the_test_ran(tmp_path):
    watch = MachineWatch(tmp_path)
    begin = time.monotonic()
    try:
        time.sleep(4 * LOOP_EVERY_S)
    finally:
        watch.close()
    taken = watch.addition_ns(begin, time.monotonic())
    assert taken > 0.0
    # As long as it takes here, whatever it is: cores share caches, and clocks change.
    assert taken == pytest.approx(loop_ns(), rel=1.5)
    core = min(os.sched_getaffinity(0))
    for name in tmp_path.glob(f"*{PACE}"):
        name.unlink()
    (tmp_path / f"core_{core}{PACE}").write_text(f"10.0 {SLOW_NS / 2}\n11.0 {2 * SLOW_NS}\n12.0 {2 * SLOW_NS}\n")
    assert watch.addition_ns(9.0, 13.0) > SLOW_NS > watch.addition_ns(9.0, 10.5)
    assert watch.addition_ns(20.0, 21.0) == 0.0
