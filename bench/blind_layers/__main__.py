"""`python -m bench.blind_layers draw | run | score`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path


def main() -> None:
    """Draw, run or score the series."""
    parser = argparse.ArgumentParser(prog="python -m bench.blind_layers", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("draw", help="write trials and their sealed answers")
    run = commands.add_parser("run", help="run the program on the trials; resumes")
    score = commands.add_parser("score", help="compare what the program said with the answers")
    for each in (draw, run, score):
        each.add_argument("--bags", type=Path, required=True, help="folder of the trials")
    for each in (draw, score):
        each.add_argument("--sealed", type=Path, required=True, help="folder of the answers")
    for each in (run, score):
        each.add_argument("--results", type=Path, required=True, help="JSON lines, one a trial")
    draw.add_argument("--seed", type=int, default=1)
    for each in (draw, run):
        each.add_argument("--first", type=int, default=0)
        each.add_argument("--count", type=int, default=60)
    run.add_argument("--timeout", type=float, default=600.0, help="processor time a trial, s")
    run.add_argument("--wall", type=float, default=600.0, help="time by the clock a trial, s")
    run.add_argument("--until", default="", help="HH:MM after which no trial is begun")
    score.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.command == "draw":
        from .draw import draw_trial

        for trial in range(given.first, given.first + given.count):
            if (given.sealed / f"{trial:03d}.json").exists():
                continue
            begin = time.time()
            answer = draw_trial(trial, given.seed, given.bags, given.sealed)
            print(f"{trial:03d} {answer['arm']} {time.time() - begin:.1f} s", flush=True)
    elif given.command == "run":
        from .run import run_all

        trials = range(given.first, given.first + given.count)
        run_all(given.bags, given.results, trials, given.timeout, given.wall, given.until)
    else:
        from .score import main as score_main

        score_main(given.bags, given.sealed, given.results, given.json)


if __name__ == "__main__":
    main()
