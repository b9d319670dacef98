"""Input of a tracker: rows of residual torque, with the columns of the parameters that it follows.

`TrackedModel` says which parameters of an identified model are followed and computes their columns; everything else
is held where it was identified. Rows come from a stream of samples (`RowStream`, on a node) or from a recording
(`rows_of`). In both, torque and columns are built at full rate, sign of the velocity included, and go through one
low-pass together. A row into whose window a reversal reaches is not smeared into something between two signs but left
out (`Rows.moving`): there friction is whatever balances the rest. So is a row that is slower than all those that the
model was identified from (`TrackedModel.slowest`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.body import MASS, Payload
from ..dynamics.effects.friction import TemperatureFriction
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..signals.motion import REVERSAL_SHARE, STANDSTILL_SHARE, Motion
from ..signals.stream import MotionStream
from .live_residual import DEFAULT_CUTOFF_HZ, Residuals

LEVELS = ("f_c", "f_b", "k_v1")
ALPHA = "alpha_c"
LOAD = "load"
"""A torque that does not turn with the direction of motion. It is no parameter: held at zero until a change says so."""
ROWS_A_PERIOD = 2.0
"""Rows in one period of the cut-off: nearer together they would say the same twice."""
PERCENTILE_95 = 1.96
"""95th percentile of a normal variable's absolute value over its RMS, for accelerations: `Motion.resolved_speed` is of
the first, a model file keeps the second. A sine's is 1.41."""


