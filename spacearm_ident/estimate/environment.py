"""What an identification says of the arm's surroundings: vacuum or air, gravity, temperatures. Results and words.

*Vacuum* (paper §2.2.2): the high-order terms of friction vanish. With them estimated, a Wald test says at which
joints they differ from zero: W = x' C^-1 x / q is F(q, nu) distributed where they do not, C their covariance (which
holds for correlated residuals) and nu the effective rows beyond the joint's columns. Joints are judged together
(Holm 1979), so that a healthy vacuum is called air in at most 5 % of the cases.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import f as f_distribution

from ..arrays import FloatArray
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import TorqueModel, temperature_joints
from ..dynamics.term import Parameter
from ..signals.motion import Motion

LEVEL = 0.05
GRAVITY_SCALE = 10.0
"""Standard deviation of each component of gravity before the data, m/s^2: it may be there, absent, or upside down."""
SEEN_SHARE = 0.25
"""A component with a standard error above this share of `GRAVITY_SCALE` is not seen."""
ZERO_ERROR = 0.5
"""Gravity is called zero only where every component that is seen is known to so many m/s^2."""


def wald(values: FloatArray, covariance: FloatArray, freedom: float) -> tuple[float, float]:
    """F and p value of the hypothesis that all values are zero.

    Args:
        values: (q,) estimates.
        covariance: (q, q) of the estimates, positive definite.
        freedom: Degrees of freedom of the residual, the denominator's of F.
    """
    scale = np.sqrt(np.diag(covariance))
    inside = np.linalg.solve(covariance / np.outer(scale, scale), values / scale)
    ratio = float(values / scale @ inside) / len(values)
    return ratio, float(f_distribution.sf(ratio, len(values), freedom))


@dataclass(frozen=True)
class HighOrder:
    """Test of one joint's k_v2 and k_v3 against zero: F, its p value, and whether they differ (all joints judged)."""

    joint: str
    f: float
    p_value: float
    differs: bool


