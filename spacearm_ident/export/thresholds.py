"""Thresholds for contact detection, by joint and speed, with their false-alarm rate on held-out motion without contact.

The residual is r = measured torque - `torque(q, q', q'')` of the exported code, low-passed at the bandwidth of the fit.
Its distribution depends on speed (friction at reversals), so each joint has a threshold for each of four speed ranges.

The residual is correlated in time, so samples are not independent trials. Rows beyond a level that lie closer than one
period of the low-pass's cut-off are one excursion. Peaks of excursions over a level u have an approximately exponential
tail (peaks over threshold, Coles 2001, ch. 4, with shape 0), which gives the level exceeded R times an hour,

    threshold = u + mean(peak - u) ln(n / (T R)),   n excursions over u in T hours.

That is an extrapolation. The false-alarm rate stated beside it is counted: the motion is cut into `FOLDS` parts in
time, the rule is applied to all but one, and excursions are counted in the one left out. Its interval is that of a
Poisson count (Garwood 1936): T hours without an excursion prove no rate below 3.7 / T.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from ..arrays import FloatArray
from ..errors import UnfitDataError
from ..signals.motion import Motion
from .controller import ControlLaw
from .law import SLOW_SHARE

SCHEMA = "spacearm_ident/contact_thresholds/1"
EDGES = (SLOW_SHARE, 1.0 / 3.0, 2.0 / 3.0)
"""Bounds between the speed ranges, shares of the joint's top held-out speed: standstill and reversals, where friction
balances the rest, then thirds. Four ranges are as many as a minute of motion fills with excursions to count."""
PER_HOUR = 1.0
"""Excursions an hour of motion in a range that a threshold is set for where the user names none."""
QUANTILE = 0.9
"""Quantile of |r| that is the lowest level u, beyond which excursions are separated: a tenth of the rows."""
TAIL = 30
"""Highest peaks that the tail is fitted to, where there are more: u is then the next lower peak. Lighter tails than an
exponential one (noise) would give too high a threshold from a lower u; the mean of 30 peaks is off by 18 %."""
FEWEST = 5
"""Excursions over u below which a range gets no threshold: the mean of fewer peaks is off by more than 45 %."""
FOLDS = 4
"""Parts of the motion that are left out in turn."""
HOUR_S = 3600.0


@dataclass(frozen=True)
class Rate:
    """A counted rate of false alarms.

    Attributes:
        excursions: How many were counted.
        seconds: Time in which they were, s.
    """

    excursions: int
    seconds: float

    @property
    def per_hour(self) -> float:
        """The estimate, 1/h; NaN without time."""
        return self.excursions * HOUR_S / self.seconds if self.seconds > 0 else float("nan")

    @property
    def ci95(self) -> tuple[float, float]:
        """Its 95 % interval, 1/h, by Garwood (1936)."""
        if self.seconds <= 0:
            return 0.0, float("inf")
        count, per = self.excursions, HOUR_S / self.seconds
        lower = 0.5 * chi2.ppf(0.025, 2 * count) if count else 0.0
        return float(lower * per), float(0.5 * chi2.ppf(0.975, 2 * count + 2) * per)


@dataclass(frozen=True)
class SpeedRange:
    """A threshold and what was counted with it.

    Attributes:
        lower, upper: Speeds |q'| that it is for, rad/s (m/s).
        threshold: N·m (N); infinite where too few excursions were there to set one.
        samples, above: Held-out rows in the range for which the other parts gave a threshold, and those beyond it.
        rate: Excursions that began in the range, counted likewise.
    """

    lower: float
    upper: float
    threshold: float
    samples: int
    above: int
    rate: Rate


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of an arm.

    Attributes:
        joints: Joint -> its speed ranges, slowest first.
        units: Joint -> unit of its torque.
        wanted_per_hour: Excursions an hour that each threshold is set for.
        merge_s: Time below which two rows beyond a threshold are one excursion, s.
        bandwidth_hz: Low-pass of the residual, Hz.
        whole: Rate of the arm: excursions of any joint.
    """

    joints: dict[str, tuple[SpeedRange, ...]]
    units: dict[str, str]
    wanted_per_hour: float
    merge_s: float
    bandwidth_hz: float
    whole: Rate

    def tables(self) -> tuple[FloatArray, FloatArray]:
        """Bounds between the ranges (n, 3) and thresholds (n, 4), SI."""
        bounds = np.array([[part.upper for part in parts[:-1]] for parts in self.joints.values()])
        return bounds, np.array([[part.threshold for part in parts] for parts in self.joints.values()])

    def lines(self) -> list[str]:
        """What a user should know, a line for each joint and range."""
        low, high = self.whole.ci95
        lines = [
            f"contact thresholds, residual up to {self.bandwidth_hz:.3g} Hz; false alarms of the arm on "
            f"{self.whole.seconds:.1f} s held out: {self.whole.excursions}, {low:.3g} to {high:.3g} an hour (95 %)"
        ]
        for joint, parts in self.joints.items():
            for part in parts:
                where = f"  {joint} |speed| {part.lower:.3g} to {part.upper:.3g}: "
                if not np.isfinite(part.threshold):
                    lines.append(f"{where}none, too short a motion")
                    continue
                low, high = part.rate.ci95
                lines.append(
                    f"{where}{part.threshold:.3g} {self.units[joint]}; {part.rate.excursions} false "
                    f"alarms in {part.rate.seconds:.1f} s ({low:.3g} to {high:.3g} an hour)"
                )
        return lines

    def document(self, notes: Sequence[str]) -> dict[str, Any]:
        """Plain data of the file; null where there is no threshold."""
        return {
            "schema": SCHEMA,
            "notes": list(notes),
            "residual": "measured torque - torque(q, qd, qdd) of the exported code, both low-passed at bandwidth_hz",
            "bandwidth_hz": self.bandwidth_hz,
            "set_for_per_hour": self.wanted_per_hour,
            "excursions_merged_within_s": self.merge_s,
            "counted_on": f"held-out motion, each of {FOLDS} parts with thresholds from the others",
            "arm": _rate(self.whole),
            "joints": {joint: [self._range(joint, part) for part in parts] for joint, parts in self.joints.items()},
        }

    def _range(self, joint: str, part: SpeedRange) -> dict[str, Any]:
        return {
            "speed_from": part.lower,
            "speed_to": part.upper,
            "threshold": part.threshold if np.isfinite(part.threshold) else None,
            "unit": self.units[joint],
            "samples": part.samples,
            "samples_above": part.above,
            **_rate(part.rate),
        }


