"""Run `spacearm mismatch` on every trial of a draw, as a process that gets the bags only.

    python run.py --draws DIR --results FILE.jsonl

A line a trial is appended as it finishes; a run that was stopped goes on where it stopped.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

KEEP = ("effect", "joints", "where", "parameters", "confidence", "alternatives", "validation")


def trial(bags: Path, program: str, timeout: float) -> dict:
    """Run one trial.

    Args:
        bags: its folder with reference*.mcap, field.mcap and, perhaps, validation.mcap.
        program: path of `spacearm`.
        timeout: s of processor time; three times that of wall time (the machine may be shared).
    """
    with tempfile.TemporaryDirectory() as out:
        command = [
            program,
            "mismatch",
            "--reference",
            *map(str, sorted(bags.glob("reference*.mcap"))),
            "--out",
            out,
            "--quiet",
        ]
        if (bags / "validation.mcap").exists():
            command += ["--validate", str(bags / "validation.mcap")]
        command.insert(2, str(bags / "field.mcap"))
        start = time.time()
        used = os.times().children_user
        # a session of its own, so that what the program starts ends with it
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(timeout), int(timeout) + 5)),
        )
        try:
            _, error = process.communicate(timeout=3 * timeout)
            code: int | None = process.returncode
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            _, error = process.communicate()
            code = None
        line = {
            "exit": code,
            "seconds": round(time.time() - start, 1),
            "cpu_seconds": round(os.times().children_user - used, 1),
        }
        file = Path(out) / "mismatch.json"
        if code in (0, 1) and file.exists():
            result = json.loads(file.read_text())
            line["verdict"] = result.get("verdict")
            line["findings"] = [{k: f.get(k) for k in KEEP} for f in result.get("findings", [])]
            line["unexplained"] = result.get("unexplained")
            line["noise_floor_Nm"] = result.get("noise_floor_Nm")
            line["residual_before_Nm"] = result.get("residual_before_Nm")
        else:
            line["error"] = error[-500:]
        return line


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=Path, required=True)
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--program", default=str(Path(sys.executable).with_name("spacearm")))
    parser.add_argument("--timeout", type=float, default=600, help="s of processor time a trial")
    parser.add_argument("--only", type=int, nargs="+", help="trials to run, in this order")
    parser.add_argument("--until", default=None, help="HH:MM; no trial starts after it")
    options = parser.parse_args()
    end = _next(options.until) if options.until else datetime.datetime.max
    done = set()
    if options.results.exists():
        done = {json.loads(line)["trial"] for line in options.results.read_text().splitlines()}
    while True:
        # an answer is written after its bags: a draw may still be going on
        drawn = {int(a.stem): a for a in sorted((options.draws / "answers").glob("*.json"))}
        left = [drawn[k] for k in options.only or drawn if k in drawn and k not in done]
        if not left or datetime.datetime.now() >= end:
            break
        answer = json.loads(left[0].read_text())
        line = {
            "trial": answer["trial"],
            **trial(options.draws / "bags" / left[0].stem, options.program, options.timeout),
        }
        with options.results.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        done.add(answer["trial"])
        print(
            line["trial"],
            line.get("verdict", line.get("error")),
            [(f["effect"], f["joints"]) for f in line.get("findings", [])],
            line["seconds"],
            "s",
            flush=True,
        )


def _next(clock: str) -> datetime.datetime:
    """When a clock next shows HH:MM."""
    hour, minute = (int(part) for part in clock.split(":"))
    today = datetime.datetime.now().replace(hour=hour, minute=minute, second=0, microsecond=0)
    return today if today > datetime.datetime.now() else today + datetime.timedelta(days=1)


if __name__ == "__main__":
    main()
