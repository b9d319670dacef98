"""How much a motion tells of the parameters: criteria on the information matrix, and that matrix itself.

With W the stacked columns of the base parameters, sample by joint, and G = W' W / samples:

    condition           sqrt(lmax / lmin) of G                   the paper's (section 3), raw
    scaled-condition    the same of G scaled to a unit diagonal  Gautier and Khalil 1992; Presse and Gautier 1993
    d-optimal           -log det G / columns                     volume of the confidence ellipsoid; Swevers et al. 1997
    prediction          log tr(G^-1 V) / 2                       variance of torques predicted on test motions

The last two weigh each joint's rows by its noise, G = sum_j W_j' W_j / sigma_j^2; the first two do not, as published.
Optimisers get smooth forms: lmax and lmin become p-norms of the eigenvalues, and every criterion comes with its
derivative F = df/dG (symmetric), so that df = tr(F dG) = 2 sum_j tr(F W_j' dW_j) / sigma_j^2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import base_parameters
from ..dynamics.model import IdentifiedModel
from ..signals.motion import Motion as SampledMotion
from .segments import Motion

CONDITION, SCALED_CONDITION, D_OPTIMAL, PREDICTION = CRITERIA = (
    "condition",
    "scaled-condition",
    "d-optimal",
    "prediction",
)
DEFAULT_CRITERION = PREDICTION
"""By the evidence in docs/excitation.md: the smallest errors of predicted torque."""
CRITERION_WORDS = {
    CONDITION: "condition number of the observation matrix",
    SCALED_CONDITION: "condition number, columns scaled to unit norm",
    D_OPTIMAL: "D-optimality: log volume of the confidence ellipsoid",
    PREDICTION: "standard deviation of predicted torque / torque noise",
}
DEFAULT_NOISE_SHARE = 0.0035
"""Standard deviation of a torque sample as a share of the joint's torque limit, where nothing better is known."""
RESOLVED_SHARE = 0.05
"""A Stribeck velocity below this share of the joint's velocity limit is not seen by motion at full speed."""
_FLOOR = 1e-15
_LOG_STEP = 1e-4
_BLOCK = 20_000
"""Samples whose columns are held at once."""

Valued = tuple[float, FloatArray]
"""f and F = df/dG (b, b)."""


def smooth_criterion(
    name: str, sharpness: float, prediction: FloatArray | None = None
) -> Callable[[FloatArray], Valued]:
    """A criterion as a smooth function of G, to be minimised.

    Args:
        name: One of `CRITERIA`.
        sharpness: p of the eigenvalues' p-norms; the condition number itself in the limit.
        prediction: V (b, b), for `prediction`.
    """
    if name == CONDITION:
        return lambda information: _log_condition(information, sharpness)
    if name == SCALED_CONDITION:
        return lambda information: _log_scaled_condition(information, sharpness)
    if name == D_OPTIMAL:
        return _log_volume
    if prediction is None:
        raise ValueError("prediction needs the second moment of the test motions' columns")
    return lambda information: _log_prediction(information, prediction)


def condition_number(information: FloatArray) -> float:
    """Condition number of W from G = W' W; infinite where a column is a combination of others."""
    values = np.linalg.eigvalsh(information)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > _FLOOR * values[-1] else float("inf")


def scaled_condition_number(information: FloatArray) -> float:
    """The same of W with its columns scaled to one length."""
    scale = np.sqrt(np.diag(information))
    if not np.all(scale > 0):
        return float("inf")
    return condition_number(information / np.outer(scale, scale))


def _log_condition(information: FloatArray, sharpness: float) -> Valued:
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, _FLOOR * values[-1])
    high, low = (values / values[-1]) ** sharpness, (values[0] / values) ** sharpness
    value = np.log(values[-1] / values[0]) + (np.log(high.sum()) + np.log(low.sum())) / sharpness
    slope = (high / high.sum() - low / low.sum()) / values
    return float(value / 2), (vectors * (slope / 2)) @ vectors.T


def _log_scaled_condition(information: FloatArray, sharpness: float) -> Valued:
    scale = _unit_diagonal(information)
    scaled = information * np.outer(scale, scale)
    value, slope = _log_condition(scaled, sharpness)
    # The scale moves with the diagonal of G: d(1/sqrt G_ii) = -(1/2) G_ii^(-3/2) dG_ii.
    out = slope * np.outer(scale, scale)
    out[np.diag_indices_from(out)] -= scale**2 * np.einsum("ij,ji->i", scaled, slope)
    return value, out


