"""What `spacearm mismatch` says of pairs of healthy recordings of one real arm, and of what is put into them.

    .venv/bin/python bench/real_pairs.py --out FILE [--arm ur10e] [--group pairs models] [--recordings DIR]
    .venv/bin/python bench/real_pairs.py --out FILE --only-summary

Groups: `pairs` (every healthy recording explained with every other of the same arm as reference, and the first half of
one with its second), `wrong` (a joint in degrees, two wrist joints exchanged, a push), `short` (three seconds as
reference or field, a joint at rest), `plants` (physics in real torque at 2 and 5 times what `identify` on the reference
leaves of the healthy field), `models` and `planted_models` (pairs and plants with the `model.yaml` that `identify`
makes of the reference in its place). Every trial calls the command as a user does, in a process of its own, one after
the other, and appends a line of JSON to FILE; run again, it goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

from real_pairs_plants import PLANTS, degrees, exchanged, healthy_residual, push, resting

from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.recording import Recording, read_recording, write_recording

CALL = "import sys; from spacearm_ident.cli.main import main; sys.exit(main())"
HEALTHY = {
    "ur10e": ("commissioning", "commissioning_2", "commissioning_validation"),
    "airbot": ("run_1", "run_1_repeated", "run_2", "run_3"),
    "panda": ("run_1", "run_2"),
    "rokae": ("run_1", "run_2"),
    "tx40": ("excitation",),
}
"""By arm: recordings between which nothing changed, as far as those who made them say."""
HALVED = (("ur10e", "commissioning"), ("airbot", "run_3"), ("airbot", "run_2"), ("tx40", "excitation"))
"""Recordings whose halves are a pair."""
CHANGED = {"ur10e": ("commissioning", "commissioning_2"), "airbot": ("run_1", "run_2")}
"""By arm: the reference and the field in which something is planted."""
PLANTED = {
    "ur10e": {"friction_drift": (1, 3), "torque_ripple": (2, 4), "payload": (1,)},
    "airbot": {"friction_drift": (0, 2), "torque_ripple": (1, 3), "payload": (1,)},
}
"""By arm and effect: the joints at which it is planted (of a payload: at which its size is measured)."""
MULTIPLES = (2.0, 5.0)
SHORT_S = 3.0
LONGEST_S = 900.0


@dataclass(frozen=True)
class Trial:
    """One call of the command.

    Attributes:
        name: Unique; what a line is known by.
        group: One of `GROUPS`.
        arm: Folder of the arm.
        right: Verdicts and names of effects any of which is right.
        bags: Makes reference and field recordings.
        wanted: Joint at which the effect is planted, if any.
        modelled: Whether a model of the reference stands in its place.
    """

    name: str
    group: str
    arm: str
    right: tuple[str, ...]
    bags: Callable[[], tuple[list[Recording], Recording]]
    wanted: str = ""
    modelled: bool = False


def trials(root: Path) -> Iterator[Trial]:
    """Every trial, arm by arm."""
    for arm in HEALTHY:
        yield from _pairs(root, arm)
        yield from _wrong(root, arm)
        yield from _short(root, arm)
        yield from _plants(root, arm)
        for group, made in (("models", _pairs(root, arm)), ("planted_models", _plants(root, arm))):
            for one in made:
                yield replace(one, name=f"{one.name}, model alone", group=group, modelled=True)


def _pairs(root: Path, arm: str) -> Iterator[Trial]:
    def bags(references: Sequence[str], field: str) -> tuple[list[Recording], Recording]:
        return [_read(root, arm, name) for name in references], _read(root, arm, field)

    quiet = ("no_mismatch",)
    for one, other in permutations(HEALTHY[arm], 2):
        yield Trial(f"{arm}: {one} > {other}", "pairs", arm, quiet, lambda a=one, b=other: bags([a], b))  # type: ignore[misc]
    for field in HEALTHY[arm] if len(HEALTHY[arm]) > 2 else ():
        others = [name for name in HEALTHY[arm] if name != field]
        yield Trial(f"{arm}: the others > {field}", "pairs", arm, quiet, lambda a=others, b=field: bags(a, b))  # type: ignore[misc]
    for _, name in (pair for pair in HALVED if pair[0] == arm):
        for first in (True, False):

            def halves(name: str = name, first: bool = first) -> tuple[list[Recording], Recording]:
                parts = _halves(_read(root, arm, name))
                return [parts[0 if first else 1]], parts[1 if first else 0]

            words = "first half > second" if first else "second half > first"
            yield Trial(f"{arm}: {name}, {words}", "pairs", arm, quiet, halves)


def _wrong(root: Path, arm: str) -> Iterator[Trial]:
    if arm not in CHANGED:
        return
    names = load_arm(root / arm / "arm.urdf").joint_names
    last = len(names) - 1
    made: dict[str, tuple[tuple[str, ...], Callable[[Recording], Recording]]] = {
        "joint 2 in degrees": (("data_unfit",), lambda field: degrees(field, field.joints.index(names[1]))),
        "wrist joints exchanged": (
            ("data_unfit",),
            lambda field: exchanged(field, field.joints.index(names[last - 1]), field.joints.index(names[last])),
        ),
        "pushed": (
            ("external_contact", "unknown"),
            lambda field: push(field.in_order(names), load_arm(root / arm / "arm.urdf")),
        ),
    }
    for words, (right, change) in made.items():
        yield Trial(f"{arm}: {words}", "wrong", arm, right, lambda change=change: _changed(root, arm, change))  # type: ignore[misc]


def _short(root: Path, arm: str) -> Iterator[Trial]:
    if arm not in CHANGED:
        return

    def bags(reference: bool, field: bool) -> tuple[list[Recording], Recording]:
        healthy, changed = (_read(root, arm, name) for name in CHANGED[arm])
        cut = [one.between(5.0, 5.0 + SHORT_S) for one in (healthy, changed)]
        return [cut[0] if reference else healthy], cut[1] if field else changed

    any_answer = ("no_mismatch", "data_unfit", "unknown")
    for words, which in {"reference": (True, False), "field": (False, True), "both": (True, True)}.items():
        yield Trial(f"{arm}: {SHORT_S:g} s, {words}", "short", arm, any_answer, lambda which=which: bags(*which))  # type: ignore[misc]
    for where in (0, len(load_arm(root / arm / "arm.urdf").joint_names) // 2):
        yield Trial(
            f"{arm}: joint {where + 1} at rest in both",
            "short",
            arm,
            any_answer,
            lambda where=where: (  # type: ignore[misc]
                [resting(_read(root, arm, CHANGED[arm][0]), where)],
                resting(_read(root, arm, CHANGED[arm][1]), where),
            ),
        )


def _plants(root: Path, arm: str) -> Iterator[Trial]:
    for effect, places in PLANTED.get(arm, {}).items():
        for joint in places:
            for multiple in MULTIPLES:

                def bags(effect: str = effect, joint: int = joint, multiple: float = multiple) -> Any:
                    model = load_arm(root / arm / "arm.urdf")
                    healthy, field = (_read(root, arm, name).in_order(model.joint_names) for name in CHANGED[arm])
                    size = multiple * healthy_residual(model, healthy, field)[joint]
                    return [healthy], PLANTS[effect](field, model, joint, float(size))

                where = load_arm(root / arm / "arm.urdf").joint_names[joint]
                name = f"{arm}: {effect} at {where}, {multiple:g} x"
                yield Trial(name, "plants", arm, (effect,), bags, "" if effect == "payload" else where)


def _read(root: Path, arm: str, name: str) -> Recording:
    return read_recording(root / arm / f"{name}.mcap")


def _changed(root: Path, arm: str, change: Callable[[Recording], Recording]) -> tuple[list[Recording], Recording]:
    healthy, field = (_read(root, arm, name) for name in CHANGED[arm])
    return [healthy], change(field)


def _halves(recording: Recording) -> tuple[Recording, Recording]:
    middle = 0.5 * (recording.time[0] + recording.time[-1])
    return recording.between(-1.0, middle), recording.between(middle, float("inf"))


def run(trial: Trial) -> dict[str, Any]:
    """Call the command; what it said, and what it took."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        references, field = trial.bags()
        words = ["mismatch", str(folder / "field.mcap")]
        write_recording(folder / "field.mcap", field)
        for number, one in enumerate(references):
            write_recording(folder / f"reference_{number}.mcap", one)
        healthy = [str(folder / f"reference_{number}.mcap") for number in range(len(references))]
        if trial.modelled:
            made = [sys.executable, "-c", CALL, "identify", *healthy, "--out", str(folder / "model"), "--quiet"]
            subprocess.run(made, capture_output=True, check=False)
            healthy = [str(folder / "model" / "model.yaml")]
        words += ["--reference", *healthy]
        words += ["--out", str(folder / "out"), "--json", "--quiet"]
        answer, complaint = folder / "answer.json", folder / "complaint.txt"
        begin = time.perf_counter()
        with answer.open("w") as out, complaint.open("w") as err:
            process = subprocess.Popen([sys.executable, "-c", CALL, *words], stdout=out, stderr=err)
            _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        said = {"exit": process.returncode, "seconds": round(seconds, 1), "peak_MB": round(used.ru_maxrss / 1024)}
        if not (told := answer.read_text()):
            error = complaint.read_text()
            return {**said, "verdict": "error", "error": error.strip().splitlines()[-1:], "traceback": "Trace" in error}
        return {**said, **_told(json.loads(told))}


