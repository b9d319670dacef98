"""Score what the program said against the sealed answers, layer by layer.

Rules, fixed before any result was seen except the keys of the result file:

* Layer 0: a fault counts when its size (RMS that friction and armature of the joint do not absorb, over the noise) is
  above `COUNTED`; it is named when an item of its class stands at its joint, in the layer of conventions or physics.
  An item of a class of `CLASSES` in the layer of conventions that matches no fault of any size is false.
* Layer 1: an item is a combination of linear parameters (mass, m c, inertia about the body's origin, armature, damping,
  friction loss). Its truth is `was` plus the coefficients times the changes, so what a fixed child adds drops out.
  Covered: the truth is inside `ci95`. False: the truth differs from `was` by no more than the interval's half-width.
  Friction of a joint with `temperature_friction` has no single truth and is left out.
* Layer 2: an effect counts when its size is above `COUNTED`; it is named when an item with one of its `ACCEPTED` names
  stands at its joint (a contact: at any joint that it loads above `COUNTED`). An item that matches no effect is false.
  Since 2026-11-26 an item's `equivalents` count as its names: asymmetric Coulomb friction and an offset of the effort
  are the same torque while a joint moves, and an item that says so is right of both.
  For an effect without a name in the catalogue the right answer is none, or `unknown` at its joint.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

COUNTED = 3.0
"""Size over the noise from which a difference must be named (issue 26)."""

CLASSES = {
    "sign": ("sign", "flip", "direction", "reversed"),
    "exchanged": ("exchang", "swap", "order", "permut"),
    "delay": ("delay", "clock", "lag", "latency"),
    "base_tilt": ("tilt", "gravity"),
    "torque_constant": ("torque_constant", "torque constant", "gain", "factor", "ratio", "scale", "unit"),
    "current_offset": ("current_offset", "current offset", "torque offset", "effort offset"),
    "zero": ("zero", "offset"),
}
"""Words by which an item's name belongs to a class of layer 0; the first class that fits."""

ACCEPTED = {
    "load_friction": ("load_friction", "gear_efficiency"),
    "temperature_friction": ("temperature_friction", "friction_drift"),
    "joint_elasticity": ("joint_elasticity", "link_flexibility"),
    "absent:pump": ("unknown",),
    "absent:hose": ("unknown",),
    "absent:detent": ("unknown",),
}
"""Names that are right for an effect beside its own: laws that differ in form only."""


WIRING_EFFECTS = ("torque_constant", "time_delay", "base_tilt", "filter_lag")
"""Effects of the catalogue that are faults of layer 0 named in the layer of physics."""


def class_of(name: str) -> str | None:
    """Class of layer 0 that an item's name belongs to, or none."""
    low = name.lower()
    return next((c for c, words in CLASSES.items() if any(w in low for w in words)), None)


def linear(table: dict[str, Any], inertia: dict[str, np.ndarray] | None = None) -> dict[str, float]:
    """Linear parameters by the name that combinations use.

    Args:
        table: parameters (arms.Table).
        inertia: rotational inertia about the centre, kg m², by body (3, 3); none: left out, as truth and simulation
            have the same.

    Returns:
        `BODY.mass` kg, `BODY.mx` kg m, `BODY.ixx` kg m² about the body's origin, `JOINT.armature` and so on.
    """
    values = {}
    for name, body in table["bodies"].items():
        m, c = float(body["mass"]), np.array(body["com"])
        full = m * (c @ c * np.eye(3) - np.outer(c, c))
        if inertia is not None:
            full = full + inertia[name]
        values[f"{name}.mass"] = m
        for k, axis in enumerate("xyz"):
            values[f"{name}.m{axis}"] = m * c[k]
            for i, other in enumerate("xyz"[: k + 1]):
                values[f"{name}.i{other}{axis}"] = full[i, k]
                values[f"{name}.i{axis}{other}"] = full[i, k]
    for name, joint in table["joints"].items():
        for key, value in joint.items():
            values[f"{name}.{key}"] = float(value)
    return values


