"""The live chain for half an hour: does it hold what it holds after a minute?

    python bench/soak.py --out DIR [--minutes 30] [--fast] [--keep] [--table]

All five nodes run as processes on the simulated arm, one excitation run after another, each recorded to a bag of its
own: the first identifies the arm, every later one validates the model. Every 10 s a line of `DIR/soak.jsonl` says what
each process holds and what the nodes count, after each run what its bag holds beside what the driver published. A soak
that was interrupted goes on where it was, with a new chain; the table is made from the lines. Only what must not be
(a message lost, memory that grows, a run that does not come to its end) makes the exit code 1; lateness is shown.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_bus import cpu_s
from bench_live import count_samples
from fault_chain import held, newest_bag

from spacearm_ident.cli.demo import FAST_PLANS, PLANS, begin, enable, node_parameters, perform, write_trajectory
from spacearm_ident.errors import UserError
from spacearm_ident.nodes.chain import STARTED_S, Chain
from spacearm_ident.nodes.main import NODES

EVERY_S = 10.0
HEARD_S = 2.0
"""How long after a run the identifier says that it works on it."""
VALIDATED_S = 120.0
GROWTH_MIB = 15.0
"""What a process may hold more in the last third than in the middle one; in the first its buffers fill."""
FILLED_S = 320.0
"""When they are full: the identifier keeps five minutes. Thirds shorter than this say nothing of growth."""
EDGE = 50
"""Samples that may lie between the driver's count and the stamp of the status it stands in, where it is held up."""
COUNTED = {
    "canopen_driver": ("cycles", "missed_cycles", "incomplete_cycles", "late_frames"),
    "recorder": ("lost", "dropped"),
    "trajectory": ("late",),
    "simulated_arm": ("physics_steps_skipped", "sync_unanswered"),
    "identifier": ("dropped", "buffered_messages"),
}
LATENESS = tuple(f"lateness_{quantile}_us" for quantile in ("p50", "p99", "p999"))

Line = dict[str, Any]