def contact_thresholds(law: ControlLaw, motions: Sequence[Motion], bandwidth_hz: float, per_hour: float) -> Thresholds:
    """Set thresholds on held-out motion without contact, and count their false alarms.

    Args:
        law: The law of the exported code.
        motions: Held-out motion with measured torque, in the bandwidth of the fit.
        bandwidth_hz: That bandwidth, Hz.
        per_hour: Excursions an hour of motion that each threshold is set for.

    Raises:
        UnfitDataError: There is no motion with measured torque.
    """
    arm = law.model.model.arm
    if not motions or not any(np.any(motion.torque) for motion in motions):
        raise UnfitDataError("no held-out motion with measured torque: name recordings with --validate")
    rows = [_Rows.of(law, motion, part) for motion in motions for part in _parts(len(motion.position))]
    top = np.max([np.abs(motion.velocity).max(axis=0) for motion in motions], axis=0)
    bounds = np.array(EDGES)[:, None] * top
    merge_s = 1.0 / bandwidth_hz
    levels = _levels(rows, bounds, merge_s, per_hour)
    counts = np.zeros((3, len(EDGES) + 1, len(arm.joints)), dtype=int)
    seconds = np.zeros(counts.shape[1:])
    anywhere = 0
    for fold in range(FOLDS):
        left = rows[fold::FOLDS]
        limits = _levels([one for k, one in enumerate(rows) if k % FOLDS != fold], bounds, merge_s, per_hour)
        for part in left:
            own = part.range_of(bounds)
            limit = np.take_along_axis(limits, own, axis=0)
            beyond, judged = part.size > limit, np.isfinite(limit)
            for k in range(len(arm.joints)):
                kept = own[judged[:, k], k]
                counts[0, :, k] += np.bincount(kept, minlength=len(EDGES) + 1)
                counts[1, :, k] += np.bincount(own[beyond[:, k], k], minlength=len(EDGES) + 1)
                begins = [span.start for span in _excursions(np.asarray(beyond[:, k]), part.step_s, merge_s)]
                counts[2, :, k] += np.bincount(own[begins, k], minlength=len(EDGES) + 1)
                seconds[:, k] += part.step_s * np.bincount(kept, minlength=len(EDGES) + 1)
            anywhere += len(_excursions(np.asarray(beyond.any(axis=1)), part.step_s, merge_s))
    edges = np.vstack([np.zeros(len(top)), bounds, top])
    joints = {
        joint.name: tuple(
            SpeedRange(
                float(edges[part, k]),
                float(edges[part + 1, k]),
                float(levels[part, k]),
                int(counts[0, part, k]),
                int(counts[1, part, k]),
                Rate(int(counts[2, part, k]), float(seconds[part, k])),
            )
            for part in range(len(EDGES) + 1)
        )
        for k, joint in enumerate(arm.joints)
    }
    units = {joint.name: joint.units.effort for joint in arm.joints}
    whole = Rate(anywhere, sum(part.step_s * len(part.size) for part in rows))
    return Thresholds(joints, units, per_hour, merge_s, bandwidth_hz, whole)


