"""Score results against answers.

    python score.py --draws DIR --results FILE.jsonl [--json OUT]

Rules. A finding is right when it names the effect of a law of the trial and shares a joint with it (laws of the
whole arm: any joint). "Same torque" also takes a name of the contract that describes the same torque (gear
efficiency for load friction, asymmetric friction for current offset, ...). `unknown` is right where an absent
kind acts, at one of its joints. A trial is right when every law is named and nothing else is.
"""

from __future__ import annotations

import argparse
import json
import math
import re
from collections import defaultdict
from pathlib import Path

WHOLE = {"payload", "base_tilt", "vacuum_friction", "external_contact", "slosh"}
FACTOR = {
    ("deg", "rad"): math.pi / 180,
    ("ms", "s"): 1e-3,
    ("mrad", "rad"): 1e-3,
    ("g", "kg"): 1e-3,
    ("mm", "m"): 1e-3,
    ("%", "1"): 0.01,
    ("°", "rad"): math.pi / 180,
}
#: names that a parameter may have, beside its own: (effect, truth) to a pattern
NAMES = {
    ("payload", "mass"): "mass",
    ("base_tilt", "angle"): "angle|tilt",
    ("torque_ripple", "amplitude"): "amplitude",
    ("torque_ripple", "cycles"): "cycles|order|frequency",
    ("joint_elasticity", "stiffness"): "stiffness",
    ("backlash", "gap"): "gap|width|backlash",
    ("harness_spring", "stiffness"): "stiffness|k_?1|spring",
    ("torque_constant", "ratio"): "ratio|factor|scale|torque_constant",
    ("motor_saturation", "limit"): "limit|saturation|level",
    ("current_offset", "offset"): "offset",
    ("encoder_eccentricity", "amplitude"): "amplitude|eccentricity",
    ("time_delay", "delay"): "delay",
    ("filter_lag", "time_constant"): "time_constant|lag|tau",
    ("friction_drift", "coulomb_change"): "coulomb|df_c",
    ("friction_drift", "viscous_change"): "viscous|dk_v1",
    ("temperature_friction", "alpha"): "alpha|slope",
    ("load_friction", "mu"): "mu|load|coefficient",
    ("gear_efficiency", "efficiency"): "efficiency|^eta$",
    ("external_contact", "force"): "force",
    ("presliding_hysteresis", "displacement"): "displacement|stroke",
    ("position_friction", "amplitude"): "amplitude",
    ("asymmetric_friction", "half_difference"): "difference|asymmetry",
    ("stribeck", "velocity"): "velocity|speed|^v_b$",
    ("stribeck", "level"): "level|amplitude|stribeck|f_b",
    ("rotor_coupling", "inertia"): "inertia|coupling",
}


#: truths of which the program states the inverse: torque recorded for true torque, where the law has it the other way
INVERSE = {("torque_constant", "ratio")}


def shares(finding: dict, law: dict) -> bool:
    """Whether a finding and a law have a joint in common."""
    return law["name"] in WHOLE or bool(set(finding["joints"]) & set(law["joints"]))


def answers_to(finding: dict, law: dict, same: bool = False) -> bool:
    """Whether a finding names a law at its joint; same: names of the same torque count too."""
    if not shares(finding, law):
        return False
    if not law["listed"]:
        return finding["effect"] == "unknown"
    return finding["effect"] == law["name"] or (same and finding["effect"] in law["also"])


def intervals(finding: dict, law: dict):
    """Yield (truth name, true value, value, low, high) of parameters that can be compared."""
    for name, (true, unit) in law["truth"].items():
        pattern = NAMES.get((law["name"], name))
        for key, p in (finding.get("parameters") or {}).items():
            if not pattern or not re.search(pattern, key, re.I) or not isinstance(p, dict) or not p.get("ci95"):
                continue
            have = (p.get("unit") or "1").replace("N·m", "N m")
            scale = 1.0 if have == unit or (have in ("", "-") and unit == "1") else FACTOR.get((have, unit))
            if scale is None:
                continue
            value, *ends = (x * scale for x in (p["value"], *p["ci95"]))
            if (law["name"], name) in INVERSE:
                value, *ends = (1.0 / x for x in (value, *ends))
            low, high = sorted(ends)
            yield name, true, value, low, high
            break


def load(draws: Path, results: Path) -> list[tuple[dict, dict]]:
    """Pairs of an answer and a result line, in trial order."""
    lines = [json.loads(x) for x in results.read_text().splitlines() if x.strip()]
    lines.sort(key=lambda x: x["trial"])
    return [(json.loads((draws / "answers" / f"{x['trial']:03d}.json").read_text()), x) for x in lines]


def judge(answer: dict, line: dict) -> dict:
    """Judge one trial."""
    findings, laws = line.get("findings") or [], answer["laws"]
    right = [any(answers_to(f, law) for law in laws) for f in findings]
    wide = [any(answers_to(f, law, True) for law in laws) for f in findings]
    named = [any(answers_to(f, law) for f in findings) for law in laws]
    return {
        "finished": "findings" in line,
        "quiet": line.get("verdict") == "no_mismatch" and not findings,
        "right": right,
        "wide": wide,
        "named": named,
        "named_wide": [any(answers_to(f, law, True) for f in findings) for law in laws],
        "effect": [any(f["effect"] == (law["name"] if law["listed"] else "unknown") for f in findings) for law in laws],
        "all": all(named) and all(right) and (bool(laws) or line.get("verdict") == "no_mismatch"),
    }


