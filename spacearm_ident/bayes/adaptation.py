"""A ground model adapted to where the arm works now: what moved, by how much, and what that says of the cause.

The ground's values and covariance are the prior of a Bayesian update (`from_prior`) with gravity as it is there,
room for friction to have changed, and friction over temperature (alpha) where the runs span one. With x the present
parameters, x = g + delta, g ~ N(m, P) what the ground knew and delta ~ N(0, Q) the change since, the update's mean x^
and covariance S give the change with an error of its own,

    delta^ = K (x^ - m),    cov = Q - K Q + K S K',    K = Q (P + Q)^-1,

so that what the ground did not know does not pass for a change.

Causes are told apart by what only they do: gravity by the torque that turns with posture as weight does (its vector is
estimated in the residual), vacuum by the share of k_v2 and k_v3 that is gone at all joints at once, temperature by the
friction level of each run by itself over that run's temperature, a level changed for another reason by what is left of
f_c at T_0. A torque cannot tell a lubricant's loss from wear or preload, and no sentence here pretends that it can.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.friction import TemperatureFriction
from ..dynamics.model import IdentifiedModel
from ..dynamics.rigid_body import RigidBody
from ..environment.temperature import LEAST_SPAN_K
from ..errors import UserError
from ..noise.weights import residual_noise
from ..recording.recording import Recording
from ..regression.balanced import pseudo_inverse
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..tracking.rows import with_effects
from .from_prior import CHANGES, GroundPrior, Updated, update

HIGH_ORDER_ROOM = 3.0
"""k_v2 and k_v3 are small and badly known: their change is left to the data."""
SLOPE_ROOM = 0.02
"""Standard deviation of alpha before the data, as a share of the friction it changes, 1/K."""
SLOPES: Mapping[str, str] = {"alpha_c": "f_c", "alpha_v": "k_v1"}
LEAST_ROWS = 10
"""Fewer moving rows say nothing of a run's level."""
CLEAR = 4.0
"""Standard errors from which a change is called one: one false call in some 16,000."""


@dataclass(frozen=True)
class Change:
    """One parameter then and now.

    Attributes:
        symbol, joint, unit: What it is; friction levels are those at T_0 where alpha is known.
        before, before_error: On the ground; zero for alpha where the ground model has none.
        after, after_error: Now.
        change, change_error: Since then.
    """

    symbol: str
    joint: str
    unit: str
    before: float
    before_error: float
    after: float
    after_error: float
    change: float
    change_error: float

    @property
    def significance(self) -> float:
        """Of the change, in standard errors."""
        return abs(self.change) / self.change_error if self.change_error > 0 else 0.0

    @property
    def moved(self) -> bool:
        """Whether it changed beyond doubt."""
        return self.significance > CLEAR


@dataclass(frozen=True)
class Levels:
    """Coulomb friction of every run by itself, alpha left out of the model.

    Attributes:
        temperature: (runs, n) mean of the run, °C; NaN where not recorded.
        level: (runs, n) N·m; NaN where the joint does not move.
        error: (runs, n) standard errors, N·m.
    """

    temperature: FloatArray
    level: FloatArray
    error: FloatArray

    def correlation(self, joint: int) -> float:
        """Pearson's R of level and temperature over the runs; NaN where there is none."""
        warm, level = self.temperature[:, joint], self.level[:, joint]
        known = np.isfinite(warm) & np.isfinite(level)
        if known.sum() < 3 or not np.ptp(warm[known]) > 0:
            return float("nan")
        return float(np.corrcoef(warm[known], level[known])[0, 1])


