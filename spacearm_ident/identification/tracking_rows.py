"""What a tracker eats: rows of residual torque with the columns of the parameters that may move.

`TrackedModel` says which parameters of an identified model are followed and computes their columns; everything else
is held where it was identified. Rows come from a stream of samples (`RowStream`, on a node) or from a recording
(`rows_of`). In both, torque and columns are built at full rate, sign of the velocity included, and go through one
low-pass together. A row into whose window a reversal reaches is not smeared into something between two signs but left
out (`Rows.moving`): there friction is whatever balances the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.effects.body import MASS, Payload
from ..dynamics.effects.friction import TemperatureFriction
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..recording.motion import REVERSAL_SHARE, STANDSTILL_SHARE, Motion
from .live import DEFAULT_CUTOFF_HZ, LiveResidual, Residuals

LEVELS = ("f_c", "f_b", "k_v1")
ALPHA = "alpha_c"
LOAD = "load"
"""A torque that does not turn with the direction of motion. It is no parameter: held at zero until a change says so."""
ROWS_A_PERIOD = 2.0
"""Rows in one period of the cut-off: nearer together they would say the same twice."""


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
    """

    def __init__(self, model: IdentifiedModel, payload: bool = False, temperature: bool = False) -> None:
        arm = model.model.arm
        self.joints = arm.joint_names
        self.payload = payload
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
    """The model with further effects, each a (kind, place), whose parameters are zero."""
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
        moving: (M, n) whether a joint's row is free of reversals and standstill.
        white: (L,) autocorrelation by lag in rows that the low-pass gives to white noise; 1 at lag 0.
        spacing_s: Time between rows.
    """

    own: FloatArray
    shared: FloatArray
    moving: np.ndarray
    white: FloatArray
    spacing_s: float


def rows_of(tracked: TrackedModel, motion: Motion) -> Rows:
    """Rows of an uninterrupted stretch of a recording (not of averaged periods)."""
    own, shared = tracked.columns(motion)
    return Rows(
        motion.time,
        motion.torque_rows,
        motion.reduce(tracked.model.torque(motion)),
        _reduced(motion, own),
        _reduced(motion, shared),
        motion.moving,
        motion.white_correlation,
        1.0 / motion.row_rate_hz,
    )


def _reduced(motion: Motion, columns: FloatArray) -> FloatArray:
    """(M, n, k) rows of columns (N, n, k)."""
    flat = motion.reduce(columns.reshape(len(columns), -1))
    return flat.reshape(len(flat), *columns.shape[1:])


class RowStream(LiveResidual):
    """Raw samples in, `Rows` out as they become known, `delay_s` late; everything as for `LiveResidual`.

    Args:
        tracked: What is followed.
        rate_hz: Rate of the samples.

    Attributes:
        temperature: (n,) latest °C of each joint, to be set by the caller; None where not all are known.
    """

    def __init__(self, tracked: TrackedModel, rate_hz: float) -> None:
        self.tracked = tracked
        self.temperature: FloatArray | None = None
        cutoff = min(tracked.model.cutoff_hz or DEFAULT_CUTOFF_HZ, 0.2 * rate_hz)
        super().__init__(tracked.model, rate_hz, ROWS_A_PERIOD * cutoff)

    def add(  # type: ignore[override]
        self, time: FloatArray, position: FloatArray, effort: FloatArray, temperature: FloatArray | None = None
    ) -> list[Rows]:
        """Take samples; returns the rows they complete, a part for each uninterrupted stretch.

        Args:
            time: (K,) s.
            position: (K, n) rad.
            effort: (K, n) N·m.
            temperature: (n,) °C now, if there is news of it.

        A sample that is not finite is left out, which leaves a gap where several are.
        """
        if temperature is not None:
            self.temperature = np.asarray(temperature, dtype=float)
        sound = np.isfinite(time) & np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
        parts = super().add(time[sound], position[sound], effort[sound])
        return [part for part in parts if isinstance(part, Rows)]

    def _start_anew(self) -> None:
        super()._start_anew()
        joints = len(self.tracked.joints)
        width = len(self.tracked.symbols) + len(self.tracked.shared) + 1
        self._columns = np.zeros((0, joints, width))

    def _predict(self, fresh: FloatArray) -> None:
        """Beside the torque, compute columns and where a joint is slow; queue them for the low-pass."""
        before = self._history
        super()._predict(fresh)
        whole = np.concatenate([before, fresh])
        speed_noise = 6 * self._noise * np.linalg.norm(self._taps[1]) + 1e-9
        own, shared = self.tracked.columns(self._motion(whole, speed_noise))
        blur = REVERSAL_SHARE * np.abs(whole[:, 2]) / (2 * np.pi * self.cutoff_hz)
        slow = np.abs(whole[:, 1]) < np.maximum(blur, speed_noise)
        # A reversal may pass between two samples.
        turned = np.diff(whole[:, 1] > 0, axis=0)
        slow[1:] |= turned
        slow[:-1] |= turned
        columns = np.concatenate([own, shared, slow[:, :, None]], axis=2)[len(before) :]
        self._columns = np.concatenate([self._columns, columns])

    def _reduce(self) -> Rows | None:
        """Low-pass and thin out torque, prediction and columns together."""
        waiting = len(self._full)
        motion = self._motion(self._full[:, :4], np.zeros(self._full.shape[2])) if waiting else None
        residuals = super()._reduce()
        if residuals is None or motion is None:
            return None
        reduced = _reduced(motion, self._columns)
        self._columns = self._columns[waiting - len(self._full) :]
        count = len(self.tracked.symbols)
        return Rows(
            residuals.time,
            residuals.measured,
            residuals.predicted,
            reduced[:, :, :count],
            reduced[:, :, count:-1],
            reduced[:, :, -1] < STANDSTILL_SHARE,
            motion.white_correlation,
            1.0 / self.row_rate_hz,
        )

    def _motion(self, signals: FloatArray, speed_noise: FloatArray) -> Motion:
        motion = super()._motion(signals, speed_noise)
        if self.temperature is None or not np.isfinite(self.temperature).all():
            return motion
        warm = np.broadcast_to(self.temperature, motion.position.shape)
        return replace(motion, temperature=warm)