def document_text(found: Thresholds, notes: Sequence[str], as_json: bool) -> str:
    """The file's text.

    Args:
        found: The thresholds.
        notes: Lines that say how they were obtained.
        as_json: JSON, else YAML.
    """
    data = found.document(notes)
    if as_json:
        return json.dumps(data, indent=2, allow_nan=False) + "\n"
    return str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110))


@dataclass(frozen=True)
class _Rows:
    """Held-out rows of one part: |residual| and speed (M, n), and the time between rows."""

    size: FloatArray
    speed: FloatArray
    step_s: float

    @classmethod
    def of(cls, law: ControlLaw, motion: Motion, part: slice) -> _Rows:
        residual = motion.torque - law.model.torque(motion)
        return cls(np.abs(residual[part]), np.abs(motion.velocity[part]), 1.0 / motion.rate_hz)

    def range_of(self, bounds: FloatArray) -> np.ndarray:
        """(M, n) number of the range of each row; bounds (3, n)."""
        return np.asarray((self.speed[None] > bounds[:, None]).sum(axis=0))


def _parts(rows: int) -> list[slice]:
    """`FOLDS` parts of a motion, one after the other."""
    cuts = np.linspace(0, rows, FOLDS + 1).astype(int).tolist()
    return [slice(start, stop) for start, stop in pairwise(cuts)]


def _levels(rows: Sequence[_Rows], bounds: FloatArray, merge_s: float, per_hour: float) -> FloatArray:
    """(4, n) thresholds from some rows; infinite where there are too few excursions."""
    levels = np.full((len(EDGES) + 1, bounds.shape[1]), np.inf)
    for part in range(len(levels)):
        within = [one.range_of(bounds) == part for one in rows]
        for k in range(bounds.shape[1]):
            sizes = [np.where(mask[:, k], one.size[:, k], 0.0) for one, mask in zip(rows, within)]
            mine = np.concatenate([size[mask[:, k]] for size, mask in zip(sizes, within)])
            if not len(mine):
                continue
            level = float(np.quantile(mine, QUANTILE))
            peaks = [
                size[span].max()
                for size, one in zip(sizes, rows)
                for span in _excursions(np.asarray(size > level), one.step_s, merge_s)
            ]
            hours = sum(one.step_s * mask[:, k].sum() for one, mask in zip(rows, within)) / HOUR_S
            if len(peaks) >= FEWEST:
                highest = sorted(peaks, reverse=True)
                if len(peaks) > TAIL:
                    level, highest = float(highest[TAIL]), highest[:TAIL]
                ratio = max(1.0, len(highest) / (hours * per_hour))
                levels[part, k] = level + float(np.mean(highest) - level) * np.log(ratio)
    return levels


def _excursions(beyond: np.ndarray, step_s: float, merge_s: float) -> list[slice]:
    """Runs of rows beyond a level, those closer than `merge_s` taken together."""
    at = np.flatnonzero(beyond)
    if not len(at):
        return []
    cuts = np.flatnonzero(np.diff(at) * step_s > merge_s)
    starts, stops = at[np.concatenate([[0], cuts + 1])], at[np.concatenate([cuts, [len(at) - 1]])] + 1
    return [slice(int(start), int(stop)) for start, stop in zip(starts, stops)]


def _rate(rate: Rate) -> dict[str, Any]:
    low, high = rate.ci95
    return {
        "seconds": rate.seconds,
        "false_alarms": rate.excursions,
        "false_alarms_per_hour": rate.per_hour if rate.seconds > 0 else None,
        "ci95_per_hour": [low, high] if np.isfinite(high) else None,
    }
