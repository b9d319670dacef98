"""The 1 kHz cycle of six simulated drives on two local buses: what is lost, late, and what it costs.

    python bench/bench_bus.py [--seconds 10] [--busy]

`--busy` keeps one CPU-bound process beside it for every core but one.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
from simulated_bus import SCALE, FirstOrderArm

from spacearm_ident.canbus.arm_bus import ArmBus, Axis
from spacearm_ident.canbus.cia402 import Goal
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.master import DriveMaster
from spacearm_ident.canbus.realtime import Pacer, prepare_process, prepare_thread
from spacearm_ident.simulation.drives.drive import DriveConfig
from spacearm_ident.simulation.drives.network import DriveNetwork

CHANNELS = ("bench0", "bench1")
FORK = multiprocessing.get_context("fork")


def serve_drives(ready, stop, result):
    prepare_thread()
    buses = [LocalBus(channel) for channel in CHANNELS]
    configs = [(k // 3, DriveConfig(1 + k, SCALE)) for k in range(6)]
    network = DriveNetwork(buses, configs, FirstOrderArm(6))
    prepare_process()
    ready.set()
    network.run(stop.is_set)
    result.put(
        (network.steps, network.skipped, network.unanswered, sum(b.lost for b in buses), sum(b.dropped for b in buses))
    )
    for bus in buses:
        bus.shutdown()


def burn(stop):
    while not stop.is_set():
        sum(range(10_000))


def cpu_s(pid: int) -> float:
    """CPU time a process has used, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(master: DriveMaster, seconds: float, drives: int) -> None:
    cycle = master.cycle()
    warning = prepare_thread()
    prepare_process()
    pacer = Pacer(1e-3)
    cycle.goal = Goal.ENABLED
    while not cycle.enabled:
        pacer.wait()
        cycle.run()
    count = round(seconds * 1000)
    last = np.zeros(count)
    target = np.zeros(6)
    pacer = Pacer(1e-3)
    received, incomplete, late = cycle.received.copy(), cycle.incomplete, cycle.late
    own, theirs, begin = time.process_time(), cpu_s(drives), time.monotonic()
    for k in range(count):
        pacer.wait()
        target[:] = 0.3 * np.sin(2e-3 * np.pi * 0.5 * k)
        cycle.run(target)
        last[k] = cycle.stamp.max() - 1e-9 * cycle.sync_ns if cycle.answer_s == cycle.answer_s else np.nan
    wall = time.monotonic() - begin
    own, theirs = time.process_time() - own, cpu_s(drives) - theirs
    received, incomplete, late = cycle.received - received, cycle.incomplete - incomplete, cycle.late - late
    cycle.goal = Goal.DISABLED
    for _ in range(10):
        pacer.wait()
        cycle.run()
    print(f"real-time priority        {'yes' if warning is None else 'no'}")
    print(f"rate                      {count / wall:.2f} Hz, {pacer.missed} slots missed of {count}")
    lateness = " ".join(f"{1e6 * pacer.lateness(q):.0f}" for q in (0.5, 0.99, 0.999, 1.0))
    print(f"cycle lateness            {lateness} µs (p50 p99 p99.9 max)")
    answers = " ".join(f"{1e6 * np.nanquantile(last, q):.0f}" for q in (0.5, 0.99, 0.999, 1.0))
    print(f"SYNC to last feedback     {answers} µs")
    print(
        f"feedback                  {received.sum()} of {6 * count} in time; "
        f"incomplete cycles {incomplete}, late frames {late}"
    )
    print(f"CPU                       master {100 * own / wall:.1f} %, drives {100 * theirs / wall:.1f} % of a core")
    kinds = Counter(event.kind.value for event in cycle.events)
    print(f"events                    {dict(kinds) or 'none'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--busy", action="store_true", help="load the other cores")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SPACEARM_RUNTIME_DIR"] = folder
        ready, stop, result = FORK.Event(), FORK.Event(), FORK.Queue()
        drives = FORK.Process(target=serve_drives, args=(ready, stop, result), daemon=True)
        busy = [
            FORK.Process(target=burn, args=(stop,), daemon=True)
            for _ in range((os.cpu_count() or 2) - 1 if options.busy else 0)
        ]
        for process in (drives, *busy):
            process.start()
        ready.wait()
        arm = ArmBus(tuple(Axis(1 + k, SCALE, bus=k // 3) for k in range(6)))
        buses = [LocalBus(channel) for channel in CHANNELS]
        with DriveMaster(arm, buses) as master:
            master.boot()
            print(f"bus load                  {' / '.join(str(load) for load in master.loads)}")
            measure(master, options.seconds, drives.pid or 0)
            stop.set()
            steps, skipped, unanswered, lost, dropped = result.get(timeout=10)
            lost += sum(bus.lost for bus in buses)
            dropped += sum(bus.dropped for bus in buses)
        print(f"frames lost on the bus    {lost} (dropped by senders {dropped})")
        print(f"physics                   {steps} steps, {skipped} skipped; SYNCs too old to answer {unanswered}")
        for process in (drives, *busy):
            process.join(5)


if __name__ == "__main__":
    main()
