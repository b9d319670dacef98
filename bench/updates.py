"""Updates of a real arm's model by seconds of another of its recordings, judged on the rest of that recording.

    .venv/bin/python bench/updates.py [--recordings DIR] [--only ARM...] [--seconds S...] [--json FILE]

Every recording of an arm is identified with the defaults; its model is updated (`--prior`) by the first seconds of
motion of every other one. The figure is the residual RMS on the moving rows of the rest, of the updated model over the
model as it was: by joint its logarithm's mean and median, how often it is above 1.02 and 1.2 or below 1/1.2, and the
largest. See docs/method.md.
"""

from __future__ import annotations

import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import argparse
import json
from collections.abc import Iterator, Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
from real_arms import NAMES, part
from real_arms_methods import moving_rows, torque_rows

from spacearm_ident.arrays import FloatArray
from spacearm_ident.bayes.from_prior import GroundPrior
from spacearm_ident.bayes.updated import identify_from_prior
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.identification.identify import identify
from spacearm_ident.recording import Recording
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare

ARMS = tuple(name for name, recordings in NAMES.items() if len(recordings) > 1)
MOVES = 0.02
"""rad in 0.1 s, of any joint: motion has begun."""
SHORTEST_S = 3.0
"""Of the rest of a recording, to be judged on."""


def first_motion_s(recording: Recording) -> float:
    """When any joint begins to move."""
    later = np.searchsorted(recording.time, recording.time + 0.1).clip(max=len(recording.time) - 1)
    moved = np.abs(recording.position[later] - recording.position).max(axis=1) > MOVES
    return float(recording.time[int(np.argmax(moved))])


def left_by(model: IdentifiedModel, motions: Sequence[Motion]) -> FloatArray:
    """(n,) residual RMS on moving rows, N m."""
    left = torque_rows(motions) - np.concatenate([motion.reduce(model.torque(motion)) for motion in motions])
    moving = moving_rows(motions)
    return np.asarray(np.sqrt((left**2 * moving).sum(axis=0) / moving.sum(axis=0)))


def ratios(root: Path, arm: str, seconds: Sequence[float]) -> Iterator[tuple[str, str, float, FloatArray]]:
    """Recording identified, recording that updates it, for so many seconds, and (n,) the figure."""
    described = load_arm(root / arm / "arm.urdf")
    recordings = {letter: part(root, arm, letter) for letter in NAMES[arm]}
    grounds = {letter: identify([one], described) for letter, one in recordings.items()}
    for first, second in permutations(recordings, 2):
        ground, recording = grounds[first], recordings[second]
        start = first_motion_s(recording)
        for duration in seconds:
            rest = recording.between(start + duration, float(recording.time[-1]))
            if len(rest.time) < 2 or rest.time[-1] - rest.time[0] < SHORTEST_S:
                continue
            judged, _ = prepare([rest], described.joint_names, ground.model.cutoff_hz)
            updated = identify_from_prior([recording.between(start, start + duration)], GroundPrior.of(ground))
            yield first, second, duration, left_by(updated.model, judged) / left_by(ground.model, judged)


def line(name: str, found: FloatArray) -> str:
    """A row of the table."""
    logs = np.log(found)
    counts = [int(np.sum(condition)) for condition in (found > 1.02, found > 1.2, found < 1.0 / 1.2)]
    figures = (
        f"{logs.mean():+.3f} | {np.median(logs):+.3f} | {counts[0]} | {counts[1]} | {counts[2]} | {found.max():.2f}"
    )
    return f"| {name} | {len(found)} | {figures} |"


def main() -> int:
    """Identify, update, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings/real"))
    parser.add_argument("--only", nargs="+", choices=ARMS, default=list(ARMS), help="these arms alone")
    parser.add_argument("--seconds", nargs="+", type=float, default=[5.0, 10.0], metavar="S", help="default: 5 10")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure there as well")
    options = parser.parse_args()
    found = [(arm, *one) for arm in options.only for one in ratios(options.recordings, arm, options.seconds)]
    print("| arm, seconds | joints | mean log | median log | > 1.02 | > 1.2 | < 1/1.2 | largest |\n|" + "---|" * 8)
    for arm in options.only:
        for duration in options.seconds:
            chosen = [one[-1] for one in found if one[0] == arm and one[3] == duration]
            print(line(f"{arm}, {duration:g} s", np.concatenate(chosen))) if chosen else None
    print(line("all", np.concatenate([one[-1] for one in found])))
    if options.json:
        rows = [[*one[:-1], one[-1].tolist()] for one in found]
        options.json.write_text(json.dumps(rows) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
