"""One trial: a sound recording, at most one mistake in it, the bag, and the sealed answer.

Which mistakes, and in which fields, follows what users of drivers report: currents published as effort, two joints
exchanged by a sorted list of names (both of UR's drivers), position in degrees with the velocity in either unit, an
axis that turns against the URDF's, zeros set by eye, arms on walls, stamps on arrival, clocks set while recording.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from conventions_arms import MOUNTS, REAL, SIMULATED, Array, Rng, Sound, gravity_in_base, mounted, real_window, simulate
from conventions_oracle import ENOUGH, Oracle

from spacearm_ident.recording import Recording, RecordingWriter, cdr, messages
from spacearm_ident.recording.qos import LATCHED

KINDS = (
    "torque_sign",
    "position_sign",
    "degrees_one",
    "degrees_all",
    "exchanged",
    "torque_unit",
    "gravity",
    "zero_offset",
)
EXTRAS = ("axis_reversed", "delay", "clock", "rest")
"""Reported apart. `axis_reversed`: position, velocity and torque of one joint, all with the wrong sign."""
REST_RAD = 0.02
"""A joint that moves less is at rest, and a finding that says so is right."""
OUTPUT_NM_PER_A = {
    "ur10e": (13.0, 13.0, 12.0, 9.0, 9.0, 9.0),
    "ur10": (13.0, 13.0, 12.5, 9.5, 9.5, 9.5),
    "ur5": (12.6, 12.6, 12.6, 9.5, 9.5, 9.5),
    "tx40": (10.0, 10.0, 9.0, 5.0, 4.6, 3.0),
    "airbot": (1.5, 1.5, 1.5, 0.95, 0.95, 0.95),
    "panda": (9.5, 9.5, 9.5, 9.5, 5.0, 5.0, 5.0),
    "rokae": (9.5, 9.5, 9.5, 9.5, 5.0, 5.0, 5.0),
    "kinova": (9.5, 9.5, 9.5, 6.0, 6.0, 6.0),
    "xarm7": (8.0, 8.0, 6.0, 6.0, 6.0, 5.0, 5.0),
    "z1": (2.2, 2.2, 2.2, 2.2, 2.2, 2.2),
    "tiago": (5.6, 5.6, 4.5, 4.5, 2.5, 2.2, 2.2),
}
"""Torque constant times gear ratio by joint, of the size that drives of such joints have; drawn within 10 % of it."""
RATED_SHARE = (0.3, 0.5)
"""Rated torque over the URDF's effort limit, which is a peak torque."""


@dataclass(frozen=True)
class Mistake:
    """What was done, and the `joints` to be named; `said` is gravity (3,) in the base frame as the bag says."""

    kind: str
    joints: tuple[str, ...]
    recording: Recording
    said: Array
    detail: dict[str, Any] = field(default_factory=dict)
    stamps: Array | None = None
    urdf: str | None = None
    arm: dict[str, Any] | None = None


def flipped(r: Recording, j: int, fields: tuple[str, ...]) -> Recording:
    """The recording with other signs in some fields of joint `j`."""
    return _scaled(r, [j], fields, -1.0)


def _scaled(r: Recording, joints: list[int], fields: tuple[str, ...], by: float) -> Recording:
    factor = np.ones(len(r.joints))
    factor[joints] = by
    return replace(r, **{name: getattr(r, name) * factor for name in fields if getattr(r, name) is not None})


def swapped(r: Recording, a: int, b: int, fields: tuple[str, ...]) -> Recording:
    """The recording with some fields of two joints exchanged."""
    order = np.arange(len(r.joints))
    order[[a, b]] = b, a
    return replace(r, **{name: getattr(r, name)[:, order] for name in fields if getattr(r, name) is not None})


def offset(r: Recording, j: int, by: float) -> Recording:
    """The recording with the zero of joint `j` moved by so many rad."""
    moved = r.position.copy()
    moved[:, j] += by
    return replace(r, position=moved)


MOTION = ("position", "velocity")
ALL = ("position", "velocity", "effort")