def _told(document: dict[str, Any]) -> dict[str, Any]:
    """What matters of an answer."""
    return {
        "verdict": document["verdict"],
        "findings": [
            {
                "effect": finding["effect"],
                "joints": finding["joints"],
                "confidence": round(finding["confidence"], 2),
                "where": finding["where"],
            }
            for finding in document["findings"]
        ],
        "unexplained": {left["joints"][0]: round(left["fraction"], 2) for left in document["unexplained"]},
        "reasons": document["reasons"],
        **{
            key: {joint: value and round(value, 3) for joint, value in document[key].items()}
            for key in ("noise_floor_Nm", "residual_before_Nm", "residual_after_Nm")
        },
    }


def outcome(line: dict[str, Any]) -> str:
    """`right`, `quiet`, `unknown`, `wrong name`, `unfit`, `error` or `traceback`."""
    if line["verdict"] == "error":
        return "traceback" if line["traceback"] else "error"
    effects = [finding["effect"] for finding in line.get("findings", [])]
    first = effects[0] if effects else line["verdict"]
    at = not line["wanted"] or not effects or line["wanted"] in line["findings"][0]["joints"]
    if first in line["right"] and at and line["group"] not in ("pairs", "models"):
        return "right"
    if line["verdict"] == "data_unfit":
        return "unfit"
    if not effects:
        return "quiet"
    return "unknown" if set(effects) == {"unknown"} else "wrong name"


