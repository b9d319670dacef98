"""A live test is excused by a machine that stood still, and by nothing else."""

import os
import time

import pytest
from machine_watch import LOST_S, PRIORITY, MachineWatch, most_lost


def test_what_is_lost_is_the_most_of_any_second():
    gaps = [(1.0, 1.04), (1.5, 1.58), (1.95, 2.0), (7.0, 7.3)]
    assert most_lost(gaps, 0.0, 5.0) == pytest.approx(0.17)
    assert most_lost(gaps, 0.0, 9.0) == pytest.approx(0.3)
    assert most_lost(gaps, 3.0, 6.0) == 0.0
    assert most_lost([], 0.0, 1.0) == 0.0


@pytest.mark.live
@pytest.mark.alone
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