def _one_joint(rng: Rng, sound: Sound, kind: str) -> Mistake:
    """Signs, degrees and zeros of one joint."""
    r, said = sound.recording, gravity_in_base(sound.mount)
    j = int(rng.integers(len(r.joints)))
    fields: tuple[str, ...] = {"torque_sign": ("effort",), "axis_reversed": ALL}.get(kind, MOTION)
    if kind in ("position_sign", "degrees_one") and rng.random() < (0.2 if kind == "position_sign" else 0.4):
        fields = ("position",)
    detail: dict[str, Any] = {"fields": fields if r.velocity is not None else [f for f in fields if f != "velocity"]}
    if kind == "zero_offset":
        by = float(rng.choice([-1, 1]) * rng.uniform(0.2, 0.5))
        return Mistake(kind, (r.joints[j],), offset(r, j, by), said, {"offset_rad": by})
    by = 180.0 / np.pi if kind == "degrees_one" else -1.0
    return Mistake(kind, (r.joints[j],), _scaled(r, [j], fields, by), said, detail)


def _degrees_all(rng: Rng, sound: Sound, kind: str) -> Mistake:
    r = sound.recording
    fields = ("position",) if rng.random() < 0.4 else MOTION
    wrong = _scaled(r, list(range(len(r.joints))), fields, 180.0 / np.pi)
    return Mistake(kind, r.joints, wrong, gravity_in_base(sound.mount), {"fields": fields})


def _exchanged(rng: Rng, sound: Sound, kind: str) -> Mistake:
    """Two joints: those that a sorted list exchanges (UR: pan and elbow), neighbours, or any."""
    r = sound.recording
    n = len(r.joints)
    first = int(rng.integers(n - 1))
    a, b = (first, first + 1) if rng.random() < 0.6 else map(int, rng.choice(n, 2, replace=False))
    if r.joints[0] == "shoulder_pan_joint" and rng.random() < 0.4:
        a, b = 0, 2
    fields = ALL if rng.random() < 0.5 else ("effort",)
    wrong = swapped(r, a, b, fields)
    return Mistake(kind, (r.joints[a], r.joints[b]), wrong, gravity_in_base(sound.mount), {"fields": fields})


def _torque_unit(rng: Rng, sound: Sound, kind: str) -> Mistake:
    r = sound.recording
    unit = str(rng.choice(["A", "mA", "percent", "per mille"], p=[0.45, 0.2, 0.2, 0.15]))
    constants = np.array(OUTPUT_NM_PER_A[sound.arm]) * rng.uniform(0.9, 1.1, len(r.joints))
    rated = _effort_limits(sound.urdf, r) * rng.uniform(*RATED_SHARE)
    factor = {"A": 1 / constants, "mA": 1e3 / constants, "percent": 100 / rated, "per mille": 1e3 / rated}[unit]
    detail = {"unit": unit, "per_Nm": np.round(factor, 4).tolist()}
    return Mistake(kind, r.joints, replace(r, effort=r.effort * factor), gravity_in_base(sound.mount), detail)


def _effort_limits(urdf: str, recording: Recording) -> Array:
    return Oracle(urdf, recording, gravity_in_base("floor"), rough=True).limit


def _gravity(rng: Rng, sound: Sound, kind: str) -> Mistake:
    """A bag that says another mounting than the true one, or an arm YAML with another gravity vector."""
    r = sound.recording
    if sound.mount == "floor" and rng.random() < 0.5:
        vectors = [[0.0, 0.0, 9.81], [0.0, 0.0, 9.81], [0.0, -9.81, 0.0], [9.81, 0.0, 0.0], [0.0, 0.0, 0.0]]
        said = vectors[rng.integers(len(vectors))]
        return Mistake(kind, (), r, np.array(said), {"true": "floor", "said": said}, arm={"gravity_m_s2": said})
    mount = "floor" if sound.mount != "floor" else str(rng.choice([m for m in MOUNTS if m != "floor"]))
    detail = {"true": sound.mount, "said": mount}
    return Mistake(kind, (), r, gravity_in_base(mount), detail, urdf=mounted(sound.urdf, mount))


def _delay(rng: Rng, sound: Sound, kind: str) -> Mistake:
    """Torque a whole number of samples late or early, 10 to 60 ms."""
    r = sound.recording
    k = int(np.ceil(rng.uniform(0.01, 0.06) * r.rate_hz - 1e-6))
    late = bool(rng.random() < 0.5)
    ahead, behind = slice(k, None), slice(0, len(r.time) - k)
    motion, torque = (ahead, behind) if late else (behind, ahead)
    cuts = [slice(max(s.start, motion.start) - motion.start, s.stop - k) for s in r.segments]
    wrong = replace(
        r,
        time=r.time[motion] - r.time[motion][0],
        position=r.position[motion],
        velocity=None if r.velocity is None else r.velocity[motion],
        effort=r.effort[torque],
        segments=tuple(s for s in cuts if s.stop > s.start),
    )
    detail = {"late_s": round((1 if late else -1) * k / r.rate_hz, 4)}
    return Mistake(kind, (), wrong, gravity_in_base(sound.mount), detail)