@dataclass(frozen=True)
class VacuumTest:
    """The high-order friction of all joints against zero.

    Attributes:
        joints: Those tested.
        unseen: Joints whose motion does not reveal them.
    """

    joints: tuple[HighOrder, ...]
    unseen: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The verdict in one line."""
        differ = [f"{one.joint} (F {one.f:.3g}, p {one.p_value:.1g})" for one in self.joints if one.differs]
        same = [one.joint for one in self.joints if not one.differs]
        if differ:
            text = f"k_v2, k_v3 differ from 0 at {', '.join(differ)}"
            text += f"; not at {', '.join(same)}" if same else ""
        elif same:
            least = min(one.p_value for one in self.joints)
            text = f"k_v2, k_v3 do not differ from 0 at {', '.join(same)} (least p {least:.2g}), as in vacuum"
        else:
            return f"k_v2, k_v3: nothing known of {', '.join(self.unseen)}"
        return text + (f"; nothing known of {', '.join(self.unseen)}" if self.unseen else "")


def judge_vacuum(
    parameters: Sequence[Parameter],
    values: FloatArray,
    covariance: FloatArray,
    scale: FloatArray,
    freedom: Mapping[str, float],
) -> VacuumTest | None:
    """Test k_v2 and k_v3 of every joint against zero.

    Args:
        parameters: (p,) of the model.
        values: (p,) estimates before any bound was imposed.
        covariance: (p or more, p or more).
        scale: (p,) standard deviations of the prior; a standard error near it means that the data say nothing.
        freedom: Effective rows beyond the columns, by joint.

    Returns:
        The verdict; None where the model estimates no such parameters.
    """
    numbers: dict[str, list[int]] = {}
    for k, parameter in enumerate(parameters):
        if ViscousFriction.high_order(parameter) and scale[k] > 0 and parameter.joint in freedom:
            numbers.setdefault(parameter.joint, []).append(k)
    if not numbers:
        return None
    errors = np.sqrt(np.diag(covariance))
    tested: list[tuple[str, float, float]] = []
    unseen = []
    for joint, places in numbers.items():
        index = np.array(places)
        if (errors[index] <= 0).any() or (errors[index] > SEEN_SHARE * scale[index]).any():
            unseen.append(joint)
        else:
            tested.append((joint, *wald(values[index], covariance[np.ix_(index, index)], freedom[joint])))
    differs = holm([p for _, _, p in tested])
    joints = tuple(HighOrder(*one, differ) for one, differ in zip(tested, differs))
    return VacuumTest(joints, tuple(unseen))


def holm(p_values: Sequence[float]) -> list[bool]:
    """Which of some hypotheses are rejected while at most `LEVEL` of all families have a false rejection."""
    rejected = [False] * len(p_values)
    for rank, k in enumerate(np.argsort(p_values)):
        if p_values[k] > LEVEL / (len(p_values) - rank):
            break
        rejected[k] = True
    return rejected


@dataclass(frozen=True)
class GravityEstimate:
    """Gravity as the data have it, m/s^2 in the base frame.

    Attributes:
        vector: (3,) what the model goes on with.
        covariance: (3, 3), the masses unknown as they are.
        before: (3,) the stated gravity.
        size_held: Only the direction was estimated.
        p_zero: p value of the hypothesis that there is none.
    """

    vector: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    before: tuple[float, ...]
    size_held: bool
    p_zero: float

    @property
    def errors(self) -> FloatArray:
        """(3,) standard errors; above a quarter of `GRAVITY_SCALE` the data say nothing of a component."""
        return np.sqrt(np.maximum(np.diag(np.array(self.covariance)), 0.0))

    @property
    def seen(self) -> np.ndarray:
        """(3,) whether the data say something of a component."""
        return self.errors < SEEN_SHARE * GRAVITY_SCALE

    @property
    def size(self) -> tuple[float, float]:
        """Magnitude and its standard error."""
        vector = np.array(self.vector)
        size = float(np.linalg.norm(vector))
        along = vector / size if size > 0 else np.full(3, 3**-0.5)
        return size, float(np.sqrt(max(along @ np.array(self.covariance) @ along, 0.0)))

    @property
    def tilt_deg(self) -> tuple[float, float] | None:
        """Angle from the stated gravity, and the largest standard error of the direction; None without a direction."""
        vector, before = np.array(self.vector), np.array(self.before)
        size, stated = np.linalg.norm(vector), np.linalg.norm(before)
        if size == 0 or stated == 0:
            return None
        along, was = vector / size, before / stated
        across = (np.eye(3) - np.outer(along, along)) / size
        spread = np.linalg.eigvalsh(across @ np.array(self.covariance) @ across.T)[-1]
        angle = np.arctan2(np.linalg.norm(np.cross(was, along)), was @ along)
        return float(np.degrees(angle)), float(np.degrees(np.sqrt(max(spread, 0.0))))

    @property
    def words(self) -> str:
        """In one line."""

        def triple(values: Sequence[float]) -> str:
            return f"({', '.join(f'{value:.3g}' for value in values)})"

        text = f"gravity estimated: {triple(self.vector)} ± {triple(list(self.errors))} m/s^2 in the base frame"
        if not any(self.vector):
            text += f", zero (p {self.p_zero:.2g})"
        else:
            (size, error), tilt = self.size, self.tilt_deg
            if tilt is not None:
                text += f", {tilt[0]:.2f} ± {tilt[1]:.2g} degrees from {triple(self.before)}"
            text += f", size {size:.2f} " + ("held" if self.size_held else f"± {error:.2g}")
            if not self.size_held and error > SEEN_SHARE * GRAVITY_SCALE:
                text += ", which this motion does not separate from the masses"
        dark = [axis for axis, seen in zip("xyz", self.seen) if not seen]
        return text + (f"; {', '.join(dark)} not excited, from the prior" if dark and not self.size_held else "")


@dataclass(frozen=True)
class Environment:
    """What was found of the surroundings; None where nothing was asked or nothing can be said.

    Attributes:
        vacuum: Whether the high-order friction is there.
        gravity: Where it was estimated.
        no_temperature: Joints whose temperature the model asks for and at least one recording does not have.
    """

    vacuum: VacuumTest | None = None
    gravity: GravityEstimate | None = None
    no_temperature: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """A line each."""
        lines = [found.words for found in (self.vacuum, self.gravity) if found is not None]
        if self.no_temperature:
            lines.append(
                f"no temperature of {', '.join(self.no_temperature)} was recorded: friction there is as at 20 degrees "
                "Celsius, how it follows the temperature stays unknown (record /joint_temperatures)"
            )
        return tuple(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for a file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Environment:
        """What `as_dict` gave, read back."""
        vacuum, gravity = data.get("vacuum"), data.get("gravity")
        return cls(
            vacuum and VacuumTest(tuple(HighOrder(**one) for one in vacuum["joints"]), tuple(vacuum["unseen"])),
            gravity
            and GravityEstimate(
                tuple(gravity["vector"]),
                tuple(tuple(row) for row in gravity["covariance"]),
                tuple(gravity["before"]),
                gravity["size_held"],
                float(gravity["p_zero"]),
            ),
            tuple(data.get("no_temperature", ())),
        )


def without_temperature(model: TorqueModel, motions: Sequence[Motion]) -> tuple[str, ...]:
    """Joints whose temperature the model asks for and a motion lacks.

    Args:
        model: Its terms say at which joints temperature is needed.
        motions: A joint is named where one of them has no temperature of it, or NaN in it.
    """
    joints = model.arm.joint_names
    return tuple(
        joint
        for joint in temperature_joints(model.structure, model.arm)
        if any(m.temperature is None or np.isnan(m.temperature[:, joints.index(joint)]).any() for m in motions)
    )
