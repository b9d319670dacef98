"""The columns of a model as smooth functions of a Fourier trajectory's coefficients, with derivatives.

What `criteria.Question.information` gives exactly for any motion, an optimiser needs differentiable and cheap: few
samples a period, the direction of motion as qd / sqrt(qd^2 + s^2) with s what the speed changes by between samples.
Static friction whose peak is narrower than that is left out, as identification leaves it out: slow segments show it.
Terms beyond rigid body, rotor inertia, springs, offsets and friction are left out too; the exact report has them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.friction import ViscousFriction
from ..dynamics.rigid_body import RigidBody
from .criteria import Question
from .regressor_gradient import DifferentiableRegressor
from .segments import Motion

Shape = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""A joint's own q, qd or qdd (T,) -> the column (T,) and its derivative by it."""
Made = tuple[str, Shape] | None
"""Which signal, and the column's shape; None where there is no such column here."""


@dataclass(frozen=True)
class _Own:
    """A column in one joint's row that depends on one of that joint's own signals."""

    joint: int
    signal: str
    shape: Shape
    slot: int | None
    value: float
    """The model's, for the torque."""


class SmoothColumns:
    """Columns of a question's base parameters and the model's torque, at the states of a motion, and the way back."""

    def __init__(self, question: Question, softness: FloatArray) -> None:
        """Args: `softness` (n,) is the speed over which the direction of motion turns, rad/s."""
        self._question = question
        model = question.identified.model
        self._arm = model.arm
        links = range(len(model.arm.joints))
        first = next((first for term, first, _ in model.numbered() if isinstance(term, RigidBody)), None)
        numbers = np.empty((0, 10), int) if first is None else first + np.arange(10 * len(links)).reshape(-1, 10)
        rigid = [int(k) for k in numbers.ravel() if k in question.leads]
        slots = {number: k for k, number in enumerate(rigid)}
        chosen = [[k for k in range(10) if first is not None and int(numbers[link, k]) in slots] for link in links]
        # Link by link: which of its ten parameters lead, and their columns here.
        self._rigid = [(picked, [slots[int(numbers[link, k])] for k in picked]) for link, picked in zip(links, chosen)]
        self._inertials = np.zeros((len(links), 10)) if first is None else question.identified.parameters[numbers]
        self._own, self.leads = _own_columns(question, softness, rigid)
        self.size = len(self.leads)

    def at(self, motion: Motion) -> Evaluated:
        """Evaluate at the states of `motion` (T, n)."""
        regressor = DifferentiableRegressor(self._arm, motion)
        samples, joints = motion.q.shape
        columns = np.zeros((joints, samples, self.size))
        torque = np.zeros((samples, joints))
        for link, (supports, block) in enumerate(regressor.blocks()):
            chosen, slots = self._rigid[link]
            if chosen:
                columns[np.ix_(supports, range(samples), slots)] = block[chosen].transpose(1, 2, 0)
            torque[:, supports] += np.einsum("pkt,p->tk", block, self._inertials[link])
        slopes = []
        for own in self._own:
            column, slope = own.shape(getattr(motion, own.signal)[:, own.joint])
            if own.slot is not None:
                columns[own.joint, :, own.slot] = column
            torque[:, own.joint] += own.value * column
            slopes.append(slope)
        return Evaluated(self, regressor, columns, torque, slopes)


