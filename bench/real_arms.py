"""Identification on real arms beside a plain model and a black box, judged on held-out recordings.

    .venv/bin/python -m pip install -c constraints.txt scikit-learn
    .venv/bin/python bench/real_arms.py [--halves] [--recordings DIR] [--only ARM] [--json FILE]
    .venv/bin/python bench/real_arms.py --arm URDF --fit BAG... --validate BAG... [--json FILE]

Plain: base parameters, rotor inertia, Coulomb, viscous, offset; least squares weighted by joint, no prior. Black box:
the plain model and, by joint, the better in cross-validation of gradient boosting and kernel ridge, fitted to what the
plain model leaves. Ours: `identify` with its defaults; the black box fitted to what that leaves shows what there still
is to find. All are fitted on the moving rows of the same motions and judged on the moving rows of the held-out
recordings, at the bandwidth that `identify` chose. With `--halves` half a recording at a time is fitted. See
docs/real_arms.md.
"""

from __future__ import annotations

import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from real_arms_methods import Plain, black_box, features, moving_rows, torque_rows

from spacearm_ident.dynamics.arm import Arm, load_arm
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import Recording, read_recording
from spacearm_ident.signals.prepare import prepare

NAMES = {
    "ur10e": {"A": "commissioning", "B": "commissioning_2", "C": "commissioning_validation"},
    "airbot": {"A": "run_1", "B": "run_2", "C": "run_3", "R": "run_1_repeated"},
    "panda": {"A": "run_1", "B": "run_2"},
    "rokae": {"A": "run_1", "B": "run_2"},
    "tx40": {"A": "excitation"},
}
SPLITS = {
    "ur10e": ("A B > C", "A C > B", "B C > A", "A > B", "A > C", "B > A", "B > C", "C > A", "C > B"),
    "airbot": ("A B > C", "A C > B", "B C > A", "A > B", "B > C", "C > R"),
    "panda": ("A > B", "B > A", "A:0-0.66 > A:0.66-1"),
    "rokae": ("A > B", "B > A"),
    "tx40": ("A:0-0.66 > A:0.66-1", "A:0.33-1 > A:0-0.33"),
}
"""By arm: recordings fitted > held out, as letters of `NAMES`; `:0-0.66` is that share of the recording's duration."""
LEAST_ROWS = 50
"""Moving rows of a joint, in fit and held-out recordings alike, below which it is left out: two to five seconds."""
TOLERANCE = 0.02
"""Share of the plain model's RMS by which ours must exceed it to count as worse."""


@dataclass(frozen=True)
class Case:
    """A split: the arm, the recordings to fit, the held-out ones, and a name."""

    name: str
    arm: Arm
    fit: list[Recording]
    held_out: list[Recording]


@dataclass(frozen=True)
class Line:
    """A joint of a case: relative RMS (residual over torque) on the held-out moving rows, in %.

    `both` is ours with the black box on what it leaves.
    """

    case: str
    joint: str
    rows: int
    plain: float
    black_box: float
    ours: float
    both: float
    learner: str

    @property
    def removed_by_black_box(self) -> float:
        """Share of the plain model's mean square residual that the black box removes; below 0: adds."""
        return 1.0 - (self.black_box / self.plain) ** 2

    @property
    def removed(self) -> float:
        """Share of the plain model's mean square residual that ours removes; below 0: adds."""
        return 1.0 - (self.ours / self.plain) ** 2

    @property
    def left_to_find(self) -> float:
        """Share of our mean square residual that the black box removes; below 0: adds."""
        return 1.0 - (self.both / self.ours) ** 2

    @property
    def worse(self) -> bool:
        """Whether ours is worse than the plain model beyond the tolerance."""
        return self.ours > (1.0 + TOLERANCE) * self.plain


def compare(case: Case) -> list[Line]:
    """Fit the three and judge them.

    Args:
        case: The split.

    Returns:
        A line a joint that moves in `LEAST_ROWS` rows of the fit and of the held-out recordings.

    Raises:
        UserError: A recording cannot be used with this arm; as `UnfitDataError` where it is too short or nothing moves.
    """
    ours = identify(case.fit, case.arm).model
    motions, _ = prepare(case.fit, case.arm.joint_names)
    held_out, _ = prepare(case.held_out, case.arm.joint_names, ours.cutoff_hz)
    plain = Plain(case.arm, motions)
    measured, moving, fit_moving = torque_rows(held_out), moving_rows(held_out), moving_rows(motions)
    rest, left = torque_rows(motions) - plain.torque(motions), measured - plain.torque(held_out)
    rest_of_ours, left_by_ours = (
        torque_rows(some) - np.concatenate([motion.reduce(ours.torque(motion)) for motion in some])
        for some in (motions, held_out)
    )
    inputs, held_out_inputs = features(motions), features(held_out)
    lines = []
    for j, joint in enumerate(case.arm.joint_names):
        fitted, judged = fit_moving[:, j], moving[:, j]
        if min(fitted.sum(), judged.sum()) < LEAST_ROWS:
            continue
        name, learner = black_box(inputs[fitted], rest[fitted, j])
        left_by_box = left[judged, j] - learner.predict(held_out_inputs[judged])
        further = black_box(inputs[fitted], rest_of_ours[fitted, j])[1]
        left_by_both = left_by_ours[judged, j] - further.predict(held_out_inputs[judged])
        figures = [
            100.0 * float(np.linalg.norm(residual) / np.linalg.norm(measured[judged, j]))
            for residual in (left[judged, j], left_by_box, left_by_ours[judged, j], left_by_both)
        ]
        lines.append(Line(case.name, joint, int(judged.sum()), *figures, learner=name))
    return lines


