"""One blind trial from a seed: what to conceal, how strongly, and the recordings that hide it.

How strong an effect is: RMS of what the recorded torque of the field run differs by from the healthy arm's on the
recorded motion, without noise and filtered to `BAND_HZ`; over the noise floor of that joint (RMS of its noise, filtered
alike); the largest such ratio among the effect's joints. Nothing is taken off for what a refit of the base model would
absorb: the reference knows the healthy arm. (Not the difference between two arms under the same commands: they turn
round at slightly different moments, and all of their friction with them, which nobody who has the motion would miss.)
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from concealed_arm import FORMS, JOINTS, VALIDATION, DrawnArm, draw_arm, draw_motion
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, lfilter, sosfiltfilt

from spacearm_ident.recording import write_recording
from spacearm_ident.simulation.closed_loop import RunawayError, Truth, measure, simulate_truth
from spacearm_ident.simulation.concealed import EFFECTS, Concealment, make_effect
from spacearm_ident.simulation.joint_law import StribeckLaw
from spacearm_ident.simulation.mechanism import RigidMechanism
from spacearm_ident.simulation.servo import ServoTuning
from spacearm_ident.simulation.thermal import ThermalParameters

BAND_HZ = 10.0
STANDSTILL = 1e-3
"""rad/s."""
TURNING_SAMPLES = 7
"""Around a reversal, whose moment is known to a sample."""
BEGINNING_S = 1.0
"""Left out: how a joint breaks away depends on how it came to rest."""
MULTIPLES = (2.0, 5.0, 10.0)
SHARES = {"healthy": 0.2, "two": 0.15, "absent": 0.1, "one": 0.55}
TOLERANCE = 0.25
"""Asked and reached multiple may differ by this share before another try."""
Entry = dict[str, Any]


@dataclass(frozen=True)
class Strength:
    """Which parameter makes an effect stronger, and where it acts.

    Attributes:
        parameter: Name.
        low: Smallest strength tried.
        high: Largest; strength is |parameter|, its inverse or 1 − it.
        form: `linear`, `signed` (either sign, drawn), `inverse`, `less` (1 − strength) or `scale` (1 ± strength).
        joints: Joints it may act at; empty: the whole arm.
        also: Other parameters to be drawn evenly between two numbers.
        along: Parameters that grow with the first: their ratio to it is drawn evenly between two numbers.
    """

    parameter: str
    low: float
    high: float
    form: str = "linear"
    joints: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    also: tuple[tuple[str, float, float], ...] = ()
    along: tuple[tuple[str, float, float], ...] = ()

    def value(self, strength: float, sign: float) -> float:
        """The parameter at a strength."""
        match self.form:
            case "signed":
                return sign * strength
            case "inverse":
                return 1.0 / strength
            case "less":
                return 1.0 - strength
            case "scale":
                return 1.0 + sign * strength
        return -strength if self.form == "negative" else strength


_PHASE = ("phase", -3.1, 3.1)
# Gear teeth: 4 to 20 % of critical damping, as is usual for meshes (Kasuba and Evans 1981: 3 to 17 %).
STRENGTHS = {
    "payload": Strength("mass", 0.02, 4.0, joints=(3, 4, 5)),
    "friction_drift": Strength("coulomb", 0.02, 8.0, "signed"),
    "temperature_friction": Strength(
        "coulomb_slope", 2e-4, 0.03, "negative", also=(("viscous_slope", -0.012, -0.004), ("rise", 12.0, 35.0))
    ),
    "load_friction": Strength("mu", 2e-3, 0.3, joints=(1, 2, 3)),
    "gear_efficiency": Strength("efficiency", 2e-3, 0.3, "less", joints=(1, 2, 3)),
    "presliding_hysteresis": Strength("distance", 5e-4, 0.03),
    "position_friction": Strength("amplitude", 0.03, 8.0, also=(_PHASE, ("cycles", 1.0, 3.0))),
    # A joint that rubs more one way has more of both kinds of friction (in these arms k_v1 is one to two times f_c):
    # more dry friction alone would be a current_offset to any fit.
    "asymmetric_friction": Strength(
        "coulomb", 0.02, 6.0, "signed", joints=(0, 3, 4, 5), along=(("viscous", 0.0, 1.5),)
    ),
    "stribeck": Strength("amplitude", 0.05, 12.0, also=(("velocity", 0.025, 0.12),)),
    "vacuum_friction": Strength("fraction", 0.02, 1.0, joints=()),
    "torque_ripple": Strength("amplitude", 0.02, 8.0, also=(_PHASE, ("cycles", 8.0, 60.0))),
    "joint_elasticity": Strength("stiffness", 1 / 2e5, 1 / 1.5e3, "inverse", joints=(0, 1, 2)),
    "backlash": Strength("gap", 5e-5, 0.03, joints=(0, 1, 2), also=(("stiffness", 1e5, 2e5), ("damping", 60.0, 300.0))),
    "harness_spring": Strength("stiffness", 0.05, 25.0, also=(("centre", -0.5, 0.5),)),
    "rotor_coupling": Strength("inertia", 5e-3, 3.0, joints=(2, 3, 4, 5)),
    "wrist_coupling": Strength("coulomb", 0.03, 6.0, joints=(3, 4)),
    "base_tilt": Strength("angle", 5e-4, 0.12, joints=(), also=(("azimuth", -3.1, 3.1),)),
    "floating_base": Strength("base_ratio", 1 / 400, 1 / 1.5, "inverse", joints=()),
    "link_flexibility": Strength("stiffness", 1 / 3e5, 1 / 1.2e3, "inverse", joints=(0, 1, 2)),
    "external_contact": Strength(
        "force", 0.1, 80.0, joints=(2, 3, 4, 5), also=(("start", 4.0, 9.0), ("duration", 1.2, 3.5))
    ),
    "torque_constant": Strength("scale", 1e-3, 0.25, "scale"),
    "motor_saturation": Strength("torque", 1 / 3e3, 1 / 8.0, "inverse", joints=(0, 1, 2, 3, 4, 5)),
    "current_offset": Strength("offset", 0.02, 10.0, "signed", joints=(0, 3, 4, 5)),
    "encoder_eccentricity": Strength("amplitude", 1e-4, 0.02, also=(_PHASE, ("cycles", 1.0, 8.0))),
    "time_delay": Strength("delay", 2e-4, 0.03, joints=()),
    "filter_lag": Strength("corner", 1 / 400, 1 / 2.0, "inverse"),
    "pump_disturbance": Strength("amplitude", 0.02, 8.0, also=(_PHASE, ("frequency", 0.8, 6.0))),
    "position_product": Strength("stiffness", 0.05, 60.0, joints=(0, 1, 2, 3)),
    "current_dead_zone": Strength("width", 0.02, 20.0),
    "loose_bolt": Strength("amplitude", 0.05, 20.0, also=(("seed", 0.0, 1e6),)),
    "soft_base": Strength("stiffness", 1 / 3e6, 1 / 4e3, "inverse", joints=()),
    "link_gyroscope": Strength("momentum", 0.02, 40.0, joints=(1, 2, 3, 4)),
    "resting_friction": Strength("amplitude", 0.05, 12.0, also=(("recovery", 0.2, 1.2),)),
}
WEIGHTLESS_ONLY = {"floating_base"}
NEEDS_WEIGHT = {"base_tilt"}
COMPARABLE = {"stribeck": "amplitude", "temperature_friction": "coulomb_slope"}
KNOWN = tuple(name for name in STRENGTHS if EFFECTS[name].known)
ABSENT = tuple(name for name in STRENGTHS if not EFFECTS[name].known)


class Trial:
    """The arm, the motions, and what the simulator makes of them with and without effects."""

    def __init__(self, seed: int, *, form: str | None, kind: str | None, effects: tuple[str, ...] | None) -> None:
        self.rng = rng = np.random.default_rng([seed, 20251])
        self.seed = seed
        self.kind = kind or ("one" if effects else str(rng.choice(list(SHARES), p=list(SHARES.values()))))
        self.names = effects or self._names()
        if self.kind == "healthy":
            self.names = ()
        elif len(self.names) == 2:
            self.kind = "two"
        elif self.names and self.names[0] in ABSENT:
            self.kind = "absent"
        weightless = bool(WEIGHTLESS_ONLY & set(self.names)) or (
            rng.random() < 0.08 and not NEEDS_WEIGHT & set(self.names)
        )
        self.form = form or str(rng.choice(["two", "three"], p=[0.7, 0.3]))
        self.arm: DrawnArm = draw_arm(rng, weightless=weightless)
        self.motions = [draw_motion(rng, shape[self.form]) for shape in (FORMS, FORMS, VALIDATION)]
        self.ambient = 20.0 + rng.uniform(-1.0, 1.0, (3, 6))
        self.floor = self._noise_floor()

    def _names(self) -> tuple[str, ...]:
        if self.kind == "absent":
            return (str(self.rng.choice(ABSENT)),)
        drawn = [str(name) for name in self.rng.choice(KNOWN, 2, replace=False)]
        if self.kind == "two" and WEIGHTLESS_ONLY & set(drawn) and NEEDS_WEIGHT & set(drawn):
            drawn = ["floating_base", "torque_ripple"]
        return tuple(drawn) if self.kind == "two" else tuple(drawn[:1])

    def simulate(self, run: int, entries: list[Entry]) -> Truth:
        """Run 0 (commissioning), 1 (field) or 2 (validation) with these effects, without noise."""
        taken = {name for entry in entries if entry["effect"] == "presliding_hysteresis" for name in entry["joints"]}
        own = [(name, float(slip)) for name, slip in zip(JOINTS, self.arm.slip) if slip > 0 and name not in taken]
        effects = [make_effect(JOINTS, **entry) for entry in entries]
        if own:
            names, slips = zip(*own)
            effects.append(make_effect(JOINTS, "presliding_hysteresis", names, {"distance": list(slips)}))
        return simulate_truth(
            self.arm.parameters,
            self.motions[run],
            drives=self.arm.drives,
            tuning=ServoTuning(rate_hz=2000.0),
            thermal=ThermalParameters(0.0, housing_heat_capacity=1e6, ambient=self.ambient[run]),
            hidden=Concealment(effects),
        )

    def record(self, run: int, truth: Truth, path: Path) -> None:
        """Noise, and the file."""
        scale = replace(truth.drives, torque_limit=self.arm.noise_std)
        recording = measure(
            replace(truth, drives=scale), self.arm.noise, seed=self.seed * 3 + run, start_ns=1_700_000_000 * 10**9
        )
        write_recording(path, replace(recording, command=None))

    def _noise_floor(self) -> np.ndarray:
        """(n,) N·m in the band, of a long stretch of noise."""
        rng, noise, n = np.random.default_rng(self.seed), self.arm.noise, 40_000
        keep = math.exp(-1e-3 / noise.effort_correlation_s)
        slow = lfilter([1.0], [1.0, -keep], rng.standard_normal(n)) * math.sqrt(1 - keep**2)
        both = noise.effort_white * rng.standard_normal(n) + noise.effort_coloured * slow
        return self.arm.noise_std * float(in_band(both[:, None]).std())

    def amplitudes(self, truth: Truth) -> np.ndarray:
        """(n,) N·m RMS of what the healthy arm, on the same motion, has not."""
        strange = in_band(truth.torque - self._healthy_torque(truth))[truth.time >= BEGINNING_S]
        return np.asarray(np.sqrt(np.mean(strange**2, axis=0)))

    def _healthy_torque(self, truth: Truth) -> np.ndarray:
        """(N, n) N·m of the arm without effects on the recorded motion; as recorded where a joint stands or turns."""
        p = self.arm.parameters
        mechanism, law, warm = RigidMechanism(p), StribeckLaw(p), np.zeros(len(JOINTS))
        torque = np.array(
            [
                mechanism.load(q, qd, qdd) + p.rotor_inertia * qdd + law.smooth_torque(q, qd, warm)
                for q, qd, qdd in zip(truth.q, truth.qd, truth.qdd)
            ]
        )
        torque += law.dry_level(truth.q, truth.qd, warm) * self._built_up(truth)
        turns = np.abs(truth.qd) < STANDSTILL
        turns[1:] |= np.sign(truth.qd[1:]) != np.sign(truth.qd[:-1])
        return np.where(maximum_filter1d(turns, TURNING_SAMPLES, axis=0), truth.torque, torque)

    def _built_up(self, truth: Truth) -> np.ndarray:
        """(N, n) share of the dry friction that is there: all of it, or what has built up since the reversal."""
        share, z = np.sign(truth.qd), np.zeros(len(JOINTS))
        slips = self.arm.slip > 0
        kept = np.exp(-np.abs(truth.qd) * 1e-3 / np.where(slips, self.arm.slip / 3.0, 1.0))
        for k, sign in enumerate(np.sign(truth.qd)):
            z = sign + (z - sign) * kept[k]
            share[k, slips] = z[slips]
        return share


def in_band(values: np.ndarray) -> np.ndarray:
    """Low-pass without delay, (N, n)."""
    return np.asarray(sosfiltfilt(butter(4, BAND_HZ, fs=1000.0, output="sos"), values, axis=0))


def draw_trial(
    seed: int,
    bags: Path,
    sealed: Path,
    *,
    form: str | None = None,
    kind: str | None = None,
    effects: tuple[str, ...] | None = None,
    multiple: float | None = None,
) -> Entry:
    """Draw, simulate and write a trial.

    Args:
        seed: Same seed, same trial.
        bags: Folder for what the tool sees; `arguments.json` there holds what a user would add on the command line.
        sealed: Folder for `answer.json`.
        form: Of the motions; drawn unless given.
        kind: `healthy`, `one`, `two` or `absent`; drawn unless given.
        effects: Names in place of drawn ones.
        multiple: Of the noise floor, in place of a drawn one.

    Returns:
        The answer.
    """
    trial = Trial(seed, form=form, kind=kind, effects=effects)
    found = [_drawn_effect(trial, name, multiple) for name in trial.names]
    entries = [entry for entry, _ in found]
    bags.mkdir(parents=True, exist_ok=True)
    sealed.mkdir(parents=True, exist_ok=True)
    for run, name in enumerate(("commissioning", "field", "field_validation")):
        known = found[0][1]["truth"] if run == 1 and len(found) == 1 else None
        truth = known or trial.simulate(run, entries if run else [])
        trial.record(run, truth, bags / f"{name}.mcap")
    if not trial.arm.parameters.gravity.any():
        (bags / "arguments.json").write_text(json.dumps(["--gravity", "0", "0", "0"]), encoding="utf-8")
    answer = {
        "schema": "spacearm_ident/concealed_answer/1",
        "seed": seed,
        "kind": trial.kind,
        "form": trial.form,
        "effects": [{key: value for key, value in more.items() if key != "truth"} for _, more in found],
        "noise_floor_Nm": dict(zip(JOINTS, np.round(trial.floor, 5).tolist())),
        "noise_std_Nm": dict(zip(JOINTS, np.round(trial.arm.noise_std, 5).tolist())),
        "arm": trial.arm.summary(),
    }
    (sealed / "answer.json").write_text(json.dumps(answer, indent=1), encoding="utf-8")
    return answer


def _drawn_effect(trial: Trial, name: str, multiple: float | None) -> tuple[Entry, Entry]:
    """An effect as strong as drawn, and what to tell of it; other joints are tried where it cannot be."""
    asked = multiple or float(trial.rng.choice(MULTIPLES))
    best: tuple[float, Entry, Entry] | None = None
    for _ in range(3):
        entry, more = _scaled(trial, name, asked)
        off = abs(math.log(max(more["multiple"], 1e-6) / asked))
        if best is None or off < best[0]:
            best = (off, entry, more)
        if off < 2 * TOLERANCE or not STRENGTHS[name].joints:
            break
    assert best is not None
    return best[1], best[2]


def _scaled(trial: Trial, name: str, asked: float) -> tuple[Entry, Entry]:
    """One placing of the effect, its strength searched by secants in the logarithm."""
    rng, strength, kind = trial.rng, STRENGTHS[name], EFFECTS[name]
    entry = _placed(trial, name)
    sign = float(rng.choice([-1.0, 1.0]))
    ratios = {key: float(rng.uniform(low, high)) for key, low, high in strength.along}
    mine = [JOINTS.index(joint) for joint in entry["joints"]] if _local(name) else list(range(6))
    x, slope, last, high = math.sqrt(strength.low * strength.high), 1.0, None, strength.high
    tries = 4
    while tries:
        value = strength.value(x, sign)
        entry["parameters"] |= {strength.parameter: value} | {key: ratio * value for key, ratio in ratios.items()}
        try:
            truth = trial.simulate(1, [entry])
        except RunawayError:  # More than the arm can carry: such a coupling leaves no inertia.
            last, high = None, 0.5 * x
            x = math.sqrt(strength.low * high)
            continue
        amplitude = trial.amplitudes(truth)
        reached = float((amplitude / trial.floor)[mine].max())
        tries -= 1
        if abs(reached / asked - 1.0) < TOLERANCE:
            break
        if last is not None and reached > 0 and last[1] > 0 and x != last[0]:
            slope = min(3.0, max(0.4, math.log(reached / last[1]) / math.log(x / last[0])))
        last = (x, reached)
        following = x * math.exp(math.log(asked / max(reached, 1e-9)) / slope)
        following = min(max(following, strength.low), high)
        if abs(math.log(following / x)) < 1e-3:
            break
        x = following
    more = {
        "effect": name,
        "known": kind.known,
        "joints": list(entry["joints"]) or list(JOINTS),
        "local": _local(name),
        "law": entry["law"],
        "parameters": dict(entry["parameters"]),
        "comparable": COMPARABLE.get(name, strength.parameter),
        "asked_multiple": asked,
        "multiple": round(reached, 3),
        "amplitude_Nm": dict(zip(JOINTS, np.round(amplitude, 5).tolist())),
        "multiples": dict(zip(JOINTS, np.round(amplitude / trial.floor, 3).tolist())),
        "truth": truth,
    }
    return entry, more


def _placed(trial: Trial, name: str) -> Entry:
    """Joints, form and minor parameters."""
    rng, strength, kind = trial.rng, STRENGTHS[name], EFFECTS[name]
    first = int(rng.choice(strength.joints)) if strength.joints else None
    joints = [] if first is None else [JOINTS[first]]
    if kind.joints_needed == 2 and first is not None:
        joints.append(JOINTS[first + 1])
    parameters: Entry = {key: float(rng.uniform(low, high)) for key, low, high in strength.also}
    if "cycles" in parameters:
        parameters["cycles"] = float(round(parameters["cycles"]))
    if name == "external_contact":
        parameters["direction"] = rng.standard_normal(3).tolist()
        # On the skin of the link: a push on the next joint's axis does not turn it, and may be on either link.
        angle, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.04, 0.12)
        parameters["point"] = [0.05 * math.cos(angle), 0.05 * math.sin(angle), height]
    if name == "presliding_hysteresis":
        trial.arm.slip[first] = 0.0  # What the healthy arm has as well, and may have more of, is not concealed.
    if name == "payload":
        parameters["centre"] = rng.uniform(-0.06, 0.12, 3).tolist()
    law = kind.laws[0] if rng.random() < 0.7 else str(rng.choice(kind.laws))
    return {"effect": name, "joints": joints, "parameters": parameters, "law": law}


def _local(name: str) -> bool:
    """Whether the torque of the named joints alone shows it."""
    spread = {"payload", "external_contact", "link_flexibility", "rotor_coupling", "link_gyroscope"}
    return bool(STRENGTHS[name].joints) and name not in spread
