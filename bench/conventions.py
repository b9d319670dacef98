"""How often `spacearm check` names an ordinary mistake in a recording, and how often one that is not there.

`draw` writes bags with one mistake each and sound ones, the answers apart; `run` calls the command on each bag and sees
no answer; `score` compares. The mistakes are in `conventions_draw`, the arms in `conventions_arms`, the criterion of
what no recording could tell in `conventions_oracle`.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from conventions_arms import REAL, SIMULATED
from conventions_draw import EXTRAS, KINDS, draw
from conventions_oracle import TOLD_SIZE
from scipy.stats import binomtest

NAMES = {name: name for name in ("sound", *KINDS, *EXTRAS)} | {
    "effort_sign": "torque_sign",
    "degrees": "degrees_one",
    "swapped": "exchanged",
    "effort_unit": "torque_unit",
    "time_delay": "delay",
    "at_rest": "rest",
    "encoder_zero": "zero_offset",
    "positions_exchanged": "exchanged",
    "efforts_exchanged": "exchanged",
    "joints_exchanged": "exchanged",
    "time_reversed": "clock",
    "clock_order": "clock",
    "clock_jitter": "clock",
}
"""The command's names of kinds -> the names here. Edit this when the command has other names."""
ALIKE = {"degrees_all": {"degrees_one"}, "axis_reversed": {"position_sign", "torque_sign"}}
"""Names that are right too, if the joints are."""
WHOLE_ARM = ("gravity", "delay", "clock")
"""Kinds of which the joints are not asked."""
RECORDINGS = Path(__file__).resolve().parents[1] / "../shared/recordings/real"
BELIEVED = 0.5
"""Probability from which a finding counts as said."""
LONGEST_S = 600.0
OUTCOMES = ("right", "right, and more", "equivalent", "wrong", "missed", "no answer")
"""`equivalent`: another mistake that the recording fits as well. `wrong`: the likeliest finding is another."""


