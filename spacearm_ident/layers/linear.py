"""`Linear`: torque of motions, linear in everything that may be wrong, as Gram matrices by joint and block of time.

Around a model with values, and a wiring, the torque of a recording is linear in

    the model's parameters     tau = Y x
    a gain's logarithm         the model's own torque at that joint
    a zero                     d tau_rigid / dq at all joints
    a delay                    -d tau / dt of what lasts (`events`)
    a tilt of the base         d tau_rigid / d gravity, times gravity x axis
    a constant's logarithm     d tau / d ln c, for the errors: a Stribeck velocity that is off moves the levels

Any subset of them, fitted to any blocks of time and judged on others, is then a small linear problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..dynamics.regressor import rigid_body_torque
from ..dynamics.term import Columns
from ..forks import each
from ..mismatch.noise import Noise
from ..mismatch.scene import Scene, Whitener
from ..regression.balanced import solve
from ..regression.held_out import time_blocks
from ..regression.prior import make_prior
from ..signals.motion import Motion
from .events import lasting_torque
from .wiring import Wiring, column_names, gravity_torque

STATE_GROUPS = 6
"""Groups of a joint's rows by its velocity, and as many by its position."""
CONSTANT_STEP = 1e-3
"""Step of the difference quotient of the torque by a constant's natural logarithm."""
CONSTANT_SPREAD = 1.0
"""Standard deviation of a constant's natural logarithm about what the search found, before the data: a factor e."""
ZERO_STEP = 1e-4
"""rad: step of the difference quotient of the torque by a zero."""
LARGEST_FACTOR = 10.0
"""A joint's variance is at most so many times what its own residual said."""
RIDGE = 1e-10
"""Relative, on the diagonal of normal equations: keeps a column that is zero from making them singular."""


@dataclass(frozen=True)
class Prior:
    """Gaussian prior of every unknown.

    Attributes:
        mean: (P,).
        precision: (P, P).
        free: (P,) which are estimated; the others stay at their mean.
    """

    mean: FloatArray
    precision: FloatArray
    free: np.ndarray

    def held(self, which: np.ndarray, value: float) -> Prior:
        """The same with some unknowns (P,) held at a value; the others are as they would be, were that so."""
        mean, free = self.mean.copy(), self.free & ~which
        slope = self.precision[np.ix_(free, which)] @ (value - mean[which])
        mean[free] -= solve(self.precision[np.ix_(free, free)], slope)
        mean[which] = value
        return Prior(mean, self.precision, free)


@dataclass(frozen=True)
class Solution:
    """Estimates.

    Attributes:
        values: (P,).
        covariance: (P, P); zero where not estimated.
    """

    values: FloatArray
    covariance: FloatArray


