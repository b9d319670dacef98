"""A blind trial of `spacearm mismatch` on simulated arms with concealed physics.

    python bench/concealed.py draw --seed 7 --out DIR [--effect torque_ripple] [--multiple 5]
    python bench/concealed.py run --trials 200 --out DIR [--jobs 2] [--first 1] [--keep] [--healthy]
    python bench/concealed.py score --out DIR

`draw` writes one trial: DIR/bags (all the tool may see) and DIR/sealed/answer.json. `run` draws trial after trial,
calls the tool on each as a user would, in a process of its own, and scores; run again, it skips what is finished and
repeats what crashed (whose bags it keeps). Of every twenty trials four are healthy, three hide two effects, two an
effect that is absent from the catalogue, eleven one effect of it; effects come in turn, amplitudes of 2, 5 and 10
times the noise floor too (see `concealed_draw` for how that is measured). The tool never runs in a process that knows
an answer.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from concealed_arm import FORMS
from concealed_draw import ABSENT, KNOWN, MULTIPLES, NEEDS_WEIGHT, WEIGHTLESS_ONLY, draw_trial
from concealed_score import load_trials, report

HEALTHY: dict[str, Any] = {"kind": "healthy", "effects": None, "multiple": None}
BLOCK = ("healthy",) * 4 + ("two",) * 3 + ("absent",) * 2 + ("one",) * 11
LONGEST_S = 900.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("draw", help="write one trial")
    draw.add_argument("--seed", type=int, required=True)
    draw.add_argument("--out", type=Path, required=True)
    draw.add_argument("--effect", action="append", choices=KNOWN + ABSENT, help="in place of what the seed draws")
    draw.add_argument("--healthy", action="store_true", help="conceal nothing")
    draw.add_argument("--multiple", type=float, help="of the noise floor")
    draw.add_argument("--form", choices=FORMS, help="of the motions: plain has no slow part")
    run = commands.add_parser("run", help="draw, call the tool, score")
    run.add_argument("--trials", type=int, default=200)
    run.add_argument("--first", type=int, default=1, help="number of the first trial (default 1)")
    run.add_argument("--out", type=Path, required=True)
    run.add_argument("--jobs", type=int, default=2)
    run.add_argument("--seed", type=int, default=0, help="of the whole series")
    run.add_argument("--form", choices=FORMS, help="of all motions")
    run.add_argument("--healthy", action="store_true", help="conceal nothing in any: how often is a false alarm?")
    run.add_argument("--keep", action="store_true", help="keep the bags of finished trials")
    run.add_argument("--draw-only", action="store_true", help="write trials, do not call the tool")
    score = commands.add_parser("score", help="open the answers")
    score.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "draw":
        kind = "healthy" if options.healthy else None
        effects = tuple(options.effect) if options.effect else None
        bags, sealed = options.out / "bags", options.out / "sealed"
        draw_trial(options.seed, bags, sealed, form=options.form, kind=kind, effects=effects, multiple=options.multiple)
        return 0
    if options.command == "run":
        run_trials(options)
        if options.draw_only:
            return 0
    print(report(load_trials(options.out)))
    return 0


def plan(series: int, number: int) -> dict[str, Any]:
    """What trial `number` (from 1) of a series conceals: kind, effects and multiple; the same for any length."""
    block, place = divmod(number - 1, len(BLOCK))
    order = np.random.default_rng([series, block, 1]).permutation(len(BLOCK))
    turn = int(order[place])
    kind = BLOCK[turn]
    multiple = MULTIPLES[int(np.random.default_rng([series, block, 2]).permutation(len(BLOCK))[turn]) % len(MULTIPLES)]
    before = sum(name == kind for name in BLOCK[:turn]) + block * BLOCK.count(kind)
    if kind == "healthy":
        return HEALTHY
    if kind == "two":
        rng = np.random.default_rng([series, block, turn, 3])
        while True:
            pair = {str(name) for name in rng.choice(KNOWN, 2, replace=False)}
            if not (pair & WEIGHTLESS_ONLY and pair & NEEDS_WEIGHT):
                return {"kind": kind, "effects": tuple(sorted(pair)), "multiple": multiple}
    names = KNOWN if kind == "one" else ABSENT
    lap, at = divmod(before, len(names))
    name = names[int(np.random.default_rng([series, lap, len(names), 4]).permutation(len(names))[at])]
    # Every lap shifts the amplitude, so that in three laps each effect has met each.
    return {"kind": kind, "effects": (name,), "multiple": MULTIPLES[(at + lap) % len(MULTIPLES)]}


def run_trials(options: argparse.Namespace) -> None:
    numbers = range(options.first, options.first + options.trials)
    finished = [n for n in numbers if went_well(folder(options.out, n))]
    todo = [n for n in numbers if n not in finished]
    print(f"{len(finished)} trials finished, {len(todo)} to do", flush=True)
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [pool.submit(one_trial, options, n) for n in todo]
        for done, job in enumerate(as_completed(jobs), start=1):
            print(f"[{done}/{len(todo)}] {job.result()}", flush=True)


def folder(out: Path, number: int) -> Path:
    return out / "trials" / f"{number:04}"


def went_well(place: Path) -> bool:
    """Whether the tool came to a verdict there (exit 0, or 1: data unfit)."""
    note = place / "finished.json"
    return note.exists() and json.loads(note.read_text(encoding="utf-8"))["exit"] in (0, 1)


def one_trial(options: argparse.Namespace, number: int) -> str:
    place, sealed = folder(options.out, number), options.out / "sealed" / f"{number:04}"
    bags = place / "bags"
    begin = time.perf_counter()
    if not (sealed / "answer.json").exists() or not (bags / "field_validation.mcap").exists():
        concealed = HEALTHY if options.healthy else plan(options.seed, number)
        draw_trial(options.seed * 100_000 + number, bags, sealed, form=options.form, **concealed)
    drawn = time.perf_counter() - begin
    if options.draw_only:
        return f"trial {number}: drawn in {drawn:.0f} s"
    seconds, code, error = call_tool(bags, place / "result")
    note = {"seconds": seconds, "exit": code, "error": error}
    (place / "finished.json").write_text(json.dumps(note), encoding="utf-8")
    if not options.keep and went_well(place):
        shutil.rmtree(bags)
    return f"trial {number}: drawn in {drawn:.0f} s, tool {seconds:.0f} s, exit {code} {error}"


def call_tool(bags: Path, result: Path) -> tuple[float, int, str]:
    """Seconds, exit status and last line of complaint of the command, called as a user would."""
    extra = bags / "arguments.json"
    command = [sys.executable, "-m", "spacearm_ident.cli.main", "mismatch"]
    command += ["--reference", str(bags / "commissioning.mcap"), str(bags / "field.mcap")]
    command += ["--validate", str(bags / "field_validation.mcap"), "--out", str(result), "--json"]
    command += json.loads(extra.read_text(encoding="utf-8")) if extra.exists() else []
    begin = time.perf_counter()
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, env=os.environ | threads)
        code, error = done.returncode, (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""
    except subprocess.TimeoutExpired:
        code, error = -1, f"longer than {LONGEST_S:g} s"
    return time.perf_counter() - begin, code, error


if __name__ == "__main__":
    sys.exit(main())