@dataclass(frozen=True)
class Share:
    """A share, dimensionless, with its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class Adaptation:
    """A ground model, adapted.

    Attributes:
        ground: The model as the ground identified it.
        weightless: The same with gravity as it is now, nothing else changed.
        adapted: The model as it is now.
        updated: The update behind it.
        changes: Friction parameters then and now, in the model's order.
        levels: Run by run.
        gravity: (3,) estimate in what the adapted model leaves over, m/s², and (3,) its standard errors.
        vacuum: Share of the ground's k_v2 and k_v3 that is gone, over all joints; None where the ground had none.
        inertia_shift: Largest move of a rigid-body value, in its standard errors on the ground.
    """

    ground: IdentifiedModel
    weightless: IdentifiedModel
    adapted: IdentifiedModel
    updated: Updated
    changes: tuple[Change, ...]
    levels: Levels
    gravity: FloatArray
    gravity_error: FloatArray
    vacuum: Share | None
    inertia_shift: float


def adapt(ground: GroundPrior, recordings: Sequence[Recording], gravity: FloatArray) -> Adaptation:
    """Adapt a ground model to runs made elsewhere.

    Args:
        ground: Model and covariance.
        recordings: Runs, short ones too; with temperatures that differ, alpha can be told.
        gravity: (3,) m/s² in the base frame, where the runs were made.

    Raises:
        UnfitDataError: Nothing moves.
        UserError: A recording lacks a joint, or the model has no friction that could change.
    """
    missing = {f"{symbol}[{joint}]" for joint in ground.model.model.arm.joint_names for symbol in SLOPES.values()}
    if missing := missing - set(ground.names):
        raise UserError(f"the ground model has no {min(missing)}: identify the ground run with a friction law")
    weightless = ground.model.possible.with_gravity(gravity)
    prior = _with_slopes(GroundPrior(weightless, ground.covariance), recordings)
    room = {**CHANGES, "k_v2": HIGH_ORDER_ROOM, "k_v3": HIGH_ORDER_ROOM}
    updated = update(recordings, prior, room)
    change, spread = _since(prior, updated, room)
    changes = _changes(prior, updated, change, spread)
    motions, _ = prepare(recordings, weightless.model.arm.joint_names, weightless.cutoff_hz, average=False)
    residuals = [motion.torque_rows - motion.reduce(updated.model.torque(motion)) for motion in motions]
    estimate, error = _gravity(updated.model, motions, residuals)
    return Adaptation(
        ground.model,
        weightless,
        updated.model,
        updated,
        changes,
        _levels(updated.model, motions, residuals, len(recordings)),
        estimate,
        error,
        _vacuum(prior, change, spread),
        _inertia_shift(prior, updated),
    )


def _with_slopes(prior: GroundPrior, recordings: Sequence[Recording]) -> GroundPrior:
    """With alpha of every joint whose temperature changes enough, zero until the data say otherwise."""
    known = set(prior.names)
    joints = prior.model.model.arm.joint_names
    places = []
    for joint in joints:
        series = [recording.temperatures[joint].values for recording in recordings if joint in recording.temperatures]
        warm = np.concatenate([values for values in series if len(values)] or [np.zeros(1)])
        new = [level for symbol, level in SLOPES.items() if f"{symbol}[{joint}]" not in known]
        if new and np.ptp(warm) >= LEAST_SPAN_K:
            places.append((TemperatureFriction.kind, {"joint": joint, "of": new}))
    if not places:
        return prior
    wider = GroundPrior(with_effects(prior.model, places), np.zeros((0, 0)))
    names = list(wider.names)
    kept = [names.index(name) for name in prior.names]
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(kept, kept)] = prior.covariance
    for number in set(range(len(names))) - set(kept):
        symbol, joint = names[number][:-1].split("[")
        covariance[number, number] = (SLOPE_ROOM * prior.model.value(SLOPES[symbol], joint)) ** 2
    return replace(wider, covariance=covariance)


def _since(prior: GroundPrior, updated: Updated, room: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """The change since the ground (u,) and its covariance (u, u); see the module's equation."""
    before = np.concatenate([prior.model.parameters, prior.model.constants])
    after = np.concatenate([updated.model.parameters, updated.model.constants])
    whole = prior.widened(room).covariance
    change = whole - prior.covariance
    gain = change @ pseudo_inverse(whole, rcond=1e-12)
    spread = change - gain @ change + gain @ updated.covariance @ gain.T
    return np.asarray(gain @ (after - before)), np.asarray(spread)


def _changes(prior: GroundPrior, updated: Updated, change: FloatArray, spread: FloatArray) -> tuple[Change, ...]:
    """Every friction level the runs can tell, then alpha."""
    model = prior.model.model
    symbols = [symbol for symbol in CHANGES if symbol != "f_b"]
    out = []
    for number, item in enumerate(model.parameters):
        slope = item.symbol in SLOPES
        if (item.symbol not in symbols and not slope) or prior.covariance[number, number] == 0.0:
            continue
        before, error = float(prior.model.parameters[number]), float(np.sqrt(prior.covariance[number, number]))
        after, after_error = float(updated.model.parameters[number]), float(updated.standard_errors[number])
        moved = (after - before, after_error) if slope else (change[number], np.sqrt(max(spread[number, number], 0.0)))
        new = slope and before == 0.0
        values = (before, 0.0 if new else error, after, after_error, float(moved[0]), float(moved[1]))
        out.append(Change(item.symbol, item.joint, item.unit, *values))
    return tuple(out)