@dataclass(frozen=True)
class Evaluated:
    """`SmoothColumns` at some states: `columns` (n, T, b), `torque` (T, n) N·m."""

    source: SmoothColumns
    regressor: DifferentiableRegressor
    columns: FloatArray
    torque: FloatArray
    slopes: list[FloatArray]

    def information(self, weights: FloatArray) -> FloatArray:
        """G (b, b), mean over the samples, joint j's rows counted `weights[j]` times."""
        scaled = (self.columns * np.sqrt(weights)[:, None, None]).reshape(-1, self.columns.shape[2])
        return np.asarray(scaled.T @ scaled / self.columns.shape[1])

    def back(self, weights: FloatArray, slope: FloatArray, by_torque: FloatArray | None = None) -> Motion:
        """Derivatives by the states, (T, n) each, of f(G) with df/dG = `slope`, plus those of a sum over torques.

        Args:
            weights: (n,) as for `information`.
            slope: (b, b), symmetric.
            by_torque: (T, n) derivative of what else counts by each torque.
        """
        samples = self.columns.shape[1]
        bars = (self.columns @ slope) * (2.0 / samples * weights)[:, None, None]
        adjoints = []
        for link, (supports, block) in enumerate(self.regressor.blocks()):
            chosen, slots = self.source._rigid[link]
            adjoint = np.zeros_like(block)
            if chosen:
                adjoint[chosen] = bars[np.ix_(supports, range(samples), slots)].transpose(2, 0, 1)
            if by_torque is not None:
                adjoint += self.source._inertials[link][:, None, None] * by_torque[:, supports].T
            adjoints.append(adjoint)
        out = self.regressor.back(adjoints)
        for own, own_slope in zip(self.source._own, self.slopes):
            change = 0.0 if own.slot is None else bars[own.joint, :, own.slot]
            if by_torque is not None:
                change = change + own.value * by_torque[:, own.joint]
            getattr(out, own.signal)[:, own.joint] += change * own_slope
        return out


def _own_columns(question: Question, softness: FloatArray, rigid: list[int]) -> tuple[list[_Own], list[int]]:
    """The columns of single joints, and the numbers of all leading parameters in the order of their slots."""
    model, identified = question.identified.model, question.identified
    leads, own = list(rigid), []
    for term, first, first_constant in model.numbered():
        if term.kind not in _SHAPES:
            continue
        constants = identified.constants[first_constant : first_constant + len(term.constants)]
        for index, parameter in enumerate(term.parameters):
            joint = model.arm.joint_names.index(parameter.joint)
            peak = float(constants[0]) if len(constants) and question.resolved(joint, float(constants[0])) else 0.0
            odd = isinstance(term, ViscousFriction) and term.is_odd(parameter)
            made = _SHAPES[term.kind](parameter.symbol, softness[joint], peak, odd)
            if made is None:
                continue
            slot = None
            if first + index in question.leads:
                slot = len(leads)
                leads.append(first + index)
            own.append(_Own(joint, *made, slot, float(identified.parameters[first + index])))
    return own, leads


def _direction(speed: FloatArray, softness: float) -> tuple[FloatArray, FloatArray]:
    root = np.sqrt(speed**2 + softness**2)
    return speed / root, softness**2 / root**3


def _stribeck(symbol: str, softness: float, peak: float, odd: bool) -> Made:
    """f_c: sgn (1 - e), f_b: sgn e, e = exp(-(qd/v_b)^2); all of it to f_c where the peak is not resolved."""

    def shape(speed: FloatArray) -> tuple[FloatArray, FloatArray]:
        sign, turn = _direction(speed, softness)
        if peak == 0.0:
            return sign, turn
        share = np.exp(-((speed / peak) ** 2))
        falling = -2 * speed / peak**2 * share
        if symbol == "f_c":
            return sign * (1 - share), turn * (1 - share) - sign * falling
        return sign * share, turn * share + sign * falling

    return ("qd", shape) if symbol == "f_c" or (symbol == "f_b" and peak > 0) else None


def _viscous(symbol: str, softness: float, peak: float, odd: bool) -> Made:
    order = int(symbol[3])

    def shape(speed: FloatArray) -> tuple[FloatArray, FloatArray]:
        if odd:
            return speed * np.abs(speed), 2 * np.abs(speed)
        return speed**order, order * speed ** (order - 1)

    return "qd", shape


def _signal(name: str) -> Callable[[str, float, float, bool], Made]:
    return lambda symbol, softness, peak, odd: (name, lambda values: (values, np.ones_like(values)))


_SHAPES: dict[str, Callable[[str, float, float, bool], Made]] = {
    "rotor_inertia": _signal("qdd"),
    "joint_spring": _signal("q"),
    "stribeck_friction": _stribeck,
    "viscous_friction": _viscous,
    "torque_offset": lambda *_: ("q", lambda values: (np.ones_like(values), np.zeros_like(values))),
}
