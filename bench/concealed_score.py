"""Open the answers of a blind trial and count.

*Strict*: the first finding's name is the concealed effect's. *With twins*: or the first finding lists it among its
alternatives as one that explains as much (a score of at least `TWIN_SCORE` of the finding's). A run that crashed or
found its data unfit counts as nothing found. The finding's value is compared with the truth as `COMPARED` says, else
by the name in the answer's `comparable` where the finding has a parameter of that name, else by its first; by size,
without the sign; and only where the concealed law is the usual one.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from concealed_draw import MULTIPLES
from scipy.stats import binomtest

TWIN_SCORE = 0.95
ALSO_CALLED = {"soft_base": "base_flexibility"}
"""What is concealed as absent, and what the catalogue calls its nearest; that name is no wrong one."""
FROM_ONE = ("efficiency", "scale")
"""Parameters that are 1 on a healthy arm: their distance from 1 is compared."""
NOTHING = "nothing"
Entry = dict[str, Any]


def _viscous(effect: Entry, arm: Entry) -> float:
    return float(arm["k_v1"][int(str(effect["joints"][0]).rsplit("_", 1)[1]) - 1])


COMPARED: dict[str, tuple[str, Callable[[Entry, Entry], float]] | None] = {
    # What is drawn is where full friction is reached: three times the length of its exponential.
    "presliding_hysteresis": ("d_s", lambda effect, arm: effect["parameters"]["distance"] / 3.0),
    "temperature_friction": (
        "alpha_v",
        lambda effect, arm: effect["parameters"]["viscous_slope"] * _viscous(effect, arm),
    ),
    "wrist_coupling": ("f", lambda effect, arm: effect["parameters"]["coulomb"]),
    # A heavy base shows by how little it turns; its mass by how little it shifts, which is a tenth of that.
    "floating_base": (
        "inertia",
        lambda effect, arm: (
            effect["parameters"]["base_ratio"] * sum(arm["mass_kg"]) * effect["parameters"].get("gyration", 0.4) ** 2
        ),
    ),
    # A knee in the answer, a cubic in the catalogue.
    "motor_saturation": None,
}
"""Effect -> (finding's parameter, what it should be, of the concealed effect and the arm); None: not comparable."""


@dataclass(frozen=True)
class Compared:
    """A found parameter beside the true one: which, its relative error, and whether the truth is in its interval."""

    key: str
    error: float
    inside: bool


@dataclass(frozen=True)
class Scored:
    """One trial: the answer and what the tool said."""

    number: int
    answer: Entry
    findings: list[Entry]
    failed: bool
    seconds: float

    @property
    def kind(self) -> str:
        """`healthy`, `one`, `two` or `absent`."""
        return str(self.answer["kind"])

    @property
    def first(self) -> str:
        """Name of the first finding."""
        return str(self.findings[0]["effect"]) if self.findings else NOTHING

    @property
    def truth(self) -> Entry:
        """The concealed effect, the stronger where there are two."""
        return max(self.answer["effects"], key=lambda effect: effect["multiple"])

    @property
    def strength(self) -> float:
        """The planned multiple of the noise floor that the reached one is next to: not every effect can be faint."""
        return min(MULTIPLES, key=lambda multiple: abs(np.log(max(self.truth["multiple"], 1e-6) / multiple)))

    def names(self, twins: bool) -> list[set[str]]:
        """What each finding may be called."""
        return [named(finding) if twins else {str(finding["effect"])} for finding in self.findings]

    def right(self, twins: bool) -> bool:
        """Whether the first finding is a concealed effect."""
        true = {effect["effect"] for effect in self.answer["effects"]}
        return bool(self.findings) and bool(self.names(twins)[0] & true)

    def rightly_unnamed(self) -> bool:
        """Whether what is absent from the catalogue was given no name of it, or that of its nearest."""
        return self.first in ("unknown", NOTHING, ALSO_CALLED.get(self.truth["effect"]))

    def both(self, twins: bool) -> bool:
        """Whether every concealed effect is among the findings."""
        named_ones = set().union(*self.names(twins)) if self.findings else set()
        return all(effect["effect"] in named_ones for effect in self.answer["effects"])

    def right_joint(self) -> bool:
        """Whether the first finding points at a concealed effect's joint or link, or at joints that show it."""
        said = set(self.findings[0].get("joints", [])) if self.findings else set()
        for effect in self.answer["effects"]:
            if effect["local"]:
                where = set(effect["joints"])
                if said & where and len(said) <= len(where) + 2:
                    return True
            else:
                shown = {joint for joint, multiple in effect["multiples"].items() if multiple >= 1.0}
                own = set(effect["joints"]) if len(effect["joints"]) < len(effect["multiples"]) else set()
                if said & (shown | own):
                    return True
        return False

    def compared(self) -> Compared | None:
        """The compared parameter as it was found and as it is, where the first finding is right."""
        effects = {effect["effect"]: effect for effect in self.answer["effects"]}
        parameters = self.findings[0].get("parameters") if self.findings else None
        if self.first not in effects or not parameters:
            return None
        effect, compared = effects[self.first], COMPARED.get(self.first, ())
        if compared is None or effect["law"] != "usual":
            return None
        if compared:
            key, true = compared[0], compared[1](effect, self.answer["arm"])
        else:
            key = effect["comparable"] if effect["comparable"] in parameters else next(iter(parameters))
            true = effect["parameters"].get(key, effect["parameters"][effect["comparable"]])
        if key not in parameters:
            return None
        value, (low, high) = float(parameters[key]["value"]), parameters[key]["ci95"]
        healthy = 1.0 if effect["comparable"] in FROM_ONE else 0.0
        size, true_size = abs(value - healthy), abs(float(true) - healthy)
        return Compared(f"{self.first}.{key}", abs(size / true_size - 1.0), abs(size - true_size) <= (high - low) / 2)


def named(finding: Entry) -> set[str]:
    """Every name the finding leaves open."""
    others = finding.get("alternatives", [])
    open_ones = {str(other["effect"]) for other in others if float(other.get("score", 0.0)) >= TWIN_SCORE}
    return {str(finding["effect"])} | open_ones


def load_trials(out: Path) -> list[Scored]:
    """All finished trials of a run."""
    trials = []
    for path in sorted(out.glob("trials/*/finished.json")):
        finished = json.loads(path.read_text(encoding="utf-8"))
        answer = json.loads((out / "sealed" / path.parent.name / "answer.json").read_text(encoding="utf-8"))
        said = path.parent / "result" / "mismatch.json"
        document = json.loads(said.read_text(encoding="utf-8")) if said.exists() else {}
        findings = document.get("findings", []) if document.get("verdict") == "mismatch" else []
        failed = document.get("verdict") not in ("mismatch", "no_mismatch")
        trials.append(Scored(int(path.parent.name), answer, findings, failed, float(finished["seconds"])))
    return trials


def share(name: str, hits: Iterable[bool]) -> str:
    """A line with Wilson's 95 % interval."""
    values = list(hits)
    if not values:
        return f"{name:52} -"
    interval = binomtest(sum(values), len(values)).proportion_ci(method="wilson")
    percent = 100 * sum(values) / len(values)
    return (
        f"{name:52} {percent:5.1f} %  {sum(values)} of {len(values)}  "
        f"(95 %: {100 * interval.low:.1f} to {100 * interval.high:.1f})"
    )


def report(trials: list[Scored]) -> str:
    """The whole score as text."""
    if not trials:
        return "no finished trials"
    by_kind = defaultdict(list)
    for trial in trials:
        by_kind[trial.kind].append(trial)
    singles = by_kind["one"]
    lines = [f"{len(trials)} trials; crashed or unfit: {sum(t.failed for t in trials)}", ""]
    lines += [share("false alarm on healthy arms", (bool(t.findings) for t in by_kind["healthy"]))]
    lines += _singles(singles)
    for twins, how in ((False, "strict"), (True, "with twins")):
        lines.append(share(f"two effects: both named, {how}", (t.both(twins) for t in by_kind["two"])))
        lines.append(share(f"two effects: first one right, {how}", (t.right(twins) for t in by_kind["two"])))
    lines.append(share("absent effect: unknown or nothing", (t.rightly_unnamed() for t in by_kind["absent"])))
    lines += _quality(trials)
    lines += ["", "concealed effect × first finding (one effect)", *_confusion(singles)]
    lines += ["", "concealed effect × first finding (absent from the catalogue)", *_confusion(by_kind["absent"])]
    lines += ["", "not right:", *_misses(trials)]
    return "\n".join(lines)


def _singles(singles: list[Scored]) -> list[str]:
    lines = [share("one effect: detected", (bool(t.findings) for t in singles))]
    for multiple in (None, *MULTIPLES):
        these = [t for t in singles if multiple in (None, t.strength)]
        at = "all" if multiple is None else f"{multiple:g} x noise"
        lines.append(share(f"  detected, {at}", (bool(t.findings) for t in these)))
        lines.append(share(f"  right effect first, strict, {at}", (t.right(False) for t in these)))
        lines.append(share(f"  right effect first, with twins, {at}", (t.right(True) for t in these)))
    detected = [t for t in singles if t.findings]
    lines.append(share("  right joint, of those detected", (t.right_joint() for t in detected)))
    return lines


def _quality(trials: list[Scored]) -> list[str]:
    right = [t for t in trials if t.right(False)]
    explained = [t.findings[0].get("validation", {}).get("explained_fraction") for t in right]
    compared = [one for one in (t.compared() for t in right) if one is not None]
    lines = [
        _median("explained fraction on unseen data, right ones", [float(e) for e in explained if e is not None]),
        _median("relative error of the compared parameter", [one.error for one in compared]),
        share("truth in the 95 % interval of that parameter", (one.inside for one in compared)),
        _median("seconds a case", [t.seconds for t in trials]),
        f"{'longest':52} {max(t.seconds for t in trials):.1f}",
        "compared:",
    ]
    by_key: dict[str, list[Compared]] = defaultdict(list)
    for one in compared:
        by_key[one.key].append(one)
    for key, ones in sorted(by_key.items()):
        error, inside = np.median([one.error for one in ones]), sum(one.inside for one in ones)
        lines.append(f"  {key:50} {error:.3f}  ({len(ones)}, in the interval {inside})")
    return lines


def _median(name: str, values: list[float]) -> str:
    return f"{name:52} {np.median(values):.3f}  ({len(values)})" if values else f"{name:52} -"


def _confusion(trials: list[Scored]) -> list[str]:
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for trial in trials:
        table[trial.truth["effect"]][trial.first] += 1
    return [
        f"  {true:24} " + ", ".join(f"{said} {count}" for said, count in row.most_common())
        for true, row in sorted(table.items())
    ]


def _misses(trials: list[Scored]) -> list[str]:
    lines = []
    for t in trials:
        if t.kind == "healthy":
            good, true = not t.findings and not t.failed, "healthy"
        else:
            good = t.rightly_unnamed() if t.kind == "absent" else t.both(False) and t.right(False)
            true = " + ".join(
                f"{e['effect']}({e['law']}) {','.join(e['joints']) if e['local'] else '-'} x{e['multiple']:.1f}"
                for e in t.answer["effects"]
            )
        if not good:
            said = ", ".join(f"{f['effect']} {','.join(f.get('joints', []))}" for f in t.findings) or NOTHING
            lines.append(f"  {t.number:4} {true}: {'FAILED' if t.failed else said}")
    return lines