def _clock(rng: Rng, sound: Sound, kind: str) -> Mistake:
    """A clock set back, stamps that jitter by a good part of a period, or stamps on arrival of whole batches."""
    r = sound.recording
    period, stamps = 1.0 / r.rate_hz, r.time.copy()
    how = str(rng.choice(["set back", "jitter", "batches"]))
    if how == "set back":
        for at in rng.uniform(0.1, 0.9, rng.integers(1, 4)) * r.time[-1]:
            stamps[r.time > at] -= rng.uniform(0.02, 1.0)
    elif how == "jitter":
        stamps += rng.normal(0.0, rng.uniform(0.4, 1.0) * period, len(stamps))
    else:
        batch = np.ceil(stamps / (period * rng.integers(4, 20)))
        _, first, members = np.unique(batch, return_index=True, return_inverse=True)
        arrived = r.time[np.append(first[1:], len(stamps)) - 1]
        stamps = arrived[members] + 2e-5 * (np.arange(len(stamps)) - first[members])
    return Mistake(kind, (), r, gravity_in_base(sound.mount), {"how": how}, stamps=stamps)


def _rest(rng: Rng, sound: Sound, kind: str) -> Mistake:
    r = sound.recording
    return Mistake(kind, tuple(at_rest(r)), r, gravity_in_base(sound.mount))


_MAKE: dict[str, Callable[[Rng, Sound, str], Mistake]] = {
    **dict.fromkeys(("torque_sign", "position_sign", "degrees_one", "zero_offset", "axis_reversed"), _one_joint),
    **{"degrees_all": _degrees_all, "exchanged": _exchanged, "torque_unit": _torque_unit, "gravity": _gravity},
    **{"delay": _delay, "clock": _clock, "rest": _rest},
}


def at_rest(r: Recording) -> list[str]:
    """Joints that hardly move."""
    return [name for name, travel in zip(r.joints, np.ptp(r.position, axis=0)) if travel < REST_RAD]


def _explanations(wrong: Recording, said: Array) -> Iterator[tuple[str, tuple[str, ...], Recording, Array]]:
    """Every single mistake, and the recording and gravity that are right if it was made."""
    names = wrong.joints
    for j, name in enumerate(names):
        yield "torque_sign", (name,), flipped(wrong, j, ("effort",)), said
        yield "position_sign", (name,), flipped(wrong, j, MOTION), said
        yield "axis_reversed", (name,), flipped(wrong, j, ALL), said
        for by in (-0.45, -0.35, -0.25, 0.25, 0.35, 0.45):
            yield "zero_offset", (name,), offset(wrong, j, by), said
    for a, b in combinations(range(len(names)), 2):
        for fields in (ALL, ("effort",)):
            yield "exchanged", (names[a], names[b]), swapped(wrong, a, b, fields), said
    for mount in MOUNTS:
        vector = gravity_in_base(mount)
        if not np.allclose(vector, said):
            yield "gravity", (), wrong, vector


def _sealed(mistake: Mistake, sound: Sound) -> dict[str, Any]:
    """Torque over the CAD values', what can tell, and which other mistakes the recording would fit as well."""
    oracle = Oracle(sound.urdf, sound.recording, gravity_in_base(sound.mount), rough=not sound.simulated)
    size = {"size": round(oracle.size(sound.recording, gravity_in_base(sound.mount)), 3)}
    if mistake.kind in ("sound", "clock", "rest"):
        how = {"sound": [], "clock": ["stamps"], "rest": ["motion"]}[mistake.kind]
        return size | {"told_by": how, "equivalents": []}
    told_by = oracle.kinematics(mistake.recording)
    if mistake.kind == "torque_unit":
        told_by += ["torque"] if oracle.told_size(mistake.recording, mistake.said) else []
        return size | {"told_by": told_by, "equivalents": []}
    excess = oracle.excess(mistake.recording, mistake.said)
    told_by += ["torque"] if excess > ENOUGH else []
    equivalents = set()
    if told_by and mistake.kind not in ("delay", "degrees_one", "degrees_all"):
        for kind, joints, right, gravity in _explanations(mistake.recording, mistake.said):
            if (kind, set(joints)) == (mistake.kind, set(mistake.joints)):
                continue
            if oracle.excess(right, gravity) < ENOUGH and not oracle.kinematics(right):
                equivalents.add((kind, joints))
    return size | {"told_by": told_by, "excess": round(excess, 1), "equivalents": sorted(equivalents)}


