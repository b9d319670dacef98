"""Run the program on the trials as a process that sees only the recordings and the simulation's file."""

from __future__ import annotations

import datetime
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .draw import BAGS


def run_all(bags: Path, results: Path, trials: range, timeout: float, wall: float, until: str = "") -> None:
    """Run every trial that `results` does not have yet.

    Args:
        bags: folder of the trials.
        results: JSON lines, one a trial, appended.
        trials: numbers of the trials. One that is not drawn yet is waited for, up to 5 minutes.
        timeout: processor time a trial, s (each process of it).
        wall: time by the clock a trial, s. On an idle machine it may be the same; beside other work it is longer.
        until: HH:MM after which no trial is begun, or empty.
    """
    end = deadline(until) if until else None
    done = {json.loads(line)["trial"] for line in results.read_text().splitlines()} if results.exists() else set()
    for trial in trials:
        if trial in done:
            continue
        if end is not None and datetime.datetime.now() >= end:
            break
        folder = bags / f"{trial:03d}"
        for _ in range(300):
            if (folder / f"{BAGS[-1]}.mcap").exists() and _complete(folder):
                break
            time.sleep(1)
        else:
            print(f"{trial:03d} is not drawn", file=sys.stderr)
            break
        record = run_one(folder, trial, timeout, wall)
        with results.open("a") as stream:
            stream.write(json.dumps(record) + "\n")
        print(f"{trial:03d} exit {record['exit']} {record['seconds']:.1f} s", flush=True)


def deadline(until: str) -> datetime.datetime:
    """The next time that a clock shows HH:MM."""
    now = datetime.datetime.now()
    hour, minute = (int(part) for part in until.split(":"))
    today = now.replace(hour=hour, minute=minute, second=0, microsecond=0)
    return today if today > now else today + datetime.timedelta(days=1)


def _complete(folder: Path) -> bool:
    last = folder / f"{BAGS[-1]}.mcap"
    with last.open("rb") as stream:
        stream.seek(0, 2)
        if stream.tell() < 16:
            return False
        stream.seek(-8, 2)
        return stream.read() == b"\x89MCAP0\r\n"


def run_one(folder: Path, trial: int, timeout: float, wall: float) -> dict[str, Any]:
    """Run one trial.

    Args:
        folder: its recordings and simulation.
        trial: its number.
        timeout: processor time, s.
        wall: time by the clock, s.

    Returns:
        `trial`, `exit` (None after `wall`, -24 or -9 after `timeout`), `seconds` (by the clock), `cpu_seconds`,
        `mismatch` (the file, or None), `stderr` (its end).
    """
    simulation = next(folder.glob("simulation.*"))
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        copies = []
        for file in (simulation, *(folder / f"{bag}.mcap" for bag in BAGS)):
            copies.append(shutil.copy(file, here / file.name))
        command = [str(Path(sys.executable).parent / "spacearm"), "mismatch", *map(str, copies[1:4])]
        command += ["--simulation", str(copies[0]), "--validate", str(copies[4])]
        command += ["--out", str(here / "out"), "--quiet"]
        begin, before = time.time(), resource.getrusage(resource.RUSAGE_CHILDREN)
        limit = ["prlimit", f"--cpu={timeout:.0f}"]
        try:
            done = subprocess.run(limit + command, capture_output=True, text=True, timeout=wall, cwd=here, check=False)
            code, errors = done.returncode, done.stderr
        except subprocess.TimeoutExpired:
            code, errors = None, f"timeout after {wall:.0f} s by the clock"
        seconds = time.time() - begin
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        file = here / "out" / "mismatch.json"
        mismatch = json.loads(file.read_text()) if file.exists() else None
    return {
        "trial": trial,
        "exit": code,
        "seconds": round(seconds, 1),
        "cpu_seconds": round(cpu, 1),
        "mismatch": mismatch,
        "stderr": errors[-600:],
    }