def _log_volume(information: FloatArray) -> Valued:
    inverse, logdet = _inverse(information)
    count = len(information)
    return -logdet / count, -inverse / count


def _log_prediction(information: FloatArray, prediction: FloatArray) -> Valued:
    inverse, _ = _inverse(information)
    spread = inverse @ prediction @ inverse
    variance = float(np.einsum("ij,ji->", inverse, prediction))
    return 0.5 * float(np.log(variance)), -0.5 * spread / variance


def _unit_diagonal(information: FloatArray) -> FloatArray:
    """(b,) scale of rows and columns that makes the diagonal one; that of an unseen column is bounded."""
    diagonal = np.diag(information)
    return 1.0 / np.sqrt(np.maximum(diagonal, 1e-24 * max(float(diagonal.max()), 1e-300)))


def _inverse(information: FloatArray) -> tuple[FloatArray, float]:
    """Inverse and log determinant of G, in units in which its diagonal is one; a singular G is bounded away."""
    scale = _unit_diagonal(information)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values, _FLOOR)
    inverse = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse, float(np.log(values).sum() - 2 * np.log(scale).sum())


@dataclass(frozen=True)
class Information:
    """What a motion tells: exact columns, no smoothing.

    Attributes:
        names: The b base parameters (by their leading parameter), then constants as `log v_b[joint]`.
        by_joint: (n, b, b) mean outer product of each joint's columns, unweighted.
        conditioned: Columns that the condition numbers are taken of.
        noise_Nm: (n,) standard deviation of a torque sample.
    """

    names: tuple[str, ...]
    by_joint: FloatArray
    conditioned: tuple[int, ...]
    noise_Nm: FloatArray

    @property
    def plain(self) -> FloatArray:
        """(b', b') unweighted, of the columns that condition numbers are taken of."""
        chosen = np.array(self.conditioned)
        return np.asarray(self.by_joint.sum(axis=0)[np.ix_(chosen, chosen)])

    @property
    def weighted(self) -> FloatArray:
        """(b, b) a sample's information, weighted by the noise of each joint."""
        return np.asarray(np.einsum("jab,j->ab", self.by_joint, self.noise_Nm**-2.0))

    def values(self) -> dict[str, float]:
        """Both condition numbers and the D-optimal criterion; the smaller, the better."""
        chosen = np.array(self.conditioned)
        return {
            CONDITION: condition_number(self.plain),
            SCALED_CONDITION: scaled_condition_number(self.plain),
            D_OPTIMAL: _log_volume(self.weighted[np.ix_(chosen, chosen)])[0],
        }

    def covariance(self, samples: float) -> FloatArray:
        """(b, b) after so many samples with independent noise."""
        return _inverse(self.weighted * samples)[0]

    def prediction_sd(self, tests: Sequence[Information], samples: float) -> FloatArray:
        """(n,) N·m: root mean square over test motions of the predicted torque's standard deviation.

        Over the columns that condition numbers are taken of: a peak of static friction that full speed does not
        show is not asked for in a motion at full speed either.

        Args:
            tests: Information of motions that are to be predicted.
            samples: How many of the excitation are independent.
        """
        chosen = np.ix_(self.conditioned, self.conditioned)
        covariance = _inverse(self.weighted[chosen] * samples)[0]
        moments = np.mean([test.by_joint for test in tests], axis=0)[:, *chosen]
        return np.asarray(np.sqrt(np.einsum("jab,ab->j", moments, covariance)))

    def relative_errors(self, samples: float) -> dict[str, float]:
        """Standard error of every constant's logarithm: its relative error."""
        errors = np.sqrt(np.diag(self.covariance(samples)))
        return {n.removeprefix("log "): float(e) for n, e in zip(self.names, errors) if n.startswith("log ")}


