"""`LiveResidual`: measured minus predicted torque while the samples come in, in the model's bandwidth."""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..signals.stream import MotionStream

DEFAULT_CUTOFF_HZ = 10.0
"""Of a model that does not say in which bandwidth it was identified."""


@dataclass(frozen=True)
class Residuals:
    """Rows of a live residual: `time` (M,) s on the clock of the samples; `measured`, `predicted` (M, n) N·m."""

    time: FloatArray
    measured: FloatArray
    predicted: FloatArray

    @property
    def residual(self) -> FloatArray:
        """(M, n) measured minus predicted, N·m."""
        return self.measured - self.predicted


class LiveResidual:
    """Streaming counterpart of `validation.validate`, for one arm and its model (`signals.stream`).

    Args:
        model: Model with values.
        rate_hz: Rate of the samples; uneven ones are interpolated onto an even grid of this rate.
        output_hz: Rate of the rows wanted; `row_rate_hz` is the nearest that divides.

    Attributes:
        stream: The filters; its `delay_s` is that of the residuals.
    """

    def __init__(self, model: IdentifiedModel, rate_hz: float, output_hz: float = 50.0) -> None:
        self.stream = MotionStream(
            model.model.arm.joint_names,
            rate_hz,
            model.cutoff_hz or DEFAULT_CUTOFF_HZ,
            output_hz,
            lambda motion: model.torque(motion)[:, :, None],
        )

    def add(self, time: FloatArray, position: FloatArray, effort: FloatArray) -> list[Residuals]:
        """Take samples; returns the rows they complete, a part for each uninterrupted stretch (often none).

        Args:
            time: (K,) s; samples at or before the last one's time are left out, unless the clock was set back.
            position: (K, n) rad, in the order of the arm's joints.
            effort: (K, n) N·m.
        """
        return [
            Residuals(rows.time, rows.torque, rows.columns[:, :, 0]) for rows in self.stream.add(time, position, effort)
        ]
