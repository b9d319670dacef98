"""What a format can hold of an identified model: the nearest parameters of its law, and what the rest costs.

A simulator's joint has few parameters beside its body: an inertia of the rotor, a damping, a Coulomb friction, at times
a spring. What else was identified (Stribeck, higher orders of speed, load on the gear, ripple, ...) is not cut off: the
format's own parameters are fitted to all of it, by least squares over the motion the model was validated on,

    min over p >= 0 of  sum over rows (tau_model - tau_bodies - columns p)^2   where the joint moves,

and what that leaves of the model's prediction is the cost, in N·m RMS and at most. The bodies are those of the
identified model, and all values the physically consistent ones: what `unbounded` and `plain` add is part of the cost.
A spring and a constant torque are taken over where a format has a spring, and are cost elsewhere: what acts by position
is no friction, and fitted by it on one motion it would be wrong on the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ..arrays import FloatArray
from ..dynamics.coupling import CoupledMotor
from ..dynamics.model import IdentifiedModel
from ..dynamics.rigid_body import JointSpring, RotorInertia, TorqueOffset
from ..results.formats import (
    ARMATURE,
    DAMPING,
    FRICTION,
    PARTS,
    REST,
    RIGID,
    SPRINGS,
    STIFFNESS,
    Format,
    lost_words,
    spring_of,
)
from ..signals.motion import Motion

SLOW_SHARE = 0.02
"""Rows slower than this share of a joint's top speed stand still: friction there is whatever balances the rest, and no
format's law is judged by it."""

ROUNDING = 1e-9
"""Share of a joint's torque below which a cost is rounding of the arithmetic: it is near 1e-15 where a format holds the
whole model, and no torque is measured to more than six digits."""


@dataclass(frozen=True)
class Nearest:
    """The parameters of a format that come nearest to a model.

    Attributes:
        format: The format.
        values: Joint -> parameter of `Format.holds` -> value, SI.
        cost_Nm: Joint -> RMS of what the format leaves, N·m, where the joint moves.
        most_Nm: Joint -> the largest of it.
        torque_Nm: Joint -> RMS of the model's torque there, to compare with.
        lost: What of the model the format does not hold as it is, in words.
        further: What else a user should know of the export, a line each.
    """

    format: Format
    values: Mapping[str, Mapping[str, float]]
    cost_Nm: Mapping[str, float]
    most_Nm: Mapping[str, float]
    torque_Nm: Mapping[str, float]
    lost: tuple[str, ...]
    further: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """What a user should know of the cost, a line each."""
        lost = f"does not hold: {', '.join(self.lost)}" if self.lost else "holds every term of this model"
        lines = [f"{self.format.name} {lost}"]
        if all(cost <= ROUNDING * self.torque_Nm[joint] for joint, cost in self.cost_Nm.items()):
            return [*lines, "  its torque is the model's at every joint", *self.further]
        for joint, cost in self.cost_Nm.items():
            share = cost / self.torque_Nm[joint] if self.torque_Nm[joint] > 0 else 0.0
            lines.append(
                f"  {joint}: costs {cost:.3g} N m RMS ({share:.1%} of its torque), {self.most_Nm[joint]:.3g} at most"
            )
        return [*lines, *self.further]


def nearest(model: IdentifiedModel, form: Format, motions: Sequence[Motion]) -> Nearest:
    """Fit a format's parameters to a model.

    Args:
        model: The identified model; its physically consistent values are exported.
        form: The format.
        motions: Where it is to be near.
    """
    whole_model, model = model, model.possible  # no simulator takes bodies that cannot be
    arm = model.model.arm
    values: dict[str, dict[str, float]] = {}
    cost, most, size = {}, {}, {}
    bodies = np.concatenate([model.torque(motion, (RIGID,)) for motion in motions])
    fitted = [kind for kind in model.model.structure if kind not in (RIGID, *SPRINGS)]
    rest = np.concatenate([model.torque(motion, fitted) for motion in motions])
    torque = np.concatenate([whole_model.torque(motion) for motion in motions])
    q, qd, qdd = (
        np.concatenate([getattr(motion, name) for motion in motions])
        for name in ("position", "velocity", "acceleration")
    )
    for k, joint in enumerate(arm.joint_names):
        moving = np.abs(qd[:, k]) > SLOW_SHARE * np.abs(qd[:, k]).max()
        columns = {ARMATURE: qdd[:, k], DAMPING: qd[:, k], FRICTION: np.sign(qd[:, k])}
        chosen = {name: column for name, column in columns.items() if name in form.holds}
        found = _fit(chosen, rest[:, k], moving)
        held = sum((found[name] * column for name, column in chosen.items()), bodies[:, k])
        if STIFFNESS in form.holds:
            spring = spring_of(model, joint)
            found |= {STIFFNESS: max(spring.stiffness, 0.0), REST: spring.rest}
            held = held + found[STIFFNESS] * (q[:, k] - spring.rest)
        left = torque[:, k] - held
        values[joint] = found
        kept = left[moving] if moving.any() else np.zeros(1)
        cost[joint], most[joint] = float(np.sqrt(np.mean(kept**2))), float(np.abs(kept).max())
        size[joint] = float(np.sqrt(np.mean(torque[moving, k] ** 2))) if moving.any() else 0.0
    return Nearest(form, values, cost, most, size, lost_words(whole_model, form))


def _fit(columns: Mapping[str, FloatArray], target: FloatArray, rows: np.ndarray) -> dict[str, float]:
    """Least squares over some rows, nothing below zero."""
    if not columns or not rows.any():
        return dict.fromkeys(columns, 0.0)
    matrix = np.column_stack([column[rows] for column in columns.values()])
    scale = np.maximum(np.sqrt(np.mean(matrix**2, axis=0)), 1e-300)
    solution = lsq_linear(matrix / scale, target[rows], (0.0, np.inf), method="bvls", tol=1e-14)
    return {name: float(value) for name, value in zip(columns, solution.x / scale)}


SIMPLE_TERMS = frozenset({RIGID, RotorInertia.kind, JointSpring.kind, TorqueOffset.kind, CoupledMotor.kind, *PARTS})
"""Terms whose law a controller's code can hold."""