class Linear:
    """Motions under a model and a wiring.

    Attributes:
        model: The model with values that the columns are built around.
        wiring: What was undone in the motions.
        names: (P,) of the unknowns.
        blocks: Number of blocks of time.
        recording: (B,) which recording a block is of.
        gram: (n, B, P + 1, P + 1) of weighted columns and, last, torque.
        by_state: (2, n, G, P + 1, P + 1) the same of equally many rows of a joint each, by its velocity and by its
            position; none unless asked for.
        rows: (n, B) number of rows.
    """

    def __init__(
        self,
        model: IdentifiedModel,
        motions: Sequence[Motion],
        whiteners: Sequence[Whitener],
        wiring: Wiring,
        by_state: bool = False,
    ) -> None:
        """Build the columns.

        Args:
            model: With values.
            motions: As recorded.
            whiteners: What a row of each joint counts for.
            wiring: What is undone first; columns of gains, zeros and delay are of what is left.
            by_state: Whether what only errors need is wanted: `by_state`, and columns of the constants' logarithms,
                which are zero else.
        """
        self.model, self.wiring, self._whiteners = model, wiring, whiteners
        self.motions = wiring.undone(motions, model)
        joints = model.model.arm.joint_names
        self.names = (
            *(parameter.name for parameter in model.model.parameters),
            *column_names(joints),
            *(f"ln {constant.name}" for constant in model.model.constants),
        )
        self._rows = each(lambda motion: _rows_of(model, motion, whiteners, by_state), self.motions)
        self._gather(by_state)

    def _gather(self, by_state: bool) -> None:
        """Gram matrices of the rows."""
        joints = range(len(self.model.model.arm.joints))
        block_of, self.recording = time_blocks(self.motions)
        self.blocks = len(self.recording)
        self.gram = np.zeros((len(joints), self.blocks, self.count + 1, self.count + 1))
        self.rows = np.zeros((len(joints), self.blocks))
        for blocks, part in zip(block_of, self._rows):
            for joint, (place, stacked) in enumerate(part):
                for number in np.unique(blocks[place]):
                    rows = stacked[blocks[place] == number]
                    self.gram[joint, number] = rows.T @ rows
                    self.rows[joint, number] = len(rows)
        self._of_all_blocks: FloatArray = self.gram.sum(axis=1)
        self.by_state = _by_state(self.motions, self._rows) if by_state else None

    def delayed(self, motions: Sequence[Motion], delay_s: float) -> Linear:
        """The same system with another delay removed, which changes the torque and no other column.

        Args:
            motions: As recorded, the same as before.
            delay_s: The delay, s.
        """
        other = copy(self)
        other.wiring = replace(self.wiring, delay_s=delay_s)
        other.motions = other.wiring.undone(motions, self.model)
        other._rows = [
            [
                (place, np.column_stack([stacked[:, :-1], torque]))
                for (place, stacked), torque in zip(part, _torque_of(self.model, motion, self._whiteners))
            ]
            for part, motion in zip(self._rows, other.motions)
        ]
        other._gather(self.by_state is not None)
        return other

    @property
    def count(self) -> int:
        """P."""
        return len(self.names)

    def column_of_constant(self, number: int) -> int:
        """Which unknown is the logarithm of a constant of the model; names are not enough, two terms may share one."""
        return self.count - len(self.model.constants) + number

    def start(self) -> FloatArray:
        """(P,) values of the model; nothing left to correct."""
        values = np.zeros(self.count)
        values[: len(self.model.parameters)] = self.model.parameters
        return values

    def solve(self, prior: Prior, noise: FloatArray, blocks: np.ndarray | None = None) -> Solution:
        """Least squares with a prior.

        Args:
            prior: Of every unknown.
            noise: (n,) factor on each joint's variance.
            blocks: Numbers of the blocks to fit to; None: all.
        """
        gram = self._weighted(noise, blocks)
        free = np.flatnonzero(prior.free)
        held = np.flatnonzero(~prior.free)
        matrix = gram[np.ix_(free, free)] + prior.precision[np.ix_(free, free)]
        vector = gram[free, -1] + prior.precision[np.ix_(free, free)] @ prior.mean[free]
        vector = vector - gram[np.ix_(free, held)] @ prior.mean[held]
        unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = matrix * np.outer(unit, unit) + RIDGE * np.eye(len(free))
        inverse = np.linalg.inv(scaled) * np.outer(unit, unit)
        values, covariance = prior.mean.copy(), np.zeros((self.count, self.count))
        values[free] = inverse @ vector
        covariance[np.ix_(free, free)] = inverse
        return Solution(values, covariance)

    def parts(self) -> list[np.ndarray]:
        """Blocks of every recording; of a single one, of its two halves."""
        recordings = np.unique(self.recording)
        if len(recordings) > 1:
            return [np.flatnonzero(self.recording == number) for number in recordings]
        return np.array_split(np.arange(self.blocks), 2)

    def squares(self, values: FloatArray) -> FloatArray:
        """(n, B) squares left by values (P,), in the rows' weights."""
        vector = np.append(values, -1.0)
        return np.asarray(np.maximum(np.einsum("i,jbik,k->jb", vector, self.gram, vector, optimize=True), 0.0))

    def rms(self, values: FloatArray) -> FloatArray:
        """(n,) root mean square of what values leave; NaN where a joint has no rows."""
        rows = self.rows.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(self.squares(values).sum(axis=1) / np.where(rows > 0, rows, np.nan)))

    def log_evidence(self, prior: Prior, noise: FloatArray, blocks: np.ndarray | None = None) -> float:
        """Logarithm of the marginal likelihood of rows, up to what no prior changes; arguments as for `solve`."""
        gram = self._weighted(noise, blocks)
        free = np.flatnonzero(prior.free)
        held = np.flatnonzero(~prior.free)
        held_mean = prior.mean[held]
        cross = gram[free, -1] - gram[np.ix_(free, held)] @ held_mean
        rest = gram[-1, -1] - 2 * gram[held, -1] @ held_mean + held_mean @ gram[np.ix_(held, held)] @ held_mean
        precision = prior.precision[np.ix_(free, free)]
        # In units of the prior both determinants are of matrices that are one or more.
        unit = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
        precision = precision * np.outer(unit, unit)
        matrix = gram[np.ix_(free, free)] * np.outer(unit, unit) + precision
        mean = prior.mean[free] / unit
        vector = cross * unit + precision @ mean
        lower = np.linalg.cholesky(matrix + RIDGE * np.diag(np.diag(matrix)))
        solved = np.linalg.solve(lower, vector)
        value = -0.5 * float(rest + mean @ precision @ mean - solved @ solved)
        value += 0.5 * float(np.linalg.slogdet(precision)[1]) - float(np.log(np.diag(lower)).sum())
        return value

    def variance(self, values: FloatArray, noise: Noise, least: float) -> FloatArray:
        """(n,) factor on each joint's variance: squares that values leave over what its rows count for.

        Args:
            values: (P,).
            noise: Whose whiteners the rows are weighted by.
            least: Smallest factor.
        """
        share = np.array([(f / w.sigma_Nm) ** 2 for f, w in zip(noise.floor_Nm, noise.whiteners)])
        counts = np.where(np.isfinite(share), self.rows.sum(axis=1) * share, 0.0)
        left = self.squares(values).sum(axis=1)
        return np.where(counts > 0, left / np.maximum(counts, 1e-9), 1.0).clip(least, LARGEST_FACTOR)

    def _weighted(self, noise: FloatArray, blocks: np.ndarray | None) -> FloatArray:
        chosen = self._of_all_blocks if blocks is None else self.gram[:, blocks].sum(axis=1)
        return np.asarray(np.tensordot(1.0 / noise, chosen, axes=1))


