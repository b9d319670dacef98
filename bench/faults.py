"""The fault campaign: every fault of the live chain, at random times of a motion.

    python bench/faults.py --out DIR [--runs 200] [--seed 0] [--only FAULT ...] [--table]

All five nodes run as processes; each run starts an excitation, breaks something at a random moment, and looks: does
the arm come to rest or go on in service, is the reason on /diagnostics, can the recording be read to its last
second, can the arm be brought back, does anybody hang or leak. One line of `DIR/runs.jsonl` a run; a campaign that
was interrupted goes on where it was, and the table is made from the lines. Nothing here asserts on speed; the time to
stop is measured in the recording.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fault_chain import EMERGENCY, FREEZE, SPOIL, BreakableChain

from spacearm_ident.cli.demo import Plan, node_parameters, write_trajectory
from spacearm_ident.errors import UserError
from spacearm_ident.recording import read_recording

MOTION = Plan("campaign", 1, 4, 0.5)
OBSERVED_S = 12.0
"""Longest wait for a run to end by itself or by the fault."""
REST_RAD_S = 0.005
BEGINNINGS = 5
"""How often a motion is begun that the machine is too busy for."""
LAST_S = 1.0
"""What a recording may lack at its end."""
FD_LEAK, THREAD_LEAK, MIB_LEAK = 8, 4, 150

Act = Callable[[BreakableChain, np.random.Generator, ExitStack], str]


@dataclass(frozen=True)
class Kind:
    """A fault.

    Attributes:
        act: Does it; returns in words what it did.
        stops: Whether the arm has to stop; else it may as well go on in service.
        reason: What /diagnostics shall say of it (regular expression over all nodes' words); empty: nothing to say.
    """

    act: Act
    stops: bool
    reason: str


def on_drive(sub: int, low: int, high: int, end: bool = False) -> Act:
    """Write the fault object of a random drive with a random value; `end`: write zero after the run."""

    def act(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
        joint, value = int(rng.integers(6)), int(rng.integers(low, high + 1))
        chain.inject(joint, sub, value)
        if end:
            after.callback(chain.inject, joint, sub, 0)
        return f"joint_{joint + 1}, {value:#x}" if sub == EMERGENCY else f"joint_{joint + 1}, {value}"

    return act


def lost_frames(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    joint, seconds = int(rng.integers(6)), float(rng.uniform(0.002, 0.3))
    chain.inject(joint, SPOIL, 3)
    time.sleep(seconds)
    chain.inject(joint, SPOIL, 0)
    return f"joint_{joint + 1}, {seconds:.3f} s"


def following_error(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    joint = int(rng.integers(6))
    chain.write(joint, 0x6065, 1, 4)
    # Its window is wide again when it has been switched on anew, which makes the driver configure it.
    after.callback(chain.send, joint, 0x000, bytes([0x81, joint + 1]))
    return f"joint_{joint + 1}"


def bus_off(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    joint = int(rng.integers(6))
    chain.bus_off(joint)
    return f"bus {joint // 3}"


def other_master(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    joint = int(rng.integers(6))
    chain.send(joint, 0x080, b"")
    return f"SYNC on bus {joint // 3}"


def halted(name: str) -> Act:
    def act(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
        seconds = float(10 ** rng.uniform(-2.0, 0.2))
        chain.halt(name, seconds)
        return f"{seconds:.3f} s"

    return act


def killed(name: str) -> Act:
    def act(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
        chain.kill(name)
        return ""

    return act


def full_disk(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    after.enter_context(chain.full_disk())
    return ""


def wrong_moment(chain: BreakableChain, rng: np.random.Generator, after: ExitStack) -> str:
    calls: list[tuple[str, bool | None]] = [
        ("/excitation/start", None),
        ("/recorder/start", None),
        ("/driver/recover", None),
        ("/driver/enable", True),
        ("/driver/enable", False),
        ("/driver/halt", None),
        ("/excitation/stop", None),
        ("/identifier/identify", None),
    ]
    service, data = calls[int(rng.integers(len(calls)))]
    try:
        return f"{service} {data if data is not None else ''}: {chain.call(service, data)}"
    except UserError as error:
        return str(error)


KINDS: dict[str, Kind] = {
    "drive fault (EMCY)": Kind(on_drive(EMERGENCY, 0x2310, 0x2340), True, r"node \d reports"),
    "over-temperature": Kind(on_drive(EMERGENCY, 0x4310, 0x4310), True, r"node \d reports.*4310"),
    "drive silent": Kind(on_drive(FREEZE, 300, 2500), True, r"no feedback|no heartbeat"),
    "encoder jump": Kind(on_drive(SPOIL, 4, 4, end=True), True, r"error|limit|node \d"),
    "short frames": Kind(on_drive(SPOIL, 1, 1, end=True), True, r"bytes of feedback"),
    "nonsense frames": Kind(on_drive(SPOIL, 2, 2, end=True), True, r"error|limit|node \d"),
    "frames lost": Kind(lost_frames, False, r"no feedback|incomplete"),
    "following error": Kind(following_error, True, r"node \d"),
    "bus off": Kind(bus_off, True, r"bus off"),
    "second master": Kind(other_master, True, r"another master"),
    "driver halted": Kind(halted("canopen_driver"), False, r""),
    "arm halted": Kind(halted("simulated_arm"), False, r""),
    "trajectory halted": Kind(halted("trajectory"), False, r""),
    "recorder halted": Kind(halted("recorder"), False, r""),
    "driver killed": Kind(killed("canopen_driver"), True, r"feedback on /joint_states"),
    "arm killed": Kind(killed("simulated_arm"), True, r"bus: |no feedback"),
    "trajectory killed": Kind(killed("trajectory"), True, r"set-point"),
    "recorder killed": Kind(killed("recorder"), False, r""),
    "identifier killed": Kind(killed("identifier"), False, r""),
    "disk full": Kind(full_disk, False, r"recording ended early"),
    "call at a wrong moment": Kind(wrong_moment, False, r""),
}


def run(chain: BreakableChain, name: str, rng: np.random.Generator) -> dict[str, object]:
    """One run; what was seen."""
    kind = KINDS[name]
    chain.serve()
    held, bag = chain.held(), chain.bag()
    chain.set_parameter("trajectory", "trajectory_file", str(chain.folder / f"{MOTION.name}.yaml"))
    delay = float(rng.uniform(0.5, 5.0))
    for _ in range(BEGINNINGS):
        chain.wait(lambda: _started(chain), "a run", 10.0)
        chain.holds(lambda: False, delay)
        if chain.excitation.get("state") in ("approach", "running"):
            break
        chain.serve()  # a machine too busy for the cycle has stopped the arm by itself
    with ExitStack() as after:
        at = time.time()
        what = kind.act(chain, rng, after)
        ended = chain.holds(lambda: _over(chain, name), OBSERVED_S)
        said = chain.holds(lambda: re.search(kind.reason, _words(chain)), 3.0)
        words = _words(chain)
        stopped = bool(chain.values("canopen_driver").get("fault")) or name == "driver killed"
        outcome = "stopped" if stopped or chain.excitation.get("complete") is False else "in service"
        until = time.time()
    grown = _grown(held, chain)
    if chain.alive("recorder"):
        chain.holds(lambda: False, 0.6)
    stop_call = time.time()
    last = stop_call if chain.alive("recorder") else at
    try:
        chain.call("/recorder/stop") if chain.alive("recorder") else None
    except UserError:
        last = 0.0  # the disk was full: what was written before is what there is
    if not (chain.alive("canopen_driver") and chain.alive("simulated_arm")):  # nobody has anything to record
        last = min(last, at)
    result = {"fault": name, "what": what, "ended": ended, "outcome": outcome, "at": at, "grown": grown}
    result |= _recorded(bag, at, until, last)
    # An arm that goes on in service although it might have stopped has nothing to tell.
    result["said"] = bool(said) or (not kind.stops and outcome == "in service")
    result["words"] = words[:300]
    try:
        chain.serve()
        result["back"] = True
    except UserError as error:
        result["back"] = str(error)[:200]
    safe = ended and (outcome == "stopped" or not kind.stops)
    result["good"] = bool(safe and result["said"] and result["readable"] and result["back"] is True and not grown)
    return result


def _started(chain: BreakableChain) -> bool:
    try:
        chain.call("/excitation/start")
        return True
    except UserError:
        return False


def _over(chain: BreakableChain, name: str) -> bool:
    """Whether the run has ended, however."""
    state = chain.excitation.get("state")
    fault = chain.values("canopen_driver").get("fault")
    return (state == "done" and name != "trajectory killed") or (bool(fault) and name == "trajectory killed")


def _words(chain: BreakableChain) -> str:
    """What all nodes say of themselves."""
    driver = chain.values("canopen_driver")
    nodes = ("canopen_driver", "trajectory", "recorder", "simulated_arm")
    counts = " ".join(f"{driver.get(f'{key}_cycles')} {key}" for key in ("missed", "incomplete"))
    return " | ".join([*(f"{name}: {chain.status(name)}" for name in nodes), driver.get("fault", ""), counts])


def _grown(before: dict[str, tuple[int, int, int]], chain: BreakableChain) -> dict[str, list[int]]:
    """Nodes that hold more than before, beyond what a run may take."""
    most = (FD_LEAK, THREAD_LEAK, MIB_LEAK)
    grown = {}
    for name, now in chain.held().items():
        more = [b - a for a, b in zip(before.get(name, now), now)]
        if any(m > limit for m, limit in zip(more, most)):
            grown[name] = more
    return grown


def _recorded(bag: Path, at: float, until: float, last: float) -> dict[str, object]:
    """Whether the bag can be read to `last`, and how long the arm moved from `at` on, seen `until` (s since 1970)."""
    try:
        recording = read_recording(bag)
    except UserError as error:
        return {"readable": False, "issues": str(error)[:200], "lacks_s": None, "stop_s": None}
    times = recording.start_ns * 1e-9 + recording.time
    lacks = last - float(times[-1]) if last else 0.0
    later = times > at
    stop = None
    if later.sum() > 50:
        window = 20  # 20 ms: the encoder's steps stay below the threshold
        span = times[window:] - times[:-window]
        speed = np.abs(recording.position[window:] - recording.position[:-window]).max(axis=1) / span
        moving = times[window:][(speed > REST_RAD_S) & (times[window:] > at) & (times[window:] < until)]
        stop = float(moving[-1] - at) if len(moving) else 0.0
    issues = sorted({issue.kind for issue in recording.issues})
    return {"readable": lacks < LAST_S, "issues": issues, "lacks_s": round(lacks, 3), "stop_s": stop}


def table(lines: list[dict[str, object]]) -> str:
    """All runs, a line a fault, as Markdown."""
    rows = [
        "| fault | runs | arm stopped | in service | time to stop, s: median (largest) | reason told | readable "
        "| back in service | leaks | all good |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in KINDS:
        mine = [line for line in lines if line["fault"] == name]
        if not mine:
            continue
        stopped = [line for line in mine if line["outcome"] == "stopped"]
        stops = [line["stop_s"] for line in stopped if line["stop_s"] is not None]
        took = f"{np.median(stops):.2f} ({max(stops):.2f})" if stops else "–"

        def count(key: str, of: list[dict[str, object]] = mine) -> str:
            return f"{sum(line[key] is True for line in of)}/{len(of)}"

        leaks = sum(bool(line["grown"]) for line in mine)
        rows.append(
            f"| {name} | {len(mine)} | {len(stopped)} | {len(mine) - len(stopped)} | {took} | {count('said')} "
            f"| {count('readable')} | {count('back')} | {leaks} | {count('good')} |"
        )
    good = sum(line["good"] is True for line in lines)
    return "\n".join([*rows, "", f"{good} of {len(lines)} runs as they should be."])


def campaign(out: Path, runs: int, seed: int, names: list[str]) -> list[dict[str, object]]:
    """Run what is missing of a campaign; returns all lines."""
    log = out / "runs.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {(line["seed"], line["run"]) for line in lines}
    write_trajectory(MOTION, out)
    parameters = node_parameters(out)
    parameters["identifier"]["auto_identify"] = False
    parameters["trajectory"] = {"restarts": 0}  # What a fault does is judged by itself.
    missing = [number for number in range(runs) if (seed, number) not in done]
    while missing:
        with BreakableChain(out, parameters) as chain:
            while missing:
                number = missing.pop(0)
                rng = np.random.default_rng([seed, number])
                name = names[number % len(names)]
                try:
                    line = run(chain, name, rng)
                except UserError as error:
                    line = {"fault": name, "outcome": "stopped", "good": False, "words": str(error), "what": ""}
                    line |= {"said": False, "readable": False, "back": False, "grown": {}, "stop_s": None}
                line |= {"seed": seed, "run": number}
                lines.append(line)
                with log.open("a") as file:
                    file.write(json.dumps(line) + "\n")
                mark = "good" if line["good"] else f"NOT GOOD {line}"
                print(f"{number:4d} {name:24} {line['what'][:60]:60} {line['outcome']:11} {mark}", flush=True)
                if line["back"] is not True:
                    break  # with a chain of new processes
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=KINDS, metavar="FAULT", help=", ".join(KINDS))
    parser.add_argument("--table", action="store_true", help="only print the table of what has been run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.table:
        options.runs = 0
    lines = campaign(options.out, options.runs, options.seed, options.only or list(KINDS))
    print(table(lines))
    return 0 if all(line["good"] for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
