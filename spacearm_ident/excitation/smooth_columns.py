"""The columns of a model as smooth functions of a Fourier trajectory's coefficients, with derivatives.

What `criteria.Question.information` gives exactly for any motion, an optimiser needs differentiable and cheap: few
samples a period, the direction of motion as qd / sqrt(qd^2 + s^2) with s what the speed changes by between samples.
Static friction whose peak is narrower than that is left out, as identification leaves it out: slow segments show it.
Terms that have no shape here (`left_out`) are left out too; the exact report has them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.friction import StribeckFriction, ViscousFriction
from ..dynamics.model import TorqueModel
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
        model = question.identified.model
        self._arm = model.arm
        links = range(len(model.arm.joints))
        self._placed: tuple[np.ndarray, np.ndarray] | None = None
        first = model.first_inertial
        numbers = np.empty((0, 10), int) if first is None else first + np.arange(10 * len(links)).reshape(-1, 10)
        self._leading = [int(k) for k in numbers.ravel() if k in question.leads]
        self.inertials = np.zeros((len(links), 10)) if first is None else question.identified.parameters[numbers]
        self._numbers = numbers
        self.own_columns, self.leads = _own_columns(question, softness, self._leading)
        self.size = len(self.leads)

    def at(self, motion: Motion, counted: int | None = None) -> Evaluated:
        """Evaluate at the states of `motion` (T, n), of which the first `counted` count for the information."""
        regressor = DifferentiableRegressor(self._arm, motion)
        samples, joints = motion.q.shape
        counted = counted or samples
        block = regressor.columns()
        columns = np.zeros((self.size, joints, counted))
        taken, put = self.places(regressor)
        columns.reshape(-1, counted)[put] = block.reshape(-1, samples)[taken, :counted]
        by_pair = np.einsum("pkt,kp->kt", block, self.inertials[regressor.links])
        torque = (np.arange(joints)[:, None] == regressor.rows).astype(float) @ by_pair
        slopes = []
        for own in self.own_columns:
            column, slope = own.shape(getattr(motion, own.signal)[:, own.joint])
            if own.slot is not None:
                columns[own.slot, own.joint] = column[:counted]
            torque[own.joint] += own.value * column
            slopes.append(slope)
        return Evaluated(self, regressor, columns, torque.T, slopes)

    def places(self, regressor: DifferentiableRegressor) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the regressor's columns (10 K, T) that lead, and their rows in `Evaluated.columns` (b n, T)."""
        if self._placed is None:
            joints, pairs = len(self._arm.joints), len(regressor.rows)
            slots = {number: slot for slot, number in enumerate(self._leading)}
            found = [
                (parameter * pairs + pair, slots[number] * joints + row)
                for pair, (row, link) in enumerate(zip(regressor.rows.tolist(), regressor.links.tolist()))
                for parameter, number in enumerate(self._numbers[link].tolist() if len(self._numbers) else ())
                if number in slots
            ]
            taken, put = np.array(found, dtype=np.intp).reshape(-1, 2).T
            self._placed = taken, put
        return self._placed


@dataclass(frozen=True)
class Evaluated:
    """`SmoothColumns` at some states: `columns` (b, n, T') of those counted, `torque` (T, n) N·m."""

    source: SmoothColumns
    regressor: DifferentiableRegressor
    columns: FloatArray
    torque: FloatArray
    slopes: list[FloatArray]

    def information(self, weights: FloatArray) -> FloatArray:
        """G (b, b), mean over the samples counted, joint j's rows counted `weights[j]` times."""
        scaled = (self.columns * np.sqrt(weights)[:, None]).reshape(len(self.columns), -1)
        return np.asarray(scaled @ scaled.T / self.columns.shape[2])

    def back(self, weights: FloatArray, slope: FloatArray, by_torque: FloatArray | None = None) -> Motion:
        """Derivatives by the states, (T, n) each, of f(G) with df/dG = `slope`, plus those of a sum over torques.

        Args:
            weights: (n,) as for `information`.
            slope: (b, b), symmetric.
            by_torque: (T, n) derivative of what else counts by each torque.
        """
        size, _, counted = self.columns.shape
        samples = len(self.torque)
        bars = (slope @ self.columns.reshape(size, -1)).reshape(self.columns.shape)
        bars *= (2.0 / counted * weights)[:, None]
        rows, links = self.regressor.rows, self.regressor.links
        adjoint = np.zeros((10, len(rows), samples))
        if by_torque is not None:
            np.multiply(self.source.inertials[links].T[:, :, None], by_torque.T[rows], out=adjoint)
        taken, put = self.source.places(self.regressor)
        adjoint.reshape(-1, samples)[taken, :counted] += bars.reshape(-1, counted)[put]
        out = self.regressor.back(adjoint)
        for own, own_slope in zip(self.source.own_columns, self.slopes):
            change = np.zeros(samples) if by_torque is None else own.value * by_torque[:, own.joint]
            if own.slot is not None:
                change[:counted] += bars[own.slot, own.joint]
            getattr(out, own.signal)[:, own.joint] += change * own_slope
        return out


def left_out(model: TorqueModel) -> tuple[str, ...]:
    """Terms of a model that an optimiser does without, in words, each once.

    Args:
        model: Whose torque is planned with.
    """
    without = [term.words for term in model.terms if term.kind not in (RigidBody.kind, *_SHAPES)]
    loaded = any(isinstance(term, StribeckFriction) and term.loaded for term in model.terms)
    return tuple(dict.fromkeys([*["friction that grows with the load"] * loaded, *without]))


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