def part(root: Path, arm: str, word: str) -> Recording:
    """A recording of `NAMES`, or a share of its duration, from a word of `SPLITS`."""
    letter, _, share = word.partition(":")
    recording = read_recording(root / arm / f"{NAMES[arm][letter]}.mcap")
    if not share:
        return recording
    first, last = (float(bound) for bound in share.split("-"))
    start, duration = recording.time[0], recording.time[-1] - recording.time[0]
    return recording.between(start + first * duration, start + last * duration)


def halves(arm: str) -> Iterator[str]:
    """Splits in which half a recording is fitted, or its middle: short data, and many of them."""
    for letter in NAMES[arm]:
        others = " ".join(other for other in NAMES[arm] if other != letter)
        for half, rest in (("0-0.5", "0.5-1"), ("0.5-1", "0-0.5")):
            yield f"{letter}:{half} > {letter}:{rest}"
            if others:
                yield f"{letter}:{half} > {others}"
        yield f"{letter}:0.2-0.8 > {letter}:0-0.2 {letter}:0.8-1"


def cases(root: Path, only: Sequence[str], of_halves: bool = False) -> Iterator[Case]:
    """The splits of `SPLITS`, or of `halves`, of the arms in `only` where it names any."""
    for name in only or SPLITS:
        arm = load_arm(root / name / "arm.urdf")
        for split in halves(name) if of_halves else SPLITS[name]:
            fit, held_out = ([part(root, name, word) for word in side.split()] for side in split.split(">"))
            yield Case(f"{name} {split.replace('>', '→')}", arm, fit, held_out)


def summary(lines: Sequence[Line]) -> dict[str, float]:
    """The figures below the table."""
    return {
        "joints": len(lines),
        "median_removed": float(np.median([line.removed for line in lines])),
        "median_removed_by_black_box": float(np.median([line.removed_by_black_box for line in lines])),
        "more_than_black_box": sum(line.removed > line.removed_by_black_box for line in lines),
        "median_left_to_find": float(np.median([line.left_to_find for line in lines])),
        "worse_than_plain": sum(line.worse for line in lines),
    }


def row(line: Line) -> str:
    """A row of the table."""
    shares = " | ".join(f"{100 * x:.0f}" for x in (line.removed_by_black_box, line.removed, line.left_to_find))
    figures = f"{line.plain:.2f} | {line.black_box:.2f} | {line.ours:.2f} | {shares}"
    return f"| {line.case} | {line.joint} | {figures} | {'worse' if line.worse else ''} |"


def options() -> argparse.Namespace:
    """What the caller asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings/real"))
    parser.add_argument("--only", nargs="+", choices=SPLITS, default=[], help="these arms alone")
    parser.add_argument("--halves", action="store_true", help="fit half a recording at a time")
    parser.add_argument("--arm", type=Path, help="URDF (or arm YAML) of recordings of your own")
    parser.add_argument("--fit", nargs="+", type=Path, default=[], metavar="BAG")
    parser.add_argument("--validate", nargs="+", type=Path, default=[], metavar="BAG", help="held-out recordings")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write lines and summary there as well")
    chosen = parser.parse_args()
    if any((chosen.arm, chosen.fit, chosen.validate)) and not all((chosen.arm, chosen.fit, chosen.validate)):
        parser.error("recordings of your own take --arm, --fit and --validate together")
    return chosen


def run(chosen: argparse.Namespace) -> list[Line]:
    """Compare case by case; print a row a joint."""
    if chosen.arm:
        bags = [[read_recording(path) for path in paths] for paths in (chosen.fit, chosen.validate)]
        posed: Iterator[Case] = iter([Case(chosen.arm.stem, load_arm(chosen.arm), *bags)])
    else:
        posed = cases(chosen.recordings, chosen.only, chosen.halves)
    print("| case | joint | plain | black box | ours | removed by black box | removed by ours | left to find | |")
    print("|---|---|---|---|---|---|---|---|---|")
    lines = []
    for case in posed:
        try:
            found = compare(case)
        except UnfitDataError as error:
            print(f"| {case.name} | – | | | | | | | unfit: {error} |", flush=True)
            continue
        for line in found:
            print(row(line), flush=True)
        if not found:
            print(f"| {case.name} | – | | | | | | | no joint moves in {LEAST_ROWS} rows of both |", flush=True)
        lines += found
    return lines


def main() -> int:
    """Run, print the summary; 0: done, 1: no joint could be judged, 2: unusable input."""
    chosen = options()
    try:
        lines = run(chosen)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    if not lines:
        return 1
    found = summary(lines)
    print(f"\nMedian share of the plain residual removed: ours {100 * found['median_removed']:.0f} %, ", end="")
    print(f"black box {100 * found['median_removed_by_black_box']:.0f} %.")
    print(f"Ours removes more than the black box in {found['more_than_black_box']} of {len(lines)} joints;", end=" ")
    print(f"the black box then removes {100 * found['median_left_to_find']:.0f} % of what is left (median).")
    print(f"Ours is worse than plain by more than {100 * TOLERANCE:.0f} % in {found['worse_than_plain']}.")
    if chosen.json:
        derived = ("removed", "removed_by_black_box", "left_to_find", "worse")
        rows = [{**asdict(line), **{key: getattr(line, key) for key in derived}} for line in lines]
        chosen.json.write_text(json.dumps({"lines": rows, "summary": found}, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