class TrackedModel:
    """An identified model and which of its parameters are followed.

    Args:
        model: As identified.
        payload: Follow mass and first moment of a body on the last link.
        temperature: Follow alpha_c, how the Coulomb level follows the temperature.

    Attributes:
        model: The same, with the terms it did not have (at zero).
        symbols: Of what is followed at each joint, in the order of its columns; `load` is the last unless a payload is
            followed.
        shared: Numbers of the parameters that act on all joints, in `model.model.parameters`.
        slowest: (n,) speed below which rows were left out of the identification, rad/s; 0 where it is not known.
    """

    def __init__(self, model: IdentifiedModel, payload: bool = False, temperature: bool = False) -> None:
        arm = model.model.arm
        self.joints = arm.joint_names
        self.payload = payload
        self.slowest = _slowest(model)
        self.model = _with_terms(model, self.joints, payload, temperature)
        self.symbols = (*LEVELS, *([ALPHA] if temperature else []), *([] if payload else [LOAD]))
        numbers = {parameter.name: k for k, parameter in enumerate(self.model.model.parameters)}
        self.own = [[numbers.get(f"{symbol}[{joint}]", -1) for symbol in self.symbols] for joint in self.joints]
        self.shared = [numbers[f"d{symbol}[{self.joints[-1]}]"] for symbol in MASS] if payload else []
        wanted = {number for row in self.own for number in row if number >= 0} | set(self.shared)
        self._terms = [
            (term, first, first_constant)
            for term, first, first_constant in self.model.model.numbered()
            if wanted & set(range(first, first + len(term.parameters)))
        ]

    def columns(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Columns at full rate: (N, n, k) of each joint's own parameters, (N, n, s) of the shared ones."""
        samples, joints = motion.position.shape
        own = np.zeros((samples, joints, len(self.symbols)))
        shared = np.zeros((samples, joints, len(self.shared)))
        background = self.model.model.background(motion, self.model.parameters, self.model.constants)
        for term, first, first_constant in self._terms:
            constants = self.model.constants[first_constant : first_constant + len(term.constants)]
            for row, (indices, columns) in term.columns(motion, constants, background).items():
                for index, column in zip(indices, columns.T):
                    if first + index in self.own[row]:
                        own[:, row, self.own[row].index(first + index)] = column
                    if first + index in self.shared:
                        shared[:, row, self.shared.index(first + index)] = column
        if not self.payload:
            own[:, :, -1] = 1.0
        return own, shared


def _slowest(model: IdentifiedModel) -> FloatArray:
    """(n,) `Motion.standstill` of the recordings a model was identified from, rad/s, without their encoders' noise.

    Friction below it was no part of the fit: at the slow ends of an approach a tracker would take what presliding
    leaves there for a change. 0 where the model does not say how fast its recordings were.
    """
    if model.own is None or model.cutoff_hz is None:
        return np.zeros(len(model.model.arm.joints))
    return REVERSAL_SHARE * PERCENTILE_95 * model.own.acceleration / (2 * np.pi * model.cutoff_hz)


def _with_terms(model: IdentifiedModel, joints: Sequence[str], payload: bool, temperature: bool) -> IdentifiedModel:
    """The model with a payload and temperature terms where it has none, at zero."""
    known = {parameter.name for parameter in model.model.parameters}
    places: list[tuple[str, Mapping[str, Any]]] = []
    if payload and f"dm[{joints[-1]}]" not in known:
        places.append((Payload.kind, {"joint": joints[-1], "last": True}))
    for joint in joints if temperature else ():
        if f"{ALPHA}[{joint}]" not in known:
            places.append((TemperatureFriction.kind, {"joint": joint, "of": ["f_c"]}))
    return with_effects(model, places)


def with_effects(model: IdentifiedModel, places: Sequence[tuple[str, Mapping[str, Any]]]) -> IdentifiedModel:
    """The model with further effects, each a (kind, place), whose parameters are zero.

    Args:
        model: Its own terms and values stay.
        places: Kind of an effect, and where it acts, with options as the structure's `at` has them.
    """
    structure: dict[str, dict[str, Any]] = {kind: dict(options) for kind, options in model.model.structure.items()}
    for kind, place in places:
        options = structure.setdefault(kind, {})
        options["at"] = [*options.get("at", ()), dict(place)]
    return model.carried_to(TorqueModel(model.model.arm, structure))


@dataclass(frozen=True)
class Rows(Residuals):
    """Rows of a residual with the columns of what is followed.

    Attributes:
        own: (M, n, k) columns of each joint's own parameters.
        shared: (M, n, s) columns of the shared ones.
        moving: (M, n) whether a joint's row is free of reversals, and of speeds below `TrackedModel.slowest`.
        white: (L,) autocorrelation by lag in rows that the low-pass gives to white noise; 1 at lag 0.
        spacing_s: Time between rows.
    """

    own: FloatArray
    shared: FloatArray
    moving: np.ndarray
    white: FloatArray
    spacing_s: float


def rows_of(tracked: TrackedModel, motion: Motion) -> Rows:
    """Rows of an uninterrupted stretch of a recording (not of averaged periods).

    Args:
        tracked: Which parameters are followed.
        motion: The stretch, at full rate, with the tracked model's joints.

    Returns:
        Rows at the reduced rate; `moving` is false also below `tracked.slowest`.
    """
    own, shared = tracked.columns(motion)
    judged = replace(motion, speed_noise=np.maximum(motion.speed_noise, tracked.slowest))
    return Rows(
        motion.time,
        motion.torque_rows,
        motion.reduce(tracked.model.torque(motion)),
        _reduced(motion, own),
        _reduced(motion, shared),
        judged.moving,
        motion.white_correlation,
        1.0 / motion.row_rate_hz,
    )


def _reduced(motion: Motion, columns: FloatArray) -> FloatArray:
    """(M, n, k) rows of columns (N, n, k)."""
    flat = motion.reduce(columns.reshape(len(columns), -1))
    return flat.reshape(len(flat), *columns.shape[1:])


class RowStream:
    """Raw samples in, `Rows` out as they become known, `stream.delay_s` late (`signals.stream`).

    Args:
        tracked: What is followed.
        rate_hz: Rate of the samples.

    Attributes:
        stream: The filters.
        temperature: (n,) latest °C of each joint, to be set by the caller, NaN where unknown; None: of none.
    """

    def __init__(self, tracked: TrackedModel, rate_hz: float) -> None:
        self.tracked = tracked
        self.temperature: FloatArray | None = None
        cutoff = tracked.model.cutoff_hz or DEFAULT_CUTOFF_HZ
        row_rate_hz = ROWS_A_PERIOD * min(cutoff, 0.2 * rate_hz)
        self.stream = MotionStream(tracked.model.model.arm.joint_names, rate_hz, cutoff, row_rate_hz, self._columns)

    def add(
        self, time: FloatArray, position: FloatArray, effort: FloatArray, temperature: FloatArray | None = None
    ) -> list[Rows]:
        """Take samples; returns the rows they complete, a part for each uninterrupted stretch.

        Args:
            time: (K,) s.
            position: (K, n) rad.
            effort: (K, n) N·m.
            temperature: (n,) °C now, NaN where unknown, if there is news of it.

        A sample that is not finite is left out, which leaves a gap where several are.
        """
        if temperature is not None:
            self.temperature = np.asarray(temperature, dtype=float)
        sound = np.isfinite(time) & np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
        count = len(self.tracked.symbols)
        return [
            Rows(
                rows.time,
                rows.torque,
                rows.columns[:, :, 0],
                rows.columns[:, :, 1 : 1 + count],
                rows.columns[:, :, 1 + count : -1],
                rows.columns[:, :, -1] < STANDSTILL_SHARE,
                rows.white_correlation,
                1.0 / self.stream.row_rate_hz,
            )
            for rows in self.stream.add(time[sound], position[sound], effort[sound])
        ]

    def _columns(self, motion: Motion) -> FloatArray:
        """(N, n, k): predicted torque, columns of what is followed, and whether the joint is slow."""
        if self.temperature is not None:
            motion = replace(motion, temperature=np.broadcast_to(self.temperature, motion.position.shape))
        own, shared = self.tracked.columns(motion)
        blur = REVERSAL_SHARE * np.abs(motion.acceleration) / (2 * np.pi * self.stream.cutoff_hz)
        slow = np.abs(motion.velocity) < np.maximum(blur, np.maximum(motion.speed_noise, self.tracked.slowest))
        # A reversal may pass between two samples.
        turned = np.diff(motion.velocity > 0, axis=0)
        slow[1:] |= turned
        slow[:-1] |= turned
        torque = self.tracked.model.torque(motion)
        return np.concatenate([torque[:, :, None], own, shared, slow[:, :, None]], axis=2)
