"""`ResidualStream`: raw joint-state messages in, rows of the live residual out, with its recent size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..dynamics.arm import FloatArray
from ..dynamics.model import IdentifiedModel
from ..identification.live import LiveResidual
from ..recording import cdr

RATE_SAMPLES = 64
"""Intervals from which the rate of the joint states is taken."""
RECENT_S = 10.0


@dataclass(frozen=True)
class Row:
    """Residual and predicted torque, (n,) N·m each, at a stamp; their sum is the torque measured, in the bandwidth."""

    stamp_ns: int
    residual: FloatArray
    predicted: FloatArray


class ResidualStream:
    """The residual of one model over a stream of messages.

    Args:
        model: Model with values.
        row_rate_hz: Rate of the rows wanted.

    Attributes:
        joints: Order of the residuals.
        left_out: Messages without a finite position and effort of every joint, or not to be decoded.
    """

    def __init__(self, model: IdentifiedModel, row_rate_hz: float) -> None:
        self.model = model
        self.joints = model.model.arm.joint_names
        self.left_out = 0
        self._row_rate_hz = row_rate_hz
        self._live: LiveResidual | None = None
        self._epoch_ns: int | None = None
        self._waiting: list[bytes] = []
        self._recent = np.zeros((0, len(self.joints)))

    def add(self, payloads: Sequence[bytes]) -> list[Row]:
        """Take messages; returns the rows they complete."""
        self._waiting.extend(payloads)
        if self._live is None and len(self._waiting) <= RATE_SAMPLES:
            return []
        stamps, position, effort = self._decode()
        if not len(stamps):
            return []
        if self._epoch_ns is None:
            self._epoch_ns = int(stamps[0])
        time = (stamps - self._epoch_ns) / 1e9
        if self._live is None:
            steps = np.diff(time)
            if not (steps > 0).any():
                return []
            rate = float(1.0 / np.median(steps[steps > 0]))
            self._live = LiveResidual(self.model, rate, min(self._row_rate_hz, rate))
        parts = self._live.add(time, position, effort)
        rows = [
            Row(self._epoch_ns + round(moment * 1e9), residual, predicted)
            for part in parts
            for moment, residual, predicted in zip(part.time.tolist(), part.residual, part.predicted)
        ]
        if rows:
            keep = int(RECENT_S * self._live.row_rate_hz)
            self._recent = np.concatenate([self._recent, *(part.residual for part in parts)])[-keep:]
        return rows

    def _decode(self) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Stamps (k,) ns, positions and efforts (k, n) of the waiting messages that have them, in order of arrival."""
        payloads, self._waiting = self._waiting, []
        joints = len(self.joints)
        stamps = np.zeros(len(payloads), dtype=np.int64)
        values = np.full((len(payloads), 2, joints), np.nan)
        for block in cdr.decode_joint_states(payloads)[0]:
            if block.position is None or block.effort is None or not set(self.joints) <= set(block.names):
                continue
            columns = [block.names.index(joint) for joint in self.joints]
            stamps[block.rows] = block.stamp_ns
            values[block.rows, 0] = block.position[:, columns]
            values[block.rows, 1] = block.effort[:, columns]
        sound = np.isfinite(values).all(axis=(1, 2))
        self.left_out += int((~sound).sum())
        return stamps[sound], values[sound, 0], values[sound, 1]

    def figures(self) -> dict[str, object]:
        """For `/diagnostics`: RMS of the last ten seconds a joint, and how the filter stands."""
        if self._live is None:
            return {}
        values: dict[str, object] = {
            "rate_Hz": self._live.row_rate_hz,
            "delay_s": self._live.delay_s,
            "bandwidth_Hz": self._live.cutoff_hz,
            "restarts": self._live.restarts,
            "messages_left_out": self.left_out,
        }
        if len(self._recent):
            rms = np.sqrt(np.mean(self._recent**2, axis=0))
            values |= {f"rms_Nm[{joint}]": float(value) for joint, value in zip(self.joints, rms)}
        return values