class Journal:
    """The lines of a soak, on disk as soon as they are known."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / "soak.jsonl"
        self.lines: list[Line] = (
            [json.loads(line) for line in self._path.read_text().splitlines()] if self._path.exists() else []
        )
        self._before = max((line["at_s"] for line in self.lines), default=0.0)
        self._start = time.monotonic()
        self.chain = 1 + max((line["chain"] for line in self.lines), default=0)

    @property
    def at_s(self) -> float:
        """Seconds soaked, all chains together."""
        return self._before + time.monotonic() - self._start

    def add(self, kind: str, what: Line) -> None:
        """Write a line."""
        about = {"kind": kind, "at_s": round(self.at_s, 1), "chain": self.chain, "unix_s": round(time.time(), 1)}
        self.lines.append({**about, **what})
        with self._path.open("a") as file:
            file.write(json.dumps(self.lines[-1]) + "\n")


class Sampler:
    """Looks at the processes every `EVERY_S` while a run is under way: the progress callback of `perform`."""

    def __init__(self, chain: Chain, journal: Journal) -> None:
        self._chain, self._journal = chain, journal
        self._cpu: dict[str, float] = {}
        self._last = 0.0
        self.reasons: dict[str, str] = {}

    def __call__(self, share: float, what: str) -> None:
        """Called often."""
        state = self._chain.excitation
        if state.get("reason"):
            self.reasons[state["run"]] = state["reason"]
        now = time.monotonic()
        if now - self._last >= EVERY_S:
            self._sample(now - self._last)
            self._last = now

    def _sample(self, elapsed: float) -> None:
        nodes = {}
        for name, pid in self._chain.processes.items():
            files, threads, memory = held(pid)
            cpu = cpu_s(pid)
            share = (cpu - self._cpu[name]) / elapsed if name in self._cpu else None
            self._cpu[name] = cpu
            said = self._chain.values(name)
            counts = {key: int(float(said[key])) for key in COUNTED[name] if key in said}
            nodes[name] = {"MiB": memory, "threads": threads, "files": files, "cpu": share, **counts}
        driver = self._chain.values("canopen_driver")
        nodes["canopen_driver"] |= {key: float(driver[key]) for key in LATENESS if key in driver}
        self._journal.add("sample", {"nodes": nodes, "load": os.getloadavg()[0]})


def soak(directory: Path, minutes: float, fast: bool, keep: bool) -> list[Line]:
    """Run what is missing of a soak; returns all lines."""
    plans = FAST_PLANS if fast else PLANS
    files = [write_trajectory(plan, directory) for plan in plans]
    journal = Journal(directory)
    while journal.at_s < 60.0 * minutes:
        try:
            with Chain(directory / f"chain_{journal.chain}", node_parameters(directory)) as chain:
                begin(chain)
                sampler = Sampler(chain, journal)
                identified = False
                while journal.at_s < 60.0 * minutes:
                    done = _one_run(chain, journal, sampler, plans[identified], files[identified], directory, keep)
                    identified = identified or done
                chain.call("/driver/enable", False)
                journal.add("end", {"codes": chain.close()})
        except UserError as error:
            print(f"chain {journal.chain} ended: {error}", file=sys.stderr)
            journal.add("broken", {"why": str(error)})
        journal.chain += 1
    return journal.lines


def _one_run(
    chain: Chain, journal: Journal, sampler: Sampler, plan: Any, file: Path, directory: Path, keep: bool
) -> bool:
    """One run in a bag of its own, until it is identified from, or validated on; whether it came to that."""
    if chain.values("recorder").get("recording") != "true":
        chain.call("/recorder/start")
    if chain.values("canopen_driver").get("operation_enabled") != "true":
        enable(chain)
    sampler.reasons.clear()
    begun = time.monotonic()
    failed = ""
    try:
        perform(chain, plan, file, sampler)
        _idle(chain, sampler)
    except UserError as error:  # where a node has died, the next call says so
        failed = str(error)
        print(f"{plan.name}: {failed}", file=sys.stderr)
    took = time.monotonic() - begun
    said = chain.call("/recorder/stop")
    chain.wait(lambda: chain.values("recorder").get("recording") == "false", "the end of the bag", STARTED_S)
    bag = newest_bag(directory)
    held_in_bag = count_samples(bag)
    verdict = chain.status("identifier: identification")
    line = {"run": plan.name, "took_s": round(took, 1), "stopped": dict(sampler.reasons), "failed": failed}
    line["identifier"] = verdict
    journal.add("run", {**line, "recorder": said, **held_in_bag})
    if not keep:
        shutil.rmtree(bag)
    return not failed


def _idle(chain: Chain, sampler: Sampler) -> None:
    """Wait until the identifier has done what the run gave it to do."""
    heard = time.monotonic() + HEARD_S

    def idle() -> bool:
        sampler(1.0, "validating")
        values = chain.values("identifier")
        waiting = values.get("identifying") != "false" or values.get("runs_waiting") != "0"
        return time.monotonic() > heard and not waiting

    chain.wait(idle, "the identifier", VALIDATED_S)


def thirds(lines: list[Line], kind: str) -> Iterator[list[Line]]:
    """The lines of a kind, by thirds of the whole time."""
    end = max(line["at_s"] for line in lines)
    for third in range(3):
        low, high = end * third / 3.0, end * (third + 1) / 3.0
        yield [line for line in lines if line["kind"] == kind and low < line["at_s"] <= high]


def table(lines: list[Line]) -> str:
    """What the processes held and the bags hold, third by third, as Markdown."""
    samples, runs = list(thirds(lines, "sample")), list(thirds(lines, "run"))
    rows = ["| | first third | middle | last |", "|---|---|---|---|"]

    def row(name: str, parts: list[list[Line]], figure: Callable[[list[Line]], str]) -> None:
        rows.append(f"| {name} | " + " | ".join(figure(part) if part else "–" for part in parts) + " |")

    for node in NODES:
        row(f"{node}, median", samples, partial(_holds, node))
    row(
        "lateness of the cycle since the start, p50 p99 p99.9, µs",
        samples,
        lambda part: " ".join(f"{part[-1]['nodes']['canopen_driver'].get(key, math.nan):.0f}" for key in LATENESS),
    )
    row(
        "an interval is off 1 ms by, p50 p99 p99.9, µs (median run)",
        runs,
        lambda part: " ".join(f"{v:.0f}" for v in np.median([line["jitter_us"] for line in part], axis=0)),
    )
    for name, key in (
        ("slots of the cycle", "slots"),
        ("slots missed", "missed"),
        ("cycles incomplete", "incomplete"),
        ("samples published", "published"),
        ("samples in the bags", "in_bag"),
    ):
        row(name, runs, lambda part, k=key: f"{sum(line[k] for line in part)}")
    row("gaps in the bags; longest, ms", runs, _gaps)
    row("runs completed; motions broken off", runs, _completed)
    row("load average, median", samples, lambda part: f"{np.median([line['load'] for line in part]):.1f}")
    return "\n".join([*rows, "", *verdicts(lines)])


def _holds(node: str, part: list[Line]) -> str:
    def middle(key: str) -> float:
        known = [line["nodes"][node][key] for line in part if line["nodes"][node].get(key) is not None]
        return float(np.median(known)) if known else math.nan

    figures = map(middle, ("MiB", "threads", "files", "cpu"))
    return "{:.0f} MiB, {:.0f} threads, {:.0f} files, {:.0%} of a core".format(*figures)


def _completed(part: list[Line]) -> str:
    done = sum(not line["failed"] for line in part)
    return f"{done} of {len(part)}; {sum(len(line['stopped']) for line in part)}"


def _gaps(part: list[Line]) -> str:
    return f"{sum(line['gaps'] for line in part)}; {max(line['largest_gap_ms'] for line in part):.0f}"


def verdicts(lines: list[Line]) -> list[str]:
    """What must not be, a line each, or that it was not."""
    runs = [line for line in lines if line["kind"] == "run"]
    ended = [line["failed"] or line["identifier"] for line in runs]
    found = [*_lost(lines), *_grown(lines), *(text for text in ended if not text.startswith("identified"))]
    found += [f"chain {line['chain']}: {line['why']}" for line in lines if line["kind"] == "broken"]
    found += [f"exit codes {line['codes']}" for line in lines if line["kind"] == "end" and any(line["codes"].values())]
    if found:
        return [f"NOT GOOD: {text}" for text in found]
    minutes, chains = max(line["at_s"] for line in lines) / 60.0, len({line["chain"] for line in lines})
    grown = "no process grew" if minutes * 20.0 > FILLED_S else "too short to say whether a process grows"
    return [
        f"{len(runs)} runs in {minutes:.1f} minutes, {chains} chain(s): no sample lost, {grown}, every run identified."
    ]


def _lost(lines: list[Line]) -> Iterator[str]:
    for line in lines:
        if line["kind"] == "run" and abs(line["published"] - line["in_bag"]) > EDGE:
            yield f"{line['published']} samples were published, {line['in_bag']} are in the bag of a run"
    for key in ("lost", "dropped"):
        most = max((line["nodes"]["recorder"].get(key, 0) for line in lines if line["kind"] == "sample"), default=0)
        if most:
            yield f"the recorder counts {most} messages {key}"


def _grown(lines: list[Line]) -> Iterator[str]:
    if max(line["at_s"] for line in lines) / 3.0 < FILLED_S:
        return
    _, before, after = thirds(lines, "sample")
    for node in NODES if before and after else ():
        medians = [np.median([line["nodes"][node]["MiB"] for line in part]) for part in (before, after)]
        if np.diff(medians) > GROWTH_MIB:
            yield f"{node} holds {medians[0]:.0f} MiB in the middle third, {medians[1]:.0f} in the last"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--minutes", type=float, default=30.0, help="how long in all (default 30)")
    parser.add_argument("--fast", action="store_true", help="short runs, as of spacearm demo --fast")
    parser.add_argument("--keep", action="store_true", help="keep the bags (about 1 MB a second)")
    parser.add_argument("--table", action="store_true", help="only print the table of what has been run")
    options = parser.parse_args()
    # However it is ended, the nodes end first (a shell's background job begins with SIGINT ignored).
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    options.out.mkdir(parents=True, exist_ok=True)
    lines = soak(options.out, 0.0 if options.table else options.minutes, options.fast, options.keep)
    if not any(line["kind"] == "sample" for line in lines):
        print("nothing has been run in this folder", file=sys.stderr)
        return 2
    print(table(lines))
    return 1 if any(line.startswith("NOT GOOD") for line in verdicts(lines)) else 0


if __name__ == "__main__":
    sys.exit(main())