@dataclass(frozen=True)
class Question:
    """What is to be known: a model at its current values, its base parameters, and how loud each joint is.

    Attributes:
        identified: Structure with current values; these enter through the constants' derivatives and the torque.
        leads: Numbers of the free parameters that lead a base parameter.
        noise_Nm: (n,) standard deviation of a torque sample.
    """

    identified: IdentifiedModel
    leads: tuple[int, ...]
    noise_Nm: FloatArray

    @classmethod
    def of(cls, identified: IdentifiedModel, noise_Nm: FloatArray | None = None) -> Question:
        """Find the base parameters; noise from the torque limits unless given.

        Args:
            identified: What is known of the arm, with values near its own.
            noise_Nm: (n,) standard deviation of a torque sample; None: a share of each joint's torque limit.
        """
        model = identified.model
        leads = tuple(k for k in base_parameters(model).independent if not model.parameters[k].held)
        if noise_Nm is None:
            limits = np.array([joint.effort_limit for joint in model.arm.joints])
            known = limits[np.isfinite(limits)]
            usual = float(np.median(known)) if len(known) else 1.0 / DEFAULT_NOISE_SHARE
            noise_Nm = DEFAULT_NOISE_SHARE * np.where(np.isfinite(limits), limits, usual)
        return cls(identified, leads, np.asarray(noise_Nm, dtype=float))

    def resolved(self, joint: int, stribeck_velocity: float) -> bool:
        """Whether motion at full speed can see a Stribeck peak this wide; if not, only slow segments can.

        Args:
            joint: Its number.
            stribeck_velocity: rad/s or m/s.
        """
        limit = self.identified.model.arm.joints[joint].velocity_limit
        return stribeck_velocity >= RESOLVED_SHARE * (limit if np.isfinite(limit) else 1.0)

    def information(self, motion: Motion, rate_hz: float) -> Information:
        """The exact information of a motion (T, n) sampled at `rate_hz`; constants that are zero have no column.

        Args:
            motion: Positions, velocities and accelerations, (T, n) each.
            rate_hz: Of its samples.
        """
        model = self.identified.model
        names = [model.parameters[k].name for k in self.leads]
        present = [k for k, value in enumerate(self.identified.constants) if value > 0]
        names += [f"log {model.constants[k].name}" for k in present]
        count = len(motion.q)
        by_joint = np.zeros((motion.q.shape[1], len(names), len(names)))
        for first in range(0, count, _BLOCK):
            columns = self._columns(Motion(*(part[first : first + _BLOCK] for part in motion)), rate_hz, present)
            by_joint += columns.transpose(0, 2, 1) @ columns / count
        seen = np.einsum("jaa->a", by_joint) > 0
        return Information(tuple(names), by_joint, self._conditioned(seen), self.noise_Nm)

    def _columns(self, motion: Motion, rate_hz: float, present: Sequence[int]) -> FloatArray:
        """(n, T, b) columns of the leading parameters, then of the logarithms of the constants `present`."""
        model = self.identified.model
        sampled = SampledMotion.free_of_noise(model.arm.joint_names, rate_hz, *motion)
        parameters, constants = self.identified.parameters, self.identified.constants
        slots = {number: k for k, number in enumerate(self.leads)}
        slot_of = {k: len(self.leads) + i for i, k in enumerate(present)}
        whole = np.zeros((motion.q.shape[1], len(motion.q), len(self.leads) + len(present)))
        background = model.background(sampled, parameters, constants)
        for term, first, first_constant in model.numbered():
            values = list(constants[first_constant : first_constant + len(term.constants)])
            here = term.columns(sampled, values, background)
            for row, (indices, columns) in here.items():
                kept = [(i, slots[first + index]) for i, index in enumerate(indices) if first + index in slots]
                whole[row][:, [slot for _, slot in kept]] += columns[:, [i for i, _ in kept]]
            for k in range(len(values)):
                if first_constant + k not in slot_of:
                    continue
                moved = [v * np.exp(_LOG_STEP) if i == k else v for i, v in enumerate(values)]
                for row, (indices, columns) in term.columns(sampled, moved, background).items():
                    change = (columns - here[row][1]) @ parameters[first + np.array(indices)]
                    whole[row][:, slot_of[first_constant + k]] += change / _LOG_STEP
        return whole

    def _conditioned(self, seen: FloatArray) -> tuple[int, ...]:
        """Linear columns but for static friction whose peak is too narrow for motion at full speed."""
        model, hidden = self.identified.model, set()
        for constant, value in zip(model.constants, self.identified.constants):
            joint = model.arm.joint_names.index(constant.joint) if constant.joint in model.arm.joint_names else -1
            if constant.symbol == "v_b" and joint >= 0 and not self.resolved(joint, float(value)):
                hidden.add(f"f_b[{constant.joint}]")
        chosen = [k for k, n in enumerate(self.leads) if model.parameters[n].name not in hidden and seen[k]]
        return tuple(chosen)
