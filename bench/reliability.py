"""How often findings of `spacearm mismatch` were right in blind trials, and what that makes of stated confidences.

    python bench/reliability.py [--series DRAWS RESULTS.jsonl ...] [--stated DRAWS RESULTS.jsonl ...]

DRAWS and RESULTS are those of `bench/blind_series`. By situation (`spacearm_ident/mismatch/reliability.py`): findings,
right ones, and the share of right ones divided by the mean weight, which is what the program multiplies by. Then the
reliability diagram and the Brier score of weights and of confidences, each series judged by the shares of the others.
Results of `--series` hold weights: those of seeds 1 to 5. Later ones hold confidences, `--stated`, which are divided by
today's shares.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spacearm_ident.mismatch.reliability import RIGHT, Situation, situations

sys.path.insert(0, str(Path(__file__).with_name("blind_series")))
import score

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.01)


class Judged(NamedTuple):
    """One finding: series, situation, weight among the explanations compared, and whether its name was right."""

    series: int
    where: Situation
    weight: float
    right: bool


def judged(series: Sequence[tuple[Path, Path]], stated: Sequence[tuple[Path, Path]] = ()) -> list[Judged]:
    """Every finding of every series; names of the same torque are right."""
    found = []
    for number, (draws, results) in enumerate((*series, *stated)):
        for answer, line in score.load(draws, results):
            findings = line.get("findings") or []
            where = situations([(finding["effect"], finding["joints"]) for finding in findings])
            right = score.judge(answer, line)["wide"]
            shown = [1.0 if number < len(series) else RIGHT[one] for one in where]
            weights = [finding["confidence"] / share for finding, share in zip(findings, shown)]
            found += [Judged(number, *one) for one in zip(where, weights, right)]
    return found


def shares(found: Sequence[Judged]) -> dict[Situation, float]:
    """Right findings over the sum of weights, by situation; half a finding each way where there are few."""
    by = {where: [one for one in found if one.where is where] for where in Situation}
    return {
        where: (sum(one.right for one in some) + 0.5) / (sum(one.weight for one in some) + 1.0)
        for where, some in by.items()
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("--series", "--stated"):
        parser.add_argument(name, type=Path, nargs=2, action="append", default=[], metavar=("DRAWS", "RESULTS"))
    chosen = parser.parse_args()
    found = judged(chosen.series, chosen.stated)
    whole = shares(found)
    for where in Situation:
        some = [one for one in found if one.where is where]
        print(
            f"{where.value:55s} {sum(one.right for one in some):3d} of {len(some):3d} right, factor {whole[where]:.2f}"
        )
    stated, weights, names = [], [], []
    for number in sorted({one.series for one in found}):
        others = shares([one for one in found if one.series != number])
        for one in (one for one in found if one.series == number):
            stated.append(one.weight * others[one.where])
            weights.append(one.weight)
            names.append(one.right)
    truth = np.array(names, float)
    for name, values in (("weight", np.array(weights)), ("confidence, from the other series", np.array(stated))):
        print(f"{name}: Brier score {np.mean((values - truth) ** 2):.3f}")
        for low, high in pairwise(EDGES):
            inside = (values >= low) & (values < high)
            if inside.any():
                print(
                    f"  stated {low:.1f} to {min(high, 1.0):.1f}: {inside.sum():3d} findings, "
                    f"mean {values[inside].mean():.2f}, right {truth[inside].mean():.2f}"
                )


if __name__ == "__main__":
    main()