def summary(lines: Sequence[dict[str, Any]]) -> str:
    """Outcomes by group, counted."""
    text = ["group          trials  outcomes"]
    for group in GROUPS:
        mine = [outcome(line) for line in lines if line["group"] == group]
        if mine:
            counts = ", ".join(f"{name} {mine.count(name)}" for name in sorted(set(mine)))
            text.append(f"{group:14} {len(mine):6}  {counts}")
    times = sorted(line["seconds"] for line in lines)
    if times:
        memory = max(line["peak_MB"] for line in lines)
        text.append(f"seconds: median {times[len(times) // 2]:g}, longest {times[-1]:g}; peak memory {memory} MB")
    return "\n".join(text)


def words(line: dict[str, Any]) -> str:
    """One trial in a line of text."""
    said = [
        f"{f['effect']} at {', '.join(f['joints'])} ({f['confidence']:.2f})" for f in line.get("findings", [])
    ] or line.get("reasons", line.get("error", []))
    left = (
        f"; left: {', '.join(f'{j} {s:.0%}' for j, s in line['unexplained'].items())}" if "unexplained" in line else ""
    )
    return f"{outcome(line):10} {line['name']}: {line['verdict']}: {'; '.join(said)}{left} [{line['seconds']:g} s]"


GROUPS = ("pairs", "wrong", "short", "plants", "models", "planted_models")


def main() -> None:
    """Run what is not in the file yet, print a line each and the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="a line of JSON a trial is added to it")
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings/real"))
    parser.add_argument("--arm", nargs="+", choices=HEALTHY, default=list(HEALTHY), help="these arms alone")
    parser.add_argument("--group", nargs="+", choices=GROUPS, default=list(GROUPS), help="these groups alone")
    parser.add_argument("--match", default="", help="trials whose name contains this alone")
    parser.add_argument("--only-summary", action="store_true", help="run nothing, print what the file says")
    options = parser.parse_args()
    text = options.out.read_text(encoding="utf-8") if options.out.exists() else ""
    lines = [json.loads(line) for line in text.splitlines()]
    done = {line["name"] for line in lines}
    for trial in () if options.only_summary else trials(options.recordings):
        wanted = trial.arm in options.arm and trial.group in options.group and options.match in trial.name
        if not wanted or trial.name in done:
            continue
        known = {"name": trial.name, "group": trial.group, "right": trial.right, "wanted": trial.wanted}
        lines.append({**known, **run(trial)})
        with options.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(lines[-1]) + "\n")
        print(words(lines[-1]), flush=True)
    if options.only_summary:
        print("\n".join(words(line) for line in lines))
    print(summary(lines))


if __name__ == "__main__":
    main()
