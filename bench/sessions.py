"""How often two recordings of one real arm, identified apart, agree within their 95 % intervals.

    .venv/bin/python bench/sessions.py [--recordings DIR] [--only ARM...] [--json FILE] [--each]

Every recording of an arm, every half of one, and all recordings but one together are identified with the defaults. For
every pair of recordings, of halves of one, and of one and all the others ("pooled"), of every parameter that both call
determined by the data, the difference d is compared with its standard error s = sqrt(s1^2 + s2^2): the share with
|d| < 1.96 s, which is 95 % where the standard errors are right, and the RMS of z = d / s, which is 1. The same for base
parameters before physical consistency is imposed. See docs/method.md.
"""

from __future__ import annotations

import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from real_arms import NAMES, part

from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.identify import identify

NORMAL = 1.959964
"""Half width of a 95 % interval, in standard errors."""
SAME_ROW = 1e-6
"""Two base parameters are the same where their regroupings differ by less than this share."""
HALVES = ("0-0.5", "0.5-1")
KINDS = ("sessions", "halves", "pooled")


@dataclass(frozen=True)
class Pair:
    """Two identifications of one arm, and z of what both determine, by name.

    Attributes:
        arm, kind, first, second: Which; `kind` is one of `KINDS`.
        parameters: z of parameters that both call determined.
        base: z of base parameters.
    """

    arm: str
    kind: str
    first: str
    second: str
    parameters: dict[str, float]
    base: dict[str, float]


def parameters(first: Identified, second: Identified) -> dict[str, float]:
    """The z of every parameter and constant that both call determined by the data."""
    others = {item.name: item for item in second.estimates if item.identifiable}
    return {
        item.name: (item.value - others[item.name].value)
        / float(np.hypot(item.standard_error, others[item.name].standard_error))
        for item in first.estimates
        if item.identifiable and item.name in others
    }


def base(first: Identified, second: Identified) -> dict[str, float]:
    """The z of the base parameters that both have, made of the same parameters in the same shares."""
    found = {}
    for name, value, error, row in zip(first.base.names, first.base_values, first.base_errors, first.base.regrouping):
        if name not in second.base.names:
            continue
        k = second.base.names.index(name)
        other = second.base.regrouping[k]
        alike = len(other) == len(row) and np.abs(other - row).max() < SAME_ROW * np.abs(row).max()
        if alike and min(error, second.base_errors[k]) > 0.0:
            found[name] = float((value - second.base_values[k]) / np.hypot(error, second.base_errors[k]))
    return found


def pairs(root: Path, arm: str) -> Iterator[Pair]:
    """Every pair of recordings of an arm, of the halves of each, and of one recording and all others."""
    urdf, known = load_arm(root / arm / "arm.urdf"), {}

    def identified(words: str) -> Identified | None:
        if words not in known:
            try:
                known[words] = identify([part(root, arm, word) for word in words.split()], urdf)
            except UnfitDataError as error:
                print(f"{arm} {words}: unfit: {error}", file=sys.stderr)
                known[words] = None
        return known[words]

    sessions = [("sessions", *pair) for pair in combinations(NAMES[arm], 2)]
    halves = [("halves", *(f"{word}:{half}" for half in HALVES)) for word in NAMES[arm]]
    others = [(word, " ".join(other for other in NAMES[arm] if other != word)) for word in NAMES[arm]]
    pooled = [("pooled", *pair) for pair in others if " " in pair[1]]
    for kind, *words in (*sessions, *halves, *pooled):
        first, second = (identified(word) for word in words)
        if first is not None and second is not None:
            yield Pair(arm, kind, *words, parameters(first, second), base(first, second))


def line(name: str, zs: Sequence[float]) -> str:
    """Share within 1.96 standard errors, the count, and RMS z."""
    if not zs:
        return f"{name:<34}   none"
    z = np.array(zs)
    held = np.abs(z) < NORMAL
    return f"{name:<34}{held.mean():>7.1%}  {held.sum():>5} of {len(z):<5} RMS z {np.sqrt(np.mean(z**2)):.2f}"


def gathered(found: Sequence[Pair], keep: Callable[[Pair], bool], what: str) -> list[float]:
    """The z of all pairs that are kept."""
    return [z for pair in found if keep(pair) for z in getattr(pair, what).values()]


def main() -> int:
    """Identify, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings/real"))
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES), help="these arms alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every z there as well")
    parser.add_argument("--each", action="store_true", help="print what disagrees beyond 1.96, pair by pair")
    options = parser.parse_args()
    found = []
    for arm in options.only:
        for pair in pairs(options.recordings, arm):
            found.append(pair)
            print(line(f"{arm} {pair.first} | {pair.second}", list(pair.parameters.values())), flush=True)
            if options.each:
                out = sorted(((z, name) for name, z in pair.parameters.items() if abs(z) > NORMAL), key=lambda x: x[0])
                print("    " + "  ".join(f"{name} {z:+.1f}" for z, name in out))
    print()
    for kind in KINDS:
        for arm in options.only:
            chosen = gathered(found, lambda one, a=arm, k=kind: (one.arm, one.kind) == (a, k), "parameters")
            print(line(f"{arm}, {kind}", chosen)) if chosen else None
    for what in ("parameters", "base"):
        for kind in KINDS:
            print(line(f"all {kind}, {what}", gathered(found, lambda one, k=kind: one.kind == k, what)))
        print(line(f"all, {what}", gathered(found, lambda _: True, what)))
    if options.json:
        options.json.write_text(json.dumps([vars(pair) for pair in found], indent=1) + "\n", encoding="utf-8")
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main())