def _rows_of(
    model: IdentifiedModel, motion: Motion, whiteners: Sequence[Whitener], with_constants: bool
) -> list[tuple[np.ndarray, FloatArray]]:
    """By joint, (M,) which rows of a motion count, and (M, P + 1) their weighted columns and, last, torque."""
    scene = Scene(model, [motion], whiteners)
    stacked = np.column_stack(
        [
            _model_columns(model, scene),
            scene.stack([_wiring_columns(model, motion)], len(column_names(motion.joints))),
            _constant_columns(model, scene) if with_constants else np.zeros((len(scene), len(model.constants))),
            scene.torque(),
        ]
    )
    slots = [scene.slot(joint, 0) for joint in range(len(motion.joints))]
    return [(scene.place[slot], stacked[slot]) for slot in slots]


def _torque_of(model: IdentifiedModel, motion: Motion, whiteners: Sequence[Whitener]) -> list[FloatArray]:
    """By joint, (M,) weighted torque of the rows of a motion that count."""
    scene = Scene(model, [motion], whiteners)
    torque = scene.torque()
    return [torque[scene.slot(joint, 0)] for joint in range(len(motion.joints))]


def _by_state(motions: Sequence[Motion], parts: Sequence[list[tuple[np.ndarray, FloatArray]]]) -> FloatArray:
    """(2, n, G, c, c) Gram matrices of rows, by motion and joint, by the joint's velocity and by its position."""
    n, width = len(motions[0].joints), parts[0][0][1].shape[1]
    gram = np.zeros((2, n, STATE_GROUPS, width, width))
    for joint in range(n):
        along = [(motion, *part[joint]) for motion, part in zip(motions, parts)]
        rows = np.concatenate([stacked for _, _, stacked in along])
        speed = np.concatenate([motion.velocity_rows[place, joint] for motion, place, _ in along])
        where = np.concatenate([motion.reduce(motion.position)[place, joint] for motion, place, _ in along])
        for kind, state in enumerate((speed, where)):
            for number, group in enumerate(np.array_split(np.argsort(state), STATE_GROUPS)):
                gram[kind, joint, number] = rows[group].T @ rows[group]
    return gram