def report(pairs: list[tuple[dict, dict]]) -> dict:
    """All figures of a series, as plain numbers."""
    by_strength: dict = defaultdict(lambda: defaultdict(int))
    cover: dict = defaultdict(lambda: [0, 0])
    bins: dict = defaultdict(lambda: [0, 0, 0.0])
    total = defaultdict(int)
    brier, wrong, seconds, cpu = [], [], [], []
    for answer, line in pairs:
        j = judge(answer, line)
        seconds.append(line["seconds"])
        cpu.append(line.get("cpu_seconds", 0))
        if not j["finished"]:
            total["unfinished"] += 1
            wrong.append((answer, line))
            continue
        kind = answer["composition"]
        total[kind] += 1
        total[kind + " right"] += j["all"]
        if kind == "healthy":
            total["healthy quiet"] += j["quiet"]
        for f, ok, wide in zip(line["findings"], j["right"], j["wide"]):
            total["findings"] += 1
            total["findings right"] += ok
            total["findings right or same torque"] += wide
            p = f.get("confidence")
            if p is not None:
                brier.append((p - ok) ** 2)
                b = bins[next(x for x in (0.5, 0.8, 0.95, 1.01) if p < x)]
                b[0] += 1
                b[1] += ok
                b[2] += p
        for k, law in enumerate(answer["laws"]):
            row = by_strength[("listed" if law["listed"] else "absent", law["strength"])]
            row["n"] += 1
            row["named at joint"] += j["named"][k]
            row["named or same torque"] += j["named_wide"][k]
            row["named anywhere"] += j["effect"][k]
            row["silent"] += not line["findings"]
            for f in line["findings"]:
                if answers_to(f, law):
                    for name, true, _, low, high in intervals(f, law):
                        cover[f"{law['name']}.{name}"][0] += 1
                        cover[f"{law['name']}.{name}"][1] += low <= true <= high
        if not j["all"]:
            wrong.append((answer, line))
    return {
        "trials": len(pairs),
        "totals": dict(total),
        "by_strength": {f"{k[0]} x{k[1]:g}": dict(v) for k, v in sorted(by_strength.items())},
        "coverage": {k: v for k, v in sorted(cover.items())},
        "reliability": {f"<{k:g}": v for k, v in sorted(bins.items())},
        "brier": sum(brier) / len(brier) if brier else None,
        "seconds": sorted(seconds),
        "cpu_seconds": sorted(cpu),
        "wrong": wrong,
    }


def text(r: dict) -> str:
    """The report as Markdown."""
    t = r["totals"]

    def middle(x: list) -> float:
        return x[len(x) // 2] if x else float("nan")

    out = [
        f"{r['trials']} trials, {t.get('unfinished', 0)} of them without a result.",
        "",
        "| composition | trials | wholly right |",
        "|---|---|---|",
    ]
    out += [f"| {k} | {t.get(k, 0)} | {t.get(k + ' right', 0)} |" for k in ("healthy", "listed", "absent", "both")]
    out += [
        "",
        "| laws, by strength | n | named at its joint | name or same torque | named, any joint | no finding at all |",
        "|---|---|---|---|---|---|",
    ]
    out += [
        f"| {k} | {v['n']} | {v['named at joint']} | {v['named or same torque']} | {v['named anywhere']} "
        f"| {v['silent']} |"
        for k, v in r["by_strength"].items()
    ]
    n, wide = t.get("findings", 0), t.get("findings right or same torque", 0)
    out += [
        "",
        f"Findings: {n}; right {t.get('findings right', 0)}, right or same torque {wide}, extra or wrong {n - wide}. "
        f"Healthy arms quiet: {t.get('healthy quiet', 0)} of {t.get('healthy', 0)}.",
        f"Brier score {r['brier']:.3f}." if r["brier"] is not None else "No finding has a probability.",
        "",
        "| stated probability | findings | mean stated | share right |",
        "|---|---|---|---|",
    ]
    out += [f"| {k} | {v[0]} | {v[2] / v[0]:.2f} | {v[1] / v[0]:.2f} |" for k, v in r["reliability"].items()]
    out += ["", "| parameter | 95 % intervals | hold the truth |", "|---|---|---|"]
    out += [f"| {k} | {v[0]} | {v[1]} |" for k, v in r["coverage"].items()]
    out += [
        "",
        f"Wall time: median {middle(r['seconds']):.0f} s, longest {r['seconds'][-1]:.0f} s; "
        f"processor time: median {middle(r['cpu_seconds']):.0f} s."
        if r["seconds"]
        else "",
        "",
        "Trials that went wrong:",
        "",
    ]
    for a, x in r["wrong"]:
        concealed = "; ".join(
            f"{w['name']} at {'whole arm' if w['name'] in WHOLE else '/'.join(w['joints'])} x{w['strength']:g} "
            f"(achieved {w['achieved']:.2f}; {', '.join(f'{k} {v[0]:.3g} {v[1]}' for k, v in w['truth'].items())})"
            for w in a["laws"]
        )
        said = x.get("error") or x.get("verdict") or f"exit {x.get('exit')}"
        if x.get("findings"):
            said = "; ".join(
                f"{f['effect']} at {'/'.join(f['joints'])} p {f.get('confidence')} ("
                + ", ".join(
                    f"{k} {p['value']:.3g} {p.get('unit', '')}"
                    for k, p in (f.get("parameters") or {}).items()
                    if isinstance(p, dict) and isinstance(p.get("value"), (int, float))
                )
                + ")"
                for f in x["findings"]
            )
        out.append(
            f"- {a['trial']:03d} {a['arm']}: {concealed or 'healthy'} -> {said} "
            f"[{x['seconds']:.0f} s wall, {x.get('cpu_seconds', 0):.0f} s processor]"
        )
    return "\n".join(out) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=Path, required=True)
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    result = report(load(options.draws, options.results))
    print(text(result))
    if options.json:
        result["wrong"] = [a["trial"] for a, _ in result["wrong"]]
        options.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
