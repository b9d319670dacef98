"""Generic rivals: free functions of one signal, without physics, that a named effect must outscore.

They are smooth functions of the position or velocity of the joint or of another one, of that position times the joint's
own direction of motion, and of torque; others are periodic in time or drift. Where one of them explains what no named
effect does, the finding is `unknown` and states that dependence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import BSpline

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.background import Background
from ..dynamics.effects.effect import Effect, Options, direction, known_joint, nothing, own
from ..dynamics.term import Columns, Constant, Parameter, Values
from ..signals.motion import Motion

UNKNOWN = "unknown"
DEGREE = 3
INNER = (2.0, 98.0)
"""Percentiles between which a dependence is followed; beyond them it stays as it is there."""
NARROWEST = 1e-6
"""rad, rad/s or N m between the percentiles below which a signal stands still: nothing can be seen to follow it."""
JUMPS = ("velocity", "torque")
"""What may turn with its sign: a spline through zero could not jump there."""


@dataclass(frozen=True)
class Rival(Effect):
    """A dependence without a name; `place` says of what, and between which bounds."""

    kind: ClassVar[str] = UNKNOWN
    words: ClassVar[str] = "a dependence that no known effect has"
    equation: ClassVar[str] = "a smooth function"
    source: ClassVar[str] = "regression splines"

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        if place["of"] == "time_periodic":
            grid = tuple(float(f) for f in np.geomspace(0.2, 18.0, 220))
            parameters = tuple(Parameter(symbol, joint, "N m") for symbol in ("sin", "cos"))
            return cls(parameters, (Constant("frequency", joint, "Hz", grid),), place=place)
        if place["of"] == "time_window":
            start = Constant("start", joint, "s", tuple(float(t) for t in np.arange(0.0, 120.0, 0.5)), begins=True)
            length = Constant("length", joint, "s", (0.75, 1.5, 3.0, 5.0))
            return cls((Parameter("torque", joint, "N m"),), (start, length), place=place)
        count = 3 if place["of"] == "time_drift" else int(place["count"]) + (place["of"] in JUMPS)
        return cls(tuple(Parameter(f"b{k}", joint, "N m") for k in range(count)), place=place)

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Splines, sines or powers of what it depends on."""
        row = motion.joints.index(self.place["joint"])
        of = self.place["of"]
        time = motion.start_s + np.arange(len(motion.position)) / motion.rate_hz
        if of == "time_periodic":
            angle = 2 * np.pi * constants[0] * time
            return own(row, np.sin(angle), np.cos(angle))
        if of == "time_window":
            if self.elsewhere(motion):
                return nothing(motion, [row], 1)
            return own(row, ((time >= constants[0]) & (time < constants[0] + constants[1])).astype(float))
        if of == "time_drift":
            moving, late = direction(motion, row), time / float(self.place["length"])
            return own(row, late, late * moving, late**2 * moving)
        other = motion.joints.index(self.place.get("with", self.place["joint"]))
        if of != "torque":
            signal = (motion.velocity if of == "velocity" else motion.position)[:, other]
        elif background is None:
            return nothing(motion, [row], len(self.parameters))
        else:
            signal = background.torque[:, other]
        basis = _splines(signal, float(self.place["low"]), float(self.place["high"]), int(self.place["count"]))
        if of == "friction_position":
            basis = basis * direction(motion, row)[:, None]
        if of in JUMPS:
            basis = np.column_stack([basis, direction(motion, other) if of == "velocity" else np.sign(signal)])
        return {row: (list(range(basis.shape[1])), basis)}

    def where(self, values: FloatArray) -> str:
        """What it depends on."""
        of, other = self.place["of"], self.place.get("with")
        if of == "time_periodic":
            return f"comes back {values[2]:.3g} times a second, whatever the motion"
        if of == "time_window":
            return f"between {values[1]:.1f} and {values[1] + values[2]:.1f} s"
        whose = f"the {'position' if 'position' in of else of} of {other}" if other else f"its own {of}"
        of_which = f"the position of {other}" if other else "position"
        return {
            "time_drift": "drifts in time",
            "friction_position": f"follows {of_which} times direction of motion",
        }.get(of, f"follows {whose}")


def rivals(motions: Sequence[Motion]) -> Iterator[Options]:
    """Every generic dependence that these motions could show: not on what stands still."""
    for place in _dependences(motions):
        if place.get("high", np.inf) - place.get("low", 0.0) > NARROWEST:
            yield place


def _dependences(motions: Sequence[Motion]) -> Iterator[Options]:
    joints = motions[0].joints
    length = max(len(motion.position) / motion.rate_hz for motion in motions)
    ends = {
        of: np.percentile(np.concatenate([getattr(motion, of) for motion in motions]), INNER, axis=0)
        for of in ("position", "velocity", "torque")
    }

    def between(of: str, row: int) -> dict[str, float]:
        return dict(zip(("low", "high"), ends[of][:, row].tolist()))

    for row, joint in enumerate(joints):
        yield {"joint": joint, "of": "position", "count": 9, **between("position", row)}
        yield {"joint": joint, "of": "friction_position", "count": 9, **between("position", row)}
        yield {"joint": joint, "of": "velocity", "count": 8, **between("velocity", row)}
        yield {"joint": joint, "of": "torque", "count": 8, **between("torque", row)}
        yield {"joint": joint, "of": "time_periodic"}
        yield {"joint": joint, "of": "time_window"}
        yield {"joint": joint, "of": "time_drift", "length": length}
        for k, name in enumerate(joints):
            if k != row:
                for of in ("position", "friction_position", "velocity"):
                    yield {"joint": joint, "with": name, "count": 6, "of": of, **between(of.split("_")[-1], k)}


def _splines(signal: FloatArray, low: float, high: float, count: int) -> FloatArray:
    """(N, count) cubic B-splines over [low, high]; beyond it the outermost values."""
    inner = np.linspace(low, high, count - DEGREE + 1)
    knots = np.concatenate([[low] * DEGREE, inner, [high] * DEGREE])
    inside = np.clip(signal, low, high - 1e-12 * max(high - low, 1e-9))
    return np.asarray(BSpline.design_matrix(inside, knots, DEGREE).toarray())
