"""Base parameters: the combinations of parameters that any motion can reveal (Gautier 1991, Khalil and Dombre 2002).

Columns of the regressor that are combinations of earlier ones, whatever the motion, are found numerically on
random motions; their parameters regroup into the earlier ones: A x = A[:, independent] (K x).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..signals.base_motion import BaseMotion
from ..signals.motion import Motion
from .background import Background
from .model import TorqueModel
from .term import Parameter

SAMPLES_A_PARAMETER = 6
RANK_TOLERANCE = 1e-8
COEFFICIENT_TOLERANCE = 1e-7
# Within a link the parameters that usually regroup into the link before come last.
ORDER = ("Izz", "Ixx", "Ixy", "Ixz", "Iyz", "mcx", "mcy", "Iyy", "mcz", "m")


@dataclass(frozen=True)
class BaseParameters:
    """The regrouping of p parameters into b base parameters.

    Attributes:
        independent: (b,) numbers of the parameters that lead a base parameter.
        regrouping: (b, p) K: base values = K @ parameters; identity on `independent`.
        names: What each base parameter is made of, such as `Izz[j1] + J_m[j1] + 0.36 m[j3]`.
        unseen: Numbers of the parameters that no motion moves any torque with.
    """

    independent: tuple[int, ...]
    regrouping: FloatArray
    names: tuple[str, ...]
    unseen: tuple[int, ...]

    def alone(self, parameter: int) -> bool:
        """Whether a parameter is a base parameter by itself."""
        if parameter not in self.independent:
            return False
        return int(np.count_nonzero(self.regrouping[self.independent.index(parameter)])) == 1

    def errors(self, covariance: FloatArray) -> FloatArray:
        """(b,) standard errors of the base parameters, from the covariance (p or more, p or more) of the parameters."""
        count = self.regrouping.shape[1]
        spread = self.regrouping @ covariance[:count, :count] @ self.regrouping.T
        return np.asarray(np.sqrt(np.maximum(np.diag(spread), 0.0)))

    def shift(self, change: FloatArray, errors: FloatArray) -> float:
        """Largest change of a base parameter in its standard errors (b,), of a change (p,) of the parameters."""
        known = errors > 0
        return float(np.max(np.abs(self.regrouping @ change)[known] / errors[known], initial=0.0))


def base_parameters(model: TorqueModel, seed: int = 0, *, moving_base: bool = False) -> BaseParameters:
    """The base parameters of a model, whatever the motion; a base that moves, and is measured, reveals more.

    Args:
        model: Its arm and terms.
        seed: Seed of the random motion states at which the observation matrix is evaluated.
        moving_base: Whether the random states include a motion of the base.
    """
    return regroup(_random_columns(model, seed, moving_base), model.parameters, _preference(model))


def regroup(columns: FloatArray, parameters: Sequence[Parameter], preference: Sequence[int]) -> BaseParameters:
    """The base parameters that columns on random motions show.

    Args:
        columns: (r, p), a column a parameter.
        parameters: p, for the names.
        preference: (p,) their numbers in the order in which they should lead.
    """
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > RANK_TOLERANCE * norms.max()
    order = [k for k in preference if seen[k]]
    scaled = columns[:, order] / norms[order]
    independent, dependent = _independent(scaled)
    solution = np.linalg.lstsq(scaled[:, independent], scaled[:, dependent], rcond=None)[0]
    regrouping = np.zeros((len(independent), columns.shape[1]))
    lead = [order[k] for k in independent]
    for b, k in enumerate(lead):
        regrouping[b, k] = 1.0
    for d, k in enumerate(dependent):
        follower = order[k]
        coefficients = solution[:, d] * norms[follower] / norms[lead]
        coefficients[np.abs(solution[:, d]) < COEFFICIENT_TOLERANCE] = 0.0
        regrouping[:, follower] = coefficients
    sort = np.argsort(lead)
    regrouping = regrouping[sort]
    lead = [lead[k] for k in sort]
    names = tuple(_name(parameters, row, first) for row, first in zip(regrouping, lead))
    unseen = tuple(int(k) for k in np.flatnonzero(~seen))
    return BaseParameters(tuple(lead), regrouping, names, unseen)


def random_base(rng: np.random.Generator, samples: int) -> BaseMotion:
    """A base that moves at random.

    Args:
        rng: Random generator; every component is uniform between -2 and 2 in its SI unit.
        samples: Number of independent samples; they are no continuous motion.

    Returns:
        Angular velocity, angular acceleration and specific force, (samples, 3) each.
    """
    return BaseMotion(*rng.uniform(-2.0, 2.0, (3, samples, 3)))


def _random_columns(model: TorqueModel, seed: int, moving_base: bool) -> FloatArray:
    """All columns on random motion states, (samples * n, p)."""
    joints = len(model.arm.joints)
    count = len(model.parameters)
    samples = max(64, SAMPLES_A_PARAMETER * count // joints)
    rng = np.random.default_rng(seed)
    position, velocity, acceleration = rng.uniform(-2.0, 2.0, (3, samples, joints))
    zero = np.zeros(joints)
    torque = np.zeros_like(position)
    background = Background.known(rng.normal(size=position.shape))
    base = random_base(rng, samples) if moving_base else None
    names = model.arm.joint_names
    warm = rng.uniform(0.0, 40.0, position.shape)
    signals = position, velocity, acceleration, torque
    motion = Motion(names, 1.0, 0.0, *signals, zero, zero, temperature=warm, base=base)
    whole = np.zeros((joints, samples, count))
    for term, first, _ in model.numbered():
        # The largest value a constant may have, so that its columns are felt at random speeds too.
        largest = [constant.grid[-1] for constant in term.constants]
        for row, (indices, columns) in term.columns(motion, largest, background).items():
            whole[row][:, first + np.array(indices)] = columns
    return whole.reshape(joints * samples, count)


def _preference(model: TorqueModel) -> list[int]:
    """Parameters in the order in which they should lead: base to tip, and as `ORDER` says within a link."""
    joints = model.arm.joint_names

    def rank(number: int) -> tuple[int, int, int]:
        parameter = model.parameters[number]
        link = joints.index(parameter.joint) if parameter.joint in joints else len(joints)
        inner = ORDER.index(parameter.symbol) if parameter.symbol in ORDER else len(ORDER)
        return (link, inner, number)

    return sorted(range(len(model.parameters)), key=rank)


def _independent(scaled: FloatArray) -> tuple[list[int], list[int]]:
    """Columns independent of the ones before them, and the others: the diagonal of an unpivoted QR."""
    diagonal = np.abs(np.diag(np.asarray(np.linalg.qr(scaled, mode="r"))))
    independent = [int(k) for k in np.flatnonzero(diagonal > RANK_TOLERANCE)]
    return independent, [k for k in range(scaled.shape[1]) if k not in set(independent)]


def _name(parameters: Sequence[Parameter], row: FloatArray, lead: int) -> str:
    parts = [parameters[lead].name]
    for k in np.flatnonzero(row).tolist():
        if k == lead:
            continue
        sign = "-" if row[k] < 0 else "+"
        size = abs(row[k])
        factor = "" if abs(size - 1) < 1e-6 else f"{size:.4g} "
        parts.append(f"{sign} {factor}{parameters[k].name}")
    return " ".join(parts)