def _vacuum(prior: GroundPrior, change: FloatArray, spread: FloatArray) -> Share | None:
    """Share s of delta = -s k over k_v2 and k_v3 of all joints, by generalised least squares."""
    places = [k for k in np.flatnonzero(prior.model.model.of_high_order) if spread[k, k] > 0]
    high = prior.model.parameters[places]
    if not high.any():
        return None
    weight = pseudo_inverse(spread[np.ix_(places, places)]) @ high
    information = float(high @ weight)
    return Share(-float(weight @ change[places]) / information, 1.0 / np.sqrt(information))


def _inertia_shift(prior: GroundPrior, updated: Updated) -> float:
    """Largest move of a rigid-body parameter or rotor in standard errors of the ground."""
    errors = np.sqrt(np.diag(prior.covariance))
    kinds = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz", "J_m")
    moves = [
        abs(updated.model.parameters[k] - prior.model.parameters[k]) / errors[k]
        for k, item in enumerate(prior.model.model.parameters)
        if item.symbol in kinds and errors[k] > 0
    ]
    return max(map(float, moves), default=0.0)


def _gravity(
    model: IdentifiedModel, motions: Sequence[Motion], residuals: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Gravity (3,), m/s², and standard errors: the model's own plus what the residuals (M, n) have of it."""
    own = model.model.arm.gravity
    information, score = np.zeros((3, 3)), np.zeros(3)
    for motion, residual in zip(motions, residuals):
        still = replace(motion, velocity=0.0 * motion.velocity, acceleration=0.0 * motion.velocity)
        columns = [motion.reduce(model.with_gravity(axis).torque(still, [RigidBody.kind])) for axis in np.eye(3)]
        for joint in range(residual.shape[1]):
            place = np.flatnonzero(motion.moving[:, joint])
            if len(place) < 2:
                continue
            noise = residual_noise(residual[place, joint], place, motion.white_correlation)
            matrix = np.stack([column[place, joint] for column in columns], axis=1)
            weight = 1.0 / max(noise.sigma_Nm**2 * noise.correlation_rows, 1e-12)
            information += weight * matrix.T @ matrix
            score += weight * matrix.T @ residual[place, joint]
    spread = np.linalg.pinv(information, hermitian=True)
    # A direction that no joint can feel (gravity along the only axis) is not known to be anything.
    felt = np.diag(information) > 1e-9 * max(float(np.diag(information).max()), 1e-300)
    error = np.where(felt, np.sqrt(np.maximum(np.diag(spread), 0.0)), np.nan)
    return np.where(felt, own + spread @ score, np.nan), error


def _levels(model: IdentifiedModel, motions: Sequence[Motion], residuals: Sequence[FloatArray], runs: int) -> Levels:
    """Coulomb friction run by run, alpha_c set aside."""
    joints = model.model.arm.joint_names
    symbols = np.array([item.symbol for item in model.model.parameters])
    slopes = replace(model, parameters=np.where(symbols == "alpha_c", model.parameters, 0.0))
    unit = replace(model, parameters=np.isin(symbols, ["f_c", "f_b"]).astype(float))
    start = np.array([model.value("f_c", name) for name in joints])
    warm, level, error = (np.full((runs, len(joints)), np.nan) for _ in range(3))
    offset, information = np.zeros((2, runs, len(joints)))
    for motion, residual in zip(motions, residuals):
        kinds = model.model.friction_kinds
        columns = motion.reduce(unit.torque(motion, kinds))
        found, weight = _offsets(columns, residual + motion.reduce(slopes.torque(motion, kinds)), motion)
        offset[motion.source] += found * weight
        information[motion.source] += weight
    informed = information > 0.0
    level[informed] = (start + offset / np.where(informed, information, 1.0))[informed]
    error[informed] = 1.0 / np.sqrt(information[informed])
    for run in range(runs):
        known = [motion.temperature for motion in motions if motion.source == run and motion.temperature is not None]
        if known:
            warm[run] = np.mean(np.concatenate(known), axis=0)
    return Levels(warm, level, error)


def _offsets(columns: FloatArray, residuals: FloatArray, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """How much of its column (M, n) each joint's residual (M, n) has, (n,), and the information in that."""
    offset, information = np.zeros((2, columns.shape[1]))
    for joint, moving in enumerate(motion.moving.T):
        place = np.flatnonzero(moving)
        column, residual = columns[place, joint], residuals[place, joint]
        size = float(column @ column)
        if len(place) < LEAST_ROWS or not size > 0.0:
            continue
        offset[joint] = float(column @ residual) / size
        noise = residual_noise(residual - offset[joint] * column, place, motion.white_correlation)
        information[joint] = size / max(noise.sigma_Nm**2 * noise.correlation_rows, 1e-12)
    return offset, information
