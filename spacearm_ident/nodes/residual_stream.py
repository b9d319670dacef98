"""`ResidualStream`: raw joint-state messages in, rows of the live residual out, with its recent size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..tracking.live_residual import LiveResidual
from .joint_samples import JointSamples

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
    """

    def __init__(self, model: IdentifiedModel, row_rate_hz: float) -> None:
        self.model = model
        self.joints = model.model.arm.joint_names
        self._row_rate_hz = row_rate_hz
        self._samples = JointSamples(self.joints, model.model.arm.effort_scale)
        self._live: LiveResidual | None = None
        self._recent = np.zeros((0, len(self.joints)))

    def add(self, payloads: Sequence[bytes]) -> list[Row]:
        """Take messages; returns the rows they complete."""
        samples = self._samples.take(payloads)
        if samples is None:
            return []
        if self._live is None:
            rate = self._samples.rate_hz
            self._live = LiveResidual(self.model, rate, min(self._row_rate_hz, rate))
        parts = self._live.add(samples.time, samples.position, samples.effort)
        rows = [
            Row(self._samples.epoch_ns + round(moment * 1e9), residual, predicted)
            for part in parts
            for moment, residual, predicted in zip(part.time.tolist(), part.residual, part.predicted)
        ]
        if rows:
            keep = int(RECENT_S * self._live.stream.row_rate_hz)
            self._recent = np.concatenate([self._recent, *(part.residual for part in parts)])[-keep:]
        return rows

    def figures(self) -> dict[str, object]:
        """For `/diagnostics`: RMS of the last ten seconds a joint, and how the filter stands."""
        if self._live is None:
            return {}
        values: dict[str, object] = {
            "rate_Hz": self._live.stream.row_rate_hz,
            "delay_s": self._live.stream.delay_s,
            "bandwidth_Hz": self._live.stream.cutoff_hz,
            "restarts": self._live.stream.restarts,
            "messages_left_out": self._samples.left_out,
        }
        if len(self._recent):
            rms = np.sqrt(np.mean(self._recent**2, axis=0))
            values |= {f"rms_Nm[{joint}]": float(value) for joint, value in zip(self.joints, rms)}
        return values