def weak_prior(linear: Linear) -> Prior:
    """The prior of an identification: CAD's inertials, as uncertain as they are large; the wiring is not estimated."""
    model = linear.model.model
    known = make_prior(model, linear.motions)
    mean, free = linear.start(), np.zeros(linear.count, dtype=bool)
    precision = np.zeros((linear.count, linear.count))
    count = len(model.parameters)
    precision[:count, :count] = known.rows.T @ known.rows
    # Rows of the prior are relative to an anchor; values are pulled to the CAD's, not to the model's.
    pulled = np.linalg.lstsq(known.rows, known.target, rcond=None)[0]
    mean[:count] = np.where(known.scale > 0, pulled, mean[:count])
    free[:count] = known.scale > 0
    mean[:count] = np.where(free[:count], mean[:count], linear.start()[:count])
    return Prior(mean, precision, free)


def _model_columns(model: IdentifiedModel, scene: Scene) -> FloatArray:
    """(R, p) weighted columns of a model's terms."""
    blocks = []
    for term, _, first in model.model.numbered():
        constants = model.constants[first : first + len(term.constants)]
        columns = [term.columns(motion, constants, b) for motion, b in zip(scene.motions, scene.backgrounds)]
        blocks.append(scene.stack(columns, len(term.parameters)))
    return np.concatenate(blocks, axis=1)


def _constant_columns(model: IdentifiedModel, scene: Scene) -> FloatArray:
    """(R, c) weighted derivative of the torque by each constant's logarithm; zero where a constant is."""
    derivatives = np.zeros((len(scene), len(model.constants)))
    along = list(zip(scene.motions, scene.backgrounds))
    for term, parameter, first in model.model.numbered():
        values = model.parameters[parameter : parameter + len(term.parameters)]
        constants = model.constants[first : first + len(term.constants)]
        searched = np.flatnonzero(constants)
        here = [term.columns(motion, constants, b) for motion, b in along] if len(searched) else []
        for number in searched:
            moved = constants.copy()
            moved[number] *= 1.0 + CONSTANT_STEP
            there = [term.columns(motion, moved, b) for motion, b in along]
            slopes = [_slope_by(*both, values) for both in zip(there, here)]
            derivatives[:, [first + number]] = scene.stack(slopes, 1)
    return derivatives


def _slope_by(there: Columns, here: Columns, values: FloatArray) -> Columns:
    """The difference quotient of a term's torque as one column a joint."""
    return {
        joint: ([0], ((columns @ values[numbers] - here[joint][1] @ values[here[joint][0]]) / CONSTANT_STEP)[:, None])
        for joint, (numbers, columns) in there.items()
    }


def _wiring_columns(model: IdentifiedModel, motion: Motion) -> Columns:
    """Full-rate columns of gains, zeros, the delay and the tilt."""
    n = len(motion.joints)
    torque = model.torque(motion)
    late = -np.gradient(lasting_torque(model, motion, torque), 1.0 / motion.rate_hz, axis=0)
    slopes = _slopes(model.model, model.parameters, motion)
    tilts = np.stack([_by_tilt(model, motion, axis) for axis in np.eye(3)], axis=2)
    columns: Columns = {}
    for row in range(n):
        own = np.concatenate([torque[:, [row]], slopes[:, row], late[:, [row]], tilts[:, row]], axis=1)
        columns[row] = [row, *range(n, 2 * n + 4)], own
    return columns


def _by_tilt(model: IdentifiedModel, motion: Motion, axis: FloatArray) -> FloatArray:
    """(N, n) derivative of the rigid bodies' torque by a tilt about an axis; none where the base's motion is known."""
    if motion.base is not None:
        return np.zeros_like(motion.torque)
    return gravity_torque(model, motion.position, np.cross(model.model.arm.gravity, axis))


def _slopes(model: TorqueModel, parameters: FloatArray, motion: Motion) -> FloatArray:
    """(N, n, n) derivative of the rigid bodies' torque by every joint's position, the last axis."""
    count = len(model.arm.joints)
    inertials = parameters[: 10 * count].reshape(-1, 10)
    state = motion.velocity, motion.acceleration
    here = rigid_body_torque(model.arm, inertials, motion.position, *state, motion.base)
    beside = (motion.position + ZERO_STEP * unit for unit in np.eye(count))
    there = [rigid_body_torque(model.arm, inertials, position, *state, motion.base) for position in beside]
    return (np.stack(there, axis=2) - here[:, :, None]) / ZERO_STEP