def _sound(rng: Rng, kind: str, real: bool, arm: str, recordings: Path) -> Sound:
    if real:
        return real_window(rng, arm, recordings)
    mount = "floor"
    if rng.random() < {"gravity": 0.7, "sound": 0.25}.get(kind, 0.0):
        mount = str(rng.choice([m for m in MOUNTS if m != "floor"]))
    joints = 6 if arm in ("ur5", "ur10", "kinova", "z1") else 7
    return simulate(rng, arm, mount, int(rng.integers(joints)) if kind == "rest" else None)


def write_bag(path: Path, recording: Recording, urdf: str, stamps: Array, rng: Rng) -> None:
    """A bag whose log times go up by the true time, 0.2 to 0.6 ms late, whatever the stamps do."""
    stamps_ns = recording.start_ns + np.rint(stamps * 1e9).astype(np.int64)
    received = np.maximum.accumulate(recording.time + rng.uniform(2e-4, 6e-4, len(stamps)))
    log_ns = recording.start_ns + np.rint(received * 1e9).astype(np.int64)
    r = recording
    payloads = cdr.encode_joint_states(stamps_ns, r.joints, r.position, r.velocity, r.effort)
    with RecordingWriter(path) as writer:
        description = writer.add_topic(messages.DESCRIPTION_TOPIC, messages.STRING, [LATCHED])
        states = writer.add_topic(messages.STATES_TOPIC, messages.JOINT_STATE)
        writer.write(description, int(log_ns[0]), cdr.encode_string(urdf))
        for at, payload in zip(log_ns.tolist(), payloads):
            writer.write(states, at, payload)


def draw(seed: tuple[int, int], trial: tuple[str, bool, str], recordings: Path, out: Path) -> str:
    """Write one trial: its bag, and its sealed answer last. Returns its name.

    Args:
        seed: Of the whole draw, and the number of the trial.
        trial: `sound` or one of `KINDS` and `EXTRAS`; whether to take a real recording; one of `REAL` or `SIMULATED`.
        recordings: Folder of the real recordings.
        out: Folder of the draw.
    """
    kind, real, arm = trial
    assert arm in (REAL if real else SIMULATED)
    rng = np.random.default_rng(seed)
    name = f"{seed[1]:04d}"
    sound = _sound(rng, kind, real, arm, recordings)
    right = Mistake("sound", (), sound.recording, gravity_in_base(sound.mount))
    mistake = right if kind == "sound" else _MAKE[kind](rng, sound, kind)
    urdf = mistake.urdf or (sound.urdf if mistake.arm or kind == "gravity" else mounted(sound.urdf, sound.mount))
    stamps = mistake.recording.time if mistake.stamps is None else mistake.stamps
    write_bag(out / "bags" / f"{name}.mcap", mistake.recording, urdf, stamps, rng)
    if mistake.arm:
        (out / "bags" / f"{name}.urdf").write_text(urdf, encoding="utf-8")
        described = {"schema": "spacearm_ident/arm/1", "urdf": f"{name}.urdf", **mistake.arm}
        (out / "bags" / f"{name}.yaml").write_text(yaml.safe_dump(described, sort_keys=False), encoding="utf-8")
    told = _sealed(mistake, sound)
    answer = {
        "trial": name,
        "kind": kind,
        "joints": list(mistake.joints),
        "arm": ("real " if real else "simulated ") + arm,
        "undeterminable": kind != "sound" and not told["told_by"],
        **told,
        "at_rest": at_rest(sound.recording),
        "detail": mistake.detail,
        "recording": sound.detail | {"mount": sound.mount},
    }
    (out / "answers" / f"{name}.json").write_text(json.dumps(answer, indent=1), encoding="utf-8")
    return name