def changes(answer: dict[str, Any]) -> dict[str, float]:
    """Truth minus simulation of every linear parameter, the payload in the last body."""
    truth, simulation = linear(answer["truth"]), linear(answer["simulation"])
    change = {key: value - simulation[key] for key, value in truth.items()}
    if answer["payload"] is not None:
        load, last = answer["payload"], answer["bodies"][-1]
        body = {"bodies": {last: {"mass": load["mass"], "com": load["com"]}}, "joints": {}}
        for key, value in linear(body, {last: np.diag(load["inertia"])}).items():
            change[key] += value
    return change


def score_trial(record: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """Score one trial.

    Args:
        record: a line of the results.
        answer: the sealed answer.

    Returns:
        Lists of what was right and wrong in each layer, and the residual's figures.
    """
    out: dict[str, Any] = {
        "trial": record["trial"],
        "arm": answer["arm"],
        "kind": answer["kind"],
        "exit": record["exit"],
        "seconds": record["seconds"],
        "cpu_seconds": record.get("cpu_seconds"),
        "ran": record["mismatch"] is not None,
    }
    if record["mismatch"] is None:
        return out | {"stderr": record["stderr"]}
    result = record["mismatch"]
    layers = {layer["layer"]: layer for layer in result["layers"]}
    items = {name: layer["items"] for name, layer in layers.items()}
    out["verdict"] = result["verdict"]
    out["layer0"] = _wiring(answer, items)
    out["layer1"] = _parameters(answer, items.get("parameters", []))
    out["layer2"] = _physics(answer, items)
    out["residual"] = _residual(answer, layers)
    return out


def _names(item: dict[str, Any]) -> tuple[str, ...]:
    """Its name, and its equivalents."""
    return (str(item["name"]), *item.get("equivalents", ()))


def _joints(item: dict[str, Any]) -> list[str]:
    return list(item.get("joints") or [])


def _said(item: dict[str, Any]) -> str:
    low, high = item.get("ci95") or (None, None)
    where = ", ".join(_joints(item)) or str(item.get("where"))
    return f"{item['name']} at {where}: {item.get('was')} -> {item.get('is')} [{low}, {high}] {item.get('unit')}"


def _wiring(answer: dict[str, Any], items: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    names = answer["joints"]
    said = items.get("conventions", []) + [i for i in items.get("physics", []) if i["name"] in WIRING_EFFECTS]
    used: list[int] = []
    faults = []
    for kind, fault in answer["wiring"].items():
        where = [names[j] for j in fault.get("joints", [fault["joint"]] if "joint" in fault else [])]
        hits = [
            i
            for i, item in enumerate(said)
            if class_of(item["name"]) == kind and (not where or not _joints(item) or set(where) & set(_joints(item)))
        ]
        used += hits
        size = float(np.max(answer["wiring_sizes"][kind]))
        free = float(np.max(answer["wiring_sizes_free"][kind]))
        row = {"fault": kind, "joints": where, **{k: v for k, v in fault.items() if k not in ("joint", "joints")}}
        faults.append(
            row | {"size": size, "size_free": free, "named": bool(hits), "said": [_said(said[i]) for i in hits]}
        )
    offsets = {names[law["joint"]] for law in answer["laws"] if law["effect"] == "current_offset"}
    false = []
    for i, item in enumerate(items.get("conventions", [])):
        known = class_of(item["name"]) == "current_offset" and set(_joints(item)) & offsets
        if i not in used and not known:
            false.append(_said(item))
    return {"faults": faults, "items": len(items.get("conventions", [])), "false": false}


def _parameters(answer: dict[str, Any], items: list[dict[str, Any]]) -> dict[str, Any]:
    change = changes(answer)
    warm = {answer["joints"][law["joint"]] for law in answer["laws"] if law["effect"] == "temperature_friction"}
    rows, touched = [], set()
    for item in items:
        combination = item.get("combination") or {}
        unknown = [key for key in combination if key not in change]
        low, high = item.get("ci95") or (None, None)
        row: dict[str, Any] = {"said": _said(item)}
        touched |= {key for key, c in combination.items() if abs(c) > 1e-9}
        friction = any(key == f"{j}.{p}" for key in combination for j in warm for p in ("frictionloss", "damping"))
        if not combination or unknown or low is None or item["was"] is None or friction:
            rows.append(row | {"evaluated": False, "unknown": unknown})
            continue
        delta = sum(c * change[key] for key, c in combination.items())
        truth, half = item["was"] + delta, (high - low) / 2
        row |= {"evaluated": True, "truth": truth, "covered": bool(low <= truth <= high)}
        row |= {"false": bool(abs(delta) <= half), "error_in_intervals": float((item["is"] - truth) / max(half, 1e-12))}
        rows.append(row)
    concealed = [key for key, value in change.items() if abs(value) > 1e-9 and key.split(".")[1][0] != "i"]
    named = [key for key in concealed if key in touched]
    return {"items": rows, "concealed": concealed, "touched": named}


def _physics(answer: dict[str, Any], items: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    names = answer["joints"]
    named = [item for item in items.get("physics", []) if item["name"] != "unknown"]
    unknown = [item for item in items.get("physics", []) + items.get("rest", []) if item["name"] == "unknown"]
    conventions = [i for i in items.get("conventions", []) if class_of(i["name"]) == "current_offset"]
    right: set[int] = set()
    effects = []
    for law, sizes, free in zip(answer["laws"], answer["law_sizes"], answer["law_sizes_free"]):
        effect, joint = law["effect"], law["joint"]
        accepted = ACCEPTED.get(effect, (effect,))
        places = {names[joint]}
        if effect == "external_contact":
            places = {names[j] for j, s in enumerate(sizes) if s > 1.0}
        hits = [i for i, x in enumerate(named) if set(_names(x)) & set(accepted) and places & set(_joints(x))]
        right |= set(hits)
        found = bool(hits)
        if effect == "current_offset":
            found = found or any(places & set(_joints(x)) for x in conventions)
        if effect.startswith("absent:"):
            found = any(places & set(_joints(x)) for x in unknown)
        size = max(sizes) if effect == "external_contact" else sizes[joint]
        size_free = max(free) if effect == "external_contact" else free[joint]
        effects.append(
            {
                "effect": effect,
                "joint": names[joint],
                "numbers": {k: v for k, v in law.items() if k not in ("effect", "joint")},
                "size": float(size),
                "size_free": float(size_free),
                "named": found,
                "said_there": [_said(x) for x in named + unknown if places & set(_joints(x))],
            }
        )
    faults = answer["wiring"]
    for i, item in enumerate(named):  # a fault of wiring under its name in the catalogue
        kind = class_of(item["name"])
        if kind in faults and item["name"] in WIRING_EFFECTS:
            where = faults[kind].get("joint")
            if where is None or names[where] in _joints(item):
                right.add(i)
        if item["name"] == "payload" and answer["payload"] is not None:
            right.add(i)
    false = [_said(x) for i, x in enumerate(named) if i not in right]
    return {"effects": effects, "named": len(named), "false": false, "unknown": [_said(x) for x in unknown]}


def _residual(answer: dict[str, Any], layers: dict[str, Any]) -> dict[str, Any]:
    """RMS before and after over the noise, root mean square over joints, for each layer."""
    out = {}
    for name, layer in layers.items():
        rows = [(answer["noise_Nm"][j], layer["joints"].get(joint)) for j, joint in enumerate(answer["joints"])]
        both = [(r["rms_before_Nm"] / n, r["rms_after_Nm"] / n) for n, r in rows if r]
        if both:
            before, after = np.sqrt(np.mean(np.square(both), axis=0))
            out[name] = {"before_over_noise": float(before), "after_over_noise": float(after)}
    return out


def _pairs(results: Path, sealed: Path) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for line in results.read_text().splitlines():
        record = json.loads(line)
        yield record, json.loads((sealed / f"{record['trial']:03d}.json").read_text())


def _share(hits: list[bool]) -> str:
    return f"{sum(hits)}/{len(hits)}" + (f" ({100 * sum(hits) / len(hits):.0f} %)" if hits else "")


def main(bags: Path, sealed: Path, results: Path, as_json: bool) -> None:
    """Print the tables, or everything as JSON.

    Args:
        bags: folder of the trials (unused: answers are sealed).
        sealed: folder of the answers.
        results: JSON lines of `run`.
        as_json: print the scored trials as JSON.
    """
    trials = [score_trial(*pair) for pair in _pairs(results, sealed)]
    if as_json:
        print(json.dumps(trials, indent=1))
        return
    ran = [t for t in trials if t["ran"]]
    seconds, cpu = [t["seconds"] for t in trials], [t["cpu_seconds"] or np.nan for t in trials]
    print(f"trials {len(trials)}, with a result {len(ran)}")
    if trials:
        print(f"seconds: median {np.median(seconds):.0f}, most {max(seconds):.0f}; CPU: median {np.nanmedian(cpu):.0f}")
    faults = [f for t in ran for f in t["layer0"]["faults"]]
    effects = [e for t in ran for e in t["layer2"]["effects"]]
    items = [i for t in ran for i in t["layer1"]["items"] if i["evaluated"]]
    every = [i for t in ran for i in t["layer1"]["items"]]
    known = [e for e in effects if not e["effect"].startswith("absent:")]
    absent = [e for e in effects if e["effect"].startswith("absent:")]
    print(f"layer 0 named, size > {COUNTED:g}: {_share([f['named'] for f in faults if f['size'] > COUNTED])}")
    print(f"layer 0 named, any size: {_share([f['named'] for f in faults])}")
    print(f"layer 0 false items: {sum(len(t['layer0']['false']) for t in ran)} in {len(ran)} trials")
    print(f"layer 1 items evaluated: {len(items)} of {len(every)}")
    print(f"layer 1 inside 95 % interval: {_share([i['covered'] for i in items])}")
    print(f"layer 1 false: {_share([i['false'] for i in items])}")
    touched = [key in t["layer1"]["touched"] for t in ran for key in t["layer1"]["concealed"]]
    print(f"layer 1 changed parameters that stand in some item: {_share(touched)}")
    print(
        f"layer 2 named at the joint, size > {COUNTED:g}: {_share([e['named'] for e in known if e['size'] > COUNTED])}"
    )
    between = [e["named"] for e in known if 1.0 < e["size"] <= COUNTED]
    print(f"layer 2 named at the joint, 1 < size <= {COUNTED:g}: {_share(between)}")
    strict = [e["named"] for e in known if e["size_free"] > COUNTED]
    print(f"layer 2 named at the joint, no parameter absorbs it, size > {COUNTED:g}: {_share(strict)}")
    total = sum(t["layer2"]["named"] for t in ran)
    wrong = sum(len(t["layer2"]["false"]) for t in ran)
    print(f"layer 2 named ones that are true: {total - wrong}/{total}")
    print(
        f"layer 2 without a name, 'unknown' at the joint: {_share([e['named'] for e in absent if e['size'] > COUNTED])}"
    )
    clean = [t for t in ran if t["kind"] == "none"]
    quiet = [t["verdict"] == "no_mismatch" for t in clean]
    print(f"trials with nothing concealed that were told so: {_share(quiet)}")
    for layer in ("conventions", "parameters", "physics", "rest"):
        both = [t["residual"][layer] for t in ran if layer in t["residual"]]
        if both:
            a, b = (np.median([x[k] for x in both]) for k in ("before_over_noise", "after_over_noise"))
            print(f"residual over noise, {layer}: {a:.2f} -> {b:.2f} (median of trials)")
    for t in trials:
        print(f"\n{t['trial']:03d} {t['arm']} {t['kind']} {t['seconds']} s (CPU {t['cpu_seconds']})", t.get("verdict"))
        if not t["ran"]:
            print("   no result:", t["stderr"][-200:])
            continue
        for f in t["layer0"]["faults"]:
            print("   0", "named " if f["named"] else "MISSED", {k: v for k, v in f.items() if k != "named"})
        for text in t["layer0"]["false"]:
            print("   0 FALSE", text)
        for i in t["layer1"]["items"]:
            if not i["evaluated"]:
                print("   1 not evaluated", i["said"], i["unknown"])
            else:
                word = ("FALSE " if i["false"] else "") + ("covered" if i["covered"] else "OUTSIDE")
                print(f"   1 {word} {i['said']} truth {i['truth']:.5g}")
        for e in t["layer2"]["effects"]:
            print("   2", "named " if e["named"] else "MISSED", {k: v for k, v in e.items() if k != "named"})
        for text in t["layer2"]["false"]:
            print("   2 FALSE", text)
        print("   residual", t["residual"])