def plan(per_kind: int, extra: int, sound: int) -> list[tuple[str, bool, str]]:
    """Kind, real or not, and arm of every trial: half of the mistakes and two fifths of the sound ones are real."""
    trials = []
    simulated = tuple(SIMULATED)
    for k, (kind, count) in enumerate([*((n, per_kind) for n in KINDS), *((n, extra) for n in EXTRAS)]):
        for i in range(count):
            real = i % 2 == 0 and kind != "rest"
            arms = REAL if real else simulated
            trials.append((kind, real, arms[(i // 2 + k) % len(arms)]))
    for i in range(sound):
        real = i % 5 < 2
        arms = REAL if real else simulated
        trials.append(("sound", real, arms[(i // 5 + i) % len(arms)]))
    return trials


def draw_all(options: argparse.Namespace) -> int:
    trials = plan(options.per_kind, options.extra, options.sound)
    order = np.random.default_rng([options.seed, 0]).permutation(len(trials))
    for folder in ("bags", "answers"):
        (options.out / folder).mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(options.jobs) as pool:
        waiting = [
            pool.submit(draw, (options.seed, number), trials[k], options.recordings, options.out)
            for number, k in enumerate(order, start=1)
            if not (options.out / "answers" / f"{number:04d}.json").exists()
        ]
        for count, done in enumerate(as_completed(waiting), start=1):
            print(f"\r{done.result()}: {count} of {len(waiting)}", end="", flush=True)
    print(f"\n{len(trials)} trials in {options.out}")
    return 0


def check(command: list[str], bag: Path) -> dict[str, Any]:
    """What the command says of one bag."""
    arm = bag.with_suffix(".yaml")
    call = [*command, str(bag), *(["--arm", str(arm)] if arm.exists() else []), "--json"]
    began = time.monotonic()
    said: dict[str, Any] = {"trial": bag.stem}
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return said | {"error": f"over {LONGEST_S:.0f} s"}
    said |= {"exit": done.returncode, "seconds": round(time.monotonic() - began, 2)}
    try:
        return said | {"findings": json.loads(done.stdout)["findings"]}
    except (ValueError, KeyError, TypeError):
        return said | {"error": (done.stderr.strip().splitlines() or ["no JSON"])[-1]}


def run_all(options: argparse.Namespace) -> int:
    known = {entry["trial"] for entry in _lines(options.results)} if options.results.exists() else set()
    bags = [bag for bag in sorted((options.draws / "bags").glob("*.mcap")) if bag.stem not in known]
    with options.results.open("a", encoding="utf-8") as file, ThreadPoolExecutor(options.jobs) as pool:
        waiting = [pool.submit(check, shlex.split(options.command), bag) for bag in bags]
        for count, done in enumerate(as_completed(waiting), start=1):
            file.write(json.dumps(done.result()) + "\n")
            file.flush()
            print(f"\r{count} of {len(bags)}", end="", flush=True)
    print()
    return 0


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def named(entry: dict[str, Any], answer: dict[str, Any]) -> list[tuple[str, set[str]]]:
    """What was said with enough belief, best first: one kind once, its joints together; true words on rest left out."""
    said: dict[str, set[str]] = {}
    # With a note alone the command calls the data sound; joints at rest are never more than a note.
    faults = [f for f in entry["findings"] if f.get("level") != "note" or f["kind"] == "at_rest"]
    findings = [f for f in faults if (f.get("probability") or 0.0) >= BELIEVED]
    for finding in sorted(findings, key=lambda f: -f["probability"]):
        kind, joints = NAMES.get(finding["kind"], finding["kind"]), set(finding.get("joints") or [])
        if kind == "rest" and answer["kind"] != "rest" and joints <= set(answer["at_rest"]):
            continue
        said.setdefault(kind, set()).update(joints)
    return list(said.items())


def _fits(said: tuple[str, set[str]], kind: str, joints: set[str]) -> bool:
    """Whether one thing said is the mistake; of one of all joints, at least half of them must be named, or none."""
    name, where = said
    if name != kind and name not in ALIKE.get(kind, ()):
        return False
    if kind in WHOLE_ARM:
        return True
    if kind in ("degrees_all", "torque_unit"):
        return (not where and name == kind) or len(where & joints) >= len(joints) / 2
    if kind == "rest":
        return bool(where) and where <= joints
    return where == joints


def outcome(said: list[tuple[str, set[str]]], answer: dict[str, Any]) -> str:
    """One of `OUTCOMES`."""
    if not said or said[0][0] == "no answer":
        return "no answer" if said else "missed"
    if _fits(said[0], answer["kind"], set(answer["joints"])):
        more = [one for one in said[1:] if not _fits(one, answer["kind"], set(answer["joints"]))]
        return "right, and more" if more else "right"
    same = answer.get("equivalents", [])
    return "equivalent" if any(_fits(said[0], kind, set(joints)) for kind, joints in same) else "wrong"


def _share(count: int, total: int) -> str:
    low, high = binomtest(count, total).proportion_ci(method="wilson") if total else (0.0, 1.0)
    return f"{count:4d} of {total:<4d}{100 * low:4.0f}–{100 * high:<4.0f}%"


def _table(title: str, rows: dict[str, list[str]]) -> None:
    """Outcomes by row; the interval is that of `right` with or without more."""
    print(f"\n{title:26s}" + "".join(f"{word:>16s}" for word in OUTCOMES) + "   right, with 95 % interval")
    everything = [word for words in rows.values() for word in words]
    for name, words in [*sorted(rows.items()), ("all", everything)]:
        good = sum(word in OUTCOMES[:2] for word in words)
        print(f"{name:26s}" + "".join(f"{words.count(w):16d}" for w in OUTCOMES) + f"   {_share(good, len(words))}")


def score_all(options: argparse.Namespace) -> int:
    """`CAD off`: the torque is not of the size that the URDF's masses make, and a word on its unit is no mere error."""
    tables: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    alarms: dict[str, list[list[str]]] = defaultdict(list)
    failed = []
    for entry in _lines(options.results):
        path = options.draws / "answers" / f"{entry['trial']}.json"
        answer = json.loads(path.read_text(encoding="utf-8"))
        if "findings" not in entry:
            failed.append(f"{entry['trial']} ({answer['kind']}, {answer['arm']}): {entry['error']}")
        found = named(entry, answer) if "findings" in entry else [("no answer", set())]
        kind = answer["kind"]
        if kind == "sound":
            odd = not 1 / TOLD_SIZE < answer["size"] < TOLD_SIZE
            names = [f"{name} (CAD off)" if odd and name == "torque_unit" else name for name, _ in found]
            alarms[answer["arm"]].append(names)
            continue
        word = outcome(found, answer)
        if options.list and word in ("wrong", "missed") and not answer["undeterminable"]:
            print(answer["trial"], answer["arm"], kind, answer["joints"], answer["detail"], "->", word, found)
        if answer["undeterminable"]:
            tables["undeterminable"][kind].append(word)
        else:
            tables["extra kinds" if kind in EXTRAS else "by kind"][kind].append(word)
            if kind in KINDS:
                tables["by arm"][answer["arm"]].append(word)
    for title in ("by kind", "by arm", "extra kinds", "undeterminable"):
        _table(title, tables[title])
    print("\nfalse alarms on sound recordings, runs without an answer among them")
    for arm, said in [*sorted(alarms.items()), ("all", [names for by_arm in alarms.values() for names in by_arm])]:
        kinds = sorted({name for names in said for name in names})
        counts = ", ".join(f"{name} {sum(name in names for names in said)}" for name in kinds)
        print(f"{arm:26s}{_share(sum(bool(names) for names in said), len(said))}   {counts}")
    print(f"\nruns without an answer: {len(failed)}", *failed[:20], sep="\n  ")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(required=True)
    one = parts.add_parser("draw", help="write bags and sealed answers; goes on where it was broken off")
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--per-kind", type=int, default=25)
    one.add_argument("--extra", type=int, default=15, help="trials of each further kind")
    one.add_argument("--sound", type=int, default=200)
    one.add_argument("--recordings", type=Path, default=RECORDINGS)
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(call=draw_all)
    two = parts.add_parser("run", help="call the command on every bag; goes on where it was broken off")
    two.add_argument("--draws", type=Path, required=True)
    two.add_argument("--results", type=Path, required=True, help="JSON lines, one a trial")
    two.add_argument("--command", default="spacearm check")
    two.set_defaults(call=run_all)
    for part in (one, two):
        part.add_argument("--jobs", type=int, choices=(1, 2), default=2)
    three = parts.add_parser("score", help="print the tables")
    three.add_argument("--draws", type=Path, required=True)
    three.add_argument("--results", type=Path, required=True)
    three.add_argument("--list", action="store_true", help="every trial that was missed or named wrong, too")
    three.set_defaults(call=score_all)
    options = parser.parse_args()
    return int(options.call(options))


if __name__ == "__main__":
    sys.exit(main())
